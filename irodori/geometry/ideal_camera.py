"""Resampling of photographs to an ideal camera without distortion, as the renderer uses."""

import math
from dataclasses import dataclass

import numpy as np

from irodori.config.models import PerspectiveView, ScenePhotograph, Size
from irodori.geometry.pinhole import Pinhole, samples_from_superpixels

_BORDER = 65  # points along each side of the sensor
_VALID = 1.0 - 1e-4  # part of the weights that must fall on valid samples; the rest is rounding


@dataclass(frozen=True)
class IdealView:
    """A pinhole picture that covers all that a camera sees.

    Parameters
    ----------
    pinhole : Pinhole
        The camera.
    block : int
        Superpixels of the camera along the side of a pixel, at the camera's axis.
    focal_px : float
        Focal length in pixels.
    width, height : int
        Even, so that the axis lies between pixels.
    """

    pinhole: Pinhole
    block: int
    focal_px: float
    width: int
    height: int

    @classmethod
    def covering(cls, pinhole: Pinhole, block: int, margin_px: float = 0.0) -> "IdealView":
        """Return the view that just covers a sensor and a margin (mosaic pixels) around it."""
        x, y = (np.linspace(-margin_px, side + margin_px, _BORDER) for side in (pinhole.width_px, pinhole.height_px))
        ends = [
            np.stack(np.broadcast_arrays(a, b), axis=-1) for a, b in ((x, y[:1]), (x, y[-1:]), (x[:1], y), (x[-1:], y))
        ]
        direction = pinhole.directions(np.concatenate(ends), np.eye(3))
        focal_px = pinhole.focal_px / (2.0 * block)
        half = focal_px * np.abs(direction[:, :2] / direction[:, 2:]).max(axis=0)
        width, height = (2 * math.ceil(side - 1e-6) for side in half)
        return cls(pinhole, block, focal_px, width, height)

    @property
    def field_of_view_deg(self) -> float:
        """Vertical field of view, degrees."""
        return math.degrees(2.0 * math.atan(self.height / 2.0 / self.focal_px))

    @property
    def image(self) -> Size:
        """Size as a scene's ``image`` has it."""
        return Size(width=self.width, height=self.height)

    def view(self, placed: ScenePhotograph) -> PerspectiveView:
        """Return the view of a scene from where the camera of a photograph stands."""
        return PerspectiveView(
            position_mm=placed.position_mm,
            target_mm=placed.target_mm,
            up=placed.up,
            field_of_view_deg=self.field_of_view_deg,
        )

    def rays(self) -> np.ndarray:
        """Return unit directions of the pixels' centres in the camera's axes (x right, y down), (height, width, 3)."""
        x = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal_px
        y = (np.arange(self.height) + 0.5 - self.height / 2) / self.focal_px
        local = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1)
        return local / np.linalg.norm(local, axis=-1, keepdims=True)

    def pixels_of(self, mosaic_xy: np.ndarray) -> np.ndarray:
        """Return where the picture shows what falls on places of the mosaic.

        Parameters
        ----------
        mosaic_xy : (..., 2) float

        Returns
        -------
        (..., 2) float64, x then y; the centre of a pixel has integer coordinates
        """
        direction = self.pinhole.directions(mosaic_xy, np.eye(3))
        centre = (np.array([self.width, self.height]) - 1.0) / 2.0
        return direction[..., :2] / direction[..., 2:] * self.focal_px + centre

    def resample(self, picture: np.ndarray, valid: np.ndarray, sample_px: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a camera's picture as this view shows it: the mean over each pixel.

        A pixel is looked at in as many places as the camera has samples in it, interpolated between samples.

        Parameters
        ----------
        picture : (rows, columns, n) float
        valid : (rows, columns) bool
        sample_px : int
            Mosaic pixels along the side of a sample.

        Returns
        -------
        mean : (height, width, n) float64
            Of the valid samples; NaN where there are none.
        whole : (height, width) bool
            Where every sample that takes part is valid.
        """
        side = self.block * 2 // sample_px
        fine = IdealView(self.pinhole, 1, self.focal_px * side, self.width * side, self.height * side)
        place = fine.pinhole.project(fine.rays(), np.zeros(3), np.eye(3))
        x, y = np.moveaxis(samples_from_superpixels(place, sample_px), -1, 0)
        # A direction without place lies outside of the picture.
        at = np.nan_to_num(np.stack([y, x]), nan=-10.0)

        def looked_up(values: np.ndarray) -> np.ndarray:
            from scipy import ndimage  # slow to import

            found = ndimage.map_coordinates(values, at, order=1, mode="constant", cval=0.0, prefilter=False)
            return found.reshape(self.height, side, self.width, side).mean(axis=(1, 3))

        kept = np.where(valid[..., None], picture, 0.0)
        share = looked_up(valid.astype(np.float64))
        sums = np.stack([looked_up(kept[..., i].astype(np.float64)) for i in range(picture.shape[2])], axis=-1)
        some = np.broadcast_to(share[..., None] > 1.0 - _VALID, sums.shape)
        mean = np.divide(sums, share[..., None], out=np.full_like(sums, np.nan), where=some)
        return mean, share > _VALID

    def gathered(self, fine: np.ndarray) -> np.ndarray:
        """Return this view of a finer one of the same camera, one superpixel a pixel, at least as wide: block means."""
        rows, columns = ((a - self.block * b) // 2 for a, b in zip(fine.shape, (self.height, self.width), strict=False))
        if min(rows, columns) < 0:
            raise ValueError(
                f"a picture of {fine.shape[1]} x {fine.shape[0]} pixels; "
                f"accepted: one that covers {self.width} x {self.height}"
            )
        block = self.block
        inner = fine[rows : rows + block * self.height, columns : columns + block * self.width]
        return inner.reshape(self.height, block, self.width, block, -1).mean(axis=(1, 3))
