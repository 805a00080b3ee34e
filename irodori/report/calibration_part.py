"""Calibration section of the report: errors of left-out chart patches, choice of estimator, chart quality."""

import csv

import numpy as np

from irodori.core import store
from irodori.report.figures import selection_figure

_ATTRIBUTES = (
    "best_estimators", "charts", "clipped_patches", "condition_number", "estimator", "level",
    "light_on_chart", "likelier_charts", "noise_amplification", "patches_found", "response_model",
    "uneven_patches", "verdicts",
)  # fmt: skip
_WAYS = {"leave_one_out": "left out patch by patch", "leave_one_chart_out": "left out chart by chart"}


def camera_calibrations(cameras: list[str], calibrations: list, errors: list, selections: list) -> list[dict]:
    """Return the data of the template ``calibration.html.j2``, one dictionary for each camera.

    Parameters
    ----------
    cameras : list of str
    calibrations, errors, selections : list of path
        ``calibration.h5``, ``calibration_errors.csv`` and ``calibration_selection.csv`` of each camera.
    """
    return [_calibration(*of_one) for of_one in zip(cameras, calibrations, errors, selections, strict=True)]


def _calibration(name: str, calibration, errors, selection) -> dict:
    with store.open_file(calibration) as file:
        found = {key: file.attribute(key) for key in _ATTRIBUTES} | {"bases": file.dataset("basis").shape[1]}
        found["left_out"] = {words: _means(file, way) for way, words in _WAYS.items() if f"{way}/rmse" in file}
    found["guidelines"] = guideline_rows(found.pop("verdicts"))
    rows = _read(selection)
    by_patch = [row for row in rows[1:] if row[rows[0].index("left_out")] == "patch"]
    files = {"selection": rows, "patches": _read(errors), "figure": selection_figure(rows[0], by_patch)}
    return found | files | {"name": name}


def guideline_rows(verdicts: list[dict]) -> list[dict]:
    """Return one row for each guideline, quantity and statistic, with the limits of all levels and the level reached.

    Parameters
    ----------
    verdicts : list of dict
        Attribute ``verdicts`` of ``calibration.h5``: the fields of `irodori.calibration.verdict.Tolerance`,
        ``measured`` and ``passes``; the levels of each guideline are in order from the strictest.
    """
    groups: dict[tuple, list[dict]] = {}
    for v in verdicts:
        groups.setdefault((v["guideline"], v["quantity"], v["metric"], v["statistic"]), []).append(v)
    return [_guideline_row(levels) for levels in groups.values()]


def _guideline_row(levels: list[dict]) -> dict:
    first = levels[0]
    sign = "<" if first["strict"] else "≤"
    reached = next((v["level"] for v in levels if v["passes"]), "none")
    return {
        **{key: first[key] for key in ("guideline", "quantity", "metric", "statistic", "measured", "source")},
        "limits": ", ".join(f"{v['level']} {sign} {v['limit']:g}" for v in levels),
        "reached": "not measured: no neutral patch" if np.isnan(first["measured"]) else reached,
        "read_in": "the document" if first["verified"] else "a secondary source, not the document",
    }


def _means(file: store.Reader, way: str) -> dict[str, float]:
    """Return mean errors of a cross-validation of patches: {light: CIEDE2000}, and ``rmse`` of the spectra."""
    of = {light: f"delta_e_{light.lower()}" for light in file.attribute("lights")} | {"rmse": "rmse"}
    return {label: float(np.nanmean(file.read(f"{way}/{name}"))) for label, name in of.items()}


def _read(path) -> list[list[str]]:
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.reader(stream))
