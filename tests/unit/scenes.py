"""Small scenes and what geometry says of them, for the tests of rendering."""

import functools
from pathlib import Path

import numpy as np
from made import made
from shortcuts import irradiance_map

from irodori.config.models import (
    BodyShape,
    ObjectShape,
    Render,
    Scene,
)
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment, directions
from irodori.light.gloss_maps import GlossMaps
from irodori.material.material_file import Material
from irodori.rendering.integrators import render_image

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
OPTIONS = Render(pixel_side=1, min_throughput=1e-9)
ONES = np.ones(61)
# Gold at about 650, 550 and 450 nm (Johnson and Christy 1972), in thirds of the grid.
GOLD_N, GOLD_K = (0.16, 0.42, 1.50), (3.80, 2.35, 1.88)
THIRDS = np.minimum(np.arange(61) // 20, 2)


def fresnel(cosine, n, k):
    """Unpolarised reflectance from the amplitudes, complex arithmetic."""
    index = n + 1j * np.asarray(k)
    inside = np.sqrt(1 - (1 - cosine**2) / index**2 + 0j)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (abs(s) ** 2 + abs(p) ** 2)


def material(reflectance=0.0, beta=0.0, mu=0.1, mirror=0.0, n=1.5, k=0.0) -> Material:
    """A uniform material; ``reflectance`` is a number or a spectrum (61,)."""
    size = (4, 8)
    spectrum = np.broadcast_to(np.asarray(reflectance, dtype=np.float64), 61)
    return Material(
        alpha=np.full(size, 0.5), beta=np.full(size, float(beta)), mu=np.full(size, float(mu)),
        green_response=np.full(size, 0.5), coefficients=np.ones((*size, 1), np.float32), basis=spectrum[:, None].copy(),
        n=np.broadcast_to(np.asarray(n, float), 61).copy(), k=np.broadcast_to(np.asarray(k, float), 61).copy(),
        mirror=mirror, typical_gloss=(1.0, 0.1),
    )  # fmt: skip


def constant_light(radiance=1.0) -> Environment:
    """Light of one radiance from everywhere; its irradiance is π times that."""
    basis = np.broadcast_to(np.asarray(radiance, dtype=np.float64), 61)[:, None].copy()
    return Environment(np.ones((32, 64, 1), np.float32), basis, np.full((16, 32, 1), np.pi, np.float32))


def sky(function, width=512, height=256, basis=None) -> Environment:
    """Light whose coefficients are a function of the direction, (height, width, 3) -> (height, width, k)."""
    coefficients = function(directions(width, height)[0]).astype(np.float32)
    basis = np.ones((61, 1)) if basis is None else basis
    return Environment(coefficients, basis, irradiance_map(coefficients, 128, 64))


def gloss_maps(light: Environment) -> GlossMaps:
    """Return the gloss maps of a light; those of the last few are remembered, for they take seconds."""
    return _gloss_maps(light.coefficients.tobytes(), light.coefficients.dtype, light.coefficients.shape)


@functools.lru_cache(maxsize=4)
def _gloss_maps(coefficients: bytes, dtype, shape: tuple[int, ...]) -> GlossMaps:
    return GlossMaps.of(np.frombuffer(coefficients, dtype).reshape(shape).copy())


BALL = Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": 20.0}))


def plate(side_mm: float) -> Shape:
    return Shape.from_definition(
        made(
            ObjectShape | BodyShape,
            {"kind": "plate", "width_mm": side_mm, "height_mm": side_mm},
        )
    )


def render(shapes, materials, light, position=(0.0, -200.0, 0.0), target=(0.0, 0.0, 0.0), size=(41, 41), *, fov=13.0,
           places=None, samples=64) -> np.ndarray:  # fmt: skip
    """Radiance of a view by the `reference` integrator, (height, width, 61)."""
    places = places or [(0.0, 0.0, 0.0)] * len(shapes)
    scene = {
        "image": {"width": size[0], "height": size[1]},
        "objects": [
            {"object": f"o{i}", "position_mm": list(p), "rotation_deg": [0.0, 0.0, 0.0], "scale": 1.0}
            for i, p in enumerate(places)
        ],
        "views": {"v": {"position_mm": list(position), "target_mm": list(target), "up": [0.0, 0.0, 1.0],
                        "field_of_view_deg": fov}},
        "integrator": {"kind": "reference", "samples": samples, "seed": 0},
    }  # fmt: skip
    return render_image(made(Scene, scene), "v", shapes, materials, light, made(Render, OPTIONS))[0]


def pixel_rays(position=(0.0, -200.0, 0.0), target=(0.0, 0.0, 0.0), size=(41, 41), fov=13.0):
    """Unit view directions of the pixel centres, (height, width, 3)."""
    forward = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    half = np.tan(np.radians(fov) / 2)
    x = (np.arange(size[0]) + 0.5 - size[0] / 2) / (size[1] / 2) * half
    y = (size[1] / 2 - np.arange(size[1]) - 0.5) / (size[1] / 2) * half
    ray = forward + x[None, :, None] * right + y[:, None, None] * up
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def sphere_hits(radius=20.0, position=(0.0, -200.0, 0.0), **view):
    """Rays, normals at their first meeting with a sphere at the origin (NaN where they miss)."""
    ray = pixel_rays(position, **view)
    along = ray @ np.asarray(position)
    with np.errstate(invalid="ignore"):
        distance = -along - np.sqrt(along**2 - (np.dot(position, position) - radius**2))
    return ray, (np.asarray(position) + distance[..., None] * ray) / radius


def smooth_light(direction):
    x, y, z = np.moveaxis(direction, -1, 0)
    return 1.0 + 0.5 * x - 0.3 * y + 0.6 * z * z + 0.2 * x * z


@functools.cache
def smooth_sky(width: int = 512, height: int = 256) -> Environment:
    """Return `smooth_light` as an environment, made once: it is not to be changed."""
    return sky(lambda direction: smooth_light(direction)[..., None], width, height)


def lobe_integral(normal, view, beta, mu, n, k) -> float:
    """Radiance β/π ∫ L F D G / cosθ_r dω of equation (5), Gauss-Legendre over half vectors."""
    nodes, weights = np.polynomial.legendre.leggauss(160)
    top = min(6 * mu, np.pi / 2)
    phi, dphi = (nodes + 1) / 2 * top, weights * top / 2
    around = (np.arange(256) + 0.5) * 2 * np.pi / 256
    tangent = np.cross(normal, [0.3, 0.9, -0.2])
    tangent /= np.linalg.norm(tangent)
    bitangent = np.cross(normal, tangent)
    phi, around = np.meshgrid(phi, around, indexing="ij")
    ring = np.cos(around)[..., None] * tangent + np.sin(around)[..., None] * bitangent
    half = np.cos(phi)[..., None] * normal + np.sin(phi)[..., None] * ring
    cos_h = half @ view
    light = 2 * cos_h[..., None] * half - view
    cos_i, cos_r = light @ normal, normal @ view
    valid = (cos_h > 1e-6) & (cos_i > 0)
    safe = np.where(valid, cos_h, 1.0)
    geometric = np.minimum(1.0, 2 * np.cos(phi) / safe * np.minimum(cos_r, cos_i))
    value = smooth_light(light) * fresnel(safe, n, k) * np.exp(-((phi / mu) ** 2)) * geometric / cos_r * 4 * safe
    return beta / np.pi * np.sum(np.where(valid, value, 0.0) * np.sin(phi) * dphi[:, None] * 2 * np.pi / 256)
