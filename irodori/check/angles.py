"""Check of an object's angles: whether its photographs would tell gloss from colour."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from irodori.capture.shot_planner.fisher_information import observe
from irodori.capture.shot_planner.planner import MaterialRange, as_fitted, expected_errors, subject_of
from irodori.check.findings import Finding
from irodori.config.capture_table import Pose, expand_poses, read_captures
from irodori.config.loaded import Loaded
from irodori.config.models import Object, Rig
from irodori.core.errors import InputError, is_file
from irodori.geometry.shape_blocks import is_flat

#: Materials for which angles are judged, spread over the range of the object's ``plan``.
_MATERIALS = 40
#: Share of them below which a warning is given. Of simulated plates in sets of angles that were not used to choose it,
#: at most 36 % of the fits were ok below it, and at least 44 % above.
_LEAST = 0.5
_OPEN = (
    "{file}: {field}: found {count} pose{s} with angles that tell gloss from colour in {share:.0%} of the "
    "materials that the object may have; accepted: {least:.0%} or more, by photographs near the mirror direction (of a "
    "plate that is not tilted, camera_deg as large as light_deg), 5 to 15 degrees to both sides of it, and 30 degrees "
    "or more away, as `irodori plan {name} --best 12` chooses them; else gloss stays open, and errors are larger"
)


def of_object(loaded: Loaded, name: str) -> Iterator[Finding]:
    """Yield a warning if photographs of a flat object, taken or to be taken, have angles that do not tell its gloss.

    The texels of a round object see many angles, and its paints tell its gloss.
    """
    definition, field = loaded.objects[name], "poses"
    if not is_flat(definition.shape.kind):
        return
    file = f"{loaded.config.definitions}/objects/{name}.yaml"
    camera = loaded.cameras[definition.camera]
    rig = loaded.rigs[camera.rig]
    try:
        if definition.poses:
            poses = expand_poses(definition.poses)
        else:
            table = definition.captures.table if definition.captures else ""
            if not is_file(table):
                return  # a session that is still to come
            file, field = table, "angles"
            poses = list(dict.fromkeys(shot.pose for shot in read_captures(table) if shot.role == "object"))
        share = told_share(definition, rig, poses, as_fitted(loaded.config, rig, definition, camera))
    except InputError:
        return  # the check of definitions or of the object's photographs says so
    if share < _LEAST:
        given = {"file": file, "field": field, "count": len(poses), "s": "s"[: len(poses) != 1], "name": name}
        yield Finding(False, _OPEN.format(share=share, least=_LEAST, **given))


def told_share(definition: Object, rig: Rig, poses: Sequence[Pose], fitted: Mapping[str, Any]) -> float:
    """Return the share of a flat object's possible materials whose β and μ photographs would determine.

    Parameters
    ----------
    definition : Object
    rig : Rig
    poses : sequence of Pose
    fitted : dict
        Noise, weights and largest angle, see `irodori.capture.shot_planner.planner.as_fitted`.
    """
    if not poses:
        return 1.0
    materials = MaterialRange.from_definition(definition).spread(_MATERIALS)
    return expected_errors(observe(subject_of(definition, rig), list(poses), materials, **fitted), materials)[1]
