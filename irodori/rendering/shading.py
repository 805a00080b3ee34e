"""Compiled shading: look-ups of textures and light, diffuse light, and the gloss lobe [eq. 5, 8, 9]."""

import math
from typing import NamedTuple

import numba
import numpy as np

from irodori.brdf import attenuation_over_cosine, fresnel
from irodori.geometry.embree import NO_HIT, hit_distance, hit_shape, trace
from irodori.geometry.surfaces import Surfaces, face_viewer, surface_at
from irodori.rendering.scene import Light, Objects
from irodori.sphere import add_interpolated, direction_uv

BANDS = 61
#: Sums over bands may be taken in any order, or each addition waits for the one before.
_SUMS = {"reassoc", "contract", "nsz"}


class World(NamedTuple):
    """What rays travel in; surface i is object i. See `irodori.rendering.scene`, and `Tracer` for the addresses."""

    surfaces: Surfaces
    objects: Objects
    light: Light
    intersect: int
    scene: int
    offset_mm: float  # height above a surface at which rays leave it


class Scratch(NamedTuple):
    """Buffers of one thread for the secondary rays of a shading point."""

    tangent: np.ndarray  # (3,)
    bitangent: np.ndarray  # (3,)
    origin: np.ndarray  # (3,)
    direction: np.ndarray  # (3,)
    point: np.ndarray  # (3,)
    normal: np.ndarray  # (3,)
    facet: np.ndarray  # (3,)
    texel: np.ndarray  # (k + 2,)
    light: np.ndarray  # (k of the light,)
    gathered: np.ndarray  # (k of the light,)
    radiance: np.ndarray  # (61,)
    incoming: np.ndarray  # (61,)
    decoded: np.ndarray  # (61,)


@numba.njit(cache=True)
def new_scratch(world):
    """Return buffers for one thread."""
    return Scratch(
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(world.objects.texels.shape[1]),
        np.empty(world.light.basis.shape[0]),
        np.empty(world.light.basis.shape[0]),
        np.empty(BANDS),
        np.empty(BANDS),
        np.empty(BANDS),
    )


@numba.njit(cache=True, inline="always")
def frame(normal, tangent, bitangent):
    """Fill two unit vectors perpendicular to a normal (Duff et al. 2017, without a branch at the pole)."""
    sign = math.copysign(1.0, normal[2])
    a = -1.0 / (sign + normal[2])
    b = normal[0] * normal[1] * a
    tangent[0], tangent[1], tangent[2] = 1.0 + sign * normal[0] ** 2 * a, sign * b, -sign * normal[0]
    bitangent[0], bitangent[1], bitangent[2] = b, sign + normal[1] ** 2 * a, -normal[1]


@numba.njit(cache=True, inline="always")
def hashed(x, y, sample, stream):
    """Return a number in [0, 1) that depends on pixel, sample and stream only."""
    h = np.uint32(x) * np.uint32(0x9E3779B1) ^ np.uint32(y) * np.uint32(0x85EBCA77)
    h ^= np.uint32(sample) * np.uint32(0xC2B2AE3D) ^ np.uint32(stream) * np.uint32(0x27D4EB2F)
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x2C1B3C6D))
    h = np.uint32((h ^ (h >> np.uint32(12))) * np.uint32(0x297A2D39))
    h = np.uint32(h ^ (h >> np.uint32(15)))
    return np.float64(h) / 4294967296.0


@numba.njit(cache=True, inline="always")
def second_coordinate(index):
    """Return the base-2 radical inverse: with index / count it makes an even set of points."""
    bits = np.uint32(index)
    value, half = 0.0, 0.5
    while bits:
        if bits & np.uint32(1):
            value += half
        half *= 0.5
        bits >>= np.uint32(1)
    return value


@numba.njit(cache=True, inline="always")
def interpolate(pixels, first, width, height, u, v, scale, out):
    """Add ``scale`` times the bilinear value of a picture at u, v in 0..1; columns wrap, rows end."""
    x, y = u * width - 0.5, min(max(v * height - 0.5, 0.0), height - 1.0)
    x0, y0 = math.floor(x), int(y)
    fx, fy = x - x0, y - y0
    left, right = int(x0) % width, (int(x0) + 1) % width
    below = min(y0 + 1, height - 1)
    a, b = first + y0 * width + left, first + y0 * width + right
    c, d = first + below * width + left, first + below * width + right
    wa, wb = scale * (1.0 - fx) * (1.0 - fy), scale * fx * (1.0 - fy)
    wc, wd = scale * (1.0 - fx) * fy, scale * fx * fy
    for i in range(out.size):
        out[i] += wa * pixels[a, i] + wb * pixels[b, i] + wc * pixels[c, i] + wd * pixels[d, i]


@numba.njit(cache=True)
def add_light(light, level, x, y, z, scale, out):
    """Add coefficients of the environment's radiance from a direction."""
    u, v = direction_uv(x, y, z)
    interpolate(light.pixels, light.first_pixel[level], light.size[level, 0], light.size[level, 1], u, v, scale, out)


@numba.njit(cache=True, inline="always")
def surface(world, index, ray, point, normal, facet, texel):
    """Move a hit point onto its surface; fill its normals and its interpolated texel."""
    u, v = surface_at(world.surfaces, index, ray, point, normal, facet)
    objects = world.objects
    texel[:] = 0.0
    width, height = objects.texture_size[index, 0], objects.texture_size[index, 1]
    if objects.wraps[index] == 0:
        # Columns that do not wrap: stay half a texel inside the texture's edges.
        u = min(max(u, 0.5 / width), 1.0 - 0.5 / width)
    interpolate(objects.texels, objects.first_texel[index], width, height, u, v, 1.0, texel)


@numba.njit(cache=True, fastmath=_SUMS)
def add_spectrum(basis, coefficients, decoded, out):
    """Add the spectrum of coefficients; ``decoded`` (61,) is a buffer.

    Samples below zero, left by recovery and compression, are dark, and the others carry so much less that the total
    stays: setting them to zero alone would add light.
    """
    decoded[:] = 0.0
    for b in range(coefficients.size):
        value = coefficients[b]
        for band in range(BANDS):
            decoded[band] += basis[b, band] * value
    total = 0.0
    positive = 0.0
    for band in range(BANDS):
        total += decoded[band]
        positive += max(decoded[band], 0.0)
    if total <= 0.0:
        return
    share = total / positive
    for band in range(BANDS):
        out[band] += share * max(decoded[band], 0.0)


@numba.njit(cache=True)
def fill_irradiance(light, normal, coefficients, decoded, out):
    """Fill the spectral irradiance of an unobstructed normal from the irradiance map [eq. 8]."""
    coefficients[:] = 0.0
    out[:] = 0.0
    width, height = light.irradiance_size[0], light.irradiance_size[1]
    add_interpolated(light.irradiance, 0, width, height, normal[0], normal[1], normal[2], 1.0, coefficients)
    add_spectrum(light.basis, coefficients, decoded, out)


@numba.njit(cache=True, fastmath=_SUMS)
def add_diffuse(objects, index, texel, irradiance, scale, decoded, out):
    """Add ``scale`` times the diffuse radiance α S / S_G · I / π of a surface [eq. 9]. ``decoded`` is a buffer.

    What is below zero is dark, as in `add_spectrum`; what stays is the light reflected under this irradiance.
    """
    decoded[:] = 0.0
    for b in range(objects.bases[index]):
        value = texel[b]
        for band in range(BANDS):
            decoded[band] += objects.basis[index, b, band] * value
    total = 0.0
    positive = 0.0
    for band in range(BANDS):
        total += decoded[band] * irradiance[band]
        positive += max(decoded[band], 0.0) * irradiance[band]
    if total <= 0.0:
        return
    share = total / positive * scale / math.pi
    for band in range(BANDS):
        out[band] += share * max(decoded[band], 0.0) * irradiance[band]


@numba.njit(cache=True, inline="always")
def level_for(light, solid_angle):
    """Return the level of the light's ladder whose pixels are nearest to a solid angle, sr."""
    pixel = 4.0 * math.pi / (light.size[0, 0] * light.size[0, 1])
    level = math.floor(0.5 * math.log2(max(solid_angle / pixel, 1.0)) + 0.5)
    return min(level, light.size.shape[0] - 1)


@numba.njit(cache=True)
def look_from(world, ray, point, facet, scratch):
    """Trace ``scratch.direction`` from a surface; return the shape met, its point, normal and texel in ``scratch``.

    Returns `NO_HIT` where the light is seen, and -2 for the back of a surface, which is black.
    """
    origin, d, hit = scratch.origin, scratch.direction, scratch.point
    for axis in range(3):
        origin[axis] = point[axis] + world.offset_mm * facet[axis]
    trace(world.intersect, world.scene, ray, origin, d, np.inf)
    index = hit_shape(ray)
    if index < 0:
        return index
    distance = hit_distance(ray)
    for axis in range(3):
        hit[axis] = origin[axis] + distance * d[axis]
    surface(world, index, ray, hit, scratch.normal, scratch.facet, scratch.texel)
    return index if face_viewer(scratch.normal, scratch.facet, d) > 0.0 else -2


@numba.njit(cache=True, inline="always")
def stratum(sample, samples, shift):
    """Return a point of an even set in the unit square, moved by a shift."""
    u, v = (sample + 0.5) / samples + shift[0], second_coordinate(sample) + shift[1]
    return u - math.floor(u), v - math.floor(v)


@numba.njit(cache=True)
def hide_and_reflect(world, ray, scratch, point, normal, facet, samples, shift, irradiance):
    """Turn the map's irradiance at a point into the real one: other objects hide light, and reflect their own.

    Cosine-distributed rays; the hidden share of the map's irradiance is replaced by the diffuse radiance of what
    hides it.
    """
    tangent, bitangent, d = scratch.tangent, scratch.bitangent, scratch.direction
    frame(normal, tangent, bitangent)
    scratch.radiance[:] = 0.0
    hidden = 0
    for s in range(samples):
        u, v = stratum(s, samples, shift)
        radius, angle = math.sqrt(u), 2.0 * math.pi * v
        a, b, c = radius * math.cos(angle), radius * math.sin(angle), math.sqrt(1.0 - u)
        for axis in range(3):
            d[axis] = a * tangent[axis] + b * bitangent[axis] + c * normal[axis]
        index = look_from(world, ray, point, facet, scratch)
        if index == NO_HIT:
            continue
        hidden += 1
        if index >= 0:
            fill_irradiance(world.light, scratch.normal, scratch.light, scratch.decoded, scratch.incoming)
            add_diffuse(
                world.objects,
                index,
                scratch.texel,
                scratch.incoming,
                math.pi / samples,
                scratch.decoded,
                scratch.radiance,
            )
    seen = 1.0 - hidden / samples
    for band in range(BANDS):
        irradiance[band] = seen * irradiance[band] + scratch.radiance[band]


@numba.njit(cache=True, error_model="numpy")
def _sample_lobe(normal, view, mu, inside, cos_r, uv, scratch):
    """Draw a half vector and mirror the view in it, into ``scratch.direction``.

    Its φ has the density 2φ/μ² exp(-(φ/μ)²), so that D over the density of H in solid angle is π μ² sinφ / φ times
    ``inside`` = 1 - exp(-(π/2μ)²), and the weight of a sample is bounded.

    Returns
    -------
    cos_h : float, V·H
    weight : float, G / cosθ_r times D dω over the density; 0 for a direction that carries no light
    solid_angle : float, sr, one over the density of the direction
    """
    phi = mu * math.sqrt(-math.log(1.0 - uv[0] * inside))
    angle, sine, cosine = 2.0 * math.pi * uv[1], math.sin(phi), math.cos(phi)
    a, b = sine * math.cos(angle), sine * math.sin(angle)
    tangent, bitangent, d = scratch.tangent, scratch.bitangent, scratch.direction
    cos_h = 0.0
    for axis in range(3):
        d[axis] = a * tangent[axis] + b * bitangent[axis] + cosine * normal[axis]
        cos_h += d[axis] * view[axis]
    cos_i = 0.0
    for axis in range(3):
        d[axis] = 2.0 * cos_h * d[axis] - view[axis]
        cos_i += d[axis] * normal[axis]
    geometric = attenuation_over_cosine(cos_i, cos_r, cosine, cos_h)
    # dω_i = 4 V·H dω_H.
    spread = math.pi * mu * mu * inside * (sine / phi if phi > 1e-9 else 1.0) * 4.0 * cos_h
    ratio = phi / mu
    return cos_h, geometric * spread, spread * math.exp(ratio * ratio)


@numba.njit(cache=True, error_model="numpy")
def add_gloss(world, ray, scratch, index, point, normal, facet, view, gloss, samples, shift, out):
    """Add the gloss radiance β/π ∫ L F D G / cosθ_r dω [eq. 5], sampled by the facet distribution.

    ``gloss`` is (β, μ). Light is looked up at the level of its ladder whose pixels have the sample's solid angle
    (Křivánek and Colbert 2008); other objects are seen by their diffuse radiance.
    """
    beta, mu = gloss
    cos_r = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    if not (beta > 0.0 and mu > 0.0 and cos_r > 0.0):
        return
    objects, d = world.objects, scratch.direction
    frame(normal, scratch.tangent, scratch.bitangent)
    inside = 1.0 - math.exp(-((0.5 * math.pi / mu) ** 2))
    scratch.gathered[:] = 0.0
    for s in range(samples):
        uv = stratum(s, samples, shift)
        cos_h, weight, solid_angle = _sample_lobe(normal, view, mu, inside, cos_r, uv, scratch)
        if weight <= 0.0:
            continue
        weight *= beta / (math.pi * samples)
        factor = weight * fresnel(cos_h, objects.n[index, 0], objects.k[index, 0])
        other = look_from(world, ray, point, facet, scratch)
        if other == NO_HIT:
            level = level_for(world.light, solid_angle / samples)
            if objects.grey[index] == 1:
                # One reflectance for all bands: the light is summed on its basis and decoded once.
                add_light(world.light, level, d[0], d[1], d[2], factor, scratch.gathered)
                continue
            scratch.light[:] = 0.0
            scratch.radiance[:] = 0.0
            add_light(world.light, level, d[0], d[1], d[2], 1.0, scratch.light)
            add_spectrum(world.light.basis, scratch.light, scratch.decoded, scratch.radiance)
        elif other >= 0:
            scratch.radiance[:] = 0.0
            fill_irradiance(world.light, scratch.normal, scratch.light, scratch.decoded, scratch.incoming)
            add_diffuse(objects, other, scratch.texel, scratch.incoming, 1.0, scratch.decoded, scratch.radiance)
        else:
            continue
        for band in range(BANDS):
            if objects.grey[index] == 0:
                factor = weight * fresnel(cos_h, objects.n[index, band], objects.k[index, band])
            out[band] += factor * scratch.radiance[band]
    add_spectrum(world.light.basis, scratch.gathered, scratch.decoded, out)
