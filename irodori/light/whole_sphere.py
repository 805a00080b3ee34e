"""Test by its borders whether a picture that is twice as wide as high shows all directions.

Each pixel of the first row lies half a pixel from the zenith and is the neighbour of the one half a turn on; in the
last row, around the nadir, it is the same. The first column is the neighbour of the last. In a photograph cut to this
shape, none of this is so. But a lamp can end at the zenith, a tripod may be painted over, and the edge of a door may
run along the first column. A picture is therefore refused only for a border that jumps as nothing in a room does, or
for two. A part of a room whose borders look alike is not recognised.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from irodori.core.errors import InputError
from irodori.light.omnidirectional import bands

#: A jump between two neighbours: least difference as a share of the brighter one, which stitching stays below, and
#: relative to the mean difference between other neighbours near them, of which there are so many on either side. Noise
#: differs everywhere alike.
_SHARE, _TIMES, _NEAR = 0.15, 3.0, 4
#: Brightness below this share of the mean is black, as where a panorama was painted over.
_BLACK = 1e-3
#: Share of the neighbours across a border that must jump: of one border alone, of a pole together with a seam.
_ALONE, _POLE = 0.5, 0.3
#: Share of the rows in which two columns differ from pole to pole; the edges of no wall are as long.
_POLE_TO_POLE = 0.95
#: Most ends of bright parts along the first row: four squares of a ceiling that meet at the zenith have so many.
_MOST_ENDS = 4
#: The least of the seam together with the zenith; with the nadir, where a tripod may be painted over carelessly.
_SEAM, _SEAM_AND_NADIR = 0.15, 0.3
#: Least height that is judged, rows; in smaller pictures, neighbours lie too far apart to be alike.
_LEAST_ROWS = 32
#: Two fisheye pictures beside each other: share of the radius within and beyond which is looked, largest share of
#: pixels with light outside, and smallest inside.
_INSIDE, _OUTSIDE, _LIT_OUTSIDE, _LIT_INSIDE = 0.9, 1.03, 0.005, 0.5
_ACCEPTED = "an equirectangular panorama of all directions"


def whole_sphere(parts: Iterable[np.ndarray], size: tuple[int, int], path) -> Iterator[np.ndarray]:
    """Yield the bands of a panorama, and raise an error after the last if it cannot show all directions.

    Parameters
    ----------
    parts : iterable of (rows, width, n) float
        As seen from inside, from the zenith down.
    size : (height, width)
    path : path
        File that the message names.

    Raises
    ------
    InputError
    """
    brightness, row = np.empty(size, np.float32), 0
    for part in parts:
        brightness[row : row + len(part)] = np.maximum(part, 0.0).sum(axis=-1)
        row += len(part)
        yield part
    found = contradiction(brightness) if size[0] >= _LEAST_ROWS else ""
    if found:
        raise InputError(path, "", found, _ACCEPTED)


def contradiction(brightness: np.ndarray) -> str:
    """Return what contradicts that a picture shows all directions; empty if nothing does.

    Parameters
    ----------
    brightness : (height, width) float, at least 0
        As seen from inside, zenith at the top.
    """
    black = _BLACK * float(brightness.mean())
    if _two_discs(brightness, black):
        return "light in two discs beside each other, as two fisheye pictures have, and none around them"
    zenith, nadir = _across_pole(brightness, black), _across_pole(brightness[::-1], black)
    seam = _across_seam(brightness, black)
    if zenith > _ALONE and _ends(brightness[0]) > _MOST_ENDS:
        return f"jumps across the zenith in {100 * zenith:.0f} % of the first row, which should see one point"
    if seam > _ALONE:
        return f"a first column that does not join the last in {100 * seam:.0f} % of the rows"
    for pole, share, least in (("first", zenith, _SEAM), ("last", nadir, _SEAM_AND_NADIR)):
        if share > _POLE and seam > least:
            return (
                f"jumps across the pole in {100 * share:.0f} % of the {pole} row, which should see one point, and a "
                f"first column that does not join the last in {100 * seam:.0f} % of the rows"
            )
    return ""


def _across_pole(brightness: np.ndarray, black: float) -> float:
    """Return the share of the first row that jumps to the pixel half a turn on."""
    half, rows = brightness.shape[1] // 2, brightness[: _NEAR + 1]
    meridians = np.concatenate([rows[::-1, :half], rows[:, half : 2 * half]])
    return float(_jumps(meridians.T, black).mean())


def _across_seam(brightness: np.ndarray, black: float) -> float:
    """Return the share of the rows that jump from the last column to the first.

    It is 0 if another pair of columns jumps from pole to pole: in a drawn sky of two halves, the seam may do so, too.
    """
    jumping = np.zeros(brightness.shape[1], int)
    for rows in bands(len(brightness)):
        circle = np.pad(brightness[rows], ((0, 0), (_NEAR, _NEAR + 1)), mode="wrap")
        jumping += _jumps(circle, black).sum(axis=0)
    shares = jumping / len(brightness)
    return 0.0 if shares[:-1].max() > _POLE_TO_POLE else float(shares[-1])


def _jumps(lines: np.ndarray, black: float) -> np.ndarray:
    """Return between which neighbours lines, (lines, n), jump, (lines, n - 9) bool; the outer four are not judged."""
    step, brighter = np.abs(np.diff(lines, axis=1)), np.maximum(lines[:, :-1], lines[:, 1:])[:, _NEAR:-_NEAR]
    windows = np.lib.stride_tricks.sliding_window_view(step, 2 * _NEAR + 1, axis=1)
    step = step[:, _NEAR:-_NEAR]
    near = (windows.sum(axis=-1) - step) / (2 * _NEAR)
    return (step > _SHARE * brighter) & (step > _TIMES * near) & (brighter > black)


def _ends(row: np.ndarray) -> int:
    """Count where a row, seen as a circle, crosses the middle between its smallest and largest value."""
    above = row > 0.5 * (row.min() + row.max())
    return int((above != np.roll(above, 1)).sum())


def _two_discs(brightness: np.ndarray, black: float) -> bool:
    """Return whether a picture has light only in two discs side by side."""
    height, width = brightness.shape
    radius = 0.25 * width
    across = (np.arange(width) + 0.5) % (0.5 * width) - radius
    outside, inside = np.zeros(2), np.zeros(2)  # pixels with light, and all
    for rows in bands(height):
        down = np.arange(rows.start, rows.stop)[:, None] + 0.5 - 0.5 * height
        distance, lit = np.hypot(across, down) / radius, brightness[rows] > black
        outside += lit[distance > _OUTSIDE].sum(), (distance > _OUTSIDE).sum()
        inside += lit[distance < _INSIDE].sum(), (distance < _INSIDE).sum()
    return bool(outside[0] < _LIT_OUTSIDE * outside[1] and inside[0] > _LIT_INSIDE * inside[1])
