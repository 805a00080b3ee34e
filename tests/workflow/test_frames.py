"""Frame sequences in the workflow: asked for by a scene alone, and made by one job."""

import json
import sys

import numpy as np
import pytest
import yaml
from PIL import Image
from project import ROOT, edit, planned, small_project, snakemake

sys.path.insert(0, str(ROOT / "tests" / "unit"))

from irodori.core import store

FRAMES = {"kind": "turntable", "count": 3, "turned": "eye"}


@pytest.mark.heavy
def test_only_a_scene_that_defines_frames_has_them_and_one_job_makes_them(tmp_path):
    from scenes import constant_light, material

    folder = small_project(tmp_path)
    refused = snakemake(folder, "--dry-run", "results/still-life/front.frames.png")
    assert refused.returncode != 0 and "the scene still-life defines no frames" in refused.stderr + refused.stdout
    assert not [rule for rule, _ in planned(snakemake(folder, "--dry-run")) if rule == "render_frames"]

    edit(folder / "config/scenes/still-life.yaml", {"frames": FRAMES, "image": {"width": 12, "height": 9}})
    jobs = [job for job in planned(snakemake(folder, "--dry-run")) if job[0] == "render_frames"]
    assert jobs == [("render_frames", {"scene": "still-life", "view": "front"})]

    # The rule on its own, on materials and light that are there.
    provenance = store.Provenance("test")
    scene = yaml.safe_load((folder / "config/scenes/still-life.yaml").read_text())
    for number, name in enumerate(item["object"] for item in scene["objects"]):
        (folder / "results" / name).mkdir(parents=True, exist_ok=True)
        material(0.3 + 0.4 * number).save(folder / "results" / name / "material.h5", provenance)
    (folder / "results/environments").mkdir()
    constant_light(np.linspace(0.5, 1.5, 61)).save(folder / "results/environments/classroom.h5", provenance)
    asked = ("--allowed-rules", "render_frames", "--", "results/still-life/front.frames.png")
    run = snakemake(folder, *asked)
    assert run.returncode == 0, run.stderr[-4000:]
    made = folder / "results/still-life"
    assert sorted(p.name for p in (made / "front/frames").glob("*.png")) == ["00000.png", "00001.png", "00002.png"]
    with Image.open(made / "front.frames.png") as image:
        assert image.n_frames == 3 and image.size == (12, 9)
    told = json.loads((made / "front.frames.json").read_text())
    assert [frame["eye_deg"] for frame in told["frames"]] == [0.0, 120.0, 240.0]
