"""Error budget of a view: the contribution of each stage to the colour error of the final picture.

On the virtual rig the truth is known, so the contribution of a stage is measured by substitution: the result of this
stage replaces the true data, everything else stays true, and the picture is compared with the picture of the true
materials under the true light. Each measured contribution is compared with a prediction made without the truth: how far
the picture of the measured materials under the measured light changes when they are varied within the error estimates
of the stages (`irodori.evaluation.error_prediction`). For compression, the prediction is the error that the compression
states for the true data, because the true data are compressed here.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.colour.colorimetry import summary, xyz_from_reflectance
from irodori.config.models import (
    Compress,
    EnvironmentMaps,
    Fit,
    InteractiveIntegrator,
    ReferenceIntegrator,
    Render,
    Scene,
    Size,
)
from irodori.config.parts import Subject
from irodori.core.progress import LOGGER, track
from irodori.evaluation import error_prediction as draws
from irodori.evaluation.known_errors import Known, colours, with_colours
from irodori.evaluation.renderer_noise import MORE, Paths, expected_noise, measured_noise, touched
from irodori.evaluation.result_tables import BudgetRow, write_rows
from irodori.evaluation.truth_errors import interior, radiance_delta_e
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.light.stage import observers
from irodori.material.material_file import Material
from irodori.material.principal_components.basis_count import CompressOptions, analyse
from irodori.rendering.integrators import render_image, with_backs, with_planned_samples
from irodori.rendering.planning.scene_plan import read_plan
from irodori.rendering.scene_white import scene_white

_WIDTH_PX = 96  # width of the pictures that are compared
_SAMPLES = 64  # paths per pixel, with the same random numbers in all pictures
# Another integrator is compared with a path-traced picture that is smaller by this factor and has more paths per pixel.
_LONG_SHARE, _LONG_SAMPLES = 2, 512
_SEAM_TEXELS = 2  # on either side, see `irodori.evaluation.truth_errors.interior`
_LIGHT = "D65"
_SEED = 8
_HOLES, _LIGHTS = 2, 6  # random draws over which the predictions for coverage and for light are averaged


@dataclass(frozen=True)
class Measured:
    """The measured data of an object, and its true material over the same texture."""

    known: Known
    truth: Material


def away_from_edges(measured: Measured) -> np.ndarray:
    """Return the texels away from seams between paints and from the edge of the object, (height, width) bool.

    At the edge of a flat object, too, a photograph mixes the object with its surroundings.
    """
    inside = interior(measured.truth)
    if measured.known.spread.border == "black":
        kept = np.pad(np.ones([n - 2 * _SEAM_TEXELS for n in inside.shape], dtype=bool), _SEAM_TEXELS)
        inside = inside & kept
    return inside


def _paint_means(values: np.ndarray, paint: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return, for every texel, the mean of the values over the chosen texels of its paint; NaN if none is chosen.

    Parameters
    ----------
    values : (height, width, k) float
    paint : (height, width) int
        Index of the paint.
    chosen : (height, width) bool
    """
    count = np.bincount(paint[chosen], minlength=paint.max() + 1)
    sums = np.stack([np.bincount(paint[chosen], v, minlength=count.size) for v in values[chosen].T], axis=-1)
    return np.divide(sums, count[:, None], out=np.full_like(sums, np.nan), where=count[:, None] > 0)[paint]


def substitutes(measured: Measured) -> dict[str, Material]:
    """Return, for each stage, a material with the part from this stage as measured and all other parts true.

    The texels of a paint away from seams and edges separate calibration from noise: the error of their mean colour is
    attributed to calibration and fit (``calibration``), their scatter about the mean to noise (``noise``). The further
    error of texels at seams and edges is attributed to rectification (``seams``), and that of texels without data to
    coverage (``unseen``). These four errors of the colour sum to the error of the measured colour. ``gloss`` has the
    measured gloss, and ``all`` is the measured material.
    """
    truth, known = measured.truth, measured.known
    estimate = known.estimate()
    (own, basis), (true, true_basis) = colours(estimate), colours(truth)
    paint, observed = truth.coefficients.argmax(axis=-1), known.material.observed
    inside = away_from_edges(measured) & observed
    means = _paint_means(own, paint, inside)
    # A paint without such a texel has no mean: its whole error is attributed to the stages other than calibration.
    known_paint = np.isfinite(means).all(axis=-1, keepdims=True)
    means = np.where(known_paint, means, 0.0)

    def off(at: np.ndarray) -> Material:
        at = at[..., None]
        exact = np.where(at & ~known_paint, 0.0, true)
        return with_colours(truth, [(np.where(at, own - means, 0.0), basis), (exact, true_basis)])

    return {
        "noise": off(inside),
        "calibration": with_colours(truth, [(means, basis), (np.where(known_paint, 0.0, true), true_basis)]),
        "seams": off(observed & ~inside),
        "unseen": off(~observed),
        "gloss": replace(
            truth,
            beta=estimate.beta,
            mu=estimate.mu,
            typical_gloss=estimate.typical_gloss,
            lobes=estimate.lobes,
            further_gloss=estimate.further_gloss,
        ),
        "all": estimate,
    }


def _compressed(coefficients: np.ndarray, basis: np.ndarray, seen_by: dict, options: CompressOptions):
    """Return coefficients and basis after compression, and the mean colour error that the compression states."""
    made = analyse(coefficients, basis, seen_by, options)
    rows = made.decode(made.encode(coefficients.reshape(-1, coefficients.shape[-1])))
    stated = max(errors["mean"] for errors in made.errors.values())
    return rows.reshape(*coefficients.shape[:2], -1), made.basis, stated


def compressed_material(truth: Material, options: CompressOptions) -> tuple[Material, float]:
    """Return the true material after compression, and the mean CIEDE2000 that the compression states."""
    matrix = xyz_from_reflectance(_LIGHT)
    own, basis = colours(truth)
    *kept, stated = _compressed(own.astype(np.float32), basis, {_LIGHT: (matrix, matrix.sum(axis=1))}, options)
    return with_colours(truth, [tuple(kept)]), stated


def compressed_light(truth: Environment, options: CompressOptions) -> tuple[Environment, float]:
    """Return the true light after compression, and the mean CIEDE2000 that the compression states."""
    *kept, stated = _compressed(truth.coefficients, truth.basis, observers(truth.upward_white()), options)
    # The irradiance map is linear in the light: its coefficients change basis as those of the panorama do.
    irradiance = truth.irradiance @ (np.linalg.pinv(kept[1]) @ truth.basis).T
    return Environment(kept[0], kept[1], irradiance.astype(np.float32)), stated


class BudgetOptions(NamedTuple):
    """The blocks of the configuration on which a budget depends."""

    render: Render
    fit: Fit
    compress: Compress
    environment: EnvironmentMaps


class _Pictures:
    """Small pictures of one view, rendered with any given materials and light."""

    def __init__(self, scene: Scene, view: str, shapes: list[Shape], options: Render) -> None:
        self.scene, self.by_paths = scene, Paths(scene, view, shapes)
        self._view, self._shapes, self._options = view, shapes, options

    def _image(self, width_px: float) -> Size:
        image = self.scene.image
        scale = min(1.0, width_px / image.width)
        return Size(width=max(1, round(scale * image.width)), height=max(1, round(scale * image.height)))

    def paths(self, materials: list[Material], light: Environment, shown: np.ndarray | None = None) -> np.ndarray:
        """Render radiance, (height, width, 61), or (n, 61) of the pixels shown, with the integrator ``reference``.

        Random numbers never change.
        """
        return self.by_paths.picture(materials, light, _SAMPLES, self._image(_WIDTH_PX), shown)

    def long_paths(self, materials: list[Material], light: Environment, shown: np.ndarray) -> np.ndarray:
        """Render pixels of a smaller picture, (n, 61), with more paths each."""
        return self.by_paths.picture(materials, light, _LONG_SAMPLES, self._image(_WIDTH_PX / _LONG_SHARE), shown)

    def own(self, materials: list[Material], light: Environment, width_px: float, baked: bool = True) -> np.ndarray:
        """Render radiance (height, width, 61) with the integrator that the scene chooses, or without its light maps."""
        scene = replace(self.scene, image=self._image(width_px))
        if not baked and isinstance(scene.integrator, InteractiveIntegrator):
            scene = replace(scene, integrator=replace(scene.integrator, light_maps=False))
        whole = with_backs(scene, materials)
        return render_image(scene, self._view, self._shapes, whole, light, self._options)[0]

    def touched(self, one: list[Material], other: list[Material], light: Environment, width_px: float) -> np.ndarray:
        """Return the pixels that differ between two sets of materials, (height, width) bool: those of objects.

        Without light maps, which the other objects change too and which take long to bake.
        """
        pair = (self.own(materials, light, width_px, baked=False) for materials in (one, other))
        return np.not_equal(*pair).any(axis=-1) & ~self.bodies(width_px)

    def bodies(self, width_px: float = _WIDTH_PX) -> np.ndarray:
        """Return the pixels that show a body of the scene, whose material is given, (height, width) bool."""
        return self.by_paths.bodies(self._image(width_px))


class _Budget:
    """Rows of the error budget of one view.

    Measured errors compare pictures with the picture of the true scene, predictions with that of the measured scene.
    """

    def __init__(self, pictures: _Pictures, objects: list[Measured], lights) -> None:
        self._pictures, self._objects = pictures, objects
        self._truths = [one.truth for one in objects]
        self._estimated_light, self._true_light = lights
        self._white, self._seen_white = (scene_white(pictures.scene, light)[0] for light in lights[::-1])
        self._parts = [substitutes(one) for one in objects]
        self._estimates = self._of_stage("all")
        true = pictures.paths(self._truths, self._true_light)
        differs = (pictures.paths(self._estimates, self._true_light) != true).any(axis=-1)
        # Of all further pictures, only these pixels are rendered: those that show objects.
        self._shown = differs & ~pictures.bodies()
        self._true = true[self._shown]
        self._base = self._paths(self._estimates, self._estimated_light)
        self._squares = np.zeros(len(self._true))
        self._rng = np.random.default_rng(_SEED)
        self.rows: list[BudgetRow] = []

    def _of_stage(self, stage: str) -> list[Material]:
        return [parts[stage] for parts in self._parts]

    def _paths(self, materials: list[Material], light: Environment) -> np.ndarray:
        return self._pictures.paths(materials, light, self._shown)

    def _off(self, materials: list[Material], light: Environment) -> np.ndarray:
        return radiance_delta_e(self._true, self._paths(materials, light), self._white)

    def _moved(self, materials: list[Material], light: Environment | None = None, base=None) -> np.ndarray:
        """Return CIEDE2000 between a picture and that of measured materials and light, at pixels that show objects."""
        picture = self._paths(materials, self._estimated_light if light is None else light)
        return radiance_delta_e(self._base if base is None else base, picture, self._seen_white)

    def _drawn(self, draw: Callable) -> list[Material]:
        return [draw(one.known, estimate) for one, estimate in zip(self._objects, self._estimates, strict=True)]

    def _add(self, stage: str, values: np.ndarray, predicted, by: str) -> None:
        """Add a row to the table.

        Parameters
        ----------
        stage : str
        values : (n,) float
            Measured CIEDE2000 of the pixels.
        predicted : float or (n,) float
            Predicted CIEDE2000, of all pixels or of each.
        by : str
            How the prediction was made, or why there is none.
        """
        figures = {key: value for key, value in summary(values).items() if key != "count"}
        self.rows.append(BudgetRow(stage, **figures, predicted=float(np.mean(predicted)), by=by))
        if np.isfinite(predicted).all() and len(values) == len(self._squares):
            self._squares += np.square(predicted)

    def _add_part(self, stage: str, label: str, predicted, by: str) -> None:
        self._add(label, self._off(self._of_stage(stage), self._true_light), predicted, by)

    def add_materials(self) -> None:
        """Add the rows of noise, calibration, seams, coverage and gloss."""
        noisy = self._moved(self._drawn(lambda one, own: draws.noisy(one, own, self._rng)))
        by = "camera's noise and the fit's errors of light and angles in every photograph, through the calibration"
        self._add_part("noise", "noise: scatter of the colour within a paint", noisy, by)
        left_out = float(np.mean([one.known.left_out for one in self._objects]))
        label = "calibration and fit: mean colour of a paint"
        self._add_part("calibration", label, left_out, "patches left out of the chart")
        sharper = self._moved(self._drawn(draws.sharper))
        by = "the measured texture without the blur of the photographs' samples"
        self._add_part("seams", "rectification: texels at seams and edges", sharper, by)
        by = "texels with data, filled as those without it are"
        self._add_part("unseen", "coverage: texels filled from their neighbours", self._holes(), by)
        gloss = self._moved(self._drawn(lambda one, own: draws.other_gloss(one, own, self._rng)))
        self._add_part("gloss", "gloss of the fit", gloss, "standard errors of β and μ where stated")

    def _holes(self) -> np.ndarray:
        """Return the predicted CIEDE2000 due to texels without data, in each pixel: the mean over a few draws."""
        found = []
        for _ in range(_HOLES):
            places = [draws.held_out(one.known, self._rng) for one in self._objects]
            there, filled = (
                [
                    draws.moved_texels(one.known, own, place[end])
                    for one, own, place in zip(self._objects, self._estimates, places, strict=True)
                ]
                for end in (0, 1)
            )
            found.append(self._moved(filled, base=self._paths(there, self._estimated_light)))
        return np.mean(found, axis=0)

    def add_light(self) -> None:
        """Add the row of the recovered light."""
        values = self._off(self._truths, self._estimated_light)
        if self._estimated_light.basis_errors is None:
            self._add("light", values, np.nan, "none: no camera recovered it")
            return
        lights = [self._estimated_light.drawn(self._rng) for _ in range(_LIGHTS)]
        predicted = np.mean([self._moved(self._estimates, light) for light in lights], axis=0)
        self._add(
            "light", values, predicted, "what the responses and their noise leave open of the lamps known, on surfaces"
        )

    def add_compression(self, of_materials: CompressOptions, of_light: CompressOptions) -> None:
        """Add the rows of the compression of materials and of light."""
        made = [compressed_material(truth, of_materials) for truth in self._truths]
        materials, worst = zip(*made, strict=True)
        by = "errors that compression states, the worst object's"
        self._add("compression of the materials", self._off(list(materials), self._true_light), max(worst), by)
        light, stated = compressed_light(self._true_light, of_light)
        self._add("compression of the light", self._off(self._truths, light), stated, "error that compression states")

    def add_all(self) -> None:
        """Add the row of all stages together except the renderer.

        Its prediction in a pixel is the root of the summed squares of those parts that have one for every pixel, or
        one number for all.
        """
        values = radiance_delta_e(self._true, self._base, self._white)
        self._add("all but the renderer", values, np.sqrt(self._squares), "root of the sum of squares in every pixel")

    def add_renderer(self) -> None:
        """Add the row of the renderer: noise of the path tracer, or another integrator's difference to path tracing."""
        if isinstance(self._pictures.scene.integrator, ReferenceIntegrator):
            self._add_noise(self._pictures.scene.integrator)
            return
        width_px = _WIDTH_PX / _LONG_SHARE
        shown = self._pictures.touched(self._truths, self._estimates, self._true_light, width_px)
        long = self._pictures.long_paths(self._truths, self._true_light, shown)
        own = self._pictures.own(self._truths, self._true_light, width_px)[shown]
        by = "none: what an integrator leaves out is seen beside paths alone"
        self._add("renderer: what the integrator leaves out", radiance_delta_e(long, own, self._white), np.nan, by)

    def _add_noise(self, integrator: ReferenceIntegrator) -> None:
        paths = self._pictures.by_paths
        shown = touched(paths, self._truths, self._estimates, self._true_light)
        values = measured_noise(paths, self._truths, self._true_light, self._white)[shown]
        predicted = expected_noise(paths, self._estimates, self._estimated_light, self._seen_white)[shown]
        by = f"the two sets of a picture's paths; measured beside {MORE} times the paths"
        what = "noise and filter" if integrator.denoise else "noise"
        self._add(f"renderer: {what} of {integrator.samples} paths a pixel", values, predicted, by)


def error_budget(
    scene: Scene,
    view: str,
    shapes: list[Shape],
    objects: list[Measured],
    lights: tuple[Environment, Environment],
    options: BudgetOptions,
) -> list[BudgetRow]:
    """Return the rows of the error budget of a view.

    Parameters
    ----------
    scene : Scene
    view : str
    shapes : list of Shape
        One for each object of the scene.
    objects : list of Measured
        One for each object of the scene, then those of the backs that it gives.
    lights : (Environment, Environment)
        The measured light and the true one.
    options : BudgetOptions
    """
    wanted = [f.name for f in fields(CompressOptions)]
    of_materials, of_light = (
        CompressOptions(**{name: getattr(block, name) for name in wanted})
        for block in (options.compress, options.environment)
    )
    budget = _Budget(_Pictures(scene, view, shapes, options.render), objects, lights)
    for step in track(
        (
            budget.add_materials,
            budget.add_light,
            lambda: budget.add_compression(of_materials, of_light),
            budget.add_all,
            budget.add_renderer,
        ),
        f"error budget of {view}",
    ):
        step()
    return budget.rows


def measure_error_budget(
    inputs: dict, scene: Scene, view: str, subjects: Sequence[Subject], options: BudgetOptions, output
) -> None:
    """Write ``error_budget.csv``, the error budget of a view.

    Parameters
    ----------
    inputs : dict
        Files: the lists ``materials``, ``true_materials`` and ``calibrations`` with one file for each object, then
        for the backs; the lists ``tiles`` and ``observations`` with the files of all of them; ``environment`` and
        ``true_environment``; ``plan``, a list with one file or none.
    scene, view, options
        See `error_budget`.
    subjects : sequence of Subject
        One for each object, then for the backs.
    output : path
    """
    shapes = [Shape.from_definition(one.shape) for one in subjects]
    objects = []
    for material, truth, calibration, shape, one in zip(
        *(inputs[name] for name in ("materials", "true_materials", "calibrations")), shapes, subjects, strict=True
    ):
        folder = Path(material).parent
        own = {name: [p for p in inputs[name] if folder in Path(p).parents] for name in ("tiles", "observations")}
        files = own | {"material": material, "calibration": calibration}
        objects.append(Measured(Known.load(files, shape, one.sample_mm, options.fit), Material.load(truth)))
    lights = Environment.load(inputs["environment"]), Environment.load(inputs["true_environment"])
    for path in inputs["plan"]:
        scene = with_planned_samples(scene, read_plan(path))
    rows = error_budget(scene, view, shapes[: len(scene.objects)], objects, lights, options)
    write_rows(output, BudgetRow, _logged(rows))


def _logged(rows: Iterable[BudgetRow]) -> Iterator[BudgetRow]:
    for row in rows:
        LOGGER.info("%s: mean %.3f p95 %.3f, predicted %.3f", row.stage, row.mean, row.p95, row.predicted)
        yield row
