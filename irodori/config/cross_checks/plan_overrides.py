"""Checks of a scene's tolerance and plan overrides against its integrator."""

from irodori.core.errors import InputError

#: Overrides that each integrator's plan knows.
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


def check_plan(scene: dict, file) -> None:
    """Refuse overrides that nothing reads.

    Raises
    ------
    InputError
    """
    kind = scene["integrator"]["kind"]
    if "tolerance_ciede2000" not in scene:
        if scene["plan"]:
            raise InputError(file, "plan", "overrides of a plan", "tolerance_ciede2000 beside them, or no plan")
        return
    for key in scene["plan"]:
        if key not in _OF[kind]:
            raise InputError(file, f"plan.{key}", f"an override for the integrator {kind}", ", ".join(_OF[kind]))
    nodes, representation = scene["plan"].get("nodes"), scene["plan"].get("representation")
    if nodes is not None and representation not in (None, "quadrature"):
        raise InputError(file, "plan.nodes", f"{nodes} of {representation}", "representation: quadrature, or no nodes")
