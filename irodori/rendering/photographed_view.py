"""Radiance before a camera in a scene, by path tracing in two independent halves that show its noise."""

from collections.abc import Sequence

import numpy as np

from irodori.config.models import ObjectShape, Optics, ReferenceIntegrator, Scene, ScenePhotograph
from irodori.config.parts import Staging
from irodori.core import store
from irodori.geometry.ideal_camera import IdealView
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.coefficients import write_coefficients
from irodori.material.material_file import Material
from irodori.rendering.integrators import render_image
from irodori.spectra.coordinates import write_wavelength

#: Mosaic pixels around the sensor that are rendered too: a filter's plate shifts what falls on it.
MARGIN_PX = 16
HALVES = 2


def render_halves(
    scene: Staging,
    placed: ScenePhotograph,
    ideal: IdealView,
    shapes: list[Shape],
    materials: list[Material],
    environment: Environment,
    *,
    samples: int,
    seed: int,
) -> np.ndarray:
    """Return a scene as seen by a camera in it, twice, by the integrator `reference` with other random numbers.

    Parameters
    ----------
    scene : Staging
    placed : ScenePhotograph
        Where the camera stands.
    ideal : IdealView
    shapes, materials : one an object of the scene
    environment : Environment
    samples : int
        Paths a pixel of both halves together, a multiple of 16.
    seed : int
        Of the first half; the second has the next.

    Returns
    -------
    (2, height, width, 61) float32
    """
    halves = []
    for half in range(HALVES):
        seen = Scene(
            environment="photographed",
            image=ideal.image,
            # Filtered, the halves would have a bias in common, which their difference does not show.
            integrator=ReferenceIntegrator(samples=samples // HALVES, seed=seed + half, denoise=False),
            views={"photograph": ideal.view(placed)},
            objects=scene.objects,
            bodies=scene.bodies,
            lights=scene.lights,
            display=scene.display,
        )
        radiance, _ = render_image(seen, "photograph", shapes, materials, environment)
        halves.append(radiance)
    return np.stack(halves)


def render_photographed(
    scene: Staging,
    placed: ScenePhotograph,
    optics: Optics,
    shapes: Sequence[ObjectShape],
    material_files: list,
    environment_file,
    *,
    output,
    provenance: store.Provenance,
) -> None:
    """Render what stands before a virtual camera in a scene, a pixel a superpixel of the camera.

    Parameters
    ----------
    scene : Staging
    placed : ScenePhotograph
    optics : Optics
        Of the camera.
    shapes : sequence of ObjectShape
    material_files, environment_file : path
        What really stands there, and the light that really falls.
    output : path
        ``/radiance`` (2, rows, columns, 61), half precision with its scale: two halves of the paths.
    """
    radiance = render_halves(
        scene,
        placed,
        IdealView.covering(Pinhole.from_optics(optics), 1, MARGIN_PX),
        [Shape.from_definition(shape) for shape in shapes],
        [Material.load(path) for path in material_files],
        Environment.load(environment_file),
        samples=placed.samples,
        seed=placed.seed,
    )
    with store.create(output, provenance) as out:
        write_wavelength(out)
        write_coefficients(
            out,
            "radiance",
            radiance,
            quantity="radiance before the camera",
            storage="half",
            codec="lzf",
            dims="half,row,column,wavelength",
        )
