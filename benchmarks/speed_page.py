"""Speed-against-error page of all benchmarks, with the Pareto front of each stage."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.report.figures import png_uri
from irodori.report.html_page import write_page

#: The variant of each stage that the workflow uses by default.
DEFAULTS = {
    "ingest": "superpixel-registered",
    "calibrate": "pinv",
    "fit": "varpro",
    "compress": "pca-budget",
    "render": "interactive-coefficients, light maps",
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
        If its columns are not `COLUMNS`.
    """
    with open(path, newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            found = ", ".join(reader.fieldnames or ()) or "nothing"
            raise InputError(path, "columns", found, ", ".join(COLUMNS))
        return list(reader)


def is_measured(row: dict) -> bool:
    """Return whether a row has measurements; for a program that could not run, it has only the reason, as metric."""
    return bool(row["seconds"])


def front(rows: Sequence[dict]) -> list[str]:
    """Return the Pareto front: variants that no other of the same unit beats in throughput and error, fastest first.

    Variants without an error, which are listed as measurements of time only, are on no front.
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


def _front_figure(rows: list[dict], front: list[str], default: str | None, metric: str) -> str:
    """Return a figure of throughput against error of variants; a line joins the Pareto front, a ring marks the default.

    Parameters
    ----------
    rows : list of dict
        Rows of a benchmark's table that have the same unit.
    front : list of str
        Variants on the front, fastest first.
    default : str, optional
    metric : str
        Label of the error axis.
    """
    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    places = {r["variant"]: (float(r["throughput"]), float(r["error"])) for r in rows}
    for name, (speed, error) in places.items():
        axes.plot(speed, error, "o", color="#2f6690" if name in front else "#b0b0b0", markersize=5)
        axes.annotate(name, (speed, error), fontsize=7, textcoords="offset points", xytext=(4, 3))
    best = [places[name] for name in front if name in places]
    axes.plot([p[0] for p in best], [p[1] for p in best], "-", color="#2f6690", linewidth=0.8)
    if default in places:
        axes.plot(*places[default], "o", markersize=12, markerfacecolor="none", color="#c04040")
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=max(min((e for _, e in places.values() if e > 0.0), default=1.0), 1e-12))
    axes.set_xlabel(f"throughput, {rows[0]['unit']}/s", fontsize=8)
    axes.set_ylabel(metric, fontsize=8)
    return png_uri(figure)


def _stage(name: str, rows: list[dict]) -> dict:
    absent = [f"{r['variant']}: {r['error_metric']}" for r in rows if not is_measured(r)]
    rows = [r for r in rows if is_measured(r)]
    metric = next((r["error_metric"] for r in rows if r["error_metric"]), "")
    best = front(rows)
    figures = {
        unit: _front_figure(group, best, DEFAULTS.get(name), metric)
        for unit in dict.fromkeys(r["unit"] for r in rows)
        if len(group := [r for r in rows if r["unit"] == unit and math.isfinite(float(r["error"]))]) > 1
    }
    return {"name": name, "rows": rows, "metric": metric, "front": best, "figures": figures, "absent": absent}


def write_speed_report(tables: Sequence, materials, size: str, output, page_file) -> None:
    """Write ``speed_error.csv``, the rows of all benchmarks, and the page that shows them.

    Parameters
    ----------
    tables : sequence of path
        Tables of the benchmarks, one for each stage.
    materials : path
        Table of `benchmarks.materials`; without rows if there was no data.
    size : str
        Size of the measured problems, shown on the page.
    output, page_file : path

    Raises
    ------
    InputError
        If a file is no table of benchmarks.
    """
    groups = {Path(path).stem: read_rows(path) for path in tables}
    with open(materials, newline="", encoding="utf-8") as stream:
        compared = [row for row in csv.DictReader(stream) if row["part"] == "all"]
    stages = [_stage(name, rows) for name, rows in groups.items()]
    write_page(page_file, "speed.html.j2", size=size, stages=stages, materials=compared)
    with written_whole(output) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row for rows in groups.values() for row in rows)
