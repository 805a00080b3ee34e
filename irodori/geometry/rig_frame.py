"""Rotations, and the coordinate frame of the gonio-reflectance rig [design, §4].

The plane of incidence is x-z, with z up. Light and camera angles are measured from +z, the light's towards +x and the
camera's towards -x. A lamp outside this plane has an azimuth about z, from +x towards +y. The table tilts about y
towards the light, and turns about its own normal. Both axes pass through the origin, at which the camera looks.
"""

import math

import numpy as np


def rotation_x(angle_rad: float) -> np.ndarray:
    """Return the (3, 3) rotation about x."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle_rad: float) -> np.ndarray:
    """Return the (3, 3) rotation about y; it turns +z towards +x."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle_rad: float) -> np.ndarray:
    """Return the (3, 3) rotation about z; it turns +x towards +y."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_xyz(angles_deg) -> np.ndarray:
    """Return the (3, 3) rotation about x, then y, then z, by angles in degrees."""
    ax, ay, az = (math.radians(a) for a in angles_deg)
    return rotation_z(az) @ rotation_y(ay) @ rotation_x(ax)


def to_light(pose) -> np.ndarray:
    """Return the (3,) unit vector L from the origin to the light in a pose (`irodori.config.capture_table.Pose`)."""
    angle, azimuth = math.radians(pose.light_deg), math.radians(pose.light_azimuth_deg)
    return np.array([math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)])


def to_camera(pose) -> np.ndarray:
    """Return the (3,) unit vector from the origin to the camera in a pose."""
    angle = math.radians(pose.camera_deg)
    return np.array([-math.sin(angle), 0.0, math.cos(angle)])


def rig_from_object(pose) -> np.ndarray:
    """Return the (3, 3) rotation from the object's frame to the rig, by turn and tilt of the table."""
    return rotation_y(math.radians(pose.tilt_deg)) @ rotation_z(math.radians(pose.turn_deg))


def rig_from_camera(pose, quarter_turns: int = 0) -> np.ndarray:
    """Return the (3, 3) rotation from camera axes (x right, y down, z forward) to the rig.

    Parameters
    ----------
    pose : Pose
    quarter_turns : int
        Quarter turns by which the camera is mounted turned about z, counter-clockwise as seen from behind it: 2 is
        upside down. At 0, up in the picture is the rig's +y.
    """
    c, s = math.cos(math.radians(pose.camera_deg)), math.sin(math.radians(pose.camera_deg))
    right, down, forward = np.array([c, 0.0, s]), np.array([0.0, -1.0, 0.0]), np.array([s, 0.0, -c])
    for _ in range(quarter_turns % 4):
        right, down = -down, right
    return np.stack([right, down, forward], axis=1)


def look_at(position, target, up) -> np.ndarray:
    """Return the (3, 3) rotation from the axes of a camera that looks at a target (x right, y down, z forward).

    Raises
    ------
    ValueError
        If position and target coincide, or the view direction is parallel to ``up``.
    """
    forward = np.asarray(target, dtype=np.float64) - np.asarray(position, dtype=np.float64)
    distance = np.linalg.norm(forward)
    if distance < 1e-9:
        raise ValueError("position and target of the view coincide")
    forward /= distance
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    length = np.linalg.norm(right)
    if length < 1e-9:
        raise ValueError("the view runs along its own up direction")
    right /= length
    return np.stack([right, np.cross(forward, right), forward], axis=1)
