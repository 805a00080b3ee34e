"""Prior for the light that reaches a camera in a room: direct light of known lamps, mixtures, and reflections."""

from dataclasses import dataclass, replace

import numpy as np

from irodori.calibration.response_model import smooth_covariance
from irodori.calibration.training import mix_paints
from irodori.colour.colorimetry import colour_matching_weights
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import chart_spectra, spectrum
from irodori.spectra.published_names import ILLUMINANTS
from irodori.spectra.published_tables import published_table

#: Chart whose patches, mixtures of them as paints, and products of two represent walls, wood and textiles.
_CHART = "BabelColor Average"
#: Standard deviation of the relative difference between a lamp and the published one.
_OF_LAMPS = 0.05
#: Correlation length (nm) of this difference; standard deviation and correlation length for reflectances.
_LENGTH_NM, _OF_SURFACES = 20.0, (0.1, 80.0)
_ALIKE = 5  # number of similar lamps that form a kind
#: Peaks, nm, of blue, green and red LEDs as manufacturers' data sheets list them, and their widths [Ohno 2005].
_LED_PEAKS_NM, _LED_WIDTHS_NM = ((445.0, 475.0), (515.0, 540.0), (615.0, 645.0)), (23.0, 34.0, 18.0)
_LED_TEMPERATURES_K = (2700.0, 3000.0, 4000.0, 5000.0, 6500.0)  # among the nominal ones of ANSI C78.377
_LED_STEPS = 6  # of each peak
#: White LEDs: the peak, nm, of the blue LED; peaks and full widths at half maximum, nm, of a green or yellow phosphor
#: (garnets with cerium) and of a red one (nitrides with europium), as manufacturers list them; values tried of each.
_PUMP_NM, _PHOSPHORS_NM = (440.0, 465.0), ((530.0, 570.0), (90.0, 130.0), (600.0, 650.0), (70.0, 110.0))
_PUMP_STEPS, _PHOSPHOR_STEPS = 4, (4, 2, 4, 2)
_C2_NM_K = 1.438777e7  # second radiation constant of Planck's law
#: Weights of the families: each lamp, each lamp reflected by coloured surfaces, each kind of lamp, and all lamps.
_BARE, _COLOURED, _KIND, _ANY = 1.0, 2.0, 1.0, 1.0


@dataclass(frozen=True)
class LightPrior:
    """Prior as a mixture of families of spectra; each is described by the second moment of spectra of luminance 1.

    Parameters
    ----------
    moment : (n, 61, 61) float64
    share : (n,) float64
        Prior probability of each family; the sum is one.
    broad : int
        Number of families, at the end of the list, that comprise any light. They are always kept.
    common : CommonErrors, optional
        Errors of the first families that they share with the response model of the camera.
    """

    moment: np.ndarray
    share: np.ndarray
    broad: int
    common: "CommonErrors | None" = None


@dataclass(frozen=True)
class CommonErrors:
    """Errors that families have in common with the response of a camera: lamps that were estimated together with it.

    Lamp ``l`` is the mean plus its ``k`` errors, each multiplied by a standard normal number. The numbers are those of
    the errors of the response. The second moment of a family is the sum, over lamps and factors, of weight times second
    moment of the lamp times factor.

    Parameters
    ----------
    mean : (lamps, 61) float64
    errors : (lamps, k, 61) float64
    weight : (2, m, lamps) float64
        Weights for each of the first m families.
    factor : (2, 61, 61) float64
        Second moments of the relative difference of a lamp from its mean, and of reflectances.
    """

    mean: np.ndarray
    errors: np.ndarray
    weight: np.ndarray
    factor: np.ndarray


def published_lamps() -> np.ndarray:
    """Return the illuminants and measured lamps of colour-science, scaled to luminance 1, (lamps, 61).

    These are CIE A to E, the D series, fluorescent, high-pressure and LED illuminants, indoor daylight, the illuminants
    of ISO 7589, and measured discharge lamps, incandescent lamps and LEDs.
    """
    lamps = np.concatenate(
        [np.stack([spectrum(name) for name in ILLUMINANTS]), published_table("light_sources").at(WAVELENGTH_NM)]
    )
    return of_luminance_one(lamps)


def led_lamps() -> list[np.ndarray]:
    """Return spectra of lamps of a red, a green and a blue LED, each of luminance 1, (lamps, 61) by temperature.

    The published spectra hold almost no such lamp, and its narrow peaks resemble those of no other. For every
    temperature, the peak wavelengths take all combinations of a regular grid.

    References
    ----------
    Shape of an LED: Ohno, Y. (2005), Spectral design considerations for white LED color rendering, Optical Engineering
    44(11), 111302, eq. (2).
    """
    peaks = _combinations(*(_middles(_LED_STEPS, *reach) for reach in _LED_PEAKS_NM))
    return _white_lamps(_led(peaks, np.array(_LED_WIDTHS_NM)))


def phosphor_led_lamps() -> list[np.ndarray]:
    """Return spectra of white LEDs of luminance 1, (lamps, 61) by temperature: a blue LED with two phosphors.

    Peaks and widths take all combinations of a regular grid. The emission of a phosphor is a Gaussian.
    """
    phosphors = (_middles(steps, *reach) for steps, reach in zip(_PHOSPHOR_STEPS, _PHOSPHORS_NM, strict=True))
    pump, green, green_width, red, red_width = _combinations(_middles(_PUMP_STEPS, *_PUMP_NM), *phosphors).T
    peaks, widths = (np.stack(pair, axis=1)[..., None] for pair in ((green, red), (green_width, red_width)))
    bands = np.exp(-4.0 * np.log(2.0) * ((WAVELENGTH_NM - peaks) / widths) ** 2)
    return _white_lamps(np.concatenate([_led(pump[:, None], np.array(_LED_WIDTHS_NM[:1])), bands], axis=1))


def _middles(steps: int, low: float, high: float) -> np.ndarray:
    """Return the middles of equal parts of a range."""
    return low + (high - low) * (np.arange(steps) + 0.5) / steps


def _combinations(*values: np.ndarray) -> np.ndarray:
    """Return all combinations of values, one of each array, (n, arrays)."""
    return np.stack(np.meshgrid(*values), axis=-1).reshape(-1, len(values))


def _led(peaks: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Return spectra of LEDs (..., n, 61) with peaks (..., n) and widths (n,), nm."""
    bell = np.exp(-(((WAVELENGTH_NM - peaks[..., None]) / widths[:, None]) ** 2))
    return (bell + 2.0 * bell**5) / 3.0


def _white_lamps(emitters: np.ndarray) -> list[np.ndarray]:
    """Return lamps of luminance 1, (m, 61) for each temperature, from the spectra of three emitters, (n, 3, 61).

    The powers of the emitters match the tristimulus values of a black body. Emitters of which one would need a negative
    power make no lamp.
    """
    matching, found = colour_matching_weights(), []
    black_body = WAVELENGTH_NM**-5.0 / np.expm1(_C2_NM_K / (WAVELENGTH_NM * np.array(_LED_TEMPERATURES_K)[:, None]))
    for white in black_body @ matching.T:
        powers = np.linalg.solve((emitters @ matching.T).swapaxes(1, 2), white[:, None])
        lamps = (powers.swapaxes(1, 2) @ emitters)[:, 0]
        found.append(of_luminance_one(lamps[(powers >= 0.0).all(axis=(1, 2))]))
    return found


def of_luminance_one(lamps: np.ndarray) -> np.ndarray:
    """Scale spectra of lamps, (lamps, 61), to luminance 1 each."""
    return lamps / (lamps @ colour_matching_weights()[1])[:, None]


def _surfaces() -> np.ndarray:
    """Return the second moment of reflectances of mean 1: patches, mixed paints, and products for two reflections."""
    patches = chart_spectra(_CHART)[1]
    first, second = np.triu_indices(len(patches))
    known = np.concatenate([patches, mix_paints(patches), patches[first] * patches[second]])
    known = known / known.mean(axis=1, keepdims=True)
    return known.T @ known / len(known) + _spread(_OF_SURFACES)


def seen_moment() -> np.ndarray:
    """Return the matrix, (61, 61), that gives the mean square of the colours, as differences of CIELAB, of surfaces.

    Colours of a light L(λ) on surfaces are linear near white: L* changes by 116/3 of the relative Y, a* by 500/3 of the
    difference of relative X and Y, b* by 200/3 of that of Y and Z. Their mean square is quadratic in L.
    """
    x, y, z = (row / row.sum() for row in colour_matching_weights())
    seen = np.stack([116.0 * y, 500.0 * (x - y), 200.0 * (y - z)]) / 3.0
    return (seen.T @ seen) * _surfaces()


def _spread(spread: tuple[float, float]) -> np.ndarray:
    deviation, length_nm = spread
    return deviation**2 * smooth_covariance(length_nm)


def _alike(moments: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of the lamps most similar to each one, itself first, (lamps, count).

    The similarity is the cosine between second moments.
    """
    size = np.sqrt(np.einsum("nij,nij->n", moments, moments))
    flat = moments.reshape(len(moments), -1)
    return np.argsort(-(flat @ flat.T) / (size[:, None] * size), axis=1, kind="stable")[:, :count]


def families_of(lamps: np.ndarray, alike: int = _ALIKE, deviation: float | np.ndarray = _OF_LAMPS) -> LightPrior:
    """Make the prior from lamps, each given by the second moment of its spectrum.

    Parameters
    ----------
    lamps : (n, 61, 61) float64
    alike : int
        Number of similar lamps that form a kind.
    deviation : float or (n,) float
        Standard deviation of the smooth relative difference from a given lamp.
    """
    kinds = _alike(lamps, alike)
    moments = _families(lamps * _near(np.broadcast_to(deviation, len(lamps))), lamps * _surfaces(), kinds)
    count = len(lamps)
    weights = zip((count, count, count, 2), (_BARE, _COLOURED, _KIND, _ANY), strict=True)
    share = np.concatenate([np.full(families, weight / families) for families, weight in weights])
    return LightPrior(moments, share / share.sum(), 2)


def families_with_errors(mean: np.ndarray, errors: np.ndarray, deviation: float) -> LightPrior:
    """Make the prior from lamps that were estimated together with the response of a camera.

    Parameters
    ----------
    mean : (lamps, 61) float64
    errors : (lamps, k, 61) float64
        See `CommonErrors`.
    deviation : float
        Standard deviation of the smooth relative difference from an estimated lamp.
    """
    moments = mean[:, :, None] * mean[:, None] + errors.swapaxes(1, 2) @ errors
    prior, kinds = families_of(moments, len(mean), deviation), _alike(moments, len(mean))
    own, none = np.eye(len(mean))[:, :, None], np.zeros((len(mean), len(mean), 1))
    weight = np.stack([_families(own, none, kinds), _families(none, own, kinds)])[..., 0]
    factor = np.stack([_near(np.array([deviation]))[0], _surfaces()])
    return replace(prior, common=CommonErrors(mean, errors, weight, factor))


def _near(deviation: np.ndarray) -> np.ndarray:
    """Return the second moments, (n, 61, 61), of a smooth relative difference of given standard deviations, (n,)."""
    return 1.0 + np.square(deviation)[:, None, None] * smooth_covariance(_LENGTH_NM)


def differences_from(lamp: np.ndarray, deviation: float) -> np.ndarray:
    """Return the covariance, (61, 61), of smooth relative differences from a lamp, (61,), at constant luminance."""
    visible = colour_matching_weights()[1] * lamp
    of_spectrum = np.eye(len(lamp)) - visible / visible.sum()
    return of_spectrum @ _spread((deviation, _LENGTH_NM)) @ of_spectrum.T


def _families(bare: np.ndarray, coloured: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """Return values of all families from those of lamps and of lamps on surfaces, (lamps, ...) each.

    The families are each lamp, each lamp on surfaces, each kind, all lamps, and all lamps on surfaces.
    """
    return np.concatenate(
        [bare, coloured, bare[kinds].mean(axis=1), bare.mean(axis=0)[None], coloured.mean(axis=0)[None]]
    )


def light_prior(lamps: np.ndarray, deviation: float | np.ndarray = _OF_LAMPS) -> LightPrior:
    """Make the prior from spectra of lamps, (lamps, 61); for the deviation see `families_of`."""
    return families_of(lamps[:, :, None] * lamps[:, None, :], deviation=deviation)


def prior_of_any_lamp(lamps: np.ndarray | None = None) -> LightPrior:
    """Make the prior of a place whose lamps are unknown: published lamps, lamps of three LEDs, and white LEDs.

    Parameters
    ----------
    lamps : (n, 61) float64, optional
        Spectra of published lamps, by default all of them.
    """
    lamps, leds = published_lamps() if lamps is None else lamps, [*led_lamps(), *phosphor_led_lamps()]
    of_leds = np.stack([some.T @ some / len(some) for some in leds])
    return families_of(np.concatenate([lamps[:, :, None] * lamps[:, None, :], of_leds]))
