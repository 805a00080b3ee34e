"""The virtual rig photographs what equation (5) says, with the faults that its file switches on and no others."""

import copy
from pathlib import Path

import numpy as np
import pytest

from irodori.brdf import angles_from_directions, reflect
from irodori.calibration import patch_centres
from irodori.captures import Pose, read_captures
from irodori.config import load_definitions, read_yaml
from irodori.geometry.embree import Tracer
from irodori.geometry.frames import rig_from_camera, rig_from_object, to_camera, to_light
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.shapes import on_table
from irodori.mosaic import decode
from irodori.rig.virtual.classroom import room_coefficients, source_spectra, trace_room
from irodori.rig.virtual.imaging import expose_object
from irodori.rig.virtual.samples import Sample
from irodori.rig.virtual.sensor import band_weights
from irodori.rig.virtual.session import Session, capture_camera, capture_object
from irodori.spectra import spectrum

ROOT = Path(__file__).resolve().parents[2]
NO_FAULTS = ("light_drift", "vignetting", "stray_light", "pose_error")


@pytest.fixture(scope="module")
def definitions():
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT)


@pytest.fixture
def perfect(definitions):
    """Return camera and rig without any imperfection."""
    rig = copy.deepcopy(definitions["rigs"]["virtual"])
    for name in NO_FAULTS:
        rig["virtual"]["imperfections"][name]["enabled"] = False
    return definitions["cameras"]["d5100-comb"], rig


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
    sample = Sample.from_definition(definition)
    weights = band_weights(camera, spectrum(rig["light"]["spectrum"]))
    rotation = rig_from_object(pose)
    tracer = Tracer(on_table(sample.shape, rotation, rig["table_radius_mm"]))
    pinhole = Pinhole.from_optics(camera["optics"])
    position = rig["camera_distance_mm"] * to_camera(pose)
    lamp = np.radians(rig["virtual"]["light_angular_radius_deg"])
    image = expose_object(
        sample, tracer, rotation, pinhole, position, rig_from_camera(pose), to_light(pose), weights, lamp
    )
    return image, sample, weights


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


def test_the_underside_and_the_shadow_of_the_table_are_black(definitions, perfect):
    image, _, _ = photograph(uniform(definitions, "tile-plate"), *perfect, Pose(95.0, 20.0))
    assert image.max() == 0.0


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
    pinhole = Pinhole.from_optics(camera["optics"])
    expected = pinhole.project(point, rig["camera_distance_mm"] * to_camera(pose), rig_from_camera(pose))
    assert np.hypot(x.mean() / 2 - expected[0], y.mean() / 2 - expected[1]) < 2.0


def test_the_chart_stands_where_the_camera_file_says(perfect, tmp_path):
    camera, rig = perfect
    capture_camera(camera, rig, "d5100-comb", tmp_path / "captures.csv")
    shots = read_captures(tmp_path / "captures.csv", tmp_path)
    roles = [shot.role for shot in shots]
    assert roles.count("dark") == 4 and roles.count("white") == 4 and roles.count("chart") == 2
    chart = next(shot for shot in shots if shot.role == "chart" and shot.filter == "out")
    picture = decode(tmp_path / chart.file).superpixels[..., 1]
    for x, y in patch_centres(camera["chart"]):
        patch = picture[round(y) - 12 : round(y) + 13, round(x) - 12 : round(x) + 13]
        assert patch.std() < 0.1 * patch.mean() + 30, "a patch is even over 25 superpixels"


def test_faults_can_be_switched_off_one_by_one(definitions, tmp_path):
    camera = definitions["cameras"]["d5100-comb"]
    for name in NO_FAULTS:
        rig = copy.deepcopy(definitions["rigs"]["virtual"])
        for other in NO_FAULTS:
            rig["virtual"]["imperfections"][other]["enabled"] = other == name
        session = Session(camera, rig, name, tmp_path / name)
        even = np.ones((600, 800))
        light = [session._next_light() for _ in range(200)]
        pose = session.real_pose(Pose(45.0, 10.0))
        seen = session._through_optics(even)
        assert (np.std(light) > 0) == (name == "light_drift")
        assert (pose != Pose(45.0, 10.0)) == (name == "pose_error")
        assert (np.ptp(seen) > 0.05) == (name == "vignetting")
        assert (seen.max() > 1.0) == (name == "stray_light")


def test_the_light_drifts_by_its_rms_and_slowly(definitions, tmp_path):
    session = Session(definitions["cameras"]["d5100-comb"], definitions["rigs"]["virtual"], "drift", tmp_path)
    light = np.array([session._next_light() for _ in range(60_000)])
    assert light.std() == pytest.approx(0.01, rel=0.15)
    step = np.diff(light).std()
    assert step == pytest.approx(0.01 * np.sqrt(2 * (1 - np.exp(-1 / 60))), rel=0.02)


def test_a_session_is_reproducible_and_sessions_differ(definitions, perfect, tmp_path):
    camera, rig = perfect
    definition = uniform(definitions, "tile-plate")
    definition["poses"] = [{"light_deg": [45.0], "camera_deg": [20.0]}]
    for folder, name in (("a", "one"), ("b", "one"), ("c", "two")):
        capture_object(definition, camera, rig, name, tmp_path / folder / "captures.csv")
    files = [sorted((tmp_path / folder).glob("*.dng")) for folder in "abc"]
    pictures = [decode(group[0]).superpixels for group in files]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).any()


def test_the_room_has_windows_lamps_and_floor_where_they_should_be(definitions):
    room = definitions["environments"]["classroom"]["virtual"]
    source, shading = trace_room(room, 400, 200)
    names = source_spectra(room, spectrum("A"))[0]
    rows = {name: np.nonzero(source == i)[0] for i, name in enumerate(names)}
    assert all(len(r) for r in rows.values())
    assert rows["ceiling"].max() < 100 <= rows["floor"].min()
    assert rows["lamps"].max() < 100
    assert (shading > 0).all() and (shading <= 1).all()
    coefficients = room_coefficients(room, 100, 50)
    # Each pixel's sources are shares of one: shading alone makes them less.
    assert (coefficients.sum(axis=-1) <= 1 + 1e-6).all() and (coefficients >= 0).all()
