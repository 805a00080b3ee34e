"""Benchmark of stated errors: its shares, the drift of a rig's lamp, and errors of materials without it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_report_errors import checks

from benchmarks import coverage
from irodori.config.capture_table import Pose, Shot
from irodori.config.models import Imperfections
from irodori.evaluation.truth_errors import interior
from irodori.simulation.virtual_rig.imperfections import Faults

FAULTS = Imperfections.of(
    {"light_drift": {"enabled": True, "relative_rms": 0.01, "correlation_shots": 60.0}}
    | {name: {"enabled": False} for name in ("vignetting", "stray_light", "pose_error", "lamp_spectrum", "laid_off",
                                             "focal_length", "filter_plate", "hot_pixels")}
)  # fmt: skip


def shots(role, count, *, darks=0):
    dark = [Shot(f"dark-{n}.dng", "dark", Pose(0.0, 0.0), "out", 0.02) for n in range(darks)]
    both = [(n, state) for n in range(count) for state in ("out", "in")]
    return dark + [Shot(f"{role}-{n}-{state}.dng", role, Pose(45.0, 0.0), state, 0.02) for n, state in both]


@given(st.floats(-2.0, 2.0), st.floats(0.3, 3.0), st.floats(0.01, 3.0))
def test_shares_are_those_of_many_drawn_drifts(off, stated, spread):
    drawn = off + spread * np.random.default_rng(1).normal(size=20_000)
    found = coverage.shares(np.array([off]), np.array([spread]), np.array([stated]))
    for count, share in enumerate(found, 1):
        assert share == pytest.approx(np.mean(np.abs(drawn) <= count * stated), abs=0.015)


def test_without_a_drift_errors_are_counted_as_they_are():
    off, stated = np.array([0.5, 1.5, -1.5, 2.5]), np.ones(4)
    assert coverage.shares(off, np.zeros(4), stated) == (0.25, 0.75)


def test_the_drift_of_a_rig_is_the_ratio_of_what_its_lamp_gave_and_scatters_as_stated():
    white, subject = shots("white", 4, darks=8), shots("object", 16)
    found = [coverage.drift(FAULTS, seed, white, "plate", subject) for seed in range(400)]
    of_seed = Faults(FAULTS, 7, "plate", subject), Faults(FAULTS, 7, coverage.CAMERA, white)
    lights = [np.mean([faults.light(shot) for shot in every if shot.filter == "out" and shot.role != "dark"])
              for faults, every in zip(of_seed, (subject, white), strict=True)]  # fmt: skip
    assert found[7].ratio == pytest.approx(lights[0] / lights[1], rel=1e-12)
    ratios = np.array([one.ratio for one in found])
    assert ratios.std() == pytest.approx(found[0].sigma, rel=0.12)  # three standard errors of 400
    still = replace(FAULTS, light_drift=replace(FAULTS.light_drift, enabled=False))
    assert coverage.drift(still, 7, white, "plate", subject) == (1.0, 0.0)


def test_the_drift_is_taken_out_of_all_that_it_scales_and_of_nothing_else():
    truth, lamp = checks(20, 20, 5), coverage.Drift(1.04, 0.013)
    found = replace(truth, alpha=1.04 * truth.alpha, beta=1.04 * truth.beta, mu=truth.mu + 0.01,
                    coefficients=1.04 * truth.coefficients)  # fmt: skip
    bands = np.array([0, 30, 60])
    stated = {key: np.full(truth.alpha.shape, 0.01) for key in ("alpha", "beta", "mu")}
    stated["reflectance"] = np.full((*truth.alpha.shape, 3), 0.01)
    stated["alpha"][:4] = np.nan
    errors = coverage.errors_of(found, truth, stated, bands, lamp)
    inner = interior(truth)
    for quantity, exact in (("alpha", truth.alpha[inner & np.isfinite(stated["alpha"])]), ("beta", truth.beta[inner])):
        off, spread, error = errors[quantity]
        np.testing.assert_allclose(off, 0.0, atol=1e-6)
        np.testing.assert_allclose(spread, 0.013 * exact)
        assert (error == 0.01).all()
    off, spread, _ = errors["mu"]
    np.testing.assert_allclose(off, 0.01, atol=1e-6)
    assert (spread == 0.0).all() and len(off) == inner.sum()
    off, spread, _ = errors["reflectance"]
    assert off.size == 3 * inner.sum()
    np.testing.assert_allclose(off, 0.0, atol=1e-6)
    np.testing.assert_allclose(spread, 0.013 * (truth.coefficients[inner] @ truth.basis.T[:, bands]).ravel(), rtol=1e-5)


def test_rigs_are_averaged_and_their_scatter_tells_the_error():
    shares = [(0.6, 0.9), (0.7, 1.0), (0.8, 0.95)]
    rows = [dict(zip(("object", "quantity", "rigs", "values", "within_1_sigma", "within_2_sigma"),
                     ("tile", "mu", 1, 10, one, two), strict=True)) for one, two in shares]  # fmt: skip
    (found,) = coverage.together(rows)
    assert (found["rigs"], found["values"]) == (3, 30)
    assert found["within_1_sigma"] == pytest.approx(0.7) and found["within_2_sigma"] == pytest.approx(0.95)
    assert found["error_of_1_sigma"] == pytest.approx(0.1 / np.sqrt(3.0))
    assert np.isnan(coverage.together(rows[:1])[0]["error_of_1_sigma"])
