"""The stage: from a chart's linear responses and measured spectra to a calibration and its errors."""

import csv
import os
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from irodori import store
from irodori.calibration.chart import read_chart
from irodori.calibration.estimators import ESTIMATORS, fit
from irodori.calibration.numerics import (
    Limits,
    check_amplification,
    check_brightest,
    check_responses,
    condition_number,
    noise_amplification,
)
from irodori.calibration.selection import BASES, SelectionRow, choose, cross_validate
from irodori.calibration.training import Noise, Training
from irodori.colour import delta_e_reflectance, goodness_of_fit, spectral_rmse, summary
from irodori.errors import InputError
from irodori.progress import LOGGER
from irodori.recovery import Calibration
from irodori.spectra import WAVELENGTH_NM, chart_spectra, spectrum

_AUTO = "auto"


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
        Definition of the camera: blocks ``chart`` and ``calibration``.
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
        Of patch means and pixels; where absent, that of the noise model in ``linear``, if it has one.

    Raises
    ------
    InputError
        If the responses determine no calibration, or one that amplifies noise beyond the configured limit.
    """
    names, spectra = chart_spectra(camera["chart"]["spectra"])
    patches, found_noise, filters = _read_chart(linear, camera["chart"], len(names))
    training = Training(patches, spectra, spectrum(light_name), found_noise if noise is None else noise)
    try:
        solved = _solve(training, camera["calibration"], filters, lights, timed=selection is not None)
    except ValueError as error:
        raise InputError(linear, "chart", str(error), "a chart that determines every band") from None
    estimate = solved.recovered
    rmse, gfc = spectral_rmse(spectra, estimate), goodness_of_fit(spectra, estimate)
    delta_e = {light: delta_e_reflectance(spectra, estimate, light) for light in lights}
    _write_calibration(output, solved.calibration, rmse, delta_e, solved.numbers, provenance)
    _write_errors(table, names, rmse, gfc, delta_e)
    if selection is not None:
        write_selection(selection, solved.rows, solved.chosen)
    _log(solved.calibration, rmse, delta_e, solved.numbers)


@dataclass(frozen=True)
class _Solved:
    """A calibration, the table it was chosen from, and the spectra it recovers of patches left out."""

    calibration: Calibration
    rows: list[SelectionRow]
    chosen: tuple[str, int]
    recovered: np.ndarray
    numbers: dict[str, float]


def _solve(training: Training, settings: dict, filters: tuple[str, ...], lights, timed: bool) -> _Solved:
    """Check the chart, judge, choose and fit; ValueError says what is wrong."""
    limits = Limits(
        settings.get("max_condition", Limits.condition),
        settings.get("max_noise_amplification", Limits.noise_amplification),
    )
    check_responses(training.response, limits.condition, training.noise.patch, filters)
    check_brightest(training, filters)
    rows, recovered = _judge(training, settings, lights, timed)
    chosen = choose(rows, settings["estimator"], settings["bases"])
    calibration = replace(
        fit(chosen[0], training, chosen[1], limits.condition),
        filters=filters,
        relative_error=_relative_error(training, recovered[chosen]),
    )
    amplification = noise_amplification(calibration)
    check_amplification(amplification, limits.noise_amplification, calibration)
    numbers = {"condition_number": condition_number(training.response), "noise_amplification": amplification}
    return _Solved(calibration, rows, chosen, recovered[chosen], numbers)


def _judge(training: Training, settings: dict, lights, timed: bool):
    """Return the table of estimators and bases, whole where it is written or the choice is open."""
    estimator, bases = settings["estimator"], settings["bases"]
    if estimator not in (_AUTO, *ESTIMATORS):
        raise ValueError(f"unknown estimator {estimator!r}; accepted: {_AUTO}, {', '.join(ESTIMATORS)}")
    counts = BASES if timed or bases == _AUTO else ()
    counts = sorted({*counts, *(() if bases == _AUTO else (bases,))})
    names = tuple(ESTIMATORS) if timed or estimator == _AUTO else (estimator,)
    rows, recovered = cross_validate(training, lights, bases=counts, timed=timed, estimators=names)
    if bases != _AUTO and not any(row.bases == bases for row in rows):
        accepted = max((row.bases for row in rows), default=0)
        raise ValueError(f"{bases} bases of {len(training.spectra)} patches; accepted: up to {accepted}")
    return rows, recovered


def _relative_error(training: Training, recovered: np.ndarray) -> float:
    """Return the rms error of unseen patches over the rms length of their scaled responses."""
    squared = np.mean((recovered - training.spectra) ** 2)
    return float(np.sqrt(squared / np.mean((training.scaled**2).sum(axis=1))))


def _read_chart(linear, chart: dict, count: int) -> tuple[np.ndarray, Noise, tuple[str, ...]]:
    """Return the chart's responses as if lit at normal incidence, (patches, bands), their noise and the filters."""
    if count != chart["rows"] * chart["columns"]:
        found = f"{count} spectra for {chart['rows']} x {chart['columns']} patches"
        raise InputError(chart["spectra"], "chart", found, "one spectrum a patch, row by row")
    with store.open_file(linear) as file:
        response, valid = file.read("response"), file.read("valid")
        light_deg, _, tilt_deg, _ = file.attribute("pose_deg")
        sample_px = file.attribute("sample_px")
        model = file.read("noise_model") if "noise_model" in file else None
        filters = tuple(file.attribute("filters"))
    patches = read_chart(response, valid, chart, linear, sample_px)
    cosine = np.cos(np.radians(light_deg - tilt_deg))
    noise = Noise()
    if model is not None and np.isfinite(model).all():
        # At the chart's mean level: an estimator knows one noise, that of a picture's typical pixel.
        pixel = np.maximum(model[:, 0] + model[:, 1] * patches.mean(axis=0), 0.0) / cosine**2
        noise = Noise(pixel / (2 * chart["patch_px"] / sample_px) ** 2, pixel)
    return patches / cosine, noise, filters


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
def _csv_writer(path):
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


def _log(calibration: Calibration, rmse, delta_e: dict, numbers: dict) -> None:
    bands, bases = calibration.training.shape[1], calibration.basis.shape[1]
    mean, largest = rmse.mean(), rmse.max()
    name = calibration.estimator
    text = "%s, cross-validation, %d bands, %d bases: spectral RMSE mean %.4f max %.4f"
    LOGGER.info(text, name, bands, bases, mean, largest)
    for light, values in delta_e.items():
        s = summary(values)
        LOGGER.info("CIEDE2000 under %s: mean %.2f p95 %.2f max %.2f", light, s["mean"], s["p95"], s["max"])
    LOGGER.info("condition number %.4g, noise amplification %.4g", *numbers.values())
