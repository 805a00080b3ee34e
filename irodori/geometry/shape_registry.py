"""Registry of the shapes, with the numbers that identify them in compiled loops.

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
#: Modules with compiled loops that were made for the shapes registered by then.
_settled: list[str] = []


def _own() -> list[type["Shape"]]:
    from irodori.geometry.shapes.disc import Disc
    from irodori.geometry.shapes.plane import Plane
    from irodori.geometry.shapes.plate import Plate
    from irodori.geometry.shapes.sphere import Sphere
    from irodori.geometry.shapes.triangle_mesh import TriangleMesh

    return [Plate, Sphere, TriangleMesh, Disc, Plane]


def shapes() -> list[type["Shape"]]:
    """Return all shapes; the index in the list is the number of the shape in compiled loops."""
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
    """Register a shape from outside the package; can be used as a class decorator.

    Compiled loops are specialised on the registered shapes, so a shape must be registered before any module with such
    loops is imported (`irodori.geometry.surfaces` and modules that import it). Their cache is separate from that of the
    loops without the shape.

    Parameters
    ----------
    shape : subclass of `irodori.geometry.shapes.shape.Shape`
        Must define all methods and class attributes of the interface; none has a default.

    Raises
    ------
    ValueError
        If compiled loops exist already, the name is taken, or the class lacks a method or an attribute.
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
    """Return all shapes for the compiled loops of a module; afterwards no shape can be registered any more."""
    _settled.append(module)
    return shapes()
