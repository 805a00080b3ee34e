"""Checks of thin sheets: their shapes, and the objects whose materials cover their backs."""

from irodori.config.loaded import Loaded
from irodori.config.models import Object, Scene
from irodori.core.errors import InputError

#: Shapes that may be sheets.
_OPEN = ("plate", "disc", "mesh")


def check_thin_sheet(definition: Object, file) -> None:
    """Refuse an object that is a sheet and has a closed or endless shape."""
    if definition.sheet is not None:
        _check_shape(definition.shape.kind, file, "sheet")


def check_thin_sheets(loaded: Loaded, scene: Scene, file) -> None:
    """Refuse sheets of a scene with a closed or endless shape, and backs whose object has another shape."""
    for index, item in enumerate(scene.objects):
        if item.back is None:
            continue
        front, back = (loaded.objects[name].shape.kind for name in (item.object, item.back))
        _check_shape(front, file, f"objects[{index}].back")
        if front != back:
            found = f"{item.back}, a {back}, on the back of a {front}"
            raise InputError(file, f"objects[{index}].back", found, f"an object of the shape {front}")
    for index, body in enumerate(scene.bodies):
        for key in ("back", "transmittance"):
            if getattr(body, key) is not None:
                _check_shape(body.shape.kind, file, f"bodies[{index}].{key}")


def _check_shape(kind: str, file, field: str) -> None:
    if kind not in _OPEN:
        raise InputError(file, field, f"a sheet of the shape {kind}", f"one of the shapes {', '.join(_OPEN)}")
