"""The README shows what the tables beside it say."""

import pytest

from benchmarks.readme import BLOCKS, FIGURES, ROOT, _number, speed_block, written
from irodori.core.errors import InputError

README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_readme_is_made_from_the_tables_beside_it():
    assert written(README, FIGURES) == README


def test_a_changed_figure_changes_the_readme(tmp_path):
    for path in FIGURES.glob("*.csv"):
        (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    table = tmp_path / "error_budget.csv"
    head, first, *rest = table.read_text(encoding="utf-8").splitlines()
    stage, _, others = first.partition(",")
    table.write_text("\n".join([head, f"{stage},77.7,{others.partition(',')[2]}", *rest]) + "\n", encoding="utf-8")
    assert "77.7" in written(README, tmp_path)


def test_a_readme_without_a_block_is_refused():
    for name in BLOCKS:
        with pytest.raises(InputError, match=f"no block '{name}'"):
            written(README.replace(f"<!-- end of {name} -->", ""), FIGURES)


def test_every_stage_shows_its_reference_and_a_variant_that_nothing_beats():
    block = speed_block(FIGURES)
    stages = {line.split(" | ")[0].strip("| ") for line in block.splitlines()[2:]}
    assert {"ingest", "calibrate", "fit", "compress"} <= stages
    for stage in stages:
        assert f"| {stage} | " in block
        assert any(line.startswith(f"| {stage} |") and "reference |" in line for line in block.splitlines()), stage


def test_numbers_are_written_with_the_digits_that_count():
    assert [_number(t) for t in ("0.0123456", "12.345", "999", "2154321.0", "nan")] == [
        "0.0123", "12.3", "999", "2 150 000", "–"]  # fmt: skip
