"""The lamp's level by a patch in the frame: recovered from the virtual rig's pictures; what cannot be is refused."""

import numpy as np
import pytest
from made import made
from test_near_light import PROVENANCE, ROOT, STRAIGHT, setup_of, small, superpixels, uniform

from irodori.config.capture_table import Pose
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import Camera, LevelPatch, Object, ObjectShape, Rig
from irodori.config.parts import PhotographedObject
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.shapes.shape import Shape
from irodori.material.photograph_levels import KNOWN_PATCH, PATCH, read_levels
from irodori.rectification.level_patch import PatchReading, levels_by_patch, measure_patch, read_patch
from irodori.simulation.virtual_rig.samples import Sample
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.simulation.virtual_rig.subjects import object_mosaic, white_mosaic
from irodori.spectra.published import light as spectrum

BALL = {"kind": "sphere", "radius_mm": 20.0}
#: Beside the ball, towards the reader: neither hidden nor shaded where lamp and camera stand in the rig's plane.
BESIDE = {"centre_mm": [0.0, -36.0, -20.0], "side_mm": 12.0}
TURNS = [Pose(45.0, 20.0, 0.0, float(turn)) for turn in (0, 90, 180, 270)]
STANDING = BESIDE | {"moves_with_table": False}


@pytest.fixture(scope="module")
def definitions():
    """The repository's configuration."""
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()


def pictures(tmp_path, definitions, patch, poses, level, *, distance_mm=None, grey=0.5, seen=None):
    """Linear files of a ball and a patch: the virtual rig's pictures under a lamp of these levels over its white's."""
    camera, rig = small(definitions, distance_mm)
    definition, weights = (
        uniform(definitions, BALL),
        band_weights(made(Camera, camera), spectrum(rig["light"]["spectrum"])),
    )
    weights, camera_, rig_ = weights[:3], made(Camera, camera), made(Rig, rig)
    white = superpixels(white_mosaic(camera_, rig_, Pose(**camera["poses"]["white"]), STRAIGHT, weights))
    place = Pose(**camera["poses"]["white"])
    flat = white / (camera["white"]["reflectance_factor"] * np.cos(np.radians(place.light_deg - place.tilt_deg)))
    sample, files = Sample.from_definition(made(Object | PhotographedObject, definition)), []
    real = made(LevelPatch, patch | {"reflectance_factor": grey})
    for number, (pose, factor) in enumerate(zip(poses, level, strict=True)):
        picture = object_mosaic(sample, camera_, rig_, pose, STRAIGHT, weights, patch=real)
        response = factor * superpixels(picture) / flat
        if seen is not None:
            response = seen(number, response)
        files.append(tmp_path / f"{number:02d}-{pose.name}.h5")
        with store.create(files[-1], PROVENANCE) as out:
            kept = {"units": "1", "dims": "row,column,band", "quantity": "response", "compression": "none"}
            out.write("response", response.astype("f4"), **kept)
            clipped = (response > 3.0).any(axis=2)
            for name, mask in (("valid", ~clipped), ("clipped", clipped)):
                out.write(name, mask.astype(np.uint8), units="1", dims="row,column", quantity=name)
            out.attribute("sample_px", 2)
            out.attribute("mosaic", "")
            out.attribute("pose_deg", list(pose.angles_deg))
            out.attribute("filters", ["out"])
    return files, setup_of(camera, rig, white=distance_mm is not None)


def measured(tmp_path, definitions, patch, poses, level, **picture):
    files, setup = pictures(tmp_path, definitions, patch, poses, level, **picture)
    output = tmp_path / "levels.h5"
    given = made(LevelPatch, patch)
    measure_patch(files, made(ObjectShape, BALL), setup, given, 0.01, 0.014, output=output, provenance=PROVENANCE)
    levels, captures = read_levels(output)
    assert captures == [file.stem for file in files]
    return levels


@pytest.mark.parametrize("distance_mm", [None, 600.0], ids=["far", "near"])
def test_photographs_in_which_the_patch_keeps_its_directions_tell_the_lamp_exactly(tmp_path, definitions, distance_mm):
    true = np.array([1.03, 0.98, 0.995, 1.011])
    found = measured(tmp_path, definitions, STANDING, TURNS, true, distance_mm=distance_mm)
    assert found.source == PATCH and found.common_error == 0.014
    assert found.level[:, 0] == pytest.approx(true / true.mean(), abs=3e-4)
    assert (found.error < 5e-4).all()


def test_a_patch_of_known_reflectance_tells_what_changed_since_the_white_as_well(tmp_path, definitions):
    true, known = 0.97 * np.array([1.01, 0.99, 1.0, 1.005]), {"reflectance_factor": 0.5, "reflectance_error": 0.002}
    found = measured(tmp_path, definitions, STANDING | known | {"departure": 0.002}, TURNS, true)
    assert found.source == KNOWN_PATCH
    # What white and object share is known as well as reflectance and law: 0.28 %, and not 1.4 %.
    assert found.common_error == pytest.approx(np.hypot(0.002, 0.002), rel=0.05)
    assert abs(found.level.mean() / true.mean() - 1.0) < 0.003
    assert found.level[:, 0] / found.level.mean() == pytest.approx(true / true.mean(), abs=3e-4)


def test_a_matt_patch_on_the_turning_and_tilting_table_is_followed(tmp_path, definitions):
    poses = [
        Pose(45.0, 10.0, 0.0, 0.0),
        Pose(45.0, 10.0, 20.0, 0.0),
        Pose(60.0, 0.0, 0.0, 20.0),
        Pose(40.0, 25.0, 10.0, -15.0),
    ]
    true = np.array([1.01, 0.99, 1.02, 0.98])
    found = measured(tmp_path, definitions, BESIDE | {"departure": 1e-4}, poses, true)
    assert found.level[:, 0] == pytest.approx(true / true.mean(), abs=1e-3)


def readings(response, angles_deg):
    return [
        PatchReading(np.full(3, r), np.full(3, 1e-4), np.radians(a)) for r, a in zip(response, angles_deg, strict=True)
    ]


def test_errors_of_levels_are_as_large_as_they_are_stated():
    """Of lamps that drift and patches that depart from Lambert's law by what is stated, over 400 sittings."""
    rng, poses = np.random.default_rng(5), [(45.0, 0.0, 45.0)] * 4 + [(60.0, 10.0, 70.0)] * 4 + [(35.0, 60.0, 95.0)] * 2
    patch = made(LevelPatch, BESIDE | {"reflectance_factor": 0.4, "reflectance_error": 0.005, "departure": 0.008})
    own, common, apart = [], [], []
    for _ in range(400):
        true = np.exp(0.01 * rng.normal(size=10) + 0.014 * rng.normal())
        law = np.repeat(np.exp(0.008 * rng.normal(size=3)), [4, 4, 2]) * np.exp(0.005 * rng.normal())
        found = levels_by_patch(readings(0.4 * true * law, poses), patch, 0.01, 0.014)
        off = np.log(found.level[:, 0] / true)
        own.append((off - off.mean()) / found.error[:, 0])
        common.append(off.mean() / found.common_error)
        apart.append(off[:4].std())
    for z, tolerance in ((np.array(own), 0.06), (np.array(common), 0.12)):
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=tolerance)
        assert np.mean(np.abs(z) < 1.0) == pytest.approx(0.68, abs=0.08)
    # Where the patch keeps its directions, the law has no say.
    assert np.mean(apart) < 2e-4


def test_a_patch_that_departs_from_the_law_at_will_says_nothing_between_other_directions():
    patch = made(LevelPatch, BESIDE | {"departure": 1.0})
    angles = [(20.0, 0.0, 20.0), (40.0, 10.0, 50.0), (60.0, 30.0, 90.0)]
    found = levels_by_patch(readings([0.5, 0.4, 0.6], angles), patch, 0.01, 0.014)
    assert np.abs(found.level - 1.0).max() < 1e-3 and (found.error > 0.007).all()


def test_a_lamp_that_varies_far_more_than_is_stated_is_believed_to():
    """Levels from 0.75 to 1.3, each in directions of its own, by a patch that departs from the law by 1 %."""
    true, rng = np.array([1.3, 0.8, 1.1, 0.75, 1.05]), np.random.default_rng(2)
    angles = [(20.0, 0.0, 20.0), (40.0, 10.0, 50.0), (60.0, 30.0, 90.0), (30.0, 60.0, 90.0), (5.0, 45.0, 50.0)]
    response = 0.5 * true * np.exp(0.01 * rng.normal(size=5))
    for stated in ({}, {"reflectance_factor": 0.5}):
        found = levels_by_patch(readings(response, angles), made(LevelPatch, BESIDE | stated), 0.01, 0.014)
        off = found.level[:, 0] / found.level.mean() / (true / true.mean()) - 1.0
        assert np.abs(off).max() < 0.03 and (found.error < 0.015).all()


def test_a_patch_of_another_reflectance_is_refused(tmp_path, definitions):
    with pytest.raises(InputError, match=r"reflectance factor of 0\.50 by the white reference"):
        measured(tmp_path, definitions, STANDING | {"reflectance_factor": 0.8}, TURNS, np.ones(4))


def shade(number, response):
    return response * (0.3 if number == 2 else 1.0)


def tint(number, response):
    return response * ([1.3, 1.0, 1.0] if number == 1 else [1.0, 1.0, 1.0])


def mottle(number, response):
    return response * (1.0 + 0.4 * (np.indices(response.shape[:2]).sum(axis=0) % 4 < 2))[..., None]


REFUSED = {
    "outside": (STANDING | {"centre_mm": [0.0, -400.0, -20.0]}, None, "outside the frame"),
    "hidden": (STANDING | {"centre_mm": [26.0, 0.0, -20.0], "side_mm": 2.0}, None, "hidden by the object"),
    "in the shadow": (STANDING | {"centre_mm": [-34.0, 0.0, -20.0], "side_mm": 5.0}, None, "shadow"),
    "covered once": (STANDING, shade, "0.30 times what it does"),
    "another thing": (STANDING, tint, "hue by 30%"),
    "no even patch": (STANDING, mottle, "varies by"),
    "bright": (STANDING, lambda number, response: 12.0 * response, "clips"),
    "dark": (STANDING, lambda number, response: 0.0 * response, "is black"),
}  # fmt: skip


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="rectify", case="a level patch that is not there, covered, clipped or in shadow")
@pytest.mark.parametrize("case", REFUSED)
def test_a_patch_that_tells_nothing_is_refused_with_the_reason(tmp_path, definitions, case):
    patch, seen, words = REFUSED[case]
    with pytest.raises(InputError, match=words) as caught:
        measured(tmp_path, definitions, patch, TURNS, np.ones(4), seen=seen)
    assert "level_patch" in str(caught.value)


def test_a_patch_edge_on_to_the_lamp_is_refused(tmp_path, definitions):
    poses = [Pose(45.0, 20.0, 0.0, 0.0), Pose(85.0, 20.0, 0.0, 0.0)]
    with pytest.raises(InputError, match="lit at 85 degrees"):
        measured(tmp_path, definitions, STANDING, poses, np.ones(2))


def test_hot_pixels_do_not_count(tmp_path, definitions):
    files, setup = pictures(tmp_path, definitions, STANDING, TURNS[:1], [1.0])
    shape, patch = Shape.from_definition(made(ObjectShape, BALL)), made(LevelPatch, STANDING)
    clean = read_patch(files[0], shape, setup, patch)
    with store.open_file(files[0]) as file:
        response, valid = file.read("response"), file.read("valid")
    row, column = (
        np.argwhere(np.abs(response[..., 1] - np.median(clean.response[1]) * np.cos(clean.angles[0])) < 0.01)
        .mean(axis=0)
        .astype(int)
    )
    response[row, column], valid[row, column] = 50.0, 0
    with store.create(files[0], PROVENANCE) as out:
        for name, values in (("response", response), ("valid", valid), ("clipped", 0 * valid)):
            out.write(name, values, units="1", dims="row,column,band"[: 10 + 5 * (values.ndim == 3)], quantity=name)
        out.attribute("sample_px", 2)
        out.attribute("mosaic", "")
        out.attribute("pose_deg", list(TURNS[0].angles_deg))
    spoiled = read_patch(files[0], shape, setup, patch)
    assert spoiled.response == pytest.approx(clean.response, rel=1e-3)
