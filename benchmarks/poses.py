"""Benchmark of planned poses: errors of fits to simulated photographs, beside as many even and random poses.

``python -m benchmarks.poses [--poses 4 6 8 12 16 24] [--materials 2000] [--output poses.csv]`` photographs random
materials of the default plate with equation (5), shot and read noise, and a virtual rig whose lamp drifts and whose
angles are off. The fit is given the nominal poses. The plan was made with a linearised model, which is not used here.
Even poses are a grid with as many light angles as a plan may have; random ones are drawn anew for each eighth of the
materials. Errors of α are absolute, those of β and μ relative.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from irodori.capture.shot_list import object_shots
from irodori.capture.shot_planner.fisher_information import Materials
from irodori.capture.shot_planner.planner import Planner, as_fitted, axis_angles
from irodori.config.capture_table import Pose
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import Camera, Object, PoseGroup, Rig, RigLimits
from irodori.evaluation.result_tables import write_rows
from irodori.fitting.solvers import FitOptions, fit
from irodori.reflection.equation5 import reflect
from irodori.simulation.virtual_rig.imperfections import Faults

ROOT = Path(__file__).resolve().parents[1]
OBJECT = "tile-plate"
POSES, MATERIALS = (4, 6, 8, 12, 16, 24), 2000
_SESSIONS = 200
_RANDOM_DRAWS = 8
_SEED = 20100401


@dataclass(frozen=True)
class PoseRow:
    """Size of one parameter's error with one design of poses, over the fits that state the parameter.

    Parameters
    ----------
    poses : int
    design, parameter : str
    median, p95 : float
    stated_fraction : float
        Share of the fits that state the parameter.
    """

    poses: int
    design: str
    parameter: str
    median: float
    p95: float
    stated_fraction: float


@dataclass(frozen=True)
class Sitting:
    """An object before a virtual rig.

    Parameters
    ----------
    definition, camera, rig : Object, Camera, Rig
    planner : Planner
        Has the range of materials, the noise and the largest angle.
    """

    definition: Object
    camera: Camera
    rig: Rig
    planner: Planner

    @classmethod
    def of_default(cls) -> "Sitting":
        """Return the sitting of the default plate."""
        loaded = load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT)
        definition = loaded.objects[OBJECT]
        camera = loaded.cameras[definition.camera]
        rig = loaded.rigs[camera.rig]
        planner = Planner(definition, rig, **as_fitted(loaded.config, rig, definition, camera))
        return cls(definition, camera, rig, planner)

    def happened(self, poses: Sequence[Pose], session: str) -> tuple[list[float], list[Pose]]:
        """Return the lamp's relative power and the true pose in the photographs without the filter of a session."""
        assert self.rig.virtual is not None
        groups = tuple(PoseGroup(**{axis: (angle,) for axis, angle in vars(pose).items()}) for pose in poses)
        shots = object_shots(replace(self.definition, poses=groups), self.camera, ".dng")
        faults = Faults(self.rig.virtual.imperfections, self.rig.virtual.seed, session, shots)
        first = {shot.pose: shot for shot in reversed(shots) if shot.filter == "out"}
        return [faults.light(first[p]) for p in poses], [faults.real_pose(first[p], p) for p in poses]

    def photograph(self, poses: list[Pose], materials: Materials, sessions: int, rng: np.random.Generator):
        """Simulate photographs and return responses, angles and weights of texels, as rectification writes them.

        Parameters
        ----------
        poses : list of Pose
        materials : Materials
            m materials, shared out evenly among the sessions; each lies on a random texel.
        sessions : int
        rng : numpy Generator

        Returns
        -------
        response : (m, J) float64
        geometry : (m, J, 4) float64
            Angles at the nominal poses, rad.
        weight : (m, J) float64
            1 where the fit may use the response, 0 elsewhere.
        """
        subject, noise, count = self.planner.subject, self.planner.noise, len(materials.alpha)
        session, texel = np.arange(count) % sessions, rng.integers(len(subject.position), size=count)
        lights, true = zip(*(self.happened(poses, f"{OBJECT} {n}") for n in range(sessions)), strict=True)
        angles = subject.geometry([pose for each in true for pose in each])
        angles = angles.reshape(sessions, len(poses), -1, 4)[session, :, texel]
        alpha, beta, mu = (v[:, None] for v in (materials.alpha, materials.beta, materials.mu))
        (lobe,), n, k = materials.lobes, materials.n, materials.k
        mean = np.array(lights)[session] * reflect(alpha, 1.0, beta, mu, angles, n=n, k=k, lobe=lobe)
        response = noise.shot_variance * rng.poisson(mean / noise.shot_variance)
        response = response + rng.normal(scale=math.sqrt(noise.read_variance), size=response.shape)
        geometry = subject.geometry(poses)
        seen = (geometry[..., :2] <= np.radians(self.planner.max_angle_deg) + 1e-9).all(axis=-1)
        seen &= subject.unobstructed(poses)
        weight = seen[:, texel].T & (response < noise.saturation_response)
        return response, geometry[:, texel].swapaxes(0, 1), weight.astype(np.float64)

    def fit_errors(self, poses: list[Pose], count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Photograph and fit random materials; return the size of each parameter's error, (count,), NaN if unstated."""
        materials, noise = self.planner.range.at(rng.random((count, 3))), self.planner.noise
        response, geometry, weight = self.photograph(poses, materials, min(_SESSIONS, count), rng)
        camera = np.tile([noise.read_variance, noise.shot_variance], (len(poses), 1))
        options = FitOptions(lobes=materials.lobes)
        found = fit(response.astype(np.float32), geometry, weight, materials.n, materials.k, options, noise=camera)
        return {
            "alpha": np.abs(found.alpha - materials.alpha),
            "beta": np.abs(found.beta / materials.beta - 1.0),
            "mu": np.abs(found.mu / materials.mu - 1.0),
        }


def even_poses(limits: RigLimits, count: int, lights: int, max_angle_deg: float) -> list[Pose]:
    """Return poses with light and camera angles at the centres of equal parts of their ranges.

    Parameters
    ----------
    limits : RigLimits
        Limits of the axes. Tilt and turn of the table stay at their smallest values.
    count : int
        Number of poses, shared out among the light angles.
    lights : int
        Number of light angles.
    max_angle_deg : float
        Largest angle of light and camera from the vertical, degrees.
    """

    def centres(axis: str, parts: int) -> list[float]:
        limit = getattr(limits, axis)
        reach = axis_angles(replace(limit, max=min(limit.max, max_angle_deg)), limit.step)
        wanted = reach[0] + (reach[-1] - reach[0]) * (np.arange(parts) + 0.5) / parts
        return [float(reach[np.abs(reach - angle).argmin()]) for angle in wanted]

    return [
        Pose(light, camera, limits.tilt_deg.min, limits.turn_deg.min)
        for index, light in enumerate(centres("light_deg", lights))
        for camera in centres("camera_deg", len(range(index, count, lights)))
    ]


def random_poses(candidates: list[Pose], count: int, max_manual: int, rng: np.random.Generator) -> list[Pose]:
    """Draw ``count`` random candidate poses that share at most ``max_manual`` settings of light and tilt."""
    settings = sorted({(pose.light_deg, pose.tilt_deg) for pose in candidates})
    chosen = [settings[i] for i in rng.choice(len(settings), size=max_manual, replace=False)]
    within = [pose for pose in candidates if (pose.light_deg, pose.tilt_deg) in chosen]
    return [within[i] for i in sorted(rng.choice(len(within), size=count, replace=False))]


def rows_of(sitting: Sitting, count: int, materials: int) -> list[PoseRow]:
    """Return the rows of all designs with ``count`` poses."""
    planner, rng = sitting.planner, np.random.default_rng(_SEED)
    manual, limits = planner.max_manual, sitting.rig.limits
    designs = {
        "planned": [planner.best(count).poses],
        "even": [even_poses(limits, count, manual, planner.max_angle_deg)],
        "random": [random_poses(planner.poses, count, manual, rng) for _ in range(_RANDOM_DRAWS)],
    }
    rows = []
    for design, drawn in designs.items():
        errors = [sitting.fit_errors(poses, max(materials // len(drawn), 1), rng) for poses in drawn]
        for parameter in errors[0]:
            off = np.concatenate([each[parameter] for each in errors])
            median, p95 = np.nanpercentile(off, [50, 95])
            stated = float(np.isfinite(off).mean())
            rows.append(PoseRow(count, design, parameter, float(median), float(p95), stated))
    return rows


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, nargs="+", default=POSES, help="numbers of poses")
    parser.add_argument("--materials", type=int, default=MATERIALS, help="random materials for each design")
    parser.add_argument("--output", type=Path, help="CSV to write")
    given = parser.parse_args()
    sitting, rows = Sitting.of_default(), []
    for count in given.poses:
        rows += rows_of(sitting, count, given.materials)
        for row in rows[-9:]:
            print(f"{count:3} poses, {row.design:>7}, {row.parameter:>5}: median {row.median:.4f}, p95 {row.p95:.4f}, "
                  f"stated by {row.stated_fraction:.1%} of the fits", flush=True)  # fmt: skip
    if given.output:
        write_rows(given.output, PoseRow, rows)


if __name__ == "__main__":
    main()
