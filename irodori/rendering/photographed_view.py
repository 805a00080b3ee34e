"""Path-traced radiance in front of a camera in a scene, in two independent halves whose difference shows the noise."""

import math
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
from irodori.rendering.integrators import render_image, with_backs
from irodori.spectra.coordinates import write_wavelength

#: Width of the rendered margin around the sensor, mosaic pixels, because a filter plate shifts the picture.
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
    """Render a scene as seen by a camera twice with the integrator `reference`, with independent random numbers.

    Parameters
    ----------
    scene : Staging
    placed : ScenePhotograph
        Pose of the camera.
    ideal : IdealView
    shapes, materials : sequence
        One of each for every object of the scene.
    environment : Environment
    samples : int
        Paths per pixel in both halves together, a multiple of 16.
    seed : int
        Seed of the first half; the second uses ``seed + 1``.

    Returns
    -------
    (2, height, width, 61) float32
    """
    halves = []
    for half in range(HALVES):
        seen = Scene(
            environment="photographed",
            image=ideal.image,
            integrator=ReferenceIntegrator(
                samples=samples // HALVES,
                seed=seed + half,
                # It would give both halves the same bias, which their difference does not show.
                denoise=False,
                # Their difference states the noise, wherever it is large.
                max_relative_standard_error=math.inf,
            ),
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
    """Render the true radiance in front of a virtual camera in a scene, one pixel for each superpixel, into a file.

    Parameters
    ----------
    scene : Staging
    placed : ScenePhotograph
    optics : Optics
        Optics of the camera.
    shapes : sequence of ObjectShape
    material_files, environment_file : path
        True materials of the objects, and true light.
    output : path
        ``/radiance`` (2, rows, columns, 61), half precision with its scale: the two halves of the paths.
    """
    radiance = render_halves(
        scene,
        placed,
        IdealView.covering(Pinhole.from_optics(optics), 1, MARGIN_PX),
        [Shape.from_definition(shape) for shape in shapes],
        with_backs(scene, [Material.load(path) for path in material_files]),
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
