"""Weight of the mirror term, measured where photographs show the mirror image of the lamp.

A lamp of angular radius ρ and even radiance, mirrored in a surface of mirror weight χ, adds χ F(θ) / sin²ρ to the
responses of texels whose half vector lies within about ρ / 2 of the normal. On most glossy surfaces that is beyond the
camera's range: clipped readings tell that there is an image, and not how bright it is. Where the readings are not
clipped, what they exceed the diffuse light and the gloss by measures χ, or shows that there is no mirror image. The
fit of diffuse light and gloss leaves such readings out, as far as the errors of the angles go.
"""

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from irodori.fitting.solvers import FitOptions
from irodori.reflection.coat import diffuse_cosine
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate

if TYPE_CHECKING:
    from irodori.fitting.diffuse_response import Observed

_LEAST_TEXELS = 4  # of a photograph that is to measure the weight
_DEVIATIONS = 2.0  # of the angle to the half vector, by which texels must lie within the image
_BLUR = 0.25  # of the image of the lamp by the lens and the size of texels, of its radius
_GLOSS_ERROR = 0.05  # relative, of the gloss that is subtracted
_LEAST_ERROR = 0.05  # relative, of the weight: evenness and size of the lamp


@dataclass(frozen=True)
class MirrorWeight:
    """Measured weight of the mirror term.

    Parameters
    ----------
    weight, error : float
        With its standard error; NaN where no photograph measures it.
    photographs : int
        Photographs that show where the lamp's mirror image is, or would be.
    clipped : int
        Those of them in which the image is clipped.
    """

    weight: float = math.nan
    error: float = math.nan
    photographs: int = 0
    clipped: int = 0

    def plain(self) -> dict:
        """Return the fields by name, None in place of NaN."""
        return {name: None if value != value else value for name, value in asdict(self).items()}


def _zone(options: FitOptions) -> tuple[float, float]:
    """Return the angles φ below which the mirror image certainly is, and above which it certainly is not, rad.

    Both are 0 where the size of the lamp is not known.
    """
    if options.lamp_radius_deg is None:
        return 0.0, 0.0
    half, error = 0.5 * math.radians(options.lamp_radius_deg), _DEVIATIONS * math.sqrt(options.angles.variances[1])
    return (1.0 - _BLUR) * half - error, (1.0 + _BLUR) * half + error


def without_images(observed: "Observed", options: FitOptions) -> "Observed":
    """Return the observations without the weight of those in which the lamp's mirror image may be."""
    beyond = _zone(options)[1]
    if beyond == 0.0:
        return observed
    return replace(observed, weight=np.where(observed.geometry[..., 3] < beyond, 0.0, observed.weight))


class MirrorImages:
    """Sums over the texels that see the mirror image of the lamp, tile by tile.

    Parameters
    ----------
    options : FitOptions
        Options of the fit, with one lobe; they tell the angular radius of the lamp, or nothing is measured.
    n, k : float
        Complex refractive index.
    band : int
        Band of the fit.
    """

    def __init__(self, options: FitOptions, n: float, k: float, band: int) -> None:
        self._options, self._n, self._k, self._band = options, n, k, band
        self._within = _zone(options)[0]
        self._area = math.sin(math.radians(options.lamp_radius_deg or 0.0)) ** 2
        self._sums: np.ndarray | None = None  # (J, 4): weight, its square, error of the gloss, texels
        self._clipped = np.zeros(0, dtype=np.int64)

    def add(self, observed: "Observed", maps: dict[str, np.ndarray]) -> None:
        """Add the texels of a tile.

        Parameters
        ----------
        observed : Observed
        maps : dict
            ``alpha``, ``beta`` and ``mu`` of the texels, NaN where unknown.
        """
        captures = observed.response.shape[1]
        if self._sums is None:
            self._sums, self._clipped = np.zeros((captures, 4)), np.zeros(captures, dtype=np.int64)
        known = np.isfinite(maps["alpha"]) & np.isfinite(maps["beta"]) & np.isfinite(maps["mu"])
        inside = known[:, None] & (observed.geometry[..., 3] < self._within)
        clipped = inside & (observed.clipped > 0)
        self._clipped += clipped.sum(axis=0)
        texel, capture = np.nonzero(inside & (observed.weight > 0.0) & ~clipped)
        if not len(texel):
            return
        angles = observed.geometry[texel, capture].astype(np.float64)
        alpha, beta, mu = (maps[name][texel].astype(np.float64) for name in ("alpha", "beta", "mu"))
        reflectance = fresnel_array(np.cos(angles[:, 2]), self._n, self._k)
        gloss = beta * reflectance * evaluate(self._options.lobes[0], mu, angles)
        ground = alpha * diffuse_cosine(angles, self._n, self._k, self._options.is_coupled)
        scale = self._area / reflectance
        weight = (observed.response[texel, capture, self._band] - ground - gloss) * scale
        row = np.stack([weight, weight**2, _GLOSS_ERROR * gloss * scale, np.ones_like(weight)], axis=-1)
        np.add.at(self._sums, capture, row)

    def join(self, other: "MirrorImages") -> None:
        """Add the sums over other texels of the object."""
        if self._sums is None:
            self._sums, self._clipped = other._sums, other._clipped
        elif other._sums is not None:
            self._sums, self._clipped = self._sums + other._sums, self._clipped + other._clipped

    def measured(self) -> MirrorWeight:
        """Return the weight that the photographs tell."""
        if self._sums is None:
            return MirrorWeight()
        count = self._sums[:, 3]
        clipped, open_ = self._clipped > 0, (count >= _LEAST_TEXELS) & (self._clipped == 0)
        seen = int(clipped.sum() + open_.sum())
        if clipped.any() or not open_.any():
            return MirrorWeight(photographs=seen, clipped=int(clipped.sum()))
        mean, square, gloss = (self._sums[open_, i] / count[open_] for i in range(3))
        weight, several = float(np.average(mean, weights=count[open_])), int(open_.sum())
        own = np.sqrt(np.maximum(square - mean**2, 0.0) / count[open_])
        spread = mean.std(ddof=1) if several > 1 else float(own.max())
        common = math.hypot(float(gloss.mean()), _LEAST_ERROR * weight)
        return MirrorWeight(weight, math.hypot(spread / math.sqrt(several), common), seen, 0)
