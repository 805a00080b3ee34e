"""Colour distance of any picture to a path-traced one of the same scene, with the noise of the paths removed.

A few pixels are traced in two independent halves A and B with the mean M. Noise increases the squared distance of a
picture x to each of them, for M half as much as for A or B. A statistic f over many pixels (mean or percentile) is
therefore extrapolated to zero noise from its squares:

    f² = 2 f(x, M)² − (f(x, A)² + f(x, B)²) / 2.

For the root mean square, this is the mean of (x − A) · (x − B), which is unbiased for any noise. Other statistics are
correct to first order in the noise if the noise is small relative to the distance, and also if there is only noise.
"""

from dataclasses import dataclass

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz
from irodori.config.models import Scene
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.shape import Shape
from irodori.rendering.reference.converging_picture import REPLICATES, TracedScene, render_places
from irodori.rendering.reference.outline_paths import MORE
from irodori.rendering.reference.random_numbers import make_numbers
from irodori.rendering.scene_arrays import View, make_placements
from irodori.rendering.single_pixels import middle_rays

#: Largest number of traced pixels that show objects.
PIXELS = 2000
#: Initial number of paths per pixel. It is doubled while the noise exceeds both `_SHARE` of the distance and `_VISIBLE`
#: (a tenth of a just visible difference), up to `_MOST` paths in total.
_FEWEST, _MOST = 64, 512 * PIXELS
_SHARE, _VISIBLE = 0.25, 0.1
#: Seed that differs from those of pictures, plans and noise.
_FIRST_SEED = 211
_TOGETHER = 8192  # pixels tested at a time for showing an object
_DRAWS = 200  # bootstrap samples of the pixels for standard errors


@dataclass(frozen=True)
class Distance:
    """CIEDE2000 between a picture and the path-traced one at pixels that show objects.

    Each statistic has a standard error, which includes the choice of pixels and the noise of the paths. Without pixels,
    all are 0.
    """

    count: int  # pixels
    paths: int  # a pixel
    noise: float  # root mean square CIEDE2000 between the paths' mean and the truth, which is removed
    mean: float
    p95: float
    p99: float
    rms: float
    standard_error_of_mean: float
    standard_error_of_p95: float
    standard_error_of_p99: float
    standard_error_of_rms: float
    #: Luminance of all pixels together relative to that of the paths, less 1: a bias is seen that single pixels hide.
    brightness: float
    standard_error_of_brightness: float


def object_pixels(tracer: Tracer, view: View, objects: int, seed: int = 0, count: int = PIXELS) -> np.ndarray:
    """Return columns and rows of distinct random pixels whose centre shows an object, (n, 2) int64.

    Parameters
    ----------
    tracer : Tracer
    view : View
        For a view with a lens, the ray through the centre of the lens decides.
    objects : int
        Number of objects; surfaces with higher numbers are lights.
    seed : int
    count : int
        Largest number of pixels; pixels are tried until enough are found.
    """
    places = np.random.default_rng([_FIRST_SEED, seed]).permutation(view.width * view.height)
    found = np.zeros((0, 2), dtype=np.int64)
    for first in range(0, len(places), _TOGETHER):
        some = places[first : first + _TOGETHER]
        pixels = np.stack([some % view.width, some // view.width], axis=1)
        _, shape = tracer.intersect(*middle_rays(view, pixels + 0.5))
        found = np.concatenate([found, pixels[(shape >= 0) & (shape < objects)]])
        if len(found) >= count:
            break
    return found[:count]


def body_pixels(scene: Scene, view: View, shapes: list[Shape]) -> np.ndarray:
    """Return the pixels that show a body of the scene and no object, neither at the centre nor at a corner.

    The material of a body is given, not measured, so that such pixels say nothing about the errors of measured
    materials. Returns (height, width) bool.

    Parameters
    ----------
    scene : Scene
    view : View
        For a view with a lens, the ray through the centre of the lens decides.
    shapes : list of Shape
        One for each object of the scene, or one for each object and body.
    """
    if not scene.bodies:
        return np.zeros((view.height, view.width), dtype=bool)
    own = shapes[: len(scene.objects)]
    placements = make_placements(scene, [*own, *(Shape.from_definition(body.shape) for body in scene.bodies)])
    tracer = Tracer(placements)

    def shown(offset: float, rows: int, columns: int) -> np.ndarray:
        places = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) + offset
        return tracer.intersect(*middle_rays(view, places))[1].reshape(rows, columns)

    middle, corner = shown(0.5, view.height, view.width), shown(0.0, view.height + 1, view.width + 1)
    around = [corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]]
    objects = [(one >= 0) & (one < len(own)) for one in (middle, *around)]
    bodies = [one >= len(own) for one in (middle, *around)]
    return np.any(bodies, axis=0) & ~np.any(objects, axis=0)


def traced_halves(
    scene: TracedScene, view: View, pixels: np.ndarray, samples: int, seed: int, more: int = MORE
) -> np.ndarray:
    """Path-trace chosen pixels in two independent halves, (2, n, 61) float64 radiance.

    Parameters
    ----------
    scene : TracedScene
    view : View
    pixels : (n, 2) int
        Column and row; equal pixels have the same random numbers.
    samples : int
        Paths per pixel, a multiple of 2.
    seed : int
    more : int
        Paths of pixels at outlines as a multiple of that, by default as in a picture.
    """
    halves = render_places(scene, view, make_numbers(samples, seed, REPLICATES, more), pixels[:, None]).halves
    assert halves is not None  # of two replicates
    mean, half = halves.mean[:, 0].astype(np.float64), halves.difference[:, 0].astype(np.float64)
    return np.stack([mean + half, mean - half])


def distance_to_halves(shown: np.ndarray, halves: np.ndarray, white_xyz: np.ndarray, paths: int) -> Distance:
    """Return the distance of pixels to path-traced halves, with the noise removed as the module describes.

    Parameters
    ----------
    shown : (n, 3) float
        XYZ of the picture's pixels, Y = 100 for white.
    halves : (2, n, 3) float
        XYZ of the same pixels in both halves of the paths.
    white_xyz : (3,) float
        XYZ of white. At a pixel brighter than white, all colours are scaled down by the same factor.
    paths : int
        Number of paths per pixel, for the result.
    """
    mean = halves.mean(axis=0)
    if not len(mean):
        return Distance(0, paths, *[0.0] * 11)
    scale = np.maximum(mean[:, 1:2] / 100.0, 1.0)
    own, middle, first, second = (lab_from_xyz(xyz / scale, white_xyz) for xyz in (shown, mean, *halves))
    noise = np.sqrt(np.mean(np.square(delta_e(first, second)))) / 2.0
    distances = np.stack([delta_e(other, own) for other in (middle, first, second)])
    drawn = np.random.default_rng(_FIRST_SEED).integers(len(mean), size=(_DRAWS, len(mean)))
    squares, spread = _extrapolated(distances), np.std(_extrapolated(distances[:, drawn]), axis=-1, ddof=1)
    figures = np.sqrt(np.maximum(squares, 0.0))
    # Standard error of a statistic: its increase if its square grows by one standard error, also for a statistic of 0.
    errors = np.sqrt(np.square(figures) + spread) - figures
    light = np.stack([shown[:, 1], np.maximum(mean[:, 1], 0.0)])
    ratios = light[0][drawn].sum(axis=1) / np.maximum(light[1][drawn].sum(axis=1), np.finfo(np.float64).tiny)
    brightness = light[0].sum() / max(light[1].sum(), np.finfo(np.float64).tiny) - 1.0, np.std(ratios, ddof=1)
    return Distance(len(mean), paths, *map(float, (noise, *figures, *errors, *brightness)))


def _extrapolated(distances: np.ndarray) -> np.ndarray:
    """Return squares of mean, p95, p99 and rms extrapolated to zero noise, (4, ...); they may be negative.

    Parameters
    ----------
    distances : (3, ..., n) float
        Distances of the pixels to the mean and to both halves.
    """
    p95, p99 = np.percentile(distances, (95.0, 99.0), axis=-1)
    rms = np.sqrt(np.mean(np.square(distances), axis=-1))
    squares = np.square(np.stack([distances.mean(axis=-1), p95, p99, rms]))
    return 2.0 * squares[:, 0] - 0.5 * (squares[:, 1] + squares[:, 2])


def distance_to_reference(
    scene: TracedScene, view: View, pixels: np.ndarray, shown: np.ndarray, matrix: np.ndarray, white_xyz: np.ndarray
) -> Distance:
    """Path-trace pixels until the noise is small and return the distance of a picture to them, without the noise.

    Parameters
    ----------
    scene : TracedScene
    view : View
    pixels : (n, 2) int
        See `object_pixels`.
    shown : (n, 3) float
        XYZ of the picture at these pixels.
    matrix : (3, 61) float
        Matrix from radiance to XYZ.
    white_xyz : (3,) float
    """
    if not len(pixels):
        return distance_to_halves(shown, np.zeros((2, 0, 3)), white_xyz, 0)
    total, paths = np.zeros((2, len(pixels), 3)), 0
    while True:
        samples = max(paths, _FEWEST)
        total += samples * (traced_halves(scene, view, pixels, samples, _FIRST_SEED + paths) @ matrix.T)
        paths += samples
        found = distance_to_halves(shown, total / paths, white_xyz, paths)
        if 2 * paths * len(pixels) > _MOST or found.noise <= max(_SHARE * found.rms, _VISIBLE):
            return found
