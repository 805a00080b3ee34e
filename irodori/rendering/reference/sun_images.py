"""Images of small bright parts of the environment in mirrors, towards which paths are aimed.

A path that reaches a sun by way of a mirror has to leave the surface, or the eye, in just the direction of the sun's
image, which a random direction hardly ever has. For chains of up to three spheres and flat shapes that reflect like
mirrors, that direction is computed: a place in the sun is drawn, and the points of the chain are found from which light
goes on to it. What is drawn remains a direction of the path. The density of any direction is known: that with which
the place in the sun is drawn, times the Jacobian of the reflections. Paths may therefore take any mixture of these
directions and their usual ones, and their mean does not change.

On a sphere, the point of reflection between two others (of which one may be infinitely far away) lies in the plane
through them and the centre, where its angle is the root of a monotonic function. In a chain, each point is found anew
between its neighbours until none moves: reflection in spheres spreads light, so that its reverse converges. Flat
mirrors are unfolded: what follows in the chain is mirrored in them.
"""

import math
from collections.abc import Sequence
from functools import wraps
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from irodori.geometry.shapes.placement import Placement
from irodori.jit.compilation import njit, uncounted
from irodori.light.equirectangular import direction_uv
from irodori.reflection.albedo import gloss_albedo
from irodori.reflection.fresnel import fresnel_array
from irodori.rendering.reference.sky_sampling import Sky, place_in_pixel
from irodori.rendering.scene_arrays import Objects, gloss_of, textures
from irodori.rendering.surface_hits import frame

#: Reflections in a chain at most, chains at most, and least weight of a chain relative to the largest.
LONGEST, _MOST_CHAINS, _LEAST_WEIGHT = 3, 32, 1e-2
#: Least albedo of a mirror, and largest μ of a gloss that counts as one.
_LEAST_ALBEDO, _SMOOTH = 0.02, 0.1
#: Variance, over μ², of the angle by which a gloss lobe blurs the image of a sun, rad²; a little more than its own.
_BLUR = 3.0
#: Groups of the suns' pixels at most, and the angle within which pixels form a group, rad.
_GROUPS, _NEAR = 8, 0.1
#: Largest share of a surface's directions that are aimed at images; the others find all other light.
_MOST = 0.5
#: Least cosine at a surface in the choice of a chain.
_LEAST_COSINE = 0.1
#: Steps to a root, rounds through a chain and steps of Newton's method at most.
_STEPS, _SWEEPS, _REFINEMENTS = 60, 200, 8
#: Movement, in radii, from which on Newton's method is tried, and that ends the search; error that is accepted, rad.
_NEARLY, _SETTLED, _MET = 1e-2, 1e-10, 1e-9
#: Columns of the buffer for spheres: centre, radius, point of reflection.
_RADIUS, _POINT, COLUMNS = 3, 4, 7


class Images(NamedTuple):
    """Suns, and chains of mirrors, for compiled loops; chains that begin with the same object follow each other."""

    chain: np.ndarray  # (chains, LONGEST) int64 objects in the order of the path from the eye, -1 for none
    weight: np.ndarray  # (chains,) reflectance times power of the suns
    kappa: np.ndarray  # (chains,) concentration of directions around a group, 1/rad²; 0 for places in the suns
    skip: np.ndarray  # (chains,) int64 next chain that begins with another object
    rest: float  # mean irradiance of a surface by all light
    flat: np.ndarray  # (objects,) int64
    centre: np.ndarray  # (objects, 3) mm
    normal: np.ndarray  # (objects, 3) of flat shapes
    radius: np.ndarray  # (objects,) mm; of the circle around a flat shape
    pixel: np.ndarray  # (suns, 2) int64 row and column in the environment
    cumulative: np.ndarray  # (suns + 1,) of their probabilities, from 0 to 1
    group: np.ndarray  # (suns,) int64
    towards: np.ndarray  # (groups, 3) unit
    part: np.ndarray  # (groups,) probability
    reach: np.ndarray  # (groups,) rad, angle around `towards` that holds the group
    least: float  # density in the last column of `pixels` from which on a pixel is a sun
    share: float  # of the suns in what is drawn from the environment
    pixels: np.ndarray  # of `Sky`
    width: int
    height: int


class NoImages(Images):
    """Images of a scene without any: a type of its own, for which loops are compiled without what aims at images."""

    __slots__ = ()


def has_images(images):
    """Return whether there are images; a constant of compiled loops."""
    return not isinstance(images, NoImages)


@overload(has_images, jit_options={"forceinline": True})
def _has_images(images):
    if issubclass(images.instance_class, NoImages):
        return lambda images: False
    return lambda images: True


def if_images(nothing):
    """Return a decorator of a function of images and more for compiled loops.

    Loops of scenes without images have the value ``nothing`` in its place, and are compiled without the function.
    """

    def decorated(kernel):
        def function(images, *rest):
            return kernel(images, *rest)

        @overload(function, jit_options={"forceinline": True})
        def chosen(images, *rest):
            if issubclass(images.instance_class, NoImages):
                return lambda images, *rest: nothing
            return lambda images, *rest: kernel(images, *rest)

        return wraps(kernel)(function)

    return decorated


def make_images(placements: Sequence[Placement], objects: Objects, sky: Sky) -> Images:
    """Return the images of an environment's suns in a scene's mirrors: none if there are no suns or no mirrors."""
    chains = _chains(placements, objects) if len(sky.suns) else []
    suns = sky.suns if chains else np.zeros((0, 3))
    probability = suns[:, 2]
    row, column = suns[:, 0].astype(np.int64), suns[:, 1].astype(np.int64)
    zenith, azimuth = np.pi * (row + 0.5) / sky.height, 2.0 * np.pi * (column + 0.5) / sky.width
    unit = np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)], axis=1)
    group, towards, part, reach = _groups(unit, probability, np.pi / sky.height)
    share = float(probability.sum())
    blur = float((part * reach**2).sum()) / 4.0
    first = np.array([chain[0] for chain, _, _ in chains], dtype=np.int64)
    padded = [[*chain, *[-1] * (LONGEST - len(chain))] for chain, _, _ in chains]
    made = Images if chains else NoImages
    return made(
        chain=np.array(padded, np.int64).reshape(-1, LONGEST),
        weight=np.array([weight * share * sky.power for _, weight, _ in chains]),
        kappa=np.array([1.0 / (width**2 + blur) if width > 0.0 else 0.0 for _, _, width in chains]),
        skip=np.array([np.searchsorted(first, index, side="right") for index in first], dtype=np.int64),
        rest=sky.whole / 4.0,
        flat=np.array([p.shape.is_flat for p in placements], dtype=np.int64),
        centre=np.stack([p.shape.frame_origin(p) for p in placements]).astype(np.float64),
        normal=np.stack([p.rotation[:, 2] for p in placements]).astype(np.float64),
        radius=np.array([_radius(p) for p in placements]),
        pixel=np.stack([row, column], axis=1),
        cumulative=np.concatenate([[0.0], probability.cumsum() / max(share, 1e-300)]),
        group=group,
        towards=towards,
        part=part,
        reach=reach,
        least=float(sky.least),
        share=share,
        pixels=sky.pixels,
        width=sky.width,
        height=sky.height,
    )


def _radius(placement: Placement) -> float:
    return np.inf if placement.shape.is_endless else placement.shape.reach_mm * placement.scale


def _groups(unit: np.ndarray, probability: np.ndarray, side: float) -> tuple[np.ndarray, ...]:
    """Return the group of each sun, and of each group direction, probability and the angle around it that holds it."""
    group, towards = np.full(len(unit), -1), list[np.ndarray]()
    while (group < 0).any() and len(towards) < _GROUPS:
        brightest = unit[np.argmax(np.where(group < 0, probability, -1.0))]
        group[(group < 0) & (unit @ brightest > np.cos(_NEAR))] = len(towards)
        towards.append(brightest)
    if len(unit):
        away = unit @ np.transpose(towards)
        group = np.where(group < 0, away.argmax(axis=1), group)
    middles, parts, reach = np.zeros((len(towards), 3)), np.zeros(len(towards)), np.zeros(len(towards))
    for number in range(len(towards)):
        own = group == number
        mean = probability[own] @ unit[own]
        middles[number], parts[number] = mean / np.linalg.norm(mean), probability[own].sum() / probability.sum()
        reach[number] = np.arccos(np.clip(unit[own] @ middles[number], -1.0, 1.0)).max() + 1.5 * side
    return group.astype(np.int64), middles, parts, reach


def _chains(placements: Sequence[Placement], objects: Objects) -> list[tuple[tuple[int, ...], float, float]]:
    """Return chains of mirrors in order, each with its reflectance and with its blur in rad, 0 for exact mirrors."""
    kinds: dict[int, list[tuple[float, float]]] = {}
    for index, placement in enumerate(placements):
        is_curved = not placement.shape.is_flat and placement.shape.ball_mm is None
        found = [] if is_curved else _reflections(objects, index)
        if found:
            kinds[index] = found
    chains = []
    for length in range(1, LONGEST + 1):
        for chain in product(kinds, repeat=length):
            pairs = list(pairwise(chain))
            if all(a != b for a, b in pairs):
                spread = np.prod([_dilution(placements[a], placements[b]) for a, b in pairs])
                for parts in product(*(kinds[index] for index in chain)):
                    albedo, width = np.prod([part[0] for part in parts]), np.sqrt(sum(part[1] ** 2 for part in parts))
                    chains.append((chain, float(albedo * spread), float(width)))
    chains = [one for one in chains if one[1] >= _LEAST_WEIGHT * max(other[1] for other in chains)]
    return sorted(sorted(chains, key=lambda one: -one[1])[:_MOST_CHAINS], key=lambda one: one[0][0])


def _reflections(objects: Objects, index: int) -> list[tuple[float, float]]:
    """Return albedo and blur in rad of an object's mirror and of its smooth gloss, those that matter."""
    n, k = objects.n[index], objects.k[index]
    mean = np.mean([fresnel_array(np.ones(1), *pair) for pair in zip(n, k, strict=True)])
    found = [(float(objects.mirror[index] * mean), 0.0)]
    for component, (beta, mu) in enumerate(gloss_of(objects, textures(objects)[index])):
        if beta.any():
            typical, name = float((beta * mu).sum() / beta.sum()), objects.lobes.names[objects.lobe[index, component]]
            albedo = float(beta.mean() * gloss_albedo(name, typical, 1.0, n, k).mean())
            found += [(albedo, math.sqrt(_BLUR) * typical)] if typical <= _SMOOTH else []
    return [one for one in found if one[0] >= _LEAST_ALBEDO]


def _dilution(a: Placement, b: Placement) -> float:
    """Return by how much the second of two mirrors is darker in the first than the sun, about."""
    if b.shape.is_flat:
        return 1.0
    radius = _radius(b)
    gap = 0.0 if a.shape.is_flat else np.linalg.norm(a.translation_mm - b.translation_mm) - _radius(a) - radius
    return float(1.0 + 2.0 * max(gap, 0.0) / radius) ** -2


@uncounted(forceinline=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@uncounted(forceinline=True)
def _plus(a, factor, b):
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@uncounted(forceinline=True)
def _row(array, index):
    return array[index, 0], array[index, 1], array[index, 2]


@uncounted(error_model="numpy")
def _distance(images, index, origin, direction):
    """Return the distance of an object along a ray that meets its front, mm; 0 or less if it does not."""
    away = _plus(_row(images.centre, index), -1.0, origin)
    if images.flat[index] == 1:
        normal = _row(images.normal, index)
        down = _dot(direction, normal)
        return _dot(away, normal) / down if down < 0.0 else -1.0
    radius, along = images.radius[index], _dot(away, direction)
    across = _plus(away, -along, direction)
    square = radius * radius - _dot(across, across)
    if square <= 0.0 or _dot(away, away) <= radius * radius:
        return -1.0
    return along - math.sqrt(square)


@uncounted(error_model="numpy")
def _reflect(images, chain, origin, direction):
    """Return the direction of a ray after a chain of reflections, its two derivatives and the Jacobian, 0 if it misses.

    The derivatives are those by small turns of the ray at right angles to each other (ray differentials, Igehy 1999).
    """
    side, up = frame(direction)
    at, by = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for link in range(LONGEST):
        index = images.chain[chain, link]
        if index < 0:
            break
        distance = _distance(images, index, origin, direction)
        if not distance > 0.0:
            return direction, side, up, 0.0
        origin = _plus(origin, distance, direction)
        normal, bend = _row(images.normal, index), 0.0
        if images.flat[index] == 0:
            bend = 1.0 / images.radius[index]
            out = _plus(origin, -1.0, _row(images.centre, index))
            normal = (bend * out[0], bend * out[1], bend * out[2])
        cosine = _dot(direction, normal)
        at, side = _bent(_plus(at, distance, side), side, direction, normal, cosine, bend)
        by, up = _bent(_plus(by, distance, up), up, direction, normal, cosine, bend)
        direction = _plus(direction, -2.0 * cosine, normal)
    x = side[1] * up[2] - side[2] * up[1]
    y = side[2] * up[0] - side[0] * up[2]
    z = side[0] * up[1] - side[1] * up[0]
    return direction, side, up, math.sqrt(x * x + y * y + z * z)


@uncounted(forceinline=True, error_model="numpy")
def _bent(offset, turn, direction, normal, cosine, bend):
    """Return the changes of place and direction of a ray after a reflection from those before; see `_reflect`."""
    offset = _plus(offset, -_dot(offset, normal) / cosine, direction)
    tilted = _dot(turn, normal) + bend * _dot(direction, offset)
    return offset, _plus(_plus(turn, -2.0 * cosine * bend, offset), -2.0 * tilted, normal)


@uncounted(error_model="numpy")
def _density_of_sun(images, chain, direction):
    """Return the density, 1/sr, with which a direction in or around the suns is drawn for a chain."""
    kappa = images.kappa[chain]
    if kappa > 0.0:
        total = 0.0
        for group in range(images.part.size):
            away = 1.0 - _dot(direction, _row(images.towards, group))
            total += images.part[group] * math.exp(-kappa * away)
        return total * kappa / (2.0 * math.pi * (1.0 - math.exp(-2.0 * kappa)))
    return sun_density(images, direction)


@if_images(0.0)
@uncounted(error_model="numpy")
def sun_density(images, direction):
    """Return the density, 1/sr, with which a direction in the suns is drawn, 0 outside them."""
    sine = math.sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    if sine <= 1e-12:
        return 0.0
    u, v = direction_uv(direction[0], direction[1], direction[2])
    x, y = u * images.width - 0.5, min(max(v * images.height - 0.5, 0.0), images.height - 1.0)
    left, above = math.floor(x), int(y)
    total, last = 0.0, images.pixels.shape[1] - 1
    for down in range(2):
        row = min(above + down, images.height - 1)
        for right in range(2):
            column = left + right
            column = column + images.width if column < 0 else column
            column = column - images.width if column >= images.width else column
            drawn = images.pixels[row * images.width + column, last]
            if drawn >= images.least:
                tall, wide = y - above, x - left
                total += drawn * (tall if down else 1.0 - tall) * (wide if right else 1.0 - wide)
    return total / (sine * images.share)


@if_images(0.0)
@uncounted(error_model="numpy")
def image_density(images, share, origin, direction):
    """Return the density, 1/sr, of a direction from a point if each chain is chosen with the probability ``share``."""
    total, chain = 0.0, 0
    while chain < images.weight.size:
        if not _distance(images, images.chain[chain, 0], origin, direction) > 0.0:
            chain = images.skip[chain]
            continue
        if share[chain] > 0.0:
            out, _, _, jacobian = _reflect(images, chain, origin, direction)
            if jacobian > 0.0:
                total += share[chain] * jacobian * _density_of_sun(images, chain, out)
        chain += 1
    return total


@uncounted(error_model="numpy")
def _towards_sun(images, sky, chain, u, v, out):
    """Draw a direction in or around the suns; see `_density_of_sun`."""
    low, high = 0, images.group.size
    while high - low > 1:
        middle = (low + high) // 2
        if images.cumulative[middle] <= u:
            low = middle
        else:
            high = middle
    start = images.cumulative[low]
    u = min((u - start) / (images.cumulative[low + 1] - start), 1.0 - 1e-12)
    kappa = images.kappa[chain]
    if kappa == 0.0:
        place_in_pixel(sky, images.pixel[low, 0], images.pixel[low, 1], u, v, out)
        return
    # von Mises-Fisher: uniform in exp(-κ (1 - cos)) between its ends.
    middle = _row(images.towards, images.group[low])
    away = -math.log(1.0 - v * (1.0 - math.exp(-2.0 * kappa))) / kappa
    sine, turn = math.sqrt(max(away * (2.0 - away), 0.0)), 2.0 * math.pi * u
    tangent, bitangent = frame(middle)
    for axis in range(3):
        across = math.cos(turn) * tangent[axis] + math.sin(turn) * bitangent[axis]
        out[axis] = (1.0 - away) * middle[axis] + sine * across


@uncounted(error_model="numpy")
def _on_sphere(whole, near, far):
    """Return the angle at a sphere's centre from a point to the place that reflects it to another.

    If the sphere hides them from each other, it is that of a place between them.

    Parameters
    ----------
    whole : float
        Angle between the directions to both points, rad.
    near, far : float
        Radius over the distance of the point and of the other; 0 for one that is infinitely far away.
    """
    low, high = max(0.0, whole - math.acos(far)), min(whole, math.acos(near))
    if low > high:
        return 0.5 * (low + high)
    angle = 0.5 * (low + high)
    for _ in range(_STEPS):
        rest = whole - angle
        a, b = math.cos(angle) - near, math.cos(rest) - far
        off = math.atan2(math.sin(angle), a) - math.atan2(math.sin(rest), b)
        if off > 0.0:
            high = angle
        else:
            low = angle
        slope = (1.0 - near * math.cos(angle)) / (1.0 - 2.0 * near * math.cos(angle) + near * near)
        slope += (1.0 - far * math.cos(rest)) / (1.0 - 2.0 * far * math.cos(rest) + far * far)
        step = off / slope
        following = angle - step
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - angle) <= 1e-15 * whole:
            return following
        angle = following
    return angle


@uncounted(error_model="numpy")
def _between(spheres, number, origin, target, is_far):
    """Fill the place on a sphere that reflects light between two points; return by how much it moved, mm.

    With ``is_far``, the target is a direction.
    """
    centre, radius = _row(spheres, number), spheres[number, _RADIUS]
    own = _plus(origin, -1.0, centre)
    other = target if is_far else _plus(target, -1.0, centre)
    away, beyond = math.sqrt(_dot(own, own)), math.sqrt(_dot(other, other))
    x = own[1] * other[2] - own[2] * other[1]
    y = own[2] * other[0] - own[0] * other[2]
    z = own[0] * other[1] - own[1] * other[0]
    whole = math.atan2(math.sqrt(x * x + y * y + z * z), _dot(own, other))
    angle = _on_sphere(whole, min(radius / away, 1.0), 0.0 if is_far else min(radius / beyond, 1.0))
    sine, a, b = math.sin(whole), 1.0, 0.0
    if sine > 1e-12:
        a, b = math.sin(whole - angle) / sine, math.sin(angle) / sine
    found, moved = _plus(_plus(centre, radius * a / away, own), radius * b / beyond, other), 0.0
    for axis in range(3):
        moved = max(moved, abs(found[axis] - spheres[number, _POINT + axis]))
        spheres[number, _POINT + axis] = found[axis]
    return moved


@uncounted(error_model="numpy")
def _unfold(images, chain, target, spheres):
    """Fill the spheres of a chain as they appear in its flat mirrors; return the target direction there, their number.

    Behind a flat mirror everything is seen mirrored, and light goes straight on.
    """
    count = 0
    for link in range(LONGEST):
        index = images.chain[chain, link]
        if index < 0:
            break
        if images.flat[index] == 0:
            spheres[count, _RADIUS] = images.radius[index]
            centre = _row(images.centre, index)
            for before in range(link - 1, -1, -1):
                centre = _mirrored(images, images.chain[chain, before], centre, 1.0)
            for axis in range(3):
                spheres[count, axis] = spheres[count, _POINT + axis] = centre[axis]
            count += 1
    for link in range(LONGEST - 1, -1, -1):
        if images.chain[chain, link] >= 0:
            target = _mirrored(images, images.chain[chain, link], target, 0.0)
    return target, count


@uncounted(error_model="numpy")
def _mirrored(images, index, place, is_point):
    """Return a place, or with ``is_point`` 0 a direction, mirrored in a flat shape; the same for a sphere."""
    if images.flat[index] == 0:
        return place
    normal = _row(images.normal, index)
    height = _dot(place, normal) - is_point * _dot(_row(images.centre, index), normal)
    return _plus(place, -2.0 * height, normal)


@uncounted(error_model="numpy")
def _aim(images, chain, origin, target, spheres, out):
    """Compute the direction that a chain of mirrors turns into another direction; return whether there is one."""
    way, count = _unfold(images, chain, target, spheres)
    if count == 0:
        return _refined(images, chain, origin, target, way, out)
    far = way
    for _ in range(_SWEEPS):
        moved = 0.0
        for number in range(count):
            start = origin if number == 0 else _point(spheres, number - 1)
            is_far = number == count - 1
            end = far if is_far else _point(spheres, number + 1)
            moved = max(moved, _between(spheres, number, start, end, is_far))
        if count > 1 and moved > _NEARLY * spheres[0, _RADIUS]:
            continue
        way = _plus(_point(spheres, 0), -1.0, origin)
        size = math.sqrt(_dot(way, way))
        way = (way[0] / size, way[1] / size, way[2] / size)
        if _refined(images, chain, origin, target, way, out):
            return True
        if count == 1 or moved <= _SETTLED * spheres[0, _RADIUS]:
            return False
    return False


@uncounted(error_model="numpy")
def _refined(images, chain, origin, target, way, out):
    """Find the direction that a chain turns into another from one nearby, by Newton's method; return whether it is."""
    for _ in range(_REFINEMENTS):
        there, side, up, jacobian = _reflect(images, chain, origin, way)
        if not jacobian > 0.0:
            return False
        off = _plus(target, -1.0, there)
        if _dot(off, off) <= _MET * _MET:
            for axis in range(3):
                out[axis] = way[axis]
            return True
        tangent, bitangent = frame(way)
        a, b, c, e, f = _dot(side, side), _dot(side, up), _dot(up, up), _dot(side, off), _dot(up, off)
        size = a * c - b * b
        way = _plus(_plus(way, (c * e - b * f) / size, tangent), (a * f - b * e) / size, bitangent)
        size = math.sqrt(_dot(way, way))
        way = (way[0] / size, way[1] / size, way[2] / size)
    return False


@uncounted(forceinline=True)
def _point(spheres, number):
    return spheres[number, _POINT], spheres[number, _POINT + 1], spheres[number, _POINT + 2]


@uncounted(forceinline=True)
def pick_chain(share, choice):
    """Return the chain that a random number in [0, 1) selects by probabilities, and another such number."""
    chosen = 0
    for chain in range(share.size):
        if share[chain] > 0.0:
            chosen = chain
            if choice < share[chain]:
                break
            choice -= share[chain]
    return chosen, min(choice / share[chosen], 1.0 - 1e-12)


@if_images(False)
@uncounted(error_model="numpy")
def draw_image(images, sky, chain, place, work, out):
    """Sample a direction from a point towards the image of a sun in a chain; return whether there is one.

    Parameters
    ----------
    images : Images
    sky : Sky
    chain : int
    place : (u, v)
        Random numbers in [0, 1) that select a place in the suns.
    work : Work
        Of the path; its origin is the point.
    out : (3,) float
    """
    _towards_sun(images, sky, chain, place[0], place[1], out)
    origin, target = (work.origin[0], work.origin[1], work.origin[2]), (out[0], out[1], out[2])
    return _aim(images, chain, origin, target, work.spheres, out)


@if_images(0.0)
@uncounted(error_model="numpy")
def fill_image_shares(images, origin, facet, share):
    """Fill the probabilities of the chains at a point of a surface; return the share of directions to aim at images."""
    total = 0.0
    for chain in range(images.weight.size):
        index = images.chain[chain, 0]
        away = _plus(_row(images.centre, index), -1.0, origin)
        found = 0.0
        if images.flat[index] == 1:
            normal = _row(images.normal, index)
            height = -_dot(away, normal)
            if height > 0.0:
                found = 1.0
                if images.chain[chain, 1] < 0:
                    found = _in_flat(images, index, origin, facet, height)
        else:
            radius, far, up = images.radius[index], math.sqrt(_dot(away, away)), _dot(away, facet)
            if far > radius and up > -radius:
                found = max(up / far, _LEAST_COSINE) / (1.0 + 2.0 * (far - radius) / radius) ** 2
        share[chain] = images.weight[chain] * found
        total += share[chain]
    if not total > 0.0:
        return 0.0
    for chain in range(images.weight.size):
        share[chain] /= total
    return min(total / (total + images.rest), _MOST)


@uncounted(error_model="numpy")
def _in_flat(images, index, origin, facet, height):
    """Return the cosine at a surface times the part of the suns whose images are seen within a flat mirror."""
    normal, found = _row(images.normal, index), 0.0
    for group in range(images.part.size):
        sun = _row(images.towards, group)
        rise = _dot(sun, normal)
        if rise <= 0.0:
            continue
        way = _plus(sun, -2.0 * rise, normal)
        up = _dot(way, facet)
        distance = height / rise
        offset = _plus(_plus(origin, distance, way), -1.0, _row(images.centre, index))
        margin = images.radius[index] + distance * images.reach[group] / rise
        if up > -images.reach[group] and _dot(offset, offset) <= margin * margin:
            found += images.part[group] * max(up, _LEAST_COSINE)
    return found


@njit(cache=True, nogil=True)
def aim_at_directions(images, chain, origin, target, out, found):
    """Fill directions, (n, 3), from points to images of directions in chains, (n,), and whether there is one."""
    spheres = np.empty((LONGEST, COLUMNS))
    for i in range(chain.size):
        start, end = _row(origin, i), _row(target, i)
        found[i] = _aim(images, chain[i], start, end, spheres, out[i])
