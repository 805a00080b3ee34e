"""The figures asked for, on measured spectra: cameras, a filter, charts, and materials that no one trained on."""

from functools import lru_cache

import pytest

from benchmarks.calibrate import CAMERAS, CIE, DATA, NEVER_SEEN, NOISES, Trial, coverage, errors, size_without

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured spectra at {DATA}")
#: What the best estimator must reach on the first camera, mean CIEDE2000 under D65 at each noise.
TARGETS = dict(zip(NOISES, (0.31, 0.46, 0.89, 2.47), strict=True))


@lru_cache
def trial(*names) -> Trial:
    return Trial.of(*names)


@lru_cache
def found(names, noise, estimator, bases=12, stated=False):
    return errors(trial(*names), noise, estimator, bases, stated)


FIRST = (CAMERAS[0], "classic", "munsell")


def test_the_baseline_is_that_measured_beforehand():
    # It took the chart's 10 nm linearly to the grid, not by Sprague's polynomial as is done here.
    assert found(FIRST, 0.0, "pinv", 6) == pytest.approx([0.39, 0.79, 0.0129], rel=0.03)
    for noise, mean, rmse in ((0.0, 0.31, 0.0094), (0.001, 0.46, 0.0108), (0.003, 0.89, 0.0125), (0.01, 2.47, 0.0187)):
        bound = found(FIRST, noise, "bound")
        assert bound[0] == pytest.approx(mean, rel=0.04) and bound[2] == pytest.approx(rmse, rel=0.03)


@pytest.mark.parametrize("noise", NOISES)
def test_local_reaches_the_linear_bound_without_the_test_set(noise):
    error = found(FIRST, noise, "local")[0]
    assert error <= TARGETS[noise]
    assert error <= found(FIRST, noise, "bound")[0]


@pytest.mark.parametrize("noise", NOISES[1:])
def test_knowing_the_variance_of_a_pixel_goes_well_under_the_bound(noise):
    assert found(FIRST, noise, "local", stated=True)[0] <= 0.97 * found(FIRST, noise, "bound")[0]


@pytest.mark.heavy
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("camera", CAMERAS[1:])
def test_other_cameras_reach_their_bound(camera, noise):
    names = (camera, "classic", "munsell")
    assert found(names, noise, "local")[0] <= 1.002 * found(names, noise, "bound")[0]


@pytest.mark.heavy
@pytest.mark.parametrize("noise", NOISES)
def test_the_larger_chart_reaches_the_bound(noise):
    names = (CAMERAS[0], "sg", "munsell")
    assert found(names, noise, "local")[0] <= found(names, noise, "bound")[0]


@pytest.mark.heavy
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("train", ["classic", "sg"])
def test_other_materials_are_recovered_better_than_by_the_pseudo_inverse(train, noise):
    # Vrhel's rocks, skins and plants are not the chart's paints.
    names = (CAMERAS[0], train, "vrhel")
    assert found(names, noise, "local")[0] <= 0.9 * found(names, noise, "pinv", 6)[0]
    assert found(names, noise, "local")[0] <= 1.02 * found(names, noise, "wiener")[0]


@pytest.mark.parametrize("noise", NOISES[:2])
def test_other_materials_reach_the_linear_bound_at_little_noise(noise):
    names = (CAMERAS[0], "classic", "vrhel")
    assert found(names, noise, "kernel")[0] <= 1.005 * found(names, noise, "bound")[0]
    # Eight principal vectors of 24 paints do not hold these spectra; twelve do.
    assert found(names, noise, "kernel", 8)[0] >= 1.02 * found(names, noise, "kernel")[0]


@pytest.mark.heavy
@pytest.mark.parametrize("noise", NOISES[:2])
@pytest.mark.parametrize("camera", CAMERAS[:2])
def test_the_larger_chart_reaches_the_bound_on_other_materials(camera, noise):
    names = (camera, "sg", "vrhel")
    assert found(names, noise, "broad")[0] <= found(names, noise, "bound")[0]


def test_the_larger_chart_reaches_the_bound_of_another_camera():
    names = (CAMERAS[1], "sg", "munsell")
    assert found(names, 0.0, "local")[0] <= found(names, 0.0, "bound")[0]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("test", ["munsell", "vrhel"])
@pytest.mark.parametrize("camera", [CAMERAS[0], *(pytest.param(c, marks=pytest.mark.heavy) for c in CAMERAS[1:])])
def test_the_choice_is_the_best_estimator_at_the_noise_of_the_pixels(camera, test):
    names = (camera, "classic", test)
    for stated in (False, True):
        chosen = found(names, 0.01, "auto", 0, stated)[0]
        assert chosen <= 1.01 * min(
            found(names, 0.01, n, 12, stated)[0] for n in ("ridge", "wiener", "local", "kernel")
        )
    assert chosen <= found(names, 0.01, "bound")[0]


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("noise", NOISES[:2])
@pytest.mark.parametrize("test", ["munsell", "vrhel"])
def test_the_choice_keeps_to_the_bound_at_little_noise(test, noise):
    names = (CAMERAS[0], "classic", test)
    assert found(names, noise, "auto", 0)[0] <= 1.05 * found(names, noise, "bound")[0]


@pytest.mark.heavy
@pytest.mark.default_cases(3)
@pytest.mark.parametrize("pair", NEVER_SEEN, ids=[test for _, test in NEVER_SEEN])
def test_error_bars_hold_on_sets_and_a_camera_that_had_no_part_in_them(pair):
    # Their size is that which the other sets ask for, seen by another camera.
    found = coverage(CAMERAS[2], pair, 0.001, size_without(pair[1]))
    if pair[1] == CIE:  # chosen to differ: no other set tells of such colours, and they are stated too narrow
        assert found.wavelengths[0] >= 0.55 and found.wavelengths[1] >= 0.85 and found.delta_e[1] >= 0.9
        return
    # The SG's gloss paints are stated too wide: the ColorChecker that was trained on has a fifth of them.
    assert 0.62 <= found.wavelengths[0] <= (0.82 if pair[1] == "sg" else 0.75)
    assert 0.62 <= found.delta_e[0] <= 0.8
    assert found.wavelengths[1] >= 0.91 and found.delta_e[1] >= 0.93


@pytest.mark.heavy
def test_stated_errors_tell_which_spectra_are_recovered_worse():
    found = [coverage(CAMERAS[2], pair, 0.001).rank for pair in NEVER_SEEN]
    assert sum(rank >= 0.4 for rank in found) >= 4
