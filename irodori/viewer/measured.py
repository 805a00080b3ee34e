"""Colour differences, CIEDE2000, between a page's rendering and that of the package, and the scenes to measure them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights, delta_e_xyz
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rotation_z
from irodori.geometry.shapes.placement import Placement
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.rendering.interactive.cube_maps import face_directions, fill_borders, look_up_cube
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, Prepared, light_of, prepare_scene, render_frame
from irodori.rendering.interactive.prepared_scene import gloss_for, indices, joined, padded
from irodori.rendering.light_maps import LightMaps as BakedMaps
from irodori.rendering.light_transfer import LightTransfer
from irodori.rendering.scene_arrays import Objects, View, under_coats
from irodori.spectra.grid import SAMPLES
from irodori.viewer.scene_data import BORDER, HALVED_FROM, LightMaps, finer

#: For a scene whose blurred light a payload replaces.
_NO_GLOSS = GlossMaps(0, ())


@dataclass(frozen=True)
class FrameParts:
    """Parts of a scene from which its frames are rendered.

    Parameters
    ----------
    objects : Objects
    placements : list of Placement
    environment : Environment
    lamps : (n, 61) float
        Spectral irradiance of the collimated lights.
    directions : (n, 3) float
        Directions towards the collimated lights.
    max_bounces : int
        Mirror reflections to follow.
    least_throughput : float
        Throughput below which a path ends.
    has_maps : bool
        Whether shapes hide light from each other and reflect it onto each other.
    """

    objects: Objects
    placements: list[Placement]
    environment: Environment
    lamps: np.ndarray
    directions: np.ndarray
    max_bounces: int
    least_throughput: float
    has_maps: bool = True

    @cached_property
    def transfer(self) -> LightTransfer:
        """Transfer of light to the scene's light maps."""
        return LightTransfer(Tracer(self.placements), self.objects, self.environment)

    def light_maps(self, turn_deg: float) -> BakedMaps | None:
        """Return the scene's light maps if its room is turned by an angle; None for a scene without."""
        if not self.has_maps:
            return None
        if turn_deg not in self._found:
            self._found[turn_deg] = self.transfer.maps(self.environment, turn_deg, self.lamps, self.directions)
        return self._found[turn_deg]

    @cached_property
    def _found(self) -> dict[float, BakedMaps]:
        return {}


@dataclass(frozen=True)
class Decoded:
    """Scene data decoded from a page's payload.

    Parameters
    ----------
    objects : Objects
    maps : LightMaps
    """

    objects: Objects
    maps: LightMaps


def prepared(parts: FrameParts, decoded: Decoded | None = None) -> Prepared:
    """Prepare a scene for frames of 61 bands, with objects and light decoded from a payload if given.

    A pixel has one ray, also at outlines, as in the pictures that are read from a page.
    """
    maps = None if decoded is None else decoded.maps
    # The coefficients of decoded light are on the basis vectors of the maps.
    environment = parts.environment if maps is None else replace(parts.environment, basis=maps.basis.T)
    objects = parts.objects if decoded is None else decoded.objects
    light, gloss = light_of(environment), None
    if not parts.has_maps:
        light = under_coats(light, environment, objects)
    if maps is not None and maps.sky is not None:  # its light replaces that of the environment
        pixels = np.zeros((0, light.pixels.shape[1]), np.float32)
        light = light._replace(pixels=pixels, size=np.array([(0, 0)]))
        gloss = _NO_GLOSS
    found = prepare_scene(
        objects,
        light,
        gloss or gloss_for(parts.environment, objects),
        Tracer(parts.placements),
        "spectral",
        np.ones(SAMPLES),
        lamps=parts.lamps,
        max_bounces=parts.max_bounces,
        least_throughput=parts.least_throughput,
        maps=parts.light_maps(0.0),
    )
    if maps is not None and maps.sky is not None:
        found.world = found.world._replace(**_fields(found, maps))
    return found


def _fields(scene: Prepared, maps: LightMaps) -> dict:
    """Return the fields of a `PreparedWorld` that hold light, from the maps of a payload."""
    assert maps.sky is not None and maps.irradiance is not None  # checked by the caller
    lanes, levels = scene.layout.light, [_bordered(np.moveaxis(maps.sky, 0, -1))]
    while levels[-1].shape[1] - 2 > 4:
        inner = levels[-1][:, 1:-1, 1:-1]
        side = inner.shape[1] // 2
        levels.append(_bordered(inner.reshape(6, side, 2, side, 2, -1).mean(axis=(2, 4))))
    fields = _joined("environment", levels, lanes)
    fields["environment_levels"] = len(levels)
    fields["texels_per_rad"] = float((levels[0].shape[1] - 2) * np.sqrt(6.0 / (4.0 * np.pi)))
    irradiance = [np.moveaxis(one, 0, -1) for one in (maps.irradiance, *maps.under_coats)]
    fields["irradiance"] = joined([padded(one @ maps.basis / np.pi, scene.layout.surface) for one in irradiance])
    fields["irradiance_side"] = irradiance[0].shape[1] - 2
    gloss = [np.moveaxis(level, 0, -1) for level in looked_up(maps)]
    pairs = []
    for place, level in enumerate(gloss):
        coarser = gloss[min(place + 1, len(gloss) - 1)]
        side = level.shape[1] - 2
        unit = np.stack([face_directions(face, side, 1) for face in range(6)])
        pair = [np.pad(values, [(0, 0)] * 3 + [(0, lanes - values.shape[-1])])
                for values in (level, look_up_cube(coarser, unit))]  # fmt: skip
        pairs.append(np.stack(pair, axis=3))
    fields |= _joined("gloss", pairs, lanes)
    fields |= {"gloss_levels": len(gloss), "gloss_level": float(maps.first)}
    return fields


def looked_up(maps: LightMaps) -> list[np.ndarray]:
    """Return the levels of blurred light at the resolution of look-ups, (k, 6, side + 2, side + 2) each."""
    pairs = zip(maps.gloss, maps.sides, strict=True)
    return [finer(level) if side > HALVED_FROM and level.shape[-1] == side // 2 + 2 * BORDER else level
            for level, side in pairs]  # fmt: skip


def _bordered(inner: np.ndarray) -> np.ndarray:
    """Return a cube map, (6, side, side, k), with a filled border, (6, side + 2, side + 2, k)."""
    stored = np.pad(inner, [(0, 0), (1, 1), (1, 1), (0, 0)])
    fill_borders(stored)
    return stored


def _joined(name: str, levels: list[np.ndarray], lanes: int) -> dict:
    """Return the fields of maps that are concatenated into one flat array, with their last axis padded to ``lanes``."""
    flat = [padded(level, lanes) for level in levels]
    texels = [math.prod(level.shape[:3]) for level in levels]
    sides = [level.shape[1] - 2 for level in levels]
    return {
        name: joined(flat),
        f"{name}_first": indices(np.cumsum(texels) - texels),
        f"{name}_side": np.array(sides, dtype=np.int32),
    }


def frame_bands(scene: Prepared, view: View, parts: FrameParts, turn_deg: float = 0.0) -> np.ndarray:
    """Render a frame under the room turned by an angle, and return its radiance, (height, width, 61)."""
    lamps = tuple(CollimatedLamp(direction) for direction in parts.directions)
    maps = parts.light_maps(turn_deg)
    if maps is not None:
        scene.show(maps)
    return render_frame(scene, view, world_from_light=rotation_z(np.radians(turn_deg)), lamps=lamps, bands=True)


def differences(bands: np.ndarray, other: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Return CIEDE2000 between two pictures of radiance, (..., 61), for a white, (61,), and the 2° observer."""
    matrix = colour_matching_weights()
    matrix = matrix * (100.0 / (matrix[1] @ white))
    return delta_e_xyz(bands @ matrix.T, other @ matrix.T, matrix @ white)


def mean_and_p99(values: Sequence[np.ndarray]) -> dict[str, float]:
    """Return mean and 99th percentile of values over all pixels of several pictures."""
    joined = np.concatenate([np.ravel(part) for part in values])
    return {"mean": round(float(joined.mean()), 4), "p99": round(float(np.percentile(joined, 99)), 4)}
