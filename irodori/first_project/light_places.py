"""Places of lamps from the light-position files (.lp) of reflectance transformation imaging."""

import math
from pathlib import Path, PureWindowsPath

from irodori.core.errors import InputError
from irodori.first_project.recognition import Recognised

_LARGEST_BYTES = 1_000_000


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
        key = _key(name)
        if key in places:
            raise InputError(path, f"line {number}", f"{name!r} again", "each photograph once")
        places[key] = (x, y, z)
    number, count = rows[0]
    if count != str(len(places)):
        found = f"{count!r} above {len(places)} photographs"
        raise InputError(path, f"line {number}", found, "the number of photographs that follow")
    return places


def places_of_poses(places: dict[str, tuple[float, float, float]], recognised: list[Recognised], path) -> list:
    """Return the position of the lamp in each pose of the object, (x, y, z).

    Parameters
    ----------
    places : dict
        From `read_light_places`.
    recognised : list of Recognised
    path : path
        The light-position file, for the error message.

    Raises
    ------
    InputError
        If no photograph of a pose is listed, or two are listed with different positions.
    """
    found = []
    for pose in range(1 + max(one.pose for one in recognised)):
        names = [one.photograph.path.name for one in recognised if one.pose == pose]
        listed = {places[_key(name)] for name in names if _key(name) in places}
        if not listed:
            raise InputError(path, "", f"none of {', '.join(names)}", "each photograph of the object by its name")
        if len(listed) > 1:
            told = f"different places for {', '.join(names)}, which look alike"
            raise InputError(path, "", told, "one place for the photographs of one pose")
        found.append(listed.pop())
    return found


def _key(name: str) -> str:
    """Return the name of a file in lower case without folder and suffix; accepts Windows paths too."""
    return PureWindowsPath(name.strip().strip('"')).stem.lower()
