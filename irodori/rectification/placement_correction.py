"""Correction of the place of an object, its camera and its light, relative to their definitions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.capture_table import Pose
from irodori.core import store
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_object, rotation_xyz
from irodori.geometry.shapes.placement import Placement, laid, with_table
from irodori.geometry.shapes.shape import Shape

if TYPE_CHECKING:
    from irodori.config.models import Placing


class Quantity(NamedTuple):
    """Name, unit and description of one number of a correction; the description is used in sentences."""

    name: str
    unit: str
    text: str


#: The numbers of a correction, in their order: the object on the table, camera and lens, angles of the rig.
QUANTITIES = (
    Quantity("x_mm", "mm", "object along the table's x"),
    Quantity("y_mm", "mm", "object along the table's y"),
    Quantity("z_mm", "mm", "object above the table"),
    Quantity("about_x_deg", "deg", "object turned about the table's x"),
    Quantity("about_y_deg", "deg", "object turned about the table's y"),
    Quantity("about_z_deg", "deg", "object turned about the table's normal"),
    Quantity("camera_distance_mm", "mm", "distance of the camera"),
    Quantity("focal_length_percent", "%", "focal length"),
    Quantity("principal_x_px", "px", "principal point along the rows"),
    Quantity("principal_y_px", "px", "principal point along the columns"),
    Quantity("camera_deg", "deg", "every camera angle"),
    Quantity("light_deg", "deg", "every light angle"),
)
COUNT = len(QUANTITIES)
#: Index of the camera angle, of which each photograph also has an individual correction.
CAMERA = [quantity.name for quantity in QUANTITIES].index("camera_deg")
#: Index of the light angle.
LIGHT = CAMERA + 1


@dataclass(frozen=True)
class Correction:
    """Corrections added to the definitions of an object, its camera and its rig.

    The object is rotated about the origin of its frame, around x, then y, then z of the table, and then moved along the
    table's axes. The table's axes coincide with those of the rig at zero tilt and zero turn.

    Parameters
    ----------
    values : sequence of 12 float
        Corrections in the order and the units of `QUANTITIES`.
    rotation_deg : (3,) float
        Typed rotation of the object from its first placement, which comes before the corrections.
    raised_mm : float
        Height of the object's origin above that of the first placement, before the corrections.
    """

    values: tuple[float, ...] = (0.0,) * COUNT
    rotation_deg: tuple[float, ...] = (0.0, 0.0, 0.0)
    raised_mm: float = 0.0

    @classmethod
    def of(cls, values: Sequence[float] | np.ndarray) -> "Correction":
        """Return the correction with the given 12 numbers, converted to float."""
        return cls(tuple(float(value) for value in values))

    @classmethod
    def laid(cls, shape: Shape, rotation_deg: Sequence[float]) -> "Correction":
        """Return no correction of an object that is turned from its first placement."""
        return cls(rotation_deg=tuple(rotation_deg), raised_mm=float(laid(shape, rotation_deg).translation_mm[2]))

    def by(self, values: Sequence[float] | np.ndarray) -> "Correction":
        """Return the correction of the same placement with other 12 numbers."""
        return replace(self, values=tuple(np.asarray(values, dtype=float).tolist()))

    @classmethod
    def load(cls, path) -> "Correction":
        """Read the correction from a file that `irodori.rectification.object_registration.register_object` wrote.

        Raises
        ------
        InputError
            If the file does not hold 12 finite corrections.
        """
        with store.open_file(path) as file:
            file.require_axes({"correction": "quantity"}, quantity=COUNT)
            return cls.of(file.read_within("correction"))

    @property
    def table_from_object(self) -> np.ndarray:
        """Rotation matrix (3, 3) of the object on the table."""
        rotation = rotation_xyz(self.values[3:6])
        return rotation @ rotation_xyz(self.rotation_deg) if any(self.rotation_deg) else rotation

    @property
    def translation_mm(self) -> np.ndarray:
        """Displacement (3,) of the object's origin on the table, mm."""
        x, y, z = self.values[:3]
        return np.array([x, y, z + self.raised_mm])

    def pinhole(self, typed: Pinhole) -> Pinhole:
        """Return a camera with its focal length and principal point corrected."""
        _, percent, x, y = self.values[6:10]
        centre = typed.centre_px[0] + x, typed.centre_px[1] + y
        return replace(typed, focal_px=typed.focal_px * (1.0 + percent / 100.0), centre_px=centre)

    def camera_distance_mm(self, typed: float) -> float:
        """Return the corrected distance of the camera, mm."""
        return typed + self.values[6]

    def pose(self, typed: Pose, own_camera_deg: float = 0.0) -> Pose:
        """Return the corrected pose of a photograph, with an individual correction of its camera angle, degrees."""
        camera, light = self.values[CAMERA], self.values[LIGHT]
        return replace(typed, light_deg=typed.light_deg + light, camera_deg=typed.camera_deg + camera + own_camera_deg)

    def placements(self, shape: Shape, pose: Pose, table_radius_mm: float) -> list[Placement]:
        """Return the corrected placements of object (0) and table (1, absent for radius 0) in the rig's frame."""
        lain = Placement(shape, self.table_from_object, self.translation_mm)
        return with_table(lain, rig_from_object(pose), table_radius_mm)

    def in_rig(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation (3, 3) and displacement (3,) mm of the object in the rig's frame."""
        rotation = rig_from_object(pose)
        return rotation @ self.table_from_object, rotation @ self.translation_mm


AS_TYPED = Correction()


#: Key of `place` with the standard deviation of each correction, in the order of `QUANTITIES`.
PRIOR_KEYS = (
    *("translation_mm",) * 3,
    *("rotation_deg",) * 3,
    "camera_distance_mm",
    "focal_length_percent",
    *("principal_point_px",) * 2,
    "camera_deg",
    "light_deg",
)


def prior_sigma(placing: "Placing") -> np.ndarray:
    """Return the standard deviations of the definitions, (12,) in the order and the units of `QUANTITIES`."""
    return np.array([getattr(placing, key) for key in PRIOR_KEYS])
