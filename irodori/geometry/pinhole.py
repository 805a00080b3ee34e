"""Pinhole camera with lens distortion, in coordinates of the sensor's mosaic.

Superpixel coordinates: a superpixel is 2 x 2 mosaic pixels, and its centre has integer coordinates, x to the right, y
down. Mosaic coordinates are in mosaic pixels, and start with 0 at the outer corner of the first.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from irodori.core.errors import InputError
from irodori.geometry.distortion import COEFFICIENTS, coefficients_of, distort_all, fold_radius, undistort_all

if TYPE_CHECKING:
    from irodori.config.models import Optics

#: Margin around the picture that must have view directions too, because of blur and of shifts by a filter, mosaic
#: pixels.
_MARGIN_PX = 16
#: Distance from the camera's plane within which a point has no image, mm.
NEAREST_MM = 1e-6


#: Corrected cameras, of which there are thousands, have the distortion of the one that is typed.
_fold_radius = lru_cache(maxsize=16)(fold_radius)


def samples_from_superpixels(xy, sample_px: int):
    """Convert superpixel coordinates to coordinates in samples of a picture.

    Parameters
    ----------
    xy : (..., 2) float
        Superpixels; the centre of a superpixel has integer coordinates.
    sample_px : int
        Side of a sample in mosaic pixels: 2 for superpixels, 1 at full resolution.

    Returns
    -------
    (..., 2) float64
        Samples; the centre of a sample has integer coordinates.
    """
    return (np.asarray(xy, dtype=np.float64) + 0.5) * (2.0 / sample_px) - 0.5


def bayer_offsets_px(pattern: str) -> np.ndarray:
    """Return the positions of red, green and blue in a superpixel, (3, 2), x then y, in superpixels from its centre.

    Parameters
    ----------
    pattern : str
        The 2 x 2 mosaic row by row, such as ``RGGB``; the two greens are averaged.

    Raises
    ------
    ValueError
        If the pattern does not have one red, two greens and one blue.
    """
    if sorted(pattern) != ["B", "G", "G", "R"]:
        raise ValueError(f"mosaic pattern {pattern!r}; accepted: one R, two G, one B, such as 'RGGB'")
    places = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])
    return np.stack([places[[letter == band for letter in pattern]].mean(axis=0) for band in "RGB"])


def superpixels_from_samples(xy, sample_px: int):
    """Convert coordinates in samples of a picture to superpixels; the inverse of `samples_from_superpixels`."""
    return (np.asarray(xy, dtype=np.float64) + 0.5) * (sample_px / 2.0) - 0.5


@dataclass(frozen=True)
class Pinhole:
    """Pinhole camera with lens distortion in OpenCV's model (`irodori.geometry.distortion`).

    Parameters
    ----------
    focal_px : float
        Focal length in mosaic pixels.
    centre_px : (2,) tuple
        Principal point in mosaic coordinates, x then y.
    width_px, height_px : int
        Size of the mosaic.
    distortion : (8,) tuple
        k1, k2, p1, p2, k3, k4, k5, k6.
    quarter_turns : int
        How the camera is mounted on the rig, see `irodori.geometry.rig_frame.rig_from_camera`.
    """

    focal_px: float
    centre_px: tuple[float, float]
    width_px: int
    height_px: int
    distortion: tuple[float, ...] = (0.0,) * len(COEFFICIENTS)
    quarter_turns: int = 0

    @classmethod
    def from_optics(cls, optics: "Optics") -> "Pinhole":
        """Return the camera of the block ``optics`` of a configuration (focal length in mm, pixel pitch in µm).

        Raises
        ------
        InputError
            If the distortion folds inside the picture.
        """
        camera = cls(
            focal_px=optics.focal_length_mm * 1000.0 / optics.pixel_pitch_um,
            centre_px=optics.principal_point_px,
            width_px=optics.width_px,
            height_px=optics.height_px,
            distortion=tuple(coefficients_of(optics.distortion)),
            quarter_turns=optics.roll_deg // 90,
        )
        camera._check_fold()
        return camera

    @property
    def is_distorted(self) -> bool:
        """Whether any coefficient of the distortion differs from 0."""
        return any(self.distortion)

    @cached_property
    def fold(self) -> float:
        """Distance from the axis, at unit depth, beyond which the distortion model is not valid."""
        return _fold_radius(self.distortion)

    def _check_fold(self) -> None:
        """Raise `InputError` if the distortion leaves a pixel without a view direction."""
        if not self.is_distorted:
            return
        x = np.linspace(-_MARGIN_PX, self.width_px + _MARGIN_PX, 65)
        y = np.linspace(-_MARGIN_PX, self.height_px + _MARGIN_PX, 49)
        grid = np.stack(np.meshgrid(x, y), axis=-1)
        lost = np.isnan(self.directions(grid, np.eye(3))[..., 0])
        if lost.any():
            found = f"a distortion that folds over {lost.mean():.1%} of the picture"
            raise InputError("camera", "optics.distortion", found, "coefficients that hold over the whole picture")

    def _through(self, function, plane: np.ndarray) -> np.ndarray:
        out = np.empty_like(plane)
        flat, seen = np.ascontiguousarray(plane.reshape(-1, 2)), out.reshape(-1, 2)
        function(np.array(self.distortion), self.fold, flat, seen)
        return out

    def project(self, points, position, world_from_camera) -> np.ndarray:
        """Project points to superpixel coordinates.

        Parameters
        ----------
        points : (..., 3) float
            Points in the world, mm.
        position : (3,) float
            Centre of projection in the world, mm.
        world_from_camera : (3, 3) float
            Rotation.

        Returns
        -------
        (..., 2) float64
            x then y; NaN for points that are not in front of the camera, or so far from its axis that the distortion
            model is not valid.
        """
        local = (np.asarray(points, dtype=np.float64) - position) @ world_from_camera
        plane = local[..., :2] / np.where(local[..., 2:] > NEAREST_MM, local[..., 2:], np.nan)
        if self.is_distorted:
            plane = self._through(distort_all, plane)
        plane *= self.focal_px
        plane += self.centre_px
        plane *= 0.5
        plane -= 0.5
        return plane

    def directions(self, mosaic_xy, world_from_camera) -> np.ndarray:
        """Return unit view directions in the world, (..., 3), of mosaic coordinates, (..., 2).

        NaN where the distortion folds.
        """
        plane = (np.asarray(mosaic_xy, dtype=np.float64) - self.centre_px) / self.focal_px
        if self.is_distorted:
            plane = self._through(undistort_all, plane)
        local = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return local @ np.asarray(world_from_camera).T
