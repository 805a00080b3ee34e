"""Fit error against the number of photographs: planned poses, an even grid, and random poses.

The photographs are simulated with the full reflection model of equation (5), with random pose errors, a drifting light,
and shot and read noise. The fit is given the nominal poses. The plan itself was made with a linearised model, which is
not used in the simulation; the standard errors that it expects are reported beside the errors found.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from irodori.capture.shot_planner.exchange import TooFewPoses
from irodori.capture.shot_planner.fisher_information import Materials, Weighting
from irodori.capture.shot_planner.planner import Planner, axis_angles, default_noise
from irodori.config.capture_table import Pose
from irodori.config.models import Planning, RigLimits
from irodori.config.parts import PlannedPlate
from irodori.core.progress import LOGGER
from irodori.evaluation.result_tables import PlanRow, write_rows
from irodori.fitting.solvers import FitOptions, fit
from irodori.reflection.equation5 import reflect

_SEED = 20100401
_SESSIONS = 200
_RANDOM_DRAWS = 8
_RELATIVE = {"alpha": False, "beta": True, "mu": True}


@dataclass(frozen=True)
class Sitting:
    """Conditions of the simulated photographs.

    Parameters
    ----------
    planner : Planner
        Planner of the poses; provides the object, the range of its materials, the noise and the largest angle.
    correlation_shots : float
        Number of photographs over which the correlation of the light's drift falls to 1/e.
    shots_per_pose : int
        Photographs at each pose: both filter states and all exposures of a bracket.
    """

    planner: Planner
    correlation_shots: float = 60.0
    shots_per_pose: int = 2

    def light(self, sessions: int, poses: int, rng: np.random.Generator) -> np.ndarray:
        """Draw the relative power of the light, (sessions, poses): a first-order autoregressive drift about 1."""
        memory = math.exp(-self.shots_per_pose / self.correlation_shots)
        out = np.empty((sessions, poses))
        state = rng.normal(size=sessions)
        for j in range(poses):
            out[:, j] = state
            state = memory * state + math.sqrt(1.0 - memory**2) * rng.normal(size=sessions)
        return 1.0 + self.planner.noise.relative * out

    def photograph(self, poses: list[Pose], materials: Materials, sessions: int, rng: np.random.Generator):
        """Simulate photographs and return responses, geometry and weights of texels, as rectification writes them.

        Parameters
        ----------
        poses : list of Pose
        materials : Materials
            m materials, shared out evenly among the sessions; each lies on a random texel.
        sessions : int
            Sessions, each with its own pose errors and drift.
        rng : numpy Generator

        Returns
        -------
        response : (m, J) float64
        geometry : (m, J, 4) float64
            Angles at the nominal poses, rad.
        weight : (m, J) float64
            1 where the fit may use the response, 0 elsewhere.
        """
        count = len(materials.alpha)
        session = np.arange(count) % sessions
        texel = rng.integers(len(self.planner.subject.position), size=count)
        off = rng.normal(scale=self.planner.noise.pose_rms_deg, size=(sessions, len(poses), 2))
        real = [
            replace(pose, light_deg=pose.light_deg + a, camera_deg=pose.camera_deg + b)
            for row in off
            for pose, (a, b) in zip(poses, row, strict=True)
        ]
        true_geometry = self.planner.subject.geometry(real).reshape(sessions, len(poses), -1, 4)[session, :, texel]
        alpha, beta, mu = (np.asarray(v)[:, None] for v in (materials.alpha, materials.beta, materials.mu))
        light = self.light(sessions, len(poses), rng)[session]
        clean = np.empty(true_geometry.shape[:2])
        for name, of in materials.of_lobes():
            clean[of] = reflect(
                alpha[of], 1.0, beta[of], mu[of], true_geometry[of], n=materials.n, k=materials.k, lobe=name
            )
        mean = light * clean
        electrons = rng.poisson(mean / self.planner.noise.shot_variance)
        response = electrons * self.planner.noise.shot_variance
        response = response + rng.normal(scale=math.sqrt(self.planner.noise.read_variance), size=response.shape)
        geometry = self.planner.subject.geometry(poses)
        frontal = (geometry[..., :2] <= np.radians(self.planner.max_angle_deg) + 1e-9).all(axis=-1)
        frontal &= self.planner.subject.unobstructed(poses)
        weight = frontal[:, texel].T & (response < self.planner.noise.saturation_response)
        return response, geometry[:, texel].swapaxes(0, 1), weight.astype(np.float64)


def even_poses(limits: RigLimits, count: int, lights: int, max_angle_deg: float) -> list[Pose]:
    """Return poses on an even grid: light and camera angles at the centres of equal parts of their ranges.

    Parameters
    ----------
    limits : RigLimits
        Limits of the axes. Tilt and turn of the table stay at their smallest values.
    count : int
        Number of poses, shared out among the light angles.
    lights : int
        Number of light angles, at most `count`.
    max_angle_deg : float
        Largest angle of light and camera from the vertical, degrees.

    Raises
    ------
    TooFewPoses
        If the steps of the rig are so coarse that two poses coincide.
    """

    def centres(axis: str, parts: int) -> list[float]:
        limit = getattr(limits, axis)
        reach = axis_angles(replace(limit, max=min(limit.max, max_angle_deg)), limit.step)
        wanted = reach[0] + (reach[-1] - reach[0]) * (np.arange(parts) + 0.5) / parts
        return [float(reach[np.abs(reach - angle).argmin()]) for angle in wanted]

    lights = min(lights, count)
    tilt, turn = limits.tilt_deg.min, limits.turn_deg.min
    poses = [
        Pose(light, camera, tilt, turn)
        for index, light in enumerate(centres("light_deg", lights))
        for camera in centres("camera_deg", len(range(index, count, lights)))
    ]
    if len(set(poses)) < count:
        raise TooFewPoses(f"an even grid of {count} poses; accepted: at most the steps of the rig")
    return poses


def random_poses(candidates: list[Pose], count: int, max_manual: int, rng: np.random.Generator) -> list[Pose]:
    """Draw ``count`` random candidate poses that share at most ``max_manual`` settings of light and tilt.

    Raises
    ------
    TooFewPoses
        If the settings drawn have fewer candidates.
    """
    settings = sorted({(pose.light_deg, pose.tilt_deg) for pose in candidates})
    drawn = rng.choice(len(settings), size=min(max_manual, len(settings)), replace=False)
    chosen = {settings[i] for i in drawn}
    within = [pose for pose in candidates if (pose.light_deg, pose.tilt_deg) in chosen]
    if len(within) < count:
        raise TooFewPoses(f"{count} random poses; accepted: at most {len(within)}")
    return [within[i] for i in sorted(rng.choice(len(within), size=count, replace=False))]


def fit_errors(sitting: Sitting, poses: list[Pose], count: int, options: FitOptions, rng) -> dict[str, np.ndarray]:
    """Simulate and fit ``count`` random materials; return the absolute error of each parameter, (count,).

    Errors of ``beta`` and ``mu`` are relative to the true value. An error is NaN where the fit does not state the
    parameter.
    """
    materials = sitting.planner.range.at(rng.random((count, 3)))
    response, geometry, weight = sitting.photograph(poses, materials, min(_SESSIONS, count), rng)
    noise = sitting.planner.noise
    camera = np.tile([noise.read_variance, noise.shot_variance], (len(poses), 1))
    # Single precision, as photographs have: the loops of the fit are already compiled for it.
    response = response.astype(np.float32)
    out = {name: np.empty(count) for name in _RELATIVE}
    for lobe, of in materials.of_lobes():
        own = replace(options, lobes=(lobe,))
        result = fit(response[of], geometry[of], weight[of], materials.n, materials.k, own, noise=camera)
        for name, relative in _RELATIVE.items():
            truth = getattr(materials, name)[of]
            out[name][of] = np.abs(getattr(result, name) - truth) / (truth if relative else 1.0)
    return out


def measure_design(
    name: str, design: str, drawn: list, sitting: Sitting, *, count: int, options: FitOptions, rng: np.random.Generator
) -> list[PlanRow]:
    """Return the rows of one design; if it has several random draws, they share the materials and are pooled."""
    share = max(count // len(drawn), 1)
    errors = [fit_errors(sitting, poses, share, options, rng) for poses in drawn]
    expected = [sitting.planner.expected(poses) for poses in drawn]
    rows = []
    for parameter in _RELATIVE:
        pooled = np.concatenate([e[parameter] for e in errors])
        known = pooled[np.isfinite(pooled)]
        median, p95 = np.percentile(known, [50, 95]) if known.size else (np.nan, np.nan)
        promised = [e[parameter][0] for e in expected if np.isfinite(e[parameter][0])]
        rows.append(
            PlanRow(
                name,
                len(drawn[0]),
                design,
                parameter,
                float(median),
                float(p95),
                known.size / pooled.size,
                float(np.median(promised)) if promised else math.nan,
            )
        )
        LOGGER.info("%s, %d poses, %s, %s: median %.4g p95 %.4g known %.1f%%", name, len(drawn[0]), design, parameter,
                    median, p95, 100 * rows[-1].identified_fraction)  # fmt: skip
    return rows


def measure_object(name: str, planned: PlannedPlate, options: FitOptions, max_angle_deg: float, settings: Planning):
    """Yield the rows of ``planning.csv`` for one plate.

    Parameters
    ----------
    name : str
    planned : PlannedPlate
    options : FitOptions
    max_angle_deg : float
    settings : Planning
    """
    definition, rig = planned.definition, planned.rig
    planner = Planner(
        definition,
        rig,
        noise=default_noise(rig, planned.sensor, planned.exposures_s, options),
        max_angle_deg=max_angle_deg,
        weighting=Weighting(options.weights, options.model_error),
    )
    faults = rig.virtual.imperfections if rig.virtual else None
    memory = faults.light_drift.correlation_shots if faults else Sitting.correlation_shots
    sitting = Sitting(planner, memory, planned.shots_per_pose)
    rng = np.random.default_rng(_SEED)
    limits, manual = rig.limits, planner.max_manual
    designs = {
        "planned": lambda count: [planner.best(count).poses],
        "even-grid": lambda count: [even_poses(limits, count, manual, max_angle_deg)],
        "even-one-light": lambda count: [even_poses(limits, count, 1, max_angle_deg)],
        "random": lambda count: [random_poses(planner.poses, count, manual, rng) for _ in range(_RANDOM_DRAWS)],
    }
    for count in settings.poses:
        for design, draw in designs.items():
            try:
                drawn = draw(count)
            except TooFewPoses as error:
                LOGGER.warning("%s, %d poses, %s: left out, %s", name, count, design, error)
                continue
            yield from measure_design(name, design, drawn, sitting, count=settings.materials, options=options, rng=rng)


def measure_plan(
    name: str, planned: PlannedPlate, options: FitOptions, max_angle_deg: float, settings: Planning, output
) -> None:
    """Write ``planning.csv``: fit errors against the number of poses for a flat object.

    Parameters
    ----------
    name : str
        Name of the object.
    planned : PlannedPlate
    options : FitOptions
    max_angle_deg : float
        ``rectify.max_angle_deg``.
    settings : Planning
    output : path
    """
    write_rows(output, PlanRow, measure_object(name, planned, options, max_angle_deg, settings))
