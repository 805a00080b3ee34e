"""State and result of the registration of an object: photographs, texels, unknowns, projections."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.capture_table import Pose
from irodori.geometry.atlas import are_alike
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera
from irodori.geometry.shapes.shape import Shape
from irodori.rectification.inner_brightness import InnerSurface
from irodori.rectification.marker_sheet import OUTLINE, SHEET_STEPS, MarkerSheet
from irodori.rectification.outline_search import InnerSide
from irodori.rectification.placement_correction import COUNT, Correction
from irodori.rectification.reduced_pictures import Level, Picture
from irodori.rectification.registration_covariance import RegisteredAngleErrors
from irodori.rectification.registration_file import Estimate
from irodori.rectification.stage import RigSetup

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


TEXELS = 3600  # texels of the object, at most, whose texture is compared
_BENT = 9  # points of the surface by which its curvature is found
_EDGE = 0.5  # change of a unit normal between neighbours that is an edge
_NUMERIC = np.array([0.01] * 3 + [0.01] * 3 + [0.1, 0.01, 0.1, 0.1, 0.01, 0.01])  # steps of derivatives, as QUANTITIES


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


class Texels(NamedTuple):
    """Points on the object whose texture is compared between photographs, in the object's frame."""

    position: np.ndarray  # (n, 3)
    normal: np.ndarray
    facet: np.ndarray
    number: np.ndarray  # (n,) index in the whole grid
    columns: int
    rows: int


@dataclass
class View:
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
class Problem:
    """State of an object's registration: data and unknowns.

    The unknowns are 12 common ones, one camera angle of each photograph, and 9 more if there is a sheet.
    """

    shape: Shape
    setup: RigSetup
    texels: Texels
    views: list[View]
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

        side = round(math.sqrt(TEXELS))
        points = texels_of(self.shape, side, side)
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
        axes = rig_from_camera(pose, self.setup.pinhole.quarter_turns)
        return correction.pinhole(self.setup.pinhole).project(points, eye, axes)

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


def texels_of(shape: Shape, width: int, height: int) -> Texels:
    """Return the texels of a shape, or of its grid coarsened to `TEXELS` at most."""
    shrink = min(1.0, math.sqrt(TEXELS / (width * height)))
    columns, rows = max(2, round(width * shrink)), max(2, round(height * shrink))
    found = shape.atlas(columns, rows)
    on = found.covered
    return Texels(found.position[on], found.normal[on], found.facet[on], np.flatnonzero(on.ravel()), columns, rows)
