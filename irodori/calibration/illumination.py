"""Estimate of the uneven light on a chart, vignetting included, where there is no flat field.

A patch has a uniform reflectance, so the slope of the response across it is the slope of the light: the slopes of all
patches determine a smooth field, exp of a polynomial in x and y, up to its scale. The dark frame between the patches
has a uniform reflectance too, but it reflects little: light scattered in the lens from bright patches and from the
paper, and the gloss of the frame's different surface, are as large as the vignetting. It is not used.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.chart import Located, read_located
from irodori.core.left_out import is_less, simplest

_SHARE = 0.75  # of a patch's side: the square whose slope is taken, clear of blurred edges
_DEGREES = (0, 1, 2)
_MAX_STANDARD_ERROR = 0.01
_MIN_SLOPES = 12  # patches
_ROUNDS = 12
_CLEAR = 2.0  # standard errors by which a richer model must predict better
_HUBER = 1.5  # standard deviations


@dataclass(frozen=True)
class Illumination:
    """Light on a chart, relative to its mean over the patches, or the reason why it is not known.

    Parameters
    ----------
    correctable : bool
        Whether responses may be divided by `field`.
    reason : str
        Phrase that describes the result, with its figures.
    degree : int
        Degree of the polynomial in the exponent; 0 is even light.
    per_band : bool
        Whether each band has a polynomial of its own.
    field : (patches, bands) float64
        Light on the patches, the mean of each band 1; all 1 where not correctable.
    standard_error : float
        Largest standard error of the field at a patch, relative; NaN where no slope was measured.
    """

    correctable: bool
    reason: str
    degree: int
    per_band: bool
    field: np.ndarray
    standard_error: float


def illumination(response: np.ndarray, valid: np.ndarray, located: Located, file, sample_px: int = 2) -> Illumination:
    """Return the light on a chart from the slopes within its patches.

    The degree, 0, 1 or 2, is the smallest one that predicts the slopes of patches left out within two standard errors
    of the best. Each band has a field of its own only if this predicts them better by two standard errors.

    Parameters
    ----------
    response : (height, width, bands) float
    valid : (height, width) bool
    located : Located
    file : path, for error messages
    sample_px : int
        Mosaic pixels along the side of a sample of the picture.

    Raises
    ------
    InputError
        If a patch lies outside the picture or most of it is not valid.
    """
    side_px = located.side_px if np.isnan(located.patch_side_px) else _SHARE * located.patch_side_px
    whole = Located(located.centres_px, side_px, located.rows, located.columns, located.patch_side_px, located.found)
    reading = read_located(response, valid, whole, file, sample_px)
    xy, scale_px = _unit(located.centres_px)
    slopes, brightest = reading.log_slope * scale_px, reading.mean.max(axis=0)
    # A dead band has no slopes, and is refused with a better message when the calibration is solved.
    weights = np.divide(reading.mean, brightest, out=np.zeros_like(reading.mean), where=brightest > 0)
    known = np.isfinite(slopes).all(axis=(1, 2)) & (weights > 0).all(axis=1)
    even = np.ones_like(reading.mean)
    if known.sum() < _MIN_SLOPES:
        reason = f"not correctable: slopes of {known.sum()} patches of {side_px:.1f} superpixels, {_MIN_SLOPES} needed"
        return Illumination(False, reason, 0, False, even, np.nan)
    degree, per_band = _choose(xy[known], slopes[known], weights[known])
    exponent, error = _field(xy, xy[known], slopes[known], weights[known], degree, per_band)
    field = np.exp(exponent)
    field /= field.mean(axis=0)
    kind = "one a band" if per_band else "common to the bands"
    words = f"degree {degree}, {kind}, {field.min():.2f} to {field.max():.2f}, standard error {error:.2%} at most"
    if error > _MAX_STANDARD_ERROR:
        reason = f"not correctable: {words}, accepted {_MAX_STANDARD_ERROR:.0%}"
        return Illumination(False, reason, degree, per_band, even, error)
    return Illumination(True, f"corrected: {words}" if degree else "even light", degree, per_band, field, error)


def _unit(centres_px: np.ndarray) -> tuple[np.ndarray, float]:
    """Return patch centres scaled to -1..1 about their middle, and the unit of this scale in superpixels."""
    low, high = centres_px.min(axis=0), centres_px.max(axis=0)
    scale_px = float((high - low).max() / 2.0)
    return (centres_px - (low + high) / 2.0) / scale_px, scale_px


def _powers(degree: int) -> list[tuple[int, int]]:
    return [(i, total - i) for total in range(1, degree + 1) for i in range(total + 1)]


def _terms(xy: np.ndarray, degree: int) -> np.ndarray:
    """Return the polynomial's terms without the constant, (n, terms)."""
    x, y = xy.T
    return np.stack([x**i * y**j for i, j in _powers(degree)], axis=1) if degree else np.zeros((len(xy), 0))


def _slope_terms(xy: np.ndarray, degree: int) -> np.ndarray:
    """Return the terms' derivatives along x and y, (n, 2, terms)."""
    x, y = xy.T
    out = np.zeros((len(xy), 2, len(_powers(degree))))
    for k, (i, j) in enumerate(_powers(degree)):
        out[:, 0, k] = i * x ** max(i - 1, 0) * y**j
        out[:, 1, k] = j * x**i * y ** max(j - 1, 0)
    return out


def _solve(xy, slopes, weights, degree: int, per_band: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients (bands, terms) by Huber's loss and their covariances (bands, terms, terms).

    Noise and scattered light are additive, which makes relative slopes of dark patches less accurate: weights are
    proportional to the response.
    """
    bands = slopes.shape[-1]
    design = _slope_terms(xy, degree).reshape(2 * len(xy), -1)
    terms = design.shape[1]
    if not terms:
        return np.zeros((bands, 0)), np.zeros((bands, 0, 0))
    values, weight = slopes.reshape(2 * len(xy), bands), np.repeat(weights, 2, axis=0)
    groups = [[band] for band in range(bands)] if per_band else [list(range(bands))]
    coefficients, covariances = np.empty((bands, terms)), np.empty((bands, terms, terms))
    for group in groups:
        a = np.tile(design, (len(group), 1)) * weight[:, group].T.reshape(-1, 1)
        b = (values * weight)[:, group].T.ravel()
        trust = np.ones(len(b))
        for _ in range(_ROUNDS):
            solved = np.linalg.lstsq(a * trust[:, None], b * trust)[0]
            residual = np.abs(b - a @ solved)
            spread = max(1.4826 * np.median(residual), 1e-12)
            trust = np.sqrt(np.minimum(1.0, _HUBER * spread / np.maximum(residual, 1e-300)))
        freedom = max(1, len(b) - terms)
        variance = np.sum((trust * (b - a @ solved)) ** 2) / freedom
        coefficients[group] = solved
        # Bands of one pixel share dirt and scattered light: further bands do not count as further observations.
        covariances[group] = variance * len(group) * np.linalg.inv((a * trust[:, None]).T @ (a * trust[:, None]))
    return coefficients, covariances


def _choose(xy, slopes, weights) -> tuple[int, bool]:
    """Return the degree, chosen with one field common to all bands, and whether bands have fields of their own."""
    errors = {degree: _left_out(xy, slopes, weights, degree, False) for degree in _DEGREES}
    degree = simplest(errors, _CLEAR)
    own = _left_out(xy, slopes, weights, degree, True)
    return degree, degree > 0 and is_less(own, errors[degree], _CLEAR)


def _left_out(xy, slopes, weights, degree: int, per_band: bool) -> np.ndarray:
    """Return the mean weighted error of each patch's slopes as predicted from all other patches, (patches,)."""
    missed = np.empty(len(xy))
    for patch in range(len(xy)):
        others = np.arange(len(xy)) != patch
        solved = _solve(xy[others], slopes[others], weights[others], degree, per_band)[0]
        predicted = _slope_terms(xy[patch : patch + 1], degree)[0] @ solved.T
        missed[patch] = np.abs((slopes[patch] - predicted) * weights[patch]).mean()
    return missed


def _field(xy_all, xy, slopes, weights, degree: int, per_band: bool) -> tuple[np.ndarray, float]:
    """Return the exponent at all patches, (patches, bands), and its largest standard error about its mean."""
    coefficients, covariances = _solve(xy, slopes, weights, degree, per_band)
    terms = _terms(xy_all, degree)
    exponent = terms @ coefficients.T
    about = terms - terms.mean(axis=0)
    variance = np.einsum("pt,btu,pu->pb", about, covariances, about)
    return exponent, float(np.sqrt(variance.max())) if degree else 0.0
