"""Refusal of views whose eye is inside a thing: the backs of surfaces are black, and so would be the picture."""

import numpy as np

from irodori.config.models import PerspectiveView, Scene
from irodori.config.placed_names import object_names
from irodori.core.errors import InputError
from irodori.geometry.enclosure import encloses
from irodori.geometry.shapes.shape import Shape
from irodori.rendering.scene_arrays import make_placements


def eye_inside(view: str, thing: str) -> tuple[str, str, str]:
    """Return field, fault and what is accepted of a view from inside a thing, for `InputError`."""
    return f"views.{view}.position_mm", f"an eye inside {thing}", "a position outside of all things, in mm"


def refuse_enclosed_eye(scene: Scene, view_name: str, shapes: list[Shape]) -> None:
    """Refuse a perspective view from inside a ball or a closed mesh; parallel rays start on no single point.

    Parameters
    ----------
    scene : Scene
    view_name : str
    shapes : list of Shape
        One an object of the scene.

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
