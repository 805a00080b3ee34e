"""Registration of an object to its photographs: estimates where object, camera and light really stand [design, §9].

The user's definitions of object, camera and rig are the prior. The outline and the texture of the object in all
photographs correct it, and so do the corners of a printed sheet on which it may stand. Gauss-Newton steps from coarse
to fine resolution find the most probable values, and the last step gives their covariance. A value that the photographs
do not determine, or whose correction is not significant, stays exactly as defined, because a correction smaller than
its own error would do harm. Such a value keeps the standard deviation of the prior if no photograph depends on it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.capture_table import Pose, placement_of
from irodori.config.cross_checks.plausible_units import check_mesh_in_frame
from irodori.config.models import MeshShape
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rig_from_camera, to_camera
from irodori.geometry.shapes.shape import Shape
from irodori.rectification.contradicted_definitions import FREE_CAMERA_DEG, Otherwise, refuse_contradictions
from irodori.rectification.inner_brightness import inner_surface, paint_contrast, painted
from irodori.rectification.marker_sheet import (
    SHEET_QUANTITIES,
    MarkerSheet,
    check_first_size,
    check_printed_size,
    find_corners,
    not_found,
)
from irodori.rectification.outline_search import find_rim
from irodori.rectification.placement_correction import (
    CAMERA,
    COUNT,
    LIGHT,
    Correction,
    prior_sigma,
)
from irodori.rectification.pose_residuals import least_residuals, pose_residuals
from irodori.rectification.reduced_pictures import Level, Picture
from irodori.rectification.registration_covariance import Rows, angle_errors, reduced_chi_square
from irodori.rectification.registration_equations import (
    FINEST_REACH,
    add_texture,
    equations,
    fitted_displacement,
    linearised_textures,
    measure_outline,
    outline_rows,
    outline_scale,
    outline_variance,
    sheet_rows,
)
from irodori.rectification.registration_file import Estimate, Told, write_angle_errors, write_estimate, write_told
from irodori.rectification.registration_problem import TEXELS, FoundSheet, Problem, Registered, View, texels_of
from irodori.rectification.stage import RigSetup, observe
from irodori.rectification.texture_agreement import (
    blocks,
    matt_weight,
)
from irodori.rectification.told_values import (
    diagonal_of_inverse,
    inverse,
    only_what_is_told,
    settle_light,
    solve,
)
from irodori.rectification.turned_texture import TURN, Side, turned, with_turn

if TYPE_CHECKING:
    from irodori.config.models import Markers, Object, Placing
    from irodori.config.parts import TexturedObject

_COARSEST_REACH = 40.0
_FEW = 300  # texels, about, by which the reach of the first search is found
_MARGIN = 80.0  # superpixels around the object in the part of a photograph that is read
_PRIOR_SIGMAS = 2.5  # standard deviations of the prior, projected into the pictures, that the first search covers
_PART_OF_OBJECT = 0.35  # upper limit of the first search, as a share of the object's smaller half side
_STEPS = 4  # Gauss-Newton steps, at most, of each level of resolution
_LAST_STEPS = 8
#: Blur of the pictures whose textures are compared: at least so many samples, and this part of a texel.
_FINEST_BLUR, _PART_OF_TEXEL = 1.0, 0.6
_STILL = 0.02  # standard deviations of the posterior within which a step ends the search
_LEAST_COSINE = 0.15  # cosine of incidence below which an outline is too dark


class FirstPlacement(NamedTuple):
    """First placement of an object: files of its photographs, and the correction that its registration found."""

    linear: Sequence
    correction: Correction

    @classmethod
    def load(cls, linear: Sequence, registration) -> "FirstPlacement":
        """Return the placement whose registration is in a file."""
        return cls(linear, Correction.load(registration))


def register(
    linear: Sequence,
    definition: "Object | TexturedObject",
    setup: RigSetup,
    placing: "Placing",
    markers: "Markers | None" = None,
    light: Callable[[RigSetup], tuple[float, float] | None] | None = None,
) -> Registered:
    """Estimate the place of an object, its camera and its light from photographs.

    Parameters
    ----------
    linear : sequence of path
        Files of linear responses, one for each capture.
    definition : Object or TexturedObject
    setup : RigSetup
        Camera and rig as defined, without correction.
    placing : Placing
        Standard deviations of the definitions.
    markers : Markers, optional
        The printed sheet on which the object stands.
    light : function, optional
        Returns the error of all light angles and its standard error, deg, for a corrected setup, or None where the
        photographs do not determine it; `irodori.fitting.light_angle.LightSearch` is one.

    Raises
    ------
    InputError
        If no photograph shows the sheet, or its size contradicts the typed one.
    """
    return _registered(linear, definition, setup, placing, markers, light)[0]


def _registered(
    linear: Sequence,
    definition: "Object | TexturedObject",
    setup: RigSetup,
    placing: "Placing",
    markers: "Markers | None",
    light: Callable[[RigSetup], tuple[float, float] | None] | None = None,
    *,
    camera_deg: float | None = None,
) -> tuple[Registered, Problem]:
    """Return the result of `register`, and the problem at its end.

    ``camera_deg`` is the standard deviation of the error that all camera angles share; by default that of `placing`.
    """
    problem = _problem(linear, definition, setup, placing, markers)
    if camera_deg is not None:
        problem.sigma[CAMERA] = camera_deg
    sigma = problem.sigma
    reach = first = _first_reach(problem)
    while reach > FINEST_REACH:
        _descend(problem, reach, _STEPS, trace=reach == first)
        reach /= 2.0
    _weigh(problem, _descend(problem, FINEST_REACH, _LAST_STEPS))
    matrix = _settle(problem, FINEST_REACH, _LAST_STEPS)
    probable, whole = problem.unknowns.copy(), inverse(matrix, sigma)
    problem.unknowns, problem.sigma = only_what_is_told(problem.unknowns, matrix, sigma)
    _settle(problem, FINEST_REACH, _LAST_STEPS)
    own, problem.unknowns[problem.own] = problem.unknowns[problem.own].copy(), 0.0
    reach = max(0.5 * first, 2.0 * FINEST_REACH)
    residual, points, suspects = pose_residuals(problem, reach)
    least = residual
    if np.any(residual > placing.max_residual_px):
        least = least_residuals(problem, residual, probable, sigma, reach)
    shown = light(setup.corrected(setup.correction.by(problem.unknowns[:COUNT]))) if light else None
    if shown is not None:
        # Nothing else depends on the light's angles: before, they were as typed, and known as well as that.
        whole[LIGHT], whole[:, LIGHT] = 0.0, 0.0
        problem.unknowns[LIGHT], probable[LIGHT], whole[LIGHT, LIGHT] = settle_light(*shown, float(sigma[LIGHT]))
    sheet = None
    if problem.sheet is not None:
        values, errors = problem.unknowns[problem.of_sheet], np.sqrt(np.diag(whole))[problem.of_sheet]
        check_printed_size(linear, problem.sheet, values, problem.shape.reach_mm)
        corners, left = zip(*((len(view.corners), view.sheet_residual_px) for view in problem.views), strict=True)
        sheet = FoundSheet(values, errors, np.array(corners), np.array(left))
    angles = slice(0, problem.own.stop)
    estimate = Estimate(probable[angles], whole[angles, angles], sigma[:COUNT], problem.unknowns[:COUNT])
    found = Registered(
        estimate,
        own,
        residual,
        least,
        problem.mm_per_px,
        points,
        suspects,
        angle_errors(problem, estimate.moment, placing.light_deg),
        sheet,
        shown,
    )
    return found, problem


def _problem(
    linear: Sequence, definition: "Object | TexturedObject", setup: RigSetup, placing: "Placing", markers=None
) -> Problem:
    """Read the parts of the photographs that may show the object and return the problem; arguments as in `register`."""
    shape = Shape.from_definition(definition.shape)
    texels = texels_of(shape, definition.texels.width, definition.texels.height)
    sigma = np.concatenate([prior_sigma(placing), np.full(len(linear), placing.camera_deg)])
    problem = Problem(shape, setup, texels, [], sigma, np.zeros(len(sigma)))
    for path in linear:
        with store.open_file(path) as file:
            problem.views.append(View(Pose.of_file(file)))
    if markers is not None:
        problem.sheet = MarkerSheet.of(markers, shape, placing)
        for view, path in zip(problem.views, track(linear, "find markers"), strict=True):
            view.corners, view.corners_px = find_corners(path)
        _lay_sheet(problem, linear, placing)
    for number, path in enumerate(track(linear, "read photographs")):
        problem.views[number].picture = Picture.load(path, _window(problem, number, _MARGIN))
    return problem


def _lay_sheet(problem: Problem, linear: Sequence, placing: "Placing") -> None:
    """Add the place of the sheet to the unknowns, and fit it and the camera to the sheet's corners alone.

    Raises an `InputError` if no photograph shows the sheet, or its squares are far from the typed size.
    """
    sheet, views = problem.sheet, problem.views
    assert sheet is not None
    if not any(len(view.corners) for view in views):
        raise not_found(linear)
    found = [view.corners for view in views], [view.corners_px for view in views]
    place, size = sheet.first_place(*found, [view.pose for view in views], problem.setup)
    check_first_size(linear, sheet, size, problem.setup, placing)
    problem.sigma = np.concatenate([problem.sigma, sheet.sigma])
    problem.unknowns = np.concatenate([problem.unknowns, place])
    matrix = _settle(problem, None, _LAST_STEPS)
    problem.told = inverse(matrix, problem.sigma)[:COUNT, :COUNT]


def _descend(problem: Problem, reach: float, most_steps: int, *, trace: bool = True) -> np.ndarray:
    """Take Gauss-Newton steps at one level of resolution and return the last normal matrix.

    Parameters
    ----------
    problem : Problem
        Its unknowns with a positive standard deviation of the prior are changed.
    reach : float
        Distance to either side of the expected outline that is searched, samples.
    most_steps : int
    trace : bool
        Whether outlines are traced anew. The points of an outline on a round object hardly change between the first
        level and the last.
    """
    spacing = _spacing(problem)
    blur = max(_FINEST_BLUR, reach / 3.0, _PART_OF_TEXEL * spacing)
    texels = problem.texels
    problem.block = blocks(texels.columns, texels.rows, spacing, blur)[texels.number]
    for view in range(len(problem.views)):
        if trace or problem.tells_texture:
            _prepare(problem, view, reach, blur)
        else:
            problem.views[view].search = _searched(problem.views[view].picture, reach)
    if reach > FINEST_REACH or problem.tells_texture:
        return _settle(problem, reach, most_steps)
    for _ in range(2):
        contrast = paint_contrast(problem)
        for view in range(len(problem.views)):
            problem.views[view].inner = painted(problem, view, contrast)
        matrix = _settle(problem, reach, most_steps)
    return matrix


def _settle(problem: Problem, reach: float | None, most_steps: int) -> np.ndarray:
    """Take Gauss-Newton steps until the unknowns rest; return the last normal matrix. Parameters as in `equations`."""
    for _ in range(most_steps):
        matrix, right = equations(problem, reach)
        step = solve(matrix, right, problem.sigma)
        problem.unknowns += step
        if np.all(np.abs(step) <= _STILL * np.sqrt(diagonal_of_inverse(matrix, problem.sigma))):
            break
    return matrix


def _weigh(problem: Problem, matrix: np.ndarray) -> None:
    """Weigh outlines, corners and textures by how far photographs contradict each other at the most probable values.

    Errors within a photograph are alike, so that the scatter of its points does not show them; they show in what
    photographs say of each other. The variances of each photograph's outline and corners are multiplied by their
    reduced χ², and those of textures, which are compared with each other, by that of all of them. ``matrix`` is the
    normal matrix at these values.
    """
    size, covariance = len(problem.unknowns), inverse(matrix, problem.sigma)
    views = problem.views
    measured = [measure_outline(problem, number, FINEST_REACH) for number in range(len(views))]
    scale = outline_scale(measured, is_last=True)
    outlines = outline_rows(problem, measured, scale, is_last=True)

    def fitted(kind: list[Rows]) -> float:
        information = np.zeros((size, size))
        for rows in kind:
            rows.add_to(information, np.zeros(size))
        return float(np.sum(covariance * information))

    displaced = _displaced_outlines(problem, measured, outlines, scale)
    each, _ = reduced_chi_square(displaced, problem.sigma, fitted(outlines))
    for view, scatter in zip(views, each, strict=True):
        view.outline_scatter = float(scatter)
    if problem.sheet is not None:
        corners = sheet_rows(problem)
        each, _ = reduced_chi_square(corners, problem.sigma, fitted(corners))
        for view, scatter in zip([view for view in views if len(view.corners)], each, strict=True):
            view.corner_scatter = float(scatter)
    if problem.tells_texture:
        information = np.zeros((size, size))
        textures = add_texture(linearised_textures(problem), information, np.zeros(size))
        share = float(np.sum(covariance * information))
        _, problem.texture_scatter = reduced_chi_square(textures, problem.sigma, share)


def _displaced_outlines(problem: Problem, measured: list, outlines: list[Rows], scale: float) -> list[Rows]:
    """Return the displacement of every photograph's outline as a whole, all its points with the same weight.

    What single points say, at edges of something else, is no error of the outline: at the end they have lost their
    influence. An outline whose points do not agree tells nothing. Arguments as in `outline_rows`, with its result.
    """
    found = []
    for number, (rows, one) in enumerate(zip(outlines, measured, strict=True)):
        view, displaced, distance, which = problem.views[number], None, one.distance, one.found
        if len(distance):
            xy = problem.seen(number, view.rim[which], problem.unknowns)
            displaced = fitted_displacement(xy, view.outward[which], distance)
        weight = np.zeros(len(distance)) if displaced is None else 1.0 / outline_variance(problem, number, one, scale)
        found.append(rows._replace(weight=weight, off=distance if displaced is None else displaced))
    return found


def _window(problem: Problem, view: int, margin: float) -> tuple[float, float, float, float]:
    """Return the bounding box of the object in a photograph plus a margin: x0, y0, x1, y1, superpixels.

    The box extends half a texel beyond the centres of the outermost texels.
    """
    xy = problem.seen(view, problem.texels.position, problem.unknowns)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        return 0.0, 0.0, 0.0, 0.0
    first, last = xy.min(axis=0), xy.max(axis=0)
    half = (last - first) / (2 * (min(problem.texels.columns, problem.texels.rows) - 1))
    (x0, y0), (x1, y1) = first - half - margin, last + half + margin
    return x0, y0, x1, y1


def _first_reach(problem: Problem) -> float:
    """Return the distance that the first search for outlines covers, samples.

    It follows from what definitions and sheet tell, and from the object's size.
    """
    covariance = np.diag(problem.sigma[:COUNT] ** 2) if problem.told is None else problem.told
    found, half = [], []
    for view in range(len(problem.views)):
        some = problem.texels.position[:: 1 + len(problem.texels.position) // _FEW]
        moved = problem.derivative(lambda v, values, some=some: problem.seen(v, some, values), view)
        spread = np.sqrt(np.einsum("nip,pq,niq->n", moved, covariance, moved) / 2.0)
        scale = problem.views[view].picture.scale
        found.append(np.nanmedian(spread) * scale)
        x0, y0, x1, y1 = _window(problem, view, 0.0)
        half.append(0.5 * min(x1 - x0, y1 - y0) * scale)
    part = _PART_OF_OBJECT * float(np.median(half))
    return max(FINEST_REACH, min(_PRIOR_SIGMAS * float(np.median(found)), _COARSEST_REACH, part))


def _searched(picture: Picture, reach: float) -> Level:
    """Return the blurred picture in which outlines are searched."""
    return picture.level(0.0 if reach <= FINEST_REACH else reach / 8.0)


def _prepare(problem: Problem, number: int, reach: float, blur: float) -> None:
    """Compute a photograph's lit outline points and the weights of its texels for the present unknowns.

    The derivatives of their places by the common unknowns, which hardly change during the steps of a level, too.
    """
    from scipy.spatial import cKDTree

    view, texels = problem.views[number], problem.texels
    correction, pose = problem.standing(number, problem.unknowns)
    camera = problem.setup.corrected(correction)
    placements = correction.placements(problem.shape, pose, problem.setup.table_radius_mm)
    tracer, placed = Tracer(placements), placements[0]
    view.search = _searched(view.picture, reach)
    eye = camera.camera_distance_mm * to_camera(pose)
    axes = rig_from_camera(pose, camera.pinhole.quarter_turns)
    rim = find_rim(tracer, camera.pinhole, eye, axes, _window(problem, number, 0.0))
    skin, normal, facet = problem.skin[0], *(one @ placed.rotation.T for one in problem.skin[1:])
    nearest = skin.query(rim.point)[1]
    lit = observe(placed.points(rim.point), normal[nearest], tracer, pose, camera, facet[nearest])
    bright = lit.lit & (np.cos(lit.geometry[:, 0]) > _LEAST_COSINE)
    view.rim, view.outward = rim.point[bright], rim.outward[bright]
    moved = problem.derivative(lambda v, values: problem.seen(v, view.rim, values), number)
    view.change = np.einsum("ni,nip->np", view.outward, moved)
    if problem.shape.ball_mm is not None:
        # A ball's outline tells nothing of its turn; points beside something that hides the ball would seem to.
        view.change[:, TURN] = 0.0
    if not problem.tells_texture:
        view.surface = inner_surface(problem, number, tracer, lit.xy[bright])
        view.inner = view.surface.evenly_painted
        return
    view.level = view.picture.level(blur)
    normal, facet = texels.normal @ placed.rotation.T, texels.facet @ placed.rotation.T
    sight = observe(placed.points(texels.position), normal, tracer, pose, camera, facet)
    bright = np.cos(sight.geometry[:, 0]) > _LEAST_COSINE
    weight = matt_weight(sight.geometry[:, 3]) * (sight.visible & sight.lit & bright)
    if len(lit.xy):
        # Blur mixes the background into texels near the outline: they get no weight.
        apart = cKDTree(lit.xy).query(np.nan_to_num(sight.xy))[0] * view.picture.scale
        weight = np.where(apart > 2.0 * blur + 1.5, weight, 0.0)
    view.weight = weight
    view.moved = problem.derivative(lambda v, values: problem.seen(v, texels.position, values), number)


def _spacing(problem: Problem) -> float:
    """Return the median distance of neighbouring texels in the pictures, samples."""
    found = []
    for number, view in enumerate(problem.views):
        place = problem.on_grid(problem.seen(number, problem.texels.position, problem.unknowns)) * view.picture.scale
        down, across = (np.asarray(one) for one in np.gradient(place, axis=(0, 1)))
        found.append(np.nanmedian(np.abs(down[..., 0] * across[..., 1] - down[..., 1] * across[..., 0])))
    return math.sqrt(float(np.median(found)))


def register_object(
    linear: Sequence,
    definition: "Object | TexturedObject",
    setup: RigSetup,
    placing: "Placing",
    markers: "Markers | None" = None,
    *,
    light: Callable[[RigSetup], tuple[float, float] | None] | None = None,
    first: FirstPlacement | None = None,
    output,
    provenance: store.Provenance,
) -> None:
    """Estimate the place of an object, its camera and its light from photographs and write it to a file.

    Parameters
    ----------
    linear : sequence of path
        Files of linear responses, each named after its capture; all show the object in one placement.
    definition : Object or TexturedObject
    setup : RigSetup
        Camera and rig as defined, without correction.
    placing : Placing
        Standard deviations of the definitions, and the largest residual that is accepted.
    markers : Markers, optional
        The printed sheet on which the object stands.
    light : function, optional
        As in `register`.
    first : FirstPlacement, optional
        The object's first placement, if this is a further one.

    Raises
    ------
    InputError
        If a mesh is a speck in the pictures, or contains the camera, as in another unit; if no photograph shows the
        sheet, or its size contradicts the typed one; if photographs contradict what was
        typed, see `irodori.rectification.contradicted_definitions` and `irodori.rectification.turned_texture`. If the
        object has several placements, the message names this one.

    Notes
    -----
    Datasets: ``/correction`` (12) in the order of ``/quantity`` and the units of ``/quantity_unit``, to be added to the
    values of the definitions, 0 for values that stay as defined; ``/sigma`` (12), standard errors of the most probable
    values, square roots of the diagonal of ``/covariance`` (12, 12); ``/prior_sigma`` (12), standard deviations of the
    definitions; ``/own_camera_deg`` (J), additional correction of each camera angle; ``/residual_px`` and
    ``/residual_mm`` (J), distance of the object in a photograph from its predicted place, NaN where nothing could be
    measured; ``/outline_points`` (J). ``/angle_error`` (4,), standard deviations of θ_i, θ_r, θ_H and φ of the
    observations, degrees, as root mean squares over all of them; ``/angle_error_of_capture`` (J, 4) and
    ``/angle_error_spread`` (4, 2), the same of each photograph, and the 5th and 95th percentiles; these three are
    missing if no texel amid others is seen and lit. What is combined with other objects that were photographed
    together: ``/probable`` (12 + J) and ``/probable_covariance`` of the numbers above and of each photograph's own
    camera angle, ``/light_shown`` and ``/light_shown_sigma`` if highlights show the light, ``/angle_change`` (J, 4, 13,
    13) with ``/observations`` (J), see `irodori.rectification.registration_file.AngleChanges`. With a sheet also
    ``/sheet_place`` and ``/sheet_place_sigma`` (9), its place and size in the order of ``/sheet_quantity`` and their
    standard errors, ``/sheet_corners`` (J), its corners found, and ``/sheet_residual_px`` (J). Attributes: ``told``,
    for each quantity whether the photographs determine it; ``captures``, names of the photographs; ``sentence``, a
    summary in words; ``remarks``, its parts that are not about these quantities.
    """
    if first is not None:
        placing = replace(placing, rotation_deg=placing.turned_deg)
    number, shape = placement_of(Path(linear[0]).stem), Shape.from_definition(definition.shape)
    if isinstance(definition.shape, MeshShape):
        check_mesh_in_frame(definition.shape, shape.reach_mm, setup.pinhole.focal_px, setup.camera_distance_mm)
    typed, setup = setup, setup.laid(shape, definition.placements, number)

    def with_free_camera() -> tuple[Registered, Problem]:
        return _registered(linear, definition, setup, placing, markers, camera_deg=FREE_CAMERA_DEG)

    def with_roll(roll_deg: int) -> tuple[Registered, Problem]:
        rolled = replace(setup, pinhole=replace(setup.pinhole, quarter_turns=roll_deg // 90))
        return _registered(linear, definition, rolled, placing, markers)

    found, problem = _registered(linear, definition, setup, placing, markers, light)
    if first is not None:
        before = _problem(first.linear, definition, typed, placing)
        found = _turned_from(first, before, found, problem, linear, placing)
    try:
        refuse_contradictions(found, problem, linear, placing, Otherwise(with_free_camera, with_roll))
    except InputError as error:
        raise _in_placement(error, number) if definition.placements else error from None
    names = [Path(path).stem for path in linear]
    sentence = in_words(found)
    LOGGER.info("%s", sentence)
    LOGGER.info("%s", found.angle_errors)
    with store.create(output, provenance) as out:
        write_estimate(out, found.estimate, names)
        out.write(
            "own_camera_deg",
            found.own_camera_deg,
            units="deg",
            dims="capture",
            quantity="own part of the camera angle's correction",
        )
        off = "distance between where a capture shows the object and where it is expected"
        out.write("residual_px", found.residual_px, units="{superpixel}", dims="capture", quantity=off)
        out.write("residual_mm", found.residual_px * found.mm_per_px, units="mm", dims="capture", quantity=off)
        out.write(
            "outline_points", found.outline_points, units="1", dims="capture", quantity="points of the outline found"
        )
        write_told(out, Told(found.estimate, found.light_deg, found.angle_errors.changes, names, _remarks(found)))
        write_angle_errors(out, found.angle_errors.rms, found.angle_errors.by_photograph)
        if found.angle_errors.stated is not None:
            out.coordinate("percentile", [5.0, 95.0], units="%", quantity="share of observations with a smaller error")
            spread = "percentiles of it over all observations"
            out.write(
                "angle_error_spread", found.angle_errors.spread, units="deg", dims="angle,percentile", quantity=spread
            )
        if found.sheet is not None:
            _write_sheet(out, found.sheet)
        out.attribute("sentence", sentence)


def _in_placement(error: InputError, number: int) -> InputError:
    """Return an error that names the placement of the object, which may have been mistaken for another."""
    field = error.field.replace("place.rotation_deg", "place.turned_deg") if number > 1 else error.field
    accepted = f"{error.accepted}; or another placement, if that is what the photograph shows"
    return InputError(error.file, field, f"in placement {number}, {error.found}", accepted)


def _turned_from(
    first: FirstPlacement,
    before: Problem,
    found: Registered,
    problem: Problem,
    linear: Sequence,
    placing: "Placing",
) -> Registered:
    """Return the registration of a further placement with what textures tell of its rotation.

    ``before`` is the problem of the first placement, without correction.
    """
    # However coarse the object's texels are, the blur that goes with them must not mix in what lies behind it.
    rows = round(math.sqrt(TEXELS / 2.0))
    texels = texels_of(problem.shape, 2 * rows, rows)
    number = problem.views[0].pose.placement
    turn = turned(
        Side(replace(before, texels=texels), first.linear, np.array(first.correction.values), 1),
        Side(replace(problem, texels=texels), linear, found.estimate.values, number),
        placing.turned_deg,
    )
    estimate = with_turn(found.estimate, turn)
    if turn is None:
        said = f"placement {number}: no texture that both placements show tells its rotation from the first"
    else:
        angles = ", ".join(f"{angle:+.2f}" for angle in turn.rotation_deg)
        error = math.sqrt(np.trace(turn.covariance) / 3.0)
        said = f"placement {number}: by texture, turned by ({angles}) ± {error:.2f} deg beyond its typed rotation"
    problem.unknowns[:COUNT] = estimate.values
    errors = angle_errors(problem, estimate.moment, placing.light_deg)
    return replace(found, estimate=estimate, angle_errors=errors, turn_remark=said)


def _write_sheet(out: store.Writer, sheet: FoundSheet) -> None:
    """Write what was found of the printed sheet."""
    names, units = [one.name for one in SHEET_QUANTITIES], np.array([one.unit for one in SHEET_QUANTITIES], "S")
    out.coordinate("sheet_quantity", names, units="1", quantity="names of the numbers of the sheet's place")
    out.write("sheet_quantity_unit", units, units="1", dims="sheet_quantity", quantity="its unit")
    for name, values, quantity in (
        ("sheet_place", sheet.values, "place and size of the printed sheet"),
        ("sheet_place_sigma", sheet.sigma, "standard errors of place and size"),
    ):
        out.write(name, values, units="{sheet_quantity_unit}", dims="sheet_quantity", quantity=quantity)
    out.write("sheet_corners", sheet.corners, units="1", dims="capture", quantity="corners of the sheet found")
    off = "distance between where a capture shows the sheet and where it is expected"
    out.write("sheet_residual_px", sheet.residual_px, units="{superpixel}", dims="capture", quantity=off)


def in_words(found: Registered) -> str:
    """Return one sentence that lists which quantities the photographs correct, confirm and leave undetermined."""
    return "; ".join([*found.estimate.in_words(), *_remarks(found)])


def _remarks(found: Registered) -> list[str]:
    """Return what is to be said of the photographs beside the quantities that they tell."""
    parts = [found.turn_remark] if found.turn_remark else []
    if found.light_deg is not None:
        off = "{:+.2f} ± {:.2f} deg".format(*found.light_deg)
        parts.append(f"highlights and shading show the light {off} from its typed angles")
    if found.sheet is not None:
        corners = found.sheet.corners
        shown = f"{np.count_nonzero(corners)} of {len(corners)} photographs, {corners.sum()} corners"
        parts.append(f"the printed sheet was found in {shown}")
    unjudged = np.count_nonzero(np.isnan(found.residual_px))
    if unjudged:
        some = f"{unjudged} of {len(found.residual_px)} photographs"
        parts.append(f"{some} show too little to tell whether their poses are right")
    return parts
