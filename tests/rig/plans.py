"""Objects, rigs and poses that the tests of planning share."""

from collections.abc import Sequence

import numpy as np
from made import made

from irodori.capture.shot_planner.fisher_information import RigSubject
from irodori.config.capture_table import Pose, expand_poses
from irodori.config.models import PoseGroup
from irodori.geometry.shapes.plate import Plate

RIG = {
    "kind": "files",
    "limits": {
        "light_deg": {"min": 35.0, "max": 125.0, "step": 0.5},
        "camera_deg": {"min": 0.0, "max": 140.0, "step": 0.1},
        "tilt_deg": {"min": 0.0, "max": 45.0, "step": 0.5},
        "turn_deg": {"min": 0.0, "max": 359.5, "step": 0.5},
    },
    "camera_distance_mm": 900.0,
    "table_radius_mm": 25.0,
}
#: The same with a lamp that also stands beside the camera's plane.
SIDEWAYS = RIG | {"limits": RIG["limits"] | {"light_azimuth_deg": {"min": -360.0, "max": 360.0, "step": 0.5}}}
PLAN = {"alpha": [0.02, 0.9], "beta": [0.5, 8.0], "mu_rad": [0.05, 0.3], "count": 12, "max_manual": 3}
PLATE_OBJECT = {
    "shape": {"kind": "plate", "width_mm": 90.0, "height_mm": 90.0},
    "refractive_index": {"n": 1.5, "k": 0.0},
    "plan": PLAN,
}
SPHERE_OBJECT = PLATE_OBJECT | {"shape": {"kind": "sphere", "radius_mm": 30.0}}
POSES = expand_poses(
    made(
        Sequence[PoseGroup],
        [
            {"light_deg": [45.0], "camera_deg": [0.0, 20.0, 35.0, 41.0, 45.0, 49.0, 55.0, 65.0]},
            {"light_deg": [65.0], "camera_deg": [30.0, 55.0, 62.0, 66.0, 72.0]},
            {"light_deg": [45.0], "camera_deg": [0.0, 3.0, 12.0, 25.0], "tilt_deg": [20.0]},
        ],
    )
)


def texel() -> RigSubject:
    """Return the centre of a plate: one texel, whose angles are those of the rig."""
    return RigSubject(Plate(90.0, 90.0), np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 900.0)


def flat_angles(poses: list[Pose]) -> np.ndarray:
    """Return θ_i, θ_r, θ_H, φ of a flat sample by the definition of the rig's angles, (poses, 4) rad."""
    incidence = np.array([pose.light_deg - pose.tilt_deg for pose in poses])
    view = np.array([pose.camera_deg + pose.tilt_deg for pose in poses])
    halves = (incidence + view) / 2, (incidence - view) / 2
    return np.radians(np.abs(np.stack([incidence, view, *halves], axis=-1)))
