"""File of the lamp's level in every photograph of an object, relative to the level at the white reference."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER

#: How levels were found: from a patch of known reflectance, from a patch, from the texels; or neither tells them.
KNOWN_PATCH, PATCH, TEXELS, NOTHING = "known patch", "patch", "texels", "nothing"
BANDS_OF_STATE = 3


@dataclass(frozen=True)
class PhotographLevels:
    """Level of the lamp in every photograph, by which its responses are divided.

    Parameters
    ----------
    level : (J, filter states) float64
        Ratio to the level at the white reference where ``source`` is `KNOWN_PATCH`, else to the mean of the object's
        photographs through the same filter state; 1 if it was not determined.
    error : (J, filter states) float64
        Standard errors, without the error that all photographs share.
    common_error : float
        Relative standard error of the scale of the responses, common to all photographs.
    source : str
        How the levels were found, one of the names above.
    """

    level: np.ndarray
    error: np.ndarray
    common_error: float
    source: str

    def of_bands(self) -> np.ndarray:
        """Return the level of every band in every photograph, (J, bands)."""
        return np.repeat(self.level, BANDS_OF_STATE, axis=1)

    def say(self) -> None:
        """Log the source of the levels, their scatter and their errors."""
        if self.source == NOTHING:
            LOGGER.info("level of the lamp: too few texels that a model describes tell it; responses stay as they are")
            return
        spread, error = 100.0 * self.level.std(), 100.0 * np.sqrt(np.mean(self.error**2))
        said = (self.source, spread, error, 100.0 * self.common_error)
        LOGGER.info(
            "level of the lamp by %s: varies by %.2f %%, known to %.2f %%; all share an error of %.2f %%", *said
        )

    def write(self, output, captures: list[str], filters: list[str], provenance: store.Provenance) -> None:
        """Write the file of levels for captures and filter states."""
        with store.create(output, provenance) as out:
            out.coordinate("capture", captures, units="1", quantity="name of the capture")
            out.coordinate("filter", filters, units="1", quantity="filter state")
            for name, values, quantity in (
                ("level", self.level, "level of the lamp over its mean, or over that at the white reference"),
                ("level_error", self.error, "standard error of level, without the part that all photographs share"),
            ):
                out.write(name, values, units="1", dims="capture,filter", quantity=quantity)
            out.attribute("common_error", float(self.common_error))
            out.attribute("source", self.source)


def read_levels(path) -> tuple[PhotographLevels, list[str]]:
    """Return the levels in a file of `PhotographLevels.write`, and the names of their captures."""
    with store.open_file(path) as file:
        file.require_axes({"level": "capture,filter", "level_error": "capture,filter"})
        captures = file.read("capture").astype(str).tolist()
        common, source = file.attribute("common_error", float), file.attribute("source", str)
        return PhotographLevels(file.read("level"), file.read("level_error"), common, source), captures


def levels_of(path, captures: list[str], bands: int, observations) -> np.ndarray:
    """Return the levels by which a tile of observations is divided, (J, bands).

    Parameters
    ----------
    path : path
        Of the levels.
    captures : list of str
        Of the observations.
    bands : int
    observations : path
        Of the tile, for the message.

    Raises
    ------
    InputError
        If the levels are those of other captures or of another number of bands.
    """
    levels, names = read_levels(path)
    found = levels.of_bands()
    if names != captures or found.shape[1] != bands:
        text = f"levels of {len(names)} captures and {found.shape[1]} bands"
        raise InputError(path, "capture", text, f"the {len(captures)} captures and {bands} bands of {observations}")
    return found


def common_error(paths: Sequence, stated: float) -> float:
    """Return the relative error common to all observations: from the file of levels, or without one, as configured."""
    for path in paths:
        return read_levels(path)[0].common_error
    return stated
