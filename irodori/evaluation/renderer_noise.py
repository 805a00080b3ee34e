"""Reference pictures for the error budget, with measured and expected noise."""

import numpy as np

from irodori.config.models import ReferenceIntegrator, Scene, Size
from irodori.evaluation.truth_errors import radiance_delta_e
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material
from irodori.rendering.integrators import with_bodies
from irodori.rendering.reference.converging_picture import REPLICATES, make_scene, render_rows
from irodori.rendering.reference.random_numbers import Numbers, make_numbers
from irodori.rendering.reference.sky_sampling import Sky, make_sky
from irodori.rendering.scene_arrays import make_objects, make_placements, make_view

#: How many times the scene's paths the picture has that is taken for converged.
MORE = 4
_PATHS = 1_500_000  # to trace for the noise, unless a single row takes more
_SEEDS = (71, 72, 73, 74)
_LIGHTS_KEPT = 2  # the measured and the true one, mostly


class Paths:
    """A view of a scene by paths; random numbers and lights are made once for all of its pictures.

    Parameters
    ----------
    scene : Scene
    view : str
    shapes : one an object of the scene
    """

    def __init__(self, scene: Scene, view: str, shapes: list[Shape]) -> None:
        self.scene, self._view, self._shapes = scene, view, shapes
        self._numbers: dict[tuple[int, int], Numbers] = {}
        self._skies: list[tuple[Environment, Sky]] = []  # of the last lights, the latest first

    def _lit(self, light: Environment) -> Sky:
        found = [pair for pair in self._skies if pair[0] is light] or [(light, make_sky(light))]
        self._skies = (found + [pair for pair in self._skies if pair[0] is not light])[:_LIGHTS_KEPT]
        return found[0][1]

    def picture(
        self, materials: list[Material], light: Environment, samples: int, seed: int = 0, image=None, rows=None
    ) -> np.ndarray:
        """Return radiance, (rows, width, 61) float32.

        Parameters
        ----------
        materials : one an object of the scene
        light : Environment
        samples : int
            Paths a pixel, a multiple of 8.
        seed : int
        image : Size, optional
            In place of the scene's.
        rows : sequence of int, optional
            Those to trace, all where absent.
        """
        scene = self.scene
        shapes, materials = with_bodies(scene, self._shapes, materials)
        placements = make_placements(scene, shapes)
        objects, _ = make_objects(placements, materials)
        prepared = make_scene(placements, objects, self._lit(light), scene.lights)
        view = make_view(scene.views[self._view], image or scene.image)
        if (samples, seed) not in self._numbers:
            self._numbers[samples, seed] = make_numbers(samples, seed, REPLICATES)
        numbers = self._numbers[samples, seed]
        parts = [(0, view.height)] if rows is None else [(row, row + 1) for row in rows]
        return np.concatenate([render_rows(prepared, view, numbers, part).radiance for part in parts])


def traced_rows(image: Size, samples: int) -> np.ndarray:
    """Return the rows of a picture that its noise is taken from, evenly over it."""
    count = round(_PATHS / (image.width * samples * (MORE + 3)))
    count = min(max(count, 1), image.height)
    return ((np.arange(count) + 0.5) * image.height / count).astype(int)


def _samples(paths: Paths) -> int:
    if not isinstance(paths.scene.integrator, ReferenceIntegrator):
        raise ValueError("noise of an integrator that has none; accepted: a scene of the integrator reference")
    return paths.scene.integrator.samples


def measured_noise(paths: Paths, rows, materials: list[Material], light: Environment, white: np.ndarray) -> np.ndarray:
    """Return CIEDE2000 between the scene's number of paths and many more, (rows, width).

    The noise of the many is taken out: of independent parts, squares add.
    """
    samples = _samples(paths)
    few = paths.picture(materials, light, samples, _SEEDS[0], rows=rows)
    many = paths.picture(materials, light, MORE * samples, _SEEDS[1], rows=rows)
    return radiance_delta_e(many, few, white) / np.sqrt(1.0 + 1.0 / MORE)


def expected_noise(paths: Paths, rows, materials: list[Material], light: Environment, white: np.ndarray) -> np.ndarray:
    """Return CIEDE2000 that the scene's number of paths leads to, (rows, width), from two pictures of as many.

    Their difference has √2 times the noise of each, and its colour: the standard error that the integrator states of
    every band does not say how far the bands err together.
    """
    samples = _samples(paths)
    one, other = (paths.picture(materials, light, samples, seed, rows=rows) for seed in _SEEDS[2:])
    return radiance_delta_e(one, other, white) / np.sqrt(2.0)
