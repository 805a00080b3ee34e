"""Paint stage: reads the fitted tiles of an object; writes its paints, and the fit with the gloss of the paints."""

import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numba
import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.fitting.mirror_image import MirrorImages, without_images
from irodori.fitting.paint_colours import MOST_CORES, Colours, cores, find_colours, noise_floor
from irodori.fitting.paint_gloss import PaintGloss
from irodori.fitting.paints import (
    BELIEVED,
    GlossModel,
    Paints,
    Tile,
    by_colour,
    find_paints,
    in_pieces,
    sample_of,
    share_by_paint,
)
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import (
    CARRIED,
    FITTED_AXES,
    GREEN,
    Model,
    Observed,
    fitted_maps,
    for_object,
    fresnel_of,
    read_observations,
    without_gloss,
)
from irodori.material.fitted_tiles import SPEED
from irodori.material.material_file import Status
from irodori.spectra.coordinates import require_bands, write_bands

_RESPONSE = "diffuse_response", "diffuse_variance"
_OWN = 0.5  # smallest share of a texel's own information on its gloss with which it keeps the status OK


def _colours(tiles: list) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield diffuse responses and variances, (rows, width, bands), and whether they are reliable, for each tile."""
    for path in tiles:
        with store.open_file(path) as file:
            response, variance, status = (file.read(name) for name in (*_RESPONSE, "status"))
            shape = -1, file.attribute("width", int)
        told = np.isin(status, BELIEVED) & np.isfinite(response).all(axis=1)
        yield (
            response.reshape(*shape, response.shape[1]),
            variance.reshape(*shape, response.shape[1]),
            told.reshape(shape),
        )


def _find_colours(tiles: list) -> Colours:
    """Find the paints of an object by the colours in its fitted tiles."""
    most, found = max(MOST_CORES // len(tiles), 200), []
    floors = [noise_floor(variance[told], response[told]) for response, variance, told in _colours(tiles) if told.any()]
    floor = np.median(floors, axis=0) if floors else np.ones(next(_colours(tiles))[0].shape[-1])
    for response, _, told in _colours(tiles):
        core = response[cores(response, floor, told)]
        found.append(core[:: max(1, -(-len(core) // most))])
    return find_colours(np.concatenate(found), floor)


def _read_fit(fitted) -> tuple[dict[str, np.ndarray], dict]:
    """Read the maps of a tile's fit, and the attributes that are passed on."""
    with store.open_file(fitted) as file:
        lobes = tuple(file.attribute("lobes", list))
        maps = {name: file.read(name) for name in fitted_maps(lobes)}
        attributes = {name: file.attribute(name, kind) for name, kind in CARRIED.items()}
        attributes |= {name: file.attribute(name) for name in SPEED}
    require_bands(attributes["filters"], maps["diffuse_response"].shape[-1], fitted)
    return maps, attributes


def _seen(observations, fitted, texels: int) -> np.ndarray:
    """Return which texels of a tile have an observation, (texels,) bool.

    Raises
    ------
    InputError
        If the fit has another number of texels.
    """
    with store.open_file(observations) as file:
        weight = file.read("weight")
    if len(weight) != texels:
        raise InputError(fitted, "status", f"{texels} texels", f"{len(weight)}, as in {observations}")
    return np.any(weight > 0.0, axis=1)


def _tile(observed: Observed, maps: dict, optics: GlossModel, chosen=slice(None)) -> Tile:
    """Return texels with their observations and fits; those with an unknown refractive index get the nominal one."""
    index, status, *colour = (maps[name][chosen] for name in ("refractive_index", "status", *_RESPONSE))
    index = np.where(np.isfinite(index), index, optics.fresnel.n).astype(np.float64)
    return Tile(observed, index, status, *colour)


def _ahead(observations: Sequence, tiles: Sequence, levels: Sequence) -> Iterator[tuple[Observed, dict]]:
    """Yield the observations of each tile, and the maps of its fit, while the next one is read."""

    def read(pair):
        return read_observations(pair[0], levels), _read_fit(pair[1])[0]

    pairs = list(zip(observations, tiles, strict=True))
    with ThreadPoolExecutor(1, initializer=numba.set_num_threads, initargs=(1,)) as pool:
        coming = pool.submit(read, pairs[0])
        for pair in [*pairs[1:], None]:
            now = coming.result()
            if pair is not None:
                coming = pool.submit(read, pair)
            yield now


def share_gloss(
    observations: list,
    tiles: list,
    output,
    options: FitOptions,
    n,
    k,
    *,
    provenance,
    calibration=None,
    levels=(),
) -> None:
    """Find the paints of an object and write its fit with the gloss of the paints, all tiles in one file.

    Parameters
    ----------
    observations, tiles : list of path
        Files of observations, and the separate fits of their texels, in the same order.
    output, options, n, k, calibration, levels
        As in `irodori.fitting.stage.fit_brdf`, which also describes the datasets.

    Notes
    -----
    A texel keeps the status OK if at least half of the information on its gloss is its own; otherwise it gets the
    status PAINT. Texels that no paint explains keep their own fit. With two lobes, all texels do.

    With one lobe there are further datasets with one entry for each paint: ``/paints/log_gloss``, log β and log μ, NaN
    if unknown; ``/paints/error``, the covariance of their errors; ``/paints/varying``, the covariance of the texels'
    log β and log μ about them; ``/paints/excess``, the factor on the variance of observations; ``/paints/texels``, the
    number of texels in the fit. The attribute ``mirror_weight`` is a `MirrorWeight`.
    """
    options = for_object(options, observations, levels)
    colours = _find_colours(tiles) if len(options.lobes) == 1 else None
    samples, optics, seconds = [], None, 0.0
    parts, carried, fitted = [], {}, 0
    for seen, own in zip(observations, tiles, strict=True):
        maps, attributes = _read_fit(own)
        optics = optics or GlossModel(options, fresnel_of(n, k, calibration, maps["diffuse_response"].shape[1]))
        if colours:
            paint = by_colour(maps["diffuse_response"], maps["diffuse_variance"], colours)
            with_light = _seen(seen, own, len(maps["status"]))
            chosen = sample_of(paint, with_light, colours, attributes["width"], len(tiles))
            observed = without_images(read_observations(seen, levels, chosen), options)
            samples.append(_tile(observed, maps, optics, chosen))
        parts.append(attributes["rows"])
        seconds, fitted = seconds + attributes["fit_seconds"], fitted + attributes["texels_fitted"]
        carried = attributes
    assert optics is not None  # an object has a tile
    start = time.perf_counter()
    paints = find_paints(samples, colours, optics) if colours else None
    width, shared, images = carried["width"], 0, MirrorImages(options, optics.fresnel.k, GREEN)
    with store.create(output, provenance) as out:
        write_bands(out, carried["filters"])
        datasets: dict = {}
        for (observed, maps), (first, last) in zip(_ahead(observations, tiles, levels), parts, strict=True):
            if paints:
                own_tile = _tile(observed, maps, optics)
                fitted_tile = replace(own_tile, observed=without_images(observed, options))
                shared += _share_tile(fitted_tile, maps, paints, width, optics)
                images.add(observed, own_tile.index, maps)
                del own_tile, fitted_tile
            del observed  # before the next one comes
            datasets = datasets or _reserve(out, maps, max(map(max, parts)) * width, options.lobes)
            for name, dataset in datasets.items():
                dataset[first * width : last * width] = maps[name]
        if paints:
            _write_paints(out, paints)
        attributes = {**carried, "rows": [min(map(min, parts)), max(map(max, parts))], "parts": parts}
        for name, value in {**attributes, "fit_seconds": seconds, "texels_fitted": fitted}.items():
            out.attribute(name, value)
        out.attribute("paint_seconds", time.perf_counter() - start)
        out.attribute("lobes", list(options.lobes))
        out.attribute("coat", options.coat)
        out.attribute("common_error", options.level_error)
        out.attribute("angle_errors", options.angles.plain())
        out.attribute("mirror_weight", images.measured().plain())
    if paints:
        _log(paints, shared)
    else:
        LOGGER.info("two lobes: every texel keeps gloss of its own")


def _reserve(out: store.Writer, maps: dict[str, np.ndarray], texels: int, lobes: tuple[str, ...]) -> dict:
    """Create an empty dataset for every map of a fit, with room for all texels of an object."""
    found = {}
    for name, (units, quantity) in fitted_maps(lobes).items():
        values, dims = maps[name], ",".join(FITTED_AXES[: maps[name].ndim])
        size = (texels, *values.shape[1:])
        found[name] = out.reserve(name, size, values.dtype, units=units, quantity=quantity, dims=dims)
    return found


def _share_tile(tile: Tile, maps: dict[str, np.ndarray], paints: Paints, width: int, optics: GlossModel) -> int:
    """Write parameters with the gloss of the paints into the maps of a tile; return the number of such texels."""
    found = share_by_paint(tile, paints, width, optics)
    here, shared, options = found.texel, found.shared, optics.options
    for name in ("alpha", "beta", "mu", "alpha_error", "beta_error", "mu_error", "residual_rms", "relative_residual"):
        maps[name][here] = getattr(shared, name)
    own = (maps["status"][here] == Status.OK) & (shared.own >= _OWN)
    maps["status"][here] = np.where(own, Status.OK, Status.PAINT)
    maps["model"][here] = Model.BOTH
    maps["paint"] = found.paint.astype(np.int16)
    gloss = np.column_stack([shared.beta, shared.mu])

    def diffuse(piece: np.ndarray) -> None:
        texels = here[piece]
        some = tile[texels]
        maps["diffuse_response"][texels], maps["diffuse_variance"][texels] = without_gloss(
            some.observed,
            gloss[piece],
            some.index,
            options.lobes,
            optics.fresnel,
            model_error=options.model_error,
            coupled=options.is_coupled,
        )

    in_pieces(diffuse, np.arange(len(here)))
    return len(here)


def _write_paints(out: store.Writer, paints: Paints) -> None:
    unknown = np.full((2, 2), np.nan)
    nothing = PaintGloss(unknown[0], unknown, unknown, math.nan, 0)
    gloss, pairs = [one or nothing for one in paints.gloss], "paint_number,parameter,other_parameter"
    out.coordinate(
        "paint_number", np.arange(len(gloss)), units="1", quantity="number of the paint, as in the map paint"
    )
    for axis in ("parameter", "other_parameter"):
        out.coordinate(axis, ["log_beta", "log_mu"], units="1", quantity="parameter of the gloss")
    for name, shape, dims, quantity in (
        ("log_gloss", (2,), "paint_number,parameter", "logarithms of beta and mu"),
        ("error", (2, 2), pairs, "their covariance"),
        ("varying", (2, 2), pairs, "covariance of the texels' about them"),
        ("excess", (), "paint_number", "factor of the variance of observations"),
        ("texels", (), "paint_number", "texels that the gloss comes from"),
    ):
        values = np.array([getattr(one, name) for one in gloss], dtype=float).reshape(-1, *shape)
        out.write(f"paints/{name}", values, units="1", dims=dims, quantity=quantity)


def _log(paints: Paints, shared: int) -> None:
    LOGGER.info("%d paints; %d texels have the gloss of one", len(paints.gloss), shared)
    for number, gloss in enumerate(paints.gloss):
        if gloss is None:
            LOGGER.info("paint %d: its texels do not determine a gloss", number)
        else:
            (beta, mu), error = np.exp(gloss.log_gloss), np.sqrt(np.diag(gloss.error))
            varying = 100.0 * np.sqrt(np.diag(gloss.varying))
            stated = (number, beta, beta * error[0], mu, mu * error[1], *varying, gloss.texels)
            text = "paint %d: beta %.4g +- %.2g, mu %.4g +- %.2g, varying by %.1f and %.1f %%, from %d texels"
            LOGGER.info(text, *stated)
