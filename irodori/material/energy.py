"""The albedo of materials: the share of incident light that a surface reflects, and texels where it exceeds 1.

A thin sheet also sends light out of its other side; this share is added.

The reflection model (equation 5) adds the diffuse, gloss and mirror terms; the diffuse term is not reduced by what
gloss and mirror reflect. The sum may therefore exceed the incident light, and two figures are computed. The *albedo* is
the share of uniform light from all sides that is reflected, over all directions together or towards any direction up to
60 degrees from the normal, whichever is more. Above 1, the surface gains energy (it fails the furnace test). The *rim
albedo* is the largest share towards any direction. It exceeds 1 on every bright surface under a smooth coat, since F
approaches 1 at grazing incidence and the diffuse light is still added in full.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.reflection.albedo import gloss_albedo
from irodori.reflection.coat import COUPLED, SUM, diffuse_albedo
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.registry import lobe

if TYPE_CHECKING:
    from irodori.material.material_file import Material

#: Standard errors by which an albedo has to exceed 1 to do so certainly, and the share that exceeds it by chance.
CERTAIN, CHANCE = 3.0, 0.00135
_STEEP_DEG = 60.0
_ROUGHNESSES, _DIRECTIONS, _CHUNK = 97, 12, 1 << 16
_AT_ONCE = 1 << 18  # texels, so that a large texture is not copied as a whole
_ROUNDING = 1e-3  # of a perfect white in half precision
#: Columns of the array that `AlbedoModel.of` returns.
ALBEDO, RIM, RIM_COSINE, ERROR, _FOUND = 0, 1, 2, 3, 4


class Errors(NamedTuple):
    """Standard errors of the parameters of texels; an error that is not known is 0 or not finite and adds nothing."""

    reflectance: np.ndarray  # (texels,) of S, rms over wavelengths
    alpha: np.ndarray  # (texels,) of α, relative to α
    gloss: np.ndarray  # (texels, components) of β μ², relative to it, an upper bound

    @classmethod
    def none(cls, texels: int, components: int) -> "Errors":
        """Return errors of 0, for parameters with unknown standard errors."""
        return cls(np.zeros(texels), np.zeros(texels), np.zeros((texels, components)))


class Reflecting(NamedTuple):
    """Diffuse reflectance (coefficients on a basis) and gloss parameters β and μ of texels."""

    coefficients: np.ndarray  # (texels, r) of α S / S_G
    basis: np.ndarray  # (61, r)
    beta: np.ndarray  # (texels, components)
    mu: np.ndarray  # (texels, components)


@njit(cache=True, error_model="numpy")
def _judge(tables, texels, errors, out, first, last):
    gloss, mirror, ground, cosine, steep, ladder = tables
    coefficients, basis, beta, mu = texels
    directions, bands = mirror.shape
    components = beta.shape[1]
    row, beside, weight = np.zeros(components, np.int64), np.zeros(components), np.zeros(components)
    diffuse = np.zeros(basis.shape[0])
    for texel in range(first, last):
        peak, known = -np.inf, True
        for band in range(diffuse.size):
            diffuse[band] = 0.0
            for i in range(basis.shape[1]):
                diffuse[band] += coefficients[texel, i] * basis[band, i]
            peak = max(peak, diffuse[band])
            known = known and math.isfinite(diffuse[band])
        for component in range(components):
            b, m, weight[component] = beta[texel, component], mu[texel, component], 0.0
            if b > 0.0:
                known = known and m > 0.0
                start, step = ladder[component]
                place = min(max((math.log(m) - start) / step, 0.0), gloss.shape[1] - 1.000001) if m > 0.0 else 0.0
                row[component] = int(place)
                beside[component], weight[component] = place - row[component], b * m * m
        if not known:
            out[texel] = np.nan
            continue
        albedo, rim, at, below, shiny = -np.inf, -np.inf, 1.0, 0.0, 0.0
        for band in range(bands):
            # If the refractive index is the same in all bands, the band of the largest diffuse reflectance decides.
            under = peak if bands == 1 else diffuse[band]
            for direction in range(directions):
                glossy = 0.0
                for component in range(components):
                    if weight[component] > 0.0:
                        r, t = row[component], beside[component]
                        low = gloss[component, r, direction, band]
                        slope = gloss[component, r + 1, direction, band] - low
                        glossy += weight[component] * (low + t * slope)
                sent = under * ground[direction, band] + glossy + mirror[direction, band]
                if steep[direction] and sent > albedo:
                    albedo, below, shiny = sent, under * ground[direction, band], glossy
                if sent > rim:
                    rim, at = sent, cosine[direction]
        variance = 0.0
        if math.isfinite(errors.reflectance[texel]):
            variance += errors.reflectance[texel] ** 2
        if math.isfinite(errors.alpha[texel]):
            variance += (errors.alpha[texel] * below) ** 2
        for component in range(components):
            if math.isfinite(errors.gloss[texel, component]):
                variance += (errors.gloss[texel, component] * shiny) ** 2
        out[texel, ALBEDO], out[texel, RIM], out[texel, RIM_COSINE] = albedo, rim, at
        out[texel, ERROR] = math.sqrt(variance)


class AlbedoModel:
    """Computes the albedo of texels of one object, from tables over roughness and angle.

    Parameters
    ----------
    lobes : sequence of str
        Names of the lobes of the gloss components.
    n, k : (61,) float
        Complex refractive index.
    mirror : float
        Weight of the mirror term.
    coat : str
        Whether the coat reduces the diffuse term, see `irodori.reflection.coat`.
    """

    def __init__(self, lobes: Sequence[str], n: np.ndarray, k: np.ndarray, mirror: float, coat: str = SUM) -> None:
        n, k = (np.asarray(x, dtype=np.float64) for x in (n, k))
        if np.ptp(n) == 0.0 and np.ptp(k) == 0.0:
            n, k = n[:1], k[:1]
        node, weight = np.polynomial.legendre.leggauss(_DIRECTIONS)
        node, weight = 0.5 * (node + 1.0), 0.5 * weight
        cosine = np.concatenate([node, [math.cos(math.radians(_STEEP_DEG)), 1.0]])

        def with_mean(values: np.ndarray) -> np.ndarray:
            """Append the mean under uniform light to values (..., directions, bands), as a further direction."""
            even = np.einsum("c,...cb->...b", 2.0 * node * weight, values[..., : len(node), :])
            return np.concatenate([values, even[..., None, :]], axis=-2)

        tables, ladder = np.zeros((len(lobes), _ROUGHNESSES, len(cosine) + 1, len(n))), np.zeros((len(lobes), 2))
        for component, name in enumerate(lobes):
            bounds = lobe(name).roughness
            mu = np.geomspace(bounds.low, bounds.high, _ROUGHNESSES)
            # Divided by μ², the gloss albedo varies little between neighbouring roughnesses.
            tables[component] = with_mean(gloss_albedo(name, mu, cosine, n, k)) / mu[:, None, None] ** 2
            ladder[component] = math.log(mu[0]), math.log(mu[1] / mu[0])
        fresnel = np.stack([fresnel_array(cosine, a, b) for a, b in zip(n, k, strict=True)], axis=-1)
        ground = np.ones_like(fresnel)
        if coat == COUPLED:
            ground = np.stack([diffuse_albedo(cosine, a, b) for a, b in zip(n, k, strict=True)], axis=-1)
        is_steep = np.append(cosine >= math.cos(math.radians(_STEEP_DEG)) - 1e-12, True)
        # The mean has no angle and stands with cosine 1: it is the largest value only if all directions are equal.
        cosine = np.append(cosine, 1.0)
        self._tables = tables, mirror * with_mean(fresnel), with_mean(ground), cosine, is_steep, ladder

    def of(self, texels: Reflecting, errors: Errors) -> np.ndarray:
        """Return albedo, rim albedo, cosine of the rim albedo's angle, and standard error of the albedo, (texels, 4).

        Both albedos are the largest over all wavelengths; NaN where colour or gloss is not known.
        """
        out = np.empty((len(texels.beta), _FOUND))
        arrays = Reflecting(*(np.ascontiguousarray(x, dtype=np.float64) for x in texels))
        stated = Errors(*(np.ascontiguousarray(x, dtype=np.float64) for x in errors))
        run_chunks(_judge, len(out), _CHUNK, self._tables, arrays, stated, out)
        return out


@dataclass(frozen=True)
class Energy:
    """Summary of the albedos of an object's texels.

    Parameters
    ----------
    texels : int
        Number of texels with known colour and gloss; the shares below are of these.
    albedo_max : float
        Largest albedo.
    gain_fraction : float
        Share of texels whose albedo is above 1.
    certain_fraction : float
        Share of texels whose albedo is above 1 by more than `CERTAIN` standard errors.
    certain_max : float
        Largest albedo of the texels that ``certain_fraction`` counts; 0 if there is none.
    rim_max, rim_deg : float
        Largest rim albedo, and its angle from the normal, degrees.
    rim_fraction : float
        Share of texels whose rim albedo is above 1.
    """

    texels: int = 0
    albedo_max: float = 0.0
    gain_fraction: float = 0.0
    certain_fraction: float = 0.0
    certain_max: float = 0.0
    rim_max: float = 0.0
    rim_deg: float = 0.0
    rim_fraction: float = 0.0

    @classmethod
    def of(cls, found: np.ndarray) -> "Energy":
        """Return the summary of the array that `AlbedoModel.of` returned; texels with NaN are left out."""
        found = found[np.isfinite(found[:, ALBEDO])]
        if not len(found):
            return cls()
        albedo, rim = found[:, ALBEDO], found[:, RIM]
        certain = albedo - CERTAIN * found[:, ERROR] > 1.0 + _ROUNDING
        highest = int(rim.argmax())
        return cls(
            texels=len(found),
            albedo_max=float(albedo.max()),
            gain_fraction=float((albedo > 1.0 + _ROUNDING).mean()),
            certain_fraction=float(certain.mean()),
            certain_max=float(albedo[certain].max(initial=0.0)),
            rim_max=float(rim[highest]),
            rim_deg=math.degrees(math.acos(min(found[highest, RIM_COSINE], 1.0))),
            rim_fraction=float((rim > 1.0 + _ROUNDING).mean()),
        )

    @property
    def gains(self) -> bool:
        """Whether the share of texels with an albedo certainly above 1 exceeds what noise alone would produce."""
        return self.certain_fraction > CHANCE

    def joined(self, other: "Energy") -> "Energy":
        """Return the summary of the texels of this summary and another one together."""
        texels = self.texels + other.texels
        if not texels:
            return self
        shares = {
            name: (self.texels * getattr(self, name) + other.texels * getattr(other, name)) / texels
            for name in ("gain_fraction", "certain_fraction", "rim_fraction")
        }
        highest = max(self, other, key=lambda one: one.rim_max)
        return Energy(
            texels=texels,
            albedo_max=max(self.albedo_max, other.albedo_max),
            certain_max=max(self.certain_max, other.certain_max),
            rim_max=highest.rim_max,
            rim_deg=highest.rim_deg,
            **shares,
        )


def energy_of(material: "Material", albedo_error: np.ndarray | None = None) -> Energy:
    """Return the summary of the albedos of a material's observed texels; unknown gloss is the object's typical gloss.

    Parameters
    ----------
    material : Material
    albedo_error : (height, width) float, optional
        Standard error of each albedo; 0 where absent.
    """
    energy, rows = Energy(), max(1, _AT_ONCE // material.alpha.shape[1])
    model = AlbedoModel(material.lobes, material.n, material.k, material.mirror, material.coat)
    basis = material.basis if material.through is None else np.hstack([material.basis, material.through.basis])
    for first in range(0, len(material.alpha), rows):
        part = material.rows(slice(first, first + rows))
        observed, gloss = part.observed, part.typically_filled()
        beta = np.stack([values[observed] for _, values, _ in gloss], axis=-1)
        mu = np.stack([values[observed] for _, _, values in gloss], axis=-1)
        coefficients = part.coefficients[observed] * part.spectrum_scale[observed][:, None]
        if part.through is not None:  # a sheet also sends light out of its other side
            coefficients = np.hstack([coefficients, np.nan_to_num(part.through.coefficients[observed])])
        found = model.of(Reflecting(coefficients, basis, beta, mu), Errors.none(len(beta), len(gloss)))
        if albedo_error is not None:
            found[:, ERROR] = np.nan_to_num(albedo_error[first : first + rows][observed])
        energy = energy.joined(Energy.of(found))
    return energy
