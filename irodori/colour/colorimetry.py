"""Tristimulus values, CIELAB and CIEDE2000 from spectra [eq. 6].

The weights of the 61 samples include the wavelengths beyond the grid, so that a picture takes one matrix product.
CIEDE2000 is implemented here, because importing the library colour-science, with which tests compare it, takes longer
than most jobs need to compute their errors.
"""

from functools import lru_cache

import numpy as np

from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM
from irodori.spectra.published import light
from irodori.spectra.published_names import ILLUMINANTS
from irodori.spectra.published_tables import published_table

_OBSERVER = "CIE 1931 2 Degree Standard Observer"
_FINE_NM = np.arange(360.0, 831.0, 1.0)


@lru_cache(maxsize=16)
def colour_matching_weights(observer_name: str = _OBSERVER) -> np.ndarray:
    """Return weights that integrate a spectrum on the grid against the colour-matching functions.

    The spectrum is taken as piecewise linear between samples and held at its end values outside 400..700 nm; the
    functions are the observer's 1 nm table, 360..830 nm.

    Parameters
    ----------
    observer_name : str
        Of `irodori.spectra.published_names.OBSERVERS`.

    Returns
    -------
    (3, 61) float64, nm
    """
    table = published_table(f"observers/{observer_name}")
    # Some tables begin at 390 nm; the functions are zero below.
    functions = np.stack([np.interp(_FINE_NM, table.wavelength_nm, f, left=0.0, right=0.0) for f in table.spectra])
    hat = np.stack([np.interp(_FINE_NM, WAVELENGTH_NM, row) for row in np.eye(SAMPLES)])
    return functions @ hat.T


def xyz_from_radiance(white: np.ndarray) -> np.ndarray:
    """Return the matrix from spectral radiance to XYZ, scaled so that a white has Y = 100 [eq. 6].

    Parameters
    ----------
    white : (61,) float
        Radiance of white, on the scale of the radiances to be converted.

    Returns
    -------
    (3, 61) float64
    """
    weights = colour_matching_weights()
    return weights * (100.0 / (weights[1] @ white))


@lru_cache(maxsize=16)
def xyz_from_reflectance(light_name: str) -> np.ndarray:
    """Return the matrix from reflectance factor to XYZ under a light; a perfect diffuser has Y = 100 [eq. 6].

    The light is used at its tabulated wavelengths (1 nm, interpolated) so that the tails beyond 400..700 nm carry
    their real power while the reflectance is held at its end values.

    Returns
    -------
    (3, 61) float64
    """
    functions = published_table(f"observers/{_OBSERVER}").at(_FINE_NM)
    if light_name in ILLUMINANTS:
        power = published_table(f"illuminants/{light_name}").at(_FINE_NM)[0]
    else:
        power = np.interp(_FINE_NM, WAVELENGTH_NM, light(light_name))
    hat = np.stack([np.interp(_FINE_NM, WAVELENGTH_NM, row) for row in np.eye(SAMPLES)])
    weights = (functions * power) @ hat.T
    return weights * (100.0 / (functions[1] @ power))


def lab_from_xyz(xyz: np.ndarray, white_xyz: np.ndarray) -> np.ndarray:
    """Return CIELAB of tristimulus values.

    Parameters
    ----------
    xyz : (..., 3) float, any scale
    white_xyz : (3,) float, same scale

    Examples
    --------
    A grey with a fifth of the white's luminance has a medium lightness and no chroma:

    >>> lab_from_xyz([0.2, 0.2, 0.2], [1.0, 1.0, 1.0]).round(1).tolist()
    [51.8, 0.0, 0.0]
    """
    ratio = np.asarray(xyz, dtype=np.float64) / np.asarray(white_xyz, dtype=np.float64)
    linear = ratio <= (6 / 29) ** 3
    f = np.where(linear, ratio * (29 / 6) ** 2 / 3 + 4 / 29, np.cbrt(ratio))
    return np.stack(
        [116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])],
        axis=-1,
    )


def delta_e(lab_a: np.ndarray, lab_b: np.ndarray) -> np.ndarray:
    """Return the colour difference CIEDE2000 between two (..., 3) arrays of CIELAB, (...) float64.

    Variables are named as in CIE 142:2001; angles are in radians.

    Examples
    --------
    The first pair of colours that Sharma, Wu and Dalal published with the formula:

    >>> float(delta_e([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485]).round(4))
    2.0425
    """
    (l_1, a_1, b_1), (l_2, a_2, b_2) = (np.moveaxis(np.asarray(lab, dtype=np.float64), -1, 0) for lab in (lab_a, lab_b))
    stretch = 1.5 - 0.5 * _saturation((np.hypot(a_1, b_1) + np.hypot(a_2, b_2)) / 2)
    a_1, a_2 = stretch * a_1, stretch * a_2
    c_1, c_2 = np.hypot(a_1, b_1), np.hypot(a_2, b_2)
    h_1, h_2 = np.arctan2(b_1, a_1) % (2 * np.pi), np.arctan2(b_2, a_2) % (2 * np.pi)
    is_grey = c_1 * c_2 == 0  # a grey has no hue: the mean is the other one's, for its own is 0
    turn = np.where(is_grey, 0.0, h_2 - h_1)
    h_mean = np.where(is_grey, h_1 + h_2, (h_1 + h_2) / 2)
    # Hues more than half a circle apart are nearer to each other the other way round.
    is_far = np.abs(turn) > np.pi
    h_mean = np.where(is_far, h_mean + np.where(h_1 + h_2 < 2 * np.pi, np.pi, -np.pi), h_mean)
    turn = np.where(is_far, turn - np.copysign(2 * np.pi, turn), turn)
    c_mean, from_middle = (c_1 + c_2) / 2, ((l_1 + l_2) / 2 - 50) ** 2
    t, rotation = _hue_terms(h_mean, c_mean)
    lightness = (l_2 - l_1) / (1 + 0.015 * from_middle / np.sqrt(20 + from_middle))
    chroma = (c_2 - c_1) / (1 + 0.045 * c_mean)
    hue = 2 * np.sqrt(c_1 * c_2) * np.sin(turn / 2) / (1 + 0.015 * c_mean * t)
    return np.sqrt(np.maximum(lightness**2 + chroma**2 + hue**2 + rotation * chroma * hue, 0.0))


def delta_e_metric(lab: np.ndarray) -> np.ndarray:
    """Return the metric of CIEDE2000: the matrix M with which small differences d of CIELAB have the square dᵀ M d.

    It is the formula of `delta_e` for two colours that approach each other.

    Parameters
    ----------
    lab : (..., 3) float

    Returns
    -------
    (..., 3, 3) float64
    """
    lightness, a, b = np.moveaxis(np.asarray(lab, dtype=np.float64), -1, 0)
    stretch = 1.5 - 0.5 * _saturation(np.hypot(a, b))
    a = stretch * a
    chroma = np.hypot(a, b)
    is_grey = chroma == 0.0
    cosine, sine = np.where(is_grey, 1.0, a / np.where(is_grey, 1.0, chroma)), b / np.where(is_grey, 1.0, chroma)
    t, rotation = _hue_terms(np.arctan2(b, a) % (2 * np.pi), chroma)
    from_middle = (lightness - 50) ** 2
    of_lightness = 1 / (1 + 0.015 * from_middle / np.sqrt(20 + from_middle))
    of_chroma, of_hue = 1 / (1 + 0.045 * chroma), 1 / (1 + 0.015 * chroma * t)
    mixed = 0.5 * rotation * of_chroma * of_hue
    # Along chroma and hue, which are turned into a and b.
    cc, hh = of_chroma**2, of_hue**2
    aa = cc * cosine**2 + hh * sine**2 - 2 * mixed * cosine * sine
    bb = cc * sine**2 + hh * cosine**2 + 2 * mixed * cosine * sine
    ab = (cc - hh) * cosine * sine + mixed * (cosine**2 - sine**2)
    out = np.zeros((*lightness.shape, 3, 3))
    out[..., 0, 0], out[..., 1, 1], out[..., 2, 2] = of_lightness**2, stretch**2 * aa, bb
    out[..., 1, 2] = out[..., 2, 1] = stretch * ab
    return out


def _hue_terms(h_mean: np.ndarray, c_mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the terms T and R_T of CIEDE2000 for mean hues, rad, and mean chromas."""
    t = (
        1
        - 0.17 * np.cos(h_mean - np.pi / 6)
        + 0.24 * np.cos(2 * h_mean)
        + 0.32 * np.cos(3 * h_mean + np.pi / 30)
        - 0.20 * np.cos(4 * h_mean - np.radians(63))
    )
    blue = np.radians(30) * np.exp(-(((np.degrees(h_mean) - 275) / 25) ** 2))
    return t, -2 * _saturation(c_mean) * np.sin(2 * blue)


def _saturation(chroma: np.ndarray) -> np.ndarray:
    """Return sqrt(C^7 / (C^7 + 25^7)) of CIEDE2000 for a chroma C: 0 for grey, near 1 for strong colours."""
    seventh = chroma**7
    return np.sqrt(seventh / (seventh + 25.0**7))


def delta_e_xyz(xyz: np.ndarray, other: np.ndarray, white_xyz: np.ndarray) -> np.ndarray:
    """Return CIEDE2000, (...), between tristimulus values, (..., 3), for a white, (3,)."""
    return delta_e(lab_from_xyz(xyz, white_xyz), lab_from_xyz(other, white_xyz))


def delta_e_of_light(truth: np.ndarray, estimate: np.ndarray, white_xyz: np.ndarray) -> np.ndarray:
    """Return `delta_e_xyz`; pairs whose first is brighter than white are scaled down to white's luminance.

    CIELAB is defined for surface colours; without the scaling, the error of a lamp would grow with its brightness.
    """
    scale = np.maximum(truth[..., 1:2] / white_xyz[1], 1.0)
    return delta_e_xyz(truth / scale, estimate / scale, white_xyz)


def delta_e_reflectance(truth: np.ndarray, estimate: np.ndarray, light_name: str = "D65") -> np.ndarray:
    """Return CIEDE2000 between reflectance factors under a light, 2° observer.

    Parameters
    ----------
    truth, estimate : (..., 61) float

    Returns
    -------
    (...) float64
    """
    matrix = xyz_from_reflectance(light_name)
    white = matrix.sum(axis=1)
    return delta_e_xyz(truth @ matrix.T, estimate @ matrix.T, white)


def summary(values: np.ndarray) -> dict[str, float]:
    """Return mean, 95th and 99th percentile and maximum of the finite values, with their count."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    if finite.size == 0:
        return {"count": 0, "mean": np.nan, "p95": np.nan, "p99": np.nan, "max": np.nan}
    return {
        "count": int(finite.size),
        "mean": float(finite.mean()),
        "p95": float(np.percentile(finite, 95)),
        "p99": float(np.percentile(finite, 99)),
        "max": float(finite.max()),
    }


def spectral_rmse(truth: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """Return the root mean square difference of spectra over their last axis, the wavelength."""
    difference = np.asarray(truth, dtype=np.float64) - np.asarray(estimate, dtype=np.float64)
    return np.sqrt(np.vecdot(difference, difference) / difference.shape[-1])


def goodness_of_fit(truth: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """Return the goodness-of-fit coefficient (GFC): |cosine| of the angle between spectra; NaN where one is zero."""
    norms = np.linalg.norm(truth, axis=-1) * np.linalg.norm(estimate, axis=-1)
    dot = np.sum(np.asarray(truth) * np.asarray(estimate), axis=-1)
    return np.divide(np.abs(dot), norms, out=np.full(np.shape(dot), np.nan), where=norms > 0)
