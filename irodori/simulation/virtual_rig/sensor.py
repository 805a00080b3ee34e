"""Sensor model: photo-electrons, noise, black level, quantisation, saturation."""

import numpy as np

from irodori.config.models import CombFilter, SensorOptions
from irodori.config.parts import AnyCamera
from irodori.spectra.grid import SAMPLES, TRAPEZOID_NM, WAVELENGTH_NM
from irodori.spectra.published import camera_sensitivities


class Sensor(SensorOptions):
    """Camera sensor, with the parameters of the block ``virtual.sensor`` of a camera's definition."""

    @property
    def white_level(self) -> int:
        """Largest digital number."""
        return 2**self.bits - 1

    @property
    def electrons_per_dn(self) -> float:
        """Conversion gain, electrons per digital number."""
        return self.full_well_e / (self.white_level - self.black_level)

    def expose(
        self, response: np.ndarray, exposure_s: float, rng: np.random.Generator, hot_rate_e_per_s=0.0
    ) -> np.ndarray:
        """Return the digital numbers of an exposure, with noise, black level, quantisation and saturation.

        Parameters
        ----------
        response : (height, width) float
            Response of each mosaic pixel in its own band.
        exposure_s : float, s
        rng : numpy Generator
            Random generator of shot noise and read noise.
        hot_rate_e_per_s : float or (height, width) float
            Dark current of each pixel beyond the sensor's own, electrons/s.

        Returns
        -------
        (height, width) uint16
        """
        per_response = self.full_well_e / self.response_at_full_well * (exposure_s / self.base_exposure_s)
        mean = np.maximum(response, 0.0) * per_response + (self.dark_current_e_per_s + hot_rate_e_per_s) * exposure_s
        # Above 100 wells the count saturates whatever the noise; the bound keeps the generator in its range.
        electrons = rng.poisson(np.minimum(mean, 100.0 * self.full_well_e)).astype(np.float64)
        electrons += rng.normal(scale=self.read_noise_e, size=mean.shape)
        electrons = np.minimum(electrons, self.full_well_e)
        numbers = np.rint(self.black_level + electrons / self.electrons_per_dn)
        return np.clip(numbers, 0, self.white_level).astype(np.uint16)


def comb_transmittance(definition: CombFilter) -> np.ndarray:
    """Return the transmittance of a comb filter, (61,), 0..1.

    Parameters
    ----------
    definition : CombFilter
        Each passband is a super-Gaussian of order 8, the shape of an interference coating.
    """
    transmittance = np.full(SAMPLES, definition.floor)
    for band in definition.passbands:
        distance = np.abs(2.0 * (WAVELENGTH_NM - band.centre_nm) / band.width_nm)
        transmittance += band.peak * np.exp(-np.log(2.0) * distance**8)
    return np.minimum(transmittance, 1.0)


def band_weights(camera: AnyCamera, light: np.ndarray) -> np.ndarray:
    """Return weights that turn a reflectance spectrum into band responses [eq. 1].

    Parameters
    ----------
    camera : Camera or PhotographingCamera
        Definition with the block ``virtual``.
    light : (61,) float
        Spectrum E(λ) of the rig's light.

    Returns
    -------
    (6, 61) float64; red, green, blue without the filter, then with it. All are divided by the sum over λ of the
    brightest unfiltered band, so that the balance between bands stays true and a perfect diffuser gives at most 1.
    """
    if camera.virtual is None:
        raise ValueError("a camera without the block virtual; accepted: a camera of the virtual rig")
    sensitivities = camera_sensitivities(camera.virtual.sensitivities)
    comb = comb_transmittance(camera.virtual.comb_filter)
    weights = np.concatenate([sensitivities, sensitivities * comb]) * light * TRAPEZOID_NM
    return weights / weights[:3].sum(axis=1).max()
