"""From pictures to texels: the right place, the right angles, nothing from what is unseen, unlit or saturated."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from lathe import lathe, write_obj
from made import made

from irodori.config.capture_table import Pose, flat_incidence_rad
from irodori.config.models import BodyShape, Object, ObjectShape, Optics, RigPose
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.embree import Tracer
from irodori.geometry.interpolation import keys_weights
from irodori.geometry.rig_frame import rig_from_object, rotation_xyz, to_light
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.sphere import Sphere
from irodori.material import tile_strips
from irodori.material.angle_errors import REGISTERED, AngleErrors, registered_errors
from irodori.material.observed_angles import read_angles
from irodori.rectification.placement_correction import COUNT
from irodori.rectification.stage import RigSetup, _sample, _Window, angles_in_captures, observe, rectify_object
from irodori.rectification.texture_tiles import tile_rows

ROOT = Path(__file__).resolve().parents[2]
OPTICS = yaml.safe_load((ROOT / "config/cameras/d5100-comb.yaml").read_text())["optics"]
DISTANCE = 900.0
PROVENANCE = store.Provenance("test")
PLATE = {"shape": {"kind": "plate", "width_mm": 80.0, "height_mm": 60.0}, "texels": {"width": 24, "height": 18}}
SPHERE = {"shape": {"kind": "sphere", "radius_mm": 25.0}, "texels": {"width": 48, "height": 24}}


def setup_of(table_radius_mm=0.0, lamp_distance_mm=None, white=None) -> RigSetup:
    rig = {"camera_distance_mm": DISTANCE, "table_radius_mm": table_radius_mm, "lamp_distance_mm": lamp_distance_mm}
    return RigSetup.from_definitions(
        made(Optics, OPTICS), made(RigGeometry, rig), white and made(RigPose, white.by_angle)
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


def linear_file(path, pose, *, response=None, valid=None, clipped=None, sample_px=2, filters=("out",), mosaic=""):
    """A capture whose responses are known functions of the place in the picture: linear, so interpolation is exact."""
    height, width = OPTICS["height_px"] // 2, OPTICS["width_px"] // 2
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if response is None:
        aside = {"": 0.0, "GBRG": 0.25}[mosaic]  # of red to the lower left of a superpixel's centre, of blue opposite
        response = np.stack([x - aside, y, 3 * (x + aside) - 2 * (y - aside)], axis=-1) / 512
    valid = np.ones((height, width), np.uint8) if valid is None else valid
    clipped = np.zeros(valid.shape, np.uint8) if clipped is None else clipped
    with store.create(path, PROVENANCE) as out:
        out.write("response", response.astype(np.float32), units="1", dims="row,column,band", quantity="response")
        out.write("valid", valid, units="1", dims="mask_row,mask_column", quantity="valid")
        out.write("clipped", clipped, units="1", dims="mask_row,mask_column", quantity="clipped")
        noise = np.arange(2.0 * response.shape[-1]).reshape(-1, 2) * pose.light_deg
        out.write("noise_model", noise, units="1", dims="band,term", quantity="noise")
        out.attribute("sample_px", sample_px)
        out.attribute("mosaic", mosaic)
        out.attribute("pose_deg", list(pose.angles_deg))
        if pose.placement > 1:
            out.attribute("placement", pose.placement)
        out.attribute("filters", list(filters))
    return path


def rectify(tmp_path, definition, poses, *, rows=None, max_angle_deg=85.0, setup=None, name="obs.h5", **picture):
    files = [linear_file(tmp_path / f"{pose.name}.h5", pose, **picture) for pose in poses]
    rows = rows or (0, definition["texels"]["height"])
    rectify_object(
        files,
        made(Object | TexturedObject, definition),
        setup or setup_of(),
        rows,
        max_angle_deg,
        output=tmp_path / name,
        provenance=PROVENANCE,
    )
    with store.open_file(tmp_path / name) as file:
        names = ("response", "weight", "shadowed", "clipped", "texel", "light_gain")
        return {name: file.read(name) for name in names if name in file} | {"geometry": read_angles(file)}


PLATE_POSES = [
    Pose(45.0, 0.0), Pose(45.0, 30.0), Pose(60.0, 55.0), Pose(45.0, 10.0, 20.0), Pose(50.0, 25.0, 10.0, 30.0),
]  # fmt: skip


@pytest.mark.parametrize("mosaic", ["", "GBRG"])
@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_texels_take_their_own_place_in_the_picture(tmp_path, definition, mosaic):
    """Also where red and blue are measured beside the centre of their superpixel."""
    found = rectify(tmp_path, definition, PLATE_POSES, mosaic=mosaic)
    for j, pose in enumerate(PLATE_POSES):
        position, _ = texels_in_rig(definition, pose)
        x, y = pixel_of(position, pose).T
        expected = np.stack([x / 512, y / 512, (3 * x - 2 * y) / 512], axis=1)
        seen = found["weight"][:, j] > 0
        assert seen.mean() > (0.99 if definition is PLATE else 0.2)
        # A thousandth of a superpixel, besides the rounding to float16, which is none in the mean.
        off = found["response"][seen, j].astype(np.float64) - expected[seen]
        rounding = 0.5 * np.spacing(expected[seen].astype(np.float16)).astype(np.float64)
        assert (np.abs(off) - rounding).max() <= 5e-3 / 512 and np.abs(off.mean(axis=0)).max() <= 0.03 / 512


def test_strips_of_a_tile_change_nothing(tmp_path, monkeypatch):
    whole = rectify(tmp_path, SPHERE, PLATE_POSES)
    width, height = (SPHERE["texels"][side] for side in ("width", "height"))
    monkeypatch.setattr(tile_strips, "MOST_OBSERVATIONS", 5 * width * len(PLATE_POSES))
    assert len(tile_strips.strips((0, height), width, len(PLATE_POSES))) > 2
    for name, found in rectify(tmp_path, SPHERE, PLATE_POSES, name="strips.h5").items():
        np.testing.assert_array_equal(found, whole[name])


@given(light=st.floats(35, 89), camera=st.floats(0, 70), tilt=st.floats(0, 19))
@settings(deadline=None, max_examples=60)
def test_angles_at_a_plates_centre_are_those_of_the_rig(light, camera, tilt):
    pose = Pose(light, camera, tilt)
    shape = Shape.from_definition(made(ObjectShape | BodyShape, PLATE["shape"]))
    rotation = rig_from_object(pose)
    tracer = Tracer([Placement(shape, rotation)])
    xy, geometry, visible, lit, power, _ = observe(np.zeros((1, 3)), rotation[:, 2][None], tracer, pose, setup_of())
    incidence, view = math.radians(light - tilt), math.radians(camera + tilt)
    assert visible[0] and lit[0] and power[0] == 1.0
    expected = [incidence, view, (incidence + view) / 2, abs(incidence - view) / 2]
    assert np.abs(geometry[0] - expected).max() <= 1e-9
    centre = [OPTICS["principal_point_px"][0] / 2 - 0.5, OPTICS["principal_point_px"][1] / 2 - 0.5]
    assert np.abs(xy[0] - centre).max() <= 1e-6


@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_a_lamp_that_goes_round_is_an_object_that_turns_back(tmp_path, definition):
    """Seen from straight above: texels have the angles of the one in the other, and the same ones are lit."""
    around = rectify(tmp_path, definition, [Pose(50.0, 0.0, light_azimuth_deg=a) for a in (70.0, -135.0)], name="a.h5")
    turned = rectify(tmp_path, definition, [Pose(50.0, 0.0, 0.0, -a) for a in (70.0, -135.0)], name="b.h5")
    np.testing.assert_allclose(around["geometry"], turned["geometry"], atol=2e-6)
    np.testing.assert_array_equal(around["weight"] > 0, turned["weight"] > 0)
    assert around["weight"].any()


@given(light=st.floats(0, 80), azimuth=st.floats(-180, 180), tilt=st.floats(0, 45))
def test_the_incidence_on_the_table_is_that_of_its_normal(light, azimuth, tilt):
    pose = Pose(light, 0.0, tilt, light_azimuth_deg=azimuth)
    normal = rig_from_object(pose)[:, 2]
    assert math.cos(flat_incidence_rad(pose)) == pytest.approx(float(to_light(pose) @ normal), abs=1e-12)


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
    found = rectify(tmp_path, definition, [pose], setup=setup_of(top), max_angle_deg=89.0)
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
        tmp_path,
        {"shape": shape, "texels": {"width": columns, "height": rows}},
        [pose],
        max_angle_deg=89.0,
        clipped=np.ones((OPTICS["height_px"] // 2, OPTICS["width_px"] // 2), np.uint8),
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
    for name in ("weight", "clipped"):
        assert (found[name][free] == 1).all(), name
    assert (found["response"][free] != 0).all()


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


@pytest.mark.parametrize("columns, rows", [(900, 3), (3, 900)])
def test_texels_outside_the_picture_have_no_weight(tmp_path, columns, rows):
    """So fine that there are texels between the first two samples of a row or column, and between the last two."""
    size = {"width_mm": 400.0 if columns > rows else 60.0, "height_mm": 400.0 if rows > columns else 60.0}
    huge = {"shape": {"kind": "plate", **size}, "texels": {"width": columns, "height": rows}}
    pose = Pose(45.0, 0.0)
    found = rectify(tmp_path, huge, [pose])
    xy = pixel_of(texels_in_rig(huge, pose)[0], pose)
    last = np.array([OPTICS["width_px"] / 2 - 1, OPTICS["height_px"] / 2 - 1])
    inside = ((xy >= 0) & (xy <= last)).all(axis=1)
    along = 0 if columns > rows else 1
    assert 0.1 < inside.mean() < 0.9
    assert (inside & (xy[:, along] < 1)).any() and (inside & (xy[:, along] > last[along] - 1)).any()
    assert np.array_equal(found["weight"][:, 0] > 0, inside)


@pytest.mark.parametrize("pose", [Pose(45.0, 60.0, 0.0, 180.0), Pose(45.0, 0.0)], ids=["behind its edge", "beside it"])
def test_an_object_that_the_picture_does_not_show_has_no_observation(tmp_path, pose):
    """A thin, far plate at an angle from which nothing of it is in the picture, or one whose face is not seen."""
    away = {"kind": "mesh", "file": str(tmp_path / "away.obj"), "unit": "mm", "pivot_mm": [0, 0, 0]}
    corners = np.array([[600.0, 600, 0], [640, 600, 0], [640, 640, 0], [600, 640, 0]])
    if pose.turn_deg:
        corners = corners[::-1]
    uv = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
    write_obj(tmp_path / "away.obj", corners[[[0, 1, 2], [0, 2, 3]]], uv[[[0, 1, 2], [0, 2, 3]]])
    found = rectify(tmp_path, {"shape": away, "texels": {"width": 6, "height": 6}}, [pose])
    assert found["texel"].all()
    assert not found["weight"].any() and not found["response"].any() and not found["clipped"].any()


def tiled(tmp_path, definition, cuts=None):
    """Observations of the whole texture, and of its tiles put together."""
    rng = np.random.default_rng(1)
    size = (OPTICS["height_px"] // 2, OPTICS["width_px"] // 2)
    picture = {"response": rng.uniform(0, 1, (*size, 3)), "valid": (rng.uniform(size=size) < 0.95).astype(np.uint8)}
    height = definition["texels"]["height"]
    whole = rectify(tmp_path, definition, PLATE_POSES, setup=setup_of(20.0), **picture)
    parts = [
        rectify(
            tmp_path, definition, PLATE_POSES, rows=rows, setup=setup_of(20.0), name=f"tile-{rows[0]}.h5", **picture
        )
        for rows in itertools.pairwise([0, *(cuts or [height // 2]), height])
    ]
    return whole, {name: np.concatenate([part[name] for part in parts]) for name in whole}


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("cuts", [[9], [1, 2, 17]])
@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_tiles_give_the_fit_the_same_observations_to_the_bit(tmp_path, definition, cuts):
    whole, parts = tiled(tmp_path, definition, cuts)
    for name in ("geometry", "weight", "shadowed"):
        assert np.array_equal(parts[name], whole[name]), name
    used = whole["weight"] > 0
    assert np.array_equal(parts["response"][used], whole["response"][used])


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("definition", [PLATE, SPHERE], ids=["plate", "sphere"])
def test_tiles_are_bit_identical_to_the_whole(tmp_path, definition):
    whole, parts = tiled(tmp_path, definition)
    for name, values in whole.items():
        assert np.array_equal(parts[name], values), name


@pytest.mark.parametrize("normals", [None, [0.08, 0.0, 0.9968]], ids=["its own", "smooth"])
def test_what_is_no_texel_of_a_mesh_is_zero_and_a_smooth_normal_gives_the_angles(tmp_path, caplog, normals):
    """A square of which the texture's left half shows all; where the right half is, is no texel."""
    corners = np.array([[-20.0, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]])[[[0, 1, 2], [0, 2, 3]]]
    uv = np.array([[0.0, 1], [0.5, 1], [0.5, 0], [0, 0]])[[[0, 1, 2], [0, 2, 3]]]
    file = tmp_path / "square.obj"
    write_obj(file, corners, uv, None if normals is None else np.broadcast_to(normals, (2, 3, 3)))
    shape = {"kind": "mesh", "file": str(file), "unit": "mm", "pivot_mm": [0, 0, 0]}
    poses = [Pose(45.0, 20.0), Pose(30.0, 10.0)]
    with caplog.at_level("INFO", logger="irodori"):
        found = rectify(tmp_path, {"shape": shape, "texels": {"width": 16, "height": 8}}, poses)
    left = np.tile(np.arange(16) < 8, 8)
    assert np.array_equal(found["texel"] == 1, left)
    assert (found["weight"][left] == 1).all() and (found["response"][left, :, :2] != 0).all()
    for name, values in found.items():
        assert not values[~left].any(), name
    assert "have no observation" not in caplog.text
    facing = math.degrees(math.atan2(normals[0], normals[2])) if normals else 0.0
    for j, pose in enumerate(poses):
        assert np.degrees(found["geometry"][left, j, 0]) == pytest.approx(abs(pose.light_deg - facing), abs=1e-3)


@pytest.mark.parametrize("setup", [setup_of(), setup_of(0.0, 400.0, Pose(45.0, 0.0))], ids=["far", "near"])
def test_a_texel_is_seen_and_lit_from_the_front_of_its_surface_and_of_its_smooth_normal(setup):
    """In free space above a small plate, where nothing else hides anything."""
    rng, pose = np.random.default_rng(2), Pose(40.0, 25.0)
    normal, facet = rng.normal(size=(2, 400, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    facet /= np.linalg.norm(facet, axis=1, keepdims=True)
    position = np.array([0.0, 0.0, 60.0]) + rng.uniform(-5.0, 5.0, (400, 3))
    plate = {"kind": "plate", "width_mm": 1.0, "height_mm": 1.0}
    tracer = Tracer([Placement(Shape.from_definition(made(ObjectShape | BodyShape, plate)), rig_from_object(pose))])
    eye = DISTANCE * np.array([-math.sin(math.radians(25.0)), 0.0, math.cos(math.radians(25.0))]) - position
    light = np.tile([math.sin(math.radians(40.0)), 0.0, math.cos(math.radians(40.0))], (400, 1))
    if setup.lamp.is_near:
        light = 400.0 * light - position
    for own in (facet, None):
        sight = observe(position, normal, tracer, pose, setup, own)
        of_both = (normal, normal if own is None else facet)
        for found, way in ((sight.visible, eye), (sight.lit, light)):
            expected = np.all([np.sum(one * way, axis=1) > 0 for one in of_both], axis=0)
            assert 0.1 < expected.mean() < 0.6
            assert np.array_equal(found, expected)


def test_texels_without_observation_are_counted(tmp_path, caplog):
    with caplog.at_level("INFO", logger="irodori"):
        found = rectify(tmp_path, SPHERE, [Pose(45.0, 20.0), Pose(45.0, 40.0)])
    without = int((found["weight"].sum(axis=1) == 0).sum())
    assert 0 < without < found["weight"].shape[0]
    assert f"{without} of {found['weight'].shape[0]} texels have no observation" in caplog.text


WHITE = Pose(40.0, 10.0)


@pytest.mark.parametrize("sample_px", [2, 1])
def test_under_a_near_lamp_a_plate_in_the_whites_place_has_the_cosine_of_its_own_light(tmp_path, sample_px):
    """The white, a perfect diffuser at its centre, divides the lamp's fall-off and its own cosine in every pixel."""
    shape = (OPTICS["height_px"] // sample_px, OPTICS["width_px"] // sample_px)
    near = setup_of(0.0, 300.0, WHITE)
    picture = {"response": np.ones((*shape, 3)), "valid": np.ones(shape, np.uint8), "sample_px": sample_px}
    found = rectify(tmp_path, PLATE, [WHITE], setup=near, **picture)
    position, _ = texels_in_rig(PLATE, WHITE)
    lamp = 300.0 * np.array([math.sin(math.radians(40.0)), 0.0, math.cos(math.radians(40.0))])
    to_lamp = lamp - position
    cosine = to_lamp[:, 2] / np.linalg.norm(to_lamp, axis=1)
    assert np.ptp(cosine) > 0.1 and (found["weight"] == 1).all()
    gain = cosine / math.cos(math.radians(40.0))
    assert found["light_gain"][:, 0] == pytest.approx(gain, rel=1e-6)
    assert found["response"][:, 0] == pytest.approx(np.stack([gain, gain, gain], axis=1), rel=2**-11)


def test_under_a_near_lamp_a_raised_texel_is_nearer_to_it_than_the_white(tmp_path):
    """The top of a sphere under a lamp right above: what the picture shows there is brighter than the white was."""
    pose, near = Pose(0.0, 30.0), setup_of(0.0, 300.0, Pose(0.0, 30.0))
    found = rectify(tmp_path, SPHERE, [pose], setup=near)
    position, _ = texels_in_rig(SPHERE, pose)
    x, _ = pixel_of(position, pose).T
    # The white's point that the pixel showed, in the plane z = 0.
    eye = DISTANCE * np.array([-math.sin(math.radians(30.0)), 0.0, math.cos(math.radians(30.0))])
    behind = eye + (position - eye) * (eye[2] / (eye[2] - position[:, 2:]))
    to_white, to_texel = np.array([0, 0, 300.0]) - behind, np.array([0, 0, 300.0]) - position
    on_white = (300.0 / np.linalg.norm(to_white, axis=1)) ** 2 * to_white[:, 2] / np.linalg.norm(to_white, axis=1)
    gain = on_white / (300.0 / np.linalg.norm(to_texel, axis=1)) ** 2
    seen = found["weight"][:, 0] > 0
    assert seen.sum() > 50 and gain[seen].min() < 0.9
    assert found["light_gain"][seen, 0] == pytest.approx(gain[seen], rel=1e-5)
    assert found["response"][seen, 0, 0] == pytest.approx((gain * x / 512)[seen], rel=1e-3)


def test_under_a_far_lamp_responses_are_the_pictures_and_no_gain_is_stored(tmp_path):
    found = rectify(tmp_path, PLATE, [Pose(45.0, 0.0)], setup=setup_of(0.0, None, WHITE))
    assert "light_gain" not in found
    alone = rectify(tmp_path, PLATE, [Pose(45.0, 0.0)])
    assert np.array_equal(found["response"], alone["response"])


def test_a_near_lamp_needs_the_whites_pose_and_an_object_that_it_stands_outside_of(tmp_path):
    with pytest.raises(InputError, match=r"poses\.white: found no pose of the white reference"):
        setup_of(0.0, 300.0)
    with pytest.raises(InputError, match=r"light\.distance_mm.*20 mm, within the reach of the object, 25 mm"):
        rectify(tmp_path, SPHERE, [Pose(45.0, 0.0)], setup=setup_of(0.0, 20.0, WHITE))


def test_errors_of_angles_by_registration_are_passed_on(tmp_path):
    files = [linear_file(tmp_path / f"{pose.name}.h5", pose) for pose in (Pose(45.0, 0.0), Pose(60.0, 30.0))]
    plate, tile = made(Object | TexturedObject, PLATE), tmp_path / "obs.h5"
    rows = 0, PLATE["texels"]["height"]
    for rms_deg, expected in ((np.array([0.08, 0.04, 0.05, 0.06]), AngleErrors(0.08, 0.06, REGISTERED)), (None, None)):
        rectify_object(
            files, plate, setup_of(), rows, 85.0, angle_error_deg=rms_deg, output=tile, provenance=PROVENANCE
        )
        assert registered_errors(tile) == expected


def test_captures_of_different_filters_and_masks_of_another_size_are_refused(tmp_path):
    first, second = Pose(45.0, 0.0), Pose(60.0, 30.0)
    files = [
        linear_file(tmp_path / "first.h5", first, filters=("out", "in")),
        linear_file(tmp_path / "second.h5", second, filters=("in", "out")),
    ]
    plate = made(Object | TexturedObject, PLATE)
    with pytest.raises(InputError, match=r"second\.h5: filters: found in, out; accepted: out, in, as in the other"):
        rectify_object(files, plate, setup_of(), (0, 18), 85.0, output=tmp_path / "obs.h5", provenance=PROVENANCE)
    with pytest.raises(InputError, match=r"valid"):
        rectify(tmp_path, PLATE, [first], valid=np.ones((5, 7), np.uint8))


def test_observations_say_which_rows_of_which_texture_they_are(tmp_path):
    response = np.ones((OPTICS["height_px"] // 2, OPTICS["width_px"] // 2, 6))
    poses = [Pose(45.0, 0.0), Pose(60.0, 30.0)]
    rectify(tmp_path, PLATE, poses, rows=(3, 7), filters=("out", "in"), response=response)
    with store.open_file(tmp_path / "obs.h5") as file:
        assert (file.attribute("rows"), file.attribute("width")) == ([3, 7], 24)
        assert file.attribute("filters") == ["out", "in"]
        assert file.read("weight").shape == (4 * 24, 2)
        assert file.read("capture").tolist() == [pose.name.encode() for pose in poses]
        assert (file.read("light_deg").tolist(), file.read("camera_deg").tolist()) == ([45.0, 60.0], [0.0, 30.0])
        assert file.read("band").tolist()[2:4] == [b"out_blue", b"in_red"]


def test_bands_that_are_not_three_a_filter_state_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"filters: found 2 filter states and 3 bands; accepted: three bands a"):
        rectify(tmp_path, PLATE, [Pose(45.0, 0.0)], filters=("out", "in"))


@given(height=st.integers(1, 60), width=st.integers(1, 60), most=st.integers(1, 2000))
def test_tiles_are_whole_rows_as_many_as_are_allowed_and_leave_none_out(height, width, most):
    tiles = tile_rows(height, width, most)
    assert [first for first, _ in tiles] == [0, *(last for _, last in tiles[:-1])] and tiles[-1][1] == height
    *full, rest = [last - first for first, last in tiles]
    assert 0 < rest <= max(full, default=height)
    assert rest == 1 or rest * width <= most
    for rows in full:
        assert (rows == 1 or rows * width <= most) and (rows + 1) * width > most


def test_noise_of_an_interpolated_response_is_carried_along_by_capture_and_band(tmp_path):
    poses = [Pose(45.0, 0.0), Pose(60.0, 30.0)]
    rectify(tmp_path, PLATE, poses)
    with store.open_file(tmp_path / "obs.h5") as file:
        noise = file.read("noise_model")
        assert [term.decode() for term in file.read("term")] == ["c0", "c1"]
    # Weights of the cubic squared, averaged over all places between the samples.
    left = np.mean([np.square(keys_weights(x)).sum() for x in (np.arange(1000) + 0.5) / 1000]) ** 2
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


@pytest.mark.default_cases(1)
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
    assert np.abs(found[0]["response"] - found[1]["response"])[both].max() <= 2**-11


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
        _sample(_Window(*pictures, np.array([first, first]), np.zeros((1, 2))), xy, out, (good, clips), 0, len(xy))
        found.append((out.copy(), good.copy(), clips.copy()))
    assert found[0][1].all() and not found[0][2].any()
    np.testing.assert_array_equal(found[0][0][0], response[2, 3])
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)


def test_angles_of_captures_are_those_of_their_placements_as_registered(tmp_path):
    """Of texels of a sphere, by vectors that are written out, whether the camera sees them or not."""
    sphere = made(Object | TexturedObject, SPHERE | {"placements": [{"rotation_deg": [180.0, 0.0, 0.0]}]})
    poses, shape = [Pose(45.0, 10.0, 20.0, 30.0), Pose(50.0, 25.0, placement=2)], Sphere(25.0)
    files = [linear_file(tmp_path / f"{number}.h5", pose) for number, pose in enumerate(poses)]
    corrections = np.zeros((2, COUNT))
    corrections[0, :6], corrections[1, :6] = (2.0, -1.0, 0.5, 3.0, -2.0, 1.0), (-3.0, 1.0, 0.2, 1.0, 2.0, -4.0)
    corrections[:, COUNT - 2 :] = [0.7, -0.4]
    corrections[0, 6] = 25.0
    for number, values in enumerate(corrections):
        with store.create(tmp_path / f"registration-{number}.h5", PROVENANCE) as out:
            out.write("correction", values, units="1", dims="quantity", quantity="correction")
    setup = setup_of().registered(shape, sphere.placements, [tmp_path / f"registration-{n}.h5" for n in (0, 1)])
    texels = shape.atlas(6, 4)
    found = angles_in_captures(files, shape, texels, setup)
    assert found.shape == (24, 2, 4)
    for number, (pose, values, typed) in enumerate(zip(poses, corrections, ((0, 0, 0), (180, 0, 0)), strict=True)):
        rotation = rig_from_object(pose) @ rotation_xyz(values[3:6]) @ rotation_xyz(typed)
        position = texels.position[texels.covered] @ rotation.T + rig_from_object(pose) @ values[:3]
        camera, light = np.radians(pose.camera_deg + 0.7), np.radians(pose.light_deg - 0.4)
        view = (DISTANCE + values[6]) * np.array([-math.sin(camera), 0.0, math.cos(camera)]) - position
        view /= np.linalg.norm(view, axis=1)[:, None]
        lit = np.array([math.sin(light), 0.0, math.cos(light)])
        half = lit + view
        half /= np.linalg.norm(half, axis=1)[:, None]
        normal = texels.normal[texels.covered] @ rotation.T
        cosines = [normal @ lit, np.sum(normal * view, axis=1), half @ lit, np.sum(normal * half, axis=1)]
        np.testing.assert_allclose(np.cos(found[:, number]), np.stack(cosines, axis=1), atol=1e-6)
    as_typed = setup_of().registered(shape, sphere.placements)
    assert as_typed.of(poses[1]).correction.rotation_deg == (180.0, 0.0, 0.0)
    assert not any(as_typed.correction.values) and as_typed.of(poses[0]) is as_typed
