"""Refusal of views from inside an object, whose surface is black from behind, as the whole picture would be."""

import numpy as np

from irodori.config.models import PerspectiveView, Scene
from irodori.config.placed_names import object_names
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.geometry.enclosure import encloses
from irodori.geometry.shapes.shape import Shape
from irodori.rendering.scene_arrays import make_placements


def eye_inside(view: str, thing: str) -> tuple[str, str, str]:
    """Return field, fault and accepted values for the `InputError` about a view from inside an object."""
    return f"views.{view}.position_mm", f"an eye inside {thing}", "a position outside every object, in mm"


def refuse_enclosed_eye(scene: Scene, view_name: str, shapes: list[Shape]) -> None:
    """Raise an error for a perspective view from inside a sphere or closed mesh; orthographic views have no eye point.

    Parameters
    ----------
    scene : Scene
    view_name : str
    shapes : list of Shape
        Shape of each object of the scene.

    Raises
    ------
    InputError
    """
    view = scene.views[view_name]
    if not isinstance(view, PerspectiveView):
        return
    placed = [*shapes, *(Shape.from_definition(body.shape) for body in scene.bodies)]
    for name, thing in zip(object_names(scene), make_placements(scene, placed), strict=True):
        if encloses(thing, np.array(view.position_mm)):
            raise InputError("scene", *eye_inside(view_name, name))


def tell_black_backs(scene: Scene, view_name: str, shapes: list[Shape], is_sheet: list[bool]) -> None:
    """Warn of plates and discs that a view sees from behind and that are no thin sheets, because they look black.

    Parameters are those of `refuse_enclosed_eye`; ``is_sheet`` says which objects, then bodies, are sheets.
    """
    view = scene.views[view_name]
    placed = make_placements(scene, [*shapes, *(Shape.from_definition(body.shape) for body in scene.bodies)])
    for name, thing, two_sided in zip(object_names(scene), placed, is_sheet, strict=True):
        side = (np.array(view.position_mm) - thing.translation_mm) @ thing.rotation[:, 2]
        if thing.shape.is_flat and not two_sided and side < 0.0:
            text = "the view %s sees %s from behind, where it is black; keys that make it a sheet: %s"
            LOGGER.warning(text, view_name, name, "sheet of the object, back or transmittance of the body")
