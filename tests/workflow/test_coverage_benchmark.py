"""Benchmark of stated errors: its shares, the drift of a rig's lamp, and the materials of a finished run."""

import csv
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import coverage
from irodori.config.capture_table import Pose, Shot
from irodori.config.models import Imperfections
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


@pytest.mark.heavy
def test_the_benchmark_counts_the_materials_that_each_rig_makes(finished, tmp_path, monkeypatch, capsys):
    seeds = []

    def run_chain(folder, cores, *targets):
        seeds.append(yaml.safe_load((folder / "config/rigs/virtual.yaml").read_text())["virtual"]["seed"])
        assert "results/tile-plate/material.h5" in targets
        shutil.copytree(finished / "results", folder / "results")
        return 1.0

    monkeypatch.setattr(coverage, "run_chain", run_chain)
    output = tmp_path / "coverage.csv"
    arguments = ["coverage", "--rigs", "2", "--objects", "tile-plate", "leaf-sphere", "--output", str(output)]
    monkeypatch.setattr("sys.argv", arguments)
    coverage.main()
    assert seeds == [1, 2] and "tile-plate" in capsys.readouterr().out
    with output.open(newline="") as stream:
        rows = {(row["object"], row["quantity"]): row for row in csv.DictReader(stream)}
    assert {name for name, _ in rows} == {"tile-plate", "leaf-sphere"}
    alpha = rows["tile-plate", "alpha"]
    assert int(alpha["rigs"]) == 2 and int(alpha["values"]) > 2 * 50
    assert 0.4 < float(alpha["within_1_sigma"]) < float(alpha["within_2_sigma"]) <= 1.0
