"""Flat field: a smooth surface fitted to a picture of the white reference.

The surface is a polynomial of degree 4 in x and y, each from -1 to 1 over the picture. So noise and dust of the white
reference do not affect the pictures of objects, and 15 numbers for each band replace a picture.
"""

from typing import NamedTuple

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

DEGREE = 4
POWERS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]  # powers of x and of y
_ROWS = 64  # rows that a thread takes at a time
_MAX_RESIDUAL = 0.05  # largest RMS residual relative to the mean; pixel noise of a white reference is far below
_BLOCKS, _LEAST_BLOCK_PX = 32, 8  # squares along the shorter side in which spots are looked for, and their least side
_NOISE = 5.0  # standard deviations of the noise of such a square, of which there are some thousand


def fit_flat(image: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Fit the polynomial surface to a flat-field picture by least squares.

    Parameters
    ----------
    image : (height, width, bands) float
    valid : (height, width) bool

    Returns
    -------
    (bands, 15) float64
        Coefficients of x^i y^j in the order of POWERS.

    Raises
    ------
    ValueError
        If the picture does not show an even surface that fills it.
    """
    if not valid.any():
        raise ValueError("a picture without a single valid pixel")
    valid = np.ascontiguousarray(valid, dtype=np.bool_)
    moments, products, squares, counts = _row_moments(image, valid)
    y = axis(image.shape[0])
    # The normal equations of 15 terms on [-1, 1] are well conditioned and need one pass over the picture.
    y_powers = y[:, None] ** np.arange(2 * DEGREE + 1)
    by_power = moments.T @ y_powers  # power of x, power of y
    normal = np.array([[by_power[i + k, j + m] for k, m in POWERS] for i, j in POWERS])
    sums = np.einsum("rbi,rj->bij", products, y_powers[:, : DEGREE + 1])
    right = np.array([sums[:, i, j] for i, j in POWERS])
    coefficients = np.linalg.solve(normal, right).T
    # Sum of squares about the fit, from the same moments.
    residual = squares.sum(axis=0) - np.einsum("bt,tb->b", coefficients, right)
    count = counts.sum()
    spread = np.sqrt(np.maximum(residual, 0.0) / count) / (sums[:, 0, 0] / count)
    corners = evaluate_flat(coefficients, min(64, image.shape[0]), min(64, image.shape[1]))
    if not (corners > 0).all() or not (np.abs(spread) < _MAX_RESIDUAL).all():
        raise ValueError(f"a picture that varies by {np.max(np.abs(spread)):.0%} about a smooth surface")
    return coefficients


class Spot(NamedTuple):
    """Square of a flat-field picture that differs from the fitted surface: its middle, px, and how far."""

    row: float
    column: float
    difference: float  # picture / surface - 1


def find_spot(image: np.ndarray, valid: np.ndarray, coefficients: np.ndarray) -> Spot | None:
    """Return the square that differs most from the surface fitted to a picture; None if none does by 5 % and noise.

    Parameters
    ----------
    image, valid, coefficients : see `fit_flat`
    """
    side = max(-(-min(valid.shape) // _BLOCKS), _LEAST_BLOCK_PX)
    rows, columns = (length // side for length in valid.shape)
    if not rows or not columns:
        return None

    def summed(picture: np.ndarray) -> np.ndarray:
        whole = picture[: rows * side, : columns * side]
        return whole.reshape(rows, side, columns, side, *picture.shape[2:]).sum(axis=(1, 3), dtype=np.float64)

    seen, fitted = (np.where(valid[..., None], one, 0.0) for one in (image, evaluate_flat(coefficients, *valid.shape)))
    is_judged = summed(valid) > 0.5 * side**2
    difference = np.where(is_judged[..., None], summed(seen) / np.maximum(summed(fitted), 1e-30) - 1.0, 0.0)
    # The median is hardly changed by the spot itself; of a normal distribution it is 0.674 standard deviations.
    noise = np.median(np.abs(difference), axis=(0, 1)) / 0.674
    beyond = np.abs(difference) - _NOISE * noise
    row, column, band = np.unravel_index(beyond.argmax(), beyond.shape)
    if beyond[row, column, band] <= _MAX_RESIDUAL:
        return None
    middle = 0.5 * (side - 1)
    return Spot(row * side + middle, column * side + middle, float(difference[row, column, band]))


def evaluate_flat(coefficients: np.ndarray, height: int, width: int) -> np.ndarray:
    """Evaluate the surface of a flat field, (height, width, bands) float32."""
    x_powers = axis(width)[:, None] ** np.arange(DEGREE + 1)
    y_powers = axis(height)[:, None] ** np.arange(DEGREE + 1)
    return np.einsum("yj,xi,bij->yxb", y_powers, x_powers, grid(coefficients), optimize=True).astype(np.float32)


def grid(coefficients: np.ndarray) -> np.ndarray:
    """Arrange coefficients, (bands, 15), as (bands, power of x, power of y), with 0 beyond the degree."""
    out = np.zeros((len(coefficients), DEGREE + 1, DEGREE + 1))
    for term, (i, j) in enumerate(POWERS):
        out[:, i, j] = coefficients[:, term]
    return out


def axis(size: int) -> np.ndarray:
    """Return the coordinates of the columns or rows of a picture, -1 to 1, (size,)."""
    return np.linspace(-1.0, 1.0, size) if size > 1 else np.zeros(1)


class _RowSums(NamedTuple):
    """Sums over the valid pixels of each row of a picture (height, width, bands)."""

    moments: np.ndarray  # (height, 2 DEGREE + 1), Σ x^i
    products: np.ndarray  # (height, bands, DEGREE + 1), Σ picture x^i
    squares: np.ndarray  # (height, bands), Σ picture²
    counts: np.ndarray  # (height,) int64, number of valid pixels


@njit(cache=True, nogil=True)
def _sum_row(pictures, valids, x, sums, row):
    image, valid, moments = pictures[row], valids[row], sums.moments[row]
    products, squares = sums.products[row], sums.squares[row]
    for column in range(valid.size):
        if not valid[column]:
            continue
        sums.counts[row] += 1
        power = 1.0
        for i in range(2 * DEGREE + 1):
            moments[i] += power
            if i <= DEGREE:
                for band in range(image.shape[1]):
                    products[band, i] += power * image[column, band]
            power *= x[column]
        for band in range(image.shape[1]):
            squares[band] += float(image[column, band]) ** 2


@njit(cache=True, nogil=True)
def _sum_rows(image, valid, x, sums, first, last):
    for row in range(first, last):
        _sum_row(image, valid, x, sums, row)


def _row_moments(image, valid):
    """Compute the sums over the valid pixels of each row."""
    height, _, bands = image.shape
    moments, products = np.zeros((height, 2 * DEGREE + 1)), np.zeros((height, bands, DEGREE + 1))
    sums = _RowSums(moments, products, np.zeros((height, bands)), np.zeros(height, dtype=np.int64))
    run_chunks(_sum_rows, height, _ROWS, image, valid, axis(image.shape[1]), sums)
    return sums
