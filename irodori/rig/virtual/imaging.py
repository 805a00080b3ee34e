"""What each mosaic pixel of the virtual camera receives: equation (5) under a collimated light, with shadows."""

import math
from typing import NamedTuple

import numba
import numpy as np

from irodori.brdf import attenuation_over_cosine, facet_distribution, fresnel
from irodori.geometry.embree import Tracer, hit_distance, hit_shape, is_blocked, new_ray, trace
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
def _surface(kind, rotation, world):
    """Return the object-frame point and the world normal of a hit on the sample."""
    ox = rotation[0, 0] * world[0] + rotation[1, 0] * world[1] + rotation[2, 0] * world[2]
    oy = rotation[0, 1] * world[0] + rotation[1, 1] * world[1] + rotation[2, 1] * world[2]
    oz = rotation[0, 2] * world[0] + rotation[1, 2] * world[1] + rotation[2, 2] * world[2]
    if kind == PLATE:
        return ox, oy, oz, rotation[0, 2], rotation[1, 2], rotation[2, 2]
    inverse = 1.0 / math.sqrt(world[0] ** 2 + world[1] ** 2 + world[2] ** 2)
    return ox, oy, oz, world[0] * inverse, world[1] * inverse, world[2] * inverse


@numba.njit(cache=True, inline="always", error_model="numpy")
def _response(out, weight, colour, sample, material, setup, normal, view):
    """Add the responses of one point, without and with the filter, to ``out`` [eq. 5]."""
    light = setup.to_light
    ci = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    cr = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    if ci <= 0.0 or cr <= 0.0:
        return
    hx, hy, hz = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    cos_phi = min((hx * normal[0] + hy * normal[1] + hz * normal[2]) / length, 1.0)
    cos_h = length / 2.0
    gloss = sample.beta[material] * facet_distribution(math.acos(cos_phi), sample.mu[material])
    gloss *= attenuation_over_cosine(ci, cr, cos_phi, cos_h)
    # The lamp is a disc: its mirror image is seen where the mirrored view falls within its angular radius.
    mirrored = 2.0 * ci * cr - (view[0] * light[0] + view[1] * light[1] + view[2] * light[2])
    image = 0.0
    if setup.lamp_cosine < 1.0 and mirrored >= setup.lamp_cosine:
        image = sample.mirror / (1.0 - setup.lamp_cosine**2)
    for state in range(2):
        band = 3 * state + colour
        rough = sample.diffuse[material, band] * ci + gloss * _lookup(sample.fresnel, cos_h, band)
        out[state] += weight * (rough + image * _lookup(sample.fresnel, ci, band))


class _Setup(NamedTuple):
    """One pose of the virtual rig for the compiled loop."""

    intersect: int
    occluded: int
    scene: int
    camera_mm: np.ndarray  # (3,)
    world_from_camera: np.ndarray  # (3, 3)
    focal_px: float
    centre_px: np.ndarray  # (2,)
    to_light: np.ndarray  # (3,)
    rotation: np.ndarray  # (3, 3) rig_from_object
    lamp_cosine: float


class _Subject(NamedTuple):
    """The sample for the compiled loop."""

    kind: int
    size_mm: np.ndarray  # (2,)
    checks: np.ndarray  # (2,) columns, rows
    diffuse: np.ndarray  # (materials, 6) band responses of S(λ)
    beta: np.ndarray  # (materials,)
    mu: np.ndarray  # (materials,)
    mirror: float
    fresnel: np.ndarray  # (nodes, 6)


@numba.njit(cache=True, inline="always")
def _aim(setup, x, y, direction):
    """Fill the direction in which the camera sees a point of the mosaic."""
    px, py = (x - setup.centre_px[0]) / setup.focal_px, (y - setup.centre_px[1]) / setup.focal_px
    scale = 1.0 / math.sqrt(px * px + py * py + 1.0)
    axes = setup.world_from_camera
    for a in range(3):
        direction[a] = (axes[a, 0] * px + axes[a, 1] * py + axes[a, 2]) * scale


@numba.njit(cache=True)
def _see(setup, sample, ray, direction, world, normal, view, weight, colour, out):
    """Add what one ray from the camera sees of the sample."""
    trace(setup.intersect, setup.scene, ray, setup.camera_mm, direction, np.inf)
    if hit_shape(ray) != 0:
        return
    for a in range(3):
        world[a] = setup.camera_mm[a] + hit_distance(ray) * direction[a]
        view[a] = -direction[a]
    ox, oy, oz, normal[0], normal[1], normal[2] = _surface(sample.kind, setup.rotation, world)
    for a in range(3):
        world[a] += _OFFSET_MM * normal[a]
    trace(setup.occluded, setup.scene, ray, world, setup.to_light, np.inf)
    if is_blocked(ray):
        return
    u, v = uv_from_point(sample.kind, sample.size_mm[0], sample.size_mm[1], ox, oy, oz)
    column = min(max(int(u * sample.checks[0]), 0), sample.checks[0] - 1)
    row = min(max(int(v * sample.checks[1]), 0), sample.checks[1] - 1)
    _response(out, weight, colour, sample, (row * sample.checks[0] + column) % sample.beta.size, setup, normal, view)


@numba.njit(cache=True)
def _expose_row(setup, sample, y, image):
    ray = new_ray()
    direction, world, normal, view, out = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    spots = _SPOTS * _SPOTS
    for x in range(image.shape[2]):
        out[:] = 0.0
        for s in range(spots):
            _aim(setup, x + s % _SPOTS, y + s // _SPOTS, direction)
            _see(setup, sample, ray, direction, world, normal, view, 1.0 / spots, y % 2 + x % 2, out)
        image[0, y, x] = out[0]
        image[1, y, x] = out[1]


@numba.njit(cache=True, parallel=True, nogil=True)
def _expose_object(setup, sample, image):
    for y in numba.prange(image.shape[1]):
        _expose_row(setup, sample, y, image)


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
    sample : irodori.rig.virtual.samples.Sample
    tracer : Tracer
        Shape 0 is the sample, the others only cast shadows.
    rotation : (3, 3) float, rig_from_object
    pinhole : Pinhole
    camera_position : (3,) float, mm
    world_from_camera : (3, 3) float
    light : (3,) float, unit vector to the light
    band_weights : (6, 61) float, see `irodori.rig.virtual.sensor.band_weights`
    lamp_radius_rad : float
        Angular radius of the lamp, for its mirror image.

    Returns
    -------
    (2, height, width) float64, responses without and with the filter
    """
    setup = _Setup(
        intersect=tracer.intersect_address,
        occluded=tracer.occluded_address,
        scene=tracer.scene,
        camera_mm=np.asarray(camera_position, dtype=np.float64),
        world_from_camera=np.ascontiguousarray(world_from_camera),
        focal_px=float(pinhole.focal_px),
        centre_px=np.asarray(pinhole.centre_px, dtype=np.float64),
        to_light=np.asarray(light, dtype=np.float64),
        rotation=np.ascontiguousarray(rotation),
        lamp_cosine=math.cos(lamp_radius_rad),
    )
    subject = _Subject(
        kind=sample.shape.kind,
        size_mm=np.asarray(sample.shape.size_mm, dtype=np.float64),
        checks=np.array([sample.columns, sample.rows]),
        diffuse=np.ascontiguousarray(sample.reflectance @ band_weights.T),
        beta=sample.beta,
        mu=sample.mu_rad,
        mirror=sample.mirror,
        fresnel=fresnel_by_band(sample.n, sample.k, band_weights),
    )
    image = np.empty((2, pinhole.height_px, pinhole.width_px))
    with numba.parallel_chunksize(8):
        _expose_object(setup, subject, image)
    return image
