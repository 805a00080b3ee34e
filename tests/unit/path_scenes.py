"""Scenes for the tests of the `reference` integrator."""

from collections.abc import Sequence

import numpy as np
import trimesh
from made import made
from scenes import constant_light

from irodori.config.models import (
    BodyShape,
    ObjectShape,
    SceneLight,
    Size,
    View,
)
from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.rendering.reference.converging_picture import Picture, make_scene, render
from irodori.rendering.scene_arrays import make_objects, make_view

DARK = constant_light(0.0)


def traced(shapes, materials, light, samples, *, position=(0.0, -200.0, 0.0), target=(0.0, 0.0, 0.0), size=(41, 41),
           fov=13.0, places=None, rotations=None, lights=(), up=(0.0, 0.0, 1.0), **options) -> Picture:  # fmt: skip
    """Render a view of shapes by paths, in 8 replicates: their spread says something of a single pixel."""
    options.setdefault("replicates", 8)
    places = places or [(0.0, 0.0, 0.0)] * len(shapes)
    rotations = rotations or [np.eye(3)] * len(shapes)
    placements = [
        Placement(shape, turn, np.asarray(place, float))
        for shape, turn, place in zip(shapes, rotations, places, strict=True)
    ]
    objects, _ = make_objects(placements, materials)
    view = {"position_mm": position, "target_mm": target, "up": up, "field_of_view_deg": fov}
    camera = make_view(made(View, view), made(Size, {"width": size[0], "height": size[1]}))
    return render(
        make_scene(placements, objects, light, made(Sequence[SceneLight], lights)), camera, samples, **options
    )


def ball(radius_mm: float) -> Shape:
    return Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": radius_mm}))


def facetted_sphere(radius_mm: float, subdivisions: int, inward: bool = False) -> Shape:
    """A sphere of flat triangles, seen from outside or, as a room, from inside."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    faces = np.asarray(sphere.faces, dtype=np.int32)[:, :: -1 if inward else 1]
    vertices = np.asarray(sphere.vertices, dtype=np.float64)
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = across / np.linalg.norm(across, axis=1, keepdims=True)
    # One triangle has the whole texture, which is of one colour, for texels have one place each.
    uv = np.full((len(faces), 3, 2), 0.5)
    uv[0] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    return TriangleMesh(Mesh(vertices, faces, uv, np.repeat(normal[:, None], 3, axis=1)))


def deviations(picture: Picture, expected) -> np.ndarray:
    """Return by how many standard errors a picture is off: of 8 replicates, so by Student's law of 7 degrees."""
    error = np.maximum(picture.standard_error, 1e-6 * np.abs(expected) + 1e-30)
    return (picture.radiance - expected) / error
