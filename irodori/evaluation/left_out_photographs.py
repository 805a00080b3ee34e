"""Leave-one-out test of photographs: the material is fitted without each in turn, and that photograph is rendered.

The pixels of the left-out photograph do not enter the fit of the material. Only the level and the direction of its lamp
(three numbers) were estimated beforehand from all photographs. A second prediction uses the direction that was known
before this estimate; only the level (one number) then comes from the left-out photograph.
"""

from typing import NamedTuple

import numpy as np

from irodori.fitting.one_gloss import OneGloss, fit_one_gloss, matt
from irodori.fitting.solvers import FitOptions
from irodori.rectification.lamp_registration import Lamps, geometry_of

#: The fewest photographs that must show a place, so that its diffuse weight does not rest on a single response.
_FEWEST = 3
MATT = "none"


class Prediction(NamedTuple):
    """Predictions of all photographs.

    Parameters
    ----------
    rendered : (T, J) float64
        Predicted responses; NaN where fewer than three of the other photographs show a place.
    error : (J,) float64
        RMS difference divided by the mean response of the photograph, with the estimated direction of the lamp.
    by_file : (J,) float64
        The same with the direction that was known before.
    """

    rendered: np.ndarray
    error: np.ndarray
    by_file: np.ndarray


def fitted(response, geometry, weight, lobe: str, n: float, k: float) -> OneGloss:
    """Fit diffuse reflection with one gloss for all places, or without gloss if ``lobe`` is `MATT`.

    The other parameters are those of `irodori.fitting.one_gloss.fit_one_gloss`.
    """
    if lobe == MATT:
        return matt(response, geometry, weight, "gaussian", n, k)
    return fit_one_gloss(response, geometry, weight, FitOptions(lobes=(lobe,)), n, k)


def predict_left_out(
    response, normal, view, weight, lamps: Lamps, known, *, lobe: str, n: float, k: float
) -> Prediction:
    """Predict every photograph from the others.

    Parameters
    ----------
    response, weight : (T, J) float
        Responses of T places in J photographs. Those with a weight of 0 (not seen, not lit, or near the terminator)
        are neither fitted nor compared.
    normal, view : (T, 3) float
        Unit vectors: surface normals and directions to the camera.
    lamps : Lamps
        Levels and directions estimated from all photographs.
    known : (J, 3) float
        Directions to the lamps that were known before.
    lobe : str
        Lobe of the gloss; ``none`` for diffuse reflection alone.
    n, k : float
        Complex refractive index.
    """
    geometry, before = geometry_of(normal, view, lamps.direction), geometry_of(normal, view, known)
    even, count = response / lamps.level, len(known)
    rendered, error, by_file = np.full(response.shape, np.nan), np.full(count, np.nan), np.full(count, np.nan)
    for left_out in range(count):
        kept = weight.copy()
        kept[:, left_out] = 0.0
        surface = fitted(even, geometry, kept, lobe, n, k)
        told = (kept > 0.0).sum(axis=1) >= _FEWEST
        rendered[told, left_out] = (lamps.level[left_out] * surface.rendered(geometry[:, left_out]))[told]
        here = told & (weight[:, left_out] > 0.0)
        real, mean = response[here, left_out], response[here, left_out].mean()
        error[left_out] = np.sqrt(np.mean((rendered[here, left_out] - real) ** 2)) / mean
        other = surface.rendered(before[:, left_out])[here]
        level = (other @ real) / (other @ other)
        by_file[left_out] = np.sqrt(np.mean((level * other - real) ** 2)) / mean
    return Prediction(rendered, error, by_file)
