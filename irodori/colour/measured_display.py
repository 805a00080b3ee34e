"""Display model from a colorimeter's measurements of patches with known code values.

Two formats are read: a CSV table with the columns red, green, blue (code values from 0 to 1), X, Y, Z (any one unit),
and the .ti3 file of Argyll's ``dispread`` (RGB_R, RGB_G, RGB_B from 0 to 100, XYZ_X, XYZ_Y, XYZ_Z). The patches must
include black and a ramp of each channel alone, up to its full value. If they include white, it is compared with the sum
of the channels; other patches are not used.
"""

from pathlib import Path

import numpy as np

from irodori.colour.tone_curves import SampledCurve
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.spectra.cgats import named_columns
from irodori.spectra.tables import csv_rows, number_rows

_COLUMNS = ["red", "green", "blue", "X", "Y", "Z"]
_ARGYLL = ["RGB_R", "RGB_G", "RGB_B", "XYZ_X", "XYZ_Y", "XYZ_Z"]
_CHANNELS = ("red", "green", "blue")
_CODES = 4096
#: Above any display in any unit, and small enough that squares and sums of doubles do not overflow.
_BRIGHTEST = 1e9
#: Largest exponent of a display's curve.
_STEEPEST = 20.0
#: Fewest levels of a channel, black and full value included, that determine its curve.
_LEAST_LEVELS = 5
#: Largest accepted difference in XYZ between the sum of the channels and the measured white, as a share of white's Y.
_MAX_NON_ADDITIVITY = 0.05


def measured_display(path) -> tuple[np.ndarray, tuple[SampledCurve, ...], np.ndarray]:
    """Read the measurements of a display and return its matrix, tone curves and black.

    Parameters
    ----------
    path : path

    Returns
    -------
    xyz_from_rgb : (3, 3) float64
        XYZ above black, from linear RGB; white, black included, has Y = 1.
    curves : three SampledCurve
        Curves of red, green and blue, interpolated between the measured levels. The interpolation is linear in a power
        of the code value, with the median exponent of the ramp.
    black_xyz : (3,) float64
        XYZ of black, on the same scale.

    Raises
    ------
    InputError
        If the file has neither format, black or a channel's full value is missing, a channel has fewer than five levels
        or gets darker as its code grows, the channels do not have their colours, or their sum differs from the measured
        white by more than 5 %.
    """
    code, xyz = _read(path)
    dark = (code == 0.0).all(axis=1)
    if not dark.any():
        raise InputError(path, "", "no patch of code 0, 0, 0", "black among the patches")
    black = xyz[dark].mean(axis=0)
    above = xyz - black
    primaries, curves = [], []
    for channel, name in enumerate(_CHANNELS):
        alone = (np.delete(code, channel, axis=1) == 0.0).all(axis=1)
        level = code[alone, channel]
        if level.max(initial=0.0) != 1.0 or len(np.unique(level)) < _LEAST_LEVELS:
            found = f"{len(np.unique(level))} levels of {name} alone, up to {level.max(initial=0.0):g}"
            raise InputError(path, name, found, f"{_LEAST_LEVELS} levels or more from 0 to 1, the others at 0")
        primary = above[alone][level == 1.0].mean(axis=0)
        if not (primary > 0.0).any():
            raise InputError(path, name, "no light at the full value", "light that grows from black")
        amount = above[alone] @ primary / (primary @ primary)
        primaries.append(primary)
        curves.append(_curve(level, amount, path, name))
    matrix = np.column_stack(primaries)
    _check_sum(code, above, matrix, path)
    white = matrix.sum(axis=1)[1] + black[1]
    if abs(np.linalg.det(matrix / white)) < 1e-6:
        raise InputError(path, "X", "primaries that lie on one line", "three primaries of different colours")
    _check_colours(matrix, path)
    return matrix / white, tuple(curves), black / white


def _check_colours(matrix: np.ndarray, path) -> None:
    """Refuse primaries of which red has not the largest x, green the largest y, and blue the largest z.

    This is so on every display; exchanged columns of code values or of X, Y and Z make it false.
    """
    if not (matrix.sum(axis=0) > 0.0).all():
        raise InputError(path, "X, Y, Z", "a channel whose light is not positive", "light that grows from black")
    xyz = matrix / matrix.sum(axis=0)
    for axis, name in enumerate(_CHANNELS):
        other = int(xyz[axis].argmax())
        if other != axis:
            found = f"a larger {'xyz'[axis]} of {_CHANNELS[other]}, {xyz[axis, other]:.3f}, than {xyz[axis, axis]:.3f}"
            accepted = "red with the largest x, green with the largest y, blue with the largest z (columns exchanged?)"
            raise InputError(path, name, found, accepted)


def _read(path) -> tuple[np.ndarray, np.ndarray]:
    """Return the code values, 0..1, and the XYZ of the n patches, (n, 3) each."""
    if Path(path).suffix.lower() == ".ti3":
        rows = np.array(named_columns(path, _ARGYLL))
        code = rows[:, :3] / 100.0
    else:
        table = csv_rows(path)
        header = [cell.strip() for cell in table[0][1]]
        if header != _COLUMNS:
            raise InputError(path, "line 1", ", ".join(header), f"the columns {', '.join(_COLUMNS)}")
        rows = np.array(number_rows(table, path))
        code = rows[:, :3]
    if (code < 0.0).any() or (code > 1.0 + 1e-9).any():
        raise InputError(path, "red, green, blue", f"code values from {code.min():g} to {code.max():g}", "0 to 1")
    if not (np.abs(rows[:, 3:]) < _BRIGHTEST).all():
        found = f"values up to {np.abs(rows[:, 3:]).max():g}"
        raise InputError(path, "X, Y, Z", found, f"light below {_BRIGHTEST:g} in the unit of the table")
    return code, rows[:, 3:]


def _curve(level: np.ndarray, amount: np.ndarray, path, name: str) -> SampledCurve:
    levels, inverse = np.unique(level, return_inverse=True)
    mean = np.bincount(inverse, amount) / np.bincount(inverse)
    if (np.diff(mean) < 0.0).any():
        at = levels[1:][np.diff(mean) < 0.0][0]
        raise InputError(path, f"{name} = {at:g}", "less light than at the level before", "light that grows")
    # Between levels the curve is a power rather than a line: interpolated along the code's power it is nearly straight.
    inner = (levels > 0.0) & (levels < 1.0) & (mean > 0.0)
    power = float(np.median(np.log(mean[inner]) / np.log(levels[inner]))) if inner.any() else 1.0
    codes = np.linspace(0.0, 1.0, _CODES)
    if not (0.0 < power < _STEEPEST and mean[-1] > mean[0]):
        raise InputError(path, name, "light that does not grow as a display's does", "light that grows from black")
    return SampledCurve(np.interp(codes**power, levels**power, mean - mean[0]))


def _check_sum(code: np.ndarray, above: np.ndarray, matrix: np.ndarray, path) -> None:
    full = (code == 1.0).all(axis=1)
    if not full.any():
        LOGGER.warning("%s: no patch of code 1, 1, 1; white is taken as the sum of the channels", path)
        return
    white, total = above[full].mean(axis=0), matrix.sum(axis=1)
    off = float(np.abs(total - white).max() / white[1])
    LOGGER.info("%s: the channels add up to the measured white within %.2f %%", path, 100 * off)
    if off > _MAX_NON_ADDITIVITY:
        found = f"channels whose sum is {100 * off:.1f} % off the measured white"
        accepted = f"a display whose channels add up within {100 * _MAX_NON_ADDITIVITY:g} %"
        raise InputError(path, "white", found, accepted)
