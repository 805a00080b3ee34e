"""Reference integrator: path-traced pictures with standard errors, resumable tile by tile."""

import hashlib
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.config.models import SceneLight
from irodori.core.atomic_files import written_whole
from irodori.core.progress import LOGGER, track
from irodori.core.provenance import code_hash
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.surfaces import make_surfaces
from irodori.jit.chunks import run_chunks
from irodori.light.environment_file import Environment
from irodori.reflection.lobes import Lobes
from irodori.reflection.registry import lobe
from irodori.rendering.compiled_calls import resolved
from irodori.rendering.reference.band_loops import padded
from irodori.rendering.reference.denoising import Halves
from irodori.rendering.reference.glints import find_glints
from irodori.rendering.reference.light_cache import no_cache
from irodori.rendering.reference.outline_paths import MORE, at_outlines
from irodori.rendering.reference.random_numbers import Numbers, in_order, make_numbers
from irodori.rendering.reference.row_statistics import Rows, Sampling, render_some_rows
from irodori.rendering.reference.sky_sampling import Sky, make_sky
from irodori.rendering.reference.sun_images import make_images
from irodori.rendering.reference.world import SEEN, Bands, World
from irodori.rendering.scene_arrays import Objects, View
from irodori.rendering.scene_lights import BANDS, make_lights

#: Number of independent sets of a pixel's samples, whose spread gives the standard error. Larger sets cover the light
#: more uniformly: for the same error, two sets need 0.6 to 0.7 of the samples that eight sets need.
REPLICATES = 2
_NEIGHBOURS = 7  # pixels along the side of the square over which `pooled` takes its mean
#: Height above a surface at which rays start, relative to its size and to its coordinates, for single precision.
_OFFSET, _STEPS = 3e-7, 1e-6
_QUICK_S = 60.0  # time that a picture may take without its tiles being stored
_CHUNKS = 8  # that a band of rows is divided into for the threads


class TracedScene(NamedTuple):
    """A scene prepared for path tracing; the tracer must be kept because the world holds addresses of its data."""

    world: World
    tracer: Tracer


class Picture(NamedTuple):
    """A path-traced picture or some of its rows.

    ``radiance`` is the mean over all paths and ``standard_error`` the error of that mean; ``halves`` has the two
    independent sets of paths if requested. ``paths`` counts all paths, ``cut`` those that were ended after
    `irodori.rendering.reference.paths.LONGEST` surfaces, the only cause of a bias, which makes the mean too low.
    """

    radiance: np.ndarray  # (rows, width, 61) float32
    standard_error: np.ndarray  # (rows, width, 61) float32
    cut: int
    paths: int
    halves: Halves | None = None


def make_scene(
    placements: list[Placement], objects: Objects, environment: Environment | Sky, lights: Sequence[SceneLight] = ()
) -> TracedScene:
    """Prepare a scene for `render_rows`.

    Parameters
    ----------
    placements, objects
        Placements and materials of the objects in the same order, see `irodori.rendering.scene_arrays`.
    environment : Environment or Sky
        A `Sky` that was made once can be used for several scenes.
    lights : sequence of SceneLight
        See `irodori.rendering.scene_lights.make_lights`.
    """
    placed, shapes = make_lights(lights, len(placements))
    tracer = Tracer([*placements, *shapes])
    surfaces = make_surfaces(tracer.placements)
    bands = Bands(padded(objects.basis), padded(objects.n, "edge"), padded(objects.k, "edge"))
    offset = _OFFSET * reaches(tracer.placements)
    addresses = (tracer.intersect_address, tracer.occluded_address, tracer.scene)
    sky = environment if isinstance(environment, Sky) else make_sky(environment)
    world = World(
        surfaces,
        objects,
        bands,
        sky,
        placed,
        *addresses,
        offset,
        _STEPS,
        make_images(placements, objects, sky),
        no_cache(len(placements)),
        len(placements),
    )
    return TracedScene(world, tracer)


class Renderer:
    """Compiled loop for a view of a scene, whose argument types take a millisecond to determine."""

    def __init__(self, scene: TracedScene, view: View, numbers: Numbers) -> None:
        self.width, self._with_halves = view.width, numbers.replicates == 2
        numbers = in_order(numbers, view.width, view.height)
        self._sampling = Sampling(scene.world, view, numbers, find_glints(scene.world.images, view))
        self._loop = resolved(render_some_rows, self._sampling, _empty_rows(np.zeros((0, 0, 2), np.int64)), 0, 0)

    def fill(self, rows: Rows) -> Picture:
        """Render pixels into arrays, and return these."""
        if self._sampling.numbers.most > self._sampling.numbers.samples:
            rows.more[:] = at_outlines(self._sampling.world, self._sampling.camera, rows.places)
        chunk = max(len(rows.places) // _CHUNKS, 1)
        run_chunks(self._loop, len(rows.places), chunk, self._sampling, rows)
        halves = Halves(rows.image, rows.difference, rows.seen) if self._with_halves else None
        return Picture(rows.image, rows.error, int(rows.cut.sum()), int(rows.paths.sum()), halves)

    def places(self, places: np.ndarray) -> Picture:
        """Render pixels given by column and row, (rows, width, 2) int64."""
        return self.fill(_empty_rows(places))

    def rows(self, rows: tuple[int, int]) -> Picture:
        """Render a band of rows."""
        return self.places(self.places_of(rows))

    def places_of(self, rows: tuple[int, int]) -> np.ndarray:
        """Return the pixels of a band of rows, (rows, width, 2) int64."""
        places = np.moveaxis(np.mgrid[slice(*rows), : self.width], 0, -1)[..., ::-1]
        return np.ascontiguousarray(places, dtype=np.int64)


def _empty_rows(places: np.ndarray, by_band: bool = True) -> Rows:
    """Return arrays for the results of pixels; their memory is taken when it is first written."""
    count, width, _ = places.shape
    image, difference = (np.empty((count, width, BANDS), dtype=np.float32) for _ in range(2))
    seen = np.empty((count, width, SEEN), dtype=np.float32)
    error = np.empty((count, width, BANDS if by_band else 1), dtype=np.float32)
    cut, paths = np.zeros((2, count), dtype=np.int64)
    return Rows(places, np.zeros((count, width), np.bool_), image, error, difference, seen, cut, paths)


def render_rows(scene: TracedScene, view: View, numbers: Numbers, rows: tuple[int, int]) -> Picture:
    """Render a band of rows on all threads of numba; the result does not depend on their number."""
    return Renderer(scene, view, numbers).rows(rows)


def render_places(scene: TracedScene, view: View, numbers: Numbers, places: np.ndarray) -> Picture:
    """Render pixels of a view given by column and row, (rows, width, 2), with the same result as `render_rows`."""
    return Renderer(scene, view, numbers).places(np.ascontiguousarray(places, dtype=np.int64))


def check_samples(samples: int, replicates: int = REPLICATES) -> None:
    """Raise an error if the number of samples is no multiple of the number of replicates.

    Raises
    ------
    ValueError
    """
    if samples < replicates or samples % replicates:
        raise ValueError(f"{samples} samples a pixel; accepted: a multiple of {replicates}")


def render(
    scene: TracedScene,
    view: View,
    samples: int,
    seed: int = 0,
    *,
    tile_rows: int = 128,
    label: str = "render",
    tiles: "FinishedTiles | None" = None,
    error_by_band: bool = True,
    replicates: int = REPLICATES,
    halves: bool = False,
) -> Picture:
    """Render a picture.

    Parameters
    ----------
    scene : TracedScene
    view : View
    samples : int
        Paths per pixel, a multiple of ``replicates``; powers of two are distributed best. Pixels at outlines have
        `MORE` times as many.
    seed : int, from 0
    tile_rows : int
        Rows of a tile; progress is reported and tiles are stored after each.
    label : str
        Label of the progress.
    tiles : FinishedTiles, optional
        Folder in which finished tiles are kept and searched.
    error_by_band : bool
        Whether the standard error is given for each band. If not, it is the root mean square over the bands, (height,
        width, 1), which needs half the memory. (With two replicates, the plain mean over bands would be a fifth too
        small if the errors of bands are independent.)
    replicates : int
        Number of independent sets of samples, at least 2. The standard error of a pixel has one degree of freedom less
        than that: with two sets it is a poor estimate for a single pixel, see `pooled`.
    halves : bool
        Whether to return the two `Halves`, which needs twice the memory and two replicates.

    Raises
    ------
    ValueError
        If `samples` is no multiple of ``replicates``, or halves are requested with more than two replicates.
    """
    check_samples(samples, replicates)
    if halves and replicates != 2:
        raise ValueError(f"halves of {replicates} replicates; accepted: 2")
    renderer = Renderer(scene, view, make_numbers(samples, seed, replicates, MORE))
    whole, parts = _empty_rows(renderer.places_of((0, view.height)), error_by_band), []
    for first in track(range(0, view.height, tile_rows), label):
        rows = (first, min(first + tile_rows, view.height))
        own = Rows(*(array[slice(*rows)] for array in whole))
        if tiles is None:
            parts.append(renderer.fill(own))
            continue
        parts.append(tiles.get(rows, partial(renderer.fill, own)))
        read = parts[-1].halves or Halves(parts[-1].radiance, own.difference, own.seen)
        own.image[:], own.error[:], own.difference[:], own.seen[:] = (
            read.mean, parts[-1].standard_error, read.difference, read.seen
        )  # fmt: skip
    cut, paths = sum(part.cut for part in parts), sum(part.paths for part in parts)
    made = Halves(whole.image, whole.difference, whole.seen) if halves else None
    return Picture(whole.image, whole.error, cut, paths, made)


def pooled(error: np.ndarray) -> np.ndarray:
    """Return standard errors (height, width) averaged, as root mean square, over 7 x 7 pixels around each pixel.

    The squared difference of two sets is an unbiased estimate of the variance, but its scatter is larger than its
    value. Neighbouring pixels mostly have similar noise and are averaged.
    """
    return np.sqrt(mean_around(np.square(error, dtype=np.float64)))


def mean_around(values: np.ndarray) -> np.ndarray:
    """Return the mean of values (height, width) over the 7 x 7 pixels around each pixel."""
    from scipy.ndimage import convolve1d  # slow to import

    even = np.full(_NEIGHBOURS, 1.0 / _NEIGHBOURS)
    for axis in range(2):
        # `uniform_filter` uses a running sum, whose rounding error next to a sun exceeds the errors of dark pixels.
        values = convolve1d(values, even, axis, mode="nearest")
    return values


def picture_key(scene: TracedScene, view: View, samples: int, seed: int) -> str:
    """Return a hash of everything on which a picture depends: the scene, the view, the samples and this code."""
    code = code_hash("irodori.rendering.reference.filling_cache")  # which uses this module
    digest = hashlib.blake2b(code.encode(), digest_size=16)
    for part in (
        scene.world.surfaces,
        scene.world.objects,
        scene.world.bands,
        scene.world.sky,
        scene.world.lights,
        view,
    ):
        for value in part:
            if isinstance(value, Lobes):
                digest.update(" ".join(f"{name} {lobe(name).digest}" for name in value.names).encode())
            else:
                digest.update(np.ascontiguousarray(value).data)
    # The light of a cache follows from the rest.
    digest.update(f"{samples} {seed} {len(scene.world.cache.least_mm2)}".encode())
    return digest.hexdigest()


class FinishedTiles:
    """Folder of the finished tiles of one picture.

    Tiles take half a kilobyte a pixel. Those of a picture that is quickly rendered again are not worth the writing.

    Parameters
    ----------
    folder : path
        Created if it does not exist.
    key : str
        Hash of everything on which the picture depends; tiles with another key are not read.
    after_s : float
        Time, s, after which finished tiles are stored, also those that were finished before.
    """

    def __init__(self, folder, key: str, after_s: float = _QUICK_S) -> None:
        self.folder, self.key = Path(folder), key
        self.folder.mkdir(parents=True, exist_ok=True)
        self._stored_from = time.monotonic() + after_s
        self._unstored: list[tuple[Path, Picture]] = []

    def get(self, rows: tuple[int, int], make: Callable[[], Picture]) -> Picture:
        """Return a tile from the folder, or call ``make`` and store its result there, at once or later."""
        path = self.folder / f"{self.key}-{rows[0]}-{rows[1]}.npz"
        if path.is_file():
            with np.load(path) as kept:
                radiance, error = kept["radiance"], kept["standard_error"]
                halves = Halves(radiance, kept["difference"], kept["seen"]) if "seen" in kept else None
                return Picture(radiance, error, int(kept["cut"]), int(kept["paths"]), halves)
        self._unstored.append((path, part := make()))
        if time.monotonic() >= self._stored_from:
            while self._unstored:
                self._store(*self._unstored.pop())
        return part

    @staticmethod
    def _store(path: Path, part: Picture) -> None:
        with written_whole(path) as temporary:
            counts = {"cut": np.array(part.cut), "paths": np.array(part.paths)}
            named = {"standard_error": part.standard_error, **counts}
            if part.halves is not None:
                named |= {"difference": part.halves.difference, "seen": part.halves.seen}
            np.savez(temporary, allow_pickle=False, radiance=part.radiance, **named)

    def remove(self) -> None:
        """Remove the tiles, and the folder if nothing else is in it."""
        for path in self.folder.glob(f"{self.key}-*"):
            path.unlink()
        if not any(self.folder.iterdir()):
            self.folder.rmdir()
        else:
            LOGGER.info("%s holds tiles of other pictures", self.folder)
