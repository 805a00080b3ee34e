"""Compiled functions that choose among the shapes: a chain of comparisons with their numbers.

A chain is made when its module is imported, from the shapes that are registered then, and is inlined where it is used:
the loops are the ones that a chain written by hand would give. Shapes that share a function share a branch.
"""

from collections.abc import Callable

from irodori.geometry.shape_registry import settle
from irodori.jit.compilation import uncounted
from irodori.jit.functions import select


def _branches(kernel: str, module: str) -> list[tuple[Callable, list[int]]]:
    """Return the functions that shapes have, each with their numbers; that of the first shape last, for the rest."""
    found: dict[Callable, list[int]] = {}
    for number, shape in enumerate(settle(module)):
        function = getattr(shape.kernels, kernel)
        if function is not None:
            found.setdefault(function, []).append(number)
    return [*found.items()][::-1]


def _is_one_of(numbers: list[int], join: str) -> str:
    # The number is a float32 in the rows of the interactive integrator, whole in the surfaces.
    return f" {join} ".join(f"(kind == {number})" for number in numbers)


def _made(name: str, source: str, known: dict, **options) -> Callable:
    namespace = dict(known)
    exec(source, namespace)
    return uncounted(cache=False, **options)(namespace[name])


def chain(kernel: str, parameters: str, module: str, **options) -> Callable:
    """Return a compiled function ``(kind, *parameters)`` that calls the kernel of the shape of a number.

    Parameters
    ----------
    kernel : str
        Field of `irodori.geometry.shapes.shape.Kernels`.
    parameters : str
        Names of its parameters, separated by commas.
    module : str
        That asks.
    **options
        Of `irodori.jit.compilation.uncounted`.
    """
    branches = _branches(kernel, module)
    lines = [f"def {kernel}(kind, {parameters}):"]
    for place, (_, numbers) in enumerate(branches[:-1]):
        lines += [f"    if {_is_one_of(numbers, 'or')}:", f"        return branch_{place}({parameters})"]
    lines.append(f"    return branch_{len(branches) - 1}({parameters})")
    known = {f"branch_{place}": function for place, (function, _) in enumerate(branches)}
    return _made(kernel, "\n".join(lines) + "\n", known, **options)


def lane_chain(kernel: str, parameters: str, results: int, module: str) -> Callable:
    """Return what `chain` returns for lanes of any shapes: each lane takes the results of its own shape's function.

    Shapes whose kernel is None have the results of any.

    Parameters
    ----------
    results : int
        Number of vectors that the kernel returns.
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
    """Return a compiled function ``(kind) -> mask`` of lanes whose shapes have a property.

    Parameters
    ----------
    holds : callable
        ``(shape class) -> bool``.
    """
    numbers = [number for number, shape in enumerate(settle(module)) if holds(shape)]
    source = f"def {name}(kind):\n    return {_is_one_of(numbers, '|') if numbers else 'kind != kind'}\n"
    return _made(name, source, {}, forceinline=True)
