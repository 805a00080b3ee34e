"""Checks of a scene's tolerance and plan overrides against its integrator."""

from irodori.config.models import Scene
from irodori.core.errors import InputError

#: Overrides that the plan of each integrator supports.
_OF = {
    "interactive": (
        "gloss",
        "mirror",
        "max_bounces",
        "least_throughput",
        "light_bases",
        "representation",
        "nodes",
        "environment_halvings",
        "texture_halvings",
    ),
    "reference": ("samples",),
}


def check_plan(scene: Scene, file) -> None:
    """Refuse overrides that have no effect with the scene's integrator, or without a tolerance.

    Raises
    ------
    InputError
    """
    kind, given = scene.integrator.kind, scene.plan.given()
    if scene.tolerance_ciede2000 is None:
        if given:
            raise InputError(file, "plan", "overrides of a plan", "tolerance_ciede2000 beside them, or no plan")
        return
    for key in given:
        if key not in _OF[kind]:
            raise InputError(file, f"plan.{key}", f"an override for the integrator {kind}", ", ".join(_OF[kind]))
    nodes, representation = scene.plan.nodes, scene.plan.representation
    if nodes is not None and representation not in (None, "quadrature"):
        raise InputError(file, "plan.nodes", f"{nodes} of {representation}", "representation: quadrature, or no nodes")
