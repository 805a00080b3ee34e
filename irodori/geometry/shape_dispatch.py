"""Compiled functions that call the function of the right shape, by a chain of comparisons with the shape's number.

A chain is made when the module that uses it is imported, from the shapes registered by then. It is inlined, so compiled
loops are the same as with a chain written by hand. Shapes with the same function share a branch.
"""

from collections.abc import Callable

from irodori.geometry.shape_registry import settle
from irodori.jit.compilation import uncounted
from irodori.jit.functions import select


def _branches(kernel: str, module: str) -> list[tuple[Callable, list[int]]]:
    """Return the different functions of the shapes, each with the numbers of its shapes; the first shape's is last."""
    found: dict[Callable, list[int]] = {}
    for number, shape in enumerate(settle(module)):
        function = getattr(shape.kernels, kernel)
        if function is not None:
            found.setdefault(function, []).append(number)
    return [*found.items()][::-1]


def _is_one_of(numbers: list[int], join: str) -> str:
    # The number is a float32 in the rows of the interactive integrator, and an integer in `Surfaces`.
    return f" {join} ".join(f"(kind == {number})" for number in numbers)


def _made(name: str, source: str, known: dict, **options) -> Callable:
    namespace = dict(known)
    exec(source, namespace)
    return uncounted(cache=False, **options)(namespace[name])


def chain(kernel: str, parameters: str, module: str, **options) -> Callable:
    """Make a compiled function ``(kind, *parameters)`` that calls a function of the shape with the number ``kind``.

    Parameters
    ----------
    kernel : str
        Name of the function, a field of `irodori.geometry.shapes.shape.Kernels`.
    parameters : str
        Names of its parameters, separated by commas.
    module : str
        Name of the module that uses the chain.
    **options
        Options of `irodori.jit.compilation.uncounted`.
    """
    branches = _branches(kernel, module)
    lines = [f"def {kernel}(kind, {parameters}):"]
    for place, (_, numbers) in enumerate(branches[:-1]):
        lines += [f"    if {_is_one_of(numbers, 'or')}:", f"        return branch_{place}({parameters})"]
    lines.append(f"    return branch_{len(branches) - 1}({parameters})")
    known = {f"branch_{place}": function for place, (function, _) in enumerate(branches)}
    return _made(kernel, "\n".join(lines) + "\n", known, **options)


def lane_chain(kernel: str, parameters: str, results: int, module: str) -> Callable:
    """Make the function of `chain` for vectors whose lanes may have different shapes.

    The functions of all shapes are called, and each lane takes the results of its own shape. For shapes without this
    function (None) the results are undefined.

    Parameters
    ----------
    kernel, parameters, module
        As in `chain`.
    results : int
        Number of vectors that the function returns.
    """
    branches = _branches(kernel, module)
    last = len(branches) - 1
    lines = [f"def {kernel}(kind, {parameters}):", f"    found = branch_{last}({parameters})"]
    for place in range(last - 1, -1, -1):
        chosen = ", ".join(f"select(own, other[{i}], found[{i}])" for i in range(results))
        lines += [
            f"    own = {_is_one_of(branches[place][1], '|')}",
            f"    other = branch_{place}({parameters})",
            f"    found = ({chosen})",
        ]
    known = {"select": select} | {f"branch_{place}": function for place, (function, _) in enumerate(branches)}
    return _made(kernel, "\n".join([*lines, "    return found", ""]), known, forceinline=True)


def lanes_are(holds: Callable, name: str, module: str) -> Callable:
    """Make a compiled function ``(kind) -> mask`` that marks the lanes with shapes that have a property.

    Parameters
    ----------
    holds : callable
        The property: ``(shape class) -> bool``.
    name : str
        Name of the function.
    module : str
        Name of the module that uses it.
    """
    numbers = [number for number, shape in enumerate(settle(module)) if holds(shape)]
    source = f"def {name}(kind):\n    return {_is_one_of(numbers, '|') if numbers else 'kind != kind'}\n"
    return _made(name, source, {}, forceinline=True)
