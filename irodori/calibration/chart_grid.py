"""Perspective grid of a chart's patches, fitted to the edges of the patches.

Grid coordinates are the column and the row of a patch, counted from 0 with fractions between the centres. A homography
``image_from_grid`` (3 x 3, last element 1) maps them to x and y in samples of the picture; a fitted grid bends with the
lens as well.
"""

from dataclasses import dataclass

import numpy as np

_REACH = 0.75  # of the pitch: how far from a patch's centre its edges are looked for
_ACROSS = np.linspace(-0.3, 0.3, 15)  # of the pitch: along the edge, where profiles are averaged
_EDGE = (0.25, 0.6)  # of the pitch: where an edge may lie from the centre
_GAP = (0.38, 0.65)  # of the pitch: where the gap's darkest place may lie
_MIN_CONTRAST = 0.12  # of the patch's level, below which the patch cannot be distinguished from the gap
_MAX_SCATTER = 0.1  # of the contrast, within the patch
_ROUNDS = 10
_SETTLED_PX = 2e-3
_BRIGHT = 99.0  # percentile of a band that becomes 1
_DISTORTION = 0.03  # standard deviation assumed for the radial distortion at the half-diagonal


@dataclass(frozen=True)
class FittedGrid:
    """A grid fitted to the edges of its patches.

    Parameters
    ----------
    image_from_grid : (3, 3) float64
        Homography without the lens distortion.
    distortion : float
        Third-order radial distortion: a point half a diagonal from the picture's centre is moved outwards by this share
        of that distance; negative for barrel distortion.
    size : (2,) tuple of int
        Width and height of the picture, samples.
    half : (2,) float64
        Half the side of a patch along columns and rows, in pitches.
    edges : int
        Number of edges that were found, at most four for each patch.
    residual_px : float
        Median distance of the edges from those of the grid, samples.
    """

    image_from_grid: np.ndarray
    distortion: float
    size: tuple[int, int]
    half: np.ndarray
    edges: int
    residual_px: float

    def image(self, points) -> np.ndarray:
        """Map grid points to the picture, (..., 2) to (..., 2)."""
        return _bent(project(self.image_from_grid, points), self.distortion, self.size)


def homography(grid: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the homography through pairs of points: exact for four, by least squares for more.

    Parameters
    ----------
    grid : (n, 2) float, n >= 4
    image : (n, 2) float

    Returns
    -------
    (3, 3) float64, the last element 1

    Raises
    ------
    numpy.linalg.LinAlgError
        If four points are given and three of them lie on a line.
    """
    rows: list[list[float]] = []
    values: list[float] = []
    for (u, v), (x, y) in zip(grid, image, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -x * u, -x * v], [0, 0, 0, u, v, 1, -y * u, -y * v]]
        values += [x, y]
    equations, right = np.array(rows, dtype=np.float64), np.array(values, dtype=np.float64)
    solved = np.linalg.solve(equations, right) if len(grid) == 4 else np.linalg.lstsq(equations, right)[0]
    return np.append(solved, 1.0).reshape(3, 3)


def project(image_from_grid: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Map grid points to the picture, (..., 2) to (..., 2)."""
    grid = np.asarray(grid, dtype=np.float64)
    mapped = np.concatenate([grid, np.ones((*grid.shape[:-1], 1))], axis=-1) @ image_from_grid.T
    return mapped[..., :2] / mapped[..., 2:]


def nodes(rows: int, columns: int) -> np.ndarray:
    """Return the grid's points, (rows * columns, 2) float64, column then row, row by row."""
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    return np.stack([column.ravel(), row.ravel()], axis=1).astype(np.float64)


def _bent(xy: np.ndarray, distortion: float, size: tuple[int, int]) -> np.ndarray:
    centre = (np.array(size) - 1.0) / 2.0
    away = (xy - centre) / (np.hypot(*size) / 2.0)
    return xy + distortion * (away**2).sum(axis=-1, keepdims=True) * (xy - centre)


def pitch_px(centres: np.ndarray, rows: int, columns: int) -> float:
    """Return the smallest distance from a patch to its neighbour, samples, from centres (rows * columns, 2)."""
    centres = np.asarray(centres).reshape(rows, columns, 2)
    steps = [np.linalg.norm(np.diff(centres, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    return float(np.concatenate(steps).min())


def even_picture(response: np.ndarray, valid: np.ndarray, window=np.s_[:, :]) -> np.ndarray:
    """Return a picture for edge detection: bands scaled to 0..1, specks removed, clipped areas white.

    Parameters
    ----------
    response : (height, width, bands) float
    valid : (height, width) bool
    window : (slice, slice)
        Rows and columns in which specks are removed.

    Returns
    -------
    (height, width, bands) float64
    """
    from scipy import ndimage  # slow to import

    bright = np.array([np.percentile(band[valid > 0], _BRIGHT) if (valid > 0).any() else 0.0
                       for band in np.moveaxis(response, -1, 0)])  # fmt: skip
    scaled = np.where(valid[..., None] > 0, response / np.where(bright > 0, bright, np.inf), 1.0)
    picture = np.clip(scaled, 0.0, 1.0)
    picture[window] = ndimage.median_filter(picture[window], size=(3, 3, 1))
    return picture


def fit_to_edges(picture: np.ndarray, image_from_grid: np.ndarray, rows: int, columns: int) -> FittedGrid:
    """Fit an approximately known grid to the edges of its patches.

    The edge on each side of a patch is the point where the profile from the patch into the gap passes half of its
    height. Blur does not move this point, and noise is averaged along the side. The homography, the lens distortion
    about the picture's centre and the half sides of the patches are fitted by least squares with a loss that is robust
    to outliers; residuals are measured along the profiles only.

    Parameters
    ----------
    picture : (height, width, bands) float, bands of similar scale
    image_from_grid : (3, 3) float
        Approximate homography, accurate to a fifth of the pitch.

    Raises
    ------
    ValueError
        If too few edges are seen to determine the map.
    """
    points = nodes(rows, columns)
    size = picture.shape[1], picture.shape[0]
    fitted = FittedGrid(np.asarray(image_from_grid, dtype=np.float64), 0.0, size, np.full(2, 0.44), 0, np.inf)
    for _ in range(_ROUNDS):
        sides = [_edges_along(picture, fitted, points, axis) for axis in (0, 1)]
        counts = [int(np.isfinite(found).sum()) for found in sides]
        if min(counts) < max(6, len(points) // 2):
            raise ValueError(f"{sum(counts)} of {4 * len(points)} patch edges")
        before, fitted = fitted, _fit(fitted, points, sides, sum(counts))
        if np.abs(fitted.image(points) - before.image(points)).max() < _SETTLED_PX:
            break
    return fitted


def _edges_along(picture, fitted: FittedGrid, points, axis: int) -> np.ndarray:
    """Return both edges of each patch along a grid axis, (patches, 2), in pitches from the centre; NaN if not found."""
    from scipy import ndimage  # slow to import

    step = np.eye(2)[axis]
    scale = np.median(np.linalg.norm(fitted.image(points + step) - fitted.image(points), axis=1))
    along = np.linspace(-_REACH, _REACH, 2 * max(8, round(_REACH * scale / 0.5)) + 1)
    where = points[:, None, None, :] + along[:, None, None] * step + _ACROSS[:, None] * step[::-1]
    x, y = np.moveaxis(fitted.image(where), -1, 0)
    bands = [ndimage.map_coordinates(band, [y, x], order=1, cval=np.nan) for band in np.moveaxis(picture, -1, 0)]
    profiles = np.median(np.stack(bands, axis=-1), axis=2)  # the median ignores dirt on a part of an edge
    return np.array([[-_edge(p[::-1], along), _edge(p, along)] for p in profiles])


def _edge(profile: np.ndarray, along: np.ndarray) -> float:
    """Return the position at which a profile (samples, bands) leaves the patch on its positive side; NaN if unclear."""
    level = np.median(profile[np.abs(along) < 0.2], axis=0)
    gap = (along > _GAP[0]) & (along < _GAP[1])
    if not np.isfinite(profile[gap | (np.abs(along) < _GAP[0])]).all():
        return np.nan
    darkest = along[gap][np.argmin(profile[gap].sum(axis=1))]
    floor = profile[np.abs(along - darkest) < 0.03].mean(axis=0)
    fall = level - floor
    if fall.sum() < _MIN_CONTRAST * level.sum() or fall.sum() <= 0:
        return np.nan
    height = (profile - floor) @ fall / (fall @ fall)
    inside = height[np.abs(along) < _EDGE[0]]
    low = np.flatnonzero((along > 0) & (height < 0.5))
    if np.ptp(inside) > 6 * _MAX_SCATTER or not low.size or low[0] == 0:
        return np.nan
    at = low[0]
    share = (height[at - 1] - 0.5) / (height[at - 1] - height[at])
    edge = along[at - 1] + share * (along[at] - along[at - 1])
    return float(edge) if _EDGE[0] < edge < _EDGE[1] else np.nan


def _fit(fitted: FittedGrid, points, sides, count: int) -> FittedGrid:
    """Return the grid fitted to measured edges, which are given relative to the present grid."""
    from scipy.optimize import least_squares  # slow to import

    parts = []
    for axis, found in enumerate(sides):
        for side in (0, 1):
            seen = np.isfinite(found[:, side])
            at = points[seen] + found[seen, side, None] * np.eye(2)[axis]
            there = fitted.image(at)
            ahead = fitted.image(at + 0.01 * np.eye(2)[axis]) - there
            sign = np.full(len(at), 2.0 * side - 1.0)
            parts.append((
                points[seen], sign, np.full(len(at), axis), there,
                ahead / np.linalg.norm(ahead, axis=1, keepdims=True),
            ))  # fmt: skip
    grid, sign, axes, measured, direction = (np.concatenate(column) for column in zip(*parts, strict=True))
    half = np.array([np.nanmedian(np.abs(found)) for found in sides])

    def distances(parameters):
        offset = sign[:, None] * parameters[8:10][axes][:, None] * np.eye(2)[axes]
        flat = project(np.append(parameters[:8], 1.0).reshape(3, 3), grid + offset)
        return ((_bent(flat, parameters[10], fitted.size) - measured) * direction).sum(axis=1)

    def residual(parameters):
        # A small chart cannot separate distortion from perspective; lenses distort by a few percent at most.
        return np.append(distances(parameters), parameters[10] / _DISTORTION)

    start = np.concatenate([fitted.image_from_grid.ravel()[:8], half, [fitted.distortion]])
    solved = least_squares(residual, start, loss="soft_l1", f_scale=0.3, x_scale="jac", max_nfev=50).x
    image_from_grid = np.append(solved[:8], 1.0).reshape(3, 3)
    median = float(np.median(np.abs(distances(solved))))
    return FittedGrid(image_from_grid, float(solved[10]), fitted.size, solved[8:10], count, median)
