"""Leave-one-out test of photographs: the material is fitted without each in turn, and that photograph is rendered.

The pixels of the left-out photograph do not enter the fit of the material. Only the level and the direction of its lamp
(three numbers) were estimated beforehand from all photographs. A second prediction uses the direction that was known
before this estimate; only the level (one number) then comes from the left-out photograph.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from irodori.fitting.one_gloss import OneGloss, fit_surface
from irodori.rectification.lamp_registration import Lamps, geometry_of

#: The fewest photographs that must show a place, so that its diffuse weight does not rest on a single response.
_FEWEST = 3


class Surface(Protocol):
    """A fitted surface of T places."""

    def rendered(self, direction: np.ndarray) -> np.ndarray:
        """Return the responses (T,) under a lamp of level 1 in a direction (3,); NaN where the surface is not known."""
        ...

    def lit(self, direction: np.ndarray) -> np.ndarray:
        """Return the places that face a lamp in a direction (3,), away from the terminator, (T,) bool."""
        ...

    def in_shadow(self, response: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """Return the places that another part of the object shades, (T,) bool, from real and rendered responses."""
        ...


class KnownShape(NamedTuple):
    """A fitted convex surface of known shape at T places.

    Parameters
    ----------
    surface : OneGloss
        Diffuse weights and gloss.
    normal, view : (T, 3) float
        Unit vectors: surface normals and directions to the camera.
    told : (T,) bool
        Places that enough photographs show.
    """

    surface: OneGloss
    normal: np.ndarray
    view: np.ndarray
    told: np.ndarray

    def rendered(self, direction) -> np.ndarray:
        """Return the responses under a lamp of level 1, see `Surface`."""
        geometry = geometry_of(self.normal, self.view, np.asarray(direction)[None])
        return np.where(self.told, self.surface.rendered(geometry[:, 0]), np.nan)

    def lit(self, direction) -> np.ndarray:
        """Return all places: those that are not lit have the weight 0 already."""
        return np.ones(len(self.normal), dtype=bool)

    def in_shadow(self, response, shown) -> np.ndarray:
        """Return no place, because a convex object does not shade itself."""
        return np.zeros(len(self.normal), dtype=bool)


def fit_known_shape(
    response, weight, lamps: Lamps, normal, view, *, lobe: str, n: float, k: float, geometry=None
) -> KnownShape:
    """Fit diffuse weights and one gloss to the responses (T, J) of a convex surface of known shape.

    The parameters are those of `irodori.fitting.one_gloss.fit_surface` and of `KnownShape`. The angles ``geometry``,
    (T, J, 4), may be given where they are known, for several fits.
    """
    if geometry is None:
        geometry = geometry_of(normal, view, lamps.direction)
    surface = fit_surface(response / lamps.level, geometry, weight, lobe, n, k)
    return KnownShape(surface, normal, view, (weight > 0.0).sum(axis=1) >= _FEWEST)


class Prediction(NamedTuple):
    """Predictions of all photographs.

    Parameters
    ----------
    rendered : (T, J) float64
        Predicted responses; NaN where the other photographs do not determine a place.
    error : (J,) float64
        RMS difference divided by the mean response of the photograph, with the estimated direction of the lamp.
    by_file : (J,) float64
        The same with the direction that was known before.
    shadow : (J,) float64
        Share of the places that the lamp would light if no other part of the object stood before it. They are not
        compared.
    compared : (T, J) bool
        Places at which each photograph is compared.
    """

    rendered: np.ndarray
    error: np.ndarray
    by_file: np.ndarray
    shadow: np.ndarray
    compared: np.ndarray


def predict_left_out(response, weight, lamps: Lamps, known, fit: Callable[[np.ndarray], Surface]) -> Prediction:
    """Predict every photograph from the others.

    Parameters
    ----------
    response, weight : (T, J) float
        Responses of T places in J photographs. Those with a weight of 0 (not seen, not lit, or clipped) are not
        compared.
    lamps : Lamps
        Levels and directions estimated from all photographs.
    known : (J, 3) float
        Directions to the lamps that were known before.
    fit : callable
        Fits the surface to all responses, with weights (T, J) that are 0 for the photograph that is left out.
    """
    count = len(known)
    rendered = np.full(response.shape, np.nan)
    error, by_file, shadow = (np.full(count, np.nan) for _ in range(3))
    compared = np.zeros(response.shape, dtype=bool)
    for left_out in range(count):
        kept = np.array(weight)
        kept[:, left_out] = 0.0
        surface, real = fit(kept), response[:, left_out]
        shown = lamps.level[left_out] * surface.rendered(lamps.direction[left_out])
        rendered[:, left_out] = shown
        here = np.isfinite(shown) & (weight[:, left_out] > 0.0) & surface.lit(lamps.direction[left_out])
        dark = here & surface.in_shadow(real, shown)
        shadow[left_out] = float(dark.sum()) / max(float(here.sum()), 1.0)
        here &= ~dark
        compared[:, left_out] = here
        real, shown, other = real[here], shown[here], surface.rendered(known[left_out])[here]
        error[left_out] = np.sqrt(np.mean((shown - real) ** 2)) / real.mean()
        level = (other @ real) / (other @ other)
        by_file[left_out] = np.sqrt(np.mean((level * other - real) ** 2)) / real.mean()
    return Prediction(rendered, error, by_file, shadow, compared)
