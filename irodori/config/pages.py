"""Scenes that a classroom page can show; light enough for the Snakefile."""

from irodori.config.models import PerspectiveView, Scene


def page_views(scene: Scene) -> list[str]:
    """Return the views that a page can begin with: upright, through a pinhole."""
    return [
        name
        for name, view in scene.views.items()
        if isinstance(view, PerspectiveView) and view.lens is None and tuple(view.up)[:2] == (0.0, 0.0)
    ]


def has_page(scene: Scene) -> bool:
    """Whether a page can show a scene: it has such a view, and no lights but collimated ones."""
    return bool(page_views(scene)) and all(light.kind == "collimated" for light in scene.lights)
