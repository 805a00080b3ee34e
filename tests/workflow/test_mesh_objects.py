"""A mesh is an input: of everything that uses it, with the buffers it refers to, and refused before anything runs."""

import pytest
from project import edit, planned, small_project, snakemake


@pytest.fixture
def project(tmp_path):
    folder = small_project(tmp_path / "project")
    edit(folder / "config/config.yaml", {"make": {"scenes": ["lid"], "cameras": []}})
    edit(folder / "config/objects/celadon-lid.yaml", {"texels": {"width": 16, "height": 16}})
    return folder


def inputs_by_rule(run) -> dict[str, set[str]]:
    """Return the inputs that a dry run lists for each rule, of the object with the mesh where a rule has objects."""
    assert run.returncode == 0, run.stderr[-4000:]
    found, rule, inputs = {}, "", set()
    for line in (run.stdout + run.stderr).splitlines():
        words = line.strip().split()
        if len(words) == 2 and words[0] in ("rule", "localrule"):
            rule, inputs = words[1].rstrip(":"), set()
        elif words[:1] == ["input:"]:
            inputs = set(line.split(":", 1)[1].replace(" ", "").split(","))
            found.setdefault(rule, set())
        elif words[:1] == ["wildcards:"] and "tile-plate" not in line:
            found.setdefault(rule, set()).update(inputs)
    return found


@pytest.mark.heavy
def test_the_mesh_is_an_input_of_every_rule_that_reads_it_and_of_no_other(project):
    used = inputs_by_rule(snakemake(project, "--dry-run", "results/lid/front.png", "results/lid/truth/front.png"))
    reading = {rule for rule, inputs in used.items() if "config/meshes/lid.obj" in inputs}
    assert reading == {
        "capture_object",
        "register_object",
        "rectify_object",
        "compress_reflectance",  # whose material states what it was made of
        "render_view",
        "render_truth",
        "write_truth",
    }


def test_a_missing_mesh_is_refused_before_anything_runs(project):
    edit(project / "config/objects/celadon-lid.yaml", {"shape.file": "config/meshes/none.obj"})
    run = snakemake(project, "--dry-run")
    said = " ".join((run.stdout + run.stderr).split())
    assert run.returncode != 0 and "Traceback" not in said
    assert "config/meshes/none.obj: found no such file; accepted: a triangle mesh with UV coordinates" in said


@pytest.mark.heavy
def test_the_default_run_has_no_mesh(tmp_path):
    jobs = planned(snakemake(small_project(tmp_path / "plain"), "--dry-run"))
    assert not any(wildcards.get("object") == "celadon-lid" for _, wildcards in jobs)


@pytest.mark.heavy
def test_the_distance_of_the_light_rectifies_anew_and_needs_no_other_key(project):
    edit(project / "config/rigs/virtual.yaml", {"light.distance_mm": 400.0})
    edit(project / "config/cameras/d5100-comb.yaml", {"optics.distortion": {"k1": -0.1}})
    rules = {rule for rule, _ in planned(snakemake(project, "--dry-run"))}
    assert {"rectify_object", "capture_object", "render_view"} <= rules
