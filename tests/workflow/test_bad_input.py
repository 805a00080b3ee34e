"""Bad input stops the run with one sentence that names file, field, value and what is accepted."""

import numpy as np
import pytest
import yaml
from project import edit, small_project, snakemake

from irodori.config.capture_table import Pose, Shot, write_captures
from irodori.simulation.virtual_rig.dng_writer import write_dng


@pytest.fixture
def project(tmp_path):
    return small_project(tmp_path / "project")


def refusal(folder, *arguments) -> str:
    """Return what a run says when it refuses to start."""
    run = snakemake(folder, "--dry-run", *arguments)
    text = run.stdout + run.stderr
    assert run.returncode != 0, text
    assert "Traceback" not in text
    return " ".join(text.split())


@pytest.mark.stability(stage="workflow", case="unknown key")
def test_an_unknown_key_names_the_one_that_was_meant(project):
    edit(project / "config/objects/leaf-sphere.yaml", {"mirror_wieght": 0.5})
    said = refusal(project)
    assert "config/objects/leaf-sphere.yaml" in said and "mirror_wieght" in said and "mirror_weight" in said


@pytest.mark.parametrize(
    "target",
    ["results/celadon-lid/material.h5", "results/cameras/eos-40d/calibration.h5", "results/still-life/top.png"],
)
def test_a_result_of_nothing_that_the_configuration_makes_is_refused_without_a_traceback(project, target):
    assert f"No rule to produce {target}" in refusal(project, target)


@pytest.mark.heavy
@pytest.mark.stability(stage="workflow", case="object names an unknown camera")
def test_an_unknown_camera_lists_those_that_exist(project):
    edit(project / "config/objects/leaf-sphere.yaml", {"camera": "d5100-cmb"})
    said = refusal(project)
    assert "leaf-sphere.yaml" in said and "camera" in said and "d5100-cmb" in said and "d5100-comb" in said


@pytest.mark.stability(stage="workflow", case="angle out of the rig's range")
def test_an_angle_out_of_the_rigs_range_says_the_range(project):
    edit(project / "config/objects/leaf-sphere.yaml", {"poses": [{"light_deg": [20.0], "camera_deg": [0.0]}]})
    said = refusal(project)
    assert "leaf-sphere.yaml" in said and "poses[0].light_deg[0]" in said and "20" in said and "35 to 125" in said


@pytest.mark.heavy
@pytest.mark.stability(stage="workflow", case="chart file without a wavelength")
def test_a_chart_with_a_missing_wavelength_is_refused(project):
    rows = [["patch", *map(str, range(400, 701, 10))]] + [[f"p{i}", *["0.5"] * 31] for i in range(24)]
    rows[7][12] = ""
    (project / "chart.csv").write_text("\n".join(",".join(row) for row in rows))
    edit(project / "config/cameras/d5100-comb.yaml", {"chart.spectra": "chart.csv"})
    said = refusal(project)
    assert "chart.csv" in said and "510 nm" in said and "a finite number" in said


def real_project(folder, files: dict[str, bytes | None]):
    """Turn the small project into one whose chart comes from a user's own files."""
    raw = folder / "raw"
    raw.mkdir()
    mosaic = np.random.default_rng(0).integers(600, 4000, (64, 96)).astype(np.uint16)
    shots = []
    for number, (name, damage) in enumerate(files.items()):
        write_dng(raw / name, mosaic, black_level=600, white_level=16383, exposure_s=0.01 + number, model="test")
        if damage is None:
            (raw / name).unlink()
        elif damage:
            (raw / name).write_bytes((raw / name).read_bytes()[: -len(damage)])
        shots.append(Shot(name, "chart", Pose(45.0, 0.0), "out", 0.01 + number))
    write_captures(raw / "captures.csv", shots)
    camera = {
        "rig": "copy-stand",
        "captures": {"table": "raw/captures.csv", "folder": "raw"},
        "chart": {
            "spectra": "BabelColor Average", "rows": 4, "columns": 6, "patch_px": 3,
            "centres_px": {"first": [5, 5], "row_end": [40, 5], "column_end": [5, 25], "last": [40, 25]},
        },
        "calibration": {"estimator": "pinv", "bases": 3},
    }  # fmt: skip
    (folder / "config/cameras/own.yaml").write_text(yaml.safe_dump(camera))
    edit(folder / "config/config.yaml", {"make": {"scenes": [], "cameras": ["own"]}})
    return folder


@pytest.mark.stability(stage="workflow", case="RAW file missing")
def test_a_missing_raw_file_is_refused_before_anything_runs(project):
    said = refusal(real_project(project, {"a.dng": b"", "b.dng": None}), "calibrate")
    assert "b.dng" in said and "captures.csv" in said


@pytest.mark.stability(stage="workflow", case="RAW file truncated")
def test_a_truncated_raw_file_stops_at_the_first_job(project):
    run = snakemake(real_project(project, {"a.dng": b"", "b.dng": b"x" * 2000}), "calibrate")
    said = " ".join((run.stdout + run.stderr).split())
    assert run.returncode != 0
    assert "b.dng" in said and "cannot decode" in said and "a whole RAW file" in said
    assert not (project / "results/cameras/own/reference.h5").exists()


@pytest.mark.stability(stage="ingest", case="file contradicts the table")
@pytest.mark.heavy
def test_an_exposure_that_the_file_contradicts_is_refused(project):
    folder = real_project(project, {"a.dng": b""})
    table = folder / "raw/captures.csv"
    table.write_text(table.read_text().replace("0.01", "0.5"))
    run = snakemake(folder, "calibrate")
    said = " ".join((run.stdout + run.stderr).split())
    assert run.returncode != 0 and "exposure_s" in said and "0.5" in said and "0.01" in said
