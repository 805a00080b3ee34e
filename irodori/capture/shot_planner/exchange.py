"""Selection of K observations with the largest joint information: greedy, then Fedorov's exchange.

A *design* is a set of poses. It is judged by the precision matrix P of (ln α, ln β, ln μ) of each case, prior included:
minus the trace of P⁻¹, the sum of the relative variances, as a mean over the cases. P is the Fisher information, or,
for texels in patches, that where the texels of a patch share β and μ, as the places of one paint do. In patches, only
texels with enough photographs for a fit tell anything of β and μ; a patch may be a single texel.

Fisher information grows by a matrix of rank one with each observation, so that a candidate is judged without a new
inversion (the matrix determinant lemma; Sherman and Morrison).
"""

import numba
import numpy as np

from irodori.capture.shot_planner.fisher_information import PARAMETERS, Observations
from irodori.jit.compilation import njit

_MIN_GAIN = 1e-9
_MAX_PASSES = 20
_SETTINGS_TRIED = 4


class TooFewPoses(ValueError):
    """Error for a rig that has fewer poses than a design requires."""


@njit(cache=True)
def _adjugate(a):
    """Return determinant and adjugate of a symmetric 3 x 3 matrix, given as its elements 00, 01, 02, 11, 12, 22."""
    c00 = a[3] * a[5] - a[4] * a[4]
    c01 = a[2] * a[4] - a[1] * a[5]
    c02 = a[1] * a[4] - a[2] * a[3]
    determinant = a[0] * c00 + a[1] * c01 + a[2] * c02
    c11 = a[0] * a[5] - a[2] * a[2]
    c12 = a[1] * a[2] - a[0] * a[4]
    c22 = a[0] * a[3] - a[1] * a[1]
    return determinant, (c00, c01, c02, c11, c12, c22)


@njit(cache=True)
def _with_row(a, row, weight):
    """Return a symmetric matrix (six elements) plus the weighted outer product of a row with itself."""
    x, y, z = row[0], row[1], row[2]
    return (
        a[0] + weight * x * x,
        a[1] + weight * x * y,
        a[2] + weight * x * z,
        a[3] + weight * y * y,
        a[4] + weight * y * z,
        a[5] + weight * z * z,
    )


@njit(cache=True, error_model="numpy")
def _score(precision):
    determinant, adjugate = _adjugate(precision)
    return -(adjugate[0] + adjugate[3] + adjugate[5]) / determinant


@njit(cache=True)
def _six(a):
    return (a[0], a[1], a[2], a[3], a[4], a[5])


@njit(cache=True)
def _judge_fisher(jacobian, variance, state):
    total = 0.0
    for c in range(variance.size):
        precision = _six(state[c])
        if variance[c] < np.inf:
            precision = _with_row(precision, jacobian[c], 1.0 / variance[c])
        total += _score(precision)
    return total / variance.size


@njit(cache=True, error_model="numpy")
def _judge_paints(jacobian, variance, state, prior, patch):
    """Return minus the mean sum of variances where the texels of a patch share β and μ, and each has its own α.

    What a patch tells of β and μ is the mean over its texels and not the sum: the error of the lamp in a photograph is
    the same in all of them. Only texels with enough photographs for a fit of their own tell, as the fit finds paints by
    the colours of such texels.
    """
    materials, texels = variance.size // patch.size, patch.size
    patches, total = patch.max() + 1, 0.0
    shared, count, seen = np.empty((patches, 3)), np.zeros(patches), np.empty((texels, 6))
    for t in range(texels):
        count[patch[t]] += 1.0
    for m in range(materials):
        shared[:] = 0.0
        for t in range(texels):
            c = t * materials + m
            p = _six(state[c])
            if variance[c] < np.inf:
                p = _with_row(p, jacobian[c], 1.0 / variance[c])
            for k in range(6):
                seen[t, k] = p[k]
            if state[c, 6] + (1.0 if variance[c] < np.inf else 0.0) <= PARAMETERS:
                continue
            shared[patch[t], 0] += (p[3] - prior[3] - p[1] * p[1] / p[0]) / count[patch[t]]
            shared[patch[t], 1] += (p[4] - p[1] * p[2] / p[0]) / count[patch[t]]
            shared[patch[t], 2] += (p[5] - prior[5] - p[2] * p[2] / p[0]) / count[patch[t]]
        for t in range(texels):
            beta, both, mu = shared[patch[t], 0] + prior[3], shared[patch[t], 1], shared[patch[t], 2] + prior[5]
            determinant = beta * mu - both * both
            of_beta, of_mu = seen[t, 1] / seen[t, 0], seen[t, 2] / seen[t, 0]
            total -= 1.0 / seen[t, 0] + (beta + mu) / determinant
            total -= (of_beta * of_beta * mu - 2.0 * of_beta * of_mu * both + of_mu * of_mu * beta) / determinant
    return total / variance.size


@njit(cache=True, parallel=True, nogil=True)
def _judge_all_paints(seen, state, prior, allowed, patch, out):
    for p in numba.prange(allowed.size):
        out[p] = _judge_paints(seen[0][p], seen[1][p], state, prior, patch) if allowed[p] else -np.inf


@njit(cache=True, parallel=True, nogil=True)
def _judge_all(seen, state, allowed, out):
    """Fill out with the variance of the design plus each candidate."""
    for p in numba.prange(allowed.size):
        out[p] = _judge_fisher(seen[0][p], seen[1][p], state) if allowed[p] else -np.inf


_UPPER = np.triu_indices(PARAMETERS)


class Selection:
    """Search for the best design among candidate poses.

    Parameters
    ----------
    seen : Observations
        Expected observations of each case in each candidate pose.
    prior : float
        Precision of each parameter before the first observation, above 0.
    setting : (candidates,) int
        Number of each candidate's settings by hand; candidates with equal numbers need no change by hand in between.
    max_manual : int
        Largest number of different settings by hand in a design.
    patch : (texels,) int, optional
        Number of the patch of the surface to which each texel belongs, if the texels of a patch share β and μ.
    """

    def __init__(self, seen: Observations, prior: float, setting, max_manual: int, patch=None) -> None:
        self.seen = Observations(*(np.ascontiguousarray(values) for values in seen))
        self.prior = tuple(prior * np.eye(PARAMETERS)[_UPPER])
        self.setting = np.asarray(setting)
        self.max_manual = max_manual
        self.patch = None if patch is None else np.asarray(patch, dtype=np.int64)

    def _state(self, chosen: list[int]) -> np.ndarray:
        """Return the Fisher information of a design plus the prior, and the observations, (cases, 7)."""
        jacobian, variance = self.seen.jacobian[chosen], self.seen.variance[chosen]
        information = np.einsum("pc,pci,pcj->cij", 1.0 / variance, jacobian, jacobian)[:, *_UPPER]
        return np.column_stack([information + self.prior, np.isfinite(variance).sum(axis=0)])

    def value(self, chosen: list[int]) -> float:
        """Return the criterion of a design."""
        jacobian, variance, *_ = self.seen
        nothing, state = np.full(variance.shape[1], np.inf), self._state(list(chosen))
        if self.patch is None:
            return _judge_fisher(jacobian[0], nothing, state)
        return _judge_paints(jacobian[0], nothing, state, self.prior, self.patch)

    def _additions(self, chosen: list[int]) -> np.ndarray:
        """Return the criterion with each candidate added, (candidates,); minus infinity if it may not be added."""
        allowed = np.ones(len(self.seen.variance), dtype=np.bool_)
        allowed[chosen] = False
        used = np.unique(self.setting[chosen]) if chosen else np.empty(0, dtype=int)
        if len(used) >= self.max_manual:
            allowed &= np.isin(self.setting, used)
        if not allowed.any():
            raise TooFewPoses(
                f"more than {len(chosen)} poses in {self.max_manual} manual settings; accepted: as many as the rig has"
            )
        out = np.empty(len(allowed))
        if self.patch is not None:
            _judge_all_paints(self.seen, self._state(chosen), self.prior, allowed, self.patch, out)
        else:
            _judge_all(self.seen, self._state(chosen), allowed, out)
        return out

    def _fill(self, chosen: list[int], count: int) -> tuple[list[int], float]:
        """Return a design extended to `count` candidates by the best additions, the first of equals; and its value."""
        chosen = list(chosen)
        while len(chosen) < count:
            chosen.append(int(np.argmax(self._additions(chosen))))
        return chosen, self.value(chosen)

    def greedy(self, count: int) -> list[int]:
        """Return a design of `count` candidates, each the best addition to those before it."""
        return self._fill([], count)[0]

    def improve(self, chosen: list[int]) -> list[int]:
        """Return a design of the same size that none of the tried exchanges improves.

        Tried are exchanges of each candidate for any other, and of all candidates with one setting by hand for
        candidates with the most promising other settings.
        """
        best, value = list(chosen), self.value(chosen)
        for _ in range(_MAX_PASSES):
            before = value
            for leave in [{index} for index in best] + self._by_setting(best):
                if not leave <= set(best):
                    continue
                kept = [index for index in best if index not in leave]
                for start in self._starts(kept) if len(leave) > 1 else [kept]:
                    try:
                        trial, gained = self._fill(start, len(best))
                    except TooFewPoses:  # this setting has fewer candidates than the removed one
                        continue
                    if gained > value + _MIN_GAIN:
                        best, value = trial, gained
            if value <= before + _MIN_GAIN:
                break
        return best

    def _by_setting(self, chosen: list[int]) -> list[set[int]]:
        groups: dict[int, set[int]] = {}
        for index in chosen:
            groups.setdefault(int(self.setting[index]), set()).add(index)
        return list(groups.values())

    def _starts(self, kept: list[int]) -> list[list[int]]:
        """Return designs with one candidate more: the best one of each of the most promising settings by hand."""
        additions = self._additions(kept)
        starts: dict[int, list[int]] = {}
        for index in np.argsort(-additions, kind="stable"):
            if additions[index] == -np.inf or len(starts) == _SETTINGS_TRIED:
                break
            starts.setdefault(int(self.setting[index]), [*kept, int(index)])
        return list(starts.values())


def choose(seen: Observations, prior: float, setting, count: int, max_manual: int, patch=None) -> list[int]:
    """Return the indices of `count` candidates, none twice; parameters as in `Selection`.

    The method is greedy forward selection by the information of each texel alone, the only criterion that is defined
    for fewer than four observations, followed by exchanges; then by exchanges of what the patches share.

    Raises
    ------
    TooFewPoses
        If there are fewer candidates than `count` within `max_manual` settings.
    """
    fisher = Selection(seen, prior, setting, max_manual)
    start = fisher.improve(fisher.greedy(count))
    return start if patch is None else Selection(seen, prior, setting, max_manual, patch).improve(start)
