"""Material stage: reads fitted tiles; writes parameter maps and compressed spectra, recovered by equation (4).

Tiles are read three times, one at a time: for the statistics of the whole texture, for the second moments of its
spectra, and to write the material's file.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.posterior import Posterior, Uncertainty
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_reflectance
from irodori.config.models import Object
from irodori.config.parts import Surface
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.jit.chunks import parallel_map
from irodori.material.coefficients import reserve_coefficients
from irodori.material.energy import ALBEDO, ERROR, AlbedoModel, Energy, Errors, Reflecting
from irodori.material.filter_level import level_of_object
from irodori.material.fitted_tiles import FittedTile, FittedTiles, columns
from irodori.material.lobe_choices import NOTHING_COMPARED, Comparison
from irodori.material.material_file import (
    BASIS,
    COEFFICIENTS,
    MAPS,
    QUANTITY,
    SENT,
    SENT_BASIS,
    SENT_COEFFICIENTS,
    gloss_maps,
    gloss_names,
    spectrum_scale,
    typically_filled,
    write_constants,
    write_sent_basis,
)
from irodori.material.passed_light import PassedLight
from irodori.material.principal_components.basis_count import Compression, CompressOptions, choose
from irodori.material.principal_components.repeated_reflection import drift
from irodori.material.principal_components.second_moments import second_moments
from irodori.spectra.grid import ERROR_NM, ERROR_STRIDE, SAMPLES
from irodori.spectra.published import refractive_index, spectrum

_GREEN = 1
_OTHER_LEVEL = (
    "photographs through the filter are %.2f times as bright as white reference and chart let expect of %d paints "
    "(+- %.2f): was the lamp, the aperture or the exposure time another one? Colours are wrong"
)
_UNTOLD = (
    "photographs do not tell gloss from colour in %.0f %% of the texels, whose colours have larger errors for it: "
    "photograph also near the mirror direction, 5 to 15 degrees to both sides of it, and 30 degrees or more away"
)
#: Share of the texels in which gloss is more than half of the squared error of the colour, from which on it is said.
#: It is 0.2 to 5 % in the default objects, 98 % of a plate photographed from one set of angles.
_MOST = 0.5
_RESPONSE = ("diffuse_response", "diffuse_variance")
_ALBEDO_MAPS = (
    ("albedo", ALBEDO, "largest share of light that is sent back, in even light or up to 60 degrees from the normal"),
    ("albedo_error", ERROR, "standard error of albedo"),
)


@dataclass(frozen=True)
class _Reflectance:
    """Coefficients of a texture's spectra on the recovery basis, tile by tile; NaN where nothing is known."""

    fitted: FittedTiles
    calibration: Calibration
    is_noise_known: bool

    def __iter__(self) -> Iterator[np.ndarray]:
        for _, maps in self.fitted.read(*_RESPONSE, "alpha"):
            yield self.of(maps)

    def variance(self, maps: dict) -> np.ndarray | None:
        """Return the variance of a tile's diffuse responses, or None if the camera's noise was not measured."""
        return maps["diffuse_variance"] if self.is_noise_known else None

    def gloss_error(self, maps: dict) -> np.ndarray:
        """Return the error of a tile's diffuse responses that all bands share, (rows, width).

        What a texel's photographs cannot separate from its gloss is in the error of α, beside the camera's noise and
        the level that all texels share. Where the fit states α without an error, all of the light may be gloss.
        """
        alpha, own = maps["alpha"], maps["alpha_error"].astype(np.float64)
        level = 0.0 if math.isnan(self.fitted.shared_error) else self.fitted.shared_error
        noise = maps["diffuse_variance"][..., _GREEN] if self.is_noise_known else 0.0
        shared = np.sqrt(np.fmax(own**2 - (level * alpha) ** 2 - noise, 0.0))
        return np.where(np.isfinite(own), shared, np.abs(maps["diffuse_response"][..., _GREEN]))

    def of(self, maps: dict) -> np.ndarray:
        """Return the coefficients (rows, width, r) of the spectra of a tile, recovered from its diffuse responses."""
        weights = self.calibration.weights(maps["diffuse_response"], self.variance(maps))
        weights[~np.isfinite(maps["alpha"])] = np.nan
        return weights


@dataclass(frozen=True)
class _Sent:
    """Albedo of the texels of fitted tiles: the albedo model of an object, its lobes and its typical gloss."""

    model: AlbedoModel
    lobes: tuple[str, ...]
    typical_gloss: tuple[float, ...]

    def of(
        self, maps: dict, weights: np.ndarray, basis: np.ndarray, reflectance_error: np.ndarray, through=None
    ) -> np.ndarray:
        """Return the array of `AlbedoModel.of` for a tile's texels, NaN where the colour is not known.

        ``through`` has coefficients and basis of a sheet's transmittance, which is added.
        """
        alpha, scale = maps["alpha"].ravel(), spectrum_scale(maps["alpha"], maps["diffuse_response"][..., _GREEN])
        names = [gloss_names(component) for component in range(len(self.lobes))]
        pairs = typically_filled(self.lobes, [(maps[beta], maps[mu]) for beta, mu in names], self.typical_gloss)
        beta = np.stack([values.ravel() for _, values, _ in pairs], axis=-1)
        mu = np.stack([values.ravel() for _, _, values in pairs], axis=-1)
        coefficients = (weights * scale[..., None]).reshape(-1, weights.shape[-1])
        if through is not None:
            sent = np.nan_to_num(through[0]).reshape(len(coefficients), -1)
            coefficients, basis = np.hstack([coefficients, sent]), np.hstack([basis, through[1]])
        relative = np.full(beta.shape, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            alpha_error = maps["alpha_error"].ravel() / alpha
            for component, (b, m) in enumerate(names):
                of_beta, of_mu = (maps[f"{name}_error"].ravel() / maps[name].ravel() for name in (b, m))
                relative[:, component] = np.hypot(of_beta, 2.0 * of_mu)
        errors = Errors(reflectance_error.ravel(), alpha_error, relative)
        return self.model.of(Reflecting(coefficients, basis, beta, mu), errors)


@dataclass
class _Gathered:
    """Counts, errors and albedos of the observed texels, collected over all tiles."""

    observed: int = 0
    texels: int = 0
    error: list = field(default_factory=list)
    colour: list = field(default_factory=list)
    ratio: list = field(default_factory=list)
    energy: Energy = field(default_factory=Energy)
    passed: list = field(default_factory=list)
    passed_error: list = field(default_factory=list)
    untold: int = 0

    def add(self, maps: dict[str, tuple], observed: np.ndarray) -> None:
        """Add a tile, of whose maps the first entries are the values; ``observed`` has its texels with a colour."""
        self.observed += int(observed.sum())
        self.texels += int(maps["texel"][0].sum())
        self.error.append(maps["reflectance_error"][0][observed])
        self.colour.append(maps["delta_e_error"][0][observed])
        self.ratio.append((maps["alpha"][0][observed] / maps["green_response"][0][observed]).astype(np.float32))

    def errors(self) -> dict:
        return {
            "reflectance_error_median": float(np.median(np.concatenate(self.error))),
            "delta_e_error_median": float(np.median(np.concatenate(self.colour))),
            "observed_fraction": self.observed / max(self.texels, 1),
            "energy": asdict(self.energy),
        }

    def transmittance(self, sheet: "_Sheet") -> dict:
        """Return source, mean over texels and wavelengths, and median standard error of a sheet's transmittance."""
        mean = np.nanmean(np.concatenate(self.passed), axis=0) @ sheet.basis.mean(axis=0)
        error = float(np.nanmedian(np.concatenate(self.passed_error))) if self.passed_error else None
        return {"source": sheet.source, "mean": float(mean), "error_median": error}


def confidence(
    calibration: Calibration, found: Uncertainty, response, variance, gloss_error: np.ndarray
) -> dict[str, tuple]:
    """Return the uncertainty of recovered spectra, as datasets for ``material.h5``.

    Parameters
    ----------
    calibration : Calibration
    found : Uncertainty
        By chart, bands and the camera's noise.
    response : (height, width, bands) float
        Diffuse responses; NaN where there is none.
    variance : (height, width, bands) float or None
        Variance of the responses from the camera's noise; None if the noise was not measured.
    gloss_error : (height, width) float
        Standard error of the responses that all bands share, because gloss has hardly a colour.

    Returns
    -------
    dict of (values, units, dims, quantity)
        ``spectral_error``: standard deviation of the reflectance factor at `ERROR_NM`,
        ``reflectance_error``: its root mean square over all wavelengths, ``delta_e_error``: the CIEDE2000 under D65
        within which the true colour lies with a probability of 0.68.
    """
    basis, xyz = calibration.basis, xyz_from_reflectance("D65")
    seen = response, response + np.expand_dims(gloss_error, -1)
    less, more = (calibration.weights(one, variance).astype(np.float64) for one in seen)
    labs = (lab_from_xyz(weights @ (xyz @ basis).T, xyz.sum(axis=1)) for weights in (less, more))
    apart, of = more - less, f"by chart, bands{'' if variance is None else ', noise'} and gloss"
    spectral = np.hypot(found.standard_deviation, apart @ basis[::ERROR_STRIDE].T).astype(np.float16)
    rms = np.sqrt(np.square(found.rms) + ((apart @ (basis.T @ basis)) * apart).sum(axis=-1) / SAMPLES)
    colour = np.hypot(found.delta_e, delta_e(*labs))
    rms, colour = rms.astype(np.float32), colour.astype(np.float32)
    return {
        "reflectance_error": (rms, "1", "row,column", f"standard deviation of S {of}, rms over wavelengths"),
        "spectral_error": (spectral, "1", "row,column,error_wavelength", f"standard deviation of S {of}"),
        "delta_e_error": (colour, "1", "row,column", f"standard error in CIEDE2000 under D65 {of}"),
    }


def compress_reflectance(
    tiles: list,
    calibration_file,
    definition: Object | Surface,
    output,
    *,
    options: CompressOptions,
    lights: list[str],
    provenance: store.Provenance,
    lobe_choice: Comparison = NOTHING_COMPARED,
    observations: Sequence = (),
    levels: Sequence = (),
) -> None:
    """Write an object's ``material.h5`` from its fitted tiles.

    Parameters
    ----------
    tiles : list of path
    calibration_file : path
    definition : Object or Surface
    options : CompressOptions
    lights : list of str
        Names of the lights under which colours are compared to choose the number of basis vectors.
    lobe_choice : Comparison
        Prediction errors of the candidates if the object's lobes were chosen by cross-validation.
    observations, levels : sequence of path
        Of a thin sheet whose transmittance is measured, see `irodori.material.passed_light`.
    """
    fitted = FittedTiles(tiles, definition.texels.height, definition.texels.width)
    calibration = Calibration.load(calibration_file)
    calibration.require_filters(fitted.filters, fitted.first)
    if calibration.band_response is None or calibration.band_response_covariance is None:
        found = "no response model"
        raise InputError(calibration_file, "band_response", found, "a calibration that this version wrote")
    fitted.misfit = lobe_choice.misfit(fitted.lobes, fitted.coat)
    # The chart and the white reference contradict each other by this much, and which of them errs is not told.
    fitted.white_error = abs(calibration.level[_GREEN] - 1.0) if calibration.level else 0.0
    reflectance = _Reflectance(fitted, calibration, fitted.is_noise_known())
    observers = {name: (matrix := xyz_from_reflectance(name), matrix.sum(axis=1)) for name in lights}
    compression, compared = compress_maps(reflectance, calibration.basis, observers, options)
    n, k = refractive_index(definition.refractive_index)
    typical_gloss = fitted.typical_gloss()
    mirror = _mirror_weight(fitted, definition.mirror_weight)
    sent = _Sent(AlbedoModel(fitted.lobes, n, k, mirror["weight"], fitted.coat), fitted.lobes, typical_gloss)
    sheet = _sheet_of(definition, calibration, observations, levels)
    level = level_of_object(calibration.filters, calibration.training, fitted.read("diffuse_response", "paint"))
    if level is not None and level.is_other:
        LOGGER.warning(_OTHER_LEVEL, level.ratio, level.paints, level.error)
    with store.create(output, provenance) as out:
        gathered = _write_maps(out, reflectance, compression, options.codec, sent, sheet=sheet)
        if sheet is not None:
            write_sent_basis(out, sheet.basis, sheet.source)
        errors = gathered.errors() | {
            "delta_e": compression.errors,
            "negative_fraction": compression.negative,
            "compression": compared,
            **fitted.speed,
            "common_error": None if math.isnan(fitted.shared_error) else fitted.shared_error,
            "angle_errors": fitted.angle_errors or None,
            "lobe_choice": [asdict(one) for one in lobe_choice.candidates],
            "lobe_choice_painted": lobe_choice.painted,
            "lobe_choice_favours_tails": lobe_choice.favours_tails,
            "lobe_choice_misfit": fitted.misfit,
            "filter_level": level._asdict() | {"is_other": bool(level.is_other)} if level else None,
            "mirror": mirror,
            "gloss_contradiction": fitted.gloss_contradiction,
        }
        if sheet is not None:
            errors["transmittance"] = gathered.transmittance(sheet)
        constants = (compression.basis, n, k, mirror["weight"])
        write_constants(out, *constants, errors, lobes=fitted.lobes, typical_gloss=typical_gloss, coat=fitted.coat)
    _log(compression, gathered, fitted.height * fitted.width)


def _mirror_weight(fitted: FittedTiles, typed: float) -> dict:
    """Return the weight of the mirror term, measured if photographs measure it, and what is known of it.

    ``typed`` is that of the object's definition. A measured weight is at least 0 and at most 1.
    """
    found = {"photographs": 0, "clipped": 0} | fitted.mirror_weight
    told = found.get("weight")
    if told is None:
        return {**found, "weight": typed, "error": None, "source": "assumed", "typed": typed}
    weight, error = min(max(told, 0.0), 1.0), found["error"]
    LOGGER.info("mirror weight: %.3g +- %.2g by %d photographs", weight, error, found["photographs"])
    if abs(typed - told) > 3.0 * error:
        text = "mirror_weight: found %.3g in the definition, %.3g +- %.2g in the photographs, which are believed"
        LOGGER.warning(text, typed, told, error)
    return {**found, "weight": weight, "source": "measured", "typed": typed}


@dataclass(frozen=True)
class _Sheet:
    """Transmittance of a thin sheet: one spectrum that is assumed, or of each texel by the light that passed."""

    calibration: Calibration
    basis: np.ndarray  # (61, k)
    passed: PassedLight | None

    @property
    def source(self) -> str:
        return "assumed" if self.passed is None else "measured"

    def of(self, rows: slice, shape: tuple, posterior: Posterior) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the coefficients (rows, width, k) of a tile, and the standard deviations if it is measured."""
        if self.passed is None:
            return np.ones((*shape, 1), dtype=np.float32), None
        response, variance = (values.reshape(*shape, -1) for values in self.passed.of(rows))
        told = variance if np.isfinite(variance[np.isfinite(response)]).all() else None
        error = posterior.of(response, told, stated=told is not None).rms
        return self.calibration.weights(response, told).astype(np.float32), error


def _sheet_of(definition: Object | Surface, calibration: Calibration, observations, levels) -> _Sheet | None:
    """Return the transmittance of an object that is a thin sheet; None for others."""
    if definition.sheet is None:
        return None
    known = definition.sheet.transmittance
    if known is None:
        return _Sheet(calibration, calibration.basis, PassedLight(observations, levels))
    LOGGER.info("the transmittance is assumed, not measured")
    values = spectrum(known) if isinstance(known, str) else np.full(SAMPLES, float(known))
    return _Sheet(calibration, values[:, None], None)


@dataclass(frozen=True)
class _Written:
    """Computed parts of the material in a tile.

    Parameters
    ----------
    coefficients : (rows, width, bases) float16 or float32
        As they are stored.
    maps : dict
        {name: (values, units, dims, quantity)}.
    passed : (rows, width, parts) float32 or None
        Coefficients of a sheet's transmittance.
    weights : (rows, width, r) float
        Coefficients of the spectra on the recovery basis.
    albedo : array
        As `AlbedoModel.of` returns.
    untold : (rows, width) bool
        Whether most of the error of the colour is gloss that photographs do not tell from it.
    """

    coefficients: np.ndarray
    maps: dict[str, tuple]
    passed: np.ndarray | None
    weights: np.ndarray
    albedo: np.ndarray
    untold: np.ndarray


def _write_maps(
    out: store.Writer,
    reflectance: _Reflectance,
    compression: Compression,
    codec: str,
    sent: _Sent,
    *,
    sheet: _Sheet | None,
) -> _Gathered:
    """Write all maps of the material, while threads compute those of the next tiles."""
    fitted, posterior, gathered = reflectance.fitted, Posterior(reflectance.calibration), _Gathered()
    size, half = (fitted.height, fitted.width), compression.storage == "half"
    shape, scale = (*size, compression.bases), compression.scale if half else None
    coefficients = reserve_coefficients(
        out, COEFFICIENTS, shape, quantity=QUANTITY, storage=compression.storage, codec=codec, scale=scale, basis=BASIS
    )
    if sheet is not None:
        passed = reserve_coefficients(
            out,
            SENT_COEFFICIENTS,
            (*size, sheet.basis.shape[1]),
            quantity=SENT,
            storage="single",
            codec=codec,
            scale=None,
            dims="row,column,part",
            basis=SENT_BASIS,
        )
    out.coordinate("error_wavelength", ERROR_NM, units="nm", quantity="wavelength of a standard deviation")
    described_maps: dict[str, tuple] = MAPS | gloss_maps(fitted.lobes)
    kept = columns(fitted.lobes)
    own_names = ("alpha", *gloss_maps(fitted.lobes))

    def made(tile: FittedTile) -> _Written:
        maps = fitted.maps(tile, (*own_names, *_RESPONSE, *kept))
        weights, response = reflectance.of(maps), maps["diffuse_response"]
        own = {name: maps[name] for name in own_names} | {"green_response": response[..., _GREEN]}
        described = {n: (v, (what := described_maps[n])[0], "row,column", what[1]) for n, v in own.items()}
        described |= {n: (maps[n], units, "row,column", quantity) for n, (units, quantity) in kept.items()}
        variance = reflectance.variance(maps)
        found = posterior.of(response, variance, stated=variance is not None)
        described |= confidence(reflectance.calibration, found, response, variance, reflectance.gloss_error(maps))
        through = None
        if sheet is not None:
            let_through, error = sheet.of(slice(*tile.rows), weights.shape[:2], posterior)
            through = let_through, sheet.basis
            if error is not None:
                described["transmittance_error"] = (error, "1", "row,column", "standard deviation of the transmittance")
        albedo = sent.of(maps, weights, reflectance.calibration.basis, found.rms, through)
        for name, column, quantity in _ALBEDO_MAPS:
            texels = albedo[:, column].astype(np.float32).reshape(weights.shape[:2])
            described[name] = (texels, "1", "row,column", quantity)
        stored = compression.encode(weights.reshape(-1, weights.shape[-1])).reshape(*weights.shape[:2], -1)
        untold = described["delta_e_error"][0] > math.sqrt(2.0) * found.delta_e
        return _Written(stored, described, through[0] if through else None, weights, albedo, untold)

    datasets = {}
    for tile, one in zip(fitted.tiles, parallel_map(made, fitted.tiles), strict=True):
        rows = slice(*tile.rows)
        coefficients[rows] = one.coefficients
        if one.passed is not None:
            passed[rows] = one.passed
            gathered.passed.append(one.passed.reshape(-1, one.passed.shape[-1]))
            if "transmittance_error" in one.maps:
                gathered.passed_error.append(one.maps["transmittance_error"][0].ravel())
        for name, (texels, units, dims, quantity) in one.maps.items():
            if name not in datasets:
                names = {"units": units, "dims": dims, "quantity": quantity}
                datasets[name] = out.reserve(name, (*size, *texels.shape[2:]), texels.dtype, **names)
            datasets[name][rows] = texels
        observed = np.isfinite(one.weights).all(axis=-1)
        gathered.add(one.maps, observed)
        gathered.untold += int((one.untold & observed).sum())
        gathered.energy = gathered.energy.joined(Energy.of(one.albedo))
    return gathered


def compress_maps(weights, basis: np.ndarray, observers: dict, options: CompressOptions) -> tuple[Compression, dict]:
    """Return the compression of reflectance maps, and its errors as attributes for the material's file.

    Parameters
    ----------
    weights : (height, width, r) float32, or tiles of it
        NaN where nothing is known; see `irodori.material.principal_components.pixel_tiles.Tiles`.
    basis : (61, r) float
    observers : dict
        See `irodori.material.principal_components.basis_count.analyse`.
    options : CompressOptions

    Returns
    -------
    compression : Compression
    errors : dict
        Summary of the compression, with ``storage`` and ``weighting``; ``drift``: see
        `irodori.material.principal_components.repeated_reflection.drift`.
    """
    moments = second_moments(weights)
    compression = choose(moments, basis, observers, options)
    truth = moments.sample @ np.asarray(basis, dtype=np.float64).T
    decoded = compression.decode(compression.encode(moments.sample)) @ compression.basis.T
    return compression, {
        **compression.summary(),
        "storage": options.storage,
        "weighting": options.weighting,
        "drift": drift(truth, decoded, compression.basis, observers),
    }


def _log(compression: Compression, gathered: _Gathered, texels: int) -> None:
    share, negative = 100 * gathered.observed / texels, 100 * compression.negative
    bases, rank = compression.bases, compression.rank
    LOGGER.info("%d bases of %d; observed %.1f %% of texels; negative samples %.3f %%", bases, rank, share, negative)
    if gathered.untold > _MOST * gathered.observed:
        LOGGER.warning(_UNTOLD, 100 * gathered.untold / gathered.observed)
    if not compression.budget_met:
        LOGGER.warning("the colour error stays above its target with all %d bases in this storage", bases)
    ratio = np.percentile(np.concatenate(gathered.ratio), [50, 5, 95])
    LOGGER.info("alpha / S_G: median %.4f, 5 to 95 %% %.4f to %.4f", *ratio)
    energy = gathered.energy
    text = "albedo: at most %.3f, above 1 in %.2f %% of texels; at the rim %.2f at %.0f degrees, above 1 in %.1f %%"
    shares = 100 * energy.gain_fraction, 100 * energy.rim_fraction
    LOGGER.info(text, energy.albedo_max, shares[0], energy.rim_max, energy.rim_deg, shares[1])
    if energy.certain_fraction:
        text = "%.3g %% of texels send back up to %.3g times the light that reaches them, beyond three standard errors"
        LOGGER.warning(text, 100 * energy.certain_fraction, energy.certain_max)
    for light, error in compression.errors.items():
        LOGGER.info("CIEDE2000 of the compression under %s: mean %.3f p99 %.3f", light, error["mean"], error["p99"])
