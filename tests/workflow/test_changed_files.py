"""A user's file that changed makes again what stands on it, whatever its time; a result that changed is refused."""

import csv
import os
import shutil
from pathlib import Path

import h5py
import pytest
import yaml
from project import edit, planned, snakemake

from irodori.core.custody import main, read_record
from irodori.ingest.mosaic import decode

CAMERA = "results/cameras/own"
LINEAR = f"{CAMERA}/linear/chart.h5"
SESSION = "results/cameras/d5100-comb"
#: In the year 2000, ns.
OLD = (946684800_000_000_000, 946684800_000_000_000)


@pytest.fixture(scope="module")
def made(finished, tmp_path_factory) -> Path:
    """Return a project with a chart ingested from a user's own photographs, which the virtual rig took for him."""
    folder, results = tmp_path_factory.mktemp("own") / "project", str(finished / "results")

    def others(of: str, names: list[str]) -> set[str]:
        return set(names) - {"cameras", "inputs.json"} if of == results else set()

    shutil.copytree(finished, folder, ignore=others, copy_function=shutil.copy2)
    shutil.copytree(folder / SESSION / "captures", folder / "raw", ignore=shutil.ignore_patterns(".*", "*.json"))
    table = folder / "raw/captures.csv"
    with table.open(newline="") as stream:
        rows = [{key: row[key] for key in row if key != "sha256"} for row in csv.DictReader(stream)]
    with table.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    (folder / "white.csv").write_text("wavelength_nm,white\n" + "".join(f"{nm},0.99\n" for nm in range(400, 701, 5)))
    camera = yaml.safe_load((folder / "config/cameras/d5100-comb.yaml").read_text())
    taken = ("poses", "exposure_s", "dark_frames", "white_frames", "linearity_exposure_s", "virtual")
    camera = {key: value for key, value in camera.items() if key not in taken}
    camera |= {"rig": "copy-stand", "captures": {"table": "raw/captures.csv", "folder": "raw"}}
    camera["white"] = {"reflectance_factor": "white.csv"}
    (folder / "config/cameras/own.yaml").write_text(yaml.safe_dump(camera))
    edit(folder / "config/config.yaml", {"make": {"scenes": [], "cameras": ["own", "d5100-comb"]}})
    run = snakemake(folder, LINEAR)
    assert run.returncode == 0, run.stderr[-4000:]
    return folder


@pytest.fixture
def project(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy", copy_function=shutil.copy2))


def jobs(folder, target=LINEAR) -> list[str]:
    return sorted(rule for rule, _ in planned(snakemake(folder, "--dry-run", target)))


def chart(folder) -> Path:
    with (folder / "raw/captures.csv").open(newline="") as stream:
        return folder / "raw" / next(row["file"] for row in csv.DictReader(stream) if row["role"] == "chart")


def correct(path: Path, times_ns: tuple[int, int] | None = None) -> None:
    """Put a darker photograph of the same size in the place of one, with an older time stamp or one that is given."""
    content = path.read_bytes()
    pixels = decode(path).values
    assert content.count(pixels.tobytes()) == 1
    path.write_bytes(content.replace(pixels.tobytes(), (600 + (pixels - 600.0) * 0.8).astype("uint16").tobytes()))
    os.utime(path, ns=times_ns or OLD)


@pytest.mark.heavy
def test_a_corrected_photograph_with_an_older_time_is_seen_and_the_result_differs(project):
    before = read_record(project / LINEAR).sha256
    correct(chart(project))
    assert main([str(project / "results")]) == 1, "the results are of another photograph"
    run = snakemake(project, LINEAR)
    assert run.returncode == 0, run.stderr[-4000:]
    assert read_record(project / LINEAR).sha256 != before
    assert main([str(project / "results")]) == 0
    assert jobs(project) == []


@pytest.mark.heavy
def test_files_that_were_only_touched_make_nothing_again(project):
    for file in [*(project / "raw").iterdir(), project / "white.csv"]:
        file.touch()
    assert jobs(project) == []


@pytest.mark.heavy
def test_another_photograph_of_the_same_size_and_time_is_seen(project):
    assert jobs(project) == []  # which leaves the hashes behind
    found = chart(project).stat()
    correct(chart(project), (found.st_atime_ns, found.st_mtime_ns))
    assert jobs(project) == ["check_camera_captures", "ingest_chart", "ingest_reference"]


@pytest.mark.heavy
def test_another_table_of_spectra_with_an_older_time_is_seen(project):
    table = project / "white.csv"
    table.write_text(table.read_text().replace("0.99", "0.98"))
    os.utime(table, ns=OLD)
    assert jobs(project) == ["ingest_chart", "ingest_reference"]


@pytest.mark.heavy
def test_a_sessions_photograph_that_is_not_the_one_it_took_is_refused_by_name(project):
    target = f"{SESSION}/captures.csv"
    assert jobs(project, target) == []
    raw = next((project / SESSION / "captures").glob("chart*.dng"))
    correct(raw)
    run = snakemake(project, target)
    said = " ".join((run.stdout + run.stderr).split())
    assert run.returncode != 0 and raw.name in said and "to take this one as it is, empty its cell sha256" in said


@pytest.mark.heavy
def test_an_edited_result_is_refused_and_made_again(project):
    reference, linear = project / f"{CAMERA}/reference.h5", project / LINEAR
    before, times = read_record(linear).sha256, reference.stat()
    with h5py.File(reference, "r+") as file:
        file.attrs["rule"] = "another"
    os.utime(reference, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert main([str(project / "results")]) == 1
    run = snakemake(project, LINEAR, "--forcerun", "ingest_chart")
    assert run.returncode != 0 and "content that its rule did not write" in run.stdout + run.stderr
    assert snakemake(project, LINEAR).returncode == 0
    assert read_record(linear).sha256 == before and main([str(project / "results")]) == 0
