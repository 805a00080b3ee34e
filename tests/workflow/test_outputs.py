"""Planning of a scene's further outputs, and the checks of its display's file."""

import numpy as np
import pytest
from project import edit, planned, small_project, snakemake

from irodori.colour.icc import Profile, write_profile
from irodori.colour.tone_curves import SRGB


@pytest.mark.heavy
def test_further_files_and_the_displays_profile_are_planned(tmp_path):
    folder = small_project(tmp_path / "still-life")
    matrix = np.array([[0.4867, 0.2657, 0.1982], [0.2290, 0.6917, 0.0793], [0.0, 0.0451, 1.0439]])
    device = {"kind": "profile", "file": "monitor.icc"}
    edit(
        folder / "config/scenes/still-life.yaml",
        {"further_outputs": ["xyz-exr", "tiff"], "display": {"device": device}},
    )
    refused = snakemake(folder, "--dry-run")
    assert (
        refused.returncode != 0
        and "display.device.file: found no such file: monitor.icc" in refused.stdout + refused.stderr
    )
    (folder / "monitor.icc").write_bytes(write_profile(Profile("monitor", matrix, (SRGB,) * 3)))
    run = snakemake(folder, "--dry-run")
    rules = [rule for rule, _ in planned(run)]
    assert {"write_xyz", "write_tiff"} <= set(rules) and "write_tiff" not in _default_rules(tmp_path)
    watched = [line for line in run.stdout.splitlines() if line.strip().startswith("input:") and "monitor.icc" in line]
    # The PNGs of the view and of its truth, the TIFF, the comparison with the photograph.
    assert len(watched) == 4


def _default_rules(folder) -> set[str]:
    return {rule for rule, _ in planned(snakemake(small_project(folder / "default"), "--dry-run"))}
