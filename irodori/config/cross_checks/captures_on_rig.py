"""Checks of poses and capture tables against the rig's ranges and the camera."""

import math
from collections.abc import Iterable
from pathlib import Path

from irodori.config.capture_table import (
    FILTERS,
    LENS,
    Pose,
    Shot,
    chart_capture,
    expand_poses,
    flat_incidence_rad,
    read_captures,
    room_chart_capture,
    shot_path,
)
from irodori.config.cross_checks.plausible_units import check_degrees
from irodori.config.models import AxisLimit, Camera, Captures, Exposures, PoseGroup, RigLimits, RigPose
from irodori.core.errors import InputError, is_file

_ANGLE_TOLERANCE_DEG = 1e-6
#: Responses of the chart and the white reference are divided by cosθ_i, which vanishes at 90 degrees.
_MAX_INCIDENCE_DEG = 80.0
_AXES = ("light_deg", "camera_deg", "tilt_deg", "turn_deg", "light_azimuth_deg")


class Reach:
    """Range of angles that a rig can reach.

    Parameters
    ----------
    limits : RigLimits
    file : path
        The rig's definition, for the error message.
    """

    def __init__(self, limits: RigLimits, file) -> None:
        self.limits, self.file = limits, file

    def check_angle(self, axis: str, angle: float, file, field: str, step: bool = True) -> None:
        """Refuse an angle outside the limits or, if `step` is set, between the steps."""
        limit: AxisLimit | None = getattr(self.limits, axis)
        if limit is None:
            if angle != 0.0:
                accepted = f"0: light in the rig's plane alone, for {self.file} has no limits.{axis}"
                raise InputError(file, field, f"{angle:.10g}", accepted)
            return
        low, high, unit = limit.min, limit.max, limit.step
        off = abs((angle - low) - round((angle - low) / unit) * unit)
        inside = low - _ANGLE_TOLERANCE_DEG <= angle <= high + _ANGLE_TOLERANCE_DEG
        if not inside or (step and off > _ANGLE_TOLERANCE_DEG):
            steps = f" in steps of {unit:g}" if step else ""
            accepted = f"{low:g} to {high:g} degrees{steps} ({self.file}, limits.{axis})"
            raise InputError(file, field, f"{angle:.10g}", accepted)

    def check_shots(self, shots: list[Shot], table) -> None:
        """Refuse photographs with angles outside the limits, or probably in radians."""
        check_degrees(shots, table)
        for shot in shots:
            for axis in _AXES:
                # Angles of a real rig are read from it, and need not be multiples of its steps.
                self.check_angle(axis, getattr(shot.pose, axis), table, f"{axis} of {shot.file}", step=False)

    def check_poses(self, groups: Iterable[PoseGroup], file) -> None:
        """Refuse poses of an object that the rig cannot take, or that occur twice."""
        for index, group in enumerate(groups):
            for axis, angles in group.given().items():
                if axis not in _AXES:
                    continue
                for item, angle in enumerate(angles):
                    self.check_angle(axis, angle, file, f"poses[{index}].{axis}[{item}]")
        try:
            expand_poses(groups)
        except ValueError as error:
            raise InputError(file, "poses", str(error), "each pose once, at least 0.1 degrees apart") from None


def states_of(exposure_s: Exposures | None) -> set[str]:
    """Return the filter states that have exposure times."""
    return set(exposure_s.given()) if exposure_s else set()


def check_incidence(pose: Pose | RigPose, file, field: str) -> None:
    """Refuse a pose in which the light does not reach a chart or a white reference from its front."""
    incidence = math.degrees(flat_incidence_rad(pose))
    if not -_ANGLE_TOLERANCE_DEG <= incidence < _MAX_INCIDENCE_DEG:
        found = f"light {pose.light_deg:g} less tilt {pose.tilt_deg:g}, the light at {incidence:g} degrees"
        if pose.light_azimuth_deg:
            found = f"the light at {incidence:.4g} degrees from the table's normal"
        raise InputError(file, field, found, f"an angle of incidence from 0 to below {_MAX_INCIDENCE_DEG:g} degrees")


def table_and_folder(captures: Captures, root: Path) -> tuple[Path, Path]:
    """Return the table of a set of photographs of a real rig and the folder of its RAW files."""
    table = root / captures.table
    return table, table.parent if captures.folder is None else root / captures.folder


def read_table(captures: Captures | None, root: Path, file) -> tuple[Path, list[Shot]]:
    """Return the path of a table and its photographs, after a check that all files exist."""
    assert captures is not None  # checked: photographs that others take have a table
    table, folder = table_and_folder(captures, root)
    if not is_file(table):
        found = f"no such file: {captures.table}"
        raise InputError(file, "captures.table", found, "a CSV that lists the photographs")
    if captures.published is not None:
        for shot in read_captures(table):
            raw = shot_path(shot, table, folder)
            if not is_file(raw):
                accepted = f"{captures.published}; or a photograph of your own, listed in {table}"
                raise InputError(file, "captures", f"no such file: {raw}", accepted)
    return table, read_captures(table, folder)


def check_sheet(shots: list[Shot], camera: Camera, table: Path, file) -> None:
    """Refuse photographs of the printed sheet that do not show the lens alone, and those of a camera without optics."""
    if not shots:
        return
    if camera.optics is None:
        found = f"no such key, though {table} lists photographs of the role {LENS}"
        raise InputError(file, "optics", found, "the block optics, whose focal length the photographs then refine")
    for shot in shots:
        if shot.filter != "out":
            found = f"the sheet with the filter in, {shot.file}"
            raise InputError(table, "filter", found, "out: the lens is measured without the filter")


def of_role(shots: list[Shot], role: str, table: Path) -> list[Shot]:
    """Return the photographs of a role; raise an error for none, or for a capture without a photograph unfiltered."""
    wanted = [shot for shot in shots if shot.role == role]
    if not wanted:
        roles = ", ".join(sorted({shot.role for shot in shots}))
        raise InputError(table, "role", f"only {roles}", f"one photograph or more of the role {role}")
    for capture, states in _states_of_captures(wanted).items():
        if "out" not in states:
            found = f"the capture {capture} only with the filter in"
            raise InputError(table, "filter", found, "each capture with the filter out as well")
    return wanted


def by_chart(shots: list[Shot], further: Iterable[str], table: Path, file) -> list[list[Shot]]:
    """Return the photographs of each chart, the first chart's first; refuse charts without counterpart."""
    wanted = ["", *further]
    groups: dict[str, list[Shot]] = {name: [] for name in wanted}
    for shot in shots:
        if shot.chart not in groups:
            known = ", ".join(chart_capture(name) for name in wanted)
            found = f"{shot.subject}, for which {file} has no further_charts.{shot.chart}"
            raise InputError(table, f"role of {shot.file}", found, known)
        groups[shot.chart].append(shot)
    for name, group in groups.items():
        if not group:
            found = f"no photograph of the role {chart_capture(name)}"
            raise InputError(table, "role", found, f"each chart of {file} photographed")
    return list(groups.values())


def check_room_charts(shots: list[Shot], wanted: Iterable[str], table: Path, file) -> list[Shot]:
    """Return the photographs of charts in an environment; refuse charts that only its table or definition has."""
    given, known = [shot for shot in shots if shot.role == "room-chart"], set(wanted)
    for shot in given:
        if shot.chart not in known:
            found = f"{shot.subject}, for which {file} has no room_charts.{shot.chart}"
            raise InputError(table, f"role of {shot.file}", found, "a chart of room_charts")
    for name in sorted(known - {shot.chart for shot in given}):
        found = f"no photograph of the role {room_chart_capture(name)}"
        raise InputError(table, "role", found, f"each of the room_charts of {file} photographed")
    return of_role(shots, "room-chart", table) if given else []


def check_states(shots: list[Shot], table: Path, wanted: set[str], chart_file: Path) -> None:
    """Refuse a capture in other filter states than those of the chart, for which the calibration is valid."""
    for capture, states in _states_of_captures(shots).items():
        if states != wanted:
            accepted = f"the filter states {_listed(wanted)}, as the chart has in {chart_file}"
            raise InputError(
                table, f"filter of the capture {capture}", f"the filter states {_listed(states)}", accepted
            )


def check_one_pose(shots: list[Shot], table: Path) -> None:
    """Refuse photographs of the chart or white reference in several poses, or not lit from the front."""
    first = shots[0]
    for shot in shots:
        check_incidence(shot.pose, table, f"light_deg of {shot.file}")
        for axis in _AXES:
            here, there = getattr(shot.pose, axis), getattr(first.pose, axis)
            if here != there:
                accepted = f"{there:g}, as of {first.file}: one pose for all photographs of the role {shot.subject}"
                raise InputError(table, f"{axis} of {shot.file}", f"{here:g}", accepted)


def _states_of_captures(shots: list[Shot]) -> dict[str, set[str]]:
    states: dict[str, set[str]] = {}
    for shot in shots:
        states.setdefault(shot.capture, set()).add(shot.filter)
    return states


def _listed(states: set[str]) -> str:
    return ", ".join(state for state in FILTERS if state in states)
