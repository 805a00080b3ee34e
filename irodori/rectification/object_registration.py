"""Registration of an object to its photographs: estimates where object, camera and light really stand [design, §9].

The user's definitions of object, camera and rig are the prior. The outline and the texture of the object in all
photographs correct it, and so do the corners of a printed sheet on which it may stand. Gauss-Newton steps from coarse
to fine resolution find the most probable values, and the last step gives their covariance. A value that the photographs
do not determine, or whose correction is not significant, stays exactly as defined, because a correction smaller than
its own error would do harm. Such a value keeps the standard deviation of the prior if no photograph depends on it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.capture_table import Pose, placement_of
from irodori.config.cross_checks.plausible_units import check_mesh_in_frame
from irodori.config.models import MeshShape
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track
from irodori.geometry.atlas import are_alike
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera
from irodori.geometry.shapes.shape import Shape
from irodori.rectification.coarse_look import contrast
from irodori.rectification.contradicted_definitions import FREE_CAMERA_DEG, refuse_contradictions
from irodori.rectification.inner_brightness import InnerSurface, inner_surface, paint_contrast, painted
from irodori.rectification.marker_sheet import (
    OUTLINE,
    SHEET_QUANTITIES,
    SHEET_STEPS,
    MarkerSheet,
    check_first_size,
    check_printed_size,
    find_corners,
    not_found,
)
from irodori.rectification.outline_search import OUTER, InnerSide, find_edges, find_rim
from irodori.rectification.placement_correction import (
    CAMERA,
    COUNT,
    LIGHT,
    Correction,
    prior_sigma,
)
from irodori.rectification.reduced_pictures import Level, Picture
from irodori.rectification.registration_covariance import RegisteredAngleErrors, Rows, angle_errors, reduced_chi_square
from irodori.rectification.registration_file import Estimate, Told, write_angle_errors, write_estimate, write_told
from irodori.rectification.stage import RigSetup, observe
from irodori.rectification.texture_agreement import (
    TextureRows,
    blocks,
    matt_weight,
    mean_texture,
    picture_slope,
    texel_values,
    texture_rows,
    without_levels,
)
from irodori.rectification.told_values import (
    CONTRADICTED,
    diagonal_of_inverse,
    inverse,
    only_what_is_told,
    settle_light,
    solve,
)
from irodori.rectification.turned_texture import TURN, Side, turned, with_turn

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

    from irodori.config.models import Markers, Object, Placing
    from irodori.config.parts import TexturedObject

_TEXELS = 3600  # texels of the object, at most, whose texture is compared
_FINEST_REACH = 4.0  # samples to either side of an outline, at the end of the search
_COARSEST_REACH = 40.0
_FEW = 300  # texels, about, by which the reach of the first search is found
_MARGIN = 80.0  # superpixels around the object in the part of a photograph that is read
_PRIOR_SIGMAS = 2.5  # standard deviations of the prior, projected into the pictures, that the first search covers
_PART_OF_OBJECT = 0.35  # upper limit of the first search, as a share of the object's smaller half side
_ROUNDS = 6  # iterations of the robust fit of an outline's displacement
_STEPS = 4  # Gauss-Newton steps, at most, of each level of resolution
_LAST_STEPS = 8
#: Blur of the pictures whose textures are compared: at least so many samples, and this part of a texel.
_FINEST_BLUR, _PART_OF_TEXEL = 1.0, 0.6
_STILL = 0.02  # standard deviations of the posterior within which a step ends the search
_LEAST_COSINE = 0.15  # cosine of incidence below which an outline is too dark
_LEAST_POINTS = 12
_BENT = 9  # points of the surface by which its curvature is found
_EDGE = 0.5  # change of a unit normal between neighbours that is an edge
# Mean square of the gradient of log reflectance per superpixel, in the direction in which it is least.
_LEAST_TEXTURE = 1e-5
#: Least mean square of the normals of an outline, along any direction, with which it tells where its object is shown.
_BOTH_WAYS = 0.1
#: Distance from a displacement of the whole outline within which a point agrees with it: superpixels, or share of that
#: displacement; and share of the points that have to agree.
_AGREE_PX, _AGREE, _MOST_AGREE = 0.3, 0.25, 0.6
#: Displacement, superpixels, from which an outline has to be clearer where it is found than where it is expected; the
#: ratio that is clearer; and distance from the outline of the readings that tell, samples.
_DOUBTFUL_PX, _CLEARER, _BESIDE = 0.5, 1.05, 1.5
_MOST_DOUBT_PX = 0.4  # of a point of an outline by which a photograph is judged
_LEAST_MATT = 0.3  # mean weight of the texels of a photograph that is judged by its texture
#: Least standard deviation of a single measurement: the systematic errors of edges and of textures in pictures.
_OUTLINE_FLOOR_PX, _TEXTURE_FLOOR, _CORNER_FLOOR_PX = 0.1, 0.01, 0.05
_OUTLINE_MOST_PX = 0.4  # largest standard deviation of outline points in the last level; points beyond are outliers
#: Neighbouring measurements have common errors: number that counts as one (for textures, a block of texels and bands).
_OUTLINE_SHARED, _TEXTURE_SHARED = 5.0, 75.0
_SIDES = 4.0  # parts of an outline in which the errors by paints and gloss are alike
_OUTLINED = 0.5  # share of photographs with an outline from which on coarse levels use outlines alone
_CAMERA = range(6, CAMERA + 1)  # quantities on which the place of the sheet in a photograph depends
_NUMERIC = np.array([0.01] * 3 + [0.01] * 3 + [0.1, 0.01, 0.1, 0.1, 0.01, 0.01])  # steps of derivatives, as QUANTITIES
#: What may be wrong with the pose of one photograph -> the angle that is varied. The place of the object in the picture
#: depends only on the sum of the camera's angle and the tilt.
_POSE_ANGLES = {"camera_deg or tilt_deg": "camera_deg", "turn_deg": "turn_deg"}


@dataclass(frozen=True)
class FoundSheet:
    """The printed sheet in the photographs.

    Parameters
    ----------
    values, sigma : (9,) float64
        Its place and size and the common displacement of outlines, in the order of `SHEET_QUANTITIES`, and their
        standard errors.
    corners : (J,) int
        Corners found in each photograph.
    residual_px : (J,) float64
        Root-mean-square distance of the corners in each photograph from where its pose and the common correction
        predict them, superpixels; NaN where the sheet was not found.
    """

    values: np.ndarray
    sigma: np.ndarray
    corners: np.ndarray
    residual_px: np.ndarray


@dataclass(frozen=True)
class Registered:
    """Result of a registration: the place of object, camera and light, with errors and residuals.

    Parameters
    ----------
    estimate : Estimate
        Corrections in use, the most probable values, and their covariance if all are estimated together, as large as
        the contradictions between photographs say.
    own_camera_deg : (J,) float64
        Additional correction of the camera angle of each photograph.
    residual_px : (J,) float64
        Root-mean-square distance, superpixels, of the object in each photograph from the place that its pose and the
        common correction predict, or that of the sheet if it is larger; NaN if nothing could be measured in the
        photograph.
    least_residual_px : (J,) float64
        The same, or that from the most probable place where all numbers are corrected, if it is smaller.
    mm_per_px : float
        Millimetres per superpixel at the distance of the object.
    outline_points : (J,) int
        Number of points of the outline at which an edge was found.
    suspects : tuple of J (str, float)
        Angle of each photograph's pose whose error would explain the residual best, and that error in degrees.
    angle_errors : RegisteredAngleErrors
        Errors of the angles of the observations that follow from all errors of the registration.
    sheet : FoundSheet, optional
        The printed sheet, if there is one.
    light_deg : (float, float), optional
        Error of all light angles by shading and highlights, and its standard error, whether it is corrected or not.
    turn_remark : str
        What textures tell of the rotation of a further placement; empty for the first.
    """

    estimate: Estimate
    own_camera_deg: np.ndarray
    residual_px: np.ndarray
    least_residual_px: np.ndarray
    mm_per_px: float
    outline_points: np.ndarray
    suspects: tuple[tuple[str, float], ...]
    angle_errors: RegisteredAngleErrors
    sheet: FoundSheet | None = None
    light_deg: tuple[float, float] | None = None
    turn_remark: str = ""

    @property
    def correction(self) -> Correction:
        """Corrections in use."""
        return Correction.of(self.estimate.values)

    @property
    def sigma(self) -> np.ndarray:
        """Standard errors of the most probable values, (12,)."""
        return self.estimate.sigma


class FirstPlacement(NamedTuple):
    """First placement of an object: files of its photographs, and the correction that its registration found."""

    linear: Sequence
    correction: Correction

    @classmethod
    def load(cls, linear: Sequence, registration) -> "FirstPlacement":
        """Return the placement whose registration is in a file."""
        return cls(linear, Correction.load(registration))


class _Texels(NamedTuple):
    """Points on the object whose texture is compared between photographs, in the object's frame."""

    position: np.ndarray  # (n, 3)
    normal: np.ndarray
    facet: np.ndarray
    number: np.ndarray  # (n,) index in the whole grid
    columns: int
    rows: int


@dataclass
class _View:
    """One photograph, with the outline and the texture weights of the current level of resolution."""

    pose: Pose  # as in the capture table
    picture: Picture = field(init=False)
    level: Level = field(init=False)  # for the texture
    search: Level = field(init=False)  # for the outline
    rim: np.ndarray = field(init=False)
    outward: np.ndarray = field(init=False)
    surface: InnerSurface | None = None  # inside the outline; None if the object is flat
    inner: InnerSide | None = None  # its brightness
    change: np.ndarray = field(init=False)  # of the outline along its normals by the common unknowns, (points, 12)
    weight: np.ndarray = field(init=False)  # of the texels
    moved: np.ndarray = field(init=False)  # derivatives of the texels' places by the common unknowns, (texels, 2, 12)
    #: Corners of the printed sheet: on it in squares, and in the picture in superpixels, (n, 2).
    corners: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    corners_px: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    sheet_residual_px: float = math.nan
    #: Variances of what outline and corners tell, relative to the expected ones.
    outline_scatter: float = 1.0
    corner_scatter: float = 1.0


@dataclass
class _Problem:
    """State of an object's registration: data and unknowns.

    The unknowns are 12 common ones, one camera angle of each photograph, and 9 more if there is a sheet.
    """

    shape: Shape
    setup: RigSetup
    texels: _Texels
    views: list[_View]
    sigma: np.ndarray
    unknowns: np.ndarray
    sheet: MarkerSheet | None = None
    told: np.ndarray | None = None  # covariance of the common unknowns by definitions and sheet; None without a sheet
    block: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))  # of the texels
    texture_scatter: float = 1.0  # variance of what textures tell, relative to the expected one

    @cached_property
    def skin(self) -> "tuple[cKDTree, np.ndarray, np.ndarray]":
        """Points of the surface, however coarse its texels are, with normals of shading and facets, (n, 3) each."""
        from scipy.spatial import cKDTree

        side = round(math.sqrt(_TEXELS))
        points = _texels(self.shape, side, side)
        return cKDTree(points.position), points.normal, points.facet

    @property
    def own(self) -> slice:
        """The unknowns that are camera angles of single photographs."""
        return slice(COUNT, COUNT + len(self.views))

    @property
    def mm_per_px(self) -> float:
        """Millimetres per superpixel at the distance of the object."""
        camera = self.setup.corrected(self.setup.correction.by(self.unknowns[:COUNT]))
        return 2.0 * camera.camera_distance_mm / camera.pinhole.focal_px

    @property
    def outline_px(self) -> float:
        """Distance of outlines from their expected places that all have in common, superpixels, outward positive."""
        return self.unknowns[self.of_sheet[OUTLINE]] / self.mm_per_px if self.sheet is not None else 0.0

    @property
    def of_sheet(self) -> range:
        """The unknowns of the sheet."""
        return range(COUNT + len(self.views), len(self.unknowns))

    @property
    def tells_texture(self) -> bool:
        """Whether textures are compared, which is done for flat objects only.

        On the spheres of the default run, which lie as defined, textures biased the camera angles by a tenth of a
        degree.
        """
        return are_alike(self.texels.normal)

    @cached_property
    def bends(self) -> np.ndarray:
        """Derivatives of the normals at the points of `skin` by the place on the surface, (n, 3, 3) per mm."""
        tree, normal, _ = self.skin
        around = tree.query(tree.data, k=_BENT)[1]
        offset, change = tree.data[around] - tree.data[:, None], normal[around] - normal[:, None]
        # Beyond an edge, the surface is another one.
        near = np.where(np.linalg.norm(change, axis=2) < _EDGE, 1.0, 0.0)[..., None]
        return np.swapaxes(np.linalg.pinv(near * offset, rcond=0.1) @ (near * change), 1, 2)

    @cached_property
    def bend_per_mm(self) -> float:
        """Curvature of the surface across its direction of strongest curvature, median over the object, 1/mm."""
        return float(np.median(np.linalg.norm(self.bends, ord=2, axis=(1, 2))))

    def seen(self, view: int, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the projections of points of the object into a photograph, (n, 2) superpixels, for given unknowns."""
        correction, pose = self.standing(view, values)
        rotation, translation_mm = correction.in_rig(pose)
        return self._projected(points @ rotation.T + translation_mm, correction, pose)

    def _projected(self, points: np.ndarray, correction: Correction, pose: Pose) -> np.ndarray:
        """Return the projections of points of the rig, (n, 2) superpixels, by the corrected camera."""
        eye = correction.camera_distance_mm(self.setup.camera_distance_mm) * to_camera(pose)
        return correction.pinhole(self.setup.pinhole).project(points, eye, rig_from_camera(pose))

    def corners_seen(self, view: int, values: np.ndarray) -> np.ndarray:
        """Return where a photograph shows the sheet's corners that were found in it, (n, 2) superpixels."""
        assert self.sheet is not None
        points = self.sheet.on_table(self.views[view].corners, values[self.of_sheet])
        correction, pose = self.standing(view, values)
        return self._projected(points @ rig_from_object(pose).T, correction, pose)

    def shading(self, view: int) -> np.ndarray:
        """Return every texel's cosine of incidence times the irradiance normal to the beam; NaN if lit from behind."""
        correction, pose = self.standing(view, self.unknowns)
        placed = correction.placements(self.shape, pose, 0.0)[0]
        light, power, _ = self.setup.lamp.seen_from(placed.points(self.texels.position), pose)
        cosine = np.sum((self.texels.normal @ placed.rotation.T) * light, axis=1)
        return np.where(cosine > 0.0, cosine * power, np.nan)

    def on_grid(self, values: np.ndarray) -> np.ndarray:
        """Arrange values of the texels, (n, m), on their grid, (rows, columns, m); NaN where there is no texel."""
        grid = np.full((self.texels.rows * self.texels.columns, values.shape[1]), np.nan)
        grid[self.texels.number] = values
        return grid.reshape(self.texels.rows, self.texels.columns, -1)

    def standing(self, view: int, values: np.ndarray) -> tuple[Correction, Pose]:
        """Return the common correction and the corrected pose of a photograph for given unknowns."""
        correction = self.setup.correction.by(values[:COUNT])
        return correction, correction.pose(self.views[view].pose, float(values[COUNT + view]))

    def derivative(self, function, view: int, numbers: Sequence[int] = range(COUNT)) -> np.ndarray:
        """Return numerical derivatives of ``function(view, unknowns)`` on a new last axis, by the common unknowns.

        ``numbers`` may name some of them, and unknowns of the sheet.
        """
        parts = []
        for number in numbers:
            step = _NUMERIC[number] if number < COUNT else SHEET_STEPS[number - self.of_sheet.start]
            ends = []
            for sign in (1.0, -1.0):
                values = self.unknowns.copy()
                values[number] += sign * step
                ends.append(function(view, values))
            parts.append((ends[0] - ends[1]) / (2.0 * step))
        return np.stack(parts, axis=-1)


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
) -> tuple[Registered, _Problem]:
    """Return the result of `register`, and the problem at its end.

    ``camera_deg`` is the standard deviation of the error that all camera angles share; by default that of `placing`.
    """
    problem = _problem(linear, definition, setup, placing, markers)
    if camera_deg is not None:
        problem.sigma[CAMERA] = camera_deg
    sigma = problem.sigma
    reach = first = _first_reach(problem)
    while reach > _FINEST_REACH:
        _descend(problem, reach, _STEPS, trace=reach == first)
        reach /= 2.0
    _weigh(problem, _descend(problem, _FINEST_REACH, _LAST_STEPS))
    matrix = _settle(problem, _FINEST_REACH, _LAST_STEPS)
    probable, whole = problem.unknowns.copy(), inverse(matrix, sigma)
    problem.unknowns, problem.sigma = only_what_is_told(problem.unknowns, matrix, sigma)
    _settle(problem, _FINEST_REACH, _LAST_STEPS)
    own, problem.unknowns[problem.own] = problem.unknowns[problem.own].copy(), 0.0
    reach = max(0.5 * first, 2.0 * _FINEST_REACH)
    residual, points, suspects = _residuals(problem, reach)
    least = residual
    if np.any(residual > placing.max_residual_px):
        least = _least_residuals(problem, residual, probable, sigma, reach)
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
) -> _Problem:
    """Read the parts of the photographs that may show the object and return the problem; arguments as in `register`."""
    shape = Shape.from_definition(definition.shape)
    texels = _texels(shape, definition.texels.width, definition.texels.height)
    sigma = np.concatenate([prior_sigma(placing), np.full(len(linear), placing.camera_deg)])
    problem = _Problem(shape, setup, texels, [], sigma, np.zeros(len(sigma)))
    for path in linear:
        with store.open_file(path) as file:
            problem.views.append(_View(Pose.of_file(file)))
    if markers is not None:
        problem.sheet = MarkerSheet.of(markers, shape, placing)
        for view, path in zip(problem.views, track(linear, "find markers"), strict=True):
            view.corners, view.corners_px = find_corners(path)
        _lay_sheet(problem, linear, placing)
    for number, path in enumerate(track(linear, "read photographs")):
        problem.views[number].picture = Picture.load(path, _window(problem, number, _MARGIN))
    return problem


def _lay_sheet(problem: _Problem, linear: Sequence, placing: "Placing") -> None:
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


def _descend(problem: _Problem, reach: float, most_steps: int, *, trace: bool = True) -> np.ndarray:
    """Take Gauss-Newton steps at one level of resolution and return the last normal matrix.

    Parameters
    ----------
    problem : _Problem
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
    if reach > _FINEST_REACH or problem.tells_texture:
        return _settle(problem, reach, most_steps)
    for _ in range(2):
        contrast = paint_contrast(problem)
        for view in range(len(problem.views)):
            problem.views[view].inner = painted(problem, view, contrast)
        matrix = _settle(problem, reach, most_steps)
    return matrix


def _settle(problem: _Problem, reach: float | None, most_steps: int) -> np.ndarray:
    """Take Gauss-Newton steps until the unknowns rest; return the last normal matrix. Parameters as in `_equations`."""
    for _ in range(most_steps):
        matrix, right = _equations(problem, reach)
        step = solve(matrix, right, problem.sigma)
        problem.unknowns += step
        if np.all(np.abs(step) <= _STILL * np.sqrt(diagonal_of_inverse(matrix, problem.sigma))):
            break
    return matrix


def _weigh(problem: _Problem, matrix: np.ndarray) -> None:
    """Weigh outlines, corners and textures by how far photographs contradict each other at the most probable values.

    Errors within a photograph are alike, so that the scatter of its points does not show them; they show in what
    photographs say of each other. The variances of each photograph's outline and corners are multiplied by their
    reduced χ², and those of textures, which are compared with each other, by that of all of them. ``matrix`` is the
    normal matrix at these values.
    """
    size, covariance = len(problem.unknowns), inverse(matrix, problem.sigma)
    views = problem.views
    measured = [_outline(problem, number, _FINEST_REACH) for number in range(len(views))]
    scale = _outline_scale(measured, is_last=True)
    outlines = _outline_rows(problem, measured, scale, is_last=True)

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
        corners = _sheet_rows(problem)
        each, _ = reduced_chi_square(corners, problem.sigma, fitted(corners))
        for view, scatter in zip([view for view in views if len(view.corners)], each, strict=True):
            view.corner_scatter = float(scatter)
    if problem.tells_texture:
        information = np.zeros((size, size))
        textures = _add_texture(_textures(problem), information, np.zeros(size))
        share = float(np.sum(covariance * information))
        _, problem.texture_scatter = reduced_chi_square(textures, problem.sigma, share)


def _displaced_outlines(problem: _Problem, measured: list, outlines: list[Rows], scale: float) -> list[Rows]:
    """Return the displacement of every photograph's outline as a whole, all its points with the same weight.

    What single points say, at edges of something else, is no error of the outline: at the end they have lost their
    influence. An outline whose points do not agree tells nothing. Arguments as in `_outline_rows`, with its result.
    """
    found = []
    for number, (rows, one) in enumerate(zip(outlines, measured, strict=True)):
        view, displaced, distance, which = problem.views[number], None, one.distance, one.found
        if len(distance):
            xy = problem.seen(number, view.rim[which], problem.unknowns)
            displaced = _displaced(xy, view.outward[which], distance)
        weight = np.zeros(len(distance)) if displaced is None else 1.0 / _outline_variance(problem, number, one, scale)
        found.append(rows._replace(weight=weight, off=distance if displaced is None else displaced))
    return found


def _texels(shape: Shape, width: int, height: int) -> _Texels:
    shrink = min(1.0, math.sqrt(_TEXELS / (width * height)))
    columns, rows = max(2, round(width * shrink)), max(2, round(height * shrink))
    found = shape.atlas(columns, rows)
    on = found.covered
    return _Texels(found.position[on], found.normal[on], found.facet[on], np.flatnonzero(on.ravel()), columns, rows)


def _window(problem: _Problem, view: int, margin: float) -> tuple[float, float, float, float]:
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


def _first_reach(problem: _Problem) -> float:
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
    return max(_FINEST_REACH, min(_PRIOR_SIGMAS * float(np.median(found)), _COARSEST_REACH, part))


def _searched(picture: Picture, reach: float) -> Level:
    """Return the blurred picture in which outlines are searched."""
    return picture.level(0.0 if reach <= _FINEST_REACH else reach / 8.0)


def _prepare(problem: _Problem, number: int, reach: float, blur: float) -> None:
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
    eye, axes = camera.camera_distance_mm * to_camera(pose), rig_from_camera(pose)
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


class _Outline(NamedTuple):
    """A photograph's outline, measured against its expected place at n points.

    Parameters
    ----------
    distance, doubt : (n,) float
        Distances of the found edges from the expected outline along its outward normals, and the standard deviations of
        the errors that neighbouring points have in common, superpixels.
    change : (n, 12) float
        Derivatives of the expected place along the normals by the common unknowns.
    found : (m,) bool
        Mask of the points of the outline at which an edge was found.
    """

    distance: np.ndarray
    doubt: np.ndarray
    change: np.ndarray
    found: np.ndarray


def _outline(problem: _Problem, number: int, reach: float) -> _Outline:
    """Measure a photograph's outline against its expected place."""
    view = problem.views[number]
    nothing = _Outline(np.zeros(0), np.zeros(0), np.zeros((0, COUNT)), np.zeros(len(view.rim), dtype=bool))
    if not len(view.rim):
        return nothing
    xy = problem.seen(number, view.rim, problem.unknowns)
    # The middle of a sheet is dark, but not black: before it, the end of the lit part may be a stronger edge.
    is_dark = problem.sheet is not None
    distance, doubt = find_edges(
        view.picture, view.search, xy, view.outward, reach, inner=view.inner, is_dark_outside=is_dark
    )
    distance -= problem.outline_px
    if problem.sheet is not None:
        # Edges of squares are stronger than that of the object.
        correction, pose = problem.standing(number, problem.unknowns)
        place, camera = problem.unknowns[problem.of_sheet], problem.setup.corrected(correction)
        far = (reach + OUTER * max(1.0, view.search.sigma)) / view.picture.scale
        distance[problem.sheet.is_over_print(xy, view.outward, far, pose, camera, place)] = np.nan
    found = np.isfinite(distance)
    if found.sum() < _LEAST_POINTS:
        return nothing
    return _Outline(distance[found], doubt[found], view.change[found], found)


def _scatter(values: np.ndarray, floor: float, most: float = math.inf) -> float:
    """Return a robust standard deviation of measurements about zero, from their median magnitude, within limits."""
    return min(max(1.4826 * float(np.median(np.abs(values))), floor), most) if values.size else floor


def _cauchy(values: np.ndarray, sigma) -> np.ndarray:
    """Return Cauchy weights of residuals, which give outliers little influence."""
    return 1.0 / (1.0 + (values / (2.0 * sigma)) ** 2)


def _equations(problem: _Problem, reach: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal matrix and right-hand side of a Gauss-Newton step, with the prior.

    ``reach`` is that of the search for outlines; if it is None, only the sheet is used.
    """
    size = len(problem.unknowns)
    matrix, right = np.zeros((size, size)), np.zeros(size)
    if problem.sheet is not None:
        for rows in _sheet_rows(problem):
            rows.add_to(matrix, right)
    if reach is not None:
        _add_object(problem, reach, matrix, right)
    free = problem.sigma > 0
    matrix[free, free] += 1.0 / problem.sigma[free] ** 2
    right[free] -= problem.unknowns[free] / problem.sigma[free] ** 2
    return matrix, right


def _sheet_rows(problem: _Problem) -> list[Rows]:
    """Return the distances of the sheet's corners from their expected places in every photograph that shows it."""
    off = [
        view.corners_px - problem.corners_seen(number, problem.unknowns) for number, view in enumerate(problem.views)
    ]
    scale = _scatter(np.concatenate(off).ravel(), _CORNER_FLOOR_PX)
    common, found = [*_CAMERA, *problem.of_sheet], []
    for number, one in enumerate(off):
        if not len(one):
            continue
        moved = problem.derivative(problem.corners_seen, number, common)
        where = [*common, COUNT + number]
        rows = np.concatenate([moved, moved[..., [common.index(CAMERA)]]], axis=-1)
        factor = _cauchy(np.linalg.norm(one, axis=1) / math.sqrt(2.0), scale) / scale**2
        factor /= problem.views[number].corner_scatter
        found.append(Rows(where, rows.reshape(-1, len(where)), np.repeat(factor, 2), one.ravel()))
    return found


def _outline_scale(measured: list[_Outline], *, is_last: bool) -> float:
    """Return the standard deviation of outline points, superpixels; ``measured`` are the results of `_outline`."""
    every = np.concatenate([one.distance for one in measured])
    return _scatter(every, _OUTLINE_FLOOR_PX, _OUTLINE_MOST_PX if is_last else math.inf)


def _outline_rows(problem: _Problem, measured: list, scale: float, *, is_last: bool) -> list[Rows]:
    """Return the outline of every photograph as rows of equations, from results and scale of its points."""
    found = []
    for view, one in enumerate(measured):
        rows, where = one.change[:, [*range(COUNT), CAMERA]], [*range(COUNT), COUNT + view]
        if problem.sheet is not None:
            rows = np.concatenate([rows, np.full((len(rows), 1), 1.0 / problem.mm_per_px)], axis=1)
            where.append(problem.of_sheet[OUTLINE])
        # Borders of paints beside an outline are many and on one side: at the end they lose all influence.
        factor = _cauchy(one.distance, np.hypot(scale, one.doubt)) ** (2 if is_last else 1)
        variance = problem.views[view].outline_scatter * _outline_variance(problem, view, one, scale)
        found.append(Rows(where, rows, factor / variance, one.distance))
    return found


def _outline_variance(problem: _Problem, number: int, outline: _Outline, scale: float) -> np.ndarray:
    """Return variances of the points of an outline as if their errors were independent, (n,) superpixels².

    Parameters
    ----------
    problem : _Problem
    number : int
        Index of the photograph.
    outline : _Outline
    scale : float
        Standard deviation of a point.
    """
    pose = replace(problem.views[number].pose, turn_deg=0.0)
    # Gloss and paints err alike on one side of an object, and in all photographs under the same angles.
    alike = sum(replace(view.pose, turn_deg=0.0) == pose for view in problem.views)
    return scale**2 * _OUTLINE_SHARED + outline.doubt**2 * max(1.0, len(outline.distance) / _SIDES) * alike


def _add_object(problem: _Problem, reach: float, matrix: np.ndarray, right: np.ndarray) -> None:
    """Add outlines and textures to normal equations."""
    is_last = reach <= _FINEST_REACH
    measured = [_outline(problem, view, reach) for view in range(len(problem.views))]
    for rows in _outline_rows(problem, measured, _outline_scale(measured, is_last=is_last), is_last=is_last):
        rows.add_to(matrix, right)
    outlined = np.mean([len(one.distance) > 0 for one in measured]) >= _OUTLINED
    if problem.tells_texture and (is_last or not outlined):
        _add_texture(_textures(problem), matrix, right, problem.texture_scatter)


def _textures(problem: _Problem) -> list[TextureRows]:
    """Return the linearised texture of every photograph."""
    texels, views = problem.texels, problem.views
    places = [problem.seen(view, texels.position, problem.unknowns) for view in range(len(views))]
    values, weights = [], []
    for number, view in enumerate(views):
        values.append(texel_values(view.picture, view.level, places[number], problem.shading(number)))
        weights.append(np.where(np.isfinite(values[-1]).all(axis=1), view.weight, 0.0))
    values = without_levels(values, weights, problem.block)
    mean = problem.on_grid(mean_texture(values, weights))
    found = []
    for number, place in enumerate(places):
        # After the common unknowns: shifts of this photograph alone along x and y.
        moved = np.concatenate([views[number].moved, np.broadcast_to(np.eye(2), (len(place), 2, 2))], axis=2)
        slope = picture_slope(mean, problem.on_grid(place)).reshape(-1, mean.shape[2], 2)[texels.number]
        found.append(texture_rows(values[number], slope, moved, weights[number], problem.block))
    return found


def _spacing(problem: _Problem) -> float:
    """Return the median distance of neighbouring texels in the pictures, samples."""
    found = []
    for number, view in enumerate(problem.views):
        place = problem.on_grid(problem.seen(number, problem.texels.position, problem.unknowns)) * view.picture.scale
        down, across = (np.asarray(one) for one in np.gradient(place, axis=(0, 1)))
        found.append(np.nanmedian(np.abs(down[..., 0] * across[..., 1] - down[..., 1] * across[..., 0])))
    return math.sqrt(float(np.median(found)))


def _add_texture(rows: list[TextureRows], matrix: np.ndarray, right: np.ndarray, scatter: float = 1.0) -> list[Rows]:
    """Add the differences between the photographs' textures to normal equations, the texels' colours eliminated.

    Returns the differences of every photograph from the mean texture.
    """
    # A texel that only one photograph shows cannot be compared.
    both = np.sum([row.weight > 0 for row in rows], axis=0) > 1
    if not both.any():
        return []
    rows = [TextureRows(*(part[both] for part in row)) for row in rows]
    values, weights = [row.value for row in rows], [row.weight for row in rows]
    mean = mean_texture(values, weights)
    off = [value - mean for value in values]
    scale = _scatter(np.concatenate([o[w > 0].ravel() for o, w in zip(off, weights, strict=True)]), _TEXTURE_FLOOR)
    weights = [
        w * _cauchy(np.sqrt(np.mean(o**2, axis=1)), scale) / (scatter * scale**2 * _TEXTURE_SHARED)
        for o, w in zip(off, weights, strict=True)
    ]
    mean, total = mean_texture(values, weights), np.sum(weights, axis=0)
    sums, found = np.zeros((*mean.shape, len(right))), []
    for view, (row, weight) in enumerate(zip(rows, weights, strict=True)):
        where = [*range(COUNT), COUNT + view]
        change = row.change[..., [*range(COUNT), CAMERA]]
        sums[..., where] += weight[:, None, None] * change
        one = change.reshape(-1, len(where)), np.repeat(weight, mean.shape[1]), (mean - row.value).ravel()
        found.append(Rows(where, *one))
        found[-1].add_to(matrix, right)
    matrix -= np.einsum("tbp,tbq->pq", sums, sums / total[:, None, None], optimize=True)
    return found


def _residuals(problem: _Problem, reach: float) -> tuple[np.ndarray, np.ndarray, tuple[tuple[str, float], ...]]:
    """Return residuals (J,) in superpixels, counts of outline points (J,), and the suspect angle of every photograph.

    Residuals are relative to the common correction. Outlines are searched over ``reach`` samples, further than at the
    end of the registration, so that a photograph with a wrong pose gets a large residual instead of none.
    """
    residual, count = np.full(len(problem.views), np.nan), np.zeros(len(problem.views), dtype=int)
    rows = _textures(problem) if problem.tells_texture else []
    weights = [row.weight for row in rows]
    mean = mean_texture([row.value for row in rows], weights) if rows else np.zeros(0)
    total = np.sum(weights, axis=0)
    suspects = []
    for number, view in enumerate(problem.views):
        distance, doubt, _, found = _outline(problem, number, reach)
        count[number] = len(distance)
        sure = doubt < _MOST_DOUBT_PX
        if sure.sum() < _LEAST_POINTS:
            sure[:] = False
        distance, found = distance[sure], _within(found, sure)
        outward = view.outward[found] if len(distance) else np.zeros((0, 2))
        if len(distance):
            xy = problem.seen(number, view.rim[found], problem.unknowns)
            residual[number] = _displacement(xy, outward, distance)
            if residual[number] > _DOUBTFUL_PX and not _is_clearer(view, xy, outward, distance):
                residual[number] = np.nan
        shift = np.full(2, np.nan)
        # An outline that tells both directions is more certain than a texture beside gloss.
        if rows and np.linalg.eigvalsh(outward.T @ outward)[0] < _BOTH_WAYS * len(outward) + 1e-9:
            shift = _shift(rows[number], mean, total)
        residual[number] = np.fmax(residual[number], np.linalg.norm(shift))
        off = np.zeros((0, 2))
        if len(view.corners):
            xy = problem.corners_seen(number, problem.unknowns)
            off, both = view.corners_px - xy, np.tile(np.eye(2), (len(xy), 1))
            view.sheet_residual_px = math.sqrt(2.0) * _displacement(np.repeat(xy, 2, axis=0), both, off.ravel())
            residual[number] = np.fmax(residual[number], view.sheet_residual_px)
        suspects.append(_suspect(problem, number, distance, found, shift, off))
    return residual, count, tuple(suspects)


def _least_residuals(
    problem: _Problem, residual: np.ndarray, probable: np.ndarray, sigma: np.ndarray, reach: float
) -> np.ndarray:
    """Return the residuals, (J,) in superpixels, or those with all common unknowns at their most probable values.

    A few points of an outline may show that an object is displaced without determining how: its place then stays as
    typed, and is no contradiction. The smaller of both counts, and NaN if the photograph does not tell that it is far
    from the most probable place. If that place is itself unlikely, it explains nothing.
    """
    if (np.abs(probable[:COUNT]) > CONTRADICTED * sigma[:COUNT]).any():
        return residual
    used, problem.unknowns = problem.unknowns, probable.copy()
    problem.unknowns[problem.own] = 0.0
    of_sheet = [view.sheet_residual_px for view in problem.views]
    least = np.minimum(residual, _residuals(problem, reach)[0])
    problem.unknowns = used
    for view, one in zip(problem.views, of_sheet, strict=True):
        view.sheet_residual_px = one
    return least


def _within(mask: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return a mask, (n,) bool, of those of the true values of another that are chosen, (true values,) bool."""
    out = mask.copy()
    out[mask] = chosen
    return out


def _is_clearer(view: _View, xy: np.ndarray, outward: np.ndarray, distance: np.ndarray) -> bool:
    """Whether a displaced outline, arguments as in `_displaced`, is clearer in a photograph than the expected one.

    A few points at borders of paints or highlights can displace an outline by far, if most points are on one side.
    """
    explained = _displaced(xy, outward, distance)
    if explained is None:
        return False
    on = np.stack([xy, xy + explained[:, None] * outward])
    across = np.broadcast_to(_BESIDE / view.picture.scale * outward, on.shape)
    expected, displaced = contrast(view.picture, on, across)
    return bool(displaced > _CLEARER * expected)


def _displacement(xy: np.ndarray, outward: np.ndarray, distance: np.ndarray) -> float:
    """Return the root-mean-square displacement of an outline, superpixels; NaN if `_displaced` returns None.

    The mean is over all points: if a rectangular plate is moved along one of its sides, half of its outline stays in
    place and still counts. Arguments as in `_displaced`.
    """
    explained = _displaced(xy, outward, distance)
    return math.nan if explained is None else math.sqrt(np.mean(explained**2))


def _displaced(xy: np.ndarray, outward: np.ndarray, distance: np.ndarray) -> np.ndarray | None:
    """Return the displacement of an outline's points along its normals by a robust affine fit, (n,) superpixels.

    Outliers, at edges of something else, have little influence. None if most points do not agree with any displacement
    of the whole: such an outline, beside shadows or paints, tells nothing about the photograph.

    Parameters
    ----------
    xy : (n, 2) float
        Expected points of the outline, superpixels.
    outward : (n, 2) float
        Unit normals.
    distance : (n,) float
        Distance of the measured outline from them, superpixels.
    """
    affine = np.concatenate([outward, outward * xy[:, :1], outward * xy[:, 1:]], axis=1)
    weight, explained = np.ones(len(distance)), distance
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        explained = affine @ np.linalg.lstsq(root[:, None] * affine, root * distance, rcond=1e-9)[0]
        left = distance - explained
        weight = _cauchy(left, _scatter(left, _OUTLINE_FLOOR_PX))
    displacement = math.sqrt(np.mean(explained**2))
    agree = np.abs(distance - explained) <= max(_AGREE_PX, _AGREE * displacement)
    return explained if agree.mean() >= _MOST_AGREE else None


def _suspect(
    problem: _Problem, number: int, distance: np.ndarray, found: np.ndarray, shift: np.ndarray, off_sheet=()
) -> tuple[str, float]:
    """Return the angle of a photograph's pose whose error would explain its displacement best, and that error, degrees.

    Parameters
    ----------
    problem : _Problem
    number : int
        Index of the photograph.
    distance : (n,) float
        Displacement of its outline at the found points, superpixels.
    found : (m,) bool
        Mask of the outline points at which an edge was found.
    shift : (2,) float
        Displacement of its texture, superpixels; used if neither an outline nor the sheet was found.
    off_sheet : (k, 2) float
        Displacement of the sheet's corners, superpixels; used if there are any.
    """
    view = problem.views[number]
    points, outward = problem.texels.position, None
    if len(off_sheet):
        off = np.ravel(off_sheet)
    elif len(distance):
        points, outward, off = view.rim[found], view.outward[found], distance
    else:
        off = np.tile(np.nan_to_num(shift), len(points))

    def place() -> np.ndarray:
        """Place of the points along the measured directions in the present pose."""
        if len(off_sheet):
            return problem.corners_seen(number, problem.unknowns).ravel()
        xy = problem.seen(number, points, problem.unknowns)
        return xy.ravel() if outward is None else np.sum(xy * outward, axis=1)

    typed, explained = view.pose, []
    for name, angle in _POSE_ANGLES.items():
        ends = []
        for sign in (1.0, -1.0):
            view.pose = replace(typed, **{angle: getattr(typed, angle) + 0.1 * sign})
            ends.append(place())
        along = (ends[0] - ends[1]) / 0.2
        by = float(along @ off) / max(float(along @ along), 1e-12)
        explained.append((float(np.sum((off - by * along) ** 2)), name, by))
    view.pose = typed
    return min(explained)[1:]


def _shift(row: TextureRows, mean: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return the displacement of a photograph's texture from that of the others, (2,) superpixels; NaN if too weak."""
    others = total - row.weight
    used = (row.weight > 0) & (others > 1e-6 * row.weight)
    # Gloss changes the texture near mirror directions: with mostly such texels, the place cannot be determined.
    if not used.any() or row.weight[used].mean() < _LEAST_MATT:
        return np.full(2, np.nan)
    share = row.weight[used] / others[used]
    off = (row.value[used] - mean[used]) * (1.0 + share)[:, None]  # from the mean of the others
    slope = row.change[used][..., COUNT:]
    weight = row.weight[used, None] * _cauchy(off, _scatter(off, _TEXTURE_FLOOR))
    matrix = np.einsum("tb,tbi,tbk->ik", weight, slope, slope)
    if np.linalg.eigvalsh(matrix)[0] < _LEAST_TEXTURE * weight.sum():
        return np.full(2, np.nan)
    return np.linalg.solve(matrix, -np.einsum("tb,tbi,tb->i", weight, slope, off))


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
    found, problem = _registered(linear, definition, setup, placing, markers, light)

    def with_free_camera() -> tuple[Registered, _Problem]:
        return _registered(linear, definition, setup, placing, markers, camera_deg=FREE_CAMERA_DEG)

    if first is not None:
        before = _problem(first.linear, definition, typed, placing)
        found = _turned_from(first, before, found, problem, linear, placing)
    used = problem.unknowns.copy()
    try:
        refuse_contradictions(found, problem, linear, placing, with_free_camera)
    except InputError as error:
        raise _in_placement(error, number) if definition.placements else error from None
    problem.unknowns = used
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
    before: _Problem,
    found: Registered,
    problem: _Problem,
    linear: Sequence,
    placing: "Placing",
) -> Registered:
    """Return the registration of a further placement with what textures tell of its rotation.

    ``before`` is the problem of the first placement, without correction.
    """
    # However coarse the object's texels are, the blur that goes with them must not mix in what lies behind it.
    rows = round(math.sqrt(_TEXELS / 2.0))
    texels = _texels(problem.shape, 2 * rows, rows)
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
