"""Tone curves of displays: between code values and linear light, both 0..1."""

import math
from dataclasses import dataclass

import numpy as np

#: Largest exponent, far above that of any display: profiles can hold numbers up to 32768, whose powers overflow.
_STEEPEST = 20.0
#: Codes at which a curve is checked, as many as 12 bits have; parameters of a profile are rounded to 1/65536.
_LOOKED_AT = 4096
_ROUNDING = 2.0 / 65536


def _require_rising(values: np.ndarray, rounding: float = 0.0) -> None:
    """Refuse linear light at increasing codes that falls by more than rounding, or ends no brighter than it begins."""
    finite = len(values) >= 2 and np.isfinite(values).all()
    if not finite or (np.diff(values) < -rounding).any() or not values[-1] > values[0]:
        raise ValueError("a tone curve that falls or is flat; accepted: one that rises from black to white")


@dataclass(frozen=True)
class ParametricCurve:
    """Power function with a straight segment near black: function type 4 of ICC.1:2022, 10.18.

    Y = (a X + b)^g + e for X >= d, and c X + f below.

    Raises
    ------
    ValueError
        If a parameter is not finite, g or a is not above 0, or the curve falls anywhere or does not rise at all.
    """

    g: float
    a: float = 1.0
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0
    e: float = 0.0
    f: float = 0.0

    def __post_init__(self) -> None:
        given = (self.g, self.a, self.b, self.c, self.d, self.e, self.f)
        if not all(map(math.isfinite, given)) or not (0.0 < self.g <= _STEEPEST and self.a > 0.0):
            raise ValueError(f"a tone curve of the exponent {self.g:g} and the factor {self.a:g}; accepted: above 0")
        # Sampled as a whole: even if both pieces rise, the curve may fall at their joint.
        _require_rising(self.linear(np.linspace(0.0, 1.0, _LOOKED_AT)), _ROUNDING)

    def linear(self, code: np.ndarray) -> np.ndarray:
        """Return the linear light of code values, any shape, 0..1."""
        code = np.asarray(code, dtype=np.float64)
        power = np.maximum(self.a * code + self.b, 0.0) ** self.g + self.e
        return np.where(code >= self.d, power, self.c * code + self.f)

    def code(self, linear: np.ndarray) -> np.ndarray:
        """Return the code values, 0..1, of linear light, any shape; light below that of code 0 yields 0."""
        linear = np.asarray(linear, dtype=np.float64)
        power = (np.maximum(linear - self.e, 0.0) ** (1.0 / self.g) - self.b) / self.a
        straight = (linear - self.f) / self.c if self.c > 0.0 else np.zeros_like(linear)
        joint = max(self.a * self.d + self.b, 0.0) ** self.g + self.e
        return np.clip(np.where(linear >= joint, power, straight), 0.0, 1.0)


@dataclass(frozen=True)
class SampledCurve:
    """Piecewise linear curve through values at equally spaced codes.

    Parameters
    ----------
    values : (n,) float
        Linear light at the codes 0, 1 / (n - 1), ... 1; n from 2.

    Raises
    ------
    ValueError
        If the curve falls anywhere, or does not rise at all.
    """

    values: np.ndarray

    def __post_init__(self) -> None:
        _require_rising(self.values)

    def linear(self, code: np.ndarray) -> np.ndarray:
        """Return the linear light of code values, any shape, 0..1."""
        return np.interp(code, np.linspace(0.0, 1.0, len(self.values)), self.values)

    def code(self, linear: np.ndarray) -> np.ndarray:
        """Return the code values, 0..1, of linear light, any shape; of codes with the same light the lowest."""
        linear = np.clip(linear, self.values[0], self.values[-1])
        upper = np.searchsorted(self.values, linear, side="left")
        lower = np.maximum(upper - 1, 0)
        step = self.values[upper] - self.values[lower]
        part = np.divide(linear - self.values[lower], step, out=np.zeros_like(linear), where=step > 0.0)
        return (lower + part) / (len(self.values) - 1)


#: IEC 61966-2-1.
SRGB = ParametricCurve(g=2.4, a=1 / 1.055, b=0.055 / 1.055, c=1 / 12.92, d=0.04045)

Curve = ParametricCurve | SampledCurve
