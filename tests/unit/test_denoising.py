"""Noise filtered out of pictures whose truth is known, and the error that the filter states."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from path_scenes import ball, traced
from scenes import OPTIONS, constant_light, material, smooth_sky
from scenes import plate as plate_of

from irodori.config.models import Render, Scene
from irodori.rendering.integrators import render_image
from irodori.rendering.reference.denoising import (
    MARGIN,
    Halves,
    denoise,
    distance_to_unbiased,
    filtered_halves,
    make_guides,
)
from irodori.rendering.reference.world import ALBEDO, NORMAL, PLACE, SEEN

SIZE = (72, 80)
WAVES = np.linspace(0.0, 1.0, 61)


def plane(radiance: np.ndarray, noise: np.ndarray | float, seed: int = 1) -> Halves:
    """A plane seen from above; radiance (height, width, 61), noise its relative standard deviation in the mean."""
    height, width = radiance.shape[:2]
    rng = np.random.default_rng(seed)
    # A path is too bright or too dark as a whole, and a little more so in the red or in the blue.
    draws = rng.normal(size=(2, height, width, 1)) + 0.3 * rng.normal(size=(2, height, width, 1)) * (WAVES - 0.5)
    mean, half = (noise * radiance * draw for draw in draws)
    seen = np.zeros((height, width, SEEN), np.float32)
    seen[..., ALBEDO:NORMAL] = 0.5
    seen[..., PLACE - 1] = 1.0
    seen[..., PLACE], seen[..., PLACE + 1] = np.meshgrid(np.arange(width), np.arange(height))
    return Halves((radiance + mean).astype(np.float32), half.astype(np.float32), seen)


def smooth(shadow: bool = False) -> np.ndarray:
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]] / SIZE[1]
    level = 0.6 + 0.3 * np.sin(4 * x) * np.cos(3 * y)
    if shadow:
        level = np.where(x + 0.3 * y > 0.6, 0.25 * level, level)
    return level[..., None] * (0.5 + 0.5 * np.cos(3 * WAVES) ** 2)


def off(picture: np.ndarray, truth: np.ndarray, at=slice(None)) -> float:
    return float(np.sqrt(np.mean(np.square(picture[at] - truth[at], dtype=np.float64))))


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.4])
def test_noise_falls_to_a_quarter_and_the_stated_error_is_no_less_than_the_true_one(noise):
    truth = smooth()
    halves = plane(truth, noise)
    made = denoise(halves)
    left, before = off(made.radiance, truth), off(halves.mean, truth)
    assert left < 0.25 * before
    # What the sets tell has a noise of its own, a part of theirs.
    assert 0.8 * left < np.sqrt(np.mean(np.square(made.error))) < 0.5 * before


def test_a_shadow_that_no_surface_tells_of_keeps_its_edge():
    truth = smooth(shadow=True)
    halves = plane(truth, 0.05)
    made = denoise(halves)
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]] / SIZE[1]
    edge = np.abs(x + 0.3 * y - 0.6) < 3 / SIZE[1]
    assert off(made.radiance, truth, edge) < off(halves.mean, truth, edge)
    assert off(made.radiance, truth) < 0.4 * off(halves.mean, truth)


def test_a_texture_is_followed_and_one_without_noise_is_left_as_it_is():
    rng = np.random.default_rng(4)
    albedo = np.kron(0.2 + 0.6 * rng.random((SIZE[0] // 8, SIZE[1] // 8, 1)), np.ones((8, 8, 1)))
    truth = albedo * smooth()
    clean, noisy = plane(truth, 0.0), plane(truth, 0.1)
    for halves in (clean, noisy):
        halves.seen[..., ALBEDO:NORMAL] = albedo
    np.testing.assert_allclose(denoise(clean).radiance, clean.mean, rtol=1e-5)
    assert off(denoise(noisy).radiance, truth) < 0.6 * off(noisy.mean, truth)


def test_blocks_keep_their_means_and_a_filter_that_blurs_is_told():
    truth = smooth(shadow=True)
    halves = plane(truth, 0.1)
    found = distance_to_unbiased(halves, denoise(halves).radiance)
    assert found["mean"] < 1.5 * found["noise"]
    blurred = np.broadcast_to(halves.mean.mean(axis=(0, 1)), halves.mean.shape)
    assert distance_to_unbiased(halves, blurred)["mean"] > 10 * found["noise"]


def test_spectra_stay_mixtures_of_those_that_were_traced():
    """Weights are the same in all bands: what two spectra span is not left."""
    one, other = 0.5 + 0.4 * np.sin(5 * WAVES), np.exp(-WAVES)
    rng = np.random.default_rng(2)
    share = np.linspace(0.2, 0.8, SIZE[1])[None, :, None]
    halves = plane(np.zeros((*SIZE, 61)), 0.0)
    for part, size in ((halves.mean, 1.0), (halves.difference, 0.1)):
        draws = rng.normal(0.0, 0.1, (2, *SIZE, 1))
        part[:] = size * ((share + draws[0]) * one + (1.0 - share + draws[1]) * other)
    flat = denoise(halves).radiance.reshape(-1, 61).astype(np.float64)
    span = np.linalg.qr(np.stack([one, other], axis=1))[0]
    assert np.abs(flat - flat @ span @ span.T).max() < 1e-5


@pytest.mark.heavy
def test_a_band_of_rows_with_its_margin_is_that_of_the_whole():
    halves = plane(smooth(), 0.1)
    guides = make_guides(halves)
    whole = filtered_halves(halves, guides, (0, SIZE[0]))
    part = filtered_halves(halves, guides, (13, 40))
    assert np.array_equal(part, whole[:, 13:40])
    cut = Halves(*(array[13 - MARGIN : 40 + MARGIN] for array in halves))
    # The noise is averaged over a little more than the margin, and the level of darkness is the band's own.
    np.testing.assert_allclose(filtered_halves(cut, make_guides(cut), (MARGIN, MARGIN + 27)), part, rtol=0.1)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), level=st.floats(-30, 30), spikes=st.integers(0, 20))
def test_whatever_shines_no_value_is_negative_or_lost(seed, level, spikes):
    rng = np.random.default_rng(seed)
    truth = 10.0**level * rng.random((20, 24, 1)) * np.ones(61)
    halves = plane(truth, 0.3, seed)
    where = rng.integers(0, 20, spikes), rng.integers(0, 24, spikes)
    halves.mean[where] *= 1e4
    halves.difference[where] = halves.mean[where]
    made = denoise(Halves(np.maximum(halves.mean, 0.0), halves.difference, halves.seen))
    assert np.isfinite(made.radiance).all() and (made.radiance >= 0.0).all() and np.isfinite(made.error).all()


@pytest.mark.heavy
def test_a_filtered_picture_is_as_near_to_many_paths_as_four_times_its_paths_are():
    """Two balls that shade each other, one of them glossy, under a sky with a bright side."""
    shapes, materials = [ball(30.0), ball(15.0)], [material(0.6), material(0.3, beta=4.0, mu=0.15)]
    arguments = {"places": [(0, 0, 0), (25, -30, 10)], "size": (64, 64), "fov": 24.0, "replicates": 2}
    light = smooth_sky(64, 32)
    truth = traced(shapes, materials, light, 2048, **arguments, seed=9).radiance
    few, more = (traced(shapes, materials, light, samples, **arguments, halves=True) for samples in (16, 64))
    made = denoise(few.halves)
    assert np.array_equal(few.halves.mean, few.radiance)
    traced_off, more_off, left = (np.abs(p.radiance - truth).mean() for p in (few, more, made))
    assert left < 1.2 * more_off < 0.5 * traced_off
    # Outlines are where the paths of a pixel meet different things, which no neighbour does: they stay as they were.
    assert off(made.radiance, truth) < 0.5 * off(few.radiance, truth)
    assert np.sqrt(np.mean(np.square(made.error))) == pytest.approx(off(made.radiance, truth), rel=0.4)


def test_halves_of_other_than_two_sets_are_refused():
    with pytest.raises(ValueError, match=r"halves of 8 replicates; accepted: 2"):
        traced([ball(1.0)], [material(0.5)], constant_light(1.0), 8, replicates=8, halves=True)


def pictured(light, caplog, *, dark: bool = False, **integrator) -> dict:
    """Figures of two balls on a plate, one of them a mirror or nearly black, and what was logged of them."""
    scene = {
        "image": {"width": 40, "height": 30}, "display": {"exposure": "auto"},
        "integrator": {"kind": "reference", "samples": 16, **integrator},
        "objects": [
            {"object": "plate", "position_mm": [0, 0, 0]},
            {"object": "matt", "position_mm": [-12, 0, 10]},
            {"object": "mirror", "position_mm": [12, 0, 10]},
        ],
        "views": {"v": {"position_mm": [0, -150.0, 60.0], "target_mm": [0, 0, 6], "field_of_view_deg": 24.0}},
    }  # fmt: skip
    materials = [material(0.5), material(0.5), material(1e-5) if dark else material(mirror=1.0, n=0.5, k=3.0)]
    caplog.clear()
    with caplog.at_level("WARNING"):
        shapes = [plate_of(80.0), ball(10.0), ball(10.0)]
        return render_image(made(Scene, scene), "v", shapes, materials, light, made(Render, OPTIONS))[1]


def test_a_sun_in_a_mirror_that_few_paths_find_is_told(caplog):
    even = pictured(constant_light(1.0), caplog)
    assert even["fireflies"] == 0 and not even["beyond_max_relative_standard_error"] and not caplog.records
    bright = constant_light(1.0)
    bright.coefficients[12, 40] = 1e6
    sun = pictured(bright, caplog)
    assert sun["fireflies"] > 0 and sun["beyond_max_relative_standard_error"]
    assert "fireflies" in caplog.text and "max_relative_standard_error" in caplog.text
    accepted = pictured(bright, caplog, max_relative_standard_error=1e9)
    assert not accepted["beyond_max_relative_standard_error"] and not caplog.records
    # The mean of the samples, where it is asked for, has the same count: fireflies are looked for before the filter.
    assert pictured(bright, caplog, denoise=False)["fireflies"] == sun["fireflies"]


def test_a_dark_body_before_a_bright_one_is_no_unsteady_picture(caplog):
    figures = pictured(constant_light(1.0), caplog, dark=True, denoise=False)
    # A pixel inside the dark outline is certain; that those across it are not is no error of its own.
    assert figures["relative_standard_error"]["max"] < 0.8 and not caplog.records
