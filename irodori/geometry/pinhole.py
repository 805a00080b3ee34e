"""Pinhole camera over the mosaic of a sensor.

Superpixel coordinates: a superpixel is 2 x 2 mosaic pixels, and its centre has integer coordinates, x right, y down.
Mosaic coordinates run from 0 at the left edge of the first mosaic pixel.
"""

from dataclasses import dataclass

import numpy as np


def samples_from_superpixels(xy, sample_px: int):
    """Turn superpixel coordinates into those of a picture's samples.

    Parameters
    ----------
    xy : (..., 2) float
        Superpixels; the centre of a superpixel has integer coordinates.
    sample_px : int
        Mosaic pixels along the side of a sample: 2 for superpixels, 1 at full resolution.

    Returns
    -------
    (..., 2) float64, samples; the centre of a sample has integer coordinates
    """
    return (np.asarray(xy, dtype=np.float64) + 0.5) * (2.0 / sample_px) - 0.5


def superpixels_from_samples(xy, sample_px: int):
    """Turn coordinates of a picture's samples into superpixels, the inverse of `samples_from_superpixels`."""
    return (np.asarray(xy, dtype=np.float64) + 0.5) * (sample_px / 2.0) - 0.5


@dataclass(frozen=True)
class Pinhole:
    """A camera without distortion.

    Parameters
    ----------
    focal_px : float
        Focal length in mosaic pixels.
    centre_px : (2,) tuple
        Principal point in mosaic coordinates, x then y.
    width_px, height_px : int
        Size of the mosaic.
    """

    focal_px: float
    centre_px: tuple[float, float]
    width_px: int
    height_px: int

    @classmethod
    def from_optics(cls, optics: dict) -> "Pinhole":
        """Return the camera of a configuration's `optics` (focal length in mm, pitch in µm)."""
        return cls(
            focal_px=optics["focal_length_mm"] * 1000.0 / optics["pixel_pitch_um"],
            centre_px=tuple(optics["principal_point_px"]),
            width_px=optics["width_px"],
            height_px=optics["height_px"],
        )

    def project(self, points, position, world_from_camera) -> np.ndarray:
        """Project points to superpixel coordinates.

        Parameters
        ----------
        points : (..., 3) float, mm
        position : (3,) float, mm
        world_from_camera : (3, 3) float

        Returns
        -------
        (..., 2) float64, x then y; NaN for points not in front of the camera
        """
        local = (np.asarray(points, dtype=np.float64) - position) @ world_from_camera
        depth = np.where(local[..., 2] > 1e-6, local[..., 2], np.nan)
        mosaic = np.stack([local[..., 0] / depth, local[..., 1] / depth], axis=-1) * self.focal_px + self.centre_px
        return mosaic / 2.0 - 0.5

    def directions(self, mosaic_xy, world_from_camera) -> np.ndarray:
        """Return unit view directions of mosaic coordinates, (..., 2) to (..., 3)."""
        plane = (np.asarray(mosaic_xy, dtype=np.float64) - self.centre_px) / self.focal_px
        local = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return local @ np.asarray(world_from_camera).T
