"""Places and levels of lamps: the light-position files (.lp) of other programs, and the tables of `irodori dome`."""

import csv
import math
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath
from typing import TypeVar

from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, counted
from irodori.core.text_tables import table_rows, with_decimal_points
from irodori.first_project.recognition import Recognised

_LARGEST_BYTES = 1_000_000
Stated = TypeVar("Stated")
#: Columns of a table of lamps, named as in a table of photographs.
_COLUMNS = ("file", "light_deg", "light_azimuth_deg", "light_level")


def write_lamps(path, lamps: Mapping[str, tuple[float, float, float]]) -> None:
    """Write a table of lamps.

    Parameters
    ----------
    path : path
    lamps : dict
        Light angle and azimuth, degrees, and level relative to the mean, by the name of the photograph.
    """
    with written_whole(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(_COLUMNS)
        writer.writerows([name, *(f"{value:.5g}" for value in lamp)] for name, lamp in lamps.items())


def read_lamps(path) -> tuple[dict[str, tuple[float, float, float]], dict[str, float]]:
    """Read the position of the lamp in each photograph, and its level where the file states it.

    Parameters
    ----------
    path : path
        Table of lamps (.csv), as `write_lamps` writes it, or a light-position file, see `read_light_places`.

    Returns
    -------
    positions : dict
        See `read_light_places`; of unit length from a table.
    levels : dict
        Irradiance of each lamp relative to the lamp that counts as 1, by the same names; empty for a light-position
        file.

    Raises
    ------
    InputError
        If the file cannot be read or a line is not complete, a name occurs twice, or a level is not above 0.
    """
    if Path(path).suffix.lower() != ".csv":
        return read_light_places(path), {}
    rows = with_decimal_points(table_rows(path, "a table of lamps"), path)
    if not rows or [cell.strip() for cell in rows[0][1]] != list(_COLUMNS):
        found = ", ".join(rows[0][1]) if rows else "an empty file"
        raise InputError(path, "", found, f"the columns {', '.join(_COLUMNS)}, as irodori dome writes them")
    positions: dict[str, tuple[float, float, float]] = {}
    levels: dict[str, float] = {}
    for line, cells in rows[1:]:
        name, *words = cells
        try:
            angle, azimuth, level = map(float, words)
        except ValueError:
            angle = azimuth = level = math.nan
        if not all(map(math.isfinite, (angle, azimuth, level))) or level <= 0.0:
            raise InputError(path, f"line {line}", repr(",".join(cells)), "a file's name, two angles, a level above 0")
        key = photograph_key(name)
        if key in positions:
            raise InputError(path, f"line {line}", f"{name!r} again", "each photograph once")
        angle, azimuth = math.radians(angle), math.radians(azimuth)
        aside = math.sin(angle)
        positions[key] = (aside * math.cos(azimuth), aside * math.sin(azimuth), math.cos(angle))
        levels[key] = level
    return positions, levels


def read_light_places(path) -> dict[str, tuple[float, float, float]]:
    """Read the position of the lamp in each photograph from a light-position file.

    The first line of the file holds the number of photographs, every other line the name of a file and the position of
    the lamp: x to the right of the picture, y up, z towards the camera, from the centre of the object, all in one unit
    of length. For a camera that looks straight down (camera angle 0) these are the axes of the rig.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict
        (x, y, z) by the name of the photograph without folder and suffix, because programs often list the JPEG beside a
        RAW file.

    Raises
    ------
    InputError
        If the file cannot be read, a line is not a name and three numbers, a name occurs twice, the number of lines is
        not the stated one, or a lamp is at the centre of the object.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise InputError(path, "", f"{path.stat().st_size} bytes", f"a light-position file below {_LARGEST_BYTES}")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "", str(error), "a light-position file (.lp): text") from None
    rows = [(number, line.strip()) for number, line in enumerate(lines, 1) if line.strip()]
    if not rows:
        raise InputError(path, "", "an empty file", "the number of photographs, then a name and x y z in each line")
    places: dict[str, tuple[float, float, float]] = {}
    for number, line in rows[1:]:
        name, *words = line.rsplit(None, 3)
        try:
            x, y, z = (float(word) for word in words)
        except ValueError:
            x = y = z = math.nan
        if not all(map(math.isfinite, (x, y, z))) or not math.hypot(x, y, z) > 0.0:
            raise InputError(path, f"line {number}", repr(line), "a file's name and three numbers x y z, not all 0")
        key = photograph_key(name)
        if key in places:
            raise InputError(path, f"line {number}", f"{name!r} again", "each photograph once")
        places[key] = (x, y, z)
    number, count = rows[0]
    if count != str(len(places)):
        found = f"{count!r} above {counted(len(places), 'photograph')}"
        raise InputError(path, f"line {number}", found, "the number of photographs that follow")
    return places


def lamp_of_poses(stated: Mapping[str, Stated], recognised: list[Recognised], path) -> list[Stated]:
    """Return what a file states about the lamp in each pose of the object: its position or its level.

    Parameters
    ----------
    stated : dict
        Positions or levels from `read_lamps`.
    recognised : list of Recognised
    path : path
        The file, for the error message.

    Raises
    ------
    InputError
        If no photograph of a pose is listed, or two are listed with different lamps.
    """
    found = []
    for pose in range(1 + max(one.pose for one in recognised)):
        names = [one.photograph.path.name for one in recognised if one.pose == pose]
        listed = {stated[photograph_key(name)] for name in names if photograph_key(name) in stated}
        if not listed:
            raise InputError(path, "", f"none of {', '.join(names)}", "each photograph of the object by its name")
        if len(listed) > 1:
            told = f"different lamps for {', '.join(names)}, which look alike"
            raise InputError(path, "", told, "one lamp for the photographs of one pose")
        found.append(listed.pop())
    return found


def photograph_key(name: str) -> str:
    """Return the name by which a file of lamps knows a photograph: lower case, without folder and suffix.

    Windows paths are accepted too.
    """
    return PureWindowsPath(name.strip().strip('"')).stem.lower()
