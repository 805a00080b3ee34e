"""Checks of a scene's photographs against their cameras: lens, calibration, files, field of view."""

import math
from pathlib import Path

from irodori.config.cross_checks.captures_on_rig import check_states_are, of_role, read_table
from irodori.config.cross_checks.environment_sources import is_photographed
from irodori.core.errors import InputError


def check_aim(placed: dict, file, field: str) -> None:
    """Refuse a camera or an eye that looks at itself, or along its own up direction."""
    forward = [b - a for a, b in zip(placed["position_mm"], placed["target_mm"], strict=True)]
    if not any(forward):
        raise InputError(file, f"{field}.target_mm", "the eye's own position", "another point")
    (a, b, c), (d, e, f) = forward, placed["up"]
    across = math.hypot(b * f - c * e, c * d - a * f, a * e - b * d)
    if across <= 1e-9 * math.hypot(a, b, c) * max(1.0, math.hypot(d, e, f)):
        found = f"{placed['up']}, along the line of sight or of no length"
        raise InputError(file, f"{field}.up", found, "a direction that points up in the picture")


def check_photograph(definitions: dict, scene: dict, label: str, states: set[str], root: Path, file) -> None:
    """Check a photograph of a scene.

    Parameters
    ----------
    definitions : dict
        Validated, see `irodori.config.cross_checks.consistency.check_agreement`.
    scene : dict
    label : str
        Name of the photograph.
    states : set of str
        Filter states of the camera's chart.
    root : path
        Where relative paths start.
    file : callable
        ``file(kind, name)`` is the path of a definition; the scene's is ``file("scenes")``.

    Raises
    ------
    InputError
        If it looks nowhere, its camera has no optics or no white reference, a key is missing for its kind of rig or not
        read by it, a virtual camera's scene is not known, or filter states differ from the chart's.
    """
    placed, own, field = scene["photographs"][label], file("scenes"), f"photographs.{label}"
    check_aim(placed, own, field)
    name = placed["camera"]
    camera, camera_file = definitions["cameras"][name], file("cameras", name)
    for key, why in (("optics", "the lens that it was taken with"), ("white", "a white reference")):
        if key not in camera:
            raise InputError(own, f"{field}.camera", f"the camera {name!r} without {key}",
                             f"a camera whose file tells {why} ({camera_file}, {key})")  # fmt: skip
    kind = definitions["rigs"][camera["rig"]]["kind"]
    needed, strange = ("exposure_s", "captures") if kind == "virtual" else ("captures", "exposure_s")
    if needed not in placed:
        raise InputError(own, f"{field}.{needed}", "no such key", f"this key, because the rig is of kind {kind}")
    if strange in placed:
        raise InputError(own, f"{field}.{strange}", f"a key that a rig of kind {kind} does not use", "to leave it out")
    if kind != "virtual":
        table, shots = read_table(placed, root, own)
        check_states_are(of_role(shots, "scene", table), table, states, camera_file)
        return
    _check_known(definitions, scene, own, field)
    if set(placed["exposure_s"]) != states:
        found = f"the filter states {', '.join(sorted(placed['exposure_s']))}"
        raise InputError(own, f"{field}.exposure_s", found, f"{', '.join(sorted(states))}, as in {camera_file}")


def _check_known(definitions: dict, scene: dict, file, field: str) -> None:
    """Refuse a virtual photograph of what nobody knows: a real object or room, or a reflection that is not rendered."""
    cameras, rigs = definitions["cameras"], definitions["rigs"]
    light = definitions["environments"][scene["environment"]]
    if is_photographed(light) and rigs[cameras[light["camera"]]["rig"]]["kind"] != "virtual":
        found = f"a virtual camera in the real place {scene['environment']!r}"
        raise InputError(
            file, f"{field}.camera", found, "a real camera, an environment whose light is known, or no such photograph"
        )
    for item in scene["objects"]:
        known = definitions["objects"][item["object"]]
        if rigs[cameras[known["camera"]]["rig"]]["kind"] != "virtual":
            found = f"a virtual camera before the real object {item['object']!r}"
            raise InputError(
                file, f"{field}.camera", found, "a real camera, virtual objects alone, or no such photograph"
            )
        if any(material["kind"] == "measured" for material in known["virtual"]["materials"]):
            found = f"a virtual camera before {item['object']!r}, which has materials of kind measured"
            raise InputError(
                file, f"{field}.camera", found, "materials of other kinds, which are rendered, or no such photograph"
            )
