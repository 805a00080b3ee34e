"""Paint stage: reads the fitted tiles of an object; writes its paints, and the fit with the gloss of the paints."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.fitting.diffuse_response import GREEN, Observed, without_gloss
from irodori.fitting.joint_gloss import HIGHLIGHTS, NOTHING, PHOTOGRAPH
from irodori.fitting.mirror_image import MirrorImages, without_images
from irodori.fitting.paint_colours import MOST_CORES, Colours, cores, find_colours, noise_floor
from irodori.fitting.paints import (
    BELIEVED,
    GlossModel,
    Paints,
    Tile,
    by_colour,
    find_paints,
    in_pieces,
    looked_at,
    sample_of,
    share_by_paint,
)
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import CARRIED, FITTED_AXES, Model, fitted_maps, for_object, fresnel_of, read_observations
from irodori.jit.chunks import parallel_map
from irodori.material.fitted_tiles import SPEED
from irodori.material.material_file import Status, gloss_maps
from irodori.material.observed_angles import read_texels
from irodori.material.tile_strips import strips, texels_of
from irodori.spectra.coordinates import require_bands, write_bands

_RESPONSE = "diffuse_response", "diffuse_variance"
_CONTRADICTED = "photographs contradict the gloss of paints by %.1f times the expected errors, "
#: Warnings about a `Contradiction`, with its size and its photograph.
_WARNINGS = {
    HIGHLIGHTS: _CONTRADICTED
    + "most of all %s, but not without highlights, which perhaps clip without a flag and are not fitted",
    PHOTOGRAPH: _CONTRADICTED + "but not without %s, whose pose is perhaps wrong and which is not fitted",
    NOTHING: _CONTRADICTED
    + "most of all %s; perhaps gloss varies within a paint, or the lobe has another form; its errors are larger",
}
_OF_FLOOR = 8  # strips, evenly spread, that tell an object's noise
_OWN = 0.5  # smallest share of a texel's own information on its gloss with which it keeps the status OK


class _Piece(NamedTuple):
    """Strip of a tile: files of its observations and of its texels' separate fits, its rows, and its texels in both."""

    observations: Path
    fitted: Path
    rows: tuple[int, int]
    texels: slice


def _pieces(observations: Sequence, tiles: Sequence) -> list[_Piece]:
    """Return the strips of all tiles of an object.

    Raises
    ------
    InputError
        If a fit has another number of texels than its observations.
    """
    found = []
    for seen, own in zip(observations, tiles, strict=True):
        with store.open_file(seen) as file:
            file.require_axes({"weight": "texel,capture"})
            texels, captures = file.layout("weight").shape
        with store.open_file(own) as file:
            rows, width = file.attribute("rows", list), file.attribute("width", int)
            file.require_axes({"status": "texel"})
            fitted = file.layout("status").shape[0]
        if fitted != texels:
            raise InputError(own, "status", f"{fitted} texels", f"{texels}, as in {seen}")
        pairs = [(strip, texels_of(strip, rows, width)) for strip in strips(rows, width, captures)]
        found += [_Piece(seen, own, strip, chosen) for strip, chosen in pairs]
    return found


def _find_colours(pieces: list[_Piece], width: int) -> Colours:
    """Find the paints of an object by the colours in its fitted tiles."""
    most = max(MOST_CORES // len(pieces), 200)

    def colours(piece: _Piece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return diffuse responses and variances, (rows, width, bands), and whether they are reliable."""
        response, variance, status = _read_maps(piece, (*_RESPONSE, "status")).values()
        told = np.isin(status, BELIEVED) & np.isfinite(response).all(axis=1)
        shape = -1, width, response.shape[1]
        return response.reshape(shape), variance.reshape(shape), told.reshape(shape[:2])

    def floor_of(piece: _Piece) -> np.ndarray:
        """Return the noise floor, (1, bands), or (0, bands) without a reliable texel."""
        response, variance, told = colours(piece)
        return noise_floor(variance[told], response[told])[None][: int(told.any())]

    def cores_of(piece: _Piece) -> np.ndarray:
        response, _, told = colours(piece)
        core = response[cores(response, floor, told)]
        return core[:: max(1, -(-len(core) // most))]

    for some in (pieces[:: max(1, len(pieces) // _OF_FLOOR)], pieces):
        floors = np.concatenate(list(parallel_map(floor_of, some)))
        if len(floors):
            break
    floor = np.median(floors, axis=0) if len(floors) else np.ones(floors.shape[1])
    return find_colours(np.concatenate(list(parallel_map(cores_of, pieces))), floor)


def _read_maps(piece: _Piece, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Read maps of the separate fits of a strip."""
    with store.open_file(piece.fitted) as file:
        return {name: file.read(name, piece.texels) for name in names}


def _carried(tiles: Sequence) -> tuple[dict, int]:
    """Return the attributes of an object's fit that its tiles state, their speeds added, and the number of bands."""
    attributes: dict = {}
    rows, sums, bands = [], dict.fromkeys(SPEED, 0), 0
    for own in tiles:
        with store.open_file(own) as file:
            attributes = {name: file.attribute(name, kind) for name, kind in CARRIED.items()}
            sums = {name: total + file.attribute(name) for name, total in sums.items()}
            bands = file.layout("diffuse_response").shape[-1]
        require_bands(attributes["filters"], bands, own)
        rows += attributes["rows"]
    return attributes | sums | {"rows": [min(rows), max(rows)]}, bands


def _tile(observed: Observed, maps: dict, chosen=slice(None)) -> Tile:
    """Return texels with their observations and fits."""
    return Tile(observed, *(maps[name][chosen] for name in ("status", *_RESPONSE)))


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
    status PAINT, or MIXTURE where it may show two paints. Texels that no paint explains keep their own fit.

    There are further datasets with one entry for each paint: ``/paints/log_gloss``, log β and log μ of each component,
    NaN if unknown; ``/paints/error``, the covariance of their errors; ``/paints/varying``, the covariance of the
    texels' about them; with one lobe ``/paints/scatter``, the covariance of what photographs tell about a texel's,
    beyond noise; ``/paints/excess``, the factor on the variance of observations; ``/paints/texels``, the number of
    texels in the fit. The attribute ``mirror_weight`` is a `MirrorWeight`; ``gloss_contradiction`` is what
    `Contradiction.told` returns, or empty.
    """
    options = for_object(options, observations, levels)
    pieces, (attributes, bands) = _pieces(observations, tiles), _carried(tiles)
    width, height, start = attributes["width"], attributes["rows"][1], time.perf_counter()
    optics = GlossModel(options, fresnel_of(n, k, calibration, bands))
    colours = _find_colours(pieces, width)

    def sampled(piece: _Piece) -> Tile:
        maps = _read_maps(piece, ("status", *_RESPONSE))
        paint = by_colour(maps["diffuse_response"], maps["diffuse_variance"], colours)
        here, with_light = looked_at(len(paint), width, len(pieces)), np.zeros(len(paint), dtype=bool)
        with store.open_file(piece.observations) as file:
            with_light[here] = np.any(read_texels(file, "weight", here + piece.texels.start) > 0, axis=1)
        chosen = sample_of(paint, with_light, colours, width, len(pieces))
        texels = chosen + piece.texels.start
        return _tile(without_images(read_observations(piece.observations, levels, texels), options), maps, chosen)

    paints = find_paints(list(parallel_map(sampled, pieces)), colours, optics)

    def no_images() -> MirrorImages:
        return MirrorImages(options, optics.fresnel.n, optics.fresnel.k, GREEN)

    def shared_by(piece: _Piece) -> tuple[dict[str, np.ndarray], int, MirrorImages]:
        maps, images = _read_maps(piece, fitted_maps(options.lobes)), no_images()
        own = _tile(read_observations(piece.observations, levels, piece.texels), maps)
        count = _share_tile(replace(own, observed=without_images(own.observed, options)), maps, paints, width, optics)
        images.add(own.observed, maps)
        return maps, count, images

    shared, images = 0, no_images()
    datasets: dict = {}
    with store.create(output, provenance) as out:
        write_bands(out, attributes["filters"])
        for piece, (maps, count, seen) in zip(pieces, parallel_map(shared_by, pieces), strict=True):
            shared += count
            images.join(seen)
            datasets = datasets or _reserve(out, maps, height * width, options.lobes)
            for name, dataset in datasets.items():
                dataset[piece.rows[0] * width : piece.rows[1] * width] = maps[name]
        _write_paints(out, paints, options.lobes)
        for name, value in {**attributes, "parts": [piece.rows for piece in pieces]}.items():
            out.attribute(name, value)
        out.attribute("paint_seconds", time.perf_counter() - start)
        out.attribute("lobes", list(options.lobes))
        out.attribute("coat", options.coat)
        out.attribute("common_error", options.level_error)
        out.attribute("angle_errors", options.angles.plain())
        out.attribute("mirror_weight", images.measured().plain())
        contradiction = {}
        if paints.contradiction:
            with store.open_file(observations[0]) as file:
                contradiction = paints.contradiction.told(file.read("capture").astype(str).tolist())
        out.attribute("gloss_contradiction", contradiction)
    _log(paints, shared, options.lobes)
    if contradiction:
        LOGGER.warning(_WARNINGS[contradiction["left_out"]], contradiction["times"], contradiction["photograph"])


def _reserve(out: store.Writer, maps: dict[str, np.ndarray], texels: int, lobes: tuple[str, ...]) -> dict:
    """Create an empty dataset for every map of a fit, with room for all texels of an object."""
    found = {}
    for name, (units, quantity) in fitted_maps(lobes).items():
        values, dims = maps[name], ",".join(FITTED_AXES[: maps[name].ndim])
        size = (texels, *values.shape[1:])
        found[name] = out.reserve(
            name, size, values.dtype, units=units, quantity=quantity, dims=dims, compression="fast"
        )
    return found


def _share_tile(tile: Tile, maps: dict[str, np.ndarray], paints: Paints, width: int, optics: GlossModel) -> int:
    """Write parameters with the gloss of the paints into the maps of a tile; return the number of such texels."""
    found = share_by_paint(tile, paints, width, optics)
    here, shared, options = found.texel, found.shared, optics.options
    for name in ("alpha", "alpha_error", "residual_rms", "relative_residual"):
        maps[name][here] = getattr(shared, name)
    for number, name in enumerate(gloss_maps(options.lobes)):
        maps[name][here], maps[f"{name}_error"][here] = shared.gloss[:, number], shared.gloss_error[:, number]
    own = (maps["status"][here] == Status.OK) & (shared.own >= _OWN)
    maps["status"][here] = np.where(own, Status.OK, np.where(found.is_mixture, Status.MIXTURE, Status.PAINT))
    maps["model"][here] = Model.BOTH
    maps["paint"] = found.paint.astype(np.int16)

    def diffuse(piece: np.ndarray) -> None:
        texels = here[piece]
        some = tile[texels]
        maps["diffuse_response"][texels], maps["diffuse_variance"][texels] = without_gloss(
            some.observed,
            shared.gloss[piece],
            options.lobes,
            optics.fresnel,
            model_error=options.model_error,
            coupled=options.is_coupled,
        )

    in_pieces(diffuse, np.arange(len(here)))
    return len(here)


def _write_paints(out: store.Writer, paints: Paints, lobes: tuple[str, ...]) -> None:
    """Write the gloss of the paints, with one entry for each; NaN where it is not known."""
    names = [f"log_{name}" for name in gloss_maps(lobes)]
    count, pairs = len(names), "paint_number,parameter,other_parameter"
    out.coordinate(
        "paint_number", np.arange(len(paints.gloss)), units="1", quantity="number of the paint, as in the map paint"
    )
    for axis in ("parameter", "other_parameter"):
        out.coordinate(axis, names, units="1", quantity="parameter of the gloss")
    described: dict[str, tuple] = {
        "log_gloss": ((count,), "paint_number,parameter", "logarithms of beta and mu"),
        "error": ((count, count), pairs, "their covariance"),
        "varying": ((count, count), pairs, "covariance of the texels' about them"),
        "excess": ((), "paint_number", "factor of the variance of observations"),
        "texels": ((), "paint_number", "texels that the gloss comes from"),
    }
    if len(lobes) == 1:
        quantity = "covariance of what a texel's photographs tell about them, beyond noise"
        described["scatter"] = ((count, count), pairs, quantity)
    for name, (shape, dims, quantity) in described.items():
        values = np.full((len(paints.gloss), *shape), 0.0 if name == "texels" else np.nan)
        for number in paints.known:
            values[number] = getattr(paints.gloss[number], name)
        out.write(f"paints/{name}", values, units="1", dims=dims, quantity=quantity)


def _log(paints: Paints, shared: int, lobes: tuple[str, ...]) -> None:
    LOGGER.info("%d paints; %d texels have the gloss of one", len(paints.gloss), shared)
    for number, gloss in enumerate(paints.gloss):
        if gloss is None:
            LOGGER.info("paint %d: its texels do not determine a gloss", number)
        else:
            values, error = np.exp(gloss.log_gloss), np.sqrt(np.diag(gloss.error))
            varying = 100.0 * np.sqrt(np.diag(gloss.varying))
            stated = zip(gloss_maps(lobes), values, values * error, varying, strict=True)
            text = ", ".join(f"{name} {v:.4g} +- {e:.2g} varying by {own:.1f} %" for name, v, e, own in stated)
            LOGGER.info("paint %d: %s, from %d texels", number, text, gloss.texels)
