"""From an omnidirectional picture to compressed light and its irradiance map: equations (4) and (8)."""

import numba
import numpy as np

from irodori import store
from irodori.calibration import Calibration
from irodori.colour import xyz_from_radiance
from irodori.errors import InputError
from irodori.light import Environment, directions
from irodori.principal import compress
from irodori.progress import LOGGER

_LARGEST_BLOCK = 4  # pixels along each side that share one test against the horizon
_BLOCK_ROWS = 128  # blocks from the zenith down, at least, where the picture has as many


def _blocks(values: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Return sums over blocks of a picture, (height, width, ...) to (rows, columns, ...), any sizes."""
    row_edges = np.arange(rows) * values.shape[0] // rows
    column_edges = np.arange(columns) * values.shape[1] // columns
    return np.add.reduceat(np.add.reduceat(values, row_edges, axis=0), column_edges, axis=1)


@numba.njit(cache=True, parallel=True, nogil=True)
def _irradiance(normals, centres, moments, out):
    count = centres.shape[0]
    bases = moments.shape[1]
    for i in numba.prange(normals.shape[0]):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        total = np.zeros(bases)
        for j in range(count):
            if nx * centres[j, 0] + ny * centres[j, 1] + nz * centres[j, 2] <= 0.0:
                continue
            for b in range(bases):
                total[b] += nx * moments[j, b, 0] + ny * moments[j, b, 1] + nz * moments[j, b, 2]
        for b in range(bases):
            out[i, b] = total[b]


def irradiance_map(coefficients: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the irradiance map I_d of equation (8) on the coefficients.

    A block of pixels on one side of the horizon gives N · Σ L ω dΩ exactly; only blocks that the horizon cuts are
    approximated, by their centre.

    Parameters
    ----------
    coefficients : (H, W, k) float
        Radiance, equirectangular.
    width, height : int
        Size of the map over the normals.

    Returns
    -------
    (height, width, k) float32, radiance unit times sr
    """
    unit, solid_angle = directions(coefficients.shape[1], coefficients.shape[0])
    block = min(max(coefficients.shape[0] // _BLOCK_ROWS, 1), _LARGEST_BLOCK)
    rows, columns = coefficients.shape[0] // block, max(1, coefficients.shape[1] // block)
    weighted = unit * solid_angle[..., None]
    moments = np.stack(
        [_blocks(coefficients * weighted[..., a : a + 1], rows, columns) for a in range(3)], axis=-1
    ).reshape(rows * columns, -1, 3)
    centres = _blocks(weighted, rows, columns).reshape(-1, 3)
    normals = directions(width, height)[0].reshape(-1, 3)
    out = np.empty((len(normals), coefficients.shape[2]), dtype=np.float32)
    _irradiance(normals, np.ascontiguousarray(centres), np.ascontiguousarray(moments, dtype=np.float64), out)
    return out.reshape(height, width, -1)


def prepare_environment(
    linear,
    calibration_file,
    output,
    target_mean: float,
    align: int,
    irradiance_size: dict,
    provenance: store.Provenance,
) -> None:
    """Write an environment's file from the linear responses of its omnidirectional picture.

    The camera was calibrated on reflectances under the rig's light E; a radiance is recovered as E(λ) times the
    reflectance that would have given the same responses.

    Raises
    ------
    InputError
        If a pixel is saturated in every bracket.
    """
    with store.open_file(linear) as file:
        response, valid = file.read("response"), file.read("valid").astype(bool)
    if not valid.all():
        raise InputError(
            linear,
            "exposure_s",
            f"{int((~valid).sum())} pixels saturated in every bracket",
            "a shorter bracket of the environment",
        )
    calibration = Calibration.load(calibration_file)
    height, width = valid.shape
    weights = calibration.weights(response).reshape(height * width, -1)
    basis = calibration.basis * calibration.light[:, None]
    # The colour of the light is judged against the rig's light as white.
    matrix = xyz_from_radiance(calibration.light)
    observers = {"light": (matrix, matrix @ calibration.light)}
    compressed = compress(weights, basis, observers, target_mean, align)
    coefficients = compressed.coefficients.reshape(height, width, -1)
    irradiance = irradiance_map(coefficients, irradiance_size["width"], irradiance_size["height"])
    errors = {"delta_e": compressed.errors, "negative_fraction": compressed.negative_fraction}
    Environment(coefficients, compressed.basis, irradiance).save(output, provenance, errors)
    LOGGER.info(
        "%d bases of %d; CIEDE2000 of the compression mean %.3f p99 %.3f; negative samples %.2f %%",
        compressed.basis.shape[1],
        basis.shape[1],
        compressed.errors["light"]["mean"],
        compressed.errors["light"]["p99"],
        100 * compressed.negative_fraction,
    )
