"""Resampling keeps parabolas and grids exactly, and never reads an invalid pixel."""

import math

import numpy as np
import pytest
from scipy import ndimage
from shortcuts import moving_from_fixed

from irodori.ingest.registration.similarity import Registration, meets_marked, resample

HEIGHT, WIDTH = 60, 80


def similarity(dx, dy, rotation_rad=0.0, scale=1.0):
    return Registration(dx, dy, rotation_rad, scale, 0.0, 0.0, ((WIDTH - 1) / 2, (HEIGHT - 1) / 2))


def picture(function):
    y, x = np.indices((HEIGHT, WIDTH))
    return np.repeat(function(x, y)[..., None], 3, axis=2).astype(np.float32)


GOOD = np.ones((HEIGHT, WIDTH), dtype=bool)


def test_the_identity_gives_the_picture_back():
    image = np.random.default_rng(0).random((HEIGHT, WIDTH, 3), dtype=np.float32)
    out, valid = resample(image, GOOD, Registration(0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    assert np.array_equal(out, image) and valid.all()


def test_parabolas_are_resampled_exactly():
    def surface(x, y):
        return 0.3 + 0.01 * x - 0.02 * y + 1e-4 * x * x - 2e-4 * x * y + 1e-4 * y * y

    moved = similarity(3.3, -2.7, 0.008, 1.01)
    out, valid = resample(picture(surface), GOOD, moved)
    y, x = np.indices((HEIGHT, WIDTH))
    places = moving_from_fixed(moved, np.stack([x, y], axis=-1))
    inner = (places > 1.0).all(axis=-1) & (places < np.array([WIDTH, HEIGHT]) - 2.0).all(axis=-1)
    assert valid[inner].all()
    assert np.abs(out[..., 0] - surface(places[..., 0], places[..., 1]))[inner].max() < 1e-5


def test_what_lies_outside_is_invalid():
    moved = similarity(5.5, 0.0)
    out, valid = resample(picture(lambda x, y: 1.0 + 0.0 * x), GOOD, moved)
    assert valid[:, : WIDTH - 6].all() and not valid[:, WIDTH - 5 :].any()
    assert (out[~valid] == 0.0).all()


def test_an_invalid_pixel_never_enters():
    image, good = picture(lambda x, y: 0.5 + 0.0 * x), GOOD.copy()
    image[30, 40], good[30, 40] = np.nan, False
    out, valid = resample(image, good, similarity(0.4, 0.3))
    # The four places whose 2 x 2 holds it.
    assert sorted(zip(*np.nonzero(~valid[:-1, :-1]), strict=True)) == [(29, 39), (29, 40), (30, 39), (30, 40)]
    assert np.allclose(out[valid], 0.5, atol=1e-6)


@pytest.mark.parametrize("frequency", [0.1, 0.2, 0.3, 0.4, 0.5])
def test_sines_keep_the_gain_that_is_stated(frequency):
    # The four weights half-way between two pixels are -1/16, 9/16, 9/16, -1/16.
    stated = 1.125 * math.cos(math.pi * frequency) - 0.125 * math.cos(3 * math.pi * frequency)
    out, _ = resample(picture(lambda x, y: np.sin(2 * math.pi * frequency * x + 0.4)), GOOD, similarity(0.5, 0.0))
    x = np.arange(2, WIDTH - 3) + 0.5
    expected = stated * np.sin(2 * math.pi * frequency * x + 0.4)
    assert np.abs(out[30, 2 : WIDTH - 3, 0] - expected).max() < 1e-3


def test_steps_ring_by_no_more_than_the_cubic():
    out, valid = resample(picture(lambda x, y: (x >= 40).astype(float)), GOOD, similarity(0.37, 0.21, 0.003, 1.003))
    assert out[valid].min() >= -0.075 and out[valid].max() <= 1.075


def test_smooth_pictures_agree_with_splines_of_another_library():
    image = ndimage.gaussian_filter(np.random.default_rng(1).random((HEIGHT, WIDTH)), 3.0)
    moved = similarity(1.7, -2.4, 0.006, 0.993)
    out, valid = resample(np.repeat(image[..., None], 3, axis=2), GOOD, moved)
    y, x = np.indices((HEIGHT, WIDTH))
    places = moving_from_fixed(moved, np.stack([x, y], axis=-1))
    witness = ndimage.map_coordinates(image, [places[..., 1], places[..., 0]], order=5, mode="mirror")
    inner = np.zeros_like(valid)
    inner[6:-6, 6:-6] = True
    assert np.abs(out[..., 1] - witness)[inner & valid].max() < 2e-3 * np.ptp(image)


@pytest.mark.parametrize("moved", [similarity(0.0, 0.0), similarity(3.3, -2.7, 0.008, 1.01), similarity(-7.5, 7.5)])
def test_marks_follow_the_picture_to_what_became_invalid(moved):
    rng = np.random.default_rng(4)
    marked, valid = rng.random((HEIGHT, WIDTH)) < 0.002, rng.random((HEIGHT, WIDTH)) < 0.5
    near = ndimage.maximum_filter(marked.astype(np.uint8), size=5, mode="constant").astype(bool)
    y, x = np.indices((HEIGHT, WIDTH))
    places = moving_from_fixed(moved, np.stack([x, y], axis=-1))
    inside = ((places >= 0) & (places <= (WIDTH - 1, HEIGHT - 1))).all(axis=-1)
    nearest = np.floor(places + 0.5).astype(int)
    expected = np.zeros_like(marked)
    expected[inside] = near[nearest[inside][:, 1], nearest[inside][:, 0]]
    assert 20 < expected.sum() < expected.size / 2
    assert np.array_equal(meets_marked(marked, valid, moved), expected & ~valid)
