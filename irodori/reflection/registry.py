"""Lobes by name. A lobe of the package is added by its file and its line here; others register themselves."""

from irodori.reflection import gaussian, ggx
from irodori.reflection.lobe import Lobe

#: Lobes of an object that names none: the paper's.
DEFAULT_LOBES = (gaussian.NAME,)

_LOBES: dict[str, Lobe] = {}


def register(lobe: Lobe) -> Lobe:
    """Add a lobe, or the new state of one of the same name; return it."""
    _LOBES[lobe.name] = lobe
    return lobe


def lobe(name: str) -> Lobe:
    """Return a lobe.

    Raises
    ------
    ValueError
        If there is none of that name; the names are listed.
    """
    if name not in _LOBES:
        raise ValueError(f"no lobe {name!r}; lobes: {', '.join(sorted(_LOBES))}")
    return _LOBES[name]


def names() -> tuple[str, ...]:
    """Return the names of all lobes, sorted."""
    return tuple(sorted(_LOBES))


for _module in (gaussian, ggx):
    register(Lobe.of_module(_module))
