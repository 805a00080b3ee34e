"""Solvers of equation (7), one result type."""

import ctypes
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import nlopt
import numpy as np

from irodori.fitting import kernels

MODEL_PARAMETERS = ("alpha", "beta", "mu")
_MAX_RELATIVE_ERROR = {"beta": 0.3, "mu": 0.2}
_MODEL_NOISE = 0.01  # of the root mean square response: light drift and pose error, whatever the residual says


class Status(IntEnum):
    """What became of a texel."""

    OK = 0
    GLOSS_UNIDENTIFIABLE = 1  # α holds; the data does not determine β and μ, which are NaN
    AT_BOUND = 2
    TOO_FEW_OBSERVATIONS = 3
    NON_FINITE = 4


@dataclass(frozen=True)
class FitOptions:
    """How to fit.

    Parameters
    ----------
    solver : str
        ``nlopt`` (compiled loop over texels) or ``nlopt-reference`` (NLopt from Python, one callback a step).
    algorithm : str
        Name of a local NLopt algorithm for bounded problems, for instance ``LN_BOBYQA`` or ``LD_SLSQP``.
    max_evaluations : int
    xtol_rel : float
    mu_scan : int
        Values of μ, equally spaced in log μ, tried before NLopt starts from the best.
    bounds : dict
        ``alpha``, ``beta``, ``mu_rad``: lower and upper bound.
    """

    solver: str = "nlopt"
    algorithm: str = "LD_LBFGS"
    max_evaluations: int = 400
    xtol_rel: float = 1e-6
    mu_scan: int = 32
    bounds: dict | None = None

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper bounds of α, β, μ, each (3,)."""
        bounds = self.bounds or {"alpha": (0.0, 2.0), "beta": (0.0, 1e4), "mu_rad": (0.005, 1.2)}
        pairs = np.array([bounds["alpha"], bounds["beta"], bounds["mu_rad"]], dtype=np.float64)
        return pairs[:, 0].copy(), pairs[:, 1].copy()

    def mu_grid(self) -> np.ndarray:
        """Return the values of μ to scan, rad."""
        lower, upper = self.limits()
        return np.geomspace(lower[2], upper[2], self.mu_scan)


@dataclass(frozen=True)
class FitResult:
    """Result of a fit; every array has one entry a texel.

    Parameters
    ----------
    alpha, beta, mu : (n,) float64
        NaN where the data does not determine them; μ in rad.
    alpha_error, beta_error, mu_error : (n,) float64
        Gauss-Newton standard errors, NaN likewise.
    residual_rms : (n,) float64, in response
    status : (n,) int8, see `Status`
    evaluations : (n,) int32, of the objective
    nlopt_result : (n,) int8, NLopt's return code, 0 where it was not called
    gloss : (n, 2) float64
        β and μ that explain the observations best, determined or not; β is 0 where gloss explains nothing.
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    alpha_error: np.ndarray
    beta_error: np.ndarray
    mu_error: np.ndarray
    residual_rms: np.ndarray
    status: np.ndarray
    evaluations: np.ndarray
    nlopt_result: np.ndarray
    gloss: np.ndarray


def algorithm_number(name: str) -> int:
    """Return NLopt's number of an algorithm.

    Raises
    ------
    ValueError
        Listing the accepted names: bounded local algorithms that need no inner optimiser.
    """
    accepted = [
        a
        for a in (
            "LN_BOBYQA",
            "LN_COBYLA",
            "LN_NELDERMEAD",
            "LN_SBPLX",
            "LN_PRAXIS",
            "LD_SLSQP",
            "LD_LBFGS",
            "LD_MMA",
            "LD_CCSAQ",
            "LD_TNEWTON",
            "LD_VAR2",
        )
        if hasattr(nlopt, a)
    ]
    if name not in accepted:
        raise ValueError(f"fit.algorithm {name!r}; accepted: {', '.join(accepted)}")
    return int(getattr(nlopt, name))


@lru_cache(maxsize=1)
def _functions() -> np.ndarray:
    library = ctypes.CDLL(nlopt._nlopt.__file__)
    names = (
        "create",
        "destroy",
        "set_lower_bounds",
        "set_upper_bounds",
        "set_initial_step",
        "set_min_objective",
        "set_xtol_rel",
        "set_maxeval",
        "optimize",
        "get_numevals",
    )
    addresses = [ctypes.cast(getattr(library, f"nlopt_{name}"), ctypes.c_void_p).value for name in names]
    return np.array(addresses, dtype=np.uintp)


def _solve_compiled(response, geometry, weight, n, k, options: FitOptions):
    texels = len(response)
    lower, upper = options.limits()
    parameters, sum_squares = np.full((texels, 3), np.nan), np.full(texels, np.nan)
    diffuse = np.full((texels, 2), np.nan)
    used, evaluations = np.zeros(texels, dtype=np.int64), np.zeros(texels, dtype=np.int32)
    result = np.zeros(texels, dtype=np.int8)
    kernels.fit_texels(
        _functions(),
        np.uintp(kernels.nlopt_objective.address),
        np.intc(algorithm_number(options.algorithm)),
        response,
        geometry,
        weight,
        n,
        k,
        options.mu_grid(),
        lower,
        upper,
        options.xtol_rel,
        np.intc(options.max_evaluations),
        parameters,
        sum_squares,
        diffuse,
        used,
        evaluations,
        result,
    )
    return parameters, sum_squares, diffuse, used, evaluations, result


def _solve_reference(response, geometry, weight, n, k, options: FitOptions):
    """Fit with NLopt from Python: the yardstick for time and the witness for the compiled loop."""
    lower, upper = options.limits()
    number, grid = algorithm_number(options.algorithm), options.mu_grid()
    texels = len(response)
    parameters, sum_squares = np.full((texels, 3), np.nan), np.full(texels, np.nan)
    diffuse, used = np.full((texels, 2), np.nan), np.zeros(texels, dtype=np.int64)
    evaluations, result = np.zeros(texels, dtype=np.int32), np.zeros(texels, dtype=np.int8)
    for t in range(texels):
        data = np.zeros(kernels.HEADER + kernels.WORDS * response.shape[1])
        used[t] = kernels.pack(response[t], geometry[t], weight[t], n, k, data)
        if used[t] == 0:
            continue
        diffuse[t, 0], _, diffuse[t, 1] = kernels.linear_solution(1e-6, data, lower, np.array([upper[0], lower[1]]))
        if used[t] <= kernels.PARAMETERS:
            continue
        a, b, m, best = kernels.scan(data, grid, lower, upper)
        kernels.set_scales(data, a, b)
        scale = np.array([data[1], data[2]])
        rows = data[kernels.HEADER :].reshape(-1, kernels.WORDS)[: used[t]]

        def cost(x, gradient, rows=rows, scale=scale):
            ratio2 = (rows[:, 2] / np.exp(x[2])) ** 2
            lobe = rows[:, 1] * np.exp(-ratio2)
            residual = x[0] * scale[0] * rows[:, 0] + x[1] * scale[1] * lobe - rows[:, 3]
            if gradient.size:
                weighted = 2.0 * rows[:, 4] * residual
                gradient[:] = (
                    scale[0] * weighted @ rows[:, 0],
                    scale[1] * weighted @ lobe,
                    x[1] * scale[1] * weighted @ (lobe * 2.0 * ratio2),
                )
            return float(rows[:, 4] @ residual**2)

        optimiser = nlopt.opt(number, 3)
        low = np.append(lower[:2] / scale, np.log(lower[2]))
        high = np.append(upper[:2] / scale, np.log(upper[2]))
        optimiser.set_lower_bounds(low)
        optimiser.set_upper_bounds(high)
        optimiser.set_initial_step(np.full(3, 0.1))
        optimiser.set_min_objective(cost)
        optimiser.set_xtol_rel(options.xtol_rel)
        optimiser.set_maxeval(options.max_evaluations)
        x = np.clip(np.append(np.array([a, b]) / scale, np.log(m)), low, high)
        parameters[t], sum_squares[t] = (a, b, m), best
        try:
            x = optimiser.optimize(x)
            result[t] = optimiser.last_optimize_result()
        except nlopt.RoundoffLimited:
            result[t] = nlopt.ROUNDOFF_LIMITED
        evaluations[t] = optimiser.get_numevals() + grid.size
        polished = cost(x, np.empty(0))
        if polished <= best:
            parameters[t], sum_squares[t] = (*(x[:2] * scale), np.exp(x[2])), polished
    return parameters, sum_squares, diffuse, used, evaluations, result


SOLVERS = {"nlopt": _solve_compiled, "nlopt-reference": _solve_reference}


def fit(
    response: np.ndarray,
    geometry: np.ndarray,
    weight: np.ndarray,
    n: float = 1.5,
    k: float = 0.0,
    options: FitOptions | None = None,
) -> FitResult:
    """Fit α, β, μ of equation (5) to every texel's observations [eq. 7].

    Parameters
    ----------
    response : (texels, J) float
        Responses of the green band.
    geometry : (texels, J, 4) float
        θ_i, θ_r, θ_H, φ in rad.
    weight : (texels, J) float
        Zero leaves an observation out.
    n, k : float
        Complex refractive index.
    options : FitOptions

    Returns
    -------
    FitResult

    Raises
    ------
    ValueError
        For an unknown solver or algorithm, listing those accepted, or for shapes that do not agree.
    """
    options = options or FitOptions()
    if options.solver not in SOLVERS:
        raise ValueError(f"fit.solver {options.solver!r}; accepted: {', '.join(SOLVERS)}")
    response, geometry, weight = (np.ascontiguousarray(a, dtype=np.float64) for a in (response, geometry, weight))
    if response.ndim != 2 or geometry.shape != (*response.shape, 4) or weight.shape != response.shape:
        raise ValueError(
            f"response {response.shape}, geometry {geometry.shape}, weight {weight.shape}; accepted: "
            "(n, J), (n, J, 4), (n, J)"
        )
    # A non-finite observation says nothing; it must not turn a texel's sums into NaN.
    weight = np.where(np.isfinite(response) & np.isfinite(geometry).all(axis=-1) & np.isfinite(weight), weight, 0.0)
    parameters, squares, diffuse, used, evaluations, result = SOLVERS[options.solver](
        response, geometry, weight, float(n), float(k), options
    )
    errors = np.empty((len(response), 3))
    kernels.standard_errors(
        response, geometry, weight, float(n), float(k), parameters, squares, used, _MODEL_NOISE, errors
    )
    return _judge(parameters, squares, diffuse, used, errors, evaluations, result, weight, options)


def _judge(parameters, squares, diffuse, used, errors, evaluations, result, weight, options) -> FitResult:
    """Decide what the data determines, and put NaN where it does not."""
    lower, upper = options.limits()
    few = used <= kernels.PARAMETERS
    fitted = ~few & np.isfinite(squares)
    with np.errstate(divide="ignore", invalid="ignore"):
        # BIC of the full model against diffuse only: two more parameters must pay for themselves.
        floor = np.finfo(np.float64).tiny
        gain = used * (np.log(np.maximum(diffuse[:, 1], floor)) - np.log(np.maximum(squares, floor)))
        glossy = fitted & (gain > 2.0 * np.log(np.maximum(used, 1))) & (parameters[:, 1] > 0)
        relative = errors / np.abs(parameters)
        at_bound = (parameters[:, :2] >= upper[:2] * (1 - 1e-6)).any(axis=1)
        at_bound |= (parameters[:, 2] >= upper[2] * (1 - 1e-4)) | (parameters[:, 2] <= lower[2] * (1 + 1e-4))
        determined = glossy & ~at_bound & (relative[:, 1] < _MAX_RELATIVE_ERROR["beta"])
        determined &= relative[:, 2] < _MAX_RELATIVE_ERROR["mu"]
    status = np.where(determined, Status.OK, Status.GLOSS_UNIDENTIFIABLE).astype(np.int8)
    status[glossy & at_bound] = Status.AT_BOUND
    status[~few & ~fitted] = Status.NON_FINITE
    status[few] = Status.TOO_FEW_OBSERVATIONS
    alpha = np.where(glossy, parameters[:, 0], np.where(fitted, diffuse[:, 0], np.nan))
    squares = np.where(glossy, squares, np.where(fitted, diffuse[:, 1], np.nan))
    total_weight = weight.sum(axis=1)
    rms = np.sqrt(np.divide(squares, total_weight, out=np.full_like(squares, np.nan), where=total_weight > 0))
    known = np.where(determined, 1.0, np.nan)
    gloss = np.where(glossy[:, None], parameters[:, 1:], np.array([0.0, 1.0]))
    return FitResult(
        alpha=alpha,
        beta=parameters[:, 1] * known,
        mu=parameters[:, 2] * known,
        alpha_error=np.where(glossy & np.isfinite(errors[:, 0]), errors[:, 0], np.nan),
        beta_error=np.where(determined, errors[:, 1], np.nan),
        mu_error=np.where(determined, errors[:, 2], np.nan),
        residual_rms=rms,
        status=status,
        evaluations=evaluations,
        nlopt_result=result,
        gloss=gloss,
    )
