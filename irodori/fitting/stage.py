"""Fit stage: reads the observations of a tile; writes fitted parameters and diffuse responses."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.core.store import Units
from irodori.fitting import judge
from irodori.fitting.band_fresnel import BandGloss, band_gloss, uniform, varies
from irodori.fitting.mirror_image import without_images
from irodori.fitting.solvers import FitOptions, FitResult, fit
from irodori.fitting.texel_rows import COSINE, LOBE, SPOILED, WEIGHT, fill_lobe, new_rows, pack_geometry
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.material.angle_errors import registered_errors
from irodori.material.material_file import NloptResult, Status, gloss_maps
from irodori.material.observed_angles import STORED, read_angles, read_texels
from irodori.material.photograph_levels import common_error, levels_of
from irodori.material.tile_strips import strips, texels_of
from irodori.reflection.lobes import Lobes
from irodori.spectra.coordinates import require_bands, write_bands

GREEN = 1  # green without the filter, the band of equation (7)
_RESPONSE_NOISE = 0.01  # standard deviation of a response if the camera's noise is unknown
_LEAST_VARIANCE = 1e-12
_GLOSS_MODEL_ERROR = 0.1
_FAR, _AN_OUTLIER_IN = 6.0, 8  # distance of an outlier in standard deviations; at most one observation in 8 is one


_CHUNK = 2048  # texels that a thread takes at a time
#: Datasets of a tile of observations that every fit reads.
_AXES = {
    "response": "texel,capture,band",
    "weight": "texel,capture",
    "clipped": "texel,capture",
    "noise_model": "capture,band,coefficient",
    "texel": "texel",
}
#: Axes of the datasets of a fit.
FITTED_AXES = ("texel_number", "band")
#: Attributes of a tile that its fit passes on.
CARRIED = {"rows": list, "width": int, "filters": list}


class Model(IntEnum):
    """Terms of the reflection model that the observations of a texel determine."""

    NOTHING = judge.NOTHING
    DIFFUSE_ALONE = judge.DIFFUSE_ALONE
    GLOSS_ALONE = judge.GLOSS_ALONE
    BOTH = judge.BOTH


@dataclass(frozen=True)
class Observed:
    """Observations of texels in all bands.

    Parameters
    ----------
    response : (texels, J, bands) float
    geometry : (texels, J, 4) float
        θ_i, θ_r, θ_H, φ in rad.
    weight : (texels, J) float
    clipped : (texels, J) uint8
    noise : (J, bands, 2) float64
        c0 and c1 of the variance c0 + c1 ρ of a response ρ by the camera's noise.
    """

    response: np.ndarray
    geometry: np.ndarray
    weight: np.ndarray
    clipped: np.ndarray
    noise: np.ndarray

    def __getitem__(self, chosen) -> "Observed":
        """Return the observations of selected texels; ``chosen`` is any NumPy index."""
        response, geometry, weight = self.response[chosen], self.geometry[chosen], self.weight[chosen]
        return Observed(response, geometry, weight, self.clipped[chosen], self.noise)


class Fitted(NamedTuple):
    """Observations of texels in all bands, and the gloss fitted to them.

    Parameters
    ----------
    response : (texels, J, bands) float
    geometry : (texels, J, 4) float
        θ_i, θ_r, θ_H, φ in rad.
    weight : (texels, J) float
    noise : (J, bands, 2) float64
        c0 and c1 of the variance c0 + c1 ρ of a response ρ by the camera's noise.
    model_error : float
        Relative error of an observation apart from noise.
    lobes : tuple of Lobes
        Lobe of each component.
    gloss : (texels, 2 or 4) float64
        β and μ of each component.
    n : (texels,) float64
    k : float
        Complex refractive index of the fit.
    coupled : bool
        Whether the coat reduces the diffuse term.
    ratio : (bands, angles) float64
        Fresnel reflectance of each band divided by that of the fit, at equally spaced θ_H from 0 to π/2.
    """

    response: np.ndarray
    geometry: np.ndarray
    weight: np.ndarray
    noise: np.ndarray
    model_error: float
    lobes: tuple[Lobes, ...]
    gloss: np.ndarray
    n: np.ndarray
    k: float
    coupled: bool
    ratio: np.ndarray


@njit(cache=True, error_model="numpy")
def _expected(given, j, b, gloss, fitted):
    """Return the variance of an observation j in band b from noise, light and the error of the gloss.

    The noise is that at the ``fitted`` response. If it is unknown, a constant is used.
    """
    noise = given.noise
    own = noise[j, b, 0] + noise[j, b, 1] * max(fitted, 0.0) + (given.model_error * fitted) ** 2
    own = max(own, _LEAST_VARIANCE) if math.isfinite(own) else _RESPONSE_NOISE**2
    return own + (_GLOSS_MODEL_ERROR * gloss) ** 2


@njit(cache=True, error_model="numpy")
def _leave_out(t, given, rows, fitted):
    """Set the weights of the valid observations of a texel to 1, and those of invalid ones and of outliers to 0.

    An outlier is more than `_FAR` standard deviations away from the prediction by the other observations, in green. At
    most one observation in eight is left out.
    """
    response, weight, used, b = given.response[t], given.weight[t], 0, min(GREEN, given.response.shape[2] - 1)
    for j in range(response.shape[0]):
        fine = weight[j] > 0.0 and math.isfinite(response[j, b]) and rows[SPOILED, j] == 0.0
        rows[WEIGHT, j] = 1.0 if fine else 0.0
        used += fine
    for _ in range(used // _AN_OUTLIER_IN):
        top, bottom = 0.0, 0.0
        for j in range(response.shape[0]):
            if rows[WEIGHT, j] > 0.0:
                w = weight[j] * rows[COSINE, j] / _expected(given, j, b, fitted[j], max(response[j, b], fitted[j]))
                top, bottom = top + w * (response[j, b] - fitted[j]), bottom + w * rows[COSINE, j]
        worst, furthest = -1, _FAR * _FAR
        for j in range(response.shape[0]):
            cosine = rows[COSINE, j]
            if not rows[WEIGHT, j] > 0.0 or not cosine > 0.0:
                continue
            w = weight[j] * cosine / _expected(given, j, b, fitted[j], max(response[j, b], fitted[j]))
            rest = bottom - w * cosine
            if not rest > 0.0:
                continue
            told = (top - w * (response[j, b] - fitted[j])) / rest * cosine + fitted[j]
            off = (response[j, b] - told) ** 2 / _expected(given, j, b, fitted[j], told)
            if off > furthest:
                worst, furthest = j, off
        if worst < 0:
            return
        rows[WEIGHT, worst] = 0.0


@njit(cache=True, error_model="numpy")
def _combine_texel(t, given, rows, fitted, out, variance):
    """Fill diffuse responses and variances of a texel, (bands,) each; ``fitted`` is its gloss in green, (P,)."""
    response, weight, noise, ratio = given.response[t], given.weight[t], given.noise, given.ratio
    theta_h = given.geometry[t, :, 2]
    step = 0.5 * math.pi / (ratio.shape[1] - 1)
    _leave_out(t, given, rows, fitted)
    for b in range(response.shape[1]):
        diffuse = np.nan  # unknown in the first of two rounds
        for _ in range(2):
            top, bottom, spread = 0.0, 0.0, 0.0
            for j in range(response.shape[0]):
                rho, cosine = response[j, b], rows[COSINE, j]
                if not rows[WEIGHT, j] > 0.0 or not math.isfinite(rho):
                    continue
                place = min(max(theta_h[j] / step, 0.0), ratio.shape[1] - 1.0)
                i = min(int(place), ratio.shape[1] - 2)
                gloss = fitted[j] * (ratio[b, i] + (place - i) * (ratio[b, i + 1] - ratio[b, i]))
                expected = _expected(given, j, b, gloss, diffuse * cosine + gloss)
                w = weight[j] * cosine / expected
                top += w * (rho - gloss)
                bottom += w * cosine
                spread += w * w * (noise[j, b, 0] + noise[j, b, 1] * max(rho, 0.0))
            diffuse = top / bottom if bottom > 0.0 else np.nan
        out[b] = diffuse
        variance[b] = spread / bottom**2 if bottom > 0.0 else np.nan


@njit(cache=True, error_model="numpy")
def _add_gloss(t, given, component, lobes, rows, fitted):
    """Fill the rows of a texel's geometry, and add the gloss of a component to ``fitted``, (P,)."""
    beta, mu = given.gloss[t, 2 * component], given.gloss[t, 2 * component + 1]
    pack_geometry(given.geometry[t], lobes, given.n[t], given.k, given.coupled, rows)
    if beta > 0.0:
        fill_lobe(rows, lobes, math.log(mu))
        for j in range(fitted.size):
            fitted[j] += beta * rows[LOBE, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _combine_chunk(given, out, variance, first, last):
    rows, gloss = new_rows(given.response.shape[1]), given.gloss
    fitted = np.empty(rows.shape[1])
    for t in range(first, last):
        fitted[:] = 0.0
        _add_gloss(t, given, 0, given.lobes[0], rows, fitted)
        if gloss.shape[1] > 2 and gloss[t, 2] > 0.0:
            _add_gloss(t, given, 1, given.lobes[1], rows, fitted)
        _combine_texel(t, given, rows, fitted, out[t], variance[t])


def diffuse_response(
    response,
    geometry,
    weight,
    result: FitResult,
    fresnel: BandGloss,
    noise,
    *,
    model_error: float = 0.01,
    coupled: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Combine the observations of each texel to its diffuse response, without gloss, in every band.

    The fitted gloss is subtracted from every observation. The remainder, divided by cosθ_i, is averaged with inverse
    variances as weights and without outliers. Observations with strong gloss have less weight because of the error of
    the gloss model.

    Parameters
    ----------
    response : (texels, J, bands) float
    geometry : (texels, J, 4) float, rad
    weight : (texels, J) float
    result : FitResult
    fresnel : BandGloss
        n and k of the fit, and the Fresnel reflectance of each band.
    noise : (J, bands, 2) float
        c0 and c1 of the variance c0 + c1 ρ of a response ρ by the camera's noise.
    model_error : float
        Relative error of an observation apart from noise.
    coupled : bool
        Whether the coat reduces the diffuse term, see `irodori.reflection.coat`.

    Returns
    -------
    response : (texels, bands) float64
        NaN where there is no observation.
    variance : (texels, bands) float64
        Variance by the camera's noise alone; NaN where the noise is unknown or there is no observation.
    """
    observed = Observed(response, geometry, weight, np.empty((0, 0), np.uint8), noise)
    index = np.where(np.isfinite(result.index), result.index, fresnel.n)
    return without_gloss(observed, result.gloss, index, result.lobes, fresnel, model_error=model_error, coupled=coupled)


def without_gloss(
    observed: Observed,
    gloss,
    index,
    lobes: tuple[str, ...],
    fresnel: BandGloss,
    *,
    model_error: float,
    coupled: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute diffuse responses and variances as `diffuse_response` does, for a given gloss.

    Parameters
    ----------
    observed : Observed
    gloss : (texels, 2 or 4) float64
        β and μ of each component.
    index : (texels,) float64
        Real refractive index.
    lobes : tuple of str
        Lobe of each component.
    fresnel, model_error, coupled
        As in `diffuse_response`.
    """
    out, variance = np.empty((2, len(observed.response), observed.response.shape[2]))
    noise = np.ascontiguousarray(observed.noise, dtype=np.float64)
    alone = tuple(Lobes((name,)) for name in (lobes if len(lobes) > 1 else lobes * 2))
    given = Fitted(
        observed.response, observed.geometry, observed.weight, noise, float(model_error), alone, gloss, index,
        fresnel.k, coupled, fresnel.ratio,
    )  # fmt: skip
    run_chunks(_combine_chunk, len(out), _CHUNK, given, out, variance)
    return out, variance


def _of_near_light(noise, gain, weight) -> np.ndarray:
    """Return the noise model of responses multiplied by the gain for a near light: variance gain² c0 + gain c1 ρ.

    Each capture has one model, with the mean gain and the mean squared gain over the texels seen.

    Parameters
    ----------
    noise : (J, bands, 2) float
        c0 and c1 without gain.
    gain, weight : (texels, J) float
    """
    seen = np.maximum(weight.sum(axis=0), 1e-30)
    first, second = (weight * gain).sum(axis=0) / seen, (weight * gain**2).sum(axis=0) / seen
    return noise * np.stack([second, first], axis=-1)[:, None, :]


def fresnel_of(n, k, calibration, bands: int) -> BandGloss:
    """Return n and k for the fit, and the Fresnel reflectance of every band.

    Parameters
    ----------
    n, k : float or (61,) float
        Complex refractive index.
    calibration : path or None
        Calibration of the camera; required if n or k varies with wavelength.
    bands : int
        Number of bands.

    Raises
    ------
    ValueError
        If n or k varies and there is no calibration.
    InputError
        If n or k varies and the calibration has no response model.
    """
    if not varies(n, k):
        return uniform(np.mean(n), np.mean(k), bands)
    if calibration is None:
        raise ValueError("a refractive index that varies with the wavelength; accepted: one with a calibration")
    with store.open_file(calibration) as file:
        if "band_response" not in file:
            accepted = "the response model of a calibration, for a refractive index that varies with the wavelength"
            raise InputError(calibration, "band_response", "no such dataset", accepted)
        found = band_gloss(n, k, file.read("band_response"), GREEN)
    LOGGER.info("refractive index in the band of the fit: %.3f + %.3f i", found.n, found.k)
    return found


def fitted_maps(lobes: tuple[str, ...]) -> dict[str, tuple[Units, str]]:
    """Return the datasets of a fit with these lobes, one entry for each texel: name -> (units, quantity)."""
    gloss: dict[str, tuple[Units, str]] = {}
    for name, (unit, quantity) in gloss_maps(lobes).items():
        gloss |= {name: (unit, quantity), f"{name}_error": (unit, f"standard error of {name}")}
    return gloss | {
        "alpha": ("1", "diffuse weight"),
        "alpha_error": ("1", "standard error of alpha"),
        "residual_rms": ("1", "root mean square residual in response"),
        "relative_residual": ("1", "residual over root mean square response"),
        "status": (Status, "outcome of the fit"),
        "model": (Model, "terms of the model that the observations tell"),
        "refractive_index": ("1", "real refractive index; NaN where fitted and not determined"),
        "refractive_index_error": ("1", "its standard error where it was fitted"),
        "evaluations": ("1", "evaluations of the objective"),
        "paint": ("1", "number of the texel's paint, -1 where not known"),
        "nlopt_result": (NloptResult, "return code of NLopt"),
        "texel": (store.Mask, "whether a surface lies under the texel's centre"),
        "diffuse_response": ("1", "response to the diffuse reflectance alone"),
        "diffuse_variance": ("1", "variance of diffuse_response from the camera's noise"),
    }


def narrowed(values: np.ndarray) -> np.ndarray:
    """Return values as they are stored: numbers of double precision, of which noise fills half, in single precision."""
    with np.errstate(over="ignore", under="ignore"):
        return values.astype(np.float32) if values.dtype == np.float64 else values


def write_fitted(output, maps: dict, attributes: dict, lobes: tuple[str, ...], provenance: store.Provenance) -> None:
    """Write a fitted tile: the maps named in `fitted_maps`, and attributes of the file."""
    described = fitted_maps(lobes)
    maps = {name: narrowed(values) for name, values in maps.items()}
    with store.create(output, provenance) as out:
        write_bands(out, attributes["filters"])
        store.write_maps(out, {name: (maps[name], *described[name]) for name in described}, ",".join(FITTED_AXES))
        for name, value in {**attributes, "lobes": list(lobes)}.items():
            out.attribute(name, value)


def read_observations(path, levels: Sequence = (), texels=slice(None)) -> Observed:
    """Read the observations of a tile; their noise model includes the gain for a near light and the lamp's levels.

    Parameters
    ----------
    path : path
        Tile of observations.
    levels : sequence of path
        File of the lamp's level in every photograph, see `irodori.material.photograph_levels`, by which responses are
        divided. If empty, responses stay as they are.
    texels : slice or (n,) int, sorted
        Texels to return; all by default.

    Raises
    ------
    InputError
        If the file is not a tile of observations, is damaged, or has datasets of inconsistent shapes, or if the levels
        are those of other captures.
    """
    with store.open_file(path) as file:
        file.require_axes(_AXES, coefficient=2)
        noise = file.read("noise_model")
        if "light_gain" in file:
            file.require_axes(_AXES | {"light_gain": "texel,capture"})
            around = texels if isinstance(texels, slice) else slice(None)
            noise = _of_near_light(noise, file.read("light_gain", around), file.read("weight", around))
        response, weight = (
            read_texels(file, name, texels).astype(np.float32, copy=False) for name in ("response", "weight")
        )
        clipped, geometry = read_texels(file, "clipped", texels), read_angles(file, texels)
        if geometry.shape[:2] != weight.shape:
            found, accepted = f"angles of {geometry.shape[:2]} texels and captures", f"those of {weight.shape} weights"
            raise InputError(path, STORED, found, accepted)
        captures = file.read("capture").astype(str).tolist() if levels else []
    for name in levels:
        level = levels_of(name, captures, response.shape[2], path)
        response /= level.astype(response.dtype)
        # Of a response ρ over the level: its variance, c0 + c1 ρ over the level's square, in terms of itself.
        noise = noise / np.stack([level**2, level], axis=-1)
    return Observed(response, geometry, weight, clipped, noise)


def for_object(options: FitOptions, observations: Sequence, levels: Sequence = ()) -> FitOptions:
    """Return options with an object's own errors: those of its angles, by registration, and that which all share.

    Parameters
    ----------
    options : FitOptions
    observations : sequence of path
        Tiles of the object; the first one tells the errors of the angles, if the object was registered.
    levels : sequence of path
        File of the lamp's levels, if there is one: it tells the error that all observations share.
    """
    own = replace(options, registered=registered_errors(observations[0]))
    LOGGER.info("error of the angles: %s", own.angles)
    return replace(own, level_error=common_error(levels, options.level_error))


def fit_brdf(
    observations, output, options: FitOptions, n, k, *, provenance: store.Provenance, calibration=None, levels=()
) -> None:
    """Fit one tile of observations and write its parameters.

    Parameters
    ----------
    observations, output : path
    options : FitOptions
    n, k : float or (61,) float
        Complex refractive index. If it varies with wavelength, each band has its own Fresnel reflectance.
    calibration : path, optional
        Calibration of the camera; required if n or k varies.
    levels : sequence of path
        As in `read_observations`; the file also gives the error that all observations share.

    Notes
    -----
    Datasets, one entry for each texel: ``/alpha``, ``/beta``, ``/mu`` (in the unit of the lobe), with a second lobe
    ``/beta_2`` and ``/mu_2``, their ``*_error``, ``/residual_rms``, ``/relative_residual``, ``/status`` (see `Status`),
    ``/model``, ``/paint``, ``/evaluations``, ``/nlopt_result``, ``/refractive_index`` and ``/refractive_index_error``
    (NaN where the index was given), ``/diffuse_response`` (texel, bands) and ``/diffuse_variance``, its variance by the
    camera's noise; ``/texel``, 0 where the texture shows no surface. The attribute ``common_error`` is the relative
    error of α and β that all texels share; the stated errors of the texels include it. The attribute ``angle_errors``
    tells the errors of the angles that were used, in degrees, and their source.
    """
    options = for_object(options, [observations], levels)
    with store.open_file(observations) as file:
        file.require_axes(_AXES, coefficient=2)
        texel, (_, captures, bands) = file.read("texel"), file.layout("response").shape
        carried = {name: file.attribute(name, kind) for name, kind in CARRIED.items()}
    first, last = carried["rows"]
    if (last - first) * carried["width"] != len(texel):
        found = f"rows {first} to {last} of {carried['width']} texels"
        raise InputError(observations, "rows", found, f"rows of {len(texel)} texels together")
    require_bands(carried["filters"], bands, observations)
    fresnel, seconds, parts = fresnel_of(n, k, calibration, bands), 0.0, []
    of_tile = strips(carried["rows"], carried["width"], captures)
    for strip in of_tile:
        chosen = texels_of(strip, carried["rows"], carried["width"])
        observed = without_images(read_observations(observations, levels, chosen), options)
        maps, took = _fit_strip(observed, fresnel, options)
        parts.append({name: narrowed(values) for name, values in maps.items()})
        seconds += took
    maps = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    fitted = int((maps["evaluations"] > 0).sum())
    other = {"texel": texel, "paint": np.full(len(texel), -1, dtype=np.int16)}
    carried |= {"parts": of_tile}
    attributes = carried | {"fit_seconds": seconds, "texels_fitted": fitted, "common_error": options.level_error}
    attributes |= {"angle_errors": options.angles.plain(), "coat": options.coat}
    write_fitted(output, maps | other, attributes, options.lobes, provenance)
    counts = np.bincount(maps["status"], minlength=len(Status))
    LOGGER.info("fitted %d texels in %.2f s (%.0f texels/s)", fitted, seconds, fitted / max(seconds, 1e-9))
    LOGGER.info("%s", ", ".join(f"{s.name.lower()}: {counts[s]}" for s in Status))


def _fit_strip(observed: Observed, fresnel: BandGloss, options: FitOptions) -> tuple[dict[str, np.ndarray], float]:
    """Return the maps of a fit of some texels, without ``texel`` and ``paint``, and the seconds that it took."""
    response, geometry, weight = observed.response, observed.geometry, observed.weight
    clipped, noise, n, k = observed.clipped, observed.noise, fresnel.n, fresnel.k
    if options.weights == "noise" and not np.isfinite(noise[:, GREEN]).all():
        LOGGER.info("the camera's noise is not known in every capture: observations have equal weights")
    green, of_green = response[..., GREEN], noise[:, GREEN]
    # Compile before the time is measured.
    fit(green[:2], geometry[:2], weight[:2], n, k, options, noise=of_green, clipped=clipped[:2])
    start = time.perf_counter()
    result = fit(green, geometry, weight, n, k, options, noise=of_green, clipped=clipped)
    seconds, error = time.perf_counter() - start, options.model_error
    diffuse, diffuse_variance = diffuse_response(
        response, geometry, weight, result, fresnel, noise, model_error=error, coupled=options.is_coupled
    )
    maps = {"refractive_index": result.index, "refractive_index_error": result.index_error}
    maps |= {"diffuse_response": diffuse, "diffuse_variance": diffuse_variance}
    told = fitted_maps(result.lobes)
    return maps | {name: getattr(result, name) for name in told if name not in {*maps, "texel", "paint"}}, seconds
