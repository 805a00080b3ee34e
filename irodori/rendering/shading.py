"""Compiled shading: look-ups of textures and light, diffuse light, and the gloss lobe [eq. 5, 8, 9]."""

import math

import numba
import numpy as np

from irodori.brdf import attenuation_over_cosine, fresnel
from irodori.geometry.embree import trace
from irodori.geometry.shapes import SPHERE, uv_from_point

BANDS = 61


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


@numba.njit(cache=True, inline="always")
def direction_uv(x, y, z):
    """Return equirectangular u, v of a unit direction."""
    u = math.atan2(y, x) / (2.0 * math.pi)
    return (u if u >= 0.0 else u + 1.0), math.acos(min(max(z, -1.0), 1.0)) / math.pi


@numba.njit(cache=True)
def add_light(light, level, x, y, z, scale, out):
    """Add coefficients of the environment's radiance from a direction."""
    u, v = direction_uv(x, y, z)
    interpolate(light.pixels, light.first_pixel[level], light.size[level, 0], light.size[level, 1], u, v, scale, out)


@numba.njit(cache=True)
def surface(objects, index, point, normal, texel):
    """Move a hit point onto its surface; fill its normal and its interpolated texel."""
    rotation, centre = objects.rotation[index], objects.translation_mm[index]
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    inverse = 1.0 / objects.scale[index]
    ox = (rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z) * inverse
    oy = (rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z) * inverse
    oz = (rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z) * inverse
    kind = objects.kind[index]
    if kind == SPHERE:
        length = math.sqrt(x * x + y * y + z * z)
        radius = objects.size_mm[index, 0] * objects.scale[index]
        for a in range(3):
            normal[a] = (point[a] - centre[a]) / length
            point[a] = centre[a] + radius * normal[a]
    else:
        offset = oz * objects.scale[index]
        for a in range(3):
            normal[a] = rotation[a, 2]
            point[a] -= offset * normal[a]
    u, v = uv_from_point(kind, objects.size_mm[index, 0], objects.size_mm[index, 1], ox, oy, oz)
    texel[:] = 0.0
    width, height = objects.texture_size[index, 0], objects.texture_size[index, 1]
    if kind == SPHERE:
        interpolate(objects.texels, objects.first_texel[index], width, height, u, v, 1.0, texel)
    else:
        # A plate's columns do not wrap: stay half a texel inside its edges.
        u = min(max(u, 0.5 / width), 1.0 - 0.5 / width)
        interpolate(objects.texels, objects.first_texel[index], width, height, u, v, 1.0, texel)


@numba.njit(cache=True)
def reflected_irradiance(objects, light, index, normal, texel, irradiance, scale, own, out):
    """Add the diffuse radiance α S / S_G · I / π [eq. 9] times ``scale``.

    ``irradiance`` (61,) is used where ``own`` is true; otherwise the irradiance map gives it [eq. 8].
    """
    bases = objects.bases[index]
    basis = objects.basis[index]
    coefficients = np.zeros(light.basis.shape[1])
    if not own:
        u, v = direction_uv(normal[0], normal[1], normal[2])
        flat = light.irradiance.reshape(-1, light.irradiance.shape[2])
        interpolate(flat, 0, light.irradiance.shape[1], light.irradiance.shape[0], u, v, 1.0, coefficients)
    for band in range(BANDS):
        reflectance = 0.0
        for b in range(bases):
            reflectance += basis[band, b] * texel[b]
        incoming = irradiance[band]
        if not own:
            incoming = 0.0
            for b in range(coefficients.size):
                incoming += light.basis[band, b] * coefficients[b]
        out[band] += scale * max(reflectance, 0.0) * max(incoming, 0.0) / math.pi


@numba.njit(cache=True)
def map_irradiance(light, normal, out):
    """Fill the spectral irradiance of an unobstructed normal from the irradiance map [eq. 8]."""
    coefficients = np.zeros(light.basis.shape[1])
    u, v = direction_uv(normal[0], normal[1], normal[2])
    flat = light.irradiance.reshape(-1, light.irradiance.shape[2])
    interpolate(flat, 0, light.irradiance.shape[1], light.irradiance.shape[0], u, v, 1.0, coefficients)
    for band in range(BANDS):
        value = 0.0
        for b in range(coefficients.size):
            value += light.basis[band, b] * coefficients[b]
        out[band] = max(value, 0.0)


@numba.njit(cache=True, inline="always")
def level_for(light, solid_angle):
    """Return the level of the light's ladder whose pixels are nearest to a solid angle, sr."""
    pixel = 4.0 * math.pi / (light.size[0, 0] * light.size[0, 1])
    level = math.floor(0.5 * math.log2(max(solid_angle / pixel, 1.0)) + 0.5)
    return min(level, light.size.shape[0] - 1)


@numba.njit(cache=True)
def add_ambient(objects, light, tracing, buffers, point, normal, samples, shift_u, shift_v, offset, irradiance):
    """Turn the map's irradiance at a point into the real one: other objects hide light, and reflect their own.

    Cosine-distributed rays; the hidden share of the map's irradiance is replaced by the diffuse radiance of what
    hides it.
    """
    intersect, scene, address, at, f, i = tracing
    tangent, bitangent, d, hit_point, hit_normal, hit_texel, gathered = buffers
    frame(normal, tangent, bitangent)
    gathered[:] = 0.0
    hidden = 0
    for s in range(samples):
        u = (s + 0.5) / samples + shift_u
        v = second_coordinate(s) + shift_v
        u -= math.floor(u)
        v -= math.floor(v)
        radius, angle = math.sqrt(u), 2.0 * math.pi * v
        a, b, c = radius * math.cos(angle), radius * math.sin(angle), math.sqrt(1.0 - u)
        for axis in range(3):
            d[axis] = a * tangent[axis] + b * bitangent[axis] + c * normal[axis]
        trace(
            intersect,
            scene,
            address,
            at,
            f,
            i,
            point[0] + offset * normal[0],
            point[1] + offset * normal[1],
            point[2] + offset * normal[2],
            d[0],
            d[1],
            d[2],
            0.0,
            np.float32(np.inf),
        )
        index = i[at + 18]
        if index < 0:
            continue
        hidden += 1
        for axis in range(3):
            hit_point[axis] = point[axis] + offset * normal[axis] + f[at + 8] * d[axis]
        surface(objects, index, hit_point, hit_normal, hit_texel)
        if hit_normal[0] * d[0] + hit_normal[1] * d[1] + hit_normal[2] * d[2] >= 0.0:
            continue  # the back of a plate is black
        reflected_irradiance(objects, light, index, hit_normal, hit_texel, gathered, math.pi / samples, False, gathered)
    seen = 1.0 - hidden / samples
    for band in range(BANDS):
        irradiance[band] = seen * irradiance[band] + gathered[band]


@numba.njit(cache=True, error_model="numpy")
def add_gloss(
    objects, light, tracing, buffers, index, point, normal, view, beta, mu, samples, shift_u, shift_v, offset, out
):
    """Add the gloss radiance β/π ∫ L F D G / cosθ_r dω [eq. 5], sampled by the facet distribution.

    Half vectors are drawn with density proportional to D sinφ-free in φ (a Rayleigh law), so that the weight of a
    sample is bounded; the light is looked up at the level whose pixels have the sample's solid angle.
    """
    intersect, scene, address, at, f, i = tracing
    tangent, bitangent, d, hit_point, hit_normal, hit_texel, gathered = buffers
    cos_r = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    if not (beta > 0.0 and mu > 0.0 and cos_r > 0.0):
        return
    frame(normal, tangent, bitangent)
    inside = 1.0 - math.exp(-((0.5 * math.pi / mu) ** 2))
    coefficients = np.zeros(light.basis.shape[1])
    radiance = np.zeros(BANDS)
    grey = objects.grey[index] == 1
    for s in range(samples):
        u = (s + 0.5) / samples + shift_u
        v = second_coordinate(s) + shift_v
        u -= math.floor(u)
        v -= math.floor(v)
        phi = mu * math.sqrt(-math.log(1.0 - u * inside))
        angle, sine = 2.0 * math.pi * v, math.sin(phi)
        a, b, c = sine * math.cos(angle), sine * math.sin(angle), math.cos(phi)
        cos_h = 0.0
        for axis in range(3):
            d[axis] = a * tangent[axis] + b * bitangent[axis] + c * normal[axis]
            cos_h += d[axis] * view[axis]
        if cos_h <= 0.0:
            continue
        cos_i = 0.0
        for axis in range(3):
            d[axis] = 2.0 * cos_h * d[axis] - view[axis]
            cos_i += d[axis] * normal[axis]
        geometric = attenuation_over_cosine(cos_i, cos_r, c, cos_h)
        if geometric <= 0.0:
            continue
        # dω_i = 4 V·H dω_H, and D over the density of H is π μ² (1 - exp(-(π/2μ)²)) sinφ / φ.
        spread = math.pi * mu * mu * inside * (sine / phi if phi > 1e-9 else 1.0) * 4.0 * cos_h
        weight = beta / math.pi * geometric * spread / samples
        ratio = phi / mu
        fresnel_grey = fresnel(cos_h, objects.n[index, 0], objects.k[index, 0])
        trace(
            intersect,
            scene,
            address,
            at,
            f,
            i,
            point[0] + offset * normal[0],
            point[1] + offset * normal[1],
            point[2] + offset * normal[2],
            d[0],
            d[1],
            d[2],
            0.0,
            np.float32(np.inf),
        )
        other = i[at + 18]
        if other < 0:
            level = level_for(light, spread / (samples * math.exp(-ratio * ratio)))
            if grey:
                add_light(light, level, d[0], d[1], d[2], weight * fresnel_grey, coefficients)
                continue
            coefficients[:] = 0.0
            add_light(light, level, d[0], d[1], d[2], weight, coefficients)
            for band in range(BANDS):
                value = 0.0
                for b_index in range(coefficients.size):
                    value += light.basis[band, b_index] * coefficients[b_index]
                radiance[band] += fresnel(cos_h, objects.n[index, band], objects.k[index, band]) * max(value, 0.0)
            continue
        for axis in range(3):
            hit_point[axis] = point[axis] + offset * normal[axis] + f[at + 8] * d[axis]
        surface(objects, other, hit_point, hit_normal, hit_texel)
        if hit_normal[0] * d[0] + hit_normal[1] * d[1] + hit_normal[2] * d[2] >= 0.0:
            continue
        gathered[:] = 0.0
        reflected_irradiance(objects, light, other, hit_normal, hit_texel, gathered, weight, False, gathered)
        for band in range(BANDS):
            factor = fresnel_grey if grey else fresnel(cos_h, objects.n[index, band], objects.k[index, band])
            radiance[band] += factor * gathered[band]
    for band in range(BANDS):
        value = radiance[band]
        if grey:
            sum_ = 0.0
            for b_index in range(coefficients.size):
                sum_ += light.basis[band, b_index] * coefficients[b_index]
            value += max(sum_, 0.0)
        out[band] += value
