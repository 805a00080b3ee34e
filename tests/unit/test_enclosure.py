"""Points inside balls and closed meshes, and the refusal of an eye inside a thing."""

from dataclasses import replace

import numpy as np
import pytest
from test_distance_to_reference import STUDIO, scene_of

from irodori.core.errors import InputError
from irodori.geometry.enclosure import encloses, winding_number
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.rendering.eyes import refuse_enclosed_eye

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                 [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip


def test_a_cube_winds_once_about_its_points_and_an_open_box_by_the_rest_of_the_sphere():
    rng = np.random.default_rng(3)
    for _ in range(50):
        assert winding_number(CORNERS, CUBE, rng.uniform(-0.95, 0.95, 3)) == pytest.approx(1.0, abs=1e-12)
        outside = rng.normal(size=3)
        outside *= 2.0 / np.linalg.norm(outside)
        assert winding_number(CORNERS, CUBE, outside) == pytest.approx(0.0, abs=1e-12)
    # Each side is a sixth of the sphere seen from the middle.
    assert winding_number(CORNERS, CUBE[2:], np.zeros(3)) == pytest.approx(5 / 6)


def test_a_placed_ball_and_its_triangles_enclose_the_same_points():
    ball = STUDIO[0][1]
    mesh, turn, rng = TriangleMesh(ball.facetted(20.0)), rotation_xyz([20.0, 50.0, -70.0]), np.random.default_rng(4)
    for distance, inside in ((0.0, True), (37.0, True), (41.0, False), (90.0, False)):
        for shape in (ball, mesh):
            thing = Placement(shape, turn, np.array([5.0, -9.0, 70.0]), 2.0)
            towards = rng.normal(size=3)
            point = thing.translation_mm + distance * towards / np.linalg.norm(towards)
            assert encloses(thing, point) == inside, (shape.name, distance)


def test_an_eye_inside_a_thing_is_refused_in_one_sentence():
    scene = scene_of({"kind": "reference"})
    refuse_enclosed_eye(scene, "v", STUDIO[0])
    inside = replace(scene, views={"v": replace(scene.views["v"], position_mm=(0.0, 3.0, 25.0))})
    with pytest.raises(InputError, match=r"views\.v\.position_mm: found an eye inside jar; accepted: ") as caught:
        refuse_enclosed_eye(inside, "v", STUDIO[0])
    assert "\n" not in str(caught.value)
