"""Detection of a ColorChecker Classic or Digital SG in a photograph, with its orientation.

The segmentation of the library colour-checker-detection finds squares. This module arranges them in a lattice, fits it
to the edges of the patches, determines the orientation, and accepts a chart only if it agrees with measured spectra.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from irodori.calibration.chart_grid import FittedGrid, even_picture, fit_to_edges, nodes, pitch_px, project
from irodori.calibration.patch_order import readings, rmse_of_unseen
from irodori.calibration.patches import read_squares
from irodori.calibration.square_lattice import Lattice, lattices
from irodori.config.cross_checks.named_spectra import FOUND_LAYOUTS, FOUND_WORDS
from irodori.core.errors import InputError, PlainError

_WORKING_WIDTH_PX = 1440  # the library's own, to which its thresholds are set
_SMOOTHINGS = 2  # of the library's five, which take most of its time and find no more
#: Widths the picture is stretched to: the library seeks squares, and a tilt or a sensor's pixels make patches oblong.
_STRETCHES = (1.0, 1.6, 1.0 / 1.6)
_MIN_PITCH_PX = 10.0
_MIN_EDGES = 0.5  # of four a patch
_MAX_RESIDUAL = 0.02  # of the pitch, besides half a sample
_HALF = (0.33, 0.49)  # half a patch's side over the pitch: what charts of this layout have
_READ = 0.6  # of a patch's side: the square that is compared with the spectra
_MAX_GRADIENT, _MAX_UNEVENNESS = 0.35, 0.15  # of a patch, above which something lies on it
_MAX_PATCH_RMSE = 0.25
_MAX_RMSE = 0.09  # leave-one-patch-out; a right grid gives 0.03 to 0.06 with three bands, a wrong one over 0.15
_MAX_RATIO = 0.6  # of the errors of the right reading and of the next best
_MIN_RANK_CORRELATION = 0.8
_ADVICE = "a whole, evenly lit ColorChecker of {} x {} patches, or its corners as chart.centres_px"


@dataclass(frozen=True)
class FoundChart:
    """A chart found in a photograph.

    Parameters
    ----------
    centres : (patches, 2) float64
        x then y of the patches in the order of the spectra, samples.
    side : float
        Smallest side of a patch, samples.
    turn_deg : float
        Direction of the chart's long side in the picture, from x towards y (down), -180..180.
    edges : int
        Number of patch edges that were found, at most four for each patch.
    residual_px : float
        Median distance of the edges from those of the grid, samples.
    rmse : float
        Spectral RMSE, leave-one-patch-out, in the accepted orientation.
    next_rmse : float
        The same in the next best of the four orientations: as it lies, turned by 180°, and both mirrored.
    """

    centres: np.ndarray
    side: float
    turn_deg: float
    edges: int
    residual_px: float
    rmse: float
    next_rmse: float


class _NoChartError(ValueError):
    """Error for a candidate that is not the chart; the message is the reason."""


@dataclass(frozen=True)
class _Sought:
    """Search for a chart: its photograph, and the colours and layout that are expected.

    ``rows`` and ``columns`` are those of the chart with its long side horizontal; ``places``, (patches,) int, is the
    index of each patch in them, row by row, in the order of the spectra.
    """

    response: np.ndarray
    valid: np.ndarray
    spectra: np.ndarray
    file: object
    picture: np.ndarray
    rows: int
    columns: int
    places: np.ndarray

    @classmethod
    def of(cls, response, valid, spectra, file, layout: tuple[int, int]) -> "_Sought":
        """Return the search for a chart; parameters as in `find_chart`."""
        rows, columns = min(layout), max(layout)
        number = np.arange(rows * columns).reshape(rows, columns)
        # Letters of an SG run along its long side: spectra in their order go down the columns.
        places = number if layout == (rows, columns) else number.T
        picture = even_picture(response, valid)
        return cls(response, valid, spectra, file, picture, rows, columns, places.ravel())

    @property
    def advice(self) -> str:
        """Advice to the user for error messages: what is accepted."""
        return _ADVICE.format(self.rows, self.columns)


def find_chart(
    response: np.ndarray, valid: np.ndarray, spectra: np.ndarray, file, layout: tuple[int, int] = (4, 6)
) -> FoundChart:
    """Find the only ColorChecker in a photograph.

    Parameters
    ----------
    response : (height, width, bands) float, three bands or more
    valid : (height, width) bool
        False for clipped and hot samples.
    spectra : (patches, 61) float
        Measured reflectance factors, row by row from the dark skin of a Classic, or the first white of an SG.
    file : path, for error messages
    layout : (int, int), of FOUND_LAYOUTS
        Rows and columns of the spectra.

    Raises
    ------
    InputError
        For another layout; if no chart is found, or several; if the chart is cut off, covered, mirrored or uneven, or
        its responses do not agree with the measured spectra.
    """
    if layout not in FOUND_LAYOUTS:
        accepted = f"{FOUND_WORDS}; for other layouts chart.centres_px"
        raise InputError(file, "chart.find", f"chart for {layout[0]} x {layout[1]} patches", accepted)
    patches = layout[0] * layout[1]
    if len(spectra) != patches or response.shape[-1] < 3:
        found = f"{len(spectra)} spectra and {response.shape[-1]} bands"
        raise InputError(file, "chart.find", found, f"the {patches} spectra of a ColorChecker and three bands")
    sought = _Sought.of(response, valid, spectra, file, layout)
    most = 0
    for stretch in _STRETCHES:
        squares = _squares(sought.picture, stretch)
        most = max(most, len(squares))
        candidates = lattices(squares)
        if candidates:
            return _the_one(candidates, sought)
    raise InputError(file, "chart.find", f"no chart (at most {most} separate squares)", sought.advice)


def _library():
    """Return the library's segmentation function; it imports OpenCV, whose system libraries may be missing."""
    try:
        from colour_checker_detection import segmenter_default
    except ImportError as error:
        raise PlainError(
            f"chart.find: chart needs OpenCV, which does not start ({error}): install the system's libgl1 and "
            "libglib2.0-0, or give chart.centres_px with find: edges"
        ) from error
    return segmenter_default


def _squares(picture: np.ndarray, stretch: float) -> np.ndarray:
    """Return the corners of the squares that the library detects, (n, 4, 2) float64, samples."""
    segmenter_default = _library()
    if np.ptp(picture[..., :3].max(axis=-1)) == 0:
        return np.zeros((0, 4, 2))  # the library would divide by the range
    image = picture[..., :3].astype(np.float32)
    if stretch != 1.0:
        from scipy import ndimage  # slow to import

        image = ndimage.zoom(image, (1.0, stretch, 1.0), order=1)
    height, width = image.shape[:2]
    # The library turns upright pictures clockwise without saying so.
    upright = height > width
    seen = segmenter_default(np.ascontiguousarray(np.rot90(image, -1) if upright else image), additional_data=True,
                             working_width=_WORKING_WIDTH_PX,
        bilateral_filter_iterations=_SMOOTHINGS)  # fmt: skip
    scale = max(height, width) / _WORKING_WIDTH_PX
    x, y = np.moveaxis((np.asarray(seen.swatches, dtype=np.float64).reshape(-1, 4, 2) + 0.5) * scale - 0.5, -1, 0)
    if upright:
        x, y = y, height - 1.0 - x
    return np.stack([x * (picture.shape[1] - 1.0) / (width - 1.0), y], axis=-1)


def _the_one(candidates: list[Lattice], sought: _Sought) -> FoundChart:
    """Return the only candidate that is a chart; raise an error if none is, or several are."""
    found, reasons = [], []
    for lattice in candidates:
        try:
            found.append(_prove(lattice, sought))
        except _NoChartError as error:
            x, y = lattice.centres.mean(axis=0)
            reasons.append(f"{lattice.rows} x {lattice.columns} squares about ({x:.0f}, {y:.0f}): {error}")
    if len(found) > 1:
        places = " and ".join("({:.0f}, {:.0f})".format(*chart.centres.mean(axis=0)) for chart in found)
        raise InputError(sought.file, "chart.find", f"{len(found)} charts about {places}", "one chart, or its corners")
    if not found:
        raise InputError(sought.file, "chart.find", "; ".join(reasons), sought.advice)
    return found[0]


def _prove(lattice: Lattice, sought: _Sought) -> FoundChart:
    """Return the chart that contains a lattice of squares, which may lack one row and one column of the chart."""
    rows, columns = sought.rows, sought.columns
    if not columns - 1 <= lattice.columns <= columns or not rows - 1 <= lattice.rows <= rows:
        raise _NoChartError(f"not the {rows} x {columns} of a whole chart")
    proved, reasons = [], []
    for right, down in itertools.product(range(columns - lattice.columns + 1), range(rows - lattice.rows + 1)):
        try:
            grid = _fitted(lattice.image_from_grid @ _moved(right, down), sought)
            proved.append(_oriented(grid, sought))
        except _NoChartError as error:
            reasons.append(str(error))
    if not proved:
        raise _NoChartError("; ".join(dict.fromkeys(reasons)))
    return min(proved, key=lambda chart: chart.rmse)


def _moved(right: int, down: int) -> np.ndarray:
    """Return the homography that translates grid coordinates by (-right, -down)."""
    return np.array([[1.0, 0.0, -right], [0.0, 1.0, -down], [0.0, 0.0, 1.0]])


def _fitted(image_from_grid: np.ndarray, sought: _Sought) -> FittedGrid:
    height, width = sought.picture.shape[:2]
    rows, columns = sought.rows, sought.columns
    right, bottom = columns - 0.6, rows - 0.6
    corners = project(image_from_grid, np.array([[-0.4, -0.4], [right, -0.4], [-0.4, bottom], [right, bottom]]))
    if not ((corners > -0.5) & (corners < [width - 0.5, height - 0.5])).all():
        raise _NoChartError("the chart is cut by the picture's edge")
    pitch = pitch_px(project(image_from_grid, nodes(rows, columns)), rows, columns)
    if pitch < _MIN_PITCH_PX:
        raise _NoChartError(f"patches every {pitch:.1f} samples, too small below {_MIN_PITCH_PX:g}")
    try:
        grid = fit_to_edges(sought.picture, image_from_grid, rows, columns)
    except ValueError as error:
        raise _NoChartError(str(error)) from None
    limit, every = 0.5 + _MAX_RESIDUAL * pitch, 4 * rows * columns
    if grid.edges < _MIN_EDGES * every or grid.residual_px > limit:
        raise _NoChartError(
            f"{grid.edges} of {every} patch edges, {grid.residual_px:.1f} samples off a perspective grid"
        )
    if not ((grid.half > _HALF[0]) & (grid.half < _HALF[1])).all():
        raise _NoChartError("patches of {:.2f} x {:.2f} of their pitch".format(*2 * grid.half))
    return grid


def _oriented(grid: FittedGrid, sought: _Sought) -> FoundChart:
    """Return the chart in the orientation, upright or turned by 180°, that agrees with the spectra; refuse mirrored."""
    from scipy.stats import spearmanr  # slow to import

    rows, columns, spectra = sought.rows, sought.columns, sought.spectra
    centres = grid.image(nodes(rows, columns))
    side = 2.0 * grid.half.min() * pitch_px(centres, rows, columns)
    try:
        read = read_squares(sought.response, sought.valid, centres, max(2.0, _READ * side), sought.file)
    except InputError as error:
        raise _NoChartError(error.found) from None
    orders = {name: order[sought.places] for name, order in readings(rows, columns).items()}
    patch_rmse = {name: rmse_of_unseen(read["mean"][order], spectra) for name, order in orders.items()}
    errors = {name: float(values.mean()) for name, values in patch_rmse.items()}
    best, second = sorted(errors, key=errors.__getitem__)[:2]
    order = orders[best]
    rank = spearmanr(_brightness(read["mean"][order]), spectra.mean(axis=1)).statistic
    described = f"spectral RMSE {errors[best]:.3f}, next best reading {errors[second]:.3f}, rank correlation {rank:.2f}"
    if errors[best] > _MAX_RMSE or errors[best] > _MAX_RATIO * errors[second] or not rank > _MIN_RANK_CORRELATION:
        raise _NoChartError(f"patches that do not answer as the measured spectra do ({described})")
    if best in ("mirrored", "flipped"):
        raise _NoChartError("a mirrored picture of the chart")
    _refuse_covered(read["gradient"][order], read["unevenness"][order], patch_rmse[best])
    centres = centres[order]
    ahead = centres[np.argmax(sought.places % columns)] - centres[0]
    turn_deg = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
    return FoundChart(centres, float(side), turn_deg, grid.edges, grid.residual_px, errors[best], errors[second])


def _refuse_covered(gradient: np.ndarray, unevenness: np.ndarray, patch_rmse: np.ndarray) -> None:
    """Refuse a chart with a covered patch; one too small for a gradient (NaN) is judged by its spectrum alone."""
    for number in range(len(gradient)):
        change = max(gradient[number] / _MAX_GRADIENT, unevenness[number] / _MAX_UNEVENNESS)
        if change > 1.0:
            raise _NoChartError(f"patch {number} uneven by {gradient[number]:.0%}, as if something covered it")
        if patch_rmse[number] > _MAX_PATCH_RMSE:
            raise _NoChartError(f"patch {number} off its spectrum by {patch_rmse[number]:.2f}, as if covered")


def _brightness(mean: np.ndarray) -> np.ndarray:
    """Return the mean over the bands, each divided by its largest patch, (patches,)."""
    return (mean / np.maximum(mean.max(axis=0), np.finfo(float).tiny)).mean(axis=1)
