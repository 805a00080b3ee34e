"""Equation (5) against measured materials: what it leaves, beside Lambert and GGX, and that its fits are minima."""

import numpy as np
import pytest
from test_fitting import gloss_over_beta
from test_fitting_hard import in_plane

from benchmarks import materials
from irodori.reflection.fresnel import fresnel_array

needs_data = pytest.mark.skipif(
    not (materials.DATA / "brdf").is_dir(), reason="no measured materials beside the repository"
)
GEOMETRY = in_plane(*np.meshgrid([10, 30, 50, 65, 75], np.linspace(0, 78, 14))).reshape(-1, 4)


def made_up(response) -> materials.Measured:
    response = np.atleast_2d(response)
    brdf = response / (np.pi * np.cos(GEOMETRY[:, 0]))
    return materials.Measured("made up", GEOMETRY, np.linspace(400, 700, len(response)), brdf)


def test_every_model_fits_what_it_made():
    cosine = np.cos(GEOMETRY[:, 0])
    truth = {"lambert": (0.4, 0.0, 1.0), "equation 5": (0.3, 2.0, 0.2), "ggx": (0.2, 0.7, 0.25)}
    made = {
        "lambert": 0.4 * cosine,
        "equation 5": 0.3 * cosine + 2.0 * gloss_over_beta(GEOMETRY, 0.2),
        "ggx": 0.2 * cosine + 0.7 * materials.ggx(GEOMETRY)(0.25),
    }
    for model, response in made.items():
        measured = made_up(response)
        fitted = materials.fit_all(measured)[model]
        assert materials.relative(measured, fitted, measured.trusted) < 1e-5
        assert fitted.parameters[0] == pytest.approx(truth[model], rel=1e-4)
    both = made_up(made["ggx"])
    assert materials.relative(both, materials.fit_all(both)["equation 5"], both.trusted) > 0.01


def test_the_ggx_lobe_is_reciprocal_and_keeps_energy():
    swapped = GEOMETRY[:, [1, 0, 2, 3]]
    for roughness in (0.05, 0.3, 1.0):
        forth, back = (materials.ggx(g)(roughness) / np.cos(g[:, 0]) for g in (GEOMETRY, swapped))
        np.testing.assert_allclose(forth, back, rtol=1e-12)
    # Without Fresnel's loss a narrow lobe at normal incidence returns what comes in, but for a tail below the horizon:
    # a share α² / (1 + α²) of the facets is steeper than 45°.
    theta, roughness = np.radians(np.linspace(0.001, 89.999, 20000)), 0.05
    geometry = np.stack([0 * theta, theta, theta / 2, theta / 2], axis=1)
    fresnel = fresnel_array(np.cos(theta / 2), materials.N, materials.K)
    returned = 2.0 * materials.ggx(geometry)(roughness) / fresnel * np.cos(theta) * np.sin(theta)
    assert 1.0 - 2.0 * roughness**2 < np.trapezoid(returned, theta) < 1.0


def test_outliers_are_counted_and_left_out():
    response = 0.4 * np.cos(GEOMETRY[:, 0])
    response[7] = 100.0
    measured = made_up(response)
    assert (~measured.trusted).sum() == 1
    fitted = materials.fit_all(measured)
    assert fitted["lambert"].parameters[0, 0] == pytest.approx(0.4)
    assert materials.relative(measured, fitted["equation 5"], measured.trusted) < 1e-6
    assert materials.fit_all(measured, keep_outliers=True)["lambert"].parameters[0, 0] > 1.0


@needs_data
@pytest.mark.heavy
@pytest.mark.parametrize("name", materials.MATERIALS)
def test_measured_materials_are_fitted_to_the_minimum_and_better_than_by_lambert(name):
    for measured in materials.read(name):
        chosen = slice(0, None, 30) if len(measured.wavelength_nm) > 1 else slice(None)
        part = measured._replace(wavelength_nm=measured.wavelength_nm[chosen], brdf=measured.brdf[chosen])
        fitted = materials.fit_all(part)
        errors = {model: materials.relative(part, fitted[model], part.trusted) for model in materials.MODELS}
        assert errors["equation 5"] < errors["lambert"] and errors["ggx"] < errors["lambert"]
        if name == materials.PTFE:
            assert errors["lambert"] < 0.08  # nearly a perfect diffuser, as it is known for
        assert (~measured.trusted).sum() <= 0.001 * measured.brdf.size
        for model in materials.MODELS[1:]:
            off = (fitted[model].predicted - part.response)[0, part.trusted[0]]
            assert np.sum(off**2) <= 1.0001 * materials.peer(part, model, 0, starts=8)


@needs_data
@pytest.mark.parametrize("name", materials.CORNELL[1:])
def test_halves_of_the_photographs_of_a_measured_paint_are_seldom_called_ok_and_differ(name):
    found = materials.halves(name, "ggx", 16, 1500, seed=5)
    for parameter in ("alpha", "beta", "mu"):
        assert found["ok"] * (1.0 - found[parameter]) < 0.02, parameter
    # Equation (5) denies these paints, and says so.
    assert materials.halves(name, "gaussian", 16, 1500, seed=5)["ok"] < 0.02
    assert materials.halves(name, "gaussian", 64, 300, seed=5)["ok"] < 0.005


@needs_data
@pytest.mark.heavy
@pytest.mark.parametrize("lobe", ["gaussian", "ggx"])
@pytest.mark.parametrize("name", materials.CORNELL[1:])
def test_halves_of_the_photographs_agree_on_the_texels_of_a_measured_paint(name, lobe):
    found = [materials.halves_of_paint(name, lobe, photographs, 600.0, seed=50) for photographs in (16, 32)]
    for parameter in ("alpha", "beta", "mu"):
        assert np.mean([half[parameter] for half in found]) > 0.9, parameter
    assert min(half["ok"] for half in found) > 0.6


@needs_data
@pytest.mark.heavy
def test_errors_of_the_gloss_of_a_paint_are_those_that_halves_show_though_the_lobe_has_another_form():
    off = []
    for seed in range(60, 68):
        one, other = (
            gloss for *_, gloss in materials.gloss_of_halves("cornell_krylon_blue", "gaussian", 32, 550.0, seed)
        )
        off.append((one.log_gloss - other.log_gloss) / np.sqrt(np.diag(one.error + other.error)))
    # Two standard deviations of what eight draws of normal errors would give.
    assert (np.sqrt(np.mean(np.square(off), axis=0)) < 1.5).all()


@needs_data
@pytest.mark.heavy
@pytest.mark.parametrize(
    ("lobe", "wavelength_nm", "seed"), [("gaussian", 650.0, 3), ("gaussian", 650.0, 4), ("ggx", 450.0, 60)]
)
def test_a_narrow_lobe_on_a_broad_one_is_not_left_out_as_clipped_highlights(lobe, wavelength_nm, seed):
    found = [gloss for *_, gloss in materials.gloss_of_halves("cornell_acryl_blue", lobe, 32, wavelength_nm, seed)]
    known = [gloss for gloss in found if gloss is not None]
    assert len(known) == 2 if lobe == "gaussian" else known
    assert all(np.exp(gloss.log_gloss[1]) < 0.05 for gloss in known)


def test_draws_count_by_the_surfaces_that_they_tell_of():
    one = {"ok": 0.5, "alpha": 1.0, "alpha_told": 0.5, "beta": 0.8, "beta_told": 0.5, "mu": np.nan, "mu_told": 0.0}
    two = {"ok": 0.1, "alpha": 0.0, "alpha_told": 0.1, "beta": np.nan, "beta_told": 0.0, "mu": np.nan, "mu_told": 0.0}
    found = materials.together([one, two])
    assert found["ok"] == pytest.approx(0.3) and found["alpha"] == pytest.approx(0.5 / 0.6)
    assert found["beta"] == pytest.approx(0.8) and np.isnan(found["mu"])
