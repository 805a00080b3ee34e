"""Unique names of the objects and bodies in a scene."""

from irodori.config.models import Scene

__all__ = ["materials_of", "object_names"]


def materials_of(scene: Scene) -> list[str]:
    """Return the names of a scene's objects, in its order, then those of the objects on the backs of sheets."""
    return [item.object for item in scene.objects] + [item.back for item in scene.objects if item.back is not None]


def object_names(scene: Scene) -> list[str]:
    """Return a unique name for every object of a scene, then for every body.

    An object that is placed several times is ``jar``, ``jar#2``, ``jar#3``; the first body is ``bodies[0]``.
    """
    seen: dict[str, int] = {}
    names = []
    for item in scene.objects:
        number = seen[item.object] = seen.get(item.object, 0) + 1
        names.append(item.object if number == 1 else f"{item.object}#{number}")
    return names + [f"bodies[{index}]" for index in range(len(scene.bodies))]
