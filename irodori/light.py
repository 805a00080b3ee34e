"""Light from all directions, as it stands in an environment's file and as the renderer wants it.

Equirectangular: rows are the angle from the zenith (+z), columns the azimuth from +x towards +y, both at pixel
centres. Radiance is relative: 1 is a perfect diffuser lit at normal incidence by the rig's light.
"""

from dataclasses import dataclass

import numba
import numpy as np

from irodori import store
from irodori.coefficients import read_coefficients, write_coefficients

_LARGEST_BLOCK = 4  # pixels along each side that share one test against the horizon
_BLOCK_ROWS = 128  # blocks from the zenith down, at least, where the picture has as many


@dataclass(frozen=True)
class Environment:
    """Spectral light on a basis.

    Parameters
    ----------
    coefficients : (height, width, k) float32
    basis : (61, k) float
        L(λ) = basis @ coefficients.
    irradiance : (h, w, k) float32
        I_d of equation (8) for normals on the same kind of grid, on the same basis.
    """

    coefficients: np.ndarray
    basis: np.ndarray
    irradiance: np.ndarray

    def save(
        self,
        path,
        provenance: store.Provenance,
        errors: dict | None = None,
        *,
        storage: str = "single",
        codec: str = "gzip",
    ) -> None:
        """Write an environment's file; ``storage`` and ``codec`` are those of `irodori.coefficients`."""
        with store.create(path, provenance) as out:
            write_coefficients(
                out,
                "coefficients",
                self.coefficients,
                quantity="coefficients of the radiance",
                storage=storage,
                codec=codec,
            )
            out.write("basis", self.basis, units="1", dims="wavelength,basis", quantity="spectral basis of the light")
            out.write(
                "irradiance",
                self.irradiance,
                units="sr",
                dims="row,column,basis",
                quantity="coefficients of the irradiance map",
            )
            out.attribute("errors", errors or {})

    @classmethod
    def load(cls, path) -> "Environment":
        """Read an environment's file."""
        with store.open_file(path) as file:
            return cls(read_coefficients(file, "coefficients"), file.read("basis"), file.read("irradiance"))

    def upward_white(self) -> np.ndarray:
        """Return the radiance of a perfect diffuser that faces up, (61,): the scene's white."""
        return self.basis @ self.irradiance[0].astype(np.float64).mean(axis=0) / np.pi


def directions(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit vector (height, width, 3) and the solid angle in sr (height, width) of every pixel.

    Solid angles are exact: the difference of the cosines of a row's edges times its width in azimuth.
    """
    edges = np.linspace(0.0, np.pi, height + 1)
    theta = 0.5 * (edges[1:] + edges[:-1])
    azimuth = 2 * np.pi * (np.arange(width) + 0.5) / width
    unit = np.stack(
        [
            np.outer(np.sin(theta), np.cos(azimuth)),
            np.outer(np.sin(theta), np.sin(azimuth)),
            np.repeat(np.cos(theta)[:, None], width, axis=1),
        ],
        axis=-1,
    )
    solid_angle = np.repeat((np.cos(edges[:-1]) - np.cos(edges[1:]))[:, None], width, axis=1) * (2 * np.pi / width)
    return unit, solid_angle


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
