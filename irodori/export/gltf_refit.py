"""Refit of the gloss of a material as a single GGX lobe, the only one that a glTF material has.

Texels with nearly the same parameters are fitted together. The roughness and weight of the lobe and the brightness of
the base minimise the squared differences of CIELAB lightness L* over many pairs of directions. Lightness weights a
highlight and its surroundings by how visible they are. Half of the pairs of light and eye are spread evenly over the
hemisphere, half lie about the highlight.
"""

from typing import NamedTuple

import numpy as np

from irodori.colour.colorimetry import lab_from_xyz, xyz_from_reflectance
from irodori.export.gltf_reflection import COAT_F0, GltfSurface, reflected
from irodori.material.material_file import Material
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate
from irodori.reflection.registry import lobe

#: Texels are fitted together when they agree within these steps of ln μ, ln β, and L* of the diffuse colour, which are
#: about as fine as 8-bit textures.
_ALIKE = (0.01, 0.02, 1.0)
_GEOMETRIES, _AT_ONCE = 128, 512
#: Smallest α = roughness² of a fit, and the weight at or below which a texel has no gloss.
_LEAST_ALPHA, _LEAST_WEIGHT = 1e-4, 1e-5
_DARK = 1e-4  # diffuse luminance below which the brightness of the base is not fitted
_ROUNDS, _STEP, _ENOUGH = 60, 1e-4, 1e-7
#: Largest angle of a direction from the normal, rad: nearer to the horizon the lobes lose numerical precision.
_HIGHEST = np.radians(89.0)


class Texel(NamedTuple):
    """Reflection parameters of c texels of a material."""

    diffuse: np.ndarray  # (c, n) reflectance factor in any linear bands or colours
    gloss: list[tuple[str, np.ndarray, np.ndarray]]  # lobe, β (c,) and μ (c,) of each component


class Refit(NamedTuple):
    """Parameters of a glTF material over a texture: one GGX lobe, the brightness of the base, and a clear coat."""

    alpha: np.ndarray  # (h, w) roughness², 0 for a mirror; texels without gloss have the mean of the others
    weight: np.ndarray  # (h, w) 0..1
    base: np.ndarray  # (h, w) factor on the diffuse colour
    coat: float  # weight of the smooth clear coat, 0..1


def spread(count: int, dimensions: int, start: float) -> np.ndarray:
    """Return points that cover the unit cube evenly, (count, dimensions): the additive sequence of Roberts (2018)."""
    root = 1.5
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return (start + np.outer(np.arange(1, count + 1), root ** -np.arange(1.0, dimensions + 1))) % 1.0


def _unit(theta, azimuth) -> np.ndarray:
    sine = np.sin(theta)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(theta)], axis=-1)


def everywhere(count: int, start: float) -> np.ndarray:
    """Return pairs of directions to light and eye, even in projected solid angle, as angles (count, 4) in rad."""
    p = spread(count, 4, start)
    light, eye = (_unit(np.minimum(np.arcsin(np.sqrt(p[:, i])), _HIGHEST), 2 * np.pi * p[:, i + 1]) for i in (0, 2))
    return angles_from_directions(np.array([0.0, 0.0, 1.0]), light, eye)


def about_highlight(reach: np.ndarray, start: float) -> np.ndarray:
    """Return pairs of directions to light and eye whose half vectors lie near the normal.

    Parameters
    ----------
    reach : (..., count) float
        Largest angle between half vector and normal, rad; angles are spread evenly from 0 to it.
    start : float
        Start of the sequence of `spread`.

    Returns
    -------
    (..., count, 4) float64
        θ_i, θ_r, θ_H, φ in rad; NaN where the light would be within 1° of the horizon or below it.
    """
    p = spread(reach.shape[-1], 3, start)
    eye = _unit(np.minimum(np.arcsin(np.sqrt(p[:, 0])), _HIGHEST), np.zeros(len(p)))
    half = _unit(reach * p[:, 1], np.broadcast_to(2 * np.pi * p[:, 2], reach.shape))
    light = 2.0 * np.sum(half * eye, axis=-1, keepdims=True) * half - eye
    found = angles_from_directions(np.array([0.0, 0.0, 1.0]), light, np.broadcast_to(eye, light.shape))
    return np.where(found[..., :1] < _HIGHEST, found, np.nan)


def gloss_reach(gloss: list[tuple[str, np.ndarray, np.ndarray]], count: int) -> np.ndarray:
    """Return the largest angle of half vectors from the normal for each texel and pair, (c, count) rad.

    The angle is the reach of a gloss component's lobe; successive pairs take the components in turn.
    """
    own = []
    for name, beta, mu in gloss:
        reach = lobe(name).reach
        own.append([reach(one) if weight > 0.0 else np.nan for weight, one in zip(beta, mu, strict=True)])
    reaches = np.array(own)
    widest = np.nan_to_num(np.fmax.reduce(reaches, axis=0), nan=0.1)
    reaches = np.where(np.isnan(reaches), widest, reaches)
    return np.stack([reaches[i % len(gloss)] for i in range(count)], axis=1)


def rough_terms(texel: Texel, fresnel, geometry: np.ndarray) -> np.ndarray:
    """Return π L_o / E_n of the diffuse and gloss terms of a material [eq. 5], (c, g, n).

    Parameters
    ----------
    texel : Texel
    fresnel : callable
        (...) cosθ_H -> (..., n) Fresnel reflectance in the colours of ``texel.diffuse``.
    geometry : (c, g, 4) or (1, g, 4) float, rad
    """
    shape = (len(texel.diffuse), geometry.shape[1], 4)
    geometry = np.broadcast_to(geometry, shape)
    total = np.zeros(shape[:2])
    for name, beta, mu in texel.gloss:
        total += beta[:, None] * evaluate(name, np.where(beta > 0.0, mu, 1.0)[:, None], geometry)
    diffuse = np.cos(geometry[..., :1]) * texel.diffuse[:, None]
    return diffuse + total[..., None] * fresnel(np.cos(geometry[..., 2]))


def fresnel_colours(material: Material, colours_from_bands: np.ndarray):
    """Return a function that computes the Fresnel reflectance of a material as linear colours.

    Parameters
    ----------
    material : Material
    colours_from_bands : (n, 61) float
        Matrix from a reflectance factor to n linear colours.

    Returns
    -------
    callable
        (...) cosθ_H -> (..., n).
    """
    n, k = material.n, material.k
    if np.ptp(n) == 0.0 and np.ptp(k) == 0.0:
        white = colours_from_bands.sum(axis=1)
        return lambda cosine: fresnel_array(cosine, n[0], k[0])[..., None] * white

    def varying(cosine):
        cosine = np.asarray(cosine)
        total = np.zeros((*cosine.shape, len(colours_from_bands)))
        for band, column in enumerate(colours_from_bands.T):
            total += fresnel_array(cosine, n[band], k[band])[..., None] * column
        return total

    return varying


def _lightness(luminance: np.ndarray) -> np.ndarray:
    xyz = np.broadcast_to(np.maximum(luminance, 0.0)[..., None], (*luminance.shape, 3))
    return lab_from_xyz(xyz, np.ones(3))[..., 0]


def coat_of(material: Material) -> float:
    """Return the weight of the clear coat that represents the mirror term, 0..1; 0 for a material without gloss."""
    if not any((np.nan_to_num(beta) > 0.0).any() for _, beta, _ in material.gloss):
        return 0.0
    luminance = xyz_from_reflectance("D65")[1:2] / 100.0
    return float(min(material.mirror * fresnel_colours(material, luminance)(np.ones(1))[0, 0] / COAT_F0, 1.0))


def refit(material: Material) -> Refit:
    """Fit roughness and weight of a GGX lobe and the brightness of the base to each texel of a material.

    The mirror term becomes the clear coat; in a material without gloss it becomes the lobe, with roughness 0.

    Parameters
    ----------
    material : Material
        A material with all texels filled, see `Material.filled`.
    """
    luminance = xyz_from_reflectance("D65")[1:2] / 100.0
    fresnel = fresnel_colours(material, luminance)
    diffuse = material.coefficients @ (material.basis.T @ luminance[0]) * material.spectrum_scale
    diffuse = np.maximum(diffuse.ravel().astype(np.float64), 0.0)
    gloss = [(name, np.maximum(beta.ravel(), 0.0), mu.ravel()) for name, beta, mu in material.gloss]
    coat, shape = coat_of(material), material.alpha.shape
    keys = [np.rint(_lightness(diffuse) / _ALIKE[2])]
    for _, beta, mu in gloss:
        some = (beta > 0.0) & (mu > 0.0)
        keys += [np.where(some, np.rint(np.log(np.where(some, value, 1.0)) / step), np.inf)
                 for value, step in ((mu, _ALIKE[0]), (beta, _ALIKE[1]))]  # fmt: skip
    which = np.zeros(diffuse.size, dtype=np.int64)
    for key in keys:
        _, number = np.unique(key, return_inverse=True)
        _, which = np.unique(which * (number.max() + 1) + number, return_inverse=True)
    count = np.bincount(which)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(which, values) / count

    kinds = Texel(mean(diffuse)[:, None], [(name, mean(np.where(m > 0.0, b, 0.0)), mean(np.where(m > 0.0, m, 0.0)))
                                           for name, b, m in gloss])  # fmt: skip
    alpha, weight, base = np.empty((3, len(count)))
    f0 = float(fresnel(np.ones(1))[0, 0])
    for first in range(0, len(count), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        some = Texel(kinds.diffuse[part], [(name, b[part], m[part]) for name, b, m in kinds.gloss])
        alpha[part], weight[part], base[part] = _fitted(some, fresnel, f0, coat, material.mirror)
    # Viewers interpolate between texels with and without gloss: those without get the mean roughness of the others.
    weighty = weight > 0.0
    alpha = np.where(weighty, alpha, np.average(alpha[weighty], weights=count[weighty]) if weighty.any() else 1.0)
    factor = np.divide(base, kinds.diffuse[:, 0], out=np.ones_like(base), where=kinds.diffuse[:, 0] > 0.0)
    alpha, weight, factor = (values[which].reshape(shape) for values in (alpha, weight, factor))
    return Refit(alpha, weight, factor, coat)


def _fitted(texel: Texel, fresnel, f0: float, coat: float, mirror: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit c texels; return α = roughness², weight, and luminance of the base, (c,) each."""
    count = len(texel.diffuse)
    glossy = np.any([beta > 0.0 for _, beta, _ in texel.gloss], axis=0)
    near = about_highlight(gloss_reach(texel.gloss, _GEOMETRIES // 2), 0.5)
    far = np.broadcast_to(everywhere(_GEOMETRIES // 2, 0.5), near.shape)
    geometry = np.concatenate([far, near], axis=1)
    seen = ~np.isnan(geometry[..., 0])
    geometry = np.where(seen[..., None], geometry, 0.1)
    wanted = _lightness(rough_terms(texel, fresnel, geometry)[..., 0])

    def lightness(p: np.ndarray) -> np.ndarray:
        surface = GltfSurface.of(p[:, 2, None, None] ** 3, np.exp(p[:, 1, None]), [f0],
                                 np.where(glossy, np.exp(p[:, 0]), 0.0)[:, None], coat)  # fmt: skip
        return _lightness(reflected(surface, geometry)[..., 0])

    # Texels without gloss have the mirror term as their lobe, or none: its parameters are fixed.
    fixed = np.log(max(min(mirror, 1.0) if coat == 0.0 else 0.0, _LEAST_WEIGHT))
    mus = np.array([np.where(beta > 0.0, mu, 0.0) for _, beta, mu in texel.gloss])
    betas = np.array([beta for _, beta, _ in texel.gloss])
    powers = betas * mus**2
    typical = np.where(glossy, (powers * mus).sum(axis=0) / np.maximum(powers.sum(axis=0), 1e-300), 1.0)
    start = np.stack([np.log(np.clip(typical, _LEAST_ALPHA, 1.0)),
                      np.where(glossy, np.log(np.clip(4.0 * powers.sum(axis=0), _LEAST_WEIGHT, 1.0)), fixed),
                      np.cbrt(np.minimum(texel.diffuse[:, 0], 1.0))], axis=1)  # fmt: skip
    low = np.tile([np.log(_LEAST_ALPHA), np.log(_LEAST_WEIGHT), 0.0], (count, 1))
    high = np.tile([0.0, 0.0, 1.0], (count, 1))
    low[~glossy, :2] = high[~glossy, :2] = start[~glossy, :2]
    dark = texel.diffuse[:, 0] < _DARK
    low[dark, 2] = high[dark, 2] = start[dark, 2]
    found = _least_squares(lambda p: np.where(seen, lightness(p) - wanted, 0.0), start, low, high)
    weight = np.exp(found[:, 1])
    return (np.where(glossy, np.exp(found[:, 0]), 0.0), np.where(weight > _LEAST_WEIGHT, weight, 0.0),
            found[:, 2] ** 3)  # fmt: skip


def _least_squares(residual, start: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Solve c small least-squares problems with bounds by the Levenberg-Marquardt method; return parameters (c, p).

    All problems take their steps together; each has its own damping.

    Parameters
    ----------
    residual : callable
        Function from parameters (c, p) to residuals (c, r).
    start, low, high : (c, p) float
        Start values and bounds.
    """
    at = start
    left = residual(at)
    cost, damping = np.sum(left**2, axis=1), np.full(len(at), 1e-2)
    for _ in range(_ROUNDS):
        slopes = []
        for i in range(at.shape[1]):
            # Backwards where a step forwards would leave the bounds.
            step = np.where(at[:, i] + _STEP <= high[:, i], _STEP, -_STEP)
            moved = at.copy()
            moved[:, i] += step
            slopes.append((residual(moved) - left) / step[:, None])
        jacobian = np.stack(slopes, axis=2)
        downhill = np.einsum("crp,cr->cp", jacobian, left)
        # Parameters at a bound with a gradient that points outwards, and fixed ones, are not changed.
        held = ((at <= low) & (downhill > 0.0)) | ((at >= high) & (downhill < 0.0)) | (low == high)
        jacobian = np.where(held[:, None, :], 0.0, jacobian)
        normal = np.einsum("crp,crq->cpq", jacobian, jacobian)
        diagonal = np.einsum("cpp->cp", normal)
        normal = normal + np.eye(at.shape[1]) * (damping[:, None] * diagonal + 1e-12 + (diagonal == 0.0))[:, None, :]
        step = -np.linalg.solve(normal, np.where(held, 0.0, downhill)[..., None])[..., 0]
        tried = np.clip(at + step, low, high)
        rest = residual(tried)
        value = np.sum(rest**2, axis=1)
        better = value < cost
        gain = np.where(better, (cost - value) / np.maximum(cost, 1e-300), 0.0)
        at = np.where(better[:, None], tried, at)
        left, cost = np.where(better[:, None], rest, left), np.where(better, value, cost)
        damping = np.clip(np.where(better, damping / 5.0, damping * 4.0), 1e-9, 1e6)
        if not ((gain > _ENOUGH) | (~better & (damping < 1e3))).any():
            break
    return at
