"""Probes: rays through random points of a scene's pictures, rendered with simplifications by `interactive`.

The scene is prepared once, in full and in 61 bands. A simplification only changes that prepared scene: a limit, an
entry of a table, or another picture of the environment. Many candidates are thus rendered in little more time than one.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.geometry.shapes.shape_rows import COLUMNS, MIRROR, ROWS, SHAPE
from irodori.rendering.interactive.channels import spectral_channels
from irodori.rendering.interactive.cube_maps import environment_pyramid
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, Prepared, light_of
from irodori.rendering.interactive.pixel_rays import rays_through, render_rays
from irodori.rendering.interactive.prepared_scene import (
    PreparedWorld,
    bordered_size,
    colour_fields,
    environment_fields,
    make_irradiance,
    stored_texels,
)
from irodori.rendering.interactive.round_lobes import TAPS
from irodori.rendering.interactive.shading import FURTHER
from irodori.rendering.planning.modelled_scene import Model, SceneParts, coarser, prepare
from irodori.rendering.scene_arrays import Light, View, textures, under_coats

#: Value in place of a level for a texture that reflects nothing.
BLACK = -1


@dataclass(frozen=True)
class Changes:
    """Simplifications of a picture relative to the full model; by default none.

    Parameters
    ----------
    max_bounces : int, optional
        Number of mirror reflections.
    least_throughput : float
        Throughput below which a path ends.
    without_gloss, without_mirror : frozenset of int
        Objects without gloss or mirror term.
    light_basis : (k, 61), optional
        Replacement of the environment's basis: its projection on fewer vectors.
    sky_level : int
        Finest level of the environment that is used, 0 for full resolution.
    texture_level : dict
        Object -> number of halvings of its texture, or `BLACK`.
    """

    max_bounces: int | None = None
    least_throughput: float = 0.0
    without_gloss: frozenset = frozenset()
    without_mirror: frozenset = frozenset()
    light_basis: np.ndarray | None = None
    sky_level: int = 0
    texture_level: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Texture:
    """Size and first texel of a texture in the prepared scene; ``first`` is -1 for a level that is not made yet."""

    rows: int
    columns: int
    first: int


class Probes:
    """Random rays of a scene's pictures, and the scene prepared for them.

    Parameters
    ----------
    parts : SceneParts
    model : Model
        Full model.
    ladder : Light
        Environment with all its levels.
    views : list of View
        Views with equal shares of the rays: ray i belongs to view i modulo their number.
    count : int
        Number of rays.
    seed : int
        Seed of the random points.
    """

    def __init__(
        self, parts: SceneParts, model: Model, ladder: Light, views: list[View], count: int, seed: int
    ) -> None:
        rng = np.random.default_rng(seed)
        rays = [rays_through(view, rng.random((1, 2)) * (view.width, view.height))
                for view in (views[i % len(views)] for i in range(count))]  # fmt: skip
        self.count, self.views, self.view = count, len(views), views[0]
        self.rays = np.concatenate(rays)
        self._parts, self._ladder = parts, ladder
        self._lamps = tuple(CollimatedLamp(towards) for towards in parts.lamp_towards)
        matrix = xyz_from_radiance(parts.white)
        self._levels = self._places_of_textures()
        spare = sum(bordered_size(t.rows, t.columns) for (_, level), t in self._levels.items() if level)
        self._prepared = prepare(parts, model, matrix, spare_texels=spare)
        self._channels = spectral_channels(parts.objects, light_of(parts.environment), parts.lamp_spectra, matrix)
        self._skies: dict[int, dict] = {}
        self._met: dict[tuple, dict[str, float]] = {}
        self._fill = int(self._prepared.world.texture_first[-1]) + bordered_size(
            *(int(size) for size in parts.objects.texture_size[-1])
        )

    def radiance(self, changes: Changes = Changes()) -> np.ndarray:
        """Render all rays with simplifications and return their radiance, (count, 61) float64."""
        return self._render(changes)[0]

    def met(self, changes: Changes) -> dict[str, float]:
        """Return the mean numbers of traced rays, hits, glossy hits and misses per ray from the eye.

        Of the changes, only those of gloss, mirrors and limits of paths matter.
        """
        limits = changes.max_bounces, changes.least_throughput, changes.without_gloss, changes.without_mirror
        if limits not in self._met:
            figures = self._render(Changes(*limits))[1]
            self._met[limits] = {name: figures[name] / self.count for name in ("rays", "hits", "glossy", "misses")}
        return self._met[limits]

    def _render(self, changes: Changes) -> tuple[np.ndarray, dict[str, int]]:
        prepared = self._with(changes)
        figures: dict[str, int] = {}
        gloss = [self._gloss_of(i, changes.texture_level.get(i, 0)) for i in changes.without_gloss]
        kept = [[numbers.copy() for numbers in powers] for powers in gloss]
        for powers in gloss:
            for numbers in powers:
                numbers[...] = 0.0
        try:
            found = render_rays(prepared, self.view, self.rays, self._lamps, bands=True, figures=figures)
        finally:
            for powers, before in zip(gloss, kept, strict=True):
                for numbers, old in zip(powers, before, strict=True):
                    numbers[...] = old
        return found, figures

    def _with(self, changes: Changes) -> Prepared:
        """Return the prepared scene with all changes except those of gloss."""
        world, limits = self._prepared.world, self._prepared.limits
        least = changes.least_throughput
        bounces = limits.max_bounces if changes.max_bounces is None else changes.max_bounces
        limits = limits._replace(max_bounces=bounces, least_throughput=least, least_lobe=least / TAPS)
        fields: dict = {}
        if changes.light_basis is not None:
            fields |= self._on_basis(changes.light_basis)
        if changes.sky_level:
            fields |= self._sky(changes.sky_level)
        if changes.without_mirror or changes.texture_level:
            fields |= self._tables(world, changes)
        return replace(self._prepared, world=world._replace(**fields), limits=limits)

    def _on_basis(self, basis: np.ndarray) -> dict:
        light = light_of(self._parts.environment)._replace(basis=basis)
        matrix = xyz_from_radiance(self._parts.white)
        channels = spectral_channels(self._parts.objects, light, self._parts.lamp_spectra, matrix)
        fields = colour_fields(channels)
        if self._prepared.world.irradiance_side > 0:
            coated = under_coats(light, self._parts.environment, self._parts.objects)
            fields["irradiance"] = make_irradiance(coated, channels)[0]
        return fields

    def _sky(self, level: int) -> dict:
        if level not in self._skies:
            first, (columns, rows) = self._ladder.first_pixel[level], self._ladder.size[level]
            picture = self._ladder.pixels[first : first + columns * rows].reshape(rows, columns, -1)
            pyramid = environment_pyramid(picture, self._channels.stored_from_light, self._channels.light)
            self._skies[level] = environment_fields(pyramid, self._channels)
        return self._skies[level]

    def _tables(self, world: PreparedWorld, changes: Changes) -> dict:
        shape = world.shape.copy().reshape(-1, SHAPE)
        shape[list(changes.without_mirror), MIRROR] = 0.0
        first = world.texture_first.copy()
        for index, level in changes.texture_level.items():
            texture = self._texture(index, level)
            shape[index, COLUMNS], shape[index, ROWS] = texture.columns, texture.rows
            first[index] = texture.first
        return {"shape": shape.ravel(), "texture_first": first}

    def _places_of_textures(self) -> dict[tuple[int, int], Texture]:
        places, at = {}, 0
        for index, (columns, rows) in enumerate(self._parts.objects.texture_size):
            places[index, 0] = Texture(int(rows), int(columns), at)
            at += bordered_size(rows, columns)
            places[index, BLACK] = Texture(1, 1, -1)
            for level in range(1, halvings_of(columns, rows) + 1):
                places[index, level] = Texture(-(-int(rows) // 2**level), -(-int(columns) // 2**level), -1)
        return places

    def _texture(self, index: int, level: int) -> Texture:
        """Return the position of an object's texture at a level; if it is new, make it and append it to the texels."""
        texture = self._levels[index, level]
        if texture.first >= 0:
            return texture
        objects, world = self._parts.objects, self._prepared.world
        own = textures(objects)[index]
        made = np.zeros_like(own[:1, :1]) if level == BLACK else coarser(own, level)
        found = stored_texels(objects, index, made, self._channels)
        texture = self._levels[index, level] = replace(texture, first=int(self._fill))
        self._fill += bordered_size(texture.rows, texture.columns)
        for flat, numbers in zip((world.texels, world.further), found, strict=True):
            if flat.size:
                width = numbers.size // bordered_size(texture.rows, texture.columns)
                flat[texture.first * width : texture.first * width + numbers.size] = numbers
        return texture

    def _gloss_of(self, index: int, level: int) -> list[np.ndarray]:
        """Return the powers of an object's gloss components as views of the prepared texels."""
        texture, world = self._texture(index, level), self._prepared.world
        chosen = slice(texture.first, texture.first + bordered_size(texture.rows, texture.columns))
        powers = [world.texels.reshape(-1, self._channels.surface)[chosen, -2]]
        if world.further.size:
            further = world.further.reshape(-1, FURTHER)[chosen]
            powers += [further[:, 2 * i] for i in range(self._parts.objects.lobe.shape[1] - 1)]
        return powers


def halvings_of(columns: int, rows: int) -> int:
    """Return the number of times that a texture's resolution can be halved."""
    return max(int(np.log2(max(min(int(columns), int(rows)), 1))) - 1, 0)
