"""Charts that stand in a room: what they tell of its lamps, and which of them are refused."""

import numpy as np
import pytest

from benchmarks.light import CHART, adapted_errors, camera, chart_under, errors, recovered, unlike
from irodori.core.errors import InputError
from irodori.light.light_prior import prior_of_any_lamp, published_lamps
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel
from irodori.light.room_charts import recovery_with
from irodori.spectra.published import chart_spectra, spectrum

#: Lamps of all kinds, none of them in the prior, nor one like it.
LAMPS = ("D50", "FL11", "HP4", "LED-B3", "LED-RGB1")
WALLS = np.stack([spectrum(f"TCS{number}") for number in (7, 16, 39, 40, 59, 80)])


@pytest.fixture(scope="module")
def seen():
    return camera()


def lamp(name: str) -> np.ndarray:
    return spectrum(name) / spectrum(name).mean()


def prior_without(*names: str):
    return prior_of_any_lamp(unlike(published_lamps(), *(lamp(name) for name in names)) if names else None)


def room_of(seen, lights: np.ndarray) -> Directions:
    """A room that shows some lights, (n, 61), each as much as the others."""
    return Directions(lights @ seen.sensitivity.T, np.full(len(lights), 1 / len(lights)))


def error(recovery: LightRecovery, room: Directions, lights: np.ndarray) -> float:
    """Return the mean CIEDE2000 of a ColorChecker, adapted, under the recovered lights of a room."""
    found = recovery.weights(room.response) @ recovery.basis.T
    return np.mean([adapted_errors(*each) for each in zip(lights, found, strict=True)])


def test_a_lamp_with_a_chart_under_it_is_recovered_far_better_than_without(seen):
    with_chart, without = (errors(seen, variant, names=LAMPS)[:, 0] for variant in ("room-chart", "mixture"))
    assert with_chart.mean() <= 0.2 and with_chart.mean() < 0.4 * without.mean()
    assert (with_chart < without + 0.1).all()


def test_charts_in_two_places_tell_two_lamps_that_light_both_from_each_other(seen):
    """Walls under either lamp alone are recovered, though each chart stands under both."""
    pair = np.stack([lamp("D65"), lamp("LED-B3")])
    lights = np.concatenate([pair, *(WALLS * one for one in pair)])
    room, prior = room_of(seen, lights), prior_without("D65", "LED-B3")
    charts = [chart_under(seen, np.array(share) @ pair, seed) for seed, share in enumerate([(0.8, 0.2), (0.3, 0.7)])]
    model = ResponseModel.of(seen.calibration)
    alone, helped = (recovery_with(some, model, room, prior) for some in ([], charts))
    assert error(helped, room, lights) < min(0.5, 0.9 * error(alone, room, lights))
    # What the recovery states of itself, drawn as it is for the picture's errors.
    weights = helped.weights(room.response)
    found, rng = weights @ helped.basis.T, np.random.default_rng(1)
    drawn = np.tensordot(rng.standard_normal((16, len(helped.errors))), helped.errors, axes=1) + helped.basis
    stated = np.mean([adapted_errors(*each) for basis in drawn for each in zip(found, weights @ basis.T, strict=True)])
    assert 0.5 < stated / error(helped, room, lights) < 2.0


def test_no_chart_is_the_recovery_without_charts(seen):
    room, prior = room_of(seen, WALLS * lamp("FL2")), prior_without("FL2")
    model = ResponseModel.of(seen.calibration)
    none = recovery_with([], model, room, prior)
    np.testing.assert_array_equal(
        none.weights(room.response), LightRecovery.of_room(model, room, prior).weights(room.response)
    )


@pytest.mark.parametrize("name", ["A", "FL11", "HP1", "LED-B5"])
def test_a_chart_under_a_lamp_that_the_panorama_does_not_show_is_refused_by_its_name(seen, name):
    room = room_of(seen, np.concatenate([WALLS * lamp("D65"), WALLS * lamp("LED-B3")]))
    charts = [chart_under(seen, lamp("D65"), name="desk"), chart_under(seen, lamp(name), name="window")]
    with pytest.raises(InputError, match="nowhere in the panorama") as caught:
        recovery_with(charts, ResponseModel.of(seen.calibration), room, prior_without())
    assert caught.value.field == "room_charts.window"


@pytest.mark.stability(stage="light", case="a lamp outside the frame")
def test_a_lamp_that_itself_lies_outside_the_frame_is_no_disagreement(seen):
    lights = WALLS * lamp("FL11")
    room, prior = room_of(seen, lights), prior_without("FL11")
    model = ResponseModel.of(seen.calibration)
    alone, helped = (
        error(recovery_with(some, model, room, prior), room, lights) for some in ([], [chart_under(seen, lamp("FL11"))])
    )
    assert helped < 0.8 * alone


@pytest.mark.parametrize("fault", ["turned", "mirrored", "another chart"])
def test_a_chart_that_is_read_otherwise_than_it_is_is_refused(seen, fault):
    chart = chart_under(seen, lamp("D65"), name="desk")
    patches = chart.response.reshape(4, 6, -1)
    if fault == "another chart":
        chart.reflectance[:] = chart_spectra(CHART)[1][np.random.default_rng(1).permutation(24)]
    else:
        chart.response[:] = (patches[::-1, ::-1] if fault == "turned" else patches[:, ::-1]).reshape(24, -1)
    with pytest.raises(InputError, match="the right way up") as caught:
        recovery_with([chart], ResponseModel.of(seen.calibration), room_of(seen, WALLS * lamp("D65")), prior_without())
    assert caught.value.field == "room_charts.desk"


@pytest.mark.stability(stage="light", case="two lamps of different kind")
@pytest.mark.parametrize("names", [("FL11", "D65"), ("LED-RGB1", "A"), ("FL4", "LED-B3")], ids="+".join)
def test_two_lamps_of_different_kind_are_recovered_on_walls_and_mixed(seen, names):
    pair = np.stack([lamp(name) for name in names])
    lights = np.concatenate([pair, [[0.5, 0.5], [0.2, 0.8]] @ pair, *(WALLS * one for one in pair)])
    room, prior = room_of(seen, lights), prior_without(*names)
    charts = [chart_under(seen, np.array(share) @ pair, seed) for seed, share in enumerate([(0.8, 0.2), (0.3, 0.7)])]
    alone, helped = (error(recovery_with(some, seen.model, room, prior), room, lights) for some in ([], charts))
    as_paint = np.mean([adapted_errors(light, recovered(seen, light, None)) for light in lights])
    assert helped <= 0.55 and helped < 0.95 * alone and helped < 0.5 * as_paint
    assert alone < 0.8 * as_paint


@pytest.mark.stability(stage="light", case="narrow-band LED")
def test_narrow_lines_are_recovered_with_a_chart_or_what_is_known_of_them(seen):
    found = {
        variant: errors(seen, variant, names=("LED-RGB1",)).item() for variant in ("room-chart", "named", "measured")
    }
    assert found["room-chart"] <= 0.15 and found["measured"] <= 0.15 and found["named"] <= 0.25
