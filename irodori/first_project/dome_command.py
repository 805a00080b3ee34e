"""The subcommand ``dome``: the reflection of a ball from photographs of a fixed camera under one lamp after another."""

import argparse
import csv
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.config.capture_table import light_angles_deg
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.core.file_kinds import IF_LINEAR, is_picture, kind_instead_of_raw
from irodori.core.store import Provenance, create
from irodori.evaluation.left_out_photographs import MATT, Prediction, fitted, predict_left_out
from irodori.export.pictures import specification, write_picture_file
from irodori.first_project.light_places import read_light_places, write_lamps
from irodori.first_project.lights_command import (
    add_names,
    add_outline,
    asked_circle,
    in_counting_order,
    is_mask,
    names_of,
    same_size,
)
from irodori.fitting.one_gloss import OneGloss
from irodori.ingest.first_look import COARSE, COARSE_WARNING
from irodori.ingest.mosaic import Mosaic, decode
from irodori.rectification.circle_search import Circle
from irodori.rectification.lamp_registration import Lamps, geometry_of, register_lamps
from irodori.reflection.registry import DEFAULT_LOBES, names

#: Share of the ball's radius that is used: nearer to its rim a pixel spans many degrees.
INSIDE = 0.95
#: cosθ_i below which a place counts as near the terminator, where errors of the lamp's size and the ball's outline
#: dominate.
LEAST_COSINE = 0.2
_CLIPPED, _FEWEST = 0.98, 5
_GREEN = 1
_WRITTEN = ("lamps.csv", "surface.h5", "left-out.csv", "left-out.png")
#: Approximate number of places from which levels and directions of the lamps are estimated.
_REGISTERED = 1200
#: Amplification of the difference between photograph and rendering in the picture of differences.
_TENFOLD = 10.0


class Seen(NamedTuple):
    """Responses of J photographs at T places (pixels) on a ball.

    Parameters
    ----------
    names : list of str
    response : (T, J) float64
        Green response: fraction of the largest number that the file can hold, per second of exposure.
    usable : (T, J) bool
        Responses that are not clipped.
    normal, view : (T, 3) float64
        Unit vectors: surface normals and directions to the camera.
    inside : (rows, columns) bool
        Pixels of the picture that are the places.
    """

    names: list[str]
    response: np.ndarray
    usable: np.ndarray
    normal: np.ndarray
    view: np.ndarray
    inside: np.ndarray

    def lit(self, direction: np.ndarray) -> np.ndarray:
        """Return 1 for responses that are not clipped and lie on the lit side away from the terminator, else 0, (T, J).

        ``direction`` has the unit vectors to the lamps, (J, 3).
        """
        return ((self.normal @ direction.T > LEAST_COSINE) & self.usable).astype(float)


def main(arguments: list[str] | None = None, prog: str = "irodori dome") -> int:
    """Fit the reflection of a ball to photographs of one fixed camera, and predict each of them from the others.

    The photographs differ in nothing but the lamp, and the directions to the lamps are known from a light-position
    file (see irodori lights). Levels and directions of the lamps are refined together. Written are lamps.csv (levels
    and directions, for irodori init --lights), surface.h5 (diffuse weight and gloss in each pixel), left-out.csv (the
    error of each photograph that was left out) and left-out.png (photographs, renderings, and ten times their
    difference). The exit status is 2 if nothing was written.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("photographs", nargs="+", help="photographs of the ball; RAW, or with --linear TIFF or PNG")
    parser.add_argument("--lights", required=True, help="light-position file (.lp) that lists the photographs")
    parser.add_argument("--linear", action="store_true", help=f"the photographs are TIFF or PNG: {IF_LINEAR}")
    add_outline(parser)
    add_names(parser, "in lamps.csv")
    near = "standard deviation of the directions to the lamps, degrees; 0 where they are exact (3)"
    parser.add_argument("--error-deg", type=float, default=3.0, help=near)
    parser.add_argument("--refractive-index", type=float, default=1.5, help="of the surface (1.5)")
    parser.add_argument("--into", default="dome", help="folder to write into (dome)")
    asked = parser.parse_args(arguments)
    try:
        return _measure(asked)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2


def _measure(asked: argparse.Namespace) -> int:
    seen, known = _seen(asked)
    listed = names_of(asked, seen.names)
    part = slice(None, None, max(1, len(seen.normal) // _REGISTERED))
    response, normal, view, lit = (v[part] for v in (seen.response, seen.normal, seen.view, seen.lit(known)))
    n = asked.refractive_index
    lamps = register_lamps(response, normal, view, lit, known, error_deg=asked.error_deg, n=n, k=0.0)
    weight, tried = seen.lit(lamps.direction), {}
    # The simplest first: no gloss, then the paper's lobe, then all other registered lobes.
    for lobe in (MATT, *sorted(names(), key=lambda name: (name,) != DEFAULT_LOBES)):
        tried[lobe] = predict_left_out(
            seen.response, seen.normal, seen.view, weight, lamps, known, lobe=lobe, n=n, k=0.0
        )  # fmt: skip
        print(f"gloss {lobe}: left-out photographs differ by {_percent(tried[lobe].error)}")
    lobe = simplest({name: one.error for name, one in tried.items()})
    found = tried[lobe]
    geometry = geometry_of(seen.normal, seen.view, lamps.direction)
    surface = fitted(seen.response / lamps.level, geometry, weight, lobe, n, 0.0)
    _say(seen, lamps, found, surface, asked)
    into = Path(asked.into)
    into.mkdir(parents=True, exist_ok=True)
    write_lamps(into / "lamps.csv", {
        Path(name).name: (*light_angles_deg(direction), level)
        for name, direction, level in zip(listed, lamps.direction, lamps.level, strict=True)
    })  # fmt: skip
    _write_table(into / "left-out.csv", seen, lamps, found)
    _write_surface(into / "surface.h5", seen, lamps, surface, lobe)
    _write_pictures(into / "left-out.png", seen, found, weight)
    print(f"written: {', '.join(str(into / name) for name in _WRITTEN)}")
    return 0


def simplest(errors: dict[str, np.ndarray]) -> str:
    """Return the simplest model with errors within one standard error of the best model.

    Errors are compared photograph by photograph.

    Parameters
    ----------
    errors : dict of (J,) float
        Error of each photograph by the name of the model, the simplest model first.
    """
    best = min(errors.values(), key=lambda error: error.mean())
    for name, error in errors.items():
        behind = error - best
        if behind.mean() <= behind.std(ddof=1) / np.sqrt(len(behind)):
            return name
    raise AssertionError("the best is within one standard error of itself")


def _seen(asked: argparse.Namespace) -> tuple[Seen, np.ndarray]:
    """Read the photographs, and the directions to their lamps from the light-position file, (J, 3)."""
    files = [Path(name) for name in in_counting_order(asked.photographs) if not is_mask(name, asked)]
    places = read_light_places(asked.lights)
    for file in files:
        if file.stem.lower() not in places:
            raise InputError(asked.lights, "", f"no place of a lamp for {file.name}", "each photograph by its name")
        if is_picture(file) and not asked.linear:
            found = kind_instead_of_raw(file) or "a TIFF picture"
            raise InputError(file, "", found, f"RAW files; or --linear, {IF_LINEAR}")
    if len(files) < _FEWEST:
        raise InputError(asked.lights, "", f"{len(files)} photographs", f"{_FEWEST} or more, each under another lamp")
    mosaics = [decode(file, asked.linear) for file in files]
    pictures = [_green(mosaic) for mosaic in mosaics]
    same_size(files, pictures)
    if mosaics[0].full_scale <= COARSE:
        print(f"{files[0]}: {COARSE_WARNING}", file=sys.stderr)
    circle: Circle = asked_circle(asked, pictures, files[0])
    print(f"ball about {circle.x:.1f}, {circle.y:.1f}, radius {circle.radius:.1f} pixels")
    normals = circle.normals(pictures[0].shape)
    with np.errstate(invalid="ignore"):
        inside = normals[..., 2] > np.sqrt(1.0 - INSIDE**2)
    usable = np.stack([mosaic.largest[inside] < _CLIPPED for mosaic in mosaics], axis=1)
    normal = normals[inside]
    view = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
    response = np.stack([picture[inside] for picture in pictures], axis=1).astype(float)
    known = np.array([places[file.stem.lower()] for file in files])
    known /= np.linalg.norm(known, axis=1)[:, None]
    seen = Seen([file.name for file in files], response, usable, normal, view, inside)
    dark = (seen.lit(known).sum(axis=0) < _FEWEST).nonzero()[0]
    if len(dark):
        found = f"{seen.names[dark[0]]} without places that are lit and do not clip"
        raise InputError(files[dark[0]], "", found, "a ball that its lamp lights from the camera's side")
    return seen, known


def _green(mosaic: Mosaic) -> np.ndarray:
    return mosaic.superpixels[..., _GREEN] / (mosaic.full_scale * (mosaic.exposure_s or 1.0))


def _percent(error: np.ndarray) -> str:
    return f"{100.0 * error.mean():.2f} % in the mean and {100.0 * error.max():.2f} % at worst"


def _say(seen: Seen, lamps: Lamps, found: Prediction, surface: OneGloss, asked: argparse.Namespace) -> None:
    for name, level, moved, error in zip(seen.names, lamps.level, lamps.moved_deg, found.error, strict=True):
        print(f"{name}: lamp {level:.3f} of the mean, {moved:.1f} degrees beside {asked.lights}; error {error:.2%}")
    if surface.gloss is None:
        print("the photographs tell no gloss")
    else:
        (beta, mu), sigma = np.exp(surface.gloss.log_gloss), np.sqrt(np.diag(surface.gloss.error))
        print(
            f"gloss {surface.lobe}: beta {beta:.3g} +- {sigma[0]:.0%}, mu {mu:.3g} rad +- {sigma[1]:.0%}, "
            f"where alpha is {np.nanmedian(surface.alpha):.3g}"
        )
    print(f"left-out photographs, lamps registered: {_percent(found.error)}")
    print(f"left-out photographs, lamps where {asked.lights} says: {_percent(found.by_file)}")


def _write_table(path: Path, seen: Seen, lamps: Lamps, found: Prediction) -> None:
    columns = ("file", "moved_deg", "relative_rms", "relative_rms_by_file")
    with written_whole(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(columns)
        for at, name in enumerate(seen.names):
            numbers = lamps.moved_deg[at], found.error[at], found.by_file[at]
            writer.writerow([name, *(f"{value:.5g}" for value in numbers)])


def _write_surface(path: Path, seen: Seen, lamps: Lamps, surface: OneGloss, lobe: str) -> None:
    def spread(values: np.ndarray) -> np.ndarray:
        out = np.full((*seen.inside.shape, *values.shape[1:]), np.nan, dtype=np.float32)
        out[seen.inside] = values
        return out

    with create(path, Provenance("irodori dome")) as out:
        for name, unit, quantity in (
            ("alpha", "1", "diffuse weight in green, part of the files' range under the mean lamp"),
            ("beta", "1", "gloss weight, in the unit of alpha"),
            ("mu", "rad", "roughness"),
        ):
            out.write(name, spread(getattr(surface, name)), units=unit, dims="row,column", quantity=quantity)
        out.write(
            "normal", spread(seen.normal), units="1", dims="row,column,axis", quantity="x right, y up, z to camera"
        )
        out.coordinate("photograph", seen.names, units="1", quantity="name of the photograph")
        out.write("level", lamps.level, units="1", dims="photograph", quantity="level of the lamp, geometric mean 1")
        out.write("direction", lamps.direction, units="1", dims="photograph,axis", quantity="direction to the lamp")
        out.attribute("lobe", lobe)


def _write_pictures(path: Path, seen: Seen, found: Prediction, weight: np.ndarray) -> None:
    """Write a picture with a row of photographs, a row of renderings and a row of their differences.

    Photographs and renderings are shown as square roots of the response.
    """
    top = float(np.quantile(seen.response, 0.999))
    rows, columns = (np.flatnonzero(seen.inside.any(axis=axis)) for axis in (1, 0))
    crop = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)

    def tile(values: np.ndarray, at: int) -> np.ndarray:
        out = np.zeros(seen.inside.shape)
        out[seen.inside] = np.where(weight[:, at] > 0.0, np.nan_to_num(values), 0.0)
        return np.clip(out[crop], 0.0, 1.0)

    lines = []
    for make in (
        lambda at: np.sqrt(np.maximum(seen.response[:, at] / top, 0.0)),
        lambda at: np.sqrt(np.maximum(found.rendered[:, at] / top, 0.0)),
        lambda at: 0.5 + 0.5 * _TENFOLD * (seen.response[:, at] - found.rendered[:, at]) / top,
    ):
        lines.append(np.concatenate([tile(make(at), at) for at in range(len(seen.names))], axis=1))
    picture = np.rint(255.0 * np.concatenate(lines, axis=0)).astype(np.uint8)[..., None]
    write_picture_file(path, specification(picture.shape[:2], ["Y"], {}, "uint8"), [picture])


if __name__ == "__main__":
    sys.exit(main())
