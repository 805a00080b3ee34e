"""The interface of a lobe, a formula for how gloss depends on the angles: all that the rest of the package uses of it.

A lobe is a module in this folder, or a module anywhere else that is passed to `irodori.reflection.registry.register`.
With its weight β and the Fresnel reflectance F, the gloss term of the reflection model is

    π L_o / E_n = β F(θ_H) D G / cosθ_r

and the lobe computes ``D G / cosθ_r = factor * value``, where only ``value`` depends on the roughness μ. The lobes of
the package are scaled so that the term is β F at normal incidence and reflection.

The functions are compiled kernels (`irodori.jit`). They accept numbers or vectors, except ``draw`` and ``density``,
which accept only numbers. Cosines are cosθ_i = N·L, cosθ_r = N·V, cosφ = N·H and cosθ_H = V·H; t is ln μ.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import ModuleType

from irodori.core.parsed_sources import parsed


@dataclass(frozen=True)
class Parameter:
    """A non-linear parameter of a lobe.

    Parameters
    ----------
    name, symbol, unit, quantity : str
        Names as written in files and reports; the unit ``1`` means a ratio.
    low, high : float
        Bounds of the values for which the lobe is defined.
    """

    name: str
    symbol: str
    unit: str
    quantity: str
    low: float
    high: float


@dataclass(frozen=True)
class Lobe:
    """One gloss lobe: its names, its roughness and its kernels for fitting and rendering.

    Parameters
    ----------
    name : str
        Name in configurations and files: lower-case letters, digits and underscores.
    title : str
        Name in reports.
    roughness : Parameter
        The parameter μ. The weight β, which is linear, belongs to every lobe.
    features : kernel (cosθ_i, cosθ_r, cosφ, cosθ_H, φ) -> (factor, f0, f1, f2)
        Quantities that depend on an observation's angles alone. ``factor`` is 0 unless all cosines are positive, ``f0``
        is 0 at φ = 0 and grows with φ, and features that the lobe does not need are 0.
    constants : kernel (t) -> tuple of two numbers
        Quantities that depend on the roughness alone, computed once for all observations.
    value : kernel (constants, f0, f1, f2) -> value
    derivatives : kernel (constants, f0, f1, f2) -> (value, ∂value/∂t, ∂²value/∂t²)
    flank : kernel (constants, f0, f1, f2) -> (share, steepness)
        Value relative to that at φ = 0, and the squared derivative of its logarithm by φ, 1/rad²; they give the error
        of an observation that an error of the pose causes.
    squares_at_half_octave : bool
        Whether the value is exp(c f0) with c, the first of the constants, proportional to 1 / μ². The value at μ / √2
        is then the square of that at μ, which makes a scan over roughnesses faster.
    draw : kernel (μ, v0, v1, v2, u0, u1) -> (h0, h1, h2)
        Samples a half vector from two random numbers in 0..1; v is the unit vector to the viewer; h and v are in a
        frame with the normal as its third axis.
    density : kernel (μ, cosθ_r, cosφ, cosθ_H, φ) -> float, 1/sr
        Probability density of the light direction that ``draw`` yields by reflecting the view in the half vector.
    strength : kernel (μ) -> float
        Approximate albedo for β F = 1 and a view near the normal. Sets the probability of sampling the lobe; never 0.
    reach : kernel (μ) -> float, rad
        φ beyond which the lobe is below about 1e-4 of its peak (at most 2e-4), at most π/2.
    digest : str
        Hash of the module's code, without comments and docstrings. If it changes, kernels with the lobe are compiled
        again.
    """

    name: str
    title: str
    roughness: Parameter
    features: Callable
    constants: Callable
    value: Callable
    derivatives: Callable
    flank: Callable
    squares_at_half_octave: bool
    draw: Callable
    density: Callable
    strength: Callable
    reach: Callable
    digest: str = field(default="", compare=False)

    @classmethod
    def of_module(cls, module: ModuleType) -> "Lobe":
        """Return the lobe that a module defines by functions named as the fields and constants in capital letters.

        Raises
        ------
        ValueError
            If the module lacks one of them; the message names it.
        """
        constants = {"name": "NAME", "title": "TITLE", "roughness": "ROUGHNESS"}
        constants["squares_at_half_octave"] = "SQUARES_AT_HALF_OCTAVE"
        values = {}
        for one in fields(cls):
            if one.name == "digest":
                continue
            attribute = constants.get(one.name, one.name)
            if not hasattr(module, attribute):
                raise ValueError(f"the lobe {module.__name__} has no {attribute}; see {cls.__module__}")
            values[one.name] = getattr(module, attribute)
        assert module.__file__, "a lobe's module is a file"
        return cls(**values, digest=parsed(Path(module.__file__)).code[:16])
