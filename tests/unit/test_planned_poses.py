"""Planned poses beside even and random ones: errors of fits to simulated photographs, see `benchmarks.poses`."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import poses
from benchmarks.poses import Sitting, even_poses, random_poses, rows_of
from irodori.capture.shot_planner.fisher_information import observe
from irodori.config.models import AxisLimit

COUNTS = (6, 8, 16)


@pytest.fixture(scope="module")
def sitting():
    return Sitting.of_default()


@pytest.fixture(scope="module")
def rows(sitting):
    return {(row.poses, row.design, row.parameter): row for count in COUNTS for row in rows_of(sitting, count, 1000)}


@pytest.mark.parametrize("other", ["even", "random"])
def test_planned_poses_beat_as_many_others(rows, other):
    # Measured with 2000 materials: 8 planned poses leave 95th percentiles of 0.044 in β and 0.026 in μ, an even grid
    # 0.111 and 0.075.
    for count in COUNTS:
        for parameter in ("beta", "mu"):
            plan, rival = rows[count, "planned", parameter], rows[count, other, parameter]
            # With sixteen poses the even ones state a hundredth more: strong, rough gloss saturates in planned poses
            # near grazing angles, where an object photographed with one exposure time has no shorter one.
            assert plan.stated_fraction >= min(0.98, rival.stated_fraction)
            assert plan.median < rival.median
            # Poses that state far fewer materials keep those that are easy: of six on an even grid two thirds.
            alike = rival.stated_fraction > 0.95 * plan.stated_fraction
            assert plan.p95 < (0.8 if alike else 1.0) * rival.p95


def test_eight_planned_poses_beat_sixteen_on_an_even_grid(rows):
    for parameter in ("beta", "mu"):
        assert rows[8, "planned", parameter].p95 < rows[16, "even", parameter].p95


def test_the_outcome_keeps_what_the_plan_promises(rows, sitting):
    # Half of a normal distribution lies within 0.67 standard deviations. The plan takes the drift of photographs for
    # independent: what they share of it adds to the error of β, and spares μ.
    for count in COUNTS:
        (_, (beta, _), (mu, _)) = sitting.planner.best(count).expected.values()
        for parameter, sigma in (("beta", math.hypot(beta, sitting.planner.noise.relative)), ("mu", mu)):
            assert 0.3 < rows[count, "planned", parameter].median / sigma < 1.0


def test_photographs_without_noise_leave_the_fit_without_error(sitting):
    faults = sitting.rig.virtual.imperfections
    still = {name: replace(getattr(faults, name), enabled=False) for name in ("light_drift", "pose_error")}
    rig = replace(sitting.rig, virtual=replace(sitting.rig.virtual, imperfections=replace(faults, **still)))
    # Poses planned for no noise see most lobes once, as for no noise that is enough.
    planned = sitting.planner.best(8).poses
    planner = SimpleNamespace(**vars(sitting.planner))
    planner.noise = replace(planner.noise, shot_variance=1e-13, read_variance=1e-14)
    found = replace(sitting, rig=rig, planner=planner).fit_errors(planned, 60, np.random.default_rng(5))
    for name, values in found.items():
        known = values[np.isfinite(values)]
        assert known.size > 30 and np.median(known) < 1e-3, name


def test_simulated_photographs_scatter_as_the_noise_says(sitting):
    """Of the plate's centre, whose texels have the angles of the rig."""
    planner, middle = sitting.planner, np.array([[0.5, 0.5, 0.5]])
    planned, materials = planner.best(6).poses, planner.range.at(np.tile(middle, (6000, 1)))
    response, geometry, weight = sitting.photograph(planned, materials, 2000, np.random.default_rng(3))
    assert response.shape == weight.shape == (6000, 6) and geometry.shape == (6000, 6, 4)
    centre = np.isclose(geometry[..., :2], planner.subject.geometry(planned)[:, 0, :2]).all(axis=(1, 2))
    used = weight[centre].all(axis=0)
    assert centre.sum() > 800 and used.sum() >= 4
    seen = observe(planner.subject, planned, planner.range.at(middle), planner.noise)
    np.testing.assert_allclose(response[centre].std(axis=0)[used], np.sqrt(seen.variance[used, 0]), rtol=0.12)


def test_errors_are_absolute_in_alpha_and_relative_in_gloss(sitting, monkeypatch):
    drawn = sitting.planner.range.at(np.random.default_rng(5).random((40, 3)))
    off = SimpleNamespace(alpha=drawn.alpha - 0.01, beta=1.1 * drawn.beta, mu=0.8 * drawn.mu)
    monkeypatch.setattr(poses, "fit", lambda *_, **__: off)
    found = sitting.fit_errors(sitting.planner.best(4).poses, 40, np.random.default_rng(5))
    assert found["alpha"] == pytest.approx(0.01)
    assert found["beta"] == pytest.approx(0.1) and found["mu"] == pytest.approx(0.2)


def test_an_even_grid_stands_at_the_middles_of_equal_parts(sitting):
    limits = replace(
        sitting.rig.limits,
        camera_deg=AxisLimit(min=0.0, max=140.0, step=10.0),
        light_deg=AxisLimit(min=30.0, max=70.0, step=10.0),
    )
    found = even_poses(limits, 8, 2, 80.0)
    angles = [(light, camera) for light in (40.0, 60.0) for camera in (10.0, 30.0, 50.0, 70.0)]
    assert [(pose.light_deg, pose.camera_deg) for pose in found] == angles
    assert {(pose.tilt_deg, pose.turn_deg) for pose in found} == {(limits.tilt_deg.min, limits.turn_deg.min)}
    seven = even_poses(sitting.rig.limits, 7, 3, 80.0)
    assert len(set(seven)) == 7 and len({pose.light_deg for pose in seven}) == 3


def test_random_poses_keep_to_the_manual_settings(sitting):
    found = random_poses(sitting.planner.poses, 12, 3, np.random.default_rng(1))
    assert len(set(found)) == 12 and len({(pose.light_deg, pose.tilt_deg) for pose in found}) <= 3
