"""Variable projection of eight texels at once, for the ordinary case.

A texel takes this way where one interval of the scan certainly holds the lowest minimum, no other comes near, and the
data calls for both diffuse light and gloss. Every step is that of `irodori.fitting.texels`, and where a lane meets
anything else it is handed back, to be fitted alone. The rows of observations are
filled by `irodori.fitting.vectorised_rows`, the minimum is found by `lane_scan` and judged by `lane_judge`.
"""

from irodori.fitting import judge
from irodori.fitting.vectorised_judge import judge_lanes
from irodori.fitting.vectorised_rows import expect, load_rows, pack_own, tell, weigh_rows
from irodori.fitting.vectorised_scan import best_interval, newton, scan_squares, scan_tables, value_nodes
from irodori.jit.lanes import COUNT, bits, select, store
from irodori.jit.native import uncounted

NOISY = 0.01  # relative variance of an observation times their number, from which on weights are of the fitted response


@uncounted(error_model="numpy")
def _minimise(problem, shared, rules, rows, sums, ordinary):
    """Return the fixed sums, log μ, α, β, the steps, and which lanes stayed ordinary."""
    captures, nodes = problem.response.shape[1], problem.nodes.size
    box = (rules.low_alpha, rules.high_alpha, rules.low_beta, rules.high_beta)
    fixed, changed = weigh_rows(rows, captures)
    if shared.nodes.shape[1] == 0:
        scan_squares(problem, rows, sums)
    else:
        scan_tables(shared, rows, captures, nodes, sums, changed)
    least, top = value_nodes(fixed, sums, nodes, box)
    place, bracket, single = best_interval(problem, sums, least, top)
    t, a, b, steps, converged = newton(rows, captures, fixed, box, place, bracket, ordinary & single)
    return fixed, t, a, b, steps, converged


@uncounted(error_model="numpy")
def fit_abreast(problem, shared, rules, first, last, buffers):
    """Fit texels ``first`` .. ``first + 7``, those before ``last``; return a bit for each that is done.

    Parameters
    ----------
    problem, shared, rules
        As in `irodori.fitting.texels`; the rows of a shared geometry are filled already.
    buffers : Abreast
        Its results are filled.
    """
    captures, rows, sums = problem.response.shape[1], buffers.rows, buffers.sums
    if shared.nodes.shape[1] == 0:
        pack_own(problem, first, last, rows)
    used, floor, ordinary = load_rows(problem, rules, first, last, rows)
    ordinary = ordinary & tell(rows, captures)
    fixed, t, a, b, steps, ordinary = _minimise(problem, shared, rules, rows, sums, ordinary)
    if rules.weighted:
        noisy = ordinary & (used * used * floor > NOISY * fixed[2])
        if bits(noisy) != 0:
            expect(problem, rules, rows, a, b, t, noisy)
            before = steps
            fixed, t, a, b, steps, ordinary = _minimise(problem, shared, rules, rows, sums, ordinary)
            steps = select(noisy, steps + before, steps)
    if bits(ordinary) == 0:
        return 0
    ordinary = ordinary & judge_lanes(rows, captures, fixed, (a, b, t), used, floor, rules, buffers.results)
    store(buffers.results, (judge.COLUMNS + 1) * COUNT, steps + problem.nodes.size)
    return int(bits(ordinary)) & _unclipped(problem, first, last)


@uncounted()
def _unclipped(problem, first, last):
    """Return a bit for each texel of which no observation clips."""
    found = (1 << min(COUNT, last - first)) - 1
    for i in range(min(COUNT, last - first)):
        t = first + i if problem.clipped.shape[0] > 1 else 0
        for j in range(problem.clipped.shape[1]):
            if problem.clipped[t, j] != 0:
                found &= ~(1 << i)
    return found


@uncounted()
def write_abreast(results, done, first, out):
    """Store the results of the lanes that are ``done`` as those of the texels from ``first`` on."""
    for i in range(COUNT):
        if done >> i & 1:
            for column in range(judge.COLUMNS):
                out.table[first + i, column] = results[column, i]
            out.status[first + i], out.model[first + i] = int(results[judge.COLUMNS, i]), judge.BOTH
            out.evaluations[first + i] = int(results[judge.COLUMNS + 1, i])
