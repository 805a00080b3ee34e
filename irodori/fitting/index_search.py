"""Search for the real refractive index n, using any solver for α, β and μ.

The least sum of squares over (α, β, μ) is a function of n alone. It is evaluated on a grid, and its minimum is refined
by parabolas through three points, for all texels at once.
"""

from dataclasses import dataclass

import numpy as np

from irodori.fitting import judge
from irodori.fitting.texels import Output

_NODES = 9
_REFINEMENTS = 4
#: Standard error of n beyond which n counts as not determined and the given n is used.
_MAX_ERROR = 0.1


@dataclass(frozen=True)
class IndexFit:
    """Result of the search: output of the solver at the n of each texel, n (NaN if not determined), and its error."""

    output: Output
    index: np.ndarray
    error: np.ndarray


def _pick(outputs: list[Output], which: np.ndarray) -> Output:
    rows = np.arange(len(which))
    return Output(*(np.stack(fields)[which, rows] for fields in zip(*outputs, strict=True)))


def _sorted(n: np.ndarray, outputs: list[Output]) -> tuple[np.ndarray, list[Output]]:
    order = np.argsort(n, axis=0)
    return np.take_along_axis(n, order, axis=0), [_pick(outputs, o) for o in order]


def _parabola(n: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the minimum n and the curvature, (texels,) each, of parabolas through three points, (3, texels)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        left, right = (value[1] - value[0]) / (n[1] - n[0]), (value[2] - value[1]) / (n[2] - n[1])
        curvature = 2.0 * (right - left) / (n[2] - n[0])
        place = 0.5 * (n[0] + n[1]) - left / curvature
    return place, curvature


def fit_index(solve, errors_at, texels: int, limits: tuple[float, float], nominal: np.ndarray) -> IndexFit:
    """Fit the real refractive index n of each texel.

    Parameters
    ----------
    solve : callable
        Function from n, (texels,) float64, to the `Output` of a fit of α, β and μ.
    errors_at : callable
        Function from n, (texels,), and α, β, log μ, (texels, 3), to the standard errors of α, β, log μ, n, (texels, 4).
    texels : int
        Number of texels.
    limits : (float, float)
        Bounds of n.
    nominal : (texels,) or (1,) float64
        n to use where the data do not determine it.
    """
    grid = np.geomspace(*limits, _NODES)
    outputs = [solve(np.full(texels, n)) for n in grid]
    squares = np.nan_to_num(np.stack([o.table[:, judge.SQUARES] for o in outputs]), nan=np.inf)
    middle = np.clip(squares.argmin(axis=0), 1, _NODES - 2)
    n = np.stack([grid[middle - 1], grid[middle], grid[middle + 1]])
    three = [_pick(outputs, middle + i) for i in (-1, 0, 1)]
    evaluations = np.sum([o.evaluations for o in outputs], axis=0)
    for _ in range(_REFINEMENTS):
        value = np.stack([o.table[:, judge.SQUARES] for o in three])
        place, curvature = _parabola(n, value)
        # Keep a distance to known points: otherwise the next parabola would lose numerical precision.
        gap = 1e-3 * (n[2] - n[0])
        beside = np.where(n[2] - n[1] > n[1] - n[0], n[1] + gap, n[1] - gap)
        usable = np.isfinite(place) & (curvature > 0) & (place > n[0] + gap) & (place < n[2] - gap)
        usable &= np.abs(place - n[1]) > gap
        trial = np.where(usable, place, np.clip(beside, *limits))
        outcome = solve(trial)
        evaluations = evaluations + outcome.evaluations
        four, outputs = _sorted(np.concatenate([n, trial[None]]), [*three, outcome])
        value = np.nan_to_num(np.stack([o.table[:, judge.SQUARES] for o in outputs]), nan=np.inf)
        middle = np.clip(value.argmin(axis=0), 1, 2)
        rows = np.arange(texels)
        n = np.stack([four[middle + i, rows] for i in (-1, 0, 1)])
        three = [_pick(outputs, middle + i) for i in (-1, 0, 1)]
    return _conclude(n, three, solve, errors_at, limits=limits, nominal=nominal, evaluations=evaluations)


def _conclude(n, three, solve, errors_at, *, limits, nominal, evaluations) -> IndexFit:
    """Return n where it is determined, with the errors of four unknowns, and the fit with the nominal n elsewhere."""
    value = np.stack([o.table[:, judge.SQUARES] for o in three])
    best = np.nan_to_num(value, nan=np.inf).argmin(axis=0)
    _, curvature = _parabola(n, value)
    found, index = _pick(three, best), n[best, np.arange(n.shape[1])]
    columns = [judge.ALPHA, judge.BETA, judge.LOG_MU]
    errors = errors_at(index, found.table[:, columns])
    inside = (index > limits[0] * (1 + 1e-3)) & (index < limits[1] * (1 - 1e-3))
    known = inside & (curvature > 0) & (errors[:, 3] < _MAX_ERROR) & (found.status == judge.Status.OK)
    found.table[:, [judge.ALPHA_ERROR, judge.BETA_ERROR, judge.LOG_MU_ERROR]] = errors[:, :3]
    stated = errors[:, 1] < judge.MAX_RELATIVE_ERROR["beta"] * found.table[:, judge.BETA]
    stated &= errors[:, 2] < judge.MAX_RELATIVE_ERROR["mu"]
    found.status[known & ~stated] = judge.Status.MU_UNIDENTIFIABLE
    given = solve(np.broadcast_to(nominal, n.shape[1]).copy())
    output = _pick([given, found], known.astype(int))
    output.evaluations[:] = evaluations + given.evaluations
    return IndexFit(output, np.where(known, index, np.nan), np.where(known, errors[:, 3], np.nan))
