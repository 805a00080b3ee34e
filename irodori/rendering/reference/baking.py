"""Baking of light maps by path tracing.

The size of a map and its number of paths follow from its errors: both are increased until values interpolated between
the texels are close enough to path tracing at the same points.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from irodori.config.definition import as_plain
from irodori.config.models import Scene, SceneLight
from irodori.core.atomic_files import written_whole
from irodori.core.progress import LOGGER, track
from irodori.core.provenance import code_hash
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shadow_nodes import extend_to_closed
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.rendering.light_maps import LEFT_OUT, Bake, LightMaps
from irodori.rendering.map_layouts import Layout, Points, make_layout
from irodori.rendering.reference.converging_picture import TracedScene, make_scene
from irodori.rendering.reference.incident_light import incident_light, relative_noise
from irodori.rendering.scene_arrays import Objects
from irodori.spectra.grid import SAMPLES

#: Largest root-mean-square error between a map's texels, and largest noise, relative to the mean light on its object.
MOST_ERROR, MOST_NOISE = 0.02, 0.02
#: Texels of a map and paths per texel, initially and at most.
_FEWEST_TEXELS, _MOST_TEXELS = 1 << 10, 1 << 16
_FEWEST_PATHS, _MOST_PATHS = 64, 4096
#: Number of points between texels at which the error is measured, and their seed, which differs from that of the maps.
_JUDGED, _SEED = 512, 307
#: The module that adds to the maps what gloss sees.
_SURROUNDINGS = "irodori.rendering.interactive.surroundings"


def maps_key(scene: Scene, shapes: Sequence[Shape], objects: Objects, environment: Environment) -> str:
    """Return a hash of everything on which the light maps of a scene depend, including this code.

    The hash is made from definitions and contents of files only. Values computed from them may differ in the last bits
    between the machines of a cluster, where one bakes the maps and another renders with them.

    Parameters
    ----------
    scene : Scene
    shapes : sequence of Shape
        Shapes of the objects, then of the bodies.
    objects, environment
        As in `bake_maps`.
    """
    stands = as_plain({"objects": scene.objects, "bodies": scene.bodies, "lights": scene.lights})
    text = [code_hash(__name__, _SURROUNDINGS), json.dumps(stands, sort_keys=True), *objects.lobes.names]
    text += [f"{shape.name} {shape.size_mm}" for shape in shapes]
    digest = hashlib.blake2b("\n".join(text).encode(), digest_size=16)
    triangles = [shape.triangles for shape in shapes if shape.triangles is not None]
    meshes = [part for mesh in triangles for part in (mesh.vertices_mm, mesh.faces)]
    materials = (objects.texture_size, objects.texels, objects.basis, objects.mirror, objects.n, objects.k)
    for values in (*meshes, *materials, objects.lobe, environment.coefficients, environment.basis):
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


class FinishedMaps:
    """Folder of the finished maps of one scene, so that a bake that was killed continues with the next object.

    Parameters
    ----------
    folder : path
        Created if it does not exist.
    key : str
        Key of the maps, see `maps_key`; maps with another key are removed.
    """

    def __init__(self, folder, key: str) -> None:
        self.folder, self.key = Path(folder), key
        self.folder.mkdir(parents=True, exist_ok=True)
        for path in self.folder.glob("*.npz"):
            if not path.name.startswith(f"{key}-"):
                LOGGER.info("%s is a light map of something else: it is removed", path)
                path.unlink()

    def get(self, index: int, make: Callable[[], tuple[np.ndarray, Bake]]) -> tuple[np.ndarray, Bake]:
        """Return an object's map from the folder, or call ``make`` and store its result there."""
        path = self.folder / f"{self.key}-{index}.npz"
        if path.is_file():
            with np.load(path) as kept:
                return kept["found"], Bake(*(value.item() for value in (kept[name] for name in Bake._fields)))
        found, bake = make()
        with written_whole(path) as temporary:
            np.savez(temporary, allow_pickle=False, found=found, **{k: np.array(v) for k, v in bake._asdict().items()})
        return found, bake


def bake_maps(
    placements: Sequence[Placement],
    objects: Objects,
    environment: Environment,
    lights: Sequence[SceneLight] = (),
    *,
    key: str = "",
    most_error: float = MOST_ERROR,
    finished: FinishedMaps | None = None,
) -> LightMaps:
    """Bake the light maps of a scene.

    Parameters
    ----------
    placements, objects, environment, lights
        As in `irodori.rendering.reference.converging_picture.make_scene`. Of the lights other than the environment, the
        maps contain only light that other surfaces reflect; the integrator adds their direct light.
    key : str
        Key of the maps, see `maps_key`.
    most_error : float
        Accepted root-mean-square error between a map's texels, relative to the mean light on its object. A map of the
        largest size is kept even if its error is larger, with a warning.
    finished : FinishedMaps, optional
        Folder in which finished maps are kept and searched.
    """
    scene = make_scene(list(placements), objects, environment, lights)
    spectra, bakes = [], []
    for index in track(range(len(placements)), "light maps"):
        make = partial(_bake, scene, index, make_layout(placements, index), most_error)
        found, bake = make() if finished is None else finished.get(index, make)
        spectra.append(found)
        bakes.append(bake)
        LOGGER.info("light map %d: %d texels, %d paths each, error %.3g of the light", index, *bake[:2], bake.error)
        if bake.error > most_error:
            LOGGER.warning("light map %d errs by %.3g of the light, more than %g", index, bake.error, most_error)
    basis = _basis(spectra)
    stored = tuple((found @ basis).astype(np.float32) for found in spectra)
    return LightMaps(stored, basis, key, tuple(bakes))


def _basis(spectra: list[np.ndarray]) -> np.ndarray:
    """Return orthonormal vectors (61, k) that represent spectra (..., 61) up to the relative norm `LEFT_OUT`."""
    squares = sum((flat.T @ flat for flat in (one.reshape(-1, SAMPLES) for one in spectra)), np.zeros((SAMPLES,) * 2))
    values, vectors = np.linalg.eigh(squares)
    energy = np.maximum(values[::-1], 0.0)
    left = np.append(energy[::-1].cumsum()[::-1], 0.0)  # left out with 0, 1, 2, ... vectors
    count = max(int(np.argmax(left <= LEFT_OUT**2 * left[0])), 1)
    return np.ascontiguousarray(vectors[:, ::-1][:, :count])


def _bake(scene: TracedScene, index: int, layout: Layout, most_error: float) -> tuple[np.ndarray, Bake]:
    """Return the spectra of an object's map, (rows, columns, 61) float64, and its size and errors."""
    most = _FEWEST_TEXELS
    while True:
        rows, columns = layout.size(most)
        halves, paths = _traced(scene, index, layout.points(most))
        found = halves.mean(axis=0, dtype=np.float64)
        # A texel that no light reaches lies inside another object, unless all is black. Its light would be seen: it is
        # interpolated with that of the texels around the other object.
        extend_to_closed(found, found.any(axis=1), layout.cells(most))
        found = found.reshape(rows, columns, SAMPLES)
        noise, error = relative_noise(halves), _error(scene, index, layout, found, most)
        bake = Bake(rows * columns, paths, noise, error, most)
        if error <= most_error or 4 * most > _MOST_TEXELS or layout.size(4 * most) == (rows, columns):
            return found, bake
        most *= 4


def _traced(scene: TracedScene, index: int, places: Points, seed: int = 0) -> tuple[np.ndarray, int]:
    """Return the light at points in two independent halves, (2, n, 61), and the number of paths per point.

    The number of paths is doubled until the noise is small enough.
    """
    paths = _FEWEST_PATHS
    while True:
        halves = incident_light(scene, index, *places, samples=paths, seed=seed)
        noise = relative_noise(halves)
        if noise <= MOST_NOISE or paths >= _MOST_PATHS:
            return halves, paths
        # The noise falls at least with the square root of the number of paths.
        while paths < _MOST_PATHS and noise > MOST_NOISE:
            paths, noise = 2 * paths, noise / np.sqrt(2.0)


def _error(scene: TracedScene, index: int, layout: Layout, found: np.ndarray, most: int) -> float:
    """Return the root-mean-square error of a map between its texels, by path tracing, relative to the mean light."""
    places, shown = layout.between(found, most, _JUDGED, _SEED)
    halves, _ = _traced(scene, index, places, seed=_SEED)
    seen = halves.any(axis=(0, 2))  # not inside another object
    product = np.mean((shown - halves[0])[seen] * (shown - halves[1])[seen], dtype=np.float64) if seen.any() else 0.0
    mean = float(halves.mean(dtype=np.float64))
    return float(np.sqrt(max(product, 0.0))) / mean if mean > 0.0 else 0.0
