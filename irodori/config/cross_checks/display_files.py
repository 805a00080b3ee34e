"""Checks of a scene's display: its files exist, and its primaries enclose its white."""

from pathlib import Path

from irodori.config.models import DisplayDevice, MeasuredDisplay, PrimariesDisplay, StandardDisplay
from irodori.core.errors import InputError, is_file

_MEASURED = (".csv", ".ti3")


def check_display(device: DisplayDevice, root: Path, file) -> None:
    """Refuse a display with a missing file, or with a white outside the triangle of its primaries.

    Parameters
    ----------
    device : DisplayDevice
    root : path
        Folder at which relative paths start.
    file : path
        File of the scene's definition, for the error message.

    Raises
    ------
    InputError
    """
    field = "display.device"
    if isinstance(device, PrimariesDisplay):
        corners = [device.red_xy, device.green_xy, device.blue_xy]
        sides = [_side(device.white_xy, a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
        if not (min(sides) > 0.0 or max(sides) < 0.0):
            found = f"{list(device.white_xy)}, which the primaries do not enclose"
            raise InputError(file, f"{field}.white_xy", found, "a white within the triangle of red, green and blue")
    if isinstance(device, PrimariesDisplay | StandardDisplay):
        return
    measured = isinstance(device, MeasuredDisplay)
    if not is_file(root / device.file):
        wanted = "a table of measured patches" if measured else "the ICC profile of a display"
        raise InputError(file, f"{field}.file", f"no such file: {device.file}", wanted)
    if measured and not device.file.lower().endswith(_MEASURED):
        accepted = f"a name that ends in {' or '.join(_MEASURED)}"
        raise InputError(file, f"{field}.file", device.file, accepted)


def _side(point, a, b) -> float:
    """Return a number whose sign tells on which side of the line from a to b a point lies."""
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])
