"""Hard cases together: what each stage does when everything that is hard comes at once.

The outcome asked for is always the same: finite or flagged, within bounds, no exception that is not a refusal in words,
and no warning (the tests' settings make warnings errors).
"""

import itertools

import numpy as np
import pytest
from compressing import compress
from depth import examples
from hard_scenes import SCENES, brightest_of, hard_scene
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from made_up_camera import LIGHT, checked_fit, system, training
from path_scenes import traced
from sky_draws import densities, shares
from test_estimators import PROBES
from test_fitting import GEOMETRY, K, N, model
from test_fitting_hard import assert_sound, in_plane, stated
from test_principal_components import line, observers, picture

from irodori.calibration.estimators import ESTIMATORS
from irodori.calibration.training import Training
from irodori.config.models import IrradianceMap
from irodori.core import store
from irodori.fitting.solvers import FitOptions
from irodori.fitting.solvers import fit as fit_texels
from irodori.light.environment_file import Environment, directions
from irodori.light.irradiance import Integrator
from irodori.light.omnidirectional import OmnidirectionalPicture
from irodori.light.stage import write_environment
from irodori.material.material_file import Status
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.rendering.reference.sky_sampling import make_sky
from irodori.spectra.published import spectrum

# --- fit -----------------------------------------------------------------------------------------------------------

CAMERA = np.tile([4e-6, 8e-5], (len(GEOMETRY), 1))
POSES = {
    "plate": GEOMETRY,
    "grazing": in_plane(np.linspace(60, 89.9, len(GEOMETRY)), np.linspace(89.9, 70, len(GEOMETRY))),
    "back-lit": np.concatenate([GEOMETRY[:10], in_plane(np.linspace(91, 125, 7), np.linspace(0, 60, 7))]),
    "off the peak": in_plane(np.linspace(5, 25, len(GEOMETRY)), np.linspace(60, 75, len(GEOMETRY))),
    "one": np.repeat(GEOMETRY[4:5], len(GEOMETRY), axis=0),
}
MATERIALS = tuple(itertools.product((0.0, 1e-4, 0.5), (0.0, 0.5, 9.9e3), (0.005, 0.05, 1.2)))
SPOILS = ("nothing", "outlier", "nan", "inf", "dark", "negative", "three left", "clipped")


def spoiled(response, weight, clipped, spoil, rng):
    """Do to the observations of one texel what a spoil is called."""
    at = rng.integers(len(response))
    if spoil == "outlier":
        response[at] = 100.0 * np.abs(response).max() + 1.0
    elif spoil in ("nan", "inf"):
        response[at] = float(spoil)
    elif spoil == "dark":
        response[:] = 0.0
    elif spoil == "negative":
        response -= 0.01
    elif spoil == "three left":
        weight[rng.permutation(len(response))[3:]] = 0.0
    elif spoil == "clipped":
        clipped[:] = response > 0.5 * response.max()
        weight[clipped] = 0.0


def all_at_once(noise, seed=0):
    """Every material in every set of poses, spoiled in every way: (texels, J) responses, weights, clipped; names."""
    rng = np.random.default_rng(seed)
    names = list(itertools.product(MATERIALS, POSES, SPOILS))
    response, weight, clipped = np.empty((3, len(names), len(GEOMETRY)))
    geometry = np.stack([POSES[pose] for _, pose, _ in names])
    with np.errstate(all="ignore"):  # the model itself, which knows no horizon
        for row, ((alpha, beta, mu), pose, _) in enumerate(names):
            seen = (POSES[pose][:, :2] < np.pi / 2).all(axis=1)
            response[row] = np.where(seen, model(alpha, beta, mu, POSES[pose]), 0.0)
    response *= 1 + noise * rng.normal(size=response.shape)
    weight[:], clipped[:] = 1.0, 0.0
    for row, (*_, spoil) in enumerate(names):
        spoiled(response[row], weight[row], clipped_row := clipped[row].astype(bool), spoil, rng)
        clipped[row] = clipped_row
    return names, response, geometry, weight, clipped.astype(bool)


@pytest.mark.stability(stage="fit", case="all of part D together")
@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_every_material_in_every_pose_spoiled_in_every_way_ends_finite_or_flagged(noise, scale, kind):
    names, response, geometry, weight, clipped = all_at_once(noise)
    bounds = {"alpha": (0.0, 2.0 * scale), "beta": (0.0, 1e4 * scale), "mu_rad": (0.005, 1.2)}
    for camera in (None, CAMERA * [scale**2, scale]):
        options = FitOptions(bounds=bounds)
        result = fit_texels((scale * response).astype(kind), geometry.astype(kind), weight.astype(kind), N, K, options,
                            noise=camera, clipped=clipped)  # fmt: skip
        # An outlier taken for a lobe at the bound of μ cannot be told from α: both are open, and the status says so.
        assert_sound(result, bounds, stating=(Status.OK, Status.DIFFUSE_ONLY, Status.DARK))
        by_name = dict(zip(names, result.status, strict=True))
        poses, spoils = np.array([n[1] for n in names]), np.array([n[2] for n in names])
        few = (poses == "one") | (spoils == "three left")
        assert not stated(result)[few].any()
        assert np.isin(result.status[(spoils == "dark") & ~few], (Status.DARK, Status.TOO_FEW_OBSERVATIONS)).all()
        plain = by_name[(0.5, 0.5, 0.05), "plate", "nothing"]
        if noise == 0.0 and kind is np.float64:
            assert plain == Status.OK  # what is not hard is not lost among what is
            row = names.index(((0.5, 0.5, 0.05), "plate", "nothing"))
            assert result.mu[row] == pytest.approx(0.05, rel=1e-3)
            assert result.alpha[row] == pytest.approx(0.5 * scale, rel=1e-3)


@pytest.mark.stability(stage="fit", case="all of part D together, random")
@given(
    beta_exponent=st.floats(-6, 4), mu=st.floats(0.005, 1.2), alpha=st.sampled_from([0.0, 1e-6, 1.0]),
    last_deg=st.floats(80.0, 89.999), exponent=st.floats(-6, 6), spoil=st.sampled_from(SPOILS),
    solver=st.sampled_from(["varpro", "nlopt"]), n=st.sampled_from([1.0001, 1.5, 0.05]), k=st.sampled_from([0.0, 40.0]),
    seed=st.integers(0, 99), kind=st.sampled_from([np.float32, np.float64]),
)  # fmt: skip
@settings(deadline=None, max_examples=examples(60))
def test_a_random_material_at_grazing_angles_ends_finite_or_flagged(
    beta_exponent, mu, alpha, last_deg, exponent, spoil, solver, n, k, seed, kind
):
    rng, scale, count = np.random.default_rng(seed), 10.0**exponent, 15
    geometry = in_plane(np.linspace(40, last_deg, count), rng.uniform(0, last_deg, count))
    response = model(alpha, 10.0**beta_exponent, mu, geometry, n, k) * (1 + 0.01 * rng.normal(size=count))
    weight, clipped = np.ones(count), np.zeros(count, bool)
    spoiled(response, weight, clipped, spoil, rng)
    bounds = {"alpha": (0.0, 2.0 * scale), "beta": (0.0, 1e4 * scale), "mu_rad": (0.005, 1.2)}
    given_ = [np.asarray(v, kind)[None] for v in (scale * response, geometry, weight)]
    result = fit_texels(*given_, n, k, FitOptions(solver=solver, bounds=bounds), clipped=clipped[None])
    assert_sound(result, bounds, stating=(Status.OK, Status.DIFFUSE_ONLY, Status.DARK))


# --- calibration ---------------------------------------------------------------------------------------------------


@pytest.mark.stability(stage="calibrate", case="all of part C together")
@pytest.mark.parametrize("name", list(ESTIMATORS))
@given(
    exponents=st.lists(st.integers(-6, 6), min_size=6, max_size=6), copies=st.integers(1, 3),
    kept=st.integers(4, 24), dark=st.sampled_from([0.0, 1e-4, 0.05]), dead=st.sampled_from([None, 0, 4]),
    alike=st.booleans(), noise=st.sampled_from([0.0, 0.003]), kind=st.sampled_from([np.float32, np.float64]),
    bases=st.integers(3, 8), seed=st.integers(0, 9),
)  # fmt: skip
@settings(deadline=None, max_examples=examples(8))
def test_a_chart_with_several_faults_is_recovered_from_or_refused(
    name, exponents, copies, kept, dark, dead, alike, noise, kind, bases, seed
):
    chart, rng = training(noise), np.random.default_rng(seed)
    rows = np.tile(rng.permutation(24)[:kept], copies)
    gain = 10.0 ** np.array(exponents, float)
    response = (chart.response[rows] - dark) * gain
    if alike:
        response[:, 3] = 2.0 * response[:, 1]
    if dead is not None:
        response[:, dead] = 0.0
    try:
        solved = checked_fit(name, Training(response.astype(kind).astype(float), chart.spectra[rows], LIGHT), bases)
    except ValueError as refusal:
        assert "accepted" in str(refusal)
        return
    probes = ((PROBES @ system().T - dark) * gain).astype(kind)
    probes[3], probes[5, 2] = 0.0, np.nan
    found = solved.spectra(probes)
    assert np.isnan(found[5]).all() and np.isfinite(np.delete(found, 5, axis=0)).all()
    assert dead is None and not alike and kept >= 6


@pytest.mark.stability(stage="calibrate", case="all of part C together")
@pytest.mark.parametrize("name", ["kernel", "broad"])
def test_a_population_whose_spread_rounding_makes_indefinite_is_fitted(name):
    """Twice 15 patches, all responses too dark by 0.05, no noise: eigenvalues of -1e-7 of their sum."""
    chart = training(0.0)
    rows = np.tile(np.random.default_rng(4).permutation(24)[:15], 2)
    response = (chart.response[rows] - 0.05).astype(np.float32).astype(float)
    solved = checked_fit(name, Training(response, chart.spectra[rows], LIGHT), 3)
    found = solved.spectra(PROBES @ system().T - 0.05)
    assert np.isfinite(found).all() and np.abs(found).max() < 2.0


# --- compression ---------------------------------------------------------------------------------------------------

SHAPES = ((1, 1), (1, 37), (37, 1), (2, 1), (9, 11))


@pytest.mark.stability(stage="compress", case="all of part E together")
@given(
    shape=st.sampled_from(SHAPES), fill=st.sampled_from(["picture", "constant", "black", "one line", "negative"]),
    missing=st.sampled_from([0.0, 0.3, 0.9]), exponent=st.integers(-6, 6), bases=st.sampled_from([None, 1, 4, 100]),
    sun=st.booleans(), weighting=st.sampled_from(["nothing", "visual"]), storage=st.sampled_from(["half", "single"]),
    light=st.sampled_from(["A", "FL11", "sodium"]), seed=st.integers(0, 9),
)  # fmt: skip
@settings(deadline=None, max_examples=examples(12))
def test_a_picture_that_is_hard_in_several_ways_comes_back(
    shape, fill, missing, exponent, bases, sun, weighting, storage, light, seed
):
    rng = np.random.default_rng(seed)
    source = picture(seed, *shape)
    if fill == "one line":
        source *= np.arange(61) == 38
    elif fill != "picture":
        source[:] = {"constant": 0.4, "black": 0.0, "negative": -0.2}[fill]
    if sun:
        source[0, 0] = 1e6
    source *= np.float32(10.0**exponent)
    lost = rng.uniform(size=shape) < missing
    lost[0, 0] = False  # a picture of no pixel is another case
    source[lost] = np.nan
    lights = observers("D65") | ({"sodium": line(589.0)} if light == "sodium" else observers(light))
    done = compress(source, None, lights, CompressOptions(weighting=weighting, storage=storage), bases=bases)
    made, known = done.compression, source[~lost]
    assert made.masked == lost.sum() and np.array_equal(np.isnan(done.coefficients[:, 0]), lost.ravel())
    assert made.bases <= made.rank <= min(len(known), 61) or made.bases <= 61
    decoded = done.coefficients[~lost.ravel()] @ done.basis.T
    assert np.isfinite(decoded).all() and np.abs(decoded).max() <= 1.1 * max(np.abs(known).max(), 1e-30) * 61**0.5
    assert all(np.isfinite([e["mean"], e["max"]]).all() for e in done.errors.values())
    if bases in (None, 100) and not sun and fill != "picture":
        # One spectrum everywhere is one basis, exact but for the rounding of the storage.
        assert np.abs(decoded - known).max() <= 2.0**-10 * np.abs(known).max()


# --- environment ---------------------------------------------------------------------------------------------------

SPECTRA = {"FL11": spectrum("FL11") / 100, "sodium": np.where(np.arange(61) == 38, 5.0, 1e-6), "grey": np.ones(61)}


@pytest.mark.stability(stage="environment", case="all of part E together")
@given(
    size=st.sampled_from([(1, 2), (1, 30), (2, 4), (9, 18), (16, 32)]), lamp=st.sampled_from(list(SPECTRA)),
    place=st.sampled_from(["zenith", "nadir", "seam", "middle"]), sky=st.sampled_from([0.0, 1.0]),
    exponent=st.integers(-6, 6), storage=st.sampled_from(["half", "single"]), gloss=st.booleans(),
)  # fmt: skip
@settings(deadline=None, max_examples=examples(12))
def test_a_sun_of_one_texel_and_one_line_at_the_pole_in_the_smallest_sky(
    tmp_path_factory, size, lamp, place, sky, exponent, storage, gloss
):
    height, width = size
    at = {"zenith": (0, 0), "nadir": (height - 1, width - 1), "seam": (height // 2, 0), "middle": (height // 2, 1)}
    weights = np.zeros((height, width, 2), np.float32)
    weights[..., 0] = sky
    weights[at[place]] += np.float32([0.0, 1e6])
    weights *= np.float32(10.0**exponent)
    basis = np.stack([spectrum("D65") / 100, SPECTRA[lamp]], axis=1)
    path = tmp_path_factory.mktemp("sky") / "e.h5"
    write_environment(
        OmnidirectionalPicture(size, basis, lambda: iter([weights])),
        None,
        path,
        CompressOptions(storage=storage),
        made(IrradianceMap, {"max_error": 0.01, "max_height": 16}),
        store.Provenance("test"),
        gloss_maps=gloss,
    )
    found = Environment.load(path)
    radiance, expected = found.coefficients @ found.basis.T, weights @ basis.T
    assert np.isfinite(radiance).all() and np.isfinite(found.irradiance).all()
    assert np.abs(radiance - expected).max() <= 2.0**-9 * np.abs(expected).max()
    assert np.isfinite(found.upward_white()).all()
    normals = np.concatenate([directions(8, 4)[0].reshape(-1, 3), [[0, 0, 1.0], [0, 0, -1.0]]])
    assert np.isfinite(Integrator(found.coefficients)(normals)).all()
    drawn = make_sky(found)
    assert shares(drawn).sum() == pytest.approx(1.0, rel=1e-5)
    # The sun holds nearly all the power, so nearly all samples fall on it.
    density = densities(drawn, directions(width, height)[0])
    assert density.argmax() == np.ravel_multi_index(at[place], size) or size == (1, 2)


# --- rendering -----------------------------------------------------------------------------------------------------


@pytest.mark.stability(stage="render", case="all of part F together, by paths")
@given(**SCENES)
@settings(deadline=None, max_examples=examples(25))
def test_a_scene_that_is_hard_in_several_ways_ends_finite_by_paths(**scene):
    shapes, materials, light, view = hard_scene(**scene)
    found = traced(shapes, materials, light, 16, size=(8, 6), **view)
    assert np.isfinite(found.radiance).all() and np.isfinite(found.standard_error).all()
    assert (found.radiance >= 0).all() and (found.standard_error >= 0).all()
    if scene["beta"] == "none" or scene["mirror"] == 1.0:
        # Diffuse light and mirrors pass on no more than they get, sample by sample.
        assert found.radiance.max() <= brightest_of(scene) * (1 + 1e-4)
