"""Resampling of photographs to an ideal camera without distortion, like that of the renderer."""

import math
from dataclasses import dataclass

import numpy as np

from irodori.config.models import PerspectiveView, ScenePhotograph, Size
from irodori.geometry.pinhole import Pinhole, samples_from_superpixels

_BORDER = 65  # points along each side of the sensor
_VALID = 1.0 - 1e-4  # share of the weights that must fall on valid samples; the rest allows for rounding


@dataclass(frozen=True)
class IdealView:
    """Undistorted pinhole picture with the same centre of projection and axis as a camera.

    Parameters
    ----------
    pinhole : Pinhole
        The camera, with distortion.
    block : int
        Side of a pixel of this picture in superpixels of the camera, at the camera's axis.
    focal_px : float
        Focal length in pixels.
    width, height : int
        Size in pixels; even, so that the axis lies between pixels.
    """

    pinhole: Pinhole
    block: int
    focal_px: float
    width: int
    height: int

    @classmethod
    def covering(cls, pinhole: Pinhole, block: int, margin_px: float = 0.0) -> "IdealView":
        """Return the smallest view that covers the sensor and a margin (mosaic pixels) around it."""
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
        """Size of the picture, in the form of a scene's ``image``."""
        return Size(width=self.width, height=self.height)

    def view(self, placed: ScenePhotograph) -> PerspectiveView:
        """Return the view of a scene from the place of a photograph's camera."""
        return PerspectiveView(
            position_mm=placed.position_mm,
            target_mm=placed.target_mm,
            up=placed.up,
            field_of_view_deg=self.field_of_view_deg,
        )

    def rays(self) -> np.ndarray:
        """Return unit vectors to the pixel centres, (height, width, 3), in camera axes: x right, y down, z forward."""
        x = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal_px
        y = (np.arange(self.height) + 0.5 - self.height / 2) / self.focal_px
        local = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1)
        return local / np.linalg.norm(local, axis=-1, keepdims=True)

    def pixels_of(self, mosaic_xy: np.ndarray) -> np.ndarray:
        """Convert places of the camera's mosaic to places in this picture.

        Parameters
        ----------
        mosaic_xy : (..., 2) float
            Mosaic coordinates, x then y.

        Returns
        -------
        (..., 2) float64
            Pixels, x then y, with integers at pixel centres.
        """
        direction = self.pinhole.directions(mosaic_xy, np.eye(3))
        centre = (np.array([self.width, self.height]) - 1.0) / 2.0
        return direction[..., :2] / direction[..., 2:] * self.focal_px + centre

    def resample(self, picture: np.ndarray, valid: np.ndarray, sample_px: int) -> tuple[np.ndarray, np.ndarray]:
        """Resample a picture of the camera to this view, averaging over each pixel.

        Each pixel is sampled on a grid as dense as the samples of the camera, with linear interpolation.

        Parameters
        ----------
        picture : (rows, columns, n) float
        valid : (rows, columns) bool
        sample_px : int
            Side of a sample in mosaic pixels.

        Returns
        -------
        mean : (height, width, n) float64
            Mean of the valid samples; NaN where there are none.
        whole : (height, width) bool
            Whether all samples in the mean are valid.
        """
        side = self.block * 2 // sample_px
        fine = IdealView(self.pinhole, 1, self.focal_px * side, self.width * side, self.height * side)
        place = fine.pinhole.project(fine.rays(), np.zeros(3), np.eye(3))
        x, y = np.moveaxis(samples_from_superpixels(place, sample_px), -1, 0)
        # Directions that the camera does not image are treated as outside the picture.
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
        """Average a finer picture of the same camera, with one pixel per superpixel, to the pixels of this view.

        Parameters
        ----------
        fine : (rows, columns, ...) float
            Picture that is centred on the axis and covers at least this view.

        Raises
        ------
        ValueError
            If it is too small.
        """
        rows, columns = ((a - self.block * b) // 2 for a, b in zip(fine.shape, (self.height, self.width), strict=False))
        if min(rows, columns) < 0:
            raise ValueError(
                f"a picture of {fine.shape[1]} x {fine.shape[0]} pixels; "
                f"accepted: one that covers {self.width} x {self.height}"
            )
        block = self.block
        inner = fine[rows : rows + block * self.height, columns : columns + block * self.width]
        return inner.reshape(self.height, block, self.width, block, -1).mean(axis=(1, 3))
