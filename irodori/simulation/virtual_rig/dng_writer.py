"""DNG files that LibRaw decodes like those of a real camera (Adobe DNG specification 1.4)."""

import io
from fractions import Fraction

import numpy as np
import tifffile

from irodori.core.atomic_files import written_whole

_CFA_PHOTOMETRIC = 32803
_ILLUMINANT_A = 17
#: XYZ to camera space for illuminant A; viewers want one, LibRaw's raw data does not depend on it.
_COLOUR_MATRIX = (0.80, -0.27, -0.07, -0.45, 1.25, 0.21, -0.08, 0.19, 0.62)


def _rational(value: float) -> tuple[int, int]:
    fraction = Fraction(value).limit_denominator(1_000_000)
    return fraction.numerator, fraction.denominator


def write_dng(
    path,
    mosaic: np.ndarray,
    *,
    black_level: int,
    white_level: int,
    exposure_s: float,
    model: str,
    iso: float = 0.0,
    f_number: float = 0.0,
) -> None:
    """Write an RGGB mosaic as an uncompressed 16-bit DNG, replacing the file only when complete.

    Parameters
    ----------
    path : path of the file
    mosaic : (height, width) uint16, digital numbers; even sides
    black_level, white_level : int, digital numbers
    exposure_s : float, s
    model : str
        Camera model for the file's tags.
    iso, f_number : float
        Sensitivity and relative aperture for the file's tags; 0 writes none.
    """
    if mosaic.dtype != np.uint16 or mosaic.ndim != 2 or mosaic.shape[0] % 2 or mosaic.shape[1] % 2:
        raise ValueError(f"mosaic of {mosaic.dtype} {mosaic.shape}; accepted: uint16 with even sides")
    matrix = [part for value in _COLOUR_MATRIX for part in (round(value * 10_000), 10_000)]
    tags = [
        (271, "s", 0, "Irodori", True),  # Make
        (272, "s", 0, model, True),  # Model
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, (0, 1, 1, 2), True),  # CFAPattern: RGGB
        (33434, "2I", 1, _rational(exposure_s), True),  # ExposureTime
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50707, "B", 4, (1, 1, 0, 0), True),  # DNGBackwardVersion
        (50708, "s", 0, f"Irodori {model}", True),  # UniqueCameraModel
        (50714, "H", 1, black_level, True),  # BlackLevel
        (50717, "I", 1, white_level, True),  # WhiteLevel
        (50721, "2i", 9, tuple(matrix), True),  # ColorMatrix1
        (50728, "2I", 3, (1, 1) * 3, True),  # AsShotNeutral
        (50778, "H", 1, _ILLUMINANT_A, True),  # CalibrationIlluminant1
    ]
    if f_number:
        tags.append((33437, "2I", 1, _rational(f_number), True))  # FNumber
    if iso:
        tags.append((34855, "H", 1, round(iso), True))  # ISOSpeedRatings
    # In memory first: numpy writes to files on its own, and does not say that it was a full disk that stopped it.
    content = io.BytesIO()
    tifffile.imwrite(content, mosaic, photometric=_CFA_PHOTOMETRIC, extratags=tags, metadata=None, subfiletype=0)
    # The view is released before an error of the disk leaves here: where the error's frames still hold one, collecting
    # the buffer crashes Python 3.12, and 3.13 complains.
    with written_whole(path) as temporary, content.getbuffer() as written:
        temporary.write_bytes(written)
