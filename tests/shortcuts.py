"""Compositions of the package's functions that tests of several folders need and the chain does not."""

import numpy as np
from lathe import lathe

from irodori.calibration.chart import locate_patches, read_located
from irodori.calibration.chart_reading import ChartReading
from irodori.calibration.paper_estimator import calibrate
from irodori.capture.shot_planner.fisher_information import Observations
from irodori.ingest.registration.similarity import Registration
from irodori.light.environment_file import directions
from irodori.light.irradiance import Integrator


def ball(radius_mm: float, rings: int, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Return corners and UV of a sphere of triangles, its texture that of a sphere of `irodori.geometry.shapes`."""
    polar = np.linspace(np.pi, 0.0, rings + 1)
    radius = radius_mm * np.sin(polar)
    radius[[0, -1]] = 0.0  # both poles on the axis, which rounding leaves beside it
    return lathe(np.stack([radius, radius_mm * np.cos(polar)], axis=1), segments)


def irradiance_map(coefficients: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the irradiance map of equation (8), (height, width, k) float32, of radiance (H, W, k)."""
    return Integrator(coefficients)(directions(width, height)[0]).astype(np.float32)


def leave_one_out(response: np.ndarray, spectra: np.ndarray, bases: int, light: np.ndarray) -> np.ndarray:
    """Return each patch's spectrum recovered by the paper's calibration on all the others, (m, 61)."""
    recovered = np.empty_like(spectra)
    for patch in range(len(spectra)):
        others = np.arange(len(spectra)) != patch
        recovered[patch] = calibrate(response[others], spectra[others], bases, light).spectra(response[patch])
    return recovered


def read_patches(response: np.ndarray, valid: np.ndarray, chart: dict, file, sample_px: int = 2) -> ChartReading:
    """Locate the patches of a chart and return their statistics."""
    return read_located(response, valid, locate_patches(response, valid, chart, file, sample_px), file, sample_px)


def moving_from_fixed(registration: Registration, xy) -> np.ndarray:
    """Return where places of the fixed picture lie in the moving one, (..., 2) to (..., 2), superpixels."""
    matrix = registration.affine()
    return np.asarray(xy, dtype=np.float64) @ matrix[:, :2].T + matrix[:, 2]


def information(observations: Observations) -> np.ndarray:
    """Return the Fisher information about (ln α, ln β, ln μ) of independent photographs together, (cases, 3, 3)."""
    rows = observations.scaled()
    return np.einsum("pci,pcj->cij", rows, rows)
