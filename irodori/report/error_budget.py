"""The error budget of a view: what each stage adds to the final pixel, from RAW noise to the renderer.

The virtual rig knows the truth, so a stage's contribution is measured by substitution: everything is true but what that
stage made, and the picture is compared with the one of true materials under true light. Beside it stands what was
expected without knowing the truth, from the errors that the stages themselves state.
"""

import csv
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from irodori import store
from irodori.colour import summary, xyz_from_reflectance
from irodori.environment import observers
from irodori.fitted_tiles import FittedTiles
from irodori.geometry.shapes import Shape
from irodori.light import Environment
from irodori.material import Material
from irodori.principal import CompressOptions, analyse
from irodori.progress import LOGGER, track
from irodori.recovery import Calibration
from irodori.rendering.integrators import render_image
from irodori.rendering.white import scene_white
from irodori.report.errors import interior, radiance_delta_e
from irodori.whole_files import written_whole

_WIDTH_PX = 96  # of the pictures that are compared
_REFERENCE_SHARE = 2  # by which the pictures beside the path tracer's are smaller still
_REFERENCE_SAMPLES = 256
_LIGHT = "D65"
_SEED = 8


@dataclass(frozen=True)
class BudgetRow:
    """One line of ``error_budget.csv``: CIEDE2000 of the pixels that show an object, with one part not true.

    ``predicted`` is the mean that the stages' own errors lead to, NaN where no stage states one; ``by`` says how.
    """

    stage: str
    mean: float
    p95: float
    p99: float
    max: float
    predicted: float
    by: str


@dataclass(frozen=True)
class Measured:
    """An object as the chain measured it, beside its truth.

    Parameters
    ----------
    material, truth : Material
        Over the same texture.
    gloss_error : (height, width, 2) float
        Standard errors of β and of μ in rad; NaN where the fit states none.
    response, variance : (height, width, bands) float
        Diffuse responses and what the camera's noise gives them; NaN where there is none.
    calibration : Calibration
    left_out : float
        Mean CIEDE2000 of the chart's patches, each left out of the calibration in turn.
    """

    material: Material
    truth: Material
    gloss_error: np.ndarray
    response: np.ndarray
    variance: np.ndarray
    calibration: Calibration
    left_out: float

    @classmethod
    def load(cls, material, truth, tiles: list, calibration) -> "Measured":
        """Read an object's files."""
        own, true = Material.load(material), Material.load(truth)
        fitted = FittedTiles(tiles, *own.alpha.shape)
        parts = [maps for _, maps in fitted.read("diffuse_response", "diffuse_variance", "beta_error", "mu_error")]
        maps = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        gloss_error = np.stack([maps["beta_error"], maps["mu_error"]], axis=-1)
        response, variance = maps["diffuse_response"], maps["diffuse_variance"]
        with store.open_file(calibration) as file:
            left_out = float(file.read(f"leave_one_out/delta_e_{_LIGHT.lower()}").mean())
        return cls(own, true, gloss_error, response, variance, Calibration.load(calibration), left_out)

    def estimate(self, covered: np.ndarray) -> Material:
        """Return the measured material as it is rendered."""
        return self.material.filled(covered)[0]


def _colours(material: Material) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients of α S / S_G and their basis."""
    return material.coefficients * material.spectrum_scale[..., None], material.basis


def _with_colours(truth: Material, parts: list[tuple[np.ndarray, np.ndarray]]) -> Material:
    """Return the true material with the sum of some spectra as its diffuse reflectance."""
    one = np.ones(truth.alpha.shape)
    coefficients = np.concatenate([np.broadcast_to(c, (*one.shape, c.shape[-1])) for c, _ in parts], axis=-1)
    basis = np.concatenate([b for _, b in parts], axis=1)
    return replace(truth, alpha=one, green_response=one, coefficients=coefficients.astype(np.float32), basis=basis)


def _paint_means(values: np.ndarray, paint: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return at every texel the mean of some values over the chosen texels of its paint, zero where none is chosen."""
    count = np.bincount(paint[chosen], minlength=paint.max() + 1)
    sums = np.stack([np.bincount(paint[chosen], v, minlength=count.size) for v in values[chosen].T], axis=-1)
    return (sums / np.maximum(count, 1)[:, None])[paint]


def substitutes(measured: Measured, covered: np.ndarray) -> dict[str, Material]:
    """Return the material with one part as it was measured and the rest true, by the stage that made the part.

    A paint's texels away from its seams tell calibration from noise: their mean colour is off by what calibration and
    fit do to all of them, what is left scatters. Texels at seams see two paints. Those that no capture determined have
    the colour of the nearest one that is.
    """
    truth, estimate = measured.truth, measured.estimate(covered)
    (own, basis), (true, true_basis) = _colours(estimate), _colours(truth)
    paint, observed = truth.coefficients.argmax(axis=-1), measured.material.observed
    inside = interior(truth) & observed
    means = _paint_means(own, paint, inside)

    def colours(at: np.ndarray, of_own: np.ndarray, of_true: np.ndarray) -> Material:
        at = at[..., None]
        return _with_colours(truth, [(np.where(at, of_own, 0.0), basis), (np.where(at, of_true, true), true_basis)])

    none = np.zeros_like(true)
    return {
        "noise": colours(inside, own - means, true),
        "calibration": colours(inside, means, none),
        "seams": colours(observed & ~inside, own, none),
        "unseen": colours(~observed, own, none),
        "gloss": replace(truth, beta=estimate.beta, mu=estimate.mu, typical_gloss=estimate.typical_gloss),
        "all": estimate,
    }


def propagated(measured: Measured, rng: np.random.Generator) -> dict[str, Material]:
    """Return the true material with a draw of the errors that the stages state, by stage: noise and gloss."""
    truth, calibration = measured.truth, measured.calibration
    known = np.isfinite(measured.variance).all(axis=-1) & np.isfinite(measured.response).all(axis=-1)
    response, variance = measured.response[known], measured.variance[known]
    drawn = response + rng.standard_normal(response.shape) * np.sqrt(variance)
    change = np.zeros((*known.shape, calibration.basis.shape[1]))
    change[known] = calibration.weights(drawn, variance) - calibration.weights(response, variance)
    stated = np.isfinite(measured.gloss_error).all(axis=-1)
    moved = rng.standard_normal((*known.shape, 2)) * np.where(stated[..., None], measured.gloss_error, 0.0)
    noisy = _with_colours(truth, [_colours(truth), (change, calibration.basis)])
    lowest = 0.5 * truth.mu  # a draw of many standard errors is no roughness
    gloss = {"beta": np.maximum(truth.beta + moved[..., 0], 0.0), "mu": np.maximum(truth.mu + moved[..., 1], lowest)}
    return {"noise": noisy, "gloss": replace(truth, **gloss)}


def _compressed(coefficients: np.ndarray, basis: np.ndarray, seen_by: dict, options: CompressOptions):
    """Return coefficients and basis after compression, and the mean colour error that it states."""
    made = analyse(coefficients, basis, seen_by, options)
    rows = made.decode(made.encode(coefficients.reshape(-1, coefficients.shape[-1])))
    stated = max(errors["mean"] for errors in made.errors.values())
    return rows.reshape(*coefficients.shape[:2], -1), made.basis, stated


def compressed_material(truth: Material, options: CompressOptions) -> tuple[Material, float]:
    """Return the true material after compression, and the mean CIEDE2000 that it states."""
    matrix = xyz_from_reflectance(_LIGHT)
    own, basis = _colours(truth)
    *kept, stated = _compressed(own.astype(np.float32), basis, {_LIGHT: (matrix, matrix.sum(axis=1))}, options)
    return _with_colours(truth, [tuple(kept)]), stated


def compressed_light(truth: Environment, options: CompressOptions) -> tuple[Environment, float]:
    """Return the true light after compression, and the mean CIEDE2000 that it states."""
    *kept, stated = _compressed(truth.coefficients, truth.basis, observers(truth.upward_white()), options)
    # The map is linear in the light: its coefficients go where those of the picture go.
    irradiance = truth.irradiance @ (np.linalg.pinv(kept[1]) @ truth.basis).T
    return Environment(kept[0], kept[1], irradiance.astype(np.float32)), stated


class _Pictures:
    """Pictures of one view from whatever materials and light, beside the true one."""

    def __init__(self, scene: dict, view: str, shapes: list[Shape], options: dict) -> None:
        scale = min(1.0, _WIDTH_PX / scene["image"]["width"])
        size = {side: max(1, round(scale * n)) for side, n in scene["image"].items()}
        self._scene, self._view, self._shapes, self._options = scene | {"image": size}, view, shapes, options

    def of(self, materials: list[Material], light: Environment) -> np.ndarray:
        """Return radiance (height, width, 61), by the scene's own integrator."""
        return render_image(self._scene, self._view, self._shapes, materials, light, self._options)[0]

    def traced(self, materials: list[Material], light: Environment, own: bool, seed: int = 0) -> np.ndarray:
        """Return a smaller picture by the scene's own integrator, or by the path tracer."""
        small = {side: max(1, n // _REFERENCE_SHARE) for side, n in self._scene["image"].items()}
        integrator = {"kind": "reference", "samples": _REFERENCE_SAMPLES, "seed": seed}
        scene = self._scene | {"image": small} | ({} if own else {"integrator": integrator})
        return render_image(scene, self._view, self._shapes, materials, light, self._options)[0]


class _Budget:
    """The rows of one view, as they are measured."""

    def __init__(self, pictures: _Pictures, objects: list[Measured], covered: list[np.ndarray], lights, white) -> None:
        self._pictures, self._truths, self._white = pictures, [one.truth for one in objects], white
        self._estimated_light, self._true_light = lights
        self._own = [substitutes(one, on) for one, on in zip(objects, covered, strict=True)]
        rng = np.random.default_rng(_SEED)
        self._drawn = [propagated(one, rng) for one in objects]
        self._true = pictures.of(self._truths, self._true_light)
        self._seen = (pictures.of(self._parts("all"), self._true_light) != self._true).any(axis=-1)
        self.rows: list[BudgetRow] = []

    def _parts(self, stage: str) -> list[Material]:
        return [parts[stage] for parts in self._own]

    def _off(self, materials: list[Material], light: Environment) -> np.ndarray:
        return radiance_delta_e(self._true, self._pictures.of(materials, light), self._white)[self._seen]

    def _add(self, stage: str, values: np.ndarray, predicted: float, by: str) -> None:
        figures = {key: value for key, value in summary(values).items() if key != "count"}
        self.rows.append(BudgetRow(stage, **figures, predicted=float(predicted), by=by))

    def add_materials(self, left_out: float) -> None:
        """Add noise, calibration, seams and gloss."""
        drawn = {
            stage: self._off([parts[stage] for parts in self._drawn], self._true_light).mean()
            for stage in ("noise", "gloss")
        }
        for stage, label, predicted, by in (
            ("noise", "RAW noise: scatter of the colour within a paint", drawn["noise"], "camera's noise, through M"),
            ("calibration", "calibration and fit: mean colour of a paint", left_out, "patches left out of the chart"),
            ("seams", "rectification: texels that see two paints", np.nan, ""),
            ("unseen", "coverage: texels filled from their neighbours", np.nan, ""),
            ("gloss", "gloss of the fit", drawn["gloss"], "standard errors of β and μ where stated"),
        ):
            self._add(stage=label, values=self._off(self._parts(stage), self._true_light), predicted=predicted, by=by)

    def add_light(self, left_out: float) -> None:
        """Add the recovered light."""
        values = self._off(self._truths, self._estimated_light)
        self._add("light", values, left_out, "patches left out of the chart")

    def add_compression(self, of_materials: CompressOptions, of_light: CompressOptions) -> None:
        """Add the compression of materials and of light."""
        made = [compressed_material(truth, of_materials) for truth in self._truths]
        materials, stated = zip(*made, strict=True)
        by = "errors that compression states, the worst object's"
        self._add("compression of the materials", self._off(list(materials), self._true_light), max(stated), by)
        light, stated = compressed_light(self._true_light, of_light)
        self._add("compression of the light", self._off(self._truths, light), stated, "error that compression states")

    def add_renderer(self) -> None:
        """Add what the integrator leaves out, against the path tracer, whose noise is what is predicted."""
        one, other = (self._pictures.traced(self._truths, self._true_light, False, seed) for seed in (0, 1))
        traced = (one.astype(np.float64) + other) / 2
        own = self._pictures.traced(self._truths, self._true_light, True)
        all_own = self._pictures.traced(self._parts("all"), self._true_light, True)
        seen = (own != all_own).any(axis=-1)
        noise = radiance_delta_e(one, other, self._white)[seen].mean() / 2
        values = radiance_delta_e(traced, own, self._white)[seen]
        self._add("renderer: what the integrator leaves out", values, noise, "noise of the path tracer, no prediction")

    def add_all(self) -> None:
        """Add everything as measured, and the root of the sum of squares of what was predicted for the parts."""
        values = self._off(self._parts("all"), self._estimated_light)
        parts = [row.predicted for row in self.rows if np.isfinite(row.predicted) and "renderer" not in row.stage]
        self._add("all but the renderer", values, np.sqrt(np.sum(np.square(parts))), "root of the sum of squares")


def error_budget(
    scene: dict,
    view: str,
    shapes: list[Shape],
    objects: list[Measured],
    lights: tuple[Environment, Environment],
    options: dict,
) -> list[BudgetRow]:
    """Return the rows of a view's budget.

    Parameters
    ----------
    scene : dict
        Validated definition.
    view : str
    shapes, objects : one an object of the scene
    lights : (Environment, Environment)
        The measured light and the true one.
    options : dict
        ``render``: of the integrator; ``compress`` and ``environment``: those keys of the configuration.
    """
    white = scene_white(scene, lights[1])[0]
    covered = [s.is_covered(*one.truth.alpha.shape[::-1]) for s, one in zip(shapes, objects, strict=True)]
    budget = _Budget(_Pictures(scene, view, shapes, options["render"]), objects, covered, lights, white)
    left_out = float(np.mean([one.left_out for one in objects]))
    wanted = [f.name for f in fields(CompressOptions)]
    of_materials, of_light = (
        CompressOptions(**{name: options[key][name] for name in wanted}) for key in ("compress", "environment")
    )
    for step in track(
        (
            lambda: budget.add_materials(left_out),
            lambda: budget.add_light(left_out),
            lambda: budget.add_compression(of_materials, of_light),
            budget.add_renderer,
            budget.add_all,
        ),
        f"error budget of {view}",
    ):
        step()
    return budget.rows


def measure_error_budget(inputs: dict, scene: dict, view: str, shapes: list[dict], options: dict, output) -> None:
    """Write ``error_budget.csv`` of a view.

    Parameters
    ----------
    inputs : dict
        Files: lists of materials, true_materials and calibrations, one an object, and ``tiles``, the fitted tiles of
        all objects; ``environment`` and ``true_environment``.
    scene, view, options : see `error_budget`
    shapes : list of dict
    output : path
    """
    objects = []
    for material, truth, calibration in zip(
        inputs["materials"], inputs["true_materials"], inputs["calibrations"], strict=True
    ):
        folder = Path(material).parent
        tiles = [path for path in inputs["tiles"] if folder in Path(path).parents]
        objects.append(Measured.load(material, truth, tiles, calibration))
    lights = Environment.load(inputs["environment"]), Environment.load(inputs["true_environment"])
    rows = error_budget(scene, view, [Shape.from_definition(s) for s in shapes], objects, lights, options)
    with written_whole(output) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [f.name for f in fields(BudgetRow)])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in asdict(row).items()})
            LOGGER.info("%s: mean %.3f p95 %.3f, predicted %.3f", row.stage, row.mean, row.p95, row.predicted)


def read_budget(path) -> list[BudgetRow]:
    """Return the rows of a budget's file."""
    with open(path, newline="", encoding="utf-8") as stream:
        return [BudgetRow(**{f.name: f.type(row[f.name]) for f in fields(BudgetRow)}) for row in csv.DictReader(stream)]
