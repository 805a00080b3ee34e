"""Outline of an object in a stated pose, as the camera of the rig would see it, for drawing over photographs."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.embree import Tracer
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape

if TYPE_CHECKING:
    from irodori.config.capture_table import Pose
    from irodori.config.models import ObjectShape, Optics

#: Largest number of columns of the grid on which an outline is computed; previews of photographs are as wide.
_SAMPLES = 900


@dataclass(frozen=True)
class Outline:
    """Outline of an object in a photograph, if object, camera and pose are as defined.

    Parameters
    ----------
    path : str
        SVG path in superpixels, with superpixel (0, 0) from 0 to 1; empty if the object is outside the picture.
    box : (4,) tuple of int, optional
        First and last column, first and last row covered, superpixels; None if the object is outside the picture.
    size : (2,) tuple of int
        Columns and rows of the picture, superpixels.
    """

    path: str
    box: tuple[int, int, int, int] | None
    size: tuple[int, int]

    def __str__(self) -> str:
        width, height = self.size
        if self.box is None:
            return "by its pose the object is outside the picture"
        left, right, top, bottom = self.box
        cut = [
            name
            for name, meets in (
                ("left", left == 0),
                ("right", right == width - 1),
                ("upper", top == 0),
                ("lower", bottom == height - 1),
            )
            if meets
        ]
        place = f"{left / width:.0%} to {(right + 1) / width:.0%} of the picture's width and {top / height:.0%} to "
        place += f"{(bottom + 1) / height:.0%} of its height"
        beyond = f", and beyond its {' and '.join(cut)} edge" if cut else ""
        return f"by its pose the object lies from {place}{beyond}"


class ProjectedOutlines:
    """Outlines of one object before one camera; the outline of each pose is computed once.

    Parameters
    ----------
    shape : ObjectShape
    optics : Optics
    distance_mm : float
        From the origin of the rig to the centre of projection.
    """

    def __init__(self, shape: "ObjectShape", optics: "Optics", distance_mm: float) -> None:
        self._definition, self._optics, self._distance_mm = shape, optics, distance_mm
        self._side = max(1, -(-(optics.width_px // 2) // _SAMPLES))
        self._known: dict[str, Outline] = {}

    @cached_property
    def _seen(self) -> tuple[Shape, Pinhole]:
        """Shape and camera, loaded on first use because a mesh may be large."""
        return Shape.from_definition(self._definition), Pinhole.from_optics(self._optics)

    def of(self, pose: "Pose") -> Outline:
        """Return the outline in a pose, along the edges of blocks of superpixels.

        Raises
        ------
        InputError
            If the shape is a mesh whose file cannot be read, or the distortion folds inside the picture.
        """
        if pose.name not in self._known:
            side, size = self._side, (self._optics.width_px // 2, self._optics.height_px // 2)
            mask = silhouette(*self._seen, self._distance_mm, pose, side)
            rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            box = None
            if len(rows):
                ends = (columns[0], columns[-1] + 1, rows[0], rows[-1] + 1)
                left, right, top, bottom = (int(end) * side for end in ends)
                box = left, min(right, size[0]) - 1, top, min(bottom, size[1]) - 1
            self._known[pose.name] = Outline(svg_path(mask, side), box, size)
        return self._known[pose.name]


def silhouette(shape: Shape, pinhole: Pinhole, distance_mm: float, pose: "Pose", side: int = 1) -> np.ndarray:
    """Return the blocks of superpixels with their centre covered by an object in a pose.

    Parameters
    ----------
    shape : Shape
    pinhole : Pinhole
    distance_mm : float
        From the origin of the rig to the centre of projection.
    pose : Pose
    side : int
        Side of a block in superpixels.

    Returns
    -------
    (rows, columns) bool
        Includes incomplete blocks at the right and lower edges of the picture.
    """
    rows, columns = (-(-(length // 2) // side) for length in (pinhole.height_px, pinhole.width_px))
    mask = np.zeros((rows, columns), dtype=bool)
    axes, eye = rig_from_camera(pose, pinhole.quarter_turns), distance_mm * to_camera(pose)
    # Rays are traced only where the cube around the object may be seen.
    reach = shape.reach_mm * 1.05
    across = np.stack(np.meshgrid(*[(-reach, 0.0, reach)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    seen = (pinhole.project(across, eye, axes) + 0.5) / side
    low, high = np.zeros(2, dtype=int), np.array([columns, rows])
    if np.isfinite(seen).all() and distance_mm > math.sqrt(3.0) * reach:
        low = np.clip(np.floor(seen.min(axis=0)).astype(int), 0, [columns, rows])
        high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 1, 0, [columns, rows])
    if not (low < high).all():
        return mask
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    centres = np.stack([2.0 * x + 1.0, 2.0 * y + 1.0], axis=-1).reshape(-1, 2) * side
    directions = pinhole.directions(centres, axes)
    known = np.isfinite(directions[:, 0])
    hit = np.zeros(len(directions), dtype=bool)
    tracer = Tracer([Placement(shape, rig_from_object(pose))])
    origins = np.broadcast_to(eye, directions[known].shape).copy()
    hit[known] = tracer.occluded(origins, np.ascontiguousarray(directions[known]))
    mask[low[1] : high[1], low[0] : high[0]] = hit.reshape(x.shape)
    return mask


def svg_path(mask: np.ndarray, side: int = 1) -> str:
    """Return the edges between covered and other blocks as an SVG path, with block (0, 0) from 0 to ``side``."""
    padded = np.pad(mask, 1)
    parts = []
    for row, column, length in _runs(padded[1:, 1:-1] != padded[:-1, 1:-1]):
        parts.append(f"M{column * side} {row * side}h{length * side}")
    for column, row, length in _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T):
        parts.append(f"M{column * side} {row * side}v{length * side}")
    return "".join(parts)


def _runs(edges: np.ndarray):
    """Yield (line, start, length) of the runs of true values along the lines of an array."""
    steps = np.diff(np.pad(edges, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    starts, ends = np.argwhere(steps == 1), np.argwhere(steps == -1)
    for (line, first), (_, last) in zip(starts.tolist(), ends.tolist(), strict=True):
        yield line, first, last - first
