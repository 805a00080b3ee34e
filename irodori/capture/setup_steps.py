"""Settings that a photograph requires, each made by a motor or by a person.

A setting is an angle of a pose in degrees, the state of the comb filter (``filter``), the thing that is photographed
(``subject``, see `irodori.config.capture_table.Shot`), or how it is laid (``placement``).
"""

import dataclasses
from collections.abc import Container

from irodori.config.capture_table import Pose, Shot

ANGLES = tuple(field.name for field in dataclasses.fields(Pose) if field.name != "placement")

#: Roles of photographs without a pose: the lens is covered, or the camera is away from the rig.
_WITHOUT_POSE = ("dark", "environment", "room-chart")


def motor_targets(shot: Shot, motorised: Container[str]) -> dict[str, float]:
    """Return {motorised axis: angle that a shot requires, degrees}; empty if its pose does not matter.

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
    """Return the settings by hand of a shot: ``subject``, ``placement``, angles without a motor, and ``filter``.

    Settings that do not matter to the shot are omitted: they may stay as they are.
    """
    wanted: dict[str, float | str] = {"subject": shot.subject}
    if shot.role not in _WITHOUT_POSE:
        wanted |= {angle: getattr(shot.pose, angle) for angle in ANGLES if angle not in motorised}
    if shot.subject == "object":
        wanted["placement"] = shot.pose.placement
    if shot.role != "dark":
        wanted["filter"] = shot.filter
    return wanted
