"""Fitted tiles of an object as one texture, read tile by tile."""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError, counted
from irodori.core.progress import LOGGER
from irodori.material.material_file import NloptResult, Status, gloss_maps, gloss_names, read_coat, read_lobes
from irodori.reflection.coat import SUM

#: Maps of the fit, other than α, β and μ, that a material's file keeps for any lobes: units and quantity.
COLUMNS: dict[str, tuple[store.Units, str]] = {
    "texel": (store.Mask, "whether a surface lies under the texel's centre"),
    "alpha_error": ("1", "standard error of alpha"),
    "residual_rms": ("1", "root mean square residual in response"),
    "status": (Status, "outcome of the fit"),
    "relative_residual": ("1", "root mean square residual over root mean square response"),
    "paint": ("1", "number of the texel's paint, -1 where not known"),
    "evaluations": ("1", "evaluations of the objective"),
    "nlopt_result": (NloptResult, "return code of NLopt"),
}

_DETERMINED = (Status.OK, Status.PAINT, Status.MIXTURE, Status.DIFFUSE_ONLY)

#: Attributes of a tile that say how fast it was fitted.
SPEED = ("fit_seconds", "texels_fitted")


def columns(lobes: tuple[str, ...]) -> dict[str, tuple[store.Units, str]]:
    """Return units and quantities of the maps `COLUMNS` and of the errors of β and μ: name -> (units, quantity)."""
    errors = {f"{name}_error": (units, f"standard error of {name}") for name, (units, _) in gloss_maps(lobes).items()}
    return COLUMNS | errors


class FittedTile(NamedTuple):
    """A tile, or a part of one: its file, its first and last-plus-one texture row, and its first row in the file."""

    path: Path
    rows: tuple[int, int]
    start: int


class FittedTiles:
    """The fitted tiles of one object, read from the top row of the texture down.

    Parameters
    ----------
    paths : list of path
    height, width : int
        Size of the texture, texels.

    Attributes
    ----------
    filters : list of str
        Filter states of the bands.
    lobes : tuple of str
        Lobe of each gloss component.
    coat : str
        Coat with which the texels were fitted, see `irodori.reflection.coat`.
    speed : dict
        ``fit_seconds`` without start-up and compilation, and ``texels_fitted``.
    common_error : float
        Relative error of α and β that all texels share; NaN if the tiles do not state it.
    mirror_weight : dict
        Measured weight of the mirror term, as `irodori.fitting.mirror_image.MirrorWeight.plain`; empty if the tiles do
        not state it.
    gloss_contradiction : dict
        Photographs that contradict the gloss of paints, as `irodori.fitting.joint_gloss.Contradiction.told`; empty if
        none do.
    angle_errors : dict
        Errors of the angles that the fit used, as `irodori.material.angle_errors.AngleErrors.plain`; empty if the tiles
        do not state them.
    misfit : float
        Multiplies all standard errors that are read; 1 unless it is set. Above 1 no model predicts the photographs
        (`irodori.material.lobe_choices.Comparison.misfit`), and what a fit calls determined is contradicted.
    white_error : float
        Relative error of the level of the white reference, which is added to all errors of α and β that are read; 0
        unless it is set.

    Raises
    ------
    InputError
        If the tiles do not cover the texture exactly, or differ in their filter states, lobes or coat.
    """

    def __init__(self, paths: list, height: int, width: int) -> None:
        self.first, self.height, self.width, self.filters = paths[0], height, width, None
        self.misfit, self.white_error = 1.0, 0.0
        self.lobes: tuple[str, ...] = ()
        self.coat = SUM
        self.speed: dict = dict.fromkeys(SPEED, 0)
        self.common_error = math.nan
        self.angle_errors: dict = {}
        self.mirror_weight: dict = {}
        self.gloss_contradiction: dict = {}
        covered, tiles = np.zeros(height, dtype=int), []
        for path in paths:
            with store.open_file(path) as file:
                found = file.attribute("filters")
                if self.filters not in (None, found):
                    accepted = f"{', '.join(self.filters)}, as in the other tiles"
                    raise InputError(path, "filters", ", ".join(found), accepted)
                self.filters = found
                lobes = read_lobes(file)
                if self.lobes not in ((), lobes):
                    raise InputError(path, "lobes", ", ".join(lobes), f"{', '.join(self.lobes)}, as in the other tiles")
                coat = read_coat(file)
                if self.lobes and coat != self.coat:
                    raise InputError(path, "coat", coat, f"{self.coat}, as in the other tiles")
                self.lobes, self.coat = lobes, coat
                for name in self.speed:
                    self.speed[name] += file.attribute(name)
                if file.has_attribute("common_error"):
                    self.common_error = file.attribute("common_error", float)
                if file.has_attribute("mirror_weight"):
                    self.mirror_weight = file.attribute("mirror_weight", dict)
                if file.has_attribute("gloss_contradiction"):
                    self.gloss_contradiction = file.attribute("gloss_contradiction", dict)
                if file.has_attribute("angle_errors"):
                    self.angle_errors = file.attribute("angle_errors", dict)
                whole = file.attribute("rows", list)
                # A file of all tiles names them; its texels begin with the first row of the first.
                for first, last in file.attribute("parts", list) if file.has_attribute("parts") else [whole]:
                    covered[first:last] += 1
                    tiles.append(FittedTile(path, (first, last), first - whole[0]))
        if not (covered == 1).all():
            found = f"{counted(int((covered != 1).sum()), 'row')} missing or doubled"
            raise InputError(self.first, "rows", found, f"tiles that cover {height} rows once")
        self.tiles = sorted(tiles, key=lambda tile: tile.rows)

    def read(self, *names: str) -> Iterator[tuple[slice, dict[str, np.ndarray]]]:
        """Yield, for every tile, the slice of its texture rows and its maps of the given names."""
        for tile in self.tiles:
            yield slice(*tile.rows), self.maps(tile, names)

    def maps(self, tile: FittedTile, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Read the maps of a tile, (rows, width, ...) each."""
        first, last = tile.rows
        part = slice(tile.start * self.width, (tile.start + last - first) * self.width)
        with store.open_file(tile.path) as file:
            found = {name: self._believed(name, file.read(name, part)) for name in names}
            if self.white_error:
                for name in found.keys() & self._scaled_errors():
                    scaled = file.read(name.removesuffix("_error"), part)
                    found[name] = np.hypot(found[name], scaled.dtype.type(self.white_error) * scaled)
        return {name: one.reshape(last - first, self.width, *one.shape[1:]) for name, one in found.items()}

    @property
    def shared_error(self) -> float:
        """Relative error of α and β, as they are read, that all texels share; NaN if the tiles do not state it."""
        return math.hypot(self.misfit * self.common_error, self.white_error)

    def _scaled_errors(self) -> set[str]:
        """Return the names of the errors of what is proportional to the level of the light."""
        return {"alpha_error", *(f"{gloss_names(component)[0]}_error" for component in range(len(self.lobes)))}

    def _believed(self, name: str, values: np.ndarray) -> np.ndarray:
        """Return a map as far as it is believed if the model contradicts left-out photographs."""
        if self.misfit == 1.0:
            return values
        if name == "status":
            return np.where(np.isin(values, _DETERMINED), np.array(Status.CONTRADICTED, values.dtype), values)
        power = 1 if name.endswith("_error") else 2 if name == "diffuse_variance" else 0
        return values * values.dtype.type(self.misfit**power) if power else values

    def typical_gloss(self) -> tuple[float, ...]:
        """Return β and μ of each gloss component in turn: their medians over the half of texels that know μ best.

        A component that no texel has gets β = 0, μ = 1. Of several components, one that is known to be absent (β = 0)
        in more texels than it is present in gets β = 0.
        """
        typical: list[float] = []
        for component in range(len(self.lobes)):
            beta_name, mu_name = gloss_names(component)
            parts, lacking = [], 0
            for _, maps in self.read(beta_name, mu_name, f"{mu_name}_error"):
                stacked = np.stack(list(maps.values()), axis=-1)
                parts.append(stacked[np.isfinite(stacked).all(axis=-1)])
                lacking += int((maps[beta_name] == 0.0).sum())
            beta, mu, mu_error = np.concatenate(parts).T
            if not beta.size:
                typical += [0.0, 1.0]
                continue
            relative = mu_error / mu
            best = relative <= np.median(relative)
            is_rare = len(self.lobes) > 1 and lacking > beta.size
            typical += [0.0 if is_rare else float(np.median(beta[best])), float(np.median(mu[best]))]
        return tuple(typical)

    def is_noise_known(self) -> bool:
        """Return whether the camera's noise was measured for all texels that have a diffuse response.

        Raises
        ------
        InputError
            If no texel has both a diffuse response and a diffuse weight α.
        """
        measured = unknown = observed = 0
        for _, maps in self.read("diffuse_response", "diffuse_variance", "alpha"):
            has = np.isfinite(maps["diffuse_response"]).all(axis=-1)
            observed += int((has & np.isfinite(maps["alpha"])).sum())
            measured += int(has.sum())
            unknown += int((has & ~np.isfinite(maps["diffuse_variance"]).all(axis=-1)).sum())
        if not observed:
            found = "no texel with enough observations"
            accepted = "captures that see the object lit and from its front (flip the faces of a mesh that looks away)"
            raise InputError(self.first, "status", found, accepted)
        if unknown:
            share = 100 * unknown / measured
            LOGGER.info("noise not measured for %.1f %% of the texels: it has no part in their spectra", share)
        return not unknown
