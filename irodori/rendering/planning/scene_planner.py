"""State of the planner: decisions so far, their colour errors at the probes, and their work."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from irodori.colour.colorimetry import delta_e_xyz, xyz_from_radiance
from irodori.config.models import PlanOverrides
from irodori.rendering.interactive.quadrature import Quadrature
from irodori.rendering.planning.modelled_scene import Model, SceneParts, look_up_numbers, solved_nodes, widths_of
from irodori.rendering.planning.probes import Changes, Probes
from irodori.rendering.planning.tolerance import bound_of_share
from irodori.rendering.scene_arrays import Light

#: Number of probes per view, and the seed of their points, which differs from that of the checked pixels.
PROBES, SEED = 2000, 1
#: Largest number of views for which the number of probes grows; more views share the same total.
MOST_VIEWS = 4
#: Number of decisions that may cause a colour error.
_LOSSY = 8


@dataclass(frozen=True)
class Decision:
    """One decision of a plan.

    Parameters
    ----------
    value, full
        Chosen value, and value in the full model.
    predicted_delta_e : float
        Upper bound of the error of this decision alone, CIEDE2000, see `irodori.rendering.planning.choices.choose`.
    numbers_per_ray : float
        Numbers that are multiplied and added per ray from the eye with this decision and all before it.
    by : str
        ``plan``, or ``scene`` if the scene's definition states the value.
    why : str
        Reason.
    """

    value: object
    full: object
    predicted_delta_e: float
    numbers_per_ray: float
    by: str
    why: str


@dataclass
class ScenePlanner:
    """State of planning: model and decisions so far, remaining tolerance, and the probes that measure errors."""

    parts: SceneParts
    probes: Probes
    model: Model
    tolerance: float
    names: list[str]
    overrides: PlanOverrides
    ladder: Light
    where: str = "scene"
    changes: Changes = field(default_factory=Changes)
    decisions: dict[str, Decision] = field(default_factory=dict)
    left: int = _LOSSY
    spent: float = 0.0
    joint: float = 0.0
    xyz: Callable | None = None
    by_scene: set[str] = field(default_factory=set)
    solved: dict[int, Quadrature] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.by_scene |= self.overrides.given().keys()
        self.full, self.matrix = self.model, xyz_from_radiance(self.parts.white)
        self.white_xyz = self.matrix @ self.parts.white
        self.seen = self.probes.radiance()
        self.truth = self.seen @ self.matrix.T
        self.xyz = lambda spectra: spectra @ self.matrix.T

    def errors(self, changes: Changes, xyz: Callable | None = None) -> np.ndarray:
        """Render all probes with changes and return CIEDE2000 of each to the full model, (count,)."""
        return self.differences(self.probes.radiance(changes), xyz)

    def differences(self, radiance: np.ndarray, xyz: Callable | None = None) -> np.ndarray:
        """Return CIEDE2000 of the probes' radiance, (count, 61), to that of the full model, (count,)."""
        found = (xyz or (lambda spectra: spectra @ self.matrix.T))(radiance)
        return delta_e_xyz(self.truth, found, self.white_xyz)

    def bound(self, errors: np.ndarray) -> float:
        """Return the largest error bound of any view, see `bound_of_share`, because each picture is checked alone."""
        views = self.probes.views
        return max(bound_of_share(errors[view::views]) for view in range(min(views, len(errors))))

    def showing(self, radiance: np.ndarray) -> np.ndarray:
        """Return a mask of the probes whose radiance, (count, 61), differs from the full model at all, (count,)."""
        return (radiance != self.seen).any(axis=1)

    def bound_where(self, chosen: np.ndarray, radiance: np.ndarray) -> float:
        """Return the error bound over selected probes only, so that objects that are small in the picture count too."""
        return bound_of_share(self.differences(radiance)[chosen]) if chosen.any() else 0.0

    def solve(self, nodes: int) -> Quadrature:
        """Return the quadrature of ``nodes`` wavelengths for the paths of the model, solved once."""
        if nodes not in self.solved:
            self.solved[nodes] = solved_nodes(self.parts, self.model.max_bounces, self.matrix, nodes)
        return self.solved[nodes]

    def fits(self, alone: float, changes: Changes, xyz: Callable | None = None) -> bool:
        """Return whether a decision's own error is within its share, and that of all decisions within the tolerance."""
        if alone > (self.tolerance - self.spent) / self.left:
            return False
        return self.bound(self.errors(changes, xyz or self.xyz)) <= self.tolerance

    def decide(self, name: str, alone: float, changes: Changes, why: str, lossy: bool = True, **model) -> None:
        """Record a decision: change the model, subtract its error from the tolerance and note the reason."""
        before = {key: getattr(self.full, key) for key in model}
        self.model, self.changes = replace(self.model, **model), changes
        value, full = (self._named(name, next(iter(d.values()))) for d in (model, before))
        self.spent += alone
        self.left -= int(lossy)
        by = "scene" if name in self.by_scene else "plan"
        self.decisions[name] = Decision(value, full, alone, self.numbers(), by, why)

    def _named(self, name: str, value):
        if name in ("gloss", "mirror"):
            return [n for n, traced in zip(self.names, value, strict=True) if traced]
        if name == "texture_halvings":
            return dict(zip(self.names, value, strict=True))
        return list(value) if isinstance(value, tuple) else value

    def met(self, model: Model | None = None) -> dict[str, float]:
        """Return the mean numbers of hits, glossy hits, misses and traced rays per ray from the eye in a model."""
        model = model or self.model

        def without(before, after) -> frozenset:
            return frozenset(i for i, (a, b) in enumerate(zip(before, after, strict=True)) if a and not b)

        limits = model.max_bounces, model.least_throughput
        left = without(self.full.gloss, model.gloss), without(self.full.mirror, model.mirror)
        return self.probes.met(Changes(*limits, *left))

    def numbers(self, model: Model | None = None) -> float:
        """Return how many numbers are multiplied and added per ray from the eye in a model."""
        model = model or self.model
        return look_up_numbers(model, widths_of(self.parts, model), self.met(model), self.parts.maps is not None)
