"""Plan of poses as text that a person with a lamp, a camera on a stand and a ruler can follow."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from irodori.capture.shot_planner.planner import Plan
from irodori.config.capture_table import Pose
from irodori.config.models import Rig
from irodori.core.errors import counted
from irodori.geometry.rig_frame import to_camera, to_light

#: Largest angle of lamp and camera from the vertical in such a plan, degrees: beyond it the table is in the way.
_LOWEST_DEG = 80.0
#: Smallest angle between lamp and camera in such a plan, degrees, if the rig states none: a camera with its stand and a
#: lamp, each some 15 cm wide, stand beside each other 0.9 m away.
_CLEARANCE_DEG = 10.0
#: Angles in the order in which a person sets them, as `irodori init` asks for them.
_AXES = ("light_deg", "light_azimuth_deg", "camera_deg", "tilt_deg", "turn_deg")
#: How each pose is photographed, by filter states; () if they are unknown.
_TIMES = {
    ("out",): "once",
    ("in", "out"): "twice, without the filter and with it",
    (): "once, or twice where there is a filter, without it and with it",
}


def by_hand(rig: Rig) -> Rig:
    """Return a rig as a person sets it up.

    The angles of lamp and camera are limited to 80 degrees, as far as its own limits permit, and lamp and camera stand
    ten degrees apart or more, unless the rig states another angle.
    """
    limits = {
        axis: replace(limit, max=max(limit.min, min(limit.max, _LOWEST_DEG)))
        for axis, limit in (("light_deg", rig.limits.light_deg), ("camera_deg", rig.limits.camera_deg))
    }
    clearance_deg = _CLEARANCE_DEG if rig.clearance_deg is None else rig.clearance_deg
    return replace(rig, limits=replace(rig.limits, **limits), clearance_deg=clearance_deg)


def followed(plan: Plan, rig: Rig, states: Collection[str] = ()) -> list[str]:
    """Return a plan as a numbered list of text lines, with positions in millimetres beside the angles.

    Parameters
    ----------
    plan : Plan
    rig : Rig
        Definition with the distances of camera and lamp; without the lamp's, its position is given per metre.
    states : collection of str
        Filter states in which the camera was calibrated; empty if unknown.

    Returns
    -------
    list of str
        Lines; the last are answers to the questions of `irodori init`.
    """
    settings = len({_setting(pose) for pose in plan.poses})
    how = _TIMES[tuple(sorted(states))]
    sideways = any(pose.light_azimuth_deg for pose in plan.poses)
    lamp = "where the list says" if sideways else "to your right"
    lines = [
        f"{counted(len(plan.poses), 'pose')}: lamp and object are set {settings} times, the camera for every pose.",
        f"Photograph each {how}.",
        f"The lamp stands {lamp} and the camera to your left, both turned to the object's middle. Places are",
        "measured from there, angles from straight above it. Leave focus, aperture and zoom alone, and note the angles",
        "where they are not those of the list.",
    ]
    if sideways:
        lines.append("The azimuth of the lamp is how far it goes around the object from your right, away from you.")
    last: tuple[int, float, float, float, float] | None = None
    for number, pose in enumerate(plan.poses, 1):
        if _setting(pose) != last:
            if pose.placement != (last[0] if last else 1):
                lines += ["", f"Lay the object down as in placement {pose.placement} of its definition."]
            last = _setting(pose)
            lines += ["", *_of_setting(pose, rig)]
        camera = _place(rig.camera_distance_mm * to_camera(pose))
        lines.append(f"{number:4}. camera at {pose.camera_deg:g} degrees: {camera}")
    lines += ["", *plan.expectations(), "", "for irodori init, in the order of the list:"]
    axes = [axis for axis in _AXES if sideways or axis != "light_azimuth_deg"]
    lines += [f"{axis}: {' '.join(_numbers(plan.poses, axis))}" for axis in axes]
    if any(pose.placement > 1 for pose in plan.poses):
        lines.append(f"then in the table, column placement: {' '.join(_numbers(plan.poses, 'placement'))}")
    return lines


def _setting(pose: Pose) -> tuple[int, float, float, float, float]:
    """Return what changes less often in a pose than the camera: placement, and light, tilt and turn, degrees."""
    return pose.placement, pose.light_deg, pose.light_azimuth_deg, pose.tilt_deg, pose.turn_deg


def _of_setting(pose: Pose, rig: Rig) -> list[str]:
    away = rig.light.distance_mm
    place = _place((away or 1000.0) * to_light(pose))
    lamp = place if away else f"{place}, for each metre that it stands away"
    tilt = f"tilted by {pose.tilt_deg:g} degrees to your right" if pose.tilt_deg else "level"
    turn = f"turned by {pose.turn_deg:g} degrees, counter-clockwise from above" if pose.turn_deg else "not turned"
    azimuth = f", azimuth {pose.light_azimuth_deg:g}" if pose.light_azimuth_deg else ""
    return [f"lamp at {pose.light_deg:g} degrees{azimuth}: {lamp}", f"object {tilt}, {turn}"]


def _place(from_middle_mm: np.ndarray) -> str:
    """Return a phrase for a position relative to the object's middle, mm, as seen by a person in front of the rig."""
    x, y, z = (round(float(value)) for value in from_middle_mm)
    side = f"{abs(x)} mm to the {'right' if x > 0 else 'left'}" if x else "straight"
    beside = f", {abs(y)} mm {'away from' if y > 0 else 'towards'} you" if y else ""
    return f"{side}{beside}, {abs(z)} mm {'down' if z < 0 else 'up'}"


def _numbers(poses: Sequence[Pose], axis: str) -> list[str]:
    """Return the angles of an axis as text; a single one if all are equal."""
    found = [f"{getattr(pose, axis):g}" for pose in poses]
    return found[:1] if len(set(found)) == 1 else found
