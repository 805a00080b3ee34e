"""Prior over the light that reaches a camera in a room: known lamps, alone and beside others, on reflectances."""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.response_model import smooth_covariance
from irodori.calibration.training import mix_paints
from irodori.colour.colorimetry import colour_matching_weights
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import chart_spectra, spectrum
from irodori.spectra.published_names import ILLUMINANTS
from irodori.spectra.published_tables import published_table

#: The chart whose patches, their mixtures as paints and their products stand for walls, wood and cloth.
_CHART = "BabelColor Average"
#: Standard deviation of what differs from a published lamp.
_OF_LAMPS = 0.05
#: Correlation length, nm, of that, and both of what differs from a known reflectance.
_LENGTH_NM, _OF_SURFACES = 20.0, (0.1, 80.0)
_ALIKE = 5  # lamps that make a kind: their mixtures and what lies between them
#: Peaks, nm, of blue, green and red LEDs as manufacturers' data sheets list them, and their widths [Ohno 2005].
_LED_PEAKS_NM, _LED_WIDTHS_NM = ((445.0, 475.0), (515.0, 540.0), (615.0, 645.0)), (23.0, 34.0, 18.0)
_LED_TEMPERATURES_K = (2700.0, 3000.0, 4000.0, 5000.0, 6500.0)  # among the nominal ones of ANSI C78.377
_LED_STEPS = 6  # of each peak
_C2_NM_K = 1.438777e7  # second radiation constant of Planck's law
#: Weight of a lamp itself, of the lamp on coloured surfaces, of its kind, and of any mixture of all lamps.
_BARE, _COLOURED, _KIND, _ANY = 1.0, 2.0, 1.0, 1.0


@dataclass(frozen=True)
class LightPrior:
    """A mixture of families of light; of each the second moment of its spectra, brought to luminance 1, is known.

    Parameters
    ----------
    moment : (n, 61, 61) float64
    share : (n,) float64
        Of a family before a picture was seen; sums to one.
    broad : int
        So many families at the end hold any light: they are kept whatever a picture shows.
    """

    moment: np.ndarray
    share: np.ndarray
    broad: int


def published_lamps() -> np.ndarray:
    """Return the illuminants and measured lamps of colour-science, each of luminance 1, (lamps, 61).

    CIE A to E, the D series, fluorescent, high-pressure and LED illuminants, indoor daylight, those of ISO 7589, and
    measured discharge lamps, incandescent lamps and LEDs.
    """
    lamps = np.concatenate(
        [np.stack([spectrum(name) for name in ILLUMINANTS]), published_table("light_sources").at(WAVELENGTH_NM)]
    )
    return of_luminance_one(lamps)


def led_lamps() -> np.ndarray:
    """Return spectra of lamps of a red, a green and a blue LED, each of luminance 1, (temperatures, lamps, 61).

    The published spectra hold almost no such lamp, and its narrow peaks resemble those of no other. For every
    temperature, the peak wavelengths take all combinations of a regular grid; the powers of the LEDs match the
    tristimulus values of a black body of that temperature.

    References
    ----------
    Shape of an LED: Ohno, Y. (2005), Spectral design considerations for white LED color rendering, Optical Engineering
    44(11), 111302, eq. (2).
    """
    steps = (np.arange(_LED_STEPS) + 0.5) / _LED_STEPS
    peaks = np.stack(np.meshgrid(*(low + (high - low) * steps for low, high in _LED_PEAKS_NM)), axis=-1).reshape(-1, 3)
    bell = np.exp(-(((WAVELENGTH_NM - peaks[..., None]) / np.array(_LED_WIDTHS_NM)[:, None]) ** 2))
    leds = (bell + 2.0 * bell**5) / 3.0
    black_body = WAVELENGTH_NM**-5.0 / np.expm1(_C2_NM_K / (WAVELENGTH_NM * np.array(_LED_TEMPERATURES_K)[:, None]))
    white = black_body @ colour_matching_weights().T
    powers = np.linalg.solve((leds @ colour_matching_weights().T).swapaxes(-1, -2), white[:, None, :, None])[..., 0]
    lamps = np.einsum("tnk,nkl->tnl", powers, leds)
    return lamps / (lamps @ colour_matching_weights()[1])[..., None]


def of_luminance_one(lamps: np.ndarray) -> np.ndarray:
    """Return spectra of lamps, (lamps, 61), each brought to luminance 1."""
    return lamps / (lamps @ colour_matching_weights()[1])[:, None]


def _surfaces() -> np.ndarray:
    """Return the second moment of reflectances of mean 1: patches, paints mixed of them, light off two of them."""
    patches = chart_spectra(_CHART)[1]
    first, second = np.triu_indices(len(patches))
    known = np.concatenate([patches, mix_paints(patches), patches[first] * patches[second]])
    known = known / known.mean(axis=1, keepdims=True)
    return known.T @ known / len(known) + _spread(_OF_SURFACES)


def _spread(spread: tuple[float, float]) -> np.ndarray:
    deviation, length_nm = spread
    return deviation**2 * smooth_covariance(length_nm)


def _alike(moments: np.ndarray, count: int) -> np.ndarray:
    """Return which lamps are most alike to every one by their second moments, itself the first, (lamps, count)."""
    size = np.sqrt(np.einsum("nij,nij->n", moments, moments))
    flat = moments.reshape(len(moments), -1)
    return np.argsort(-(flat @ flat.T) / (size[:, None] * size), axis=1, kind="stable")[:, :count]


def families_of(lamps: np.ndarray, alike: int = _ALIKE, deviation: float | np.ndarray = _OF_LAMPS) -> LightPrior:
    """Return the prior that lamps make, each given by the second moment of its spectrum, (lamps, 61, 61).

    Parameters
    ----------
    lamps : (n, 61, 61) float64
    alike : int
        Lamps that make a kind.
    deviation : float or (n,) float
        Standard deviation of what differs smoothly from a lamp, relative.
    """
    variance = np.broadcast_to(np.square(deviation), len(lamps))[:, None, None]
    bare, surfaces = lamps * (1.0 + variance * smooth_covariance(_LENGTH_NM)), _surfaces()
    of_any = np.stack([bare.mean(axis=0), lamps.mean(axis=0) * surfaces])
    moments = (bare, lamps * surfaces, bare[_alike(lamps, alike)].mean(axis=1), of_any)
    share = np.concatenate(
        [
            np.full(len(moment), weight / len(moment))
            for moment, weight in zip(moments, (_BARE, _COLOURED, _KIND, _ANY), strict=True)
        ]
    )
    return LightPrior(np.concatenate(moments), share / share.sum(), len(moments[-1]))


def light_prior(lamps: np.ndarray, deviation: float | np.ndarray = _OF_LAMPS) -> LightPrior:
    """Return the prior that a list of lamps, (lamps, 61), makes; for the deviation see `families_of`."""
    return families_of(lamps[:, :, None] * lamps[:, None, :], deviation=deviation)


def prior_of_any_lamp(lamps: np.ndarray | None = None) -> LightPrior:
    """Return the prior of a place of which nothing is said: published lamps, and those of three LEDs.

    Parameters
    ----------
    lamps : (n, 61) float64, optional
        The published lamps; all of them where absent.
    """
    lamps, leds = published_lamps() if lamps is None else lamps, led_lamps()
    of_leds = leds.swapaxes(1, 2) @ leds / leds.shape[1]
    return families_of(np.concatenate([lamps[:, :, None] * lamps[:, None, :], of_leds]))
