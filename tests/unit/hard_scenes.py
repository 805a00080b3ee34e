"""Scenes in which everything that is hard for a renderer comes at once, for the tests of both integrators."""

import dataclasses

import numpy as np
from hypothesis import strategies as st
from path_scenes import ball
from scenes import constant_light, material, plate

BETAS = {"none": lambda mu: 0.0, "all": lambda mu: 1 / (4 * mu**2)}
SCENES = {
    "scale": st.sampled_from([1e-2, 1.0, 1e5]),  # of a scene of 100 mm: 1 mm to 10 km
    "mu": st.sampled_from([0.005, 0.1, 1.2]),
    "beta": st.sampled_from(list(BETAS)),
    "index": st.sampled_from([(1.5, 0.0), (1.0, 0.0), (0.05, 9.0), (1.2, 40.0)]),
    "mirror": st.sampled_from([0.0, 1.0]),
    "white": st.sampled_from([0.0, 1.0]),
    "elevation_deg": st.sampled_from([1e-3, 0.5, 20.0, 89.99]),
    "sun": st.sampled_from(["none", "zenith", "horizon"]),
}


def hard_scene(*, scale, mu, beta, index, mirror, white, elevation_deg, sun):
    """Two touching spheres that touch their plate, seen at an angle: shapes, materials, light, view."""
    n, k = index
    share = 1.0 - mirror
    stuff = material(white * share * (beta == "none"), beta=share * BETAS[beta](mu), mu=mu, mirror=mirror, n=n, k=k)
    light = constant_light(np.linspace(0.5, 1.0, 61))
    if sun != "none":
        coefficients = light.coefficients.copy()
        coefficients[(0, 0) if sun == "zenith" else (15, 48)] = 1e6
        light = dataclasses.replace(light, coefficients=coefficients)
    angle = np.radians(elevation_deg)
    away = np.array([0.0, -200.0 * np.cos(angle), 200.0 * np.sin(angle) + 1e-3])
    places = [(0.0, 0.0, 0.0), (-20.0 * scale, 0.0, 20.0 * scale), (20.0 * scale, 0.0, 20.0 * scale)]
    shapes = [plate(200.0 * scale), ball(20.0 * scale), ball(20.0 * scale)]
    return shapes, [stuff] * 3, light, {"places": places, "position": tuple(scale * away), "fov": 30}


def brightest_of(scene: dict) -> float:
    """Largest radiance of a scene's light."""
    return 1.0 if scene["sun"] == "none" else 1e6
