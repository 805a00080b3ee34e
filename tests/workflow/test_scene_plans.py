"""A scene with a tolerance is planned before it is rendered; materials and light are made up here, not photographed."""

import numpy as np
import pytest
from project import edit, planned, small_project, snakemake
from shortcuts import irradiance_map

from irodori.core.store import Provenance
from irodori.light.environment_file import Environment, directions
from irodori.material.material_file import Material

SCENE = "config/scenes/still-life.yaml"
#: What is made up counts as made: no other rule may run.
ALONE = ("results/still-life/front.png", "--allowed-rules", "bake_light", "plan_scene", "render_view")


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


@pytest.mark.heavy
def test_only_a_scene_with_a_tolerance_is_planned(folder):
    edit(folder / SCENE, {"integrator": {"kind": "interactive"}})
    assert {rule for rule, _ in planned(snakemake(folder, "--dry-run", *ALONE))} == {"bake_light", "render_view"}
    edit(folder / SCENE, {"tolerance_ciede2000": 2.0})
    assert {rule for rule, _ in planned(snakemake(folder, "--dry-run", *ALONE))} == {
        "bake_light",
        "plan_scene",
        "render_view",
    }
