"""A scene rendered by the integrator that it names."""

import time

import numpy as np

from irodori.geometry.shapes import Shape
from irodori.light import Environment
from irodori.material import Material
from irodori.progress import LOGGER, track
from irodori.rendering.integrator import render_rows
from irodori.rendering.scene import make_light, make_objects, make_placements, make_tracer, make_view
from irodori.spectra import refractive_index, spectrum

#: Kinds of `integrator` in a scene.
INTEGRATORS = ("sampled", "interactive", "reference")


def render_image(
    scene: dict,
    view_name: str,
    shapes: list[Shape],
    materials: list[Material],
    environment: Environment,
    options: dict,
    tile_rows: int = 60,
    tiles_folder=None,
) -> tuple[np.ndarray, dict]:
    """Render a view of a scene.

    Parameters
    ----------
    scene : dict
        Validated definition of the scene; without ``integrator`` it is ``sampled``.
    view_name : str
    shapes, materials : one an object of the scene
    environment : Environment
    options : dict
        See `irodori.rendering.integrator.render_rows`.
    tile_rows : int
        Rows rendered between two reports of progress.
    tiles_folder : path, optional
        Where the `reference` integrator keeps finished tiles until the picture is whole.

    Returns
    -------
    radiance : (height, width, 61) float32
    figures : dict
        Integrator, seconds, pixels and rays or paths per second, share of filled texels by object; of the `reference`
        integrator the standard error of the pixels too.

    Raises
    ------
    ValueError
        If the integrator is unknown, or cannot render what the scene asks for.
    """
    scene, shapes, materials = _with_bodies(scene, shapes, materials)
    integrator = scene.get("integrator", {"kind": "sampled"})
    if integrator["kind"] not in INTEGRATORS:
        raise ValueError(f"unknown integrator {integrator['kind']!r}; accepted: {', '.join(INTEGRATORS)}")
    placements = make_placements(scene, shapes)
    objects, filled = make_objects(placements, materials)
    if integrator["kind"] == "sampled":
        if scene.get("lights"):
            raise ValueError("lights in a scene of the integrator 'sampled'; accepted: the integrator 'reference'")
        radiance, figures = _render_sampled(scene, view_name, placements, objects, environment, options, tile_rows)
    elif integrator["kind"] == "interactive":
        radiance, figures = _render_interactive(scene, view_name, placements, objects, environment, options)
    else:
        radiance, figures = _render_reference(
            scene, view_name, placements, objects, environment, tile_rows, tiles_folder
        )
    figures["pixels_per_second"] = radiance.shape[0] * radiance.shape[1] / figures["seconds"]
    names = [item["object"] for item in scene["objects"] if "object" in item]
    figures["filled_fraction"] = dict(zip(names, filled, strict=False))
    return radiance, {"integrator": integrator["kind"], **figures}


def _with_bodies(scene: dict, shapes: list[Shape], materials: list[Material]) -> tuple[dict, list, list]:
    """Return a scene, shapes and materials whose last objects are the scene's bodies."""
    bodies = scene.get("bodies", [])
    made = []
    for body in bodies:
        n, k = refractive_index(body["material"]["refractive_index"])
        gloss = {
            key: body["material"][name] for key, name in (("beta", "beta"), ("mu", "mu_rad"), ("mirror", "mirror"))
        }
        made.append(Material.uniform(spectrum(body["material"]["spectrum"]), **gloss, n=n, k=k))
    shapes = [*shapes, *(Shape.from_definition(body["shape"]) for body in bodies)]
    return scene | {"objects": [*scene["objects"], *bodies]}, shapes, [*materials, *made]


def _render_sampled(scene, view_name, placements, objects, environment, options, tile_rows) -> tuple[np.ndarray, dict]:
    """Render by the irradiance map and few samples a point, see `irodori.rendering.integrator`."""
    tracer = make_tracer(placements)
    light = make_light(environment)
    view = make_view(scene["views"][view_name], scene["image"])
    render_rows(objects, light, view, tracer, (view.height // 2, view.height // 2 + 1), options)  # compile
    start, met = time.perf_counter(), 0
    radiance = np.empty((view.height, view.width, 61), dtype=np.float32)
    for first in track(range(0, view.height, tile_rows), f"render {view_name}"):
        last = min(first + tile_rows, view.height)
        radiance[first:last], shaded = render_rows(objects, light, view, tracer, (first, last), options)
        met += shaded
    seconds = time.perf_counter() - start
    primary = view.width * view.height * options["pixel_side"] ** 2
    rays = primary + met * (1 + options["ambient_samples"] + options["gloss_samples"])
    figures = {
        "seconds": seconds,
        "rays": rays,
        "rays_per_second": rays / seconds,
        "surfaces_shaded": met,
    }
    return radiance, figures


def _render_interactive(scene, view_name, placements, objects, environment, options) -> tuple[np.ndarray, dict]:
    """Render by look-ups alone, see `irodori.rendering.interactive`, which is loaded only where it is asked for."""
    from irodori.gloss import GlossMaps
    from irodori.rendering import interactive
    from irodori.rendering.lights import BANDS, make_lights

    if any(light["kind"] != "collimated" for light in scene.get("lights", [])):
        raise ValueError("area lights in a scene of the integrator 'interactive'; accepted: collimated lights")
    lights, _ = make_lights(scene.get("lights", []), 0)
    lamps = tuple(interactive.Lamp(rotation[:, 2]) for rotation in lights.rotation)
    start = time.perf_counter()
    prepared = interactive.prepare_scene(
        objects,
        interactive.light_of(environment),
        GlossMaps.of(environment.coefficients),
        make_tracer(placements),
        "spectral",
        np.ones(BANDS),  # bands need no white, and under lamps alone the environment has none
        lamps=lights.spectrum[:, :BANDS],
        max_bounces=options["max_bounces"],
        least_throughput=options["min_throughput"],
        half=False,
        ambient=scene["integrator"]["ambient"],
    )
    prepared_s = time.perf_counter() - start
    side = options["pixel_side"]
    image = {key: side * size for key, size in scene["image"].items()}
    view = make_view(scene["views"][view_name], image)
    interactive.render_frame(prepared, view._replace(width=side, height=side), lamps=lamps, bands=True)  # compile
    start, counted = time.perf_counter(), {}
    fine = interactive.render_frame(prepared, view, lamps=lamps, bands=True, figures=counted)
    radiance = fine.reshape(scene["image"]["height"], side, scene["image"]["width"], side, BANDS).mean(axis=(1, 3))
    seconds = time.perf_counter() - start
    rays = counted["rays"]
    return radiance, {
        "seconds": seconds,
        "seconds_to_prepare": prepared_s,
        "rays": rays,
        "rays_per_second": rays / seconds,
    }


def _render_reference(scene, view_name, placements, objects, environment, tile_rows, folder) -> tuple[np.ndarray, dict]:
    """Render by paths, see `irodori.rendering.reference`, which is loaded only where it is asked for."""
    from irodori.rendering import reference

    samples, seed = scene["integrator"]["samples"], scene["integrator"]["seed"]
    prepared = reference.make_scene(placements, objects, environment, scene.get("lights"))
    view = make_view(scene["views"][view_name], scene["image"])
    reference.render(prepared, view._replace(width=1, height=1), reference.REPLICATES)  # compile
    tiles = None
    if folder is not None:
        tiles = reference.Tiles(folder, reference.picture_key(prepared, view, samples, seed))
    start = time.perf_counter()
    picture = reference.render(prepared, view, samples, seed, tile_rows, f"render {view_name}", tiles)
    seconds = time.perf_counter() - start
    if tiles is not None:
        tiles.remove()
    if picture.cut:
        LOGGER.warning("%d paths were cut: the picture is too dark by what they would have brought", picture.cut)
    error, mean = picture.standard_error.mean(axis=-1), picture.radiance.mean(axis=-1)
    relative = np.divide(error, mean, out=np.zeros_like(error), where=mean > 0)
    figures = {
        "seconds": seconds,
        "samples": samples,
        "paths_per_second": view.width * view.height * samples / seconds,
        "paths_cut": picture.cut,
        "relative_standard_error": {
            "mean": float(relative.mean()),
            "p95": float(np.percentile(relative, 95)),
            "max": float(relative.max()),
        },
    }
    return picture.radiance, figures
