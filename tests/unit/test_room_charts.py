"""Charts that stand in a room: what they tell of its lamps, and which of them are refused."""

import functools
import itertools
from dataclasses import replace

import numpy as np
import pytest
from made import made
from scipy.optimize import least_squares

from benchmarks.light import CHART, adapted_errors, camera, chart_under, errors, recovered, unlike
from irodori.calibration.response_model import smooth_covariance
from irodori.colour.colorimetry import colour_matching_weights
from irodori.config.models import CapturesSource, Chart, IrradianceMap, MirrorBallSource, Size
from irodori.core import store
from irodori.core.errors import InputError
from irodori.light.environment_file import Environment
from irodori.light.known_lamps import known_prior
from irodori.light.light_prior import LightPrior, light_prior, prior_of_any_lamp, published_lamps
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel
from irodori.light.room_charts import (
    ChartResponses,
    RoomLight,
    light_on,
    lights_on,
    read_room_charts,
    recovery_with,
    room_prior,
    with_misfit,
)
from irodori.light.stage import prepare_environment
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import chart_spectra, spectrum

#: Lamps of all kinds, none of them in the prior, nor one like it.
LAMPS = ("D50", "FL11", "HP4", "LED-B3", "LED-RGB1")
GOLD = 0.36 + 0.6 / (1.0 + np.exp((520.0 - WAVELENGTH_NM) / 12.0))  # reflectance of gold, about
WALLS = np.stack([spectrum(f"TCS{number}") for number in (7, 16, 39, 40, 59, 80)])


@pytest.fixture(scope="module")
def seen():
    return camera()


def lamp(name: str) -> np.ndarray:
    return spectrum(name) / spectrum(name).mean()


@functools.cache
def prior_without(*names: str, every: int = 1) -> LightPrior:
    """The prior of any lamp but these, of every published lamp or of every so many."""
    some = published_lamps()[::every]
    return prior_of_any_lamp(unlike(some, *map(lamp, names)) if names else some)


def with_exact_rig_lamp(model: ResponseModel) -> ResponseModel:
    """The model of a camera whose rig's lamp is known exactly, so that other errors are not lost beside its own."""
    return replace(model, rig_lamp_errors=np.zeros((0, 61)))


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


@pytest.mark.heavy
def test_charts_in_two_places_tell_two_lamps_that_light_both_from_each_other(seen):
    """Walls under either lamp alone are recovered, though each chart stands under both; mean over three draws."""
    pair = np.stack([lamp("D65"), lamp("LED-B3")])
    lights = np.concatenate([pair, *(WALLS * one for one in pair)])
    prior, found, rng = prior_without("D65", "LED-B3"), [], np.random.default_rng(1)
    for own in (seen, camera(1), camera(2)):
        room = room_of(own, lights)
        charts = [chart_under(own, np.array(share) @ pair, seed) for seed, share in enumerate([(0.8, 0.2), (0.3, 0.7)])]
        model = with_exact_rig_lamp(own.model)
        alone, helped = (recovery_with(some, model, room, prior) for some in ([], charts))
        # What the recovery states of itself, drawn as it is for the picture's errors.
        weights = helped.weights(room.response)
        recovered_ = weights @ helped.basis.T
        drawn = np.tensordot(rng.standard_normal((8, len(helped.errors))), helped.errors, axes=1) + helped.basis
        pairs = [each for basis in drawn for each in zip(recovered_, weights @ basis.T, strict=True)]
        stated = np.mean([adapted_errors(*each) for each in pairs])
        found.append([error(alone, room, lights), error(helped, room, lights), stated])
    alone, helped, stated = np.mean(found, axis=0)
    assert helped < min(0.5, 0.9 * alone)
    assert 0.5 < stated / helped < 2.0


@pytest.mark.heavy
@pytest.mark.stability(stage="light", case="rig's lamp unlike its name")
@pytest.mark.parametrize("unlike_name", ["smoothly, by 5 %", "50 K more or less"])
def test_what_the_rigs_lamp_may_differ_from_its_name_is_in_the_errors_of_recovered_light(unlike_name):
    """Over three draws and the lamps, each with a chart under it."""
    found = []
    for draw in range(3):
        rng = np.random.default_rng(20 + draw)
        if unlike_name == "smoothly, by 5 %":
            covariance = 0.05**2 * smooth_covariance(40.0)
            true = lamp("A") * (1.0 + rng.multivariate_normal(np.zeros(61), covariance, method="eigh"))
        else:
            true = lamp("P2806" if draw % 2 else "P2906")
        own = camera(draw)
        own = replace(own, sensitivity=own.sensitivity * lamp("A") / true)
        for name in LAMPS:
            light, prior = lamp(name), prior_without(name)
            room = room_of(own, light[None])
            helped = recovery_with([chart_under(own, light)], own.model, room, prior)
            weights = helped.weights(room.response)[0]
            recovered_ = helped.basis @ weights
            drawn = np.tensordot(rng.standard_normal((8, len(helped.errors))), helped.errors, axes=1) + helped.basis
            stated = np.sqrt(np.mean([adapted_errors(recovered_, basis @ weights) ** 2 for basis in drawn]))
            found.append([adapted_errors(light, recovered_), stated])
    true, stated = np.sqrt(np.mean(np.square(found), axis=0))
    assert 0.6 < true / stated < 1.5


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


def test_light_seen_in_a_golden_mirror_is_recovered_as_well_as_without_it(seen):
    """The prior describes the light before the mirror, whose colour makes no other lamp of it."""
    model = with_exact_rig_lamp(ResponseModel.of(seen.calibration))
    for name in LAMPS:
        lights, prior, off = WALLS * lamp(name), prior_without(name), []
        for mirror in (np.ones(61), GOLD):
            room = room_of(seen, lights * mirror)
            recovery = recovery_with([], model, room, prior, mirror)
            off.append(np.linalg.norm(recovery.weights(room.response) @ recovery.basis.T - lights))
        assert off[1] == pytest.approx(off[0], rel=0.1), name


def test_charts_are_compared_with_the_light_before_a_golden_mirror(seen):
    """The camera sees the charts without the mirror."""
    model = ResponseModel.of(seen.calibration)
    room = room_of(seen, np.concatenate([WALLS * lamp("D65"), WALLS * lamp("LED-B3")]) * GOLD)
    desk = chart_under(seen, lamp("D65"), name="desk")
    charts = [desk, chart_under(seen, lamp("LED-B3"), name="window")]
    recovery_with(charts, model, room, prior_without(), GOLD)
    with pytest.raises(InputError, match="nowhere in the panorama"):
        recovery_with(charts, model, room, prior_without())
    for name in ("FL11", "HP1", "LED-B5"):
        with pytest.raises(InputError, match="nowhere in the panorama") as caught:
            recovery_with([desk, chart_under(seen, lamp(name), name="window")], model, room, prior_without(), GOLD)
        assert caught.value.field == "room_charts.window"


def shadowed(response: np.ndarray) -> np.ndarray:
    """A tenth less light on the lowest row."""
    return response * np.where(np.arange(24) < 18, 1.0, 0.9)[:, None]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    "spoilt", [lambda response: response + 0.03 * response.max(axis=0), shadowed], ids=["veiling light", "shadow"]
)
def test_what_no_light_explains_of_a_chart_is_in_its_variance(seen, spoilt):
    """Such a chart is not refused; it then tells less, and not something else."""
    model = with_exact_rig_lamp(ResponseModel.of(seen.calibration))
    off: dict[str, list] = {"sound": [], "spoilt": []}
    for seed, name in enumerate(LAMPS):
        lights, sound = WALLS * lamp(name), chart_under(seen, lamp(name), seed)
        assert with_misfit(sound).variance == pytest.approx(sound.variance, abs=(2e-3 * sound.response.max()) ** 2)
        bad = replace(sound, response=spoilt(sound.response))
        added = np.sqrt((with_misfit(bad).variance - bad.variance) / np.square(bad.response.max(axis=0)))
        assert (added > 5e-3).all() and (added < 3e-2).all()
        room = room_of(seen, lights)
        prior = prior_without(name, every=2)
        for how, chart in {"sound": sound, "spoilt": bad}.items():
            off[how].append(error(recovery_with([chart], model, room, prior), room, lights))
    # Taken at its word, it makes the colours five times worse, or more.
    assert np.mean(off["spoilt"]) < 3.0 * np.mean(off["sound"])


@pytest.mark.stability(stage="light", case="a lamp outside the frame")
def test_a_lamp_that_itself_lies_outside_the_frame_is_no_disagreement(seen):
    """In the mean over three kinds of lamps."""
    model, found = ResponseModel.of(seen.calibration), []
    for name in ("FL11", "FL2", "HP1"):
        lights, prior = WALLS * lamp(name), prior_without(name)
        room = room_of(seen, lights)
        some = ([], [chart_under(seen, lamp(name))])
        found.append([error(recovery_with(charts, model, room, prior), room, lights) for charts in some])
    alone, helped = np.mean(found, axis=0)
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


@pytest.mark.heavy
@pytest.mark.stability(stage="light", case="two lamps of different kind")
@pytest.mark.parametrize("names", [("FL11", "D65"), ("LED-RGB1", "A"), ("FL4", "LED-B3")], ids="+".join)
def test_two_lamps_of_different_kind_are_recovered_on_walls_and_mixed(seen, names):
    """In the mean over six draws of the noise of the calibration."""
    pair = np.stack([lamp(name) for name in names])
    lights = np.concatenate([pair, [[0.5, 0.5], [0.2, 0.8]] @ pair, *(WALLS * one for one in pair)])
    prior, found = prior_without(*names), []
    for own in (seen, *(camera(seed) for seed in range(1, 6))):
        room = room_of(own, lights)
        charts = [chart_under(own, np.array(share) @ pair, seed) for seed, share in enumerate([(0.8, 0.2), (0.3, 0.7)])]
        recoveries = [recovery_with(some, own.model, room, prior) for some in ([], charts)]
        as_paint = np.mean([adapted_errors(light, recovered(own, light, None)) for light in lights])
        found.append([*(error(one, room, lights) for one in recoveries), as_paint])
    alone, helped, as_paint = np.mean(found, axis=0)
    assert helped <= 0.55 and helped < 0.95 * alone and helped < 0.5 * as_paint
    assert alone < 0.8 * as_paint


@pytest.mark.stability(stage="light", case="narrow-band LED")
def test_narrow_lines_are_recovered_with_a_chart_or_what_is_known_of_them(seen):
    found = {
        variant: errors(seen, variant, names=("LED-RGB1",)).item() for variant in ("room-chart", "named", "measured")
    }
    assert found["room-chart"] <= 0.15 and found["measured"] <= 0.15 and found["named"] <= 0.25


CORNERS = {"first": [20, 20], "row_end": [120, 20], "column_end": [20, 80], "last": [120, 80]}
ON_WALL = {"spectra": CHART, "rows": 4, "columns": 6, "patch_px": 10, "centres_px": CORNERS}


def photographed(folder, seen, lamp_, light=1.0, spoilt=(), filters=None) -> tuple:
    """Write the photograph of a chart on a wall under a lamp of uneven brightness; return its file and definition.

    ``spoilt`` has for each patch the share of its square that is not valid.
    """
    response, valid = np.full((100, 140, 6), 1e-3), np.ones((100, 140), np.uint8)
    for number, one in enumerate((chart_spectra(CHART)[1] * lamp_) @ seen.sensitivity.T):
        y, x = 20 + 20 * (number // 6), 20 + 20 * (number % 6)
        response[y - 9 : y + 9, x - 9 : x + 9] = one
    for number, share in enumerate(spoilt):
        y, x = 15 + 20 * (number // 6), 15 + 20 * (number % 6)
        valid[y : y + round(10 * share), x : x + 10] = 0
    with store.create(folder / "wall.h5", store.Provenance("test")) as out:
        response = response * np.broadcast_to(light, (100, 140))[..., None]
        out.write("response", response.astype("f4"), units="1", dims="row,column,band", quantity="response")
        out.write("valid", valid, units="1", dims="row,column", quantity="valid")
        out.attribute("pose_deg", [45.0, 0.0, 0.0, 0.0])
        out.attribute("sample_px", 2)
        out.attribute("filters", list(filters or seen.calibration.filters))
    return folder / "wall.h5", made(Chart, ON_WALL)


def test_the_responses_to_a_chart_on_a_wall_are_those_of_its_whole_patches_under_even_light(tmp_path, seen):
    """The white reference of the rig evens the light of the rig alone: what falls on the wall is told by the chart."""
    fall_off = np.linspace(1.2, 0.8, 140)[None] * np.linspace(0.9, 1.1, 100)[:, None]
    # Of ten rows of a square one may be lost to one in twenty; up to a quarter of the patches are left out.
    spoilt = [0.0] * 18 + [0.1] * 6
    file, chart = photographed(tmp_path, seen, lamp("FL11"), fall_off, spoilt)
    (found,) = read_room_charts({"desk": (file, chart)}, seen.calibration)
    spectra = chart_spectra(CHART)[1][:18]
    expected = (spectra * lamp("FL11")) @ seen.sensitivity.T
    assert (found.name, found.file) == ("desk", file) and np.array_equal(found.reflectance, spectra)
    ratio = found.response / expected
    assert found.response.dtype == np.float64 and ratio == pytest.approx(ratio.mean(), rel=0.01)
    assert read_room_charts({}, seen.calibration) == []


def test_noise_and_unevenness_that_cannot_be_told_are_known_of_a_chart_on_a_wall(tmp_path, seen, caplog):
    noise = np.exp(0.05 * np.random.default_rng(1).standard_normal((100, 140)))
    file, chart = photographed(tmp_path, seen, lamp("D65"), noise)
    (found,) = read_room_charts({"desk": (file, chart)}, seen.calibration)
    expected = (chart_spectra(CHART)[1] * lamp("D65")) @ seen.sensitivity.T
    off = found.response / expected
    # Noise of 5 % in each sample, the same in all bands, and what it leaves unknown of the light.
    square = np.mean(np.square(off / off.mean(axis=0) - 1.0)) / np.mean(found.variance / found.response**2)
    assert 0.5 < square < 2.0 and not caplog.records
    small = made(Chart, ON_WALL | {"patch_px": 3})
    assert len(read_room_charts({"desk": (file, small)}, seen.calibration)) == 1
    assert "room chart desk: its light is taken as even: not correctable" in caplog.text


def test_a_chart_on_a_wall_that_is_mostly_spoilt_or_seen_through_other_filters_is_refused(tmp_path, seen):
    file, chart = photographed(tmp_path, seen, lamp("D65"), spoilt=[0.1] * 7)
    with pytest.raises(InputError, match=r"7 of 24 patches saturated or masked.*25% at most") as caught:
        read_room_charts({"desk": (file, chart)}, seen.calibration)
    assert (caught.value.file, caught.value.field) == (str(file), "room_charts.desk")
    file, chart = photographed(tmp_path, seen, lamp("D65"), filters=["out"])
    with pytest.raises(InputError, match="as in the chart's photographs") as caught:
        read_room_charts({"desk": (file, chart)}, seen.calibration)
    assert (caught.value.file, caught.value.field) == (str(file), "filters")


def luminance(light: np.ndarray) -> float:
    return float(colour_matching_weights()[1] @ light)


def few_families(rng) -> LightPrior:
    """Three families, each of mixtures of two smooth spectra."""
    bumps = np.exp(-(((np.arange(61.0) - rng.uniform(0, 60, (3, 2, 1))) / 9.0) ** 2)) + 0.1
    return LightPrior(np.einsum("nki,nkj->nij", bumps, bumps), rng.dirichlet(np.ones(3)), 1)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_light_on_a_chart_and_the_moment_of_its_families_are_those_of_the_mixture_written_out(seen, seed):
    rng = np.random.default_rng(seed)
    prior, patches = few_families(rng), chart_spectra(CHART)[1][[2, 9, 18]]
    mean = seen.sensitivity[[0, 2, 4]] / 100.0
    # Errors of the sensitivities of which the bands share a part.
    share = np.array([[1.0, 0.5, -0.2], [0.5, 1.0, 0.3], [-0.2, 0.3, 1.0]])
    model = ResponseModel(mean, np.einsum("bc,bi,cj->bicj", 2e-3 * share, mean, mean))
    # As likely of one family as of another, so that both the means and their distance have a say.
    answer = np.abs(rng.normal(1.0, 0.3, (3, 3)))
    variance = rng.uniform(0.0, 1e-4, (3, 3))
    found = light_on(ChartResponses("desk", "c.h5", answer, patches, variance), model, prior)
    rows = np.array([mean[band] * patch for band in range(3) for patch in patches])
    y = np.array([answer[patch, band] for band in range(3) for patch in range(3)])
    parts = []
    for moment, share in zip(prior.moment, prior.share, strict=True):
        second = rows @ moment @ rows.T
        for i, j in itertools.product(range(9), repeat=2):
            # An error of the sensitivities is common to all patches.
            second[i, j] += patches[i % 3] @ (model.covariance[i // 3, :, j // 3] * moment) @ patches[j % 3]
        # Noise counts in units of the brightest patch, since the scale of the light is unknown.
        expected = np.diag(second).copy()
        for i in range(9):
            band, brightest = i // 3, answer[:, i // 3].argmax()
            noise = variance[i % 3, band] / answer[brightest, band] ** 2 * expected[3 * band + brightest]
            second[i, i] += 2e-3**2 * expected[i] + noise
        inverse, gain = np.linalg.inv(second), moment @ rows.T @ np.linalg.inv(second)
        square = y @ inverse @ y / 9.0
        density = share / np.sqrt(np.linalg.det(second)) * square ** (-9 / 2)
        parts.append((density, gain @ y, square * moment))
    total = sum(density for density, _, _ in parts)
    np.testing.assert_allclose(found[0], sum(density / total * one for density, one, _ in parts), rtol=1e-6)
    expected = sum(density / total * one for density, _, one in parts)
    np.testing.assert_allclose(found[1], expected, atol=1e-6 * expected.max())


def test_of_two_lights_less_each_other_what_is_left_is_that_of_a_single_lamp():
    pair = np.stack([lamp("D65"), lamp("LED-B3")])
    error_ = 1e-2 * np.stack([np.sin(np.arange(61) / 9.0), np.cos(np.arange(61) / 5.0)])
    first, second = (
        RoomLight.of(3.0 * np.array(share) @ pair, 3.0 * np.roll(error_, turn, axis=0))
        for turn, share in enumerate(((0.8, 0.2), (0.3, 0.7)))
    )
    assert luminance(first.mean) == pytest.approx(1.0)
    np.testing.assert_allclose(first.errors * luminance(3.0 * np.array([0.8, 0.2]) @ pair), 3.0 * error_)
    for one, other in ((first, second), (second, first)):
        left = one.without(other)
        assert luminance(left.mean) == pytest.approx(1.0)
        # As much is taken as leaves one wavelength two hundredths of the light's mean below nothing.
        factor = np.linalg.lstsq(np.stack([one.mean, other.mean], axis=1), left.mean, rcond=None)[0]
        taken = -factor[1] / factor[0]
        lowest = (one.mean - taken * other.mean).min()
        assert 0.1 < taken < 0.9 and lowest == pytest.approx(-0.02 * one.mean.mean(), rel=1e-6)
        expected = factor[0] * (one.errors - taken * other.errors)
        np.testing.assert_allclose(left.errors, expected, rtol=1e-6, atol=1e-12)
    # Of a light less itself a tenth is left.
    same = first.without(first)
    np.testing.assert_allclose(same.mean, first.mean, rtol=1e-6)
    np.testing.assert_allclose(same.errors, first.errors, rtol=1e-6)
    # Where the other light has nothing, noise below two hundredths of its mean does not limit what is taken.
    dark = replace(second, mean=np.where(np.arange(61) == 5, 1e-9, second.mean))
    assert np.isfinite(first.without(dark).mean).all()


def test_the_lamps_of_a_room_are_half_of_its_prior_and_any_mixture_nearly_the_rest():
    published = light_prior(published_lamps()[::20])
    pair = np.stack([lamp("D65"), lamp("LED-B3")])
    errors_ = 1e-4 * np.eye(61)[:5]
    lights = [RoomLight.of(np.array(share) @ pair, errors_) for share in ((0.8, 0.2), (0.3, 0.7))]
    found = room_prior(lights, published)
    known = len(published.share) - published.broad
    own = len(found.share) - len(published.share)
    assert found.broad == published.broad == 2 and np.array_equal(found.moment[own:], published.moment)
    assert found.share[:own].sum() == pytest.approx(0.5) and found.share[own : own + known].sum() == pytest.approx(0.02)
    assert found.share[-2:].sum() == pytest.approx(0.48)
    np.testing.assert_allclose(found.share[own:-2] / published.share[:known], 0.02 / published.share[:known].sum())
    # Its lamps: the light on each chart, and each less the other.
    parted = [lights[0].without(lights[1]), lights[1].without(lights[0])]
    distance = np.subtract.outer(np.arange(61), np.arange(61)) * 5.0 / 20.0
    near = 1.0 + 0.005**2 * np.exp(-0.5 * distance**2)
    for moment, one in zip(found.moment, [*lights, *parted], strict=False):
        np.testing.assert_allclose(moment, (np.outer(one.mean, one.mean) + one.errors.T @ one.errors) * near, rtol=1e-6)
    # All of them are of one kind.
    kind = np.mean(found.moment[:4], axis=0)
    assert sum(np.allclose(moment, kind, rtol=1e-6) for moment in found.moment[4:own]) >= 4


@pytest.mark.parametrize("unit", [1.0, 7.0])
def test_lights_on_charts_and_the_response_are_the_likeliest_together(seen, unit):
    """As a general optimiser finds them; another unit of the responses changes nothing but the unit of the light."""
    rng = np.random.default_rng(3)
    patches, mean = chart_spectra(CHART)[1][:8], seen.sensitivity[:2] / 100.0
    smooth = np.exp(-0.5 * (np.subtract.outer(np.arange(61), np.arange(61)) / 8.0) ** 2)
    share = np.array([[1.0, 0.6], [0.6, 1.0]])
    covariance = np.einsum("bc,bi,ij,cj->bicj", 1e-2 * share, mean, smooth, mean)
    model = ResponseModel(mean, covariance)
    family = np.outer(lamp("D50"), lamp("D50")) * (1.0 + 0.05**2 * smooth)
    prior = LightPrior(family[None], np.ones(1), 1)
    true = mean * (1.0 + 0.1 * np.sin(np.arange(61) / 9.0))
    charts = []
    for name in ("desk", "window"):
        light = lamp("D50") * (1.0 + 0.05 * np.linalg.cholesky(smooth + 1e-9 * np.eye(61)) @ rng.standard_normal(61))
        answer = (patches * light) @ true.T * (1.0 + 1e-3 * rng.normal(size=(8, 2)))
        variance = unit**2 * rng.uniform(0.0, 1e-2, answer.shape) ** 2 * answer.max(axis=0) ** 2
        charts.append(ChartResponses(name, name, unit * answer, patches, variance))
    refined, lights = lights_on(charts, model, prior)
    values, vectors = np.linalg.eigh(covariance.reshape(122, 122))
    of_response = vectors * np.sqrt(np.maximum(values, 0.0))
    moments = [light_on(chart, model, prior)[1] for chart in charts]
    of_lights = [np.linalg.cholesky(moment + 1e-9 * np.trace(moment) / 61 * np.eye(61)) for moment in moments]

    def parted(x):
        return mean + (of_response @ x[:122]).reshape(2, 61), [
            root @ one for root, one in zip(of_lights, x[122:].reshape(2, 61), strict=True)
        ]

    def misfit(x):
        response, spectra = parted(x)
        off = [
            ((patches * one) @ response.T - chart.response) / np.sqrt((2e-3 * chart.response) ** 2 + chart.variance)
            for chart, one in zip(charts, spectra, strict=True)
        ]
        return np.concatenate([x, np.ravel(off)])

    start = np.concatenate([np.zeros(122), *(np.linalg.solve(root, unit * lamp("D50")) for root in of_lights)])
    response, spectra = parted(least_squares(misfit, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x)
    np.testing.assert_allclose(refined.mean, response, rtol=1e-3, atol=1e-3 * mean.max())
    for found, one in zip(lights, spectra, strict=True):
        np.testing.assert_allclose(found.mean, one / luminance(one), atol=2e-3 * found.mean.max())


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("told", [True, False])
def test_noise_in_the_reading_of_a_chart_is_in_the_errors_of_its_light(seen, told):
    """Noise of half a per cent of the brightest patch is much of the light of a black one. Untold, it is missed."""
    patches, true, matching, ratios = chart_spectra(CHART)[1], lamp("D65"), colour_matching_weights()[[0, 2]], []
    for seed in range(8):
        answer = (patches * true) @ seen.sensitivity.T
        noise = 5e-3 * answer.max(axis=0) * np.ones_like(answer)
        answer = answer + noise * np.random.default_rng(seed).standard_normal(answer.shape)
        chart = ChartResponses("desk", "c.h5", answer, patches, np.square(noise if told else 0.0 * noise))
        _, (found,) = lights_on([chart], seen.model, prior_without())
        off = matching @ (found.mean - true / luminance(true))
        ratios.append(off / np.linalg.norm(found.errors @ matching.T, axis=0))
    rms = np.sqrt(np.mean(np.square(ratios)))
    assert rms < 1.5 if told else rms > 2.0


def drawn_place(model: ResponseModel, rng) -> tuple[np.ndarray, np.ndarray]:
    """Return a camera's true response, drawn from its model, and two lamps near published ones, as the prior has it."""
    off = np.tensordot(rng.standard_normal(len(model.errors)), model.errors, axes=1)
    distance = np.subtract.outer(np.arange(61), np.arange(61)) * 5.0 / 20.0
    near = np.linalg.cholesky(0.05**2 * np.exp(-0.5 * distance**2) + 1e-12 * np.eye(61))
    lamps = np.stack([lamp(name) * (1.0 + near @ rng.standard_normal(61)) for name in ("D65", "FL2")])
    rig_lamp = 1.0 + rng.standard_normal(len(model.rig_lamp_errors)) @ model.rig_lamp_errors
    return (model.mean + off) / rig_lamp, np.maximum(lamps, 0.0)


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("rig_lamp", ["exact", "known by name"])
@pytest.mark.parametrize("shares", [(), ((0.8, 0.2), (0.3, 0.7))], ids=["without charts", "with charts"])
def test_the_errors_that_a_recovered_light_states_are_those_of_its_tristimulus_values(seen, shares, rig_lamp):
    """Over draws of camera and lamps from the model; most errors of a spectrum, and the largest, cannot be seen.

    With charts and an exact lamp of the rig, the ratio of true to stated errors is 1.25 in the geometric mean of 64
    draws, and scatters by a factor of 1.5 from draw to draw. With one known by name, its root mean square is 1.05.
    """
    matching, paints, ratios = colour_matching_weights(), chart_spectra(CHART)[1][::4], []
    model, prior = with_exact_rig_lamp(seen.model) if rig_lamp == "exact" else seen.model, prior_without()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        true, lamps = drawn_place(model, rng)
        lights = np.concatenate([lamps, *(paints * one for one in lamps)])
        room = Directions(lights @ true.T, np.full(len(lights), 1 / len(lights)))
        own = replace(seen, sensitivity=true)
        charts = [chart_under(own, np.array(share) @ lamps, 10 * seed + i) for i, share in enumerate(shares)]
        recovery = recovery_with(charts, model, room, prior)
        weights, luminance_ = recovery.weights(room.response), (lights @ matching[1])[:, None]
        off = (weights @ recovery.basis.T - lights) @ matching.T / luminance_
        drawn = np.einsum("qlr,mr,cl->qmc", recovery.errors, weights, matching) / luminance_
        ratios.append(np.sqrt(np.mean(off**2) / np.mean(np.sum(drawn**2, axis=0))))
    if rig_lamp == "exact":
        assert 0.7 < np.exp(np.mean(np.log(ratios))) < 1.7
    else:
        assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.5


def place(folder, seen, name="FL11") -> None:
    """Write a calibration, and the panorama of coloured walls under a lamp."""
    with store.create(folder / "calibration.h5", store.Provenance("test")) as out:
        seen.calibration.write(out)
    walls = WALLS[np.random.default_rng(4).integers(len(WALLS), size=(8, 16))]
    with store.create(folder / "linear.h5", store.Provenance("test")) as out:
        response = (walls * lamp(name)) @ seen.sensitivity.T
        out.write("response", response.astype("f4"), units="1", dims="row,column,band", quantity="response")
        for mask, value in (("valid", 1), ("clipped", 0)):
            out.write(mask, np.full((8, 16), value, np.uint8), units="1", dims="row,column", quantity=mask)
        out.attribute("filters", list(seen.calibration.filters))


def prepared(folder, **given) -> tuple[np.ndarray, dict]:
    """Return the recovered spectra of a place, (8, 16, 61), and what the file says of them."""
    prepare_environment(
        folder / "linear.h5", folder / "calibration.h5", folder / "e.h5",
        CompressOptions(target_delta_e_mean=0.0, target_delta_e_p99=np.inf, align=8, storage="single"),
        made(IrradianceMap, {"max_error": 0.1, "max_height": 8}),
        store.Provenance("test"), **given,
    )  # fmt: skip
    light = Environment.load(folder / "e.h5")
    with store.open_file(folder / "e.h5") as file:
        return light.coefficients @ light.basis.T, file.attribute("origin")


def test_the_lamps_of_a_place_are_told_by_charts_by_what_is_named_or_by_what_is_published(tmp_path, seen, caplog):
    place(tmp_path, seen, "FL2")
    few = light_prior(published_lamps()[::30])
    desk = {"desk": photographed(tmp_path, seen, lamp("FL2"))}
    found, told = {}, {}
    for name, given in {
        "published": {"prior": few}, "charts": {"prior": few, "room_charts": desk}, "named": {"lamps": ["FL2"]},
        "both": {"lamps": ["FL2"], "room_charts": desk},
    }.items():  # fmt: skip
        caplog.clear()
        with caplog.at_level("INFO", logger="irodori"):
            found[name], origin = prepared(tmp_path, **given)
        told[name] = origin["lamps"]
        assert origin["kind"] == "captures" and f"source of the lamps' spectra: {told[name]}" in caplog.text
    assert told == {
        "published": "published lamps", "charts": "charts in the room (desk)", "named": "named lamps (FL2)",
        "both": "charts in the room (desk) and named lamps (FL2)",
    }  # fmt: skip
    walls = WALLS[np.random.default_rng(4).integers(len(WALLS), size=(8, 16))][:, ::-1] * lamp("FL2")
    off = {name: np.linalg.norm(np.roll(one, 8, axis=1) - walls) / np.linalg.norm(walls) for name, one in found.items()}
    assert off["charts"] < 0.9 * off["published"] and max(off["named"], off["both"]) < 0.8 * off["published"]


def test_lamps_are_as_uncertain_as_their_definition_says(tmp_path, seen):
    place(tmp_path, seen, "FL2")
    said = {error: prepared(tmp_path, lamps=["FL2"], lamps_error_percent=error)[0] for error in (None, 5.0, 1.0)}
    assert np.array_equal(said[None], said[5.0]) and not np.allclose(said[5.0], said[1.0], rtol=1e-4)
    assert np.array_equal(said[1.0], prepared(tmp_path, prior=known_prior(["FL2"], 1.0))[0])


def test_charts_and_lamps_of_another_place_are_refused_by_the_stage(tmp_path, seen):
    place(tmp_path, seen, "D65")
    with pytest.raises(InputError, match=r"found A for a panorama that other lamps explain") as caught:
        prepared(tmp_path, lamps=["A"])
    assert (caught.value.file, caught.value.field) == (str(tmp_path / "linear.h5"), "lamps")
    with pytest.raises(InputError, match="nowhere in the panorama"):
        prepared(tmp_path, prior=light_prior(published_lamps()[::30]),
                 room_charts={"desk": photographed(tmp_path, seen, lamp("FL11"))})  # fmt: skip
    assert not (tmp_path / "e.h5").exists()


def test_a_coloured_ball_is_taken_out_of_the_light_before_charts_and_lamps_are_compared_with_it(tmp_path, seen):
    """It reflects red light six times as well as blue; the room is white, under one lamp."""
    place(tmp_path, seen, "D65")
    with store.create(tmp_path / "linear.h5", store.Provenance("test")) as out:
        response = np.broadcast_to((lamp("D65") * spectrum("TCS20")) @ seen.sensitivity.T, (60, 60, 6))
        out.write("response", response.astype("f4"), units="1", dims="row,column,band", quantity="response")
        for mask, value in (("valid", 1), ("clipped", 0)):
            out.write(mask, np.full((60, 60), value, np.uint8), units="1", dims="row,column", quantity=mask)
        out.attribute("filters", list(seen.calibration.filters))
    ball = {"kind": "mirror_ball", "centre_px": [29.5, 29.5], "radius_px": 29.0, "camera_azimuth_deg": 0.0,
            "camera_elevation_deg": 0.0, "roll_deg": 0.0, "reflectance_factor": "TCS20"}  # fmt: skip
    given = {
        "source": made(CapturesSource | MirrorBallSource, ball), "image": made(Size, {"width": 16, "height": 8}),
        "room_charts": {"desk": photographed(tmp_path, seen, lamp("D65"))}, "lamps": ["D65"],
    }  # fmt: skip
    found, _ = prepared(tmp_path, **given)
    assert np.abs(found - lamp("D65")).mean() < 0.03
    with pytest.raises(InputError, match="nowhere in the panorama"):
        prepared(tmp_path, **given | {"room_charts": {"desk": photographed(tmp_path, seen, lamp("FL11"))}})


def test_a_mirror_ball_needs_the_size_of_its_picture(tmp_path, seen):
    place(tmp_path, seen)
    ball = {"kind": "mirror_ball", "centre_px": [8.0, 4.0], "radius_px": 3.0, "camera_azimuth_deg": 0.0,
            "camera_elevation_deg": 0.0, "roll_deg": 0.0, "reflectance_factor": 1.0}  # fmt: skip
    with pytest.raises(ValueError, match="without the size of its picture"):
        prepared(tmp_path, source=made(CapturesSource | MirrorBallSource, ball), lamps=["FL11"])
