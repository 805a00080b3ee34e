"""Fisher information of photographs about α, β and μ of equation (5), and predicted standard errors.

The parameters are (ln α, ln β, ln μ), so that their errors are relative and have no unit. The best poses depend on the
scale of the parameters, because a sum of variances does; the report states relative errors of β and μ.

A *case* is one material on one texel: case = texel * materials + material. A material here has one gloss component.
For an object with two, materials with either lobe alone are used. The poses then serve both lobes, but the separation
of the two components of one texel is not part of the prediction, and the errors are larger than predicted.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from irodori.config.capture_table import Pose
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rig_from_object, to_camera, to_light
from irodori.geometry.shapes.placement import Placement, on_table
from irodori.geometry.shapes.shape import Shape
from irodori.jit.compilation import njit
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobes import Lobes, constants, derivatives, features, value
from irodori.reflection.registry import DEFAULT_LOBES

if TYPE_CHECKING:
    from irodori.config.models import SensorOptions

PARAMETERS = 3
_OFFSET_MM = 1e-3
_SINGULAR = 1e-10  # determinant, scaled to a unit diagonal, below which parameters cannot be separated


@dataclass(frozen=True)
class ObservationNoise:
    """Parameters of the variance of one observation ρ: shot and read noise, drift of the light, and pose error.

    Parameters
    ----------
    read_variance : float
        c0, variance of a response of zero.
    shot_variance : float
        c1, variance added for each unit of response.
    relative : float
        Standard deviation of the light from photograph to photograph, ratio.
    pose_rms_deg : float
        Standard deviation of the light angle and of the camera angle, degrees.
    saturation_response : float
        Response at and above which an observation is clipped and not used; infinite if exposures cover every response.
    """

    read_variance: float = 6e-8
    shot_variance: float = 4e-5
    relative: float = 0.01
    pose_rms_deg: float = 0.05
    saturation_response: float = math.inf

    @classmethod
    def of_sensor(cls, sensor: "SensorOptions", exposures_s=(), **others) -> "ObservationNoise":
        """Return the noise of a camera's ``virtual.sensor`` block for its brightest band.

        Parameters
        ----------
        sensor : SensorOptions
        exposures_s : sequence of float
            Exposure times of a bracket, s; the longest determines the noise and the shortest the saturation. If empty,
            the base exposure is used.
        **others
            Further fields of `ObservationNoise`.
        """
        base = sensor.base_exposure_s
        exposures = list(exposures_s) or [base]
        per_response = sensor.full_well_e / sensor.response_at_full_well
        longest, shortest = max(exposures) / base, min(exposures) / base
        return cls(
            read_variance=(sensor.read_noise_e / (per_response * longest)) ** 2,
            shot_variance=1.0 / (per_response * longest),
            saturation_response=sensor.response_at_full_well / shortest,
            **others,
        )


#: Relative error of the model of which the fit takes account in its weights by default, `fit.model_error`.
MODEL_ERROR = 0.01


@dataclass(frozen=True)
class Materials:
    """Materials with parameters that the photographs are to determine.

    Parameters
    ----------
    alpha, beta, mu : (m,) float
        Diffuse and gloss weights, at least 0; roughness in the unit of the lobe, above 0.
    n, k : float
        Complex refractive index n + ik of all materials.
    lobes : tuple of str
        Names of lobes in `irodori.reflection.registry`; the materials are divided among them in equal parts, in order.
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    n: float = 1.5
    k: float = 0.0
    lobes: tuple[str, ...] = DEFAULT_LOBES

    def of_lobes(self) -> list[tuple[str, np.ndarray]]:
        """Return (name of a lobe, indices of its materials) for every lobe."""
        which = np.arange(len(self.alpha)) * len(self.lobes) // len(self.alpha)
        return [(name, np.flatnonzero(which == number)) for number, name in enumerate(self.lobes)]

    def parameters(self) -> np.ndarray:
        """Return α, β, μ as (m, 3) float64."""
        return np.stack(np.broadcast_arrays(self.alpha, self.beta, self.mu), axis=-1).astype(np.float64)


@dataclass(frozen=True)
class RigSubject:
    """Texels of an object on the rig's table.

    Parameters
    ----------
    shape : Shape
    position, normal : (t, 3) float
        Object frame, mm and unit vectors.
    camera_distance_mm : float
    table_radius_mm : float
        Half the side of the table's top; 0 if there is no table.
    further_deg : tuple of (3,) float
        Rotation of each further placement, see `irodori.geometry.shapes.placement.laid`.
    """

    shape: Shape
    position: np.ndarray
    normal: np.ndarray
    camera_distance_mm: float
    table_radius_mm: float = 0.0
    further_deg: tuple[tuple[float, ...], ...] = ()

    def placed(self, pose: Pose) -> list[Placement]:
        """Return object and table in a pose, in the rig's frame."""
        rotation_deg = ((0.0, 0.0, 0.0), *self.further_deg)[pose.placement - 1]
        return on_table(self.shape, rig_from_object(pose), self.table_radius_mm, rotation_deg)

    def geometry(self, poses: list[Pose]) -> np.ndarray:
        """Return θ_i, θ_r, θ_H, φ of every texel in every pose, (poses, t, 4) rad."""
        turns = {_turn(pose): pose for pose in poses}  # few, however many the poses
        placed = {turn: self.placed(pose)[0] for turn, pose in turns.items()}
        rotation = np.array([placed[_turn(pose)].rotation for pose in poses])
        normal = np.einsum("pij,tj->pti", rotation, self.normal)
        light = np.array([to_light(pose) for pose in poses])[:, None]
        view = self.camera_distance_mm * np.array([to_camera(pose) for pose in poses])[:, None]
        view = view - np.array([placed[_turn(pose)].translation_mm for pose in poses])[:, None]
        view = view - np.einsum("pij,tj->pti", rotation, self.position)
        return angles_from_directions(normal, light, view / np.linalg.norm(view, axis=-1, keepdims=True))

    def unobstructed(self, poses: list[Pose]) -> np.ndarray:
        """Return whether neither object nor table hides a texel from the light or the camera, (poses, t) bool."""
        out = np.empty((len(poses), len(self.position)), dtype=bool)
        groups: dict[tuple, list[int]] = {}
        for index, pose in enumerate(poses):
            groups.setdefault(_turn(pose), []).append(index)
        for group in groups.values():
            placed = self.placed(poses[group[0]])
            tracer = Tracer(placed)
            start = placed[0].points(self.position + _OFFSET_MM * self.normal)
            light = np.array([to_light(poses[index]) for index in group])[:, None]
            view = self.camera_distance_mm * np.array([to_camera(poses[index]) for index in group])[:, None] - start
            distance = np.linalg.norm(view, axis=-1)
            start, light = np.broadcast_to(start, view.shape), np.broadcast_to(light, view.shape)
            # One call for all rays: waking the threads for a handful of rays costs more than the rays.
            hidden = tracer.occluded(
                start.reshape(-1, 3), (view / distance[..., None]).reshape(-1, 3), far=distance.reshape(-1)
            )
            hidden |= tracer.occluded(start.reshape(-1, 3), light.reshape(-1, 3))
            out[group] = ~hidden.reshape(distance.shape)
        return out


def _turn(pose: Pose) -> tuple[float, float, int]:
    """Return what turns the object in a pose: tilt and turn of the table, degrees, and the placement."""
    return pose.tilt_deg, pose.turn_deg, pose.placement


class Observations(NamedTuple):
    """Expected observations of every case in every pose, float64."""

    jacobian: np.ndarray  # (poses, cases, 3) ∂ρ / ∂(ln α, ln β, ln μ); zero without an observation
    variance: np.ndarray  # (poses, cases) of ρ; infinite without an observation
    response: np.ndarray  # (poses, cases) ρ; zero without an observation
    weight: np.ndarray  # (poses, cases) weight in the fit; zero without an observation

    def of(self, chosen) -> "Observations":
        """Return the observations of the poses with the given indices."""
        chosen = np.asarray(chosen, dtype=np.intp)
        return Observations(self.jacobian[chosen], self.variance[chosen], self.response[chosen], self.weight[chosen])

    def scaled(self) -> np.ndarray:
        """Return the Jacobian divided by the standard deviation, (poses, cases, 3); rowᵀ row is the information."""
        return self.jacobian / np.sqrt(self.variance)[..., None]


def observe(
    subject: RigSubject,
    poses: list[Pose],
    materials: Materials,
    noise: ObservationNoise,
    max_angle_deg: float = 80.0,
    model_error: float = MODEL_ERROR,
) -> Observations:
    """Return the expected observations of each texel with each material in each pose.

    Parameters
    ----------
    subject : RigSubject
    poses : list of Pose
    materials : Materials
    noise : ObservationNoise
    max_angle_deg : float
        Observations with θ_i or θ_r beyond this angle have no weight in the fit and are not used here, degrees.
    model_error : float
        As ``fit.model_error``, ratio: weights of the fit are 1 / (c0 + c1 ρ + (model error · ρ)²).

    Returns
    -------
    Observations

    Notes
    -----
    The variance due to the pose error is the mean square change of ρ when the light, then the camera, moves by one
    standard deviation to either side. To first order this is (∂ρ/∂θ σ)²; at the lobe's top, where the derivative is
    zero, the curvature remains. It prevents that observations on steep flanks of the lobe count for more than they
    contribute.
    """
    shifts = [("light_deg", -1), ("light_deg", 1), ("camera_deg", -1), ("camera_deg", 1)]
    moved = [poses] + [
        [replace(pose, **{axis: getattr(pose, axis) + sign * noise.pose_rms_deg}) for pose in poses]
        for axis, sign in shifts
    ]
    geometry = np.stack([subject.geometry(group) for group in moved], axis=2)  # (poses, t, 5, 4)
    limit = np.radians(max_angle_deg) + 1e-9
    seen = (geometry[:, :, 0, :2] <= limit).all(axis=-1) & subject.unobstructed(poses)
    reflectance = fresnel_array(np.cos(geometry[..., 2]), materials.n, materials.k)
    parameters = materials.parameters()
    cases = geometry.shape[1] * len(parameters)
    shape = (len(poses), cases)
    out = Observations(np.zeros((*shape, PARAMETERS)), np.full(shape, np.inf), np.zeros(shape), np.zeros(shape))
    spread = _Spread(noise.read_variance, noise.shot_variance, noise.relative, noise.saturation_response, model_error)
    for name, chosen in materials.of_lobes():
        _fill(Lobes.of(name), _Seen(geometry, reflectance, seen), _Group(parameters, chosen), spread, out)
    return out


@njit(cache=True, error_model="numpy")
def _features(lobes, geometry, reflectance, out):
    """Fill cosθ_i, F times the lobe's factor, and the lobe's three features of a pose and its shifted poses, (5, 5)."""
    for s in range(5):
        # Beyond the horizon there is no light: the cosine of a moved pose must not turn negative.
        cosine = math.cos(min(geometry[s, 0], 0.5 * math.pi))
        cos_r, cos_h, phi = math.cos(geometry[s, 1]), math.cos(geometry[s, 2]), geometry[s, 3]
        factor, f0, f1, f2 = features(lobes, math.cos(geometry[s, 0]), cos_r, math.cos(phi), cos_h, phi)
        out[0, s], out[1, s], out[2, s], out[3, s], out[4, s] = cosine, reflectance[s] * factor, f0, f1, f2


class _Seen(NamedTuple):
    """Geometry and visibility of the texels in every pose and its four shifted poses."""

    geometry: np.ndarray  # (poses, t, 5, 4) θ_i, θ_r, θ_H, φ, rad
    reflectance: np.ndarray  # (poses, t, 5) Fresnel reflectance
    is_seen: np.ndarray  # (poses, t) bool


class _Group(NamedTuple):
    """Materials with one lobe."""

    parameters: np.ndarray  # (materials, 3) α, β, μ of all materials
    chosen: np.ndarray  # indices of the materials with this lobe


class _Spread(NamedTuple):
    """Parameters of an observation's variance, as in `ObservationNoise`, and of the variance that the fit assumes."""

    read: float
    shot: float
    relative: float
    saturation: float
    expected: float  # relative error of the model


@njit(cache=True)
def _fill_pose(lobes, seen, group, spread, filled, p):
    jacobian, variance, response, weight = filled.jacobian[p], filled.variance[p], filled.response[p], filled.weight[p]
    read, shot, relative, saturation, expected = spread
    parameters, materials, at = group.parameters, group.parameters.shape[0], np.empty((5, 5))
    for t in range(seen.is_seen.shape[1]):
        if not seen.is_seen[p, t]:
            continue
        _features(lobes, seen.geometry[p, t], seen.reflectance[p, t], at)
        for m in group.chosen:
            alpha, beta, constant = parameters[m, 0], parameters[m, 1], constants(lobes, math.log(parameters[m, 2]))
            shape, slope, _ = derivatives(lobes, constant, at[2, 0], at[3, 0], at[4, 0])
            gloss = beta * at[1, 0] * shape
            total = alpha * at[0, 0] + gloss
            if total >= saturation:
                continue
            case = t * materials + m
            shift = 0.0
            for s in range(1, 5):
                moved = alpha * at[0, s] + beta * at[1, s] * value(lobes, constant, at[2, s], at[3, s], at[4, s])
                shift += 0.5 * (moved - total) ** 2
            jacobian[case, 0] = alpha * at[0, 0]
            jacobian[case, 1] = gloss
            jacobian[case, 2] = beta * at[1, 0] * slope
            variance[case] = read + shot * total + (relative * total) ** 2 + shift
            response[case] = total
            weight[case] = 1.0 / (read + shot * total + (expected * total) ** 2)


@njit(cache=True, parallel=True, nogil=True)
def _fill(lobes, seen, group, spread, filled):
    for p in numba.prange(seen.is_seen.shape[0]):
        _fill_pose(lobes, seen, group, spread, filled, p)


def standard_errors(observations: Observations) -> np.ndarray:
    """Return the expected relative standard errors of α, β, μ of the fit, (cases, 3); infinite where undetermined.

    With the weights w of the fit of equation (7) its covariance is N⁻¹ (Σ w² v J Jᵀ) N⁻¹ with N = Σ w J Jᵀ, as
    `irodori.fitting.judge` computes it from the photographs. It exceeds the inverse of the information, because the
    weights of the fit are not optimal: they include noise and model error, but not the effect of pose errors. An error
    that all photographs share, which the fit adds to the errors of α and β, is not included.
    """
    jacobian, weight = observations.jacobian, observations.weight
    seen = np.isfinite(observations.variance)
    # Without weight in the fit an observation adds to neither sum.
    variance = np.where(seen, observations.variance, 0.0)
    normal = np.einsum("pc,pci,pcj->cij", weight, jacobian, jacobian)
    middle = np.einsum("pc,pci,pcj->cij", weight**2 * variance, jacobian, jacobian)
    out = np.full(normal.shape[:2], np.inf)
    size = np.sqrt(np.einsum("cii->ci", normal))
    usable = (size > 0.0).all(axis=1) & (seen.sum(axis=0) > PARAMETERS)
    if not usable.any():
        return out
    scale = size[usable, :, None] * size[usable, None, :]
    unit = normal[usable] / scale
    usable[usable] = apart = np.linalg.det(unit) > _SINGULAR
    inverse = np.linalg.inv(unit[apart])
    covariance = inverse @ (middle[usable] / scale[apart]) @ inverse
    out[usable] = np.sqrt(np.maximum(np.einsum("cii->ci", covariance), 0.0)) / size[usable]
    return out


def shared_errors(observations: Observations, patch: np.ndarray) -> np.ndarray:
    """Return the expected relative standard errors of α, β, μ where the texels of a patch share β and μ, (cases, 3).

    What a patch tells of β and μ is the mean over its texels, seen or not: the error of the lamp in a photograph is the
    same in all of them, so that many texels tell little more than one. Texels with three photographs or fewer tell
    nothing of it. Infinite where undetermined.

    Parameters
    ----------
    observations : Observations
    patch : (t,) int
        Number of the patch to which each texel belongs, from 0.
    """
    scaled = np.where(np.isfinite(observations.variance)[..., None], observations.scaled(), 0.0)
    information = np.einsum("pci,pcj->cij", scaled, scaled).reshape(len(patch), -1, PARAMETERS, PARAMETERS)
    of_alpha = information[..., 0, 0]
    seen = of_alpha > 0.0
    mixed = information[..., 0, 1:] / np.where(seen, of_alpha, 1.0)[..., None]
    own = information[..., 1:, 1:] - np.einsum("tm,tmi,tmj->tmij", of_alpha, mixed, mixed)
    members = patch == np.arange(patch.max() + 1)[:, None]
    enough = np.isfinite(observations.variance).sum(axis=0).reshape(seen.shape) > PARAMETERS
    shared = np.einsum("gt,tm,tmij->gmij", members / members.sum(axis=1, keepdims=True), enough, own)
    size = np.einsum("gmii->gmi", shared)
    known = (size > 0.0).all(axis=-1) & (np.linalg.det(shared) > _SINGULAR * size.prod(axis=-1))
    covariance = np.full(shared.shape, np.inf)
    covariance[known] = np.linalg.inv(shared[known])
    known, covariance = known[patch] & seen, covariance[patch]
    out = np.full((*seen.shape, PARAMETERS), np.inf)
    mixed, gloss = mixed[known], covariance[known]
    of_gloss = np.einsum("ci,cij,cj->c", mixed, gloss, mixed)
    out[known, 0] = np.sqrt(1.0 / of_alpha[known] + np.maximum(of_gloss, 0.0))
    out[known, 1:] = np.sqrt(np.maximum(np.einsum("cii->ci", gloss), 0.0))
    return out.reshape(-1, PARAMETERS)
