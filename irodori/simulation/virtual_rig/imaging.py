"""Responses of the virtual camera's pixels to a sample under a far or near light, with shadows."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from irodori.geometry.distortion import undistort
from irodori.geometry.embree import Tracer, hit_distance, hit_shape, is_blocked, new_ray, trace
from irodori.geometry.lamp import Lamp
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.surfaces import Surfaces, face_viewer, make_surfaces, surface_at
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.simulation.virtual_rig.aperture import gather_rows, place_in_cell
from irodori.simulation.virtual_rig.sample_reflection import (
    GlossComponents,
    gloss_components,
    gloss_term,
    measured_lobe,
)

_BLOCK_ROWS = 16


@njit(cache=True, forceinline=True)
def _lookup(table, cosine, band):
    position = min(max(cosine, 0.0), 1.0) * (table.shape[0] - 1)
    node = min(int(position), table.shape[0] - 2)
    part = position - node
    return (1.0 - part) * table[node, band] + part * table[node + 1, band]


@njit(cache=True, forceinline=True, error_model="numpy")
def _response(out, sample, material, setup, point, ci):
    """Compute the responses of one point in three bands, lit at cosine of incidence `ci` and seen from its front."""
    normal, view, light, power = point.normal, point.back, point.light, point.lamp[0]
    cr = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    hx, hy, hz = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    cos_phi = min((hx * normal[0] + hy * normal[1] + hz * normal[2]) / length, 1.0)
    cos_h = length / 2.0
    lobe, image = 0.0, 0.0
    if sample.table[material] < 0:
        lobe = gloss_term(sample.gloss, material, ci, cr, cos_phi, cos_h)
    # The lamp is a disc: its mirror image is seen if the reflected view lies within its angular radius. The squared
    # sine of the radius is proportional to the irradiance; the radiance of the lamp is the same from everywhere.
    mirrored = 2.0 * ci * cr - (view[0] * light[0] + view[1] * light[1] + view[2] * light[2])
    width = (1.0 - setup.lamp_cosine**2) * power
    if setup.lamp_cosine < 1.0 and mirrored >= math.sqrt(max(1.0 - width, 0.0)):
        image = sample.mirror / width
    for band in range(out.size):
        if sample.table[material] >= 0:
            rough = ci * measured_lobe(sample.measured[sample.table[material]], cos_phi, cos_h, band)
        else:
            ground = sample.diffuse[material, band] * ci
            if sample.is_coupled:
                through = (1.0 - _lookup(sample.fresnel, ci, band)) * (1.0 - _lookup(sample.fresnel, cr, band))
                ground *= through / (1.0 - _lookup(sample.fresnel, 1.0, band)) ** 2
            rough = ground + lobe * _lookup(sample.fresnel, cos_h, band)
        out[band] = power * (rough + image * _lookup(sample.fresnel, ci, band))


class _Setup(NamedTuple):
    """Scene, camera and light at one pose of the virtual rig, for the compiled loop."""

    intersect: int
    occluded: int
    scene: int
    camera_mm: np.ndarray  # (3,)
    world_from_camera: np.ndarray  # (3, 3)
    focal_px: float
    centre_px: np.ndarray  # (2,)
    distortion: np.ndarray  # (8,)
    fold: float
    is_distorted: bool
    ideal_from_seen: np.ndarray  # (2, 3) in mosaic coordinates
    to_light: np.ndarray  # (3,)
    light_distance_mm: float  # from the origin; infinite for a far light
    lamp_cosine: float  # of its angular radius seen from the origin
    reach_mm: float  # of the sample from the origin
    offset_mm: float  # above the surface, at which shadow rays leave
    is_open: bool  # whether nothing can stand between a point that faces the lamp and the lamp


class _Point(NamedTuple):
    """Buffers of one thread for the point that a ray hits; all vectors are (3,)."""

    direction: np.ndarray  # from the camera
    world: np.ndarray
    normal: np.ndarray
    facet: np.ndarray
    back: np.ndarray  # to the camera
    light: np.ndarray  # to the lamp
    uv: np.ndarray  # (2,)
    lamp: np.ndarray  # (2,) irradiance normal to the beam, 1 at the origin; distance in mm
    origin: np.ndarray  # of the shadow ray


@njit(cache=True)
def _new_point():
    return _Point(
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(2),
        np.empty(2),
        np.empty(3),
    )


class _Subject(NamedTuple):
    """Sample on the rig, with its spectra turned into band responses, for the compiled loop."""

    checks: np.ndarray  # (2,) columns, rows
    diffuse: np.ndarray  # (materials, 3) band responses of S(λ)
    gloss: GlossComponents
    table: np.ndarray  # (materials,) index into `measured`, -1 of materials that are not measured
    measured: np.ndarray  # (tables, half nodes, difference nodes, 3) π times the BRDF
    mirror: float
    fresnel: np.ndarray  # (nodes, 3)
    surfaces: Surfaces
    through: np.ndarray  # (materials, 3) band responses of the transmittance
    is_sheet: bool
    is_coupled: bool


class _Row(NamedTuple):
    """Buffers of one thread for a row of quarter pixels."""

    x: np.ndarray  # (width,) intersection of the rays with the plane at depth 1 of the camera's frame
    y: np.ndarray  # (width,)
    is_near: np.ndarray  # (width,) whether the ray hits the bounding sphere of the sample


@uncounted(error_model="numpy")
def _aim_row(setup, number, row):
    """Compute the rays of a row of quarter pixels, and which of them may hit the sample, as most do not.

    The loops have no branches, so that the compiler can use vector instructions.
    """
    m, (cx, cy), focal = setup.ideal_from_seen, (setup.centre_px[0], setup.centre_px[1]), setup.focal_px
    for j in range(row.x.size):
        x, y = place_in_cell(number, j - 1)
        row.x[j] = (m[0, 0] * x + m[0, 1] * y + m[0, 2] - cx) / focal
        row.y[j] = (m[1, 0] * x + m[1, 1] * y + m[1, 2] - cy) / focal
    if setup.is_distorted:
        for j in range(row.x.size):
            row.x[j], row.y[j] = undistort(setup.distortion, setup.fold, row.x[j], row.y[j])
    eye, axes = setup.camera_mm, setup.world_from_camera
    ex = eye[0] * axes[0, 0] + eye[1] * axes[1, 0] + eye[2] * axes[2, 0]
    ey = eye[0] * axes[0, 1] + eye[1] * axes[1, 1] + eye[2] * axes[2, 1]
    ez = eye[0] * axes[0, 2] + eye[1] * axes[1, 2] + eye[2] * axes[2, 2]
    outside = eye[0] ** 2 + eye[1] ** 2 + eye[2] ** 2 - setup.reach_mm**2
    for j in range(row.x.size):
        x, y = row.x[j], row.y[j]
        along = ex * x + ey * y + ez
        row.is_near[j] = outside * (x * x + y * y + 1.0) <= along * along


@njit(cache=True, forceinline=True)
def _turn(setup, x, y, direction):
    """Compute the unit direction of a ray through point (x, y) of the plane at depth 1 of the camera's frame."""
    scale = 1.0 / math.sqrt(x * x + y * y + 1.0)
    axes = setup.world_from_camera
    for a in range(3):
        direction[a] = (axes[a, 0] * x + axes[a, 1] * y + axes[a, 2]) * scale


@njit(cache=True, forceinline=True)
def _is_seen(setup, surfaces, ray, point):
    """Trace a ray from the camera and return whether it hits the front of the sample; fill the buffers of the point."""
    trace(setup.intersect, setup.scene, ray, setup.camera_mm, point.direction, np.inf)
    if hit_shape(ray) != 0:
        return False
    for a in range(3):
        point.world[a] = setup.camera_mm[a] + hit_distance(ray) * point.direction[a]
        point.back[a] = -point.direction[a]
    point.uv[0], point.uv[1] = surface_at(surfaces, 0, ray, point.world, point.normal, point.facet)
    return face_viewer(point.normal, point.facet, point.direction) > 0.0


@njit(cache=True, forceinline=True)
def _face_lamp(setup, point):
    """Compute direction to the lamp and its irradiance at a point; return the cosine of incidence, at most 0 behind."""
    if math.isinf(setup.light_distance_mm):
        for a in range(3):
            point.light[a] = setup.to_light[a]
        point.lamp[0], point.lamp[1] = 1.0, np.inf
    else:
        total = 0.0
        for a in range(3):
            point.light[a] = setup.light_distance_mm * setup.to_light[a] - point.world[a]
            total += point.light[a] ** 2
        distance = math.sqrt(total)
        for a in range(3):
            point.light[a] /= distance
        point.lamp[0], point.lamp[1] = setup.light_distance_mm**2 / total, distance
    cosine, front = 0.0, 0.0
    for a in range(3):
        cosine += point.normal[a] * point.light[a]
        front += point.facet[a] * point.light[a]
    return cosine if front > 0.0 else min(cosine, 0.0)


@njit(cache=True, forceinline=True)
def _is_lit(setup, ray, point, side):
    """Return whether nothing blocks the light at a point; ``side`` is -1 for the other side of a sheet."""
    for a in range(3):
        point.origin[a] = point.world[a] + side * setup.offset_mm * point.facet[a]
    trace(setup.occluded, setup.scene, ray, point.origin, point.light, point.lamp[1])
    return not is_blocked(ray)


@njit(cache=True, forceinline=True)
def _material_at(sample, point):
    """Return the index of the material at a point of the surface."""
    column = min(max(int(point.uv[0] * sample.checks[0]), 0), sample.checks[0] - 1)
    row = min(max(int(point.uv[1] * sample.checks[1]), 0), sample.checks[1] - 1)
    return (row * sample.checks[0] + column) % sample.diffuse.shape[0]


@njit(cache=True, nogil=True)
def _expose(setup, sample, image, first, last):
    """Compute a block of rows of the mosaic: trace a ray for each quarter pixel, then average them into pixels."""
    width = 2 * image.shape[1] + 2
    points = np.zeros((2 * (last - first) + 2, width, 3))
    row = _Row(np.empty(width), np.empty(width), np.empty(width, np.bool_))
    _look(setup, sample, new_ray(), _new_point(), points, (row, first))
    gather_rows(points, first, image)


@uncounted(error_model="numpy")
def _look(setup, sample, ray, point, points, rows):
    """Compute the responses of quarter pixels, beginning half a pixel before the row ``first``."""
    row, first = rows
    for i in range(points.shape[0]):
        _aim_row(setup, 2 * first + i - 1, row)
        for j in range(points.shape[1]):
            if not row.is_near[j]:
                continue
            _turn(setup, row.x[j], row.y[j], point.direction)
            if _is_seen(setup, sample.surfaces, ray, point):
                ci = _face_lamp(setup, point)
                if ci > 0.0 and (setup.is_open or _is_lit(setup, ray, point, 1.0)):
                    _response(points[i, j], sample, _material_at(sample, point), setup, point, ci)
                elif ci < 0.0 and sample.is_sheet and _is_lit(setup, ray, point, -1.0):
                    for band in range(3):
                        through = sample.through[_material_at(sample, point), band]
                        points[i, j, band] = -ci * point.lamp[0] * through


@dataclass(frozen=True)
class RigView:
    """Camera, light and filter plate for a view of the sample.

    Parameters
    ----------
    pinhole : Pinhole
    position_mm : (3,) float
        Centre of projection in the rig's frame.
    world_from_camera : (3, 3) float
    to_light : (3,) float, unit vector from the origin
    lamp : Lamp
    lamp_radius_rad : float
        Angular radius of the lamp seen from the origin, for its mirror image.
    ideal_from_seen : (2, 3) float
        Affine map of mosaic coordinates from a picture through the filter plate to a picture without it.
    """

    pinhole: Pinhole
    position_mm: np.ndarray
    world_from_camera: np.ndarray
    to_light: np.ndarray
    lamp: Lamp
    lamp_radius_rad: float
    ideal_from_seen: np.ndarray


def _is_open(placements, to_light: np.ndarray, lamp: Lamp) -> bool:
    """Return whether every point of the first shape that faces the lamp is certainly lit, without shadow rays.

    A convex shape does not shade itself, and a table under it shades nothing if the lamp is above its plane.
    """
    shape, table = placements[0].shape, placements[1:]
    normals = [top.rotation[:, 2] for top in table]
    if not shape.is_convex or not all(top.shape.is_flat for top in table):
        return False
    if not lamp.is_near:
        return all(float(normal @ to_light) >= 0.0 for normal in normals)
    place = lamp.distance_mm * to_light
    return all(float(normal @ (place - top.translation_mm)) >= 0.0 for normal, top in zip(normals, table, strict=True))


def expose_object(sample, tracer: Tracer, view: RigView, band_weights: np.ndarray) -> np.ndarray:
    """Return the response of each mosaic pixel to the sample under the rig's light.

    Parameters
    ----------
    sample : irodori.simulation.virtual_rig.samples.Sample
    tracer : Tracer
        Shape 0 is the sample; the others only cast shadows. The sample must stand above the plane of each flat shape.
    view : RigView
    band_weights : (3, 61) float
        Weights of the photograph's filter state, see `irodori.simulation.virtual_rig.sensor.band_weights`.

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
        distortion=np.array(view.pinhole.distortion),
        fold=float(view.pinhole.fold),
        is_distorted=view.pinhole.is_distorted,
        ideal_from_seen=np.ascontiguousarray(view.ideal_from_seen, dtype=np.float64),
        to_light=np.asarray(view.to_light, dtype=np.float64),
        light_distance_mm=float(view.lamp.distance_mm),
        lamp_cosine=math.cos(view.lamp_radius_rad),
        reach_mm=1.001 * sample.shape.reach_mm + float(np.linalg.norm(tracer.placements[0].translation_mm)),
        offset_mm=sample.shape.ray_offset_mm,
        is_open=_is_open(tracer.placements, np.asarray(view.to_light), view.lamp),
    )
    subject = _Subject(
        checks=np.array([sample.columns, sample.rows]),
        diffuse=np.ascontiguousarray(sample.reflectance @ band_weights.T),
        gloss=gloss_components(sample.lobes, sample.beta, sample.mu),
        table=sample.table,
        measured=np.ascontiguousarray(sample.measured @ band_weights.T),
        mirror=sample.mirror,
        fresnel=sample.fresnel @ band_weights.T,
        surfaces=make_surfaces(list(tracer.placements[:1])),
        through=np.ascontiguousarray(sample.through @ band_weights.T),
        is_sheet=bool(sample.through.any()),
        is_coupled=sample.is_coupled,
    )
    image = np.empty((view.pinhole.height_px, view.pinhole.width_px))
    run_chunks(_expose, len(image), _BLOCK_ROWS, setup, subject, image)
    return image
