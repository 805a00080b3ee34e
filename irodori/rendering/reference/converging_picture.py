"""Reference integrator: progressive pictures with standard errors, resumable by tile."""

import hashlib
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
from irodori.rendering.reference.random_numbers import Numbers, make_numbers
from irodori.rendering.reference.row_statistics import Rows, Sampling, render_some_rows
from irodori.rendering.reference.sky_sampling import Sky, make_sky
from irodori.rendering.reference.world import SEEN, Bands, World
from irodori.rendering.scene_arrays import Objects, View
from irodori.rendering.scene_lights import BANDS, make_lights

#: Independent sets of a pixel's samples, from whose spread the standard error comes. Points of one set cover the light
#: the more evenly the more they are: to the same error two sets take 0.6 to 0.7 of the samples of eight.
REPLICATES = 2
_NEIGHBOURS = 7  # pixels along the side of the square over which `pooled` takes its mean
#: Rays leave a surface this part of its reach above it, and this part of its coordinates: single precision.
_OFFSET, _STEPS = 3e-7, 1e-6


class TracedScene(NamedTuple):
    """A scene ready for paths; the tracer owns what the world's addresses point to."""

    world: World
    tracer: Tracer


class Picture(NamedTuple):
    """Part of a picture, or all of it.

    ``radiance`` is the mean and ``standard_error`` that of the mean; ``halves`` has the two sets apart where they are
    asked for. ``cut`` counts the paths that were ended at `irodori.rendering.reference.paths.LONGEST` surfaces, the one
    thing by which the mean can be too low.
    """

    radiance: np.ndarray  # (rows, width, 61) float32
    standard_error: np.ndarray  # (rows, width, 61) float32
    cut: int
    halves: Halves | None = None


def make_scene(
    placements: list[Placement], objects: Objects, environment: Environment | Sky, lights: Sequence[SceneLight] = ()
) -> TracedScene:
    """Return a scene for `render_rows`.

    Parameters
    ----------
    placements, objects
        Of the objects, one for one, see `irodori.rendering.scene_arrays`.
    environment : Environment or Sky
        A sky that is made already serves several scenes.
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
    return TracedScene(World(surfaces, objects, bands, sky, placed, *addresses, offset, _STEPS), tracer)


def render_rows(scene: TracedScene, view: View, numbers: Numbers, rows: tuple[int, int]) -> Picture:
    """Render a band of rows, on as many threads as numba may use; these do not change the result."""
    return render_places(scene, view, numbers, np.moveaxis(np.mgrid[slice(*rows), : view.width], 0, -1)[..., ::-1])


def render_places(scene: TracedScene, view: View, numbers: Numbers, places: np.ndarray) -> Picture:
    """Render pixels at their places in a view's picture, (rows, width, 2) column and row, as `render_rows` does."""
    places = np.ascontiguousarray(places, dtype=np.int64)
    count, width, _ = places.shape
    image, seen = (np.zeros((count, width, size), dtype=np.float32) for size in (BANDS, SEEN))
    error, difference, cut = np.zeros_like(image), np.zeros_like(image), np.zeros(count, dtype=np.int64)
    arguments = Sampling(scene.world, view, numbers), Rows(places, image, error, difference, seen, cut)
    run_chunks(resolved(render_some_rows, *arguments, 0, 0), count, 1, *arguments)
    return Picture(image, error, int(cut.sum()), Halves(image, difference, seen) if numbers.replicates == 2 else None)


def check_samples(samples: int, replicates: int = REPLICATES) -> None:
    """Refuse a number of samples that the replicates cannot share.

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
    tile_rows: int = 16,
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
        Paths a pixel, a multiple of ``replicates``; powers of two are spread best.
    seed : int, from 0
    tile_rows : int
        Rows between two reports of progress, and between two tiles on disk.
    label : str
        Of the progress.
    tiles : Tiles, optional
        Where finished tiles are kept and looked for.
    error_by_band : bool
        Otherwise the standard error is its root mean square over the bands, (height, width, 1): half the memory.
        Of two sets the plain mean would be a fifth too small where bands err apart from each other.
    replicates : int
        Independent sets of the samples, 2 or more. The standard error of a pixel follows Student's law with one degree
        of freedom less: of two sets it says little of a single pixel, see `pooled`.
    halves : bool
        Whether the picture is to have its `Halves`, for which it needs twice the memory and two replicates.

    Raises
    ------
    ValueError
        If `samples` is no multiple of ``replicates``, or halves are asked for of other than two.
    """
    check_samples(samples, replicates)
    if halves and replicates != 2:
        raise ValueError(f"halves of {replicates} replicates; accepted: 2")
    numbers = make_numbers(samples, seed, replicates)
    radiance = np.empty((view.height, view.width, BANDS), dtype=np.float32)
    error, cut = np.empty((view.height, view.width, BANDS if error_by_band else 1), dtype=np.float32), 0
    difference = np.empty_like(radiance) if halves else None
    seen = np.empty((view.height, view.width, SEEN), dtype=np.float32)
    for first in track(range(0, view.height, tile_rows), label):
        rows = (first, min(first + tile_rows, view.height))
        if tiles is None:
            part = render_rows(scene, view, numbers, rows)
        else:
            part = tiles.get(rows, partial(render_rows, scene, view, numbers, rows))
        radiance[slice(*rows)] = part.radiance
        spread = part.standard_error
        error[slice(*rows)] = spread if error_by_band else np.sqrt(np.mean(spread**2, axis=-1, keepdims=True))
        cut += part.cut
        if difference is not None and part.halves is not None:
            difference[slice(*rows)], seen[slice(*rows)] = part.halves.difference, part.halves.seen
    return Picture(radiance, error, cut, None if difference is None else Halves(radiance, difference, seen))


def pooled(error: np.ndarray) -> np.ndarray:
    """Return standard errors (height, width) as root mean square over each pixel's neighbourhood, 7 x 7 pixels.

    Squares of the differences of two sets are right in the mean, and single ones scatter by more than themselves;
    neighbours mostly have like noise.
    """
    from scipy.ndimage import convolve1d  # slow to import

    squares, even = np.square(error, dtype=np.float64), np.full(_NEIGHBOURS, 1.0 / _NEIGHBOURS)
    for axis in range(2):
        # Not `uniform_filter`: behind a sun's outline the rounding of its running sum is more than the dark's errors.
        squares = convolve1d(squares, even, axis, mode="nearest")
    return np.sqrt(squares)


def picture_key(scene: TracedScene, view: View, samples: int, seed: int) -> str:
    """Return a hash of everything that a picture depends on: the scene, the view, the samples and this code."""
    digest = hashlib.blake2b(code_hash(__name__).encode(), digest_size=16)
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
    digest.update(f"{samples} {seed}".encode())
    return digest.hexdigest()


class FinishedTiles:
    """Finished tiles in a folder, of one picture alone.

    Parameters
    ----------
    folder : path
        Made where it is not there.
    key : str
        Names everything that the picture depends on: tiles of another key are not read.
    """

    def __init__(self, folder, key: str) -> None:
        self.folder, self.key = Path(folder), key
        self.folder.mkdir(parents=True, exist_ok=True)

    def get(self, rows: tuple[int, int], make: Callable[[], Picture]) -> Picture:
        """Return a tile from the folder, or make it and keep it there."""
        path = self.folder / f"{self.key}-{rows[0]}-{rows[1]}.npz"
        if path.is_file():
            with np.load(path) as kept:
                radiance, error = kept["radiance"], kept["standard_error"]
                halves = Halves(radiance, kept["difference"], kept["seen"]) if "seen" in kept else None
                return Picture(radiance, error, int(kept["cut"]), halves)
        part = make()
        with written_whole(path) as temporary:
            named = {"standard_error": part.standard_error, "cut": np.array(part.cut)}
            if part.halves is not None:
                named |= {"difference": part.halves.difference, "seen": part.halves.seen}
            np.savez(temporary, allow_pickle=False, radiance=part.radiance, **named)
        return part

    def remove(self) -> None:
        """Remove the tiles, and the folder if nothing else is in it."""
        for path in self.folder.glob(f"{self.key}-*"):
            path.unlink()
        if not any(self.folder.iterdir()):
            self.folder.rmdir()
        else:
            LOGGER.info("%s holds tiles of other pictures", self.folder)
