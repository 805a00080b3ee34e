"""Check that the patches of a chart are in the order of its spectra."""

from collections.abc import Iterator

import numpy as np

from irodori.calibration.chart_grid import homography, nodes, project

_SPARE_PATCHES = 4  # beyond the number of bands: with fewer, the order cannot be judged
_MAX_RATIO = 0.6  # of the error of another reading to that of the one configured
_UPRIGHT = "upright"


def is_telling(response: np.ndarray) -> bool:
    """Return whether responses (m, bands) are finite and numerous enough, relative to the bands, for a comparison."""
    return len(response) >= response.shape[1] + _SPARE_PATCHES and bool(np.isfinite(response).all())


def predicted_by_others(response: np.ndarray, spectra: np.ndarray) -> np.ndarray:
    """Return each patch's spectrum as all others predict it linearly from its response, in closed form.

    Parameters
    ----------
    response : (m, bands) float
    spectra : (m, 61) float

    Returns
    -------
    (m, 61) float64
    """
    response = response / np.maximum(np.abs(response).max(axis=0), np.finfo(float).tiny)
    left = np.linalg.svd(response, full_matrices=False)[0]
    leverage = (left**2).sum(axis=1)
    return spectra - (spectra - left @ (left.T @ spectra)) / np.maximum(1.0 - leverage, 1e-6)[:, None]


def rmse_of_unseen(response: np.ndarray, spectra: np.ndarray) -> np.ndarray:
    """Return the spectral RMSE of `predicted_by_others`, (m,) float64."""
    return np.sqrt(((predicted_by_others(response, spectra) - spectra) ** 2).mean(axis=1))


def readings(rows: int, columns: int) -> dict[str, np.ndarray]:
    """Return the orders in which a chart could be read: upright, turned by 180°, mirrored or flipped, each (m,)."""
    number = np.arange(rows * columns).reshape(rows, columns)
    orders = {_UPRIGHT: number, "turned": number[::-1, ::-1], "mirrored": number[:, ::-1], "flipped": number[::-1]}
    return {name: order.ravel() for name, order in orders.items()}


def _places(centres: np.ndarray, rows: int, columns: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield a phrase for each possible reading of a chart, and the centres of the patches in that reading, (m, 2).

    The corners can be named in eight ways, with the given layout and with rows and columns exchanged.
    """
    corners = centres.reshape(rows, columns, 2)[[0, 0, -1, -1], [0, -1, 0, -1]]
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    for across, down, layout in ((columns, rows, ""), (rows, columns, f"as {columns} rows of {rows} columns")):
        if layout and rows == columns:
            continue
        grid = nodes(down, across) / [across - 1.0, down - 1.0]
        for turned, turn in (
            ("", (0, 1, 2, 3)),
            ("with row_end and column_end of its corners exchanged", (0, 2, 1, 3)),
        ):
            image_from_square = homography(square, corners[list(turn)])
            for name, order in readings(down, across).items():
                words = [layout, turned, "" if name == _UPRIGHT else name]
                yield ", ".join(filter(None, words)) or _UPRIGHT, project(image_from_square, grid[order])


def check_order(centres: np.ndarray, read, spectra: np.ndarray, rows: int, columns: int) -> None:
    """Refuse a chart that agrees with the spectra much better when its patches are read in another order.

    Parameters
    ----------
    centres : (m, 2) float
        Centres of the patches as they were read, row by row.
    read : callable
        Function from centres (m, 2) to the responses there, (m, bands), or None if they cannot be read.
    spectra : (m, 61) float
    rows, columns : int

    Raises
    ------
    ValueError
        The message names the order that fits. Charts with hardly more patches than bands pass, because their order
        cannot be judged.
    """
    if min(rows, columns) < 2:
        return
    errors = {}
    for words, places in _places(centres, rows, columns):
        response = read(centres if words == _UPRIGHT else places)
        if response is not None and is_telling(response):
            errors[words] = float(rmse_of_unseen(response, spectra).mean())
    if _UPRIGHT not in errors:
        return
    best = min(errors, key=errors.__getitem__)
    if errors[best] < _MAX_RATIO * errors[_UPRIGHT]:
        raise ValueError(
            f"patches that agree with the spectra when the chart is read {best} (spectral RMSE {errors[best]:.3f}) and "
            f"not as it is defined ({errors[_UPRIGHT]:.3f})"
        )
