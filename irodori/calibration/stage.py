"""The stage: from a chart's linear responses and measured spectra to a calibration and its errors."""

import csv
import os
from pathlib import Path

import numpy as np

from irodori import store
from irodori.calibration.chart import read_chart
from irodori.calibration.linear import calibrate, leave_one_out
from irodori.colour import delta_e_reflectance, goodness_of_fit, spectral_rmse, summary
from irodori.errors import InputError
from irodori.progress import LOGGER
from irodori.recovery import Calibration
from irodori.spectra import WAVELENGTH_NM, chart_spectra, spectrum


def calibrate_camera(
    linear, camera: dict, light_name: str, output, table, provenance: store.Provenance, lights=("D65", "A")
) -> None:
    """Calibrate a camera from its chart and write the calibration and its leave-one-patch-out errors.

    Parameters
    ----------
    linear : path
        Linear responses of the chart.
    camera : dict
        Definition of the camera.
    light_name : str
        Spectrum of the light on the chart.
    output : path of the HDF5 file
    table : path of the CSV of errors, one row a patch
    lights : sequence of str
        Lights for CIEDE2000.
    """
    names, spectra = chart_spectra(camera["chart"]["spectra"])
    patches = _chart_responses(linear, camera["chart"], len(names))
    light, bases = spectrum(light_name), camera["calibration"]["bases"]
    try:
        calibration = calibrate(patches, spectra, bases, light)
        recovered = leave_one_out(patches, spectra, bases, light)
    except ValueError as error:
        raise InputError(linear, "chart", str(error), "a chart that determines every band") from None
    rmse, gfc = spectral_rmse(spectra, recovered), goodness_of_fit(spectra, recovered)
    delta_e = {name: delta_e_reflectance(spectra, recovered, name) for name in lights}
    with store.open_file(linear) as file:
        filters = file.attribute("filters")
    _write_calibration(output, calibration, filters, patches, rmse, delta_e, provenance)
    _write_errors(table, names, rmse, gfc, delta_e)
    mean, largest = rmse.mean(), rmse.max()
    LOGGER.info(
        "leave-one-patch-out, %d bands, %d bases: spectral RMSE mean %.4f max %.4f",
        patches.shape[1],
        bases,
        mean,
        largest,
    )
    for name, values in delta_e.items():
        s = summary(values)
        LOGGER.info("CIEDE2000 under %s: mean %.2f p95 %.2f max %.2f", name, s["mean"], s["p95"], s["max"])


def _chart_responses(linear, chart: dict, count: int) -> np.ndarray:
    """Return the chart's responses as if lit at normal incidence, (patches, bands)."""
    if count != chart["rows"] * chart["columns"]:
        found = f"{count} spectra for {chart['rows']} x {chart['columns']} patches"
        raise InputError(chart["spectra"], "chart", found, "one spectrum a patch, row by row")
    with store.open_file(linear) as file:
        response, valid = file.read("response"), file.read("valid")
        light_deg, _, tilt_deg, _ = file.attribute("pose_deg")
        sample_px = file.attribute("sample_px")
    return read_chart(response, valid, chart, linear, sample_px) / np.cos(np.radians(light_deg - tilt_deg))


def _write_calibration(output, calibration: Calibration, filters, patches, rmse, delta_e: dict, provenance) -> None:
    with store.create(output, provenance) as out:
        out.write("wavelength", WAVELENGTH_NM, units="nm", dims="wavelength", quantity="wavelength")
        out.write("basis", calibration.basis, units="1", dims="wavelength,basis", quantity="spectral basis B'")
        matrix = calibration.weights_from_response
        out.write("weights_from_response", matrix, units="1", dims="band,basis", quantity="matrix M of equation (4)")
        out.write("light", calibration.light, units="1", dims="wavelength", quantity="relative power of the light")
        out.write("chart_response", patches, units="1", dims="patch,band", quantity="responses P of the chart")
        out.write("leave_one_out/rmse", rmse, units="1", dims="patch", quantity="spectral RMSE")
        for name, values in delta_e.items():
            label = f"leave_one_out/delta_e_{name.lower()}"
            out.write(label, values, units="1", dims="patch", quantity=f"CIEDE2000 under {name}")
        out.attribute("filters", filters)
        out.attribute("condition_number", float(np.linalg.cond(patches / np.abs(patches).max(axis=0))))


def _write_errors(path, names, rmse, gfc, delta_e: dict) -> None:
    path = Path(path)
    temporary = path.with_name(f".{path.name}.part")
    with temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["patch", "spectral_rmse", "gfc", *(f"delta_e_{n.lower()}" for n in delta_e)])
        columns = [rmse, gfc, *delta_e.values()]
        for i, name in enumerate(names):
            writer.writerow([name, *(f"{c[i]:.5f}" for c in columns)])
        writer.writerow(["mean", *(f"{np.mean(c):.5f}" for c in columns)])
        writer.writerow(["p95", *(f"{np.percentile(c, 95):.5f}" for c in columns)])
        writer.writerow(["max", *(f"{np.max(c):.5f}" for c in columns)])
    os.replace(temporary, path)
