"""Lamp of the rig, near or far: direction and irradiance at each point.

A response is relative to a perfect diffuser at the same place, lit at normal incidence, so the inverse-square fall-off
of a near lamp has to be divided out at each texel. Division by the white reference has already removed a fall-off, but
that over the plane and in the pose of the white reference, not that over the object. Therefore rectification multiplies
by the irradiance on the white reference (`Lamp.on_white`) and divides by the irradiance at the texel
(`Lamp.seen_from`). On the plane of the white reference, in its pose, the two differ only by a cosine. Vignetting, which
the white reference measures in the same pixels, stays divided out.
"""

import math
from dataclasses import dataclass

import numpy as np

from irodori.config.capture_table import Pose
from irodori.core.errors import InputError
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera, to_light


@dataclass(frozen=True)
class Lamp:
    """A small lamp in the direction of the light angle.

    Parameters
    ----------
    distance_mm : float
        Distance from the origin of the rig; infinite for a far lamp.
    """

    distance_mm: float = math.inf

    @classmethod
    def at(cls, distance_mm: float | None) -> "Lamp":
        """Return the lamp at the distance ``light.distance_mm`` of a rig's definition; a far lamp for None."""
        return FAR if distance_mm is None else cls(distance_mm)

    @property
    def is_near(self) -> bool:
        """Whether the lamp has a finite distance."""
        return math.isfinite(self.distance_mm)

    def seen_from(self, position, pose: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return direction, irradiance and distance of the lamp at points.

        Parameters
        ----------
        position : (..., 3) float
            Points in the rig's frame, mm.
        pose : Pose

        Returns
        -------
        direction : (..., 3) float64
            Unit vectors to the lamp.
        power : (...) float64
            Irradiance normal to the beam, relative to that at the origin.
        distance : (...) float64
            Distance to the lamp, mm; infinite for a far lamp.
        """
        position = np.asarray(position, dtype=np.float64)
        if not self.is_near:
            shape = position.shape[:-1]
            return np.broadcast_to(to_light(pose), position.shape), np.ones(shape), np.full(shape, np.inf)
        way = self.distance_mm * to_light(pose) - position
        distance = np.linalg.norm(way, axis=-1)
        return way / distance[..., None], (self.distance_mm / distance) ** 2, distance

    def on_white(self, mosaic_xy, pinhole: Pinhole, camera_distance_mm: float, pose: Pose) -> np.ndarray:
        """Return the irradiance on the white reference, relative to that at its centre, (...) float64.

        Parameters
        ----------
        mosaic_xy : (..., 2) float
            Places in the picture, mosaic coordinates.
        pinhole : Pinhole
        camera_distance_mm : float
        pose : Pose
            Pose in which the white reference was photographed. Its face contains the origin and is tilted like the
            table.

        Raises
        ------
        InputError
            If a pixel does not see the lit side of the white reference.
        """
        mosaic_xy = np.asarray(mosaic_xy, dtype=np.float64)
        if not self.is_near:
            return np.ones(mosaic_xy.shape[:-1])
        normal = rig_from_object(pose)[:, 2]
        view = pinhole.directions(mosaic_xy, rig_from_camera(pose, pinhole.quarter_turns))
        eye = camera_distance_mm * to_camera(pose)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = -(eye @ normal) / (view @ normal)
            point = eye + along[..., None] * view
            direction, power, _ = self.seen_from(point, pose)
            cosine = direction @ normal
        if not ((along > 0) & np.isfinite(along) & (cosine > 0)).all():
            found = f"a white reference that some pixels do not see lit ({pose.name})"
            raise InputError("camera", "poses.white", found, "a pose in which it fills the picture")
        return power * cosine / float(to_light(pose) @ normal)


FAR = Lamp()
