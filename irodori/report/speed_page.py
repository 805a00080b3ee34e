"""Speed-against-error page of all benchmarks, with the Pareto front of each stage."""

import csv
import html
import math
from collections.abc import Sequence
from pathlib import Path

from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.report.figures import front_figure
from irodori.report.markup import figure, number, table, write_page

#: The variant of each stage that the workflow uses unless it is told otherwise.
DEFAULTS = {
    "ingest": "superpixel-registered",
    "calibrate": "pinv",
    "fit": "varpro",
    "compress": "pca-budget",
    "render": "interactive-coefficients",
}
COLUMNS = (
    "stage", "variant", "work", "unit", "seconds", "throughput", "error_metric", "error", "peak_mb", "reference",
    "ratio",
)  # fmt: skip


def read_rows(path) -> list[dict]:
    """Return the rows of one benchmark's table.

    Raises
    ------
    InputError
        If its columns are not those of the design, section 6.
    """
    with open(path, newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            found = ", ".join(reader.fieldnames or ()) or "nothing"
            raise InputError(path, "columns", found, ", ".join(COLUMNS))
        return list(reader)


def is_measured(row: dict) -> bool:
    """Whether a row has figures; one of a peer that could not run has the reason as its metric and nothing else."""
    return bool(row["seconds"])


def front(rows: Sequence[dict]) -> list[str]:
    """Return the variants that no other one of the same unit beats in both throughput and error, fastest first.

    Variants without an error, which stand beside the others as a measure of time alone, are on no front.
    """
    known = [r for r in rows if is_measured(r) and math.isfinite(float(r["error"]))]
    found = [
        r
        for r in known
        if not any(
            other["unit"] == r["unit"]
            and float(other["throughput"]) >= float(r["throughput"])
            and float(other["error"]) <= float(r["error"])
            and (other["throughput"], other["error"]) != (r["throughput"], r["error"])
            for other in known
        )
    ]
    return [r["variant"] for r in sorted(found, key=lambda r: -float(r["throughput"]))]


def _stage_section(stage: str, rows: list[dict]) -> str:
    absent = [html.escape(f"{r['variant']}: {r['error_metric']}") for r in rows if not is_measured(r)]
    rows = [r for r in rows if is_measured(r)]
    metric = next((r["error_metric"] for r in rows if r["error_metric"]), "")
    best = front(rows)
    lines = [
        [
            ("* " if r["variant"] in best else "") + r["variant"],
            f"{number(r['work'])} {r['unit']}",
            number(r["seconds"]),
            f"{number(r['throughput'])} {r['unit']}/s",
            *(number(r[name]) for name in ("error", "peak_mb")),
            r["reference"],
            number(r["ratio"]),
        ]
        for r in rows
    ]
    header = ["variant", "work", "seconds", "throughput", metric, "peak, MB", "reference", "time over the reference's"]
    parts = [f"<h2>{html.escape(stage)}</h2>"]
    parts += [
        figure(front_figure(group, best, DEFAULTS.get(stage), metric), f"{stage}: throughput in {unit}/s against error")
        for unit in dict.fromkeys(r["unit"] for r in rows)
        if len(group := [r for r in rows if r["unit"] == unit and math.isfinite(float(r["error"]))]) > 1
    ]
    return "".join([*parts, table(header, lines), *(f"<p>{text}</p>" for text in absent)])


def _materials_section(path) -> str:
    with open(path, newline="", encoding="utf-8") as stream:
        rows = [r for r in csv.DictReader(stream) if r["part"] == "all"]
    title = "<h2>Measured materials</h2>"
    if not rows:
        return title + "<p>No measured materials are at hand: nothing was compared.</p>"
    models = list(dict.fromkeys(r["model"] for r in rows))
    lines = []
    for material in dict.fromkeys(r["material"] for r in rows):
        same = {r["model"]: r for r in rows if r["material"] == material}
        lines.append([material, same[models[0]]["outliers"], *(number(same[m]["relative_rms"]) for m in models)])
    return (
        title
        + "<p>Root mean square residual over the root mean square of the response, every wavelength fitted by itself: "
        + "where a model is far above the best, it is not enough for that material.</p>"
        + table(["material", "outliers left out", *models], lines)
    )


def write_speed_report(tables: Sequence, materials, size: str, output, page_file) -> None:
    """Write ``speed_error.csv`` and its page.

    Parameters
    ----------
    tables : sequence of path
        One a stage, as the benchmarks write them.
    materials : path
        Table of `benchmarks.materials`; empty where there was no data.
    size : str
        What was measured, for the page.
    output, page_file : path

    Raises
    ------
    InputError
        If a table is not one.
    """
    groups = {Path(path).stem: read_rows(path) for path in tables}
    parts = [f"<p>Size: {html.escape(size)}. A star marks what no other variant beats in both speed and error.</p>"]
    for stage, rows in groups.items():
        parts.append(
            _stage_section(stage, rows) if rows else f"<h2>{stage}</h2><p>Skipped: its data is not at hand.</p>"
        )
    parts.append(_materials_section(materials))
    write_page(page_file, "Irodori: speed against error", "<h1>Speed against error</h1>" + "".join(parts))
    with written_whole(output) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row for rows in groups.values() for row in rows)
