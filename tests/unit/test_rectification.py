"""From pictures to texels: the right place, the right angles, nothing from what is unseen, unlit or saturated."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made

from irodori.config.capture_table import Pose
from irodori.config.models import (
    BodyShape,
    Object,
    ObjectShape,
    Optics,
)
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core import store
from irodori.geometry.embree import Tracer
from irodori.geometry.lathe import lathe, write_obj
from irodori.geometry.rig_frame import rig_from_object
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.rectification.stage import RigSetup, _sample, _Window, observe, rectify_object

ROOT = Path(__file__).resolve().parents[2]
OPTICS = yaml.safe_load((ROOT / "config/cameras/d5100-comb.yaml").read_text())["optics"]
DISTANCE = 900.0
PROVENANCE = store.Provenance("test")
PLATE = {"shape": {"kind": "plate", "width_mm": 80.0, "height_mm": 60.0}, "texels": {"width": 24, "height": 18}}
SPHERE = {"shape": {"kind": "sphere", "radius_mm": 25.0}, "texels": {"width": 48, "height": 24}}


def setup_of(table_radius_mm=0.0) -> RigSetup:
    return RigSetup.from_definitions(
        made(Optics, OPTICS),
        made(RigGeometry, {"camera_distance_mm": DISTANCE, "table_radius_mm": table_radius_mm}),
    )


def texels_in_rig(definition, pose):
    """Positions and normals of the texels in the rig's frame, (n, 3) each, by the documented parametrisation."""
    width, height = definition["texels"]["width"], definition["texels"]["height"]
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    u, v = u.ravel(), v.ravel()
    if definition["shape"]["kind"] == "plate":
        size = definition["shape"]
        position = np.stack([(u - 0.5) * size["width_mm"], (0.5 - v) * size["height_mm"], 0 * u], axis=1)
        normal = np.tile([0.0, 0.0, 1.0], (u.size, 1))
    else:
        azimuth, zenith = 2 * np.pi * u, np.pi * v
        normal = np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)], axis=1)
        position = definition["shape"]["radius_mm"] * normal
    turn, tilt = math.radians(pose.turn_deg), math.radians(pose.tilt_deg)
    about_z = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    about_y = np.array([[math.cos(tilt), 0, math.sin(tilt)], [0, 1, 0], [-math.sin(tilt), 0, math.cos(tilt)]])
    rotation = about_y @ about_z
    return position @ rotation.T, normal @ rotation.T


def pixel_of(position, pose):
    """Where a pinhole on the rig's arm sees points, in superpixels, from angles off its axis."""
    angle = math.radians(pose.camera_deg)
    axis = np.array([math.sin(angle), 0.0, -math.cos(angle)])  # from the camera to the origin
    right = np.array([math.cos(angle), 0.0, math.sin(angle)])
    up = np.array([0.0, 1.0, 0.0])
    ray = position + DISTANCE * axis
    focal = OPTICS["focal_length_mm"] / (OPTICS["pixel_pitch_um"] * 1e-3)
    x = OPTICS["principal_point_px"][0] + focal * (ray @ right) / (ray @ axis)
    y = OPTICS["principal_point_px"][1] - focal * (ray @ up) / (ray @ axis)
    # Integer superpixel coordinates are centres of 2 x 2 mosaic pixels.
    return np.stack([x / 2 - 0.5, y / 2 - 0.5], axis=1)


def linear_file(path, pose, response=None, valid=None, clipped=None, sample_px=2):
    """A capture whose responses are known functions of the place in the picture: linear, so interpolation is exact."""
    height, width = OPTICS["height_px"] // 2, OPTICS["width_px"] // 2
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if response is None:
        response = np.stack([x / 512, y / 512, (3 * x - 2 * y) / 512], axis=-1)
    valid = np.ones((height, width), np.uint8) if valid is None else valid
    clipped = np.zeros(valid.shape, np.uint8) if clipped is None else clipped
    with store.create(path, PROVENANCE) as out:
        out.write("response", response.astype(np.float32), units="1", dims="row,column,band", quantity="response")
        out.write("valid", valid, units="1", dims="row,column", quantity="valid")
        out.write("clipped", clipped, units="1", dims="row,column", quantity="clipped")
        noise = np.arange(2.0 * response.shape[-1]).reshape(-1, 2) * pose.light_deg
        out.write("noise_model", noise, units="1", dims="band,term", quantity="noise")
        out.attribute("sample_px", sample_px)
        out.attribute("pose_deg", [pose.light_deg, pose.camera_deg, pose.tilt_deg, pose.turn_deg])
        out.attribute("filters", ["out"])
    return path


def rectify(tmp_path, definition, poses, *, rows=None, max_angle_deg=85.0, table=0.0, name="obs.h5", **picture):
    files = [linear_file(tmp_path / f"{pose.name}.h5", pose, **picture) for pose in poses]
    rows = rows or (0, definition["texels"]["height"])
    rectify_object(
        files,
        made(Object | TexturedObject, definition),
        setup_of(table),
        rows,
        max_angle_deg,
        output=tmp_path / name,
        provenance=PROVENANCE,
    )
    with store.open_file(tmp_path / name) as file:
        return {name: file.read(name) for name in ("response", "geometry", "weight", "shadowed", "clipped", "texel")}


PLATE_POSES = [
    Pose(45.0, 0.0), Pose(45.0, 30.0), Pose(60.0, 55.0), Pose(45.0, 10.0, 20.0), Pose(50.0, 25.0, 10.0, 30.0),
]  # fmt: skip


@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_texels_take_their_own_place_in_the_picture(tmp_path, definition):
    found = rectify(tmp_path, definition, PLATE_POSES)
    for j, pose in enumerate(PLATE_POSES):
        position, _ = texels_in_rig(definition, pose)
        x, y = pixel_of(position, pose).T
        expected = np.stack([x / 512, y / 512, (3 * x - 2 * y) / 512], axis=1)
        seen = found["weight"][:, j] > 0
        assert seen.mean() > (0.99 if definition is PLATE else 0.2)
        # A thousandth of a superpixel.
        assert np.abs(found["response"][seen, j] - expected[seen]).max() <= 5e-3 / 512


@given(light=st.floats(35, 89), camera=st.floats(0, 70), tilt=st.floats(0, 19))
@settings(deadline=None, max_examples=60)
def test_angles_at_a_plates_centre_are_those_of_the_rig(light, camera, tilt):
    pose = Pose(light, camera, tilt)
    shape = Shape.from_definition(made(ObjectShape | BodyShape, PLATE["shape"]))
    rotation = rig_from_object(pose)
    tracer = Tracer([Placement(shape, rotation)])
    xy, geometry, visible, lit, power = observe(np.zeros((1, 3)), rotation[:, 2][None], tracer, pose, setup_of())
    incidence, view = math.radians(light - tilt), math.radians(camera + tilt)
    assert visible[0] and lit[0] and power[0] == 1.0
    expected = [incidence, view, (incidence + view) / 2, abs(incidence - view) / 2]
    assert np.abs(geometry[0] - expected).max() <= 1e-9
    centre = [OPTICS["principal_point_px"][0] / 2 - 0.5, OPTICS["principal_point_px"][1] / 2 - 0.5]
    assert np.abs(xy[0] - centre).max() <= 1e-6


def angle(a, b):
    return np.arccos(np.clip(np.sum(a * b, axis=1), -1, 1))


@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_angles_elsewhere_follow_the_camera_at_its_distance(tmp_path, definition):
    found = rectify(tmp_path, definition, PLATE_POSES)
    for j, pose in enumerate(PLATE_POSES):
        position, normal = texels_in_rig(definition, pose)
        light, camera = math.radians(pose.light_deg), math.radians(pose.camera_deg)
        to_light = np.tile([math.sin(light), 0.0, math.cos(light)], (len(position), 1))
        to_eye = DISTANCE * np.array([-math.sin(camera), 0.0, math.cos(camera)]) - position
        to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
        half = (to_light + to_eye) / np.linalg.norm(to_light + to_eye, axis=1, keepdims=True)
        pairs = ((normal, to_light), (normal, to_eye), (half, to_light), (normal, half))
        expected = np.stack([angle(*pair) for pair in pairs], axis=1)
        assert np.abs(found["geometry"][:, j] - expected).max() <= 2e-6


def test_what_faces_away_has_no_weight_and_what_faces_both_has(tmp_path):
    poses = [Pose(45.0, 0.0), Pose(60.0, 40.0), Pose(120.0, 30.0), Pose(45.0, 25.0, 0.0, 90.0)]
    found = rectify(tmp_path, SPHERE, poses, max_angle_deg=85.0)
    for j, pose in enumerate(poses):
        theta_i, theta_r = found["geometry"][:, j, 0], found["geometry"][:, j, 1]
        away = (theta_i >= np.pi / 2) | (theta_r >= np.pi / 2)
        assert away.any() and (found["weight"][away, j] == 0).all()
        # A sphere alone hides nothing from itself but what faces away.
        facing = (theta_i < np.radians(84.9)) & (theta_r < np.radians(84.9))
        assert facing.any() and (found["weight"][facing, j] == 1).all(), pose
        assert not found["shadowed"][:, j].any()


@pytest.mark.parametrize("limit", [30.0, 60.0, 80.0])
def test_grazing_texels_are_kept_without_weight(tmp_path, limit):
    found = rectify(tmp_path, SPHERE, [Pose(45.0, 20.0)], max_angle_deg=limit)
    grazing = (found["geometry"][:, 0, :2] > np.radians(limit) + 1e-6).any(axis=1)
    frontal = (found["geometry"][:, 0, :2] < np.radians(limit) - 1e-6).all(axis=1)
    assert (found["weight"][grazing] == 0).all() and (found["weight"][frontal] == 1).all()
    assert np.isfinite(found["geometry"]).all()


def test_the_tables_shadow_falls_where_geometry_says(tmp_path):
    # Light from below the horizon: the table's top hides it from the lower texels.
    radius, top = SPHERE["shape"]["radius_mm"], 75.0
    pose = Pose(120.0, 10.0)
    definition = SPHERE | {"texels": {"width": 96, "height": 48}}
    found = rectify(tmp_path, definition, [pose], table=top, max_angle_deg=89.0)
    position, normal = texels_in_rig(definition, pose)
    light = math.radians(pose.light_deg)
    to_light = np.array([math.sin(light), 0.0, math.cos(light)])
    # The ray from a texel meets the plane z = -radius at this x; the top is a square around the axis.
    length = (-radius - position[:, 2]) / to_light[2]
    x, y = (position + length[:, None] * to_light)[:, :2].T
    outside = np.maximum(abs(x), abs(y)) - top
    facing = (normal @ to_light > 0.02) & (found["geometry"][:, 0, 1] < np.radians(88))
    hidden, free = facing & (outside < -0.5), facing & (outside > 0.5)
    assert hidden.sum() > 20 and free.sum() > 20
    assert (found["shadowed"][hidden] == 1).all() and (found["weight"][hidden] == 0).all()
    assert (found["shadowed"][free] == 0).all() and (found["weight"][free] == 1).all()


def test_observations_name_the_filter_states_of_their_bands(tmp_path):
    rectify(tmp_path, PLATE, [Pose(45.0, 0.0)])
    with store.open_file(tmp_path / "obs.h5") as file:
        assert file.attribute("filters") == ["out"]


def test_what_stands_before_a_texel_leaves_it_no_observation(tmp_path):
    """A post on a disc: the camera does not see the disc behind it, however well that is lit, and shows the post there.

    Without a view of it a texel has no weight and no response, and it lies in no shadow.
    """
    radius, height, post = 30.0, 30.0, 5.0
    profile = np.array([[radius, 0.0], [post, 0.0], [post, height], [0.0, height]])
    corners, uv = lathe(profile, 180)
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    solid = np.linalg.norm(sides, axis=1) > 1e-9
    write_obj(tmp_path / "post.obj", corners[solid], uv[solid])
    shape = {"kind": "mesh", "file": str(tmp_path / "post.obj"), "unit": "mm", "pivot_mm": [0, 0, 0]}
    columns, rows = 90, 60
    pose = Pose(45.0, 40.0)
    found = rectify(
        tmp_path, {"shape": shape, "texels": {"width": columns, "height": rows}}, [pose], max_angle_deg=89.0
    )
    # Texture rows run along the profile from its last point to its first: the disc's are the last.
    way = (radius - post) + height + post
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    r, azimuth = (radius - (1.0 - v) * way).ravel(), 2 * np.pi * u.ravel()
    disc = r > post + 1.0
    x, y = r * np.cos(azimuth), r * np.sin(azimuth)
    angle = math.radians(pose.camera_deg)
    to_eye = np.stack([-DISTANCE * math.sin(angle) - x, -y], axis=1)
    flat = np.linalg.norm(to_eye, axis=1)
    # Along the way over the ground: how near it comes to the axis, and how high the ray is where it meets the post.
    along = -(x * to_eye[:, 0] + y * to_eye[:, 1]) / flat
    beside = np.abs(x * to_eye[:, 1] - y * to_eye[:, 0]) / flat
    meets = along - np.sqrt(np.maximum(post**2 - beside**2, 0.0))
    high = meets * DISTANCE * math.cos(angle) / flat
    hidden = disc & (along > 0) & (beside < 0.9 * post) & (high < 0.95 * height)
    free = disc & (x > 0) & ((beside > 1.1 * post) | (high > 1.05 * height))
    assert hidden.sum() > 50 and free.sum() > 50
    for name in ("weight", "response", "shadowed", "clipped"):
        assert (found[name][hidden] == 0).all(), name
    assert (found["weight"][free] == 1).all() and (found["response"][free] != 0).all()


def test_texels_near_saturated_pixels_have_no_weight(tmp_path):
    height, width = OPTICS["height_px"] // 2, OPTICS["width_px"] // 2
    valid = np.ones((height, width), np.uint8)
    valid[140:160, 190:200] = 0
    pose = Pose(45.0, 0.0)
    found = rectify(tmp_path, PLATE | {"texels": {"width": 120, "height": 90}}, [pose], valid=valid)
    position, _ = texels_in_rig(PLATE | {"texels": {"width": 120, "height": 90}}, pose)
    x, y = pixel_of(position, pose).T
    # Bilinear interpolation touches pixels less than one away.
    touched = (x > 189.001) & (x < 199.999) & (y > 139.001) & (y < 159.999)
    clear = (x < 188.999) | (x > 200.001) | (y < 138.999) | (y > 160.001)
    assert touched.sum() > 20
    assert (found["weight"][touched] == 0).all() and (found["weight"][clear] == 1).all()


def test_texels_outside_the_picture_have_no_weight(tmp_path):
    huge = {"shape": {"kind": "plate", "width_mm": 400.0, "height_mm": 60.0}, "texels": {"width": 80, "height": 12}}
    pose = Pose(45.0, 0.0)
    found = rectify(tmp_path, huge, [pose])
    x, y = pixel_of(texels_in_rig(huge, pose)[0], pose).T
    inside = (x >= 0) & (x <= OPTICS["width_px"] / 2 - 1) & (y >= 0) & (y <= OPTICS["height_px"] / 2 - 1)
    assert 0.1 < inside.mean() < 0.9
    assert np.array_equal(found["weight"][:, 0] > 0, inside)


def tiled(tmp_path, definition, cuts=None):
    """Observations of the whole texture, and of its tiles put together."""
    rng = np.random.default_rng(1)
    size = (OPTICS["height_px"] // 2, OPTICS["width_px"] // 2)
    picture = {"response": rng.uniform(0, 1, (*size, 3)), "valid": (rng.uniform(size=size) < 0.95).astype(np.uint8)}
    height = definition["texels"]["height"]
    whole = rectify(tmp_path, definition, PLATE_POSES, table=20.0, **picture)
    parts = [
        rectify(tmp_path, definition, PLATE_POSES, rows=rows, table=20.0, name=f"tile-{rows[0]}.h5", **picture)
        for rows in itertools.pairwise([0, *(cuts or [height // 2]), height])
    ]
    return whole, {name: np.concatenate([part[name] for part in parts]) for name in whole}


@pytest.mark.parametrize("cuts", [[9], [1, 2, 17]])
@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_tiles_give_the_fit_the_same_observations_to_the_bit(tmp_path, definition, cuts):
    whole, parts = tiled(tmp_path, definition, cuts)
    for name in ("geometry", "weight", "shadowed"):
        assert np.array_equal(parts[name], whole[name]), name
    used = whole["weight"] > 0
    assert np.array_equal(parts["response"][used], whole["response"][used])


@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_tiles_are_bit_identical_to_the_whole(tmp_path, definition):
    whole, parts = tiled(tmp_path, definition)
    for name, values in whole.items():
        assert np.array_equal(parts[name], values), name


def test_noise_of_an_interpolated_response_is_carried_along_by_capture_and_band(tmp_path):
    poses = [Pose(45.0, 0.0), Pose(60.0, 30.0)]
    rectify(tmp_path, PLATE, poses)
    with store.open_file(tmp_path / "obs.h5") as file:
        noise = file.read("noise_model")
    # Bilinear weights squared, averaged over all places between four samples.
    left = np.mean([x * x + (1 - x) ** 2 for x in (np.arange(1000) + 0.5) / 1000]) ** 2
    assert noise.shape == (2, 3, 2)
    for j, pose in enumerate(poses):
        assert noise[j] == pytest.approx(np.arange(6.0).reshape(3, 2) * pose.light_deg * left, rel=1e-5)


def test_what_clips_is_told_from_what_is_masked_otherwise(tmp_path):
    height, width = OPTICS["height_px"] // 2, OPTICS["width_px"] // 2
    valid, clipped = np.ones((height, width), np.uint8), np.zeros((height, width), np.uint8)
    valid[140:160, 190:200] = 0
    clipped[140:160, 190:200] = 1
    valid[120:125, 180:185] = 0  # hot
    pose = Pose(45.0, 0.0)
    definition = PLATE | {"texels": {"width": 120, "height": 90}}
    found = rectify(tmp_path, definition, [pose], valid=valid, clipped=clipped)
    x, y = pixel_of(texels_in_rig(definition, pose)[0], pose).T
    touched = (x > 189.001) & (x < 199.999) & (y > 139.001) & (y < 159.999)
    clear = (x < 188.999) | (x > 200.001) | (y < 138.999) | (y > 160.001)
    assert touched.sum() > 20
    assert (found["clipped"][touched, 0] == 1).all() and (found["clipped"][clear, 0] == 0).all()
    hot = (x > 179.001) & (x < 184.999) & (y > 119.001) & (y < 124.999)
    assert hot.any() and (found["weight"][hot] == 0).all()


@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_full_resolution_gives_the_same_texels_as_superpixels(tmp_path, definition):
    """One scene that is linear over the sensor, sampled at superpixels and at mosaic pixels."""
    found = []
    for sample_px in (2, 1):
        height, width = OPTICS["height_px"] // sample_px, OPTICS["width_px"] // sample_px
        y, x = (np.mgrid[:height, :width] + 0.5) * sample_px  # of each sample's centre, mosaic pixels
        response = np.stack([x / 1024, y / 1024, (3 * x - 2 * y) / 1024], axis=-1)
        valid = np.ones((height, width), np.uint8)
        found.append(rectify(tmp_path, definition, PLATE_POSES, response=response, valid=valid, sample_px=sample_px))
    assert np.array_equal(found[0]["geometry"], found[1]["geometry"])
    both = (found[0]["weight"] > 0) & (found[1]["weight"] > 0)
    assert both.mean() > 0.99 * (found[0]["weight"] > 0).mean()
    assert np.abs(found[0]["response"] - found[1]["response"])[both].max() < 1e-5


def test_a_texel_on_a_sample_does_not_depend_on_the_window_that_is_read():
    rng = np.random.default_rng(5)
    response = rng.random((9, 9, 6), dtype=np.float32)
    valid, clipped = np.ones((9, 9), dtype=bool), np.zeros((9, 9), dtype=np.uint8)
    valid[2, 4], clipped[3, 4] = False, 1  # neighbours of the sample at column 3, row 2, without weight there
    xy = np.array([[3.0, 2.0], [3.0, 2.5], [2.5, 2.0]])
    found = []
    for first, last in ((1, 4), (1, 7), (0, 9)):
        out, good, clips = np.zeros((3, 6), dtype=np.float32), np.empty(3, dtype=bool), np.empty(3, dtype=np.uint8)
        window = slice(first, last)
        pictures = (picture[window, window] for picture in (response, valid, clipped))
        _sample(_Window(*pictures, np.array([first, first])), xy, out, good, clips)
        found.append((out.copy(), good.copy(), clips.copy()))
    assert found[0][1].all() and not found[0][2].any()
    np.testing.assert_array_equal(found[0][0][0], response[2, 3])
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)
