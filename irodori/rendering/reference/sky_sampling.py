"""Environment light of the path tracer: radiance and exact importance sampling.

Radiance between pixels is interpolated, and nearly half the light of a sun of one pixel lies outside of that pixel,
where directions drawn from whole pixels never are. Here a pixel is drawn by its power, then a place under its tent.

The mean of the light is left out of what is drawn (Karlík et al. 2019, MIS compensation): directions drawn from the
surface's own reflection serve the even part better, and serve it alone where the light is constant.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import uncounted
from irodori.light.environment_file import Environment, directions
from irodori.light.equirectangular import direction_uv
from irodori.rendering.reference.band_loops import padded

_TWO_PI_SQUARED = 2.0 * math.pi**2
#: Share of the light's power under which what exceeds the mean is rounding.
_EVEN = 1e-5


class Sky(NamedTuple):
    """An environment; the last column of ``pixels`` is the density of drawn places, times the sine of the zenith angle.

    ``power`` is what is drawn from, summed over wavelengths and the sphere: 0 where nothing is to be drawn.
    """

    pixels: np.ndarray  # (height * width, k + 1) float32
    width: int
    height: int
    basis: np.ndarray  # (1, k, 64) float32
    rows: np.ndarray  # (1, height + 1) from 0 to 1
    columns: np.ndarray  # (height, width + 1), each row from 0 to 1
    row_guides: np.ndarray  # (1, height + 1) int32, see `_guides`
    column_guides: np.ndarray  # (height, width + 1) int32
    power: float


def make_sky(environment: Environment) -> Sky:
    """Return an environment as the path tracer wants it; what is negative summed over the wavelengths is not drawn.

    Raises
    ------
    ValueError
        If its radiance is not finite.
    """
    height, width, bases = environment.coefficients.shape
    power = np.maximum(environment.coefficients @ environment.basis.sum(axis=0).astype(np.float64), 0.0)
    solid_angle = directions(width, height)[1]
    total = float((power * solid_angle).sum())
    if not math.isfinite(total):
        raise ValueError("a radiance that is not finite; accepted: finite numbers")
    drawn = np.maximum(power - total / (4.0 * np.pi), 0.0)
    excess = float((drawn * solid_angle).sum())
    if excess <= _EVEN * total:
        drawn, excess = np.zeros_like(drawn), 0.0
    rows, columns = _cumulative(drawn, solid_angle)
    pixels = np.empty((height, width, bases + 1), dtype=np.float32)
    pixels[..., :bases] = environment.coefficients
    pixels[..., bases] = np.diff(rows)[:, None] * np.diff(columns, axis=1)
    pixels[..., bases] *= width * height / _TWO_PI_SQUARED if excess > 0.0 else 0.0
    return Sky(
        pixels.reshape(height * width, bases + 1),
        width,
        height,
        padded(environment.basis.T[None]),
        rows[None],
        columns,
        _guides(rows[None]),
        _guides(columns),
        excess,
    )


def _cumulative(power: np.ndarray, solid_angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cumulative probabilities of the rows (h + 1,), and of the pixels along each (h, w + 1), from 0 to 1."""
    largest = power.max()
    scaled = power / largest if largest > 0.0 else np.ones_like(power)
    columns = np.concatenate([np.zeros((len(power), 1)), np.cumsum(scaled, axis=1)], axis=1)
    rows = np.concatenate([[0.0], np.cumsum(columns[:, -1] * solid_angle[:, 0])])
    # A black row is never entered; its own probabilities are even so that nothing is divided by 0.
    columns[columns[:, -1] <= 0.0] = np.arange(power.shape[1] + 1)
    return rows / rows[-1], columns / columns[:, -1:]


def _guides(cumulative: np.ndarray) -> np.ndarray:
    """Return where the search in each row (n + 1,) may begin: the entry that holds i / n, for i from 0 to n."""
    rows, count = cumulative.shape[0], cumulative.shape[1] - 1
    even = np.arange(count + 1) / count
    found = np.empty((rows, count + 1), dtype=np.int32)
    for row in range(rows):
        found[row] = np.searchsorted(cumulative[row], even, side="right") - 1
    return np.clip(found, 0, count - 1)


@uncounted(forceinline=True)
def _entry(cumulative, guides, row, u):
    """Return the entry of a row whose share of 0..1 holds u, never one without a share."""
    count = cumulative.shape[1] - 1
    part = int(u * count)
    low, high = guides[row, part], guides[row, part + 1] + 1
    while high - low > 1:
        middle = (low + high) // 2
        if cumulative[row, middle] <= u:
            low = middle
        else:
            high = middle
    return low


@uncounted(forceinline=True)
def _under_tent(r):
    """Return a place from -1 to 1 with a density that falls from 1 at 0 to 0 at both ends."""
    return math.sqrt(2.0 * r) - 1.0 if r < 0.5 else 1.0 - math.sqrt(2.0 * (1.0 - r))


@uncounted(forceinline=True)
def sample_sky(sky, u, v, direction, coefficients):
    """Fill a drawn direction and the coefficients of its radiance; return the density in 1/sr, 0 for a useless one.

    Parameters
    ----------
    sky : Sky
        Of ``power`` above 0.
    u, v : float
        Even in [0, 1).
    direction : (3,) float
    coefficients : (k + 1,) float
    """
    row = _entry(sky.rows, sky.row_guides, 0, v)
    start = sky.rows[0, row]
    v = (v - start) / (sky.rows[0, row + 1] - start)
    column = _entry(sky.columns, sky.column_guides, row, u)
    start = sky.columns[row, column]
    u = (u - start) / (sky.columns[row, column + 1] - start)
    # The outer half of a polar row is not interpolated: its tent is flat there.
    flat = (row == 0 and v < 0.5) or (row == sky.height - 1 and v >= 0.5)
    at = v if flat else 0.5 + _under_tent(v)
    v = (row + at) / sky.height
    u = (column + 0.5 + _under_tent(u)) / sky.width
    u -= math.floor(u)
    sine = math.sin(math.pi * v)
    azimuth = 2.0 * math.pi * u
    direction[0], direction[1], direction[2] = sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(math.pi * v)
    return _look(sky, u, v, sine, coefficients)


@uncounted(forceinline=True)
def _look(sky, u, v, sine, coefficients):
    """Fill the interpolated coefficients of the pixels about a place; columns wrap, rows end."""
    x, y = u * sky.width - 0.5, min(max(v * sky.height - 0.5, 0.0), sky.height - 1.0)
    left, above = math.floor(x), int(y)
    fx, fy = x - left, y - above
    right, below = left + 1, min(above + 1, sky.height - 1)
    left = left + sky.width if left < 0 else left
    right = right - sky.width if right >= sky.width else right
    a, b = above * sky.width + left, above * sky.width + right
    c, d = below * sky.width + left, below * sky.width + right
    wa, wb, wc, wd = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    pixels = sky.pixels
    for i in range(coefficients.size):
        coefficients[i] = wa * pixels[a, i] + wb * pixels[b, i] + wc * pixels[c, i] + wd * pixels[d, i]
    return coefficients[coefficients.size - 1] / sine if sine > 1e-12 else 0.0


@uncounted(forceinline=True)
def look_at_sky(sky, direction, coefficients):
    """Fill the coefficients of the radiance from a direction; return the density with which it is drawn, 1/sr."""
    u, v = direction_uv(direction[0], direction[1], direction[2])
    sine = math.sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    return _look(sky, u, v, sine, coefficients)
