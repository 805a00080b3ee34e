"""Checks of a scene's photographs against their cameras: lens, calibration, files, field of view."""

import math
from pathlib import Path

from irodori.config.cross_checks.captures_on_rig import check_states, of_role, read_table, states_of
from irodori.config.cross_checks.environment_sources import is_photographed
from irodori.config.loaded import Loaded
from irodori.config.models import MeasuredMaterial, Scene, ScenePhotograph, View
from irodori.core.errors import InputError


def check_aim(placed: View | ScenePhotograph, file, field: str) -> None:
    """Refuse a camera or an eye that has its target at its own position, or looks along its up direction."""
    forward = [b - a for a, b in zip(placed.position_mm, placed.target_mm, strict=True)]
    if not any(forward):
        raise InputError(file, f"{field}.target_mm", "the eye's own position", "another point")
    (a, b, c), (d, e, f) = forward, placed.up
    across = math.hypot(b * f - c * e, c * d - a * f, a * e - b * d)
    if across <= 1e-9 * math.hypot(a, b, c) * max(1.0, math.hypot(d, e, f)):
        found = f"{list(placed.up)}, along the line of sight or of no length"
        raise InputError(file, f"{field}.up", found, "a direction that points up in the picture")


def check_photograph(loaded: Loaded, scene: Scene, label: str, states: set[str], root: Path, file) -> None:
    """Check a photograph of a scene.

    Parameters
    ----------
    loaded : Loaded
    scene : Scene
    label : str
        Name of the photograph.
    states : set of str
        Filter states of the camera's chart.
    root : path
        Folder at which relative paths start.
    file : callable
        ``file(kind, name)`` is the path of a definition; the scene's is ``file("scenes")``.

    Raises
    ------
    InputError
        If it has no valid direction of view, its camera has no optics or no white reference, a key is missing for the
        kind of rig or not used by it, the truth of a virtual camera's scene is unknown, or filter states differ from
        those of the chart.
    """
    placed, own, field = scene.photographs[label], file("scenes"), f"photographs.{label}"
    check_aim(placed, own, field)
    name, camera_file = placed.camera, file("cameras", placed.camera)
    camera = loaded.cameras[name]
    for key, why in (("optics", "the lens that it was taken with"), ("white", "a white reference")):
        if getattr(camera, key) is None:
            raise InputError(own, f"{field}.camera", f"the camera {name!r} without {key}",
                             f"a camera whose file states {why} ({camera_file}, {key})")  # fmt: skip
    kind = loaded.rigs[camera.rig].kind
    needed, strange = ("exposure_s", "captures") if kind == "virtual" else ("captures", "exposure_s")
    if getattr(placed, needed) is None:
        raise InputError(own, f"{field}.{needed}", "no such key", f"this key, because the rig is of kind {kind}")
    if getattr(placed, strange) is not None:
        raise InputError(own, f"{field}.{strange}", f"a key that a rig of kind {kind} does not use", "to leave it out")
    if kind != "virtual":
        table, shots = read_table(placed.captures, root, own)
        check_states(of_role(shots, "scene", table), table, states, camera_file)
        return
    _check_known(loaded, scene, own, field)
    given = states_of(placed.exposure_s)
    if given != states:
        found = f"the filter states {', '.join(sorted(given))}"
        raise InputError(own, f"{field}.exposure_s", found, f"{', '.join(sorted(states))}, as in {camera_file}")


def _check_known(loaded: Loaded, scene: Scene, file, field: str) -> None:
    """Refuse a virtual photograph without a known truth: of a real object or room, or of measured materials."""
    place = scene.environment
    if is_photographed(loaded.environments[place]) and not loaded.is_virtual("environments", place):
        found = f"a virtual camera in the real place {place!r}"
        raise InputError(
            file, f"{field}.camera", found, "a real camera, an environment whose light is known, or no such photograph"
        )
    for name in (placed.object for placed in scene.objects):
        known = loaded.objects[name].virtual
        if not loaded.is_virtual("objects", name):
            found = f"a virtual camera before the real object {name!r}"
            raise InputError(
                file, f"{field}.camera", found, "a real camera, virtual objects alone, or no such photograph"
            )
        assert known is not None  # checked: what the virtual rig photographs has materials
        if any(isinstance(material, MeasuredMaterial) for material in known.materials):
            found = f"a virtual camera before {name!r}, which has materials of kind measured"
            raise InputError(
                file, f"{field}.camera", found, "materials of other kinds, which are rendered, or no such photograph"
            )
