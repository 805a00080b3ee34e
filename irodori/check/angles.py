"""Check of an object's angles: whether its photographs would tell gloss from colour."""

from collections.abc import Iterator, Sequence
from types import SimpleNamespace

from irodori.capture.shot_planner.fisher_information import observe
from irodori.capture.shot_planner.planner import (
    MaterialRange,
    StatedErrors,
    default_noise,
    expected_errors,
    subject_of,
)
from irodori.check.findings import Finding
from irodori.config.capture_table import Pose, expand_poses, read_captures
from irodori.config.loaded import Loaded
from irodori.config.models import Object, Rig
from irodori.config.photograph_sets import PhotographSets
from irodori.core.errors import InputError, is_file

#: Materials for which angles are judged, spread over the range of the object's ``plan``.
_MATERIALS = 40
#: Share of them below which a warning is given. Of simulated plates in sets of angles that were not used to choose it,
#: at most 36 % of the fits were ok below it, and at least 44 % above.
_MOST = 0.5
_OPEN = (
    "{file}: {field}: found {count} photograph{s} with angles that tell gloss from colour in {share:.0%} of the "
    "materials that the object may have; accepted: {most:.0%} or more, by photographs near the mirror direction (of a "
    "plate that is not tilted, camera_deg as large as light_deg), 5 to 15 degrees to both sides of it, and 30 degrees "
    "or more away, as `irodori plan {name} --best 12` chooses them; else gloss stays open, and errors are larger"
)


def of_object(loaded: Loaded, name: str) -> Iterator[Finding]:
    """Yield a warning if photographs of a flat object, taken or to be taken, have angles that do not tell its gloss.

    The texels of a round object see many angles, and its paints tell its gloss.
    """
    definition, field = loaded.objects[name], "poses"
    file = f"{loaded.config.definitions}/objects/{name}.yaml"
    try:
        if definition.poses:
            poses = expand_poses(definition.poses)
        else:
            sets, asked = PhotographSets(loaded), SimpleNamespace(object=name)
            if not is_file(sets.table(asked)):
                return  # a session that is still to come
            file, field = sets.table(asked), "angles"
            poses = list(dict.fromkeys(shot.pose for shot in read_captures(file) if shot.role == "object"))
        rig = loaded.rigs[loaded.cameras[definition.camera].rig]
        share = told_share(definition, rig, poses, loaded.config.fit)
    except InputError:
        return  # other checks say so
    if share < _MOST:
        given = {"file": file, "field": field, "count": len(poses), "s": "s"[: len(poses) != 1], "name": name}
        yield Finding(False, _OPEN.format(share=share, most=_MOST, **given))


def told_share(definition: Object, rig: Rig, poses: Sequence[Pose], errors: StatedErrors) -> float:
    """Return the share of an object's possible materials whose β and μ a flat object's photographs would determine.

    1 for other shapes. ``errors`` are those that the fit assumes.
    """
    subject = subject_of(definition, rig)
    if not subject.shape.is_flat or not poses:
        return 1.0
    materials = MaterialRange.from_definition(definition).spread(_MATERIALS)
    seen = observe(subject, list(poses), materials, default_noise(rig, fit=errors))
    return expected_errors(seen, materials)[1]
