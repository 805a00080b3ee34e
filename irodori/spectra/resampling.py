"""Resampling of measured spectra to the grid.

Errors of the interpolation methods: mean / maximum CIEDE2000 under D65 (and mean spectral RMSE) of sets of measured
reflectances that were reduced to steps of 10 and 20 nm, against the same sets on the grid:

| set, step | 10 nm, Sprague | 10 nm, linear | 20 nm, Sprague | 20 nm, linear |
|---|---|---|---|---|
| Munsell, 5 nm | 0.035 / 0.37 (0.0007) | 0.062 / 0.36 (0.0013) | 0.110 / 1.05 (0.0027) | 0.260 / 0.95 (0.0046) |
| Vrhel, 2 nm | 0.030 / 0.28 (0.0006) | 0.056 / 0.30 (0.0012) | 0.082 / 0.83 (0.0022) | 0.224 / 0.80 (0.0034) |
| ColorChecker, 4 nm | 0.076 / 0.36 (0.0010) | 0.092 / 0.28 (0.0013) | 0.130 / 0.62 (0.0018) | 0.279 / 0.54 (0.0034) |

Reflectances measured in finer steps than the grid are interpolated: on the ColorChecker, averaging them over 5 nm has
an error of 0.044 and interpolation one of 0.016, against full resolution. Lights are averaged: for lamp lines of 2 nm
width, sampled every nanometre, the mean error is 2.5 with the values at the grid's wavelengths and 0.08 with averages.
"""

from functools import lru_cache

import numpy as np

from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.spectra.grid import SAMPLES, STEP_NM, WAVELENGTH_NM
from irodori.spectra.tables import MAX_GAP_NM, check_wavelengths

METHODS = ("auto", "average", "linear", "sprague")
#: Largest difference of steps that still counts as uniform, nm: wavelengths are written with a few decimals.
_UNIFORM_NM = 1e-3
#: Sprague's fifth-order polynomial takes three neighbours on either side.
_MIN_SPRAGUE = 6
#: Coefficients of the polynomial, from the two values before, the value at its beginning, and the three after it.
_SPRAGUE = np.array(
    [
        [0.0, 0.0, 24.0, 0.0, 0.0, 0.0],
        [2.0, -16.0, 0.0, 16.0, -2.0, 0.0],
        [-1.0, 16.0, -30.0, 16.0, -1.0, 0.0],
        [-9.0, 39.0, -70.0, 66.0, -33.0, 7.0],
        [13.0, -64.0, 126.0, -124.0, 61.0, -12.0],
        [-5.0, 25.0, -50.0, 50.0, -25.0, 5.0],
    ]
) / 24.0  # fmt: skip
#: The two values that are added before the first, from the first six; those after the last are their mirror image.
_SPRAGUE_ENDS = (
    np.array([[884.0, -1960.0, 3033.0, -2648.0, 1080.0, -180.0], [508.0, -540.0, 488.0, -367.0, 144.0, -24.0]]) / 209.0
)


def resample(
    wavelength_nm: np.ndarray,
    values: np.ndarray,
    file,
    max_gap_nm: float = MAX_GAP_NM,
    method: str = "linear",
) -> np.ndarray:
    """Resample spectra to the grid, without extrapolation; values beyond 400..700 nm are dropped.

    Parameters
    ----------
    wavelength_nm : (n,) float, strictly increasing, nm
    values : (..., n) float
    file : origin of the spectra, for the error message
    max_gap_nm : float
        Largest accepted step of the wavelengths, nm.
    method : str
        ``linear``; ``sprague``, the fifth-order interpolation that CIE 167:2005 recommends for uniform steps, exact for
        polynomials of degree 4 at least two steps from the ends of the data and for linear data up to the ends;
        ``average``, weighted by a triangle of ±5 nm, which keeps the power of a light's lines (beyond the ends of the
        data, within the triangles of 400 and 700 nm, the end values continue); ``auto``, for reflectances: Sprague for
        uniform steps, linear otherwise, and linear also for a spectrum that Sprague would make more negative than its
        own values.

    Returns
    -------
    (..., 61) float64

    Raises
    ------
    InputError
        If the wavelengths do not increase, do not cover 400..700 nm, have a gap over `max_gap_nm`, are not uniform for
        the method ``sprague``, or a value is not finite.
    ValueError
        For an unknown method.
    """
    if method not in METHODS:
        raise ValueError(f"the resampling method {method!r}; accepted: {', '.join(METHODS)}")
    wavelength_nm = np.asarray(wavelength_nm, dtype=np.float64)
    values = np.asarray(values, dtype=np.float64)
    if not np.isfinite(wavelength_nm).all():
        raise InputError(file, "wavelength", "a wavelength that is not finite", "strictly increasing wavelengths in nm")
    check_wavelengths(wavelength_nm, file, "wavelength", max_gap_nm)
    if not np.isfinite(values).all():
        raise InputError(file, "wavelength", "a missing or non-finite value", "a finite number at every wavelength")
    flat = values.reshape(-1, wavelength_nm.size)
    if method == "average":
        out = flat @ _average_matrix(tuple(wavelength_nm)).T
    elif method == "linear" or (method == "auto" and not is_uniform(wavelength_nm)):
        out = _linear(wavelength_nm, flat)
    elif not is_uniform(wavelength_nm):
        raise InputError(file, "wavelength", "steps that are not uniform", "uniform steps for Sprague's interpolation")
    else:
        out = flat @ _sprague_matrix(tuple(wavelength_nm)).T
        if method == "auto":
            out = _without_overshoot(out, wavelength_nm, flat, file)
    return out.reshape((*values.shape[:-1], SAMPLES))


def resample_picture(wavelength_nm: np.ndarray, pixels: np.ndarray, file) -> np.ndarray:
    """Resample a spectral picture of light to the grid.

    Pictures with finer steps than the grid are averaged over ±5 nm. Others are interpolated by Sprague's method if
    their steps are uniform, and linearly otherwise or in pixels that Sprague would make more negative than they are.

    Parameters
    ----------
    wavelength_nm : (n,) float, nm
    pixels : (..., n) float, finite
    file : path
        For the error message.

    Returns
    -------
    (..., 61) float32

    Raises
    ------
    InputError
        See `resample`.
    """
    unit = np.eye(len(wavelength_nm))
    if is_finer_than_grid(np.asarray(wavelength_nm)):
        return pixels @ resample(wavelength_nm, unit, file, method="average").astype(np.float32)
    linear = resample(wavelength_nm, unit, file).astype(np.float32)
    if not is_uniform(np.asarray(wavelength_nm)):
        return pixels @ linear
    out = pixels @ resample(wavelength_nm, unit, file, method="sprague").astype(np.float32)
    overshot = out.min(axis=-1) < np.minimum(pixels.min(axis=-1), 0.0)
    out[overshot] = pixels[overshot] @ linear
    return out


def is_uniform(wavelength_nm: np.ndarray) -> bool:
    """Return whether wavelengths have equal steps and are enough for Sprague's interpolation."""
    steps = np.diff(wavelength_nm)
    return wavelength_nm.size >= _MIN_SPRAGUE and float(np.ptp(steps)) <= _UNIFORM_NM


def is_finer_than_grid(wavelength_nm: np.ndarray) -> bool:
    """Return whether the mean step of wavelengths within 400..700 nm is smaller than the grid's."""
    inside = (wavelength_nm >= WAVELENGTH_NM[0]) & (wavelength_nm <= WAVELENGTH_NM[-1])
    return int(inside.sum()) > SAMPLES


def _linear(wavelength_nm: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(WAVELENGTH_NM, wavelength_nm, row) for row in rows])


def _without_overshoot(out: np.ndarray, wavelength_nm: np.ndarray, rows: np.ndarray, file) -> np.ndarray:
    """Replace rows that Sprague's interpolation made more negative than their own values by linear interpolation."""
    overshot = out.min(axis=1) < np.minimum(rows.min(axis=1), 0.0)
    if overshot.any():
        LOGGER.info("%s: %d spectra interpolated linearly, Sprague's would be negative", file, overshot.sum())
        out[overshot] = _linear(wavelength_nm, rows[overshot])
    return out


@lru_cache(maxsize=16)
def _sprague_matrix(wavelength_nm: tuple[float, ...]) -> np.ndarray:
    """Return the matrix of Sprague's interpolation, which is linear in the values, (61, n).

    The polynomial and the values beyond the ends are those of CIE 167:2005, with the coefficients that the library
    colour-science has; it is written here because the library takes a second to load.
    """
    count, span = len(wavelength_nm), wavelength_nm[-1] - wavelength_nm[0]
    # Uniform wavelengths may be rounded: their places count in whole steps.
    place = np.clip((WAVELENGTH_NM - wavelength_nm[0]) / span, 0.0, 1.0) * (count - 1)
    first = np.minimum(place.astype(int), count - 2)
    extended = np.zeros((count + 4, count))
    extended[2:-2] = np.eye(count)
    extended[:2, :_MIN_SPRAGUE], extended[-2:, -_MIN_SPRAGUE:] = _SPRAGUE_ENDS, _SPRAGUE_ENDS[::-1, ::-1]
    powers = (place - first)[:, None] ** np.arange(len(_SPRAGUE))
    around = extended[first[:, None] + np.arange(len(_SPRAGUE))]
    matrix = np.einsum("sp,pk,skn->sn", powers, _SPRAGUE, around)
    # At wavelengths that grid and source have in common, the source's values are kept without rounding.
    nearest = np.rint(place).astype(int)
    shared = np.abs(place - nearest) * span / (count - 1) < 1e-9
    matrix[shared] = np.eye(count)[nearest[shared]]
    return matrix


@lru_cache(maxsize=16)
def _average_matrix(wavelength_nm: tuple[float, ...]) -> np.ndarray:
    """Return the matrix, (61, n), that averages linear interpolation over a triangle around each grid wavelength.

    Beyond the ends of the data, their end values continue.
    """
    source = np.array([wavelength_nm[0] - STEP_NM, *wavelength_nm, wavelength_nm[-1] + STEP_NM])
    matrix = np.zeros((SAMPLES, source.size))
    for row, centre in zip(matrix, WAVELENGTH_NM, strict=True):
        inside = source[np.abs(source - centre) < STEP_NM]
        knots = np.unique(np.concatenate([[centre - STEP_NM, centre, centre + STEP_NM], inside]))
        widths = np.diff(knots)
        # Triangle times line is a parabola between knots, for which Simpson's rule is exact.
        points = np.concatenate([knots, 0.5 * (knots[1:] + knots[:-1])])
        weights = np.zeros(points.size)
        weights[: knots.size - 1] += widths / 6.0
        weights[1 : knots.size] += widths / 6.0
        weights[knots.size :] += widths * 4.0 / 6.0
        weights *= np.maximum(0.0, 1.0 - np.abs(points - centre) / STEP_NM)
        left = np.clip(np.searchsorted(source, points, side="right") - 1, 0, source.size - 2)
        part = (points - source[left]) / (source[left + 1] - source[left])
        np.add.at(row, left, weights * (1.0 - part))
        np.add.at(row, left + 1, weights * part)
        row /= row.sum()
    matrix[:, 1] += matrix[:, 0]
    matrix[:, -2] += matrix[:, -1]
    return matrix[:, 1:-1]
