"""Errors of a registered object's angles: derivatives at a pixel, scatter of photographs, and what the fit uses."""

import math
from dataclasses import replace

import h5py
import numpy as np
import pytest
from drawn_plates import NAMES, PLATE, SETUP, VIEWS, correction, drawn
from test_registration_steps import problem_without_pictures

from irodori.config.capture_table import Pose
from irodori.config.models import Placing
from irodori.core import store
from irodori.fitting.solvers import FitOptions, fit
from irodori.fitting.stage import fit_brdf, for_object
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera, to_light
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.sphere import Sphere
from irodori.material.angle_errors import DATASET
from irodori.rectification.object_registration import register, register_object
from irodori.rectification.placement_correction import COUNT, LIGHT, Correction
from irodori.rectification.registration_covariance import (
    RegisteredAngleErrors,
    Rows,
    _angle_changes,
    _directions,
    _is_amid,
    _is_seen,
    angle_errors,
    reduced_chi_square,
)
from irodori.rectification.registration_file import AngleChanges
from irodori.reflection.equation5 import angles_from_directions, reflect

MADE = store.Provenance("test")
ABOUT_Z = NAMES.index("about_z_deg")
POSES = [Pose(45.0, 10.0), Pose(60.0, 25.0, 10.0, 90.0)]
RADIUS_MM = 25.0


def seen_angles(shape, pose, correction_, xy) -> np.ndarray:
    """Angles under which pixels show a corrected plate or sphere, (n, 4) deg, by intersecting their rays with it."""
    real, camera = correction_.pose(pose), SETUP.corrected(correction_)
    eye = camera.camera_distance_mm * to_camera(real)
    rays = camera.pinhole.directions(2.0 * (xy + 0.5), rig_from_camera(real))
    table = rig_from_object(real)
    centre, turned = table @ correction_.translation_mm, table @ correction_.table_from_object
    if isinstance(shape, Sphere):
        along = rays @ (centre - eye)
        far = np.sqrt(np.sum((eye - centre) ** 2) - along**2)
        # Rays beside the sphere are those of hidden points, which do not count.
        hit = eye + (along - np.sqrt(np.maximum(RADIUS_MM**2 - far**2, 0.0)))[:, None] * rays
        normal = (hit - centre) / RADIUS_MM
    else:
        normal = np.broadcast_to(turned[:, 2], rays.shape)
        hit = eye + ((centre - eye) @ turned[:, 2] / (rays @ turned[:, 2]))[:, None] * rays
    view = (eye - hit) / np.linalg.norm(eye - hit, axis=1)[:, None]
    return np.degrees(angles_from_directions(normal, np.broadcast_to(to_light(real), view.shape), view))


@pytest.mark.parametrize("shape", [Plate(60.0, 50.0), Sphere(RADIUS_MM)], ids=["plate", "sphere"])
def test_what_a_pixel_shows_changes_as_the_derivatives_say(shape):
    """Any small error of any of the twelve numbers, against rays that meet the moved object."""
    problem = problem_without_pictures(shape, POSES, columns=60, rows=48)
    rng = np.random.default_rng(4)
    for number, pose in enumerate(POSES):
        found = _angle_changes(problem, number)
        moved = rng.normal(size=COUNT) * [0.02, 0.02, 0.02, 0.05, 0.05, 0.05, 0.5, 0.05, 0.2, 0.2, 0.02, 0.02]
        # The same observations, told apart by their angles as they are without an error.
        place = problem.seen(number, problem.texels.position, problem.unknowns)
        own = np.degrees(angles_from_directions(*np.split(_directions(problem, number, problem.unknowns), 3, axis=1)))
        ends = [seen_angles(shape, pose, Correction.of(sign * moved), place) for sign in (1.0, -1.0)]
        exact = 0.5 * (ends[0] - ends[1])
        seen = _is_seen(problem, number) & _is_amid(problem)
        np.testing.assert_allclose(seen_angles(shape, pose, Correction(), place)[seen], own[seen], atol=1e-5)
        steep = own[seen][:, 3] > 1.0  # of an angle near zero the second order is more than the first
        np.testing.assert_allclose((found @ moved)[steep], exact[seen][steep], atol=0.02 * np.abs(exact[seen]).max())


def test_a_turned_sphere_is_seen_under_the_same_angles_and_a_turned_plate_is_not():
    turned = np.zeros((COUNT + 2, COUNT + 2))
    turned[[3, 4, 5], [3, 4, 5]] = 1.0  # a degree about each axis, as before any photograph
    sphere, plate = (
        angle_errors(problem_without_pictures(shape, POSES, columns=60, rows=48), turned, 0.0).rms
        for shape in (Sphere(RADIUS_MM), Plate(60.0, 50.0))
    )
    assert sphere.max() < 0.01 and 0.9 < plate[3] < 1.1


def test_an_error_of_the_light_moves_the_half_vector_by_half():
    """In the plane of incidence of a flat object, which has no other error."""
    problem = problem_without_pictures(Plate(2.0, 2.0), [Pose(45.0, 10.0), Pose(60.0, 30.0)])
    nothing = np.zeros((COUNT + 2, COUNT + 2))
    own = angle_errors(problem, nothing, 0.1)
    np.testing.assert_allclose(own.rms, [0.1, 0.0, 0.05, 0.05], atol=1e-4)
    np.testing.assert_allclose(own.by_photograph, [own.rms] * 2, atol=1e-4)
    shared = nothing.copy()
    shared[LIGHT, LIGHT] = 0.3**2
    np.testing.assert_allclose(angle_errors(problem, shared, 0.4).rms, [0.5, 0.0, 0.25, 0.25], atol=1e-3)


def photographs_of(rng, count, scatter, unknowns=4, points=40):
    """Rows of photographs whose points have a common displacement in addition, fitted by least squares."""
    found, matrix, right = [], np.eye(unknowns) * 1e-9, np.zeros(unknowns)
    for number in range(count):
        change = rng.normal(size=(points, unknowns))
        own = change @ rng.normal(size=unknowns) * scatter / math.sqrt(points)
        found.append(Rows([*range(unknowns)], change, np.ones(points), rng.normal(size=points) + own))
        found[number].add_to(matrix, right)
    solution = np.linalg.solve(matrix, right)
    return [rows._replace(off=rows.off - rows.change @ solution) for rows in found]


@pytest.mark.parametrize(("scatter", "expected"), [(0.0, 1.0), (3.0, 10.0), (10.0, 101.0)])
@pytest.mark.parametrize("weight", [1.0, 0.04], ids=["right", "too-small"])
def test_variances_of_photographs_follow_from_their_contradictions(scatter, expected, weight):
    """The displacement adds ``scatter`` squared to what each photograph tells; expected variances may be too large."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(30):
        rows = [one._replace(weight=weight * one.weight) for one in photographs_of(rng, 12, scatter)]
        found.append(reduced_chi_square(rows, np.full(4, 1e3), 4.0))
    assert np.mean([together for _, together in found]) == pytest.approx(weight * expected, rel=0.12, abs=0.03)
    assert all(each.min() >= together for each, together in found)


def test_without_anything_to_contradict_variances_are_as_expected():
    rows = photographs_of(np.random.default_rng(2), 3, 5.0)
    tight = np.full(4, 1e-3)  # the prior knows all of it better
    assert reduced_chi_square(rows, tight, 0.0)[1] == 1.0
    assert reduced_chi_square(rows, np.full(4, 1e3), 12.0)[1] == 1.0
    assert reduced_chi_square([], tight, 0.0)[1] == 1.0


def test_texels_amid_others_are_all_of_a_plate_but_those_of_its_border():
    problem = problem_without_pictures(Plate(60.0, 50.0), POSES)
    texels = problem.texels
    row, column = np.divmod(texels.number, texels.columns)
    inner = (row > 0) & (row < texels.rows - 1) & (column > 0) & (column < texels.columns - 1)
    np.testing.assert_array_equal(_is_amid(problem), inner)


def test_errors_of_angles_are_said_of_incidence_and_half_vector_or_why_they_are_not_known():
    rms, spread = np.array([0.1, 0.2, 0.3, 0.4]), np.array([[0.01, 0.11], [0.02, 0.12], [0.03, 0.13], [0.04, 0.14]])
    changes = AngleChanges(np.zeros((1, 4, COUNT + 1, COUNT + 1)), np.zeros(1, dtype=int))
    assert str(RegisteredAngleErrors(rms, rms[None], spread, changes)) == (
        "errors of the angles, degrees: incidence 0.100 (90 % from 0.010 to 0.110), "
        "between normal and half vector 0.400 (90 % from 0.040 to 0.140)"
    )
    unknown = RegisteredAngleErrors(np.full(4, np.nan), rms[None], spread, changes)
    assert "not told, because no texel amid others is seen and lit" in str(unknown)


# From the photographs to the fit


@pytest.fixture(scope="module")
def registered(tmp_path_factory):
    """A drawn plate that lies off in its plane and by its tilt, registered and rectified."""
    folder = tmp_path_factory.mktemp("registered")
    truth = correction(x_mm=0.8, y_mm=-0.6, about_x_deg=0.4, about_z_deg=0.4)
    files = drawn(folder, truth, contrast=0.3)
    register_object(files, PLATE, SETUP, Placing(), output=folder / "registration.h5", provenance=MADE)
    return folder, truth, files


def test_the_file_of_a_registration_has_errors_of_angles_that_hold(registered):
    folder, truth, _ = registered
    with store.open_file(folder / "registration.h5") as file:
        stated, spread = file.read(DATASET), file.read("angle_error_spread")
        of_each, used = file.read("angle_error_of_capture"), Correction.of(file.read("correction"))
    with h5py.File(folder / "registration.h5") as file:
        assert file[DATASET].attrs["units"] == "deg" and file["angle_error_of_capture"].attrs["units"] == "deg"
    assert of_each.shape == (len(VIEWS), 4) and (spread[:, 0] <= stated).all()
    np.testing.assert_allclose(np.sqrt(np.mean(of_each**2, axis=0)), stated, rtol=0.1)
    problem = problem_without_pictures(Plate(60.0, 50.0), VIEWS)
    off = []
    for number, pose in enumerate(VIEWS):
        place = problem.seen(number, problem.texels.position, np.zeros(COUNT + len(VIEWS)))
        off.append(
            seen_angles(Plate(60.0, 50.0), pose, used, place) - seen_angles(Plate(60.0, 50.0), pose, truth, place)
        )
    # Nothing moved light and camera here: the errors are smaller than stated, which allows for that.
    assert (np.sqrt(np.mean(np.square(off), axis=(0, 1))) < stated).all()
    # Light and camera, each with a shared and an own error of 0.05 degrees, and the tilt of the plate.
    assert 0.05 < stated[3] < 0.1


def test_priors_of_the_angles_are_all_that_is_left_of_an_object_that_cannot_move(tmp_path):
    certain = "translation_mm", "rotation_deg", "camera_distance_mm", "focal_length_percent", "principal_point_px"
    fixed = Placing(**dict.fromkeys((*certain, "camera_deg"), 0.0), light_deg=0.2)
    found = register(drawn(tmp_path, Correction(), VIEWS[:2], VIEWS[:2]), PLATE, SETUP, fixed).angle_errors
    # A shared and an own error of the light.
    np.testing.assert_allclose(found.rms, 0.2 * math.sqrt(2.0) * np.array([1.0, 0.0, 0.5, 0.5]), atol=0.01)


def observations(path, angle_error_deg=None):
    """A tile of texels whose highlight is seen from both flanks, with or without errors by registration."""
    rng, count = np.random.default_rng(3), 40
    theta = np.radians(np.linspace(20.0, 60.0, 12))
    geometry = np.tile(
        np.stack([0 * theta + 0.7, theta, (0.7 + theta) / 2, np.abs(theta - 0.7) / 2], -1), (count, 1, 1)
    )
    clean = reflect(0.3, 1.0, 2.0, 0.12, geometry)
    noisy = clean * (1.0 + 0.003 * rng.normal(size=clean.shape))
    response = np.repeat(noisy[..., None], 3, axis=2)
    with store.create(path, MADE) as out:
        out.coordinate("capture", [str(j) for j in range(12)], units="1", quantity="name of the capture")
        out.coordinate("angle", ["theta_i", "theta_r", "theta_h", "phi"], units="1", quantity="symbol of an angle")
        for name, values, dims in (
            ("response", response.astype("f4"), "texel_number,capture,band"),
            ("geometry", geometry.astype("f4"), "texel_number,capture,angle"),
            ("weight", np.ones((count, 12), "f4"), "texel_number,capture"),
            ("clipped", np.zeros((count, 12), "u1"), "texel_number,capture"),
            ("noise_model", np.tile([1e-6, 0.0], (12, 3, 1)), "capture,band,term"),
            ("texel", np.ones(count, "u1"), "texel_number"),
        ):
            out.write(name, values, units="1", dims=dims, quantity=name)
        if angle_error_deg is not None:
            out.write(DATASET, np.array(angle_error_deg), units="deg", dims="angle", quantity="error")
        for name, value in (("rows", [0, 5]), ("width", 8), ("filters", ["out"])):
            out.attribute(name, value)
    return path


def test_photographs_that_contradict_each_other_tell_less(tmp_path):
    """Turns half a degree off in turn: four of them tell the turn within a quarter of a degree, and not to 0.03."""
    shown = [replace(pose, turn_deg=pose.turn_deg + off) for pose, off in zip(VIEWS, (0.5, -0.5) * 2, strict=True)]
    sigma = []
    for name, poses in (("sound", VIEWS), ("off", shown)):
        (tmp_path / name).mkdir()
        found = register(drawn(tmp_path / name, Correction(), poses, contrast=0.0), PLATE, SETUP, Placing())
        sigma.append(found.sigma[ABOUT_Z])
    assert sigma[0] < 0.04 and 0.1 < sigma[1] < 0.5


@pytest.mark.parametrize(
    ("stated", "by_registration", "used"),
    [
        ("auto", (0.3, 0.3, 0.2, 0.2), {"theta_i_deg": 0.3, "phi_deg": 0.2, "source": "registered"}),
        ("auto", None, {"theta_i_deg": 0.05, "phi_deg": 0.05 / math.sqrt(2.0), "source": "assumed"}),
        (0.4, (0.3, 0.3, 0.2, 0.2), {"theta_i_deg": 0.4, "phi_deg": 0.4 / math.sqrt(2.0), "source": "stated"}),
        (0.0, None, {"theta_i_deg": 0.0, "phi_deg": 0.0, "source": "stated"}),
    ],
)
def test_a_fit_uses_what_is_stated_else_what_registration_tells(tmp_path, caplog, stated, by_registration, used):
    tile, output = observations(tmp_path / "tile.h5", by_registration), tmp_path / "brdf.h5"
    with caplog.at_level("INFO", logger="irodori"):
        fit_brdf(tile, output, FitOptions(pose_error_deg=stated), 1.5, 0.0, provenance=MADE)
    said = {"registered": "by registration", "stated": "as stated", "assumed": "as assumed without registration"}
    assert f"{used['phi_deg']:.3f} deg to the half vector, {said[used['source']]}" in caplog.text
    with store.open_file(output) as file:
        assert file.attribute("angle_errors", dict) == pytest.approx(used)
        found = np.nanmedian(file.read("mu_error"))
        with store.open_file(tile) as seen:
            response, geometry, weight = (seen.read(name) for name in ("response", "geometry", "weight"))
        same = FitOptions(pose_error_deg=used["phi_deg"] * math.sqrt(2.0))
        noise = np.tile([1e-6, 0.0], (12, 1))
        alike = fit(response[..., 1], geometry, weight, 1.5, 0.0, same, noise=noise)
        # What moves the half vector is what counts for the roughness.
        assert found == pytest.approx(np.nanmedian(alike.mu_error), rel=0.02)
    assert for_object(FitOptions(pose_error_deg=stated), [tile]).angles.source == used["source"]
