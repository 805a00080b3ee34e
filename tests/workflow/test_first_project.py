"""`irodori init` and what follows it: few words make of photographs what written definitions make of them."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from project import ROOT, edit, small_project, snakemake

from irodori.command_line import main
from irodori.config.capture_table import read_captures
from irodori.core.store import open_file
from irodori.material.lobe_choices import chosen_model
from irodori.spectra.published import chart_spectra

ANSWERS = {
    "camera_distance_mm": "900", "lamp": "A", "focal_length_mm": "50", "pixel_pitch_um": "10", "shape": "plate 90",
    "light_deg": "45", "camera_deg": "0 20 35 41 45 49 55 65",
}  # fmt: skip
S40 = ROOT.parent / "shared" / "data" / "raw" / "powershot_s40_chart.crw"


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> Path:
    """Return a folder in which written definitions photographed and fitted a plate, as many texels as init gives it."""
    folder = small_project(tmp_path_factory.mktemp("written"))
    # Photographs of one object, as they are in the other project.
    edit(folder / "config/config.yaml", {"rectify.tile_texels": 40000, "photographed_together": []})
    edit(folder / "config/objects/tile-plate.yaml", {"texels": {"width": 128, "height": 128}})
    run = snakemake(folder, "results/tile-plate/surface.h5")
    assert run.returncode == 0, run.stderr[-4000:]
    return folder


@pytest.fixture
def started(tmp_path, monkeypatch) -> Path:
    """Return the working directory, which holds the workflow's own configuration and no definition."""
    (tmp_path / "config").mkdir()
    shutil.copy(ROOT / "config/config.yaml", tmp_path / "config")
    edit(tmp_path / "config/config.yaml", {"rectify.tile_texels": 40000})
    monkeypatch.chdir(tmp_path)
    return tmp_path


def calibrated(photograph: Path) -> np.ndarray:
    """Return the spectral errors, leave-one-patch-out, of a camera of one photograph of a chart, a patch each."""
    Path("answers.yaml").write_text("lamp: A\n")
    assert main(["init", str(photograph), "--name", "eye", "--answers", "answers.yaml"]) == 0
    run = snakemake(Path.cwd(), "--configfile=config/eye.yaml", "calibrate")
    assert run.returncode == 0, run.stderr[-4000:]
    with open("results/cameras/eye/calibration_errors.csv", newline="") as stream:
        rows = {row["patch"]: float(row["spectral_rmse"]) for row in csv.DictReader(stream)}
    return np.array([rows[name] for name in chart_spectra("BabelColor Average")[0]])


@pytest.mark.heavy
def test_fifteen_words_fit_what_the_written_definitions_fit(fitted, started, capsys):
    photographs = started / "My plate"
    photographs.mkdir()
    number = 0
    for name in ("cameras/d5100-comb", "tile-plate"):
        taken = fitted / "results" / name / "captures"
        for shot in read_captures(taken / "captures.csv"):
            shutil.copy(taken / shot.file, photographs / f"IMG {number:04d}.dng")
            number += 1
    assert sum(len(words.split()) for words in ANSWERS.values()) <= 15
    (started / "answers.yaml").write_text(yaml.safe_dump(ANSWERS))
    assert main(["init", "My plate", "--answers", "answers.yaml"]) == 0, capsys.readouterr().out
    # The virtual rig knows the size of its lamp, and fits no readings in the lamp's mirror image.
    edit(started / "config/rigs/my-plate-rig.yaml", {"light.angular_radius_deg": 0.25})
    run = snakemake(started, "--configfile=config/my-plate.yaml", "results/my-plate/surface.h5")
    assert run.returncode == 0, run.stderr[-4000:]
    written, own = fitted / "results/tile-plate", started / "results/my-plate"
    assert chosen_model(own / "lobes.h5") == {"lobes": ("gaussian",), "coat": "sum"}
    names = sorted(path.name for path in (written / "linear").glob("*.h5"))
    assert len(names) == 8 and names == sorted(path.name for path in (own / "linear").glob("*.h5"))
    for name in names:
        with open_file(written / "linear" / name) as one, open_file(own / "linear" / name) as other:
            np.testing.assert_allclose(other.read("response"), one.read("response"), rtol=1e-6, atol=1e-9)
    with open_file(written / "surface.h5") as one, open_file(own / "surface.h5") as other:
        assert np.isfinite(one.read("alpha")).mean() > 0.9 and np.isfinite(one.read("mu")).mean() > 0.5
        for quantity in ("alpha", "beta", "mu", "alpha_error", "diffuse_response", "status"):
            np.testing.assert_allclose(other.read(quantity), one.read(quantity), rtol=1e-6, err_msg=quantity)


@pytest.mark.heavy
def test_one_photograph_of_a_chart_calibrates_a_camera(fitted, started):
    errors = calibrated(fitted / "results/cameras/d5100-comb/captures/chart-out-20000us.dng")
    assert len(errors) == 24 and errors.mean() < 0.05


@pytest.mark.heavy
@pytest.mark.skipif(not S40.is_file(), reason=f"no published photograph {S40.name}")
def test_a_published_photograph_of_a_chart_calibrates_its_camera(started):
    errors = calibrated(S40)
    assert len(errors) == 24 and errors.mean() < 0.06
