"""Reduced models of a scene for the interactive integrator, and their cost."""

from dataclasses import dataclass

import numpy as np

from irodori.geometry.embree import Tracer
from irodori.jit.vectors import width_of
from irodori.light.blurred_light import WIDTHS_RAD, first_level, level_height, prefiltered
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.rendering.interactive.channels import coefficient_width, spectral_light_width
from irodori.rendering.interactive.cube_maps import FACES, environment_side
from irodori.rendering.interactive.frame_renderer import Prepared, light_of, prepare_scene
from irodori.rendering.interactive.prepared_scene import levels_by_lobe
from irodori.rendering.interactive.quadrature import Quadrature, path_spectra, solve_quadrature
from irodori.rendering.interactive.round_lobes import TAPS, lobe_table
from irodori.rendering.light_maps import LightMaps
from irodori.rendering.scene_arrays import (
    Light,
    Objects,
    coats_of,
    coefficients_of,
    gloss_of,
    make_light,
    textures,
    under_coats,
)
from irodori.spectra.grid import SAMPLES

_CORNERS = 4  # of a bilinear look-up
#: Rows of the picture, at most, from which the leading vectors of the light are taken.
_MOMENT_ROWS = 256


@dataclass(frozen=True)
class Model:
    """All decisions of a plan for the interactive integrator.

    Parameters
    ----------
    gloss, mirror : tuple of bool
        For each object, whether its gloss and its mirror term are rendered.
    max_bounces : int
        Number of mirror reflections to follow.
    least_throughput : float
        Throughput below which a path ends or a lobe is skipped.
    light_bases : int
        Number of basis vectors of the environment's spectra.
    representation : str
    nodes : int
        Number of wavelengths; for the representation ``quadrature``.
    environment_halvings : int
        How often the resolution of the environment is halved.
    texture_halvings : tuple of int
        How often the resolution of each object's texture is halved.
    gloss_levels : (int, int)
        First and last-plus-one index of the levels in `irodori.light.blurred_light.WIDTHS_RAD` that are looked up;
        equal if there are none.
    diffuse : bool
        Whether any surface has a diffuse term.
    environment, irradiance : bool
        Whether the environment and the irradiance map are looked up.
    quadrature : Quadrature, optional
        Wavelengths and weights; solved for the scene by default.
    """

    gloss: tuple[bool, ...]
    mirror: tuple[bool, ...]
    max_bounces: int
    least_throughput: float
    light_bases: int
    representation: str
    nodes: int
    environment_halvings: int
    texture_halvings: tuple[int, ...]
    gloss_levels: tuple[int, int]
    diffuse: bool
    environment: bool
    irradiance: bool
    quadrature: Quadrature | None = None


@dataclass(frozen=True)
class SceneParts:
    """Objects, environment, tracer and lamps of a scene.

    ``white`` is the radiance that the display shows as white, (61,), to which colour differences refer. ``maps`` are
    the scene's light maps, or None.
    """

    objects: Objects
    environment: Environment
    tracer: Tracer
    lamp_towards: np.ndarray
    lamp_spectra: np.ndarray
    white: np.ndarray
    maps: LightMaps | None = None


def full_model(parts: SceneParts, max_bounces: int) -> Model:
    """Return the model without simplifications; only terms that the scene does not have are left out."""
    objects, environment = parts.objects, parts.environment
    count, shines = len(objects.bases), bool(environment.coefficients.any())
    gloss = tuple(bool(beta_of(objects, i).any()) for i in range(count))
    diffuse = any(is_diffuse(objects, i) for i in range(count))
    height, width = environment.coefficients.shape[:2]
    levels = (first_level(height, width), len(WIDTHS_RAD)) if shines and any(gloss) else (0, 0)
    return Model(
        gloss=gloss,
        mirror=tuple(bool(m > 0) for m in objects.mirror),
        max_bounces=max_bounces,
        least_throughput=0.0,
        light_bases=environment.basis.shape[1],
        representation="spectral",
        nodes=SAMPLES,
        environment_halvings=0,
        texture_halvings=(0,) * count,
        gloss_levels=levels,
        diffuse=diffuse,
        environment=shines,
        irradiance=shines and diffuse and parts.maps is None,
    )


def coarser(texture: np.ndarray, level: int) -> np.ndarray:
    """Return a texture whose texels are means over squares with sides of 2**level texels, smaller at the edges."""
    side = 2**level
    if level == 0:
        return texture
    rows, columns = (np.arange(0, size, side) for size in texture.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(texture, rows, axis=0, dtype=np.float64), columns, axis=1)
    counts = np.outer(
        np.diff(np.append(rows, texture.shape[0])),
        np.diff(np.append(columns, texture.shape[1])),
    )
    return (sums / counts[..., None]).astype(np.float32)


def is_diffuse(objects: Objects, index: int) -> bool:
    """Return whether an object has a diffuse term anywhere."""
    used = objects.basis[index].any(axis=1)
    return bool(coefficients_of(objects, textures(objects)[index])[..., used].any())


def beta_of(objects: Objects, index: int) -> np.ndarray:
    """Return the largest β of the gloss components of an object's texels, (rows, columns), 0 where μ is 0."""
    return np.maximum.reduce([beta for beta, _ in gloss_of(objects, textures(objects)[index])])


def levels_of_lobes(objects: Objects, gloss: tuple[bool, ...], finest: int) -> tuple[int, int]:
    """Return first and last-plus-one level of blurred light in which the gloss of objects is looked up.

    ``gloss`` selects the objects. All entries of the lobes' tables between the least and the largest roughness of the
    objects are considered, at every angle.
    """
    levels = levels_by_lobe(objects, gloss)
    if not levels:
        return 0, 0
    last = len(WIDTHS_RAD) - 1
    # A look-up is between a level and the next.
    first = int(np.clip(np.floor(min(level for level, _ in levels)), finest, last))
    return first, int(np.clip(np.floor(max(level for _, level in levels)) + 1, first, last)) + 1


def leading_basis(light: Light, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the leading principal vectors of a light's spectra and the matrix to coefficients on them.

    Returns
    -------
    to : (k, count) float64
        ``coefficients @ to`` are the coefficients on the new basis.
    basis : (count, 61) float64
    """
    columns, rows = light.size[0]
    step = -(-rows // _MOMENT_ROWS)
    pixels = light.pixels[: columns * rows].reshape(rows, columns, -1)[::step, ::step].astype(np.float64)
    weight = np.sqrt(np.sin(np.pi * (np.arange(0, rows, step) + 0.5) / rows))[:, None, None]
    flat = (pixels * weight).reshape(-1, pixels.shape[2])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    basis = np.linalg.svd(root @ light.basis, full_matrices=False)[2][:count]
    # The sign of a vector depends on the library: the element of largest magnitude is made positive.
    largest = basis[np.arange(len(basis)), np.abs(basis).argmax(axis=1)]
    basis = basis * np.sign(largest)[:, None]
    return light.basis @ basis.T, basis


def _light(light: Light, model: Model) -> Light:
    """Return the environment of a model, reduced in resolution and in basis vectors, from one with all levels."""
    level = model.environment_halvings
    first, (columns, rows) = light.first_pixel[level], light.size[level]
    pixels, basis = light.pixels[first : first + columns * rows], light.basis
    irradiance = light.irradiance
    coated = light.under_coats if model.irradiance else ()
    if model.light_bases < light.basis.shape[0]:
        to, basis = leading_basis(light, model.light_bases)
        pixels, irradiance = (pixels @ to).astype(np.float32), (irradiance @ to).astype(np.float32)
        coated = tuple((one @ to).astype(np.float32) for one in coated)
    size = np.array([(columns, rows)])
    if not model.environment:
        pixels, size = pixels[:0], np.zeros((1, 2), dtype=np.int64)
    irradiance_size = light.irradiance_size
    if not model.irradiance:
        irradiance, irradiance_size = irradiance[:0], np.zeros(2, dtype=np.int64)
    return Light(pixels, np.array([0]), size, basis, irradiance, irradiance_size, coated)


def _gloss(parts: SceneParts, model: Model) -> GlossMaps:
    """Return the blurred light of a model on its basis, without levels if the model does not look it up."""
    if model.gloss_levels[0] == model.gloss_levels[1]:
        return GlossMaps(0, ())
    coefficients, count = parts.environment.coefficients, model.light_bases
    to = None
    if count < coefficients.shape[2]:
        to, _ = leading_basis(light_of(parts.environment), count)
    stored = GlossMaps.stored(parts.environment, model.gloss_levels)
    if stored is None:
        first, levels = prefiltered(_on_basis(coefficients, to), model.gloss_levels)
    else:
        first, levels = stored.first, [_on_basis(level, to) for level in stored.levels]
    return GlossMaps(first, tuple(levels))


def _on_basis(coefficients: np.ndarray, to: np.ndarray | None) -> np.ndarray:
    """Return coefficients multiplied by the matrix ``to``, float32, or unchanged without a matrix."""
    return coefficients if to is None else (coefficients @ to).astype(np.float32)


def reduced_objects(objects: Objects, model: Model) -> Objects:
    """Return the objects of a model, with coarser textures and without the gloss and mirror terms left out."""
    texels, first, sizes = [], [0], []
    for index in range(len(objects.bases)):
        texture = coarser(textures(objects)[index], model.texture_halvings[index])
        if not model.gloss[index]:
            texture = texture.copy()
            texture[..., coefficients_of(objects, texture).shape[-1] :: 2] = 0.0
        texels.append(texture.reshape(-1, texture.shape[2]))
        first.append(first[-1] + len(texels[-1]))
        sizes.append(texture.shape[1::-1])
    return objects._replace(
        texels=np.concatenate(texels),
        first_texel=np.array(first[:-1]),
        texture_size=np.array(sizes),
        mirror=np.where(model.mirror, objects.mirror, 0.0),
    )


def solved_nodes(parts: SceneParts, bounces: int, matrix: np.ndarray, count: int) -> Quadrature:
    """Solve and return a quadrature of ``count`` wavelengths for a scene."""
    spectra = path_spectra(parts.objects, light_of(parts.environment), parts.lamp_spectra, bounces)
    return solve_quadrature(spectra, matrix, parts.white, counts=(count,))


def prepare(
    parts: SceneParts,
    model: Model,
    matrix: np.ndarray,
    ladder: Light | None = None,
    *,
    spare_texels: int = 0,
    smooth_outlines: bool = False,
) -> Prepared:
    """Prepare a scene for the frames of a model.

    Parameters
    ----------
    parts : SceneParts
    model : Model
    matrix : (3, 61) float
        Matrix from radiance to XYZ.
    ladder : Light, optional
        Environment with all its levels; made here by default if the model needs it.
    spare_texels, smooth_outlines
        See `irodori.rendering.interactive.frame_renderer.prepare_scene`.
    """
    light = light_of(parts.environment)
    if model.environment_halvings:
        light = make_light(parts.environment) if ladder is None else ladder
    if model.irradiance:
        light = under_coats(light, parts.environment, parts.objects)
    quadrature = None
    if model.representation == "quadrature":
        quadrature = model.quadrature or solved_nodes(parts, model.max_bounces, matrix, model.nodes)
    return prepare_scene(
        reduced_objects(parts.objects, model),
        _light(light, model),
        _gloss(parts, model),
        parts.tracer,
        model.representation,
        parts.white,
        lamps=parts.lamp_spectra,
        max_bounces=model.max_bounces,
        least_throughput=model.least_throughput,
        quadrature=quadrature,
        spare_texels=spare_texels,
        maps=parts.maps,
        smooth_outlines=smooth_outlines,
    )


def stays_grey(objects: Objects, model: Model) -> bool:
    """Return whether all gloss and mirror terms in a model are grey: n + ik is the same for all wavelengths."""
    shines = np.array(model.gloss) | (np.array(model.mirror) & (objects.mirror > 0))
    return bool((objects.grey[shines] == 1).all())


@dataclass(frozen=True)
class Widths:
    """Lanes of a model's texels and of its light, and other numbers that determine the work of a look-up."""

    surface: int
    light: int
    coloured: bool
    rows: int  # rows of round lobes that are looked up at a glossy hit


def objects_rows(objects: Objects) -> int:
    """Return the largest number of rows of round lobes, summed over gloss components, of any object."""
    rows = np.array([len(lobe_table(name).entries) for name in objects.lobes.names])
    return int(rows[objects.lobe].sum(axis=1).max())


def widths_of(parts: SceneParts, model: Model) -> Widths:
    """Return the widths of the vectors that a model's look-ups process."""
    rows = objects_rows(parts.objects)
    light, coloured = model.light_bases, not stays_grey(parts.objects, model)
    if model.representation == "spectral":
        return Widths(width_of(SAMPLES + 2), spectral_light_width(light), True, rows)
    if model.representation == "quadrature":
        return Widths(width_of(model.nodes + 2), width_of(light), coloured, rows)
    lit = light_of(parts.environment)
    if light < len(lit.basis):
        lit = lit._replace(basis=leading_basis(lit, light)[1])
    surface = coefficient_width(parts.objects, lit, parts.lamp_spectra, parts.maps)
    return Widths(surface, width_of(light), False, rows)


def memory_mb(parts: SceneParts, model: Model, widths: Widths) -> float:
    """Return the memory of a model's maps and textures, MB."""
    numbers = 0.0
    height = parts.environment.coefficients.shape[0] >> model.environment_halvings
    if model.environment:
        numbers += FACES * environment_side(height) ** 2 * 4.0 / 3.0 * widths.light
    if model.irradiance:
        maps = 1 + len(coats_of(parts.objects).n_k)
        numbers += maps * FACES * parts.environment.irradiance.shape[0] ** 2 * widths.surface
    for level in range(*model.gloss_levels):
        numbers += FACES * (2.0 / np.pi * level_height(WIDTHS_RAD[level])) ** 2 * 2 * widths.light
    numbers += sum(float(np.prod(one.shape[:2])) for one in parts.maps.maps) * widths.surface if parts.maps else 0.0
    for size, halvings in zip(parts.objects.texture_size, model.texture_halvings, strict=True):
        numbers += float(np.prod(np.ceil(size / 2.0**halvings) + 2)) * widths.surface
    return numbers * 4.0 / 1e6


def look_up_numbers(model: Model, widths: Widths, met: dict[str, float], has_maps: bool) -> float:
    """Return the estimated work for a pixel with one ray: how many numbers are multiplied and added.

    Parameters
    ----------
    met : dict
        Mean number of ``hits``, ``glossy`` hits and ``misses`` per ray.
    has_maps : bool
        Whether there are light maps.
    """
    decoding = widths.light * widths.surface if widths.coloured else 0
    maps = int(model.diffuse or any(model.gloss)) + int(model.irradiance or has_maps)
    a_hit = _CORNERS * widths.surface * maps
    blurred = model.gloss_levels[1] > model.gloss_levels[0]
    a_lobe = widths.rows * TAPS * (2 * _CORNERS * widths.light + decoding) if blurred else 0
    a_sky = 2 * _CORNERS * widths.light + decoding if model.environment else 0
    total = met["hits"] * a_hit + met["glossy"] * a_lobe + met["misses"] * a_sky
    return total + 3 * (widths.surface + (0 if widths.coloured else widths.light))
