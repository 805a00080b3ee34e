"""Angles of the rig, rotations, the pinhole camera, texture coordinates, and the table."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made import made

from irodori.config.capture_table import Pose, flat_incidence_rad
from irodori.config.models import (
    BodyShape,
    ObjectShape,
    Optics,
)
from irodori.geometry import rig_frame
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.shapes.flat import THICKNESS_MM, uv_of_flat
from irodori.geometry.shapes.placement import Placement, on_table
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.sphere import Sphere, uv_of_sphere

ANGLE = st.floats(-180.0, 180.0)
POSE = st.builds(
    Pose,
    light_deg=st.floats(35.0, 125.0),
    camera_deg=st.floats(0.0, 140.0),
    tilt_deg=st.floats(0.0, 45.0),
    turn_deg=st.floats(0.0, 360.0),
)
POINT = arrays(np.float64, 3, elements=st.floats(-1000.0, 1000.0))
SIZE = st.floats(0.1, 1000.0)


def is_rotation(matrix):
    return np.allclose(matrix.T @ matrix, np.eye(3), atol=1e-14) and np.linalg.det(matrix) == pytest.approx(1.0)


def angle_between(a, b):
    return math.atan2(np.linalg.norm(np.cross(a, b)), a @ b)


# Rotations and the rig


@given(x=ANGLE, y=ANGLE, z=ANGLE)
def test_rotations_keep_lengths_and_handedness(x, y, z):
    assert is_rotation(rig_frame.rotation_xyz((x, y, z)))
    for rotation in (rig_frame.rotation_x, rig_frame.rotation_y, rig_frame.rotation_z):
        assert is_rotation(rotation(math.radians(x)))
        assert rotation(math.radians(x)) @ rotation(math.radians(-x)) == pytest.approx(np.eye(3), abs=1e-15)


def test_quarter_turns_send_axes_where_the_right_hand_says():
    x, y, z = np.eye(3)
    quarter = math.pi / 2
    assert rig_frame.rotation_x(quarter) @ y == pytest.approx(z, abs=1e-15)
    assert rig_frame.rotation_y(quarter) @ z == pytest.approx(x, abs=1e-15)
    assert rig_frame.rotation_z(quarter) @ x == pytest.approx(y, abs=1e-15)
    assert rig_frame.rotation_xyz((90, 90, 0)) @ y == pytest.approx(x, abs=1e-15)  # y to z about x, then z to x about y
    assert rig_frame.rotation_xyz((90, 0, 90)) @ y == pytest.approx(z, abs=1e-15)


@given(pose=POSE)
def test_rig_frames_are_rotations(pose):
    assert is_rotation(rig_frame.rig_from_object(pose))
    assert is_rotation(rig_frame.rig_from_camera(pose))


@given(pose=POSE)
@example(pose=Pose(45.0, 20.0, 10.0))
@example(pose=Pose(35.0, 140.0, 45.0, 90.0))
def test_a_flat_sample_sees_light_minus_tilt_and_camera_plus_tilt(pose):
    # Design §4. Tilt is towards the light, so it closes the angle to the light and opens that to the camera.
    normal = rig_frame.rig_from_object(pose)[:, 2]
    theta_i, theta_r = math.radians(pose.light_deg - pose.tilt_deg), math.radians(pose.camera_deg + pose.tilt_deg)
    assert normal @ rig_frame.to_light(pose) == pytest.approx(math.cos(theta_i), abs=1e-14)
    assert normal @ rig_frame.to_camera(pose) == pytest.approx(math.cos(theta_r), abs=1e-14)
    assert flat_incidence_rad(pose) == pytest.approx(theta_i, abs=1e-14)
    assert angle_between(rig_frame.to_light(pose), rig_frame.to_camera(pose)) == pytest.approx(
        math.radians(min(pose.light_deg + pose.camera_deg, 360 - pose.light_deg - pose.camera_deg)), abs=1e-13
    )


@given(pose=POSE)
def test_light_camera_and_normal_stay_in_one_plane_of_incidence(pose):
    for vector in (rig_frame.to_light(pose), rig_frame.to_camera(pose), rig_frame.rig_from_object(pose)[:, 2]):
        assert vector[1] == pytest.approx(0.0, abs=1e-15)
        assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-15)


def test_light_stands_at_plus_x_camera_at_minus_x_and_zero_looks_straight_down():
    pose = Pose(90.0, 90.0)
    assert rig_frame.to_light(pose) == pytest.approx([1, 0, 0], abs=1e-15)
    assert rig_frame.to_camera(pose) == pytest.approx([-1, 0, 0], abs=1e-15)
    assert rig_frame.rig_from_camera(Pose(45.0, 0.0))[:, 2] == pytest.approx([0, 0, -1], abs=1e-15)
    assert rig_frame.rig_from_object(Pose(45.0, 0.0, 30.0))[0, 2] > 0


@given(pose=POSE, turn=st.floats(0.0, 360.0))
def test_the_turn_moves_the_texture_and_not_the_normal(pose, turn):
    turned = Pose(pose.light_deg, pose.camera_deg, pose.tilt_deg, turn)
    assert rig_frame.rig_from_object(turned)[:, 2] == pytest.approx(rig_frame.rig_from_object(pose)[:, 2], abs=1e-15)
    relative = rig_frame.rig_from_object(pose).T @ rig_frame.rig_from_object(turned)
    expected = rig_frame.rotation_z(math.radians(turn - pose.turn_deg))
    assert relative == pytest.approx(expected, abs=1e-13)


@given(pose=POSE, distance=st.floats(10.0, 5000.0))
def test_the_rig_camera_looks_at_the_origin_with_y_up(pose, distance):
    camera = rig_frame.look_at(distance * rig_frame.to_camera(pose), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    assert rig_frame.rig_from_camera(pose) == pytest.approx(camera, abs=1e-13)


# Looking


@given(position=POINT, target=POINT, up=arrays(np.float64, 3, elements=st.floats(-1.0, 1.0)))
def test_look_at_points_forward_and_keeps_up_up(position, target, up):
    forward = target - position
    assume(np.linalg.norm(forward) > 1e-3 and np.linalg.norm(np.cross(forward, up)) > 1e-3 * np.linalg.norm(forward))
    matrix = rig_frame.look_at(position, target, up)
    assert np.allclose(matrix.T @ matrix, np.eye(3), atol=1e-9) and np.linalg.det(matrix) > 0
    assert matrix[:, 2] == pytest.approx(forward / np.linalg.norm(forward), abs=1e-12)
    assert matrix[:, 1] @ up < 0.0  # image y runs down
    assert matrix[:, 0] @ up == pytest.approx(0.0, abs=1e-9)


def test_look_at_refuses_views_without_a_direction_or_an_up():
    with pytest.raises(ValueError, match="coincide"):
        rig_frame.look_at([1, 2, 3], [1, 2, 3], [0, 0, 1])
    with pytest.raises(ValueError, match="up"):
        rig_frame.look_at([0, 0, 5], [0, 0, 0], [0, 0, 1])


# Pinhole

CAMERA = st.builds(
    Pinhole,
    focal_px=st.floats(100.0, 50000.0),
    centre_px=st.tuples(st.floats(0.0, 6000.0), st.floats(0.0, 4000.0)),
    width_px=st.just(6000),
    height_px=st.just(4000),
)


@given(
    camera=CAMERA,
    mosaic=st.tuples(st.floats(0.0, 6000.0), st.floats(0.0, 4000.0)),
    distance=st.floats(1.0, 1e4),
    position=POINT,
    angles=st.tuples(ANGLE, ANGLE, ANGLE),
)
@settings(deadline=None)
def test_a_pixels_ray_projects_back_to_the_pixel(camera, mosaic, distance, position, angles):
    rotation = rig_frame.rotation_xyz(angles)
    direction = camera.directions(np.array(mosaic), rotation)
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-14)
    seen = camera.project(position + distance * direction, position, rotation)
    # Superpixels are two mosaic pixels wide, and their centres are integers. Rounding of world coordinates, a few
    # 1e-13 mm, is seen at the distance of the point.
    rounding = 4e-13 * camera.focal_px / distance * max(1.0, np.linalg.norm(mosaic) / camera.focal_px) ** 3
    assert seen == pytest.approx(np.array(mosaic) / 2 - 0.5, abs=1e-9 + rounding)


@given(camera=CAMERA, point=POINT, position=POINT, angles=st.tuples(ANGLE, ANGLE, ANGLE))
@settings(deadline=None)
def test_the_ray_of_a_projected_point_passes_through_it(camera, point, position, angles):
    rotation = rig_frame.rotation_xyz(angles)
    offset = point - position
    distance = np.linalg.norm(offset)
    assume(distance > 1.0)
    seen = camera.project(point, position, rotation)
    if offset @ rotation[:, 2] <= 0:
        assert np.isnan(seen).all()
        return
    assume(offset @ rotation[:, 2] > 0.01 * distance)
    direction = camera.directions(2 * seen + 1, rotation)
    assert angle_between(direction, offset / distance) < 1e-11


def test_magnification_is_focal_length_over_distance():
    # 50 mm lens, 5 µm pixels, 1 m away: 10 mm are 0.5 mm on the sensor, 100 mosaic pixels, 50 superpixels.
    optics = {"focal_length_mm": 50, "pixel_pitch_um": 5, "principal_point_px": [300, 200], "width_px": 600}
    camera = Pinhole.from_optics(made(Optics, {**optics, "height_px": 400}))
    pose = Pose(45.0, 0.0)
    points = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
    centre, right, up = camera.project(points, [0.0, 0.0, 1000.0], rig_frame.rig_from_camera(pose))
    assert centre == pytest.approx([149.5, 99.5])
    assert right - centre == pytest.approx([50.0, 0.0])
    assert up - centre == pytest.approx([0.0, -50.0])


def test_a_plate_seen_from_above_reads_like_its_texture():
    position, _ = Plate(60.0, 40.0).texels(6, 4)
    camera = Pinhole(10000.0, (3000.0, 2000.0), 6000, 4000)
    seen = camera.project(position, [0.0, 0.0, 500.0], rig_frame.rig_from_camera(Pose(45.0, 0.0)))
    assert (np.diff(seen[..., 0], axis=1) > 0).all() and (np.diff(seen[..., 1], axis=0) > 0).all()


# Shapes


@given(width=st.integers(1, 40), height=st.integers(1, 40), size=st.tuples(SIZE, SIZE), is_flat=st.booleans())
@settings(deadline=None)
def test_texel_centres_have_the_texture_coordinates_of_their_centres(width, height, size, is_flat):
    shape = Plate(*size) if is_flat else Sphere(size[0])
    position, normal = shape.texels(width, height)
    assert position.shape == normal.shape == (height, width, 3)
    for row in range(height):
        for column in range(width):
            point = position[row, column]
            u, v = uv_of_flat(*size, *point[:2]) if is_flat else uv_of_sphere(*point)
            assert u == pytest.approx((column + 0.5) / width, abs=1e-13)
            assert v == pytest.approx((row + 0.5) / height, abs=1e-13)


@given(u=st.floats(0.0, 1.0, exclude_max=True), v=st.floats(1e-6, 1 - 1e-6), radius=SIZE)
def test_a_point_of_the_sphere_has_its_azimuth_and_polar_angle_as_coordinates(u, v, radius):
    azimuth, polar = 2 * math.pi * u, math.pi * v
    point = radius * np.array(
        [math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)]
    )
    found_u, found_v = uv_of_sphere(*point)
    assert found_v == pytest.approx(v, abs=1e-14)
    assert min(abs(found_u - u), 1 - abs(found_u - u)) < 1e-14  # u = 0 and u = 1 are one meridian


@given(point=POINT)
@example(point=np.array([1.0, -1e-30, 0.0]))
@example(point=np.array([-1.0, -0.0, 0.0]))
@example(point=np.array([0.0, 0.0, 1.0]))
@example(point=np.array([0.0, 0.0, -1.0]))
def test_every_direction_has_coordinates_inside_the_texture(point):
    u, v = uv_of_sphere(*point)
    assert 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0


def test_normals_point_out_of_the_shape():
    position, normal = Sphere(25.0).texels(16, 8)
    assert normal == pytest.approx(position / 25.0, abs=1e-14)
    position, normal = Plate(30.0, 20.0).texels(3, 2)
    assert (normal == [0.0, 0.0, 1.0]).all() and (position[..., 2] == 0).all()
    assert position[0, 0] == pytest.approx([-10.0, 5.0, 0.0]) and position[-1, -1] == pytest.approx([10.0, -5.0, 0.0])


def test_configured_shapes_are_the_named_ones_and_others_are_refused():
    plate = made(ObjectShape | BodyShape, {"kind": "plate", "width_mm": 30, "height_mm": 20})
    assert Shape.from_definition(plate) == Plate(30.0, 20.0)
    sphere = made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": 5})
    assert Shape.from_definition(sphere) == Sphere(5.0)
    with pytest.raises(ValueError, match=r"torus.*plate, sphere"):
        Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "torus"}))


# Placement


@given(angles=st.tuples(ANGLE, ANGLE, ANGLE), translation=POINT, scale=st.floats(0.1, 10.0), size=st.tuples(SIZE, SIZE))
@settings(deadline=None)
def test_placed_plates_keep_their_shape_and_face(angles, translation, scale, size):
    rotation = rig_frame.rotation_xyz(angles)
    a, b, c, d = Placement(Plate(*size), rotation, translation, scale).corners()
    tolerance = 1e-9
    assert np.linalg.norm(b - a) == pytest.approx(scale * size[0], abs=tolerance)
    assert np.linalg.norm(c - b) == pytest.approx(scale * size[1], abs=tolerance)
    assert (a + c) / 2 == pytest.approx(translation, abs=tolerance)
    assert (b + d) / 2 == pytest.approx(translation, abs=tolerance)
    area_vector = np.cross(b - a, d - a)  # counter-clockwise seen from the face
    assert area_vector == pytest.approx(scale**2 * size[0] * size[1] * rotation[:, 2], rel=1e-9, abs=1e-6)


@given(pose=POSE, radius=st.floats(1.0, 200.0), table=st.floats(1.0, 500.0))
def test_a_sphere_rests_on_the_table_at_any_tilt(pose, radius, table):
    rotation = rig_frame.rig_from_object(pose)
    ball, top = on_table(Sphere(radius), rotation, table)
    assert ball.translation_mm == pytest.approx(np.zeros(3), abs=0.0)
    normal = rotation[:, 2]
    assert top.corners() @ normal == pytest.approx(np.full(4, -radius), abs=1e-10)
    assert top.corners().mean(axis=0) == pytest.approx(-radius * normal, abs=1e-10)
    assert np.ptp(np.linalg.norm(top.corners() - top.corners().mean(axis=0), axis=1)) < 1e-9


@given(pose=POSE)
def test_a_plate_lies_its_thickness_above_the_table(pose):
    rotation = rig_frame.rig_from_object(pose)
    plate, top = on_table(Plate(50.0, 40.0), rotation, 100.0)
    assert plate.corners() @ rotation[:, 2] == pytest.approx(np.zeros(4), abs=1e-12)
    assert top.corners() @ rotation[:, 2] == pytest.approx(np.full(4, -THICKNESS_MM), abs=1e-12)


def test_a_table_of_radius_0_is_absent():
    assert len(on_table(Plate(50.0, 40.0), np.eye(3), 0.0)) == 1
