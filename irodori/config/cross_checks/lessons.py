"""Checks of a scene's lesson against the scene: everything that its steps name must exist."""

from collections.abc import Iterable
from pathlib import Path

from irodori.config.models import DrawnIlluminant, LessonLight, LessonStep, NamedIlluminant, Scene
from irodori.config.pages import MOST_LAMPS
from irodori.config.placed_names import object_names
from irodori.config.validation import suggest
from irodori.core.errors import InputError, is_file
from irodori.spectra.published_names import ILLUMINANTS

#: Media types of a lesson's pictures, by their first bytes.
PICTURE_KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_MOST_BYTES = 1_000_000


def check_lesson(scene: Scene, root: Path, file) -> None:
    """Raise an error for a lesson that the page would refuse.

    It names a view, object, illuminant or picture that does not exist, draws a light without power, or has more lamps
    than the page can show.

    Raises
    ------
    InputError
    """
    if scene.lesson is None:
        return
    names = object_names(scene)
    for index, step in enumerate(scene.lesson.steps):
        field = f"lesson.steps[{index}]"
        if step.view is not None:
            _check_name(step.view, scene.views, file, f"{field}.view")
            if step.camera is not None:
                raise InputError(file, f"{field}.camera", "a camera beside the view", "one of the two")
        for number, pose in enumerate(step.objects):
            _check_name(pose.name, names, file, f"{field}.objects[{number}].name")
        _check_light(scene, step.light, file, f"{field}.light")
        if step.compare is not None:
            _check_light(scene, step.compare.light, file, f"{field}.compare.light")
        _check_picture(step, root, file, f"{field}.picture")


def _check_name(name: str, known: Iterable[str], file, field: str) -> None:
    listed = list(known)
    if name not in listed:
        raise InputError(file, field, f"{name}, which is not there", suggest(name, listed))


def _check_light(scene: Scene, light: LessonLight, file, field: str) -> None:
    lamps = len(scene.lights) + len(light.lamps)
    if light.lamps and lamps > MOST_LAMPS:
        found = f"{lamps} lamps with the scene's own lights"
        raise InputError(file, f"{field}.lamps", found, f"at most {MOST_LAMPS} together")
    named = [(light.illuminant, f"{field}.illuminant")]
    named += [(lamp.illuminant, f"{field}.lamps[{index}].illuminant") for index, lamp in enumerate(light.lamps)]
    for illuminant, where in named:
        if isinstance(illuminant, NamedIlluminant):
            _check_name(illuminant.name, ILLUMINANTS, file, f"{where}.name")
        if isinstance(illuminant, DrawnIlluminant) and not any(illuminant.power):
            raise InputError(file, f"{where}.power", "61 zeros", "a power above 0 at one wavelength at least")


def _check_picture(step: LessonStep, root: Path, file, field: str) -> None:
    if step.picture is None:
        return
    accepted = f"a PNG or JPEG of at most {_MOST_BYTES} bytes"
    path = root / step.picture
    if not is_file(path):
        raise InputError(file, field, f"no such file: {step.picture}", accepted)
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(file, field, f"{step.picture} of {path.stat().st_size} bytes", accepted)
    if picture_kind(path) is None:
        raise InputError(file, field, f"{step.picture}, whose content is neither", accepted)


def picture_kind(path: Path) -> str | None:
    """Return the media type of a picture by its first bytes; None if it is neither PNG nor JPEG."""
    with path.open("rb") as stream:
        head = stream.read(8)
    return next((kind for start, kind in PICTURE_KINDS.items() if head.startswith(start)), None)
