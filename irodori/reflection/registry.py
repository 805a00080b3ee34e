"""Registry of lobes by name. The package's own lobes are listed here; others are added with `register`."""

from irodori.reflection import gaussian, ggx
from irodori.reflection.lobe import Lobe

#: Lobes of an object that names none: the one of the paper.
DEFAULT_LOBES = (gaussian.NAME,)

_LOBES: dict[str, Lobe] = {}


def register(lobe: Lobe) -> Lobe:
    """Add a lobe to the registry, replacing one of the same name, and return it."""
    _LOBES[lobe.name] = lobe
    return lobe


def lobe(name: str) -> Lobe:
    """Return the lobe with a given name.

    Raises
    ------
    ValueError
        If there is none of that name; the message lists the names.
    """
    if name not in _LOBES:
        raise ValueError(f"no lobe {name!r}; lobes: {', '.join(sorted(_LOBES))}")
    return _LOBES[name]


def names() -> tuple[str, ...]:
    """Return the names of all lobes, sorted."""
    return tuple(sorted(_LOBES))


for _module in (gaussian, ggx):
    register(Lobe.of_module(_module))
