"""The first look at a set of RAW files: hashes, sizes, and settings against the table."""

import dataclasses
import hashlib

import numpy as np
import pytest
from dng_files import write_any_dng
from raw_studio import SIZE, Studio, dng

from irodori.config.capture_table import ROLES, Pose, Shot, read_captures, write_captures
from irodori.core.errors import InputError
from irodori.ingest.first_look import check_captures
from irodori.ingest.mosaic import decode


def test_check_captures_notes_the_hash_of_every_file(tmp_path):
    studio = Studio(tmp_path, seed=18)
    studio.references()
    table, output = studio.table(), tmp_path / "checked.csv"
    check_captures(table, tmp_path, output, ROLES)
    assert read_captures(output, tmp_path) == read_captures(table, tmp_path)
    lines = output.read_text().splitlines()
    assert lines[0].split(",")[-1] == "sha256"
    for line in lines[1:]:
        file, *_, digest = line.split(",")
        assert digest == hashlib.sha256((tmp_path / file).read_bytes()).hexdigest()


@pytest.mark.parametrize("fault", ["exposure", "size", "truncated", "missing"])
def test_check_captures_refuses(tmp_path, fault):
    studio = Studio(tmp_path, seed=19)
    studio.references()
    culprit = studio.shots[-1].file
    if fault == "exposure":
        studio.shots[-1] = dataclasses.replace(studio.shots[-1], exposure_s=studio.shots[-1].exposure_s * 1.2)
    elif fault == "size":
        dng(tmp_path / culprit, np.full((64, 64), 700, np.uint16), exposure_s=0.05)
    elif fault == "truncated":
        content = (tmp_path / culprit).read_bytes()
        (tmp_path / culprit).write_bytes(content[: len(content) // 2])
    else:
        (tmp_path / culprit).unlink()
    table, output = studio.table(), tmp_path / "checked.csv"
    with pytest.raises(InputError, match=culprit):
        check_captures(table, tmp_path, output, ROLES)
    assert not output.exists()


def test_check_captures_holds_files_to_the_stated_size(tmp_path):
    studio = Studio(tmp_path, seed=25)
    studio.references()
    table = studio.table()
    check_captures(table, tmp_path, tmp_path / "a.csv", ROLES, (SIZE[1], SIZE[0]))
    with pytest.raises(InputError, match="9000 x 6000 pixels, as its set states"):
        check_captures(table, tmp_path, tmp_path / "b.csv", ROLES, (9000, 6000))


def test_check_captures_keeps_the_shots_of_its_own_set(tmp_path):
    studio = Studio(tmp_path, seed=26)
    studio.references()
    studio.shoot("object", np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.3))
    check_captures(studio.table(), tmp_path, tmp_path / "object.csv", ["object"])
    assert [shot.role for shot in read_captures(tmp_path / "object.csv")] == ["object"]


def own(path, level=1500, **settings):
    """A file of one setting."""
    return write_any_dng(path, np.full((64, 96), level, np.uint16), **settings)


def set_of(tmp_path, files, table=()):
    """A set whose files have settings, and its table others."""
    shots = []
    for number, settings in enumerate(files):
        own(tmp_path / f"{number}.dng", 1500 + number, **settings)
        stated = dict(table[number]) if number < len(table) else {}
        shots.append(Shot(f"{number}.dng", "white", Pose(45.0, 0.0), "out", 0.02, **stated))
    write_captures(tmp_path / "captures.csv", shots)
    check_captures(tmp_path / "captures.csv", tmp_path, tmp_path / "checked.csv", ROLES)
    return [(s.iso, s.f_number) for s in read_captures(tmp_path / "checked.csv")]


def test_the_files_own_settings_fill_a_silent_table(tmp_path):
    found = set_of(tmp_path, [{"iso": 100, "f_number": 8.0}, {"iso": 400, "f_number": 5.6}])
    assert np.allclose(found, [(100, 8.0), (400, 5.6)], rtol=1e-3)


def test_the_table_counts_where_the_file_rounds(tmp_path):
    found = set_of(tmp_path, [{"iso": 635, "f_number": 5.66}], [{"iso": 640.0, "f_number": 5.6}])
    assert found == [(640.0, 5.6)]


@pytest.mark.stability(stage="ingest", case="file contradicts the table")
@pytest.mark.parametrize(
    ("column", "own_value", "stated"), [("iso", 100, 126.0), ("iso", 400, 320.0), ("f_number", 8.0, 9.0)]
)
def test_a_third_of_a_stop_is_a_difference(tmp_path, column, own_value, stated):
    with pytest.raises(InputError, match=rf"captures\.csv: {column}.*0\.dng"):
        set_of(tmp_path, [{column: own_value}], [{column: stated}])


def test_settings_known_in_part_must_agree(tmp_path):
    agreed = set_of(tmp_path, [{"iso": 200, "f_number": 8.0}, {"iso": 200}, {}])
    assert np.allclose(agreed, [(200, 8.0)] * 3, rtol=1e-3)
    with pytest.raises(InputError, match=r"iso.*2\.dng"):
        set_of(tmp_path, [{"iso": 200}, {"iso": 400}, {}])


def test_the_lens_of_the_files_is_that_of_the_definition(tmp_path):
    shots = [Shot(f"{number}.dng", "white", Pose(45.0, 0.0), "out", 0.02) for number in range(3)]
    write_captures(tmp_path / "captures.csv", shots)
    # Makers round; a file without a focal length says nothing.
    for shot, (number, focal_mm) in zip(shots, enumerate((50.0, 47.0, 0.0)), strict=True):
        own(tmp_path / shot.file, 1500 + number, focal_mm=focal_mm)
    asked = (tmp_path / "captures.csv", tmp_path, tmp_path / "checked.csv", ROLES, None)
    check_captures(*asked, (50.0, 900.0))
    with pytest.raises(InputError, match=r"0\.dng: focal length: found taken at 50 mm, .*is 85: is it the right lens"):
        check_captures(*asked, (85.0, 900.0))


def test_clipping_below_the_white_level_is_said_once_for_a_set(tmp_path, caplog):
    """The tag states more than the sensor reaches; highlights are masked all the same."""
    studio = Studio(tmp_path, seed=34)
    studio.references()
    truth = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.4)
    truth[20:30, 40:60] = 9.0
    for angle in (20.0, 40.0):
        for state, exposure_s in (("out", 0.02), ("in", 0.05)):
            studio.shoot("object", truth, state, exposure_s, angle)
    for shot in studio.shots:
        taken = decode(tmp_path / shot.file)
        dng(tmp_path / shot.file, taken.values, white=20_000, exposure_s=shot.exposure_s)
    check_captures(studio.table(), tmp_path, tmp_path / "checked.csv", ROLES)
    (said,) = [one.getMessage() for one in caplog.records if "white level" in one.getMessage()]
    assert "have exactly 16383" in said and "the file states 20000: they are taken as saturated" in said
    response, valid, *_ = studio.ingest(Pose(40.0, 0.0).name)
    expected = np.ones_like(valid)
    expected[20:30, 40:60] = 0
    assert np.array_equal(valid, expected)
    # The level of the other pixels is that of the white reference, none of which is saturated.
    assert np.allclose(response[valid == 1].mean(axis=0), 0.4, rtol=0.01)


@pytest.mark.parametrize("role", ["dark", "white", "chart", "object"])
def test_a_mosaic_of_another_pattern_than_the_others_is_refused(tmp_path, role):
    studio = Studio(tmp_path, seed=35)
    studio.references()
    truth = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.4)
    for subject in ("chart", "object"):
        for state, exposure_s in (("out", 0.02), ("in", 0.05)):
            studio.shoot(subject, truth * (0.5 if subject == "chart" else 1.0), state, exposure_s)
    culprit = [shot for shot in studio.shots if shot.role == role][-1]
    mosaic = decode(tmp_path / culprit.file).values
    (tmp_path / culprit.file).unlink()
    write_any_dng(tmp_path / culprit.file, mosaic, pattern="BGGR", exposure_s=culprit.exposure_s)
    table = studio.table()
    words = rf"{culprit.file}: mosaic: found a mosaic of BGGR, .* of RGGB: was it converted or cropped in another way"
    with pytest.raises(InputError, match=words):
        check_captures(table, tmp_path, tmp_path / "checked.csv", ROLES)
    # Nor does ingestion take it, in which sets meet.
    with pytest.raises(InputError, match=rf"{culprit.file}: mosaic: found BGGR; accepted: RGGB, as the camera's ref"):
        studio.ingest(Pose(40.0, 0.0).name)
