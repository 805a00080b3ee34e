"""Reading a colour chart: where its patches lie, and what the camera answered there."""

import numpy as np
from scipy import stats

from irodori.errors import InputError
from irodori.geometry.pinhole import samples_from_superpixels

_TRIM = 0.1  # share of a patch's pixels left out at each end


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
