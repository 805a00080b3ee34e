"""A ball that was turned over and laid down again: poses that show it in both placements, and how far it is turned."""

import math

import numpy as np

from irodori.config.capture_table import Pose

#: Beside the camera, a lamp lights what it sees of the ball's lower half too: placements have their sides in common.
POSES = [Pose(45.0, 25.0)] + [Pose(75.0, 80.0, 0.0, turn, 145.0) for turn in (0.0, 90.0, 180.0, 270.0)]
OVER = (180.0, 0.0, 0.0)


def angle_deg(rotation) -> float:
    """Angle of a rotation matrix."""
    return math.degrees(math.acos(min(1.0, (np.trace(rotation) - 1.0) / 2.0)))
