"""Registry of the shapes: which there are, and their numbers.

A shape of the package is one file in ``irodori/geometry/shapes/`` and a line in `_own`. A shape from outside the
package is registered with `register`.
"""

import inspect
from pathlib import Path
from typing import TYPE_CHECKING

from irodori.geometry.shape_blocks import add_block
from irodori.jit.outside_sources import add_outside_source

if TYPE_CHECKING:
    from irodori.geometry.shapes.shape import Shape

_outside: list[type["Shape"]] = []
#: Modules whose compiled loops know the shapes that there were when they were made.
_settled: list[str] = []


def _own() -> list[type["Shape"]]:
    from irodori.geometry.shapes.disc import Disc
    from irodori.geometry.shapes.plane import Plane
    from irodori.geometry.shapes.plate import Plate
    from irodori.geometry.shapes.sphere import Sphere
    from irodori.geometry.shapes.triangle_mesh import TriangleMesh

    return [Plate, Sphere, TriangleMesh, Disc, Plane]


def shapes() -> list[type["Shape"]]:
    """Return all shapes; the place in the list is the shape's number in compiled loops."""
    return [*_own(), *_outside]


def number_of(shape: "Shape") -> int:
    """Return the number of a shape in compiled loops.

    Raises
    ------
    ValueError
        If the shape is not registered.
    """
    known = shapes()
    if type(shape) not in known:
        raise ValueError(f"unknown shape {type(shape).__name__!r}; accepted: {', '.join(s.name for s in known)}")
    return known.index(type(shape))


def register(shape: type["Shape"]) -> type["Shape"]:
    """Make a shape from outside the package known; may decorate its class.

    Compiled loops are specialised on the shapes that there are, so this comes before a module that has such loops is
    imported (`irodori.geometry.surfaces` and what imports it). The loops are then kept apart from those without it.

    Parameters
    ----------
    shape : subclass of `irodori.geometry.shapes.shape.Shape`
        With everything declared that the interface asks for: nothing has a silent default.

    Raises
    ------
    ValueError
        If compiled loops were made already, the name is taken, or the class leaves something undeclared.
    """
    if _settled:
        raise ValueError(f"the shape {shape.name!r} comes too late: the loops of {_settled[0]} are made without it")
    if shape.name in [known.name for known in shapes()]:
        raise ValueError(f"the shape {shape.name!r} is registered already")
    missing = [name for name in shape.__abstractmethods__ | shape.DECLARED if not _is_declared(shape, name)]
    if missing:
        raise ValueError(f"the shape {shape.name!r} leaves undeclared: {', '.join(sorted(missing))}")
    _outside.append(shape)
    add_block(shape.schema, shape.is_flat)
    add_outside_source(__name__, Path(inspect.getfile(shape)))
    return shape


def _is_declared(shape: type, name: str) -> bool:
    return hasattr(shape, name) and not getattr(getattr(shape, name), "__isabstractmethod__", False)


def settle(module: str) -> list[type["Shape"]]:
    """Return all shapes for the compiled loops of a module; from then on none is registered."""
    _settled.append(module)
    return shapes()
