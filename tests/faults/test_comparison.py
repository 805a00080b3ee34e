"""The comparison of results sees every bit that matters, and no clock."""

import json

import numpy as np
import pytest
from comparison import differences, results

from irodori.colour.display import srgb
from irodori.core.custody import write_record
from irodori.core.store import Provenance, create
from irodori.export.pictures import write_display_picture, write_spectral_exr


def make(folder, values=None, seconds=1.0, radiance=0.25, mean="0.5", note="x"):
    """Write one result of every kind."""
    (folder / "jar/captures").mkdir(parents=True)
    (folder / "logs").mkdir()
    values = np.array([0.0, np.nan, 1.5]) if values is None else values
    with create(
        folder / "jar/material.h5", Provenance("compress_reflectance", inputs={"tile.h5": str(seconds)})
    ) as out:
        out.write("alpha", values, units="1", dims="texel", quantity="diffuse weight")
        out.attribute("fit_seconds", seconds)
        out.attribute("note", note)
        out.attribute("errors", {"fit_seconds": seconds, "delta_e": {"mean": float(mean)}})
    picture = np.full((2, 3, 61), radiance, np.float32)
    write_spectral_exr(folder / "jar/front.exr", picture, picture[..., :3], {})
    write_display_picture(folder / "jar/front.png", np.zeros((2, 3, 3), np.uint8), srgb().profile, {})
    figures = {"seconds": seconds, "exposure": 1.0}
    (folder / "jar/front.json").write_text(json.dumps(figures))
    (folder / "jar/errors.csv").write_text(f"subject,mean\njar,{mean}\n")
    (folder / "logs/fit.log").write_text(str(seconds))
    (folder / "jar/report.html").write_text(str(seconds))
    (folder / "jar/captures/captures.csv").write_text("file\n")
    write_record(folder / "jar/errors.csv", "results/jar/errors.csv", {"results/jar/material.h5": str(seconds)})
    return folder


@pytest.fixture
def expected(tmp_path):
    return make(tmp_path / "expected")


def test_results_that_only_a_clock_tells_apart_are_the_same(tmp_path, expected):
    assert differences(make(tmp_path / "found", seconds=9.0), expected) == []
    assert len(results(expected)) == 6


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"values": np.array([-0.0, np.nan, 1.5])}, "jar/material.h5: alpha"),
        ({"values": np.array([0.0, np.nan, np.nextafter(1.5, 2)])}, "jar/material.h5: alpha"),
        ({"values": np.array([0.0, np.nan, 1.5], np.float32)}, "jar/material.h5: alpha"),
        ({"note": "y"}, "jar/material.h5: @note"),
        ({"radiance": np.nextafter(np.float16(0.25), np.float16(1))}, "jar/front.exr: pixels"),
        ({"mean": "0.50"}, "jar/errors.csv: line 2"),
    ],
)
def test_one_bit_is_seen_wherever_it_is(tmp_path, expected, change, said):
    assert differences(make(tmp_path / "found", **change), expected) == [said]


def test_what_an_attribute_holds_beside_its_seconds_is_compared(tmp_path, expected):
    found = make(tmp_path / "found", seconds=9.0, mean="0.6")
    assert differences(found, expected) == ["jar/errors.csv: line 2", "jar/material.h5: @errors"]


def test_missing_files_surplus_files_and_unreadable_ones_are_named(tmp_path, expected):
    found = make(tmp_path / "found")
    (found / "jar/front.png").unlink()
    (found / "more.csv").write_text("")
    whole = (found / "jar/material.h5").read_bytes()
    (found / "jar/material.h5").write_bytes(whole[: len(whole) // 2])
    (found / "jar/front.json").write_text("{")
    said = "\n".join(differences(found, expected))
    for name in ("jar/front.png: missing", "more.csv: should not be there", "jar/material.h5: unreadable",
                 "jar/front.json: unreadable"):  # fmt: skip
        assert name in said


def test_a_broken_off_run_may_lack_files_but_hold_none_that_is_half_written(tmp_path, expected):
    found = make(tmp_path / "found")
    (found / "jar/errors.csv").unlink()
    (found / "jar/.material.12-ab.part.h5").write_bytes(b"half")
    (found / "jar/captures/captures.csv").write_text("file\nhalf a session")
    assert differences(found, expected, partial=True) == []
    (found / "jar/captures/session.json").write_text("{}")
    assert len(differences(found, expected, partial=True)) == 2
    (found / "jar/material.h5").write_bytes(b"half")
    assert len(differences(found, expected, partial=True)) == 3
