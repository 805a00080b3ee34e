"""Mistakes of a person or a camera that spoil single photographs.

Unlike the imperfections of a working rig, mistakes should be noticed, and the photograph taken again.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter, shift

from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera


@dataclass(frozen=True)
class Mishap:
    """Mistakes in a photograph; without arguments there is none.

    Parameters
    ----------
    subject, filter : str, optional
        True subject in front of the lens (``dark``: the lens cap is on) and true state of the comb filter.
    lamp : float
        Power of the lamp relative to normal, 0 if it is off.
    aperture : float
        Transmitted light relative to the aperture that the file states.
    ambient : float
        Light of the room, for example through an open door, as the response of a white sheet in every pixel.
    blur_px : float
        Standard deviation of the blur of a lens out of focus, superpixels.
    moved_px : (float, float)
        Displacement of the object in the picture, superpixels down and to the right.
    body : str
        Model name of another camera that is stated in the file.
    cut_px : int
        Number of rows that are missing from the picture, mosaic pixels.
    delivers_last : bool
        Whether the camera delivers its last photograph again.
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
        """Return the responses of a mosaic, (height, width), changed by lamp, aperture, room light, blur and shift."""
        changed = response * self.lamp + self.ambient
        if not self.blur_px and not any(self.moved_px):
            return changed * self.aperture
        # The four positions of the mosaic have different colours and are processed separately.
        for row in (0, 1):
            for column in (0, 1):
                part = changed[row::2, column::2]
                if any(self.moved_px):
                    part = shift(part, self.moved_px, order=1, mode="nearest")
                changed[row::2, column::2] = gaussian_filter(part, self.blur_px) if self.blur_px else part
        return changed * self.aperture


class Accident(VirtualCamera):
    """A virtual camera to which mishaps happen: at a photograph so many times in a row.

    It remembers the pictures of an object before the optics in `seen`, which cameras of one plate may share.
    """

    seen: dict | None = None
    _now = Mishap()
    _last = None

    def happen(self, file: str, mishap: Mishap, times: int = 1) -> None:
        self._file, self._then, self._left, self.tried = file, mishap, times, getattr(self, "tried", [])

    def capture(self, shot, path):
        hit = shot.file == self._file and self._left > 0
        self._left -= hit
        self.tried.append(shot.file)
        self._now = self._then if hit else Mishap()
        self.model = self._now.body or VirtualCamera.model
        super().capture(shot, path)

    def _seen(self, shot):
        set_up, level = self.bench, self.faults.light(shot)
        self.bench = replace(
            set_up, subject=self._now.subject or set_up.subject, filter=self._now.filter or set_up.filter
        )
        response, hot_rate = super()._seen(shot)
        self.bench = set_up
        return self._now.seen(level * response) / level, hot_rate

    def _object(self, pose, plate, weights):
        if self.seen is None:
            return super()._object(pose, plate, weights)
        key = pose, plate.tobytes(), weights.tobytes()
        if key not in self.seen:
            self.seen[key] = super()._object(pose, plate, weights)
        return self.seen[key]

    def _exposed(self, shot):
        if self._last is None or not self._now.delivers_last:
            self._last = super()._exposed(shot)
        return self._last[: len(self._last) - self._now.cut_px]
