"""Photographs predicted from the others: a material is fitted without each in turn, and that photograph is rendered.

Levels and directions of the lamps were found beforehand with all photographs: of the one that is left out three numbers
are used, the level of its lamp and its direction, and none of its pixels tells the material. Beside it stands the
prediction for the direction that was known before, in which one number is used, the level.
"""

from typing import NamedTuple

import numpy as np

from irodori.fitting.one_gloss import OneGloss, fit_one_gloss, matt
from irodori.fitting.solvers import FitOptions
from irodori.rectification.lamp_registration import Lamps, geometry_of

#: Photographs that must show a place, so that its diffuse weight is not that of one reading.
_FEWEST = 3
MATT = "none"


class Prediction(NamedTuple):
    """Predictions of all photographs.

    Parameters
    ----------
    rendered : (T, J) float64
        In the unit of the responses; NaN where the other photographs do not show a place.
    error, by_file : (J,) float64
        Root mean square of the difference over the mean response of the photograph, for the lamp's direction as
        registered and as known before.
    """

    rendered: np.ndarray
    error: np.ndarray
    by_file: np.ndarray


def fitted(response, geometry, weight, lobe: str, n: float, k: float) -> OneGloss:
    """Return the fit of one gloss, or none for `MATT`; parameters as in `irodori.fitting.one_gloss.fit_one_gloss`."""
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
        Weight is 0 where a place is not seen or lit, or near the terminator: it is neither fitted nor compared.
    normal, view : (T, 3) float
    lamps : Lamps
        As registered.
    known : (J, 3) float
        Directions to the lamps as known before.
    lobe : str
        Of the gloss; ``none`` for diffuse reflection alone.
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
