"""What photographs in a pose tell about α, β and μ of equation (5): Fisher information, and the errors of a fit.

The parameters are (ln α, ln β, ln μ), so that their errors are relative. The determinant of the information then has
no unit: other units of light or angle multiply a material's parameters, which moves their logarithms and leaves the
derivatives as they are. Any other scale fixed for each material would shift the criterion by a constant and choose the
same poses; a sum of variances, though, depends on the scale, and relative errors of β and μ are what the report states.

A *case* is one material on one texel; cases run over texels first: case = texel * materials + material.
"""

import math
from dataclasses import dataclass, replace

import numba
import numpy as np

from irodori.config.capture_table import Pose
from irodori.config.models import SensorOptions
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rig_from_object, to_camera, to_light
from irodori.geometry.shapes import Shape, on_table
from irodori.jit.native import njit
from irodori.reflection.equation5 import angles_from_directions, gloss_factors

PARAMETERS = 3
_OFFSET_MM = 1e-3
_SINGULAR = 1e-10  # determinant, scaled to a unit diagonal, under which parameters cannot be told apart


@dataclass(frozen=True)
class Noise:
    """Variance of one observation ρ: shot and read noise, and the errors that the model of the rig leaves.

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
        An observation from this response on is clipped and tells nothing; infinite where brackets reach every response.
    """

    read_variance: float = 6e-8
    shot_variance: float = 4e-5
    relative: float = 0.01
    pose_rms_deg: float = 0.05
    saturation_response: float = math.inf

    @classmethod
    def of_sensor(cls, sensor: SensorOptions, exposures_s=(), **others) -> "Noise":
        """Return the noise of a camera's ``virtual.sensor`` block for its brightest band.

        Parameters
        ----------
        sensor : SensorOptions
        exposures_s : sequence of float
            Exposure times of a bracket, s; the longest sets the noise and the shortest what saturates. The base
            exposure where empty.
        **others
            Further fields.
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


@dataclass(frozen=True)
class Weighting:
    """How the fit weighs an observation: by the inverse of the variance that it expects, or not at all.

    Parameters
    ----------
    weights : str
        ``noise``: 1 / (c0 + c1 ρ + (model error · ρ)²); ``equal``. As ``fit.weights``.
    model_error : float
        As ``fit.model_error``, ratio.

    Raises
    ------
    ValueError
        For other weights.
    """

    weights: str = "noise"
    model_error: float = 0.01

    def __post_init__(self) -> None:
        if self.weights not in ("noise", "equal"):
            raise ValueError(f"weights {self.weights!r}; accepted: noise, equal")


#: The fit's own where the configuration says nothing.
WEIGHTING = Weighting()


@dataclass(frozen=True)
class Materials:
    """Materials to tell apart.

    Parameters
    ----------
    alpha, beta, mu : (m,) float
        Weights, at least 0; roughness in rad, above 0.
    n, k : float
        Complex refractive index n + ik of all.
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    n: float = 1.5
    k: float = 0.0

    def parameters(self) -> np.ndarray:
        """Return α, β, μ as (m, 3) float64."""
        return np.stack(np.broadcast_arrays(self.alpha, self.beta, self.mu), axis=-1).astype(np.float64)


@dataclass(frozen=True)
class Subject:
    """Texels of an object on the rig's table.

    Parameters
    ----------
    shape : Shape
    position, normal : (t, 3) float
        Object frame, mm and unit vectors.
    camera_distance_mm : float
    table_radius_mm : float
        Half the side of the table's top, 0 for none.
    """

    shape: Shape
    position: np.ndarray
    normal: np.ndarray
    camera_distance_mm: float
    table_radius_mm: float = 0.0

    def geometry(self, poses: list[Pose]) -> np.ndarray:
        """Return θ_i, θ_r, θ_H, φ of every texel in every pose, (poses, t, 4) rad."""
        turned = {(pose.tilt_deg, pose.turn_deg): rig_from_object(pose) for pose in poses}
        rotation = np.array([turned[pose.tilt_deg, pose.turn_deg] for pose in poses])
        normal = np.einsum("pij,tj->pti", rotation, self.normal)
        light = np.array([to_light(pose) for pose in poses])[:, None]
        view = self.camera_distance_mm * np.array([to_camera(pose) for pose in poses])[:, None]
        view = view - np.einsum("pij,tj->pti", rotation, self.position)
        return angles_from_directions(normal, light, view / np.linalg.norm(view, axis=-1, keepdims=True))

    def unobstructed(self, poses: list[Pose]) -> np.ndarray:
        """Return whether neither object nor table stands between a texel and the light or the camera, (poses, t)."""
        out = np.empty((len(poses), len(self.position)), dtype=bool)
        groups: dict[tuple, list[int]] = {}
        for index, pose in enumerate(poses):
            groups.setdefault((pose.tilt_deg, pose.turn_deg), []).append(index)
        for group in groups.values():
            rotation = rig_from_object(poses[group[0]])
            tracer = Tracer(on_table(self.shape, rotation, self.table_radius_mm))
            start = (self.position + _OFFSET_MM * self.normal) @ rotation.T
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


@dataclass(frozen=True)
class Observations:
    """What each pose would show of each case.

    Parameters
    ----------
    jacobian : (poses, cases, 3) float64
        ∂ρ / ∂(ln α, ln β, ln μ); zero where there is nothing to observe.
    variance : (poses, cases) float64
        Of ρ; infinite where there is nothing to observe.
    response : (poses, cases) float64
        ρ, zero where there is nothing to observe.
    weight : (poses, cases) float64
        That of the fit; zero where there is nothing to observe.
    """

    jacobian: np.ndarray
    variance: np.ndarray
    response: np.ndarray
    weight: np.ndarray

    def of(self, chosen) -> "Observations":
        """Return the observations of chosen poses."""
        chosen = np.asarray(chosen)
        return Observations(self.jacobian[chosen], self.variance[chosen], self.response[chosen], self.weight[chosen])

    def scaled(self) -> np.ndarray:
        """Return the Jacobian over the standard deviation, (poses, cases, 3): row · rowᵀ is the information."""
        return self.jacobian / np.sqrt(self.variance)[..., None]


def observe(
    subject: Subject,
    poses: list[Pose],
    materials: Materials,
    noise: Noise,
    max_angle_deg: float = 80.0,
    weighting: Weighting = WEIGHTING,
) -> Observations:
    """Return what each pose would show of each texel with each material.

    Parameters
    ----------
    subject : Subject
    poses : list of Pose
    materials : Materials
    noise : Noise
    max_angle_deg : float
        Observations with θ_i or θ_r beyond it carry no weight in the fit and tell nothing here, degrees.
    weighting : Weighting
        How the fit will weigh them.

    Returns
    -------
    Observations

    Notes
    -----
    The pose error enters as the mean square change of ρ when the light, then the camera, moves by one standard
    deviation to either side. To first order this is (∂ρ/∂θ σ)²; at the lobe's top, where the derivative is zero, the
    curvature remains. Observations on steep flanks are therefore not taken for better than they are.
    """
    shifts = [("light_deg", -1), ("light_deg", 1), ("camera_deg", -1), ("camera_deg", 1)]
    moved = [poses] + [
        [replace(pose, **{axis: getattr(pose, axis) + sign * noise.pose_rms_deg}) for pose in poses]
        for axis, sign in shifts
    ]
    geometry = np.stack([subject.geometry(group) for group in moved], axis=2)  # (poses, t, 5, 4)
    limit = np.radians(max_angle_deg) + 1e-9
    seen = (geometry[:, :, 0, :2] <= limit).all(axis=-1) & subject.unobstructed(poses)
    # Beyond the horizon there is no light: the cosine of a moved pose must not turn negative.
    cosine = np.cos(np.minimum(geometry[..., 0], np.pi / 2))
    gloss = gloss_factors(np.ascontiguousarray(geometry), float(materials.n), float(materials.k))
    parameters = materials.parameters()
    cases = geometry.shape[1] * len(parameters)
    shape = (len(poses), cases)
    out = Observations(np.zeros((*shape, PARAMETERS)), np.full(shape, np.inf), np.zeros(shape), np.zeros(shape))
    phi = np.ascontiguousarray(geometry[..., 3])
    spread = (noise.read_variance, noise.shot_variance, noise.relative, noise.saturation_response)
    # Without weights of its own the fit takes all variances for one.
    expected = weighting.model_error if weighting.weights == "noise" else -1.0
    filled = out.jacobian, out.variance, out.response, out.weight
    _fill(cosine, gloss, phi, seen, parameters, spread, expected, *filled)
    return out


@njit(cache=True)
def _rough(alpha, beta, mu, cosine, gloss, phi):
    """Return the gloss and the sum of the rough terms of equation (5)."""
    ratio = phi / mu
    lobe = beta * gloss * math.exp(-ratio * ratio)
    return lobe, alpha * cosine + lobe


@njit(cache=True)
def _fill_pose(cosine, gloss, phi, seen, parameters, spread, expected, jacobian, variance, response, weight):
    read, shot, relative, saturation = spread
    materials = parameters.shape[0]
    for t in range(seen.size):
        if not seen[t]:
            continue
        for m in range(materials):
            alpha, beta, mu = parameters[m, 0], parameters[m, 1], parameters[m, 2]
            lobe, total = _rough(alpha, beta, mu, cosine[t, 0], gloss[t, 0], phi[t, 0])
            if total >= saturation:
                continue
            case = t * materials + m
            shift = 0.0
            for s in range(1, 5):
                _, moved = _rough(alpha, beta, mu, cosine[t, s], gloss[t, s], phi[t, s])
                shift += 0.5 * (moved - total) ** 2
            jacobian[case, 0] = alpha * cosine[t, 0]
            jacobian[case, 1] = lobe
            jacobian[case, 2] = 2.0 * lobe * (phi[t, 0] / mu) ** 2
            variance[case] = read + shot * total + (relative * total) ** 2 + shift
            response[case] = total
            weight[case] = 1.0 / (read + shot * total + (expected * total) ** 2) if expected >= 0.0 else 1.0


@njit(cache=True, parallel=True, nogil=True)
def _fill(cosine, gloss, phi, seen, parameters, spread, expected, jacobian, variance, response, weight):
    for p in numba.prange(seen.shape[0]):
        _fill_pose(
            cosine[p], gloss[p], phi[p], seen[p], parameters, spread, expected,
            jacobian[p], variance[p], response[p], weight[p],
        )  # fmt: skip


def information(observations: Observations) -> np.ndarray:
    """Return the Fisher information about (ln α, ln β, ln μ) of all poses together, (cases, 3, 3).

    Observations are taken for independent, so that information adds. The drift of a lamp is not: it forgets itself
    over some sixty photographs and moves those of one session together, which changes α and β alike and μ hardly.
    """
    rows = observations.scaled()
    return np.einsum("pci,pcj->cij", rows, rows)


def standard_errors(observations: Observations) -> np.ndarray:
    """Return the expected relative standard errors of α, β, μ of the fit, (cases, 3); infinite where undetermined.

    With the weights w of the fit of equation (7) its covariance is N⁻¹ (Σ w² v J Jᵀ) N⁻¹ with N = Σ w J Jᵀ, as
    `irodori.fitting.judge` computes it from the photographs. It is more than the inverse of the information by what the
    best weights would gain: those of the fit know noise and model error, but not what an error of the pose does. An
    error that all photographs share, which the fit adds to those of α and β, is not in it.
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
