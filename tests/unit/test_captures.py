"""Tables of photographs: round trip, every fault with its place, nothing but InputError for any bytes."""

import csv
import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made

from irodori.config.capture_table import (
    COLUMNS,
    FILTERS,
    ROLES,
    Pose,
    Shot,
    check_unchanged,
    expand_poses,
    placement_of,
    read_captures,
    shot_path,
    write_captures,
)
from irodori.config.models import PoseGroup
from irodori.core.atomic_files import file_sha256
from irodori.core.errors import InputError
from irodori.geometry.rig_frame import to_light

HEADER = ",".join(COLUMNS)
GOOD = "a.dng,object,45,20,0,0,out,0.02"

_FILE = st.text(st.characters(min_codepoint=32, exclude_categories=("Cs", "Cc")), min_size=1, max_size=20)
_TENTHS = st.integers(-3600, 3600).map(lambda tenths: tenths / 10)
_ANY = {
    # Paths that leave the folder are refused.
    "file": _FILE.filter(lambda text: text.strip() and text[0] != "/" and ".." not in text.split("/")),
    "pose": st.builds(
        Pose, _TENTHS, _TENTHS, _TENTHS, _TENTHS, st.integers(-1799, 1799).map(lambda tenths: tenths / 10)
    ),
    "filter": st.sampled_from(FILTERS),
    "exposure_s": st.floats(1e-6, 3600),
    "light_level": st.floats(0.1, 10.0),
}
_NAME = st.from_regex("[a-z0-9-]+", fullmatch=True)
_SHOT = st.one_of(
    st.builds(Shot, role=st.sampled_from([role for role in ROLES if role != "room-chart"]), **_ANY),
    st.builds(Shot, role=st.sampled_from(["chart", "room-chart"]), chart=_NAME, **_ANY),
)


def write(folder: Path, *lines: str) -> Path:
    path = folder / "captures.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def refused(folder: Path, *lines: str) -> InputError:
    with pytest.raises(InputError) as caught:
        read_captures(write(folder, *lines))
    return caught.value


def test_pose_name_is_in_tenths_of_a_degree():
    assert Pose(45.0, 20.0).name == "l0450-c0200-t000-r0000"
    assert Pose(125.0, 140.0, 45.0, 359.5).name == "l1250-c1400-t450-r3595"
    assert Pose(0.1 + 0.2, 0.0).name == Pose(0.3, 0.0).name
    assert Pose(45.0, 0.0, light_azimuth_deg=-90.0).name == "l0450-c0000-t000-r0000-a2700"
    assert Pose(45.0, 0.0, light_azimuth_deg=360.0).name == Pose(45.0, 0.0).name


def test_a_shot_of_an_object_belongs_to_its_pose_and_any_other_to_its_role():
    pose = Pose(45.0, 0.0)
    assert Shot("a.dng", "object", pose, "out", 0.02).capture == pose.name
    assert Shot("a.dng", "chart", pose, "out", 0.02).capture == "chart"
    assert Shot("a.dng", "room-chart", pose, "out", 0.02, chart="desk").capture == "room-chart-desk"


def test_expand_poses_multiplies_within_a_group_and_keeps_the_order():
    groups = [{"light_deg": [45.0, 60.0], "camera_deg": [0.0, 10.0]},
              {"light_deg": [35.0], "camera_deg": [5.0], "tilt_deg": [20.0], "turn_deg": [0.0, 90.0]},
              ]  # fmt: skip
    assert expand_poses(made(Sequence[PoseGroup], groups)) == [
        Pose(45.0, 0.0), Pose(45.0, 10.0), Pose(60.0, 0.0), Pose(60.0, 10.0),
        Pose(35.0, 5.0, 20.0, 0.0), Pose(35.0, 5.0, 20.0, 90.0),
    ]  # fmt: skip


@pytest.mark.parametrize("second", [45.0, 45.01])
def test_expand_poses_refuses_a_pose_twice(second):
    groups = [{"light_deg": [45.0], "camera_deg": [0.0]}, {"light_deg": [second], "camera_deg": [0.0]}]
    with pytest.raises(ValueError, match="l0450-c0000-t000-r0000 twice"):
        expand_poses(made(Sequence[PoseGroup], groups))


@settings(deadline=None)
@given(shots=st.lists(_SHOT, min_size=1, max_size=8))
def test_what_is_written_is_read_back(tmp_path_factory, shots):
    if len({os.path.normpath(shot.file) for shot in shots}) < len(shots):
        return
    if len({(shot.capture, shot.filter, shot.exposure_s) for shot in shots}) < len(shots):
        return
    path = tmp_path_factory.mktemp("round") / "captures.csv"
    write_captures(path, shots)
    assert read_captures(path) == shots


@pytest.mark.stability(stage="fuzzing", case="captures.csv")
@settings(deadline=None, max_examples=300)
@given(content=st.binary(max_size=300) | st.binary(max_size=200).map(lambda b: f"{HEADER}\n{GOOD}\n".encode() + b))
def test_any_bytes_give_shots_or_an_input_error(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("fuzz") / "captures.csv"
    path.write_bytes(content)
    try:
        shots = read_captures(path)
    except InputError as error:
        assert error.file == str(path)
    else:
        assert shots and all(isinstance(shot, Shot) for shot in shots)


@pytest.mark.stability(stage="fuzzing", case="captures.csv")
@settings(deadline=None, max_examples=300)
@given(cells=st.lists(st.text(max_size=12) | st.sampled_from(["object", "chart", "in", "1e308", "-0"]),
                      min_size=8, max_size=8))  # fmt: skip
def test_any_cells_give_shots_or_an_input_error(tmp_path_factory, cells):
    path = tmp_path_factory.mktemp("fuzz") / "captures.csv"
    path.write_text(f"{HEADER}\n{','.join(cells)}\n", encoding="utf-8", errors="replace", newline="")
    try:
        read_captures(path, path.parent)
    except InputError as error:
        assert error.found and error.accepted


@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_what_spreadsheets_write_is_read(tmp_path, bom, end):
    path = tmp_path / "captures.csv"
    path.write_bytes(bom + (end.join([HEADER, GOOD, "", ",,,,,,,", ""])).encode())
    assert read_captures(path) == [Shot("a.dng", "object", Pose(45.0, 20.0), "out", 0.02)]


def test_optional_columns_and_another_order(tmp_path):
    path = write(tmp_path, "exposure_s, filter ,role,file,camera_deg,light_deg,sha256",
                 "0.02, out , chart ,a b.dng,0,45,00ff")  # fmt: skip
    assert read_captures(path) == [Shot("a b.dng", "chart", Pose(45.0, 0.0), "out", 0.02)]


def test_a_lamp_beside_the_rigs_plane_has_an_azimuth(tmp_path):
    path = write(tmp_path, f"{HEADER},light_azimuth_deg", f"{GOOD},-30.5", GOOD.replace("a.dng", "b.dng") + ",")
    assert [shot.pose.light_azimuth_deg for shot in read_captures(path)] == [-30.5, 0.0]


_PLACE = st.tuples(*[st.floats(-2000.0, 2000.0)] * 3).filter(lambda xyz: math.hypot(*xyz) > 1.0)


@given(place=_PLACE)
def test_a_lamps_place_gives_the_direction_to_it(tmp_path_factory, place):
    cells = ",".join(map(repr, place))
    lines = ("file,role,light_x,light_y,light_z,camera_deg,filter,exposure_s", f"a.dng,object,{cells},0,out,0.02")
    (shot,) = read_captures(write(tmp_path_factory.mktemp("place"), *lines))
    np.testing.assert_allclose(to_light(shot.pose), np.array(place) / math.hypot(*place), atol=1e-9)


@pytest.mark.parametrize(
    ("header", "cells", "field", "found"),
    [
        ("light_x,light_y,light_z,light_deg", "1,0,1,45", "line 1, light_deg", "light_deg beside light_x"),
        ("light_x,light_y", "1,0", "line 1, light_z", "no such column"),
        ("light_azimuth_deg", "0", "line 1, light_deg", "no such column"),
        ("light_x,light_y,light_z", "0,0,0", "line 2, light_x, light_y, light_z", "0, 0, 0"),
        ("light_x,light_y,light_z", "1,high,0", "line 2, light_y", "'high'"),
        ("light_deg,light_azimuth_deg", "45,400", "line 2, light_azimuth_deg", "400"),
    ],
)
def test_a_light_that_is_said_twice_by_half_or_nowhere_is_refused(tmp_path, header, cells, field, found):
    error = refused(tmp_path, f"file,role,camera_deg,filter,exposure_s,{header}", f"a.dng,object,0,out,0.02,{cells}")
    assert error.field == field and found in error.found


@pytest.mark.parametrize("level", ["105", "0.05", "0", "-1", "bright"])
def test_a_level_of_a_lamp_that_is_no_ratio_near_one_is_refused(tmp_path, level):
    header, line = "file,role,light_deg,camera_deg,filter,exposure_s,light_level", f"a.dng,object,45,0,out,0.02,{level}"
    error = refused(tmp_path, header, line)
    assert error.field == "line 2, light_level" and level in error.found


def test_bracket_and_averaged_frames_are_accepted(tmp_path):
    rows = ["a.dng,object,45,0,0,0,out,0.02", "b.dng,object,45,0,0,0,out,0.2",
            "c.dng,object,45,0,0,0,in,0.02",
            "d.dng,dark,0,0,0,0,out,0.2", "e.dng,dark,0,0,0,0,out,0.2", "f.dng,white,45,0,0,0,in,0.1",
            "g.dng,white,45,0,0,0,in,0.1"]  # fmt: skip
    assert len(read_captures(write(tmp_path, HEADER, *rows))) == len(rows)


@pytest.mark.parametrize(
    ("row", "column", "found"),
    [
        ("a.dng,objekt,45,20,0,0,out,0.02", "role", "'objekt'"),
        ("a.dng,room-chart,0,0,0,0,out,0.02", "role", "without a name"),
        ("a.dng,room-chart-Desk,0,0,0,0,out,0.02", "role", "'room-chart-Desk'"),
        ("a.dng,object,45,20,0,0,off,0.02", "filter", "'off'"),
        ("a.dng,object,high,20,0,0,out,0.02", "light_deg", "'high'"),
        ("a.dng,object,,20,0,0,out,0.02", "light_deg", "''"),
        ("a.dng,object,45,nan,0,0,out,0.02", "camera_deg", "'nan'"),
        ("a.dng,object,45,20,inf,0,out,0.02", "tilt_deg", "'inf'"),
        ("a.dng,object,45,20,0,1e9,out,0.02", "turn_deg", "1e9"),
        ("a.dng,object,45,20,0,0,out,0", "exposure_s", "0"),
        ("a.dng,object,45,20,0,0,out,-1", "exposure_s", "-1"),
        ("a.dng,object,45,20,0,0,out,1/60", "exposure_s", "'1/60'"),
        (" ,object,45,20,0,0,out,0.02", "file", "' '"),
        ("b.dng,object,45,20,0,0,out,0.02", "exposure_s", "of line 2"),
        ("./first.dng,object,45,20,0,0,out,0.5", "file", "again, as in line 2"),
        ("b.dng,object,45.01,20,0,0,in,0.02", "light_deg", "less than 0.1 degrees"),
    ],
)
def test_a_fault_in_a_row_names_line_and_column(tmp_path, row, column, found):
    error = refused(tmp_path, HEADER, GOOD.replace("a.dng", "first.dng"), row)
    assert error.field == f"line 3, {column}"
    assert found in error.found


def test_suggestions_for_a_role_and_a_column(tmp_path):
    assert "did you mean 'object'?" in refused(tmp_path, HEADER, GOOD.replace("object", "objekt")).accepted
    error = refused(tmp_path, HEADER.replace("exposure_s", "exposure"), GOOD)
    assert error.field == "line 1, exposure" and "did you mean 'exposure_s'?" in error.accepted


@pytest.mark.parametrize(
    ("lines", "field", "found"),
    [
        ([""], "", "an empty file"),
        ([HEADER], "", "without photographs"),
        ([HEADER.replace("camera_deg,", ""), GOOD], "line 1, camera_deg", "no such column"),
        ([HEADER + ",file", GOOD + ",b"], "line 1, file", "twice"),
        ([HEADER, "a.dng,object,45"], "line 2", "3 cells"),
        ([HEADER, GOOD + ",x"], "line 2", "9 cells"),
        ([HEADER, '"a.dng,object'], "line 2", "unexpected end"),
    ],
)
def test_a_fault_of_the_table(tmp_path, lines, field, found):
    error = refused(tmp_path, *lines)
    assert error.field == field
    assert found in error.found


SAVED = {
    "semicolons": (";", "utf-8"),
    "semicolons with a decimal comma": ("; ", "utf-8"),
    "tabs": ("\t", "utf-8"),
    "Excel's Unicode text": ("\t", "utf-16"),
    "UTF-16, big end first": (",", "utf-16-be"),
}


@pytest.mark.parametrize("saved", SAVED)
@pytest.mark.parametrize("behind", ["", ",,,"])
def test_a_table_is_read_as_a_spreadsheet_saves_it(tmp_path, saved, behind):
    separator, encoding = SAVED[saved]
    text = f"{HEADER}{behind}\n壺,object,45.5,20,0,0,out,0.02{behind}\n".replace(",", separator.strip(" ") or separator)
    if "decimal comma" in saved:
        text = text.replace("45.5", "45,5").replace("0.02", "0,02")
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    path = tmp_path / "captures.csv"
    path.write_bytes((mark + text).encode(encoding))
    assert read_captures(path) == [Shot("壺", "object", Pose(45.5, 20.0), "out", 0.02)]


@pytest.mark.parametrize(
    ("name", "encoding", "said"),
    [("朱の壺.nef", "cp932", "Shift-JIS"), ("Blätter.nef", "cp1252", "one byte a letter")],
)
def test_another_encoding_is_named_with_the_way_to_save_the_table(tmp_path, name, encoding, said):
    path = tmp_path / "captures.csv"
    path.write_bytes(f"{HEADER}\n{GOOD.replace('a.dng', name)}\n".encode(encoding))
    with pytest.raises(InputError, match=rf"captures\.csv: byte \d+: found .*({said}).*CSV UTF-8"):
        read_captures(path)


def test_what_is_no_text_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_captures(tmp_path / "absent.csv")
    with pytest.raises(InputError, match=r"accepted: a CSV .* that can be read"):
        read_captures(tmp_path)
    (tmp_path / "captures.csv").write_bytes(b"\x80\0\0\0" * 40)
    with pytest.raises(InputError, match="no text"):
        read_captures(tmp_path / "captures.csv")


def test_a_cell_behind_the_last_column_is_refused_and_an_empty_one_is_not(tmp_path):
    assert read_captures(write(tmp_path, f"{HEADER},,", f"{GOOD},,", f"{GOOD.replace('a.', 'b.')}"[:-4] + "0.03,,"))
    assert "line 2" in str(refused(tmp_path, f"{HEADER},,", f"{GOOD},,checked by K."))


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"\xff\xd8\xff\xe1" + bytes(40), "JPEG"),
        (b"\x89PNG\r\n\x1a\n" + bytes(40), "PNG"),
        (bytes(4) + b"ftypheic" + bytes(40), "HEIC"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
    ],
)
def test_a_picture_in_place_of_a_raw_file_is_named(tmp_path, content, kind):
    (tmp_path / "a.dng").write_bytes(content)
    table = write(tmp_path, HEADER, GOOD)
    with pytest.raises(InputError, match=rf"line 2, file: found an? .*{kind}.*a RAW file"):
        read_captures(table, tmp_path)


def test_with_a_folder_each_file_must_hold_something(tmp_path):
    path = write(tmp_path, HEADER, GOOD)
    with pytest.raises(InputError, match=r"line 2, file: found no such file: .*a\.dng"):
        read_captures(path, tmp_path)
    (tmp_path / "a.dng").touch()
    with pytest.raises(InputError, match=r"line 2, file: found an empty file: .*a\.dng"):
        read_captures(path, tmp_path)
    (tmp_path / "a.dng").write_bytes(b"raw")
    assert len(read_captures(path, tmp_path)) == 1


def test_shot_path_is_beside_the_table_unless_a_folder_is_given():
    shot = Shot("a.dng", "chart", Pose(45.0, 0.0), "out", 0.02)
    assert shot_path(shot, "x/captures.csv") == Path("x/a.dng")
    assert shot_path(shot, "x/captures.csv", "raw") == Path("raw/a.dng")


def test_digest_sensitivity_and_aperture_come_back(tmp_path):
    shots = [
        Shot("a.dng", "chart", Pose(45.0, 0.0), "out", 0.02),
        Shot("b.dng", "chart", Pose(45.0, 0.0), "in", 0.02, 100.0, 5.6),
    ]
    path = tmp_path / "captures.csv"
    write_captures(path, shots, {"a.dng": "00ff", "b.dng": "11ff"})
    first, second = csv.DictReader(path.read_text().splitlines())
    assert (first["file"], first["iso"], first["f_number"], first["sha256"]) == ("a.dng", "", "", "00ff")
    assert (second["file"], second["iso"], second["f_number"], second["sha256"]) == ("b.dng", "100.0", "5.6", "11ff")
    assert read_captures(path) == shots


def test_a_photograph_whose_bytes_are_not_those_of_the_tables_hash_is_refused_by_name(tmp_path):
    shots = [Shot(f"{name}.dng", "chart", Pose(45.0, 0.0), state, 0.02) for name, state in (("a", "out"), ("b", "in"))]
    for shot in shots:
        (tmp_path / shot.file).write_bytes(bytes(range(200)))
    path = tmp_path / "captures.csv"
    digest = file_sha256(tmp_path / "a.dng")
    write_captures(path, shots, {"a.dng": digest.upper(), "b.dng": ""})
    check_unchanged(path, tmp_path, shots)
    # The second has no hash that could vouch for it.
    (tmp_path / "b.dng").write_bytes(b"other")
    check_unchanged(path, tmp_path, shots)
    content = bytearray((tmp_path / "a.dng").read_bytes())
    content[77] ^= 4
    (tmp_path / "a.dng").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.dng: .*captures\.csv.*as it was taken"):
        check_unchanged(path, tmp_path, shots)
    check_unchanged(path, tmp_path, shots[1:])


@pytest.mark.parametrize("cells", ["0,", "-100,", "nan,", "auto,", ",-2"])
def test_a_sensitivity_or_aperture_that_is_no_positive_number_is_refused(tmp_path, cells):
    path = write(tmp_path, HEADER + ",iso,f_number", f"{GOOD},{cells}")
    with pytest.raises(InputError, match=r"line 2, (iso|f_number)"):
        read_captures(path)


def test_a_write_that_fails_leaves_the_old_table_and_nothing_else(tmp_path):
    path = write(tmp_path, HEADER, GOOD)
    before = path.read_bytes()
    with pytest.raises(KeyError):
        write_captures(path, [Shot("b.dng", "chart", Pose(45.0, 0.0), "out", 0.02)], {})
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["captures.csv"]


TAKEN = "a.dng,object,45,0,0,0,out,0.02,2026-05-04T10:15:30.250+09:00,2026-05-04T10:15:28,EOS 40D 0123,12.5,a veil\n"


def test_how_a_photograph_was_taken_comes_back_and_makes_it_no_other_photograph(tmp_path):
    path = tmp_path / "captures.csv"
    path.write_text(HEADER + ",taken_at,camera_time,camera,camera_read_deg,accepted\n" + TAKEN)
    [shot] = read_captures(path)
    assert shot == Shot("a.dng", "object", Pose(45.0, 0.0), "out", 0.02)
    assert shot.taken.at == "2026-05-04T10:15:30.250+09:00" and shot.taken.camera_time == "2026-05-04T10:15:28"
    assert (shot.taken.camera, shot.taken.read_deg, shot.taken.accepted) == (
        "EOS 40D 0123",
        {"camera_deg": 12.5},
        "a veil",
    )
    write_captures(path, [shot])
    assert read_captures(path)[0].taken == shot.taken


@pytest.mark.parametrize(
    ("column", "cell"), [("taken_at", "yesterday"), ("camera_time", "10:15"), ("turn_read_deg", "far")]
)
def test_a_time_or_a_place_that_is_none_is_refused_by_its_column(tmp_path, column, cell):
    path = tmp_path / "captures.csv"
    path.write_text(f"{HEADER},{column}\na.dng,object,45,0,0,0,out,0.02,{cell}\n")
    with pytest.raises(InputError, match=f"line 2, {column}: found '{cell}'"):
        read_captures(path)


def test_the_column_placement_says_how_an_object_lay_and_survives_writing(tmp_path):
    table = tmp_path / "captures.csv"
    lines = ["a.dng,object,45,10,out,0.02,", "b.dng,object,45,10,out,0.02,2", "c.dng,white,45,0,out,0.02,"]
    table.write_text("file,role,light_deg,camera_deg,filter,exposure_s,placement\n" + "\n".join(lines))
    shots = read_captures(table)
    assert [shot.pose.placement for shot in shots] == [1, 2, 1]
    assert [placement_of(shot.capture) for shot in shots[:2]] == [1, 2]
    # The same angles in another placement are another capture.
    assert shots[1].capture == shots[0].capture + "-p2"
    write_captures(table, shots)
    assert read_captures(table) == shots
    for line, said in (("d.dng,object,45,10,out,0.02,0", "a whole number"), ("d.dng,white,45,0,out,0.02,2", "white")):
        table.write_text("file,role,light_deg,camera_deg,filter,exposure_s,placement\n" + line)
        with pytest.raises(InputError, match=rf"line 2, placement.*{said}"):
            read_captures(table)
