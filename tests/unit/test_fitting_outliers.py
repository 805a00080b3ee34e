"""Single readings that are wrong, and data that no model fits: withstood, or said."""

import numpy as np
import pytest
from test_fitting import GEOMETRY, K, N, materials, model
from test_fitting_hard import CAMERA, in_plane, stated

from irodori.fitting.band_fresnel import uniform
from irodori.fitting.diffuse_response import diffuse_response
from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status
from irodori.reflection.equation5 import reflect

TEXELS = 400
POSES = np.concatenate([GEOMETRY, in_plane([30, 50, 60, 40], [25, 45, 60, 25])])
NOISE = np.tile(CAMERA[:1], (len(POSES), 1))


def photographed(seed=26):
    """True α, β, μ, and responses with the camera's noise and half a per cent of drift."""
    truth, rng = materials(TEXELS, seed), np.random.default_rng(seed)
    clean = model(*truth, POSES)
    spread = np.sqrt(NOISE[:, 0] + NOISE[:, 1] * clean + (0.005 * clean) ** 2)
    return truth, clean, clean + spread * rng.normal(size=clean.shape)


def fitted(response, **options):
    return fit(response, POSES, np.ones(response.shape), N, K, FitOptions(**options), noise=NOISE)


def spoiled_at(which, clean):
    """The observation of each texel that is spoiled."""
    if which == "highest":
        return clean.argmax(axis=1)
    return np.random.default_rng(260).integers(0, len(POSES), TEXELS)


@pytest.mark.stability(stage="fit", case="one dark reading", factor=0.0)
@pytest.mark.stability(stage="fit", case="one doubled reading", factor=2.0)
@pytest.mark.stability(stage="fit", case="one gross outlier in 20", factor=0.2)
@pytest.mark.parametrize("factor", [0.0, 0.2, 2.0])
@pytest.mark.parametrize("which", ["any", "highest"])
def test_one_wrong_reading_changes_nothing(factor, which):
    (alpha, beta, mu), clean, response = photographed()
    plain = fitted(response)
    response[np.arange(TEXELS), spoiled_at(which, clean)] *= factor
    result = fitted(response)
    both = stated(result) & stated(plain)
    assert both.mean() > 0.97 * stated(plain).mean()
    for name, truth in (("alpha", alpha), ("beta", beta), ("mu", mu)):
        off = [np.abs(getattr(one, name) / truth - 1)[both] for one in (plain, result)]
        assert np.median(off[1]) < 1.25 * np.median(off[0])
        error = np.abs(getattr(result, name) - truth)[both] / getattr(result, f"{name}_error")[both]
        assert (error < 2).mean() > 0.93


@pytest.mark.stability(stage="fit", case="one dark reading")
def test_a_dark_reading_is_not_in_the_colour():
    (alpha, _, _), clean, response = photographed()
    bands = np.stack([1.5 * response, response, 0.5 * response], axis=-1)
    bands[np.arange(TEXELS), spoiled_at("any", clean)] = 0.0
    result = fitted(bands[..., 1])
    observed = (bands, np.tile(POSES, (TEXELS, 1, 1)), np.ones(response.shape))
    found, _ = diffuse_response(*observed, result, uniform(N, K, 3), np.repeat(NOISE[:, None], 3, axis=1))
    assert np.median(np.abs(found[:, 1] / alpha - 1)[stated(result)]) < 0.01


@pytest.mark.stability(stage="fit", case="clipping at 60 % of the peak, unflagged")
def test_readings_that_clip_unflagged_are_seldom_gloss_that_is_stated_and_wrong():
    (_, beta, _), clean, response = photographed()
    result = fitted(np.minimum(response, 0.6 * clean.max(axis=1, keepdims=True)))
    wrong = stated(result) & (np.abs(result.beta - beta) > 2.0 * result.beta_error)
    assert wrong.mean() < 0.08


@pytest.mark.stability(stage="fit", case="two lobes fitted as one")
def test_two_lobes_that_are_fitted_as_one_are_not_ok_where_the_readings_tell():
    (alpha, beta, mu), clean, response = photographed()
    other = model(0.0, beta, np.minimum(5.0 * mu, 1.0), POSES)
    result = fitted(response * (1.0 + other / clean))
    denied, ok = result.status == Status.CONTRADICTED, stated(result)
    assert denied.mean() > 0.4 and ok.mean() < 0.4
    assert (np.abs(result.alpha - alpha) < 2.0 * result.alpha_error)[ok].mean() > 0.93
    # What describes it best is stated all the same.
    assert np.isfinite(result.beta[denied]).mean() > 0.9


@pytest.mark.stability(stage="fit", case="a retro-reflector")
@pytest.mark.parametrize("strength", [0.02, 0.1, 0.2, 1.0])
def test_a_retro_reflector_is_not_ok_where_the_readings_tell(strength):
    """Light goes back to the lamp as well, in a lobe of 10 degrees that four photographs of 25 see."""
    near_the_lamp = in_plane([30, 45, 60, 20], [-26, -38, -50, -20])
    poses, (alpha, beta, mu) = np.concatenate([POSES, near_the_lamp]), materials(TEXELS, 26)
    noise = np.tile(CAMERA[:1], (len(poses), 1))
    same_side = poses[:, 2] < poses[:, 3]  # then the angle between light and view is 2 θ_H
    returned = strength * np.exp(-((2.0 * poses[:, 2] / np.radians(10.0)) ** 2)) * np.cos(poses[:, 0]) * same_side
    clean = model(alpha, beta, mu, poses) + returned
    spread = np.sqrt(noise[:, 0] + noise[:, 1] * clean + (0.005 * clean) ** 2)
    response = clean + spread * np.random.default_rng(29).normal(size=clean.shape)
    result = fit(response, poses, np.ones(clean.shape), N, K, FitOptions(), noise=noise)
    ok = stated(result)
    if strength >= 0.2:
        assert ok.mean() < 0.3
    for name, truth in (("alpha", alpha), ("beta", beta), ("mu", mu)):
        right = np.abs(getattr(result, name) - truth) < 2.0 * getattr(result, f"{name}_error")
        assert right[ok].sum() >= 0.93 * ok.sum()


@pytest.mark.stability(stage="fit", case="μ above its bound")
@pytest.mark.parametrize("rougher", [1.05, 1.2, 2.0])
def test_a_surface_rougher_than_its_bound_is_not_ok(rougher):
    alpha, beta, _ = materials(TEXELS, 28)
    clean = model(alpha, beta, 0.3 * rougher, POSES)
    rng = np.random.default_rng(28)
    response = clean * (1 + 0.005 * rng.normal(size=clean.shape))
    result = fitted(response, bounds={"mu_rad": (0.005, 0.3)})
    assert stated(result).mean() < 0.03


@pytest.mark.parametrize("spoiled", [(), (0,)], ids=["plain", "one reading off"])
def test_a_lobe_of_another_form_is_denied_and_its_errors_cover_what_is_left(spoiled):
    """GGX facets, photographed 48 times, fitted with equation (5)."""
    rng, (alpha, beta, mu) = np.random.default_rng(61), materials(TEXELS, 61)
    incidence = rng.uniform(15, 65, (TEXELS, 48))
    geometry = in_plane(incidence, np.abs(incidence + rng.normal(0, 18, incidence.shape)))
    a, b, m = (values[:, None] for values in (alpha, beta, mu))
    clean = reflect(a, 1.0, b, m, geometry, n=N, k=K, lobe="ggx")
    response = clean * (1 + 0.005 * rng.normal(size=clean.shape))
    response[:, list(spoiled)] *= 2.0
    noise, weight = np.tile([1e-6, 1e-5], (48, 1)), np.ones(clean.shape)
    wrong, right = (
        fit(response, geometry, weight, N, K, FitOptions(lobes=(name,)), noise=noise) for name in ("gaussian", "ggx")
    )
    assert (wrong.status == Status.CONTRADICTED).mean() > 0.45
    off = np.abs(wrong.alpha - alpha)[stated(wrong)] / wrong.alpha_error[stated(wrong)]
    assert (off < 2).mean() > 0.8
    assert stated(right).mean() > 0.97 and (right.status == Status.CONTRADICTED).mean() < 0.01


def test_one_reading_on_a_lobe_tells_neither_height_nor_width():
    """A narrow highlight that one photograph of twelve sees, over diffuse light."""
    geometry = in_plane(np.r_[45.0, np.linspace(20, 60, 11)], np.r_[46.0, np.linspace(70, 5, 11)])
    alpha, beta, _ = materials(TEXELS, 62)
    near = np.sort(geometry[:, 3])
    mu = 0.5 * near[1]  # the second nearest sees exp(-4)
    rng = np.random.default_rng(62)
    clean = model(alpha, beta, np.full(TEXELS, mu), geometry)
    result = fit(
        clean * (1 + 0.005 * rng.normal(size=clean.shape)), geometry, np.ones(clean.shape), N, K, FitOptions(),
        noise=np.tile(CAMERA[:1], (len(geometry), 1)),
    )  # fmt: skip
    assert stated(result).mean() < 0.01


def test_noise_alone_contradicts_nothing():
    _, _, response = photographed()
    assert (fitted(response).status == Status.CONTRADICTED).mean() < 0.01
