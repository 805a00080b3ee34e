"""Errors of the report: what is left out of them, and how bright pixels are compared."""

from dataclasses import replace

import colour
import numpy as np
import pytest
from scenes import constant_light

from irodori.colour.colorimetry import delta_e, delta_e_reflectance, lab_from_xyz, xyz_from_radiance
from irodori.config.models import Scene
from irodori.core import store
from irodori.evaluation.result_tables import ErrorRow, read_rows
from irodori.evaluation.truth_errors import (
    alpha_coverage,
    environment_errors,
    interior,
    material_errors,
    measure_errors,
    radiance_delta_e,
)
from irodori.export.pictures import write_spectral_exr
from irodori.light.environment_file import directions
from irodori.light.placed_lights import unit_luminance
from irodori.material.material_file import Material, Status
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


def seen_from_above(**keys) -> Scene:
    """A picture of 8 x 6 pixels, each 10 mm wide, of an empty table."""
    view = {"kind": "orthographic", "position_mm": [0.0, 0.0, 100.0], "target_mm": [0.0, 0.0, 0.0],
            "up": [0.0, 1.0, 0.0], "height_mm": 60.0}  # fmt: skip
    size = {"width": 8, "height": 6}
    return Scene.of({"environment": "e", "image": size, "views": {"v": view}, "objects": []} | keys)


def test_the_pictures_error_in_the_table_is_plain_ciede2000_up_to_white_and_scaled_beyond(tmp_path):
    """What is darker than white is compared as it is; a pixel five times white as one at white, both scaled alike."""
    provenance = store.Provenance("test")
    constant_light(1.0).save(tmp_path / "e.h5", provenance)
    rng = np.random.default_rng(4)
    truth = rng.uniform(0.02, 0.98, (6, 8, 61)).astype(np.float32)
    found = truth * rng.uniform(0.8, 1.2, (6, 8, 61)).astype(np.float32)
    bright = (slice(0, 1), slice(0, 4))
    truth[bright] += 5.0
    found[4:, :5] = truth[4:, :5]  # no object
    body = (slice(0, 6), slice(6, 8))  # whose material is given
    for name, radiance in (("true", truth), ("found", found)):
        write_spectral_exr(tmp_path / f"{name}.exr", radiance, radiance[..., :3], {})
    inputs = {key: [] for key in ("materials", "true_materials", "environments", "true_environments", "calibrations")}
    inputs |= {"light": [tmp_path / "e.h5"], "views": [tmp_path / "found.exr"]}
    inputs |= {"true_views": [tmp_path / "true.exr"]}
    names = {"cameras": [], "objects": [], "environments": [], "views": ["s/v"], "light": "e"}
    board = {"shape": {"kind": "plate", "width_mm": 19.0, "height_mm": 60.0}, "position_mm": [30.0, 0.0, 0.0],
             "material": {"spectrum": "TCS1"}}  # fmt: skip
    measure_errors(inputs, names, seen_from_above(bodies=[board]), [], ["D65"], tmp_path / "errors.csv")
    row, objects = read_rows(tmp_path / "errors.csv", ErrorRow)
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
        assert getattr(row, name) == pytest.approx(value, rel=2e-3), name
    own = expected.sum() - expected[body].sum()
    assert objects.count == 6 * 6 - 2 * 5 and objects.mean == pytest.approx(own / objects.count, rel=2e-3)


def test_a_pictures_error_is_judged_against_a_white_that_counts_the_scenes_lights(tmp_path):
    """Under a lamp nine times the environment the same difference is that of a darker colour: its ΔE is smaller."""
    provenance = store.Provenance("test")
    constant_light(0.5).save(tmp_path / "e.h5", provenance)
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.05, 0.4, (6, 8, 61)).astype(np.float32)
    pictures = {"true": truth, "found": truth * rng.uniform(0.9, 1.1, truth.shape[:2])[..., None].astype(np.float32)}
    for name, radiance in pictures.items():
        write_spectral_exr(tmp_path / f"{name}.exr", radiance, radiance[..., :3], {}, storage="single")
    lamp = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": 0.0, "elevation_deg": 90.0, "irradiance": 4.5}
    found = {}
    for label, lights, exposure in (("dark", [], "auto"), ("lit", [lamp], "auto"), ("exposed", [], 2.0)):
        inputs = {key: [] for key in ("materials", "true_materials", "environments", "true_environments")}
        inputs |= {"calibrations": [], "light": [tmp_path / "e.h5"]}
        inputs |= {"views": [tmp_path / "found.exr"], "true_views": [tmp_path / "true.exr"]}
        names = {"cameras": [], "objects": [], "environments": [], "views": ["s/v"], "light": "e"}
        scene = seen_from_above(lights=lights, display={"exposure": exposure})
        measure_errors(inputs, names, scene, [], ["D65"], tmp_path / "errors.csv")
        found[label] = read_rows(tmp_path / "errors.csv", ErrorRow)[0].mean
    white = 0.5 + 4.5 * unit_luminance("D65")
    assert found["lit"] == pytest.approx(radiance_delta_e(truth, pictures["found"], white).mean(), rel=1e-4)
    assert found["exposed"] == pytest.approx(
        radiance_delta_e(truth, pictures["found"], np.full(61, 0.25)).mean(), rel=1e-3
    )
    assert found["lit"] < 0.8 * found["dark"]


def off_by_known_amounts() -> tuple[Material, Material]:
    """Return a material and its truth: two paints, a column at the edge that nobody saw, gloss off where it is known.

    Of the 12 columns 2 to 9 lie at no edge of what is seen; the seam is between columns 5 and 6.
    """
    side = 12
    column = np.broadcast_to(np.arange(side), (side, side))
    spectra = np.linspace([0.2, 0.6], [0.5, 0.3], 61)
    paint = column * 2 // side
    green = spectra[30][paint]
    beta, mu, one_hot = np.full((side, side), 2.0), np.full((side, side), 0.1), np.eye(2, dtype=np.float32)[paint]
    truth = Material(green, beta, mu, green, one_hot, spectra, np.full(61, 1.5), np.zeros(61), 0.0, (2.0, 0.1))
    wide = spectra * np.linspace(0.9, 1.2, 61)[:, None]
    scale = np.where(column < 3, 1.1, 1.0)  # of the spectrum to what the green response says
    alpha = np.where(column == 11, np.nan, wide[30][paint] * scale)
    beta, mu = np.where(column < 2, 2.5, 2.2), np.where(column < 2, np.nan, 0.08)
    beta[:, 4:8] = 50.0  # at the seam
    found = replace(truth, alpha=alpha, green_response=alpha / scale, beta=beta, mu=mu, basis=wide)
    return found, truth


def test_every_row_of_a_material_says_what_it_is_off_by():
    found, truth = off_by_known_amounts()
    rows = {(row.quantity, row.light): row for row in material_errors("tile", found, truth, ["D65", "A"])}
    assert {row.subject for row in rows.values()} == {"tile"} and len(rows) == 2 * (2 + 2) + 4
    column = np.broadcast_to(np.arange(12), (12, 12))
    seen, inside = column < 11, (column < 4) | (column > 7)
    for label, chosen in (("", seen), (" away from seams", seen & inside)):
        exact, own = (m.coefficients[chosen] @ m.basis.T for m in (truth, found))
        for light in ("D65", "A"):
            row, off = rows[f"reflectance CIEDE2000{label}", light], delta_e_reflectance(exact, own, light)
            assert row.count == chosen.sum() and row.mean == pytest.approx(off.mean())
            assert row.p95 == pytest.approx(np.percentile(off, 95)) and row.max == pytest.approx(off.max())
        row = rows[f"reflectance spectral RMSE{label}", ""]
        assert row.mean == pytest.approx(np.sqrt(((exact - own) ** 2).mean(axis=1)).mean(), rel=1e-5)
        cosine = (exact * own).sum(axis=1) / np.linalg.norm(exact, axis=1) / np.linalg.norm(own, axis=1)
        assert rows[f"reflectance 1 - GFC{label}", ""].mean == pytest.approx((1 - cosine).mean(), rel=1e-3)
    row = rows["alpha absolute away from seams", ""]
    assert row.mean == pytest.approx(np.abs(found.alpha - truth.alpha)[seen & inside].mean()) and row.count == 84
    # The first two columns state no roughness, so that their strength is none of a known highlight.
    row = rows["beta relative away from seams, where known", ""]
    assert (row.count, row.mean, row.max) == (12 * 6, pytest.approx(0.1), pytest.approx(0.1))
    row = rows["mu relative away from seams, where known", ""]
    assert (row.count, row.mean, row.max) == (12 * 6, pytest.approx(0.2), pytest.approx(0.2))
    row = rows["alpha / S_G - 1", ""]
    assert row.count == 12 * 11 and row.max == pytest.approx(0.1) and row.mean == pytest.approx(0.1 * 3 / 11)


def test_the_coverage_of_alphas_error_tells_what_all_texels_share_from_each_ones_own(tmp_path):
    """α off by 3 % in common, which is stated as 2 %, and by 1 % in each texel, as stated."""
    rng, truth = np.random.default_rng(3), checks(40, 40, 100)
    alpha = 1.03 * truth.alpha * (1.0 + 0.01 * rng.normal(size=truth.alpha.shape))
    found = replace(truth, alpha=alpha, extra={"alpha_error": (np.hypot(0.02, 0.01) * alpha, "1", "error")})
    found.save(tmp_path / "found.h5", store.Provenance("test"), errors={"common_error": 0.02})
    rows = {row.quantity: row for row in alpha_coverage("tile", tmp_path / "found.h5", found, truth)}
    assert {row.count for row in rows.values()} == {1600, 1}
    assert rows["alpha within 1 standard error"].mean < 0.25
    assert rows["alpha within 2 standard errors"].mean > 0.9
    assert rows["alpha within 1 standard error, without the common factor"].mean == pytest.approx(0.683, abs=0.03)
    assert rows["alpha within 2 standard errors, without the common factor"].mean == pytest.approx(0.954, abs=0.015)
    assert rows["common factor of alpha over its standard error"].mean == pytest.approx(1.5, abs=0.03)
    found.save(tmp_path / "old.h5", store.Provenance("test"))
    assert alpha_coverage("tile", tmp_path / "old.h5", found, truth) == []


def test_weights_beside_seams_or_of_nothing_are_not_counted_in_their_coverage(tmp_path):
    """A seam, where the truth is a mixture, and a hole in the truth, as where an object has no paint."""
    truth = checks(20, 20, 10)
    hole = truth.alpha.copy()
    hole[2:5, 2:5] = 0.0
    truth = replace(truth, alpha=hole)
    stated = np.full(truth.alpha.shape, 0.05)
    found = replace(truth, alpha=np.where(interior(truth) & (hole > 0.0), hole + 0.01, 7.0))
    with store.create(tmp_path / "found.h5", store.Provenance("test")) as out:
        out.write("alpha_error", stated, units="1", dims="row,column", quantity="standard error")
        out.attribute("errors", {"common_error": 0.0})
    rows = {row.quantity: row for row in alpha_coverage("tile", tmp_path / "found.h5", found, truth)}
    assert {row.count for row in rows.values()} == {int(interior(truth).sum()) - 9}
    assert rows["alpha within 1 standard error"].mean == 1.0
    # No error is stated that all texels share: there is none to compare the median's with.
    assert "common factor of alpha over its standard error" not in rows


def test_a_recovered_light_is_judged_by_its_picture_and_its_irradiance():
    truth = constant_light(2.0)
    same = environment_errors("room", truth, truth)
    assert [row.quantity for row in same] == ["light CIEDE2000", "irradiance CIEDE2000"]
    assert all(row.max < 1e-6 and row.subject == "room" for row in same)
    # Half as bright as white in white's own colour: grey of Y = 50.
    half = environment_errors("room", replace(truth, basis=truth.basis * 0.5), truth)
    grey = delta_e(lab_from_xyz(np.array([50.0, 50.0, 50.0]), np.full(3, 100.0)), np.array([100.0, 0.0, 0.0]))
    assert half[0].mean == pytest.approx(grey, rel=1e-3) and half[1].mean == pytest.approx(grey, rel=0.01)
    # Light from above alone: a surface is as bright as the part of the sky that it sees.
    sky = 0.5 * (1.0 + directions(128, 64)[0][..., 2:])
    above = replace(truth, irradiance=(sky * truth.irradiance[0, 0]).astype(np.float32))
    dim = environment_errors("room", replace(above, irradiance=0.5 * above.irradiance), above)[1]
    seen = [lab_from_xyz(np.tile(y * 100.0 * sky, 3), np.full(3, 100.0)) for y in (1.0, 0.5)]
    assert dim.mean == pytest.approx(delta_e(*seen).mean(), rel=0.01)
    # The picture alone, and the irradiance alone.
    picture = environment_errors("room", replace(truth, coefficients=truth.coefficients * 0.5), truth)
    assert picture[0].mean == pytest.approx(grey, rel=1e-3) and picture[1].max < 1e-6
    assert picture[0].count == truth.coefficients[::4, ::4, 0].size and picture[1].count == 64 * 128


def test_the_outcome_of_a_fit_and_of_a_calibration_stand_in_the_table(tmp_path):
    provenance = store.Provenance("test")
    found, truth = off_by_known_amounts()
    residual = np.full((12, 12), 0.02)
    residual[0] = 0.05
    status = np.zeros((12, 12), np.uint8)
    status[:, :3] = Status.MU_UNIDENTIFIABLE
    found = replace(found, extra={
        "relative_residual": (residual, "1", "residual"), "status": (status, "1", "outcome"),
    })  # fmt: skip
    found.save(tmp_path / "found.h5", provenance)
    truth.save(tmp_path / "true.h5", provenance)
    constant_light(1.0).save(tmp_path / "light.h5", provenance)
    with store.create(tmp_path / "calibration.h5", provenance) as out:
        for name, values in (("rmse", [0.01, 0.03]), ("delta_e_d65", [1.0, 2.0])):
            out.write(f"leave_one_out/{name}", np.array(values), units="1", dims="patch", quantity=name)
    inputs = {"materials": [tmp_path / "found.h5"], "true_materials": [tmp_path / "true.h5"],
              "environments": [tmp_path / "light.h5"], "true_environments": [tmp_path / "light.h5"],
              "calibrations": [tmp_path / "calibration.h5"]}  # fmt: skip
    inputs |= {"light": [], "views": [], "true_views": []}
    names = {"cameras": ["cam"], "objects": ["tile"], "environments": ["room"], "views": [], "light": ""}
    measure_errors(inputs, names, None, [], ["D65", "A"], tmp_path / "errors.csv")
    rows = {(row.subject, row.quantity, row.light): row for row in read_rows(tmp_path / "errors.csv", ErrorRow)}
    assert rows["cam", "leave-one-patch-out spectral RMSE", ""].mean == 0.02
    assert rows["cam", "leave-one-patch-out CIEDE2000", "D65"].max == 2.0
    assert ("cam", "leave-one-patch-out CIEDE2000", "A") not in rows
    row = rows["tile", "residual over response", ""]
    assert row.mean == pytest.approx(0.0225) and row.count == 144
    assert rows["tile", "share of texels: ok", ""].mean == 0.75
    assert rows["tile", "share of texels: mu unidentifiable", ""].mean == 0.25
    assert ("tile", "alpha / S_G - 1", "") in rows and ("room", "light CIEDE2000", "") in rows
