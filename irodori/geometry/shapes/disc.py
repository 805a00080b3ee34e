"""Discs, and a closed form of the share of the cosine-weighted hemisphere that a disc hides, clipped at the horizon.

For a circle r(t) = c + ρ (e₁ cos t + e₂ sin t) seen from the origin, Lambert's sum over the edges of a polygon becomes
the integral of n · (r × dr) / |r|²: a quotient of first-order trigonometric polynomials with an elementary primitive.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.geometry.embree import Primitive, oriented_disc
from irodori.geometry.mesh import Mesh, make_mesh
from irodori.geometry.shapes.flat import (
    FlatShape,
    flat_point,
    flat_texture,
    frame_axes,
    nodes_about_flat,
    surface_at_flat,
)
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plane import distance_to_plane
from irodori.geometry.shapes.shape import Kernels
from irodori.geometry.shapes.shape_rows import RADIUS
from irodori.jit.compilation import njit
from irodori.jit.functions import select

if TYPE_CHECKING:
    from irodori.config.models import DiscShape

IS_FLAT = True
SCHEMA = {
    "scene": {
        "title": "DiscShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind", "radius_mm"],
        "properties": {
            "kind": {
                "const": "disc",
                "description": "A flat disc that faces +z before it is turned, and is black behind.",
            },
            "radius_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 1.0e6,
                "description": "Radius, in mm.",
            },
        },
    }
}

#: Number of sides of the polygon that approximates a disc.
_SIDES = 128
#: Relative variation of |r|² over the circle below which it counts as constant.
_CENTRED = 1e-7


class _Quotient(NamedTuple):
    """Coefficients of (a + b cos τ + s sin τ) / (k + swing cos τ), with two values that its integral needs."""

    a: float
    b: float
    s: float
    k: float
    swing: float
    root: float  # √(k² - swing²)
    ratio: float  # √((k - swing) / (k + swing))


@njit(cache=True, error_model="numpy")
def _primitive(quotient, tau):
    """Return the integral of a `_Quotient` from 0 to τ, for τ within ±2π."""
    a, b, s, k, swing, root, ratio = quotient
    if swing <= _CENTRED * k:
        return (a * tau + b * math.sin(tau) + s * (1.0 - math.cos(tau))) / k
    plain = 2.0 / root * math.atan2(ratio * math.sin(0.5 * tau), math.cos(0.5 * tau))
    rise = math.log1p(swing * (math.cos(tau) - 1.0) / (k + swing))
    return b / swing * tau + (a - b * k / swing) * plain - s / swing * rise


@njit(cache=True, error_model="numpy")
def hidden_by_disc(normal, centre, axes, radius):
    """Return the share of the cosine-weighted hemisphere that a disc hides.

    Parameters
    ----------
    normal : tuple of 3 float
        Unit normal at the point.
    centre : tuple of 3 float
        Centre of the disc relative to the point, mm.
    axes : tuple of 3 tuples of 3 float
        Two perpendicular unit vectors in the disc, and their cross product.
    radius : float, mm
    """
    e, f, g = axes
    ce = centre[0] * e[0] + centre[1] * e[1] + centre[2] * e[2]
    cf = centre[0] * f[0] + centre[1] * f[1] + centre[2] * f[2]
    cg = centre[0] * g[0] + centre[1] * g[1] + centre[2] * g[2]
    ne = normal[0] * e[0] + normal[1] * e[1] + normal[2] * e[2]
    nf = normal[0] * f[0] + normal[1] * f[1] + normal[2] * f[2]
    ng = normal[0] * g[0] + normal[1] * g[1] + normal[2] * g[2]
    across = math.hypot(ce, cf)
    low, high = (radius - across) ** 2 + cg * cg, (radius + across) ** 2 + cg * cg
    if low <= 0.0:
        return 0.0
    # Heights of the points of the circle above the horizon: ``middle`` plus or minus up to ``swing``.
    middle, swing = ce * ne + cf * nf + cg * ng, radius * math.hypot(ne, nf)
    if middle <= -swing:
        return 0.0
    half = math.pi if middle >= swing else math.acos(-middle / swing)
    top, towards = math.atan2(nf, ne), math.atan2(cf, ce)
    # n · (r × dr/dt) and |r|² with the angle counted from the centre's direction.
    b, s = radius * (cg * ne - ce * ng), radius * (cg * nf - cf * ng)
    turn_c, turn_s = math.cos(towards), math.sin(towards)
    b, s = b * turn_c + s * turn_s, s * turn_c - b * turn_s
    a, k, change = radius * radius * ng, 0.5 * (low + high), 0.5 * (high - low)
    if half == math.pi:
        start, end = -math.pi, math.pi
    else:
        way = top - towards
        way -= 2.0 * math.pi * math.floor(way / (2.0 * math.pi) + 0.5)
        start, end = way - half, way + half
    quotient = _Quotient(a, -b, -s, k, change, math.sqrt(low * high), math.sqrt(low / high))
    found = _primitive(quotient, end) - _primitive(quotient, start)
    if half < math.pi:
        # Close the path along the horizon, between the two points where the circle meets it.
        pe, pf = ce + radius * math.cos(top + half), cf + radius * math.sin(top + half)
        qe, qf = ce + radius * math.cos(top - half), cf + radius * math.sin(top - half)
        turned = ne * (pf * cg - cg * qf) + nf * (cg * qe - pe * cg) + ng * (pe * qf - pf * qe)
        found += math.atan2(turned, pe * qe + pf * qf + cg * cg)
    return min(abs(found) / (2.0 * math.pi), 1.0)


@njit(cache=True)
def _hides(row, at, x, y, z, normal):
    axes = frame_axes(row, at)
    facing = axes[2]
    if x * facing[0] + y * facing[1] + z * facing[2] >= 0.0:
        facing = (0.0, 0.0, 0.0)
    return hidden_by_disc(normal, (x, y, z), axes, np.float64(row[at + RADIUS])), facing


@njit(cache=True, forceinline=True)
def _distance(row, at, centre, direction, along):
    distance, radius = distance_to_plane(row, at, centre, direction), row[at + RADIUS]
    x, y, z = (
        distance * direction[0] - centre[0],
        distance * direction[1] - centre[1],
        distance * direction[2] - centre[2],
    )
    return select((distance >= 0.0) & (x * x + y * y + z * z < radius * radius), distance, np.inf)


@dataclass(frozen=True)
class Disc(FlatShape):
    """A disc centred on the origin; its texture covers the square around it.

    Parameters
    ----------
    radius_mm : float
    """

    radius_mm: float

    name = "disc"
    schema = SCHEMA
    is_endless = False
    kernels = Kernels(
        surface_at=surface_at_flat,
        hides=_hides,
        distance=_distance,
        may_be_met=None,
        point=flat_point,
        texture=flat_texture,
        nodes_about=nodes_about_flat,
    )

    @classmethod
    def from_block(cls, block: "DiscShape") -> "Disc":
        """Return the disc with the radius given in a configuration block."""
        return cls(float(block.radius_mm))

    @property
    def size_mm(self) -> tuple[float, float]:
        """The diameter, for both sides."""
        return 2.0 * self.radius_mm, 2.0 * self.radius_mm

    @property
    def reach_mm(self) -> float:
        """The radius."""
        return self.radius_mm

    def primitive(self, placement: Placement) -> Primitive:
        """Return Embree's disc, which is exact."""
        return oriented_disc(placement.translation_mm, placement.rotation[:, 2], self.radius_mm * placement.scale)

    def facetted(self, reach_mm: float) -> Mesh:
        """Return a polygon with 128 sides; its edges are at most 0.03 % of the radius inside the rim."""
        angle = 2.0 * np.pi * np.arange(_SIDES + 1) / _SIDES
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rim[-1] = rim[0]
        flat = np.stack([np.zeros_like(rim[1:]), rim[:-1], rim[1:]], axis=1)
        corners = self.radius_mm * np.concatenate([flat, np.zeros((_SIDES, 3, 1))], axis=2)
        return make_mesh(corners, 0.5 + flat * [0.5, -0.5])

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the centre and four points of the rim, where the angles of the camera differ most."""
        position = self.radius_mm * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
        return position, np.tile([0.0, 0.0, 1.0], (len(position), 1))
