"""Mistakes with one photograph at the bench or in the camera, for practice and for tests.

Unlike the imperfections of a sound rig, these are mistakes: a person is expected to see them and to take the photograph
again.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mishap:
    """Mistakes; without arguments there is none.

    Parameters
    ----------
    subject, filter : str, optional
        What truly stands before the lens (``dark``: the cap is on), and the true state of the comb filter.
    lamp : float
        Power of the lamp beside the usual, 0 where it is off.
    aperture : float
        Light that the lens lets through beside what its file says.
    ambient : float
        Light of the room through an open door, as the response of a white sheet everywhere.
    blur_px : float
        Standard deviation of the blur of a lens out of focus, superpixels.
    moved_px : (float, float)
        How far the object stands from where it stood, superpixels down and to the right.
    body : str
        Model of another camera.
    cut_px : int
        Rows by which the picture is smaller, mosaic pixels.
    delivers_last : bool
        The camera delivers its last photograph once more.
    """

    subject: str | None = None
    filter: str | None = None
    lamp: float = 1.0
    aperture: float = 1.0
    ambient: float = 0.0
    blur_px: float = 0.0
    moved_px: tuple[float, float] = (0.0, 0.0)
    body: str | None = None
    cut_px: int = 0
    delivers_last: bool = False

    def seen(self, response: np.ndarray) -> np.ndarray:
        """Return the response of each mosaic pixel as it is with the mistakes, (height, width)."""
        changed = response * self.lamp + self.ambient
        if not self.blur_px and not any(self.moved_px):
            return changed * self.aperture
        from scipy.ndimage import gaussian_filter, shift  # slow to import

        # Each place of the mosaic has its own colour.
        for row in (0, 1):
            for column in (0, 1):
                part = changed[row::2, column::2]
                if any(self.moved_px):
                    part = shift(part, self.moved_px, order=1, mode="nearest")
                changed[row::2, column::2] = gaussian_filter(part, self.blur_px) if self.blur_px else part
        return changed * self.aperture
