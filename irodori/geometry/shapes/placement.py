"""Placement of shapes in a world, and of an object on the table of the rig."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.shape import Shape


@dataclass(frozen=True)
class Placement:
    """A shape placed in a world: ``world = scale * rotation @ object + translation``.

    Parameters
    ----------
    shape : Shape
    rotation : (3, 3) float
        world_from_object.
    translation_mm : (3,) float
    scale : float
    """

    shape: Shape
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation_mm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0

    def points(self, position: np.ndarray) -> np.ndarray:
        """Convert positions from the object frame to the world, (..., 3) mm."""
        return self.scale * (position @ self.rotation.T) + self.translation_mm

    def corners(self) -> np.ndarray:
        """Return the four corners (4, 3) of a plate in the world, counter-clockwise seen from its face."""
        half_x, half_y = self.shape.size_mm[0] / 2, self.shape.size_mm[1] / 2
        signs = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
        return self.points(signs * [half_x, half_y, 0.0])


def laid(shape: Shape, rotation_deg: Sequence[float]) -> Placement:
    """Place an object on the table, turned from how it lies first; the placed shape is in the frame of the table.

    It stands with its lowest point on the table, which is where it was. This placement is composed before the turn of
    the rig, and the turn of an object that is not laid exactly so.

    Parameters
    ----------
    shape : Shape
    rotation_deg : (3,) float
        Rotation about x, then y, then z of the table; zeros for the first placement.
    """
    if not any(rotation_deg):
        return Placement(shape)
    turned = Placement(shape, rotation_xyz(rotation_deg))
    return replace(turned, translation_mm=np.array([0.0, 0.0, shape.table_height_mm - _table_under_mm(turned)]))


def _table_under_mm(lain: Placement) -> float:
    """Return the height of the table's top under an object that lies so on it, mm."""
    shape, height_mm = lain.shape, float(lain.translation_mm[2])
    if shape.ball_mm is not None or shape.is_flat:
        return height_mm + shape.table_height_mm
    # A table that cuts through an object, which registration turns by a fraction of a degree, would hide a part of it.
    return height_mm + float((shape.facetted(shape.reach_mm).vertices_mm @ lain.rotation[2]).min())


def reaches(placements: Sequence[Placement]) -> np.ndarray:
    """Return the size scale of each placed shape, (n,) mm: the largest distance of its points from its origin.

    Endless shapes get the largest reach of the other shapes, or 1 mm if there are none.
    """
    found = np.array([p.shape.reach_mm * p.scale for p in placements])
    endless = np.array([p.shape.is_endless for p in placements])
    others = found[~endless]
    return np.where(endless, others.max() if others.size else 1.0, found)


def on_table(
    shape: Shape, rotation: np.ndarray, table_radius_mm: float, rotation_deg: Sequence[float] = (0.0, 0.0, 0.0)
) -> list[Placement]:
    """Place an object on the table of the rig, in the rig's frame.

    Shape 0 is the object, shape 1 the table, a square; it is absent for radius 0. ``rotation`` is that of the table in
    the rig, and ``rotation_deg`` that of the object on the table, see `laid`.
    """
    return with_table(laid(shape, rotation_deg), rotation, table_radius_mm)


def with_table(lain: Placement, rotation: np.ndarray, table_radius_mm: float) -> list[Placement]:
    """Return the placements of `on_table` for an object that lies so in the frame of the table, its lowest point on it.

    Under a flat object, the table's top lies below its middle by the thickness of flat objects.
    """
    from irodori.geometry.shapes.plate import Plate

    placements = [replace(lain, rotation=rotation @ lain.rotation, translation_mm=rotation @ lain.translation_mm)]
    if table_radius_mm > 0:
        top = Plate(2 * table_radius_mm, 2 * table_radius_mm)
        placements.append(Placement(top, rotation, rotation @ np.array([0.0, 0.0, _table_under_mm(lain)])))
    return placements
