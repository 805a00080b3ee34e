"""Calibration section of the report: errors of unseen patches, choice of estimator, chart quality."""

import csv
import html
import math

import numpy as np

from irodori.core import store
from irodori.report.figures import selection_figure
from irodori.report.markup import details, figure, number, table

_VERDICTS = ("guideline", "level", "metric", "statistic", "limit", "measured", "passes", "source")


def calibration_section(cameras: list[str], calibrations: list, errors: list, selections: list) -> str:
    """Return the section.

    Parameters
    ----------
    cameras : list of str
    calibrations, errors, selections : list of path
        ``calibration.h5``, ``calibration_errors.csv`` and ``calibration_selection.csv`` of each camera.
    """
    parts = [
        "<h2>Calibration</h2><p>Errors are those of patches that the calibration has not seen: each was left out in "
        "turn, and each whole chart where there are several. The comparison of the estimators adds the noise of a "
        "pixel, where it was measured.</p>"
    ]
    for name, calibration, patches, selection in zip(cameras, calibrations, errors, selections, strict=True):
        parts.append(f"<h3>{html.escape(name)}</h3>")
        with store.open_file(calibration) as file:
            parts.append(table(["", ""], _figures(file)))
            verdicts = file.attribute("verdicts")
        header, rows = _read(selection)
        by_patch = [row for row in rows if row[header.index("left_out")] == "patch"]
        parts.append(figure(selection_figure(header, by_patch), f"{name}: error against time for every estimator"))
        parts.append(details("every estimator and number of bases", table(header, [_short(r) for r in rows])))
        parts.append(details("heritage-imaging guidelines", _verdicts(verdicts)))
        parts.append(details("patch by patch", table(*_read(patches))))
    return "".join(parts)


def _read(path) -> tuple[list[str], list[list[str]]]:
    with open(path, newline="", encoding="utf-8") as stream:
        header, *rows = list(csv.reader(stream))
    return header, rows


def _short(row: list[str]) -> list[str]:
    return [text if text.isalpha() else number(float(text)) for text in row]


def _figures(file: store.Reader) -> list[list[str]]:
    """Return what the calibration says of itself, a row a quantity."""
    jitter, light = file.attribute("jitter"), file.attribute("light_on_chart")
    uneven, clipped = file.attribute("uneven_patches"), file.attribute("clipped_patches")
    moved = "not measurable: a moved patch leaves the picture"
    if not math.isnan(jitter["worst"]):
        moved = (
            f"{jitter['worst']:.3f}, {'within' if jitter['worst'] <= jitter['limit'] else 'BEYOND'} {jitter['limit']:g}"
        )
    rows = [
        ["estimator", f"{file.attribute('estimator')}, {file.dataset('basis').shape[1]} bases"],
        *_best(file.attribute("best_estimators")),
        ["charts", ", ".join(f"{name} of {count} patches" for name, count in file.attribute("charts").items())],
        *(_left_out(file, "leave_one_out", "left out patch by patch")),
        *(_left_out(file, "leave_one_chart_out", "left out chart by chart")),
        ["condition number of the responses", number(file.attribute("condition_number"))],
        ["noise amplification", number(file.attribute("noise_amplification"))],
        [f"change of the mean CIEDE2000 with all patches moved by {jitter['step_px']:g} superpixels", moved],
        ["light on the chart", light],
        ["patches with dirt, an edge or a shadow", ", ".join(uneven) or "none"],
        [
            "patches of which more than 5 % clips or is hot",
            ", ".join(f"{n} {s:.0%}" for n, s in clipped.items()) or "none",
        ],
    ]
    for chart, found in file.attribute("patches_found").items():
        rows.append([f"patches of {chart}", ", ".join(f"{key} {value:.3g}" for key, value in found.items())])
    return rows


def _left_out(file: store.Reader, way: str, words: str) -> list[list[str]]:
    """Return a row of errors for one way of leaving out; none where it was not done."""
    if f"{way}/rmse" not in file:
        return []
    parts = [f"{light} {_mean(file, way, f'delta_e_{light.lower()}')}" for light in file.attribute("lights")]
    return [[f"patches {words}, mean CIEDE2000 and spectral RMSE", ", ".join([*parts, _mean(file, way, "rmse")])]]


def _mean(file: store.Reader, way: str, name: str) -> str:
    return number(float(np.nanmean(file.read(f"{way}/{name}"))))


def _best(found: dict) -> list[list[str]]:
    """Return a row for the best estimator of each kind; its time stands in the table of all."""
    return [
        [f"best {kind} estimator", f"{best['estimator']}, {best['bases']} bases, score {number(best['score'])}"]
        for kind, best in found.items()
        if best is not None
    ]


def _verdicts(verdicts: list[dict]) -> str:
    rows = [
        [number(v[k]) if isinstance(v[k], float) else str(v[k]) for k in _VERDICTS[:-2]]
        + ["passes" if v["passes"] else "fails", v["source"] + ("" if v["verified"] else " (not verified)")]
        for v in verdicts
    ]
    note = (
        "<p>Recovered reflectances against the tolerances of whole chains: passing is necessary and not sufficient. "
        "Each in the guideline's own metric, D50.</p>"
    )
    return note + table(list(_VERDICTS), rows)
