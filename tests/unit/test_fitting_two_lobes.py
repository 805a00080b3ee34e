"""Other lobes than the paper's and sums of two: what was put in comes out, and what is not told is not stated."""

from dataclasses import replace
from pathlib import Path

import nlopt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.config.cross_checks.object_lobes import check_lobes
from irodori.config.definitions import load_definitions
from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml
from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status
from irodori.reflection.fresnel import fresnel
from irodori.reflection.registry import lobe

ROOT = Path(__file__).resolve().parents[2]

LIGHT = np.radians(np.array([25.0, 45.0, 65.0]))[np.arange(60) % 3]
CAMERA = LIGHT + np.radians(np.linspace(-35.0, 20.0, 60))
ANGLES = np.stack([LIGHT, np.abs(CAMERA), np.abs(LIGHT + CAMERA) / 2, np.abs(LIGHT - CAMERA) / 2], axis=1)
ANGLES = ANGLES.astype(np.float32).astype(np.float64)  # so that they are the same in single precision
COSINE = np.cos(ANGLES[:, 0])
NOISE = np.tile([1e-6, 1e-5], (len(ANGLES), 1))
PAIRS = [("ggx", "ggx"), ("gaussian", "ggx")]
#: Relative, of noiseless parameters: the rounding of the responses to single precision moves them by up to 1.5e-6.
ROUNDED = 3e-6
EXACT = {"model_error": 1e-5, "level_error": 1e-5, "pose_error_deg": 0.0}


def gloss(name: str, mu: float) -> np.ndarray:
    """F D G / cosθ_r of all poses, from the lobe's kernels alone."""
    kind = lobe(name)
    out = np.empty(len(ANGLES))
    for j, (theta_i, theta_r, theta_h, phi) in enumerate(ANGLES):
        factor, *features = kind.features(np.cos(theta_i), np.cos(theta_r), np.cos(phi), np.cos(theta_h), phi)
        out[j] = fresnel(np.cos(theta_h), 1.5, 0.0) * factor * kind.value(kind.constants(np.log(mu)), *features)
    return out


def responses(names, alpha, *pairs) -> np.ndarray:
    """Responses of materials, (texels, J); each pair is β and μ of a component, (texels,) each."""
    rows = [a * COSINE for a in alpha]
    for name, (beta, mu) in zip(names, pairs, strict=True):
        rows = [row + b * gloss(name, m) for row, b, m in zip(rows, beta, mu, strict=True)]
    return np.array(rows)


def two_components(count: int, seed: int):
    """α and β, μ of a broad and a narrow component."""
    rng = np.random.default_rng(seed)
    broad = rng.uniform(0.5, 3.0, count), rng.uniform(0.25, 0.5, count)
    narrow = rng.uniform(1.0, 6.0, count), rng.uniform(0.05, 0.12, count)
    return rng.uniform(0.05, 0.8, count), broad, narrow


def run(response, lobes, noise=None, **options):
    """Fit in single precision, as the chain does, whose loops serve here, too."""
    response = response.astype(np.float32)
    return fit(response, ANGLES, np.ones_like(response), options=FitOptions(lobes=lobes, **options), noise=noise)


@given(
    alpha=st.floats(0.02, 0.9),
    beta=st.floats(0.5, 8.0),
    mu=st.floats(0.04, 0.4),
    scale=st.sampled_from([1.0, 1e-4, 1e3]),
)
@settings(max_examples=40, deadline=None)
def test_ggx_is_recovered_without_noise(alpha, beta, mu, scale):
    truth = scale * responses(["ggx"], [alpha], ([beta], [mu]))
    bounds = {"alpha": [0.0, 2.0 * scale], "beta": [0.0, 1e4 * scale]}
    found = run(truth, ("ggx",), bounds=bounds, **EXACT)
    assert found.status[0] == Status.OK
    assert found.lobes == ("ggx",)
    assert found.alpha[0] == pytest.approx(scale * alpha, rel=ROUNDED)
    assert found.beta[0] == pytest.approx(scale * beta, rel=ROUNDED)
    assert found.mu[0] == pytest.approx(mu, rel=ROUNDED)


@pytest.mark.parametrize("noise", [None, NOISE], ids=["noise unknown", "noise known"])
def test_error_bars_of_ggx_are_honest(noise):
    rng = np.random.default_rng(5)
    count = 3000
    alpha, beta, mu = rng.uniform(0.1, 0.8, count), rng.uniform(1.0, 6.0, count), rng.uniform(0.06, 0.3, count)
    clean = responses(["ggx"], alpha, (beta, mu))
    deviation = np.sqrt(1e-6 + 1e-5 * clean)
    found = run(
        clean + deviation * rng.normal(size=clean.shape),
        ("ggx",),
        noise,
        model_error=0.0,
        level_error=0.0,
        pose_error_deg=0.0,
    )
    known = found.status == Status.OK
    assert known.mean() > 0.99
    for name, truth in (("alpha", alpha), ("beta", beta), ("mu", mu)):
        off = np.abs(getattr(found, name) - truth)[known] / getattr(found, f"{name}_error")[known]
        assert 0.62 <= (off < 1.0).mean() <= 0.75, name
        # Equal weights leave few observations to tell a bright highlight's variance: their tails are a little longer.
        assert (off < 2.0).mean() >= (0.93 if noise is not None else 0.92), name


@pytest.mark.parametrize("solver", ["nlopt", "nlopt-reference"])
def test_ggx_is_the_same_to_nlopt(solver):
    alpha, (beta, mu), _ = two_components(20, 3)
    response = responses(["ggx"], alpha, (beta, mu)) * (1 + 0.01 * np.random.default_rng(4).normal(size=(20, 60)))
    ours, other = run(response, ("ggx",)), run(response, ("ggx",), solver=solver)
    assert np.array_equal(ours.status, other.status)
    for name in ("alpha", "beta", "mu"):
        error = getattr(ours, f"{name}_error")
        gap = np.abs(getattr(ours, name) - getattr(other, name))
        assert (gap[ours.status == Status.OK] < 0.02 * error[ours.status == Status.OK]).all(), name


@pytest.mark.parametrize("lobes", PAIRS)
def test_two_lobes_are_recovered_without_noise(lobes):
    alpha, broad, narrow = two_components(60, 1)
    found = run(responses(lobes, alpha, broad, narrow), lobes, **EXACT)
    assert (found.status == Status.OK).all()
    expected = {"alpha": alpha, "beta": broad[0], "mu": broad[1], "beta_2": narrow[0], "mu_2": narrow[1]}
    for name, truth in expected.items():
        np.testing.assert_allclose(getattr(found, name), truth, rtol=ROUNDED, err_msg=name)
    np.testing.assert_allclose(found.gloss, np.column_stack([*broad, *narrow]), rtol=ROUNDED)


def test_of_two_lobes_of_a_kind_the_broader_stands_first():
    alpha, broad, narrow = two_components(20, 7)
    found = run(responses(("ggx", "ggx"), alpha, narrow, broad), ("ggx", "ggx"), **EXACT)
    assert (found.mu > found.mu_2).all()
    np.testing.assert_allclose(found.beta, broad[0], rtol=ROUNDED)


@pytest.mark.stability(stage="fit", case="a transparent varnish")
@pytest.mark.parametrize("lobes", PAIRS)
def test_error_bars_of_two_lobes_are_honest(lobes):
    rng = np.random.default_rng(8)
    alpha, broad, narrow = two_components(1000, 9)
    clean = responses(lobes, alpha, broad, narrow)
    response = clean + np.sqrt(1e-6 + 1e-5 * clean) * rng.normal(size=clean.shape)
    found = run(response, lobes, NOISE, model_error=0.0, level_error=0.0, pose_error_deg=0.0)
    known = found.status == Status.OK
    assert known.mean() > 0.9
    expected = {"alpha": alpha, "beta": broad[0], "mu": broad[1], "beta_2": narrow[0], "mu_2": narrow[1]}
    for name, truth in expected.items():
        off = np.abs(getattr(found, name) - truth)[known] / getattr(found, f"{name}_error")[known]
        assert 0.62 <= (off < 1.0).mean() <= 0.75, name
        assert (off < 2.0).mean() >= 0.93, name


def least_by_nlopt(lobes, response, start) -> float:
    """Return the least sum of squares that NLopt finds from a start, without any derivative."""

    def cost(x, gradient):
        parts = x[1] * gloss(lobes[0], np.exp(x[2])) + x[3] * gloss(lobes[1], np.exp(x[4]))
        return float(np.sum((x[0] * COSINE + parts - response) ** 2))

    optimiser = nlopt.opt(nlopt.LN_BOBYQA, 5)
    optimiser.set_lower_bounds([0.0, 0.0, np.log(0.005), 0.0, np.log(0.005)])
    optimiser.set_upper_bounds([2.0, 1e4, np.log(1.2), 1e4, np.log(1.2)])
    optimiser.set_initial_step(0.05)
    optimiser.set_min_objective(cost)
    optimiser.set_ftol_rel(1e-10)
    optimiser.set_maxeval(1500)
    optimiser.optimize(start)
    return optimiser.last_optimum_value()


@pytest.mark.parametrize("lobes", PAIRS)
def test_no_sum_of_two_lobes_fits_better_that_nlopt_finds(lobes):
    alpha, broad, narrow = two_components(5, 11)
    clean = responses(lobes, alpha, broad, narrow)
    response = clean * (1 + 0.01 * np.random.default_rng(12).normal(size=clean.shape))
    found = run(response, lobes)
    for t in range(5):
        beta, mu, beta_2, mu_2 = found.gloss[t]
        ours = np.sum((responses(lobes, [found.alpha[t]], ([beta], [mu]), ([beta_2], [mu_2]))[0] - response[t]) ** 2)
        truth = [alpha[t], broad[0][t], np.log(broad[1][t]), narrow[0][t], np.log(narrow[1][t])]
        assert ours <= least_by_nlopt(lobes, response[t], truth) * (1 + 1e-6)


def test_one_lobe_is_stated_where_the_data_calls_for_one():
    rng = np.random.default_rng(13)
    alpha, broad, _ = two_components(200, 14)
    clean = responses(["ggx"], alpha, broad)
    response = clean + np.sqrt(1e-6 + 1e-5 * clean) * rng.normal(size=clean.shape)
    two, one = (run(response, lobes, NOISE, model_error=0.0) for lobes in (("ggx", "ggx"), ("ggx",)))
    single = two.beta_2 == 0.0
    assert single.mean() > 0.95
    assert np.isnan(two.mu_2[single]).all()
    assert np.isnan(two.beta_2_error[single]).all()
    for name in ("alpha", "beta", "mu", "beta_error", "status"):
        np.testing.assert_array_equal(getattr(two, name)[single], getattr(one, name)[single])


def test_the_lobe_that_explains_the_data_alone_is_the_one_stated():
    alpha, broad, _ = two_components(40, 15)
    found = run(responses(["ggx"], alpha, broad), ("gaussian", "ggx"), **EXACT)
    assert (found.status == Status.OK).all()
    assert (found.beta == 0.0).all()
    assert np.isnan(found.mu).all()
    np.testing.assert_allclose(found.mu_2, broad[1], rtol=ROUNDED)


def test_a_component_that_is_not_told_is_no_number():
    rng = np.random.default_rng(16)
    alpha, broad, narrow = two_components(300, 17)
    clean = responses(("ggx", "ggx"), alpha, broad, (0.02 * narrow[0], narrow[1]))
    response = clean * (1 + 0.02 * rng.normal(size=clean.shape))
    found = run(response, ("ggx", "ggx"))
    for beta, mu in (("beta", "mu"), ("beta_2", "mu_2")):
        stated = np.isfinite(getattr(found, mu))
        relative = getattr(found, f"{beta}_error")[stated] / getattr(found, beta)[stated]
        assert (relative < 0.3).all()
        assert (getattr(found, f"{mu}_error")[stated] / getattr(found, mu)[stated] < 0.2).all()
        assert np.isin(found.status[stated], [Status.OK, Status.MU_UNIDENTIFIABLE]).all()
    assert not (np.isfinite(found.mu) & np.isfinite(found.mu_2) & (found.status == Status.MU_UNIDENTIFIABLE)).any()


def test_two_components_that_the_readings_deny_are_not_ok():
    rng = np.random.default_rng(19)
    alpha, broad, narrow = two_components(200, 20)
    clean = responses(("ggx", "ggx"), alpha, broad, narrow)
    response = clean + np.sqrt(1e-6 + 1e-5 * clean) * rng.normal(size=clean.shape)
    right, wrong = (run(response, (name, "ggx"), NOISE, model_error=0.005) for name in ("ggx", "gaussian"))
    assert (right.status == Status.OK).mean() > 0.9 and (right.status == Status.CONTRADICTED).mean() < 0.01
    assert (wrong.status == Status.OK).mean() < 0.7
    denied = wrong.status == Status.CONTRADICTED
    assert denied.mean() > 0.25 and np.isfinite(wrong.beta_2[denied]).all()


def test_matt_and_unseen_texels_are_as_with_one_lobe():
    response = np.vstack([responses([], [0.5]), np.zeros((1, 60)), np.full((1, 60), np.nan)])
    two, one = run(response, ("ggx", "ggx")), run(response, ("ggx",))
    np.testing.assert_array_equal(two.status, one.status)
    np.testing.assert_array_equal(two.alpha, one.alpha)
    assert np.isnan(two.beta_2).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lobes": ("gausian",)}, "lobe 'gausian'; did you mean 'gaussian'"),
        ({"lobes": ()}, "0 lobes; accepted: 1 to 2"),
        ({"lobes": ("ggx", "ggx"), "solver": "nlopt"}, "fit.solver 'nlopt' of an object with two lobes"),
    ],
)
def test_what_cannot_be_fitted_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        FitOptions(**options)


@pytest.mark.parametrize(
    ("lobes", "changed", "message"),
    [
        (["ggxx"], {}, r"lobes\[0\].*did you mean 'ggx'"),
        (["autos"], {}, r"lobes\[0\].*did you mean 'auto'"),
        (["auto", "ggx"], {}, "auto beside a lobe.*auto alone"),
        (["gaussian", "ggx"], {"solver": "nlopt"}, "two lobes with fit.solver: nlopt"),
    ],
)
def test_a_definition_is_checked_before_anything_is_fitted(lobes, changed, message):
    loaded = load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT)
    settings_of_fit, definition = loaded.config.fit, next(iter(loaded.objects.values()))
    for fine in (("gaussian", "ggx"), ("auto",)):
        check_lobes(replace(definition, lobes=fine), settings_of_fit, "object.yaml")
    with pytest.raises(InputError, match=message):
        check_lobes(replace(definition, lobes=tuple(lobes)), replace(settings_of_fit, **changed), "object.yaml")
