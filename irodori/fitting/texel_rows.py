"""Rows of observations for compiled loops: those of one texel, or of eight texels side by side.

Loops process a row eight numbers at a time, called *lanes*. In the rows of one texel, these are eight of its
observations, and the row is padded with observations of weight 0. In the rows of eight texels, they are the same
observation of each texel. The same functions loop over both kinds of rows. They differ only in sums over observations,
where `folded` adds up the lanes for one texel and keeps them for eight. The type of an argument selects the kind: often
a parameter of the texel, otherwise ``zero``, is a number for the rows of one texel, and lanes for those of eight.
"""

import math

from numba import types
from numba.extending import overload

from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import lower_of, magnitude, select, upper_of
from irodori.jit.vector_memory import aligned, lane, load, mask_bits, spread, store
from irodori.jit.vectors import LANES
from irodori.reflection import lobes as lobe_kernels
from irodori.reflection.coat import passed
from irodori.reflection.fresnel import fresnel

#: Rows: cosθ_i; the gloss for a lobe of 1 (F times its factor); three features of the lobe; NaN where an angle is not
#: finite, else 0; response; weight; expected variance; weight times cosine, and times response; the gloss of the
#: last lobe for β = 1, and its slope along log μ; the weights at the last scan; the weights before outliers are left
#: out; the response for which the variance was computed.
(
    COSINE, GLOSS, F0, F1, F2, SPOILED, RESPONSE, WEIGHT, VARIANCE, WEIGHTED_COSINE, WEIGHTED_RESPONSE, LOBE,
    LOBE_SLOPE, BEFORE, TRUST, ASSUMED,
) = range(16)  # fmt: skip
ROWS = 16
_ANGLES = RESPONSE  # this row and the next three hold θ_i, θ_r, θ_H, φ until responses are loaded
_HALF_PI_HIGH, _HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17


@njit(cache=True, forceinline=True)
def vectors_of(rows):
    """Return the number of groups of eight numbers in a row."""
    return rows.shape[1] // LANES


@njit(cache=True, forceinline=True)
def get(rows, row, j):
    """Return the eight numbers of group j in a row."""
    return load(rows, row * rows.shape[1] + j * LANES)


@njit(cache=True, forceinline=True)
def put(rows, row, j, value):
    """Store the eight numbers of group j in a row."""
    store(rows, row * rows.shape[1] + j * LANES, value)


def _by_kind(about: str, names: str, number, lanes):
    """Make a function for compiled code with one implementation for one texel and another for eight.

    Parameters
    ----------
    about : str
        Docstring of the function.
    names : str
        Its arguments; the type of the last, a number or lanes, selects the implementation.
    number, lanes : callable
        Implementations for one texel and for eight.
    """
    namespace: dict = {"number": number, "lanes": lanes, "types": types}
    last = names.split(", ")[-1]
    exec(
        f"def made({names}):\n    raise NotImplementedError('in compiled code only')\n"
        f"def chosen({names}):\n    return number if isinstance({last}, (types.Number, types.Boolean)) else lanes\n",
        namespace,
    )
    made = namespace["made"]
    made.__doc__ = about
    overload(made, jit_options={"forceinline": True, "error_model": "numpy"})(namespace["chosen"])
    return made


@njit(cache=True, forceinline=True)
def _sum_of(x):
    return ((lane(x, 0) + lane(x, 4)) + (lane(x, 1) + lane(x, 5))) + (
        (lane(x, 2) + lane(x, 6)) + (lane(x, 3) + lane(x, 7))
    )


@njit(cache=True, forceinline=True)
def _highest_of(x):
    low = max(max(lane(x, 0), lane(x, 1)), max(lane(x, 2), lane(x, 3)))
    return max(low, max(max(lane(x, 4), lane(x, 5)), max(lane(x, 6), lane(x, 7))))


folded = _by_kind(
    "Return a sum of lanes over all observations of a texel.",
    "total, zero", lambda total, zero: _sum_of(total), lambda total, zero: total,
)  # fmt: skip
highest = _by_kind(
    "Return the largest of lanes over all observations of a texel.",
    "total, zero", lambda total, zero: _highest_of(total), lambda total, zero: total,
)  # fmt: skip
any_of = _by_kind(
    "Return whether something is true of any texel.", "mask", lambda mask: mask, lambda mask: mask_bits(mask) != 0
)
all_of = _by_kind(
    "Return whether something is true of all texels.", "mask", lambda mask: mask, lambda mask: mask_bits(mask) == 255
)
item = _by_kind(
    "Return one observation of a row, a texel's or one of each of eight.",
    "rows, row, j, zero", lambda rows, row, j, zero: rows[row, j], lambda rows, row, j, zero: get(rows, row, j),
)  # fmt: skip
noise_at = _by_kind(
    "Return a coefficient of the camera's noise for the observations at place j of a row; ``noise`` is (2, P).",
    "noise, i, j, zero",
    lambda noise, i, j, zero: load(noise, i * noise.shape[1] + j * LANES),
    lambda noise, i, j, zero: noise[i, j],
)


def _put_number(rows, row, j, value, zero):
    rows[row, j] = value


def _put_lanes(rows, row, j, value, zero):
    put(rows, row, j, value)


put_item = _by_kind(
    "Store one number of a row, or one for each of eight texels.", "rows, row, j, value, zero", _put_number, _put_lanes
)


@njit(cache=True, fastmath={"contract"}, forceinline=True)
def cosine_of(angle):
    """Return cos of an angle in rad, clipped to 0..π, to 1e-16; a number or lanes."""
    x = lower_of(upper_of(angle, 0.0), math.pi)  # NaN becomes 0
    y = (_HALF_PI_HIGH - x) + _HALF_PI_LOW
    s = y * y
    p = 1.0 / 51090942171709440000.0
    p = p * s - 1.0 / 121645100408832000.0
    p = p * s + 1.0 / 355687428096000.0
    p = p * s - 1.0 / 1307674368000.0
    p = p * s + 1.0 / 6227020800.0
    p = p * s - 1.0 / 39916800.0
    p = p * s + 1.0 / 362880.0
    p = p * s - 1.0 / 5040.0
    p = p * s + 1.0 / 120.0
    p = p * s - 1.0 / 6.0
    return y + y * s * p


@uncounted(error_model="numpy")
def _fill_geometry(rows, lobes, n, k, coupled):
    """Fill diffuse term, gloss, lobe features and the mark for non-finite angles from the angles.

    The refractive index n is a number or lanes.
    """
    for j in range(vectors_of(rows)):
        theta_i, theta_r = get(rows, _ANGLES, j), get(rows, _ANGLES + 1, j)
        theta_h, phi = get(rows, _ANGLES + 2, j), get(rows, _ANGLES + 3, j)
        put(rows, SPOILED, j, 0.0 * (theta_i + theta_r + (theta_h + phi)))
        phi = select(magnitude(phi) < math.pi, phi, math.pi)
        cos_i, cos_r, cos_h = cosine_of(theta_i), cosine_of(theta_r), cosine_of(theta_h)
        factor, f0, f1, f2 = lobe_kernels.features(lobes, cos_i, cos_r, cosine_of(phi), cos_h, phi)
        put(rows, GLOSS, j, fresnel(cos_h, n, k) * factor)
        put(rows, F0, j, f0)
        put(rows, F1, j, f1)
        put(rows, F2, j, f2)
        # 0 unless light and camera are above the horizon of the surface.
        lit = select((cos_i > 0.0) & (cos_r > 0.0), cos_i, 0.0)
        if coupled:
            lit = lit * passed(cos_i, n, k) * passed(cos_r, n, k)
        put(rows, COSINE, j, lit)


@uncounted(error_model="numpy")
def pack_geometry(geometry, lobes, n, k, coupled, rows):
    """Fill the rows of a texel that depend on its geometry; `SPOILED` is NaN if an angle is not finite, else 0.

    Parameters
    ----------
    geometry : (J, 4) float
        θ_i, θ_r, θ_H, φ in rad. For observations with an angle that is not finite, the other rows get meaningless but
        finite values.
    lobes : Lobes
        One lobe.
    n, k : float
        Complex refractive index.
    coupled : bool
        Whether the coat reduces the diffuse term, see `irodori.reflection.coat`.
    rows : (ROWS, P) float64
        P is J rounded up to a multiple of eight. Four rows from `RESPONSE` on are overwritten with the angles.
    """
    for i in range(4):
        for j in range(geometry.shape[0]):
            rows[_ANGLES + i, j] = geometry[j, i]
        for j in range(geometry.shape[0], rows.shape[1]):
            rows[_ANGLES + i, j] = 0.0
    _fill_geometry(rows, lobes, n, k, coupled)


@uncounted(error_model="numpy")
def pack_eight(problem, first, last, rows):
    """Fill the rows of eight texels that depend on their geometries; beyond the end, the last texel is repeated."""
    captures = problem.geometry.shape[1]
    for i in range(LANES):
        t = min(first + i, last - 1)
        for j in range(captures):
            for angle in range(4):
                rows[_ANGLES + angle, j * LANES + i] = problem.geometry[t, j, angle]
    _fill_geometry(rows, problem.lobes, spread(problem.n), problem.k, problem.coupled)


@uncounted()
def spread_geometry(common, rows):
    """Fill the geometry rows of eight texels with the geometry that all texels share."""
    for row in range(SPOILED + 1):
        for j in range(vectors_of(rows)):
            put(rows, row, j, spread(common[row, j]))


@uncounted(error_model="numpy")
def fill_lobe(rows, lobes, log_mu):
    """Fill the row `LOBE` with the gloss of every observation for β = 1."""
    constant = lobe_kernels.constants(lobes, log_mu)
    for j in range(vectors_of(rows)):
        value = lobe_kernels.value(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j))
        put(rows, LOBE, j, get(rows, GLOSS, j) * value)


@njit(cache=True)
def padded(observations: int) -> int:
    """Return the length of a row for one texel: the number of observations, rounded up to a multiple of eight."""
    return (observations + LANES - 1) // LANES * LANES


@njit(cache=True)
def new_rows(observations):
    """Allocate rows for one texel."""
    width = padded(observations)
    rows = aligned(ROWS * width).reshape((ROWS, width))
    for j in range(width):
        rows[BEFORE, j] = math.nan
    return rows


@njit(cache=True)
def new_rows_of_eight(observations):
    """Allocate rows for eight texels."""
    rows = aligned(ROWS * observations * LANES).reshape((ROWS, observations * LANES))
    for j in range(observations * LANES):
        rows[BEFORE, j] = math.nan
    return rows
