"""Choice of K observations out of many by what they tell together: greedy, then exchange (Fedorov).

Two criteria, both means over the cases and both larger for the better design:

``determinant``  mean of ln det(prior + information): D-optimality, the volume of what remains possible
``variance``     minus the mean of the trace of the inverse: A-optimality, the sum of the relative variances

Each observation adds a matrix of rank one, so that a candidate is judged without a new inversion (the matrix
determinant lemma; Sherman and Morrison).
"""

import numba
import numpy as np

CRITERIA = ("determinant", "variance")
_MIN_GAIN = 1e-9
_MAX_PASSES = 20


@numba.njit(cache=True)
def _gain_of(rows, inverse, by_determinant):
    """Return what one candidate adds to the criterion, summed over the cases."""
    total = 0.0
    for c in range(rows.shape[0]):
        a, b, m = rows[c, 0], rows[c, 1], rows[c, 2]
        if a == 0.0 and b == 0.0 and m == 0.0:
            continue
        inv = inverse[c]
        x = inv[0, 0] * a + inv[0, 1] * b + inv[0, 2] * m
        y = inv[0, 1] * a + inv[1, 1] * b + inv[1, 2] * m
        z = inv[0, 2] * a + inv[1, 2] * b + inv[2, 2] * m
        q = a * x + b * y + m * z
        if by_determinant:
            total += np.log1p(q)
        else:
            total += (x * x + y * y + z * z) / (1.0 + q)
    return total


@numba.njit(cache=True, parallel=True, nogil=True)
def _gains(rows, inverse, allowed, by_determinant, out):
    for p in numba.prange(rows.shape[0]):
        out[p] = _gain_of(rows[p], inverse, by_determinant) if allowed[p] else -np.inf


class Selection:
    """Observations chosen so far, and the search for better ones.

    Parameters
    ----------
    rows : (candidates, cases, 3) float
        Derivatives over standard deviations (`irodori.rig.information.Observations.scaled`).
    prior : (3, 3) float
        Information before the first observation, positive definite.
    setting : (candidates,) int
        What a person sets by hand for a candidate; equal numbers need no step in between.
    max_manual : int
        How many different settings a design may have.
    criterion : str
        One of CRITERIA.

    Raises
    ------
    ValueError
        For an unknown criterion.
    """

    def __init__(self, rows, prior, setting, max_manual: int, criterion: str = "determinant") -> None:
        if criterion not in CRITERIA:
            raise ValueError(f"criterion {criterion!r}; accepted: {', '.join(CRITERIA)}")
        self.rows = np.ascontiguousarray(rows, dtype=np.float64)
        self.prior = np.asarray(prior, dtype=np.float64)
        self.setting = np.asarray(setting)
        self.max_manual = max_manual
        self.by_determinant = criterion == "determinant"

    def information(self, chosen) -> np.ndarray:
        """Return prior and information of the chosen candidates, (cases, 3, 3)."""
        rows = self.rows[list(chosen)]
        return self.prior + np.einsum("pci,pcj->cij", rows, rows)

    def value(self, chosen) -> float:
        """Return the criterion of a design."""
        total = self.information(chosen)
        if self.by_determinant:
            return float(np.linalg.slogdet(total)[1].mean())
        return float(-np.trace(np.linalg.inv(total), axis1=1, axis2=2).mean())

    def _best_addition(self, chosen: list[int]) -> tuple[int, float]:
        """Return the candidate that adds most, and what it adds; the first of equals."""
        allowed = np.ones(len(self.rows), dtype=np.bool_)
        allowed[chosen] = False
        used = np.unique(self.setting[chosen]) if chosen else np.empty(0, dtype=int)
        if len(used) >= self.max_manual:
            allowed &= np.isin(self.setting, used)
        inverse = np.linalg.inv(self.information(chosen))
        out = np.empty(len(self.rows))
        _gains(self.rows, inverse, allowed, self.by_determinant, out)
        best = int(np.argmax(out))
        if out[best] == -np.inf:
            raise ValueError(f"{len(chosen)} poses within {self.max_manual} settings; accepted: no more poses than these")
        return best, float(out[best]) / self.rows.shape[1]

    def _fill(self, chosen: list[int], count: int) -> list[int]:
        chosen = list(chosen)
        while len(chosen) < count:
            chosen.append(self._best_addition(chosen)[0])
        return chosen

    def choose(self, count: int) -> list[int]:
        """Return the indices of `count` candidates, none twice.

        Greedy forward selection; then each chosen candidate is exchanged for the best other one, and all candidates of
        one setting for the best others, as long as the criterion grows.

        Raises
        ------
        ValueError
            If there are fewer candidates than `count` within `max_manual` settings.
        """
        best = self._fill([], count)
        value = self.value(best)
        for _ in range(_MAX_PASSES):
            before = value
            for leave in [{index} for index in best] + self._by_setting(best):
                if not leave <= set(best):
                    continue
                trial = self._fill([index for index in best if index not in leave], count)
                gained = self.value(trial)
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
