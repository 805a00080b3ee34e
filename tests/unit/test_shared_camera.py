"""Registrations are combined: against one fit of all measurements, and where objects contradict each other."""

import logging

import numpy as np
import pytest
from drawn_plates import NAMES, PLATE, SETUP, correction, drawn
from test_registration_steps import problem_without_pictures

from irodori.config.capture_table import Pose
from irodori.config.models import Placing
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.shapes.sphere import Sphere
from irodori.material.angle_errors import read_registered
from irodori.rectification.object_registration import register_object
from irodori.rectification.placement_correction import CAMERA, COUNT, LIGHT, Correction, prior_sigma
from irodori.rectification.registration_covariance import angle_errors
from irodori.rectification.registration_file import AngleChanges, Estimate, Told, read_told
from irodori.rectification.shared_camera import combine_registrations, combined

MADE = store.Provenance("test")
PRIOR = prior_sigma(Placing())
CAPTURES = 3
SIZE = COUNT + CAPTURES
ROOM = np.append(PRIOR, np.full(CAPTURES, PRIOR[CAMERA]))  # of every unknown of an object
COMMON = np.array([NAMES.index(name) for name in NAMES[6:LIGHT]])
OWN = np.array([at for at in range(SIZE) if at not in (*COMMON, LIGHT)])
DISTANCE, FOCAL = NAMES.index("camera_distance_mm"), NAMES.index("focal_length_percent")
NO_ANGLES = AngleChanges(np.zeros((CAPTURES, 4, COUNT + 1, COUNT + 1)), np.zeros(CAPTURES, dtype=int))


class Measured:
    """What is measured of one object: rows that depend linearly on its unknowns, with errors of 1."""

    def __init__(self, rng, common, *, count=60, strength=30.0, is_ball=False, light=None):
        self.truth = ROOM * rng.normal(size=SIZE)
        self.truth[COMMON], self.truth[LIGHT] = common, 0.0
        self.rows = strength * rng.normal(size=(count, SIZE)) / ROOM / np.sqrt(count)
        self.rows[:, LIGHT] = 0.0
        if is_ball:  # only the ratio of focal length and distance, and no turn
            self.rows[:, DISTANCE] = -self.rows[:, FOCAL] / 9.0
            self.rows[:, 3:6] = 0.0
        self.readings, self.light = self.rows @ self.truth + rng.normal(size=count), light

    def told(self) -> Told:
        covariance = np.linalg.inv(self.rows.T @ self.rows + np.diag(ROOM**-2.0))
        probable = covariance @ self.rows.T @ self.readings
        # What is in use does not enter the combination.
        estimate = Estimate(probable, covariance, PRIOR, np.zeros(COUNT))
        return Told(estimate, self.light, NO_ANGLES, [str(n) for n in range(CAPTURES)], ["as photographed"])


def common_numbers(rng):
    return PRIOR[COMMON] * rng.normal(size=len(COMMON))


def together(objects) -> tuple[np.ndarray, np.ndarray]:
    """One least-squares fit of all objects: common numbers and each object's own; values and covariance."""
    size = len(COMMON) + len(OWN) * len(objects)
    matrix, right = np.zeros((size, size)), np.zeros(size)
    matrix[np.diag_indices(size)] = np.concatenate([PRIOR[COMMON], *[ROOM[OWN]] * len(objects)]) ** -2.0
    for number, one in enumerate(objects):
        first = len(COMMON) + number * len(OWN)
        where = [*range(len(COMMON)), *range(first, first + len(OWN))]
        rows = one.rows[:, [*COMMON, *OWN]]
        matrix[np.ix_(where, where)] += rows.T @ rows
        right[where] += rows.T @ one.readings
    covariance = np.linalg.inv(matrix)
    return covariance @ right, covariance


def test_registrations_combine_to_what_one_fit_of_all_measurements_gives():
    rng = np.random.default_rng(1)
    common = common_numbers(rng)
    objects = [Measured(rng, common), Measured(rng, common, is_ball=True), Measured(rng, common, strength=3.0)]
    values, covariance = together(objects)
    found = combined({str(n): one.told() for n, one in enumerate(objects)})
    for number, placed in enumerate(found.values()):
        first = len(COMMON) + number * len(OWN)
        where = [*range(len(COMMON)), *range(first, first + len(OWN))]
        mine, scale = np.array([*COMMON, *OWN]), np.array([*ROOM[COMMON], *ROOM[OWN]])
        np.testing.assert_allclose(placed.estimate.probable[mine] / scale, values[where] / scale, atol=1e-8)
        np.testing.assert_allclose(
            placed.estimate.covariance[np.ix_(mine, mine)] / np.outer(scale, scale),
            covariance[np.ix_(where, where)] / np.outer(scale, scale),
            atol=1e-8,
        )
        assert placed.estimate.covariance[LIGHT, LIGHT] == pytest.approx(PRIOR[LIGHT] ** 2)


def test_a_ball_learns_from_a_plate_what_it_cannot_tell_and_says_from_whom():
    rng = np.random.default_rng(2)
    common = PRIOR[COMMON] * [1.0, -1.2, 0.8, 0.9, 0.1]
    plate, ball = Measured(rng, common, strength=100.0).told(), Measured(rng, common, is_ball=True).told()
    assert not ball.estimate.told[[DISTANCE, FOCAL]].any()
    found = combined({"plate": plate, "ball": ball})
    for placed in found.values():
        estimate = placed.estimate
        assert (np.abs(estimate.values[COMMON] - common) / PRIOR[COMMON] < 0.11).all()
        assert (estimate.sigma[COMMON[:4]] < 0.05 * PRIOR[COMMON[:4]]).all()
        assert "of camera and lens, plate, ball tell together" in placed.remarks[0]
        assert "distance of the camera, focal length by plate;" in placed.remarks[0]
        assert placed.remarks[-1] == "as photographed"
    both = np.array([one.estimate.values[COMMON] for one in found.values()])
    assert (both[0] == both[1]).all()  # one camera


def test_where_everything_is_told_the_most_probable_place_is_used():
    rng = np.random.default_rng(12)
    common = PRIOR[COMMON] * [1.0, -1.2, 0.8, 0.9, 1.1]
    found = combined({str(n): Measured(rng, common, strength=300.0).told() for n in range(2)})
    for placed in found.values():
        np.testing.assert_allclose(placed.estimate.values[:6], placed.estimate.probable[:6], atol=0.02 * PRIOR[0])


def test_stated_errors_of_what_is_combined_are_honest():
    """Over draws of everything from its prior: χ² of the common numbers, and of where each object stands."""
    rng, squares = np.random.default_rng(3), {"common": [], "place": []}
    for _ in range(60):
        common = common_numbers(rng)
        objects = {str(n): Measured(rng, common, is_ball=n > 0, strength=10.0) for n in range(3)}
        found = combined({name: one.told() for name, one in objects.items()})
        for name, one in objects.items():
            estimate = found[name].estimate
            off = estimate.probable - one.truth
            for part, where in (("common", COMMON), ("place", np.arange(6))):
                squares[part].append(
                    off[where] @ np.linalg.solve(estimate.covariance[np.ix_(where, where)], off[where])
                )
    assert np.mean(squares["common"]) / len(COMMON) == pytest.approx(1.0, abs=0.25)
    assert np.mean(squares["place"]) / 6.0 == pytest.approx(1.0, abs=0.15)


def test_a_number_that_was_certain_stays_as_typed():
    rng = np.random.default_rng(4)
    common = common_numbers(rng)
    common[FOCAL - 6] = 0.0
    told = {}
    for name in ("a", "b"):
        own = Measured(rng, common).told()
        # As registration states it: without room, and without a covariance.
        free = np.array([at for at in range(SIZE) if at != FOCAL])
        covariance, prior = np.zeros((SIZE, SIZE)), PRIOR.copy()
        inner = np.linalg.inv(own.estimate.covariance)[np.ix_(free, free)]
        covariance[np.ix_(free, free)] = np.linalg.inv(inner)
        prior[FOCAL] = 0.0
        probable = own.estimate.probable.copy()
        probable[FOCAL] = 0.0
        told[name] = own._replace(estimate=Estimate(probable, covariance, prior, np.zeros(COUNT)))
    for placed in combined(told).values():
        assert placed.estimate.values[FOCAL] == placed.estimate.probable[FOCAL] == 0.0
        assert (placed.estimate.covariance[FOCAL] == 0.0).all() and np.isfinite(placed.estimate.covariance).all()


# Who was not photographed together with the others.


@pytest.mark.parametrize("moved", ["refocused", "camera nearer"])
def test_an_object_before_another_camera_is_left_apart_and_named(moved, caplog):
    rng = np.random.default_rng(5)
    common = common_numbers(rng)
    other = common + (np.array([0, 3.0, 0, 0, 0]) if moved == "refocused" else np.array([30.0, 0, 0, 0, 0]))
    objects = {"ball": Measured(rng, common, is_ball=True), "plate": Measured(rng, common)}
    objects |= {"tile": Measured(rng, common), "late": Measured(rng, other)}
    told = {name: one.told() for name, one in objects.items()}
    with caplog.at_level(logging.WARNING, logger="irodori"):
        found = combined(told)
    alone = combined({name: told[name] for name in ("ball", "plate", "tile")})
    for name, placed in alone.items():
        np.testing.assert_array_equal(found[name].estimate.probable, placed.estimate.probable)
    assert found["late"].estimate is told["late"].estimate  # as its own photographs say
    said = found["late"].remarks[0]
    assert said.startswith("left apart from ball, plate, tile, which contradict it about camera and lens: ")
    assert ("focal length" if moved == "refocused" else "distance of the camera") in said and "against" in said
    assert "late: left apart" in caplog.text and "plate: left apart from late" in caplog.text


def test_two_sets_typed_as_one_are_found_and_combined_each_for_itself():
    rng = np.random.default_rng(6)
    first, second = common_numbers(rng), common_numbers(rng)
    second[0] = first[0] + 60.0
    objects = {name: Measured(rng, first if name < "c" else second) for name in "abcd"}
    told = {name: one.told() for name, one in objects.items()}
    found = combined(told)
    for pair in ("ab", "cd"):
        alone = combined({name: told[name] for name in pair})
        for name in pair:
            np.testing.assert_array_equal(found[name].estimate.probable, alone[name].estimate.probable)
            assert "left apart from" in found[name].remarks[0]
    assert list(found) == list("abcd")


def test_two_objects_that_contradict_each_other_are_both_left_as_they_were():
    rng = np.random.default_rng(7)
    common = common_numbers(rng)
    told = {"a": Measured(rng, common).told(), "b": Measured(rng, common + np.array([0, 0, 5.0, 0, 0])).told()}
    found = combined(told)
    assert all(found[name].estimate is told[name].estimate for name in told)
    assert all("principal point along the rows" in found[name].remarks[0] for name in told)


def test_an_object_that_tells_nothing_contradicts_nobody():
    rng = np.random.default_rng(8)
    common = common_numbers(rng)
    told = {"plate": Measured(rng, common).told(), "mute": Measured(rng, -5.0 * common, strength=1e-3).told()}
    found = combined(told)
    assert found["mute"].estimate.told[[DISTANCE, FOCAL]].all()
    np.testing.assert_allclose(found["plate"].estimate.probable, told["plate"].estimate.probable, rtol=1e-3, atol=1e-4)


def test_sound_sets_are_hardly_ever_divided():
    rng, divided = np.random.default_rng(9), 0
    for _ in range(100):
        common = common_numbers(rng)
        told = {str(n): Measured(rng, common, is_ball=n % 2 > 0, strength=20.0).told() for n in range(5)}
        divided += any("left apart" in one.remarks[0] for one in combined(told).values())
    assert divided <= 1


# The light.


def test_balls_show_a_plate_where_the_light_stands():
    rng = np.random.default_rng(10)
    common = common_numbers(rng)
    told = {"plate": Measured(rng, common).told()}
    told |= {f"ball-{n}": Measured(rng, common, light=(1.0 + 0.02 * n, 0.06)).told() for n in range(3)}
    found = combined(told)
    for placed in found.values():
        estimate = placed.estimate
        assert estimate.values[LIGHT] == pytest.approx(1.02, abs=1e-3) and estimate.told[LIGHT]
        assert estimate.sigma[LIGHT] == pytest.approx(0.06 / np.sqrt(3.0), rel=0.01)
        assert "ball-0, ball-1, ball-2 show the light +1.02 ± 0.03 deg from its typed angles" in placed.remarks


def test_a_light_that_agrees_with_what_was_typed_narrows_its_error_only():
    rng = np.random.default_rng(11)
    common = common_numbers(rng)
    told = {"plate": Measured(rng, common).told(), "ball": Measured(rng, common, light=(0.03, 0.05)).told()}
    plate = combined(told)["plate"].estimate
    assert plate.values[LIGHT] == 0.0
    assert plate.sigma[LIGHT] == pytest.approx(0.05 / np.sqrt(2.0), rel=0.01)
    assert plate.probable[LIGHT] == pytest.approx(0.015, rel=0.01)
    assert (plate.covariance[LIGHT, :LIGHT] == 0.0).all()


def test_a_ball_whose_highlights_contradict_the_others_keeps_its_own():
    rng = np.random.default_rng(12)
    common = common_numbers(rng)
    lights = {"ball-0": (0.0, 0.05), "ball-1": (0.03, 0.05), "lacquer": (0.9, 0.05), "plate": None}
    told = {name: Measured(rng, common, light=light).told() for name, light in lights.items()}
    found = combined(told)
    own = told["lacquer"].estimate
    assert found["lacquer"].estimate.values[LIGHT] == own.values[LIGHT]
    assert found["lacquer"].estimate.covariance[LIGHT, LIGHT] == own.covariance[LIGHT, LIGHT]
    assert "ball-0, ball-1 show the light" in " ".join(found["plate"].remarks)
    # One against one: nobody can say which is right, and the plate is not asked.
    found = combined({name: told[name] for name in ("ball-0", "lacquer", "plate")})
    assert "show the light" not in " ".join(found["plate"].remarks)
    assert found["plate"].estimate.sigma[LIGHT] == pytest.approx(PRIOR[LIGHT])


# Files.


def test_errors_of_angles_follow_from_what_the_file_keeps(tmp_path):
    """For any errors of a registration, as the propagation over all observations gives them."""
    poses = [Pose(45.0, 10.0), Pose(60.0, 25.0, 10.0, 90.0)]
    problem = problem_without_pictures(Sphere(25.0), poses, columns=40, rows=32)
    rng = np.random.default_rng(13)
    first, second = (root @ root.T for root in 0.05 * rng.normal(size=(2, COUNT + len(poses), COUNT + len(poses))))
    kept, expected = angle_errors(problem, first, 0.05).changes, angle_errors(problem, second, 0.1)
    by_photograph = kept.by_photograph(second, 0.1)
    np.testing.assert_allclose(by_photograph, expected.by_photograph, rtol=1e-9)
    np.testing.assert_allclose(kept.rms(by_photograph), expected.rms, rtol=1e-9)
    assert (expected.spread[:, 0] < expected.rms).all() and (expected.rms < expected.spread[:, 1]).all()


@pytest.fixture(scope="module")
def registered(tmp_path_factory):
    """Registrations of two plates that were drawn before a camera 20 mm nearer than it is typed."""
    folder, files = tmp_path_factory.mktemp("together"), []
    for number, lies in enumerate(({"x_mm": 1.2, "about_z_deg": 1.5}, {"y_mm": -0.9, "about_x_deg": -0.8})):
        photographs = folder / f"plate-{number}"
        photographs.mkdir()
        whole = correction(**lies, camera_distance_mm=-20.0)
        files.append(folder / f"registration-{number}.h5")
        linear = drawn(photographs, whole, contrast=0.3)
        register_object(linear, PLATE, SETUP, Placing(), output=files[-1], provenance=MADE)
    return files


def test_a_file_is_read_as_it_was_written(registered):
    told = read_told(registered[0])
    with store.open_file(registered[0]) as file:
        np.testing.assert_array_equal(told.estimate.sigma, file.read("sigma"))
        np.testing.assert_array_equal(told.estimate.values, file.read("correction"))
        np.testing.assert_array_equal(told.estimate.covariance[:COUNT, :COUNT], file.read("covariance"))
        assert file.attribute("told") == told.estimate.told.tolist()
        assert file.attribute("sentence") == "; ".join([*told.estimate.in_words(), *told.remarks])
    by_photograph = told.angles.by_photograph(told.estimate.moment, PRIOR[LIGHT])
    np.testing.assert_allclose(told.angles.rms(by_photograph), read_registered(registered[0]), rtol=1e-9)
    assert told.light_deg is None and told.captures == ["0", "1", "2", "3"]


def test_later_stages_read_a_placement_as_they_read_a_registration(registered, tmp_path):
    placements = [tmp_path / f"placement-{n}.h5" for n in range(2)]
    combine_registrations(["one", "two"], registered, placements, provenance=MADE)
    found = [Correction.load(path) for path in placements]
    assert found[0].values[6:] == found[1].values[6:] and found[0].values[:6] != found[1].values[:6]
    for own, path in zip(registered, placements, strict=True):
        with store.open_file(own) as before, store.open_file(path) as after:
            assert (after.read("sigma") <= before.read("sigma") * (1 + 1e-9)).all()
            assert "one, two tell together" in after.attribute("sentence")
            assert after.attribute("captures") == before.attribute("captures")
            assert after.read("angle_error_of_capture").shape == (4, 4)
        assert (read_registered(path) > 0.0).all()


def test_of_an_older_file_it_is_said_what_it_lacks(registered, tmp_path):
    old = tmp_path / "old.h5"
    with store.create(old, MADE) as out:
        out.attribute("captures", ["0"])
        out.write("correction", np.zeros(COUNT), units="1", dims="quantity", quantity="as an earlier version wrote")
    with pytest.raises(InputError, match="probable: found no such dataset"):
        combine_registrations(["a", "b"], [registered[0], old], [tmp_path / "a.h5", tmp_path / "b.h5"], MADE)
    assert not (tmp_path / "a.h5").exists()
