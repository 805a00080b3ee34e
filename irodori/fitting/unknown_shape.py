"""Fit of a surface of unknown shape: normals and diffuse weights of all places, and one gloss for all of them.

Normals and gloss are estimated in turn. The normals are those of `irodori.rectification.photometric_stereo`, from
responses without their gloss; the gloss is that of `irodori.fitting.one_gloss` with these normals. Because neither is
known at first, a grid of glosses is tried on some places, and the search goes on from the best.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from irodori.fitting.one_gloss import MATT, fit_one_gloss
from irodori.fitting.paint_gloss import PaintGloss
from irodori.fitting.solvers import FitOptions
from irodori.rectification.lamp_registration import Lamps, cosine_to_half, geometry_of, perpendiculars
from irodori.rectification.photometric_stereo import (
    AGREES,
    FEWEST,
    LEAST_COSINE,
    LEVEL_ERROR,
    QUARTER,
    Facets,
    fit_facets,
    misfit_of,
    refine_lamps,
)
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import LobeAtAngles

#: Responses below this share of the rendered ones are in the shadow of another part of the object.
SHADOW = 0.5
#: Places with which the gloss is searched, and from which it is estimated then.
_SEARCHED, _ESTIMATED = 300, 1200
#: Glosses with which the search begins: β relative to the median of α, and μ in rad.
_BETAS, _MUS = (2.0, 6.0, 18.0), (0.07, 0.15, 0.3, 0.5)
#: Rounds in which normals and gloss, places and lamps, or normals with a known gloss are estimated.
_GLOSS_ROUNDS, _LAMP_ROUNDS, _NORMAL_ROUNDS = 4, 10, 4
#: Turn by which derivatives of the gloss are taken, and largest turn of a normal in one step, rad; largest relative
#: change of a diffuse weight in one step.
_TURN, _LARGEST_TURN, _LARGEST_CHANGE = 0.01, 0.15, 0.5
#: Difference from the model, relative to α, at which a response counts half when glosses are compared.
_HALF = 0.03
_VIEW = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class UnknownShape:
    """Normals, diffuse weights and common gloss of T places, seen from far away.

    Parameters
    ----------
    facets : Facets
        Normals and diffuse weights.
    lobe : str
        Lobe of the gloss; ``none`` without gloss.
    n, k : float
        Complex refractive index.
    gloss : PaintGloss or None
        Common gloss; None if the places show no gloss.
    """

    facets: Facets
    lobe: str
    n: float
    k: float
    gloss: PaintGloss | None = None

    @property
    def beta(self) -> float:
        """Weight of the gloss, in the unit of the responses; 0 without gloss."""
        return 0.0 if self.gloss is None else float(np.exp(self.gloss.log_gloss[0]))

    @property
    def mu(self) -> float:
        """Roughness, rad; NaN without gloss."""
        return np.nan if self.gloss is None else float(np.exp(self.gloss.log_gloss[1]))

    def lit(self, direction) -> np.ndarray:
        """Return the places that face a lamp, away from the terminator, (T,) bool; ``direction`` (3,) to the lamp."""
        with np.errstate(invalid="ignore"):
            return self.facets.normal @ direction > LEAST_COSINE

    def in_shadow(self, response, shown) -> np.ndarray:
        """Return the places, (T,) bool, that are much darker than rendered: others stand between them and the lamp."""
        with np.errstate(invalid="ignore"):
            return response < SHADOW * shown

    def rendered(self, direction) -> np.ndarray:
        """Return the responses (T,) under a lamp of level 1 in a direction (3,); NaN at places without a normal."""
        one = np.asarray(direction, dtype=np.float64)[None]
        return self._rendered(Lamps(one, np.ones(1), np.zeros(1)))[:, 0]

    def _known_normals(self) -> np.ndarray:
        return np.where(self.facets.told[:, None], self.facets.normal, _VIEW)

    def _rendered(self, lamps: Lamps) -> np.ndarray:
        cosine = np.maximum(self.facets.normal @ lamps.direction.T, 0.0)
        return lamps.level * (self.facets.alpha[:, None] * cosine + self._shine(lamps.direction, self._known_normals()))

    def at_other_places(self, response, usable, lamps: Lamps) -> "UnknownShape":
        """Return the surface with the same gloss at other places, with responses (T, J) as in `fit_unknown_shape`."""
        response = np.asarray(response, dtype=np.float64)
        facets = fit_facets(response, usable, lamps.light, misfit=self.facets.misfit)
        return replace(self, facets=facets)._converged(response, usable, lamps)

    def _shine(self, direction, normal) -> np.ndarray:
        """Return the gloss at places with normals (T, 3) under J lamps of level 1, (T, J)."""
        if self.gloss is None:
            return np.zeros((len(normal), len(direction)))
        lobe = LobeAtAngles.under_lamps(self.lobe, normal, np.broadcast_to(_VIEW, normal.shape), direction)
        fresnel = fresnel_array(cosine_to_half(_VIEW, direction), self.n, self.k)
        return self.beta * fresnel * lobe.value(self.mu)

    def _with_normals(self, response, usable, lamps: Lamps) -> "UnknownShape":
        """Return the surface after a Gauss-Newton step of normals and diffuse weights, with the gloss as it is."""
        told, light = self.facets.told, lamps.light
        alpha = np.where(told, self.facets.alpha, 1.0)[:, None]
        normal = np.where(told[:, None], self.facets.normal, _VIEW)
        first, second = perpendiculars(normal)
        shine, by_first, by_second = (
            lamps.level * self._shine(lamps.direction, _unit(normal + _TURN * turn)) / alpha
            for turn in (np.zeros_like(normal), first, second)
        )
        cosine = normal @ light.T
        left = response / alpha - np.maximum(cosine, 0.0) - shine
        used = usable & told[:, None] & (cosine > LEAST_COSINE * lamps.level)
        square = (QUARTER * misfit_of(left, used)) ** 2
        weight = np.where(used, (square / (square + left**2)) ** 2, 0.0)
        by = np.stack([cosine, first @ light.T + (by_first - shine) / _TURN,
                       second @ light.T + (by_second - shine) / _TURN], axis=-1)  # fmt: skip
        matrix = np.einsum("tja,tj,tjb->tab", by, weight, by)
        matrix += (1e-9 + 1e-3 * np.trace(matrix, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        step = np.linalg.solve(matrix, np.einsum("tja,tj->ta", by, weight * left)[..., None])[..., 0]
        change, one, other = np.clip(
            step, *(np.array([_LARGEST_CHANGE, _LARGEST_TURN, _LARGEST_TURN]) * s for s in (-1, 1))
        ).T
        normal = _unit(normal + one[:, None] * first + other[:, None] * second)
        good = told & (np.count_nonzero(weight > AGREES, axis=1) >= FEWEST) & (normal[:, 2] > 0.0)
        return replace(self, facets=Facets(
            np.where(good[:, None], normal, np.nan), np.where(good, alpha[:, 0] * (1.0 + change), np.nan),
            np.where(good[:, None], weight, 0.0), misfit_of(left, weight > AGREES),
        ))  # fmt: skip

    def _with_gloss(self, response, usable, lamps: Lamps) -> "UnknownShape":
        """Return the surface with the gloss fitted again, with the normals as they are."""
        with np.errstate(invalid="ignore"):
            lit = self.facets.normal @ lamps.direction.T > LEAST_COSINE
        weight = (usable & lit & ~self.in_shadow(response, self._rendered(lamps))).astype(float)
        options = FitOptions(lobes=(self.lobe,))
        geometry = _geometry(self._known_normals(), lamps.direction)
        found = fit_one_gloss(response / lamps.level, geometry, weight, options, self.n, self.k)
        return replace(self, gloss=found.gloss)

    def _converged(self, response, usable, lamps: Lamps) -> "UnknownShape":
        """Return the surface with normals and diffuse weights that belong to its gloss."""
        found = self
        for _ in range(_NORMAL_ROUNDS if self.gloss is not None else 0):
            found = found._with_normals(response, usable, lamps)
        return found

    def _loss(self, response, usable, lamps: Lamps) -> float:
        """Return the mean loss of the usable responses: 0 if they are as rendered, 1 if they are quite different."""
        square = ((response - self._rendered(lamps)) / self.facets.alpha[:, None]) ** 2
        return float(np.mean((square / (square + _HALF**2))[usable & self.facets.told[:, None]]))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _geometry(normal, direction) -> np.ndarray:
    return geometry_of(normal, np.broadcast_to(_VIEW, normal.shape), direction)


def fit_unknown_shape(response, usable, lamps: Lamps, *, lobe: str, n: float, k: float) -> UnknownShape:
    """Fit normals, diffuse weights and one gloss.

    Parameters
    ----------
    response : (T, J) float
        Responses of T places in J photographs, proportional to the light.
    usable : (T, J) bool
        False for responses that are clipped or left out.
    lamps : Lamps
        Levels and directions of the lamps of the photographs.
    lobe : str
        Lobe of the gloss; ``none`` for diffuse reflection alone.
    n, k : float
        Complex refractive index.
    """
    response = np.asarray(response, dtype=np.float64)
    found = UnknownShape(fit_facets(response, usable, lamps.light), lobe, n, k)
    if lobe == MATT:
        return found
    told = np.flatnonzero(found.facets.told)
    if not len(told):
        return found
    few, more = (told[:: max(1, len(told) // count)] for count in (_SEARCHED, _ESTIMATED))
    start = _searched(found, response[few], usable[few], lamps)
    gloss = _estimated(replace(found, gloss=start), response[more], usable[more], lamps)
    return replace(found, gloss=gloss)._converged(response, usable, lamps)


def _searched(matt: UnknownShape, response, usable, lamps: Lamps) -> PaintGloss | None:
    """Return the gloss of a grid that explains the responses of some places best; None if none explains them better."""
    typical = float(np.nanmedian(matt.facets.alpha))
    matt = replace(matt, facets=fit_facets(response, usable, lamps.light))
    best, found = matt._loss(response, usable, lamps), None
    for beta, mu in product(_BETAS, _MUS):
        gloss = PaintGloss(
            np.log([beta * typical, mu]), np.eye(2), np.zeros((2, 2)), 1.0, len(response), np.zeros((2, 2))
        )
        loss = replace(matt, gloss=gloss)._converged(response, usable, lamps)._loss(response, usable, lamps)
        if loss < best:
            best, found = loss, gloss
    return found


def _estimated(start: UnknownShape, response, usable, lamps: Lamps) -> PaintGloss | None:
    """Return the gloss that explains the responses of some places best, from that of a grid."""
    if start.gloss is None:
        return None
    facets = fit_facets(response, usable, lamps.light)
    one = replace(start, facets=facets)._converged(response, usable, lamps)
    best, found = one._loss(response, usable, lamps), one.gloss
    for _ in range(_GLOSS_ROUNDS):
        one = one._with_gloss(response, usable, lamps)._converged(response, usable, lamps)
        loss = one._loss(response, usable, lamps)
        if loss < best:
            best, found = loss, one.gloss
    return found


def register_unknown_shape(response, usable, known, *, error_deg: float) -> Lamps:
    """Estimate levels and directions of the lamps of J photographs from a matt surface of unknown shape.

    Normals and lamps are estimated in turn. A gloss is not modelled here: on a surface of few different normals it
    cannot be told from the levels of the lamps.

    Parameters
    ----------
    response : (T, J) float
    usable : (T, J) bool
    known : (J, 3) float
        Unit vectors to the lamps as known beforehand.
    error_deg : float
        Standard deviation of these directions, degrees; 0 if they are exact.
    """
    response = np.asarray(response, dtype=np.float64)
    light = np.array(known, dtype=np.float64)
    for _ in range(_LAMP_ROUNDS):
        facets = fit_facets(response, usable, light)
        light = refine_lamps(
            response, facets, known, np.ones(len(known)), error_deg=error_deg, level_error=LEVEL_ERROR
        )  # fmt: skip
    return Lamps.of_light(light, known)
