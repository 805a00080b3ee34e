"""Planning of the poses that best determine an object's expected materials, within the rig's limits."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from irodori.capture.shot_planner.exchange import TooFewPoses, choose
from irodori.capture.shot_planner.fisher_information import (
    MODEL_ERROR,
    Materials,
    ObservationNoise,
    Observations,
    RigSubject,
    observe,
    shared_errors,
    standard_errors,
)
from irodori.config.capture_table import Pose
from irodori.config.cross_checks.object_lobes import AUTO
from irodori.config.models import AxisLimit, Camera, Config, Object, PosePlan, Rig, RigLimits, SensorOptions
from irodori.config.parts import PlannedObject
from irodori.core.errors import counted
from irodori.geometry.rig_frame import to_camera, to_light
from irodori.geometry.shapes.shape import Shape
from irodori.material.angle_errors import errors_in_use
from irodori.reflection.registry import DEFAULT_LOBES
from irodori.spectra.published import refractive_index_at

AXES = ("light_deg", "light_azimuth_deg", "camera_deg", "tilt_deg", "turn_deg")
#: Largest distance between candidates along each axis, degrees; the rig's own step where that is larger.
COARSE_DEG = {"light_deg": 5.0, "light_azimuth_deg": 45.0, "camera_deg": 2.0, "tilt_deg": 15.0, "turn_deg": 45.0}
#: Distances for curved shapes, which show many normals at once: neighbouring poses differ little, and turns matter.
SPHERE_COARSE_DEG = COARSE_DEG | {"light_deg": 15.0, "camera_deg": 10.0}
#: The same where the lamp also stands beside the plane of the camera, which makes eight times as many candidates.
SIDEWAYS_COARSE_DEG = SPHERE_COARSE_DEG | {"camera_deg": 20.0, "tilt_deg": 45.0}
#: Smallest angle between lamp and camera, degrees, if the rig states none.
_CLEARANCE_DEG = 5.0
_SPHERE_TEXELS = 64
_FLAT_MATERIALS, _SPHERE_MATERIALS = 40, 16
_PRIOR_RELATIVE_ERROR = 1.0  # of each parameter before any photograph: known to a factor of e
_TOLERANCE_DEG = 1e-6
#: Number of patches of a curved surface that may have different paints.
_PATCHES = 16
#: Relative standard errors from which the fit reports β and μ as not known.
KNOWN_RELATIVE_ERROR = {"beta": 0.3, "mu": 0.2}


@dataclass(frozen=True)
class MaterialRange:
    """Range of the materials that an object may have.

    Parameters
    ----------
    alpha, beta, mu_rad : (2,) tuple of float
        Smallest and largest value; α is spread evenly in between, β and μ evenly in their logarithms. μ is in the unit
        of the lobe.
    n, k : float
        Complex refractive index in the green band.
    lobes : tuple of str
        Lobes of the object's gloss components. With two, half of the materials have either lobe alone, see
        `irodori.capture.shot_planner.fisher_information`.
    """

    alpha: tuple[float, float] = PosePlan.alpha
    beta: tuple[float, float] = PosePlan.beta
    mu_rad: tuple[float, float] = PosePlan.mu_rad
    n: float = 1.5
    k: float = 0.0
    lobes: tuple[str, ...] = DEFAULT_LOBES

    @property
    def parameters(self) -> int:
        """Number of parameters of a texel's fit: α, and β and μ of each component."""
        return 1 + 2 * len(self.lobes)

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "mu_rad"):
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise ValueError(f"plan.{name} [{low:g}, {high:g}]; accepted: two numbers above 0, the smaller first")

    @classmethod
    def from_definition(cls, definition: Object | PlannedObject) -> "MaterialRange":
        """Return the range of an object's validated definition: ``plan``, ``refractive_index`` and ``lobes``.

        If the lobes are to be chosen from photographs, the lobe of equation (5) is assumed.
        """
        n, k = refractive_index_at(definition.refractive_index)
        plan, lobes = definition.plan, DEFAULT_LOBES if AUTO in definition.lobes else definition.lobes
        return cls(alpha=plan.alpha, beta=plan.beta, mu_rad=plan.mu_rad, n=n, k=k, lobes=lobes)

    def at(self, unit: np.ndarray) -> Materials:
        """Return the materials at points of the unit cube, (m, 3), which spans the range."""
        (a0, a1), (b0, b1), (m0, m1) = self.alpha, self.beta, self.mu_rad
        return Materials(
            alpha=a0 + unit[:, 0] * (a1 - a0),
            beta=b0 * (b1 / b0) ** unit[:, 1],
            mu=m0 * (m1 / m0) ** unit[:, 2],
            n=self.n,
            k=self.k,
            lobes=self.lobes,
        )

    def spread(self, count: int) -> Materials:
        """Return materials that fill the range evenly: a Halton sequence, which is always the same."""
        return self.at(_halton(count))


def _halton(count: int) -> np.ndarray:
    """Return the first points of the Halton sequence after the origin, (count, 3).

    They are those of `scipy.stats.qmc.Halton`, whose package takes most of a second to import.
    """
    out = np.zeros((count, 3))
    for column, base in enumerate((2, 3, 5)):
        left, share = np.arange(1, count + 1), 1.0
        while left.any():
            share /= base
            out[:, column] += share * (left % base)
            left //= base
    return out


@dataclass(frozen=True)
class Plan:
    """Chosen poses, and the errors that are expected of a fit to their photographs.

    Parameters
    ----------
    poses : list of Pose
        In the order of their manual steps: by placement, place of the light and tilt, then turn, then camera angle.
    expected : dict
        {parameter: (median, 95th percentile) of the standard error} over the determined cases of the range: ``alpha``
        absolute, ``beta`` and ``mu`` relative.
    determined_fraction : float
        Share of cases (materials on texels) with β and μ that a fit would report as known, see KNOWN_RELATIVE_ERROR; of
        a curved shape those of a patch of the surface together.
    """

    poses: list[Pose]
    expected: dict[str, tuple[float, float]]
    determined_fraction: float

    def lines(self) -> list[str]:
        """Return the plan as text: one line for each setting by hand and turn, and one for each expected error."""
        groups: dict[tuple, list[str]] = {}
        for pose in self.poses:
            key = pose.placement, *_hand(pose), pose.turn_deg
            groups.setdefault(key, []).append(f"{pose.camera_deg:g}")
        several = any(pose.placement > 1 for pose in self.poses)
        sideways = any(pose.light_azimuth_deg for pose in self.poses)
        out = [
            (f"placement {placement}, " if several else "")
            + f"light {light:g}, "
            + (f"azimuth {azimuth:g}, " if sideways else "")
            + f"tilt {tilt:g}, turn {turn:g}: camera {', '.join(cameras)} degrees"
            for (placement, light, azimuth, tilt, turn), cameras in groups.items()
        ]
        return out + self.expectations()

    def expectations(self) -> list[str]:
        """Return the expected errors of a fit to the photographs as lines of text."""
        out = []
        for name, (median, p95) in self.expected.items():
            kind = "absolute" if name == "alpha" else "relative"
            out.append(f"expected standard error of {name}, {kind}: median {median:.2g}, 95th percentile {p95:.2g}")
        return [*out, f"{self.determined_fraction:.0%} of materials and texels determined"]


def subject_of(definition: Object | PlannedObject, rig: Rig) -> RigSubject:
    """Return sample texels of an object on the rig, for which poses are planned.

    Parameters
    ----------
    definition : Object or PlannedObject
    rig : Rig
    """
    shape = Shape.from_definition(definition.shape)
    position, normal = shape.samples(_SPHERE_TEXELS)
    further_deg = tuple(one.rotation_deg for one in definition.placements)
    return RigSubject(shape, position, normal, rig.camera_distance_mm, rig.table_radius_mm, further_deg)


def patches(position: np.ndarray, count: int = _PATCHES) -> np.ndarray:
    """Return the number of the patch of each texel, (t,) int: patches about as far from each other as possible.

    Parameters
    ----------
    position : (t, 3) float
        Object frame, mm.
    count : int
        Largest number of patches.
    """
    distance = np.linalg.norm(position[:, None] - position[None], axis=-1)
    middles = [0]
    while len(middles) < min(count, len(position)):
        middles.append(int(np.argmax(distance[middles].min(axis=0))))
    return np.argmin(distance[middles], axis=0)


def axis_angles(limit: AxisLimit, coarse_deg: float) -> np.ndarray:
    """Return angles of an axis, degrees, from its smallest in multiples of its step, about `coarse_deg` apart.

    Parameters
    ----------
    limit : AxisLimit
    coarse_deg : float
        Largest distance between two angles; one step of the axis if that is larger.
    """
    step = limit.step * max(1, math.floor(coarse_deg / limit.step + _TOLERANCE_DEG))
    count = math.floor((limit.max - limit.min) / step + _TOLERANCE_DEG) + 1
    # Multiples of steps such as 0.1 have rounding errors in their last digits.
    return np.round(limit.min + step * np.arange(count), 9)


def candidate_poses(limits: RigLimits, coarse_deg: Mapping[str, float], clearance_deg: float) -> list[Pose]:
    """Return the poses of a rig on a coarse grid of its steps in which the camera does not block the light.

    Parameters
    ----------
    limits : RigLimits
    coarse_deg : dict
        Distance of the candidates along each axis of AXES that the rig has, degrees.
    clearance_deg : float
        Smallest angle between the directions to the light and to the camera, degrees.

    Raises
    ------
    ValueError
        If `coarse_deg` lacks an axis or has an unknown one; the message lists the axes.
    """
    given = limits.given()
    if not set(given) <= set(coarse_deg) <= set(AXES):
        raise ValueError(f"coarse_deg for {', '.join(coarse_deg) or 'nothing'}; accepted: {', '.join(given)}")
    angles = {axis: axis_angles(limit, coarse_deg[axis]).tolist() for axis, limit in given.items()}
    # Angles that differ by a whole turn are one place, which has the smallest of them.
    falling = sorted(angles.get("light_azimuth_deg", [0.0]), key=abs, reverse=True)
    azimuths = {angle % 360.0: angle for angle in falling}
    away = math.cos(math.radians(clearance_deg)) + 1e-12
    places = itertools.product(angles["light_deg"], angles["camera_deg"], sorted(azimuths.values()))
    seen = [Pose(light, camera, light_azimuth_deg=azimuth) for light, camera, azimuth in places]
    return [
        replace(pose, tilt_deg=tilt, turn_deg=turn)
        for pose in seen
        if float(to_light(pose) @ to_camera(pose)) <= away
        for tilt in angles["tilt_deg"]
        for turn in angles["turn_deg"]
    ]


def open_poses(
    shape: Shape, limits: RigLimits, clearance_deg: float = _CLEARANCE_DEG, coarse_deg: Mapping | None = None
) -> list[Pose]:
    """Return the candidate poses for a shape, by default on a grid for its kind.

    A flat shape is not turned, and is lit in the camera's plane, where the mirror direction is, if the rig can do so.
    """
    azimuth = limits.light_azimuth_deg
    if not shape.is_flat:
        usual = SPHERE_COARSE_DEG if azimuth is None else SIDEWAYS_COARSE_DEG
        return candidate_poses(limits, coarse_deg or usual, clearance_deg)
    if azimuth is not None and azimuth.min <= 0.0 <= azimuth.max:
        azimuth = None
    still = replace(limits.turn_deg, max=limits.turn_deg.min)
    flat = replace(limits, turn_deg=still, light_azimuth_deg=azimuth)
    return candidate_poses(flat, coarse_deg or COARSE_DEG, clearance_deg)


class StatedErrors(Protocol):
    """Errors that a fit assumes, as in the configuration's block ``fit`` or in the options of a fit."""

    @property
    def model_error(self) -> float:
        """Relative error of an observation apart from noise."""

    @property
    def pose_error_deg(self) -> Literal["auto"] | float:
        """Standard deviation of the angle of light or camera, degrees; ``auto`` leaves it to registration."""


def default_noise(
    rig: Rig, sensor: SensorOptions | None = None, exposures_s=(), fit: StatedErrors | None = None
) -> ObservationNoise:
    """Return the noise that the definitions of a rig and its camera state, otherwise the noise that the fit assumes.

    Parameters
    ----------
    rig : Rig
        Light drift and pose error are those of its ``virtual.imperfections``, if it has them.
    sensor : SensorOptions, optional
        Sensor of a virtual camera.
    exposures_s : sequence of float
        Exposure times of the photographs without the filter, s.
    fit : StatedErrors, optional
        Assumed errors for a rig whose definition does not state them.
    """
    own = {}
    if fit is not None:
        pose_rms_deg = errors_in_use(fit.pose_error_deg, None).rig_deg
        own = {"relative": fit.model_error, "pose_rms_deg": pose_rms_deg}
    if rig.virtual is not None:
        drift, pose = rig.virtual.imperfections.light_drift, rig.virtual.imperfections.pose_error
        own = {
            "relative": drift.relative_rms if drift.enabled else 0.0,
            "pose_rms_deg": pose.rms_deg if pose.enabled else 0.0,
        }
    return ObservationNoise(**own) if sensor is None else ObservationNoise.of_sensor(sensor, exposures_s, **own)


def as_fitted(config: Config, rig: Rig, definition: Object | None = None, camera: Camera | None = None) -> dict:
    """Return noise, model error and largest angle of observations as the fit of a configuration has them.

    They are the parameters ``noise``, ``model_error`` and ``max_angle_deg`` of `Planner` and of
    `irodori.capture.shot_planner.fisher_information.observe`.

    Parameters
    ----------
    config : Config
    rig : Rig
    definition : Object, optional
        Object with the exposure times of a virtual camera.
    camera : Camera, optional
        Camera whose sensor, if it is a virtual one, determines the noise.
    """
    fit, sensor = config.fit, camera.virtual.sensor if camera and camera.virtual else None
    exposures_s = definition.exposure_s.out if sensor and definition and definition.exposure_s else ()
    return {
        "noise": default_noise(rig, sensor, exposures_s, fit),
        "model_error": fit.model_error,
        "max_angle_deg": config.rectify.max_angle_deg,
    }


class Planner:
    """Planner of poses for an object on a rig; it evaluates all candidates once, for plans with any number of poses.

    Parameters
    ----------
    definition : Object or PlannedObject
    rig : Rig
    materials : MaterialRange, optional
        By default that of the object.
    noise : ObservationNoise, optional
        By default `default_noise` of the rig.
    max_angle_deg : float
        ``rectify.max_angle_deg``: observations beyond this angle are not used, degrees.
    coarse_deg : dict, optional
        See `candidate_poses`; the time is proportional to the number of candidates.
    model_error : float
        As ``fit.model_error``, ratio.

    Attributes
    ----------
    poses : list of Pose
        Candidates in which a part of the object is lit and seen.
    """

    def __init__(
        self,
        definition: Object | PlannedObject,
        rig: Rig,
        *,
        materials: MaterialRange | None = None,
        noise: ObservationNoise | None = None,
        max_angle_deg: float = 80.0,
        coarse_deg: Mapping[str, float] | None = None,
        model_error: float = MODEL_ERROR,
    ) -> None:
        self.subject = subject_of(definition, rig)
        self.max_manual = definition.plan.max_manual
        flat = self.subject.shape.is_flat
        clearance_deg = _CLEARANCE_DEG if rig.clearance_deg is None else rig.clearance_deg
        poses = open_poses(self.subject.shape, rig.limits, clearance_deg, coarse_deg)
        if not poses:
            raise TooFewPoses(
                f"a rig whose camera never stands {clearance_deg:g} degrees from the light; accepted: some poses"
            )
        further = range(2, len(definition.placements) + 2)
        poses = poses + [replace(pose, placement=number) for number in further for pose in poses]
        self.range = materials or MaterialRange.from_definition(definition)
        self.sample = self.range.spread(_FLAT_MATERIALS if flat else _SPHERE_MATERIALS)
        self.noise = noise or default_noise(rig)
        self.max_angle_deg, self.model_error = max_angle_deg, model_error
        seen = self._observe(poses)
        useful = np.flatnonzero(np.isfinite(seen.variance).any(axis=1))
        self.poses, self.seen = [poses[i] for i in useful], seen.of(useful)

    def best(self, count: int, max_manual: int | None = None) -> Plan:
        """Choose poses; parameters, result and errors as in `plan_best`."""
        max_manual = self.max_manual if max_manual is None else max_manual
        parameters = self.range.parameters
        if count <= parameters:
            raise ValueError(
                f"{counted(count, 'pose')}; accepted: {parameters + 1} or more, for {parameters} parameters"
            )
        if max_manual < 1:
            raise ValueError(f"{max_manual} manual settings; accepted: 1 or more")
        if len(self.poses) < count:
            raise TooFewPoses(
                f"{counted(count, 'pose')}; accepted: at most the {len(self.poses)} in which the rig sees the object"
            )
        setting = np.unique([_hand(p) for p in self.poses], axis=0, return_inverse=True)[1].reshape(-1)
        position, flat = self.subject.position, self.subject.shape.is_flat
        patch = np.arange(len(position)) if flat else patches(position)
        chosen = choose(self.seen, _PRIOR_RELATIVE_ERROR**-2, setting, count, max_manual, patch)
        order = sorted(
            chosen, key=lambda i: (self.poses[i].placement, *_hand(self.poses[i]), self.poses[i].turn_deg, i)
        )
        expected, fraction = expected_errors(self.seen.of(order), self.sample, None if flat else patch)
        return Plan([self.poses[i] for i in order], expected, fraction)

    def _observe(self, poses: list[Pose]) -> Observations:
        return observe(self.subject, poses, self.sample, self.noise, self.max_angle_deg, self.model_error)


def plan_best(
    definition: Object | PlannedObject,
    rig: Rig,
    count: int | None = None,
    max_manual: int | None = None,
    **others,
) -> Plan:
    """Choose the poses that best determine α, β and μ over a range of materials.

    Poses of flat shapes have the smallest variances of α, β and μ of each texel, of which the fit needs four unclipped
    photographs. Those of curved shapes have the smallest variances with the gloss of paints: where it is known, one
    photograph tells a place's colour.

    Parameters
    ----------
    definition : Object or PlannedObject
    rig : Rig
    count : int, optional
        Number of poses, at least 4 (one more than the three parameters), or 6 for two gloss components; by default
        ``plan.count``.
    max_manual : int, optional
        Largest number of different settings of light and tilt by hand; by default ``plan.max_manual``.
    **others
        Further parameters of `Planner`: ``materials``, ``noise``, ``max_angle_deg``, ``coarse_deg``, ``model_error``.

    Returns
    -------
    Plan

    Raises
    ------
    ValueError
        For too small a count, or less than one manual setting.
    TooFewPoses
        If the rig has fewer poses than required.
    """
    planner = Planner(definition, rig, **others)
    return planner.best(definition.plan.count if count is None else count, max_manual)


def expected_errors(
    seen: Observations, materials: Materials, patch: np.ndarray | None = None
) -> tuple[dict[str, tuple[float, float]], float]:
    """Return median and 95th percentile of the standard errors of a fit, and the share of cases that are determined.

    Parameters
    ----------
    seen : Observations
        Expected observations in the poses of a design.
    materials : Materials
        Materials of the observations.
    patch : (t,) int, optional
        Number of the patch of each texel, if the texels of a patch share their gloss.

    Returns
    -------
    expected : dict
        As in `Plan`; NaN if no case is determined.
    determined_fraction : float
    """
    errors = standard_errors(seen) if patch is None else shared_errors(seen, patch)
    known = (errors[:, 1] < KNOWN_RELATIVE_ERROR["beta"]) & (errors[:, 2] < KNOWN_RELATIVE_ERROR["mu"])
    names = ("alpha", "beta", "mu")
    if not known.any():
        return dict.fromkeys(names, (math.nan, math.nan)), 0.0
    errors[:, 0] *= np.tile(materials.alpha, len(errors) // len(materials.alpha))
    median, high = np.percentile(errors[known], [50, 95], axis=0)
    return {name: (float(median[i]), float(high[i])) for i, name in enumerate(names)}, float(known.mean())


def _hand(pose: Pose) -> tuple[float, float, float]:
    """Return the angles of a pose that a person sets: light angle and azimuth, and tilt, degrees."""
    return pose.light_deg, pose.light_azimuth_deg, pose.tilt_deg
