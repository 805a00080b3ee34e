"""Script that writes the tables of both READMEs and of docs from the results of a run, its benchmark and its exports.

``python -m benchmarks.published_tables [--results results]`` after ``snakemake --cores 2``, ``snakemake --cores 2
benchmark`` and ``python -m benchmarks.exports``, at the top of the repository: copies the tables shown to
``docs/figures`` and rewrites the blocks between marks in all documents. Text between two marks is never written by
hand: a test compares it with ``docs/figures``.
"""

import argparse
import csv
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.speed_page import DEFAULTS, front, is_measured, read_rows
from irodori.core.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"
#: Table in docs/figures -> where a run leaves it, under results/.
SOURCES = {
    "errors.csv": "still-life/errors.csv",
    "error_budget.csv": "still-life/error_budget/front.csv",
    "speed_error.csv": "benchmark/speed_error.csv",
    "exports.csv": "benchmark/exports.csv",
}
#: Quantities of ``errors.csv`` that are shown, where there are such.
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
    """Format a number, given as text, for the documents; NaN becomes a dash."""
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
    """Return the table of speed: for every stage the references, the default and the variants on the Pareto front."""
    rows = read_rows(folder / "speed_error.csv")
    lines = []
    for stage in dict.fromkeys(r["stage"] for r in rows):
        own = [r for r in rows if r["stage"] == stage]
        shown = {*front(own), DEFAULTS.get(stage), *(r["reference"] for r in own)}
        lines += [_speed_line(r) for r in own if r["variant"] in shown or not is_measured(r)]
    return _table(("stage", "variant", "speed", "times its reference", "error", "which is", "peak, MB"), lines)


def _speed_line(row: dict) -> list[str]:
    """Return the table cells of a variant, or the reason if it could not run."""
    if not is_measured(row):
        return [row["stage"], row["variant"], "–", "–", "–", row["error_metric"].replace("|", "/"), "–"]
    error = _number(row["error"], 2)
    return [row["stage"], row["variant"], f"{_number(row['throughput'])} {row['unit']}/s", _times(row), error,
            row["error_metric"] if error != "–" else "", f"{float(row['peak_mb']):.0f}"]  # fmt: skip


#: What the README's five figures are, and how an error, a ratio and a speed with its error are written.
_ENGLISH = (
    ("measured on the default scene and on two cores", "CIEDE2000, or a number"),
    ("colour error of chart patches left out of the calibration", "colour error of the recovered light",
     "colour error of the picture, on the objects", "texels fitted a second, and that beside NLopt called from Python",
     "pixels rendered a second, interactive, and how far they are from path tracing on the objects"),
    "{mean} mean, {p95} at the 95th percentile", "{speed}, {times} times as many", "{speed}, {mean} mean",
)  # fmt: skip
_JAPANESE = (
    ("標準のシーンを2コアで測定", "CIEDE2000または数値"),
    ("較正に使わなかったチャートの色票の色誤差", "復元した光の色誤差", "画像の色誤差(物体の上)",
     "1秒間に当てはめるテクセル数と、Pythonから呼ぶNLoptとの比",
     "1秒間に描画する画素数(対話型)と、物体の上での経路追跡との色差"),
    "平均 {mean}、95パーセンタイル {p95}", "{speed}({times} 倍)", "{speed}、平均 {mean}",
)  # fmt: skip


def figures_block(folder: Path, words=_ENGLISH) -> str:
    """Return the list of five figures for the README."""
    head, whats, error, ratio, distance = words
    errors = _rows(folder / "errors.csv")
    speeds = {(r["stage"], r["variant"]): r for r in read_rows(folder / "speed_error.csv")}
    quantities = (
        "leave-one-patch-out CIEDE2000", "light CIEDE2000", "picture CIEDE2000 to true materials, objects only",
    )  # fmt: skip
    found = [next(r for r in errors if r["quantity"] == q and r["light"] != "A") for q in quantities]
    fit, frame = (speeds[key, DEFAULTS[key]] for key in ("fit", "render"))
    values = [
        *(error.format(mean=_number(r["mean"]), p95=_number(r["p95"])) for r in found),
        ratio.format(speed=_number(fit["throughput"]), times=_times(fit)),
        distance.format(speed=_number(frame["throughput"]), mean=_number(frame["error"])),
    ]
    return _table(head, list(zip(whats, values, strict=True)))


def japanese_figures_block(folder: Path) -> str:
    """Return the same list of five figures for the Japanese README."""
    return figures_block(folder, _JAPANESE)


def _times(row: dict) -> str:
    return "reference" if row["variant"] == row["reference"] else _number(str(1 / float(row["ratio"])))


def exports_block(folder: Path) -> str:
    """Return the table of exports, with the reason for each comparison that could not be made."""
    lines, before = [], ""
    for row in _rows(folder / "exports.csv"):
        name, before = "" if row["export"] == before else row["export"], row["export"]
        figures = [_number(row[key]) if row[key] else "–" for key in ("mean", "p95", "max")]
        what = row["compared"] if row["mean"] else f"{row['compared']}: {row['count']}"
        cost = [_number(row[key]) if name and row[key] else "" for key in ("mb", "cpu_s")]
        lines.append([f"`{name}`" if name else "", what.replace("|", "/"), *figures, *cost])
    return _table(("`irodori export`, or file", "compared", "mean", "p95", "max", "MB", "CPU s"), lines)


#: Document -> its blocks.
DOCUMENTS: dict[str, dict[str, Callable[[Path], str]]] = {
    "README.md": {"figures": figures_block},
    "docs/exports.md": {"exports": exports_block},
    "README.ja.md": {"figures": japanese_figures_block},
    "docs/benchmarks.md": {"errors": errors_block, "budget": budget_block, "speed": speed_block},
}


def written(text: str, document: str, folder: Path) -> str:
    """Return a document's text with its blocks rewritten from the tables in a folder.

    Raises
    ------
    InputError
        If the text lacks a block's marks.
    """
    for name, block in DOCUMENTS[document].items():
        begin, end = f"<!-- {name}: made by benchmarks.published_tables -->\n", f"<!-- end of {name} -->"
        before, mark, rest = text.partition(begin)
        _, other, after = rest.partition(end)
        if not (mark and other):
            raise InputError(document, "", f"no block {name!r}", f"{begin.strip()} and {end}, in this order")
        text = f"{before}{begin}\n{block(folder)}\n\n{end}{after}"
    return text


def main() -> None:
    """Copy the tables and write the documents' blocks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=ROOT / "results")
    results = parser.parse_args().results
    FIGURES.mkdir(exist_ok=True)
    for name, source in SOURCES.items():
        shutil.copyfile(results / source, FIGURES / name)
    for document in DOCUMENTS:
        path = ROOT / document
        path.write_text(written(path.read_text(encoding="utf-8"), document, FIGURES), encoding="utf-8")


if __name__ == "__main__":
    main()
