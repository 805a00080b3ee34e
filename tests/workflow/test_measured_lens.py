"""A lens measured from photographs of the printed sheet: a rule makes it, and the jobs of objects wait for it."""

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from drawn_sheets import HEIGHT, PITCH_UM, PLACES, TRUE, WIDTH, photographed, store
from project import edit, planned, small_project, snakemake

from irodori.check.photographs import PhotographCheck
from irodori.command_line import main
from irodori.config.capture_table import COLUMNS
from irodori.config.project import load_project
from irodori.core.custody import read_record
from irodori.lens.lens_file import LensFile
from irodori.simulation.virtual_rig.dng_writer import write_dng

LENS = "results/cameras/own/lens.yaml"


@pytest.fixture
def project(tmp_path):
    """Return a project with a camera of one's own, which photographed a chart, the sheet and a plate."""
    folder = small_project(tmp_path / "project")
    store(folder / "raw", [photographed(TRUE, place, seed) for seed, place in enumerate(PLACES)])
    mosaic = np.random.default_rng(0).integers(600, 4000, (HEIGHT, WIDTH)).astype(np.uint16)
    for name in ("chart", "white", "plate"):
        write_dng(folder / f"raw/{name}.dng", mosaic, black_level=512, white_level=16383, exposure_s=0.02, model="test")
    rows = ["chart.dng,chart,45,0,0,0,out,0.02", "white.dng,white,45,0,0,0,out,0.02"]
    rows += [f"sheet{number:02}.dng,lens,0,0,0,0,out,0.02" for number in range(len(PLACES))]
    rows += ["plate.dng,object,45,20,0,0,out,0.02"]
    (folder / "raw/captures.csv").write_text("\n".join([",".join(COLUMNS), *rows]))
    definitions = folder / "config"
    camera = yaml.safe_load((definitions / "cameras/d5100-comb.yaml").read_text())
    for key in ("virtual", "poses", "exposure_s", "dark_frames", "white_frames", "linearity_exposure_s", "comb_filter"):
        camera.pop(key, None)
    camera |= {"rig": "copy-stand", "captures": {"table": "raw/captures.csv"}}
    camera["calibration"] = {"estimator": "pinv", "bases": 3}
    camera["optics"] = {"focal_length_mm": 7.0, "pixel_pitch_um": PITCH_UM, "width_px": WIDTH, "height_px": HEIGHT,
                        "principal_point_px": [WIDTH / 2, HEIGHT / 2]}  # fmt: skip
    (definitions / "cameras/own.yaml").write_text(yaml.safe_dump(camera))
    plate = yaml.safe_load((definitions / "objects/tile-plate.yaml").read_text())
    for key in ("virtual", "poses", "exposure_s"):
        plate.pop(key)
    plate |= {"camera": "own", "captures": {"table": "raw/captures.csv"}}
    (definitions / "objects/own-plate.yaml").write_text(yaml.safe_dump(plate))
    scene = {"photographs": {}, "objects": [{"object": "own-plate", "position_mm": [0.0, 0.0, 0.0]}]}
    edit(definitions / "scenes/still-life.yaml", scene)
    return folder


def made_lens(folder) -> Path:
    """Return the file of the lens that the workflow measures."""
    run = snakemake(folder, LENS)
    assert run.returncode == 0, run.stderr[-3000:]
    return folder / LENS


def jobs(folder, *arguments) -> list[str]:
    return [rule for rule, _ in planned(snakemake(folder, "--dry-run", *arguments))]


@pytest.mark.heavy
def test_the_sheet_in_a_cameras_table_measures_its_lens_and_a_changed_photograph_measures_it_again(project):
    tile = "results/own-plate/observations/tile-000.h5"
    assert {"calibrate_lens", "rectify_object"} <= set(jobs(project, tile))
    found = LensFile.load(made_lens(project))
    assert abs(found.optics.focal_length_mm - 7.5) < 0.02 and "7.1 % more than the typed 7 mm" in found.remarks[0]
    record = read_record(project / LENS)
    assert record is not None and {"raw/captures.csv", "raw/sheet00.dng"} <= set(record.inputs)
    assert "raw/chart.dng" not in record.inputs
    assert jobs(project, LENS) == [] and "calibrate_lens" not in jobs(project, tile)
    shutil.copy(project / "raw/sheet01.dng", project / "raw/sheet02.dng")
    assert jobs(project, LENS) == ["calibrate_lens"]


def looked_at(folder) -> tuple[list[str], dict]:
    """Return the findings about the photographs of the sheet, and the optics measured from them."""
    optics: dict = {}
    found = PhotographCheck(load_project([]), optics=optics).findings()
    return [str(finding) for finding in found if "sheet" in str(finding)], optics


@pytest.mark.heavy
def test_a_check_measures_the_lens_and_names_photographs_without_the_sheet(project, monkeypatch):
    monkeypatch.chdir(project)
    findings, optics = looked_at(project)
    assert findings == [] and abs(optics["own"].focal_length_mm - 7.5) < 0.02
    shutil.copy(project / "raw/plate.dng", project / "raw/sheet03.dng")
    (said,), optics = looked_at(project)
    assert said.startswith("warning") and "sheet03.dng: left out, 0 of the sheet's corners" in said and "own" in optics
    for number in range(1, len(PLACES)):
        shutil.copy(project / "raw/plate.dng", project / f"raw/sheet{number:02}.dng")
    findings, optics = looked_at(project)
    assert any(said.startswith("error") and "the sheet in 1 photograph" in said for said in findings) and not optics


@pytest.mark.heavy
def test_without_opencv_a_check_says_what_is_missing_and_goes_on(project, monkeypatch):
    monkeypatch.chdir(project)
    monkeypatch.setitem(sys.modules, "cv2", None)
    check = PhotographCheck(load_project([]))
    (said,) = [str(finding) for finding in check.findings() if "OpenCV" in str(finding)]
    assert said.startswith("error: the role lens needs OpenCV") and check.count >= 3


@pytest.mark.heavy
def test_a_preview_draws_outlines_with_the_measured_lens(project, monkeypatch):
    monkeypatch.chdir(project)

    def outline() -> str:
        main(["preview", "-o", "page.html"])
        figure = next(part for part in Path("page.html").read_text().split("<figure")[1:] if "<b>plate.dng</b>" in part)
        return re.search(r'<path[^>]* d="([^"]+)"', figure)[1]

    measured = outline()
    optics = LensFile.load(made_lens(project)).optics.plain()
    edit(project / "config/cameras/own.yaml", {"optics": optics})
    (project / "raw/captures.csv").write_text(
        "\n".join(line for line in (project / "raw/captures.csv").read_text().splitlines() if ",lens," not in line)
    )
    assert measured == outline()
    edit(project / "config/cameras/own.yaml", {"optics": optics | {"focal_length_mm": 7.0}})
    assert measured != outline()
