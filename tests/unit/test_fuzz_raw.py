"""RAW files with damaged headers: decoded, or refused by name; never a crash, never a hang."""

import json
import os
import struct
import sys
from pathlib import Path

import numpy as np
import patience
import pytest
from depth import examples
from dng_files import write_any_dng
from raw_studio import DATA, ROOT, dng, random_mosaic

from irodori.ingest.dng_levels import black_level_repeats
from irodori.ingest.tiff_tags import read_tags


def fuzz(source: Path, folder: Path, header: int, count: int, seed: int = 0) -> dict:
    """Return the outcomes of decoding damaged copies in a process of its own."""
    command = [sys.executable, Path(__file__).with_name("raw_fuzzer.py"), source, folder, header, count, seed]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    run = patience.run([*map(str, command)], env=environment)
    assert run.returncode == 0, f"{folder}: {run.stderr[-2000:]}"
    return json.loads(run.stdout)


def check(found: dict) -> None:
    assert found.pop("slowest_s") < 30.0
    assert set(found) <= {"decoded", "refused"}, found
    assert found["refused"] > 0


@pytest.mark.stability(stage="fuzzing", case="RAW header bit-flipped")
@pytest.mark.stability(stage="fuzzing", case="RAW truncated")
@pytest.mark.parametrize("kind", ["virtual rig", "with an EXIF block"])
def test_a_dng_with_a_damaged_header_is_decoded_or_refused(tmp_path, kind):
    mosaic = random_mosaic(np.random.default_rng(0))
    path = tmp_path / "whole.dng"
    if kind == "virtual rig":
        dng(path, mosaic)
    else:
        write_any_dng(path, mosaic, iso=100, f_number=5.6, black=np.full((2, 2), 600))
    check(fuzz(path, tmp_path, 900, examples(400)))


@pytest.mark.stability(stage="fuzzing", case="RAW header bit-flipped")
@pytest.mark.parametrize(
    ("name", "header", "count"), [("dc120_chart.kdc", 4000, 40), ("powershot_s40_chart.crw", -4000, 8)]
)
def test_a_camera_s_file_with_a_damaged_header_is_decoded_or_refused(tmp_path, name, header, count):
    if not (DATA / name).is_file():
        pytest.skip(f"no real photograph at {DATA / name}")
    found = fuzz(DATA / name, tmp_path, header, examples(count))
    # A Kodak's data is decoded as far as it goes: LibRaw does not say where it ends.
    found["decoded"] = found.get("decoded", 0) + found.pop("cut and decoded", 0)
    found.setdefault("refused", 1)
    check(found)


def test_a_header_that_claims_a_thousand_million_values_costs_no_more_than_its_file(tmp_path):
    path = write_any_dng(tmp_path / "a.dng", random_mosaic(np.random.default_rng(0)), black=np.full((2, 2), 600))
    assert black_level_repeats(path) == [(2, 2)]
    content = bytearray(path.read_bytes())
    for entry in range(10, 10 + 12 * int.from_bytes(content[8:10], "little"), 12):
        if int.from_bytes(content[entry : entry + 2], "little") != 50713:
            content[entry + 4 : entry + 8] = (2**30).to_bytes(4, "little")
    path.write_bytes(content)
    assert black_level_repeats(path) == [(2, 2)]


@pytest.mark.parametrize("content", [b"", b"II*\0", b"II*\0\xff\xff\xff\xff", b"MM\0*\0\0\0\x08\xff\xff", b"text"])
def test_a_file_that_is_no_tiff_or_ends_at_once_states_no_repeat(tmp_path, content):
    (tmp_path / "a.dng").write_bytes(content)
    assert black_level_repeats(tmp_path / "a.dng") == []


def test_directories_that_point_at_each_other_end(tmp_path):
    # One directory without entries whose next one is itself.
    (tmp_path / "a.dng").write_bytes(b"II*\0" + (8).to_bytes(4, "little") + bytes(2) + (8).to_bytes(4, "little"))
    assert black_level_repeats(tmp_path / "a.dng") == []


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("kind", "content", "read"),
    [
        (2, b"Maker A\0", ("Maker A",)), (2, b"Mak\0", ("Mak",)), (2, b"M", ("M",)),
        (2, b"x" * 255 + b"\0", ("x" * 255,)),
        (2, b"x" * 256 + b"\0", None),  # no camera's name
        (5, bytes(8), (0, 0)),  # a fraction: numerator and denominator
        (12, bytes(8), None),  # a floating-point number
    ],
)  # fmt: skip
def test_a_tag_is_a_text_that_a_camera_writes_or_whole_numbers_or_a_fraction(tmp_path, order, kind, content, read):
    number = len(content) if kind == 2 else 1
    value = content.ljust(4, b"\0") if len(content) <= 4 else struct.pack(order + "I", 26)
    entry = struct.pack(order + "HHI", 271, kind, number) + value
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "IH", 8, 1)
    # The next directory is said to lie beyond the end, and is none.
    (tmp_path / "a.dng").write_bytes(head + entry + b"\xff" * 4 + content)
    assert [tag.values for tag in read_tags(tmp_path / "a.dng", (271,))] == ([] if read is None else [read])


def test_a_value_may_stand_anywhere_in_a_file(tmp_path):
    entry = struct.pack("<HHII", 330, 3, 4, 0)  # four short numbers from the first byte on
    (tmp_path / "a.dng").write_bytes(b"II*\0" + struct.pack("<IH", 8, 1) + entry + bytes(4))
    assert [tag.values for tag in read_tags(tmp_path / "a.dng", (330,))] == [struct.unpack("<4H", b"II*\0\x08\0\0\0")]
