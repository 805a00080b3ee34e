"""Four representations of colour along a path, which share one rendering kernel.

At a hit, the numbers of the texel are multiplied with those of the light, one by one, and added to the pixel; light
from the sky and from blurred maps is added in its stored form. The representation determines what the numbers mean:

``spectral``
    61 bands. Throughput is a spectrum, and stored light is decoded at every look-up. Nothing is simplified; the other
    representations are compared with this one.
``quadrature``
    Radiance at a few wavelengths, with weights that integrate the scene's own spectra into XYZ.
``coefficients``
    Light is given by its coefficients on a basis; a texel holds the bilinear form from coefficients to XYZ. This is
    exact, after any number of reflections, while the throughput is the same for all wavelengths: each path has one
    diffuse or glossy surface between the light and the mirrors, and mirrors with constant n + ik are grey.
``rgb``
    Three products, as in an ordinary RGB renderer.

All operations are linear: negative samples, which spectral recovery and compression leave, are kept.
"""

from dataclasses import dataclass, replace

import numpy as np

from irodori.jit.vectors import width_of
from irodori.rendering.interactive.quadrature import Quadrature
from irodori.rendering.light_maps import LEFT_OUT, LightMaps
from irodori.rendering.scene_arrays import Light, Objects, gloss_of, textures
from irodori.spectra.grid import SAMPLES

REPRESENTATIONS = ("spectral", "coefficients", "quadrature", "rgb")
#: Least number of lanes of the light in ``spectral``. With four, a picture would be about a twentieth faster, but the
#: loop, which takes longest of all to compile, would have to be compiled once more.
_LEAST_SPECTRAL_LIGHT = 8
#: Linear sRGB primaries and D65, for `rgb`: XYZ of 1, 1, 1 is the white of D65 with Y = 1.
_XYZ_FROM_RGB = np.array(
    [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]
)


@dataclass(frozen=True)
class Channels:
    """Matrices of one representation for one scene: from spectra to channels, and from channels to XYZ.

    Parameters
    ----------
    count : int
        Number of channels, the numbers of a texel that are multiplied with light.
    surface, light : int
        Lanes of a texel and of stored light, see `irodori.rendering.interactive.representation_layout.Layout`.
    coloured : bool
        Whether the throughput differs between channels.
    texel_from_weights : tuple of (count, k) float64
        For each object, from the coefficients of S(λ) to the channels of a texel.
    irradiance_from_light : (count, k) float64
        From the coefficients of the irradiance to the light factor of a texel, 1 / π included.
    stored_from_light : (s, k) float64
        From the coefficients of the light to the form in which it is stored.
    baked_from_radiance : (count, 61) float64
        From the radiance of a perfect diffuser in the texel's place to the light factor of the texel.
    colour_from_radiance : (count, 61) float64
        From radiance to the channels of a pixel.
    lamp_light, lamp_colour : (lamps, count) float64
        Light factor of texels for a lamp of irradiance E(λ), and the colour of E / π itself.
    index : (objects, 2, count) float64
        n and k by channel.
    xyz_from_colour : (3, count) float64
        From channels to XYZ.
    xyz_from_light : (3, s) float64
        From stored light to XYZ.
    colour_from_light : (count, s) float64
        From stored light to channels; unused if ``coloured`` is false.
    """

    count: int
    surface: int
    light: int
    coloured: bool
    texel_from_weights: tuple[np.ndarray, ...]
    irradiance_from_light: np.ndarray
    stored_from_light: np.ndarray
    baked_from_radiance: np.ndarray
    colour_from_radiance: np.ndarray
    lamp_light: np.ndarray
    lamp_colour: np.ndarray
    index: np.ndarray
    xyz_from_colour: np.ndarray
    xyz_from_light: np.ndarray
    colour_from_light: np.ndarray


def _bases(objects: Objects) -> list[np.ndarray]:
    """Return the basis of each object's S(λ), (61, k)."""
    return [objects.basis[i, :k].T for i, k in enumerate(objects.bases)]


def mean_spectra(objects: Objects) -> list[np.ndarray]:
    """Return the mean S(λ) over the texels of each object, (61,)."""
    means = []
    for i, texels in enumerate(textures(objects)):
        weights = texels[..., : objects.bases[i]].reshape(-1, objects.bases[i])
        means.append(weights.mean(axis=0, dtype=np.float64) @ objects.basis[i, : objects.bases[i]])
    return means


def _by_channel(values: np.ndarray, objects: Objects, light: Light, lamps, xyz_from_colour, coloured: bool) -> Channels:
    """Return channels that are linear functionals of the spectrum, the rows of ``values``, (count, 61)."""
    count = len(values)
    basis = light.basis.T
    lamp = lamps @ values.T / np.pi
    index = np.stack([objects.n, objects.k], axis=1)
    weight = np.abs(values)
    colour = values @ basis
    return Channels(
        count=count,
        surface=width_of(count + 2),
        light=width_of(basis.shape[1]),
        coloured=coloured,
        texel_from_weights=tuple(values @ b for b in _bases(objects)),
        irradiance_from_light=colour / np.pi,
        stored_from_light=np.eye(basis.shape[1]),
        baked_from_radiance=values,
        colour_from_radiance=values,
        lamp_light=lamp,
        lamp_colour=lamp,
        index=index @ weight.T / weight.sum(axis=1),
        xyz_from_colour=xyz_from_colour,
        xyz_from_light=xyz_from_colour @ colour,
        colour_from_light=colour,
    )


def spectral_light_width(count: int) -> int:
    """Return the lanes of stored light on ``count`` basis vectors in ``spectral``: a power of two, at least 8."""
    return max(width_of(count), _LEAST_SPECTRAL_LIGHT)


def spectral_channels(objects: Objects, light: Light, lamps: np.ndarray, matrix: np.ndarray) -> Channels:
    """Return the channels of the representation ``spectral``, the 61 bands."""
    bands = _by_channel(np.eye(SAMPLES), objects, light, lamps, matrix, True)
    return replace(bands, light=spectral_light_width(light.basis.shape[0]))


def quadrature_channels(
    objects: Objects, light: Light, lamps: np.ndarray, quadrature: Quadrature, coloured: bool
) -> Channels:
    """Return the channels of the representation ``quadrature``, the wavelengths of a spectral quadrature."""
    chosen = np.eye(SAMPLES)[quadrature.samples]
    return _by_channel(chosen, objects, light, lamps, quadrature.weights, coloured)


def rgb_channels(objects: Objects, light: Light, lamps: np.ndarray, matrix: np.ndarray, white, coloured) -> Channels:
    """Return the channels of ``rgb``: linear sRGB of the light times that of the surface under white, over white's."""
    rgb = np.linalg.solve(_XYZ_FROM_RGB, matrix)
    of_white = rgb @ white
    basis = light.basis.T
    lamp = lamps @ rgb.T / np.pi
    seen = np.abs(rgb * white)
    return Channels(
        count=3,
        surface=width_of(3 + 2),
        light=width_of(3),
        coloured=coloured,
        texel_from_weights=tuple((rgb * white) @ b / of_white[:, None] for b in _bases(objects)),
        irradiance_from_light=rgb @ basis / np.pi,
        stored_from_light=rgb @ basis,
        baked_from_radiance=rgb,
        colour_from_radiance=rgb,
        lamp_light=lamp,
        lamp_colour=lamp,
        index=np.stack([objects.n, objects.k], axis=1) @ seen.T / seen.sum(axis=1),
        xyz_from_colour=_XYZ_FROM_RGB,
        xyz_from_light=_XYZ_FROM_RGB,
        colour_from_light=np.eye(3),
    )


def further_basis(spectra: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return the vectors (61, m) that extend the basis of a light, (61, k), to that of its light maps.

    Vectors that carry less than the share `irodori.rendering.light_maps.LEFT_OUT` of the maps' norm are left out.

    Parameters
    ----------
    spectra : (61, n) float
        See `irodori.rendering.light_maps.LightMaps.weighted_basis`.
    basis : (61, k) float
    """
    rest = spectra - basis @ (np.linalg.pinv(basis) @ spectra)
    left, values, _ = np.linalg.svd(rest, full_matrices=False)
    return left[:, : int((values > LEFT_OUT * np.linalg.norm(spectra)).sum())]


def coefficient_channels(
    objects: Objects, light: Light, lamps: np.ndarray, matrix: np.ndarray, further: np.ndarray
) -> Channels:
    """Return the channels of ``coefficients``: bilinear forms for X, Y and Z in turn, each over the light's basis.

    Light that objects reflect onto each other is not in the span of that basis. The forms have ``further`` vectors for
    it, (61, m).

    Raises
    ------
    ValueError
        If a mirror or gloss is coloured, because the light that it reflects is not in the span of the basis.
    """
    if not is_grey(objects):
        raise ValueError(
            "coefficients need a refractive index that does not vary with the wavelength where there is gloss or a "
            "mirror; accepted representations: spectral, quadrature, rgb"
        )
    basis = light.basis.T
    k = basis.shape[1]
    wide = np.concatenate([basis, further], axis=1)
    lit = wide.shape[1]
    # Lamps are further vectors of the light.
    spectra = np.concatenate([wide, lamps.T], axis=1)
    each = spectra.shape[1]
    irradiance = np.zeros((3, each, k))
    irradiance[:, :k] = np.eye(k) / np.pi
    lamp_light = np.zeros((len(lamps), 3, each))
    lamp_light[np.arange(len(lamps)), :, lit + np.arange(len(lamps))] = 1.0 / np.pi
    # Light that is not multiplied with a texel is carried as XYZ.
    colour = np.zeros((3 * each, SAMPLES))
    colour[::each] = matrix
    index = np.repeat(np.stack([objects.n[:, :1], objects.k[:, :1]], axis=1), 3 * each, axis=2)
    return Channels(
        count=3 * each,
        surface=width_of(3 * each + 2),
        light=width_of(k),
        coloured=False,
        texel_from_weights=tuple(
            np.einsum("cl,lj,lm->cjm", matrix, spectra, b).reshape(-1, b.shape[1]) for b in _bases(objects)
        ),
        irradiance_from_light=irradiance.reshape(-1, k),
        stored_from_light=np.eye(k),
        baked_from_radiance=np.tile(np.pad(np.linalg.pinv(wide), ((0, each - lit), (0, 0))), (3, 1)),
        colour_from_radiance=colour,
        lamp_light=lamp_light.reshape(len(lamps), 3 * each),
        lamp_colour=lamps @ colour.T / np.pi,
        index=index,
        xyz_from_colour=np.repeat(np.eye(3), each, axis=1),
        xyz_from_light=matrix @ basis,
        colour_from_light=np.zeros((3 * each, k)),
    )


def exact_representation(objects: Objects, light: Light, lamps: int, maps: LightMaps | None = None) -> tuple[str, str]:
    """Return the representation with the least work whose XYZ equal those of the 61 bands within rounding.

    A thousandth of the light of the scene's light maps may be neglected.

    Returns
    -------
    representation : str
        ``coefficients`` or ``spectral``.
    why : str
        Reason, for the log.
    """
    if not is_grey(objects):
        return "spectral", "gloss or a mirror has a refractive index that varies with the wavelength"
    basis = light.basis.T
    further = 0 if maps is None else further_basis(maps.weighted_basis(), basis).shape[1]
    numbers = 3 * (basis.shape[1] + further + lamps)
    if width_of(numbers + 2) > width_of(SAMPLES + 2):
        return "spectral", f"{numbers} products of light and surface are more than {SAMPLES} bands"
    why = f"one surface a path and grey mirrors: XYZ by {numbers} products of light and surface are exact"
    return "coefficients", why


def is_grey(objects: Objects) -> bool:
    """Return whether all gloss and all mirrors of the scene are grey: n + ik is the same for all wavelengths."""
    shines = objects.mirror > 0
    for i, texels in enumerate(textures(objects)):
        shines[i] |= any(beta.any() for beta, _ in gloss_of(objects, texels))
    return bool((objects.grey[shines] == 1).all())
