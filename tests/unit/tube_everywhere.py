"""Run by test_shapes in a process of its own: a shape from outside the package through all that asks shapes.

usage: python tube_everywhere.py OUTPUT PART ...
"""

import sys
import tempfile
from pathlib import Path

from tube import Tube

from irodori.geometry.shape_registry import register

register(Tube)

import numpy as np  # noqa: E402
from scenes import material, plate, sky, smooth_light  # noqa: E402
from test_flat_shapes import seen  # noqa: E402
from test_rectification import pixel_of, rectify  # noqa: E402

from irodori.config.capture_table import Pose  # noqa: E402
from irodori.config.definition import typed  # noqa: E402
from irodori.config.models import ObjectShape  # noqa: E402
from irodori.config.validation import load_schema  # noqa: E402
from irodori.geometry.embree import Tracer, hit_distance, hit_shape, new_ray, trace  # noqa: E402
from irodori.geometry.rig_frame import rig_from_object, rotation_xyz  # noqa: E402
from irodori.geometry.shapes.placement import Placement  # noqa: E402
from irodori.geometry.shapes.shape import Shape  # noqa: E402
from irodori.geometry.surfaces import face_viewer, make_surfaces, surface_at  # noqa: E402
from irodori.jit.compilation import njit  # noqa: E402
from irodori.rendering.reference import baking, filling_cache  # noqa: E402

BLOCK = {"kind": "tube", "radius_mm": 20.0, "height_mm": 60.0}


@njit(cache=True)
def _meet(surfaces, intersect, scene, origin, direction, found):
    ray, facet, (shape, point, normal, uv) = new_ray(), np.empty(3), found
    for r in range(shape.size):
        trace(intersect, scene, ray, origin[r], direction[r], np.inf)
        shape[r] = hit_shape(ray)
        if shape[r] >= 0:
            for axis in range(3):
                point[r, axis] = origin[r, axis] + hit_distance(ray) * direction[r, axis]
            uv[r, 0], uv[r, 1] = surface_at(surfaces, shape[r], ray, point[r], normal[r], facet)
            if face_viewer(normal[r], facet, direction[r]) <= 0.0:
                shape[r] = -2


def meet(tracer, origin, direction) -> tuple:
    """Shapes that rays meet, -1 for none and -2 for a back; points, normals and uv."""
    count = len(origin)
    found = np.empty(count, dtype=np.int64), np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 2))
    surfaces = make_surfaces(list(tracer.placements))
    _meet(surfaces, tracer.intersect_address, tracer.scene, origin, direction, found)
    return found


def traced() -> dict:
    """Distances and surfaces of rays; the shape from configuration."""
    shape = Shape.from_definition(typed(ObjectShape, BLOCK))
    placement = Placement(shape, rotation_xyz((20.0, 30.0, 40.0)), np.array([5.0, -3.0, 8.0]), 1.5)
    rng = np.random.default_rng(3)
    origin = rng.normal(size=(4000, 3))
    origin *= 300.0 / np.linalg.norm(origin, axis=1, keepdims=True)
    direction = rng.normal(size=origin.shape) * 15.0 - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    tracer = Tracer([placement])
    distance, hit = tracer.intersect(origin, direction)
    seen, point, normal, uv = meet(tracer, origin, direction)
    reached = origin + np.where(hit == 0, distance, 0.0)[:, None] * direction
    local = (point - placement.translation_mm) @ placement.rotation / placement.scale
    variants = [v["properties"]["kind"]["const"] for v in load_schema("object")["properties"]["shape"]["oneOf"]]
    return {
        "hit": hit, "seen": seen, "local": local, "uv": uv, "normal": normal @ placement.rotation,
        "exact": (reached - placement.translation_mm) @ placement.rotation / placement.scale,
        "variants": np.array(variants),
    }  # fmt: skip


def rectified() -> dict:
    """Observations of pictures whose responses are known functions of the place."""
    definition = {"shape": BLOCK, "texels": {"width": 48, "height": 24}}
    pose = Pose(35.0, 0.0, 45.0, 40.0)  # light and camera before the same side
    with tempfile.TemporaryDirectory() as folder:
        found = rectify(Path(folder), definition, [pose], max_angle_deg=88.0)
    position = Shape.from_definition(typed(ObjectShape, BLOCK)).texels(48, 24)[0].reshape(-1, 3)
    rotation = rig_from_object(pose)
    return {
        "response": found["response"],
        "weight": found["weight"],
        "pixel": pixel_of(position @ rotation.T, pose),
    }


VIEW = {"position": (0.0, -300.0, 0.0), "target": (0.0, 0.0, 0.0), "size": (32, 32), "fov": 8.0}
#: Nothing is seen of the inside, which is black.
FLOOR_VIEW = {"position": (0.0, -300.0, 20.0), "target": (0.0, 0.0, -30.0), "size": (48, 32), "fov": 20.0}


def rendered(integrator: str) -> dict:
    """Pictures of the tube under a smooth sky, in a white furnace on a floor, and of the floor alone, all of them grey.

    `interactive` is asked for XYZ: the loop for 61 bands takes twice as long to compile. The error that its light maps
    state is not measured: the paths from their texels would be one more loop to compile. Nor does `reference` trace the
    paths that fill its cache: in the furnace, where the light is the same everywhere, the cache is filled with that.
    """
    baking._error = lambda *_: 0.0
    cached = []

    def light_of_furnace(scene, places, *_):
        cached.append(places)
        return np.ones_like(places.halves)

    filling_cache.gathering_loop, filling_cache.light_at = lambda *_: None, light_of_furnace
    shape, grey, white = Shape.from_definition(typed(ObjectShape, BLOCK)), material(0.5), material(1.0)
    kind, white_light = {"kind": "interactive", "light_maps": True}, np.ones(61)
    if integrator == "reference":
        kind, white_light = {"kind": "reference", "samples": 256, "seed": 0, "cache": False}, None
    furnace = kind | {"cache": True} if integrator == "reference" else kind

    def level(*scene, **view):
        found = seen(*scene, **view, white=white_light)
        return found[..., 30] if integrator == "reference" else found[..., 1] / 100.0

    light = sky(lambda towards: smooth_light(towards)[..., None])
    tube = level([shape], [grey], [(0.0, 0.0, 0.0)], kind, light, **VIEW)
    both = level([plate(400.0), shape], [white, white], [(0.0, 0.0, -30.0), (0.0, 0.0, 0.0)], furnace, **FLOOR_VIEW)
    dark = [material(0.5), material(0.0)]
    shadow = level([plate(400.0), shape], dark, [(0.0, 0.0, -30.0), (0.0, 0.0, 0.0)], kind, **FLOOR_VIEW)
    alone = level([plate(400.0)], dark[:1], [(0.0, 0.0, -30.0)], kind, **FLOOR_VIEW)
    found = {"tube": tube, "furnace": both, "shadow": shadow, "alone": alone}
    if cached:
        found["texels"] = np.stack([cached[0].point, cached[0].normal], axis=1)[cached[0].surface == 1]
    return found


PARTS = {
    "traced": traced,
    "rectified": rectified,
    "reference": lambda: rendered("reference"),
    "interactive": lambda: rendered("interactive"),
}

if __name__ == "__main__":
    found = {f"{part} {name}": value for part in sys.argv[2:] for name, value in PARTS[part]().items()}
    np.savez(sys.argv[1], **found)
