"""The interface of a lobe: everything that the rest of the package knows about one form of rough gloss.

A lobe is one file in this folder, or one module anywhere else that is handed to `irodori.reflection.registry.register`.
With β its weight and F the Fresnel reflectance, it gives the gloss term of the reflection model

    π L_o / E_n = β F(θ_H) D G / cosθ_r

in the form ``D G / cosθ_r = factor * value``, where only ``value`` depends on the roughness μ. The lobes of the
package are scaled so that the term is β F at normal incidence and reflection.

The functions are compiled kernels (`irodori.jit`) and take numbers or vectors alike, but for ``draw`` and ``density``,
which take numbers. Cosines are cosθ_i = N·L, cosθ_r = N·V, cosφ = N·H and cosθ_H = V·H; t is ln μ.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import ModuleType


@dataclass(frozen=True)
class Parameter:
    """A non-linear parameter of a lobe.

    Parameters
    ----------
    name, symbol, unit, quantity : str
        As files and reports state them; a unit of ``1`` is a ratio.
    low, high : float
        Bounds within which the lobe is defined.
    """

    name: str
    symbol: str
    unit: str
    quantity: str
    low: float
    high: float


@dataclass(frozen=True)
class Lobe:
    """One form of rough gloss.

    Parameters
    ----------
    name : str
        Small letters, digits and underscores; what configurations and files say.
    title : str
        What reports say.
    roughness : Parameter
        The parameter μ. The weight β, which is linear, belongs to every lobe.
    features : kernel (cosθ_i, cosθ_r, cosφ, cosθ_H, φ) -> (factor, f0, f1, f2)
        What an observation's geometry is to the lobe; ``factor`` is 0 unless all cosines are positive, ``f0`` is 0 at
        φ = 0 and grows with φ, and what the lobe has no use for is 0.
    constants : kernel (t) -> tuple of two numbers
        What a roughness is to the lobe, computed once for all observations.
    value : kernel (constants, f0, f1, f2) -> value
    derivatives : kernel (constants, f0, f1, f2) -> (value, ∂value/∂t, ∂²value/∂t²)
    flank : kernel (constants, f0, f1, f2) -> (share, steepness)
        The value over that at φ = 0, and the square of the slope of its logarithm along φ, 1/rad²: what an error of
        the pose does to an observation.
    squares_at_half_octave : bool
        Whether the value is exp(c f0), where c is the first of the constants and goes with 1 / μ²: at μ / √2 it is the
        square of that at μ, which a scan over roughnesses makes use of.
    draw : kernel (μ, v0, v1, v2, u0, u1) -> (h0, h1, h2)
        A half vector from two random numbers in 0..1; v is the unit vector to the viewer, both in a frame whose third
        axis is the normal.
    density : kernel (μ, cosθ_r, cosφ, cosθ_H, φ) -> float, 1/sr
        With which ``draw`` leads to the direction of light that is mirrored in the half vector.
    strength : kernel (μ) -> float
        About the albedo of a steep view for β F = 1; decides how often a lobe is drawn and is never 0.
    reach : kernel (μ) -> float, rad
        φ beyond which the lobe is below about 1e-4 of its peak (at most 2e-4), at most π/2.
    digest : str
        Hash of the module's source: what is compiled with the lobe is compiled anew when it changes.
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
        """Return the lobe that a module defines by constants and functions named as the fields here.

        Raises
        ------
        ValueError
            If a field is missing, with its name.
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
        source = Path(module.__file__).read_bytes()
        return cls(**values, digest=hashlib.sha256(source).hexdigest()[:16])
