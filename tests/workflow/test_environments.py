"""Environments that no camera photographed, in the workflow: what is made of them, and from what."""

import json

import numpy as np
import pytest
import yaml
from project import planned, small_project, snakemake

from irodori.core.store import open_file
from irodori.light.environment_file import Environment, directions

LIGHTS = [
    {"spectrum": "D65", "azimuth_deg": 180.0, "elevation_deg": 30.0, "diameter_deg": 40.0, "radiance": 5.0},
    {"spectrum": "A", "azimuth_deg": 30.0, "elevation_deg": 60.0, "irradiance": 1.0},
]


def environment(folder, **definition):
    (folder / "config/environments/classroom.yaml").write_text(yaml.safe_dump(definition))


@pytest.mark.heavy
def test_placed_lights_are_made_without_a_camera_and_light_a_scene(tmp_path):
    folder = small_project(tmp_path)
    environment(folder, source={"kind": "lights", "lights": LIGHTS}, image={"width": 100, "height": 50})
    jobs = planned(snakemake(folder, "--dry-run"))
    assert not [rule for rule, wildcards in jobs if "environment" in wildcards and rule != "prepare_environment"]
    rules = {rule for rule, _ in jobs}
    assert {"prepare_environment", "render_view", "measure_errors", "write_report"} <= rules
    run = snakemake(folder, "results/environments/classroom.h5")
    assert run.returncode == 0, run.stderr[-4000:]
    path = folder / "results/environments/classroom.h5"
    light = Environment.load(path)
    unit = directions(100, 50)[0]
    window = unit @ [-np.cos(np.pi / 6), 0, 0.5] > np.cos(np.radians(18))
    assert (light.coefficients @ light.basis.sum(axis=0))[window].min() > 0
    with open_file(path) as file:
        errors, origin = file.attribute("errors"), file.attribute("origin")
        assert "gloss/width" in file and json.dumps(errors)
    assert origin == {"kind": "lights", "count": 2}
    assert set(errors) == {"delta_e", "negative_fraction", "compression", "irradiance"}


@pytest.mark.heavy
def test_a_panorama_is_an_input_and_its_absence_is_said_before_anything_is_made(tmp_path):
    folder = small_project(tmp_path)
    environment(folder, source={"kind": "rgb", "file": "sky.exr"})
    refused = snakemake(folder, "--dry-run")
    assert refused.returncode != 0 and "no such file: sky.exr" in refused.stderr + refused.stdout
    (folder / "sky.exr").write_bytes(b"not a picture")
    assert ("prepare_environment", {"environment": "classroom"}) in planned(snakemake(folder, "--dry-run"))
    run = snakemake(folder, "results/environments/classroom.h5")
    assert run.returncode != 0
    assert "sky.exr" in (folder / "results/logs/prepare_environment/classroom.log").read_text()
