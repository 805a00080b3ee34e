"""Shapes that are turned and scaled, with light maps: what they hide of the surroundings and throw on one another.

The truth are paths that know of no turn and no scale: sizes are made larger, and the world is turned the other way.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made import made
from path_scenes import traced
from scenes import OPTIONS, material, pixel_rays, sky, smooth_light
from tube import Tube

from irodori.config.models import Scene
from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.mesh import make_mesh
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.disc import Disc
from irodori.geometry.shapes.placement import Placement, laid
from irodori.geometry.shapes.plane import Plane
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.sphere import Sphere
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material
from irodori.rendering.integrators import render_image

#: How the shape stands, and its neighbour, whose place is from the shape's origin in the shape's frame, mm.
PLACE_MM, TURN_DEG, SCALE = np.array([15.0, -10.0, 20.0]), (35.0, -50.0, 70.0), 1.6
BESIDE_MM, BESIDE_TURN_DEG, BESIDE_SCALE = np.array([6.0, -4.0, 24.0]), (-60.0, 25.0, 40.0), 0.7
EYE_MM, SIZE, FOV_DEG, SAMPLES = np.array([150.0, -280.0, 190.0]), (24, 18), 12.0, 384


def quadrangles(corners: np.ndarray) -> Shape:
    """A mesh of up to nine quadrangles (n, 4, 3), each with a square of the texture to itself."""
    square = np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]])
    uv = np.array([(square + np.divmod(i, 3)) / 3 for i in range(len(corners))])
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    return TriangleMesh(make_mesh(corners[:, halves].reshape(-1, 3, 3), uv[:, halves].reshape(-1, 3, 2)))


def corner(scale: float) -> Shape:
    """A floor and a wall, which shade each other."""
    floor = [(-25.0, -20.0, 0.0), (25.0, -20.0, 0.0), (25.0, 20.0, 0.0), (-25.0, 20.0, 0.0)]
    wall = [(-25.0, 20.0, 0.0), (25.0, 20.0, 0.0), (25.0, 20.0, 35.0), (-25.0, 20.0, 35.0)]
    return quadrangles(scale * np.array([floor, wall]))


def block(scale: float, turn: np.ndarray) -> Shape:
    """A box of unequal sides."""
    faces = []
    for axis in range(3):
        a, b, c = np.roll(np.eye(3), -axis, axis=0)
        for sign in (1.0, -1.0):
            faces.append([sign * (a + p * b) + q * c for p, q in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return quadrangles(scale * np.array(faces) * [24.0, 10.0, 16.0] @ turn.T)


#: Shapes as large as a scale makes them.
SHAPES = {
    "plate": lambda scale: Plate(60.0 * scale, 30.0 * scale),
    "disc": lambda scale: Disc(24.0 * scale),
    "plane": lambda scale: Plane(),
    "sphere": lambda scale: Sphere(20.0 * scale),
    "mesh": corner,
}
#: Neighbours, turned besides: a ball, and a mesh.
NEIGHBOURS = {"sphere": lambda scale, turn: Sphere(20.0 * scale), "mesh": block}


def matt(two_sided: bool) -> Material:
    """A surface of one colour, or of a bright and a dark side: such a sphere shows how it is turned."""
    if not two_sided:
        return material(0.6)
    azimuth, polar = 2 * np.pi * (np.arange(32) + 0.5) / 32, np.pi * (np.arange(16) + 0.5) / 16
    alpha = 0.5 + 0.3 * np.cos(azimuth) * np.sin(polar)[:, None]
    even = {name: np.full(alpha.shape, value) for name, value in (("beta", 0.0), ("mu", 0.1), ("green_response", 0.5))}
    return replace(material(0.6), alpha=alpha, coefficients=np.ones((*alpha.shape, 1), np.float32), **even)


@cache
def light(turned: bool) -> Environment:
    """Light that varies slowly, threefold between directions, in the world or in the shape's frame."""
    turn = rotation_xyz(TURN_DEG) if turned else np.eye(3)
    return sky(lambda direction: 0.5 + 0.5 * smooth_light(direction @ turn.T)[..., None], 128, 64)


def interactive(shape: str, neighbour: str, beside_mm, eye_mm, target_mm, *, light_maps: bool) -> np.ndarray:
    """Radiance by the integrator `interactive`, (height, width): turns and scales as a configuration gives them."""
    definition = {
        "image": {"width": SIZE[0], "height": SIZE[1]}, "lights": [],
        "objects": [
            {"object": "a", "position_mm": PLACE_MM.tolist(), "rotation_deg": list(TURN_DEG), "scale": SCALE},
            {"object": "b", "position_mm": beside_mm.tolist(), "rotation_deg": list(BESIDE_TURN_DEG),
             "scale": BESIDE_SCALE},
        ],
        "views": {"v": {"position_mm": eye_mm.tolist(), "target_mm": target_mm.tolist(), "up": [0.0, 0.0, 1.0],
                        "field_of_view_deg": FOV_DEG}},
        "integrator": {"kind": "interactive", "light_maps": light_maps},
    }  # fmt: skip
    shapes = [SHAPES[shape](1.0), NEIGHBOURS[neighbour](1.0, np.eye(3))]
    materials = [matt(shape == "sphere"), matt(False)]
    options = replace(OPTIONS, pixel_side=4)
    return render_image(made(Scene, definition), "v", shapes, materials, light(False), options)[0][..., 30]


#: Root mean square of the errors over a shape and over its neighbours, as parts of their mean radiance;
#: the noise of the paths is 0.005 to 0.010 of it.
TOLERANCES = {"plate": (0.03, 0.016), "disc": (0.03, 0.016), "plane": (0.02, 0.04), "sphere": (0.018, 0.01),
              "mesh": (0.04, 0.016)}  # fmt: skip


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("neighbour", ["sphere", pytest.param("mesh", marks=pytest.mark.heavy)])
def test_a_turned_and_scaled_shape_and_its_neighbour_shade_each_other_as_paths_say(shape, neighbour):
    turn, beside_turn = rotation_xyz(TURN_DEG), rotation_xyz(BESIDE_TURN_DEG)
    from_shape = BESIDE_MM + ([30.0, -10.0, 25.0] if shape == "sphere" else 0.0)
    eye, beside, target = (PLACE_MM + turn @ place for place in (EYE_MM, from_shape, 0.5 * from_shape))
    found, bare = (interactive(shape, neighbour, beside, eye, target, light_maps=maps) for maps in (True, False))
    # The same in the shape's frame and of full size.
    shapes = [SHAPES[shape](SCALE), NEIGHBOURS[neighbour](BESIDE_SCALE, turn.T @ beside_turn)]
    places, position = [PLACE_MM @ turn, beside @ turn], eye @ turn
    truth = traced(shapes, [matt(shape == "sphere"), matt(False)], light(True), SAMPLES, position=position,
                   target=target @ turn, size=SIZE, fov=FOV_DEG, places=places, up=turn[2])  # fmt: skip
    # Pixels that show one shape only.
    rays = pixel_rays(eye, target, (4 * SIZE[0], 4 * SIZE[1]), FOV_DEG).reshape(-1, 3) @ turn
    tracer = Tracer([Placement(one, translation_mm=place) for one, place in zip(shapes, places, strict=True)])
    seen = tracer.intersect(np.broadcast_to(position, rays.shape), rays)[1].reshape(SIZE[1], 4, SIZE[0], 4)
    seen = np.where(seen.min(axis=(1, 3)) == seen.max(axis=(1, 3)), seen.min(axis=(1, 3)), NO_HIT)
    for number, tolerance in enumerate(TOLERANCES[shape]):
        here = seen == number
        mean, noise = truth.radiance[here, 30].mean(), truth.standard_error[here, 30]
        error, without = (np.sqrt(np.mean((image - truth.radiance[..., 30])[here] ** 2)) for image in (found, bare))
        assert here.sum() >= 25 and np.sqrt(np.mean(noise**2)) <= 0.012 * mean
        assert error <= tolerance * mean
        # Much of the picture is what this test is about.
        assert number or without >= 3.0 * error


@pytest.mark.parametrize("rotation_deg", [(180.0, 0.0, 0.0), (90.0, 0.0, 0.0), (30.0, 20.0, 10.0)])
def test_a_shape_from_outside_that_is_turned_over_stands_on_the_table(rotation_deg):
    """The lowest point of a cylinder is on the rim of an end: half its height and its radius, projected."""
    tube = Tube(20.0, 60.0)
    upright = abs(rotation_xyz(rotation_deg)[2, 2])
    below = 30.0 * upright + 20.0 * np.sqrt(1.0 - min(upright, 1.0) ** 2)
    assert laid(tube, rotation_deg).translation_mm == pytest.approx([0.0, 0.0, tube.table_height_mm + below], abs=0.01)
