"""A finished run as a Workflow Run RO-Crate: valid without a network, and true to the files and the run."""

import hashlib
import io
import json
import shutil
import zipfile
from datetime import datetime
from pathlib import Path

import pytest
import requests
import rocrate
from project import ROOT, edit
from requests.models import Response
from requests_cache import CachedSession
from rocrate_validator.services import ValidationSettings, validate
from urllib3 import HTTPResponse

from irodori.command_line import main

_CONTEXT = "https://w3id.org/ro/crate/1.1/context"
_BIOSCHEMAS = "https://bioschemas.org/"
#: Where version 1.1 of the context, which crates name, differs from the newer one that the package rocrate has.
_OF_1_1 = {
    "ComputationalWorkflow": f"{_BIOSCHEMAS}ComputationalWorkflow", "FormalParameter": f"{_BIOSCHEMAS}FormalParameter",
    "input": f"{_BIOSCHEMAS}ComputationalWorkflow#input", "output": f"{_BIOSCHEMAS}ComputationalWorkflow#output",
}  # fmt: skip
_ORCID = "0000-0002-1825-0097"  # of Josiah Carberry, who exists for examples


@pytest.fixture
def project(again) -> Path:
    """Return a finished project with the workflow in it, as a clone of the repository has it."""
    shutil.copytree(ROOT / "workflow", again / "workflow", ignore=shutil.ignore_patterns("__pycache__"))
    return again


def crate(folder: Path, *arguments) -> int:
    return main(["crate", "--directory", str(folder), *map(str, arguments)])


def graph_of(file: Path) -> dict[str, dict]:
    return {one["@id"]: one for one in json.loads(file.read_text(encoding="utf-8"))["@graph"]}


def filled_cache(folder: Path) -> Path:
    """Return a cache of the validator that holds the one document that it would fetch."""
    document = json.loads((Path(rocrate.__file__).parent / "data/ro-crate.jsonld").read_text(encoding="utf-8"))
    document["@context"].update(_OF_1_1)
    answer = Response()
    answer.status_code, answer.url = 200, _CONTEXT
    content = json.dumps(document).encode()
    answer._content, answer.raw = content, HTTPResponse(io.BytesIO(content), status=200, preload_content=False)
    answer.headers["Content-Type"] = "application/ld+json"
    answer.request = requests.Request("GET", _CONTEXT).prepare()
    with CachedSession(cache_name=str(folder / "cache"), backend="sqlite", expire_after=-1) as session:
        session.cache.save_response(answer)
    return folder / "cache"


@pytest.mark.heavy
# The validator's graph library warns of itself.
@pytest.mark.filterwarnings("ignore:ConjunctiveGraph is deprecated:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:Dataset.default_context is deprecated:DeprecationWarning")
def test_a_crate_of_a_run_is_valid_and_every_hash_is_that_of_its_file(project, tmp_path):
    publication = {"licence": "https://creativecommons.org/licenses/by/4.0/", "photographer": "Josiah Carberry"}
    edit(project / "config/config.yaml", {"publication": publication | {"photographer_orcid": _ORCID}})
    assert crate(project, "--output", tmp_path / "crate") == 0
    for profile in ("process-run-crate", "workflow-run-crate"):
        settings = ValidationSettings(
            rocrate_uri=str(tmp_path / "crate"), profile_identifier=profile, offline=True,
            cache_path=filled_cache(tmp_path),
        )  # fmt: skip
        issues = [f"{issue.check.identifier}: {issue.message}" for issue in validate(settings).get_issues()]
        assert issues == [], profile
    graph = graph_of(tmp_path / "crate/ro-crate-metadata.json")
    files = [one for one in graph.values() if "File" in one["@type"]]
    assert len(files) > 80
    for one in files:
        content = (tmp_path / "crate" / one["@id"]).read_bytes()
        assert one["sha256"] == hashlib.sha256(content).hexdigest() and int(one["contentSize"]) == len(content)
    names = {one["@id"] for one in files}
    assert {"workflow/Snakefile", "config/config.yaml", "config/objects/tile-plate.yaml",
            "results/still-life/report.html", "results/still-life/front.exr", "results/tile-plate/material.h5",
            "results/still-life/photographs/front/comparison.h5"} <= names  # fmt: skip
    assert any(name.endswith(".dng") for name in names)
    root, run = graph["./"], graph["#run"]
    assert root["license"] == {"@id": publication["licence"]} and root["author"] == {
        "@id": f"https://orcid.org/{_ORCID}"
    }
    assert run["instrument"] == {"@id": "workflow/Snakefile"} and run["agent"] == root["author"]
    assert {"@id": "results/still-life/front.png"} in run["result"]
    assert graph["#camera-d5100-comb"]["subjectOf"] == {"@id": "config/cameras/d5100-comb.yaml"}
    assert graph["#software-numpy"]["softwareVersion"] and graph["#software-snakemake"]["softwareVersion"]


def test_every_job_has_its_time_and_comes_after_those_whose_results_it_read(project):
    assert crate(project) == 0
    graph = graph_of(project / "ro-crate-metadata.json")
    jobs = [one for name, one in graph.items() if name.startswith("#job-")]

    def listed(job, key):
        found = job.get(key, [])
        return [one["@id"] for one in (found if isinstance(found, list) else [found])]

    made_at = {name: datetime.fromisoformat(job["endTime"]) for job in jobs for name in listed(job, "result")}
    pictures = [job for job in jobs if "results/still-life/front.exr" in listed(job, "result")]
    assert len(pictures) == 1 and "results/tile-plate/material.h5" in listed(pictures[0], "object")
    # What one job wrote is of one job.
    assert "results/still-life/front.png" in listed(pictures[0], "result")
    for job in jobs:
        start, end = (datetime.fromisoformat(job[key]) for key in ("startTime", "endTime"))
        assert start <= end
        # Snakemake notes the end of a job by its file's time, which file systems round.
        assert all((made_at[name] - start).total_seconds() < 1.0 for name in listed(job, "object") if name in made_at)
    run = graph["#run"]
    assert datetime.fromisoformat(run["endTime"]) == max(map(datetime.fromisoformat, (job["endTime"] for job in jobs)))


def test_a_crate_is_zipped_and_never_written_over_something(project, tmp_path, capsys):
    assert crate(project, "--output", tmp_path / "run.zip") == 0
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        assert archive.testzip() is None
        metadata = json.loads(archive.read("ro-crate-metadata.json"))
        names = {one["@id"] for one in metadata["@graph"] if "File" in one["@type"]}
        assert names | {"ro-crate-metadata.json"} == set(archive.namelist())
    capsys.readouterr()
    assert crate(project, "--output", tmp_path / "run.zip") == 1
    assert "found something that is there already" in capsys.readouterr().out


def test_a_run_in_another_folder_than_its_workflow_has_a_crate_with_both(again, tmp_path, capsys):
    """As after `snakemake --directory`: the project's folder has no workflow."""
    assert crate(again) == 1 and not (again / "ro-crate-metadata.json").exists()
    said = capsys.readouterr().out
    assert f"{ROOT / 'workflow/Snakefile'}: found a workflow that lies outside the project's folder" in said
    assert "accepted: --output" in said
    moved = tmp_path / "elsewhere"
    shutil.copytree(ROOT / "workflow", moved, ignore=shutil.ignore_patterns("__pycache__"))
    (moved / "Snakefile").rename(moved / "Another.smk")
    for name, options in (("beside", ()), ("given", ("--snakefile", moved / "Another.smk"))):
        assert crate(again, "--output", tmp_path / name, *options) == 0
        files = [one for one in graph_of(tmp_path / name / "ro-crate-metadata.json").values() if "File" in one["@type"]]
        for one in files:
            assert one["sha256"] == hashlib.sha256((tmp_path / name / one["@id"]).read_bytes()).hexdigest()
        names = {one["@id"] for one in files}
        assert {"workflow/Snakefile", "workflow/rules/fit.smk", "workflow/scripts/fit_brdf.py",
                "config/config.yaml", "results/still-life/front.exr"} <= names  # fmt: skip


def test_a_run_that_cannot_be_vouched_for_has_no_crate(project, capsys):
    def said() -> str:
        capsys.readouterr()
        assert crate(project) == 1
        assert not (project / "ro-crate-metadata.json").exists()
        return capsys.readouterr().out

    picture = project / "results/still-life/front.png"
    before = picture.read_bytes()
    picture.write_bytes(before + b"x")
    assert "front.png: found content that its rule did not write" in said()
    picture.write_bytes(before)
    room = project / "config/environments/classroom.yaml"
    for file, changed in (
        (room, {"lamps": ["FL11"]}),
        (project / "config/objects/tile-plate.yaml", {"mirror_weight": 0.4}),
    ):
        before = file.read_bytes()
        edit(file, {"description": "Other words."} | changed)
        found = f"found a result made before {next(iter(changed))} of config/{file.parent.name}/{file.name} changed"
        assert found in said()
        file.write_bytes(before)
    photograph = next((project / "results/tile-plate/captures").glob("*.dng"))
    before = photograph.read_bytes()
    photograph.write_bytes(before[:-1] + b"x")
    assert f"{photograph.name}: found" in said()
    photograph.write_bytes(before)
    edit(project / "config/config.yaml", {"publication": {"photographer_orcid": "0000-0002-1825-0098"}})
    assert "publication.photographer_orcid: found 0000-0002-1825-0098, a last digit of 8" in said()
    edit(project / "config/config.yaml", {"publication": {}})
    capsys.readouterr()
    assert crate(project, "--snakefile", project / "workflow/Snakefiles") == 1
    assert "workflow/Snakefiles: found no such file; accepted: the workflow's Snakefile" in capsys.readouterr().out
    shutil.rmtree(project / ".snakemake")
    assert "found no notes of jobs" in said()
