"""Placed shapes: where shapes stand in a world, and an object on the rig's table."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from irodori.geometry.shapes.shape import Shape


@dataclass(frozen=True)
class Placement:
    """A shape standing in a world: ``world = scale * rotation @ object + translation``.

    Parameters
    ----------
    shape : Shape
    rotation : (3, 3) float, world_from_object
    translation_mm : (3,) float
    scale : float
    """

    shape: Shape
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation_mm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0

    def points(self, position: np.ndarray) -> np.ndarray:
        """Return world positions of object-frame positions, (..., 3) mm."""
        return self.scale * (position @ self.rotation.T) + self.translation_mm

    def corners(self) -> np.ndarray:
        """Return the four corners (4, 3) of a plate in the world, counter-clockwise seen from its face."""
        half_x, half_y = self.shape.size_mm[0] / 2, self.shape.size_mm[1] / 2
        signs = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
        return self.points(signs * [half_x, half_y, 0.0])


def reaches(placements: Sequence[Placement]) -> np.ndarray:
    """Return the reach of each placed shape about its own origin, (n,) mm: what lengths at its surface compare to.

    That of an endless shape is the largest of the others, 1 mm where there is none.
    """
    found = np.array([p.shape.reach_mm * p.scale for p in placements])
    endless = np.array([p.shape.is_endless for p in placements])
    others = found[~endless]
    return np.where(endless, others.max() if others.size else 1.0, found)


def on_table(shape: Shape, rotation: np.ndarray, table_radius_mm: float) -> list[Placement]:
    """Return an object (shape 0) on the rig's table (shape 1, a square; absent for radius 0) in the rig's frame."""
    from irodori.geometry.shapes.plate import Plate

    placements = [Placement(shape, rotation)]
    if table_radius_mm > 0:
        top = Plate(2 * table_radius_mm, 2 * table_radius_mm)
        placements.append(Placement(top, rotation, rotation @ np.array([0.0, 0.0, shape.table_height_mm])))
    return placements
