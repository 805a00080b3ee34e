"""Rendering of a scene by the integrator that its definition names, `interactive` or `reference`."""

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import Body, BodyMaterial, InteractiveIntegrator, ReferenceIntegrator, Render, Scene
from irodori.core.progress import LOGGER
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material
from irodori.rendering.frame_state import STILL, Moment, turned_scene
from irodori.rendering.planning.scene_plan import ScenePlan
from irodori.rendering.scene_arrays import make_objects, make_placements, make_view, under_coats
from irodori.rendering.scene_white import scene_white
from irodori.spectra.published import refractive_index, spectrum

if TYPE_CHECKING:
    from irodori.config.parts import Staging
    from irodori.rendering.light_maps import LightMaps

#: Options if a configuration has none.
DEFAULTS = Render()
#: Largest number of pixels for which hits are kept between frames, 60 bytes a pixel.
_KEPT_PIXELS = 1 << 22


def render_image(
    scene: Scene,
    view_name: str,
    shapes: list[Shape],
    materials: list[Material],
    environment: Environment,
    options: Render = DEFAULTS,
    *,
    tiles_folder=None,
    maps_file=None,
    plan: ScenePlan | None = None,
    check: bool = True,
    distance: bool = False,
) -> tuple[np.ndarray, dict]:
    """Render a view of a scene.

    Parameters
    ----------
    scene : Scene
    view_name : str
    shapes, materials : sequence
        One of each for every object of the scene.
    environment : Environment
    options : Render
    tiles_folder : path, optional
        Folder in which the integrator `reference` keeps finished tiles until the picture is complete.
    maps_file : path, optional
        File of light maps that were baked for this scene. If the scene's integrator uses light maps and there is no
        file, they are baked here.
    plan : ScenePlan, optional
        Simplifications to make, see `irodori.rendering.planning`; none by default.
    check : bool
        Whether a picture rendered by a plan is checked: with the integrator `interactive` against the full model, with
        `reference` by ``distance``.
    distance : bool
        Whether to measure the picture's distance to the path-traced one, see `irodori.rendering.reference.distance`,
        and to raise an error if it exceeds the tolerance of the plan.

    Returns
    -------
    radiance : (height, width, 61) float32; by a plan without all bands (height, width, 3) XYZ with Y = 100 for white
    figures : dict
        Integrator, seconds, pixels and rays or paths per second, and share of filled texels by object; for the
        integrator `reference` also the standard error of the pixels; ``delta_e_to_reference`` if the distance is
        measured.

    Raises
    ------
    ValueError
        If the integrator cannot render something in the scene.
    irodori.rendering.planning.planned_check.ToleranceError
        If the error of a picture rendered by a plan exceeds the scene's tolerance.
    """
    renderer = make_renderer(
        with_planned_samples(scene, plan), shapes, materials, environment, options, maps_file=maps_file
    )
    return render_prepared(renderer, view_name, tiles_folder=tiles_folder, plan=plan, check=check, distance=distance)


def render_prepared(
    renderer: "Renderer",
    view_name: str,
    *,
    tiles_folder=None,
    plan: ScenePlan | None = None,
    check: bool = True,
    distance: bool = False,
) -> tuple[np.ndarray, dict]:
    """Render a view as `render_image` does, by a renderer of the scene with the plan's samples.

    The materials that the renderer was made of, which take as much space as its own textures, need not be kept.
    """
    if plan is None or renderer.kind == "reference":
        picture, figures = renderer.picture(view_name, tiles_folder=tiles_folder)
    else:
        picture, figures = _planned(renderer, view_name, plan, check)
    if plan is not None and renderer.kind == "reference":
        figures["plan"] = plan.figures
        distance = distance or check
    if distance:
        figures["delta_e_to_reference"] = _to_reference(renderer, view_name, picture, plan)
    return picture, figures


def with_planned_samples(scene: Scene, plan: ScenePlan | None) -> Scene:
    """Return a scene of the integrator `reference` with the plan's number of paths per pixel, others unchanged."""
    if plan is None or not isinstance(scene.integrator, ReferenceIntegrator):
        return scene
    return replace(scene, integrator=replace(scene.integrator, samples=plan.decisions["samples"]))


def has_light_maps(scene: Scene) -> bool:
    """Return whether a scene is rendered by the integrator `interactive` with light maps."""
    return isinstance(scene.integrator, InteractiveIntegrator) and scene.integrator.light_maps


def has_shadows(scene: Scene) -> bool:
    """Return whether objects shade each other from the light of all directions."""
    return not isinstance(scene.integrator, InteractiveIntegrator) or scene.integrator.light_maps


def _planned(renderer: "Renderer", view_name: str, plan: ScenePlan, check: bool) -> tuple[np.ndarray, dict]:
    """Render a view by a plan; `irodori.rendering.planning` is imported only here."""
    from irodori.rendering.planning.planned_picture import parts_of, render_planned

    assert isinstance(renderer, InteractiveRenderer)  # the plan of another has no model
    parts = parts_of(renderer)
    return renderer.described(*render_planned(renderer.scene, view_name, parts, renderer.options, plan, check))


def _to_reference(renderer: "Renderer", view_name: str, picture: np.ndarray, plan: ScenePlan | None) -> dict:
    """Measure a picture's distance to the path-traced one; raise an error if it exceeds the tolerance of a plan.

    The picture has 61 bands or XYZ. Returns the fields of `irodori.rendering.reference.distance.Distance` and seconds.
    """
    from irodori.rendering.reference.converging_picture import make_scene
    from irodori.rendering.reference.distance import distance_to_reference, object_pixels

    start, scene = time.perf_counter(), renderer.scene
    placements, view = make_placements(scene, renderer.shapes), make_view(scene.views[view_name], scene.image)
    traced = make_scene(placements, renderer.objects, renderer.environment, scene.lights)
    white, _ = scene_white(scene, renderer.environment)
    matrix = xyz_from_radiance(white)
    pixels = object_pixels(traced.tracer, view, len(placements))
    shown = picture[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    shown = shown if picture.shape[-1] == 3 else shown @ matrix.T
    found = distance_to_reference(traced, view, pixels, shown, matrix, matrix @ white)
    LOGGER.info("to reference: CIEDE2000 mean %.3g, p99 %.3g, at %d pixels", found.mean, found.p99, found.count)
    if plan is not None:
        from irodori.rendering.planning.planned_check import refuse_far

        refuse_far(found, plan, view_name)
    return {**asdict(found), "seconds": time.perf_counter() - start}


def make_renderer(
    scene: Scene,
    shapes: list[Shape],
    materials: list[Material],
    environment: Environment,
    options: Render = DEFAULTS,
    white: np.ndarray | None = None,
    *,
    maps_file=None,
) -> "Renderer":
    """Return a renderer for any view of a scene at any moment; parameters and errors as in `render_image`.

    With a ``white``, (61,) radiance, the renderer may return XYZ with Y = 100 for that white, (height, width, 3), if
    the integrator can compute them with less work than the 61 bands and as exactly.
    """
    made: type[Renderer] = _Reference if isinstance(scene.integrator, ReferenceIntegrator) else InteractiveRenderer
    renderer = made(scene, shapes, materials, environment, options, white)
    renderer.maps_file = maps_file
    return renderer


class Renderer(ABC):
    """A scene with its integrator; data that do not change between pictures are kept. Made by `make_renderer`."""

    kind = ""
    #: File of the scene's light maps, or None.
    maps_file = None

    def __init__(
        self,
        scene: Scene,
        shapes: list[Shape],
        materials: list[Material],
        environment: Environment,
        options: Render,
        white: np.ndarray | None = None,
    ) -> None:
        self.scene, self.environment, self.options, self.white = scene, environment, options, white
        pairs = list(zip(scene.objects, materials, strict=False))
        self.sheets = {item.object: material.transmittance or "none" for item, material in pairs if material.is_sheet}
        self.shapes, materials = with_bodies(scene, shapes, materials)
        self.check()
        # Textures do not depend on where objects stand.
        self.objects, filled = make_objects(make_placements(self.scene, self.shapes), materials)
        names = [item.object for item in self.scene.objects]
        self.filled = dict(zip(names, filled, strict=False))
        self._lit: tuple = ()

    @abstractmethod
    def check(self) -> None:
        """Raise an error if the integrator cannot render something in the scene.

        Raises
        ------
        ValueError
        """

    def light(self, moment: Moment):
        """Return the light of a moment in the integrator's form; it is made again only if its filter has changed."""
        if not self._lit or self._lit[0] != moment.filter:
            self._lit = moment.filter, self.make_light(moment)
        return self._lit[1]

    @abstractmethod
    def make_light(self, moment: Moment):
        """Return the data that depend on the filter of a moment, but on none of its angles."""

    @abstractmethod
    def render(self, view_name: str, moment: Moment, keep: bool, tiles_folder) -> tuple[np.ndarray, dict]:
        """Render a view; return the picture and the integrator's own figures."""

    def picture(
        self, view_name: str, moment: Moment = STILL, keep: bool = False, tiles_folder=None
    ) -> tuple[np.ndarray, dict]:
        """Render a view.

        Parameters
        ----------
        view_name : str
        moment : Moment
        keep : bool
            Whether to keep hits for later pictures of the same view with the same angle between eye and objects.
        tiles_folder : path, optional

        Returns
        -------
        Picture and figures as in `render_image`.
        """
        return self.described(*self.render(view_name, moment, keep, tiles_folder))

    def described(self, picture: np.ndarray, figures: dict) -> tuple[np.ndarray, dict]:
        """Add the figures that all integrators have to those of a picture; return picture and figures."""
        figures["pixels_per_second"] = picture.shape[0] * picture.shape[1] / figures["seconds"]
        if self.sheets:
            figures["transmittance"] = self.sheets
        return picture, {"integrator": self.kind, **figures, "filled_fraction": self.filled}


def with_bodies(scene: Scene, shapes: list[Shape], materials: list[Material]) -> tuple[list[Shape], list[Material]]:
    """Return shapes and materials of a scene's objects, followed by those of its bodies."""
    made = [body_material(body) for body in scene.bodies]
    return [*shapes, *(Shape.from_definition(body.shape) for body in scene.bodies)], [*materials, *made]


def with_backs(scene: "Scene | Staging", materials: Sequence[Material]) -> list[Material]:
    """Return the materials of a scene's objects, each with its back; those of the backs follow them in the argument."""
    backs = iter(materials[len(scene.objects) :])
    pairs = zip(scene.objects, materials, strict=False)
    return [material if item.back is None else replace(material, back=next(backs)) for item, material in pairs]


def body_material(body: Body) -> Material:
    """Return the uniform material of a scene's body, of a sheet with its back and its transmittance."""
    material = _uniform(body.material, body.transmittance)
    return material if body.back is None else replace(material, back=_uniform(body.back))


def _uniform(own: BodyMaterial, transmittance: float | str | None = None) -> Material:
    n, k = refractive_index(own.refractive_index)
    sent = spectrum(transmittance) if isinstance(transmittance, str) else transmittance
    return Material.uniform(
        spectrum(own.spectrum), beta=own.beta, mu=own.mu_rad, mirror=own.mirror, n=n, k=k, transmittance=sent
    )


class InteractiveRenderer(Renderer):
    """Renderer by precomputed look-ups; `irodori.rendering.interactive` is imported only when it renders."""

    kind = "interactive"
    compiled = False
    prepared_s = 0.0
    #: Whether all light maps follow from the transfer of light, because light or objects turn in some pictures.
    light_turns = False
    representation, why = "spectral", "the picture is asked for in all bands"

    def check(self) -> None:
        """Raise an error for area lights, whose soft shadows the integrator cannot render."""
        if any(light.kind != "collimated" for light in self.scene.lights):
            raise ValueError("area lights in a scene of the integrator 'interactive'; accepted: collimated lights")

    def make_light(self, moment: Moment):
        """Return the scene prepared for frames in the light of a moment."""
        from irodori.rendering.interactive.channels import exact_representation
        from irodori.rendering.interactive.frame_renderer import light_of, prepare_scene
        from irodori.rendering.interactive.prepared_scene import gloss_for
        from irodori.rendering.scene_lights import BANDS, make_lights

        start = time.perf_counter()
        assert isinstance(self.scene.integrator, InteractiveIntegrator)  # `make_renderer` chooses this class for it
        environment = moment.environment(self.environment)
        lights = moment.lights(make_lights(self.scene.lights, 0)[0])
        light, maps = light_of(environment), None
        if has_light_maps(self.scene):
            maps = self._turned_maps(moment) if self.light_turns else self.baked
            if moment.filter is not None and not self.light_turns:
                maps = maps.under(moment.filter)
        else:
            light = under_coats(light, environment, self.objects)
        if self.white is not None:
            lamps = lights.spectrum[:, :BANDS]
            self.representation, self.why = exact_representation(self.objects, light, lamps, maps)
        LOGGER.info("representation %s: %s", self.representation, self.why)
        prepared = prepare_scene(
            self.objects,
            light,
            gloss_for(environment, self.objects),
            self.tracer,
            self.representation,
            np.ones(BANDS) if self.white is None else self.white,  # bands need none
            lamps=lights.spectrum[:, :BANDS],
            max_bounces=self.scene.max_bounces,
            least_throughput=self.options.min_throughput,
            maps=maps,
            smooth_outlines=self.scene.integrator.smooth_outlines,
        )
        self.prepared_s = time.perf_counter() - start
        return prepared

    @cached_property
    def tracer(self) -> Tracer:
        """Objects and bodies of the scene where it is defined to have them, for tracing rays."""
        return Tracer(make_placements(self.scene, self.shapes))

    @cached_property
    def transfer(self):
        """Transfer of light between the surroundings and the surfaces of the scene."""
        from irodori.rendering.light_transfer import LightTransfer

        return LightTransfer(self.tracer, self.objects, self.environment)

    def _turned_maps(self, moment: Moment) -> "LightMaps":
        """Return the light maps of a moment in which the objects are not turned."""
        from irodori.rendering.scene_lights import BANDS, make_lights

        lights = moment.lights(make_lights(turned_scene(self.scene, moment).lights, 0)[0])
        lamps = lights.spectrum[:, :BANDS], lights.rotation[:, :, 2]
        return self.transfer.maps(moment.environment(self.environment), moment.environment_deg, *lamps)

    @cached_property
    def baked(self) -> "LightMaps":
        """Light maps of the scene as it stands, read from their file if there is one, else baked.

        Raises
        ------
        InputError
            If the file has light maps of another scene.
        """
        from irodori.rendering.light_maps import LightMaps
        from irodori.rendering.reference.baking import bake_maps, maps_key

        key = maps_key(self.scene, self.shapes, self.objects, self.environment)
        if self.maps_file is not None:
            return LightMaps.load(self.maps_file, key)
        return bake_maps(self.tracer, self.objects, self.environment, self.scene.lights, key=key)

    def render(self, view_name, moment, keep, tiles_folder):
        """Render a frame; return the picture and its figures."""
        from irodori.rendering.interactive.frame_renderer import CollimatedLamp, render_frame
        from irodori.rendering.scene_lights import make_lights

        # Rotated objects would have to be prepared again: all else is rotated instead.
        moment = moment.seen_from("objects")
        if not self.light_turns and (moment.environment_deg or (self.scene.lights and moment.lights_deg)):
            self.light_turns, self._lit = has_light_maps(self.scene), ()
        lit, scene, prepared = self._lit, turned_scene(self.scene, moment), self.light(moment)
        if self.light_turns and self._lit is lit:  # not just prepared with its maps
            prepared.show(self._turned_maps(moment))
        side, size = self.options.pixel_side, scene.image
        view = make_view(scene.views[view_name], size).finer(side)
        lights = make_lights(scene.lights, 0)[0]
        frame = {
            "world_from_light": moment.rotation("environment"),
            "lamps": tuple(CollimatedLamp(rotation[:, 2]) for rotation in lights.rotation),
            "bands": self.representation == "spectral",
        }
        if not self.compiled:
            render_frame(prepared, view._replace(width=side, height=side), **frame)
            self.compiled = True
        keep = keep and view.width * view.height <= _KEPT_PIXELS
        counted: dict[str, int] = {}
        start = time.perf_counter()
        fine = render_frame(prepared, view, **frame, figures=counted, keep_visibility=keep)
        radiance = fine.reshape(size.height, side, size.width, side, -1).mean(axis=(1, 3))
        seconds, rays = time.perf_counter() - start, counted["rays"]
        return radiance, {
            "seconds": seconds,
            "seconds_to_prepare": self.prepared_s,
            "representation": self.representation,
            "light_maps": has_light_maps(self.scene),
            "rays": rays,
            "rays_per_second": rays / seconds,
        }


class _Reference(Renderer):
    """Renderer by path tracing; `irodori.rendering.reference` is imported only when it renders."""

    kind = "reference"
    compiled = False

    def check(self) -> None:
        """Do nothing, because path tracing can render every scene."""

    def make_light(self, moment: Moment):
        from irodori.rendering.reference.sky_sampling import make_sky

        return make_sky(moment.environment(self.environment))

    def render(self, view_name, moment, keep, tiles_folder):
        from irodori.rendering.reference.converging_picture import (
            REPLICATES,
            FinishedTiles,
            make_scene,
            picture_key,
            render,
        )
        from irodori.rendering.reference.filling_cache import with_cache

        scene = turned_scene(self.scene, moment.seen_from("environment"))
        assert isinstance(scene.integrator, ReferenceIntegrator)  # `make_renderer` chooses this class for it
        samples, seed = scene.integrator.samples, scene.integrator.seed
        placements = make_placements(scene, self.shapes)
        prepared = make_scene(placements, self.objects, self.light(moment), scene.lights)
        prepared = prepared._replace(world=prepared.world._replace(lights=moment.lights(prepared.world.lights)))
        view = make_view(scene.views[view_name], scene.image)
        start = time.perf_counter()
        if scene.integrator.cache:
            prepared = with_cache(prepared, view.width * view.height * samples)
        filled_s = time.perf_counter() - start
        if not self.compiled:
            first = render(prepared, view._replace(width=1, height=1), REPLICATES, halves=scene.integrator.denoise)
            _finished(first)
            self.compiled = True
        tiles = None
        if tiles_folder is not None:
            tiles = FinishedTiles(tiles_folder, picture_key(prepared, view, samples, seed))
        start = time.perf_counter()
        picture = render(
            prepared,
            view,
            samples,
            seed,
            tile_rows=self.options.tile_rows,
            label=f"render {view_name}",
            tiles=tiles,
            error_by_band=False,
            halves=scene.integrator.denoise,
        )
        seconds, cached = filled_s + time.perf_counter() - start, len(prepared.world.cache.least_mm2)
        del prepared  # the filter needs the memory
        radiance, errors = _finished(picture)
        _tell_unsteady(errors, scene.integrator.max_relative_standard_error)
        if tiles is not None:
            tiles.remove()
        if picture.cut:
            LOGGER.warning("%d paths were cut: the picture is too dark by what they would have brought", picture.cut)
        return radiance, {
            "seconds": filled_s + time.perf_counter() - start,
            "samples": samples,
            "cache": {"texels": cached, "seconds": filled_s},
            "paths": picture.paths,
            "paths_per_second": picture.paths / seconds,
            "paths_cut": picture.cut,
            **errors,
        }


def _finished(picture) -> tuple[np.ndarray, dict]:
    """Return the radiance of a path-traced picture, denoised if it has two halves, and its errors."""
    from irodori.rendering.reference.converging_picture import mean_around, pooled

    # Both over the same pixels: beside an outline the error of bright pixels is none of a dark one.
    around = mean_around(picture.radiance.mean(axis=-1, dtype=np.float64))
    traced = _relative(pooled(picture.standard_error[..., 0]), around)
    counted = {"fireflies": count_fireflies(picture)}
    if picture.halves is None:
        return picture.radiance, {"relative_standard_error": traced, **counted}
    from irodori.rendering.reference.denoising import BLOCK_PX, denoise, distance_to_unbiased

    start = time.perf_counter()
    radiance, error = denoise(picture.halves)
    distance = distance_to_unbiased(picture.halves, radiance)
    return radiance, {
        "relative_standard_error": _relative(error, radiance.mean(axis=-1)),
        **counted,
        "denoised": {
            "seconds": time.perf_counter() - start,
            "relative_standard_error_before": traced,
            "relative_distance_to_unbiased": distance,
            "block_px": BLOCK_PX,
        },
    }


def _tell_unsteady(errors: dict, most: float) -> None:
    """Note in the figures, and warn, if a pixel's relative standard error exceeds the accepted maximum."""
    largest = errors["relative_standard_error"]["max"]
    errors["beyond_max_relative_standard_error"] = largest > most
    if largest > most:
        LOGGER.warning(
            "the largest relative standard error of a pixel is %.3g, more than %g (max_relative_standard_error), and "
            "%d pixels are fireflies: a small bright light is found by few paths; more samples, or a larger or dimmer "
            "light, help",
            largest,
            most,
            errors["fireflies"],
        )


def count_fireflies(picture) -> int:
    """Return the number of pixels with a standard error above the median radiance of the 7 × 7 pixels around them."""
    from scipy.ndimage import median_filter  # slow to import

    around = median_filter(picture.radiance.mean(axis=-1), 7, mode="nearest")
    return int((picture.standard_error[..., 0] > around).sum())


def _relative(error: np.ndarray, radiance: np.ndarray) -> dict[str, float]:
    """Return mean, 95th percentile and maximum of errors over radiances of the same pixels, (height, width) each."""
    relative = np.divide(error, radiance, out=np.zeros(radiance.shape), where=radiance > 0)
    return {
        "mean": float(relative.mean()),
        "p95": float(np.percentile(relative, 95)),
        "max": float(relative.max()),
    }
