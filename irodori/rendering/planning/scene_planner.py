"""State of the planner: decisions so far, their colour error on the probes, and their cost."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import PlanOverrides
from irodori.rendering.interactive.quadrature import Quadrature
from irodori.rendering.planning.modelled_scene import Model, SceneParts, look_up_numbers, solved_nodes, widths_of
from irodori.rendering.planning.probes import Changes, Probes
from irodori.rendering.planning.tolerance import bound_of_share, differences
from irodori.rendering.scene_arrays import Light

#: Probes of a view, and the seed of their places; pixels that are checked have another.
PROBES, SEED = 2000, 1
#: Views with so many probes; more of them share these.
MOST_VIEWS = 4
#: Decisions that may cost colour.
_LOSSY = 8


@dataclass(frozen=True)
class Decision:
    """One decision of a plan.

    Parameters
    ----------
    value, full
        What is modelled, and what the full model has.
    predicted_delta_e : float
        CIEDE2000 that this decision alone costs at most, see `irodori.rendering.planning.choices.choose`.
    numbers_per_ray : float
        Numbers that are multiplied and added for a ray of the eye with this decision and those before it.
    by : str
        ``plan`` or ``scene``, whose file overrides the plan.
    why : str
    """

    value: object
    full: object
    predicted_delta_e: float
    numbers_per_ray: float
    by: str
    why: str


@dataclass
class ScenePlanner:
    """The state of planning: what is decided, by the plan or ``by_scene``, and what it costs."""

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
        """Return CIEDE2000 of every probe of the picture with changes."""
        return self.differences(self.probes.radiance(changes), xyz)

    def differences(self, radiance: np.ndarray, xyz: Callable | None = None) -> np.ndarray:
        """Return CIEDE2000 of every probe of a picture, (count, 61) radiance."""
        found = (xyz or (lambda spectra: spectra @ self.matrix.T))(radiance)
        return differences(self.truth, found, self.white_xyz)

    def bound(self, errors: np.ndarray) -> float:
        """Return the bound of the share of pixels in the view where it is largest: each picture is checked alone."""
        views = self.probes.views
        return max(bound_of_share(errors[view::views]) for view in range(min(views, len(errors))))

    def showing(self, radiance: np.ndarray) -> np.ndarray:
        """Return which probes of a picture, (count, 61), differ from the full one at all, (count,) bool."""
        return (radiance != self.seen).any(axis=1)

    def bound_where(self, chosen: np.ndarray, radiance: np.ndarray) -> float:
        """Return the bound of the share among chosen probes, so that what is small in the picture counts too."""
        return bound_of_share(self.differences(radiance)[chosen]) if chosen.any() else 0.0

    def solve(self, nodes: int) -> Quadrature:
        """Return the quadrature of a number of wavelengths for the paths of the model."""
        if nodes not in self.solved:
            self.solved[nodes] = solved_nodes(self.parts, self.model.max_bounces, self.matrix, nodes)
        return self.solved[nodes]

    def fits(self, alone: float, changes: Changes, xyz: Callable | None = None) -> bool:
        """Return whether a decision keeps under its share, and all together under the tolerance."""
        if alone > (self.tolerance - self.spent) / self.left:
            return False
        return self.bound(self.errors(changes, xyz or self.xyz)) <= self.tolerance

    def decide(self, name: str, alone: float, changes: Changes, why: str, lossy: bool = True, **model) -> None:
        """Note a decision."""
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
        """Return what a ray of the eye meets: surfaces, glossy ones, the environment, and rays traced."""
        model = model or self.model

        def without(before, after) -> frozenset:
            return frozenset(i for i, (a, b) in enumerate(zip(before, after, strict=True)) if a and not b)

        limits = model.max_bounces, model.least_throughput
        left = without(self.full.gloss, model.gloss), without(self.full.mirror, model.mirror)
        return self.probes.met(Changes(*limits, *left))

    def numbers(self, model: Model | None = None) -> float:
        """Return the numbers that a ray of the eye costs."""
        model = model or self.model
        return look_up_numbers(model, widths_of(self.parts, model), self.met(model), len(self.names))
