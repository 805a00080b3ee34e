"""Fit stage: reads the observations of a tile; writes fitted parameters and diffuse responses."""

import time
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.core.store import Units
from irodori.fitting import judge
from irodori.fitting.band_fresnel import BandGloss, band_gloss, uniform, varies
from irodori.fitting.diffuse_response import GREEN, Observed, diffuse_response
from irodori.fitting.mirror_image import without_images
from irodori.fitting.solvers import FitOptions, fit
from irodori.jit.half_precision import single_from_half
from irodori.material.angle_errors import registered_errors
from irodori.material.material_file import NloptResult, Status, gloss_maps
from irodori.material.observed_angles import STORED, read_angles, read_texels
from irodori.material.photograph_levels import common_error, levels_of
from irodori.material.tile_strips import strips, texels_of
from irodori.spectra.coordinates import require_bands, write_bands

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
        kept = {name: (maps[name], *described[name]) for name in described}
        store.write_maps(out, kept, ",".join(FITTED_AXES), compression="fast")
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
        response, weight = (read_texels(file, name, texels) for name in ("response", "weight"))
        if response.dtype == np.float16:  # but not in tiles of the first version
            response = single_from_half(response)
        response, weight = response.astype(np.float32, copy=False), weight.astype(np.float32, copy=False)
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
    ``/model``, ``/paint``, ``/evaluations``, ``/nlopt_result``, ``/diffuse_response`` (texel, bands) and
    ``/diffuse_variance``, its variance by the camera's noise; ``/texel``, 0 where the texture shows no surface. The
    attribute ``common_error`` is the relative error of α and β that all texels share; the stated errors of the
    texels include it. The attribute ``angle_errors`` tells the errors of the angles that were used, in degrees, and
    their source.
    """
    options = for_object(options, [observations], levels)
    with store.open_file(observations) as file:
        file.require_axes(_AXES, coefficient=2)
        texel, (_, captures, bands) = file.read("texel"), file.layout("response").shape
        carried = {name: file.attribute(name, kind) for name, kind in CARRIED.items()}
    if [type(row) for row in carried["rows"]] != [int, int]:
        raise InputError(observations, "rows", str(carried["rows"]), "the first row and the one after the last")
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
    if not np.isfinite(noise[:, GREEN]).all():
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
    maps = {"diffuse_response": diffuse, "diffuse_variance": diffuse_variance}
    told = fitted_maps(result.lobes)
    return maps | {name: getattr(result, name) for name in told if name not in {*maps, "texel", "paint"}}, seconds
