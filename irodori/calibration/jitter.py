"""Sensitivity of a calibration's errors to small shifts of the places where patches are measured."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from irodori.calibration.chart import Located
from irodori.calibration.patches import read_means
from irodori.geometry.pinhole import samples_from_superpixels

#: Superpixels by which all patches are moved at once; 6 mosaic pixels.
STEP_PX = 3.0
#: Largest change of the mean CIEDE2000, leave-one-patch-out, that a report accepts.
LIMIT = 0.05
SHIFTS = tuple((dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0))


@dataclass(frozen=True)
class Jitter:
    """Errors of a calibration with its patches in place and moved.

    Parameters
    ----------
    step_px : float
        Distance by which the patches are moved, superpixels.
    in_place : float
        Error with the patches in place.
    moved : (8,) float64
        Error with all patches moved by `step_px` times SHIFTS.
    """

    step_px: float
    in_place: float
    moved: np.ndarray

    @property
    def worst(self) -> float:
        """Largest change of the error, absolute."""
        return float(np.abs(self.moved - self.in_place).max())


def jitter(
    response: np.ndarray,
    valid: np.ndarray,
    located: Located,
    error: Callable[[np.ndarray], float],
    file,
    *,
    sample_px: int = 2,
    step_px: float = STEP_PX,
) -> Jitter:
    """Return an error of a calibration with the patches of its chart in place and moved in eight directions.

    Parameters
    ----------
    response : (height, width, bands) float
    valid : (height, width) bool
    located : Located
        Positions of the patches.
    error : callable
        Function from the responses of the patches, (patches, bands), to one number, such as the mean CIEDE2000 of
        leave-one-patch-out.
    file : path, for error messages
    sample_px : int
        Mosaic pixels along the side of a sample of the picture.
    step_px : float
        Distance of the move, superpixels; on the diagonals both coordinates change by it.

    Raises
    ------
    InputError
        If a moved patch lies outside the picture or most of it is not valid.
    """

    def at(dx: float, dy: float) -> float:
        centres = samples_from_superpixels(located.centres_px + step_px * np.array([dx, dy]), sample_px)
        return float(error(read_means(response, valid, centres, located.side_px * 2.0 / sample_px, file)))

    return Jitter(step_px, at(0.0, 0.0), np.array([at(*shift) for shift in SHIFTS]))
