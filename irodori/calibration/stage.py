"""The stage: from a chart's linear responses and measured spectra to a calibration and its errors."""

import csv
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from irodori import store
from irodori.calibration.jitter import LIMIT, STEP_PX
from irodori.calibration.order import check_order
from irodori.calibration.reading import ChartPhotograph
from irodori.calibration.selection import KINDS, SelectionRow, best_of
from irodori.calibration.solution import Solution, error_of_unseen, solve
from irodori.calibration.training import Noise, Training
from irodori.calibration.verdict import judge
from irodori.colour import delta_e_reflectance, goodness_of_fit, spectral_rmse, summary
from irodori.errors import InputError
from irodori.progress import LOGGER
from irodori.recovery import Calibration
from irodori.spectra import WAVELENGTH_NM, chart_spectra, light

_MAX_INVALID_SHARE = 0.05  # of a patch, beyond which the report names it


def calibrate_camera(
    linear,
    camera: dict,
    light_name: str,
    output,
    table,
    provenance: store.Provenance,
    lights=("D65", "A"),
    selection=None,
    noise: Noise | None = None,
) -> None:
    """Calibrate a camera from its chart and write the calibration and its cross-validation errors.

    Parameters
    ----------
    linear : path
        Linear responses of the chart.
    camera : dict
        Definition of the camera: blocks ``chart`` and ``calibration``. Where no white reference has evened the light,
        it is told from the chart itself.
    light_name : str
        Spectrum of the light on the chart.
    output : path of the HDF5 file
    table : path of the CSV of errors, one row a patch
    lights : sequence of str
        Lights for CIEDE2000.
    selection : path, optional
        CSV of the errors and cost of every estimator and number of bases; where absent, only what the configuration
        leaves open is computed. All its columns but the measured time are the same from run to run.
    noise : Noise, optional
        Of patch means and pixels; where absent, what the photograph tells.

    Raises
    ------
    InputError
        If the chart cannot be read, or the responses determine no calibration, or one that amplifies noise beyond the
        configured limit.
    """
    names, spectra = chart_spectra(camera["chart"]["spectra"])
    photograph = ChartPhotograph.load(linear, camera["chart"], len(names))

    reading = photograph.read()
    noise = photograph.noise(reading) if noise is None else noise
    training = Training(photograph.responses(reading), spectra, light(light_name), noise)
    try:
        check_order(training.response, spectra, camera["chart"]["rows"], camera["chart"]["columns"])
        solved = solve(training, camera["calibration"], photograph.filters, lights, timed=selection is not None)
    except ValueError as error:
        raise InputError(linear, "chart", str(error), "a chart that determines every band") from None

    def error_of(responses: np.ndarray) -> float:
        return error_of_unseen(replace(training, response=responses), solved.chosen, lights[0])

    estimate = solved.recovered
    rmse, gfc = spectral_rmse(spectra, estimate), goodness_of_fit(spectra, estimate)
    delta_e = {name: delta_e_reflectance(spectra, estimate, name) for name in lights}
    checks = {
        "uneven_patches": [name for name, uneven in zip(names, reading.uneven, strict=True) if uneven],
        "patches_found": {key: float(value) for key, value in photograph.located.found.items()},
        "light_on_chart": photograph.light.reason if photograph.light else "evened by the white reference",
        "jitter": _jitter(photograph, error_of),
        "verdicts": _verdicts(spectra, estimate),
        "best_estimators": {kind: best_of(solved.rows, names) for kind, names in KINDS.items()},
        "clipped_patches": _clipped(names, reading.invalid_share),
    }
    _write_calibration(output, solved.calibration, rmse, delta_e, solved.numbers | checks, provenance)
    _write_errors(table, names, rmse, gfc, delta_e)
    if selection is not None:
        write_selection(selection, solved.rows, solved.chosen)
    _log(solved, rmse, delta_e, checks)


def _jitter(photograph: ChartPhotograph, error) -> dict[str, float]:
    """Return what the mean CIEDE2000 does as the patches are moved; NaN where a moved patch leaves the picture."""
    try:
        found = photograph.jitter(error)
    except InputError as refused:
        LOGGER.warning("the patches cannot be moved for the jitter test: %s", refused)
        return {"step_px": STEP_PX, "in_place": math.nan, "worst": math.nan, "limit": LIMIT}
    return {"step_px": found.step_px, "in_place": found.in_place, "worst": found.worst, "limit": found.limit}


def _clipped(names, invalid_share) -> dict[str, float]:
    """Return the patches of which more than a little is left out, with the share."""
    return {name: float(share) for name, share in zip(names, invalid_share, strict=True) if share > _MAX_INVALID_SHARE}


def _verdicts(spectra, estimate) -> list[dict]:
    return [
        {**vars(v.tolerance), "measured": float(v.measured), "passes": bool(v.passes)} for v in judge(spectra, estimate)
    ]


def _write_calibration(output, calibration: Calibration, rmse, delta_e: dict, numbers: dict, provenance) -> None:
    with store.create(output, provenance) as out:
        out.write("wavelength", WAVELENGTH_NM, units="nm", dims="wavelength", quantity="wavelength")
        calibration.write(out)
        out.write("leave_one_out/rmse", rmse, units="1", dims="patch", quantity="spectral RMSE")
        for name, values in delta_e.items():
            label = f"leave_one_out/delta_e_{name.lower()}"
            out.write(label, values, units="1", dims="patch", quantity=f"CIEDE2000 under {name}")
        for name, value in numbers.items():
            out.attribute(name, value)


@contextmanager
def _csv_writer(path) -> Iterator:
    """Open a CSV that takes its name when it is complete."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.part")
    with temporary.open("w", newline="", encoding="utf-8") as stream:
        yield csv.writer(stream)
    os.replace(temporary, path)


def _write_errors(path, names, rmse, gfc, delta_e: dict) -> None:
    with _csv_writer(path) as writer:
        writer.writerow(["patch", "spectral_rmse", "gfc", *(f"delta_e_{n.lower()}" for n in delta_e)])
        columns = [rmse, gfc, *delta_e.values()]
        for i, name in enumerate(names):
            writer.writerow([name, *(f"{c[i]:.5f}" for c in columns)])
        writer.writerow(["mean", *(f"{np.mean(c):.5f}" for c in columns)])
        writer.writerow(["p95", *(f"{np.percentile(c, 95):.5f}" for c in columns)])
        writer.writerow(["max", *(f"{np.max(c):.5f}" for c in columns)])


def write_selection(path, rows: list[SelectionRow], chosen: tuple[str, int]) -> None:
    """Write the table of cross-validation, one row an estimator and number of bases.

    Parameters
    ----------
    path : path
    rows : list of SelectionRow
    chosen : (str, int)
        Estimator and number of bases of the calibration.
    """
    lights = list(rows[0].delta_e_mean)
    parts = ("mean", "p95", "max")
    colour = [f"delta_e_{light.lower()}_{part}" for light in lights for part in parts]
    header = ["estimator", "bases", "chosen", "score", *colour, "rmse_mean", "rmse_max", "multiply_adds_per_pixel"]
    with _csv_writer(path) as writer:
        writer.writerow([*header, "evaluation_ns_per_pixel"])
        for r in rows:
            errors = [getattr(r, f"delta_e_{part}")[light] for light in lights for part in parts]
            numbers = [r.score, *errors, r.rmse_mean, r.rmse_max]
            selected = int((r.estimator, r.bases) == chosen)
            cost = [r.multiply_adds, f"{r.ns_per_pixel:.1f}"]
            writer.writerow([r.estimator, r.bases, selected, *(f"{n:.5f}" for n in numbers), *cost])


def _log(solved: Solution, rmse, delta_e: dict, checks: dict) -> None:
    calibration = solved.calibration
    bands, bases = calibration.training.shape[1], calibration.basis.shape[1]
    mean, largest = rmse.mean(), rmse.max()
    text = "%s, cross-validation, %d bands, %d bases: spectral RMSE mean %.4f max %.4f"
    LOGGER.info(text, calibration.estimator, bands, bases, mean, largest)
    for name, values in delta_e.items():
        s = summary(values)
        LOGGER.info("CIEDE2000 under %s: mean %.2f p95 %.2f max %.2f", name, s["mean"], s["p95"], s["max"])
    LOGGER.info("condition number %.4g, noise amplification %.4g", *solved.numbers.values())
    LOGGER.info("light on the chart: %s", checks["light_on_chart"])
    moved = checks["jitter"]
    LOGGER.info("patches moved by %g superpixels: CIEDE2000 changes by %.3f", moved["step_px"], moved["worst"])
    if moved["worst"] > moved["limit"]:
        LOGGER.warning("that is more than %g: larger patches, or smaller squares in them, would help", moved["limit"])
    for name in checks["uneven_patches"]:
        LOGGER.warning("patch %s: dirt, an edge or a shadow", name)
    for name, share in checks["clipped_patches"].items():
        LOGGER.warning(
            "patch %s: %.0f %% of its samples clip or are hot; where they clip, the rest is too dark", name, 100 * share
        )
