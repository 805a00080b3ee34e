"""Linear TIFF and PNG pictures with three bands, in place of RAW files: their numbers are proportional to the light.

Each pixel of a picture becomes 2 x 2 mosaic pixels (red, green, green, blue), so that a superpixel is exactly a pixel
of the picture.

Only the user can know whether a picture is linear. A picture with a tone curve is refused if its numbers reveal the
curve: applied to integers, a curve leaves gaps between the numbers in the dark part, where it is steep, and fewer or
none in the bright part. There is no such trace if the picture was rounded to fewer steps or interpolated after the
curve; then an exposure series of a white surface reveals the curve (`irodori.ingest.linearity`).
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from irodori.core.errors import InputError
from irodori.export.pictures import stored_samples

_ACCEPTED = "a TIFF or PNG picture of 8 or 16 bits in red, green and blue, without transparency"
_SETTINGS = {
    "exposure_s": "ExposureTime",
    "f_number": "FNumber",
    "iso": "Exif:PhotographicSensitivity",
    "focal_mm": "Exif:FocalLength",
}
#: An octave is used if its mean count per distinct number is at least the first, and it has more than the second
#: count of distinct numbers.
_OFTEN, _FEWEST = 20.0, 4
#: Largest ratio between the steps of octaves of a linear picture, and of a gap to the median gap within an octave.
_LARGEST_RATIO, _REGULAR = 2.0, 4.0
_DARKEST_OCTAVE = 3  # octaves below 8 have too few numbers


def read_picture(path) -> dict[str, Any]:
    """Read a linear picture, and return the fields of an `irodori.ingest.mosaic.Mosaic`.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict
        ``values`` (2 height, 2 width) uint16, ``pattern``, ``black`` 0 and ``white``, the largest number that the file
        can hold; exposure time, ISO, f-number and focal length stated in the file, 0 if it does not state them.

    Raises
    ------
    InputError
        If the file does not exist, cannot be read, has other data types or bands, or shows a tone curve.
    """
    if not Path(path).is_file():
        raise InputError(path, "", "no such file", _ACCEPTED)
    samples, attributes = stored_samples(path, _ACCEPTED)
    if samples.dtype not in (np.uint8, np.uint16) or samples.shape[2] != 3:
        found = f"{samples.shape[2]} bands of {samples.dtype} numbers"
        raise InputError(path, "", found, _ACCEPTED)
    refuse_tone_curve(path, samples)
    white = np.iinfo(samples.dtype).max
    # Red and green over green and blue.
    bands = np.array([[0, 1], [1, 2]])
    height, width = samples.shape[:2]
    values = samples.astype(np.uint16)[:, :, bands].transpose(0, 2, 1, 3).reshape(2 * height, 2 * width)
    settings = {name: _positive(attributes.get(tag)) for name, tag in _SETTINGS.items()}
    return {
        "values": np.ascontiguousarray(values),
        "pattern": "RGGB",
        "black": np.zeros((2, 2), dtype=np.float32),
        "white": np.full((2, 2), white, dtype=np.float32),
        "full_scale": float(white),
        "orientation": 0,
        **settings,
    }


def _positive(value) -> float:
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) and value > 0.0 else 0.0


def refuse_tone_curve(path, samples: np.ndarray) -> None:
    """Raise `InputError` if the gaps between the numbers of a picture differ between dark and bright octaves.

    Parameters
    ----------
    path : path
        Name of the picture for the message.
    samples : (height, width, bands) uint8 or uint16

    Raises
    ------
    InputError
        If the numbers of a band show a tone curve.
    """
    for band in range(samples.shape[2]):
        steps = steps_by_octave(np.bincount(samples[..., band].ravel()))
        if not steps or max(steps.values()) < _LARGEST_RATIO * min(steps.values()):
            continue
        wide, narrow = max(steps, key=lambda first: steps[first]), min(steps, key=lambda first: steps[first])
        found = (
            f"a tone curve: numbers lie {steps[wide]:.3g} apart from {wide} to {2 * wide}, "
            f"and {steps[narrow]:.3g} from {narrow} to {2 * narrow}"
        )
        raise InputError(path, "linear", found, "a picture developed linearly (gamma 1, no curve), or the RAW file")


def steps_by_octave(counts: np.ndarray) -> dict[int, float]:
    """Return the mean gap between the numbers that occur in each octave, by the first number of the octave.

    Octaves with too few numbers or irregular gaps are left out.

    Parameters
    ----------
    counts : (n,) int
        Number of occurrences of each number.
    """
    found = {}
    for octave in range(_DARKEST_OCTAVE, 16):
        first = 1 << octave
        part = counts[first : 2 * first]
        there = np.flatnonzero(part)
        if len(there) <= _FEWEST or part.sum() < _OFTEN * len(there):
            continue
        gaps = np.diff(there)
        # A single large gap only means that the picture has no such tones.
        if gaps.max() < _REGULAR * max(float(np.median(gaps)), 1.0):
            found[first] = float(gaps.mean())
    return found
