"""The rig's lamp, far or near: direction and irradiance at each point.

Responses count against a perfect diffuser lit at normal incidence *where it stands*: a near lamp's inverse-square
fall-off is divided out per texel. The white reference has already divided a picture by the fall-off over its own
plane, in its own pose; for the object that is the wrong one. Rectification multiplies it back in (`Lamp.on_white`) and
divides by the texel's own (`Lamp.seen_from`); on the white's plane, in its pose, the two differ by the cosine alone.
Vignetting, which the white reference measures in the same pixels, stays divided out.
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
        From the origin of the rig; infinite for a far light.
    """

    distance_mm: float = math.inf

    @classmethod
    def at(cls, distance_mm: float | None) -> "Lamp":
        """Return the lamp at the `light.distance_mm` of a rig; a far one for None."""
        return FAR if distance_mm is None else cls(distance_mm)

    @property
    def is_near(self) -> bool:
        """Whether its distance matters."""
        return math.isfinite(self.distance_mm)

    def seen_from(self, position, pose: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return how points are lit.

        Parameters
        ----------
        position : (..., 3) float
            In the rig's frame, mm.
        pose : Pose

        Returns
        -------
        direction : (..., 3) float64
            Unit vectors to the lamp.
        power : (...) float64
            Irradiance normal to the beam, 1 at the origin.
        distance : (...) float64
            To the lamp, mm; infinite for a far one.
        """
        position = np.asarray(position, dtype=np.float64)
        if not self.is_near:
            shape = position.shape[:-1]
            return np.broadcast_to(to_light(pose), position.shape), np.ones(shape), np.full(shape, np.inf)
        way = self.distance_mm * to_light(pose) - position
        distance = np.linalg.norm(way, axis=-1)
        return way / distance[..., None], (self.distance_mm / distance) ** 2, distance

    def on_white(self, mosaic_xy, pinhole: Pinhole, camera_distance_mm: float, pose: Pose) -> np.ndarray:
        """Return the irradiance of the white reference over that at its centre, (...) float64.

        Parameters
        ----------
        mosaic_xy : (..., 2) float
            Where the picture shows it, mosaic coordinates.
        pinhole : Pinhole
        camera_distance_mm : float
        pose : Pose
            In which it is photographed, its face through the origin, as the table is tilted.

        Raises
        ------
        InputError
            If a pixel does not see its lit side.
        """
        mosaic_xy = np.asarray(mosaic_xy, dtype=np.float64)
        if not self.is_near:
            return np.ones(mosaic_xy.shape[:-1])
        normal = rig_from_object(pose)[:, 2]
        view = pinhole.directions(mosaic_xy, rig_from_camera(pose))
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
