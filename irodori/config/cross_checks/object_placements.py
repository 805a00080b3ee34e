"""Checks of the placements of an object against its shape and its photographs."""

from collections.abc import Iterable

from irodori.config.models import Object
from irodori.core.errors import InputError
from irodori.geometry.shape_blocks import is_flat


def check_placements(definition: Object, numbers: Iterable[int], source, field: str, file) -> None:
    """Refuse photographs in placements that the object's definition does not have.

    Parameters
    ----------
    definition : Object
    numbers : iterable of int
        Numbers of the placements that are photographed.
    source : path
        File that states them, a definition or a table.
    field : str
        Key or column in it.
    file : path
        The object's definition.
    """
    known = len(definition.placements) + 1
    for number in numbers:
        if number > known:
            accepted = f"1 to {known}, or a further placement under the key placements of {file}"
            raise InputError(source, field, f"the placement {number}", accepted)


def check_not_flat(definition: Object, file) -> None:
    """Refuse further placements of a flat object, whose definition is ``file``."""
    if definition.placements and is_flat(definition.shape.kind):
        found = f"{len(definition.placements)} for a {definition.shape.kind}"
        accepted = "none: a flat object shows its whole face in one placement, and its texture has no other side"
        raise InputError(file, "placements", found, accepted)


def check_all_placed(definition: Object, numbers: set[int], file) -> None:
    """Refuse placements that no photograph shows.

    Parameters
    ----------
    definition : Object
    numbers : set of int
        Numbers of the placements that are photographed.
    file : path
        The object's definition.
    """
    for number in range(1, len(definition.placements) + 2):
        if number not in numbers:
            field = f"placements[{number - 2}]" if number > 1 else "placements"
            found = f"no photograph of the object in placement {number}"
            raise InputError(file, field, found, "photographs in every placement, or no such placement")
