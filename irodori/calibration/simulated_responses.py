"""Weights from reflectance to the simulated responses of a camera with known sensitivities [eq. 1]."""

import numpy as np

from irodori.spectra.grid import SAMPLES, TRAPEZOID_NM

EXPOSURES = ("per_band", "per_shot", "same_time")
#: A band whose response to white is at most this fraction of the brightest band's counts as blind.
_DARK = 1e-9


def band_weights(
    sensitivities: np.ndarray, light: np.ndarray, transmittance: np.ndarray | None = None, exposure: str = "per_band"
) -> np.ndarray:
    """Return weights that turn reflectances into responses on the scale of the sensor, 1 = full scale [eq. 1].

    Parameters
    ----------
    sensitivities : (3, 61) float, R_b(λ), relative
    light : (61,) float, E(λ), relative
    transmittance : (61,) float or None
        Transmittance of the filter in front of the lens in a second shot; if None, there is one shot of three bands.
    exposure : str
        Bands in which a perfect diffuser reaches full scale. ``per_band``: every band, as if each were exposed alone
        (the ideal that tables of noise against error assume); ``per_shot``: the brightest band of each shot, with a
        longer exposure of the second; ``same_time``: the brightest band of the first shot, with the same exposure time
        for the second.

    Returns
    -------
    (3 or 6, 61) float64; the sum of a row is the response to a perfect diffuser, 0 for a band without signal

    Raises
    ------
    ValueError
        For an unknown exposure, wrong shapes, negative or non-finite values, and a camera without any signal.
    """
    if exposure not in EXPOSURES:
        raise ValueError(f"the exposure {exposure!r}; accepted: {', '.join(EXPOSURES)}")
    first = _checked(sensitivities, "sensitivities", 2) * _checked(light, "light", 1) * TRAPEZOID_NM
    shots = [first] if transmittance is None else [first, first * _checked(transmittance, "transmittance", 1)]
    whites = [shot.sum(axis=1) for shot in shots]
    brightest = whites[0].max()
    if not brightest > 0.0:
        raise ValueError("a camera that sees nothing of the light; accepted: sensitivities and light that overlap")
    scales = {
        "per_band": whites,
        "per_shot": [np.full_like(white, white.max()) for white in whites],
        "same_time": [np.full_like(white, brightest) for white in whites],
    }[exposure]
    scale = np.concatenate(scales)[:, None]
    weights = np.concatenate(shots)
    return np.divide(weights, scale, out=np.zeros_like(weights), where=scale > _DARK * brightest)


def _checked(values, name: str, dimensions: int) -> np.ndarray:
    values = np.asarray(values, dtype=np.float64)
    if values.shape[-1:] != (SAMPLES,) or values.ndim != dimensions:
        raise ValueError(f"{name} of shape {values.shape}; accepted: {SAMPLES} wavelengths on the last axis")
    if not np.isfinite(values).all() or (values < -0.01 * np.abs(values).max()).any():
        raise ValueError(f"{name} that are negative or not finite; accepted: finite values from 0")
    return values
