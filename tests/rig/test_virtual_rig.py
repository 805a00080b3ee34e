"""The virtual rig photographs what equation (5) says, with the faults that its file switches on and no others."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made import made

from irodori.calibration.chart import patch_centres
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.colour.colorimetry import colour_matching_weights
from irodori.config.capture_table import Pose, Shot
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import (
    Camera,
    Chart,
    EnvironmentDefinition,
    Imperfections,
    Object,
    Optics,
    PlacedChart,
    Rig,
    VirtualRoom,
)
from irodori.config.parts import PhotographedObject, SceneRadiance
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera, to_light
from irodori.ingest.mosaic import decode
from irodori.light.environment_file import directions
from irodori.light.omnidirectional import from_panorama
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.classroom import light_on_chart, room_coefficients, source_spectra, trace_room
from irodori.simulation.virtual_rig.ground_truth import true_material
from irodori.simulation.virtual_rig.imperfections import Faults, lamp_light
from irodori.simulation.virtual_rig.samples import Sample
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.simulation.virtual_rig.subjects import object_mosaic, room_mosaic
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera
from irodori.spectra.published import spectrum

ROOT = Path(__file__).resolve().parents[2]
NO_FAULTS = (
    "light_drift", "vignetting", "stray_light", "pose_error", "lamp_spectrum", "laid_off", "focal_length",
    "filter_plate", "hot_pixels",
)  # fmt: skip
STRAIGHT = np.eye(2, 3)


@pytest.fixture(scope="module")
def definitions():
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()


@pytest.fixture
def perfect(definitions):
    """Return camera and rig without any imperfection."""
    rig = copy.deepcopy(definitions["rigs"]["virtual"])
    for name in NO_FAULTS:
        rig["virtual"]["imperfections"][name]["enabled"] = False
    return definitions["cameras"]["d5100-comb"], rig


def coarse(camera: dict) -> dict:
    """Return a camera with the field of another in 200 x 150 pixels, for tests that compare whole files."""
    camera = copy.deepcopy(camera)
    camera["optics"] |= {
        "pixel_pitch_um": 40.0, "width_px": 200, "height_px": 150, "principal_point_px": [100.0, 75.0],
    }  # fmt: skip
    return camera


def uniform(definitions, name: str, beta: float = 4.0, mu_rad: float = 0.15, mirror: float = 0.0) -> dict:
    definition = copy.deepcopy(definitions["objects"][name])
    definition["virtual"] = {
        "pattern": {"kind": "uniform"},
        "materials": [{"spectrum": "TCS16", "beta": beta, "mu_rad": mu_rad}],
    }
    definition["mirror_weight"] = mirror
    return definition


def photograph(definition: dict, camera: dict, rig: dict, pose: Pose):
    """Return the two mosaics of a pose before the optics, with the sample and band weights."""
    sample = Sample.from_definition(made(Object | PhotographedObject, definition))
    weights = band_weights(made(Camera, camera), spectrum(rig["light"]["spectrum"]))
    image = np.stack(
        [
            object_mosaic(sample, made(Camera, camera), made(Rig, rig), pose, STRAIGHT, weights[b : b + 3])
            for b in (0, 3)
        ]
    )
    return image, sample, weights


def standing(shot: Shot) -> Bench:
    """Return a bench on which everything stands as a photograph wants it."""
    angles = {name: getattr(shot.pose, name) for name in ("light_deg", "camera_deg", "tilt_deg", "turn_deg")}
    return Bench(by_hand_deg=angles, filter=shot.filter, subject=shot.role)


def shoot(camera: dict, rig: dict, session: str, shots: list[Shot], folder: Path, subject=None) -> None:
    """Take all photographs of a session into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    virtual = VirtualCamera(
        made(Camera, camera),
        made(Rig, rig),
        Bench(),
        session,
        shots,
        made(Object | PhotographedObject | EnvironmentDefinition | SceneRadiance, subject),
    )
    for shot in shots:
        virtual.bench = standing(shot)
        virtual.capture(shot, folder / shot.file)


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("pose", [Pose(45.0, 0.0), Pose(45.0, 41.0), Pose(65.0, 60.0), Pose(45.0, 3.0, 20.0)])
def test_the_centre_of_a_plate_has_the_response_of_equation_5(definitions, perfect, pose):
    image, sample, weights = photograph(uniform(definitions, "tile-plate"), *perfect, pose)
    normal = rig_from_object(pose)[:, 2]
    geometry = angles_from_directions(normal, to_light(pose), to_camera(pose))
    rows, columns = slice(298, 302), slice(398, 402)
    for state in (0, 1):
        for colour, (y, x) in enumerate([(0, 0), (0, 1), (1, 1)]):
            band = 3 * state + colour
            scale = weights[band].sum()
            expected = scale * reflect(1.0, sample.reflectance[0] @ weights[band] / scale, 4.0, 0.15, geometry)
            seen = image[state, rows, columns][y::2, x::2].mean()
            # Four millimetres about the centre see the lobe under angles that differ by 0.01 degrees.
            assert seen == pytest.approx(float(expected), rel=2e-3)


def test_a_plate_of_two_components_has_the_sum_of_their_terms_and_its_truth_has_both(definitions, perfect):
    definition, pose = uniform(definitions, "tile-plate"), Pose(45.0, 41.0)
    second = {"lobe": "ggx", "beta": 1.5, "mu_rad": 0.4}
    definition["virtual"]["materials"][0]["further_gloss"] = [second]
    image, sample, weights = photograph(definition, *perfect, pose)
    geometry = angles_from_directions(rig_from_object(pose)[:, 2], to_light(pose), to_camera(pose))
    scale = weights[1].sum()
    plain = reflect(1.0, sample.reflectance[0] @ weights[1] / scale, 4.0, 0.15, geometry)
    expected = scale * (plain + reflect(0.0, 0.0, 1.5, 0.4, geometry, lobe="ggx"))
    assert image[0, 298:302, 398:402][0::2, 1::2].mean() == pytest.approx(float(expected), rel=2e-3)
    truth = true_material(
        made(Object, definition), *(made(kind, one) for kind, one in zip((Camera, Rig), perfect, strict=True))
    )
    assert [(name, beta[0, 0], mu[0, 0]) for name, beta, mu in truth.gloss] == [
        ("gaussian", 4.0, 0.15), ("ggx", 1.5, 0.4)
    ]  # fmt: skip
    assert truth.typical_gloss == (4.0, 0.15, 1.5, 0.4)


def test_the_truth_of_materials_with_different_lobes_has_a_component_for_each(definitions, perfect):
    definition = uniform(definitions, "tile-plate")
    definition["virtual"]["pattern"] = {"kind": "checks", "columns": 2, "rows": 1}
    definition["virtual"]["materials"].append({"lobe": "ggx", "spectrum": "TCS3", "beta": 2.0, "mu_rad": 0.3})
    truth = true_material(
        made(Object, definition), *(made(kind, one) for kind, one in zip((Camera, Rig), perfect, strict=True))
    )
    (one, beta, _), (other, further, mu) = truth.gloss
    assert (one, other) == ("gaussian", "ggx")
    left, right = (0, 0), (0, -1)
    assert beta[left] == 4.0 and further[left] == 0.0 and beta[right] == 0.0 and further[right] == 2.0
    assert (mu == 0.3).all()


def test_the_underside_and_the_shadow_of_the_table_are_black(definitions, perfect):
    image, _, _ = photograph(uniform(definitions, "tile-plate"), *perfect, Pose(95.0, 20.0))
    assert image.max() == 0.0


@pytest.mark.default_cases(3)
@pytest.mark.parametrize("distance_mm", [None, 120.0])
@pytest.mark.parametrize("pose", [Pose(45.0, 20.0), Pose(100.0, 60.0, 15.0), Pose(100.0, 60.0, 5.0)])
def test_shadow_rays_are_left_out_only_where_nothing_can_shade(definitions, perfect, pose, distance_mm, monkeypatch):
    camera, rig = perfect
    if distance_mm:
        rig["light"]["distance_mm"] = distance_mm
    short, _, _ = photograph(definitions["objects"]["vermilion-sphere"], camera, rig, pose)
    monkeypatch.setattr("irodori.simulation.virtual_rig.imaging._is_open", lambda *given: False)
    traced, _, _ = photograph(definitions["objects"]["vermilion-sphere"], camera, rig, pose)
    np.testing.assert_array_equal(short, traced)


@pytest.mark.heavy
def test_the_lamps_mirror_image_saturates_where_the_sphere_reflects_it(definitions, perfect):
    camera, rig = perfect
    with_mirror, _, _ = photograph(uniform(definitions, "leaf-sphere", mirror=1.0), camera, rig, Pose(45.0, 25.0))
    without, _, _ = photograph(uniform(definitions, "leaf-sphere"), camera, rig, Pose(45.0, 25.0))
    bright = (with_mirror - without)[0]
    full = camera["virtual"]["sensor"]["response_at_full_well"]
    assert bright.max() > 10 * full
    assert (bright > 0).sum() < 200, "the image of a lamp of half a degree is small"
    y, x = np.nonzero(bright > full)
    # Specular point of a sphere: its normal halves the angle between light and camera.
    pose, radius = Pose(45.0, 25.0), 30.0
    half = to_light(pose) + to_camera(pose)
    point = radius * half / np.linalg.norm(half)
    pinhole = Pinhole.from_optics(made(Optics, camera["optics"]))
    expected = pinhole.project(point, rig["camera_distance_mm"] * to_camera(pose), rig_from_camera(pose))
    assert np.hypot(x.mean() / 2 - expected[0], y.mean() / 2 - expected[1]) < 2.0


def test_the_chart_stands_where_the_camera_file_says(perfect, tmp_path):
    camera, rig = perfect
    shots = camera_shots(made(Camera, camera), ".dng")
    roles = [shot.role for shot in shots]
    assert roles.count("dark") == 8 and roles.count("white") == 10 and roles.count("chart") == 2
    chart = [shot for shot in shots if shot.role == "chart" and shot.filter == "out"]
    shoot(camera, rig, "d5100-comb", chart, tmp_path)
    picture = decode(tmp_path / chart[0].file).superpixels[..., 1]
    for x, y in patch_centres(made(Chart, camera["chart"])):
        patch = picture[round(y) - 12 : round(y) + 13, round(x) - 12 : round(x) + 13]
        assert patch.std() < 0.1 * patch.mean() + 30, "a patch is even over 25 superpixels"


def faults_of(rig: dict, session: str, count: int) -> tuple[Faults, list[Shot]]:
    """Return the imperfections of a session of `count` photographs, filter in, each in a pose of its own."""
    shots = [Shot(f"{i}.dng", "object", Pose(45.0, 0.1 * i), "in", 0.02) for i in range(count)]
    return Faults(made(Imperfections, rig["virtual"]["imperfections"]), rig["virtual"]["seed"], session, shots), shots


def test_faults_can_be_switched_off_one_by_one(definitions):
    for name in NO_FAULTS:
        rig = copy.deepcopy(definitions["rigs"]["virtual"])
        for other in NO_FAULTS:
            rig["virtual"]["imperfections"][other]["enabled"] = other == name
        faults, shots = faults_of(rig, name, 200)
        seen = faults.through_optics(np.ones((600, 800)))
        assert (np.std([faults.light(shot) for shot in shots]) > 0) == (name == "light_drift")
        assert (faults.real_pose(shots[3], Pose(45.0, 10.0)) != Pose(45.0, 10.0)) == (name == "pose_error")
        assert (np.ptp(seen) > 0.05) == (name == "vignetting")
        assert (seen.max() > 1.0) == (name == "stray_light")
        assert (faults.ideal_from_seen(shots[0], 800, 600) != np.eye(2, 3)).any() == (name == "filter_plate")
        assert (faults.hot_rate_e_per_s(600, 800) > 0).any() == (name == "hot_pixels")


@pytest.mark.parametrize(("shift_mired", "temperature_k"), [(5.0, 2816), (-20.0, 3029)])
def test_a_lamp_that_is_redder_or_bluer_than_its_name_is_as_a_black_body_of_that_temperature(
    definitions, shift_mired, temperature_k
):
    rig = copy.deepcopy(definitions["rigs"]["virtual"])
    rig["light"]["spectrum"] = "A"
    rig["virtual"]["imperfections"]["lamp_spectrum"] = {"enabled": True, "shift_mired": shift_mired}
    ratio = lamp_light(made(Rig, rig)) / spectrum("A")
    black_bodies = spectrum(f"P{temperature_k}") / spectrum("P2856")
    np.testing.assert_allclose(ratio / ratio.mean(), black_bodies / black_bodies.mean(), rtol=2e-3)
    luminance = colour_matching_weights()[1]
    assert luminance @ lamp_light(made(Rig, rig)) == pytest.approx(luminance @ spectrum("A"))
    rig["virtual"]["imperfections"]["lamp_spectrum"]["enabled"] = False
    np.testing.assert_array_equal(lamp_light(made(Rig, rig)), spectrum("A"))


def test_the_light_drifts_by_its_rms_and_slowly(definitions):
    faults, shots = faults_of(definitions["rigs"]["virtual"], "drift", 60_000)
    light = np.array([faults.light(shot) for shot in shots])
    assert light.std() == pytest.approx(0.01, rel=0.15)
    step = np.diff(light).std()
    assert step == pytest.approx(0.01 * np.sqrt(2 * (1 - np.exp(-1 / 60))), rel=0.02)


def test_the_pose_is_off_by_its_rms_and_only_after_a_move(definitions):
    faults, shots = faults_of(definitions["rigs"]["virtual"], "pose", 4000)
    off = np.array([faults.real_pose(shot, shot.pose).camera_deg - shot.pose.camera_deg for shot in shots])
    assert off.std() == pytest.approx(0.05, rel=0.05)
    pair = [Shot(f"{s}.dng", "object", Pose(45.0, 0.0), s, 0.02) for s in ("out", "in")]
    still = Faults(made(Imperfections, definitions["rigs"]["virtual"]["virtual"]["imperfections"]), 1, "pair", pair)
    assert still.real_pose(pair[0], pair[0].pose) == still.real_pose(pair[1], pair[1].pose)


def test_the_plate_moves_the_picture_as_its_file_says(definitions, perfect):
    camera, rig = copy.deepcopy(perfect)
    plate = rig["virtual"]["imperfections"]["filter_plate"]
    plate.update(enabled=True, shift_px=[3.0, -2.0], repeat_rms_px=0.0, magnification=1.01, rotation_deg=0.5)
    faults, shots = faults_of(rig, "plate", 1)
    seen = faults.ideal_from_seen(shots[0], 800, 600)
    centre, point = np.array([400.0, 300.0]), np.array([100.0, 50.0])
    angle = np.radians(0.5)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = centre + 2.0 * np.array([3.0, -2.0]) + 1.01 * turn @ (point - centre)
    np.testing.assert_allclose(seen @ [*moved, 1.0], point, atol=1e-9)
    definition = uniform(definitions, "tile-plate")
    sample = Sample.from_definition(made(Object | PhotographedObject, definition))
    weights = band_weights(made(Camera, camera), spectrum("A"))[3:]
    straight, through = (
        object_mosaic(sample, made(Camera, camera), made(Rig, rig), Pose(45.0, 0.0), m, weights)
        for m in (STRAIGHT, seen)
    )

    def edge(picture, axis):
        """Return the centre and half the width of the bright square along an axis, mosaic pixels."""
        inside = (picture > 0.5 * np.median(picture[picture > 0])).any(axis=1 - axis)
        where = np.nonzero(inside)[0]
        return 0.5 * (where[0] + where[-1]), 0.5 * (where[-1] - where[0])

    # A square 400 px wide turned by half a degree reaches 1.7 px further on either side.
    for axis, shift in ((1, 6.0), (0, -4.0)):
        (before, half), (after, wider) = edge(straight, axis), edge(through, axis)
        assert after - before == pytest.approx(shift, abs=1.1)
        assert wider == pytest.approx(half * 1.01 + half * np.sin(angle), abs=1.6)


def test_hot_pixels_belong_to_the_camera_and_not_to_a_session(definitions, tmp_path):
    camera, rig = definitions["cameras"]["d5100-comb"], copy.deepcopy(definitions["rigs"]["virtual"])
    rig["virtual"]["imperfections"]["hot_pixels"]["fraction"] = 0.001
    dark = [shot for shot in camera_shots(made(Camera, camera), ".dng") if shot.role == "dark"][-1:]
    for session in ("one", "two"):
        shoot(camera, rig, session, dark, tmp_path / session)
    pictures = [decode(tmp_path / session / dark[0].file).superpixels for session in ("one", "two")]
    hot = [np.argwhere(picture > 200) for picture in pictures]
    assert 200 < len(hot[0]) < 480, "about half of 480 hot pixels stand 200 DN above the rest at 50 ms"
    shared = {tuple(place) for place in hot[0]} & {tuple(place) for place in hot[1]}
    assert len(shared) > 0.8 * len(hot[0])


def test_a_session_is_reproducible_sessions_differ_and_a_broken_off_one_continues_the_same(
    definitions, perfect, tmp_path
):
    camera = coarse(perfect[0])
    rig = definitions["rigs"]["virtual"]
    definition = uniform(definitions, "tile-plate")
    definition["poses"] = [{"light_deg": [45.0], "camera_deg": [20.0, 30.0]}]
    shots = object_shots(made(Object | PhotographedObject, definition), made(Camera, camera), ".dng")
    for folder, name in (("a", "one"), ("b", "one"), ("c", "two")):
        shoot(camera, rig, name, shots, tmp_path / folder, definition)
    contents = [[(tmp_path / folder / shot.file).read_bytes() for shot in shots] for folder in "abc"]
    assert contents[0] == contents[1]
    assert all(first != second for first, second in zip(contents[0], contents[2], strict=True))
    late = VirtualCamera(
        made(Camera, camera),
        made(Rig, rig),
        standing(shots[-1]),
        "one",
        shots,
        made(Object | PhotographedObject | EnvironmentDefinition | SceneRadiance, definition),
    )
    late.capture(shots[-1], tmp_path / "late.dng")
    assert (tmp_path / "late.dng").read_bytes() == contents[0][-1]


def test_the_camera_photographs_what_stands_there_and_not_what_it_is_asked_for(definitions, perfect, tmp_path):
    camera, rig = perfect
    definition = uniform(definitions, "tile-plate")
    shots = object_shots(made(Object | PhotographedObject, definition), made(Camera, camera), ".dng")
    virtual = VirtualCamera(
        made(Camera, camera),
        made(Rig, rig),
        standing(shots[0]),
        "bench",
        shots,
        made(Object | PhotographedObject | EnvironmentDefinition | SceneRadiance, definition),
    )
    virtual.capture(shots[0], tmp_path / "out.dng")
    virtual.bench.filter = "in"
    virtual.capture(shots[0], tmp_path / "forgotten.dng")
    out, forgotten = (decode(tmp_path / f"{name}.dng").superpixels for name in ("out", "forgotten"))
    assert forgotten.mean() < 0.5 * out.mean(), "the comb filter takes most of the light"


def test_a_camera_mounted_upside_down_sees_the_picture_turned_by_half_a_turn(definitions, perfect):
    camera, rig = perfect
    rolled = {**camera, "optics": {**camera["optics"], "roll_deg": 180}}
    # One grey response in all bands, and whole superpixels: the mosaic itself does not turn with the picture.
    sample = Sample.from_definition(made(Object | PhotographedObject, uniform(definitions, "leaf-sphere")))
    seen = [
        object_mosaic(sample, made(Camera, one), made(Rig, rig), Pose(60.0, 20.0), STRAIGHT, np.full((3, 61), 1 / 61))
        for one in (camera, rolled)
    ]
    upright, turned = (one.reshape(300, 2, 400, 2).mean(axis=(1, 3)) for one in seen)
    assert np.abs(upright - np.rot90(upright, 2)).mean() > 0.1 * upright.mean()
    assert np.abs(upright - np.rot90(turned, 2)).mean() < 0.002 * upright.mean()


def test_the_room_has_windows_lamps_and_floor_where_they_should_be(definitions):
    room = definitions["environments"]["classroom"]["virtual"]
    source, shading = trace_room(made(VirtualRoom, room), 400, 200)
    names = source_spectra(made(VirtualRoom, room), spectrum("A"))[0]
    rows = {name: np.nonzero(source == i)[0] for i, name in enumerate(names)}
    assert all(len(r) for r in rows.values())
    assert rows["ceiling"].max() < 100 <= rows["floor"].min()
    assert rows["lamps"].max() < 100
    assert (shading > 0).all() and (shading <= 1).all()
    coefficients = room_coefficients(made(VirtualRoom, room), 100, 50)
    # Each pixel's sources are shares of one: shading alone makes them less.
    assert (coefficients.sum(axis=-1) <= 1 + 1e-6).all() and (coefficients >= 0).all()


def test_the_room_is_photographed_as_a_panorama_that_turns_to_the_right(definitions):
    rig_light = spectrum("A")
    room = made(VirtualRoom, definitions["environments"]["classroom"]["virtual"])
    coefficients = room_coefficients(room, 40, 20)
    mosaic = room_mosaic(room, coefficients, rig_light, np.full((3, 61), 1 / 61))
    expected = coefficients @ (source_spectra(room, rig_light)[1] / rig_light).mean(axis=1)
    assert np.allclose(from_panorama(mosaic[::2, ::2, None])[..., 0], expected, rtol=1e-6)
    assert not np.allclose(mosaic[::2, ::2], expected, rtol=0.1)


def test_a_chart_in_the_room_is_lit_by_what_it_faces(definitions):
    room = made(VirtualRoom, definitions["environments"]["classroom"]["virtual"])
    light = spectrum("A")

    def on_chart(position_m, facing):
        return light_on_chart(room, made(PlacedChart, {"position_m": position_m, "facing": facing}), light)

    _, sources = source_spectra(room, light)
    window, lamps = sources[4:6] / np.linalg.norm(sources[4:6], axis=1, keepdims=True)
    at_window, at_desk = on_chart([4.0, 0.0, 1.2], [1, 0, 0]), on_chart([0.0, 0.0, 0.75], [0, 0, 1])
    at_window, at_desk = (one / np.linalg.norm(one) for one in (at_window, at_desk))
    assert at_window @ window > 0.995 > at_desk @ window
    assert at_desk @ lamps > at_window @ lamps
    # All of the room is on one side of a wall or the other: what two faces get is what a sphere does.
    whole = room_coefficients(replace(room, eye_m=(0.0, 0.0, 1.2)), 400, 200) @ sources
    vertical, solid_angle = directions(400, 200)
    expected = np.tensordot(np.abs(vertical[..., 2]) * solid_angle / np.pi, whole, axes=2)
    both = sum(on_chart([0.0, 0.0, 1.2], [0, 0, side]) for side in (-1, 1))
    np.testing.assert_allclose(both, expected, rtol=1e-6)


def test_stray_light_keeps_the_colour_of_the_picture(definitions):
    rig = copy.deepcopy(definitions["rigs"]["virtual"])
    for name in NO_FAULTS:
        rig["virtual"]["imperfections"][name]["enabled"] = name == "stray_light"
    picture = np.zeros((60, 80))
    picture[0::2, 0::2], picture[1::2, 1::2] = 1.0, 0.1  # red ten times as bright as blue, no green
    added = faults_of(rig, "stray", 1)[0].through_optics(picture) - picture
    fraction = rig["virtual"]["imperfections"]["stray_light"]["fraction"]
    np.testing.assert_allclose(added[0::2, 0::2], fraction * 1.0)
    np.testing.assert_allclose(added[1::2, 1::2], fraction * 0.1)
    np.testing.assert_allclose(added[0::2, 1::2], 0.0)


def test_a_measured_material_has_the_reflectance_of_its_table(definitions, tmp_path):
    nm = list(range(400, 701, 20))
    head = ",".join(["theta_i_rad", "phi_i_rad", "theta_r_rad", "phi_r_rad", *map(str, nm)])
    rows = [f"{t},0,{u},{p}" + ",0.2" * len(nm) for t in (0.0, 0.4, 0.8) for u in (0.1, 0.7) for p in (0.0, 3.0)]
    (tmp_path / "even.csv").write_text("\n".join([head, *rows]) + "\n")
    definition = copy.deepcopy(definitions["objects"]["tile-plate"])
    definition["virtual"] = {
        "pattern": {"kind": "uniform"},
        "materials": [{"kind": "measured", "file": str(tmp_path / "even.csv")}],
    }
    truth = true_material(
        made(Object, definition),
        made(Camera, definitions["cameras"]["d5100-comb"]),
        made(Rig, definitions["rigs"]["virtual"]),
    )
    np.testing.assert_allclose(truth.basis[:, 0], np.pi * 0.2)
    assert np.isnan(truth.beta).all() and np.isnan(truth.mu).all()
