"""Reading and writing of ``plan.yaml``: decisions, reasons and predicted costs."""

from dataclasses import asdict, replace

import numpy as np
import yaml

from irodori.core.atomic_files import written_whole
from irodori.rendering.interactive.quadrature import Quadrature
from irodori.rendering.planning.modelled_scene import Model, memory_mb, widths_of
from irodori.rendering.planning.scene_plan import ScenePlan
from irodori.rendering.planning.scene_planner import Decision, ScenePlanner
from irodori.rendering.planning.tolerance import SHARE

#: Significant digits of predictions, because the last bits of a sum depend on the library.
_DIGITS = 4
#: Decisions that are fields of `Model` without conversion.
_PLAIN = (
    "max_bounces",
    "least_throughput",
    "light_bases",
    "representation",
    "nodes",
    "environment_halvings",
    "environment",
    "irradiance",
)


def rounded(value, digits: int = _DIGITS):
    """Convert a value to plain numbers, lists and dictionaries, floats rounded to ``digits`` significant digits."""
    if isinstance(value, dict):
        return {str(key): rounded(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [rounded(item, digits) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.{digits}g}")
    return value.item() if isinstance(value, np.generic) else value


def cost_of(planner: ScenePlanner, model: Model, side: int) -> dict[str, float]:
    """Return the predicted cost of a model: numbers multiplied and added per pixel, rays per pixel, and memory."""
    rays = side**2
    met = planner.met(model)
    return {
        "numbers_per_pixel": rays * planner.numbers(model),
        "rays_per_pixel": rays * met["rays"],
        "memory_mb": memory_mb(planner.parts, model, widths_of(planner.parts, model)),
    }


def document_of(scene_name: str, planner: ScenePlanner, side: int) -> dict:
    """Return the content of the plan's file.

    Parameters
    ----------
    scene_name : str
    planner : ScenePlanner
        Planner that `irodori.rendering.planning.choices.choose` returned.
    side : int
        Number of rays along each side of a pixel.
    """
    decisions = {name: decision_block(decision) for name, decision in planner.decisions.items()}
    document = {
        "scene": scene_name,
        "integrator": "interactive",
        "tolerance_ciede2000": planner.tolerance,
        "pixels_within": SHARE,
        "predicted_delta_e": rounded(max(planner.spent, planner.joint)),
        "predicted_delta_e_together": rounded(planner.joint),
        "probes": planner.probes.count,
        "cost": rounded(cost_of(planner, planner.model, side)),
        "cost_of_full_model": rounded(cost_of(planner, planner.full, side)),
        "decisions": decisions,
    }
    if planner.model.quadrature is not None:
        document["quadrature"] = {
            "samples": planner.model.quadrature.samples.tolist(),
            "xyz_weights": rounded(planner.model.quadrature.weights, 9),
        }
    return document


def decision_block(decision: Decision) -> dict:
    """Return a decision in the form of the plan's file."""
    return rounded({key: value for key, value in asdict(decision).items() if value is not None})


def model_of(plan: ScenePlan, full: Model, names: list[str]) -> Model:
    """Return the model that a plan describes.

    Parameters
    ----------
    plan : ScenePlan
    full : Model
        Full model of the scene.
    names : list of str
        Names of the objects, see `irodori.rendering.scene_arrays.row_names`.
    """
    values, found = plan.decisions, plan.quadrature
    quadrature = None
    if found is not None:
        quadrature = Quadrature(np.array(found["samples"]), np.array(found["xyz_weights"]), np.nan, np.nan)
    return replace(
        full,
        gloss=tuple(name in values["gloss"] for name in names),
        mirror=tuple(name in values["mirror"] for name in names),
        texture_halvings=tuple(values["texture_halvings"][name] for name in names),
        gloss_levels=tuple(values["gloss_levels"]),
        quadrature=quadrature,
        **{name: values[name] for name in _PLAIN},
    )


def write_plan(path, document: dict) -> None:
    """Write a plan to a YAML file, replacing the file only when complete."""
    text = yaml.safe_dump(document, sort_keys=False, width=120, allow_unicode=True)
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
