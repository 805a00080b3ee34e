"""Path-traced pictures for the error budget, and their measured and expected noise."""

from typing import NamedTuple

import numpy as np

from irodori.config.models import ReferenceIntegrator, Scene, Size
from irodori.evaluation.truth_errors import radiance_delta_e
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material
from irodori.rendering.integrators import with_backs, with_bodies
from irodori.rendering.reference.converging_picture import (
    REPLICATES,
    TracedScene,
    make_scene,
    render_places,
    render_rows,
)
from irodori.rendering.reference.denoising import MARGIN, Halves, filtered_halves, make_guides, squared_error
from irodori.rendering.reference.distance import body_pixels
from irodori.rendering.reference.filling_cache import with_cache
from irodori.rendering.reference.outline_paths import MORE as MORE_AT_OUTLINES
from irodori.rendering.reference.random_numbers import Numbers, make_numbers
from irodori.rendering.reference.sky_sampling import Sky, make_sky
from irodori.rendering.scene_arrays import View, make_objects, make_placements, make_view
from irodori.rendering.single_pixels import sheared_view

#: Paths of the picture that is taken as converged, as a multiple of the scene's; its remaining noise is subtracted.
MORE = 16
_PATHS = 1_500_000  # number of paths traced to measure the noise, unless a single block takes more
_SIDE = 8  # side of a block in pixels, without the margin that the noise filter reads
#: Steps, in x and y, of points that fill a square evenly however many they are (Roberts 2018, by the plastic number).
_EVEN_STEPS = (0.7548776662466927, 0.5698402909980532)
_SEEDS = (71, 72, 73)
_LIGHTS_KEPT = 2  # the measured and the true one, mostly


class Paths:
    """Path-traced pictures of a view of a scene; random numbers and tables of the light are kept for further pictures.

    Parameters
    ----------
    scene : Scene
    view : str
    shapes : list of Shape
        One for each object of the scene.
    """

    def __init__(self, scene: Scene, view: str, shapes: list[Shape]) -> None:
        self.scene, self._view, self._shapes = scene, view, shapes
        self._numbers: dict[tuple[int, int], Numbers] = {}
        self._skies: list[tuple[Environment, Sky]] = []  # of the last lights, the latest first

    def _lit(self, light: Environment) -> Sky:
        found = [pair for pair in self._skies if pair[0] is light] or [(light, make_sky(light))]
        self._skies = (found + [pair for pair in self._skies if pair[0] is not light])[:_LIGHTS_KEPT]
        return found[0][1]

    def _scene(self, materials: list[Material], light: Environment, cached: bool = False) -> TracedScene:
        shapes, materials = with_bodies(self.scene, self._shapes, with_backs(self.scene, materials))
        placements = make_placements(self.scene, shapes)
        objects, _ = make_objects(placements, materials)
        scene, image = make_scene(placements, objects, self._lit(light), self.scene.lights), self.scene.image
        return with_cache(scene, image.width * image.height * _samples(self)) if cached else scene

    def _numbers_of(self, samples: int, seed: int) -> Numbers:
        if (samples, seed) not in self._numbers:
            self._numbers[samples, seed] = make_numbers(samples, seed, REPLICATES, MORE_AT_OUTLINES)
        return self._numbers[samples, seed]

    def picture(
        self,
        materials: list[Material],
        light: Environment,
        samples: int,
        image: Size | None = None,
        shown: np.ndarray | None = None,
    ) -> np.ndarray:
        """Render the view and return radiance, (height, width, 61) float32, or that of some pixels, (n, 61).

        Parameters
        ----------
        materials : list of Material
            One for each object of the scene, then those of the backs that it gives.
        light : Environment
        samples : int
            Paths per pixel, a multiple of 8.
        image : Size, optional
            Size of the picture; the scene's by default.
        shown : (height, width) bool, optional
            Pixels to render, row by row; they are as in the whole picture.
        """
        view = make_view(self.scene.views[self._view], image or self.scene.image)
        prepared, numbers = self._scene(materials, light), self._numbers_of(samples, 0)
        if shown is None:
            return render_rows(prepared, view, numbers, (0, view.height)).radiance
        return render_places(prepared, view, numbers, np.argwhere(shown)[:, None, ::-1]).radiance[:, 0]

    def blocks(
        self, materials: list[Material], light: Environment, samples: int, seed: int, margin: int, cached: bool = False
    ) -> Halves:
        """Render blocks of the scene's picture, each with a margin; return them stacked along the first axis.

        Each block has its own random numbers. A margin may reach beyond the picture; it shows what a larger
        picture of the same view would show there. With ``cached``, paths end in the cache of the scene's whole picture.
        The other parameters are those of `picture`.
        """
        prepared, numbers = self._scene(materials, light, cached), self._numbers_of(samples, seed)
        found = []
        for number, block in enumerate(self._block_views(margin)):
            own = numbers._replace(seed=seed * 1_000_003 + number)
            found.append(render_rows(prepared, block, own, (0, block.height)).halves)
        return Halves(*(np.stack([getattr(block, name) for block in found]) for name in Halves._fields))

    def _block_views(self, margin: int) -> list[View]:
        view, side = make_view(self.scene.views[self._view], self.scene.image), _SIDE + 2 * margin
        places = block_places(self.scene.image, _samples(self), _margin(self))
        return [sheared_view(view, x, y)._replace(width=side, height=side) for x, y in places]

    def bodies(self, image: Size) -> np.ndarray:
        """Return the pixels of a picture of the view that show a body, (height, width) bool."""
        return body_pixels(self.scene, make_view(self.scene.views[self._view], image), self._shapes)

    def bodies_in_blocks(self) -> np.ndarray:
        """Return the pixels of the blocks without margin that show a body, (blocks · 8, 8) bool."""
        return np.concatenate([body_pixels(self.scene, block, self._shapes) for block in self._block_views(0)])


def block_places(image: Size, samples: int, margin: int) -> list[tuple[float, float]]:
    """Return the centres, x and y in pixels, of the blocks in which noise is measured, spread evenly over a picture."""
    across, down = max(image.width // _SIDE, 1), max(image.height // _SIDE, 1)
    paths = samples * (2 * (_SIDE + 2 * margin) ** 2 + MORE * _SIDE**2)
    count = max(round(_PATHS / paths), 1)
    if count >= across * down:
        chosen = np.stack(np.divmod(np.arange(across * down), across)[::-1], axis=1)
    else:
        steps = np.arange(count)[:, None] * _EVEN_STEPS
        chosen = ((0.5 + steps) % 1.0 * (across, down)).astype(int)
    return [((x + 0.5) * image.width / across, (y + 0.5) * image.height / down) for x, y in chosen]


def _margin(paths: Paths) -> int:
    return MARGIN if _integrator(paths).denoise else 0


def _samples(paths: Paths) -> int:
    return _integrator(paths).samples


def _integrator(paths: Paths) -> ReferenceIntegrator:
    if not isinstance(paths.scene.integrator, ReferenceIntegrator):
        raise ValueError("noise of an integrator that has none; accepted: a scene of the integrator reference")
    return paths.scene.integrator


def _inner(values: np.ndarray, margin: int) -> np.ndarray:
    """Cut the margin off blocks, (blocks, side, side, ...), and return them as (blocks · 8, 8, ...)."""
    inner = values[:, margin : margin + _SIDE, margin : margin + _SIDE]
    return inner.reshape(-1, *inner.shape[2:])


def touched(paths: Paths, one: list[Material], other: list[Material], light: Environment) -> np.ndarray:
    """Return the pixels of objects, (blocks · 8, 8) bool: those that differ between two sets of materials.

    Bodies, which reflect the light of objects, are left out.
    """
    pair = (_inner(paths.blocks(materials, light, REPLICATES, 0, 0).mean, 0) for materials in (one, other))
    return np.not_equal(*pair).any(axis=-1) & ~paths.bodies_in_blocks()


class TracedBlocks(NamedTuple):
    """Radiance of blocks of a picture as the scene's integrator renders it; each array is (blocks · 8, 8, 61)."""

    shown: np.ndarray  # mean of ``filtered``
    first: np.ndarray  # from the first set of paths, unfiltered
    second: np.ndarray  # from the second set of paths, unfiltered
    filtered: np.ndarray  # (2, ...), both sets after the noise filter, or unfiltered if the scene has no filter


def traced_blocks(paths: Paths, materials: list[Material], light: Environment, seed: int) -> TracedBlocks:
    """Render blocks with the scene's number of paths per pixel, and filter them if the scene is to be filtered."""
    margin = _margin(paths)
    halves = paths.blocks(materials, light, _samples(paths), seed, margin, _integrator(paths).cache)
    first, second = (_inner(halves.mean + sign * halves.difference, margin) for sign in (1.0, -1.0))
    filtered = np.stack([first, second])
    if margin:
        rows = (margin, margin + _SIDE)
        made = []
        for block in zip(*halves, strict=True):
            one = Halves(*block)
            made.append(filtered_halves(one, make_guides(one), rows)[:, :, margin : margin + _SIDE])
        filtered = np.concatenate(made, axis=1)
    return TracedBlocks(filtered.mean(axis=0), first, second, filtered)


def measured_noise(paths: Paths, materials: list[Material], light: Environment, white: np.ndarray) -> np.ndarray:
    """Return CIEDE2000 between blocks of the scene's picture and those of a converged picture, (blocks · 8, 8).

    The remaining noise of the converged picture is independent, so squares add: all distances are reduced by the same
    factor, by which the mean square decreases by that of this noise.
    """
    few = traced_blocks(paths, materials, light, _SEEDS[0])
    many = paths.blocks(materials, light, MORE * _samples(paths), _SEEDS[1], 0)
    mean, half = (_inner(part, 0) for part in (many.mean, many.difference))
    distance = radiance_delta_e(mean, few.shown, white)
    own = np.mean(np.square(radiance_delta_e(mean + half, mean - half, white))) / 4.0
    whole = float(np.mean(np.square(distance)))
    return distance * np.sqrt(max(1.0 - own / whole, 0.0) if whole > 0.0 else 0.0)


def expected_noise(paths: Paths, materials: list[Material], light: Environment, white: np.ndarray) -> np.ndarray:
    """Estimate CIEDE2000 due to the scene's number of paths from one picture alone, (blocks · 8, 8).

    For a filtered picture, the root mean square over all blocks is estimated, bias of the filter included, see
    `irodori.rendering.reference.denoising.squared_error`; the estimated square of a single pixel scatters by more than
    its value. It is divided among the pixels in proportion to the colour differences between the two filtered sets:
    the mean of an error that is the same everywhere would be too large. For an unfiltered picture it is half the colour
    difference between its two sets of paths. Standard errors of single bands would not do, because the errors of the
    bands are correlated.
    """
    one = traced_blocks(paths, materials, light, _SEEDS[2])
    if not _margin(paths):
        return radiance_delta_e(one.first, one.second, white) / 2.0
    squares = squared_error(lambda a, b: radiance_delta_e(a, b, white), one.first, one.second, one.filtered)
    least = np.square(radiance_delta_e(one.filtered[0], one.filtered[1], white)) / 4.0
    whole, left = max(float(squares.mean()), float(least.mean())), float(least.mean())
    return np.sqrt(least * (whole / left)) if left > 0.0 else np.full(squares.shape, np.sqrt(whole))
