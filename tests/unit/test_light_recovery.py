"""Recovered light beside the true one: lamps and rooms that the prior has never seen, and the stated error."""

from dataclasses import replace

import numpy as np
import pytest
from exact_light import as_it_is

from benchmarks.light import CIE, WALLS, adapted_errors, camera, errors, unlike
from irodori.core import store
from irodori.core.errors import InputError
from irodori.evaluation.truth_errors import radiance_delta_e
from irodori.light.environment_file import Environment
from irodori.light.light_prior import LightPrior, light_prior, published_lamps
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel, draw_directions
from irodori.spectra.published import spectrum

TCS = np.stack([spectrum(f"TCS{i}") for i in range(99)])
#: Every third lamp, all kinds among them.
SOME = CIE[::3]


@pytest.fixture(scope="module")
def seen():
    return camera()


@pytest.fixture(scope="module")
def prior() -> LightPrior:
    return light_prior(published_lamps())


def one_direction(response: np.ndarray) -> Directions:
    return Directions(response[None], np.ones(1))


def test_lamps_that_the_prior_does_not_know_are_recovered_far_better_than_as_the_rigs_lamp_on_paint(seen):
    found, before = errors(seen, "mixture")[:, 0], errors(seen, "rig-lamp")[:, 0]
    assert found.mean() <= 0.60 and before.mean() > 1.5
    # Three narrow lines are like no other published lamp.
    assert [name for name, worse in zip(CIE, found - before > 0.2, strict=True) if worse] in ([], ["LED-RGB1"])
    assert (found - before).max() < 0.9


def test_a_mixture_of_families_is_better_than_one_family_of_all_lamps(seen):
    assert errors(seen, "mixture", names=SOME).mean() < 0.75 * errors(seen, "posterior", names=SOME).mean()


def test_light_off_coloured_walls_is_no_worse_than_as_the_rigs_lamp_on_paint(seen):
    found, before = (errors(seen, variant, WALLS[::2], SOME).mean(axis=0) for variant in ("mixture", "rig-lamp"))
    assert (found < before).all() and found.mean() < 0.7 * before.mean()


def test_the_other_directions_of_a_room_tell_of_its_lamps(seen):
    """What one wall leaves open, the walls beside it under the same lamp decide."""
    rng, alone, together = np.random.default_rng(4), [], []
    for name in ("FL2", "FL11", "LED-B2", "D50", "HP4"):
        lamp = spectrum(name) / spectrum(name).mean()
        known = light_prior(unlike(published_lamps(), lamp))
        light = lamp * TCS[rng.choice(99, 8, replace=False)]
        response = light @ seen.sensitivity.T
        for one, answer in zip(light, response, strict=True):
            own = LightRecovery.of_room(seen.model, one_direction(answer), known)
            alone.append(adapted_errors(one, own.basis @ own.weights(answer)))
        room = LightRecovery.of_room(seen.model, Directions(response, np.full(8, 1 / 8)), known)
        together += [adapted_errors(*pair) for pair in zip(light, room.weights(response) @ room.basis.T, strict=True)]
    assert np.mean(together) < np.mean(alone)


def test_the_stated_error_is_the_error_of_lamps_that_the_prior_does_not_know(seen):
    found, expected, rng = [], [], np.random.default_rng(6)
    for name in CIE[::2]:
        true = spectrum(name) / spectrum(name).mean()
        response = seen.sensitivity @ true
        recovery = LightRecovery.of_room(
            seen.model, one_direction(response), light_prior(unlike(published_lamps(), true))
        )
        weights = recovery.weights(response)
        own = recovery.basis @ weights
        drawn = rng.standard_normal((8, len(recovery.errors)))
        lights = own + np.einsum("dq,qlr,r->dl", drawn, recovery.errors, weights)
        found.append(radiance_delta_e(TCS * true, TCS * own, true).mean())
        expected.append(np.mean([radiance_delta_e(TCS * own, TCS * one, own).mean() for one in lights]))
    ratio = np.log(np.array(expected) / found)
    assert np.median(np.abs(ratio)) < np.log(2.0) and np.abs(np.median(ratio)) < np.log(1.5)
    assert np.sum(expected) == pytest.approx(np.sum(found), rel=0.5)


def test_twice_the_light_is_twice_what_is_recovered_and_what_is_not_finite_stays_so(seen, prior):
    response = (seen.sensitivity @ (spectrum("FL11") * TCS[:9]).T).T.astype(np.float32)
    recovery = LightRecovery.of_room(seen.model, Directions(response.astype(float), np.full(9, 1 / 9)), prior)
    weights = recovery.weights(response)
    assert recovery.weights(2.0 * response) == pytest.approx(2.0 * weights, rel=1e-5)
    holes = response.copy()
    holes[2, 3], holes[5] = np.nan, 0.0
    found = recovery.weights(holes)
    assert np.isnan(found[2]).all() and (found[5] == 0.0).all()
    np.testing.assert_array_equal(found[[0, 1, 3, 4, 6, 7, 8]], weights[[0, 1, 3, 4, 6, 7, 8]])


def test_a_picture_is_recovered_to_the_same_bits_pixel_by_pixel(seen, prior):
    rng = np.random.default_rng(2)
    response = rng.uniform(0.0, 1.0, (5000, 6)).astype(np.float32)
    recovery = LightRecovery.of_room(seen.model, draw_directions([(response, 1.0)]), prior)
    whole = recovery.weights(response)
    np.testing.assert_array_equal(recovery.weights(response[1234:1301]), whole[1234:1301])


def test_a_black_room_is_black(seen, prior):
    drawn = draw_directions([(np.zeros((40, 6)), 1.0)] * 2)
    assert (LightRecovery.of_room(seen.model, drawn, prior).weights(np.zeros((3, 6))) == 0.0).all()


def test_directions_are_drawn_by_their_light():
    response = np.concatenate([np.full((500, 3), 1e-4), np.full((1, 3), 50.0), np.full((1, 3), np.nan)])
    drawn = draw_directions([(response, 1.0), (np.full((10, 3), 5.0), 1.0)])
    bright = drawn.response[:, 0] > 1.0
    assert drawn.share[bright].sum() > 0.99 and drawn.share.sum() == pytest.approx(1.0)
    assert drawn.share[drawn.response[:, 0] == 50.0].sum() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("lacking", ["band_response", "band_response_covariance"])
def test_a_calibration_that_does_not_know_its_response_is_refused(seen, lacking):
    calibration = replace(seen.calibration, **{lacking: None})
    with pytest.raises(InputError, match=rf"c\.h5.*{lacking}.*no such dataset"):
        ResponseModel.of(calibration, "c.h5")


def test_a_drawn_light_differs_by_its_errors_alone_and_given_light_has_none(tmp_path):
    basis = as_it_is(np.eye(61)[:, :2]).basis
    shape = np.ones((2, 4, 2), np.float32)
    light = Environment(shape, basis, shape, basis_errors=np.stack([basis, 2 * basis]))
    light.save(tmp_path / "e.h5", store.Provenance("test"))
    stored = Environment.load(tmp_path / "e.h5")
    ratios = [stored.drawn(np.random.default_rng(seed)).basis[0, 0] - 1.0 for seed in range(2000)]
    assert np.std(ratios) == pytest.approx(np.sqrt(5.0), rel=0.1) and np.mean(ratios) == pytest.approx(0.0, abs=0.2)
    with pytest.raises(ValueError, match="without errors"):
        replace(light, basis_errors=None).drawn(np.random.default_rng(0))
