"""Files that the subcommand ``dome`` writes."""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.config.capture_table import light_angles_deg
from irodori.core.atomic_files import written_whole
from irodori.core.store import Provenance, create
from irodori.evaluation.left_out_photographs import Prediction
from irodori.export.pictures import specification, write_picture_file
from irodori.first_project.dome_photographs import Places
from irodori.first_project.light_places import write_lamps
from irodori.fitting.paint_gloss import PaintGloss
from irodori.rectification.lamp_registration import Lamps

#: Amplification of the difference between photograph and rendering in the picture of differences.
_TENFOLD = 10.0


class SurfaceMaps(NamedTuple):
    """Maps of a surface at T places, and its lobe.

    Parameters
    ----------
    alpha, beta, mu : (T,) float
        Diffuse weight, gloss weight and roughness in rad.
    normal : (T, 3) float
    normal_error_deg : (T,) float or None
        Standard error of a normal that was found, degrees.
    agreeing : (T,) int or None
        Number of photographs that agree about a normal that was found.
    lobe : str
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    normal: np.ndarray
    normal_error_deg: np.ndarray | None
    agreeing: np.ndarray | None
    lobe: str


class Measured(NamedTuple):
    """Surface and lamps of one object, and predictions of photographs that were left out.

    Parameters
    ----------
    inside : (rows, columns) bool
        Pixels of the maps.
    maps : SurfaceMaps
    gloss : PaintGloss or None
    lamps : Lamps
    judged : Places
        Places at which photographs were left out.
    found : Prediction
        Predictions of the photographs that were left out.
    """

    inside: np.ndarray
    maps: SurfaceMaps
    gloss: PaintGloss | None
    lamps: Lamps
    judged: Places
    found: Prediction


def write_dome(into: Path, measured: Measured, own: list[str], listed: list[str]) -> list[Path]:
    """Write all files of a measurement, and return their paths.

    Parameters
    ----------
    into : Path
        Folder.
    measured : Measured
    own : list of str
        Names of the J photographs of the object.
    listed : list of str
        Names of photographs for the table of lamps.
    """
    lamps, maps, inside = measured.lamps, measured.maps, measured.inside
    into.mkdir(parents=True, exist_ok=True)
    files = {name: into / name for name in ("lamps.csv", "surface.h5", "left-out.csv", "left-out.png")}
    write_lamps(files["lamps.csv"], {
        Path(name).name: (*light_angles_deg(direction), level)
        for name, direction, level in zip(listed, lamps.direction, lamps.level, strict=True)
    })  # fmt: skip
    _write_table(files["left-out.csv"], own, lamps, measured.found)
    _write_surface(files["surface.h5"], own, lamps, maps, inside)
    _write_left_out(files["left-out.png"], measured.judged, measured.found)
    normals = into / "normals.png"
    if maps.agreeing is not None:
        files["normals.png"] = normals
        _write_normals(normals, maps.normal, inside)
    else:
        normals.unlink(missing_ok=True)  # of an earlier measurement
    return list(files.values())


def _write_table(path: Path, names: list[str], lamps: Lamps, found: Prediction) -> None:
    columns = ("file", "moved_deg", "relative_rms", "relative_rms_by_file", "in_shadow")
    with written_whole(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(columns)
        for name, *numbers in zip(names, lamps.moved_deg, found.error, found.by_file, found.shadow, strict=True):
            writer.writerow([name, *(f"{value:.5g}" for value in numbers)])


def _spread(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    out = np.full((*inside.shape, *values.shape[1:]), np.nan, dtype=np.float32)
    out[inside] = values
    return out


def _write_surface(path: Path, names: list[str], lamps: Lamps, maps: SurfaceMaps, inside: np.ndarray) -> None:
    with create(path, Provenance("irodori dome")) as out:
        for name, unit, dims, quantity in (
            ("alpha", "1", "row,column", "diffuse weight in green, part of the files' range under the mean lamp"),
            ("beta", "1", "row,column", "gloss weight, in the unit of alpha"),
            ("mu", "rad", "row,column", "roughness"),
            ("normal", "1", "row,column,axis", "x right, y up, z to camera"),
            ("normal_error_deg", "deg", "row,column", "standard error of the normal, if the lamps are as stated"),
            ("agreeing", "1", "row,column", "number of photographs that agree about the normal"),
        ):
            values = getattr(maps, name)
            if values is not None:
                out.write(name, _spread(values, inside), units=unit, dims=dims, quantity=quantity)
        out.coordinate("photograph", names, units="1", quantity="name of the photograph")
        out.write("level", lamps.level, units="1", dims="photograph", quantity="level of the lamp, geometric mean 1")
        out.write("direction", lamps.direction, units="1", dims="photograph,axis", quantity="direction to the lamp")
        out.attribute("lobe", maps.lobe)


def _write_left_out(path: Path, seen: Places, found: Prediction) -> None:
    """Write a picture with a row of photographs, a row of predictions and a row of their differences.

    Photographs and predictions are shown as square roots of the response. What is not compared is black.
    """
    top = float(np.quantile(seen.response, 0.999))
    rows, columns = (np.flatnonzero(seen.inside.any(axis=axis)) for axis in (1, 0))
    crop = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    real, shown = seen.response / top, found.rendered / top

    def tile(values: np.ndarray, at: int) -> np.ndarray:
        out = np.zeros(seen.inside.shape)
        out[seen.inside] = np.where(found.compared[:, at], np.nan_to_num(values), 0.0)
        return np.clip(out[crop], 0.0, 1.0)

    lines = []
    for make in (
        lambda at: np.sqrt(np.maximum(real[:, at], 0.0)),
        lambda at: np.sqrt(np.maximum(shown[:, at], 0.0)),
        lambda at: 0.5 + 0.5 * _TENFOLD * (real[:, at] - shown[:, at]),
    ):
        lines.append(np.concatenate([tile(make(at), at) for at in range(real.shape[1])], axis=1))
    picture = np.rint(255.0 * np.concatenate(lines, axis=0)).astype(np.uint8)[..., None]
    write_picture_file(path, specification(picture.shape[:2], ["Y"], {}, "uint8"), [picture])


def _write_normals(path: Path, normal: np.ndarray, inside: np.ndarray) -> None:
    """Write a normal map: x, y and z from -1 to 1 as red, green and blue from 0 to 255, black where not known."""
    spread = _spread(normal, inside)
    known = np.isfinite(spread).all(axis=-1)[..., None]
    picture = np.where(known, np.rint(127.5 * (np.where(known, spread, 0.0) + 1.0)), 0.0).astype(np.uint8)
    write_picture_file(path, specification(picture.shape[:2], ["R", "G", "B"], {}, "uint8"), [picture])
