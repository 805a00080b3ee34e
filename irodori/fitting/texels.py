"""Loop over texels: load, minimise, assess, store."""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.huber import robust
from irodori.fitting.observations import Rules, expect, load, telling, weigh
from irodori.fitting.shared_geometry import no_shared, padded_nodes, scan_shared, tabulate
from irodori.fitting.texel_rows import CONSTANT, ROWS, SLOPE, WEIGHT, pack_geometry, padded
from irodori.fitting.varpro import SUMS, minimise, scan_own
from irodori.fitting.vectorised_judge import SURE
from irodori.fitting.vectorised_rows import new_abreast, spread_geometry
from irodori.fitting.vectorised_texels import NOISY, fit_abreast, write_abreast
from irodori.jit.lanes import COUNT
from irodori.jit.native import aligned, njit, run_chunks, uncounted
from irodori.material.material_file import Status

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
    steepness : (nodes,) float64
        2 / μ² there.
    chains : int
        Steps of the nodes in √2.
    """

    response: np.ndarray
    weight: np.ndarray
    geometry: np.ndarray
    clipped: np.ndarray
    n: np.ndarray
    k: float
    noise: np.ndarray
    nodes: np.ndarray
    steepness: np.ndarray
    chains: int


class Output(NamedTuple):
    """What the loop fills: see the columns of `irodori.fitting.judge`."""

    table: np.ndarray  # (texels, COLUMNS)
    status: np.ndarray  # (texels,) int8
    model: np.ndarray  # (texels,) int8
    evaluations: np.ndarray  # (texels,) int32
    result: np.ndarray  # (texels,) int8, NLopt's return code


@njit(cache=True)
def new_block(problem):
    """Return an empty block for one texel, scratch for angles, and for the sums of the scan."""
    p, nodes = padded(problem.response.shape[1]), padded_nodes(problem.nodes.size)
    block = aligned(ROWS * p).reshape((ROWS, p))
    for j in range(p):  # an assignment of whole rows compiles the text of its error, for seconds
        block[CONSTANT, j], block[SLOPE, j] = problem.noise[0, j], problem.noise[1, j]
    return block, aligned(4 * p).reshape((4, p)), aligned(SUMS * nodes).reshape((SUMS, nodes))


@njit(cache=True, error_model="numpy")
def conclude(block, fixed, a, b, log_mu, used, floor, clipped, nodes, sums, rules):
    """Choose the model by BIC, state errors and status; the scan's sums are those of the block."""
    diffuse = fixed[1] / fixed[0] if fixed[0] > 0.0 else 0.0
    diffuse = min(max(diffuse, rules.low_alpha), rules.high_alpha)
    squares = max(fixed[2] + diffuse * (diffuse * fixed[0] - 2.0 * fixed[1]), 0.0)
    unknown = math.log(used)
    model, best = judge.DIFFUSE_ALONE, judge.information_criterion(squares, used, floor, unknown)
    nothing = judge.information_criterion(fixed[2], used, floor, 0.0)
    if rules.low_alpha == 0.0 and nothing <= best:
        model, best = judge.NOTHING, nothing
    errors = judge.Errors(np.inf, np.inf, np.inf, squares, 1.0)
    evaluations = 0
    if b > 0.0:
        both = judge.full_errors(block, a, b, log_mu, used, rules, True)
        criterion = judge.information_criterion(both.squares, used, floor, 3.0 * unknown)
        if criterion < best or rules.low_beta > 0.0:
            model, best, errors = judge.BOTH, criterion, both
        # That gloss alone explains the data says nothing where the data cannot tell α from gloss.
        if rules.low_alpha == 0.0 and not a > SURE * both.alpha and judge.shown_dark(a, both.alpha, fixed):
            box = (0.0, 0.0, rules.low_beta, rules.high_beta)
            alone_mu, _, alone_b, evaluations = minimise(block, fixed, box, nodes, sums)
            alone = judge.full_errors(block, 0.0, alone_b, alone_mu, used, rules, False)
            if judge.information_criterion(alone.squares, used, floor, 2.0 * unknown) < best:
                model, errors, a, b, log_mu = judge.GLOSS_ALONE, alone, 0.0, alone_b, alone_mu
    if model == judge.NOTHING or model == judge.DIFFUSE_ALONE:
        status = judge.diffuse_status(block, clipped, model, diffuse, rules)
        diffuse_error, squares = judge.diffuse_errors(block, diffuse, used, rules)
        variance = max(squares / (used - 1), floor)
        return judge.Verdict(
            status, model, diffuse, 0.0, 0.0, diffuse_error, np.inf, np.inf, squares, variance, evaluations
        )
    status = judge.gloss_status(block, clipped, a, b, log_mu, errors, rules)
    variance = max(errors.squares / (used - judge.PARAMETERS), floor)
    return judge.Verdict(
        status, model, a, b, log_mu, errors.alpha, errors.beta, errors.log_mu, errors.squares, variance, evaluations
    )


@njit(cache=True)
def write(out, t, verdict, fixed, evaluations):
    """Store a verdict."""
    out.status[t], out.model[t] = verdict.status, verdict.model
    out.evaluations[t] = evaluations + verdict.evaluations
    row = out.table[t]
    row[judge.ALPHA], row[judge.BETA], row[judge.LOG_MU] = verdict.alpha, verdict.beta, verdict.log_mu
    row[judge.ALPHA_ERROR], row[judge.BETA_ERROR] = verdict.alpha_error, verdict.beta_error
    row[judge.LOG_MU_ERROR], row[judge.SQUARES] = verdict.log_mu_error, verdict.squares / fixed[3]
    row[judge.POWER], row[judge.VARIANCE] = fixed[2] / fixed[3], verdict.variance / fixed[3]


@njit(cache=True, inline="always")
def clipped_of(t, problem):
    """Return which observations of a texel clip; empty where that is not known."""
    return problem.clipped[t if problem.clipped.shape[0] > 1 else 0]


@njit(cache=True)
def _weights_changed(block, before):
    changed = False
    for j in range(before.size):
        changed |= block[WEIGHT, j] != before[j]
        before[j] = block[WEIGHT, j]
    return changed


@njit(cache=True, error_model="numpy")
def _scan(block, shared, problem, sums, before):
    if shared.nodes.shape[1] == 0:
        scan_own(block, problem.nodes, problem.steepness, problem.chains, sums)
    else:
        scan_shared(block, shared, sums, _weights_changed(block, before))


@njit(cache=True, error_model="numpy")
def _fit_texel(t, block, shared, used, floor, problem, rules, sums, before, out):
    """Scan, polish and judge one loaded texel."""
    box = (rules.low_alpha, rules.high_alpha, rules.low_beta, rules.high_beta)
    fixed = weigh(block)
    _scan(block, shared, problem, sums, before)
    log_mu, a, b, evaluations = minimise(block, fixed, box, problem.nodes, sums)
    settled = True
    if is_noisy(used, floor, fixed, rules):
        expect(block, a, b, log_mu, rules)
        fixed = weigh(block)
        _scan(block, shared, problem, sums, before)
        log_mu, a, b, count = minimise(block, fixed, box, problem.nodes, sums)
        evaluations += count
    if rules.huber > 0.0:
        fixed, a, b, log_mu, count, settled = robust(block, problem.nodes, rules)
        _scan(block, shared, problem, sums, before)
        evaluations += count + problem.nodes.size
    clipped = clipped_of(t, problem)
    verdict = conclude(block, fixed, a, b, log_mu, used, floor, clipped, problem.nodes, sums, rules)
    write(out, t, verdict, fixed, evaluations)
    if not settled:
        doubt(out, t)


@njit(cache=True)
def is_noisy(used, floor, fixed, rules):
    """Return whether weights of noisy responses would pull α by more than a fifth of its standard error."""
    return rules.weighted and used * used * floor > NOISY * fixed[2]


@njit(cache=True)
def doubt(out, t):
    """Take back that the gloss of a texel is determined."""
    if out.status[t] == _OK:
        out.status[t] = _UNIDENTIFIABLE


@njit(cache=True)
def give_up(t, used, lost, problem, out):
    """Store the status of a texel with too few observations."""
    out.status[t] = judge.hopeless(used, lost, clipped_of(t, problem))
    for column in range(judge.COLUMNS):
        out.table[t, column] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_chunk(problem, shared, rules, common, out, first, last):
    """Fit some texels, each with a geometry of its own unless there is something ``shared``."""
    block, angles, sums = new_block(problem)
    for i in range(common.shape[0]):
        for j in range(common.shape[1]):
            block[i, j] = common[i, j]
    buffers = new_abreast(problem.response.shape[1], problem.nodes.size)
    if common.shape[0] > 0:
        spread_geometry(common, buffers.rows, problem.response.shape[1])
    before = np.full(block.shape[1], np.nan)
    _fit_range(problem, shared, rules, block, angles, sums, before, buffers, out, first, last)


@uncounted(error_model="numpy")
def _fit_range(problem, shared, rules, block, angles, sums, before, buffers, out, first, last):
    """Fit texels eight at a time, and alone those that are not done then."""
    together = rules.huber == 0.0 and (problem.geometry.shape[0] > 1 or shared.nodes.shape[1] > 0)
    for batch in range(first, last, COUNT):
        done = fit_abreast(problem, shared, rules, batch, last, buffers) if together else 0
        write_abreast(buffers.results, done, batch, out)
        for i in range(min(COUNT, last - batch)):
            if not done >> i & 1:
                _fit_alone(batch + i, block, angles, shared, problem, rules, sums, before, out)


@njit(cache=True, error_model="numpy")
def _fit_alone(t, block, angles, shared, problem, rules, sums, before, out):
    """Load, fit and judge one texel."""
    if shared.nodes.shape[1] == 0:
        n = problem.n[t if problem.n.size > 1 else 0]
        pack_geometry(problem.geometry[t if problem.geometry.shape[0] > 1 else 0], n, problem.k, angles, block)
    used, lost, floor = load(problem.response[t], problem.weight[t], rules, block)
    used = telling(block, used)
    if used <= judge.PARAMETERS:
        give_up(t, used, lost, problem, out)
    else:
        _fit_texel(t, block, shared, used, floor, problem, rules, sums, before, out)


@njit(cache=True)
def _common_block(problem):
    """Return a block with the geometry that all texels share."""
    block, angles, _ = new_block(problem)
    pack_geometry(problem.geometry[0], problem.n[0], problem.k, angles, block)
    return block


def fit_texels(problem: Problem, rules: Rules, out: Output) -> None:
    """Fit every texel by variable projection, with the geometry of its own or the one that all share."""
    shared, common = no_shared(), np.zeros((0, 0))
    if problem.geometry.shape[0] == 1 and problem.n.size == 1:
        common = _common_block(problem)
        shared = tabulate(common, problem.nodes)
    run_chunks(_fit_chunk, len(problem.response), _CHUNK, problem, shared, rules, common, out)
