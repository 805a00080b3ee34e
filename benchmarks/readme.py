"""The README's tables of figures, made from the tables that a run and its benchmark leave.

``python -m benchmarks.readme [--results results]`` after ``snakemake --cores 2`` and ``snakemake --cores 2 benchmark``,
at the top of the repository: copies the tables that the README shows to ``docs/figures`` and writes the README's blocks
anew between their marks. What stands between two marks is never written by hand: a test compares the README with
``docs/figures``.
"""

import argparse
import csv
import shutil
from collections.abc import Sequence
from pathlib import Path

from irodori.core.errors import InputError
from irodori.report.speed_page import DEFAULTS, front, read_rows

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"
#: Table in docs/figures -> where a run leaves it, under results/.
SOURCES = {
    "errors.csv": "errors.csv",
    "error_budget.csv": "still-life/error_budget/front.csv",
    "speed_error.csv": "benchmark/speed_error.csv",
}
#: Quantities of ``errors.csv`` that the README shows, where there are such.
QUANTITIES = (
    "leave-one-patch-out CIEDE2000",
    "reflectance CIEDE2000 away from seams",
    "beta relative away from seams, where known",
    "mu relative away from seams, where known",
    "light CIEDE2000",
    "picture CIEDE2000 to true materials, objects only",
)


def _table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *lines))


def _number(text: str, digits: int = 3) -> str:
    """Return a number as the README writes it; a dash where there is none."""
    value = float(text)
    if value != value:
        return "–"
    return (
        f"{value:.{digits}g}" if abs(value) < 10**digits else f"{float(f'{value:.{digits}g}'):,.0f}".replace(",", " ")
    )


def _rows(path: Path) -> list[dict]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def errors_block(folder: Path) -> str:
    """Return the table of errors against the truth."""
    lines = [
        [r["subject"], r["quantity"] + (f", {r['light']}" if r["light"] in ("D65", "A") else ""), r["count"],
         *(_number(r[name]) for name in ("mean", "p95", "max"))]
        for r in _rows(folder / "errors.csv")
        if r["quantity"] in QUANTITIES and r["light"] != "A"
    ]  # fmt: skip
    return _table(("what", "quantity", "count", "mean", "p95", "max"), lines)


def budget_block(folder: Path) -> str:
    """Return the table of the error budget."""
    names = ("mean", "p95", "max", "predicted")
    lines = [[r["stage"], *(_number(r[name]) for name in names)] for r in _rows(folder / "error_budget.csv")]
    return _table(("stage as measured, the rest true", "mean", "p95", "max", "mean predicted"), lines)


def speed_block(folder: Path) -> str:
    """Return the table of speed: of every stage the references, the default, and what no other variant beats."""
    rows = read_rows(folder / "speed_error.csv")
    lines = []
    for stage in dict.fromkeys(r["stage"] for r in rows):
        own = [r for r in rows if r["stage"] == stage]
        shown = {*front(own), DEFAULTS.get(stage), *(r["reference"] for r in own)}
        lines += [
            [stage, r["variant"], f"{_number(r['throughput'])} {r['unit']}/s", _times(r), _number(r["error"], 2),
             r["error_metric"] if _number(r["error"]) != "–" else "", f"{float(r['peak_mb']):.0f}"]
            for r in own
            if r["variant"] in shown
        ]  # fmt: skip
    return _table(("stage", "variant", "speed", "times its reference", "error", "which is", "peak, MB"), lines)


def _times(row: dict) -> str:
    return "reference" if row["variant"] == row["reference"] else _number(str(1 / float(row["ratio"])))


BLOCKS = {"errors": errors_block, "budget": budget_block, "speed": speed_block}


def written(readme: str, folder: Path) -> str:
    """Return the README with its blocks made anew from the tables of a folder.

    Raises
    ------
    InputError
        If the README lacks a block's marks.
    """
    for name, block in BLOCKS.items():
        begin, end = f"<!-- {name}: made by benchmarks.readme -->\n", f"<!-- end of {name} -->"
        before, mark, rest = readme.partition(begin)
        _, other, after = rest.partition(end)
        if not (mark and other):
            raise InputError("README.md", "", f"no block {name!r}", f"{begin.strip()} and {end}, in this order")
        readme = f"{before}{begin}\n{block(folder)}\n\n{end}{after}"
    return readme


def main() -> None:
    """Copy the tables and write the README's blocks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=ROOT / "results")
    results = parser.parse_args().results
    FIGURES.mkdir(exist_ok=True)
    for name, source in SOURCES.items():
        shutil.copyfile(results / source, FIGURES / name)
    path = ROOT / "README.md"
    path.write_text(written(path.read_text(encoding="utf-8"), FIGURES), encoding="utf-8")


if __name__ == "__main__":
    main()
