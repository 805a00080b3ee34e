"""Statements in the header of a Radiance HDR picture that OpenImageIO leaves out: exposure and primaries.

The format is described in Ward, *Radiance File Formats* (1991; "Picture File Format"): lines ``VARIABLE=value`` up to
an empty line. Lines that begin with a space are those of the pictures from which this one was made, and do not count.
"""

from pathlib import Path
from typing import NamedTuple

from irodori.core.errors import InputError
from irodori.spectra.tables import number

#: Longest header that is read, in bytes; it lists the commands that made the picture.
_LONGEST_BYTES = 1 << 20
#: Accepted exposures; beyond them, single precision cannot represent the light.
_EXPOSURES = (1e-30, 1e30)
_COUNTS = {"EXPOSURE": 1, "COLORCORR": 3, "PRIMARIES": 8}


class RadianceHeader(NamedTuple):
    """Exposure and primaries of a Radiance HDR picture.

    Parameters
    ----------
    exposure : (red, green, blue)
        Factors by which the radiance of each channel has been multiplied.
    primaries : tuple of 8 float, optional
        Chromaticities x, y of red, green, blue and white, if the file states them.
    """

    exposure: tuple[float, float, float]
    primaries: tuple[float, ...] | None


def radiance_header(path) -> RadianceHeader:
    """Read the header of a Radiance HDR picture.

    Several lines of ``EXPOSURE`` or ``COLORCORR`` multiply; of several lines of ``PRIMARIES`` the last holds.

    Raises
    ------
    InputError
        If one of these lines does not have the right count of finite numbers, or the light was multiplied by a factor
        outside 1e-30 to 1e30.
    """
    exposure, primaries = [1.0, 1.0, 1.0], None
    with Path(path).open("rb") as file:
        lines = file.read(_LONGEST_BYTES).split(b"\n")
    for line in lines:
        if not line.strip():
            break
        name, _, text = line.decode("latin-1").partition("=")
        if name not in _COUNTS:
            continue
        values = _numbers(text, _COUNTS[name], path, name)
        if name == "PRIMARIES":
            primaries = tuple(values)
        else:
            exposure = [old * new for old, new in zip(exposure, values if len(values) > 1 else values * 3, strict=True)]
            if not all(_EXPOSURES[0] <= factor <= _EXPOSURES[1] for factor in exposure):
                accepted = f"a positive factor; all together from {_EXPOSURES[0]:g} to {_EXPOSURES[1]:g}"
                raise InputError(path, name, text.strip(), accepted)
    return RadianceHeader((exposure[0], exposure[1], exposure[2]), primaries)


def _numbers(text: str, count: int, path, name: str) -> list[float]:
    """Return the numbers in a line of the header; raise an error for another count of them."""
    words = text.split()
    if len(words) != count:
        raise InputError(path, name, f"{len(words)} numbers", f"{count} numbers" if count > 1 else "one number")
    return [number(word, path, name) for word in words]
