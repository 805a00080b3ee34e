"""Fit of a surface with varying colour and one common gloss, by the method of `irodori.fitting.paint_gloss`."""

from dataclasses import dataclass

import numpy as np

from irodori.fitting import gloss_sums
from irodori.fitting.joint_gloss import gloss_of_paints
from irodori.fitting.paint_gloss import PaintGloss, share
from irodori.fitting.solvers import FitOptions, problem_of
from irodori.reflection.equation5 import reflect

#: Name, among those of lobes, of a surface without gloss.
MATT = "none"
#: Approximate number of places from which the common gloss is fitted.
_MOST = 2000


@dataclass(frozen=True)
class OneGloss:
    """Fitted parameters of a surface with T places and a common gloss.

    Parameters
    ----------
    alpha, beta, mu : (T,) float64
        NaN at places that no photograph shows. β is 0 if the surface shows no gloss.
    gloss : PaintGloss or None
        Common gloss; None if the places show no gloss or do not determine it.
    lobe : str
        Lobe of the gloss.
    n, k : float
        Complex refractive index.
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    gloss: PaintGloss | None
    lobe: str
    n: float
    k: float

    def rendered(self, geometry) -> np.ndarray:
        """Compute the responses of all places in geometries (T, ..., 4), in the unit of the fitted responses."""
        several = (slice(None), *(None,) * (np.ndim(geometry) - 2))
        return reflect(
            self.alpha[several], 1.0, self.beta[several], self.mu[several], geometry, n=self.n, k=self.k, lobe=self.lobe
        )


def fit_surface(response, geometry, weight, lobe: str, n: float, k: float) -> OneGloss:
    """Fit diffuse reflection with one gloss for all places, or without gloss if ``lobe`` is `MATT`.

    The other parameters are those of `fit_one_gloss`.
    """
    if lobe == MATT:
        return matt(response, geometry, weight, "gaussian", n, k)
    return fit_one_gloss(response, geometry, weight, FitOptions(lobes=(lobe,)), n, k)


def fit_one_gloss(response, geometry, weight, options: FitOptions, n: float, k: float) -> OneGloss:
    """Fit diffuse weights and one common gloss to a single band.

    Parameters
    ----------
    response, weight : (T, J) float
    geometry : (T, J, 4) float
        θ_i, θ_r, θ_H, φ in rad.
    options : FitOptions
        Options with one lobe.
    n, k : float
        Complex refractive index.
    """
    (lobe,) = options.lobes
    unknown = np.full((response.shape[1], 2), np.nan)
    surface = gloss_sums.pack(
        *problem_of(response, geometry, weight, n, k, options, noise=unknown), sides=True
    )  # fmt: skip
    told = np.flatnonzero((weight > 0.0).sum(axis=1) > 3)
    chosen = told[:: max(1, len(told) // _MOST)]
    some = surface._replace(blocks=surface.blocks[chosen])
    (gloss,), _ = gloss_of_paints([some if len(chosen) else None], options.nodes(), checked=False)
    if gloss is None:
        return matt(response, geometry, weight, lobe, n, k)
    own = share(surface, gloss)
    seen = (weight > 0.0).any(axis=1)
    alpha, beta, mu = (np.where(seen, values, np.nan) for values in (own.alpha, own.beta, own.mu))
    return OneGloss(alpha, beta, mu, gloss, lobe, n, k)


def matt(response, geometry, weight, lobe: str, n: float, k: float) -> OneGloss:
    """Fit diffuse weights without gloss; parameters as in `fit_one_gloss`."""
    cosine = np.maximum(np.cos(geometry[..., 0]), 0.0)
    power = (weight * cosine**2).sum(axis=1)
    alpha = np.where(power > 0.0, (weight * cosine * response).sum(axis=1) / np.where(power > 0.0, power, 1.0), np.nan)
    nothing = np.where(power > 0.0, 0.0, np.nan)
    return OneGloss(alpha, nothing, nothing + 0.1, None, lobe, n, k)
