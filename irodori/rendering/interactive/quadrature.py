"""Spectral quadrature: few wavelengths and weights that integrate a scene's radiance into XYZ."""

from dataclasses import dataclass

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz
from irodori.rendering.scene_arrays import Light, Objects, coefficients_of

#: Numbers of wavelengths that fill a vector of 8, 16 or 32 lanes together with the two numbers of gloss.
COUNTS = (6, 14, 30)
_PATHS = 4000
_SEED = 7
_RIDGE = 1e-9


@dataclass(frozen=True)
class Quadrature:
    """Wavelengths and weights of a spectral quadrature, with its errors.

    Parameters
    ----------
    samples : (n,) int
        Indices among the 61 wavelengths.
    weights : (3, n) float64
        XYZ is ``weights @ radiance[samples]``.
    delta_e_mean, delta_e_p99 : float
        Mean and 99th percentile of CIEDE2000 over path spectra that were not used to solve for the weights.
    """

    samples: np.ndarray
    weights: np.ndarray
    delta_e_mean: float
    delta_e_p99: float


def path_spectra(objects: Objects, light: Light, lamps: np.ndarray, bounces: int) -> np.ndarray:
    """Return random spectra of paths in a scene, (n, 61): light from the sky, off texels and through coloured mirrors.

    Directions, normals and texels are drawn at random with a fixed seed.
    """
    rng = np.random.default_rng(_SEED)
    sky = light.pixels[rng.integers(light.size[0, 0] * light.size[0, 1], size=_PATHS)].astype(np.float64) @ light.basis
    lit = light.irradiance[rng.integers(len(light.irradiance), size=_PATHS)].astype(np.float64) @ light.basis / np.pi
    if len(lamps):
        lit = lit + rng.random((_PATHS, len(lamps))) ** 4 @ lamps / np.pi
    which = rng.integers(len(objects.bases), size=_PATHS)
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
    """Return the least-squares weights for chosen wavelengths, and their squared error up to a constant."""
    gram = moments[np.ix_(chosen, chosen)]
    gram = gram + _RIDGE * np.trace(gram) / len(chosen) * np.eye(len(chosen))
    weights = np.linalg.solve(gram, products[chosen]).T
    return weights, -float(np.sum(weights * products[chosen].T))


def _best(rest: list[int], moments: np.ndarray, products: np.ndarray) -> tuple[float, int]:
    """Return the least error that one more wavelength next to those in ``rest`` can give, and that wavelength."""
    left = (s for s in range(len(moments)) if s not in rest)
    return min((_solve([*rest, s], moments, products)[1], s) for s in left)


def _select(count: int, moments: np.ndarray, products: np.ndarray) -> list[int]:
    """Return ``count`` wavelengths, chosen greedily one by one and then exchanged while that reduces the error."""
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
            # Errors are differences of large sums: a gain below their rounding does not count.
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
    """Return the quadrature with the fewest wavelengths within the targets, or with the most if none is.

    Parameters
    ----------
    spectra : (n, 61) float
        Radiances to integrate; weights are solved on every second one, and errors measured on the others.
    matrix : (3, 61) float
        Matrix from radiance to XYZ.
    white : (61,) float
    target_mean, target_p99 : float
        Limits of mean and 99th percentile of CIEDE2000.
    counts : tuple of int
        Numbers of wavelengths to try, increasing.
    """
    white_xyz = matrix @ white
    luminance = spectra @ matrix[1]
    spectra = spectra[luminance > 1e-9 * luminance.max()]
    # Spectra are scaled to equal luminance, because errors are seen relative to the brightness.
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
