"""Selection of K observations with the largest joint information: greedy, then Fedorov's exchange.

A *design* is a set of poses. It is judged by the precision matrix P of (ln α, ln β, ln μ) of each case, prior included;
every criterion is a mean over the cases, larger for a better design:

``variance``        minus the trace of P⁻¹, where P is the Fisher information: the sum of the relative variances
``fit-variance``    the same for the precision that the fit reaches with its own weights
``paint-variance``  the same as ``variance`` where the texels of a patch share β and μ, as the places of one paint do

Fisher information grows by a matrix of rank one with each observation, so that a candidate is judged without a new
inversion (the matrix determinant lemma; Sherman and Morrison). The precision of the fit, N (Σ w² v J Jᵀ)⁻¹ N with
N = Σ w J Jᵀ, is computed anew for each candidate; a further observation can decrease it if its weight is too large.
"""

import numba
import numpy as np

from irodori.capture.shot_planner.fisher_information import PARAMETERS, Observations
from irodori.jit.compilation import njit

CRITERIA = ("variance", "fit-variance", "paint-variance")
_MIN_GAIN = 1e-9
_MAX_PASSES = 20
_SETTINGS_TRIED = 4
_SINGULAR = 1e-10  # determinant over the product of the diagonal


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
def _times(a, x, y, z):
    """Return the product of a symmetric matrix (six elements) and the column x, y, z."""
    return a[0] * x + a[1] * y + a[2] * z, a[1] * x + a[3] * y + a[4] * z, a[2] * x + a[4] * y + a[5] * z


@njit(cache=True, error_model="numpy")
def _fit_precision(prior, normal, middle, count):
    """Return the precision matrix prior + N M⁻¹ N, or the prior alone if the fit has too few observations."""
    determinant, m = _adjugate(middle)
    enough = count > PARAMETERS and determinant > _SINGULAR * middle[0] * middle[3] * middle[5]
    if not (enough and _adjugate(normal)[0] > _SINGULAR * normal[0] * normal[3] * normal[5]):
        return prior
    n00, n01, n02, n11, n12, n22 = normal
    # Columns of M⁻¹ N, times the determinant of M.
    a0, a1, a2 = _times(m, n00, n01, n02)
    b0, b1, b2 = _times(m, n01, n11, n12)
    c0, c1, c2 = _times(m, n02, n12, n22)
    return (
        prior[0] + (n00 * a0 + n01 * a1 + n02 * a2) / determinant,
        prior[1] + (n01 * a0 + n11 * a1 + n12 * a2) / determinant,
        prior[2] + (n02 * a0 + n12 * a1 + n22 * a2) / determinant,
        prior[3] + (n01 * b0 + n11 * b1 + n12 * b2) / determinant,
        prior[4] + (n02 * b0 + n12 * b1 + n22 * b2) / determinant,
        prior[5] + (n02 * c0 + n12 * c1 + n22 * c2) / determinant,
    )


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


@njit(cache=True)
def _judge_fit(jacobian, variance, weight, state, prior):
    total = 0.0
    for c in range(variance.size):
        normal, middle, count = _six(state[c]), _six(state[c, 6:]), state[c, 12]
        if variance[c] < np.inf:
            normal = _with_row(normal, jacobian[c], weight[c])
            middle = _with_row(middle, jacobian[c], weight[c] * weight[c] * variance[c])
            count += 1.0
        total += _score(_fit_precision(prior, normal, middle, count))
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
            if state[c, 12] + (1.0 if variance[c] < np.inf else 0.0) <= PARAMETERS:
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
def _judge_all(seen, state, prior, allowed, of_fit, out):
    """Fill out with the variance, or that of the fit, of the design plus each candidate."""
    jacobian, variance, _, weight = seen
    for p in numba.prange(allowed.size):
        if not allowed[p]:
            out[p] = -np.inf
        elif of_fit:
            out[p] = _judge_fit(jacobian[p], variance[p], weight[p], state, prior)
        else:
            out[p] = _judge_fisher(jacobian[p], variance[p], state)


_UPPER = np.triu_indices(PARAMETERS)


def _sums(weight, jacobian) -> np.ndarray:
    """Return Σ weight j jᵀ over the poses, (cases, 6)."""
    return np.einsum("pc,pci,pcj->cij", weight, jacobian, jacobian)[:, *_UPPER]


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
    criterion : str
        One of CRITERIA.
    patch : (texels,) int, optional
        Number of the patch of the surface to which each texel belongs, for the criterion ``paint-variance``; by default
        there is one texel.

    Raises
    ------
    ValueError
        For an unknown criterion.
    """

    def __init__(
        self, seen: Observations, prior: float, setting, max_manual: int, criterion: str, *, patch=None
    ) -> None:
        if criterion not in CRITERIA:
            raise ValueError(f"criterion {criterion!r}; accepted: {', '.join(CRITERIA)}")
        self.seen = Observations(*(np.ascontiguousarray(values) for values in seen))
        self.prior = tuple(prior * np.eye(PARAMETERS)[_UPPER])
        self.setting = np.asarray(setting)
        self.max_manual = max_manual
        self.of_fit = criterion.startswith("fit-")
        self.patch = None
        if criterion.startswith("paint-"):
            self.patch = np.zeros(1, dtype=np.int64) if patch is None else np.asarray(patch, dtype=np.int64)

    def _state(self, chosen: list[int]) -> np.ndarray:
        """Return sums of a design, (cases, 13): Fisher information plus prior, or N and Σ w² v J Jᵀ; and the count."""
        jacobian, variance, _, weight = self.seen.of(chosen)
        seen = np.isfinite(variance)
        state = np.zeros((self.seen.variance.shape[1], 13))
        state[:, 12] = seen.sum(axis=0)
        if self.of_fit:
            state[:, :6] = _sums(weight, jacobian)
            state[:, 6:12] = _sums(weight**2 * np.where(seen, variance, 0.0), jacobian)
        else:
            state[:, :6] = _sums(1.0 / variance, jacobian) + self.prior
        return state

    def value(self, chosen: list[int]) -> float:
        """Return the criterion of a design."""
        jacobian, variance, _, weight = self.seen
        nothing, state = np.full(variance.shape[1], np.inf), self._state(list(chosen))
        if self.patch is not None:
            return _judge_paints(jacobian[0], nothing, state, self.prior, self.patch)
        if self.of_fit:
            return _judge_fit(jacobian[0], nothing, weight[0], state, self.prior)
        return _judge_fisher(jacobian[0], nothing, state)

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
            _judge_all(self.seen, self._state(chosen), self.prior, allowed, self.of_fit, out)
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


def choose(
    seen: Observations, prior: float, setting, count: int, max_manual: int, criterion: str, *, patch=None
) -> list[int]:
    """Return the indices of `count` candidates, none twice; parameters as in `Selection`.

    The method is greedy forward selection by Fisher information, the only criterion that is defined for fewer than four
    observations, followed by exchanges by the criterion in question.

    Raises
    ------
    ValueError
        For an unknown criterion.
    TooFewPoses
        If there are fewer candidates than `count` within `max_manual` settings.
    """
    fisher = Selection(seen, prior, setting, max_manual, "variance")
    start = fisher.improve(fisher.greedy(count))
    return Selection(seen, prior, setting, max_manual, criterion, patch=patch).improve(start)
