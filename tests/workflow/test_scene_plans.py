"""A scene with a tolerance is planned before it is rendered; materials and light are made up here, not photographed."""

import json

import numpy as np
import pytest
import yaml
from project import edit, planned, small_project, snakemake
from shortcuts import irradiance_map

from irodori.core.store import Provenance
from irodori.light.environment_file import Environment, directions
from irodori.material.material_file import Material

SCENE = "config/scenes/still-life.yaml"
#: What is made up counts as made: no other rule may run.
ALONE = ("results/still-life/front.png", "--allowed-rules", "plan_scene", "render_view")


@pytest.fixture
def folder(tmp_path):
    """A project whose materials and environment stand in results/."""
    folder, origin = small_project(tmp_path / "project"), Provenance("test", "0", "0")
    warm, cold = np.linspace(0.2, 0.8, 61), np.linspace(0.7, 0.1, 61)
    materials = {
        "tile-plate": Material.uniform(warm),
        "leaf-sphere": Material.uniform(cold, beta=2.0, mu=0.3, mirror=0.5),
    }
    for name, material in materials.items():
        (folder / "results" / name).mkdir(parents=True)
        material.save(folder / "results" / name / "material.h5", origin)
    coefficients = (1.2 + directions(32, 16)[0][..., 2:]).astype(np.float32)
    light = Environment(coefficients, np.ones((61, 1)), irradiance_map(coefficients, 32, 16))
    (folder / "results/environments").mkdir()
    light.save(folder / "results/environments/classroom.h5", origin)
    return folder


def test_only_a_scene_with_a_tolerance_is_planned(folder):
    edit(folder / SCENE, {"integrator": {"kind": "interactive"}})
    assert planned(snakemake(folder, "--dry-run", *ALONE)) == [
        ("render_view", {"scene": "still-life", "view": "front"})
    ]
    edit(folder / SCENE, {"tolerance_ciede2000": 2.0})
    assert {rule for rule, _ in planned(snakemake(folder, "--dry-run", *ALONE))} == {"plan_scene", "render_view"}


@pytest.mark.heavy
def test_a_planned_picture_is_checked_and_a_bad_override_leaves_none(folder):
    edit(folder / SCENE, {"integrator": {"kind": "interactive"}, "tolerance_ciede2000": 2.0})
    run = snakemake(folder, *ALONE)
    assert run.returncode == 0, run.stderr[-4000:]
    results = folder / "results/still-life"
    figures = json.loads((results / "front.json").read_text())["plan"]
    plan = yaml.safe_load((results / "plan.yaml").read_text())
    assert figures["predicted_delta_e"] == plan["predicted_delta_e"] <= 2.0
    assert figures["measured_delta_e"]["p99"] <= 2.0
    edit(folder / SCENE, {"plan": {"gloss": [], "mirror": []}, "tolerance_ciede2000": 0.05})
    run = snakemake(folder, *ALONE)
    said = run.stdout + run.stderr
    assert run.returncode != 0 and "tolerated: 0.05" in said and "Traceback" not in said
    assert not list(results.glob("front.*")) and (results / "plan.yaml").exists()
