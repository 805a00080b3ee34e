"""Photographs of a folder, RAW files or linear pictures, with their metadata, in the order in which they were taken."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irodori.core.confined_paths import confined
from irodori.core.errors import InputError
from irodori.core.file_kinds import IF_LINEAR, is_picture, kind_instead_of_raw
from irodori.core.progress import track
from irodori.first_project.photograph_order import in_order
from irodori.ingest.mosaic import Mosaic, decode
from irodori.ingest.plausibility import Look, look_at
from irodori.ingest.tiff_tags import RATIONAL, read_tags

_ACCEPTED = "RAW files of one camera, such as DNG, CR2, NEF or ARW"
_PICTURES = "TIFF or PNG pictures, as --linear says"
#: Suffixes of files that commonly lie beside photographs.
_BESIDE = (
    ".csv", ".txt", ".xmp", ".yaml", ".yml", ".md", ".pp3", ".json", ".html", ".lp", ".db", ".ini", ".dop", ".cos",
    ".on1", ".thm", ".mov", ".mp4", ".avi", ".doc", ".docx", ".odt", ".xls", ".xlsx", ".ods",
)  # fmt: skip
_PLANE_RESOLUTION, _PLANE_UNIT, _EXIF_WIDTH = 41486, 41488, 40962
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
#: Largest relative difference between the width of the picture in the metadata and that of the mosaic with its margins.
_MARGIN = 0.05
#: Assumed exposure time of linear pictures that state none, s: many programs that develop RAW files drop it.
UNSTATED_S = 1.0


@dataclass(frozen=True)
class Photograph:
    """A photograph with its metadata and a small version of its picture.

    Parameters
    ----------
    path : path
    look : Look
        Small version of the picture, and statistics of it.
    exposure_s, iso, f_number : float
        Values stated in the file; 0 if it does not state them.
    pitch_um : float
        Distance of mosaic pixels stated in the file, micrometres; 0 if it does not state it.
    linear : bool
        Whether it is a TIFF or PNG picture with numbers proportional to the light, instead of a RAW file.
    """

    path: Path
    look: Look
    exposure_s: float
    iso: float
    f_number: float
    pitch_um: float = 0.0
    linear: bool = False

    @property
    def rate(self) -> np.ndarray:
        """Small RGB picture times f-number², over exposure time in s and ISO / 100, (rows, columns, 3)."""
        aperture = self.f_number**2 if self.f_number else 1.0
        return self.look.picture * (aperture / (self.exposure_s * (self.iso / 100.0 if self.iso else 1.0)))


def raw_files(place, linear: bool = False) -> list[Path]:
    """List the files of a folder that may be RAW, or with ``linear`` its TIFF and PNG files.

    Parameters
    ----------
    place : path
        A folder, or a single file.
    linear : bool

    Raises
    ------
    InputError
        If the folder does not exist, or has no such file, or a link in it leads nowhere.
    """
    place = Path(place)
    if place.is_file():
        found = [place]
    elif place.is_dir():
        found = sorted(
            file
            for file in place.iterdir()
            if (file.is_file() or not file.exists())
            and not file.name.startswith(".")
            and file.suffix.lower() not in _BESIDE
        )
        for file in found:
            if not file.exists():
                raise InputError(file, "", "a link to no file", "the photograph, or a link to it")
    else:
        raise InputError(place, "", "no such folder", f"a folder of {_ACCEPTED}, or one such file")
    if linear:
        pictures = [file for file in found if is_picture(file)]
        if not pictures:
            raise InputError(place, "", "no TIFF or PNG picture", _PICTURES)
        return pictures
    kinds = {file: kind_instead_of_raw(file) for file in found}
    others = [file for file in found if kinds[file]]
    # Cameras may write a JPEG beside each RAW file, which is ignored.
    raw = [file for file in found if not kinds[file]]
    if not raw and others:
        accepted = _ACCEPTED + (f"; or --linear, {IF_LINEAR}" if is_picture(others[0]) else "")
        raise InputError(place, "", f"no RAW file; {others[0].name} is {kinds[others[0]]}", accepted)
    if not raw:
        raise InputError(place, "", "an empty folder", _ACCEPTED)
    return raw


def photographs(place, linear: bool = False, order: str = "") -> tuple[list[Photograph], str]:
    """Read all RAW files of a folder, or a single file; with ``linear``, TIFF and PNG pictures.

    Parameters
    ----------
    place : path
        A folder, or a single file.
    linear : bool
    order : str
        See `irodori.first_project.photograph_order.in_order`.

    Returns
    -------
    list of Photograph
        In the order in which they were taken.
    str
        What the order is that of, as a phrase.

    Raises
    ------
    InputError
        If there is no photograph, one cannot be decoded, a RAW file states no exposure time, or the photographs are
        from several cameras or have different sizes; if a file is a link out of the folder, which the later commands do
        not follow; if the order cannot be told.
    """
    files = raw_files(place, linear)
    for file in files:
        confined(file.parent, file.name, file, "")
    found = list(_looked_at(files, linear))
    first = found[0]
    for one in found[1:]:
        if one.look.camera != first.look.camera:
            told = f"{one.look.camera or 'no camera'!r}, and {first.look.camera or 'no camera'!r} in {first.path.name}"
            raise InputError(one.path, "body", told, "the photographs of one camera in one folder")
        if one.look.size != first.look.size:
            told = "{} x {} pixels".format(*one.look.size) + ", and {} x {}".format(*first.look.size)
            raise InputError(one.path, "size", f"{told} in {first.path.name}", "photographs of one size in one folder")
    paths, told = in_order({one.path: one.look.time for one in found}, order)
    by_path = {one.path: one for one in found}
    return [by_path[path] for path in paths], told


def _looked_at(files: list[Path], linear: bool) -> Iterator[Photograph]:
    for path in track(files, "look"):
        mosaic = decode(path, linear)
        exposure_s = mosaic.exposure_s or (UNSTATED_S if linear else 0.0)
        if not exposure_s:
            raise InputError(path, "exposure time", "none", "a RAW file that states its exposure time")
        look = look_at(path, mosaic, thumbnail=True)
        pitch_um = 0.0 if linear else pixel_pitch_um(path, mosaic)
        yield Photograph(path, look, exposure_s, mosaic.iso, mosaic.f_number, pitch_um, linear)


def pixel_pitch_um(path: Path, mosaic: Mosaic) -> float:
    """Return the distance of pixels, micrometres, from the EXIF resolution of the focal plane.

    It is 0 if the file does not state the resolution, or states it for a picture of another width.
    """
    tags = {tag.number: tag for tag in read_tags(path, (_PLANE_RESOLUTION, _PLANE_UNIT, _EXIF_WIDTH))}
    resolution, unit, width = (tags.get(number) for number in (_PLANE_RESOLUTION, _PLANE_UNIT, _EXIF_WIDTH))
    if resolution is None or resolution.kind != RATIONAL or unit is None or width is None:
        return 0.0
    above, below = (int(value) for value in resolution.values[:2])
    unit_mm = _UNIT_MM.get(int(unit.values[0]))
    if not above or not below or unit_mm is None or abs(int(width.values[0]) / mosaic.size[0] - 1.0) > _MARGIN:
        return 0.0
    return round(1000.0 * unit_mm * below / above, 3)
