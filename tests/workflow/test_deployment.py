"""The workflow in all ways of using it: from the root, by its own file, in another folder, as a module, installed."""

import shutil

import pytest
from project import ROOT, planned, small_project, snakemake

TRUTH = "results/leaf-sphere/truth.h5"  # the output of a job without inputs
#: What the documentation shows, and a rule that asks for all of it.
MODULE = (
    next(
        block.removeprefix("python\n").replace("path/to/irodori/workflow/Snakefile", "{snakefile}")
        for block in (ROOT / "docs/other-workflow.md").read_text().split("```")
        if block.startswith("python\n") and "module irodori" in block
    )
    + """
rule everything:
    default_target: True
    input: rules.irodori_all.input
"""
)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return small_project(tmp_path_factory.mktemp("deployed") / "project")


@pytest.fixture(scope="module")
def jobs(project) -> list:
    """Return the jobs that the repository's root plans."""
    found = planned(snakemake(project, "--dry-run"))
    assert {"calibrate_camera", "fit_brdf", "render_view", "all"} <= {rule for rule, _ in found}
    return sorted(found, key=str)


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """Return a folder with a package of the same name, as another version that somebody installed, which cannot run."""
    folder = tmp_path_factory.mktemp("other-version")
    (folder / "irodori").mkdir()
    (folder / "irodori/__init__.py").write_text("raise RuntimeError('the wrong irodori')\n")
    return folder


@pytest.mark.heavy
def test_the_workflows_own_file_plans_what_the_root_plans(project, jobs, broken):
    run = snakemake(project, "--dry-run", snakefile=ROOT / "workflow/Snakefile", search_path=broken)
    assert sorted(planned(run), key=str) == jobs


@pytest.mark.heavy
def test_a_directory_may_be_named_instead_of_entered(project, jobs, tmp_path):
    run = snakemake(tmp_path, "--directory", str(project), "--dry-run")
    assert sorted(planned(run), key=str) == jobs
    assert list(tmp_path.iterdir()) == []


@pytest.mark.heavy
def test_another_workflow_uses_it_as_a_module_with_the_repositorys_package(project, jobs, broken, tmp_path):
    outer = tmp_path / "outer"
    shutil.copytree(project / "config", outer / "config")
    snakefile = outer / "Snakefile"
    snakefile.write_text(MODULE.format(snakefile=ROOT / "workflow/Snakefile"))
    found = planned(snakemake(outer, "--dry-run", snakefile=snakefile, forked=True))
    inner = [(rule.removeprefix("irodori_"), names) for rule, names in found if rule != "everything"]
    assert sorted([*inner, ("all", {})], key=str) == jobs
    made = snakemake(outer, TRUTH, snakefile=snakefile, search_path=broken)
    assert made.returncode == 0 and (outer / TRUTH).is_file(), made.stderr[-3000:]


@pytest.mark.heavy
def test_rules_away_from_the_repository_use_the_installed_package(project, jobs, tmp_path):
    shutil.copytree(ROOT / "workflow", tmp_path / "rules-only/workflow")
    shutil.copytree(ROOT / "envs", tmp_path / "rules-only/envs")
    snakefile = tmp_path / "rules-only/workflow/Snakefile"
    installed = tmp_path / "installed"
    (installed / "irodori-0.1.0.dist-info").mkdir(parents=True)
    (installed / "irodori").symlink_to(ROOT / "irodori")
    run = snakemake(project, "--dry-run", snakefile=snakefile, search_path=installed)
    assert sorted(planned(run), key=str) == jobs
    run = snakemake(project, "--dry-run", "benchmark", snakefile=snakefile, forked=True)
    said = run.stdout + run.stderr
    assert run.returncode != 0 and "produce benchmark" in said and "Traceback" not in said


@pytest.mark.heavy
def test_a_directory_without_a_configuration_is_refused_by_name(tmp_path):
    run = snakemake(tmp_path, "--dry-run")
    said = run.stdout + run.stderr
    assert run.returncode != 0 and "config/config.yaml but it is not present" in said and "Traceback" not in said
