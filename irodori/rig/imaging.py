"""What each mosaic pixel of the virtual camera receives: equation (5) under a collimated light, with shadows."""

import math

import numba
import numpy as np

from irodori.brdf import attenuation_over_cosine, facet_distribution, fresnel
from irodori.geometry.embree import Tracer, new_ray, trace
from irodori.geometry.shapes import PLATE, uv_from_point

# The optical low-pass filter of a mosaic sensor splits each point into four, one pixel apart: a pixel sees its corners.
_SPOTS = 2
_FRESNEL_NODES = 512
_OFFSET_MM = 1e-3


def fresnel_by_band(n: np.ndarray, k: np.ndarray, band_weights: np.ndarray) -> np.ndarray:
    """Return Fresnel reflectance seen by each band, tabulated over the cosine of the angle of incidence.

    Parameters
    ----------
    n, k : (61,) float
    band_weights : (bands, 61) float

    Returns
    -------
    (nodes, bands) float64, weighted response of a surface with reflectance F(n(λ), k(λ), θ)
    """
    cosines = np.linspace(0.0, 1.0, _FRESNEL_NODES)
    table = np.array([[fresnel(c, n[i], k[i]) for i in range(n.size)] for c in cosines])
    return table @ band_weights.T


@numba.njit(cache=True, inline="always")
def _lookup(table, cosine, band):
    position = min(max(cosine, 0.0), 1.0) * (table.shape[0] - 1)
    node = min(int(position), table.shape[0] - 2)
    part = position - node
    return (1.0 - part) * table[node, band] + part * table[node + 1, band]


@numba.njit(cache=True, inline="always")
def _surface(kind, size, rotation, world):
    """Return the object-frame point and the world normal of a hit on the sample."""
    ox = rotation[0, 0] * world[0] + rotation[1, 0] * world[1] + rotation[2, 0] * world[2]
    oy = rotation[0, 1] * world[0] + rotation[1, 1] * world[1] + rotation[2, 1] * world[2]
    oz = rotation[0, 2] * world[0] + rotation[1, 2] * world[1] + rotation[2, 2] * world[2]
    if kind == PLATE:
        return ox, oy, oz, rotation[0, 2], rotation[1, 2], rotation[2, 2]
    inverse = 1.0 / math.sqrt(world[0] ** 2 + world[1] ** 2 + world[2] ** 2)
    return ox, oy, oz, world[0] * inverse, world[1] * inverse, world[2] * inverse


@numba.njit(cache=True, inline="always", error_model="numpy")
def _response(out, weight, colour, diffuse, beta, mu, mirror, lamp_cosine, table, normal, light, view):
    """Add the responses of one sample, without and with the filter, to ``out`` [eq. 5]."""
    ci = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    cr = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    if ci <= 0.0 or cr <= 0.0:
        return
    hx, hy, hz = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    cos_phi = min((hx * normal[0] + hy * normal[1] + hz * normal[2]) / length, 1.0)
    cos_h = length / 2.0
    gloss = beta * facet_distribution(math.acos(cos_phi), mu) * attenuation_over_cosine(ci, cr, cos_phi, cos_h)
    # The lamp is a disc: its mirror image is seen where the mirrored view falls within its angular radius.
    mirrored = 2.0 * ci * cr - (view[0] * light[0] + view[1] * light[1] + view[2] * light[2])
    image = mirror / (1.0 - lamp_cosine * lamp_cosine) if mirrored >= lamp_cosine else 0.0
    for state in range(2):
        band = 3 * state + colour
        out[state] += weight * (
            diffuse[band] * ci + gloss * _lookup(table, cos_h, band) + image * _lookup(table, ci, band)
        )


@numba.njit(cache=True, parallel=True, nogil=True)
def _expose_object(
    functions,
    scene,
    camera,
    to_world,
    focal,
    centre,
    light,
    rotation,
    kind,
    size,
    checks,
    diffuse,
    beta,
    mu,
    mirror,
    lamp_cosine,
    table,
    image,
):
    intersect, occluded = functions
    height, width = image.shape[1], image.shape[2]
    for y in numba.prange(height):
        f = np.empty(64, np.float32)
        i = f.view(np.int32)
        address, at = new_ray(f, i)
        d, world, normal, out = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
        for x in range(width):
            colour = (y % 2) + (x % 2)
            out[:] = 0.0
            for s in range(_SPOTS * _SPOTS):
                px = (x + s % _SPOTS - centre[0]) / focal
                py = (y + s // _SPOTS - centre[1]) / focal
                scale = 1.0 / math.sqrt(px * px + py * py + 1.0)
                for a in range(3):
                    d[a] = (to_world[a, 0] * px + to_world[a, 1] * py + to_world[a, 2]) * scale
                trace(
                    intersect,
                    scene,
                    address,
                    at,
                    f,
                    i,
                    camera[0],
                    camera[1],
                    camera[2],
                    d[0],
                    d[1],
                    d[2],
                    0.0,
                    np.float32(np.inf),
                )
                if i[at + 18] != 0:
                    continue
                for a in range(3):
                    world[a] = camera[a] + f[at + 8] * d[a]
                ox, oy, oz, normal[0], normal[1], normal[2] = _surface(kind, size, rotation, world)
                trace(
                    occluded,
                    scene,
                    address,
                    at,
                    f,
                    i,
                    world[0] + _OFFSET_MM * normal[0],
                    world[1] + _OFFSET_MM * normal[1],
                    world[2] + _OFFSET_MM * normal[2],
                    light[0],
                    light[1],
                    light[2],
                    0.0,
                    np.float32(np.inf),
                )
                if f[at + 8] < 0.0:
                    continue
                u, v = uv_from_point(kind, size[0], size[1], ox, oy, oz)
                column = min(max(int(u * checks[0]), 0), checks[0] - 1)
                row = min(max(int(v * checks[1]), 0), checks[1] - 1)
                m = (row * checks[0] + column) % beta.size
                _response(
                    out,
                    1.0 / (_SPOTS * _SPOTS),
                    colour,
                    diffuse[m],
                    beta[m],
                    mu[m],
                    mirror,
                    lamp_cosine,
                    table,
                    normal,
                    light,
                    -d,
                )
            image[0, y, x] = out[0]
            image[1, y, x] = out[1]


def expose_object(
    sample,
    tracer: Tracer,
    rotation,
    pinhole,
    camera_position,
    world_from_camera,
    light,
    band_weights,
    lamp_radius_rad: float,
) -> np.ndarray:
    """Return what each mosaic pixel receives from the sample under the rig's light.

    Parameters
    ----------
    sample : irodori.rig.samples.Sample
    tracer : Tracer
        Shape 0 is the sample, the others only cast shadows.
    rotation : (3, 3) float, rig_from_object
    pinhole : Pinhole
    camera_position : (3,) float, mm
    world_from_camera : (3, 3) float
    light : (3,) float, unit vector to the light
    band_weights : (6, 61) float, see `irodori.rig.sensor.band_weights`
    lamp_radius_rad : float
        Angular radius of the lamp, for its mirror image.

    Returns
    -------
    (2, height, width) float64, responses without and with the filter
    """
    image = np.empty((2, pinhole.height_px, pinhole.width_px))
    _expose_object(
        (tracer.intersect_address, tracer.occluded_address),
        tracer.scene,
        np.asarray(camera_position, dtype=np.float64),
        np.ascontiguousarray(world_from_camera),
        float(pinhole.focal_px),
        np.asarray(pinhole.centre_px, dtype=np.float64),
        np.asarray(light, dtype=np.float64),
        np.ascontiguousarray(rotation),
        sample.shape.kind,
        np.asarray(sample.shape.size_mm, dtype=np.float64),
        np.array([sample.columns, sample.rows]),
        np.ascontiguousarray(sample.reflectance @ band_weights.T),
        sample.beta,
        sample.mu_rad,
        sample.mirror,
        math.cos(lamp_radius_rad),
        fresnel_by_band(sample.n, sample.k, band_weights),
        image,
    )
    return image
