"""Classroom pages of scenes: the views and environments that a page can show. Quick to import for the Snakefile."""

from irodori.config.models import PerspectiveView, Scene


def page_views(scene: Scene) -> list[str]:
    """Return the names of the views that a page can begin with: all except those through a lens, which need samples."""
    return [name for name, view in scene.views.items() if not isinstance(view, PerspectiveView) or view.lens is None]


def page_rooms(scene: Scene) -> list[str]:
    """Return the names of the environments in a page: that of the scene, then those of its lesson."""
    steps = scene.lesson.steps if scene.lesson else ()
    lights = [light for step in steps for light in (step.light, step.compare and step.compare.light) if light]
    return list(dict.fromkeys([scene.environment, *(light.environment for light in lights if light.environment)]))


def page_fault(scene: Scene) -> tuple[str, str, str] | None:
    """Return (field, found, accepted) of the reason why a page cannot show a scene; None if it can."""
    if not page_views(scene):
        return "views", "no view but through a lens", "a view without a lens for the scene's page"
    for number, light in enumerate(scene.lights):
        if light.kind != "collimated":
            return f"lights[{number}].kind", light.kind, "collimated lights alone in a scene that has a page"
    return None
