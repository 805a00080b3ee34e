"""Calibration stage: computes a calibration and its errors from linear responses to charts and measured spectra."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from irodori.calibration.best_response import BestResponse, CameraSensitivities, Given
from irodori.calibration.charts import Charts
from irodori.calibration.conditioning import check_amplification, check_brightest, check_responses
from irodori.calibration.estimator_choice import KINDS, SelectionRow, best_of
from irodori.calibration.filter_table import DEPARTURES, read_filter
from irodori.calibration.gates import check_level, check_mean, check_patches, likelier_charts
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.solution import Solution, solve
from irodori.calibration.training import Training
from irodori.calibration.verdict import judge
from irodori.colour.colorimetry import delta_e_reflectance, goodness_of_fit, spectral_rmse, summary
from irodori.config.capture_table import FILTERS
from irodori.config.models import Camera
from irodori.config.parts import CalibratedCamera
from irodori.core import store
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.spectra.published import camera_sensitivities, lamp_error, light

_MAX_INVALID_SHARE = 0.05  # of a patch, beyond which the report names it


def calibrate_camera(
    linear,
    camera: Camera | CalibratedCamera,
    light_name: str,
    output,
    table,
    provenance: store.Provenance,
    *,
    light_error_percent: float | None = None,
    lights=("D65", "A"),
    selection=None,
) -> None:
    """Calibrate a camera from its chart and write the calibration and its cross-validation errors.

    Parameters
    ----------
    linear : path or sequence of paths
        Linear responses of the chart, or of all charts in the order of the definition.
    camera : Camera or CalibratedCamera
        Definition of the camera. Without a white reference, uneven light is estimated from each chart itself.
    light_name : str
        Spectrum of the light on the charts.
    light_error_percent : float, optional
        How far the light may differ from this spectrum; by default as `irodori.spectra.published.lamp_error` says.
    output : path of the HDF5 file
    table : path of the CSV of errors, one row for each patch; with several charts also with whole charts left out
    lights : sequence of str
        Lights for CIEDE2000.
    selection : path, optional
        CSV of the errors and cost of every estimator and number of bases; if absent, only the combinations that the
        configuration allows are computed. All its columns but the measured time are the same in every run.

    Raises
    ------
    InputError
        If a chart cannot be read, the error of single patches or the mean error of patches left out exceeds the
        configured limit, or the responses determine no calibration, or one that amplifies noise beyond the limit.
    """
    with threadpool_limits(1):  # small matrices, and the same sums whatever the threads
        charts = Charts.load(linear, camera)
        charts.check_levels()
        spectra = charts.spectra
        settings = camera.calibration
        known = charts.noise(settings.texel_photographs)
        training = Training(charts.responses(), spectra, light(light_name), known, given=_given(camera, charts))
        limit = settings.max_leave_one_out_error
        with _refusing(charts):
            check_responses(training.response, settings.max_condition, known.patch, charts.filters)
            check_brightest(training, charts.filters)
        check_patches(charts, training.response, limit, lights[0])
        likelier = likelier_charts(charts, training.response, lights[0])
        with _refusing(charts):
            solved = solve(training, settings, charts.filters, lights, selection is not None, charts.number)
        errors = {"leave_one_out": _errors(spectra, solved.recovered, lights)}
        if solved.recovered_by_chart is not None:
            errors["leave_one_chart_out"] = _errors(spectra, solved.recovered_by_chart, lights)
        check_mean(charts, errors["leave_one_out"][f"delta_e_{lights[0].lower()}"], limit, lights[0], likelier)
        # Checked last: with the spectra of another chart the amplification would mean nothing.
        with _refusing(charts):
            amplification = solved.numbers["noise_amplification"]
            check_amplification(amplification, settings.max_noise_amplification, solved.calibration)
        level = _level_beside_white(charts, training)
        if level.size:
            check_level(charts, level, settings.max_level_difference)
        checks = _checks(charts, training, solved, lights) | {"likelier_charts": likelier}
        checks |= {"response_model": _response_model(training.best_response)}
    lamp = lamp_error(light_name, light_error_percent)
    calibration = replace(solved.calibration, light_error=lamp, level=tuple(level.tolist()))
    _write_calibration(output, calibration, errors, solved.numbers | checks, provenance)
    _write_errors(table, charts.patches, errors)
    if selection is not None:
        write_selection(selection, solved.rows, solved.chosen)
    _log(replace(solved, calibration=calibration), errors, checks)


def _given(camera: Camera | CalibratedCamera, charts: Charts) -> Given:
    """Return the filter table and the sensitivities that the definition of a camera has beside its chart.

    Raises
    ------
    InputError
        If a filter is given and the chart was not photographed without and with it, or a table cannot be read.
    """
    table = sensitivities = None
    if (known := camera.comb_filter) is not None:
        if charts.filters != FILTERS:
            found = f"a filter, and photographs of the chart with filter {', '.join(charts.filters)}"
            accepted = f"photographs with filter {', '.join(FILTERS)}, or no comb_filter"
            raise InputError(charts.photographs[0].path, "comb_filter", found, accepted)
        table = read_filter(known.transmittance, known.name, known.shift_nm)
    if camera.sensitivities is not None:
        file = camera.sensitivities.file
        values = np.maximum(camera_sensitivities(file), 0.0)
        if not values.any(axis=1).all():
            raise InputError(file, "", "a band that sees nothing", "sensitivities of red, green and blue")
        sensitivities = CameraSensitivities(values, camera.sensitivities.error_percent / 100.0)
    return Given(table, sensitivities)


def _level_beside_white(charts: Charts, training: Training) -> np.ndarray:
    """Return the response of a perfect diffuser in each band, (bands,); empty without a white reference."""
    if any(photograph.light is not None for photograph in charts.photographs):
        return np.zeros(0)
    return training.best_response.mean.sum(axis=1) * training.scale


def _response_model(best: BestResponse) -> dict:
    """Return the response model's entry in the calibration file: its sources, and how the filter differs."""
    told = {
        "sources": list(best.sources),
        "ignored": {source: best.ignored_by(source) for source in best.ignored()},
        "log_evidence": {", ".join(sources): float(value) for sources, value in best.evidence.items()},
    }
    found = zip(DEPARTURES, best.filter.departures, best.filter.errors, strict=True) if best.filter else ()
    told["filter"] = {name: [float(value), float(error)] for name, value, error in found}
    return told


@contextmanager
def _refusing(charts: Charts) -> Iterator[None]:
    """Turn a ValueError about patches into an InputError that names the chart's file and key."""
    try:
        yield
    except ValueError as error:
        raise charts.refusal(error) from None


def _checks(charts: Charts, training: Training, solved: Solution, lights) -> dict:
    """Return the calibration file's attributes on charts, patches, light and the choice of the estimator."""
    each = list(zip(charts.captures, charts.photographs, charts.readings, strict=True))
    uneven = _of_all(each, lambda reading: reading.uneven)
    return {
        "lights": list(lights),
        "charts": dict(zip(charts.captures, np.bincount(charts.number).tolist(), strict=True)),
        "uneven_patches": [name for name, is_so in zip(charts.patches, uneven, strict=True) if is_so],
        "patches_found": {c: {k: float(v) for k, v in p.located.found.items()} for c, p, _ in each if p.located.found},
        "light_on_chart": "; ".join(dict.fromkeys(_light(photograph) for _, photograph, _ in each)),
        "verdicts": _verdicts(charts.spectra, solved.recovered),
        "best_estimators": {kind: best_of(solved.rows, names) for kind, names in KINDS.items()},
        "clipped_patches": _clipped(charts.patches, _of_all(each, lambda reading: reading.invalid_share)),
    }


def _errors(spectra: np.ndarray, estimate: np.ndarray, lights) -> dict[str, np.ndarray]:
    """Return spectral RMSE, GFC and CIEDE2000 under each light of every patch, by column; NaN where not judged."""
    judged = np.isfinite(estimate).all(axis=1)
    truth, found = spectra[judged], estimate[judged]
    values = {"spectral_rmse": spectral_rmse(truth, found), "gfc": goodness_of_fit(truth, found)}
    values |= {f"delta_e_{name.lower()}": delta_e_reflectance(truth, found, name) for name in lights}
    whole = {}
    for name, column in values.items():
        whole[name] = np.full(len(spectra), np.nan)
        whole[name][judged] = column
    return whole


def _of_all(each, value) -> np.ndarray:
    return np.concatenate([value(reading) for _, _, reading in each])


def _light(photograph) -> str:
    return photograph.light.reason if photograph.light else "evened by the white reference"


def _clipped(names, invalid_share) -> dict[str, float]:
    """Return {patch: share of invalid samples} of the patches with more than 5 % of them."""
    return {name: float(share) for name, share in zip(names, invalid_share, strict=True) if share > _MAX_INVALID_SHARE}


def _verdicts(spectra, estimate) -> list[dict]:
    return [
        {**vars(v.tolerance), "measured": float(v.measured), "passes": bool(v.passes)} for v in judge(spectra, estimate)
    ]


def _write_calibration(output, calibration: Calibration, errors: dict, numbers: dict, provenance) -> None:
    with store.create(output, provenance) as out:
        calibration.write(out)
        for way, columns in errors.items():
            out.write(f"{way}/rmse", columns["spectral_rmse"], units="1", dims="patch", quantity="spectral RMSE")
            for name in (name for name in columns if name.startswith("delta_e_")):
                quantity = f"CIEDE2000 under {name.removeprefix('delta_e_').upper()}"
                out.write(f"{way}/{name}", columns[name], units="1", dims="patch", quantity=quantity)
        for name, value in numbers.items():
            out.attribute(name, value)


@contextmanager
def _csv_writer(path) -> Iterator:
    """Open a writer of a CSV file, which gets its final name when it is complete."""
    with written_whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        yield csv.writer(stream)


def _write_errors(path, names, errors: dict[str, dict[str, np.ndarray]]) -> None:
    """Write the errors of patches left out; with several charts, columns ``_by_chart`` have whole charts left out."""
    columns = dict(errors["leave_one_out"])
    columns |= {f"{name}_by_chart": values for name, values in errors.get("leave_one_chart_out", {}).items()}
    with _csv_writer(path) as writer:
        writer.writerow(["patch", *columns])
        for i, name in enumerate(names):
            writer.writerow([name, *(f"{c[i]:.5f}" for c in columns.values())])
        for name, value in (("mean", np.nanmean), ("p95", lambda c: np.nanpercentile(c, 95)), ("max", np.nanmax)):
            writer.writerow([name, *(f"{value(c):.5f}" for c in columns.values())])


def write_selection(path, rows: list[SelectionRow], chosen: tuple[str, int]) -> None:
    """Write the cross-validation table: one row for each estimator, number of bases and kind of data left out.

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
    header = [
        "estimator",
        "bases",
        "left_out",
        "chosen",
        "score",
        *colour,
        "rmse_mean",
        "rmse_max",
        "multiply_adds_per_pixel",
    ]
    with _csv_writer(path) as writer:
        writer.writerow([*header, "evaluation_ns_per_pixel"])
        for r in rows:
            errors = [getattr(r, f"delta_e_{part}")[light] for light in lights for part in parts]
            numbers = [r.score, *errors, r.rmse_mean, r.rmse_max]
            selected = int((r.estimator, r.bases) == chosen)
            cost = [r.multiply_adds, f"{r.ns_per_pixel:.1f}"]
            writer.writerow([r.estimator, r.bases, r.left_out, selected, *(f"{n:.5f}" for n in numbers), *cost])


def _log(solved: Solution, errors: dict, checks: dict) -> None:
    calibration = solved.calibration
    bands, bases = calibration.band_scale().size, calibration.basis.shape[1]
    for way, columns in errors.items():
        rmse = columns["spectral_rmse"]
        text = "%s, %s, %d bands, %d bases: spectral RMSE mean %.4f max %.4f"
        left_out = way.replace("_", " ")
        LOGGER.info(text, calibration.estimator, left_out, bands, bases, np.nanmean(rmse), np.nanmax(rmse))
        for name in (name for name in columns if name.startswith("delta_e_")):
            s = summary(columns[name][np.isfinite(columns[name])])
            light_name = name.removeprefix("delta_e_").upper()
            LOGGER.info("CIEDE2000 under %s: mean %.2f p95 %.2f max %.2f", light_name, s["mean"], s["p95"], s["max"])
    LOGGER.info("condition number %.4g, noise amplification %.4g", *solved.numbers.values())
    LOGGER.info("light on the chart: %s", checks["light_on_chart"])
    if level := solved.calibration.level:
        LOGGER.info("level beside the white reference: %s", " ".join(f"{value:.3f}" for value in level))
    _log_response_model(checks["response_model"])
    for field, name in checks["likelier_charts"].items():
        LOGGER.warning("%s: the photograph agrees clearly better with the spectra of %s", field, name)
    for name in checks["uneven_patches"]:
        LOGGER.warning("patch %s: dirt, an edge or a shadow", name)
    for name, share in checks["clipped_patches"].items():
        LOGGER.warning(
            "patch %s: %.0f %% of its samples clip or are hot; where they clip, the rest is too dark", name, 100 * share
        )


def _log_response_model(told: dict) -> None:
    LOGGER.info("response model from: %s", ", ".join(told["sources"]))
    if told["filter"]:
        words = "the filter beside its table: shift %.2f +- %.2f nm, %.2f +- %.2f nm more 150 nm further"
        LOGGER.info(words, *told["filter"]["shift_nm"], *told["filter"]["tilt_nm"])
    for source, nats in told["ignored"].items():
        LOGGER.warning("%s not used: the chart is e^%.0f times likelier without it; is it this camera's?", source, nats)
