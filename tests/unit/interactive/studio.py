"""Small scenes for the interactive integrator, and what a plain loop says of them."""

import numpy as np
from made import made
from scenes import fresnel, gloss_maps, pixel_rays
from shortcuts import irradiance_map

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import Size, View
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.sphere import Sphere
from irodori.light.environment_file import Environment, directions
from irodori.rendering.interactive.frame_renderer import light_of, prepare_scene, render_frame
from irodori.rendering.scene_arrays import make_objects, make_view

REPRESENTATIONS = ("spectral", "coefficients", "quadrature", "rgb")
BANDS = np.arange(61)
#: Three unlike lights: daylight that falls, a lamp of three lines, a band about 550 nm.
LINES = sum(a * np.exp(-(((BANDS - c) / 1.5) ** 2)) for a, c in ((4.0, 8), (5.0, 29), (5.0, 43)))
BASIS = np.stack([np.linspace(1.3, 0.7, 61), 0.1 + LINES, np.exp(-(((BANDS - 30) / 12.0) ** 2))], axis=1)


def even_light(weights=(1.0, 0.5, 0.3), height=32) -> Environment:
    """Light of one spectrum from everywhere, on `BASIS`."""
    coefficients = np.broadcast_to(np.float32(weights), (height, 2 * height, 3)).copy()
    return Environment(coefficients, BASIS, np.pi * coefficients)


def spectrum_of(weights=(1.0, 0.5, 0.3)) -> np.ndarray:
    return BASIS @ np.asarray(weights)


def placed(shapes, places=None, rotations=None, scale=1.0):
    places = places or [(0.0, 0.0, 0.0)] * len(shapes)
    rotations = rotations or [np.eye(3)] * len(shapes)
    rows = zip(shapes, rotations, places, strict=True)
    return [Placement(s, r, scale * np.asarray(p, dtype=np.float64), scale) for s, r, p in rows]


def prepared(shapes, materials, light, representation="coefficients", *, places=None, rotations=None, scale=1.0,
             white=None, **options):  # fmt: skip
    placements = placed(shapes, places, rotations, scale)
    objects, _ = make_objects(placements, materials)
    white = light.upward_white() if white is None else white
    maps = gloss_maps(light)
    return prepare_scene(objects, light_of(light), maps, Tracer(placements), representation, white, **options)


def view_of(position=(0.0, -200.0, 0.0), target=(0.0, 0.0, 0.0), size=(41, 41), fov=13.0, scale=1.0):
    seen = {"position_mm": scale * np.asarray(position), "target_mm": scale * np.asarray(target),
            "up": [0.0, 0.0, 1.0], "field_of_view_deg": fov}  # fmt: skip
    return make_view(made(View, seen), made(Size, {"width": size[0], "height": size[1]}))


def picture(shapes, materials, light, representation="coefficients", view=None, frame=None, **scene):
    """XYZ, or the bands of ``spectral``."""
    ready = prepared(shapes, materials, light, representation, **scene)
    seen = view_of(**(view or {}))
    return render_frame(ready, seen, bands=representation == "spectral", **(frame or {}))


def plain_radiance(placements, materials, environment, irradiance, ray, bounces):
    """Radiance along a ray, (61,): the rendering equation of the integrator term by term, in double precision.

    ``environment`` and ``irradiance`` give spectra for a direction and for a normal; materials have one texel. A ray is
    its origin and its direction.
    """
    hit, (origin, direction) = None, ray
    for placement, material in zip(placements, materials, strict=True):
        centre, size = placement.translation_mm, np.asarray(placement.shape.size_mm) * placement.scale
        local = origin - centre
        if isinstance(placement.shape, Sphere):
            along = direction @ local
            root = along**2 - local @ local + size[0] ** 2
            distance = -along - np.sqrt(root) if root >= 0 else -1.0
            normal = (local + distance * direction) / size[0]
        else:
            assert placement.shape.is_flat
            normal = placement.rotation[:, 2]
            distance = -(local @ normal) / (direction @ normal)
            across = (local + distance * direction) @ placement.rotation
            if (np.abs(across[:2]) > size / 2).any():
                distance = -1.0
        if distance > 1e-6 and (hit is None or distance < hit[0]):
            hit = distance, normal, material
    if hit is None:
        return environment(direction)
    distance, normal, material = hit
    cosine = -direction @ normal
    if cosine <= 0:
        return np.zeros(61)
    surface = material.basis @ (material.coefficients[0, 0] * material.alpha[0, 0] / material.green_response[0, 0])
    out = surface * irradiance(normal) / np.pi
    if bounces and material.mirror > 0:
        reflected = direction + 2 * cosine * normal
        point = origin + distance * direction + 1e-9 * distance * normal
        passed = material.mirror * fresnel(cosine, material.n, material.k)
        out = out + passed * plain_radiance(
            placements, materials, environment, irradiance, (point, reflected), bounces - 1
        )
    return out


def plain_picture(placements, materials, environment, irradiance, bounces, *, position, target, size, fov):
    rays = pixel_rays(position, target, size, fov)
    origin = np.asarray(position, dtype=np.float64)
    return np.array([[plain_radiance(placements, materials, environment, irradiance, (origin, ray), bounces)
                      for ray in row] for row in rays])  # fmt: skip


def sky_of(function, height=128) -> Environment:
    """Light with one number a direction, on the first vector of `BASIS`."""
    values = function(directions(2 * height, height)[0])
    coefficients = np.stack([values, 0 * values, 0 * values], axis=-1).astype(np.float32)
    return Environment(coefficients, BASIS, irradiance_map(coefficients, 128, 64))


def levels(image, light):
    """The coefficient on the first vector that Y shows."""
    white = light.upward_white()
    return image[..., 1] / (xyz_from_radiance(white)[1] @ BASIS[:, 0])
