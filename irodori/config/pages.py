"""Classroom pages of scenes: the views and environments that a page can show. Quick to import for the Snakefile."""

from irodori.config.models import LessonLight, NamedIlluminant, PerspectiveView, Scene

#: Most lamps of a page's light, with the scene's own: as many as its shader has room for (``MOST_LAMPS``).
MOST_LAMPS = 8


def page_views(scene: Scene) -> list[str]:
    """Return the names of the views that a page can begin with: all except those through a lens, which need samples."""
    return [name for name, view in scene.views.items() if not isinstance(view, PerspectiveView) or view.lens is None]


def page_rooms(scene: Scene) -> list[str]:
    """Return the names of the environments in a page: that of the scene, then those of its lesson."""
    named = (light.environment for light in _lesson_lights(scene) if light.environment)
    return list(dict.fromkeys([scene.environment, *named]))


def page_illuminants(scene: Scene) -> list[str]:
    """Return the names of the illuminants of a scene's lesson."""
    lights = _lesson_lights(scene)
    found = [light.illuminant for light in lights]
    found += [lamp.illuminant for light in lights for lamp in light.lamps]
    return list(dict.fromkeys(one.name for one in found if isinstance(one, NamedIlluminant)))


def _lesson_lights(scene: Scene) -> list[LessonLight]:
    steps = scene.lesson.steps if scene.lesson else ()
    return [light for step in steps for light in (step.light, step.compare and step.compare.light) if light]


def page_fault(scene: Scene) -> tuple[str, str, str] | None:
    """Return (field, found, accepted) of the reason why a page cannot show a scene; None if it can."""
    if not page_views(scene):
        return "views", "no view but through a lens", "a view without a lens for the scene's page"
    for number, light in enumerate(scene.lights):
        if light.kind != "collimated":
            return f"lights[{number}].kind", light.kind, "collimated lights alone in a scene that has a page"
    if len(scene.lights) > MOST_LAMPS:
        return "lights", f"{len(scene.lights)} lights", f"at most {MOST_LAMPS} in a scene that has a page"
    return None
