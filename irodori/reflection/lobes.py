"""Lobes as a compile-time constant: a loop with a `Lobes` argument is compiled for the lobes that it names.

In Python, a `Lobes` is an ordinary argument. In compiled code it has no value, only a type, which holds the names of
the lobes and the hashes of their sources. The functions below become calls of the kernels of these lobes; with several
lobes, a chain of comparisons selects one. A loop for one lobe thus compiles to the same code as if the lobe were
written into it. The hashes distinguish the kernels of lobes from outside the package; the sources of the package's own
lobes are part of the hash under which compiled kernels are cached anyway.

Functions with a second argument ``which`` take the number of one lobe of several; the others take a `Lobes` of one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from llvmlite import ir
from numba import types
from numba.core.cgutils import get_null_value
from numba.core.imputils import lower_constant
from numba.extending import NativeValue, models, overload, register_model, typeof_impl, unbox

from irodori.reflection.registry import lobe


@dataclass(frozen=True)
class Lobes:
    """Names of the lobes for which a loop is compiled.

    Parameters
    ----------
    names : tuple of str
        Names of registered lobes; the argument ``which`` counts them from 0.
    """

    names: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in self.names:
            lobe(name)

    @classmethod
    def of(cls, names: Sequence[str] | str) -> "Lobes":
        """Return the `Lobes` of one or several names, without duplicates, in order of first occurrence."""
        return cls(tuple(dict.fromkeys([names] if isinstance(names, str) else names)))


class LobesType(types.Type):
    """Numba type of a `Lobes` in compiled code."""

    def __init__(self, names: tuple[str, ...], digests: tuple[str, ...]) -> None:
        self.names, self.digests = names, digests
        super().__init__(name=f"Lobes({', '.join(f'{n}:{d}' for n, d in zip(names, digests, strict=True))})")

    @property
    def key(self):
        """Names and source hashes of the lobes, by which numba compares types."""
        return self.names, self.digests


@typeof_impl.register(Lobes)
def _typeof(value, context):
    return LobesType(value.names, tuple(lobe(name).digest for name in value.names))


@register_model(LobesType)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, ir.IntType(8))


@lower_constant(LobesType)
def _constant(context, builder, kind, value):
    return get_null_value(ir.IntType(8))


@unbox(LobesType)
def _unbox(kind, value, context):
    return NativeValue(get_null_value(ir.IntType(8)))


def _specialised(name: str, arguments: str, about: str, choosing: bool, kernel: str = ""):
    """Return a function for compiled code that calls the kernel ``kernel`` (or ``name``) of its argument's lobes."""
    kernel = kernel or name
    head = f"lobes, which, {arguments}" if choosing else f"lobes, {arguments}"
    namespace: dict = {}
    exec(f"def {name}({head}):\n    raise NotImplementedError('in compiled code only')\n", namespace)
    made = namespace[name]
    made.__doc__ = about

    def build(kind):
        if not isinstance(kind, LobesType) or not (choosing or len(kind.names) == 1):
            return None
        inner = {f"kernel{i}": getattr(lobe(n), kernel) for i, n in enumerate(kind.names)}
        last = len(kind.names) - 1
        lines = [f"    if which == {i}:\n        return kernel{i}({arguments})\n" for i in range(last)]
        source = f"def {name}({head}):\n{''.join(lines)}    return kernel{last}({arguments})\n"
        exec(source, inner)
        return inner[name]

    # numba requires that an overload has the same parameters as the function.
    chooser: dict = {"build": build}
    exec(f"def chosen({head}):\n    return build(lobes)\n", chooser)
    overload(made, jit_options={"error_model": "numpy", "forceinline": True})(chooser["chosen"])
    return made


_ARGUMENTS = "cos_i, cos_r, cos_phi, cos_h, phi"
features = _specialised("features", _ARGUMENTS, "See `Lobe.features`.", False)
constants = _specialised("constants", "t", "See `Lobe.constants`.", False)
value = _specialised("value", "constant, f0, f1, f2", "See `Lobe.value`.", False)
derivatives = _specialised("derivatives", "constant, f0, f1, f2", "See `Lobe.derivatives`.", False)
flank = _specialised("flank", "constant, f0, f1, f2", "See `Lobe.flank`.", False)
draw = _specialised("draw", "mu, v0, v1, v2, u0, u1", "See `Lobe.draw`.", True)
density = _specialised("density", "mu, cos_r, cos_phi, cos_h, phi", "See `Lobe.density`.", True)
strength = _specialised("strength", "mu", "See `Lobe.strength`.", True)
reach = _specialised("reach", "mu", "See `Lobe.reach`.", True)
features_of = _specialised("features_of", _ARGUMENTS, "See `Lobe.features`; of one of several.", True, "features")
constants_of = _specialised("constants_of", "t", "See `Lobe.constants`; of one of several.", True, "constants")
value_of = _specialised("value_of", "constant, f0, f1, f2", "See `Lobe.value`; of one of several.", True, "value")


def squares_at_half_octave(lobes):
    """Return `Lobe.squares_at_half_octave` of a `Lobes` of one, in compiled code only."""
    raise NotImplementedError("in compiled code only")


@overload(squares_at_half_octave, jit_options={"forceinline": True})
def _squares(lobes):
    if isinstance(lobes, LobesType) and len(lobes.names) == 1:
        flag = lobe(lobes.names[0]).squares_at_half_octave
        return lambda lobes: flag
    return None
