"""Rough reflection by look-up: blurred light against sums over pixels, the fitted lobes against the true ones."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lobe_albedos import lobe_albedo
from scenes import DATA
from scipy.optimize import nnls
from scipy.special import ive

from irodori.core import store
from irodori.core.errors import InputError
from irodori.light.blurred_light import (
    WIDTHS_RAD,
    _bessel_series,
    _divided,
    _row_series,
    _thinned,
    first_level,
    prefiltered,
    row_angles,
)
from irodori.light.environment_file import Environment, directions
from irodori.light.equirectangular import look_up
from irodori.light.gloss import lobe_table, look_up_errors, make_lobe_table
from irodori.light.gloss.gloss_maps import GlossMaps, gloss_radiance
from irodori.light.gloss.lobe_table import fitted_lobes
from irodori.light.gloss.look_up_errors import gloss_errors, lit_places, places, true_gloss
from irodori.light.gloss.make_lobe_table import (
    _candidates,
    _pursue,
    extent,
    farthest,
    fit_lobe,
    gaussians,
    grid_cells,
    lobe_samples,
    unit,
)
from irodori.light.gloss.point_sources import point_lights
from irodori.light.irradiance import Integrator
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobe_arrays import evaluate
from irodori.reflection.registry import names


def blurred(coefficients, unit, width_rad):
    """Σ of power times the von Mises-Fisher lobe, over 4 x 4 parts of every pixel."""
    fine = coefficients.repeat(4, axis=0).repeat(4, axis=1)
    pixel, solid_angle = directions(fine.shape[1], fine.shape[0])
    kappa = width_rad**-2
    lobe = kappa / (2 * np.pi * -np.expm1(-2 * kappa)) * np.exp(kappa * (unit @ pixel.reshape(-1, 3).T - 1))
    return lobe @ (fine * solid_angle[..., None]).reshape(-1, fine.shape[2])


def looked_up(level, unit):
    out = np.empty((len(unit), level.shape[2]))
    look_up(level, np.ascontiguousarray(unit), out)
    return out


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="environment", case="poles and seam")
@pytest.mark.parametrize("place", [None, (0, 5), (63, 0), (32, 127), (20, 64)])
def test_blurred_light_is_the_sum_over_the_pixels_at_poles_and_seam_too(place):
    rng = np.random.default_rng(1)
    coefficients = rng.uniform(0, 1, (64, 128, 2)).astype(np.float32)
    unit = rng.normal(size=(20, 3))
    if place is not None:
        coefficients *= 1e-6
        coefficients[place] = [1e3, 10.0]
        unit[:10] = directions(128, 64)[0][place] + 0.03 * unit[:10]
    unit = np.concatenate([unit / np.linalg.norm(unit, axis=1, keepdims=True), [[0, 0, 1.0], [0, 0, -1.0]]])
    first, levels = prefiltered(coefficients)
    assert first + len(levels) == len(WIDTHS_RAD) and WIDTHS_RAD[first] < 2 * np.pi / 64
    power = (coefficients * directions(128, 64)[1][..., None]).sum(axis=(0, 1))
    for level, width_rad in zip(levels, WIDTHS_RAD[first:], strict=True):
        expected = blurred(coefficients, unit, width_rad)
        # A third of the width between pixels: bilinear look-up errs by up to 2 % of a sharp highlight's peak.
        assert np.abs(looked_up(level, unit) - expected).max() <= 0.02 * expected.max()
        kept = (level * directions(level.shape[1], level.shape[0])[1][..., None]).sum(axis=(0, 1))
        assert np.allclose(kept, power, rtol=0.006)


@pytest.mark.parametrize("row", [0, 1, -1])
def test_light_beside_a_pole_keeps_its_power_and_place_in_the_widest_blurs(row):
    coefficients = np.zeros((200, 400, 1), np.float32)
    coefficients[row, 30] = 1e4
    unit_, solid_angle = directions(400, 200)
    first, levels = prefiltered(coefficients, (len(WIDTHS_RAD) - 3, len(WIDTHS_RAD)))
    for level, width_rad in zip(levels, WIDTHS_RAD[first:], strict=True):
        own, weight = directions(level.shape[1], level.shape[0])
        power = level * weight[..., None]
        assert power.sum() == pytest.approx(1e4 * solid_angle[row, 30], rel=0.006)
        mean = np.einsum("yxk,yxa->a", power, own)
        assert mean / np.linalg.norm(mean) == pytest.approx(unit_[row, 30], abs=0.004)
        assert level.max() == pytest.approx(power.sum() / (2.0 * np.pi * width_rad**2), rel=0.1)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("size", [(24, 48), (90, 60)])
def test_every_width_is_the_light_under_its_lobe_at_the_maps_own_places(size):
    """At the poles, the seam and between: light that varies from pixel to pixel, each shining evenly over its area.

    Between a map's places a look-up adds a sixth of their distance squared to the width's, which the map leaves out.
    """
    height, width = size
    rng, parts = np.random.default_rng(1), 6
    sky = rng.gamma(0.3, 1.0, (height, width, 2)).astype(np.float32)
    sky[0, 3], sky[height // 2, width - 1] = 60.0, 90.0
    unit_, solid_angle = directions(width * parts, height * parts)
    power = sky.repeat(parts, axis=0).repeat(parts, axis=1) * solid_angle[..., None]
    first, levels = prefiltered(sky)
    pitch = max(np.pi / height, 2.0 * np.pi / width)
    assert len(levels) == len(WIDTHS_RAD) - first and 1.0 <= WIDTHS_RAD[first] / (0.6 * pitch) < math.sqrt(2.0)
    for width_rad, level in zip(WIDTHS_RAD[first:], levels, strict=True):
        rows = level.shape[0]
        assert level.shape == (rows, 2 * rows, 2) and 3.0 <= rows * width_rad / np.pi < 3.0 + width_rad / np.pi
        kappa = 1.0 / (width_rad**2 - (np.pi / rows) ** 2 / 6.0)
        some = np.ix_(np.unique([0, 1, rows // 3, rows // 2, rows - 2, rows - 1]), np.arange(0, 2 * rows, rows // 4))
        cosine = directions(2 * rows, rows)[0][some].reshape(-1, 3) @ unit_.reshape(-1, 3).T
        lobe = kappa / (2.0 * np.pi * -np.expm1(-2.0 * kappa)) * np.exp(kappa * (cosine - 1.0))
        expected = lobe @ power.reshape(-1, 2)
        found = level[some].reshape(-1, 2)
        assert np.abs(found - expected).max() <= 4e-3 * expected.max()
        assert found == pytest.approx(expected, rel=0.015)


def test_only_the_widths_that_are_asked_for_are_made():
    sky = np.random.default_rng(3).uniform(0.0, 1.0, (24, 48, 1)).astype(np.float32)
    first, every = prefiltered(sky)
    for wanted, expected in (
        ((first + 2, first + 4), (first + 2, 2)),
        ((0, first + 1), (first, 1)),
        ((0, 1), (first, 1)),
    ):
        found, levels = prefiltered(sky, wanted)
        assert (found, len(levels)) == expected
        for one, other in zip(levels, every[found - first :], strict=False):
            assert one == pytest.approx(other, rel=5e-3)


@pytest.mark.parametrize("size", [(32, 64), (33, 50), (100, 200)])
def test_constant_light_stays_constant_when_blurred(size):
    for level in prefiltered(np.full((*size, 1), 3.0, np.float32))[1]:
        assert np.abs(level / 3.0 - 1.0).max() <= 0.01


@given(z=st.floats(300.0, 1e5), terms=st.integers(2, 1500))
@settings(deadline=None, max_examples=40)
def test_the_series_of_a_narrow_lobe_is_of_bessel_functions(z, terms):
    found = _bessel_series(np.zeros((1, 1)), np.array([[z]]), terms)[0]
    assert np.abs(found - ive(np.arange(terms), z)).max() <= 2e-6 * ive(0, z)


@pytest.mark.parametrize("size", [(3, 7), (70, 8), (2, 1)])
def test_the_series_of_a_row_is_that_of_light_which_is_even_over_each_pixel(size):
    """Also of more terms than there are pixels; written out: the integral of exp(-imφ) over each pixel."""
    height, width = size
    sky = np.random.default_rng(4).uniform(0.0, 1.0, (height, width, 2))
    found = _row_series(sky, 3 * width + 2)
    edges, solid_angle = 2.0 * np.pi * np.arange(width + 1) / width, directions(width, height)[1]
    for m in range(3 * width + 2):
        whole = edges if m == 0 else 1j * np.exp(-1j * m * edges) / m
        mean = np.diff(whole) * width / (2.0 * np.pi)
        expected = np.einsum("yxk,yx,x->yk", sky, solid_angle, mean)
        np.testing.assert_allclose(found[:, m], expected, atol=1e-5 * solid_angle.max() * width)


@pytest.mark.parametrize("parts", [1, 3])
def test_a_divided_row_keeps_its_light_each_part_by_its_solid_angle(parts):
    series = np.random.default_rng(5).normal(size=(4, 6, 2)).astype(np.complex64)
    found, theta = _divided(series, parts)
    fine = directions(1, 4 * parts)[1][:, 0]
    np.testing.assert_allclose(theta, row_angles(4 * parts))
    edges = np.cos(np.linspace(0.0, np.pi, 4 * parts + 1))
    np.testing.assert_allclose(np.cos(theta), (edges[1:] + edges[:-1]) / 2.0, atol=1e-12)
    for row in range(4):
        own = slice(row * parts, (row + 1) * parts)
        expected = fine[own, None, None] / fine[own].sum() * series[row]
        np.testing.assert_allclose(found[own], expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("height", [2, 7, 10])
def test_of_half_as_many_rows_each_has_the_light_of_those_about_it_and_beyond_a_pole_half_a_turn_away(height):
    series = np.random.default_rng(6).normal(size=(height, 5, 2)).astype(np.complex64)
    theta = row_angles(height)
    found, places = _thinned(series, theta)
    rows = height // 2
    np.testing.assert_allclose(places, np.pi * (np.arange(rows) + 0.5) / rows)
    expected = np.zeros((rows, 5, 2), complex)
    for one, angle in zip(series, theta, strict=True):
        at = angle / np.pi * rows - 0.5
        for row, share in ((math.floor(at), 1.0 - at % 1.0), (math.floor(at) + 1, at % 1.0)):
            turned = 1.0 if 0 <= row < rows else (-1.0) ** np.arange(5)[:, None]
            expected[min(max(row, 0), rows - 1)] += share * turned * one
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(height=st.integers(1, 40), width=st.integers(1, 60), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_pictures_of_any_size_keep_their_power(height, width, seed):
    coefficients = np.random.default_rng(seed).uniform(0, 1, (height, width, 1)).astype(np.float32)
    power = (coefficients[..., 0] * directions(width, height)[1]).sum()
    for level in prefiltered(coefficients)[1]:
        assert (level[..., 0] * directions(level.shape[1], level.shape[0])[1]).sum() == pytest.approx(power, rel=0.01)


#: The package's lobes: that of the tests' own has no table beside the package.
OWN = [name for name in names() if name != "toy"]

#: Root mean square difference of a table's rough lobes from the true ones, up to 80 degrees.
ROUGH_REST = {"gaussian": 0.1, "ggx": 0.13}


def rebuilt(lobes, i, j, direction):
    """The lobe that an entry of the table stands for, at directions of light."""
    used = lobes.weight[i, j] > 0
    axis = unit(lobes.theta_r[j] + lobes.offset[i, j, used], lobes.across[i, j, used])
    return gaussians(direction, axis, WIDTHS_RAD[lobes.width[i, j, used]]) @ lobes.weight[i, j, used]


@pytest.mark.parametrize("name", OWN)
def test_the_fitted_lobes_are_the_true_ones_under_the_horizon_too_and_keep_their_power(name):
    lobes = fitted_lobes(name)
    assert (lobes.weight >= 0).all() and (lobes.across >= 0).all()
    for i, mu in enumerate(lobes.mu):
        for j, theta_r in enumerate(lobes.theta_r):
            # Not the samples of the fit.
            direction, value, _, solid_angle = lobe_samples(mu, theta_r, (90, 32), name)
            found = rebuilt(lobes, i, j, direction)
            power = (value * solid_angle).sum()
            assert (found * solid_angle).sum() == pytest.approx(power, rel=0.03 if theta_r < 1.3 else 0.08)
            # Root mean square: the error for one small sun that may stand anywhere. Narrower across than the finest
            # width a lobe cannot be had.
            rest = math.sqrt((((found - value) ** 2) * solid_angle).sum() / (value**2 * solid_angle).sum())
            core = extent(name, mu).core
            if math.sqrt(2) * core * math.cos(theta_r) >= WIDTHS_RAD[0] and theta_r <= math.radians(80.1):
                assert rest <= (0.05 if mu <= 0.12 else ROUGH_REST[name]), (mu, math.degrees(theta_r))


#: Entries that take little time, of smooth and rough lobes, to grazing; none of normal view: there, two lobes
#: on either side are as good, and rounding says which is taken.
@pytest.mark.default_cases(3)
@pytest.mark.parametrize("entry", [(5, 1), (3, 9), (10, 9)])
@pytest.mark.parametrize("name", OWN)
def test_a_table_is_what_its_module_makes(name, entry):
    lobes, (i, j) = fitted_lobes(name), entry
    made = fit_lobe(lobes.mu[i], lobes.theta_r[j], name)
    count = len(made.weight)
    assert (lobes.weight[i, j] > 0.0).sum() == count
    for column in ("width", "offset", "across", "weight", "incidence"):
        expected = getattr(lobes, column)[i, j, :count]
        assert getattr(made, column) == pytest.approx(expected, rel=1e-5, abs=1e-6), column
    direction, value, _, solid_angle = lobe_samples(lobes.mu[i], lobes.theta_r[j], name=name)
    missed = rebuilt(lobes, i, j, direction) - value
    rest = math.sqrt((missed**2 * solid_angle).sum() / (value**2 * solid_angle).sum())
    assert made.rest == pytest.approx(rest, rel=1e-2)


def test_a_lobe_narrower_than_the_finest_width_is_that_of_the_finest_width_and_keeps_its_power():
    made = fit_lobe(0.002, 0.5)
    _, value, cos_h, solid_angle = lobe_samples(0.002, 0.5)
    power = (value * solid_angle).sum()
    assert not made.width.any() and made.weight.sum() == pytest.approx(power, rel=0.02)
    # Strongest first; about the mirror direction, where facets reflect that stand along the normal.
    assert (np.diff(made.weight) <= 0.0).all()
    assert (made.weight @ made.offset) / power == pytest.approx(0.0, abs=0.002)
    mean = (((1.0 - cos_h) ** 5) @ (value * solid_angle) / power) ** 0.2
    assert made.incidence + 0.5 == pytest.approx(math.acos(1.0 - mean), abs=0.01)


@pytest.mark.parametrize(("mu", "theta_r"), [(0.02, 0.7), (0.1, 1.4), (0.45, 0.0), (1.2, 1.0)])
@pytest.mark.parametrize("name", OWN)
def test_a_lobe_is_sampled_as_far_as_it_reaches_and_as_finely_as_its_tail_is_long(name, mu, theta_r):
    core, tail = extent(name, mu)
    direction, value, cos_h, solid_angle = lobe_samples(mu, theta_r, (60, 20), name)
    reach, of_core = min(8.4 * tail, 2.0 * math.pi) + 0.02, 8.4 * core + 0.02
    more = math.asinh(math.sqrt(2.0) * reach / core) / math.asinh(math.sqrt(2.0) * min(of_core, reach) / core)
    assert len(direction) == round(60 * more) * round(20 * more)
    # Along the plane of incidence to a little below the horizon of a facet's light, and to one side of the plane.
    along = np.arctan2(direction[:, 0], direction[:, 2]) - theta_r
    across, side = np.arcsin(direction[:, 1]), min(reach, math.pi / 2.0)
    low, high = max(-reach, -math.pi / 2.0 - 0.3 - theta_r), min(reach, math.pi / 2.0 + min(reach, 1.5) - theta_r)
    along = np.sort(np.where(along < low, along + 2.0 * math.pi, np.where(along > high, along - 2.0 * math.pi, along)))
    assert low <= along[0] < low + 0.15 * (high - low) and high - 0.15 * (high - low) < along[-1] <= high
    assert 0.0 < across.min() < 0.05 * side and 0.7 * side < across.max() <= side
    assert solid_angle.sum() == pytest.approx((high - low) * 2.0 * math.sin(side), rel=0.01)
    view = np.array([-math.sin(theta_r), 0.0, math.cos(theta_r)])
    geometry = angles_from_directions(np.array([0.0, 0.0, 1.0]), direction, view)
    np.testing.assert_allclose(cos_h, np.sqrt(np.maximum(0.5 + 0.5 * direction @ view, 0.0)), atol=1e-7)
    np.testing.assert_allclose(value, evaluate(name, mu, geometry))
    # Cells are narrowest about the mirror direction, across it by the cosine of the view angle narrower.
    nearest = np.argmin(np.abs(np.arccos(np.clip(direction @ (view * [-1.0, 0.0, 1.0]), -1.0, 1.0))))
    density = solid_angle / np.cos(across)
    assert density[nearest] == pytest.approx(density.min(), rel=0.3)


@pytest.mark.parametrize(("low", "high", "count"), [(-0.4, 1.3, 40), (0.0, 0.2, 5), (-2.0, -0.1, 9)])
def test_cells_fill_their_range_and_are_narrowest_about_zero(low, high, count):
    centre, width = grid_cells(0.05, low, high, count)
    assert len(centre) == len(width) == count and width.sum() == pytest.approx(high - low)
    edges = low + np.concatenate([[0.0], np.cumsum(width)])
    np.testing.assert_allclose(centre, 0.5 * (edges[1:] + edges[:-1]))
    # They grow with the distance from zero as its hyperbolic sine does, from the scale on.
    np.testing.assert_allclose(np.diff(np.arcsinh(edges / 0.05)), np.ptp(np.arcsinh(edges / 0.05)) / count)


@pytest.mark.parametrize(("mu", "theta_r"), [(0.02, 0.6), (0.1, 1.45), (0.15, 0.3), (0.4, 1.2)])
@pytest.mark.parametrize("name", OWN)
def test_candidates_are_all_places_of_a_grid_about_the_mirror_direction_that_facets_reach(name, mu, theta_r):
    core, tail = extent(name, mu)
    width, view = math.sqrt(2.0) * core, np.array([-math.sin(theta_r), 0.0, math.cos(theta_r)])
    finest = min(width * max(0.1, min(0.25, 0.6 * math.cos(theta_r))), 0.2)
    numbers, *places = _candidates(name, mu, theta_r)
    wanted = [n for n, one in enumerate(WIDTHS_RAD) if finest <= one < 1.02 * math.sqrt(2.0) * tail]
    assert sorted(set(numbers)) == wanted
    for number in wanted:
        own, found = WIDTHS_RAD[number], []
        step, beside = 0.6 * own, min(max(3.0 * width, 2.9 * own), 1.4)
        is_wide = max(core, own / 1.5) > 0.12
        for k in range(-2000, 2000):
            along = theta_r + k * step
            if not -math.pi / 2 <= along <= math.pi / 2 + step / 2:
                continue
            for m in range(math.ceil(beside / step) if is_wide else 1):
                across = m * step
                light = np.array(
                    [math.cos(across) * math.sin(along), math.sin(across), math.cos(across) * math.cos(along)]
                )
                half = light + view
                if math.acos(half[2] / np.linalg.norm(half)) < min(2.4 * max(core, 0.69 * own), 1.5):
                    found.append((along, across))
        chosen = numbers == number
        np.testing.assert_allclose(np.stack([one[chosen] for one in places], axis=1), found, atol=1e-9)


@pytest.mark.parametrize(("used", "noise"), [(3, 0.0), (30, 0.05)])
def test_a_target_is_pursued_by_the_column_that_explains_most_of_what_is_left(used, noise):
    """Step by step, each time with the weights of all columns anew; of forty look-ups a pair takes two."""
    rng = np.random.default_rng(7)
    rows, cost = rng.uniform(0.0, 1.0, (80, 40)) ** 4, rng.integers(1, 3, 40)
    target = rows[:, :used] @ rng.uniform(0.5, 1.0, used)
    target = target / np.linalg.norm(target) + noise * rng.normal(size=80)
    chosen, weights, rest = [], np.zeros(0), target
    while np.linalg.norm(rest) >= 0.01:
        free = [n for n in range(40) if n not in chosen and cost[n] <= 40 - sum(cost[chosen])]
        gain = {n: rest @ rows[:, n] / np.linalg.norm(rows[:, n]) for n in free}
        if not gain or max(gain.values()) < 1e-4:
            break
        chosen.append(max(gain, key=gain.get))
        weights = nnls(rows[:, chosen], target)[0]
        chosen, weights = [n for n, w in zip(chosen, weights, strict=True) if w > 0.0], weights[weights > 0.0]
        rest = target - rows[:, chosen] @ weights
    found, of_found = _pursue(rows, target, cost)
    assert found.tolist() == chosen and cost[found].sum() <= 40
    np.testing.assert_allclose(of_found, weights, rtol=1e-6)
    assert (np.linalg.norm(rest) < 0.01) == (noise == 0.0)


def test_the_command_writes_the_table_that_is_stored(tmp_path, monkeypatch):
    """Four entries of it, for all take minutes."""
    lobes, some = fitted_lobes("gaussian"), np.ix_([2, 3], [8, 9])
    monkeypatch.setattr(make_lobe_table, "MU", lobes.mu[some[0].ravel()])
    monkeypatch.setattr(make_lobe_table, "THETA_R_RAD", lobes.theta_r[some[1].ravel()])
    monkeypatch.setattr(make_lobe_table, "path_of", lambda name: tmp_path / f"{name}.h5")
    make_lobe_table.main(["gaussian"])
    with store.open_file(tmp_path / "gaussian.h5") as made, store.open_file(lobe_table.path_of("gaussian")) as stored:
        for name in ("table", "lobe"):
            assert made.attribute(name) == stored.attribute(name)
        assert np.array_equal(made.read("mu"), stored.read("mu")[some[0].ravel()])
        assert np.array_equal(made.read("theta_r"), stored.read("theta_r")[some[1].ravel()])
        assert made.read("rest") == pytest.approx(stored.read("rest")[some], rel=1e-3)
        for name in lobe_table.COLUMNS:
            found, expected = made.read(name), stored.read(name)[some]
            assert found.dtype == expected.dtype
            most = found.shape[2]
            assert found == pytest.approx(expected[..., :most], rel=1e-3, abs=1e-4)
            assert not expected[..., most:].any() and found[..., -1].any() == expected[..., most - 1].any()


def test_samples_of_a_lobe_hold_its_power():
    for name in OWN:
        for mu in (0.01, 0.1, 0.4):
            for theta_r in (0.0, 1.0, 1.4):
                _, value, _, solid_angle = lobe_samples(mu, theta_r, (150, 60), name)
                albedo = lobe_albedo(name, mu, math.cos(theta_r))[0, 0]
                assert (value * solid_angle).sum() / math.pi == pytest.approx(albedo, rel=2e-3)


@pytest.mark.parametrize("width_rad", [WIDTHS_RAD[6], WIDTHS_RAD[-1]])
@pytest.mark.parametrize("across", [0.0, 0.4])
def test_a_lobe_has_unit_power_whatever_its_width(width_rad, across):
    pixel, solid_angle = directions(512, 256)
    found = gaussians(pixel.reshape(-1, 3), unit(np.array([0.3]), np.array([across])), np.array([width_rad]))
    assert (found[:, 0] * solid_angle.ravel()).sum() == pytest.approx(1.0, rel=1e-3)


def test_lobes_are_those_of_von_mises_and_fisher_on_both_sides_of_the_plane():
    rng = np.random.default_rng(3)
    axis, direction = unit(rng.uniform(-1, 1, 4), rng.uniform(0, 1, 4)), rng.normal(size=(50, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    width_rad = np.array([0.02, 0.1, 0.5, 3.0])
    found = gaussians(direction, axis, width_rad)
    for n, ((x, y, z), width) in enumerate(zip(axis, width_rad, strict=True)):
        kappa = 1.0 / width**2
        sides = [np.exp(np.maximum(kappa * (direction @ [x, sign * y, z] - 1.0), -700.0)) for sign in (1.0, -1.0)]
        expected = kappa / (2.0 * np.pi * (1.0 - np.exp(-2.0 * kappa))) * np.mean(sides, axis=0)
        np.testing.assert_allclose(found[:, n], expected, rtol=1e-9)
    assert found.min() > 0.0


def test_the_extent_of_facets():
    assert extent("gaussian", 0.1) == pytest.approx((0.1, 0.1), rel=1e-3)
    # D of GGX is about 1/e where tanφ is 0.8054 μ; but for a share of x its facets lie within tanφ = μ / √x.
    assert extent("ggx", 0.01).core == pytest.approx(0.01 * math.sqrt(math.exp(0.5) - 1.0), rel=1e-3)
    assert math.tan(farthest("ggx", 0.02, 0.01)) == pytest.approx(0.02 * math.sqrt(99.0), rel=0.01)


def test_the_table_of_a_lobe_from_elsewhere_is_made_once_and_kept_beside_the_kernels(tmp_path, monkeypatch):
    table, made = lobe_table.path_of("ggx"), []

    def write(path, name):
        made.append(name)
        path.write_bytes(table.read_bytes())

    monkeypatch.setattr(lobe_table, "_FOLDER", tmp_path / "package")
    monkeypatch.setattr(lobe_table, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr("irodori.light.gloss.make_lobe_table.write_table", write)
    for _ in range(2):
        fitted_lobes.cache_clear()
        assert fitted_lobes("ggx").weight.shape[:2] == (12, 11)
    fitted_lobes.cache_clear()
    assert made == ["ggx"]


def test_a_lobe_without_a_table_and_a_place_for_it_is_refused_with_the_command_that_makes_it(tmp_path, monkeypatch):
    monkeypatch.setattr(lobe_table, "_FOLDER", tmp_path)
    monkeypatch.setattr(lobe_table, "cache_folder", lambda: None)
    fitted_lobes.cache_clear()
    try:
        with pytest.raises(InputError, match=r"lobe_table-ggx.h5.*python -m irodori.light.gloss.make_lobe_table ggx"):
            fitted_lobes("ggx")
    finally:
        fitted_lobes.cache_clear()
    with pytest.raises(ValueError, match="no lobe 'phong'"):
        fitted_lobes("phong")


@pytest.fixture(scope="module")
def constant():
    coefficients = np.tile(np.float32([2.0, 0.5]), (128, 256, 1))
    return Integrator(coefficients), GlossMaps.of(coefficients)


@pytest.mark.default_cases(7)
@pytest.mark.parametrize(
    ("mu", "limit"), [(0.02, 0.02), (0.07, 0.02), (0.15, 0.03), (0.3, 0.04), (0.36, 0.03), (0.8, 0.01), (1.2, 0.01)]
)
@pytest.mark.parametrize(("index", "name"), [((1.5, 0.0), "gaussian"), ((0.2, 3.4), "gaussian"), ((1.5, 0.0), "ggx")])
def test_constant_light_is_reflected_as_the_lobe_says(constant, mu, limit, index, name):
    integrator, maps = constant
    if (name, mu) == ("ggx", 0.3):
        limit = 0.07  # between two view angles of the table: the horizon cuts its tail
    for theta_r in (0.0, 33.0, 62.0, 74.0):
        normal, view = places(math.radians(theta_r), 3, seed=4)
        truth = true_gloss(integrator, normal, view, mu, index, name)
        found = gloss_radiance(maps.tables(name), normal, view, 1.0, mu, index)
        assert np.abs(found - truth).max() <= limit * truth.max()
    # Directly: radiance times Fresnel at normal view times ∫ D G 4 cosφ dω_h / π for a narrow lobe, 4 μ² π / π.
    if mu <= 0.02:
        found = gloss_radiance(maps.tables(name), [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], 1.0, mu, index)
        assert found == pytest.approx(np.array([2.0, 0.5]) * 4 * mu**2 * fresnel(1.0, *index), rel=0.01)


def test_gloss_turns_with_the_scene_and_scales_with_its_weight():
    rng = np.random.default_rng(5)
    sky = rng.uniform(0, 1, (48, 96, 3)).astype(np.float32) ** 8
    turned = np.roll(sky, 24, axis=1)  # a quarter turn about the zenith
    normal, view = places(0.7, 40, seed=6)
    mu, beta = rng.uniform(0.1, 0.5, 40), rng.uniform(0, 3, 40)
    one = gloss_radiance(GlossMaps.of(sky).tables(), normal, view, beta, mu, (1.6, 0.0))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    tables = GlossMaps.of(turned).tables()
    other = gloss_radiance(tables, normal @ quarter.T, view @ quarter.T, 2 * beta, mu, (1.6, 0.0))
    # Levels of an odd number of rows have columns that a quarter turn does not map onto each other.
    assert np.abs(other - 2 * one).max() <= 0.01 * one.max()


@pytest.mark.default_cases(6)
@pytest.mark.parametrize("name", OWN)
@pytest.mark.parametrize("mu", [0.05, 0.3, 1.2])
@pytest.mark.parametrize("place", [(40, 300), (0, 7), (70, 511)])
def test_one_bright_pixel_is_reflected_by_the_lobe_in_its_own_direction(name, mu, place):
    sky = np.zeros((256, 512, 2), np.float32)
    sky[place] = [3.0, 50.0]
    unit_, solid_angle = directions(512, 256)
    sun = unit_[place]
    rng = np.random.default_rng(9)
    mirror = sun + 0.4 * mu * rng.normal(size=(5, 3))
    mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
    normal = mirror + 0.5 * rng.normal(size=(5, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    view = 2.0 * np.sum(normal * mirror, axis=1, keepdims=True) * normal - mirror
    geometry = angles_from_directions(normal, sun, view)
    term = reflect(0.0, 0.0, 1.0, mu, geometry, n=1.7, k=0.2, lobe=name)
    found = true_gloss(Integrator(sky), normal, view, mu, (1.7, 0.2), name)
    expected = term[:, None] * sky[place] * solid_angle[place] / np.pi
    assert (expected > 0.0).any()
    assert np.abs(found - expected).max() <= 0.03 * expected.max()


def test_two_lights_are_reflected_as_each_alone():
    """However far apart they stand: what is taken together is small against the lobe."""
    skies = np.zeros((3, 512, 1024, 1), np.float32)
    skies[0, 160, 240] = skies[1, 208, 304] = skies[2, 160, 240] = skies[2, 208, 304] = 1.0
    normal, view = lit_places(Integrator(skies[2]).cells, 0.9, 0.7, 20, seed=5)
    one, other, both = (true_gloss(Integrator(sky), normal, view, 0.9) for sky in skies)
    assert np.median(both) > 0.0 and both == pytest.approx(one + other, rel=0.01)


def test_places_have_the_angle_and_mirror_where_light_comes_from():
    normal, view = places(0.9, 50, seed=3)
    assert np.linalg.norm([normal, view], axis=-1) == pytest.approx(1.0)
    assert np.sum(normal * view, axis=1) == pytest.approx(math.cos(0.9))
    sky = np.zeros((64, 128, 1), np.float32)
    sky[20, 90] = 1.0
    sun = directions(128, 64)[0][20, 90]
    for mu in (0.02, 0.2):
        normal, view = lit_places(Integrator(sky).cells, mu, 0.9, 200, seed=4)
        assert np.linalg.norm([normal, view], axis=-1) == pytest.approx(1.0)
        assert np.sum(normal * view, axis=1) == pytest.approx(math.cos(0.9))
        mirror = 2.0 * np.sum(normal * view, axis=1, keepdims=True) * normal - view
        away = np.linalg.norm(np.cross(mirror, sun), axis=1)
        assert 0.7 * mu < math.sqrt((away**2).mean() / 2.0) < 1.3 * mu
    black = lit_places(Integrator(0.0 * sky).cells, 0.2, 0.9, 7, seed=4)
    assert np.array_equal(black, places(0.9, 7, seed=4))


def test_errors_of_the_look_up_are_those_against_the_true_lobe():
    """Root mean square and largest over six places each, relative to the radiance; black light has none."""
    sky = np.random.default_rng(6).uniform(0.5, 1.0, (32, 64, 1)).astype(np.float32)
    integrator, maps = Integrator(sky), GlossMaps.of(sky)
    rows = gloss_errors(integrator, maps, "ggx")
    assert len(rows) == 48 and {row["lobe"] for row in rows} == {"ggx"}
    assert len({(row["mu"], row["theta_r_deg"]) for row in rows}) == 48
    for row in rows[::7]:
        angle = math.radians(row["theta_r_deg"])
        both = places(angle, 3), lit_places(integrator.cells, row["mu"], angle, 3)
        normal, view = (np.concatenate(one) for one in zip(*both, strict=True))
        true = true_gloss(integrator, normal, view, row["mu"], lobe="ggx")[:, 0]
        off = gloss_radiance(maps.tables("ggx"), normal, view, 1.0, row["mu"], (1.5, 0.0))[:, 0] - true
        assert row["rms"] == pytest.approx(np.sqrt((off**2).sum() / (true**2).sum()))
        assert row["max"] == pytest.approx(np.abs(off).max() / true.max())
    dark = gloss_errors(Integrator(0.0 * sky), GlossMaps.of(0.0 * sky))
    assert all(row["rms"] == row["max"] == 0.0 for row in dark)


def test_errors_of_the_look_up_are_root_mean_squares_and_largest_ones_over_places_of_both_kinds(monkeypatch):
    """Of two roughnesses and view angles: over places at random and places that mirror the bright."""
    monkeypatch.setattr(look_up_errors, "MU", (0.1, 0.8))
    monkeypatch.setattr(look_up_errors, "THETA_R_DEG", (0.0, 60.0))
    sky = np.random.default_rng(6).uniform(0.5, 1.0, (16, 32, 1)).astype(np.float32)
    sky[3, 5] = 40.0
    integrator, maps = Integrator(sky), GlossMaps.of(sky)
    rows = gloss_errors(integrator, maps)
    assert [(row["mu"], row["theta_r_deg"]) for row in rows] == [(0.1, 0.0), (0.1, 60.0), (0.8, 0.0), (0.8, 60.0)]
    for row in rows:
        mu, angle = row["mu"], math.radians(row["theta_r_deg"])
        both = places(angle, 3), lit_places(integrator.cells, mu, angle, 3)
        normal, view = (np.concatenate(one) for one in zip(*both, strict=True))
        true = true_gloss(integrator, normal, view, mu)[:, 0]
        off = gloss_radiance(maps.tables(), normal, view, 1.0, mu, (1.5, 0.0))[:, 0] - true
        assert row["rms"] == pytest.approx(np.sqrt((off**2).sum() / (true**2).sum()))
        assert row["max"] == pytest.approx(np.abs(off).max() / true.max()) and row["lobe"] == "gaussian"
        # Of a rough surface the look-up is good enough to tell the normal from the view.
        assert mu < 0.8 or row["rms"] < 0.01
    dark = gloss_errors(Integrator(0.0 * sky), GlossMaps.of(0.0 * sky))
    assert all(row["rms"] == row["max"] == 0.0 for row in dark)


def test_what_reflects_nothing_gives_nothing(constant):
    tables = constant[1].tables()
    up, side = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    for normal, view, beta, mu in ((up, -up, 1.0, 0.1), (up, side, 1.0, 0.1), (up, up, 0.0, 0.1), (up, up, 1.0, np.nan),
                                   (up, up, np.nan, 0.1), (up, up, 1.0, 0.0)):  # fmt: skip
        assert (gloss_radiance(tables, normal, view, beta, mu, (1.5, 0.0)) == 0).all()
    assert np.isfinite(gloss_radiance(tables, -up, -up, 1.0, 0.1, (1.5, 0.0))).all()


@pytest.mark.heavy
@pytest.mark.parametrize(("name", "lobe"), [("museum", "gaussian"), ("hall", "gaussian"), ("hall", "ggx")])
def test_the_errors_under_a_photographed_place(name, lobe, monkeypatch):
    path = DATA / "environments" / f"{name}.exr"
    if not path.is_file():
        pytest.skip(f"no picture at {path}")
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    light = np.maximum(source.read_image("float"), 0.0)
    source.close()
    if lobe == "ggx":  # its long tails take ten times as long to integrate: a sharp, a middling and a wide lobe
        monkeypatch.setattr(look_up_errors, "MU", look_up_errors.MU[::3])
    rows = gloss_errors(Integrator(light), GlossMaps.of(light), lobe)
    assert len(rows) == (18 if lobe == "ggx" else 48) and {row["lobe"] for row in rows} == {lobe}
    for row in rows:
        # Across the plane of incidence the lobe is as narrow as cosθ_r: under the finest map it is only sketched.
        finest = WIDTHS_RAD[first_level(*light.shape[:2])]
        narrow = math.sqrt(2.0) * row["mu"] * math.cos(math.radians(row["theta_r_deg"])) < finest
        limit = 0.35 if narrow else 0.2 if row["theta_r_deg"] > 80 else 0.06
        assert row["rms"] <= limit and row["max"] <= 1.5 * limit, row


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("mu", [0.05, 0.2, 0.36, 0.6, 1.2])
def test_a_sun_under_the_horizon_does_not_shine(mu):
    sky = np.zeros((128, 256, 1), np.float32)
    sky[90, 40] = 1e4  # its centre 37.3 degrees under the zenith's horizon
    integrator, tables = Integrator(sky), GlossMaps.of(sky).tables()
    sun = directions(256, 128)[0][90, 40]
    across = np.cross(sun, [0.3, 0.5, 0.8])
    across /= np.linalg.norm(across)
    side = np.cross(across, sun)

    def seen(height_deg, theta_r_deg):  # the sun at a height over the horizon, in the plane of incidence
        height, theta_r = math.radians(height_deg), math.radians(theta_r_deg)
        normal = math.sin(height) * sun + math.cos(height) * side
        forward = math.cos(height) * sun - math.sin(height) * side
        view = math.cos(theta_r) * normal - math.sin(theta_r) * forward
        pair = normal[None], view[None]
        found = gloss_radiance(tables, *pair, 1.0, mu, (1.5, 0.0))[0, 0]
        return found, true_gloss(integrator, *pair, mu)[0, 0]

    peak = max(seen(height, 80.0)[1] for height in (5, 10, 15, 20, 30, 40))
    assert peak > 0
    for below in (-3.0, -6.0, -12.0, -40.0):
        # The sun's own pixel is 1.4 degrees high; a map blurs it by no more than a tenth of the lobe.
        assert abs(seen(below, 80.0)[0]) <= 0.04 * peak, below


def test_points_are_the_light_they_stand_for():
    rng = np.random.default_rng(8)
    sky = rng.gamma(0.1, 1.0, (96, 192, 3)).astype(np.float32)
    sky[0, 5], sky[50, 191] = 1e5, 3e5  # at the pole and the seam
    points = point_lights(sky)
    unit_, solid_angle = directions(192, 96)
    power = (sky * solid_angle[..., None]).sum(axis=(0, 1))
    assert np.allclose(points.power.sum(axis=0), power, rtol=1e-5)
    assert np.allclose(np.linalg.norm(points.direction, axis=1), 1.0)
    for place in ((0, 5), (50, 191)):
        brightest = points.direction[(points.direction @ unit_[place]).argmax()]
        assert brightest @ unit_[place] > math.cos(0.001)
    assert len(point_lights(np.zeros((4, 8, 2), np.float32)).power) == 0


@pytest.mark.parametrize("size", [(96, 192), (100, 150), (5, 9)])
def test_each_point_has_the_power_of_a_cell_of_a_tenth_of_a_radian_and_stands_in_its_centre_of_power(size):
    """Of 32 bands of rows, each in as many cells as its longest row is long; coarse pixels are divided first."""
    sky = np.random.default_rng(9).gamma(0.5, 1.0, (*size, 2)).astype(np.float32)
    fine = sky.repeat(-(-64 // size[0]) if size[0] < 64 else 1, axis=0)
    fine = fine.repeat(-(-128 // size[1]) if size[1] < 128 else 1, axis=1)
    (height, width), points = fine.shape[:2], point_lights(sky)
    unit_, solid_angle = directions(width, height)
    light, number = fine * solid_angle[..., None], 0
    length = np.linalg.norm(light, axis=2)[..., None] * unit_
    rows = np.round(np.linspace(0, height, 33)).astype(int)
    for first, last in itertools.pairwise(rows):
        longest = np.sin(np.pi * (np.arange(first, last) + 0.5) / height).max()
        columns = np.round(np.linspace(0, width, max(4, math.ceil(64 * longest)) + 1)).astype(int)
        for left, right in itertools.pairwise(columns):
            cell = np.s_[first:last, left:right]
            np.testing.assert_allclose(points.power[number], light[cell].sum(axis=(0, 1)), rtol=1e-4)
            moment = length[cell].sum(axis=(0, 1))
            np.testing.assert_allclose(points.direction[number], moment / np.linalg.norm(moment), atol=1e-5)
            number += 1
    assert number == len(points.power)


def test_gloss_maps_in_a_file(tmp_path, constant):
    maps = constant[1]
    light = Environment(np.ones((8, 16, 2), np.float32), np.ones((61, 2)), np.ones((4, 8, 2), np.float32))
    light.save(tmp_path / "e.h5", store.Provenance("test"), gloss=maps)
    read = GlossMaps.load(tmp_path / "e.h5")
    assert read.first == maps.first
    assert all(np.array_equal(a, b) for a, b in zip(read.levels, maps.levels, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(read.points, maps.points, strict=True))
    some = GlossMaps.load(tmp_path / "e.h5", (maps.first + 1, maps.first + 3))
    assert some.first == maps.first + 1 and len(some.levels) == 2
    assert np.array_equal(some.levels[1], maps.levels[2])
    finer = GlossMaps.load(tmp_path / "e.h5", (0, maps.first))
    assert finer.first == maps.first and len(finer.levels) == 1
    assert GlossMaps.stored(light) is None
    assert GlossMaps.stored(Environment.load(tmp_path / "e.h5")).first == maps.first
    light.save(tmp_path / "none.h5", store.Provenance("test"))
    assert GlossMaps.stored(Environment.load(tmp_path / "none.h5")) is None
    with pytest.raises(InputError, match="gloss/width"):
        GlossMaps.load(tmp_path / "none.h5")
