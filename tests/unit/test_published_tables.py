"""The documents show what the tables beside them say."""

import csv

import pytest

from benchmarks.published_tables import DOCUMENTS, FIGURES, ROOT, _number, speed_block, written
from benchmarks.table import row_without_figures
from irodori.core.errors import InputError


def text_of(document: str) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


@pytest.fixture
def figures(tmp_path):
    """Return a copy of the tables that a test may change."""
    for path in FIGURES.glob("*.csv"):
        (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("document", DOCUMENTS)
def test_documents_are_made_from_the_tables_beside_them(document):
    assert written(text_of(document), document, FIGURES) == text_of(document)


def test_a_changed_figure_changes_the_document(figures):
    table = figures / "error_budget.csv"
    head, first, *rest = table.read_text(encoding="utf-8").splitlines()
    stage, _, others = first.partition(",")
    table.write_text("\n".join([head, f"{stage},77.7,{others.partition(',')[2]}", *rest]) + "\n", encoding="utf-8")
    assert "77.7" in written(text_of("docs/benchmarks.md"), "docs/benchmarks.md", figures)


def test_the_readme_shows_five_figures_and_no_other_generated_table(figures):
    readme = text_of("README.md")
    assert readme.count("made by benchmarks.published_tables") == 1
    block = readme.partition("published_tables -->")[2].partition("<!-- end")[0]
    assert len([line for line in block.splitlines() if line.startswith("|")]) == 2 + 5
    table = figures / "errors.csv"
    with table.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        row["mean"] = "77.7"
    with table.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    assert written(readme, "README.md", figures).count("77.7 mean") == 3


@pytest.mark.parametrize(("document", "name"), [(d, name) for d, blocks in DOCUMENTS.items() for name in blocks])
def test_a_document_without_a_block_is_refused(document, name):
    with pytest.raises(InputError, match=f"{document}: found no block '{name}'"):
        written(text_of(document).replace(f"<!-- end of {name} -->", ""), document, FIGURES)


def test_every_stage_shows_its_reference_and_a_variant_that_nothing_beats():
    block = speed_block(FIGURES)
    stages = {line.split(" | ")[0].strip("| ") for line in block.splitlines()[2:]}
    assert {"ingest", "calibrate", "fit", "compress"} <= stages
    for stage in stages:
        assert f"| {stage} | " in block
        assert any(line.startswith(f"| {stage} |") and "reference |" in line for line in block.splitlines()), stage


def test_a_peer_that_could_not_run_is_shown_with_the_reason(figures):
    with (figures / "speed_error.csv").open("a", newline="", encoding="utf-8") as stream:
        row = row_without_figures("render", "mitsuba-llvm box", "ended by SIGABRT: no | LLVM")
        csv.DictWriter(stream, list(row), lineterminator="\n").writerow(row)
    assert "| render | mitsuba-llvm box | – | – | – | cannot run: ended by SIGABRT: no / LLVM | – |" in speed_block(
        figures
    )


def test_numbers_are_written_with_the_digits_that_count():
    assert [_number(t) for t in ("0.0123456", "12.345", "999", "2154321.0", "nan")] == [
        "0.0123", "12.3", "999", "2 150 000", "–"]  # fmt: skip
