"""Shared gloss of neighbouring texels, for those that cannot determine their own.

Most objects vary faster in colour than in gloss. A texel that leaves β and μ open takes them from a joint fit of one
β and μ, and an α for each texel, to the observations of the texels around it (`irodori.fitting.pool_sums`).

What must not happen is that another material takes part. A texel around takes part only if a common gloss explains it
and the texel in question together; and the pool must agree with itself: texels that its gloss does not explain are
left out where they are few, and make the neighbourhood smaller where they are many. Texels that show no gloss take
part like all others, so that noise does not become gloss by choice of the texels where it looks like it.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from irodori.core.progress import LOGGER
from irodori.fitting import pool_sums
from irodori.fitting.judge import MAX_RELATIVE_ERROR
from irodori.fitting.observations import Rules
from irodori.fitting.pool_sums import PACKED, Packed, evaluate, lowest, polish
from irodori.fitting.solvers import FitOptions, FitResult, problem_of
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.material.material_file import Status
from irodori.reflection.lobes import Lobes

_BETA, _MU = MAX_RELATIVE_ERROR["beta"], MAX_RELATIVE_ERROR["mu"]
_DIFFUSE_ONLY = int(Status.DIFFUSE_ONLY)
_IN_NEED = (Status.MU_UNIDENTIFIABLE, Status.AT_BOUND, Status.DIFFUSE_ONLY)
_TAKE_PART = (Status.OK, *_IN_NEED)
#: χ² of two parameters that one material exceeds once in a thousand; for a pair twice that, the pose is not in it yet.
_FOREIGN = 9.2
_PAIR_FOREIGN = 2.0 * _FOREIGN
#: χ² that the pool's gloss may add to a texel that showed none by itself.
_SILENT = 4.0
#: Share of the texels that see the gloss which may object to it.
_FOREIGN_SHARE = 0.1
#: Texels that must see the gloss: two of different materials can be explained by a gloss that is neither's.
_WITNESSES = 4
_VARYING = 3  # texels with a gloss of their own that tell how it varies
_POLISH = 14
_CHUNK = 16  # texels that a thread takes at a time
_PROMISING = 1.25  # between two nodes the gain of gloss is at most this multiple of that at the nodes
#: Columns of the outcome.
_ALPHA, _BETA_OUT, _LOG_MU, _ALPHA_ERROR, _BETA_ERROR, _LOG_MU_ERROR, _RMS, _RELATIVE, _COUNT = range(9)
_COLUMNS = 9


class Tile(NamedTuple):
    """A tile of texels among which gloss is pooled.

    Parameters
    ----------
    width : int
        Texels in a row; texels run along the rows.
    radius : int
        Distance in texels up to which others take part.
    lobes : Lobes
        One lobe.
    rules : Rules
    status : (texels,) int8
    own : (texels, 4) float64
        log β and log μ of the texels that determine them, and their standard errors; else NaN.
    packed : Packed
    """

    width: int
    radius: int
    lobes: Lobes
    rules: Rules
    status: np.ndarray
    own: np.ndarray
    packed: Packed


class Joint(NamedTuple):
    """The gloss that fits the members of a pool together.

    Parameters
    ----------
    blocks : (members, PACKED, P) float64
        Their observations, with weights that know the pose error.
    log_mu, beta : float
    squares : float
        The weighted sum of squares.
    """

    blocks: np.ndarray
    log_mu: float
    beta: float
    squares: float


@njit(cache=True, error_model="numpy")
def _valley(members, packed):
    """Return the node of the least joint sum of squares, the gain over no gloss at all."""
    total = np.zeros((2, packed.nodes.size))
    for m in range(members.size):
        total[0] += packed.sums[members[m], 1]
        total[1] += packed.sums[members[m], 2]
    best, gain = 0, -1.0
    for i in range(packed.nodes.size):
        b, c = total[0, i], total[1, i]
        here = b * b / c if b > 0.0 and c > 0.0 else 0.0
        if here > gain:
            best, gain = i, here
    return best, gain


@njit(cache=True, error_model="numpy")
def _agree(t, k, tile):
    """Return whether one gloss explains two texels nearly as well as a gloss each."""
    sums, nodes, high = tile.packed.sums, tile.packed.nodes, tile.rules.high_beta
    apart = sums[t, 3, 1] + sums[k, 3, 1] + _PAIR_FOREIGN
    a = sums[t, 3, 0] + sums[k, 3, 0]
    best, least = 0, np.inf
    for i in range(nodes.size):
        value, _ = lowest(a, sums[t, 1, i] + sums[k, 1, i], sums[t, 2, i] + sums[k, 2, i], 0.0, high)
        if value <= apart:
            return True
        if value < least:
            best, least = i, value
    pair = np.stack((tile.packed.blocks[t], tile.packed.blocks[k]))
    _t, _b, value = polish(pair, tile.lobes, nodes[min(best + 1, nodes.size - 1)], nodes[max(best - 1, 0)], high, 8)
    return value <= apart


@njit(cache=True, error_model="numpy")
def _around(t, tile, members, distance):
    """Fill the texel and those around it that agree with it, nearest to farthest not sorted; return their count."""
    radius, width, rows = tile.radius, tile.width, tile.status.size // tile.width
    members[0], distance[0], count = t, 0, 1
    row, column = t // width, t % width
    for y in range(max(row - radius, 0), min(row + radius + 1, rows)):
        for x in range(max(column - radius, 0), min(column + radius + 1, width)):
            k, square = y * width + x, (y - row) ** 2 + (x - column) ** 2
            if k == t or square > radius * radius or tile.packed.used[k] == 0:
                continue
            if _agree(t, k, tile):
                members[count], distance[count] = k, square
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def _fit_members(members, tile):
    """Return the `Joint` fit of the members."""
    nodes, lobes, rules = tile.packed.nodes, tile.lobes, tile.rules
    best, _ = _valley(members, tile.packed)
    left, right = nodes[min(best + 1, nodes.size - 1)], nodes[max(best - 1, 0)]
    blocks = tile.packed.blocks[members]
    log_mu, beta, value = polish(blocks, lobes, left, right, rules.high_beta, 6)
    pool_sums.spread_by_pose(blocks, lobes, beta, log_mu, rules)
    low, high = nodes[nodes.size - 1], nodes[0]
    left, right = max(min(left, log_mu - 0.2), low), min(max(right, log_mu + 0.2), high)
    log_mu, beta, value = polish(blocks, lobes, left, right, rules.high_beta, _POLISH)
    return Joint(blocks, log_mu, beta, value)


@njit(cache=True, error_model="numpy")
def _misfit(members, m, joint, tile):
    """Return by how much χ² of a member exceeds its own least with the pool's gloss."""
    a, b, c = evaluate(joint.blocks[m], tile.lobes, tile.packed.sums[members[m], 3, 2])
    own, _ = lowest(a, b, c, 0.0, tile.rules.high_beta)
    a, b, c = evaluate(joint.blocks[m], tile.lobes, joint.log_mu)
    return a + joint.beta * (joint.beta * c - 2.0 * b) - own


@njit(cache=True, error_model="numpy")
def _sift(members, joint, excess, tile):
    """Return to which members the gloss is foreign, whether to too many, how many see it, and the first's misfit."""
    beta = joint.beta
    foreign = np.zeros(members.size, dtype=np.bool_)
    wrong, able = 0, 0
    first = 0.0
    for m in range(members.size):
        off = _misfit(members, m, joint, tile) / excess
        foreign[m] = off > _FOREIGN
        wrong += foreign[m]
        # Only a texel that would see this gloss can object to it.
        able += foreign[m] or beta * beta * evaluate(joint.blocks[m], tile.lobes, joint.log_mu)[2] > _FOREIGN
        if m == 0:
            first = off
    return foreign, wrong > max(1.0, _FOREIGN_SHARE * able), able - wrong, first


@njit(cache=True, error_model="numpy")
def _conclude(members, joint, tile, row):
    """Fill the outcome of a pool that agrees with itself, if it determines the gloss; return whether it does."""
    (blocks, log_mu, beta, value), lobes, rules, nodes = joint, tile.lobes, tile.rules, tile.packed.nodes
    observations = 0
    for m in range(members.size):
        observations += tile.packed.used[members[m]]
    excess = max(value / max(observations - members.size - 2, 1), 1.0)
    without = 0.0
    for m in range(members.size):
        without += evaluate(blocks[m], lobes, log_mu)[0]
    if not (without - value) / excess > 2.0 * math.log(observations):  # Schwarz's criterion for β and μ
        return False
    inside = nodes[nodes.size - 1] + 1e-4 < log_mu < nodes[0] - 1e-4 and beta < rules.high_beta * (1.0 - 1e-6)
    bb, bt, tt = pool_sums.covariance(blocks, lobes, beta, log_mu, rules, excess)
    told = math.sqrt(bb) < _BETA * beta and math.sqrt(tt) < _MU
    if not (inside and told and pool_sums.top_is_seen(blocks, lobes, log_mu)):
        return False
    alpha, by_beta, by_mu, cc = pool_sums.own_alpha(blocks[0], lobes, beta, log_mu, rules.low_alpha, rules.high_alpha)
    variance = excess / cc + by_beta * by_beta * bb + 2.0 * by_beta * by_mu * bt + by_mu * by_mu * tt
    squares, power, total = pool_sums.residual(tile.packed.blocks[members[0]], lobes, alpha, beta, log_mu)
    row[_ALPHA], row[_BETA_OUT], row[_LOG_MU] = alpha, beta, log_mu
    row[_ALPHA_ERROR] = math.sqrt(variance + (rules.model_error * alpha) ** 2)
    row[_BETA_ERROR], row[_LOG_MU_ERROR] = math.sqrt(bb), math.sqrt(tt)
    row[_RMS] = math.sqrt(squares / total)
    row[_RELATIVE] = math.sqrt(squares / power) if power > 0.0 else np.nan
    row[_COUNT] = members.size
    return True


@njit(cache=True, error_model="numpy")
def _vary(t, tile, column):
    """Return the variance between the values around a texel beyond what their errors explain (method of moments).

    All texels around that determine their gloss count, up to twice the pool's radius: the pool's own agree by choice.
    """
    radius, width, own, rows = 2 * tile.radius, tile.width, tile.own, tile.status.size // tile.width
    count, total, weight, square, inverse = 0, 0.0, 0.0, 0.0, 0.0
    row, column_of = t // width, t % width
    for y in range(max(row - radius, 0), min(row + radius + 1, rows)):
        for x in range(max(column_of - radius, 0), min(column_of + radius + 1, width)):
            value, error = own[y * width + x, column], own[y * width + x, column + 2]
            if math.isfinite(value) and (y - row) ** 2 + (x - column_of) ** 2 <= radius * radius:
                w = 1.0 / (error * error)
                count += 1
                weight += w
                total += w * value
                square += w * value * value
                inverse += w * w
    if count < _VARYING:
        return 0.0
    # DerSimonian and Laird, Controlled Clinical Trials 7(3), 1986.
    scatter = square - total * total / weight
    return max((scatter - (count - 1)) / (weight - inverse / weight), 0.0)


@njit(cache=True, error_model="numpy")
def _widen(t, tile, row):
    """Add to the errors how much gloss varies around a texel; forget the outcome where that leaves it open."""
    by_beta, by_mu = _vary(t, tile, 0), _vary(t, tile, 1)
    row[_BETA_ERROR] = row[_BETA_OUT] * math.sqrt((row[_BETA_ERROR] / row[_BETA_OUT]) ** 2 + by_beta)
    row[_LOG_MU_ERROR] = math.sqrt(row[_LOG_MU_ERROR] ** 2 + by_mu)
    if not (row[_BETA_ERROR] < _BETA * row[_BETA_OUT] and row[_LOG_MU_ERROR] < _MU):
        row[:] = np.nan


@njit(cache=True, error_model="numpy")
def _pool_texel(t, tile, row):
    """Fill the outcome of one texel in need; leave it as it is where the neighbourhood says nothing."""
    radius, used = tile.radius, tile.packed.used
    size = (2 * radius + 1) ** 2
    members, distance = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    count = _around(t, tile, members, distance)
    while radius > 0 and count > 1:
        kept = 0
        for m in range(count):
            if distance[m] <= radius * radius:
                members[kept], distance[kept] = members[m], distance[m]
                kept += 1
        count = kept
        chosen = members[:count].copy()
        if not _PROMISING * _valley(chosen, tile.packed)[1] > 2.0 * math.log(used[chosen].sum()):
            radius -= max(1, radius // 3)
            continue
        joint = _fit_members(chosen, tile)
        excess = max(joint.squares / max(used[chosen].sum() - count - 2, 1), 1.0)
        foreign, mixed, witnesses, off = _sift(chosen, joint, excess, tile)
        limit = _SILENT if tile.status[t] == _DIFFUSE_ONLY else _FOREIGN
        if not mixed and not foreign[0]:
            if foreign.any():
                chosen = chosen[~foreign]
                joint = _fit_members(chosen, tile)
                off = _misfit(chosen, 0, joint, tile) / excess
            able = off <= limit and witnesses >= _WITNESSES
            if able and _conclude(chosen, joint, tile, row):
                _widen(t, tile, row)
            return
        radius -= max(1, radius // 3)


@njit(cache=True, nogil=True)
def _pool_some(targets, tile, out, first, last):
    for i in range(first, last):
        _pool_texel(targets[i], tile, out[targets[i]])


def pool(result: FitResult, response, geometry, weight, *, n, k, options: FitOptions, noise, width: int) -> FitResult:
    """Return the result with the gloss of their neighbourhood for texels that leave β and μ open.

    Parameters
    ----------
    result : FitResult
        Of the same observations.
    response, geometry, weight, n, k, noise
        As in `irodori.fitting.solvers.fit`; where the index was fitted, a texel's own is used where it is known.
    options : FitOptions
        ``pooling_radius_texels`` is the radius; with 0 the result is returned as it is.
    width : int
        Texels in a row; texels run along the rows.

    Returns
    -------
    FitResult
        Texels of status MU_UNIDENTIFIABLE or AT_BOUND, and those of DIFFUSE_ONLY whose observations do not object,
        that found their gloss have status POOLED; ``pooled_from`` counts the texels that it comes from. Where the
        camera's noise is not known nothing is pooled.

    Raises
    ------
    ValueError
        If the texels do not fill rows of this width.
    """
    if len(response) % width:
        raise ValueError(f"{len(response)} texels in rows of {width}; accepted: whole rows")
    in_need = np.isin(result.status, _IN_NEED)
    glossy = np.isin(result.status, _TAKE_PART[:-1]).any()
    if options.pooling_radius_texels == 0 or not (glossy and in_need.any()):
        return result
    index = np.where(np.isfinite(result.index), result.index, n)
    problem, rules = problem_of(response, geometry, weight, index, k, options, noise=noise)
    if not rules.known:
        # A texel that fits well by chance would decide for all: four degrees of freedom tell no variance.
        LOGGER.info("the camera's noise is not known in every capture: gloss is not pooled")
        return result
    nodes = replace(options, scan_per_octave=4).nodes()
    own = result.gloss.copy()
    own[~np.isin(result.status, _TAKE_PART)] = np.nan
    count, observations = len(response), problem.noise.shape[1]
    packed = Packed(
        blocks=np.zeros((count, PACKED, observations)),
        used=np.zeros(count, dtype=np.int32),
        sums=np.zeros((count, 4, nodes.size)),
        nodes=nodes,
    )
    out = np.full((count, _COLUMNS), np.nan)
    pool_sums.pack(problem, rules, own, packed)
    radius = options.pooling_radius_texels
    tile = Tile(width, radius, problem.lobes, rules, result.status, _own_gloss(result), packed)
    targets = np.flatnonzero(in_need & (packed.used > 0))
    run_chunks(_pool_some, len(targets), _CHUNK, targets, tile, out)
    return _merge(result, out)


def _own_gloss(result: FitResult) -> np.ndarray:
    """Return log β and log μ of the texels that determine them, and their standard errors, (texels, 4); else NaN."""
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = [np.log(result.beta), np.log(result.mu), result.beta_error / result.beta, result.mu_error / result.mu]
    return np.where((result.status == Status.OK)[:, None], np.column_stack(columns), np.nan)


def _merge(result: FitResult, out: np.ndarray) -> FitResult:
    """Put the outcome of the pools into the result."""
    found = np.isfinite(out[:, _COUNT])
    mu = np.exp(out[:, _LOG_MU])

    def chosen(values, others):
        return np.where(found, values, others)

    return replace(
        result,
        alpha=chosen(out[:, _ALPHA], result.alpha),
        beta=chosen(out[:, _BETA_OUT], result.beta),
        mu=chosen(mu, result.mu),
        alpha_error=chosen(out[:, _ALPHA_ERROR], result.alpha_error),
        beta_error=chosen(out[:, _BETA_ERROR], result.beta_error),
        mu_error=chosen(out[:, _LOG_MU_ERROR] * mu, result.mu_error),
        residual_rms=chosen(out[:, _RMS], result.residual_rms),
        relative_residual=chosen(out[:, _RELATIVE], result.relative_residual),
        status=chosen(int(Status.POOLED), result.status).astype(np.int8),
        model=chosen(3, result.model).astype(np.int8),
        gloss=np.where(found[:, None], np.column_stack([out[:, _BETA_OUT], mu]), result.gloss),
        pooled_from=np.nan_to_num(out[:, _COUNT]).astype(np.int32),
    )
