"""Spectral quadrature: few wavelengths and weights that integrate a scene's radiance into XYZ."""

from dataclasses import dataclass

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz
from irodori.rendering.scene_arrays import Light, Objects, coefficients_of

#: Numbers of wavelengths that fill a vector of 8, 16, 32, 64 with the two numbers of gloss beside them.
COUNTS = (6, 14, 30)
_PATHS = 4000
_SEED = 7
_RIDGE = 1e-9


@dataclass(frozen=True)
class Quadrature:
    """Wavelengths and weights.

    Parameters
    ----------
    samples : (n,) int
        Of the 61.
    weights : (3, n) float64
        XYZ is ``weights @ radiance[samples]``.
    delta_e_mean, delta_e_p99 : float
        CIEDE2000 over the paths that the weights were not solved on.
    """

    samples: np.ndarray
    weights: np.ndarray
    delta_e_mean: float
    delta_e_p99: float


def path_spectra(objects: Objects, light: Light, lamps: np.ndarray, bounces: int, count: int = _PATHS) -> np.ndarray:
    """Return spectra that paths of a scene may carry, (n, 61): its light, from its texels, in its coloured mirrors.

    Directions, normals and texels are drawn at random, from a fixed seed.
    """
    rng = np.random.default_rng(_SEED)
    sky = light.pixels[rng.integers(light.size[0, 0] * light.size[0, 1], size=count)].astype(np.float64) @ light.basis
    lit = light.irradiance[rng.integers(len(light.irradiance), size=count)].astype(np.float64) @ light.basis / np.pi
    if len(lamps):
        lit = lit + rng.random((count, len(lamps))) ** 4 @ lamps / np.pi
    which = rng.integers(len(objects.bases), size=count)
    texel = objects.first_texel[which] + rng.integers(objects.texture_size[which].prod(axis=1))
    weights = objects.texels[texel].astype(np.float64)
    surface = np.einsum("pk,pkl->pl", coefficients_of(objects, weights), objects.basis[which])
    spectra = np.concatenate([sky, surface * lit])
    # Coloured mirrors, met 0..bounces times; grey ones change no spectrum's shape.
    coloured = np.flatnonzero(objects.grey == 0)
    if coloured.size:
        for _ in range(bounces):
            met = coloured[rng.integers(coloured.size, size=len(spectra))]
            n, k = objects.n[met], objects.k[met]
            normal = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
            grazing = rng.random((len(spectra), 1)) ** 3
            passed = normal + (1 - normal) * grazing
            spectra = np.where(rng.random((len(spectra), 1)) < 0.5, spectra * passed, spectra)
    return spectra


def _solve(chosen, moments, products):
    """Return weights for chosen samples and the squared error they leave."""
    gram = moments[np.ix_(chosen, chosen)]
    gram = gram + _RIDGE * np.trace(gram) / len(chosen) * np.eye(len(chosen))
    weights = np.linalg.solve(gram, products[chosen]).T
    return weights, -float(np.sum(weights * products[chosen].T))


def _best(rest: list[int], moments: np.ndarray, products: np.ndarray) -> tuple[float, int]:
    """Return the sample that leaves the least error beside others, after that error."""
    left = (s for s in range(len(moments)) if s not in rest)
    return min((_solve([*rest, s], moments, products)[1], s) for s in left)


def _select(count: int, moments: np.ndarray, products: np.ndarray) -> list[int]:
    """Return samples chosen one by one, then exchanged while that helps."""
    chosen: list[int] = []
    while len(chosen) < count:
        chosen.append(_best(chosen, moments, products)[1])
    least = _solve(chosen, moments, products)[1]
    improved = True
    while improved:
        improved = False
        for place in range(count):
            rest = chosen[:place] + chosen[place + 1 :]
            error, sample = _best(rest, moments, products)
            # Errors are differences from a large sum: less than its rounding is no gain.
            if error < least - 1e-12 * abs(least):
                chosen[place], least, improved = sample, error, True
    return sorted(chosen)


def solve_quadrature(
    spectra: np.ndarray,
    matrix: np.ndarray,
    white: np.ndarray,
    target_mean: float = 0.1,
    target_p99: float = 0.5,
    counts: tuple[int, ...] = COUNTS,
) -> Quadrature:
    """Return the smallest quadrature of some counts within targets, the largest where none is.

    Parameters
    ----------
    spectra : (n, 61) float
        Radiances to integrate; every second one is left for the error.
    matrix : (3, 61) float
        XYZ from radiance.
    white : (61,) float
    target_mean, target_p99 : float
        CIEDE2000.
    counts : tuple of int
        Growing numbers of wavelengths to try.
    """
    white_xyz = matrix @ white
    luminance = spectra @ matrix[1]
    spectra = spectra[luminance > 1e-9 * luminance.max()]
    # Equal weight to dark and bright; an error is seen against the brightness.
    spectra = spectra / (spectra @ matrix[1])[:, None] * white_xyz[1]
    solved, held = spectra[::2], spectra[1::2]
    wanted = solved @ matrix.T
    moments, products = solved.T @ solved, solved.T @ wanted
    truth = lab_from_xyz(held @ matrix.T, white_xyz)
    for count in counts:
        samples = _select(count, moments, products)
        weights, _ = _solve(samples, moments, products)
        difference = delta_e(truth, lab_from_xyz(held[:, samples] @ weights.T, white_xyz))
        found = Quadrature(np.array(samples), weights, float(difference.mean()), float(np.percentile(difference, 99)))
        if found.delta_e_mean <= target_mean and found.delta_e_p99 <= target_p99:
            break
    return found
