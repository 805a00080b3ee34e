"""Transmittance of a thin sheet: photographed on the virtual rig with the lamp behind it, or assumed."""

import logging

import numpy as np
import pytest
from definitions import ROOT
from small_chain import run_chain, small_camera, small_rig

from irodori.config.definitions import read_yaml
from irodori.config.models import Object
from irodori.core import store
from irodori.core.errors import InputError
from irodori.material.passed_light import PassedLight
from irodori.simulation.virtual_rig.ground_truth import true_material

#: A leaf of two shades: what is reflected, and what comes through.
SHADES = [("TCS31", "TCS81"), ("TCS20", 0.1)]
FRONT = {"light_deg": [45.0], "camera_deg": [0.0, 20.0, 41.0, 49.0, 65.0]}
BEHIND = {"light_deg": [115.0, 125.0], "camera_deg": [20.0]}


def leaf(sheet: dict, poses=(FRONT, BEHIND)) -> Object:
    """Return the default plate as a leaf of 12 x 12 texels."""
    paints = [{"spectrum": s, "beta": 2.0, "mu_rad": 0.15, "transmittance": t} for s, t in SHADES]
    return Object.of(
        read_yaml(ROOT / "config/objects/tile-plate.yaml")
        | {"mirror_weight": 0.0, "texels": {"width": 12, "height": 12}, "poses": list(poses), "sheet": sheet,
           "virtual": {"pattern": {"kind": "checks", "columns": 2, "rows": 1}, "materials": paints}}
    )  # fmt: skip


@pytest.fixture(scope="module")
def setting():
    """Return camera and rig, with the rig's faults but for the place, and no table in the way."""
    return small_camera(), small_rig(without=("laid_off", "focal_length"), table_radius_mm=0.0)


def test_what_passes_through_a_leaf_is_measured_with_the_lamp_behind_it(setting, tmp_path):
    """Spectra, errors, and the front, which the photographs from behind do not change."""
    definition = leaf({})
    found, truth = run_chain(definition, *setting, tmp_path), true_material(definition, *setting)
    assert found.transmittance == "measured" and found.is_sheet
    inner = np.zeros((12, 12), dtype=bool)
    inner[2:10, [2, 3, 8, 9]] = True  # away from seam and edges
    own, exact = ((m.through.coefficients @ m.through.basis.T)[inner] for m in (found, truth))
    assert np.isfinite(own).all()
    with store.open_file(tmp_path / "material.h5") as file:
        error, figures = file.read("transmittance_error")[inner], file.attribute("errors", dict)["transmittance"]
        albedo = file.read("albedo")[inner]
    off = np.sqrt(np.mean((own - exact) ** 2, axis=1))
    assert off.mean() < 0.04 and np.mean(off < 2.0 * error) > 0.9
    assert abs(own.mean() - exact.mean()) < 0.01 and figures["source"] == "measured"
    assert figures["mean"] == pytest.approx(exact.mean(), rel=0.05)
    reflected = (found.coefficients @ found.basis.T)[inner]
    known = np.isfinite(reflected).all(axis=1)  # a front that few pixels show may have gaps
    assert known.mean() > 0.9
    assert (albedo > (reflected + own).max(axis=1) - 0.01)[known].all()  # of both sides together


def test_a_sheet_that_no_lamp_lights_from_behind_is_refused_or_assumed(setting, tmp_path, caplog):
    with caplog.at_level(logging.INFO, "irodori"):
        found = run_chain(leaf({"transmittance": 0.3}, [FRONT]), *setting, tmp_path)
    assert "assumed" in caplog.text and found.transmittance == "assumed" and found.is_sheet
    np.testing.assert_allclose(found.through.spectra(), 0.3, rtol=1e-6)
    with pytest.raises(InputError, match="passed: found no texel that shows light from behind; accepted: a photograph"):
        PassedLight([tmp_path / "tile.h5"], [])
