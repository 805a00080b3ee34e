"""Environment light of the path tracer: radiance and exact importance sampling.

Radiance is interpolated between pixels, so that nearly half the light of a sun of one pixel lies outside that pixel,
where sampling within whole pixels would never find it. Here, a pixel is sampled by its power, then a point with the
density of the interpolation's tent function.

The mean radiance is subtracted before sampling (MIS compensation, Karlík et al. 2019): directions sampled from the
surface's reflection are better for the uniform part of the light, and are the only ones if the light is constant.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import uncounted
from irodori.jit.functions import circle_point
from irodori.light.environment_file import Environment, directions
from irodori.light.equirectangular import direction_uv
from irodori.rendering.reference.band_loops import padded

_TWO_PI_SQUARED = 2.0 * math.pi**2
#: Share of the light's power below which the part above the mean is considered rounding error.
_EVEN = 1e-5
#: The brightest pixels are suns if, with a share f of the light from a solid angle Ω, π f² / Ω is at least this. It is
#: the variance of their light in a mirror, relative to the square of all light, if directions are drawn by the cosine.
_WORTH = 100.0
_MOST_SUNS = 4096
#: Entries of cumulative probability for each guide to them. Eight share a cache line, and the guides stay in the cache.
_PER_GUIDE = 8


class Sky(NamedTuple):
    """Environment for path tracing; the last column of ``pixels`` is the sampling density times sine of zenith angle.

    ``power`` is the power of the part of the light that is sampled, summed over wavelengths and the sphere; with 0,
    nothing is sampled. ``suns`` are the pixels of small bright lights, see `_WORTH`; often there are none.
    """

    pixels: np.ndarray  # (height * width, k + 1) float32
    width: int
    height: int
    basis: np.ndarray  # (1, k, 64) float32
    rows: np.ndarray  # (1, height + 1) from 0 to 1
    columns: np.ndarray  # (height, width + 1), each row from 0 to 1
    row_guides: np.ndarray  # (1, height / _PER_GUIDE + 1) int32, see `_guides`
    column_guides: np.ndarray  # (height, width / _PER_GUIDE + 1) int32
    power: float
    whole: float  # power of all light
    suns: np.ndarray  # (suns, 3) row, column and probability
    least: float  # of the last column of ``pixels`` from which on a pixel is a sun
    even: bool  # whether all pixels are the same


def make_sky(environment: Environment) -> Sky:
    """Prepare an environment for the path tracer; pixels with a negative sum over wavelengths are not sampled.

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
    suns, least = _suns(pixels[..., bases], solid_angle, excess / total if excess > 0.0 else 0.0)
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
        total,
        suns,
        least,
        bool((environment.coefficients == environment.coefficients[:1, :1]).all()),
    )


def _suns(density: np.ndarray, solid_angle: np.ndarray, drawn: float) -> tuple[np.ndarray, float]:
    """Return `Sky.suns` and `Sky.least` for the last column of its pixels, (h, w), and the share of light in it."""
    flat = density.ravel()
    brightest = np.flatnonzero(flat > 0.0)
    if not brightest.size:
        return np.zeros((0, 3)), np.inf
    if brightest.size > _MOST_SUNS:
        brightest = brightest[np.argpartition(flat[brightest], -_MOST_SUNS)[-_MOST_SUNS:]]
    brightest = brightest[np.argsort(-flat[brightest], kind="stable")]
    probability = flat[brightest].astype(np.float64) * (_TWO_PI_SQUARED / flat.size)
    angle = np.broadcast_to(solid_angle, density.shape).ravel()[brightest].cumsum()
    worth = np.pi * (drawn * probability.cumsum()) ** 2 / angle
    count = int(np.argmax(worth)) + 1
    if not worth[count - 1] >= _WORTH:
        return np.zeros((0, 3)), np.inf
    least = float(flat[brightest[count - 1]])
    count = int((flat[brightest] >= least).sum())  # with those that are as bright as the last
    row, column = np.divmod(brightest[:count], density.shape[1])
    return np.stack([row, column, probability[:count]], axis=1), least


def _cumulative(power: np.ndarray, solid_angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cumulative probabilities of the rows (h + 1,), and of the pixels in each row (h, w + 1), from 0 to 1."""
    largest = power.max()
    scaled = power / largest if largest > 0.0 else np.ones_like(power)
    columns = np.concatenate([np.zeros((len(power), 1)), np.cumsum(scaled, axis=1)], axis=1)
    rows = np.concatenate([[0.0], np.cumsum(columns[:, -1] * solid_angle[:, 0])])
    # A black row is never chosen; its pixels get equal probabilities to avoid a division by 0.
    columns[columns[:, -1] <= 0.0] = np.arange(power.shape[1] + 1)
    return rows / rows[-1], columns / columns[:, -1:]


def _guides(cumulative: np.ndarray) -> np.ndarray:
    """Return start indices for the search in each row: the entry containing i / n for i from 0 to n, (rows, n + 1).

    There is one for `_PER_GUIDE` entries.
    """
    rows, count = cumulative.shape[0], cumulative.shape[1] - 1
    number = -(-count // _PER_GUIDE)
    even = np.arange(number + 1) / number
    found = np.empty((rows, number + 1), dtype=np.int32)
    for row in range(rows):
        found[row] = np.searchsorted(cumulative[row], even, side="right") - 1
    return np.clip(found, 0, count - 1)


@uncounted(forceinline=True)
def _entry(cumulative, guides, row, u):
    """Return the entry of a row whose interval of cumulative probability contains u, never one of probability 0."""
    part = int(u * (guides.shape[1] - 1))
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
    """Transform a uniform number in [0, 1) to one from -1 to 1 with the tent density 1 - |x|."""
    return math.sqrt(2.0 * r) - 1.0 if r < 0.5 else 1.0 - math.sqrt(2.0 * (1.0 - r))


@uncounted(forceinline=True)
def sample_sky(sky, u, v, direction, coefficients):
    """Sample a direction and fill the coefficients of its radiance; return the density in 1/sr, 0 for an invalid one.

    Parameters
    ----------
    sky : Sky
        Sky with ``power`` above 0.
    u, v : float
        Uniform random numbers in [0, 1).
    direction : (3,) float
    coefficients : (k + 1,) float
    """
    row = _entry(sky.rows, sky.row_guides, 0, v)
    start = sky.rows[0, row]
    v = (v - start) / (sky.rows[0, row + 1] - start)
    column = _entry(sky.columns, sky.column_guides, row, u)
    start = sky.columns[row, column]
    u = (u - start) / (sky.columns[row, column + 1] - start)
    u, v, sine = place_in_pixel(sky, row, column, u, v, direction)
    return _look(sky, u, v, sine, coefficients)


@uncounted(forceinline=True)
def place_in_pixel(sky, row, column, u, v, direction):
    """Sample a direction by the weight with which a pixel is interpolated there.

    Returns its place u, v in the picture, and the sine of its zenith angle.
    """
    # The outer half of a polar row is not interpolated: its tent is flat there.
    flat = (row == 0 and v < 0.5) or (row == sky.height - 1 and v >= 0.5)
    at = v if flat else 0.5 + _under_tent(v)
    v = (row + at) / sky.height
    u = (column + 0.5 + _under_tent(u)) / sky.width
    u -= math.floor(u)
    (upwards, sine), (east, north) = circle_point(0.5 * v), circle_point(u)
    direction[0], direction[1], direction[2] = sine * east, sine * north, upwards
    return u, v, sine


@uncounted(forceinline=True)
def _look(sky, u, v, sine, coefficients):
    """Fill the coefficients interpolated at a point and return the density, 1/sr; columns wrap around, rows end."""
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
    """Fill the coefficients of the radiance from a direction; return the density of sampling it, 1/sr."""
    if sky.even:
        for i in range(coefficients.size):
            coefficients[i] = sky.pixels[0, i]
        return 0.0
    u, v = direction_uv(direction[0], direction[1], direction[2])
    sine = math.sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    return _look(sky, u, v, sine, coefficients)
