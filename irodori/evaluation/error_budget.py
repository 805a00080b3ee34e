"""Error budget of a view: the contribution of each stage to the final pixel.

The virtual rig knows the truth, so a stage's contribution is measured by substitution: everything is true but what that
stage made, and the picture is compared with the one of true materials under true light. Beside it stands what was
expected without knowing the truth: how far the picture of the measured materials under the measured light moves by what
the stages know of their errors, see `irodori.evaluation.error_prediction` and its neighbours. Compression alone states
its error of what is compressed here, which is the truth.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.colour.colorimetry import summary, xyz_from_reflectance
from irodori.config.models import Compress, EnvironmentMaps, Fit, ReferenceIntegrator, Render, Scene, Size
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
from irodori.rendering.integrators import render_image, with_planned_samples
from irodori.rendering.planning.scene_plan import read_plan
from irodori.rendering.scene_white import scene_white

_WIDTH_PX = 96  # of the pictures that are compared
_SAMPLES = 64  # of their pixels, by the same paths in all
_LONG_SHARE, _LONG_SAMPLES = 2, 512  # of the picture that another integrator is compared with: smaller, and its paths
_SEAM_TEXELS = 2  # on either side, see `irodori.evaluation.truth_errors.interior`
_LIGHT = "D65"
_SEED = 8
_HOLES, _LIGHTS = 2, 3  # draws of what is predicted from few independent ones


@dataclass(frozen=True)
class Measured:
    """An object as the chain measured it, beside its truth over the same texture."""

    known: Known
    truth: Material


def away_from_edges(measured: Measured) -> np.ndarray:
    """Return the texels away from seams of two paints and from the edge of the object, (height, width) bool.

    At the edge of a flat object a photograph shows a mixture too, with what lies beside it.
    """
    inside = interior(measured.truth)
    if measured.known.spread.border == "black":
        kept = np.pad(np.ones([n - 2 * _SEAM_TEXELS for n in inside.shape], dtype=bool), _SEAM_TEXELS)
        inside = inside & kept
    return inside


def _paint_means(values: np.ndarray, paint: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return at every texel the mean of some values over the chosen texels of its paint, NaN where none is chosen."""
    count = np.bincount(paint[chosen], minlength=paint.max() + 1)
    sums = np.stack([np.bincount(paint[chosen], v, minlength=count.size) for v in values[chosen].T], axis=-1)
    return np.divide(sums, count[:, None], out=np.full_like(sums, np.nan), where=count[:, None] > 0)[paint]


def substitutes(measured: Measured) -> dict[str, Material]:
    """Return the material with one part as it was measured and the rest true, by the stage that made the part.

    A paint's texels away from seams and edges tell calibration from noise: their mean colour is off by what calibration
    and fit do to all of the paint, what is left scatters. What texels at seams and edges, and those that no capture
    determined, are off beyond that is the part of rectification and of coverage. The four sum to what was measured.
    """
    truth, known = measured.truth, measured.known
    estimate = known.estimate()
    (own, basis), (true, true_basis) = colours(estimate), colours(truth)
    paint, observed = truth.coefficients.argmax(axis=-1), known.material.observed
    inside = away_from_edges(measured) & observed
    means = _paint_means(own, paint, inside)
    # Of a paint without such a texel nothing tells calibration from the rest.
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
    """Return coefficients and basis after compression, and the mean colour error that it states."""
    made = analyse(coefficients, basis, seen_by, options)
    rows = made.decode(made.encode(coefficients.reshape(-1, coefficients.shape[-1])))
    stated = max(errors["mean"] for errors in made.errors.values())
    return rows.reshape(*coefficients.shape[:2], -1), made.basis, stated


def compressed_material(truth: Material, options: CompressOptions) -> tuple[Material, float]:
    """Return the true material after compression, and the mean CIEDE2000 that it states."""
    matrix = xyz_from_reflectance(_LIGHT)
    own, basis = colours(truth)
    *kept, stated = _compressed(own.astype(np.float32), basis, {_LIGHT: (matrix, matrix.sum(axis=1))}, options)
    return with_colours(truth, [tuple(kept)]), stated


def compressed_light(truth: Environment, options: CompressOptions) -> tuple[Environment, float]:
    """Return the true light after compression, and the mean CIEDE2000 that it states."""
    *kept, stated = _compressed(truth.coefficients, truth.basis, observers(truth.upward_white()), options)
    # The map is linear in the light: its coefficients go where those of the picture go.
    irradiance = truth.irradiance @ (np.linalg.pinv(kept[1]) @ truth.basis).T
    return Environment(kept[0], kept[1], irradiance.astype(np.float32)), stated


class BudgetOptions(NamedTuple):
    """The blocks of the configuration on which a budget depends."""

    render: Render
    fit: Fit
    compress: Compress
    environment: EnvironmentMaps


class _Pictures:
    """Small pictures of one view from whatever materials and light."""

    def __init__(self, scene: Scene, view: str, shapes: list[Shape], options: Render) -> None:
        self.scene, self.by_paths = scene, Paths(scene, view, shapes)
        self._view, self._shapes, self._options = view, shapes, options

    def _image(self, width_px: float) -> Size:
        image = self.scene.image
        scale = min(1.0, width_px / image.width)
        return Size(width=max(1, round(scale * image.width)), height=max(1, round(scale * image.height)))

    def paths(self, materials: list[Material], light: Environment, samples=_SAMPLES, width_px=_WIDTH_PX) -> np.ndarray:
        """Return radiance (height, width, 61) by the integrator `reference`, always with the same random numbers."""
        return self.by_paths.picture(materials, light, samples, image=self._image(width_px))

    def own(self, materials: list[Material], light: Environment, width_px: float) -> np.ndarray:
        """Return radiance (height, width, 61) by the scene's own integrator."""
        scene = replace(self.scene, image=self._image(width_px))
        return render_image(scene, self._view, self._shapes, materials, light, self._options)[0]


class _Budget:
    """The rows of one view: pictures beside the true one, and beside the measured one."""

    def __init__(self, pictures: _Pictures, objects: list[Measured], lights) -> None:
        self._pictures, self._objects = pictures, objects
        self._truths = [one.truth for one in objects]
        self._estimated_light, self._true_light = lights
        self._white, self._seen_white = (scene_white(pictures.scene, light)[0] for light in lights[::-1])
        self._parts = [substitutes(one) for one in objects]
        self._estimates = self._of_stage("all")
        self._true = pictures.paths(self._truths, self._true_light)
        self._shown = (pictures.paths(self._estimates, self._true_light) != self._true).any(axis=-1)
        self._base = pictures.paths(self._estimates, self._estimated_light)
        self._squares = np.zeros(int(self._shown.sum()))
        self._rng = np.random.default_rng(_SEED)
        self.rows: list[BudgetRow] = []

    def _of_stage(self, stage: str) -> list[Material]:
        return [parts[stage] for parts in self._parts]

    def _off(self, materials: list[Material], light: Environment) -> np.ndarray:
        return radiance_delta_e(self._true, self._pictures.paths(materials, light), self._white)[self._shown]

    def _moved(self, materials: list[Material], light: Environment | None = None, base=None) -> np.ndarray:
        """Return how far a picture is from that of the measured materials and light."""
        picture = self._pictures.paths(materials, self._estimated_light if light is None else light)
        return radiance_delta_e(self._base if base is None else base, picture, self._seen_white)[self._shown]

    def _drawn(self, draw: Callable) -> list[Material]:
        return [draw(one.known, estimate) for one, estimate in zip(self._objects, self._estimates, strict=True)]

    def _add(self, stage: str, values: np.ndarray, predicted, by: str) -> None:
        """Add a row; ``predicted`` is a number, or one of every pixel."""
        figures = {key: value for key, value in summary(values).items() if key != "count"}
        self.rows.append(BudgetRow(stage, **figures, predicted=float(np.mean(predicted)), by=by))
        if np.isfinite(predicted).all() and len(values) == len(self._squares):
            self._squares += np.square(predicted)

    def _add_part(self, stage: str, label: str, predicted, by: str) -> None:
        self._add(label, self._off(self._of_stage(stage), self._true_light), predicted, by)

    def add_materials(self) -> None:
        """Add noise, calibration, seams, coverage and gloss."""
        noisy = self._moved(self._drawn(lambda one, own: draws.noisy(one, own, self._rng)))
        by = "camera's noise and the fit's model_error and pose_error_deg of every photograph, through the calibration"
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
        """Return what is expected of texels without data, the mean of some draws."""
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
            found.append(self._moved(filled, base=self._pictures.paths(there, self._estimated_light)))
        return np.mean(found, axis=0)

    def add_light(self) -> None:
        """Add the recovered light."""
        values = self._off(self._truths, self._estimated_light)
        if self._estimated_light.basis_errors is None:
            self._add("light", values, np.nan, "none: no camera recovered it")
            return
        lights = [self._estimated_light.drawn(self._rng) for _ in range(_LIGHTS)]
        predicted = np.mean([self._moved(self._estimates, light) for light in lights], axis=0)
        self._add("light", values, predicted, "what the responses leave open of the lamps known, on surfaces")

    def add_compression(self, of_materials: CompressOptions, of_light: CompressOptions) -> None:
        """Add the compression of materials and of light."""
        made = [compressed_material(truth, of_materials) for truth in self._truths]
        materials, worst = zip(*made, strict=True)
        by = "errors that compression states, the worst object's"
        self._add("compression of the materials", self._off(list(materials), self._true_light), max(worst), by)
        light, stated = compressed_light(self._true_light, of_light)
        self._add("compression of the light", self._off(self._truths, light), stated, "error that compression states")

    def add_all(self) -> None:
        """Add everything as measured; what was predicted for the parts adds by squares, pixel by pixel."""
        values = radiance_delta_e(self._true, self._base, self._white)[self._shown]
        self._add("all but the renderer", values, np.sqrt(self._squares), "root of the sum of squares in every pixel")

    def add_renderer(self) -> None:
        """Add what the scene's integrator is off: of the path tracer its noise, of another its difference to paths."""
        if isinstance(self._pictures.scene.integrator, ReferenceIntegrator):
            self._add_noise(self._pictures.scene.integrator)
            return
        width_px = _WIDTH_PX / _LONG_SHARE
        long, own = (
            picture(self._truths, self._true_light, width_px=width_px, **more)
            for picture, more in ((self._pictures.paths, {"samples": _LONG_SAMPLES}), (self._pictures.own, {}))
        )
        shown = (own != self._pictures.own(self._estimates, self._true_light, width_px)).any(axis=-1)
        by = "none: what an integrator leaves out is seen beside paths alone"
        self._add(
            "renderer: what the integrator leaves out", radiance_delta_e(long, own, self._white)[shown], np.nan, by
        )

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
    """Return the rows of a view's budget.

    Parameters
    ----------
    scene : Scene
    view : str
    shapes, objects : one an object of the scene
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
    """Write ``error_budget.csv`` of a view.

    Parameters
    ----------
    inputs : dict
        Files: lists of materials, true_materials and calibrations, one an object, and ``tiles`` and ``observations``,
        those of all objects; ``environment`` and ``true_environment``; ``plan``, a list of one file, or of
        none.
    scene, view, options : see `error_budget`
    subjects : sequence of Subject
        One an object.
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
    rows = error_budget(scene, view, shapes, objects, lights, options)
    write_rows(output, BudgetRow, _logged(rows))


def _logged(rows: Iterable[BudgetRow]) -> Iterator[BudgetRow]:
    for row in rows:
        LOGGER.info("%s: mean %.3f p95 %.3f, predicted %.3f", row.stage, row.mean, row.p95, row.predicted)
        yield row
