"""The page of speed against error: its front, its table, its refusals."""

import csv
import importlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import table
from benchmarks.speed_page import COLUMNS, front, read_rows, write_speed_report
from irodori.core.errors import InputError


def _row(variant, throughput, error, unit="pixels", stage="fit"):
    values = (stage, variant, "100", unit, "1.0", str(throughput), "share missed", str(error), "200", "slow", "0.5")
    return dict(zip(COLUMNS, values, strict=True))


def _write(path, rows, columns=COLUMNS):
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, columns)
        writer.writeheader()
        writer.writerows(rows)
    return path


@given(st.lists(st.tuples(st.floats(1.0, 1e9), st.floats(0.0, 1.0)), min_size=1, max_size=12, unique=True))
def test_nothing_beats_the_front_and_the_front_beats_everything_else(points):
    rows = [_row(f"v{i}", *p) for i, p in enumerate(points)]
    best = {name: points[int(name[1:])] for name in front(rows)}
    assert best
    for i, (speed, error) in enumerate(points):
        beaten = [(s, e) for s, e in points if s >= speed and e <= error and (s, e) != (speed, error)]
        assert (f"v{i}" in best) == (not beaten)


def test_units_have_fronts_of_their_own_and_a_time_without_error_has_none():
    rows = [_row("slow", 1.0, 0.1), _row("other", 9.0, 0.2, "shots"), _row("blas", 99.0, float("nan"))]
    assert front(rows) == ["other", "slow"]


def test_the_tables_become_one_and_the_page_shows_all_of_it(tmp_path):
    fit = _write(tmp_path / "fit.csv", [_row("varpro", 2e6, 0.0), _row("nlopt-reference", 3e3, 0.0)])
    skipped = _write(tmp_path / "calibrate.csv", [])
    materials = tmp_path / "materials.csv"
    rows = [
        {"material": "plaster", "model": model, "outliers": 1, "values": 9, "part": part, "relative_rms": rms}
        for part in ("all", "red")
        for model, rms in (("lambert", 0.9), ("equation 5", 0.3))
    ]
    _write(materials, rows, list(rows[0]))
    write_speed_report([fit, skipped], materials, "small", tmp_path / "speed_error.csv", tmp_path / "page.html")
    assert [r["variant"] for r in read_rows(tmp_path / "speed_error.csv")] == ["varpro", "nlopt-reference"]
    page = (tmp_path / "page.html").read_text()
    missing = "calibrate</h2>\n<p>Not measured"
    for text in ("varpro", "2e+06 pixels/s", "plaster", "0.9", "0.3", missing, "the size “small”"):
        assert text in page
    assert page.count("<figure>") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "calibrate.csv", "fit.csv", "materials.csv", "page.html", "speed_error.csv",
    ]  # fmt: skip


def test_the_benchmarks_write_the_columns_that_the_report_reads():
    assert table.COLUMNS == COLUMNS


def test_a_table_with_other_columns_is_refused_by_name(tmp_path):
    bad = _write(tmp_path / "fit.csv", [], ("stage", "speed"))
    with pytest.raises(InputError, match=r"fit\.csv: columns: found stage, speed; accepted: stage, variant"):
        read_rows(bad)


@pytest.mark.parametrize(
    "name", ["calibrate", "compress", "environment", "fit", "ingest", "plan", "reference", "render"]
)
def test_every_benchmark_says_what_it_takes(name, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(f"benchmarks.{name}").main()
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert all(option in printed for option in ("--runs", "--threads", "--size", "--output"))
