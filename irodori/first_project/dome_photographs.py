"""Photographs of a dome: one fixed camera, one lamp after another."""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core.errors import InputError, counted
from irodori.core.file_kinds import IF_LINEAR, is_picture, kind_instead_of_raw
from irodori.first_project.light_places import photograph_key, read_lamps
from irodori.first_project.lights_command import same_size
from irodori.ingest.first_look import SetNumbers
from irodori.ingest.mosaic import decode

_CLIPPED, _FEWEST, _GREEN = 0.98, 5, 1


class Places(NamedTuple):
    """Responses of J photographs at T places (pixels) of an object.

    Parameters
    ----------
    response : (T, J) float32
        Green response: fraction of the largest number that the file can hold, per second of exposure.
    usable : (T, J) bool
        Responses that are not clipped.
    inside : (rows, columns) bool
        Pixels of the picture that are the places.
    """

    response: np.ndarray
    usable: np.ndarray
    inside: np.ndarray


class DomePhotographs(NamedTuple):
    """Photographs of one object and what is known of their lamps.

    Parameters
    ----------
    files : list of Path
        J photographs.
    green : (J, rows, columns) float32
        Green response, as in `Places`.
    usable : (J, rows, columns) bool
        Pixels that are not clipped.
    direction : (J, 3) float64
        Unit vectors to the lamps: x to the right, y up, z to the camera.
    level : (J,) float64 or None
        Levels of the lamps with geometric mean 1, where the file of lamps states them.
    """

    files: list[Path]
    green: np.ndarray
    usable: np.ndarray
    direction: np.ndarray
    level: np.ndarray | None

    @property
    def names(self) -> list[str]:
        """Names of the files without their folder."""
        return [file.name for file in self.files]

    def places(self, inside: np.ndarray, step: int = 1) -> Places:
        """Return the responses of the pixels inside a mask (rows, columns), of every ``step``-th row and column."""
        inside, thin = inside[::step, ::step], (slice(None), slice(None, None, step), slice(None, None, step))
        response, usable = (np.ascontiguousarray(all_of[thin][:, inside].T) for all_of in (self.green, self.usable))
        return Places(response, usable, inside)


def read_photographs(files: list[Path], lights, linear: bool = False) -> DomePhotographs:
    """Read photographs, and their lamps from a light-position file or a table of lamps.

    Parameters
    ----------
    files : list of Path
    lights : path
        The light-position file or table of lamps.
    linear : bool
        Whether TIFF and PNG pictures have numbers proportional to the light.

    Raises
    ------
    InputError
        If there are fewer than five photographs, one has no lamp or another size than the first, or is a TIFF or PNG
        picture that is not said to be linear.
    """
    stated, levels = read_lamps(lights)
    for file in files:
        if photograph_key(file.name) not in stated:
            raise InputError(lights, "", f"no place of a lamp for {file.name}", "each photograph by its name")
        if is_picture(file) and not linear:
            found = kind_instead_of_raw(file) or "a TIFF picture"
            raise InputError(file, "", found, f"RAW files; or --linear, {IF_LINEAR}")
    if len(files) < _FEWEST:
        raise InputError(lights, "", counted(len(files), "photograph"), f"{_FEWEST} or more, each under another lamp")
    green, usable, numbers = [], [], SetNumbers()
    for file in files:
        mosaic = decode(file, linear)
        green.append((mosaic.superpixels[..., _GREEN] / (mosaic.full_scale * (mosaic.exposure_s or 1.0))).astype("f4"))
        usable.append(mosaic.largest < _CLIPPED)
        for words in numbers.warnings(file, mosaic):
            print(words, file=sys.stderr)
    same_size(files, green)
    keys = [photograph_key(file.name) for file in files]
    direction = np.array([stated[key] for key in keys])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    level = np.array([levels[key] for key in keys]) if levels else None
    if level is not None:
        level /= np.exp(np.log(level).mean())
    return DomePhotographs(files, np.stack(green), np.stack(usable), direction, level)


def refuse_dark(photographs: DomePhotographs, lit: np.ndarray) -> None:
    """Raise `InputError` if a photograph has no usable place that its lamp lights; ``lit`` (T, J) has those."""
    dark = (np.count_nonzero(lit, axis=0) < _FEWEST).nonzero()[0]
    if len(dark):
        file = photographs.files[dark[0]]
        found = f"{file.name} without places that are lit and do not clip"
        raise InputError(file, "", found, "an object that its lamp lights from the camera's side")
