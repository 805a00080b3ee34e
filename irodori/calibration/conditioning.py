"""Checks whether a chart can calibrate a camera, and the noise amplification of a calibration."""

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.response_model import fit_response_model, smooth_priors
from irodori.calibration.training import Training

#: Largest condition number of the chart's responses, every band divided by its largest patch; the default.
MAX_CONDITION = 1e5
_ALIKE = 1e-9  # relative; clipped means agree to rounding, measured ones do not
_BELOW_ZERO = 0.01  # of the band's largest patch, where the noise is not known
_NOISE_LIMIT = 5.0  # standard deviations of a patch mean
_CLIPPED_SHARE = 0.05  # of the band's largest response: smallest deficit of a saturated patch
_CLIPPED_LIMIT = 6.0  # standard deviations of the prediction from the other patches: smallest deficit
_SAME_PATCH = 1e-6  # relative difference of responses in all bands


class PatchError(ValueError):
    """Error for responses that determine no calibration because of one patch.

    Parameters
    ----------
    patch : int
        Index of the patch among those of all charts.
    fault : str
        Description of the fault, which follows "patch N" in the message.
    """

    def __init__(self, patch: int, fault: str) -> None:
        self.patch, self.fault = int(patch), fault
        super().__init__(f"patch {patch}{fault}")


def condition_number(response: np.ndarray) -> float:
    """Return the condition number of responses (m, bands), every band divided by its largest magnitude."""
    return float(np.linalg.cond(response / np.abs(response).max(axis=0)))


def check_responses(
    response: np.ndarray,
    limit: float = MAX_CONDITION,
    patch_variance: np.ndarray | None = None,
    filters: tuple[str, ...] = (),
) -> None:
    """Raise an error for responses that determine no calibration.

    Parameters
    ----------
    response : (m, bands) float
    limit : float
        Largest condition number, bands scaled.
    patch_variance : (bands,) float, optional
        Variance of the patch means.
    filters : tuple of str
        Filter states, three bands each, for the names of the bands in the message.

    Raises
    ------
    ValueError
        For responses that are not finite, fewer patches than bands (patches with the same response count once), a band
        without signal, negative or saturated patches, and nearly proportional bands. The message names a remedy.
    """
    patches, bands = response.shape
    names = [band_name(band, filters) for band in range(bands)]
    if patches < bands:
        raise ValueError(f"{patches} patches for {bands} bands; accepted: at least as many patches as bands")
    if not np.isfinite(response).all():
        patch, band = np.argwhere(~np.isfinite(response))[0]
        raise PatchError(patch, f" not finite in {names[band]}; accepted: finite responses")
    peak = np.abs(response).max(axis=0)
    if not (peak > 0).all():
        dead = names[int(np.argmin(peak))]
        raise ValueError(
            f"{dead} without any signal; accepted: bands that see the chart (more exposure, or no such band)"
        )
    scaled = response / peak
    _refuse_negative(scaled, None if patch_variance is None else patch_variance / peak**2, names)
    distinct = _distinct(scaled)
    if distinct < bands:
        found = f"{distinct} different patches among {patches} for {bands} bands"
        raise ValueError(f"{found}; accepted: at least as many different patches as bands (a chart of more colours)")
    _refuse_saturated(scaled, names)
    condition = np.linalg.cond(scaled)
    if not condition <= limit:
        first, second, cosine = _most_alike(scaled)
        raise ValueError(
            f"responses of condition number {condition:.3g}: {names[first]} and {names[second]} are the most alike "
            f"(cosine {cosine:.9f}); accepted: up to {limit:.3g} (a filter that changes one of them more, a chart of "
            "more saturated colours, or fewer bands)"
        )


def check_brightest(training: Training, filters: tuple[str, ...] = ()) -> None:
    """Refuse a chart with a saturated patch: the brightest one of a band, far below the prediction from the others.

    Raises
    ------
    ValueError
        The message names the patch and the band, and by how much it is below the prediction.
    """
    names = [band_name(band, filters) for band in range(training.response.shape[1])]
    known = np.zeros(len(names)) if training.noise.patch is None else training.noise.patch / training.scale**2
    brightest = np.argmax(training.scaled, axis=0)
    for patch in np.unique(brightest):
        others = np.arange(len(training.spectra)) != patch
        priors = smooth_priors(training.spectra[others], training.light)
        model = fit_response_model(training.scaled[others], priors, known)
        spectrum = training.spectra[patch]
        for band in np.flatnonzero(brightest == patch):
            predicted = spectrum @ model.mean[band]
            spread = np.sqrt(spectrum @ model.covariance[band] @ spectrum + model.noise[band])
            lack = predicted - training.scaled[patch, band]
            if lack > max(_CLIPPED_SHARE, _CLIPPED_LIMIT * spread):
                found = f", the brightest in {names[band]}, {lack:.0%} below what the others predict"
                raise PatchError(patch, f"{found}: saturated; accepted: a chart exposed below saturation")


def noise_amplification(calibration: Calibration) -> float:
    """Return the standard deviation of the recovered reflectance, rms over wavelengths, per unit of a band's noise.

    The value is that of the worst band, with noise in units of the band's largest patch; for a non-linear estimator,
    that of the worst patch of the chart too.
    """
    return float(np.sqrt(_gains(calibration).max() / len(calibration.basis)))


def _gains(calibration: Calibration) -> np.ndarray:
    """Return the variance of the spectrum, summed over wavelengths, per variance of each band in units of its peak.

    (patches, bands) float64, at the responses of the chart.
    """
    chart = np.asarray(calibration.training, dtype=np.float64)
    return (calibration.mapping.slopes(chart, None) ** 2).sum(axis=2) * calibration.band_scale() ** 2


def check_amplification(amplification: float, limit: float, calibration: Calibration) -> None:
    """Raise an error for a calibration that amplifies noise too much.

    Raises
    ------
    ValueError
        The message has the amplification, the band and a remedy.
    """
    if amplification <= limit:
        return
    band = int(np.argmax(_gains(calibration).max(axis=0)))
    raise ValueError(
        f"{calibration.estimator} with {calibration.basis.shape[1]} bases amplifies the noise of "
        f"{band_name(band, calibration.filters)} {amplification:.3g} times; accepted: up to {limit:.3g} (fewer bases, "
        "wiener or local in place of pinv, or a filter that makes the bands differ more)"
    )


def band_name(band: int, filters: tuple[str, ...]) -> str:
    """Return the number of a band with its colour and its filter state, as far as the filter states tell them."""
    if 3 * len(filters) > band:
        return f"band {band} ({('red', 'green', 'blue')[band % 3]}, filter {filters[band // 3]})"
    return f"band {band}"


def _refuse_negative(scaled: np.ndarray, variance, names: list[str]) -> None:
    least = -_BELOW_ZERO if variance is None else -np.maximum(_NOISE_LIMIT * np.sqrt(variance), _BELOW_ZERO)
    if (scaled < least).any():
        patch, band = np.argwhere(scaled < least)[0]
        found = f" at {scaled[patch, band]:.3g} of the largest in {names[band]}"
        accepted = "responses that are not negative (a dark frame of the same exposure)"
        raise PatchError(patch, f"{found}; accepted: {accepted}")


def _distinct(scaled: np.ndarray) -> int:
    """Return the number of patches with responses that differ from all before them."""
    kept: list[np.ndarray] = []
    for row in scaled:
        if not kept or min(np.abs(row - other).max() for other in kept) > _SAME_PATCH:
            kept.append(row)
    return len(kept)


def _refuse_saturated(scaled: np.ndarray, names: list[str]) -> None:
    """Refuse bands in which patches with different responses in other bands share the largest value."""
    for band in range(scaled.shape[1]):
        top = np.flatnonzero(scaled[:, band] >= scaled[:, band].max() * (1.0 - _ALIKE))
        differ = [p for p in top[1:] if np.abs(scaled[p] - scaled[top[0]]).max() > 1e-3]
        if differ:
            found = f" with another at the same largest value in {names[band]}: saturated"
            raise PatchError(top[0], f"{found}; accepted: a chart exposed below saturation")


def _most_alike(scaled: np.ndarray) -> tuple[int, int, float]:
    unit = scaled / np.linalg.norm(scaled, axis=0)
    cosine = np.abs(unit.T @ unit)
    np.fill_diagonal(cosine, -1.0)
    first, second = np.unravel_index(np.argmax(cosine), cosine.shape)
    return int(min(first, second)), int(max(first, second)), float(cosine[first, second])
