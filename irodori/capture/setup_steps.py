"""Steps that set up a photograph, each done by a motor or by a person.

A setting is an angle of a pose in degrees, the state of the comb filter (``filter``), or what stands before the lens
(``subject``, of a photograph as `irodori.config.capture_table.Shot` has it).
"""

import dataclasses
from collections.abc import Container

from irodori.config.capture_table import Pose, Shot

ANGLES = tuple(field.name for field in dataclasses.fields(Pose))

#: What the pose does not matter to: a covered lens sees nothing, and a place is photographed away from the rig.
_WITHOUT_POSE = ("dark", "environment", "room-chart")


def motor_targets(shot: Shot, motorised: Container[str]) -> dict[str, float]:
    """Return the angle of each motorised axis that a shot wants, degrees; empty where its pose does not matter.

    Parameters
    ----------
    shot : Shot
    motorised : container of str
        Angles that motors drive, such as ``RigDevice.axes``.
    """
    if shot.role in _WITHOUT_POSE:
        return {}
    return {angle: getattr(shot.pose, angle) for angle in ANGLES if angle in motorised}


def hand_settings(shot: Shot, motorised: Container[str]) -> dict[str, float | str]:
    """Return what a shot wants set by hand: ``subject``, angles without a motor in degrees, and ``filter``.

    What does not matter to the shot is left out: it may stay as it stands.
    """
    wanted: dict[str, float | str] = {"subject": shot.subject}
    if shot.role not in _WITHOUT_POSE:
        wanted |= {angle: getattr(shot.pose, angle) for angle in ANGLES if angle not in motorised}
    if shot.role != "dark":
        wanted["filter"] = shot.filter
    return wanted
