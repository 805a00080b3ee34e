"""Exposure time, ISO and aperture of a photograph, from the capture table and from the file."""

import dataclasses
from collections.abc import Iterable

from irodori.config.capture_table import FILTERS, Shot
from irodori.core.errors import InputError
from irodori.ingest.mosaic import Mosaic

#: Largest relative difference between file and table. Cameras round: 1/50 s is written as 0.01976, ISO 640 as 635,
#: f/5.6 as 5.66; the nearest other setting is a third of a stop away, 26 % in time and ISO, 12 % in f-number.
TOLERANCE = 0.05
_COLUMNS = ("exposure_s", "iso", "f_number")
_OPTIONAL = ("iso", "f_number")


def settle(shot: Shot, mosaic: Mosaic, table) -> Shot:
    """Return a shot with ISO and aperture taken from the file if the table does not state them.

    Raises
    ------
    InputError
        If exposure time, ISO or f-number in the file differ from those in the table by more than 5 %.
    """
    found = {}
    for column in _COLUMNS:
        stated, own = getattr(shot, column), getattr(mosaic, column)
        if stated and own and abs(own / stated - 1) > TOLERANCE:
            raise InputError(table, column, f"{column} {stated:g} for {shot.file}", f"{own:g} as the file itself says")
        found[column] = stated or own
    return dataclasses.replace(shot, **found)


def settle_set(shots: list[Shot], table) -> list[Shot]:
    """Complete ISO and f-number in a set of shots, so that each is known for all shots or for none.

    If a setting is known for some shots only, these must agree within 5 %, and the others are assumed to have the same.
    The aperture of dark frames is ignored, because no light passes it.

    Raises
    ------
    InputError
        If the setting is unknown for some shots and differs among the others.
    """
    for column in _OPTIONAL:
        concerned = [s for s in shots if column == "iso" or s.role != "dark"]
        known = [getattr(s, column) for s in concerned if getattr(s, column)]
        silent = [s for s in concerned if not getattr(s, column)]
        if not known or not silent:
            continue
        if max(known) > (1 + TOLERANCE) * min(known):
            found = f"no {column} for {silent[0].file}, while others have {min(known):g} to {max(known):g}"
            raise InputError(table, column, found, "the value for every photograph whose file does not hold it")
        fill = {column: known[0]}
        shots = [dataclasses.replace(s, **fill) if s in silent else s for s in shots]
    return shots


def relative_exposure_s(shot: Shot) -> float:
    """Return exposure time x lamp's level x (ISO / 100) / f-number², s; unknown factors count as 1."""
    amplified_s = shot.exposure_s * shot.light_level * (shot.iso / 100.0 if shot.iso else 1.0)
    return amplified_s / (shot.f_number**2 if shot.f_number else 1.0)


def iso_ratio(shot: Shot, iso: float) -> float:
    """Return the amplification of a shot relative to that at another ISO; 1 if either is unknown."""
    return shot.iso / iso if shot.iso and iso else 1.0


def known_settings(shots: Iterable[Shot]) -> list[str]:
    """Return those of ``iso`` and ``f_number`` that are known for the shots, after `settle_set`."""
    lit = [s for s in shots if s.role != "dark"]
    return [column for column in _OPTIONAL if any(getattr(s, column) for s in lit)]


def filter_states(shots: Iterable[Shot]) -> list[str]:
    """Return the filter states that occur in shots, in the order of the bands."""
    shots = list(shots)
    return [state for state in FILTERS if any(shot.filter == state for shot in shots)]
