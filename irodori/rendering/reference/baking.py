"""Baking of light maps: light that is transferred to the surfaces of a scene, with its error by path tracing."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from irodori.config.definition import as_plain
from irodori.config.models import Scene, SceneLight
from irodori.core.progress import LOGGER
from irodori.core.provenance import code_hash
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.rendering.light_maps import LightMaps
from irodori.rendering.light_transfer import LightTransfer
from irodori.rendering.map_layouts import Layout
from irodori.rendering.reference.converging_picture import TracedScene, make_scene
from irodori.rendering.reference.incident_light import incident_light
from irodori.rendering.scene_arrays import Objects
from irodori.rendering.scene_lights import make_lights
from irodori.spectra.grid import SAMPLES

#: Points between the texels of each map at which paths are traced, the number of paths from each, and their seed.
_JUDGED, _PATHS, _SEED = 128, 512, 311
#: Root-mean-square error of a map, relative to the mean light on its object, above which there is a warning.
_WARNED = 0.05


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
    text = [code_hash(__name__), json.dumps(stands, sort_keys=True), *objects.lobes.names]
    text += [f"{shape.name} {shape.size_mm}" for shape in shapes]
    digest = hashlib.blake2b("\n".join(text).encode(), digest_size=16)
    triangles = [shape.triangles for shape in shapes if shape.triangles is not None]
    meshes = [part for mesh in triangles for part in (mesh.vertices_mm, mesh.faces)]
    materials = (objects.texture_size, objects.texels, objects.basis, objects.mirror, objects.n, objects.k)
    sheets = () if (objects.behind < 0).all() else (objects.behind, objects.through)
    coats = (objects.coupled,) if objects.coupled.any() else ()
    for values in (*meshes, *materials, *sheets, *coats, objects.lobe, environment.coefficients, environment.basis):
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def bake_maps(
    tracer: Tracer,
    objects: Objects,
    environment: Environment,
    lights: Sequence[SceneLight] = (),
    *,
    key: str = "",
) -> LightMaps:
    """Bake the light maps of a scene as it stands, and measure their error by path tracing.

    Parameters
    ----------
    tracer : Tracer
        Shape i is object i.
    objects, environment, lights
        As in `irodori.rendering.reference.converging_picture.make_scene`. Of the lights other than the environment, the
        maps contain only light that other surfaces reflect; the integrator adds their direct light.
    key : str
        Key of the maps, see `maps_key`.
    """
    lamps = make_lights(lights, 0)[0]
    transfer = LightTransfer(tracer, objects, environment)
    maps = transfer.maps(environment, 0.0, lamps.spectrum[:, :SAMPLES].astype(np.float64), lamps.rotation[:, :, 2])
    scene, bakes = make_scene(list(tracer.placements), objects, environment, lights), []
    for index, bake in enumerate(maps.bakes):
        error = _error(scene, index, transfer.layouts[index], maps.of(index), bake.most)
        bakes.append(bake._replace(error=error))
        LOGGER.info("light map %d: %d texels, error %.3g of the light", index, bake.texels, error)
        if error > _WARNED:
            LOGGER.warning("light map %d errs by %.3g of the light, more than %g", index, error, _WARNED)
    return replace(maps, key=key, bakes=tuple(bakes))


def _error(scene: TracedScene, index: int, layout: Layout, found: np.ndarray, most: int) -> float:
    """Return the root-mean-square error of a map between its texels, by path tracing, relative to the mean light."""
    places, shown = layout.between(found, most, _JUDGED, _SEED)
    halves = incident_light(scene, index, *places, samples=_PATHS, seed=_SEED)
    seen = halves.any(axis=(0, 2))  # not inside another object
    product = np.mean((shown - halves[0])[seen] * (shown - halves[1])[seen], dtype=np.float64) if seen.any() else 0.0
    mean = float(halves.mean(dtype=np.float64))
    return float(np.sqrt(max(product, 0.0))) / mean if mean > 0.0 else 0.0
