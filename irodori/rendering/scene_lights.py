"""Lights placed in a scene: collimated lights, rectangles and spheres with any spectrum.

The units are those of an environment of placed lights: a radiance of 1 has the luminance of D65 as tabulated (100 at
560 nm), and an irradiance of 1 gives a perfect diffuser that faces the light a radiance of 1.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.sphere import Sphere
from irodori.jit.compilation import uncounted
from irodori.jit.functions import circle_point
from irodori.light.placed_lights import direction_of, unit_luminance
from irodori.rendering.surface_hits import frame

if TYPE_CHECKING:
    from irodori.config.models import RectangleLight, SceneLight, SphereLight

COLLIMATED, RECTANGLE, BALL = 0, 1, 2
KINDS = {"collimated": COLLIMATED, "rectangle": RECTANGLE, "sphere": BALL}
BANDS, PADDED = 61, 64
#: Least cosine at a rectangle for its probability of being chosen, so that grazing light is still sampled.
_LEAST_COSINE = 0.05
#: Least solid angle, sr, at which a rectangle is sampled by solid angle; below, the difference of angles is inaccurate.
_LEAST_SOLID_ANGLE = 1e-4


class Lights(NamedTuple):
    """Placed lights for compiled loops; the first axis counts the lights.

    ``spectrum`` is the radiance of an area light, or the irradiance of a surface that faces a collimated light (in
    units of radiance times sr), padded with zeros. ``surface`` is the light's index among all traced shapes, -1 for
    none.
    """

    kind: np.ndarray  # (lights,)
    spectrum: np.ndarray  # (lights, 64) float32
    power: np.ndarray  # (lights,) sum of the spectrum
    position_mm: np.ndarray  # (lights, 3) centre
    rotation: np.ndarray  # (lights, 3, 3) world_from_light; the third column is where it shines
    size_mm: np.ndarray  # (lights, 2) width and height, or radius twice
    surface: np.ndarray  # (lights,)


def make_lights(definitions: "Sequence[SceneLight]", first_surface: int) -> tuple[Lights, list[Placement]]:
    """Return the lights of a scene, and the placements of the area lights' shapes.

    Parameters
    ----------
    definitions : sequence of SceneLight
    first_surface : int
        Index of the first light's shape among all traced shapes.
    """
    count = len(definitions)
    lights = Lights(
        kind=np.zeros(count, dtype=np.int64),
        spectrum=np.zeros((count, PADDED), dtype=np.float32),
        power=np.zeros(count),
        position_mm=np.zeros((count, 3)),
        rotation=np.tile(np.eye(3), (count, 1, 1)),
        size_mm=np.zeros((count, 2)),
        surface=np.full(count, -1, dtype=np.int64),
    )
    placements: list[Placement] = []
    for i, light in enumerate(definitions):
        lights.kind[i] = KINDS[light.kind]
        spectrum = unit_luminance(light.spectrum)
        if light.kind == "collimated":
            lights.spectrum[i, :BANDS] = math.pi * light.irradiance * spectrum
            lights.rotation[i, :, 2] = direction_of(light.azimuth_deg, light.elevation_deg)
        else:
            placement = _placement(light)
            lights.spectrum[i, :BANDS] = light.radiance * spectrum
            lights.position_mm[i], lights.rotation[i] = placement.translation_mm, placement.rotation
            lights.size_mm[i] = placement.shape.size_mm
            lights.surface[i] = first_surface + len(placements)
            placements.append(placement)
        lights.power[i] = lights.spectrum[i].sum(dtype=np.float64)
    return lights, placements


def _placement(light: "RectangleLight | SphereLight") -> Placement:
    position = np.asarray(light.position_mm, dtype=np.float64)
    if light.kind == "rectangle":
        return Placement(Plate(light.width_mm, light.height_mm), rotation_xyz(light.rotation_deg), position)
    return Placement(Sphere(light.radius_mm), np.eye(3), position)


def upward_radiance(lights: Lights) -> np.ndarray:
    """Return the radiance of an unobstructed perfect diffuser at the scene's origin that faces up, (61,).

    Of lights that cross the diffuser's horizon only the part above it counts.
    """
    total = np.zeros(BANDS)
    for i, kind in enumerate(lights.kind):
        centre, axes, size = lights.position_mm[i], lights.rotation[i].T, lights.size_mm[i]
        if kind == COLLIMATED:
            factor = max(axes[2, 2], 0.0)
        elif kind == BALL:
            factor = _irradiance_of_ball(centre, size[0])
        else:
            across, along = 0.5 * size[0] * axes[0], 0.5 * size[1] * axes[1]
            corners = [centre + x * across + y * along for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            factor = _irradiance_of_polygon(corners) if centre @ axes[2] < 0.0 else 0.0
        total += factor * lights.spectrum[i, :BANDS]
    return total / math.pi


def _irradiance_of_ball(centre: np.ndarray, radius: float) -> float:
    """Return the irradiance of a surface at the origin that faces +z, of a sphere of radiance 1 (0 to π).

    Snyder, *Radiant energy transfer from spheres* (NASA TN D-4883, 1968), in the form of Lagarde and de Rousiers,
    *Moving Frostbite to physically based rendering* (SIGGRAPH course, 2014). Within the sphere it is that on its
    surface.
    """
    distance = max(float(np.linalg.norm(centre)), radius)
    up = centre[2] / distance
    sine_squared = (radius / distance) ** 2
    if up**2 > sine_squared:
        return math.pi * sine_squared * max(up, 0.0)
    aside = max(math.sqrt(max(1.0 - up**2, 0.0)), 1e-12)
    cotangent = math.sqrt(max(1.0 / sine_squared - 1.0, 0.0))
    edge = min(max(-cotangent * up / aside, -1.0), 1.0)
    chord = aside * math.sqrt(1.0 - edge**2)
    seen = (up * math.acos(edge) - cotangent * chord) * sine_squared + math.atan2(chord, cotangent)
    return max(seen, 0.0)


def _irradiance_of_polygon(corners: Sequence[np.ndarray]) -> float:
    """Return the irradiance of a surface at the origin that faces +z, of a flat polygon of radiance 1 (0 to π).

    Lambert's formula: the sum, over the edges of the part above the horizon, of the angle of an edge times the cosine
    between +z and the normal of the plane through edge and origin.
    """
    above = []
    for here, there in zip(corners, [*corners[1:], corners[0]], strict=True):
        if here[2] >= 0.0:
            above.append(here)
        if (here[2] < 0.0) != (there[2] < 0.0):
            above.append(here + (there - here) * (here[2] / (here[2] - there[2])))
    total = 0.0
    for here, there in zip(above, [*above[1:], *above[:1]], strict=True):
        normal = np.cross(here, there)
        length = float(np.linalg.norm(normal))
        if length > 0.0:  # an edge that meets the origin has no plane with it
            total += normal[2] / length * math.atan2(length, float(here @ there))
    return 0.5 * abs(total)


@uncounted(forceinline=True)
def _towards(lights, light, point):
    """Return the squared distance of a point to a light's centre, mm², and its height above the light's plane, mm."""
    squared, height = 0.0, 0.0
    for axis in range(3):
        away = point[axis] - lights.position_mm[light, axis]
        squared += away * away
        height += away * lights.rotation[light, axis, 2]
    return squared, height


@uncounted(forceinline=True)
def unobstructed(lights, light, point):
    """Return the approximate irradiance of a light at a point without occlusion, summed over the wavelengths.

    Lights are chosen with probabilities in proportion to it. It is 0 only where the light does not shine.
    """
    if lights.kind[light] == COLLIMATED:
        return lights.power[light]
    squared, height = _towards(lights, light, point)
    if lights.kind[light] == BALL:
        radius = lights.size_mm[light, 0]
        return lights.power[light] * math.pi * radius * radius / squared if squared > radius * radius else 0.0
    if height <= 0.0:
        return 0.0
    area = lights.size_mm[light, 0] * lights.size_mm[light, 1]
    cosine = max(height / math.sqrt(squared), _LEAST_COSINE)
    return lights.power[light] * area * cosine / max(squared, area)


@uncounted(forceinline=True)
def _cap(lights, light, squared):
    """Return 1 - cos of the angular radius of a spherical light at a squared distance."""
    sine2 = lights.size_mm[light, 0] ** 2 / squared
    return sine2 / (1.0 + math.sqrt(1.0 - sine2))


@uncounted(forceinline=True)
def _corners(a, b, c, p, q, r):
    """Return arccos(-a b) + arccos(-b c), from 0 to 2π, accurate at both ends of the range.

    ``p``, ``q``, ``r`` are 1 - a², 1 - b², 1 - c². The angles are the arguments of two complex numbers, and their sum
    is the argument of the product.
    """
    x, y = -a * b, math.sqrt(p + a * a * q)
    u, v = -b * c, math.sqrt(q + b * b * r)
    angle = math.atan2(x * v + y * u, x * u - y * v)
    return angle if angle >= 0.0 else angle + 2.0 * math.pi


class _Rectangle(NamedTuple):
    """A rectangular light relative to a point, with quantities for sampling by solid angle (Ureña et al. 2013)."""

    x: float  # mm, corner of least coordinates in the light's frame, relative to the point
    y: float
    z: float  # not positive
    width: float  # mm
    height: float
    first: float  # third coordinate of the normal of the plane through the point and the side of least y
    second: float  # the same for the side of greatest y
    rest: float  # rad, full turn less the angles at the two corners of least x
    solid_angle: float  # sr


@uncounted(forceinline=True, error_model="numpy")
def _rectangle(lights, light, point):
    """Return the `_Rectangle` of a rectangular light for a point off its plane."""
    x, y, z = 0.0, 0.0, 0.0
    for axis in range(3):
        away = lights.position_mm[light, axis] - point[axis]
        x += away * lights.rotation[light, axis, 0]
        y += away * lights.rotation[light, axis, 1]
        z += away * lights.rotation[light, axis, 2]
    width, height = lights.size_mm[light, 0], lights.size_mm[light, 1]
    x, y, z = x - 0.5 * width, y - 0.5 * height, -abs(z)
    far_x, far_y, z2 = x + width, y + height, z * z
    first2, second2, left2, right2 = y * y + z2, far_y * far_y + z2, x * x + z2, far_x * far_x + z2
    first, second = -y / math.sqrt(first2), far_y / math.sqrt(second2)
    left, right = -x / math.sqrt(left2), far_x / math.sqrt(right2)
    first2, second2, left2, right2 = z2 / first2, z2 / second2, z2 / left2, z2 / right2
    rest = 2.0 * math.pi - _corners(second, left, first, second2, left2, first2)
    solid_angle = _corners(first, right, second, first2, right2, second2) - rest
    return _Rectangle(x, y, z, width, height, first, second, rest, solid_angle)


@uncounted(forceinline=True, error_model="numpy")
def _draw_rectangle(seen, u, v):
    """Sample a point on a `_Rectangle`, uniform in solid angle, mm from its corner of least coordinates."""
    x, y, z, width, height, first, second, rest, solid_angle = seen
    cosine, sine = circle_point((rest + u * solid_angle) / (2.0 * math.pi))
    # The place on the plane at distance 1 is cot(arccos(1 / √(slope² + first²))).
    slope, off = cosine * first - second, sine * sine * (1.0 - first * first)
    at_x = -z * sine / math.sqrt(max(slope * slope - off, 1e-30 * sine * sine))
    at_x = min(max(math.copysign(at_x, slope * sine), x), x + width)
    squared = at_x * at_x + z * z
    low, high = y / math.sqrt(squared + y * y), (y + height) / math.sqrt(squared + (y + height) ** 2)
    rise = low + v * (high - low)
    at_y = rise * math.sqrt(squared / max(1.0 - rise * rise, 1e-30))
    return at_x - x, min(max(at_y - y, 0.0), height)


@uncounted(forceinline=True)
def density_towards(lights, light, point, direction):
    """Return the density in 1/sr with which `sample_towards` samples a direction that hits the light; 0 from behind."""
    squared, height = _towards(lights, light, point)
    if lights.kind[light] == BALL:
        radius = lights.size_mm[light, 0]
        return 1.0 / (2.0 * math.pi * _cap(lights, light, squared)) if squared > radius * radius else 0.0
    cosine = 0.0
    for axis in range(3):
        cosine -= direction[axis] * lights.rotation[light, axis, 2]
    if height <= 0.0 or cosine <= 0.0:
        return 0.0
    solid_angle = _rectangle(lights, light, point).solid_angle
    if solid_angle > _LEAST_SOLID_ANGLE:
        return 1.0 / solid_angle
    distance = height / cosine
    return distance * distance / (lights.size_mm[light, 0] * lights.size_mm[light, 1] * cosine)


@uncounted(forceinline=True)
def sample_towards(lights, light, point, u, v, direction):
    """Sample a unit direction from a point to a light, uniform in solid angle, or in area for a small rectangle.

    Rectangles are sampled as in Ureña et al. (2013).

    Parameters
    ----------
    lights : Lights
    light : int
    point : (3,) float, mm
    u, v : float
        Uniform random numbers in [0, 1).
    direction : (3,) float

    Returns
    -------
    float, 1/sr
        Density of the direction, 1 for a collimated light, 0 if the light does not shine on the point.
    """
    turn = lights.rotation
    if lights.kind[light] == COLLIMATED:
        for axis in range(3):
            direction[axis] = turn[light, axis, 2]
        return 1.0
    squared, above = _towards(lights, light, point)
    if lights.kind[light] == BALL:
        radius, distance = lights.size_mm[light, 0], math.sqrt(squared)
        if distance <= radius:
            return 0.0
        for axis in range(3):
            direction[axis] = (lights.position_mm[light, axis] - point[axis]) / distance
        tangent, bitangent = frame(direction)
        rise = u * _cap(lights, light, squared)
        sine, (east, north) = math.sqrt(rise * (2.0 - rise)), circle_point(v)
        a, b = sine * east, sine * north
        for axis in range(3):
            direction[axis] = (1.0 - rise) * direction[axis] + a * tangent[axis] + b * bitangent[axis]
        return density_towards(lights, light, point, direction)
    if above <= 0.0:
        return 0.0
    seen, density = _rectangle(lights, light, point), 0.0
    a, b = u * seen.width, v * seen.height
    if seen.solid_angle > _LEAST_SOLID_ANGLE:
        a, b = _draw_rectangle(seen, u, v)
        density = 1.0 / seen.solid_angle
    a, b = a - 0.5 * seen.width, b - 0.5 * seen.height
    length = 0.0
    for axis in range(3):
        place = lights.position_mm[light, axis] + a * turn[light, axis, 0] + b * turn[light, axis, 1]
        direction[axis] = place - point[axis]
        length += direction[axis] ** 2
    length = math.sqrt(length)
    if length <= 0.0:
        return 0.0
    for axis in range(3):
        direction[axis] /= length
    return density if density > 0.0 else density_towards(lights, light, point, direction)
