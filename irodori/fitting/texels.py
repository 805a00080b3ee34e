"""Loop over texels: load, minimise, assess, store."""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.huber import robust
from irodori.fitting.observations import Rules, every_lane, expect_fitted, load_one, telling, weigh, weights_changed
from irodori.fitting.shared_geometry import no_shared, padded_nodes, scan_shared, tabulate
from irodori.fitting.texel_rows import new_rows, pack_geometry, spread_geometry
from irodori.fitting.varpro import SUMS, minimise, scan
from irodori.fitting.vectorised_texels import NOISY, SURE, fit_eight, new_eight, write_eight
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.jit.vector_memory import aligned
from irodori.jit.vectors import LANES
from irodori.material.material_file import Status
from irodori.reflection.lobes import Lobes

_CHUNK = 8192  # texels that a thread fits before it asks for more
_OK, _UNIDENTIFIABLE = int(Status.OK), int(Status.MU_UNIDENTIFIABLE)


class Problem(NamedTuple):
    """What a fit is given.

    Parameters
    ----------
    response, weight : (texels, J) float
    geometry : (texels, J, 4) or (1, J, 4) float
    clipped : (texels, J) or (1, 0) uint8
    n : (texels,) or (1,) float64
    k : float
    noise : (2, P) float64
        c0 and c1 of the camera's variance c0 + c1 ρ, by capture.
    nodes : (nodes,) float64
        log μ of the scan, falling.
    chains : int
        Steps of the nodes in √2.
    lobes : Lobes
        The one lobe that is fitted.
    """

    response: np.ndarray
    weight: np.ndarray
    geometry: np.ndarray
    clipped: np.ndarray
    n: np.ndarray
    k: float
    noise: np.ndarray
    nodes: np.ndarray
    chains: int
    lobes: Lobes


class Output(NamedTuple):
    """What the loop fills: see the columns of `irodori.fitting.judge`."""

    table: np.ndarray  # (texels, COLUMNS)
    status: np.ndarray  # (texels,) int8
    model: np.ndarray  # (texels,) int8
    evaluations: np.ndarray  # (texels,) int32
    result: np.ndarray  # (texels,) int8, NLopt's return code


@njit(cache=True)
def new_sums(problem):
    """Return room for a texel's sums of the scan."""
    nodes = padded_nodes(problem.nodes.size)
    return aligned(SUMS * nodes).reshape((SUMS, nodes))


@uncounted(error_model="numpy")
def conclude(rows, fixed, a, b, log_mu, used, floor, clipped, problem, sums, rules):
    """Choose the model by BIC, state errors and status; the scan's sums are those of the rows."""
    lobes, unknown = problem.lobes, math.log(used)
    diffuse, best, nothing = judge.without_gloss(fixed, used, floor, rules)
    model = judge.DIFFUSE_ALONE
    if rules.low_alpha == 0.0 and nothing <= best:
        model, best = judge.NOTHING, nothing
    errors = judge.Errors(np.inf, np.inf, np.inf, 0.0, False)
    evaluations = 0
    if b > 0.0:
        both = judge.full_errors(rows, lobes, a, b, log_mu, used, rules, True)
        criterion = judge.information_criterion(both.squares, used, floor, 3.0 * unknown)
        if criterion < best or rules.low_beta > 0.0:
            model, best, errors = judge.BOTH, criterion, both
        # That gloss alone explains the data says nothing where the data cannot tell α from gloss.
        if rules.low_alpha == 0.0 and not a > SURE * both.alpha and judge.shown_dark(a, both.alpha, fixed):
            box = (0.0, 0.0, rules.low_beta, rules.high_beta)
            alone_mu, _, alone_b, evaluations = minimise(rows, lobes, fixed, box, problem.nodes, sums)
            alone = judge.full_errors(rows, lobes, 0.0, alone_b, alone_mu, used, rules, False)
            if judge.information_criterion(alone.squares, used, floor, 2.0 * unknown) < best:
                model, errors, a, b, log_mu = judge.GLOSS_ALONE, alone, 0.0, alone_b, alone_mu
    if model == judge.NOTHING or model == judge.DIFFUSE_ALONE:
        status = judge.diffuse_status(rows, lobes, clipped, model, diffuse, rules)
        diffuse_error, squares = judge.diffuse_errors(rows, diffuse, used, rules)
        variance = max(squares / (used - 1), floor)
        return judge.Verdict(
            status, model, diffuse, 0.0, 0.0, diffuse_error, np.inf, np.inf, squares, variance, evaluations
        )
    status = judge.gloss_status(rows, lobes, clipped, a, b, log_mu, errors, rules)
    variance = max(errors.squares / (used - judge.PARAMETERS), floor)
    return judge.Verdict(
        status, model, a, b, log_mu, errors.alpha, errors.beta, errors.log_mu, errors.squares, variance, evaluations
    )


@njit(cache=True, inline="always")
def clipped_of(t, problem):
    """Return which observations of a texel clip; empty where that is not known."""
    return problem.clipped[t if problem.clipped.shape[0] > 1 else 0]


@uncounted()
def write(out, t, verdict, fixed, evaluations):
    """Store a verdict."""
    out.status[t], out.model[t] = verdict.status, verdict.model
    out.evaluations[t] = evaluations + verdict.evaluations
    row = out.table[t]
    row[judge.ALPHA], row[judge.BETA], row[judge.LOG_MU] = verdict.alpha, verdict.beta, verdict.log_mu
    row[judge.ALPHA_ERROR], row[judge.BETA_ERROR] = verdict.alpha_error, verdict.beta_error
    row[judge.LOG_MU_ERROR], row[judge.SQUARES] = verdict.log_mu_error, verdict.squares / fixed[3]
    row[judge.POWER], row[judge.VARIANCE] = fixed[2] / fixed[3], verdict.variance / fixed[3]


@uncounted(error_model="numpy")
def _scan(rows, shared, problem, sums):
    if shared.nodes.shape[1] == 0:
        scan(rows, problem, sums, 0.0)
    else:
        scan_shared(rows, shared, sums, weights_changed(rows))


@uncounted(error_model="numpy")
def _fit_texel(t, rows, shared, used, floor, problem, rules, sums, out):
    """Scan, polish and judge one loaded texel."""
    box, lobes = (rules.low_alpha, rules.high_alpha, rules.low_beta, rules.high_beta), problem.lobes
    fixed = weigh(rows, 0.0)
    _scan(rows, shared, problem, sums)
    log_mu, a, b, evaluations = minimise(rows, lobes, fixed, box, problem.nodes, sums)
    settled = True
    if is_noisy(used, floor, fixed, rules):
        expect_fitted(rows, lobes, problem.noise, rules, a, b, log_mu, every_lane())
        fixed = weigh(rows, 0.0)
        _scan(rows, shared, problem, sums)
        log_mu, a, b, count = minimise(rows, lobes, fixed, box, problem.nodes, sums)
        evaluations += count
    if rules.huber > 0.0:
        fixed, a, b, log_mu, count, settled = robust(rows, problem, rules)
        _scan(rows, shared, problem, sums)
        evaluations += count + problem.nodes.size
    clipped = clipped_of(t, problem)
    verdict = conclude(rows, fixed, a, b, log_mu, used, floor, clipped, problem, sums, rules)
    write(out, t, verdict, fixed, evaluations)
    if not settled:
        leave_gloss_open(out, t)


@njit(cache=True, forceinline=True)
def is_noisy(used, floor, fixed, rules):
    """Return whether weights of noisy responses would pull α by more than a fifth of its standard error."""
    return rules.weighted and used * used * floor > NOISY * fixed[2]


@uncounted()
def leave_gloss_open(out, t):
    """Take back that the gloss of a texel is determined."""
    if out.status[t] == _OK:
        out.status[t] = _UNIDENTIFIABLE


@uncounted()
def write_too_few(t, used, problem, rows, out):
    """Store the status of a texel with too few observations."""
    out.status[t] = judge.status_of_too_few(used, problem.response[t], problem.weight[t], rows, clipped_of(t, problem))
    for column in range(judge.COLUMNS):
        out.table[t, column] = np.nan


@uncounted(error_model="numpy")
def load_texel(t, problem, rules, rows):
    """Fill responses, variances and weights of a texel; return its observations and the expected w r²."""
    used, floor = load_one(problem.response[t], problem.weight[t], problem.noise, rules, rows)
    return telling(rows, problem.response.shape[1], used), floor


@uncounted(error_model="numpy")
def pack_texel(t, problem, rows):
    """Fill what the geometry of a texel gives."""
    n = problem.n[t if problem.n.size > 1 else 0]
    pack_geometry(problem.geometry[t if problem.geometry.shape[0] > 1 else 0], problem.lobes, n, problem.k, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_chunk(problem, shared, rules, common, out, first, last):
    """Fit some texels, each with a geometry of its own unless there is something ``shared``."""
    rows, sums = new_rows(problem.response.shape[1]), new_sums(problem)
    for i in range(common.shape[0]):
        for j in range(common.shape[1]):
            rows[i, j] = common[i, j]
    eight = new_eight(problem.response.shape[1], problem.nodes.size)
    if common.shape[0] > 0:
        spread_geometry(common, eight.rows)
    _fit_range(problem, shared, rules, rows, sums, eight, out, first, last)


@uncounted(error_model="numpy")
def _fit_range(problem, shared, rules, rows, sums, eight, out, first, last):
    """Fit texels eight at a time, and alone those that are not done then."""
    together = rules.huber == 0.0 and (problem.geometry.shape[0] > 1 or shared.nodes.shape[1] > 0)
    for batch in range(first, last, LANES):
        done = fit_eight(problem, shared, rules, batch, last, eight) if together else 0
        write_eight(eight.results, done, batch, out)
        for i in range(min(LANES, last - batch)):
            if not done >> i & 1:
                _fit_alone(batch + i, rows, shared, problem, rules, sums, out)


@uncounted(error_model="numpy")
def _fit_alone(t, rows, shared, problem, rules, sums, out):
    """Load, fit and judge one texel."""
    if shared.nodes.shape[1] == 0:
        pack_texel(t, problem, rows)
    used, floor = load_texel(t, problem, rules, rows)
    if used <= judge.PARAMETERS:
        write_too_few(t, used, problem, rows, out)
    else:
        _fit_texel(t, rows, shared, used, floor, problem, rules, sums, out)


@njit(cache=True)
def _common_rows(problem):
    """Return rows with the geometry that all texels share."""
    rows = new_rows(problem.response.shape[1])
    pack_texel(0, problem, rows)
    return rows


def fit_texels(problem: Problem, rules: Rules, out: Output) -> None:
    """Fit every texel by variable projection, with the geometry of its own or the one that all share."""
    shared, common = no_shared(), np.zeros((0, 0))
    if problem.geometry.shape[0] == 1 and problem.n.size == 1:
        common = _common_rows(problem)
        shared = tabulate(common, problem.lobes, problem.nodes)
    run_chunks(_fit_chunk, len(problem.response), _CHUNK, problem, shared, rules, common, out)
