"""A lens measured from photographs of the printed sheet: a rule makes it, and the jobs of objects wait for it."""

import shutil

import numpy as np
import pytest
import yaml
from drawn_sheets import HEIGHT, PITCH_UM, PLACES, TRUE, WIDTH, photographed, store
from project import edit, planned, small_project, snakemake

from irodori.config.capture_table import COLUMNS
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


def jobs(folder, *arguments) -> list[str]:
    return [rule for rule, _ in planned(snakemake(folder, "--dry-run", *arguments))]


def test_the_sheet_in_a_cameras_table_measures_its_lens_and_a_changed_photograph_measures_it_again(project):
    tile = "results/own-plate/observations/tile-000.h5"
    assert {"calibrate_lens", "rectify_object"} <= set(jobs(project, tile))
    run = snakemake(project, LENS)
    assert run.returncode == 0, run.stderr[-3000:]
    found = LensFile.load(project / LENS)
    assert abs(found.optics.focal_length_mm - 7.5) < 0.02 and "7.1 % more than the typed 7 mm" in found.remarks[0]
    record = read_record(project / LENS)
    assert record is not None and {"raw/captures.csv", "raw/sheet00.dng"} <= set(record.inputs)
    assert "raw/chart.dng" not in record.inputs
    assert jobs(project, LENS) == [] and "calibrate_lens" not in jobs(project, tile)
    shutil.copy(project / "raw/sheet01.dng", project / "raw/sheet02.dng")
    assert jobs(project, LENS) == ["calibrate_lens"]
