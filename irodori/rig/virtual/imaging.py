"""What each mosaic pixel of the virtual camera receives from a sample under a collimated light, with shadows."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from irodori.geometry.embree import Tracer, hit_distance, hit_shape, is_blocked, new_ray, trace
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.shapes import PLATE, uv_from_point
from irodori.rig.virtual.reflection import MEASURED, gloss_lobe, measured_lobe

_BLOCK_ROWS = 16
_OFFSET_MM = 1e-3


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
def _response(out, sample, material, setup, normal, view, ci):
    """Fill the responses of one point, lit at the cosine `ci` and seen from its front, in the state's three bands."""
    light = setup.to_light
    cr = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    hx, hy, hz = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    cos_phi = min((hx * normal[0] + hy * normal[1] + hz * normal[2]) / length, 1.0)
    cos_h = length / 2.0
    lobe, image = 0.0, 0.0
    if sample.model[material] != MEASURED:
        lobe = sample.beta[material] * gloss_lobe(sample.model[material], sample.mu[material], ci, cr, cos_phi, cos_h)
    # The lamp is a disc: its mirror image is seen where the mirrored view falls within its angular radius.
    mirrored = 2.0 * ci * cr - (view[0] * light[0] + view[1] * light[1] + view[2] * light[2])
    if setup.lamp_cosine < 1.0 and mirrored >= setup.lamp_cosine:
        image = sample.mirror / (1.0 - setup.lamp_cosine**2)
    for band in range(out.size):
        if sample.model[material] == MEASURED:
            rough = ci * measured_lobe(sample.measured[sample.table[material]], cos_phi, cos_h, band)
        else:
            rough = sample.diffuse[material, band] * ci + lobe * _lookup(sample.fresnel, cos_h, band)
        out[band] = rough + image * _lookup(sample.fresnel, ci, band)


class _Setup(NamedTuple):
    """One pose of the virtual rig for the compiled loop."""

    intersect: int
    occluded: int
    scene: int
    camera_mm: np.ndarray  # (3,)
    world_from_camera: np.ndarray  # (3, 3)
    focal_px: float
    centre_px: np.ndarray  # (2,)
    ideal_from_seen: np.ndarray  # (2, 3) in mosaic coordinates
    to_light: np.ndarray  # (3,)
    rotation: np.ndarray  # (3, 3) rig_from_object
    lamp_cosine: float
    reach_mm: float  # of the sample from the origin


class _Subject(NamedTuple):
    """The sample for the compiled loop."""

    kind: int
    size_mm: np.ndarray  # (2,)
    checks: np.ndarray  # (2,) columns, rows
    diffuse: np.ndarray  # (materials, 3) band responses of S(λ)
    model: np.ndarray  # (materials,) PAPER, GGX or MEASURED
    beta: np.ndarray  # (materials,)
    mu: np.ndarray  # (materials,)
    table: np.ndarray  # (materials,) index into `measured`
    measured: np.ndarray  # (tables, half nodes, difference nodes, 3) π times the BRDF
    mirror: float
    fresnel: np.ndarray  # (nodes, 3)


@numba.njit(cache=True, inline="always")
def _aim(setup, x, y, direction):
    """Fill the direction in which the camera sees a point of the mosaic."""
    m = setup.ideal_from_seen
    x, y = m[0, 0] * x + m[0, 1] * y + m[0, 2], m[1, 0] * x + m[1, 1] * y + m[1, 2]
    px, py = (x - setup.centre_px[0]) / setup.focal_px, (y - setup.centre_px[1]) / setup.focal_px
    scale = 1.0 / math.sqrt(px * px + py * py + 1.0)
    axes = setup.world_from_camera
    for a in range(3):
        direction[a] = (axes[a, 0] * px + axes[a, 1] * py + axes[a, 2]) * scale


@numba.njit(cache=True, inline="always")
def _may_hit(setup, direction):
    """Whether a ray from the camera meets the sphere about the sample; most of a picture does not."""
    eye = setup.camera_mm
    along = eye[0] * direction[0] + eye[1] * direction[1] + eye[2] * direction[2]
    return eye[0] ** 2 + eye[1] ** 2 + eye[2] ** 2 - along**2 <= setup.reach_mm**2


@numba.njit(cache=True, inline="always")
def _is_seen(setup, sample, ray, direction, world, normal, view):
    """Whether a ray from the camera sees the front of the sample; fills its point, its normal and the way back."""
    trace(setup.intersect, setup.scene, ray, setup.camera_mm, direction, np.inf)
    seen = hit_shape(ray) == 0
    if seen:
        for a in range(3):
            world[a] = setup.camera_mm[a] + hit_distance(ray) * direction[a]
            view[a] = -direction[a]
        _u, _v, _w, normal[0], normal[1], normal[2] = _surface(sample.kind, setup.rotation, world)
        seen = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2] > 0.0
    return seen


@numba.njit(cache=True, inline="always")
def _is_lit(setup, ray, origin, world, normal):
    """Whether nothing stands between a point and the light."""
    for a in range(3):
        origin[a] = world[a] + _OFFSET_MM * normal[a]
    trace(setup.occluded, setup.scene, ray, origin, setup.to_light, np.inf)
    return not is_blocked(ray)


@numba.njit(cache=True, inline="always")
def _material_at(setup, sample, world):
    """Return the material of a point of the surface."""
    x, y, z, _nx, _ny, _nz = _surface(sample.kind, setup.rotation, world)
    u, v = uv_from_point(sample.kind, sample.size_mm[0], sample.size_mm[1], x, y, z)
    column = min(max(int(u * sample.checks[0]), 0), sample.checks[0] - 1)
    row = min(max(int(v * sample.checks[1]), 0), sample.checks[1] - 1)
    return (row * sample.checks[0] + column) % sample.beta.size


@numba.njit(cache=True, error_model="numpy")
def _expose_block(setup, sample, block, image):
    """Fill a block of rows: look at points half a pixel apart, then let each pixel gather its own."""
    first = block * _BLOCK_ROWS
    rows = min(_BLOCK_ROWS, image.shape[0] - first)
    points = np.empty((2 * rows + 3, 2 * image.shape[1] + 3, 3))
    ray = new_ray()
    direction, origin = np.empty(3), np.empty(3)
    world, normal, view = np.empty(3), np.empty(3), np.empty(3)
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            _aim(setup, 0.5 * (j - 1), first + 0.5 * (i - 1), direction)
            out = points[i, j]
            out[:] = 0.0
            if _may_hit(setup, direction) and _is_seen(setup, sample, ray, direction, world, normal, view):
                light = setup.to_light
                ci = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
                if ci > 0.0 and _is_lit(setup, ray, origin, world, normal):
                    _response(out, sample, _material_at(setup, sample, world), setup, normal, view, ci)
    gather_rows(points, first, image)


@numba.njit(cache=True, parallel=True, nogil=True)
def _expose(setup, sample, image):
    for block in numba.prange((image.shape[0] + _BLOCK_ROWS - 1) // _BLOCK_ROWS):
        _expose_block(setup, sample, block, image)


@numba.njit(cache=True)
def gather_rows(points, first, image):
    """Fill rows of an RGGB mosaic from what is seen at points half a pixel apart.

    A pixel gathers light over its whole area, and the optical low-pass filter before the sensor splits every point in
    four, one pixel apart: along each axis the weights are 1, 2, 2, 2, 1 over two pixels.

    Parameters
    ----------
    points : (2 rows + 3, 2 width + 3, 3) float
        Responses in red, green and blue; the first point is half a pixel outside the first pixel of the first row.
    first : int
        First row to fill, even.
    image : (height, width) float64
    """
    for y in range((points.shape[0] - 3) // 2):
        for x in range(image.shape[1]):
            band, total = y % 2 + x % 2, 0.0
            for i in range(5):
                line = 0.0
                for j in range(5):
                    line += (2.0 if 0 < j < 4 else 1.0) * points[2 * y + i, 2 * x + j, band]
                total += (2.0 if 0 < i < 4 else 1.0) * line
            image[first + y, x] = total / 64.0


@dataclass(frozen=True)
class View:
    """From where, through what and under which light the sample is seen.

    Parameters
    ----------
    pinhole : Pinhole
    rotation : (3, 3) float, rig_from_object
    position_mm : (3,) float
        Centre of projection in the rig's frame.
    world_from_camera : (3, 3) float
    to_light : (3,) float, unit vector
    lamp_radius_rad : float
        Angular radius of the lamp, for its mirror image.
    ideal_from_seen : (2, 3) float
        Affine map of mosaic coordinates: where a picture without the filter's plate shows what is seen.
    """

    pinhole: Pinhole
    rotation: np.ndarray
    position_mm: np.ndarray
    world_from_camera: np.ndarray
    to_light: np.ndarray
    lamp_radius_rad: float
    ideal_from_seen: np.ndarray


def expose_object(sample, tracer: Tracer, view: View, band_weights: np.ndarray) -> np.ndarray:
    """Return what each mosaic pixel receives from the sample under the rig's light.

    Parameters
    ----------
    sample : irodori.rig.virtual.samples.Sample
    tracer : Tracer
        Shape 0 is the sample, the others only cast shadows.
    view : View
    band_weights : (3, 61) float
        Those of the photograph's filter state, see `irodori.rig.virtual.sensor.band_weights`.

    Returns
    -------
    (height, width) float64, responses
    """
    setup = _Setup(
        intersect=tracer.intersect_address,
        occluded=tracer.occluded_address,
        scene=tracer.scene,
        camera_mm=np.asarray(view.position_mm, dtype=np.float64),
        world_from_camera=np.ascontiguousarray(view.world_from_camera),
        focal_px=float(view.pinhole.focal_px),
        centre_px=np.asarray(view.pinhole.centre_px, dtype=np.float64),
        ideal_from_seen=np.ascontiguousarray(view.ideal_from_seen, dtype=np.float64),
        to_light=np.asarray(view.to_light, dtype=np.float64),
        rotation=np.ascontiguousarray(view.rotation),
        lamp_cosine=math.cos(view.lamp_radius_rad),
        reach_mm=1.001 * sample.shape.reach_mm,
    )
    subject = _Subject(
        kind=sample.shape.kind,
        size_mm=np.asarray(sample.shape.size_mm, dtype=np.float64),
        checks=np.array([sample.columns, sample.rows]),
        diffuse=np.ascontiguousarray(sample.reflectance @ band_weights.T),
        model=sample.model,
        beta=sample.beta,
        mu=sample.mu_rad,
        table=sample.table,
        measured=np.ascontiguousarray(sample.measured @ band_weights.T),
        mirror=sample.mirror,
        fresnel=sample.fresnel @ band_weights.T,
    )
    image = np.empty((view.pinhole.height_px, view.pinhole.width_px))
    _expose(setup, subject, image)
    return image
