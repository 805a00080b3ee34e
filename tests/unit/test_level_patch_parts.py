"""A level patch in pictures made by hand: what is read of it, each limit from both sides, and the levels it tells."""

import math
import re
from contextlib import nullcontext

import numpy as np
import pytest
from drawn_plates import SETUP, SMALL
from made import made

from irodori.config.capture_table import Pose
from irodori.config.models import LevelPatch, ObjectShape
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera, to_light
from irodori.geometry.shapes.sphere import Sphere
from irodori.material.photograph_levels import KNOWN_PATCH, PATCH, read_levels
from irodori.rectification.level_patch import PatchReading, _check_readings, levels_by_patch, measure_patch, read_patch

BALL = Sphere(10.0)
#: 12 mm are 16 superpixels: the square lies within 79.5 +- 8, 97.5 +- 8 where it stands still before an upright camera.
STILL = {"centre_mm": [0.0, -28.5, 0.0], "side_mm": 12.0, "moves_with_table": False}
ABOVE = Pose(40.0, 0.0)


def refused(words: str):
    """Expect an error with some words (a pattern), and none where there are none."""
    return pytest.raises(InputError, match=words) if words else nullcontext()


def file_of(folder, pose, response, valid=None, name="one.h5", sample_px=2):
    response = np.broadcast_to(response, (120 * 2 // sample_px, 160 * 2 // sample_px, np.shape(response)[-1]))
    valid = np.ones(response.shape[:2], np.uint8) if valid is None else valid
    with store.create(folder / name, store.Provenance("test")) as out:
        out.write("response", response.astype("f4"), units="1", dims="row,column,band", quantity="response")
        for mask, values in (("valid", valid), ("clipped", 0 * valid)):
            out.write(mask, values, units="1", dims="row,column", quantity=mask)
        out.attribute("sample_px", sample_px)
        out.attribute("mosaic", "")
        out.attribute("pose_deg", list(pose.angles_deg))
        out.attribute("filters", ["out", "in"][: response.shape[2] // 3])
    return folder / name


def plane(colour, right=0.0, down=0.0, sample_px=2) -> np.ndarray:
    """Return responses (rows, columns, bands) that change evenly over the picture, 1 times the colour at its middle."""
    y, x = np.mgrid[: 120 * 2 // sample_px, : 160 * 2 // sample_px] * (sample_px / 2.0) - 0.5 + sample_px / 4.0
    return (1.0 + right * (x - 79.5) + down * (y - 59.5))[..., None] * np.asarray(colour)


def where(patch, pose) -> tuple[np.ndarray, np.ndarray]:
    """Return the square's 24 x 24 points in the rig's frame, and where they are seen, superpixels."""
    side = (np.arange(24) + 0.5) / 24.0 * patch["side_mm"] - patch["side_mm"] / 2.0
    points = np.array([[x, y, 0.0] for y in side for x in side]) + patch["centre_mm"]
    if patch.get("moves_with_table", True):
        points = points @ rig_from_object(pose).T
    return points, SMALL.project(points, 900.0 * to_camera(pose), rig_from_camera(pose))


@pytest.mark.parametrize("sample_px", [2, 1])
@pytest.mark.parametrize("pose", [ABOVE, Pose(50.0, 20.0, 10.0, 25.0)])
@pytest.mark.parametrize("moves", [False, True])
def test_a_patch_is_read_over_its_square_in_the_directions_in_which_it_is_seen(tmp_path, pose, moves, sample_px):
    patch, colour = STILL | {"moves_with_table": moves}, np.array([0.3, 0.5, 0.4])
    file = file_of(tmp_path, pose, plane(colour, 2e-3, -3e-3, sample_px), sample_px=sample_px)
    found = read_patch(file, BALL, SETUP, made(LevelPatch, patch))
    points, xy = where(patch, pose)
    normal = rig_from_object(pose)[:, 2] if moves else np.array([0.0, 0.0, 1.0])
    seen = 1.0 + 2e-3 * (xy[:, 0] - 79.5) - 3e-3 * (xy[:, 1] - 59.5)
    cosine = normal @ to_light(pose)
    np.testing.assert_allclose(found.response, colour * seen.mean() / cosine, rtol=1e-5)
    # As many readings as there are samples under the square.
    count = len({tuple(place) for place in np.rint((xy + 0.5) * 2.0 / sample_px - 0.5)})
    np.testing.assert_allclose(found.error, seen.std() / seen.mean() / math.sqrt(count), rtol=1e-4)
    way = 900.0 * to_camera(pose) - points
    way /= np.linalg.norm(way, axis=1)[:, None]
    expected = math.acos(cosine), np.arccos(way @ normal).mean(), np.arccos(way @ to_light(pose)).mean()
    np.testing.assert_allclose(found.angles, expected, atol=1e-6)


def test_a_patch_lies_within_the_frame_to_its_last_sample(tmp_path):
    for by, is_seen in ((0.3, True), (-0.3, False)):
        for axis, sign, edge in ((0, -1.0, 79.5), (0, 1.0, 79.5), (1, 1.0, 59.5), (1, -1.0, 59.5)):
            centre = np.zeros(3)
            # The outermost of the points lies half of a twenty-fourth of the side within the square.
            centre[axis] = sign * (0.75 * (edge - by) - 6.0 * 23.0 / 24.0)
            patch = made(LevelPatch, STILL | {"centre_mm": centre.tolist()})
            file = file_of(tmp_path, ABOVE, plane([0.5] * 3))
            with refused("" if is_seen else "lies outside the frame"):
                read_patch(file, BALL, SETUP, patch)


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (Pose(74.0, 0.0), ""), (Pose(76.0, 0.0), "lit at 76 degrees from its normal"),
        (Pose(40.0, 72.0), ""), (Pose(40.0, 77.0), "seen at 77 degrees from its normal"),
    ],
)  # fmt: skip
def test_a_patch_is_lit_and_seen_to_75_degrees(tmp_path, pose, words):
    file = file_of(tmp_path, pose, plane([0.5] * 3))
    patch = made(LevelPatch, STILL | {"side_mm": 2.0})
    with refused(words and rf"one\.h5.*level_patch.*{words}.*up to 75 degrees"):
        read_patch(file, BALL, SETUP, patch)


@pytest.mark.parametrize(
    ("columns", "words"), [(1, ""), (3, r"measured on \d\d% of the square.*nine tenths"), (16, "measured on")]
)
def test_a_tenth_of_the_square_may_be_masked(tmp_path, columns, words):
    valid = np.ones((120, 160), np.uint8)
    valid[:, 75 : 75 + columns // 2] = 0
    if columns == 1:
        valid[92, 75] = 0
    file, patch = file_of(tmp_path, ABOVE, plane([0.5] * 3), valid), made(LevelPatch, STILL)
    with refused(words):
        found = read_patch(file, BALL, SETUP, patch)
        np.testing.assert_allclose(found.response, 0.5 / math.cos(math.radians(40.0)), rtol=1e-5)


@pytest.mark.parametrize(("uneven", "bands", "words"), [
    (0.095, [1, 1, 1], ""), (0.105, [1, 1, 1], "varies by 11% over the square.*even patch"), (0.3, [1, 0, 1], ""),
    (0.105, [0, 1, 0, 0, 0, 0], "varies by 11%"), (0.105, [0, 0, 0, 0, 1, 0], "varies by 11%"),
])  # fmt: skip
def test_the_green_bands_of_a_patch_are_even_to_a_tenth(tmp_path, uneven, bands, words):
    side = np.where(np.arange(160) < 79.5, -1.0, 1.0)[None, :, None]
    file = file_of(tmp_path, ABOVE, np.broadcast_to(0.5 * (1.0 + uneven * side * bands), (120, 160, len(bands))))
    with refused(words):
        read_patch(file, BALL, SETUP, made(LevelPatch, STILL))


def test_one_black_band_is_a_black_patch(tmp_path):
    for colour in ([0.5, 0.5, 0.0], [0.0, 0.5, 0.5]):
        with pytest.raises(InputError, match=r"is black.*white or grey patch"):
            read_patch(file_of(tmp_path, ABOVE, plane(colour)), BALL, SETUP, made(LevelPatch, STILL))


NAMES = ["a.h5", "b.h5", "c.h5"]


@pytest.mark.parametrize(
    ("factor", "other", "hue", "named", "words"),
    [
        (0.49, 1.0, 1.0, "", ""), (0.51, 1.0, 1.0, "a.h5", "reflectance factor of 0.51 by the white.*the stated 0.4"),
        (0.33, 1.0, 1.0, "", ""), (0.31, 1.0, 1.0, "a.h5", "reflectance factor of 0.31"),
        (0.4, 1.49, 1.0, "", ""), (0.4, 1.51, 1.0, "b.h5", "reflects 1.51 times what it does in the median"),
        (0.4, 0.68, 1.0, "", ""), (0.4, 0.65, 1.0, "b.h5", "reflects 0.65 times"),
        (0.4, 1.0, 1.09, "", ""), (0.4, 1.0, 1.11, "b.h5", "changes its hue by 11%"),
        (0.4, 1.0, 0.91, "", ""), (0.4, 1.0, 0.89, "b.h5", "changes its hue by 12%"),
    ],
)  # fmt: skip
def test_a_photograph_that_shows_something_other_than_the_patch_is_named(factor, other, hue, named, words):
    response = factor * np.array([[0.9, 1.0, 1.1, 0.3, 0.5, 0.2]] * 3)
    response[1] *= other
    response[1, 0] *= hue
    patch = made(LevelPatch, STILL | {"reflectance_factor": 0.4})
    with refused(words and rf"^{re.escape(named)}: level_patch: .*{words}"):
        _check_readings(NAMES, response, patch)
    if "factor" in words:  # which is not known where it is not stated
        _check_readings(NAMES, response, made(LevelPatch, STILL))


@pytest.mark.parametrize("stated", [None, 0.5])
@pytest.mark.parametrize("varies", [0.003, 0.2])
def test_levels_are_what_normal_variables_are_given_the_responses(stated, varies):
    """Written out: a lamp that drifts, and has changed, a patch that departs from the law alike in like directions."""
    rng, count = np.random.default_rng(4), 5
    angles = np.radians([(40, 0, 40), (40, 0, 40), (42, 5, 47), (60, 30, 90), (20, 60, 80)])
    response = 0.5 * np.exp(varies * rng.normal(size=(count, 6)) + 0.01)
    error = rng.uniform(1e-3, 4e-3, (count, 6))
    readings = [PatchReading(*one) for one in zip(response, error, angles, strict=True)]
    patch = (
        STILL | {"departure": 0.008, "reflectance_error": 0.006} | ({"reflectance_factor": stated} if stated else {})
    )
    found = levels_by_patch(readings, made(LevelPatch, patch), 0.01, 0.014)
    for state, band in enumerate((1, 4)):
        told = np.log(response[:, band])
        told = told - (math.log(stated) if stated else told.mean())
        of_factor = 0.006 if stated else 1e3
        drift = max(0.01**2, told.var() - 0.008**2)
        change = max(0.014**2, told.mean() ** 2 - of_factor**2)
        prior, noise = np.full((count, count), change), np.full((count, count), of_factor**2)
        for i in range(count):
            prior[i, i] += drift
            noise[i, i] += error[i, band] ** 2
            for j in range(count):
                noise[i, j] += 0.008**2 * math.exp(-0.5 * (np.linalg.norm(angles[i] - angles[j]) / 0.2) ** 2)
        gain = prior @ np.linalg.inv(prior + noise)
        level = np.exp(gain @ told)
        left = prior - gain @ prior
        np.testing.assert_allclose(found.level[:, state], level if stated else level / level.mean(), rtol=1e-6)
        own = left - left.mean(axis=0) - left.mean(axis=1)[:, None] + left.mean()
        np.testing.assert_allclose(found.error[:, state], np.sqrt(np.diag(own)), rtol=1e-4)
        if stated and not state:
            assert found.common_error == pytest.approx(math.sqrt(left.mean()))
    assert found.source == (KNOWN_PATCH if stated else PATCH) and (stated or found.common_error == 0.014)


def test_levels_of_both_filter_states_are_written_with_the_names_of_the_photographs(tmp_path):
    files = []
    for number, level in enumerate(([1.02, 0.98], [0.98, 1.02], [1.0, 1.0])):
        colour = np.repeat(level, 3) * [0.4, 0.5, 0.45, 0.2, 0.3, 0.25]
        files.append(file_of(tmp_path, Pose(40.0, 0.0, 0.0, 30.0 * number), plane(colour), name=f"{number}.h5"))
    ball, patch = made(ObjectShape, {"kind": "sphere", "radius_mm": 10.0}), made(LevelPatch, STILL)
    measure_patch(files, ball, SETUP, patch, 0.02, 0.014, output=tmp_path / "l.h5", provenance=store.Provenance("test"))
    found, captures = read_levels(tmp_path / "l.h5")
    assert captures == ["0", "1", "2"] and found.source == PATCH
    np.testing.assert_allclose(found.level, [[1.02, 0.98], [0.98, 1.02], [1.0, 1.0]], atol=2e-4)
    shaded = file_of(tmp_path, ABOVE, plane([0.2, 0.25, 0.22, 0.1, 0.15, 0.12]), name="shaded.h5")
    with pytest.raises(InputError, match=r"0\.51 times what it does") as caught:
        measure_patch([*files, shaded], ball, SETUP, patch, 0.02, 0.014, output=tmp_path / "n.h5",
                      provenance=store.Provenance("test"))  # fmt: skip
    assert re.search(r"shaded\.h5", str(caught.value)) and not (tmp_path / "n.h5").exists()
