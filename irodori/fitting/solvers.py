"""Solvers of equation (7), one result type."""

import ctypes
from dataclasses import dataclass
from functools import lru_cache

import nlopt
import numpy as np

from irodori.fitting import kernels
from irodori.material import Status

MODEL_PARAMETERS = ("alpha", "beta", "mu")
_MAX_RELATIVE_ERROR = {"beta": 0.3, "mu": 0.2}
# Bounded local algorithms that reach the minimum on noisy texels; MMA and CCSAQ stop at up to three times its value.
_ALGORITHMS = (
    "LN_BOBYQA",
    "LN_COBYLA",
    "LN_NELDERMEAD",
    "LN_SBPLX",
    "LN_PRAXIS",
    "LD_SLSQP",
    "LD_LBFGS",
    "LD_TNEWTON",
    "LD_VAR2",
)
_SETTINGS = ("objective", "algorithm", "xtol_rel", "max_evaluations")
_ROUNDING = 1e-7  # relative residual under which two models are equally perfect
_MODEL_NOISE = 0.01  # of the root mean square response: light drift and pose error, whatever the residual says


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
    xtol_rel: float = 1e-8
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
    relative_residual : (n,) float64
        Residual over the root mean square response.
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
    relative_residual: np.ndarray
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
    accepted = [name for name in _ALGORITHMS if hasattr(nlopt, name)]
    if name not in accepted:
        raise ValueError(f"fit.algorithm {name!r}; accepted: {', '.join(accepted)}")
    return int(getattr(nlopt, name))


@lru_cache(maxsize=1)
def _addresses() -> dict[str, int]:
    library = ctypes.CDLL(nlopt._nlopt.__file__)
    names = [name for name in kernels.Nlopt._fields if name not in _SETTINGS]
    return {name: ctypes.cast(getattr(library, f"nlopt_{name}"), ctypes.c_void_p).value for name in names}


def _empty_output(texels: int) -> kernels.Output:
    return kernels.Output(
        parameters=np.full((texels, 3), np.nan),
        sum_squares=np.full(texels, np.nan),
        diffuse=np.full((texels, 2), np.nan),
        used=np.zeros(texels, dtype=np.int64),
        evaluations=np.zeros(texels, dtype=np.int32),
        result=np.zeros(texels, dtype=np.int8),
    )


def _solve_compiled(response, geometry, weight, n, k, options: FitOptions) -> kernels.Output:
    lower, upper = options.limits()
    library = kernels.Nlopt(
        **_addresses(),
        objective=kernels.nlopt_objective.address,
        algorithm=algorithm_number(options.algorithm),
        xtol_rel=float(options.xtol_rel),
        max_evaluations=int(options.max_evaluations),
    )
    out = _empty_output(len(response))
    kernels.fit_texels(library, response, geometry, weight, n, k, options.mu_grid(), lower, upper, out)
    return out


def _cost(rows: np.ndarray, scale: np.ndarray, factor: float):
    """Return the objective of one texel in NLopt's Python signature; ``rows`` as in `irodori.fitting.kernels`."""

    def cost(x, gradient):
        ratio2 = (rows[:, 2] / np.exp(x[2])) ** 2
        lobe = rows[:, 1] * np.exp(-ratio2)
        residual = x[0] * scale[0] * rows[:, 0] + x[1] * scale[1] * lobe - rows[:, 3]
        if gradient.size:
            weighted = 2.0 * factor * rows[:, 4] * residual
            gradient[0] = scale[0] * weighted @ rows[:, 0]
            gradient[1] = scale[1] * weighted @ lobe
            gradient[2] = x[1] * scale[1] * weighted @ (lobe * 2.0 * ratio2)
        return factor * float(rows[:, 4] @ residual**2)

    return cost


def _solve_reference(response, geometry, weight, n, k, options: FitOptions) -> kernels.Output:
    """Fit with NLopt from Python: the yardstick for time and the witness for the compiled loop."""
    lower, upper = options.limits()
    number, grid = algorithm_number(options.algorithm), options.mu_grid()
    out = _empty_output(len(response))
    for t in range(len(response)):
        data = np.zeros(kernels.HEADER + kernels.WORDS * response.shape[1])
        out.used[t] = kernels.pack(response[t], geometry[t], weight[t], n, k, data)
        if out.used[t] == 0:
            continue
        without_gloss = np.array([upper[0], lower[1]])
        out.diffuse[t, 0], _, out.diffuse[t, 1] = kernels.linear_solution(1e-6, data, lower, without_gloss)
        if out.used[t] <= kernels.PARAMETERS:
            continue
        a, b, m, best = kernels.scan(data, grid, lower, upper)
        kernels.set_scales(data, a, b)
        scale = data[1:3].copy()
        cost = _cost(data[kernels.HEADER :].reshape(-1, kernels.WORDS)[: out.used[t]], scale, data[3])
        low, high = np.append(lower[:2] / scale, np.log(lower[2])), np.append(upper[:2] / scale, np.log(upper[2]))
        optimiser = nlopt.opt(number, kernels.PARAMETERS)
        optimiser.set_lower_bounds(low)
        optimiser.set_upper_bounds(high)
        optimiser.set_initial_step(np.full(kernels.PARAMETERS, 0.1))
        optimiser.set_min_objective(cost)
        optimiser.set_xtol_rel(options.xtol_rel)
        optimiser.set_maxeval(options.max_evaluations)
        x = np.clip(np.append(np.array([a, b]) / scale, np.log(m)), low, high)
        out.parameters[t], out.sum_squares[t] = (a, b, m), best
        try:
            x = optimiser.optimize(x)
            out.result[t] = optimiser.last_optimize_result()
        except nlopt.RoundoffLimited:
            out.result[t] = nlopt.ROUNDOFF_LIMITED
        out.evaluations[t] = optimiser.get_numevals() + grid.size
        polished = cost(x, np.empty(0)) / data[3]
        if polished <= best:
            out.parameters[t], out.sum_squares[t] = (*(x[:2] * scale), np.exp(x[2])), polished
    return out


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
    out = SOLVERS[options.solver](response, geometry, weight, float(n), float(k), options)
    errors = np.empty((len(response), 3))
    kernels.standard_errors(response, geometry, weight, float(n), float(k), out, _MODEL_NOISE, errors)
    power = np.sum(weight * np.where(weight > 0, response, 0.0) ** 2, axis=1)
    return _judge(out, errors, weight, power, options)


def _judge(out: kernels.Output, errors, weight, power, options: FitOptions) -> FitResult:
    """Decide what the data determines, and put NaN where it does not."""
    parameters, squares, diffuse, used = out.parameters, out.sum_squares, out.diffuse, out.used
    lower, upper = options.limits()
    few = used <= kernels.PARAMETERS
    fitted = ~few & np.isfinite(squares)
    with np.errstate(divide="ignore", invalid="ignore"):
        # BIC of the full model against diffuse only: two more parameters must pay for themselves.
        floor = np.maximum(_ROUNDING**2 * power, np.finfo(np.float64).tiny)
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
        relative_residual=np.sqrt(np.divide(squares, power, out=np.full_like(power, np.nan), where=power > 0)),
        status=status,
        evaluations=out.evaluations,
        nlopt_result=out.result,
        gloss=gloss,
    )
