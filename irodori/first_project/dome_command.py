"""The subcommand ``dome``: the reflection of an object from photographs of a fixed camera, each under another lamp."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from irodori.core.errors import InputError
from irodori.core.file_kinds import IF_LINEAR
from irodori.core.left_out import simplest
from irodori.evaluation.left_out_photographs import Prediction, fit_known_shape, predict_left_out
from irodori.first_project.dome_files import Measured, SurfaceMaps, write_dome
from irodori.first_project.dome_photographs import DomePhotographs, Places, read_photographs, refuse_dark
from irodori.first_project.lights_command import add_names, add_outline, asked_circle, asked_mask, paired
from irodori.fitting.one_gloss import MATT
from irodori.fitting.unknown_shape import fit_unknown_shape, register_unknown_shape
from irodori.geometry.circle_search import Circle
from irodori.rectification.lamp_registration import Lamps, geometry_of, register_lamps
from irodori.rectification.photometric_stereo import LEAST_COSINE
from irodori.reflection.registry import DEFAULT_LOBES, names

#: Share of the ball's radius that is used: nearer to its rim a pixel spans many degrees.
INSIDE = 0.95
#: Approximate number of places from which lamps are estimated, at which photographs of an object of unknown shape are
#: left out, and at which a ball is compared with an object of unknown shape.
_REGISTERED, _JUDGED, _COMPARED = 1200, 6_000, 6_000
#: If the photographs are predicted that much better with unknown normals, the object is no ball.
_NO_BALL = 0.5
_ERROR_DEG = 3.0
_CHUNK = 200_000


def main(arguments: list[str] | None = None, prog: str = "irodori dome") -> int:
    """Fit the reflection of an object to photographs of one fixed camera, and predict each of them from the others.

    The photographs differ in nothing but the lamp, and the directions to the lamps are known: from a light-position
    file (see irodori lights), or from the table lamps.csv that this command writes for a matt ball. The normals of a
    ball follow from its outline, and levels and directions of the lamps are refined with it. The normals of an object
    of any other shape are found from the photographs. Written are lamps.csv (levels and directions, for irodori init
    --lights), surface.h5 (diffuse weight, gloss and normal in each pixel), left-out.csv (the error of each photograph
    that was left out), left-out.png (photographs, predictions, and ten times their difference) and, if the normals were
    found, normals.png. The exit status is 2 if nothing was written.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("photographs", nargs="+", help="photographs of the object; RAW, or with --linear TIFF or PNG")
    lights = "light-position file (.lp) that lists the photographs, or lamps.csv of a matt ball under the same lamps"
    parser.add_argument("--lights", required=True, help=lights)
    parser.add_argument("--linear", action="store_true", help=f"the photographs are TIFF or PNG: {IF_LINEAR}")
    shape = "auto: a ball if the outline is a circle and the photographs do not contradict it (auto)"
    parser.add_argument("--shape", choices=("auto", "ball", "free"), default="auto", help=shape)
    add_outline(parser)
    add_names(parser, "in lamps.csv")
    near = "standard deviation of the directions to the lamps, degrees; 0 where they are exact (3; 0 for a lamps.csv)"
    parser.add_argument("--error-deg", type=float, help=near)
    parser.add_argument("--refractive-index", type=float, default=1.5, help="of the surface (1.5)")
    parser.add_argument("--into", default="dome", help="folder to write into (dome)")
    asked = parser.parse_args(arguments)
    try:
        return _measure(asked)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2


def _measure(asked: argparse.Namespace) -> int:
    files, listed = paired(asked)
    photographs = read_photographs(files, asked.lights, asked.linear)
    if asked.error_deg is None:
        asked.error_deg = _ERROR_DEG if photographs.level is None else 0.0
    circle = _circle(asked, photographs)
    measured = _ball(asked, photographs, circle) if circle is not None else None
    if measured is not None and asked.shape == "auto" and _is_no_ball(asked, photographs, measured):
        measured = None
    if measured is None:
        measured = _free(asked, photographs)
    _say(photographs, measured, asked)
    written = write_dome(Path(asked.into), measured, photographs.names, listed)
    print(f"written: {', '.join(map(str, written))}")
    return 0


def _circle(asked: argparse.Namespace, photographs: DomePhotographs) -> Circle | None:
    """Return the outline of the ball; None for an object of another shape."""
    if asked.shape == "free":
        return None
    if asked.mask:
        asked_mask(asked, photographs.green[0].shape)  # what is wrong with the picture itself is no question of shape
    try:
        circle = asked_circle(asked, list(photographs.green), photographs.files[0])
    except InputError:
        if asked.shape == "ball":
            raise
        where = f"inside {asked.mask}" if asked.mask else "in every pixel, as there is no --mask"
        print(f"no ball: normals are found {where}")
        return None
    print(f"ball about {circle.x:.1f}, {circle.y:.1f}, radius {circle.radius:.1f} pixels")
    return circle


def _chosen(predict: Callable[[str], Prediction]) -> tuple[str, Prediction]:
    """Return the simplest gloss that predicts photographs as well as any, and its predictions."""
    tried = {}
    # The simplest first: no gloss, then the paper's lobe, then all other registered lobes.
    for lobe in (MATT, *sorted(names(), key=lambda name: (name,) != DEFAULT_LOBES)):
        tried[lobe] = predict(lobe)
        print(f"gloss {lobe}: left-out photographs differ by {_percent(tried[lobe].error)}")
    lobe = simplest({name: one.error for name, one in tried.items()})
    return lobe, tried[lobe]


def _ball(asked: argparse.Namespace, photographs: DomePhotographs, circle: Circle) -> Measured:
    normals, n, known = circle.normals(photographs.green[0].shape), asked.refractive_index, photographs.direction
    with np.errstate(invalid="ignore"):
        seen = photographs.places(normals[..., 2] > np.sqrt(1.0 - INSIDE**2))
    normal, response = normals[seen.inside], seen.response.astype(float)
    view = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)

    def lit(direction: np.ndarray) -> np.ndarray:
        return ((normal @ direction.T > LEAST_COSINE) & seen.usable).astype(float)

    refuse_dark(photographs, lit(known) > 0.0)
    part = slice(None, None, max(1, len(normal) // _REGISTERED))
    lamps = register_lamps(
        response[part], normal[part], view[part], lit(known)[part], known, error_deg=asked.error_deg, n=n, k=0.0
    )
    weight, geometry = lit(lamps.direction), geometry_of(normal, view, lamps.direction)

    def fit(weight: np.ndarray, lobe: str):
        return fit_known_shape(response, weight, lamps, normal, view, lobe=lobe, n=n, k=0.0, geometry=geometry)

    lobe, found = _chosen(
        lambda lobe: predict_left_out(response, weight, lamps, known, lambda kept: fit(kept, lobe))
    )  # fmt: skip
    own = fit(weight, lobe).surface
    maps = SurfaceMaps(own.alpha, own.beta, own.mu, normal, None, None, lobe)
    return Measured(seen.inside, maps, own.gloss, lamps, seen, found)


def _is_no_ball(asked: argparse.Namespace, photographs: DomePhotographs, ball: Measured) -> bool:
    """Return whether the photographs contradict that the object is a ball."""
    seen = photographs.places(ball.inside, _step(ball.inside, _COMPARED))
    free = _predicted_free(asked, photographs, seen, _lamps_of_free(asked, photographs, seen), MATT)
    if not free.error.mean() < _NO_BALL * ball.found.error.mean():
        return False
    told = f"{_percent(ball.found.error)}, with normals of their own by {_percent(free.error)}"
    print(f"no ball: as a ball left-out photographs differ by {told}")
    return True


def _step(inside: np.ndarray, most: int) -> int:
    return max(1, int(np.ceil(np.sqrt(np.count_nonzero(inside) / most))))


def _lamps_of_free(asked: argparse.Namespace, photographs: DomePhotographs, seen: Places) -> Lamps:
    known = photographs.direction
    if photographs.level is not None and not asked.error_deg:
        return Lamps(known, photographs.level, np.zeros(len(known)))
    part = slice(None, None, max(1, len(seen.response) // (2 * _REGISTERED)))
    return register_unknown_shape(seen.response[part], seen.usable[part], known, error_deg=asked.error_deg)


def _predicted_free(asked, photographs: DomePhotographs, seen: Places, lamps: Lamps, lobe: str) -> Prediction:
    def fit(weight: np.ndarray):
        return fit_unknown_shape(seen.response, weight > 0.0, lamps, lobe=lobe, n=asked.refractive_index, k=0.0)

    return predict_left_out(seen.response, seen.usable.astype(float), lamps, photographs.direction, fit)


def _free(asked: argparse.Namespace, photographs: DomePhotographs) -> Measured:
    size = photographs.green[0].shape
    inside = asked_mask(asked, size) if asked.mask else np.ones(size, dtype=bool)
    seen = photographs.places(inside, _step(inside, _JUDGED))
    refuse_dark(photographs, seen.usable & (seen.response > 0.0))
    lamps = _lamps_of_free(asked, photographs, seen)
    lobe, found = _chosen(lambda lobe: _predicted_free(asked, photographs, seen, lamps, lobe))
    own = fit_unknown_shape(seen.response, seen.usable, lamps, lobe=lobe, n=asked.refractive_index, k=0.0)
    every = photographs.places(inside)
    parts = [slice(first, first + _CHUNK) for first in range(0, len(every.response), _CHUNK)]
    facets = [own.at_other_places(every.response[part], every.usable[part], lamps).facets for part in parts]
    alpha, normal, error, agreeing = (
        np.concatenate([make(one) for one in facets])
        for make in (
            lambda one: one.alpha,
            lambda one: one.normal,
            lambda one: one.normal_error_deg(lamps.light),
            lambda one: one.agreeing,
        )
    )
    told = np.isfinite(alpha)
    maps = SurfaceMaps(
        alpha, np.where(told, own.beta, np.nan), np.where(told, own.mu, np.nan), normal, error, agreeing, lobe
    )  # fmt: skip
    return Measured(inside, maps, own.gloss, lamps, seen, found)


def _percent(error: np.ndarray) -> str:
    return f"{100.0 * error.mean():.2f} % in the mean and {100.0 * error.max():.2f} % at worst"


def _say(photographs: DomePhotographs, measured: Measured, asked: argparse.Namespace) -> None:
    lamps, maps, found = measured.lamps, measured.maps, measured.found
    for at, name in enumerate(photographs.names):
        shadow = f", {found.shadow[at]:.1%} in shadow" if maps.agreeing is not None else ""
        moved = f"{lamps.moved_deg[at]:.1f} degrees beside {asked.lights}"
        print(f"{name}: lamp {lamps.level[at]:.3f} of the mean, {moved}; error {found.error[at]:.2%}{shadow}")
    if maps.normal_error_deg is not None:
        told = np.isfinite(maps.alpha)
        print(f"normals of {told.mean():.1%} of {len(told)} pixels, median standard error "
              f"{np.nanmedian(maps.normal_error_deg):.2g} degrees, if the lamps are right")  # fmt: skip
        if lamps.moved_deg.any():
            print("lamps were refined with this object: all its normals may be distorted alike, and gloss may have "
                  "been taken for the level of lamps; photograph a matt ball under the same lamps")  # fmt: skip
    if measured.gloss is None:
        print("the photographs tell no gloss")
    else:
        (beta, mu), sigma = np.exp(measured.gloss.log_gloss), np.sqrt(np.diag(measured.gloss.error))
        print(
            f"gloss {maps.lobe}: beta {beta:.3g} +- {sigma[0]:.0%}, mu {mu:.3g} rad +- {sigma[1]:.0%}, "
            f"where alpha is {np.nanmedian(maps.alpha):.3g}"
        )
    how = "registered" if lamps.moved_deg.any() else "as stated"
    print(f"left-out photographs, lamps {how}: {_percent(found.error)}")
    print(f"left-out photographs, lamps where {asked.lights} says, level from each: {_percent(found.by_file)}")


if __name__ == "__main__":
    sys.exit(main())
