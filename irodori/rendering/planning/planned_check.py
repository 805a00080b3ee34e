"""Check of a picture that was rendered by a plan, at random pixels, against the full model."""

from dataclasses import dataclass

import numpy as np

from irodori.colour.colorimetry import delta_e_xyz, summary
from irodori.core.errors import PlainError
from irodori.rendering.planning.scene_plan import ScenePlan
from irodori.rendering.planning.tolerance import SHARE
from irodori.rendering.reference.distance import Distance
from irodori.rendering.scene_arrays import View

#: Number of pixels computed with the full model, and their seed, which differs from that of the probes.
PIXELS, SEED = 3000, 2


class ToleranceError(PlainError):
    """Raised if the error of a picture exceeds the tolerance of its scene."""


@dataclass(frozen=True)
class PixelDifferences:
    """Statistics of CIEDE2000 between pixels of a picture and of the full model."""

    count: int
    mean: float
    p95: float
    p99: float
    max: float


def chosen_pixels(view: View, count: int = PIXELS, seed: int = SEED) -> np.ndarray:
    """Return columns and rows of distinct random pixels, (n, 2); all pixels if the picture has fewer than ``count``."""
    size = view.width * view.height
    place = np.random.default_rng(seed).choice(size, min(count, size), replace=False)
    return np.stack([place % view.width, place // view.width], axis=1)


def measure(planned: np.ndarray, full: np.ndarray, white_xyz: np.ndarray) -> PixelDifferences:
    """Return statistics of CIEDE2000 between pixels of a picture and of the full model, (n, 3) XYZ each."""
    found = summary(delta_e_xyz(full, planned, white_xyz))
    return PixelDifferences(int(found["count"]), found["mean"], found["p95"], found["p99"], found["max"])


def refuse_above(measured: PixelDifferences, plan: ScenePlan, view: str) -> None:
    """Raise an error if a picture's pixels differ from the full model by more than the plan's tolerance.

    Parameters
    ----------
    measured : PixelDifferences
    plan : ScenePlan
    view : str

    Raises
    ------
    ToleranceError
    """
    if not measured.p99 <= plan.tolerance_ciede2000:
        raise ToleranceError(
            f"scene {plan.scene!r}, view {view!r}: {100 * SHARE:.0f} of 100 pixels differ from the full model by up "
            f"to {measured.p99:.3g} ΔE2000 by {measured.count} pixels computed in full (mean {measured.mean:.3g}, "
            f"largest {measured.max:.3g}); tolerated: {plan.tolerance_ciede2000:g}; the plan predicted "
            f"{plan.predicted_delta_e:.3g}; raise tolerance_ciede2000, or take overrides under `plan` back."
        )


def refuse_far(found: Distance, plan: ScenePlan, view: str) -> None:
    """Raise an error if a picture is further from the path-traced one than the plan's tolerance.

    Parameters
    ----------
    found : Distance
    plan : ScenePlan
    view : str

    Raises
    ------
    ToleranceError
    """
    if not found.p99 <= plan.tolerance_ciede2000:
        if plan.integrator == "reference":
            mend = "the samples of the integrator and of `plan`"
        else:
            mend = "use the integrator reference"
        raise ToleranceError(
            f"scene {plan.scene!r}, view {view!r}: {100 * SHARE:.0f} of 100 pixels of objects differ from path "
            f"tracing by up to {found.p99:.3g} ± {found.standard_error_of_p99:.2g} ΔE2000 by {found.count} pixels of "
            f"{found.paths} paths (mean {found.mean:.3g}); tolerated: {plan.tolerance_ciede2000:g}; raise "
            f"tolerance_ciede2000, or {mend}."
        )
