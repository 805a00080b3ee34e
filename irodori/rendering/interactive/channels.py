"""Four representations of colour along a path, which share one rendering kernel.

At a hit, the numbers of the texel are multiplied with those of the light, one by one, and added to the pixel; light
from the sky and from blurred maps is added in its stored form. The representation determines what the numbers mean:

``spectral``
    61 bands. Throughput is a spectrum, and stored light is decoded at every look-up. Nothing is simplified; the other
    representations are compared with this one.
``quadrature``
    Radiance at a few wavelengths, with weights that integrate the scene's own spectra into XYZ.
``coefficients``
    X, Y and Z are sums of products of a number of the texel and one of the light, the fewest that the scene's own
    surfaces and light need (`product_forms`). They are exact, or with light maps within `LEFT_OUT`, after any number of
    reflections, while the throughput is the same for all wavelengths: each path has one diffuse or glossy surface
    between the light and the mirrors, and mirrors with constant n + ik are grey. Other light is stored as coefficients
    on its basis.
``rgb``
    Three products, as in an ordinary RGB renderer.

All operations are linear: negative samples, which spectral recovery and compression leave, are kept.
"""

from dataclasses import dataclass, replace

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.jit.vectors import width_of
from irodori.rendering.interactive.quadrature import Quadrature
from irodori.rendering.light_maps import LEFT_OUT, LightMaps
from irodori.rendering.scene_arrays import Light, Objects, coefficients_of, gloss_of, textures
from irodori.spectra.grid import SAMPLES

REPRESENTATIONS = ("spectral", "coefficients", "quadrature", "rgb")
#: Least number of lanes of the light in ``spectral``. With four, a picture would be about a twentieth faster, but the
#: loop, which takes longest of all to compile, would have to be compiled once more.
_LEAST_SPECTRAL_LIGHT = 8
#: Least number of products for each of X, Y and Z in ``coefficients``: most scenes share one compiled loop.
_LEAST_PRODUCTS = 4
#: Texels of an object from which products are found, about; amplitude of vectors that are not among them, relative to
#: the largest; and that of rounding errors.
_MOST_TEXELS, _RARE, _TINY = 1 << 14, 1e-4, 1e-7
#: Singular value, relative to the largest, below which XYZ of stored light have one dimension less.
_LEAST_VALUE = 1e-3
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
        light=_light_width(xyz_from_colour @ colour),
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


def _light_width(xyz_from_light: np.ndarray) -> int:
    """Return the lanes of stored light from which any XYZ can be made, for the matrix from stored light, (3, s).

    The light of other objects in gloss is stored as such light.
    """
    values = np.linalg.svd(xyz_from_light, compute_uv=False)
    return width_of(xyz_from_light.shape[1] + 3 - int((values > _LEAST_VALUE * values.max(initial=0.0)).sum()))


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


def light_vectors(light: Light, lamps: np.ndarray, maps: LightMaps | None) -> np.ndarray:
    """Return vectors of which the light on surfaces consists, (61, n), scaled by how much of each there is."""
    vectors = light.basis.T / np.pi if maps is None else maps.weighted_basis()
    return np.concatenate([vectors, lamps.T / np.pi], axis=1)


def _surface_vectors(objects: Objects) -> np.ndarray:
    """Return vectors of which the reflectances of surfaces consist, (61, n), scaled by how much of each there is."""
    found = []
    for basis, texels in zip(_bases(objects), textures(objects), strict=True):
        weights = coefficients_of(objects, texels).reshape(-1, objects.texels.shape[1] - 2 * objects.lobe.shape[1])
        weights = weights[:: -(-len(weights) // _MOST_TEXELS), : basis.shape[1]].astype(np.float64)
        values, vectors = np.linalg.eigh(weights.T @ weights / len(weights))
        # Rare colours are perhaps not among the chosen texels.
        scale = np.sqrt(np.maximum(values, _RARE**2 * values.max(initial=0.0)))
        found.append(basis @ (vectors * scale))
    return np.concatenate(found, axis=1)


def product_forms(
    objects: Objects, vectors: np.ndarray, matrix: np.ndarray, left_out: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return linear forms of reflectance and of light, (3 t, 61) each, whose products sum to X, Y and Z in turn.

    The sum Σ w S E over wavelengths is a bilinear form of a surface's S and the light's E. The singular vectors of its
    matrix give the fewest products for the surfaces and the light of a scene.

    Parameters
    ----------
    objects : Objects
    vectors : (61, n) float
        See `light_vectors`.
    matrix : (3, 61) float
        Weights of the wavelengths in X, Y and Z.
    left_out : float
        Largest part of the root mean square of X, Y and Z that may be left out.
    """
    surfaces = _surface_vectors(objects)
    parts = [np.linalg.svd(surfaces.T @ (weights[:, None] * vectors), full_matrices=False) for weights in matrix]
    rest = np.stack([np.append(np.square(values)[::-1].cumsum()[::-1], 0.0) for _, values, _ in parts])
    needed = int(np.argmax((rest <= left_out**2 * rest[:, :1]).all(axis=0)))
    # Lanes that would be empty have products as well.
    count = max((width_of(3 * needed + 2) - 2) // 3, _LEAST_PRODUCTS)
    of_surface, of_light = np.linalg.pinv(surfaces, _TINY), np.linalg.pinv(vectors, _TINY)
    forms = np.zeros((2, 3, count, SAMPLES))
    for channel, (left, values, right) in enumerate(parts):
        some = min(count, len(values))
        forms[0, channel, :some] = (left[:, :some] * values[:some]).T @ of_surface
        forms[1, channel, :some] = right[:some] @ of_light
    return forms[0].reshape(-1, SAMPLES), forms[1].reshape(-1, SAMPLES)


def coefficient_channels(
    objects: Objects, light: Light, lamps: np.ndarray, matrix: np.ndarray, maps: LightMaps | None
) -> Channels:
    """Return the channels of ``coefficients``: products of a surface's and the light's numbers for X, Y and Z in turn.

    With light maps, `LEFT_OUT` of X, Y and Z may be left out, else only rounding errors.

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
    of_surface, of_light = product_forms(objects, light_vectors(light, lamps, maps), matrix, _left_out(maps))
    count = len(of_surface)
    # Light that is not multiplied with a texel is carried as XYZ.
    colour = np.zeros((count, SAMPLES))
    colour[:: count // 3] = matrix
    index = np.repeat(np.stack([objects.n[:, :1], objects.k[:, :1]], axis=1), count, axis=2)
    return Channels(
        count=count,
        surface=width_of(count + 2),
        light=_light_width(matrix @ basis),
        coloured=False,
        texel_from_weights=tuple(of_surface @ b for b in _bases(objects)),
        irradiance_from_light=of_light @ basis / np.pi,
        stored_from_light=np.eye(k),
        baked_from_radiance=of_light,
        colour_from_radiance=colour,
        lamp_light=lamps @ of_light.T / np.pi,
        lamp_colour=lamps @ colour.T / np.pi,
        index=index,
        xyz_from_colour=np.repeat(np.eye(3), count // 3, axis=1),
        xyz_from_light=matrix @ basis,
        colour_from_light=np.zeros((count, k)),
    )


def _left_out(maps: LightMaps | None) -> float:
    return _TINY if maps is None else LEFT_OUT


def coefficient_width(objects: Objects, light: Light, lamps: np.ndarray, maps: LightMaps | None = None) -> int:
    """Return the lanes of a texel in ``coefficients``, for lamps (n, 61)."""
    forms = product_forms(
        objects, light_vectors(light, lamps, maps), xyz_from_radiance(np.ones(SAMPLES)), _left_out(maps)
    )
    return width_of(len(forms[0]) + 2)


def exact_representation(
    objects: Objects, light: Light, lamps: np.ndarray, maps: LightMaps | None = None
) -> tuple[str, str]:
    """Return the representation with the least work whose XYZ equal those of the 61 bands within rounding.

    A thousandth of the light of the scene's light maps may be neglected. Parameters are those of `coefficient_width`.

    Returns
    -------
    representation : str
        ``coefficients`` or ``spectral``.
    why : str
        Reason, for the log.
    """
    if not is_grey(objects):
        return "spectral", "gloss or a mirror has a refractive index that varies with the wavelength"
    width = coefficient_width(objects, light, lamps, maps)
    if width > width_of(SAMPLES + 2):
        return "spectral", f"products of light and surface need {width} numbers, more than {SAMPLES} bands"
    why = f"one surface a path and grey mirrors: XYZ by products of light and surface, {width} numbers, are exact"
    return "coefficients", why


def is_grey(objects: Objects) -> bool:
    """Return whether all gloss and all mirrors of the scene are grey: n + ik is the same for all wavelengths."""
    shines = objects.mirror > 0
    for i, texels in enumerate(textures(objects)):
        shines[i] |= any(beta.any() for beta, _ in gloss_of(objects, texels))
    return bool((objects.grey[shines] == 1).all())
