"""Camera calibration and spectral recovery: equations (1) to (4)."""

import csv
import os
from pathlib import Path

import numpy as np
from scipy import stats

from irodori import store
from irodori.colour import delta_e_reflectance, goodness_of_fit, spectral_rmse, summary
from irodori.errors import InputError
from irodori.geometry.pinhole import samples_from_superpixels
from irodori.progress import LOGGER
from irodori.recovery import Calibration
from irodori.spectra import WAVELENGTH_NM, chart_spectra, spectrum

_TRIM = 0.1  # share of a patch's pixels left out at each end
_MAX_CONDITION = 1e5


def spectral_basis(spectra: np.ndarray, bases: int) -> np.ndarray:
    """Return the first principal vectors of measured spectra, without subtracting a mean [eq. 2].

    Parameters
    ----------
    spectra : (m, 61) float, Λ
    bases : int, 1..m

    Returns
    -------
    (61, bases) float64, orthonormal columns, the sum of each positive or zero
    """
    if not 1 <= bases <= min(spectra.shape):
        raise ValueError(f"{bases} bases; accepted: 1 to {min(spectra.shape)} for {len(spectra)} spectra")
    rows = np.linalg.svd(spectra, full_matrices=False)[2][:bases]
    return (rows * np.where(rows.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)).T


def calibrate(response: np.ndarray, spectra: np.ndarray, bases: int, light: np.ndarray) -> Calibration:
    """Solve equations (3) and (4).

    Parameters
    ----------
    response : (m, bands) float, P
    spectra : (m, 61) float, Λ
    bases : int
    light : (61,) float

    Raises
    ------
    ValueError
        If P has fewer patches than bands, a band without signal, or a condition number above 1e5.
    """
    response = np.asarray(response, dtype=np.float64)
    patches, bands = response.shape
    if patches < bands:
        raise ValueError(f"{patches} patches for {bands} bands; accepted: at least as many patches as bands")
    if not np.isfinite(response).all():
        raise ValueError("a response that is not finite; accepted: finite responses")
    peak = np.abs(response).max(axis=0)
    if not (peak > 0).all():
        raise ValueError(f"band {int(np.argmin(peak))} without any signal; accepted: bands that see the chart")
    condition = np.linalg.cond(response / peak)
    if condition > _MAX_CONDITION:
        raise ValueError(f"responses of condition number {condition:.3g} (bands or patches alike); accepted: 1e5")
    basis = spectral_basis(spectra, bases)
    weights = np.linalg.pinv(basis) @ spectra.T
    # Bands are scaled to a common size first, so that the pseudo-inverse cuts none of them off for its unit.
    weights_from_response = (np.linalg.pinv(response / peak) @ weights.T) / peak[:, None]
    return Calibration(basis, weights_from_response, np.asarray(light, dtype=np.float64))


def leave_one_out(response: np.ndarray, spectra: np.ndarray, bases: int, light: np.ndarray) -> np.ndarray:
    """Return each patch's spectrum recovered by a calibration on all the others, (m, 61)."""
    recovered = np.empty_like(spectra)
    for patch in range(len(spectra)):
        others = np.arange(len(spectra)) != patch
        recovered[patch] = calibrate(response[others], spectra[others], bases, light).spectra(response[patch])
    return recovered


def patch_centres(chart: dict) -> np.ndarray:
    """Return patch centres in superpixels by the perspective map that the four corner patches fix.

    Parameters
    ----------
    chart : dict
        ``rows``, ``columns`` and ``centres_px`` with first, row_end, column_end and last.

    Returns
    -------
    (rows * columns, 2) float64, x then y, row by row
    """
    rows, columns = chart["rows"], chart["columns"]
    grid = np.array([[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]], dtype=np.float64)
    image = np.array([chart["centres_px"][k] for k in ("first", "row_end", "column_end", "last")])
    equations, right = [], []
    for (u, v), (x, y) in zip(grid, image, strict=True):
        equations += [[u, v, 1, 0, 0, 0, -x * u, -x * v], [0, 0, 0, u, v, 1, -y * u, -y * v]]
        right += [x, y]
    h = np.append(np.linalg.solve(np.array(equations), np.array(right)), 1.0).reshape(3, 3)
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    mapped = np.stack([column.ravel(), row.ravel(), np.ones(rows * columns)], axis=1) @ h.T
    return mapped[:, :2] / mapped[:, 2:]


def read_chart(response: np.ndarray, valid: np.ndarray, chart: dict, file, sample_px: int = 2) -> np.ndarray:
    """Return the trimmed mean response of every patch, (patches, bands).

    Parameters
    ----------
    response : (height, width, bands) float
    valid : (height, width) bool
        What is not valid, clipped or hot, does not count.
    chart : dict
        Definition of the chart, in superpixels.
    file : path, for error messages
    sample_px : int
        Mosaic pixels along the side of a sample of the picture: 2 for superpixels, 1 at full resolution.

    Raises
    ------
    InputError
        If a patch lies outside the picture or most of it is not valid.
    """
    height, width = valid.shape
    half = chart["patch_px"] / sample_px
    means = []
    for number, (x, y) in enumerate(samples_from_superpixels(patch_centres(chart), sample_px)):
        x0, x1, y0, y1 = round(x - half), round(x + half), round(y - half), round(y + half)
        if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
            found = f"patch {number} at ({x:.0f}, {y:.0f})"
            raise InputError(file, "chart.centres_px", found, f"patches inside {width} x {height} samples")
        good = valid[y0:y1, x0:x1].astype(bool)
        if good.mean() < 0.5:
            found = f"patch {number} saturated over {1 - good.mean():.0%}"
            raise InputError(file, "exposure_s", found, "a chart exposed below saturation")
        means.append(stats.trim_mean(response[y0:y1, x0:x1][good], _TRIM, axis=0))
    return np.stack(means)


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
