"""Checks of thin sheets: their shapes, and the objects whose materials cover their backs."""

from irodori.config.loaded import Loaded
from irodori.config.models import Object, PlateShape, Scene
from irodori.core.errors import InputError

#: Shapes that may be sheets.
_OPEN = ("plate", "disc", "mesh")
#: Share by which the sides of the plates on both sides of a sheet may differ.
_UNLIKE = 0.02


def check_thin_sheet(definition: Object, file) -> None:
    """Refuse an object that is a sheet and has a closed or endless shape."""
    if definition.sheet is not None:
        _check_shape(definition.shape.kind, file, "sheet")


def check_thin_sheets(loaded: Loaded, scene: Scene, file) -> None:
    """Refuse sheets of a scene with a closed or endless shape, and backs whose object has another shape, size or coat.

    A coat that lets light through to the ground would have to count what passes from the other side, too.
    """
    for index, item in enumerate(scene.objects):
        if item.back is None:
            continue
        definition, behind = (loaded.objects[name] for name in (item.object, item.back))
        if _lets_light_through(definition) and behind.coat != "sum":
            found = f"{item.back}, whose coat is {behind.coat}, on a sheet that lets light through"
            raise InputError(file, f"objects[{index}].back", found, "an object with the coat sum")
        front, back = definition.shape, behind.shape
        _check_shape(front.kind, file, f"objects[{index}].back")
        if front.kind != back.kind:
            found = f"{item.back}, a {back.kind}, on the back of a {front.kind}"
            raise InputError(file, f"objects[{index}].back", found, f"an object of the shape {front.kind}")
        if isinstance(front, PlateShape) and isinstance(back, PlateShape):
            _check_sizes(front, back, file, f"objects[{index}].back")
    for index, body in enumerate(scene.bodies):
        for key in ("back", "transmittance"):
            if getattr(body, key) is not None:
                _check_shape(body.shape.kind, file, f"bodies[{index}].{key}")


def _lets_light_through(definition: Object) -> bool:
    return definition.sheet is not None and definition.sheet.transmittance != 0.0


def _check_sizes(front: PlateShape, back: PlateShape, file, field: str) -> None:
    sides = (front.width_mm, back.width_mm), (front.height_mm, back.height_mm)
    if any(abs(a - b) > _UNLIKE * a for a, b in sides):
        found = f"a plate of {back.width_mm:g} mm × {back.height_mm:g} mm"
        raise InputError(
            file, field, found, f"one of the size of its front, {front.width_mm:g} mm × {front.height_mm:g} mm"
        )


def _check_shape(kind: str, file, field: str) -> None:
    if kind not in _OPEN:
        raise InputError(file, field, f"a sheet of the shape {kind}", f"one of the shapes {', '.join(_OPEN)}")
