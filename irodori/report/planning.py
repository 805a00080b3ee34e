"""Fit error against the number of photographs: planned poses, an even grid, and random poses.

The photographs are simulated with equation (5) itself, at poses that are off by the pose error, under a light that
drifts, with shot and read noise, and are fitted at the poses that were asked for. The linearisation that the plan was
made with takes no part; its expectation is reported beside the outcome.
"""

import csv
import math
import os
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from irodori.brdf import reflect
from irodori.captures import Pose
from irodori.fitting import FitOptions, fit
from irodori.geometry.shapes import PLATE, Shape
from irodori.material import Status
from irodori.progress import LOGGER
from irodori.rig.information import Materials, Noise, Subject, observe
from irodori.rig.planner import (
    COARSE_DEG,
    MaterialRange,
    axis_angles,
    default_noise,
    expected_errors,
    open_poses,
    plan_best,
    subject_of,
)

DESIGNS = ("planned", "even", "even, one light", "random")
_PARAMETERS = ("alpha", "beta", "mu")


@dataclass(frozen=True)
class Sitting:
    """How photographs are simulated.

    Parameters
    ----------
    subject : Subject
    materials : MaterialRange
    noise : Noise
    max_angle_deg : float
        ``rectify.max_angle_deg``, degrees.
    correlation_shots : float
        Photographs after which the light's drift has forgotten itself to 1/e.
    shots_per_pose : int
        Photographs of a pose, both filter states and brackets together.
    """

    subject: Subject
    materials: MaterialRange
    noise: Noise
    max_angle_deg: float = 80.0
    correlation_shots: float = 60.0
    shots_per_pose: int = 2

    def light(self, sessions: int, poses: int, rng: np.random.Generator) -> np.ndarray:
        """Return the relative power of the light, (sessions, poses): a drift of first order about 1."""
        memory = math.exp(-self.shots_per_pose / self.correlation_shots)
        out = np.empty((sessions, poses))
        state = rng.normal(size=sessions)
        for j in range(poses):
            out[:, j] = state
            state = memory * state + math.sqrt(1.0 - memory**2) * rng.normal(size=sessions)
        return 1.0 + self.noise.relative * out

    def photograph(self, poses: list[Pose], materials: Materials, sessions: int, rng: np.random.Generator):
        """Return responses, geometry and weights of texels, as rectification would hand them to the fit.

        Parameters
        ----------
        poses : list of Pose
        materials : Materials
            As many as a multiple of `sessions`; each session photographs its share on random texels.
        sessions : int
            Sittings, each with pose errors and a drift of its own.
        rng : numpy Generator

        Returns
        -------
        response : (m, J) float64
        geometry : (m, J, 4) float64, rad, of the poses asked for
        weight : (m, J) float64
        """
        count = len(materials.alpha)
        session = np.arange(count) % sessions
        texel = rng.integers(len(self.subject.position), size=count)
        off = rng.normal(scale=self.noise.pose_rms_deg, size=(sessions, len(poses), 2))
        real = [
            replace(pose, light_deg=pose.light_deg + a, camera_deg=pose.camera_deg + b)
            for row in off
            for pose, (a, b) in zip(poses, row, strict=True)
        ]
        true_geometry = self.subject.geometry(real).reshape(sessions, len(poses), -1, 4)[session, :, texel]
        alpha, beta, mu = (np.asarray(v)[:, None] for v in (materials.alpha, materials.beta, materials.mu))
        light = self.light(sessions, len(poses), rng)[session]
        mean = light * reflect(alpha, 1.0, beta, mu, true_geometry, materials.n, materials.k)
        electrons = rng.poisson(mean / self.noise.shot_variance)
        response = electrons * self.noise.shot_variance
        response = response + rng.normal(scale=math.sqrt(self.noise.read_variance), size=response.shape)
        geometry = self.subject.geometry(poses)
        frontal = (geometry[..., :2] <= np.radians(self.max_angle_deg) + 1e-9).all(axis=-1)
        frontal &= self.subject.unobstructed(poses)
        weight = frontal[:, texel].T & (response < self.noise.saturation_response)
        return response, geometry[:, texel].swapaxes(0, 1), weight.astype(np.float64)
