"""From fitted tiles to the object's material: maps, spectra by equation (4), PCA of this image."""

from dataclasses import replace

import numpy as np

from irodori import store
from irodori.colour import xyz_from_reflectance
from irodori.errors import InputError
from irodori.material import Material
from irodori.principal import WEIGHTINGS, Compression, CompressOptions, choose, drift, second_moments
from irodori.progress import LOGGER
from irodori.recovery import Calibration
from irodori.spectra import refractive_index

_COLUMNS = {
    "texel": ("1", "1 where a surface lies under the texel's centre"),
    "alpha_error": ("1", "standard error of alpha"),
    "beta_error": ("1", "standard error of beta"),
    "mu_error": ("rad", "standard error of mu"),
    "residual_rms": ("1", "root mean square residual in response"),
    "status": ("1", "outcome of the fit"),
    "relative_residual": ("1", "root mean square residual over root mean square response"),
    "pooled_from": ("1", "texels that the gloss comes from, 0 where it is the texel's own"),
    "evaluations": ("1", "evaluations of the objective"),
    "nlopt_result": ("1", "return code of NLopt, 0 where not called"),
}
_GREEN = 1


def assemble(tiles: list, height: int, width: int) -> tuple[dict[str, np.ndarray], list[str], dict]:
    """Return the maps of an object from its tiles, and the speed of the fit.

    Returns
    -------
    maps : dict of (height, width, ...) arrays
    filters : list of str
        Filter states of the bands.
    speed : dict
        ``fit_seconds`` without start-up and compilation, and ``texels_fitted``.

    Raises
    ------
    InputError
        If the tiles do not cover the texture exactly.
    """
    maps: dict[str, np.ndarray] = {}
    covered = np.zeros(height, dtype=int)
    seconds, fitted, filters = 0.0, 0, None
    for path in tiles:
        with store.open_file(path) as file:
            found = file.attribute("filters")
            if filters not in (None, found):
                raise InputError(path, "filters", ", ".join(found), f"{', '.join(filters)}, as in the other tiles")
            filters = found
            seconds, fitted = seconds + file.attribute("fit_seconds"), fitted + file.attribute("texels_fitted")
            first, last = file.attribute("rows")
            covered[first:last] += 1
            for name in ("alpha", "beta", "mu", "diffuse_response", "diffuse_variance", *_COLUMNS):
                values = file.read(name)
                if name not in maps:
                    maps[name] = np.empty((height, width, *values.shape[1:]), dtype=values.dtype)
                maps[name][first:last] = values.reshape(last - first, width, *values.shape[1:])
    if not (covered == 1).all():
        found = f"{int((covered != 1).sum())} rows missing or doubled"
        raise InputError(tiles[0], "rows", found, f"tiles that cover {height} rows once")
    return maps, filters, {"fit_seconds": seconds, "texels_fitted": fitted}


def typical_gloss(beta: np.ndarray, mu: np.ndarray, mu_error: np.ndarray) -> tuple[float, float]:
    """Return the medians of β and μ over the better-determined half of the texels; (0, 1) where there are none."""
    known = np.isfinite(beta) & np.isfinite(mu) & np.isfinite(mu_error)
    if not known.any():
        return 0.0, 1.0
    relative = mu_error[known] / mu[known]
    best = relative <= np.median(relative)
    return float(np.median(beta[known][best])), float(np.median(mu[known][best]))


def known_variance(maps: dict[str, np.ndarray]) -> np.ndarray | None:
    """Return the variance of the diffuse responses, None where the camera's noise was not measured."""
    variance = maps["diffuse_variance"]
    measured = np.isfinite(maps["diffuse_response"]).all(axis=-1)
    unknown = ~np.isfinite(variance[measured]).all(axis=-1)
    if not unknown.any():
        return variance
    LOGGER.info("noise not measured for %.1f %% of the texels: it has no part in their spectra", 100 * unknown.mean())
    return None


def confidence(calibration: Calibration, response, variance) -> dict[str, tuple]:
    """Return what is known of the reliability of recovered spectra, as maps for ``material.h5``.

    Parameters
    ----------
    calibration : Calibration
    response : (height, width, bands) float
        Diffuse responses; NaN where there is none.
    variance : (height, width, bands) float or None
        What the camera's noise gives them; None where that was not measured.

    Returns
    -------
    dict of (map, units, quantity)
        ``reflectance_error``: standard deviation of the reflectance factor, rms over the wavelengths, from the camera's
        noise, where that was measured, and the error that cross-validation on the chart found;
        ``training_distance``: of the response from those of the chart, 1 = what nine tenths of its own patches
        have at most to the nearest other; ``out_of_training``: uint8, 1 where it is above 1, 2 where the
        response has no direction.
    """
    distance = calibration.distance(response)
    noise = np.zeros_like(response) if variance is None else variance
    error = calibration.standard_deviation(response, noise, stated=variance is not None)
    outside = np.where(np.isfinite(distance), distance > 1.0, 2).astype(np.uint8)
    of = "cross-validation alone" if variance is None else "cross-validation and the camera's noise"
    quantity = f"standard deviation of S by {of}, rms over wavelengths"
    return {
        "reflectance_error": (error.astype(np.float32), "1", quantity),
        "training_distance": (distance.astype(np.float32), "1", "distance from the chart's responses, 1 = its own"),
        "out_of_training": (outside, "1", "1 where the chart has no colour like it, 2 not known"),
    }


def compress_reflectance(
    tiles: list,
    calibration_file,
    definition: dict,
    output,
    options: CompressOptions,
    lights: list[str],
    provenance: store.Provenance,
) -> None:
    """Write an object's ``material.h5`` from its fitted tiles.

    Parameters
    ----------
    tiles : list of path
    calibration_file : path
    definition : dict
        Definition of the object.
    options : CompressOptions
    lights : list of str
        Under each of which the colours are compared.
    """
    height, width = definition["texels"]["height"], definition["texels"]["width"]
    maps, filters, speed = assemble(tiles, height, width)
    calibration = Calibration.load(calibration_file)
    calibration.require_filters(filters, tiles[0])
    variance = known_variance(maps)
    weights = calibration.weights(maps["diffuse_response"], variance)
    observed = np.isfinite(weights).all(axis=-1) & np.isfinite(maps["alpha"])
    if not observed.any():
        raise InputError(tiles[0], "status", "no texel with enough observations", "captures that see the object")
    observers = {name: (matrix := xyz_from_reflectance(name), matrix.sum(axis=1)) for name in lights}
    weights[~observed] = np.nan
    compression, compared = compress_maps(weights, calibration.basis, observers, options)
    reliability = confidence(calibration, maps["diffuse_response"], variance)
    material = _material(definition, maps, weights, compression, reliability)
    error, _, _ = reliability["reflectance_error"]
    errors = {
        "out_of_training_fraction": float((reliability["out_of_training"][0][observed] == 1).mean()),
        "reflectance_error_median": float(np.median(error[observed])),
        "delta_e": compression.errors,
        "negative_fraction": compression.negative.fraction,
        "compression": compared,
        "observed_fraction": float(observed.sum() / max(maps["texel"].sum(), 1)),
        **speed,
    }
    material.save(output, provenance, errors, storage=options.storage, codec=options.codec)
    _log(material, compression, observed)


def _material(
    definition: dict, maps: dict[str, np.ndarray], weights: np.ndarray, compression: Compression, reliability: dict
) -> Material:
    """Return the material of an object's maps; ``weights``, (height, width, r), are its reflectance before."""
    coefficients = np.concatenate([compression.decode(tile) for tile in compression.tiles(weights)])
    n, k = refractive_index(definition["refractive_index"])
    return Material(
        alpha=maps["alpha"],
        beta=maps["beta"],
        mu=maps["mu"],
        green_response=maps["diffuse_response"][..., _GREEN],
        coefficients=coefficients.reshape(*weights.shape[:2], -1),
        basis=compression.basis,
        n=n,
        k=k,
        mirror=float(definition["mirror_weight"]),
        typical_gloss=typical_gloss(maps["beta"], maps["mu"], maps["mu_error"]),
        extra={name: (maps[name], units, what) for name, (units, what) in _COLUMNS.items()} | reliability,
    )


def compress_maps(
    weights: np.ndarray, basis: np.ndarray, observers: dict, options: CompressOptions
) -> tuple[Compression, dict]:
    """Return the compression of reflectance maps, and what the material's file says of it.

    Parameters
    ----------
    weights : (height, width, r) float32
        NaN where nothing is known.
    basis : (61, r) float
    observers : dict
        See `irodori.principal.analyse`.
    options : CompressOptions

    Returns
    -------
    compression : Compression
    errors : dict
        Its summary, with ``storage`` and ``weighting``; ``weightings``: the same summary for each weighting on this
        image; ``drift``: see `irodori.principal.drift`.
    """
    moments = second_moments(weights)
    made = {name: choose(moments, basis, observers, replace(options, weighting=name)) for name in WEIGHTINGS}
    compression = made[options.weighting]
    truth = moments.sample @ np.asarray(basis, dtype=np.float64).T
    decoded = compression.decode(compression.encode(moments.sample)) @ compression.basis.T
    return compression, {
        **compression.summary(),
        "storage": options.storage,
        "weighting": options.weighting,
        "weightings": {name: one.summary() for name, one in made.items()},
        "drift": drift(truth, decoded, compression.basis, observers),
    }


def _log(material: Material, compression: Compression, observed: np.ndarray) -> None:
    share, negative = 100 * observed.mean(), 100 * compression.negative.fraction
    bases, rank = compression.bases, compression.rank
    LOGGER.info("%d bases of %d; observed %.1f %% of texels; negative samples %.3f %%", bases, rank, share, negative)
    if not compression.budget_met:
        LOGGER.warning("the colour error stays above its target with all %d bases in this storage", bases)
    ratio = material.alpha[observed] / material.green_response[observed]
    LOGGER.info("alpha / S_G: median %.4f, 5 to 95 %% %.4f to %.4f", *np.percentile(ratio, [50, 5, 95]))
    for light, error in compression.errors.items():
        LOGGER.info("CIEDE2000 of the compression under %s: mean %.3f p99 %.3f", light, error["mean"], error["p99"])
