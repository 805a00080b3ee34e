"""Checks for lengths and angles that are probably in a wrong unit: metres for millimetres, radians for degrees."""

import math
from collections.abc import Iterable
from typing import Any

from irodori.config.capture_table import Shot
from irodori.config.models import MeshShape, Optics
from irodori.core.errors import InputError, counted

_AXES = ("light_deg", "camera_deg", "tilt_deg", "turn_deg", "light_azimuth_deg")
#: Step in which people set and write angles, degrees, and rounding of the same angles in radians, with 3 decimals.
_STEP_DEG, _ROUNDING_RAD = 0.5, 0.001
#: Smallest width of an object in the picture, pixels: with fewer, all its texels are at its border.
_FEWEST_PX = 16
#: Smallest share of an object's outline in the frame: parts outside of it in every pose are never photographed.
_LEAST_INSIDE = 0.25


def check_degrees(shots: Iterable[Shot], table) -> None:
    """Refuse a table with angles that are probably radians: up to 2π, and round numbers of degrees after conversion.

    Raises
    ------
    InputError
        For the first such angle.
    """
    angles = [(shot, axis, abs(getattr(shot.pose, axis))) for shot in shots for axis in _AXES]
    angles = [(shot, axis, angle) for shot, axis, angle in angles if angle]
    if not angles or any(angle > 2.0 * math.pi + _ROUNDING_RAD for _, _, angle in angles):
        return
    odd = [(shot, axis, angle) for shot, axis, angle in angles if not _is_multiple(angle, 0.1, 1e-6)]
    rounding = math.degrees(_ROUNDING_RAD) / 2.0
    if not odd or not all(_is_multiple(math.degrees(angle), _STEP_DEG, rounding) for _, _, angle in angles):
        return
    shot, axis, angle = odd[0]
    meant = round(math.degrees(angle) / _STEP_DEG) * _STEP_DEG
    found, accepted = f"{angle:g}, in radians by the look of it", f"degrees: {angle:g} rad are {meant:g} degrees"
    raise InputError(table, f"{axis} of {shot.file}", found, accepted)


def _is_multiple(value: float, step: float, tolerance: float) -> bool:
    return abs(value - round(value / step) * step) <= tolerance


def check_in_frame(shape: Any, optics: Optics, distance_mm: float, file, rig_file) -> None:
    """Refuse an object that contains the camera, is a speck in its picture, or lies mostly outside the frame.

    Meshes, whose size is in their file, are left to `check_mesh_in_frame`.

    Parameters
    ----------
    shape : block of an object's definition
    optics : Optics
    distance_mm : float
        Distance from the camera to the middle of the rig.
    file, rig_file : path
        Definitions of the object and of the rig, for the error message.

    Raises
    ------
    InputError
    """
    sides, size = _size(shape)
    if not all(sides):
        return
    lengths = f"lengths in mm (pixel_pitch_um in micrometres; {rig_file}, camera_distance_mm {distance_mm:g})"
    if max(sides) / 2.0 >= distance_mm:
        found = f"a {shape.kind} {size}, in which a camera at {distance_mm:g} mm would stand"
        raise InputError(file, "shape", found, lengths)
    px_per_mm = optics.focal_length_mm * 1000.0 / optics.pixel_pitch_um / distance_mm
    if max(sides) * px_per_mm < _FEWEST_PX:
        found = f"a {shape.kind} {size}, {counted(max(sides) * px_per_mm, 'pixel', '.2g')} in the picture"
        raise InputError(file, "shape", found, f"{_FEWEST_PX} pixels or more: {lengths}")
    inside = 1.0
    for side, middle, count in zip(sides, optics.principal_point_px, (optics.width_px, optics.height_px), strict=True):
        low, high = middle - side / 2.0 * px_per_mm, middle + side / 2.0 * px_per_mm
        inside *= max(0.0, min(high, count) - max(low, 0.0)) / (high - low)
    if inside < _LEAST_INSIDE:
        width, height = (count / px_per_mm for count in (optics.width_px, optics.height_px))
        found = f"a {shape.kind} {size}, of which {inside:.0%} lies in the frame of {width:.3g} x {height:.3g} mm"
        raise InputError(file, "shape", found, f"{_LEAST_INSIDE:.0%} or more; {lengths}")


def check_lamp_outside(shape: Any, lamp_distance_mm: float, rig_file) -> None:
    """Refuse a lamp within an object, as where its distance is in metres; parameters as in `check_in_frame`.

    Raises
    ------
    InputError
    """
    sides, size = _size(shape)
    if lamp_distance_mm <= max(sides) / 2.0:
        found = f"{lamp_distance_mm:g} mm from the middle of a {shape.kind} {size}, and so within it"
        raise InputError(rig_file, "light.distance_mm", found, "the distance of the lamp, in mm")


def _size(shape: Any) -> tuple[tuple[float, float], str]:
    """Return width and height of a shape, mm, and both as text; zeros for a mesh, whose size is in its file."""
    if radius := getattr(shape, "radius_mm", 0.0):
        return (2.0 * radius, 2.0 * radius), f"{2.0 * radius:g} mm across"
    width, height = getattr(shape, "width_mm", 0.0), getattr(shape, "height_mm", 0.0)
    return (width, height), f"{width:g} x {height:g} mm"


def check_mesh_in_frame(shape: MeshShape, reach_mm: float, focal_px: float, distance_mm: float) -> None:
    """Refuse a mesh that contains the camera or is a speck in its picture, as with another unit of its file.

    Parameters
    ----------
    shape : MeshShape
    reach_mm : float
        Radius about its origin.
    focal_px : float
        Focal length of the camera, pixels.
    distance_mm : float
        As in `check_in_frame`.

    Raises
    ------
    InputError
        That names the file of the mesh.
    """
    seen_px = 2.0 * reach_mm * focal_px / distance_mm
    if reach_mm < distance_mm and seen_px >= _FEWEST_PX:
        return
    found = f"{shape.unit}, in which it is {2.0 * reach_mm:.3g} mm wide"
    found += (
        f" and {counted(seen_px, 'pixel', '.2g')} in the picture"
        if reach_mm < distance_mm
        else " and contains the camera"
    )
    accepted = f"the unit of its coordinates: at least {_FEWEST_PX} pixels, with the camera at {distance_mm:g} mm"
    raise InputError(shape.file, "shape.unit", found, accepted)
