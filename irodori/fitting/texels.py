"""Loop over texels: load observations, minimise, assess, store the results."""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.observations import (
    Evidence,
    Minimum,
    Rules,
    box_of,
    every_lane,
    expect_fitted,
    load_one,
    telling,
    weigh,
    weights_changed,
)
from irodori.fitting.outliers import least_without, two_least
from irodori.fitting.shared_geometry import Shared, no_shared, padded_nodes, scan_shared, tabulate
from irodori.fitting.texel_rows import TRUST, WEIGHT, new_rows, pack_geometry, spread_geometry
from irodori.fitting.varpro import SUMS, minimise, scan
from irodori.fitting.vectorised_texels import NOISY, SURE, fit_eight, new_eight, write_eight
from irodori.jit.array_copies import copy_into
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.jit.references import address_of, at_address
from irodori.jit.vector_memory import aligned
from irodori.jit.vectors import LANES
from irodori.reflection.lobes import Lobes

_CHUNK = 8192  # texels that a thread takes at a time
_WORTH = 9.0  # smallest decrease of χ² by leaving out an outlier, over the remaining χ² per degree of freedom
_AN_OUTLIER_IN = 8  # smallest number of observations per outlier
_LEAST_READINGS = 12  # fewest observations that can confirm the model after one of them was left out


class Problem(NamedTuple):
    """Input of a fit: observations of the fitted band, refractive index, noise, and the scan.

    Parameters
    ----------
    response, weight : (texels, J) float
    geometry : (texels, J, 4) or (1, J, 4) float
    clipped : (texels, J) or (1, 0) uint8
    n, k : float
        Complex refractive index.
    noise : (2, P) float64
        c0 and c1 of the variance c0 + c1 ρ of a response ρ by the camera's noise, for each capture.
    nodes : (nodes,) float64
        log μ of the scan, in decreasing order.
    most_beta : (nodes,) float64
        β at each node with which gloss along the normal reflects as much light as a smooth surface: no gloss has more.
    lobes : Lobes
        The lobe to fit.
    coupled : bool
        Whether the coat reduces the diffuse term.
    """

    response: np.ndarray
    weight: np.ndarray
    geometry: np.ndarray
    clipped: np.ndarray
    n: float
    k: float
    noise: np.ndarray
    nodes: np.ndarray
    most_beta: np.ndarray
    lobes: Lobes
    coupled: bool

    def in_float64(self, texels: slice = slice(None)) -> "Problem":
        """Return a range of the texels with float64 observations, so that a slow loop is compiled for one type only."""
        count = len(self.response)

        def of_texels(array, dtype=None):
            return np.require(array[texels] if len(array) == count else array, dtype, ["C", "W"])

        observed = {name: of_texels(getattr(self, name), np.float64) for name in ("response", "weight", "geometry")}
        return self._replace(**observed, clipped=of_texels(self.clipped))


class Output(NamedTuple):
    """Arrays that the loop fills; `irodori.fitting.judge` defines the columns of the table."""

    table: np.ndarray  # (texels, COLUMNS)
    status: np.ndarray  # (texels,) int8
    model: np.ndarray  # (texels,) int8
    evaluations: np.ndarray  # (texels,) int32
    result: np.ndarray  # (texels,) int8, NLopt's return code


class Task(NamedTuple):
    """Data and settings of the loops that fit one texel."""

    problem: Problem
    rules: Rules
    shared: Shared


class Room(NamedTuple):
    """Buffers of one thread for one texel."""

    rows: np.ndarray  # (ROWS, P)
    sums: np.ndarray  # (SUMS, nodes), padded


@njit(cache=True)
def new_sums(problem):
    """Allocate the sums of the scan of one texel."""
    nodes = padded_nodes(problem.nodes.size)
    return aligned(SUMS * nodes).reshape((SUMS, nodes))


@uncounted(error_model="numpy")
def conclude(t, task, room, evidence, found, sure):
    """Choose the model of a texel by Schwarz's criterion; return parameters, errors and status as a `Verdict`.

    The sums in ``room`` must belong to its rows. If not ``sure``, see `without_outliers`, the status is CONTRADICTED in
    place of OK.
    """
    problem, rules, (rows, sums), (used, floor, fixed) = task.problem, task.rules, room, evidence
    lobes, clipped, unknown = problem.lobes, clipped_of(t, problem), math.log(used)
    diffuse, best, nothing = judge.without_gloss(evidence, rules)
    model = judge.DIFFUSE_ALONE
    if rules.low_alpha == 0.0 and nothing <= best:
        model, best = judge.NOTHING, nothing
    errors = judge.Errors(np.inf, np.inf, np.inf, 0.0, False, True)
    evaluations = found.evaluations
    if found.beta > 0.0:
        both = judge.full_errors(rows, lobes, found, used, rules, True)
        criterion = judge.information_criterion(both.squares, used, floor, 3.0 * unknown)
        if criterion < best or rules.low_beta > 0.0:
            model, best, errors = judge.BOTH, criterion, both
        # Gloss alone is tried only if α is known to be small, not if it merely cannot be separated from gloss.
        dark = judge.shown_dark(found.alpha, both.alpha, fixed)
        if rules.low_alpha == 0.0 and not found.alpha > SURE * both.alpha and dark:
            box = (0.0, 0.0, rules.low_beta, rules.high_beta)
            other = minimise(rows, lobes, fixed, box, problem.nodes, sums)
            other = Minimum(0.0, other.beta, other.log_mu, other.evaluations)
            evaluations += other.evaluations
            alone = judge.full_errors(rows, lobes, other, used, rules, False)
            if judge.information_criterion(alone.squares, used, floor, 2.0 * unknown) < best:
                model, errors, found = judge.GLOSS_ALONE, alone, other
    if model == judge.NOTHING or model == judge.DIFFUSE_ALONE:
        diffuse_error, squares, fits = judge.diffuse_errors(rows, diffuse, used, rules)
        status = judge.diffuse_status(rows, lobes, clipped, model, (diffuse, fits and sure), rules)
        variance = max(squares / (used - 1), floor)
        missed = judge.missed_gloss(fixed, sums, problem.most_beta, diffuse, variance)
        diffuse_error = math.sqrt(diffuse_error * diffuse_error + missed * missed)
        return judge.Verdict(
            status, model, diffuse, 0.0, 0.0, diffuse_error, np.inf, np.inf, squares, variance, evaluations
        )
    if not sure:
        errors = judge.Errors(errors.alpha, errors.beta, errors.log_mu, errors.squares, errors.seen, False)
    status, alpha_error = judge.gloss_status(rows, lobes, clipped, found, errors, rules), errors.alpha
    if status in judge.GLOSS_OPEN:
        alpha_error = judge.alpha_over_all_mu(evidence, sums, problem.most_beta, found, errors, rules)
    variance = max(errors.squares / (used - judge.PARAMETERS), floor)
    return judge.Verdict(
        status, model, found.alpha, found.beta, found.log_mu, alpha_error, errors.beta, errors.log_mu,
        errors.squares, variance, evaluations,
    )  # fmt: skip


@njit(cache=True, inline="always")
def clipped_of(t, problem):
    """Return the marks of clipped observations of a texel; empty if clipping is unknown."""
    return problem.clipped[t if problem.clipped.shape[0] > 1 else 0]


@uncounted()
def write(out, t, verdict, fixed):
    """Store the `Verdict` on texel t in the output."""
    out.status[t], out.model[t], out.evaluations[t] = verdict.status, verdict.model, verdict.evaluations
    row = out.table[t]
    row[judge.ALPHA], row[judge.BETA], row[judge.LOG_MU] = verdict.alpha, verdict.beta, verdict.log_mu
    row[judge.ALPHA_ERROR], row[judge.BETA_ERROR] = verdict.alpha_error, verdict.beta_error
    row[judge.LOG_MU_ERROR], row[judge.SQUARES] = verdict.log_mu_error, verdict.squares / fixed[3]
    row[judge.POWER], row[judge.VARIANCE] = fixed[2] / fixed[3], verdict.variance / fixed[3]


@uncounted(error_model="numpy")
def _scan(task, room):
    if task.shared.nodes.shape[1] == 0:
        scan(room.rows, task.problem, room.sums, 0.0)
    else:
        scan_shared(room.rows, task.shared, room.sums, weights_changed(room.rows))


@uncounted(error_model="numpy")
def _search(task, room, fixed):
    """Scan, and return the `Minimum` of a texel after its rows were weighted."""
    _scan(task, room)
    return minimise(room.rows, task.problem.lobes, fixed, box_of(task.rules), task.problem.nodes, room.sums)


@uncounted(error_model="numpy")
def _fit_texel(t, task, room, loaded, out):
    """Fit and assess one texel after its observations were loaded."""
    problem, rules, rows, (used, floor) = task.problem, task.rules, room.rows, loaded
    evidence = Evidence(used, floor, weigh(rows, 0.0))
    found = _search(task, room, evidence.fixed)
    evaluations = found.evaluations
    if is_noisy(evidence, rules):
        expect_fitted(rows, problem, rules, found, every_lane())
        evidence = Evidence(used, floor, weigh(rows, 0.0))
        found = _search(task, room, evidence.fixed)
        evaluations += found.evaluations
    found = Minimum(found.alpha, found.beta, found.log_mu, evaluations)
    evidence, found, sure = without_outliers(task, room, evidence, found)
    write(out, t, conclude(t, task, room, evidence, found, sure), evidence.fixed)


@njit(cache=True, forceinline=True)
def is_noisy(evidence, rules):
    """Return whether weights from noisy responses would change α by more than a fifth of its standard error."""
    return rules.known and evidence.used * evidence.used * evidence.floor > NOISY * evidence.fixed[2]


@uncounted()
def _copy_row(rows, source, target):
    for j in range(rows.shape[1]):
        rows[target, j] = rows[source, j]


@uncounted(error_model="numpy")
def _chi2(rows, lobes, found, rules):
    return judge.sums_at_minimum(rows, lobes, found, rules, True)[1]


@uncounted(error_model="numpy")
def _searched_without(j, task, room):
    """Return the `Minimum` without observation j, and its χ²; sets the weight of j to 0."""
    rows = room.rows
    rows[WEIGHT, j] = 0.0
    found = _search(task, room, weigh(rows, 0.0))
    return found, _chi2(rows, task.problem.lobes, found, task.rules)


@uncounted(error_model="numpy")
def without_outliers(task, room, evidence, found):
    """Leave out single observations that contradict the model, such as one in a shadow.

    If χ² is too large, observations are left out one by one: of the two without which the sum of squares is least, the
    one without which χ² is smaller. If the remaining observations still contradict the model, or the decrease of χ² is
    less than `_WORTH` times the remaining χ² per degree of freedom, no observation is left out.

    Returns
    -------
    evidence : Evidence
    found : Minimum
        The sums and the minimum without outliers. ``room`` has the corresponding weights and sums of the scan.
    sure : bool
        Whether the model may be correct. After outliers were left out, the rest may also fit a wrong model by chance,
        so this is False if there are few observations or χ² is still larger than in nearly all correct models.
    """
    problem, rules, rows = task.problem, task.rules, room.rows
    lobes, start, used, evaluations = problem.lobes, found, evidence.used, found.evaluations
    chi2 = _chi2(rows, lobes, found, rules)
    if judge.allowed(chi2, float(max(used - judge.PARAMETERS, 1)), rules):
        return evidence, found, True
    most = int(max(1, used // _AN_OUTLIER_IN))
    _copy_row(rows, WEIGHT, TRUST)
    for _ in range(most):
        if used - 1 <= judge.PARAMETERS + 1:
            break
        used -= 1
        fixed = weigh(rows, 0.0)
        _scan(task, room)
        least_without(rows, problem, fixed, box_of(rules), room.sums)
        first, second = two_least(rows)
        weight = rows[WEIGHT, first]
        found, rest = _searched_without(first, task, room)
        if second >= 0:
            rows[WEIGHT, first], other_weight = weight, rows[WEIGHT, second]
            other, other_rest = _searched_without(second, task, room)
            if other_rest < rest:
                found, rest = other, other_rest
            else:
                rows[WEIGHT, first], rows[WEIGHT, second] = 0.0, other_weight
        degrees = float(max(used - judge.PARAMETERS, 1))
        if not chi2 - rest > _WORTH * max(rest / degrees, 1.0):
            break
        chi2 = rest
        if judge.allowed(rest, degrees, rules):
            fixed = weigh(rows, 0.0)
            _scan(task, room)
            found = Minimum(found.alpha, found.beta, found.log_mu, evaluations + found.evaluations)
            sure = judge.expected(rest, degrees) and evidence.used >= _LEAST_READINGS
            return Evidence(used, evidence.floor, fixed), found, sure
    _copy_row(rows, TRUST, WEIGHT)
    fixed = weigh(rows, 0.0)
    _scan(task, room)
    return Evidence(evidence.used, evidence.floor, fixed), start, True


@uncounted()
def write_too_few(t, used, problem, rows, out):
    """Store the status of a texel with too few observations."""
    out.status[t] = judge.status_of_too_few(used, problem.response[t], problem.weight[t], rows, clipped_of(t, problem))
    for column in range(judge.COLUMNS):
        out.table[t, column] = np.nan


@uncounted(error_model="numpy")
def load_texel(t, problem, rules, rows):
    """Fill responses, variances and weights of a texel.

    Returns
    -------
    used : int
        Number of observations from `telling`.
    floor : float
        Expected weighted square of a residual.
    """
    used, floor = load_one(problem.response[t], problem.weight[t], problem.noise, rules, rows)
    return telling(rows, problem.response.shape[1], used), floor


@uncounted(error_model="numpy")
def pack_texel(t, problem, rows):
    """Fill the rows that depend on the geometry of texel t."""
    geometry = problem.geometry[t if problem.geometry.shape[0] > 1 else 0]
    pack_geometry(geometry, problem.lobes, problem.n, problem.k, problem.coupled, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_chunk(problem, rules, shared, out, first, last):
    """Fit a range of texels, with separate geometries or the ``shared`` one."""
    room = Room(new_rows(problem.response.shape[1]), new_sums(problem))
    eight = new_eight(problem.response.shape[1], problem.nodes.size)
    if shared.rows.size > 0:
        copy_into(room.rows, shared.rows)
        spread_geometry(shared.rows, eight.rows)
    _fit_range(Task(problem, rules, shared), room, eight, out, first, last)


@uncounted(error_model="numpy")
def _fit_range(task, room, eight, out, first, last):
    _fit_each(address_of(task), room, eight, address_of(out), first, last)


@uncounted(error_model="numpy")
def _fit_each(task_at, room, eight, out_at, first, last):
    """Fit texels eight at a time, and singly those for which that is not possible."""
    task, out = at_address(task_at), at_address(out_at)
    problem, rules, shared = task.problem, task.rules, task.shared
    # One geometry without its tables, with which tests compare, goes the way of single texels.
    together = problem.geometry.shape[0] > 1 or shared.nodes.shape[1] > 0
    for batch in range(first, last, LANES):
        done = fit_eight(problem, shared, rules, batch, last, eight) if together else 0
        write_eight(eight.results, done, batch, out)
        for i in range(min(LANES, last - batch)):
            if not done >> i & 1:
                _fit_alone(batch + i, task, room, out)


@uncounted(error_model="numpy")
def _fit_alone(t, task, room, out):
    """Load, fit and assess one texel."""
    problem, rows = task.problem, room.rows
    if task.shared.nodes.shape[1] == 0:
        pack_texel(t, problem, rows)
    loaded = load_texel(t, problem, task.rules, rows)
    if loaded[0] <= judge.PARAMETERS:
        write_too_few(t, loaded[0], problem, rows, out)
    else:
        _fit_texel(t, task, room, loaded, out)


@njit(cache=True)
def _common_rows(problem):
    """Allocate rows and fill them with the geometry that all texels share."""
    rows = new_rows(problem.geometry.shape[1])
    pack_texel(0, problem, rows)
    return rows


def fit_texels(problem: Problem, rules: Rules, out: Output) -> None:
    """Fit every texel by variable projection, with separate geometries or a shared one; fills ``out``."""
    shared = no_shared()
    if problem.geometry.shape[0] == 1:
        rows = _common_rows(problem)
        shared = tabulate(rows, problem.lobes, problem.nodes)
    run_chunks(_fit_chunk, len(problem.response), _CHUNK, problem, rules, shared, out)
