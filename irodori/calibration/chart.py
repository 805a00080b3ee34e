"""Measurement of a colour chart in a linear picture: patch positions, mean responses and their variances."""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.chart_grid import even_picture, fit_to_edges, homography, nodes, pitch_px, project
from irodori.calibration.detection import find_chart
from irodori.calibration.patches import ChartReading, read_squares
from irodori.config.models import Chart
from irodori.core.errors import InputError
from irodori.geometry.pinhole import samples_from_superpixels, superpixels_from_samples
from irodori.spectra.published import chart_spectra

FINDS = ("nothing", "edges", "chart")
_CORNERS = ("first", "row_end", "column_end", "last")
_DEFAULT_SHARE = 0.5  # of a patch's side that is averaged where the configuration does not say
_MAX_MOVE = 0.2  # of the pitch: from the corners of the configuration to the edges
_MAX_RESIDUAL = 0.02  # of the pitch, besides half a sample


@dataclass(frozen=True)
class Located:
    """Positions of a chart's patches in a photograph.

    Parameters
    ----------
    centres_px : (patches, 2) float64
        x then y, superpixels, in the order of the spectra.
    side_px : float
        Side of the squares to be averaged, superpixels.
    rows, columns : int
    patch_side_px : float
        Side of the whole patches, superpixels; NaN if the configured corners were used unchanged.
    found : dict
        Measurements of the search, empty if the configured corners were used unchanged. ``edges``: number of edges;
        ``residual_px``: median distance of the edges from the grid, superpixels; with ``edges`` ``moved_px``: largest
        distance from the configuration's centres, superpixels; with ``chart`` ``turn_deg``, ``rmse`` and ``next_rmse``,
        see `irodori.calibration.detection.FoundChart`.
    """

    centres_px: np.ndarray
    side_px: float
    rows: int
    columns: int
    patch_side_px: float
    found: dict


def patch_centres(chart: Chart) -> np.ndarray:
    """Return patch centres in superpixels by the homography through the four corner patches.

    Parameters
    ----------
    chart : Chart
        With ``centres_px``.

    Returns
    -------
    (rows * columns, 2) float64, x then y, row by row
    """
    return project(_from_corners(chart), nodes(chart.rows, chart.columns))


def _from_corners(chart: Chart) -> np.ndarray:
    if chart.centres_px is None:
        raise ValueError("a chart without centres_px; accepted: the centres of its four corner patches")
    rows, columns = chart.rows, chart.columns
    grid = np.array([[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]], dtype=np.float64)
    return homography(grid, np.array([getattr(chart.centres_px, k) for k in _CORNERS], dtype=np.float64))


def locate_patches(response: np.ndarray, valid: np.ndarray, chart: Chart, file, sample_px: int = 2) -> Located:
    """Return the positions of the patches: as configured, fitted to their edges, or detected.

    Parameters
    ----------
    response : (height, width, bands) float
    valid : (height, width) bool
    chart : Chart
    file : path, for error messages
    sample_px : int
        Mosaic pixels along the side of a sample of the picture: 2 for superpixels, 1 at full resolution.

    Raises
    ------
    ValueError
        For an unknown ``find``, or if a chart that is not to be detected has no ``centres_px`` or no ``patch_px``.
    InputError
        If the edges do not confirm the configured corners, or no chart or several charts are detected.
    """
    find = chart.find
    if find not in FINDS:
        raise ValueError(f"unknown chart.find {find!r}; accepted: {', '.join(FINDS)}")
    layout = chart.rows, chart.columns
    if find == "nothing":
        if chart.patch_px is None:
            raise ValueError("a chart with find: nothing and no patch_px; accepted: patch_px given")
        return Located(patch_centres(chart), float(chart.patch_px), *layout, np.nan, {})
    to_superpixels = sample_px / 2.0
    if find == "edges":
        centres, side, found = _by_edges(response, valid, chart, file, sample_px)
    else:
        centres, side, found = _by_itself(response, valid, chart, file)
    found["residual_px"] *= to_superpixels
    centres = superpixels_from_samples(centres, sample_px)
    if find == "edges":
        found["moved_px"] = float(np.linalg.norm(centres - patch_centres(chart), axis=1).max())
    patch_side_px = side * to_superpixels
    side_px = float(chart.patch_px or _DEFAULT_SHARE * patch_side_px)
    if side_px > patch_side_px:
        raise InputError(file, "chart.patch_px", f"{side_px:g}", f"at most {patch_side_px:.0f}, the patches' own side")
    return Located(centres, side_px, *layout, patch_side_px, found)


def _by_edges(response, valid, chart: Chart, file, sample_px: int) -> tuple[np.ndarray, float, dict]:
    rows, columns = chart.rows, chart.columns
    start = samples_from_superpixels(patch_centres(chart), sample_px)
    pitch = pitch_px(start, rows, columns)
    try:
        picture = even_picture(response, valid, _around(start, pitch, valid.shape))
        grid = fit_to_edges(picture, homography(nodes(rows, columns), start), rows, columns)
    except ValueError as error:
        raise InputError(
            file, "chart.centres_px", str(error), "corners about which patches end in darker gaps"
        ) from None
    centres = grid.image(nodes(rows, columns))
    moved = float(np.linalg.norm(centres - start, axis=1).max())
    if moved > _MAX_MOVE * pitch or grid.residual_px > 0.5 + _MAX_RESIDUAL * pitch:
        found = f"edges {grid.residual_px:.1f} samples off a grid that lies up to {moved:.0f} samples from the corners"
        raise InputError(file, "chart.centres_px", found, f"corners good to {_MAX_MOVE * pitch:.0f} samples")
    side = 2.0 * float(grid.half.min()) * pitch_px(centres, rows, columns)
    return centres, side, {"edges": grid.edges, "residual_px": grid.residual_px}


def _around(centres: np.ndarray, pitch: float, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a picture that contain a chart, with a margin of one pitch."""
    low, high = np.floor(centres.min(axis=0) - pitch).astype(int), np.ceil(centres.max(axis=0) + pitch).astype(int)
    rows, columns = (slice(max(0, low[a]), min(shape[1 - a], high[a] + 1)) for a in (1, 0))
    return rows, columns


def _by_itself(response, valid, chart: Chart, file) -> tuple[np.ndarray, float, dict]:
    seen = find_chart(response, valid, chart_spectra(chart.spectra)[1], file, (chart.rows, chart.columns))
    found = {name: getattr(seen, name) for name in ("edges", "residual_px", "turn_deg", "rmse", "next_rmse")}
    return seen.centres, seen.side, found


def read_located(response, valid, located: Located, file, sample_px: int = 2) -> ChartReading:
    """Return the statistics of patches at their located positions.

    Raises
    ------
    InputError
        If a patch lies outside the picture or most of it is not valid.
    """
    centres = samples_from_superpixels(located.centres_px, sample_px)
    read = read_squares(response, valid, centres, located.side_px * 2.0 / sample_px, file)
    read["log_slope"] = read["log_slope"] * (2.0 / sample_px)
    return ChartReading(centres_px=located.centres_px, side_px=located.side_px, **read)
