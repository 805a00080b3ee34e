"""Fit of a lens to the corners of a flat sheet, with selection of the distortion model by cross-validation.

The models are those of OpenCV, as in `irodori.geometry.distortion`, with one focal length for both axes. Each model is
fitted to some of the photographs. For the others only the pose of the sheet is fitted, and the distances of its corners
are the error. The simplest model within one standard error of the best is selected.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from irodori.core.errors import PlainError, counted
from irodori.core.left_out import simplest

#: Fitted coefficients of each model, by its name, simplest first.
MODELS = {
    "none": (),
    "k1": ("k1",),
    "k1 k2": ("k1", "k2"),
    "k1 k2 p1 p2": ("k1", "k2", "p1", "p2"),
    "k1 k2 p1 p2 k3": ("k1", "k2", "p1", "p2", "k3"),
    "k1 to k6, p1 p2": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
#: Smallest number of photographs, and of corners in each.
LEAST_PHOTOGRAPHS, LEAST_CORNERS = 5, 20
#: Largest RMS distance of the corners of a photograph relative to the median; photographs above it are left out.
_FAR = 3.0
_FOLDS = 5
#: Relative change of the focal length with which its standard error is estimated.
_HELD_OFF = 0.02


@dataclass(frozen=True)
class Sheet:
    """Corners of the sheet in one photograph.

    Parameters
    ----------
    name : str
        Name of the photograph, for messages.
    plane : (n, 2) float32
        Positions of the corners on the sheet, in squares.
    seen : (n, 2) float32
        Positions of the corners in the picture, samples.
    """

    name: str
    plane: np.ndarray
    seen: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """Corners as points in space with z = 0, (n, 3) float32."""
        return np.column_stack([self.plane, np.zeros(len(self.plane))]).astype(np.float32)


@dataclass(frozen=True)
class Lens:
    """A fitted lens; its lengths are in samples of the picture.

    Parameters
    ----------
    model : str
        One of MODELS.
    focal, focal_error : float
        Focal length and its standard error, samples.
    centre, centre_error : (2,) float64
        Principal point, x then y, and its standard errors, samples.
    coefficients : (8,) float64
        k1, k2, p1, p2, k3, k4, k5, k6; 0 for coefficients that the model does not have.
    rms : float
        RMS distance of the corners from their predicted positions, samples.
    left_out : float
        The same for photographs that were left out of the fit, samples.
    """

    model: str
    focal: float
    focal_error: float
    centre: np.ndarray
    centre_error: np.ndarray
    coefficients: np.ndarray
    rms: float
    left_out: float


def fit_lens(sheets: Sequence[Sheet], size: tuple[int, int]) -> tuple[Lens, list[Sheet]]:
    """Fit a lens.

    Parameters
    ----------
    sheets : sequence of Sheet
    size : (int, int)
        Width and height of the picture, samples.

    Returns
    -------
    Lens
    list of Sheet
        Photographs that were left out because they are inconsistent with the others: the sheet was bent, or moved.

    Raises
    ------
    PlainError
        If fewer than LEAST_PHOTOGRAPHS remain, or they do not determine the focal length to 1 %.
    """
    used, far = list(sheets), []
    while True:
        if len(used) < LEAST_PHOTOGRAPHS:
            raise PlainError(
                f"found {counted(len(used), 'photograph')} in agreement with each other; "
                f"accepted: {LEAST_PHOTOGRAPHS} or more, of a flat sheet in different directions"
            )
        _, per_sheet = _fit(used, size, "k1 k2")
        worst = int(np.argmax(per_sheet))
        if per_sheet[worst] <= _FAR * np.median(per_sheet):
            break
        far.append(used.pop(worst))
    errors = {model: left_out_errors(used, size, model) for model in MODELS}
    model = simplest(errors)
    lens, _ = _fit(used, size, model)
    lens = replace(lens, focal_error=_focal_error(used, size, lens), left_out=float(np.sqrt(np.mean(errors[model]))))
    # If all sheets face the camera, every focal length fits, with a different distance for each.
    if not lens.focal_error < 0.01 * lens.focal:
        raise PlainError(
            f"found a focal length known to {100 * lens.focal_error / lens.focal:.1f} %; accepted: 1 % or better: tilt "
            "the sheet by 30 to 45 degrees to the left, right, front and back in further photographs"
        )
    return lens, far


def left_out_errors(sheets: Sequence[Sheet], size: tuple[int, int], model: str) -> np.ndarray:
    """Return the mean squared distance of the corners of each photograph for a lens fitted without it, samples².

    Photographs are left out in up to five groups. If a fit fails, the error is infinite.
    """
    out = np.full(len(sheets), np.inf)
    folds = min(_FOLDS, len(sheets))
    for fold in range(folds):
        inside = [sheet for at, sheet in enumerate(sheets) if at % folds != fold]
        try:
            lens, _ = _fit(inside, size, model)
            for at in range(fold, len(sheets), folds):
                out[at] = _pose_error(sheets[at], lens)
        except cv2.error:
            continue
    return out


def _pose_error(sheet: Sheet, lens: Lens) -> float:
    """Return the mean squared distance of the corners of a sheet, in its best pose for a lens, samples²."""
    matrix = _matrix(lens.focal, lens.centre)
    ok, rotation, translation = cv2.solvePnP(sheet.points, sheet.seen, matrix, lens.coefficients)
    if not ok:
        return np.inf
    rotation, translation = cv2.solvePnPRefineLM(
        sheet.points, sheet.seen, matrix, lens.coefficients, rotation, translation
    )
    shown, _ = cv2.projectPoints(sheet.points, rotation, translation, matrix, lens.coefficients)
    return float(np.mean(np.sum((shown.reshape(-1, 2) - sheet.seen) ** 2, axis=1)))


def _matrix(focal: float, centre: np.ndarray) -> np.ndarray:
    return np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])


def _focal_error(sheets: Sequence[Sheet], size: tuple[int, int], lens: Lens) -> float:
    """Return the standard error of the focal length, samples; infinite if all focal lengths fit equally well.

    All other parameters are fitted again with the focal length fixed at slightly different values, and the error is
    computed from the increase of the squared distances. The error stated by OpenCV is not used: it is from the inverse
    of a matrix that may be singular, and is much too small if all sheets face the camera.
    """
    corners = sum(len(sheet.plane) for sheet in sheets)
    free = 2 * corners - 6 * len(sheets) - 3 - len(MODELS[lens.model])
    squares = corners * lens.rms**2
    grown = [
        corners * _fit(sheets, size, lens.model, focal=(1.0 + off) * lens.focal)[0].rms ** 2 - squares
        for off in (-_HELD_OFF, _HELD_OFF)
    ]
    if not min(grown) > 0.0:
        return np.inf
    return _HELD_OFF * lens.focal * np.sqrt(squares / free / min(grown))


def _fit(
    sheets: Sequence[Sheet], size: tuple[int, int], model: str, focal: float | None = None
) -> tuple[Lens, np.ndarray]:
    """Fit a lens of a model; return it and the RMS distance of the corners of each photograph, samples.

    A given focal length is kept fixed.
    """
    middle = (np.array(size, dtype=np.float64) - 1.0) / 2.0
    points, seen = [sheet.points for sheet in sheets], [sheet.seen for sheet in sheets]
    free = set(MODELS[model])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    if focal is None:
        start = cv2.initCameraMatrix2D(points, seen, size, 1.0)
        focal = start[0, 0] if np.isfinite(start[0, 0]) and start[0, 0] > 0 else float(max(size))
    else:
        flags |= cv2.CALIB_FIX_FOCAL_LENGTH
    for name in ("k1", "k2", "k3", "k4", "k5", "k6"):
        if name not in free:
            flags |= getattr(cv2, f"CALIB_FIX_{name.upper()}")
    if "k4" in free:
        flags |= cv2.CALIB_RATIONAL_MODEL
    if "p1" not in free:
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)
    rms, matrix, found, _, _, deviation, _, per_sheet = cv2.calibrateCameraExtended(
        points, seen, size, _matrix(focal, middle), np.zeros(8), flags=flags, criteria=stop
    )
    coefficients = np.zeros(8)
    count = min(8, found.size)
    coefficients[:count] = found.ravel()[:count]
    # The order in OpenCV is fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, ...; fixed parameters have 0.
    sigma = deviation.ravel()
    return (
        Lens(
            model=model,
            focal=float(matrix[0, 0]),
            focal_error=np.nan,
            centre=matrix[:2, 2].copy(),
            centre_error=sigma[2:4].copy(),
            coefficients=coefficients,
            rms=float(rms),
            left_out=np.nan,
        ),
        per_sheet.ravel(),
    )


def covered(sheets: Sequence[Sheet], size: tuple[int, int]) -> float:
    """Return the share of the 4 x 4 parts of the picture in which a corner of any photograph lies."""
    cells = 4
    seen = np.concatenate([sheet.seen for sheet in sheets])
    at = np.clip((seen + 0.5) / np.array(size) * cells, 0, cells - 1).astype(int)
    return len({tuple(cell) for cell in at}) / cells**2
