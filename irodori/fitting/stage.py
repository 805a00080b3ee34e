"""The stage: observations of a tile in, parameters and diffuse responses out."""

import math
import time

import numba
import numpy as np

from irodori import store
from irodori.brdf import gloss_factors
from irodori.fitting.solvers import FitOptions, FitResult, fit
from irodori.material import Status
from irodori.progress import LOGGER

GREEN = 1  # green without the filter, the band of equation (7)
_RESPONSE_NOISE = 0.01
_GLOSS_MODEL_ERROR = 0.1


@numba.njit(cache=True, parallel=True, nogil=True)
def _combine(response, cosine, gloss, weight, noise, out, variance):
    texels, captures, bands = response.shape
    for t in numba.prange(texels):
        for b in range(bands):
            top, bottom, spread = 0.0, 0.0, 0.0
            for j in range(captures):
                rho = response[t, j, b]
                if not weight[t, j] > 0.0 or not math.isfinite(rho) or not math.isfinite(gloss[t, j]):
                    continue
                expected = _RESPONSE_NOISE**2 + (_GLOSS_MODEL_ERROR * gloss[t, j]) ** 2
                w = weight[t, j] * cosine[t, j] / expected
                top += w * (rho - gloss[t, j])
                bottom += w * cosine[t, j]
                spread += w * w * (noise[j, b, 0] + noise[j, b, 1] * max(rho, 0.0))
            out[t, b] = top / bottom if bottom > 0.0 else np.nan
            variance[t, b] = spread / bottom**2 if bottom > 0.0 else np.nan


def diffuse_response(
    response, geometry, weight, result: FitResult, n: float, k: float, noise
) -> tuple[np.ndarray, np.ndarray]:
    """Return each texel's response to its diffuse reflectance alone, all observations combined, and its variance.

    The fitted gloss is subtracted from every observation and the rest, divided by cosθ_i, is averaged by inverse
    variance; where the gloss is strong its model error makes an observation count for less.

    Parameters
    ----------
    response : (texels, J, bands) float
    geometry : (texels, J, 4) float, rad
    weight : (texels, J) float
    result : FitResult
    noise : (J, bands, 2) float
        c0 and c1 of the variance c0 + c1 ρ that the camera's noise gives a response.

    Returns
    -------
    response : (texels, bands) float64, NaN where there is no observation
    variance : (texels, bands) float64
        From the camera's noise alone; NaN where that is not known, or without observation.
    """
    gloss = result.gloss[:, :1] * gloss_factors(np.asarray(geometry, dtype=np.float64), n, k)
    gloss *= np.exp(-np.square(geometry[..., 3] / result.gloss[:, 1:]))
    out, variance = np.empty((2, len(response), response.shape[2]))
    noise = np.ascontiguousarray(noise, dtype=np.float64)
    _combine(response, np.cos(geometry[..., 0]), gloss, weight, noise, out, variance)
    return out, variance


def fit_brdf(observations, output, options: FitOptions, n: float, k: float, provenance: store.Provenance) -> None:
    """Fit one tile of observations and write its parameters.

    Notes
    -----
    Datasets, one entry a texel: ``/alpha``, ``/beta``, ``/mu`` (rad), their ``*_error``, ``/residual_rms``,
    ``/status`` (see `Status`), ``/evaluations``, ``/nlopt_result``, ``/diffuse_response`` (texel, bands) and
    ``/diffuse_variance``, what the camera's noise gives it.
    """
    with store.open_file(observations) as file:
        response, geometry, weight = file.read("response"), file.read("geometry"), file.read("weight")
        noise = file.read("noise_model")
        carried = {name: file.attribute(name) for name in ("rows", "width", "filters")}
    fit(response[:1, :, GREEN], geometry[:1], weight[:1], n, k, options)  # compile before the clock starts
    start = time.perf_counter()
    result = fit(response[..., GREEN], geometry, weight, n, k, options)
    seconds = time.perf_counter() - start
    fitted = int((result.evaluations > 0).sum())
    diffuse, variance = diffuse_response(response, geometry, weight, result, n, k, noise)
    with store.create(output, provenance) as out:
        maps = {
            "alpha": (result.alpha, "1", "diffuse weight"),
            "beta": (result.beta, "1", "gloss weight"),
            "mu": (result.mu, "rad", "roughness"),
            "alpha_error": (result.alpha_error, "1", "standard error of alpha"),
            "beta_error": (result.beta_error, "1", "standard error of beta"),
            "mu_error": (result.mu_error, "rad", "standard error of mu"),
            "residual_rms": (result.residual_rms, "1", "root mean square residual in response"),
            "relative_residual": (result.relative_residual, "1", "residual over root mean square response"),
            "status": (result.status, "1", ", ".join(f"{s.value} {s.name.lower()}" for s in Status)),
            "evaluations": (result.evaluations, "1", "evaluations of the objective"),
            "nlopt_result": (result.nlopt_result, "1", "return code of NLopt, 0 where not called"),
            "diffuse_response": (diffuse, "1", "response to the diffuse reflectance alone"),
            "diffuse_variance": (variance, "1", "variance of diffuse_response from the camera's noise"),
        }
        store.write_maps(out, maps, "texel,band")
        for name, value in carried.items():
            out.attribute(name, value)
        out.attribute("fit_seconds", seconds)
        out.attribute("texels_fitted", fitted)
    counts = np.bincount(result.status, minlength=len(Status))
    LOGGER.info("fitted %d texels in %.2f s (%.0f texels/s)", fitted, seconds, fitted / max(seconds, 1e-9))
    LOGGER.info("%s", ", ".join(f"{s.name.lower()}: {counts[s]}" for s in Status))
