"""A scene with a tolerance is planned before it is rendered, and the report shows how its check went."""

import json

import pytest
import yaml
from project import edit, planned, snakemake

SCENE = "config/scenes/still-life.yaml"


def test_only_a_scene_with_a_tolerance_is_planned(again):
    edit(again / SCENE, {"integrator": {"kind": "interactive"}})
    assert "plan_scene" not in {rule for rule, _ in planned(snakemake(again, "--dry-run"))}
    edit(again / SCENE, {"tolerance_ciede2000": 2.0})
    jobs = planned(snakemake(again, "--dry-run"))
    assert ("plan_scene", {"scene": "still-life"}) in jobs
    assert not {"fit_brdf", "compress_reflectance", "prepare_environment"} & {rule for rule, _ in jobs}


@pytest.mark.heavy
def test_a_planned_scene_goes_through_to_the_report_and_a_bad_override_stops_it(again):
    edit(again / SCENE, {"integrator": {"kind": "interactive"}, "tolerance_ciede2000": 2.0})
    run = snakemake(again)
    assert run.returncode == 0, run.stderr[-4000:]
    figures = json.loads((again / "results/still-life/front.json").read_text())["plan"]
    plan = yaml.safe_load((again / "results/still-life/plan.yaml").read_text())
    assert figures["predicted_delta_e"] == plan["predicted_delta_e"] <= 2.0
    assert figures["measured_delta_e"]["p99"] <= 2.0
    page = (again / "results/report.html").read_text()
    assert "ΔE2000 to the full model" in page
    edit(again / SCENE, {"plan": {"gloss": [], "representation": "quadrature", "nodes": 6}})
    edit(again / SCENE, {"tolerance_ciede2000": 0.05})
    run = snakemake(again)
    said = run.stdout + run.stderr
    assert run.returncode != 0 and "tolerated: 0.05" in said and "Traceback" not in said
    assert not list((again / "results/still-life").glob("front.*"))
