"""Errors of a registration: how far photographs contradict each other, and what follows for the errors of angles.

The fit needs the error of the angles under which a pixel shows the surface. Not every error of a place changes them: a
sphere that is turned shows other texels, but under the same angles. Therefore the derivatives are taken at a fixed
pixel: what a changed place brings before it, less what the surface shows beside it.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import to_camera
from irodori.rectification.placement_correction import CAMERA, COUNT, LIGHT
from irodori.rectification.registration_file import AngleChanges
from irodori.rectification.stage import observe
from irodori.rectification.texture_agreement import picture_slope

if TYPE_CHECKING:
    from irodori.rectification.registration_problem import Problem

_LEAST_COSINE = 0.15  # cosine of incidence or of view below which an observation is left out
_LEAST_SINE = 1e-3  # sine of an angle below which its derivative is not defined
_NEIGHBOURS = 4.0  # times the usual distance of neighbouring texels: further apart, they are of different parts
_EDGE = 0.5  # rad: normals of neighbouring texels that differ by more lie on both sides of an edge


class Rows(NamedTuple):
    """Measurements in one photograph, linearised about the present unknowns.

    Parameters
    ----------
    where : list of p int
        Indices of the unknowns on which they depend, each once.
    change : (n, p) float
        Derivatives of what is expected by these unknowns.
    weight : (n,) float
        Inverse variances.
    off : (n,) float
        What was measured less what is expected.
    """

    where: list[int]
    change: np.ndarray
    weight: np.ndarray
    off: np.ndarray

    def add_to(self, matrix: np.ndarray, right: np.ndarray) -> None:
        """Add the measurements to the normal equations of all unknowns."""
        weighted = self.weight[:, None] * self.change
        matrix[np.ix_(self.where, self.where)] += weighted.T @ self.change
        right[self.where] += weighted.T @ self.off


class RegisteredAngleErrors(NamedTuple):
    """Standard deviations of the angles θ_i, θ_r, θ_H and φ of a registered object's observations, degrees.

    Parameters
    ----------
    rms : (4,) float64
        Root mean square over all observations; NaN if there are none.
    by_photograph : (J, 4) float64
        The same over the observations of each photograph.
    spread : (4, 2) float64
        5th and 95th percentiles over all observations.
    changes : AngleChanges
        From which these follow for any errors of the registration, but for the percentiles.
    """

    rms: np.ndarray
    by_photograph: np.ndarray
    spread: np.ndarray
    changes: AngleChanges

    @property
    def stated(self) -> np.ndarray | None:
        """The root mean squares; None if there are no observations from which to tell them."""
        return self.rms if np.isfinite(self.rms).all() else None

    def __str__(self) -> str:
        if self.stated is None:
            return "errors of the angles: not told, because no texel amid others is seen and lit"
        parts = [
            f"{name} {self.rms[at]:.3f} (90 % from {self.spread[at, 0]:.3f} to {self.spread[at, 1]:.3f})"
            for name, at in (("incidence", 0), ("between normal and half vector", 3))
        ]
        return f"errors of the angles, degrees: {', '.join(parts)}"


def reduced_chi_square(photographs: list[Rows], sigma: np.ndarray, fitted: float) -> tuple[np.ndarray, float]:
    """Return variances of what photographs tell relative to the expected ones, from how far they contradict each other.

    The expected variance counts as one measurement, so that it is what is left of a few.

    Parameters
    ----------
    photographs : list of Rows
        One kind of measurement at the most probable values: what each photograph tells deviates from them by errors.
    sigma : (n,) float
        Standard deviations of the prior of all unknowns. Combinations of unknowns that a photograph determines less
        than the prior are not counted.
    fitted : float
        Number of unknowns that these measurements have determined.

    Returns
    -------
    each : (photographs,) float64
        That of each photograph; no less than that of all of them.
    together : float
        That of all of them.
    """
    squares, told = np.zeros((2, len(photographs)))
    for number, rows in enumerate(photographs):
        scaled = rows.change * sigma[rows.where]
        weighted = rows.weight[:, None] * scaled
        information, axes = np.linalg.eigh(weighted.T @ scaled)
        counts = information > 1.0
        squares[number] = np.sum((axes.T @ (weighted.T @ rows.off))[counts] ** 2 / information[counts])
        told[number] = counts.sum()
    # The fit has taken its share of every photograph's χ².
    left = told * max(0.0, 1.0 - fitted / max(told.sum(), 1.0))
    together = float((1.0 + squares.sum()) / (1.0 + left.sum())) if left.any() else 1.0
    each = np.divide(squares, left, out=np.full(len(photographs), together), where=left > 0.0)
    return np.maximum(each, together), together


def angle_errors(problem: "Problem", moment: np.ndarray, light_deg: float) -> RegisteredAngleErrors:
    """Propagate the errors of a registration to the angles of all observations.

    Parameters
    ----------
    problem : Problem
        With the values that are used as its unknowns.
    moment : (12 + J, 12 + J) float
        Mean squares and products of the errors of the common values and of each photograph's own camera angle.
    light_deg : float
        Standard deviation of each photograph's own light angle, degrees.
    """
    squares, products = [], []
    for number in range(len(problem.views)):
        change = _angle_changes(problem, number)
        where = [*range(COUNT), COUNT + number]
        rows = change[..., [*range(COUNT), CAMERA]]
        own = moment[np.ix_(where, where)]
        own[LIGHT, LIGHT] += light_deg**2
        squares.append(np.einsum("nap,pq,naq->na", rows, own, rows, optimize=True))
        products.append(np.einsum("nap,naq->apq", rows, rows) / max(len(rows), 1))
    changes = AngleChanges(np.array(products), np.array([len(one) for one in squares]))
    by_photograph = changes.by_photograph(moment, light_deg)
    every = np.concatenate(squares)
    spread = np.percentile(every, [5.0, 95.0], axis=0).T if len(every) else np.full((4, 2), np.nan)
    return RegisteredAngleErrors(changes.rms(by_photograph), by_photograph, np.sqrt(spread), changes)


def _angle_changes(problem: "Problem", number: int) -> np.ndarray:
    """Return derivatives of θ_i, θ_r, θ_H, φ at the pixels of a photograph's observations, (observations, 4, 12).

    In degrees per unit of the common unknowns.
    """
    texels = problem.texels
    place = problem.seen(number, texels.position, problem.unknowns)
    moved = problem.derivative(lambda view, values: problem.seen(view, texels.position, values), number)
    directions = _directions(problem, number, problem.unknowns)
    change = problem.derivative(lambda view, values: _directions(problem, view, values), number)
    slope = picture_slope(problem.on_grid(directions), problem.on_grid(place)).reshape(-1, directions.shape[1], 2)
    change = change - slope[texels.number] @ moved
    is_clear = np.isfinite(change).all(axis=(1, 2)) & _is_seen(problem, number) & _is_amid(problem)
    normal, light, view = np.split(directions[is_clear], 3, axis=1)
    by_normal, by_light, by_view = np.split(change[is_clear], 3, axis=1)
    length = np.linalg.norm(light + view, axis=1)[:, None]
    half, by_half = (light + view) / length, (by_light + by_view) / length[..., None]
    by_half = by_half - half[..., None] * np.einsum("ni,nip->np", half, by_half)[:, None]
    found = []
    for one, other, by_one, by_other in (
        (normal, light, by_normal, by_light),
        (normal, view, by_normal, by_view),
        (half, light, by_half, by_light),
        (normal, half, by_normal, by_half),
    ):
        # Where two directions nearly coincide, the angle between them has no derivative: errors there are left out.
        sine = np.maximum(np.linalg.norm(np.cross(one, other), axis=1), _LEAST_SINE)
        by_cosine = np.einsum("ni,nip->np", one, by_other) + np.einsum("ni,nip->np", other, by_one)
        found.append(-by_cosine / sine[:, None])
    return np.degrees(np.stack(found, axis=1))


def _directions(problem: "Problem", number: int, values: np.ndarray) -> np.ndarray:
    """Return normals of the texels and unit vectors to light and camera, side by side, (n, 9), for given unknowns."""
    correction, pose = problem.standing(number, values)
    placed = correction.placements(problem.shape, pose, 0.0)[0]
    position = placed.points(problem.texels.position)
    light = problem.setup.lamp.seen_from(position, pose)[0]
    view = problem.setup.corrected(correction).camera_distance_mm * to_camera(pose) - position
    view /= np.linalg.norm(view, axis=1)[:, None]
    return np.concatenate([problem.texels.normal @ placed.rotation.T, np.broadcast_to(light, view.shape), view], axis=1)


def _is_seen(problem: "Problem", number: int) -> np.ndarray:
    """Return a mask of the texels that a photograph shows lit and not at grazing angles, (n,)."""
    correction, pose = problem.standing(number, problem.unknowns)
    camera, texels = problem.setup.corrected(correction), problem.texels
    placements = correction.placements(problem.shape, pose, problem.setup.table_radius_mm)
    placed = placements[0]
    normal, facet = texels.normal @ placed.rotation.T, texels.facet @ placed.rotation.T
    sight = observe(placed.points(texels.position), normal, Tracer(placements), pose, camera, facet)
    is_steep = (np.cos(sight.geometry[:, :2]) > _LEAST_COSINE).all(axis=1)
    size = 0.5 * np.array([camera.pinhole.width_px, camera.pinhole.height_px])
    is_within = ((sight.xy > 0.0) & (sight.xy < size - 1.0)).all(axis=1)
    return sight.visible & sight.lit & is_steep & is_within


def _is_amid(problem: "Problem") -> np.ndarray:
    """Return a mask of the texels that have their neighbours on the surface on both sides of them on the grid, (n,).

    Slopes between others are inexact on a curved surface, or lead across an edge to another part of the surface.
    """
    amid = np.zeros((problem.texels.rows, problem.texels.columns), dtype=bool)
    amid[1:-1, 1:-1] = True
    for axis in (0, 1):
        apart, bend = (
            np.linalg.norm(np.gradient(problem.on_grid(values), axis=axis), axis=2)
            for values in (problem.texels.position, problem.texels.normal)
        )
        with np.errstate(invalid="ignore"):
            amid &= (apart < _NEIGHBOURS * np.nanmedian(apart)) & (bend < _EDGE)
    return amid.ravel()[problem.texels.number]
