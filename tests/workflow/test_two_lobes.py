"""An object of two lobes goes through the chain, from its configuration to pictures, planned ones too, and errors.

Camera, light and sphere are those of the finished project; the plate is photographed anew.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from project import edit, snakemake

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.evaluation.truth_errors import interior
from irodori.export.pictures import read_xyz
from irodori.material.lobe_choices import read_choice
from irodori.material.material_file import Material
from irodori.spectra.grid import SAMPLES

#: A narrow highlight over a broad one, as under a coat of varnish: β and μ of the paper's lobe, then of GGX.
PAINTS = [("TCS20", 2.0, 0.07, 1.5, 0.35), ("TCS81", 1.5, 0.09, 2.0, 0.4),
          ("TCS31", 2.5, 0.08, 1.2, 0.3), ("TCS56", 2.0, 0.1, 1.5, 0.45)]  # fmt: skip

QUICK = "classroom-page"
#: Neither the costs of imperfections nor of poses: both are those of the paper's lobe and of GGX in any project.
ASKED = ("results/tile-plate/material.h5", "results/tile-plate/truth.h5", f"results/{QUICK}/front.exr",
         "results/still-life/front.exr", "results/still-life/photographs/front/comparison.json")  # fmt: skip


def component(material: Material, name: str) -> np.ndarray:
    """β or μ of a gloss component, (height, width)."""
    ((beta_2, mu_2),) = material.further_gloss
    return {"beta": material.beta, "mu": material.mu, "beta_2": beta_2, "mu_2": mu_2}[name]


@pytest.fixture(scope="module")
def made(finished, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("lobes") / "project"
    shutil.copytree(finished, folder, copy_function=shutil.copy2)
    materials = [
        {"spectrum": s, "beta": b1, "mu_rad": m1, "further_gloss": [{"lobe": "ggx", "beta": b2, "mu_rad": m2}]}
        for s, b1, m1, b2, m2 in PAINTS
    ]
    camera = [0.0, 28.0, 38.0, 43.0, 46.0, 50.0, 55.0, 62.0, 72.0]
    edit(
        folder / "config/objects/tile-plate.yaml",
        {
            "lobes": ["gaussian", "ggx"],
            "coat": "auto",
            "mirror_weight": 0.0,
            "virtual.materials": materials,
            "poses": [{"light_deg": [light], "camera_deg": camera} for light in (45.0, 60.0)],
        },
    )
    edit(folder / "config/scenes/still-life.yaml", {"integrator": {"kind": "reference", "samples": 64}})
    interactive = (folder / "config/scenes/still-life.yaml").read_text()
    (folder / f"config/scenes/{QUICK}.yaml").write_text(interactive)
    edit(
        folder / f"config/scenes/{QUICK}.yaml",
        {"integrator": {"kind": "interactive"}, "tolerance_ciede2000": 60.0, "photographs": {}},
    )
    edit(folder / "config/config.yaml", {"make.scenes": ["still-life", QUICK]})
    run = snakemake(folder, *ASKED)
    assert run.returncode == 0, run.stderr[-4000:]
    return folder


@pytest.mark.heavy
def test_both_lobes_are_recovered_where_the_data_calls_for_them(made):
    found, truth = (Material.load(made / f"results/tile-plate/{name}.h5") for name in ("material", "truth"))
    assert found.lobes == truth.lobes == ("gaussian", "ggx")
    tried = read_choice(made / "results/tile-plate/lobes.h5").candidates
    assert [(one.lobes, one.coat) for one in tried] == [(found.lobes, "sum"), (found.lobes, "coupled")]
    assert found.coat == truth.coat == "sum"
    chosen = found.observed & interior(truth)
    second = chosen & (component(found, "beta_2") > 0)
    assert chosen.mean() > 0.3 and second.sum() > 0.9 * chosen.sum()
    for name, limit in (("beta", 0.07), ("mu", 0.04), ("beta_2", 0.1), ("mu_2", 0.12)):
        ratio = component(found, name)[second] / component(truth, name)[second]
        assert np.nanmedian(np.abs(ratio - 1.0)) < limit, name


@pytest.mark.heavy
def test_pictures_and_photograph_have_both_lobes(made):
    results = made / "results"
    # The path tracer with the true materials, and what was measured: noise of 64 paths and the fit's errors.
    table = json.loads((results / "still-life/photographs/front/comparison.json").read_text())
    assert table["delta_e"]["mean"] < 4.0 and table["compared_fraction"] > 0.8
    # What the interactive integrator leaves out of the full model is predicted and checked.
    figures = json.loads((results / QUICK / "front.json").read_text())["plan"]
    plan = yaml.safe_load((results / QUICK / "plan.yaml").read_text())
    assert figures["predicted_delta_e"] == plan["predicted_delta_e"]
    left = 60.0 - plan["full_model_delta_e_to_reference"]["p99"]
    assert figures["delta_e_to_full_model"]["p99"] <= plan["predicted_delta_e"] + 0.02 <= left + 0.02
    matrix = xyz_from_radiance(np.ones(SAMPLES))
    traced, quick = (read_xyz(results / scene / "front.exr", matrix)[..., 1] for scene in ("still-life", QUICK))
    shown = traced > 0.05 * traced.max()
    ratio = quick[shown] / traced[shown]
    assert np.median(np.abs(ratio / np.median(ratio) - 1.0)) < 0.1


@pytest.mark.heavy
def test_a_tolerance_that_cannot_be_kept_leaves_no_plan(made, tmp_path):
    folder = Path(shutil.copytree(made, tmp_path / "copy", copy_function=shutil.copy2))
    scene = folder / f"config/scenes/{QUICK}.yaml"
    edit(scene, {"tolerance_ciede2000": 0.05})
    run = snakemake(folder, f"results/{QUICK}/front.png")
    said = run.stdout + run.stderr
    assert run.returncode != 0 and "tolerance_ciede2000: found 0.05" in said and "Traceback" not in said
    assert not (folder / "results" / QUICK / "plan.yaml").exists()
