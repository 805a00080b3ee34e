"""Cells of the sphere, for light from all directions that may be turned about the vertical axis.

The cells are rows by polar angle and columns by azimuth, in the order of a picture, so that a rotation shifts light
along the rows.
"""

from functools import cache

import numpy as np

from irodori.geometry.rig_frame import rotation_z
from irodori.light.environment_file import directions

ROWS, COLUMNS = 32, 64
CELLS = ROWS * COLUMNS
#: Directions in a cell among which texels take turns, so that the edges of shadows have no steps.
POOL = 8


@cache
def cell_directions() -> np.ndarray:
    """Return the directions of each cell, (cells, pool, 3) unit: places of a shifted lattice in the cell."""
    number = np.arange(POOL)
    u, v = (number + 0.5) / POOL, (number * 0.6180339887498949 + 0.31) % 1.0
    cosine = np.cos(np.pi * np.arange(ROWS + 1) / ROWS)
    z = cosine[:-1, None] + (cosine[1:] - cosine[:-1])[:, None] * u
    azimuth = 2.0 * np.pi * (np.arange(COLUMNS)[:, None] + v) / COLUMNS
    sine = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    parts = (
        sine[:, None] * np.cos(azimuth),
        sine[:, None] * np.sin(azimuth),
        np.broadcast_to(z[:, None], (ROWS, COLUMNS, POOL)),
    )
    return np.ascontiguousarray(np.stack(parts, axis=-1).reshape(CELLS, POOL, 3))


@cache
def cell_vectors() -> np.ndarray:
    """Return the integral of the direction over each cell, (cells, 3) sr."""
    rows, columns = 8 * ROWS, 8 * COLUMNS
    unit, solid_angle = directions(columns, rows)
    parts = (unit * solid_angle[..., None]).reshape(ROWS, 8, COLUMNS, 8, 3)
    return parts.sum(axis=(1, 3)).reshape(CELLS, 3)


def cell_of(unit: np.ndarray) -> np.ndarray:
    """Return the cells of directions, (n, 3), (n,) int."""
    row = np.minimum(np.arccos(np.clip(unit[:, 2], -1.0, 1.0)) / np.pi * ROWS, ROWS - 1).astype(int)
    column = np.floor(np.arctan2(unit[:, 1], unit[:, 0]) / (2.0 * np.pi) * COLUMNS).astype(int) % COLUMNS
    return row * COLUMNS + column


class Moments:
    """Integrals over cells of an environment's radiance times direction, and of its radiance, turned by any angle.

    Parameters
    ----------
    coefficients : (height, width, k) float
    """

    def __init__(self, coefficients: np.ndarray) -> None:
        height, width, k = coefficients.shape
        rows = np.zeros((ROWS, width, k, 4))
        for row in range(height):
            unit, solid_angle = directions(width, height, slice(row, row + 1))
            factors = np.concatenate([unit[0], np.ones((width, 1))], axis=1) * solid_angle[0, :, None]
            found = coefficients[row].astype(np.float64)[:, :, None] * factors[:, None, :]
            first, last = row * ROWS / height, (row + 1) * ROWS / height
            for band in range(int(first), min(int(np.ceil(last - 1e-9)), ROWS)):
                rows[band] += found * ((min(last, band + 1) - max(first, band)) / (last - first))
        self._sums = np.concatenate([np.zeros((ROWS, 1, k, 4)), rows.cumsum(axis=1)], axis=1)

    def turned(self, angle: float) -> np.ndarray:
        """Return the integrals of the cells, (cells, k, 4), if the light is turned by an angle, rad, from +x to +y."""
        width = self._sums.shape[1] - 1
        edge = (np.arange(COLUMNS + 1) / COLUMNS - angle / (2.0 * np.pi)) * width
        turns, column = np.floor(edge / width), edge % width
        whole = np.minimum(column.astype(int), width - 1)
        part = (column - whole)[:, None, None]
        sums = self._sums[:, whole] * (1.0 - part) + self._sums[:, whole + 1] * part
        sums = sums + turns[:, None, None] * self._sums[:, -1:]
        found = np.diff(sums, axis=1)
        found[..., :3] = found[..., :3] @ rotation_z(angle).T
        return found.reshape(CELLS, -1, 4).astype(np.float32)
