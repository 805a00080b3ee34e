"""Tristimulus values against the colour-science library's full-range integration, CIEDE2000 against its test data."""

import colour
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from irodori.colour.colorimetry import (
    colour_matching_weights,
    delta_e,
    delta_e_metric,
    delta_e_reflectance,
    goodness_of_fit,
    lab_from_xyz,
    spectral_rmse,
    summary,
    xyz_from_radiance,
    xyz_from_reflectance,
)
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import chart_spectra, spectrum

OBSERVER = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
FULL = colour.SpectralShape(360, 830, 1)
CHART = "BabelColor Average"
LIGHTS = ["D65", "A"]
REFLECTANCE = arrays(np.float64, 61, elements=st.floats(0.0, 1.0))
LAB = arrays(np.float64, 3, elements=st.floats(-100.0, 100.0)).map(lambda v: v * [0.5, 1, 1] + [50, 0, 0])


def light_1nm(name):
    # CIE 15 interpolates the D illuminants linearly between their tabulated values.
    light = colour.SDS_ILLUMINANTS[name].copy()
    own = colour.SpectralShape(light.shape.start, light.shape.end, 1)
    return light.interpolate(own, interpolator=colour.LinearInterpolator).extrapolate(FULL).trim(FULL)


def patch_1nm(patch, **interpolation):
    """Return a chart patch at every nm, held at its measured ends (380 and 730 nm)."""
    own = colour.SpectralShape(patch.shape.start, patch.shape.end, 1)
    return patch.copy().interpolate(own, **interpolation).extrapolate(FULL)


def library_xyz(distribution, name):
    return colour.sd_to_XYZ(distribution, cmfs=OBSERVER, illuminant=light_1nm(name), method="Integration")


def library_lab(xyz, name):
    white = library_xyz(colour.sd_ones(FULL), name)
    return colour.XYZ_to_Lab(np.asarray(xyz) / 100, colour.XYZ_to_xy(white))


def differences(ours, library, name):
    return colour.delta_E(library_lab(ours, name), library_lab(library, name), method="CIE 2000")


# Tristimulus values


@pytest.mark.parametrize(
    ("name", "published"),
    [("D65", (95.047, 100.0, 108.883)), ("A", (109.850, 100.0, 35.585))],
)
def test_a_perfect_diffuser_has_the_published_white_point(name, published):
    # ASTM E308-01, table 5, 2° observer; 1 nm against 5 nm tables differ in the last digits.
    assert xyz_from_reflectance(name).sum(axis=1) == pytest.approx(published, abs=0.01)


@pytest.mark.parametrize("name", LIGHTS)
def test_a_perfect_diffuser_has_the_white_point_of_the_library(name):
    white = xyz_from_reflectance(name) @ np.ones(61)
    assert white == pytest.approx(library_xyz(colour.sd_ones(FULL), name), rel=1e-9)


@given(reflectance=REFLECTANCE, name=st.sampled_from(LIGHTS))
@settings(deadline=None, max_examples=20)
def test_held_end_values_are_integrated_exactly(reflectance, name):
    # What design §3 states as a definition: piecewise linear inside, end values held outside, the light in full.
    held = np.interp(FULL.wavelengths, WAVELENGTH_NM, reflectance)
    expected = library_xyz(colour.SpectralDistribution(held, FULL.wavelengths), name)
    assert xyz_from_reflectance(name) @ reflectance == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("name", "design_max"), [("D65", 0.03), ("A", 0.1)])
def test_holding_the_ends_costs_the_colour_checker_almost_nothing(name, design_max):
    # The chart is measured from 380 to 730 nm; both sides interpolate it linearly, so that only the tails differ.
    # Design §3 claims a maximum of 0.03 under D65. A has more power in the red tail, for which the
    # design names no figure; 0.1 is a tenth of what can be seen.
    _, patches = chart_spectra(CHART)
    library = [
        library_xyz(patch_1nm(p, interpolator=colour.LinearInterpolator), name)
        for p in colour.SDS_COLOURCHECKERS[CHART].values()
    ]
    error = differences(patches @ xyz_from_reflectance(name).T, library, name)
    assert error.mean() <= 0.05
    assert error.max() <= design_max


@pytest.mark.parametrize("name", LIGHTS)
def test_61_samples_of_a_smooth_chart_keep_its_colour(name):
    # The library interpolates the 10 nm chart by Sprague's fifth order [CIE 15]; 61 samples of that curve lose what
    # lies between 5 nm steps and beyond the ends.
    smooth = [patch_1nm(p) for p in colour.SDS_COLOURCHECKERS[CHART].values()]
    samples = np.array([s[WAVELENGTH_NM] for s in smooth])
    error = differences(samples @ xyz_from_reflectance(name).T, [library_xyz(s, name) for s in smooth], name)
    assert error.mean() <= 0.05
    assert error.max() <= 0.1


@given(reflectance=REFLECTANCE)
@settings(deadline=None)
def test_more_reflectance_never_darkens(reflectance):
    brighter = reflectance + 0.5 * (1 - reflectance)
    assert (xyz_from_reflectance("D65") @ (brighter - reflectance) >= 0).all()


def test_white_radiance_has_y_100_on_any_scale():
    for scale in (1e-3, 1.0, 1e4):
        white = scale * spectrum("D65")
        assert (xyz_from_radiance(white) @ white)[1] == pytest.approx(100.0, rel=1e-12)


def test_an_equal_energy_light_is_neutral():
    # The 2° observer is normalised so that equal energy has x = y = z = 1/3, to the four decimals that CIE 15 prints.
    total = colour_matching_weights().sum(axis=1)
    assert total / total.sum() == pytest.approx(np.full(3, 1 / 3), abs=1e-4)


def test_a_light_given_as_a_file_agrees_with_the_same_light_by_name(tmp_path):
    # Its tails are held at the ends, so the white point of D65 may move only a little: less than 0.5 CIEDE2000.
    file = tmp_path / "d65.csv"
    cells = [",".join(map(str, ["name", *WAVELENGTH_NM])), ",".join(map(str, ["d65", *spectrum("D65")]))]
    file.write_text("\n".join(cells))
    from_file = xyz_from_reflectance(str(file))
    assert from_file.sum(axis=1)[1] == pytest.approx(100.0, rel=1e-12)
    white = xyz_from_reflectance("D65").sum(axis=1)
    assert delta_e(lab_from_xyz(from_file.sum(axis=1), white), np.array([100.0, 0.0, 0.0])) < 0.5


# CIELAB and CIEDE2000


@given(scale=st.floats(0.01, 1e4), white=arrays(np.float64, 3, elements=st.floats(0.1, 2.0)))
def test_white_is_100_0_0(scale, white):
    assert lab_from_xyz(scale * white, scale * white) == pytest.approx([100.0, 0.0, 0.0], abs=1e-12)


def test_black_is_0_0_0():
    assert lab_from_xyz(np.zeros(3), np.array([95.0, 100.0, 109.0])) == pytest.approx([0, 0, 0], abs=1e-12)


@given(xyz=arrays(np.float64, (4, 3), elements=st.floats(0.0, 150.0)))
@settings(deadline=None)
def test_lab_agrees_with_the_library(xyz):
    white = np.array([95.047, 100.0, 108.883])
    expected = colour.XYZ_to_Lab(xyz / 100, colour.XYZ_to_xy(white))
    assert lab_from_xyz(xyz, white) == pytest.approx(expected, abs=1e-9)


def test_lab_is_continuous_where_the_cube_root_meets_the_line():
    white = np.ones(3)
    edge = (6 / 29) ** 3
    below, above = (lab_from_xyz(np.full(3, edge * s), white) for s in (1 - 1e-9, 1 + 1e-9))
    assert below == pytest.approx(above, abs=1e-6)
    assert above[0] == pytest.approx(8.0, abs=1e-6)


# Sharma, Wu and Dalal (2005), Color Res. Appl. 30(1), 21-30, table 1. The pairs stand at the traps: the mean hue
# across 0°, hues 180° apart, the rotation in the blue, greys, and near black.
SHARMA = np.array(
    [
        [50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425],
        [50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615],
        [50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461],
        [50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065],
        [50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492],
        [50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
        [90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ]
)


def test_ciede2000_agrees_with_the_published_pairs_both_ways():
    assert delta_e(SHARMA[:, :3], SHARMA[:, 3:6]) == pytest.approx(SHARMA[:, 6], abs=5.1e-5)
    assert delta_e(SHARMA[:, 3:6], SHARMA[:, :3]) == pytest.approx(SHARMA[:, 6], abs=5.1e-5)


def test_the_metric_of_ciede2000_is_that_of_small_differences():
    """By the library, greys, the blue rotation and the hue 0 among the colours."""
    rng = np.random.default_rng(3)
    lab = rng.uniform([1, -90, -90], [99, 90, 90], (2000, 3))
    lab[:50, 1:] = 0.0
    lab[50:100, 2] = rng.uniform(-1e-3, 1e-3, 50)
    step = 1e-2 * rng.normal(size=lab.shape)
    expected = colour.delta_E(lab - 0.5 * step, lab + 0.5 * step, method="CIE 2000")
    found = np.sqrt(np.einsum("ni,nij,nj->n", step, delta_e_metric(lab), step))
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@given(lab=LAB, other=LAB)
@settings(deadline=None)
def test_ciede2000_is_zero_for_equals_and_never_negative(lab, other):
    assert delta_e(lab, lab) == 0.0
    assert delta_e(lab, other) >= 0.0


def test_equal_reflectances_have_no_difference_and_unequal_ones_are_lab_differences():
    _, patches = chart_spectra(CHART)
    assert delta_e_reflectance(patches, patches, "A") == pytest.approx(np.zeros(24), abs=1e-12)
    matrix = xyz_from_reflectance("A")
    expected = differences(patches[:12] @ matrix.T, patches[12:] @ matrix.T, "A")
    assert delta_e_reflectance(patches[:12], patches[12:], "A") == pytest.approx(expected, rel=1e-6)


# Measures


def test_summary_counts_and_measures_only_finite_values():
    values = np.r_[np.arange(101.0), np.nan, np.inf, np.nan]
    result = summary(values)
    assert result == {"count": 101, "mean": 50.0, "p95": 95.0, "p99": 99.0, "max": 100.0}


def test_summary_of_nothing_finite_is_nan_and_not_zero():
    result = summary(np.array([np.nan, np.nan]))
    assert result["count"] == 0
    assert all(np.isnan(result[key]) for key in ("mean", "p95", "p99", "max"))


@given(spectra=arrays(np.float64, (3, 61), elements=st.floats(0.01, 1.0)), scale=st.floats(1e-3, 1e3))
def test_goodness_of_fit_is_one_for_a_scaled_spectrum(spectra, scale):
    assert goodness_of_fit(spectra, scale * spectra) == pytest.approx(np.ones(3), abs=1e-12)


@given(a=REFLECTANCE, b=REFLECTANCE)
def test_goodness_of_fit_is_a_cosine_and_nan_against_darkness(a, b):
    fit = goodness_of_fit(a, b)
    assert np.isnan(fit) or -1e-12 <= fit <= 1 + 1e-12
    assert np.isnan(goodness_of_fit(a, np.zeros(61)))


@given(spectra=arrays(np.float64, (3, 61), elements=st.floats(0.0, 1.0)), offset=st.floats(-0.5, 0.5))
def test_rmse_of_a_constant_offset_is_the_offset(spectra, offset):
    assert spectral_rmse(spectra, spectra + offset) == pytest.approx(np.full(3, abs(offset)), abs=1e-12)
