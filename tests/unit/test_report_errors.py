"""Errors of the report: what is left out of them, and how bright pixels are compared."""

import colour
import numpy as np
import pytest
from scenes import constant_light

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.parts import Staging
from irodori.core import store
from irodori.evaluation.result_tables import read_errors
from irodori.evaluation.truth_errors import interior, measure_errors, radiance_delta_e
from irodori.export.pictures import write_spectral_exr
from irodori.light.placed_lights import unit_luminance
from irodori.material.material_file import Material
from irodori.spectra.published import spectrum


def checks(height: int, width: int, side: int) -> Material:
    """Return a truth of two materials in checks."""
    row, column = np.indices((height, width)) // side
    index = (row + column) % 2
    flat = np.full((height, width), 0.5)
    one_hot = np.eye(2, dtype=np.float32)[index]
    return Material(flat, flat, flat, flat, one_hot, np.full((61, 2), 0.5), np.ones(61), np.zeros(61), 0.0, (1.0, 0.1))


def test_two_texels_on_either_side_of_a_seam_are_left_out_and_the_border_is_kept():
    inside = interior(checks(20, 30, 10))
    rows = np.array([r not in (8, 9, 10, 11) for r in range(20)])
    columns = np.array([c not in (8, 9, 10, 11, 18, 19, 20, 21) for c in range(30)])
    np.testing.assert_array_equal(inside, rows[:, None] & columns[None, :])


def test_a_single_material_has_no_seam():
    assert interior(checks(12, 12, 100)).all()


def test_equal_pictures_differ_by_nothing_and_a_tint_shows_however_bright():
    white = spectrum("D65")
    grey = np.stack([white * level for level in (0.01, 0.5, 1.0, 50.0)])
    np.testing.assert_allclose(radiance_delta_e(grey, grey, white), 0.0, atol=1e-9)
    tinted = grey * np.linspace(0.95, 1.05, 61)
    difference = radiance_delta_e(grey, tinted, white)
    assert (difference > 0.1).all()
    # Above white both are scaled alike: the same tint is the same difference.
    assert difference[3] == pytest.approx(difference[2], rel=1e-9)


def test_the_pictures_error_in_the_table_is_plain_ciede2000_up_to_white_and_scaled_beyond(tmp_path):
    """What is darker than white is compared as it is; a pixel five times white as one at white, both scaled alike."""
    provenance = store.Provenance("test")
    constant_light(1.0).save(tmp_path / "e.h5", provenance)
    rng = np.random.default_rng(4)
    truth = rng.uniform(0.02, 0.98, (6, 8, 61)).astype(np.float32)
    found = truth * rng.uniform(0.8, 1.2, (6, 8, 61)).astype(np.float32)
    bright = (slice(0, 1), slice(0, 4))
    truth[bright] += 5.0
    for name, radiance in (("true", truth), ("found", found)):
        write_spectral_exr(tmp_path / f"{name}.exr", radiance, radiance[..., :3], {})
    inputs = {key: [] for key in ("materials", "true_materials", "environments", "true_environments", "calibrations")}
    inputs |= {"view_lights": [tmp_path / "e.h5"], "views": [tmp_path / "found.exr"]}
    inputs |= {"true_views": [tmp_path / "true.exr"]}
    names = {"cameras": [], "objects": [], "environments": [], "views": ["s/v"], "view_environments": ["e"]}
    scene = Staging.of({"lights": [], "display": {"exposure": "auto"}})
    measure_errors(inputs, names, [scene], ["D65"], tmp_path / "errors.csv")
    row = read_errors(tmp_path / "errors.csv")[0]
    matrix = xyz_from_radiance(np.ones(61))
    pair = [radiance.astype(float) @ matrix.T for radiance in (truth, found)]
    scale = pair[0][bright][..., 1:2] / 100.0
    for xyz in pair:
        xyz[bright] /= scale
    white = matrix @ np.ones(61)
    white_xy = white[:2] / white.sum()
    lab = [colour.XYZ_to_Lab(xyz / 100.0, white_xy) for xyz in pair]
    expected = colour.difference.delta_E_CIE2000(*lab)
    for name, value in (("mean", expected.mean()), ("p95", np.percentile(expected, 95)), ("max", expected.max())):
        assert float(row[name]) == pytest.approx(value, rel=2e-3), name


def test_a_pictures_error_is_judged_against_a_white_that_counts_the_scenes_lights(tmp_path):
    """Under a lamp nine times the environment the same difference is that of a darker colour: its ΔE is smaller."""
    provenance = store.Provenance("test")
    constant_light(0.5).save(tmp_path / "e.h5", provenance)
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.05, 0.4, (6, 8, 61)).astype(np.float32)
    pictures = {"true": truth, "found": truth * rng.uniform(0.9, 1.1, truth.shape[:2])[..., None].astype(np.float32)}
    for name, radiance in pictures.items():
        write_spectral_exr(tmp_path / f"{name}.exr", radiance, radiance[..., :3], {})
    lamp = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": 0.0, "elevation_deg": 90.0, "irradiance": 4.5}
    found = {}
    for label, lights, exposure in (("dark", [], "auto"), ("lit", [lamp], "auto"), ("exposed", [], 2.0)):
        inputs = {key: [] for key in ("materials", "true_materials", "environments", "true_environments")}
        inputs |= {"calibrations": [], "view_lights": [tmp_path / "e.h5"]}
        inputs |= {"views": [tmp_path / "found.exr"], "true_views": [tmp_path / "true.exr"]}
        names = {"cameras": [], "objects": [], "environments": [], "views": ["s/v"], "view_environments": ["e"]}
        scene = Staging.of({"lights": lights, "display": {"exposure": exposure}})
        measure_errors(inputs, names, [scene], ["D65"], tmp_path / "errors.csv")
        found[label] = float(read_errors(tmp_path / "errors.csv")[0]["mean"])
    white = 0.5 + 4.5 * unit_luminance("D65")
    assert found["lit"] == pytest.approx(radiance_delta_e(truth, pictures["found"], white).mean(), rel=1e-4)
    assert found["exposed"] == pytest.approx(
        radiance_delta_e(truth, pictures["found"], np.full(61, 0.25)).mean(), rel=1e-3
    )
    assert found["lit"] < 0.8 * found["dark"]
