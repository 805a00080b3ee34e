"""Solvers of equation (7), with a common interface and result type."""

import ctypes
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import lru_cache
from typing import Literal

import nlopt
import numpy as np

from irodori.config.cross_checks.object_lobes import SETTINGS_WITH_TWO_LOBES
from irodori.config.definition import check_choices, typed
from irodori.config.models import Fit, FitBounds
from irodori.core.errors import counted
from irodori.fitting import judge, nlopt_loop, texels, two_lobes
from irodori.fitting.observations import Minimum, Rules, camera_noise
from irodori.fitting.reported_parameters import report_parameters
from irodori.fitting.shared_geometry import no_shared
from irodori.fitting.texel_rows import COSINE, LOBE, LOBE_SLOPE, RESPONSE, WEIGHT
from irodori.fitting.varpro import NODE_STEP
from irodori.material.angle_errors import AngleErrors, errors_in_use
from irodori.reflection.albedo import gloss_albedo
from irodori.reflection.coat import COATS, COUPLED, SUM
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobes import Lobes
from irodori.reflection.registry import DEFAULT_LOBES, lobe, names

# NLopt's fastest bounded algorithm of those that reach the minimum on noisy texels, and where it stops.
_ALGORITHM, _XTOL_REL, _MAX_EVALUATIONS = nlopt.LD_LBFGS, 1e-8, 400
MAX_LOBES = 2
_SETTINGS = ("objective", "algorithm", "xtol_rel", "max_evaluations")


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FitOptions(Fit):
    """The ``fit`` block of the configuration, with the gloss of the object and the errors of its angles.

    `fit` takes responses as they are and treats texels separately: it ignores ``level_by_photograph``, see
    `irodori.fitting.level_estimate`, and ``gloss_by_paint``, see `irodori.fitting.paints`.

    Parameters
    ----------
    solver : str
        ``varpro`` (variable projection), ``nlopt`` (NLopt's L-BFGS in a compiled loop over texels) or, for comparison,
        ``nlopt-reference`` (the same from Python, with a callback for each evaluation).
    bounds : FitBounds or mapping
        Lower and upper bound by name: ``alpha``, ``beta``, ``mu_rad``.
    lobes : tuple of str
        Lobes of the gloss, one or two, see `irodori.reflection.registry`. The bounds of μ are in the unit of the lobe.
    registered : AngleErrors, optional
        Errors of the angles by registration of the object.
    coat : str
        ``sum``: as in equation (5); ``coupled``: the coat reduces the diffuse term, see `irodori.reflection.coat`.
    lamp_radius_deg : float, optional
        Angular radius of the lamp, if it is known. Readings in which its mirror image may be are then not fitted, see
        `irodori.fitting.mirror_image`; `fit` ignores it.
    """

    solver: Literal["varpro", "nlopt", "nlopt-reference"] = "varpro"  # type: ignore[assignment]
    lobes: tuple[str, ...] = DEFAULT_LOBES
    registered: AngleErrors | None = None
    coat: str = SUM
    lamp_radius_deg: float | None = None

    def __post_init__(self):
        check_choices(self)
        if self.coat not in COATS:
            raise ValueError(f"coat {self.coat!r}; accepted: {', '.join(COATS)}")
        self._check_lobes()
        for name in vars(FitBounds()):
            low, high = self.limits(name)
            if not low < high * (0.99 if name == "mu_rad" else 1.0) < np.inf:
                raise ValueError(f"fit.bounds {name} of {low:g} to {high:g}; accepted: a range, lower bound first")

    def _check_lobes(self) -> None:
        check_lobes(self.lobes)
        if len(self.lobes) == 1:
            return
        for name, accepted in SETTINGS_WITH_TWO_LOBES.items():
            value = getattr(self, name)
            if value != accepted:
                raise ValueError(f"fit.{name} {value!r} of an object with two lobes; accepted: {accepted!r}")

    def limits(self, name: str) -> tuple[float, float]:
        """Return lower and upper bound of a parameter; those of μ are limited to the domain of the lobes."""
        low, high = getattr(typed(FitBounds, self.bounds), name)
        if name == "mu_rad":
            defined = [lobe(one).roughness for one in self.lobes]
            low, high = max(low, *(one.low for one in defined)), min(high, *(one.high for one in defined))
        return float(low), float(high)

    @property
    def is_coupled(self) -> bool:
        """Whether the coat reduces the diffuse term."""
        return self.coat == COUPLED

    @property
    def angles(self) -> AngleErrors:
        """Errors of the angles that the fit uses."""
        return errors_in_use(self.pose_error_deg, self.registered)

    def nodes(self) -> np.ndarray:
        """Return log μ of the scan, in decreasing order from the upper to the lower bound.

        Successive μ differ by a factor √2; the last step may be shorter.
        """
        low, high = np.log(self.limits("mu_rad"))
        nodes = high - NODE_STEP * np.arange(int((high - low) / NODE_STEP + 1e-9) + 1)
        return np.append(nodes[nodes > low + 1e-9], low)


@dataclass(frozen=True)
class FitResult:
    """Result of a fit; every array has one entry for each texel.

    Parameters
    ----------
    alpha, beta, mu : (n,) float64
        NaN where the data do not determine them; μ in rad.
    alpha_error, beta_error, mu_error : (n,) float64
        Standard errors (see `irodori.fitting.judge`), NaN likewise.
    residual_rms : (n,) float64
        Weighted RMS residual of the responses.
    relative_residual : (n,) float64
        Residual divided by the RMS response.
    status : (n,) int8
        See `Status`.
    model : (n,) int8
        Terms needed to explain the observations: 0 none, 1 diffuse reflection, 2 gloss, 3 both.
    evaluations : (n,) int32
        Evaluations of the objective.
    nlopt_result : (n,) int8
        NLopt's return code; 0 if it was not called.
    gloss : (n, 2) float64
        β and μ that explain the observations best, determined or not; β is 0 where gloss explains nothing. With two
        lobes (n, 4): those of the first, then of the second.
    lobes : tuple of str
        Lobe of each component.
    beta_2, mu_2, beta_2_error, mu_2_error : (n,) float64
        Parameters of the second component; None with one lobe. Where one component suffices, the weight of the other
        is 0 and its roughness NaN.
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    alpha_error: np.ndarray
    beta_error: np.ndarray
    mu_error: np.ndarray
    residual_rms: np.ndarray
    relative_residual: np.ndarray
    status: np.ndarray
    model: np.ndarray
    evaluations: np.ndarray
    nlopt_result: np.ndarray
    gloss: np.ndarray
    lobes: tuple[str, ...] = DEFAULT_LOBES
    beta_2: np.ndarray | None = None
    mu_2: np.ndarray | None = None
    beta_2_error: np.ndarray | None = None
    mu_2_error: np.ndarray | None = None


def check_lobes(lobes) -> None:
    """Check the names of an object's lobes.

    Raises
    ------
    ValueError
        If there is none, more than two, or an unknown name; the message suggests the nearest known name.
    """
    if not 1 <= len(lobes) <= MAX_LOBES:
        raise ValueError(f"{counted(len(lobes), 'lobe')}; accepted: 1 to {MAX_LOBES}")
    for name in lobes:
        if name not in names():
            near = get_close_matches(str(name), names(), 1, 0.0)[0]
            raise ValueError(f"lobe {name!r}; did you mean {near!r}? Accepted: {', '.join(names())}")


@lru_cache(maxsize=1)
def _addresses() -> dict[str, int]:
    library = ctypes.CDLL(nlopt._nlopt.__file__)
    names = [name for name in nlopt_loop.Nlopt._fields if name not in _SETTINGS]
    return {name: ctypes.cast(getattr(library, f"nlopt_{name}"), ctypes.c_void_p).value or 0 for name in names}


def _empty_output(count: int) -> texels.Output:
    return texels.Output(
        table=np.empty((count, judge.COLUMNS)),  # every row is written later, with NaN where there are too few data
        status=np.zeros(count, dtype=np.int8),
        model=np.zeros(count, dtype=np.int8),
        evaluations=np.zeros(count, dtype=np.int32),
        result=np.zeros(count, dtype=np.int8),
    )


def _solve_varpro(problem: texels.Problem, rules: Rules, options: FitOptions) -> texels.Output:
    out = _empty_output(len(problem.response))
    texels.fit_texels(problem, rules, out)
    return out


def _solve_nlopt(problem: texels.Problem, rules: Rules, options: FitOptions) -> texels.Output:
    library = nlopt_loop.Nlopt(
        **_addresses(),
        objective=nlopt_loop.nlopt_objective(problem.lobes).address,
        algorithm=_ALGORITHM,
        xtol_rel=_XTOL_REL,
        max_evaluations=_MAX_EVALUATIONS,
    )
    out = _empty_output(len(problem.response))
    nlopt_loop.fit_nlopt(library, problem.in_float64(), rules, out)
    return out


def _cost(rows: np.ndarray, lobes, scale: np.ndarray, factor: float):
    """Return the objective of one texel with NLopt's Python signature; its unknowns are divided by their scales."""
    cosine, response, weight = rows[COSINE], rows[RESPONSE], rows[WEIGHT]
    lobe, slope = rows[LOBE], rows[LOBE_SLOPE]

    def cost(x, gradient):
        nlopt_loop.fill_lobe_and_slope(rows, lobes, x[2])
        residual = x[0] * scale[0] * cosine + x[1] * scale[1] * lobe - response
        if gradient.size:
            weighted = 2.0 * factor * weight * residual
            gradient[0] = scale[0] * weighted @ cosine
            gradient[1] = scale[1] * weighted @ lobe
            gradient[2] = x[1] * scale[1] * weighted @ slope
        return factor * float(weight @ residual**2)

    return cost


def _solve_reference(problem: texels.Problem, rules: Rules, options: FitOptions) -> texels.Output:
    """Fit with NLopt from Python: a reference for the speed of the compiled loops and a check of their results."""
    problem = problem.in_float64()
    out = _empty_output(len(problem.response))
    task = texels.Task(problem, rules, no_shared())
    data, room = nlopt_loop.new_data(problem)
    rows = room.rows
    low = np.array([rules.low_alpha, rules.low_beta, rules.low_log_mu])
    high = np.array([rules.high_alpha, rules.high_beta, rules.high_log_mu])
    for t in range(len(problem.response)):
        loaded = nlopt_loop.load_own(t, problem, rules, rows)
        if loaded[0] <= judge.PARAMETERS:
            texels.write_too_few(t, loaded[0], problem, rows, out)
            continue
        evidence, (*start, scanned), best = nlopt_loop.start_of(task, room, loaded)
        nlopt_loop.set_scales(data, rows, evidence.fixed[2], start[0], start[1])
        scale = np.append(data[1:3], 1.0)
        cost = _cost(rows, problem.lobes, scale, data[3])
        optimiser = nlopt.opt(_ALGORITHM, nlopt_loop.PARAMETERS)
        optimiser.set_lower_bounds(low / scale)
        optimiser.set_upper_bounds(high / scale)
        optimiser.set_min_objective(cost)
        optimiser.set_xtol_rel(_XTOL_REL)
        optimiser.set_maxeval(_MAX_EVALUATIONS)
        x = np.clip(np.array(start) / scale, low / scale, high / scale)
        try:
            x = optimiser.optimize(x)
            out.result[t] = optimiser.last_optimize_result()
        except nlopt.RoundoffLimited:
            out.result[t] = nlopt.ROUNDOFF_LIMITED
        if cost(x, np.empty(0)) / data[3] <= best:
            start = x * scale
        alpha, beta, log_mu = map(float, start)
        found = Minimum(alpha, beta, log_mu, optimiser.get_numevals() + scanned)
        nlopt_loop.finish(t, task, room, evidence, found, out)
    return out


SOLVERS = {"varpro": _solve_varpro, "nlopt": _solve_nlopt, "nlopt-reference": _solve_reference}


def problem_of(
    response, geometry, weight, n, k, options: FitOptions, *, noise, clipped=None
) -> tuple[texels.Problem, Rules]:
    """Convert the arguments of `fit` to the `Problem` and `Rules` of the compiled loops.

    Raises
    ------
    ValueError
        If the shapes do not agree.
    """
    # All arrays float32 or all float64, contiguous and writeable: loops are compiled anew for every other combination.
    dtype = np.float32 if np.asarray(response).dtype == np.float32 else np.float64
    response, geometry, weight = (np.require(a, dtype, ["C", "W"]) for a in (response, geometry, weight))
    geometry = geometry[None] if geometry.ndim == 2 else geometry
    clipped = np.zeros((1, 0), dtype=np.uint8) if clipped is None else np.asarray(clipped, dtype=np.uint8)
    count, captures = response.shape
    fits = geometry.shape in ((count, captures, 4), (1, captures, 4)) and weight.shape == response.shape
    fits &= clipped.shape in ((1, 0), response.shape)
    if not fits or (noise is not None and np.shape(noise) != (captures, 2)):
        raise ValueError(
            f"response {response.shape}, geometry {geometry.shape}, weight {weight.shape}, clipped {clipped.shape}, "
            f"noise {np.shape(noise)}; accepted: (n, J), (n, J, 4) or (J, 4), (n, J), (n, J), (J, 2)"
        )
    nodes = options.nodes()
    camera, known = camera_noise(noise, captures)
    problem = texels.Problem(
        response, weight, geometry, np.require(clipped, requirements=["C", "W"]), float(n), float(k), camera, nodes,
        _most_beta(options.lobes[0], nodes, n, k), Lobes((options.lobes[0],)), options.is_coupled,
    )  # fmt: skip
    rules = Rules(
        *options.limits("alpha"), *options.limits("beta"), float(nodes[-1]), float(nodes[0]), known,
        float(options.model_error), *options.angles.variances, float(options.level_error),
    )  # fmt: skip
    return problem, rules


def _most_beta(name: str, nodes: np.ndarray, n: float, k: float) -> np.ndarray:
    """Return β at nodes of log μ with which a lobe reflects, of light along the normal, as much as a smooth surface."""
    albedo = gloss_albedo(name, np.exp(nodes), 1.0, n, k)[:, 0, 0]
    # An index of 1 reflects nothing.
    return np.divide(fresnel_array(np.ones(1), n, k)[0], albedo, out=np.zeros_like(albedo), where=albedo > 0.0)


def fit(
    response: np.ndarray,
    geometry: np.ndarray,
    weight: np.ndarray,
    n: float = 1.5,
    k: float = 0.0,
    options: FitOptions | None = None,
    *,
    noise: np.ndarray | None = None,
    clipped: np.ndarray | None = None,
) -> FitResult:
    """Fit α, β and μ of equation (5) to the observations of each texel [eq. 7].

    Parameters
    ----------
    response : (texels, J) float
        Responses of the green band.
    geometry : (texels, J, 4) or (J, 4) float
        θ_i, θ_r, θ_H, φ in rad; a common geometry for all texels is much faster.
    weight : (texels, J) float
        Weights; observations with 0 are ignored.
    n, k : float
        Complex refractive index.
    options : FitOptions
    noise : (J, 2) float
        c0 and c1 of the variance c0 + c1 ρ of a response. If None, or NaN for any capture, weights are equal.
    clipped : (texels, J) bool
        Observations that the camera clipped.

    Returns
    -------
    FitResult

    Raises
    ------
    ValueError
        If the shapes do not agree.
    """
    options = options or FitOptions()
    problem, rules = problem_of(response, geometry, weight, n, k, options, noise=noise, clipped=clipped)
    if len(options.lobes) > 1:
        return _fit_two(problem, rules, options)
    return _result(SOLVERS[options.solver](problem, rules, options), problem)


def _result(out: texels.Output, problem: texels.Problem) -> FitResult:
    """Convert the output of the loops to a `FitResult`."""
    stated, gloss = report_parameters(out)
    return FitResult(
        **stated,
        status=out.status,
        model=out.model,
        evaluations=out.evaluations,
        nlopt_result=out.result,
        gloss=gloss,
        lobes=problem.lobes.names,
    )


def _fit_two(problem: texels.Problem, rules: Rules, options: FitOptions) -> FitResult:
    """Fit two gloss components where the data need them, and one elsewhere."""
    second = Lobes((options.lobes[1],))
    one = _solve_varpro(problem, rules, options)
    most = _most_beta(options.lobes[1], problem.nodes, problem.n, problem.k)
    of_second = problem._replace(lobes=second, most_beta=most)
    two = one if second == problem.lobes else _solve_varpro(of_second, rules, options)
    found = two_lobes.fit_two(problem, second, rules, one, two)
    first, other = _result(one, problem), _result(two, problem)
    both = found.both == 1
    of_second = (found.second == 1) & ~both
    table = found.table
    errors = table[:, two_lobes.ERRORS : two_lobes.ERRORS + two_lobes.PARAMETERS]
    free = both & np.isin(found.status, [judge.Status.OK, judge.Status.MU_UNIDENTIFIABLE, judge.Status.CONTRADICTED])

    def stated(values, known):
        return np.where(free & known, values, np.nan)

    def chosen(name: str, values):
        return np.where(both, values, np.where(of_second, getattr(other, name), getattr(first, name)))

    known = [np.isfinite(errors[:, i]) for i in range(two_lobes.PARAMETERS)]
    mu, mu_2 = np.exp(table[:, two_lobes.LOG_MU]), np.exp(table[:, two_lobes.LOG_MU_2])
    sure = known[0] | (found.model == judge.GLOSS_ALONE)
    alone = np.where(np.isfinite(first.beta), 0.0, np.nan)  # weight of a component that is not needed
    alone_2 = np.where(np.isfinite(other.beta), 0.0, np.nan)
    power, squares = table[:, two_lobes.POWER], table[:, two_lobes.SQUARES]
    nothing = np.tile([0.0, 1.0], (len(both), 1))
    gloss = np.where(of_second[:, None], np.hstack([nothing, other.gloss]), np.hstack([first.gloss, nothing]))
    pairs = np.column_stack([table[:, two_lobes.BETA], mu, table[:, two_lobes.BETA_2], mu_2])
    edge = found.status == judge.Status.AT_BOUND
    return replace(
        first,
        alpha=chosen("alpha", np.where(sure, table[:, two_lobes.ALPHA], np.nan)),
        alpha_error=chosen("alpha_error", np.where(known[0] & ~edge, errors[:, 0], np.nan)),
        beta=np.where(of_second, alone_2, np.where(both, stated(table[:, two_lobes.BETA], known[1]), first.beta)),
        mu=np.where(of_second, np.nan, np.where(both, stated(mu, known[2]), first.mu)),
        beta_error=np.where(of_second, np.nan, np.where(both, stated(errors[:, 1], known[1]), first.beta_error)),
        mu_error=np.where(of_second, np.nan, np.where(both, stated(errors[:, 2] * mu, known[2]), first.mu_error)),
        beta_2=np.where(of_second, other.beta, np.where(both, stated(table[:, two_lobes.BETA_2], known[3]), alone)),
        mu_2=np.where(of_second, other.mu, stated(mu_2, known[4])),
        beta_2_error=np.where(of_second, other.beta_error, stated(errors[:, 3], known[3])),
        mu_2_error=np.where(of_second, other.mu_error, stated(errors[:, 4] * mu_2, known[4])),
        residual_rms=chosen("residual_rms", np.sqrt(squares)),
        relative_residual=chosen("relative_residual", np.sqrt(squares / np.where(power > 0.0, power, np.nan))),
        status=chosen("status", found.status),
        model=chosen("model", found.model),
        evaluations=first.evaluations + (0 if two is one else other.evaluations) + found.evaluations,
        gloss=np.where(both[:, None], pairs, gloss),
        lobes=tuple(options.lobes),
    )
