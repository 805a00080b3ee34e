"""The plate's shift, turn and magnification are found from pictures whose colours differ, or said to be unknown."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from depth import inputs
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from shortcuts import moving_from_fixed

from benchmarks.plate_pictures import (
    Scene,
    errors_px,
    leaves_scene,
    photograph,
    random_reflectances,
    random_truth,
    render,
    white_weights,
)
from irodori.geometry.pinhole import bayer_offsets_px
from irodori.ingest.registration import similarity as similarity_module
from irodori.ingest.registration.band_layout import flatten
from irodori.ingest.registration.gradient_sums import gradient_moments, least_share, sample, template
from irodori.ingest.registration.pyramid import Pyramid, gradient_energy, noise_of
from irodori.ingest.registration.similarity import (
    Registration,
    _has_content,
    _noise_information,
    _Pair,
    _residual_px,
    _sigma_px,
    meets_marked,
    register,
    resample,
)
from irodori.ingest.registration.similarity_fit import (
    _colour_maps,
    affine_of_level,
    align,
    evaluate,
    information_of,
    make_level,
    search,
)

STILL = Registration(0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
WIDTH, HEIGHT = 200, 150
TARGET_PX = 0.05


def similarity(dx=0.0, dy=0.0, rotation_deg=0.0, scale=1.0) -> Registration:
    return Registration(dx, dy, math.radians(rotation_deg), scale, 0.0, 0.0)


def shoot(scene, truth, rng, width=WIDTH, height=HEIGHT, *, light=1.0, barrel_px=0.0):
    """Return both pictures and their masks."""
    fixed, fixed_valid = photograph(render(scene, width, height, 0, STILL), 0, rng)
    moving, moving_valid = photograph(
        render(scene, width, height, 1, truth, barrel_px),
        1,
        rng,
        light,
    )
    return [fixed, moving, fixed_valid, moving_valid]


def rms_px(found, truth, width=WIDTH, height=HEIGHT) -> float:
    return float(np.sqrt((errors_px(found, truth, width, height) ** 2).mean()))


def noise(rng, width=WIDTH, height=HEIGHT, level=0.0):
    return [
        *(
            photograph(
                np.full((2 * height, 2 * width), level),
                state,
                rng,
            )[0]
            for state in range(2)
        ),
        *(np.ones((height, width), dtype=bool) for _ in range(2)),
    ]


@pytest.fixture(scope="module")
def leaves():
    return leaves_scene(WIDTH, HEIGHT, np.random.default_rng(1))


@settings(max_examples=inputs(2, 6), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    dx=st.floats(-8, 8),
    dy=st.floats(-8, 8),
    rotation_deg=st.floats(-0.5, 0.5),
    scale=st.floats(0.99, 1.01),
)
def test_any_plate_before_any_scene_is_found_within_a_twentieth_of_a_superpixel(seed, dx, dy, rotation_deg, scale):
    rng = np.random.default_rng(seed)
    truth = similarity(dx, dy, rotation_deg, scale)
    found = register(*shoot(leaves_scene(WIDTH, HEIGHT, rng), truth, rng))
    assert rms_px(found, truth) <= TARGET_PX
    assert found.sigma_px <= TARGET_PX


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("corner", [(8, 8, 0.5, 1.01), (-8, 8, -0.5, 0.99), (8, -8, 0.5, 0.99), (-8, -8, 0.5, 1.01)])
def test_the_corners_of_the_plates_range_are_found(leaves, corner):
    truth = similarity(*corner)
    assert rms_px(register(*shoot(leaves, truth, np.random.default_rng(2))), truth) <= TARGET_PX


def textured(rng, shape, shift=(0, 0)) -> np.ndarray:
    """Return a level of random patches, moved by whole pixels (x, y), with a few samples that are not valid.

    Their contrast falls to the right and downwards, so that correlations must be normalised by what overlaps.
    """
    scene = np.random.default_rng(9).uniform(0.2, 0.8, (30, 30, 3)).repeat(4, axis=0).repeat(4, axis=1)
    scene *= np.geomspace(1.0, 0.2, 120)[:, None] * np.geomspace(1.0, 0.2, 120)[:, None, None]
    x, y = 30 - shift[0], 30 - shift[1]
    level = np.ones((*shape, 4), np.float32)
    level[..., :3] = scene[y : y + shape[0], x : x + shape[1]] + rng.normal(0.0, 0.002, (*shape, 3))
    level[rng.uniform(size=shape) < 0.02] = 0.0
    return level


def plain_proposals(fixed, moving, scale) -> list[complex]:
    """Return three shifts by the masked normalised correlation of gradient magnitudes, a plain sum for each."""
    (f, inside_f), (m, inside_m) = (
        (gradient_energy(one, noise_of(one)) ** 0.25, np.pad(one[1:-1, 1:-1, 3] > 0.5, 1)) for one in (fixed, moving)
    )
    reach, (height, width) = math.ceil(12.0 / scale) + 1, f.shape
    score = {}
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            here = np.s_[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
            there = np.s_[max(0, dy) : height + min(0, dy), max(0, dx) : width + min(0, dx)]
            both = inside_f[here] & inside_m[there]
            score[dx, dy] = np.corrcoef(f[here][both], m[there][both])[0, 1]
    found = []
    for _ in range(3):
        x, y = max(score, key=score.get)
        found.append(scale * complex(x, y))
        score = {place: value for place, value in score.items() if max(abs(place[0] - x), abs(place[1] - y)) > 1}
    return found


@pytest.mark.parametrize(("scale", "shift"), [(1.0, (7, -4)), (1.0, (-13, 12)), (2.0, (-3, -7)), (4.0, (1, -2))])
@pytest.mark.parametrize("shape", [(47, 60), (58, 41)])
def test_the_search_proposes_what_correlates_best(scale, shift, shape):
    rng = np.random.default_rng(12)
    fixed, moving = textured(rng, shape), textured(rng, shape, shift)
    found = search(fixed, moving, scale)
    assert found[0] == scale * complex(*shift)
    assert found == plain_proposals(fixed, moving, scale)


@pytest.mark.parametrize("bands", [np.s_[:], np.s_[:3], np.s_[1:4], np.s_[::2]])
@pytest.mark.parametrize("turned", [False, True])
def test_a_picture_s_samples_in_one_row_are_its_own_and_no_more(bands, turned):
    whole = np.random.default_rng(2).uniform(size=(4, 6, 5)).astype(np.float32)
    image = (whole.swapaxes(0, 1) if turned else whole)[..., bands]
    values, step = flatten(image)
    height, width, count = image.shape
    y, x, b = np.ogrid[:height, :width, :count]
    assert np.array_equal(values[(y * width + x) * step + b], image)
    assert values.size == (height * width - 1) * step + count
    # Neighbouring bands of a picture as it lies in memory are not copied.
    assert np.shares_memory(values, whole) == (not turned and bands != np.s_[::2])


def test_edges_count_by_the_noise_of_their_band():
    """A picture's gradients are squared in units of each band's noise, which is what differences of neighbours show."""
    rng, noise = np.random.default_rng(5), np.array([0.002, 0.01, 0.05])
    level = np.ones((60, 80, 4), np.float32)
    level[..., :3] = rng.normal(0.5, noise, (60, 80, 3))
    found = noise_of(level)
    assert found == pytest.approx(noise, rel=0.1)
    steps = np.array([0.1, 0.2, 0.3])
    level[..., :3] = np.arange(80)[:, None] * steps
    energy = gradient_energy(level, found)
    assert energy[1:-1, 1:-1] == pytest.approx(((2.0 * steps / found) ** 2).sum(), rel=1e-4)
    assert not energy[0].any() and not energy[:, -1].any()


def test_noise_is_told_by_valid_pixels_alone_and_is_a_thousandth_of_the_content_at_least():
    rng, noise = np.random.default_rng(6), np.array([0.002, 0.01, 0.05])
    for shape in ((60, 80), (200, 800)):
        level = np.ones((*shape, 4), np.float32)
        level[..., :3] = rng.normal(0.5, noise, (*shape, 3))
        clean = noise_of(level)
        spoilt = rng.uniform(size=shape) < 0.2
        level[spoilt] = [50.0, -50.0, 7.0, 0.5]
        assert noise_of(level) == pytest.approx(noise, rel=0.1) and clean == pytest.approx(noise, rel=0.1)
        level[..., 3] = np.where(spoilt, 0.51, 1.0)
        assert (noise_of(level) > 1.5 * noise).any()
    # Without noise the differences of neighbours two apart have the floor, here of one edge in forty columns.
    level = np.ones((64, 82, 4), np.float32)
    level[..., :3] = (np.arange(82) >= 41)[:, None] * [0.2, 0.4, 0.0]
    steps = np.sqrt(2 * (0.2**2 + 0.4**2) / 80 / 3)
    assert noise_of(level) == pytest.approx([1e-3 * steps] * 3, rel=1e-4)
    assert noise_of(0.0 * level).tolist() == noise_of(level * [1, 1, 1, 0]).tolist() == [1e-9] * 3


RGGB = bayer_offsets_px("RGGB")


def blobs(size, truth, *, offsets_px=((0, 0),) * 3, around=None) -> tuple[np.ndarray, np.ndarray]:
    """Return two smooth pictures without noise, the second through a plate, and the gains of its bands, (3, 3).

    ``around`` is x, y and spread of what holds all content. Where the bands lie apart their colours are mixed.
    """
    (width, height), rng = size, np.random.default_rng(0)
    count = 30 if around else width * height // 700
    places = rng.uniform(-10, 10, (2, count)) + np.array(size)[:, None] * rng.random((2, count))
    if around:
        places = np.array(around[:2])[:, None] + around[2] * rng.normal(size=(2, count))
    radii, colours = rng.uniform(3, 6, count), rng.uniform(-0.25, 0.25, (count, 3))

    def seen(x, y):
        shapes = (np.exp(-((x - p) ** 2 + (y - q) ** 2) / r**2) for p, q, r in zip(*places, radii, strict=True))
        return 0.4 + sum(shape[..., None] * one for shape, one in zip(shapes, colours, strict=True))

    mixed = np.array([[0.5, 0.2, 0.0], [0.1, 0.6, 0.2], [0.0, 0.2, 0.7]])
    gains = mixed if np.any(offsets_px) else np.diag([0.6, 0.9, 0.75])
    y, x = np.mgrid[:height, :width].astype(float)
    back = np.linalg.inv(np.vstack([truth.affine(((width - 1) / 2, (height - 1) / 2)), [0, 0, 1]]))
    pictures = np.empty((2, height, width, 3))
    for band, (right_px, down_px) in enumerate(offsets_px):
        u, v = x + right_px, y + down_px
        pictures[0, ..., band] = seen(u, v)[..., band]
        u, v = back[0, 0] * u + back[0, 1] * v + back[0, 2], back[1, 0] * u + back[1, 1] * v + back[1, 2]
        pictures[1, ..., band] = seen(u, v) @ gains[band]
    return pictures, gains


def least_sigma_px(fixed, gains, noise) -> float:
    """Return the standard error that no estimate can go below [Cramér, Rao], rms over the picture, superpixels."""
    height, width = fixed.shape[:2]
    reach = math.sqrt((height**2 + width**2) / 12.0)
    y, x = np.mgrid[:height, :width]
    u, v = (x - (width - 1) / 2) / reach, (y - (height - 1) / 2) / reach
    information = np.zeros((4, 4))
    for band in range(3):
        gy, gx = np.gradient(fixed[..., band])
        slopes = np.stack([gx, gy, u * gx + v * gy, u * gy - v * gx], axis=-1).reshape(-1, 4)
        information += slopes.T @ slopes / (noise * np.hypot(1.0, 1.0 / gains[band].sum())) ** 2
    return math.sqrt(np.trace(np.linalg.inv(information)))


PLATES = pytest.mark.parametrize(
    ("size", "plate", "made", "told", "exact_px"),
    [
        ((120, 96), (2.3, -1.7, 0.2, 1.004), {}, {}, 0.0014),
        ((97, 131), (-3.4, 2.9, -0.5, 0.991), {}, {}, 0.001),
        ((150, 210), (6.2, -7.4, 0.4, 1.008), {"offsets_px": RGGB}, {"band_offsets_px": RGGB}, 0.001),
        ((220, 120), (-5.1, 3.2, -0.4, 0.993), {}, {}, 0.0006),
        # All content in one corner, and a start that lies beyond the search.
        ((150, 100), (-5.1, 3.2, -0.4, 0.993), {"around": (115, 75, 15)}, {}, 0.006),
        ((150, 100), (4.1, 2.2, 0.3, 1.006), {"around": (35, 25, 15)}, {}, 0.006),
        ((120, 96), (14.3, -11.7, 0.2, 1.004), {}, {"start": similarity(13.2, -11.0)}, 0.0016),
    ],
)


@PLATES
def test_smooth_pictures_are_registered_exactly(size, plate, made, told, exact_px):
    pictures, _ = blobs(size, similarity(*plate), **made)
    found = register(*pictures.astype(np.float32), *[np.ones(size[::-1], bool)] * 2, **told)
    assert rms_px(found, similarity(*plate), *size) <= exact_px
    assert found.residual_px <= 0.005 and found.sigma_px <= 0.01


@pytest.mark.default_cases(3)
@PLATES
def test_noisy_pictures_are_registered_as_well_as_they_may(size, plate, made, told, exact_px):
    """Between what is found and what no estimate can beat lie a known error and little more."""
    truth, masks = similarity(*plate), [np.ones(size[::-1], bool)] * 2
    pictures, gains = blobs(size, truth, **made)
    level, off, stated = 0.002, [], []
    for seed in range(4):
        noisy = pictures + np.random.default_rng(seed).normal(0.0, level, pictures.shape)
        found = register(*noisy.astype(np.float32), *masks, **told)
        off.append(rms_px(found, truth, *size))
        stated.append(found.sigma_px)
    least = least_sigma_px(pictures[0], gains, level)
    actual, stated = np.sqrt(np.mean(np.square(off))), np.mean(stated)
    assert 0.7 < stated / actual < 3.0 and actual / least < 4.5


@pytest.fixture(scope="module")
def smooth():
    """A smooth pair with a little noise, and its masks."""
    pictures, _ = blobs((120, 96), similarity(2.3, -1.7, 0.2, 1.004))
    return [*(pictures + np.random.default_rng(3).normal(0.0, 0.002, pictures.shape)), *[np.ones((96, 120), bool)] * 2]


@pytest.mark.parametrize(
    "changed",
    [
        lambda picture: picture * 2.0**-14,
        lambda picture: picture * 2.0**10,
        lambda picture: picture[..., ::-1],
        lambda picture: picture + 2.0,
    ],
    ids=["dark", "bright", "bands in another order", "on a bright ground"],
)
def test_neither_unit_nor_order_nor_ground_of_the_bands_changes_what_is_found(smooth, changed):
    fixed, moving, *masks = smooth
    found, same = register(*smooth), register(changed(fixed), changed(moving), *masks)
    assert same.complex_parts() == pytest.approx(found.complex_parts(), abs=1e-4)
    assert (same.sigma_px, same.residual_px) == pytest.approx((found.sigma_px, found.residual_px), rel=0.01, abs=1e-4)


def test_a_band_that_shows_nothing_does_not_hinder_the_others(smooth):
    """A blue filter: of green and red nothing is left, not even noise."""
    fixed, moving, *masks = smooth
    found = register(fixed, moving * [0.0, 0.0, 1.0], *masks)
    assert rms_px(found, similarity(2.3, -1.7, 0.2, 1.004), 120, 96) < 0.1 and found.sigma_px < 0.1
    found = register(fixed * [0.0, 0.0, 1.0], moving * [0.0, 0.0, 1.0], *masks)
    assert rms_px(found, similarity(2.3, -1.7, 0.2, 1.004), 120, 96) < 0.1


def test_the_noise_told_of_a_gradient_is_the_one_that_occurs(smooth):
    """Gradients at the compared places, with noise less those without, in each band."""
    clean, noise = blobs((200, 160), similarity(), around=(60, 48, 8))[0][0], np.array([0.001, 0.002, 0.004])
    mask = np.ones((160, 200), bool)
    for level in (0, 1):
        told, found = [], []
        for seed in range(4):
            noisy = clean + np.random.default_rng(seed).normal(0.0, noise, clean.shape)
            one, other = (Pyramid(picture, mask)[level] for picture in (noisy, clean))
            made = make_level(one, other, 2.0**level, shape=(160, 200), count=8000, offsets_px=None, local=True)
            apart = made.fixed.gradient - template(other, least_share(other), made.places).gradient
            told.append(made.noise)
            found.append((apart[made.fixed.weight > 0.0] ** 2).mean(axis=(0, 2)))
        assert np.mean(told, axis=0) == pytest.approx(np.mean(found, axis=0), rel=0.2)


def test_a_start_that_is_beyond_the_search_and_not_certain_is_tried_beside_what_the_search_proposes():
    size, truth = (150, 110), similarity(31.3, -25.7, 0.2, 1.004)
    pictures, _ = blobs(size, truth)
    pictures += np.random.default_rng(1).normal(0.0, 0.003, pictures.shape)
    masks = [np.ones(size[::-1], bool)] * 2
    found = register(*pictures, *masks, similarity(30.6, -25.0))
    assert 0.05 < found.sigma_px < 0.2 and rms_px(found, truth, *size) < 3.0 * found.sigma_px
    assert register(*pictures, *masks).sigma_px > 0.2


def test_a_moved_picture_shows_every_place_where_it_went():
    """A picture quadratic in its coordinates is resampled exactly, in whatever array is offered for it."""

    def seen(x, y):
        return np.stack([x * y, x * x - 3.0 * y, 0.5 * y * y + x], axis=-1) / 100.0

    height, width = 40, 61
    y, x = np.mgrid[:height, :width].astype(float)
    plate, room = similarity(1.3, -2.2, 4.0, 1.03), np.full((height, width, 6), 7.0, np.float32)
    moved, valid = resample(seen(x, y), np.ones((height, width), bool), plate, room[..., 3:])
    assert np.shares_memory(moved, room) and (room[..., :3] == 7.0).all()
    u, v = np.moveaxis(moving_from_fixed(replace(plate, centre_px=(30.0, 19.5)), np.stack([x, y], axis=-1)), -1, 0)
    covered = (u >= 0.0) & (u <= width - 1.0) & (v >= 0.0) & (v <= height - 1.0)
    assert (valid == covered).all() and not moved[~valid].any()
    inside = (u >= 1.0) & (u < width - 2.0) & (v >= 1.0) & (v < height - 2.0)
    np.testing.assert_allclose(moved[inside], seen(u, v)[inside], atol=2e-3)
    again, _ = resample(seen(x, y), np.ones((height, width), bool), plate)
    assert np.array_equal(again, moved)


def predicted_px(pattern, rows=12, columns=24, information=(1e4,) * 4):
    """The error that is stated where each cell's own score, one unit, has the sign that a pattern gives it."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    sums = np.zeros((rows * columns, 25))
    sums[:, 0] = pattern(row, column)
    sums[:, 4:20] = np.diag(information).ravel() / (rows * columns)
    weight, geometry = np.full((rows * columns, 1), 1e-6), np.array([1.0, 95.5, 47.5, 80.0])
    xy = np.stack([8.0 * column, 8.0 * row], axis=-1)[:, None]
    level = SimpleNamespace(places=SimpleNamespace(counts=row, xy=xy, geometry=geometry), columns=columns, scale=1.0)
    return _sigma_px(level, SimpleNamespace(sums=sums, weight=weight, noise_share=1e-3))


@pytest.mark.parametrize(
    ("pattern", "parts", "cells"),
    [
        (lambda row, column: (-1.0) ** (row // 2 + column // 4), 36, 8),  # six parts along each side
        (lambda row, column: (-1.0) ** row, 12, 24),
        (lambda row, column: (-1.0) ** (column // 2), 12, 24),  # a cell has two halves
        (lambda row, column: np.where(row < 1, 1.0, 0.0), 1, 24),
    ],
    ids=["blocks", "rows", "columns", "one row alone"],
)
def test_what_parts_of_a_picture_disagree_by_counts_for_the_error(pattern, parts, cells):
    """Blocks and strips that agree within themselves and not among each other are as many measurements as there are."""
    by_parts = parts * (cells / 1e4) ** 2 * parts / max(parts - 4, 1)
    assert predicted_px(pattern) == pytest.approx(math.sqrt(max(by_parts, 4.0 / 1e4)), rel=1e-3)
    assert predicted_px(lambda row, column: 100.0 * pattern(row, column)) == pytest.approx(
        100.0 * math.sqrt(by_parts), rel=1e-3
    )


def test_an_error_above_a_superpixel_in_one_direction_is_none_that_is_known():
    for weakest, known in ((0.8, False), (1.3, True)):
        for number in range(4):
            information = np.where(np.arange(4) == number, weakest, 1e4)
            assert math.isfinite(predicted_px(lambda row, column: 0.0 * row, information=information)) == known


def test_predicted_errors_are_those_that_occur():
    ratios = []
    for seed in range(inputs(4, 8)):
        rng = np.random.default_rng(seed)
        truth = random_truth(rng)
        found = register(*shoot(leaves_scene(WIDTH, HEIGHT, rng), truth, rng))
        ratios.append(rms_px(found, truth) / found.sigma_px)
    # Four errors of four components each: their mean square is known within a factor of about 1.7.
    assert 0.5 <= math.sqrt(np.mean(np.square(ratios))) <= 2.0


def test_a_picture_of_four_samples_is_the_smallest_that_can_be_moved():
    picture = np.random.default_rng(0).random((2, 2, 3)).astype(np.float32)
    moved, valid = resample(picture, np.ones((2, 2), bool), STILL)
    assert np.array_equal(moved, picture) and valid.all()
    with pytest.raises(ValueError, match="2 x 2 or more"):
        resample(picture[:1], np.ones((1, 2), bool), STILL)


def test_known_places_of_the_bands_may_be_given():
    rng = np.random.default_rng(5)
    truth = random_truth(rng)
    pictures = shoot(leaves_scene(WIDTH, HEIGHT, rng, size_px=(20, 60), texture=0.0), truth, rng)
    assert rms_px(register(*pictures, band_offsets_px=bayer_offsets_px("RGGB")), truth) <= TARGET_PX


def test_places_of_the_bands_follow_the_mosaic():
    assert np.allclose(bayer_offsets_px("RGGB"), [[-0.25, -0.25], [0, 0], [0.25, 0.25]])
    assert np.allclose(bayer_offsets_px("GBRG"), [[-0.25, 0.25], [0, 0], [0.25, -0.25]])
    with pytest.raises(ValueError, match="RGGB"):
        bayer_offsets_px("RGB")


@pytest.mark.parametrize("size", [(64, 40), (48, 64), (150, 200)])
def test_tiny_and_portrait_pictures_are_registered(size):
    width, height = size
    rng = np.random.default_rng(3)
    truth = similarity(3.3, -2.6, 0.3, 1.006)
    scene = leaves_scene(width, height, rng, size_px=(3, 15))
    found = register(*shoot(scene, truth, rng, width, height), band_offsets_px=bayer_offsets_px("RGGB"))
    assert rms_px(found, truth, width, height) <= max(TARGET_PX, 3.0 * found.sigma_px)
    assert found.sigma_px <= 0.1


def test_a_brighter_second_picture_changes_nothing(leaves):
    truth = similarity(-4.2, 1.7, -0.2, 0.995)
    for light in (0.9, 1.1):
        assert rms_px(register(*shoot(leaves, truth, np.random.default_rng(4), light=light)), truth) <= TARGET_PX


def test_highlights_dust_and_hot_pixels_do_not_pull(leaves):
    truth = similarity(5.4, -3.1, 0.4, 1.004)
    rng = np.random.default_rng(6)
    y, x = np.indices((2 * HEIGHT, 2 * WIDTH))
    pictures, masks = [], []
    for state, transform in enumerate((STILL, truth)):
        mosaic = render(leaves, WIDTH, HEIGHT, state, transform)
        # The mirror image of the lamp saturates; dust on the sensor stays where it is.
        mosaic[np.hypot(x - 170 - 9 * state, y - 120) < 24] = 50.0
        for _ in range(6):
            at = (61, 47) if _ == 0 else (40 + 55 * _, 220 - 30 * _)
            mosaic[np.hypot(x - at[0], y - at[1]) < 7] *= 0.4
        mosaic[31, 41] = mosaic[200, 333] = 1.2
        picture, valid = photograph(mosaic, state, rng)
        picture[~valid] = np.nan
        pictures.append(picture)
        masks.append(valid)
    found = register(*pictures, *masks)
    assert rms_px(found, truth) <= TARGET_PX
    assert found.residual_px <= 0.1


def worst_px(found, truth, places) -> float:
    """Largest error at places of the picture."""
    matrix = truth.affine(((WIDTH - 1) / 2, (HEIGHT - 1) / 2))
    return float(np.hypot(*(moving_from_fixed(found, places) - places @ matrix[:, :2].T - matrix[:, 2]).T).max())


def circle(x, y, radius) -> np.ndarray:
    angle = np.linspace(0.0, 2 * math.pi, 40)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=-1)


def test_a_small_object_in_the_dark_is_aligned_where_it_is():
    rng = np.random.default_rng(7)
    scene = leaves_scene(WIDTH, HEIGHT, rng, size_px=(3, 12), inside=(70.0, 80.0, 22.0))
    truth = similarity(-6.3, 4.4, 0.35, 0.994)
    found = register(*shoot(scene, truth, rng), band_offsets_px=bayer_offsets_px("RGGB"))
    assert worst_px(found, truth, circle(70.0, 80.0, 22.0)) <= TARGET_PX
    assert rms_px(found, truth) <= 3.0 * found.sigma_px <= 0.3


def disc_scene(stripe_angle_rad: float | None) -> Scene:
    """A disc, with two stripes across it if an angle is given."""
    rng = np.random.default_rng(8)
    spectra = np.repeat(random_reflectances(3, rng)[:, None], 2, axis=1) @ white_weights().T
    leaves = np.zeros((3, 9))
    leaves[0, :4] = 100.0, 75.0, 50.0, 50.0
    leaves[1, :4] = 100.0, 60.0, 45.0, 6.0
    leaves[2, :4] = 105.0, 95.0, 30.0, 5.0
    leaves[1:, 4], leaves[1:, 8] = stripe_angle_rad or 0.0, 1.0
    count = 1 if stripe_angle_rad is None else 3
    return Scene(leaves[:count], spectra[:count], np.zeros(6))


@pytest.mark.parametrize("angle_rad", [0.1, 0.5])
def test_a_sphere_of_a_silhouette_and_two_bands_is_enough(angle_rad):
    truth = similarity(2.7, -5.2, -0.4, 1.007)
    found = register(*shoot(disc_scene(angle_rad), truth, np.random.default_rng(9)))
    places = np.concatenate([circle(100.0, 75.0, radius) for radius in (10, 30, 50)])
    assert worst_px(found, truth, places) <= TARGET_PX and found.sigma_px <= TARGET_PX


def test_a_silhouette_alone_leaves_the_rotation_unknown():
    truth = similarity(2.7, -5.2, 0.0, 1.007)
    found = register(*shoot(disc_scene(None), truth, np.random.default_rng(10)))
    assert found.sigma_px == math.inf
    assert abs(found.rotation_rad) <= math.radians(0.5)


@pytest.mark.parametrize("level", [0.0, 0.05, 0.7])
def test_a_picture_without_content_gives_no_answer(level):
    for seed in range(2):
        found = register(*noise(np.random.default_rng(seed), level=level))
        assert found.sigma_px == math.inf and math.isnan(found.residual_px)
        assert (found.dx_px, found.dy_px, found.rotation_rad, found.scale) == (0.0, 0.0, 0.0, 1.0)
        assert found.centre_px == ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)


def test_the_identity_moves_nothing():
    picture = np.random.default_rng(2).uniform(size=(20, 30, 3)).astype(np.float32)
    moved, valid = resample(picture, np.ones((20, 30), bool), STILL)
    np.testing.assert_allclose(moved[valid], picture[valid], atol=1e-6)
    assert valid.all()


def test_constant_and_invalid_pictures_give_no_answer(leaves):
    flat = np.full((HEIGHT, WIDTH, 3), 0.4, dtype=np.float32)
    good = np.ones((HEIGHT, WIDTH), dtype=np.uint8)
    assert register(flat, flat, good, good).sigma_px == math.inf
    assert register(0 * flat, 0 * flat, good, good).sigma_px == math.inf
    fixed, moving, _, _ = shoot(leaves, STILL, np.random.default_rng(0))
    assert register(fixed, moving, 0 * good, good).sigma_px == math.inf
    assert register(fixed, np.full_like(moving, np.nan), good, good).sigma_px == math.inf
    small = slice(0, 8)
    assert register(fixed[small], moving[small], good[small], good[small]).sigma_px == math.inf


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("angle_rad", [0.0, 0.3, 0.8])
def test_one_straight_edge_does_not_determine_the_shift_along_it(angle_rad):
    leaf = np.array([[100.0, 75.0 + 300.0, 900.0, 300.0, angle_rad, 0.0, 0.0, 0.0, 1.0]])
    leaf[0, :2] = 100.0 - 300.0 * math.sin(angle_rad), 75.0 + 300.0 * math.cos(angle_rad)
    spectra = random_reflectances(1, np.random.default_rng(11))[:, None].repeat(2, axis=1)
    scene = Scene(leaf, spectra @ white_weights().T, np.full(6, 0.05))
    for seed in range(2):
        found = register(*shoot(scene, similarity(1.3, 2.4), np.random.default_rng(seed)))
        assert found.sigma_px == math.inf


def test_different_scenes_have_nothing_in_common(leaves):
    other = leaves_scene(WIDTH, HEIGHT, np.random.default_rng(77))
    one, two = shoot(leaves, STILL, np.random.default_rng(0)), shoot(other, STILL, np.random.default_rng(1))
    found = register(one[0], two[1], one[2], two[3])
    assert found.sigma_px > 0.2 or found.residual_px > 0.2


def test_a_deformation_that_is_no_similarity_shows_in_the_residual(leaves):
    # What lies in both pictures: less the shift, the spread of the corners and the kernel's half width.
    y, x = np.mgrid[8 : HEIGHT - 8, 8 : WIDTH - 8]
    u = np.stack([x - (WIDTH - 1) / 2, y - (HEIGHT - 1) / 2], axis=-1)
    barrel = u * (u**2).sum(axis=-1, keepdims=True) / math.hypot(*((WIDTH - 1) / 2, (HEIGHT - 1) / 2)) ** 3
    barrel -= u * (barrel * u).sum() / (u**2).sum()  # less its best scale
    expected = math.sqrt((barrel**2).sum(axis=-1).mean())
    for corner_px in (1.0, 2.0):
        pictures = shoot(leaves, similarity(3.0, 1.0), np.random.default_rng(12), barrel_px=corner_px)
        assert register(*pictures).residual_px == pytest.approx(corner_px * expected, rel=0.4)
    assert register(*shoot(leaves, similarity(3.0, 1.0), np.random.default_rng(12))).residual_px <= 0.02


def test_a_start_beyond_the_search_is_followed(leaves):
    truth = similarity(18.0, -14.0, 0.2, 1.002)
    pictures = shoot(leaves, truth, np.random.default_rng(13))
    assert rms_px(register(*pictures, start=similarity(17.0, -13.2)), truth) <= TARGET_PX
    near = similarity(2.0, 1.0)
    wrong = register(*shoot(leaves, near, np.random.default_rng(14)), start=similarity(-8.0, 8.0))
    assert rms_px(wrong, near) <= TARGET_PX


def test_a_start_that_proves_certain_is_not_searched_beside(smooth, monkeypatch):
    searched = []
    monkeypatch.setattr(similarity_module, "search", lambda *given: searched.append(given) or search(*given))
    near = register(*smooth, start=similarity(2.0, -1.5))
    assert not searched and near.complex_parts() == pytest.approx(register(*smooth).complex_parts(), abs=1e-3)
    assert len(searched) == 1
    register(*smooth[:2], smooth[2], smooth[3] & (np.arange(120) < 14), start=similarity(2.0, -1.5))
    assert len(searched) == 2  # of a narrow strip nothing is certain


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("period_px", [3.0, 4.0, 5.0])
def test_a_weave_does_not_hold_a_start_that_is_a_period_off(period_px):
    width, height, shift_px = 480, 360, period_px + 0.3
    rng = np.random.default_rng(16)
    x0, y0, size = rng.uniform(0, width, 60), rng.uniform(0, height, 60), rng.uniform(10, 40, 60)
    level = rng.uniform(-0.3, 0.3, 60)

    def seen(dx):
        y, x = np.mgrid[:height, :width].astype(float)
        blobs = sum(
            a * np.exp(-((x - dx - p) ** 2 + (y - q) ** 2) / s**2)
            for a, p, q, s in zip(level, x0, y0, size, strict=True)
        )
        weave = np.sin(2 * np.pi * (x - dx) / period_px) * np.sin(2 * np.pi * y / period_px)
        picture = np.stack([0.4 + 0.3 * blobs + 0.01 * weave] * 3, axis=-1) * [1.0, 0.8, 0.6]
        return (picture + rng.normal(0.0, 0.003, picture.shape)).astype(np.float32)

    mask = np.ones((height, width), bool)
    found = register(seen(0.0), seen(shift_px), mask, mask, start=STILL)
    assert abs(found.dx_px - shift_px) <= 0.05 * period_px


def test_pictures_and_masks_must_fit_together():
    picture, mask = np.zeros((40, 50, 3), dtype=np.float32), np.ones((40, 50), dtype=bool)
    with pytest.raises(ValueError, match="accepted"):
        register(picture, picture[:-1], mask, mask)
    with pytest.raises(ValueError, match="accepted"):
        register(picture, picture, mask, mask[:-1])
    with pytest.raises(ValueError, match="accepted"):
        resample(picture[..., :2], mask, STILL)


@pytest.mark.parametrize("truth", [STILL, similarity(3.0, -2.0), similarity(0.6, 0.2, 40.0, 1.4)])
def test_what_a_clipped_sample_reaches_is_where_the_moved_picture_shows_it(truth):
    rng = np.random.default_rng(6)
    mask = rng.random((31, 42)) < 0.004
    found = meets_marked(mask, np.zeros(mask.shape, bool), truth)
    places = moving_from_fixed(replace(truth, centre_px=(20.5, 15.0)), np.stack(np.indices(mask.shape)[::-1], -1))
    expected = np.zeros(mask.shape, bool)
    for y, x in np.ndindex(mask.shape):
        u, v = places[y, x]
        if 0 <= u <= 41 and 0 <= v <= 30:
            column, row = math.floor(u + 0.5), math.floor(v + 0.5)
            expected[y, x] = mask[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].any()
    assert mask.any() and (found == expected).all()
    valid = rng.random(mask.shape) < 0.5
    assert (meets_marked(mask, valid, truth) == (expected & ~valid)).all()


# A fit at one level, step by step.


@pytest.mark.parametrize("scale", [1.0, 2.0, 8.0])
def test_a_similarity_is_the_same_of_the_pixels_of_any_level(scale):
    """The middle of a level's pixel 0 lies half of its side from the picture's corner, which is at -0.5."""
    turn, shift, centre = 1.03 * complex(math.cos(0.2), math.sin(0.2)), 3.0 - 7.0j, 40.0 + 25.0j
    affine = affine_of_level(turn, shift, centre, scale)
    for x, y in np.random.default_rng(1).uniform(-20.0, 60.0, (6, 2)):
        place = complex((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5)
        moved = centre + turn * (place - centre) + shift
        expected = [(moved.real + 0.5) / scale - 0.5, (moved.imag + 0.5) / scale - 0.5]
        np.testing.assert_allclose(affine[:, :2] @ [x, y] + affine[:, 2], expected)


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("local", [False, True])
def test_colours_are_mapped_by_least_squares_and_in_cells_that_tell_little_as_in_the_whole(mixed, local):
    rng, cells = np.random.default_rng(2), 5
    fixed = rng.normal(size=(cells, 3, 40)) * np.array([1.0, 1.0, 0.3, 0.1, 0.0])[:, None, None]
    moving = rng.normal(size=(cells, 3, 3)) @ fixed
    moments = np.stack([fixed @ fixed.swapaxes(1, 2), moving @ fixed.swapaxes(1, 2)], axis=1)
    level = SimpleNamespace(mixed=mixed, local=local, places=SimpleNamespace(counts=np.zeros(cells)))
    found = _colour_maps(level, moments.copy())
    if not mixed:
        moments = moments * np.eye(3)  # each band by itself
    total = moments.sum(axis=0)
    whole = total[1] @ np.linalg.inv(total[0] + 1e-6 * np.trace(total[0]) * np.eye(3))
    pull = 0.1 * np.trace(total[0]) / cells if local else 1e12
    for cell in range(cells):
        expected = (moments[cell, 1] + pull * whole) @ np.linalg.inv(moments[cell, 0] + pull * np.eye(3))
        np.testing.assert_allclose(found[cell], expected, rtol=1e-6, atol=1e-9)
    assert found.flags.c_contiguous


def level_of(fixed, moving, scale=1.0, count=2000, **told):
    """A level of two pictures (h, w, 3) all of whose pixels are valid."""
    fixed, moving = (
        np.concatenate([one, np.ones((*one.shape[:2], 1))], axis=2).astype("f4") for one in (fixed, moving)
    )
    shape = tuple(int(side * scale) for side in fixed.shape[:2])
    return make_level(fixed, moving, scale, shape=shape, count=count, **{"offsets_px": None, "local": False} | told)


def test_a_level_has_cells_of_a_sixth_of_its_side_and_places_in_its_own_pixels():
    picture = np.random.default_rng(3).uniform(0.2, 0.8, (72, 150, 3))
    for side, cell in ((72, 12), (30, 8)):
        level = level_of(picture[:side], picture[:side], 2.0)
        # Cells are half as wide as high, and a row has an even number of them.
        assert level.columns == 2 * (150 // cell) and level.places.counts.size == level.columns * (side // cell)
        radius = math.sqrt(((2 * side) ** 2 + 300**2) / 12.0)
        np.testing.assert_allclose(level.places.geometry, [2.0, 149.5, side - 0.5, radius])
        x, y = np.moveaxis(level.places.xy, -1, 0)
        row, column = np.divmod(np.arange(level.places.counts.size), level.columns)
        used = np.arange(level.places.xy.shape[1]) < level.places.counts[:, None]
        assert (np.abs(x - (column[:, None] + 0.5) * (cell // 2) + 0.5) < cell / 4)[used].all()
        assert (np.abs(y - (row[:, None] + 0.5) * cell + 0.5) < cell / 2)[used].all()
    assert level_of(np.zeros((300, 300, 3)), np.zeros((300, 300, 3))).columns == 2 * (300 // 32)
    few, many = (level_of(picture, picture, count=count).places.xy.shape[1] for count in (100, 4000))
    assert few == 8 and many == 4000 // (24 * 6)
    assert level_of(picture, picture, count=10**6).places.xy.shape[1] == 12 * 6  # all of a cell's
    apart = level_of(picture, picture, 2.0, offsets_px=RGGB)
    np.testing.assert_allclose(apart.places.offsets, -RGGB / 2.0)
    assert apart.mixed and not level.mixed and not level.places.offsets.any()


def test_places_are_compared_where_gradients_stand_out_of_the_noise():
    """By more than twelve times what the weakest twentieth has, which one in five hundred has by chance."""
    rng = np.random.default_rng(4)
    picture = 0.5 + rng.normal(0.0, 1e-3, (96, 120, 3))
    picture[:, 60:] += 0.3
    level = level_of(picture, picture)
    used = np.arange(level.places.xy.shape[1]) < level.places.counts[:, None]
    beside = np.abs(level.places.xy[..., 0][used] - 59.5) < 2.0
    assert beside.sum() > 0.7 * 2 * 94 and 0 < (~beside).sum() < 0.005 * 96 * 120


def content(seed, spread=0.1, noise=1e-3, shape=(80, 120)) -> np.ndarray:
    """A smooth random texture that fades into an even ground, with noise."""
    from scipy import ndimage

    rng, (y, x) = np.random.default_rng(seed), np.indices(shape)
    fading = np.exp(-((((y - shape[0] / 2) / 22.0) ** 2 + ((x - shape[1] / 2) / 33.0) ** 2) ** 3))
    texture = ndimage.gaussian_filter(rng.normal(size=(*shape, 3)), (2.0, 2.0, 0))
    return 0.5 + spread / texture.std() * texture * fading[..., None] + rng.normal(0.0, noise, (*shape, 3))


NOTHING = 1.0 + 0.0j, 0.0j


def test_the_weights_of_the_first_colour_map_fall_with_the_gradient():
    level = level_of(content(5), content(6))
    power = (level.fixed.gradient.astype(float) ** 2).sum(axis=(2, 3))
    there = level.fixed.weight > 0.0
    np.testing.assert_allclose(
        level.first_weight[there], 1.0 / (1.0 + power[there] / np.median(power[there])), rtol=1e-4
    )


def test_a_fit_tells_how_alike_gradients_are_whatever_sign_and_gain_a_filter_gives_them():
    picture, other = content(6), content(7)
    for gain in ([1.0, 1.0, 1.0], [-0.5, 0.2, 2.0]):
        level = level_of(picture, picture * gain)
        found = evaluate(level, *NOTHING, level.first_weight)
        assert found.coherence == pytest.approx(1.0, abs=1e-3) and (found.turn, found.shift) == NOTHING
        assert found.places == (level.fixed.weight > 0.0).sum()
        assert np.abs(found.sums[:, :4]).max() < 1e-3 * np.sqrt(np.abs(found.sums[:, 4:20]).max())
    unlike = level_of(picture, other)
    assert abs(evaluate(unlike, *NOTHING, unlike.first_weight).coherence) < 0.3
    # Of the variance of the moving picture's gradients the fixed one explains half.
    half = level_of(picture, picture + other)
    found = evaluate(half, *NOTHING, half.first_weight)
    moving = sample(half.moving, half.least, affine_of_level(*NOTHING, 59.5 + 39.5j, 1.0), half.places, half.fixed)
    moments = gradient_moments(half.places.counts, half.fixed, moving, half.first_weight).sum(axis=0)
    explained = (half.fixed.gradient * (np.diag(moments[1]) / np.diag(moments[0]))[:, None]).astype(float)
    left = moving.gradient - explained
    sigma = 1.4826 * np.median(np.abs(left[moving.valid > 0.0]), axis=(0, 2))[:, None]
    a, b = explained / sigma, moving.gradient / sigma
    parts = 2.0 * (a * b).sum(axis=(2, 3)) / np.maximum((a * a + b * b).sum(axis=(2, 3)), 1e-30)
    assert 0.4 < found.coherence < 0.9
    assert found.coherence == pytest.approx(parts[moving.valid > 0.0].mean(), abs=0.02)
    # Beyond the moving picture nothing is compared.
    assert evaluate(half, 1.0 + 0.0j, 200.0 + 0.0j, half.first_weight) is None
    moved = evaluate(half, 1.0 + 0.0j, 60.0 + 0.0j, half.first_weight)
    assert 0.3 * found.places < moved.places < 0.7 * found.places


def test_gradients_that_agree_are_known_to_a_tenth_and_to_a_thousandth_of_the_typical_one():
    """Of pictures without noise: what else is left of a gradient is a tenth of it."""
    level = level_of(content(6), content(6))
    found = evaluate(level, *NOTHING, level.first_weight)
    gradient, curvature = (one.astype(float) for one in (level.fixed.gradient, level.fixed.curvature))
    there = level.fixed.weight > 0.0
    typical = np.sqrt((gradient[there] ** 2).mean())
    variance = (1e-3 * typical) ** 2 + (0.1**2) * (gradient**2).sum(axis=3)
    xx, xy, yy = np.moveaxis(curvature, -1, 0)
    for column, product in ((20, xx**2 + xy**2), (21, xy * (xx + yy)), (22, xy**2 + yy**2)):
        expected = (product / variance).sum(axis=2)
        np.testing.assert_allclose(
            found.sums[:, column], np.where(there, expected, 0.0).sum(axis=1), rtol=2e-4, atol=1e-3
        )


@pytest.mark.parametrize(("fixed_noise", "moving_noise"), [(0.004, 0.0), (0.004, 0.004), (0.002, 0.006)])
def test_the_share_of_the_fixed_pictures_noise_in_what_is_left_is_told(fixed_noise, moving_noise):
    """Summed over three bands, of each half at most, for what is left holds the other picture's noise too."""
    rng, clean = np.random.default_rng(7), content(8, 0.2, 0.0, (160, 200))
    fixed, moving = (clean + rng.normal(0.0, noise, clean.shape) for noise in (fixed_noise, moving_noise))
    level = level_of(fixed, moving, count=8000)
    found = evaluate(level, *NOTHING, level.first_weight)
    share = min(0.5, fixed_noise**2 / (fixed_noise**2 + moving_noise**2))
    assert found.noise_share == pytest.approx(3.0 * share, rel=0.35)


def test_a_step_ends_where_the_likelihood_and_the_prior_pull_alike():
    """With a tenth of a picture's contrast the prior has a say: eight superpixels, half a degree and a hundredth."""
    fixed, rng = content(9, 0.004), np.random.default_rng(8)
    level = level_of(fixed, np.roll(fixed, 1, axis=1) + rng.normal(0.0, 2e-3, fixed.shape), count=600)
    start, reach = (1.0 + 0.0j, 0.8 + 0.1j), level.places.geometry[3]
    precision = 1.0 / np.array([8.0, 8.0, 0.01 * reach, math.radians(0.5) * reach]) ** 2
    for free in ((0, 1, 2, 3), (0, 1), (2, 3)):
        found = align(level, *start, 60, 1e-9, free)
        last = evaluate(level, found.turn, found.shift, found.weight)
        state = np.array([found.shift.real, found.shift.imag, (found.turn.real - 1.0) * reach, found.turn.imag * reach])
        pull = last.sums[:, :4].sum(axis=0) + precision * state
        scale = np.sqrt(np.diag(information_of(last.sums)) + precision)
        assert np.abs(pull / scale)[list(free)].max() < 0.02
        assert (found.turn == start[0]) == (free == (0, 1))
        # A turn about the middle moves no shift.
        assert (abs(found.shift - start[1]) < 0.02) == (free == (2, 3))
    # No step is longer than two pixels of the level.
    once = align(level, 1.0 + 0.0j, 9.0 + 0.0j, 1, 1e-9, (0, 1))
    assert 0.0 < abs(once.shift - 9.0) <= 2.0 + 1e-9


def test_the_information_of_all_cells_is_one_symmetric_matrix():
    sums = np.random.default_rng(9).normal(size=(7, 25))
    found, upper = information_of(sums), sums[:, 4:20].sum(axis=0).reshape(4, 4)
    for i in range(4):
        for j in range(4):
            assert found[i, j] == pytest.approx(upper[min(i, j), max(i, j)])


def left_of(pairs) -> float:
    """The residual that is stated of pairs of halves, each of an information (per px²) and a displacement (px)."""
    sums = np.zeros((2 * len(pairs), 25))
    for cell, (information, displacement) in enumerate(half for pair in pairs for half in pair):
        sums[cell, 20] = sums[cell, 22] = information
        sums[cell, :2] = information * np.array(displacement)
    return _residual_px(None, SimpleNamespace(sums=sums))


def test_what_a_similarity_leaves_is_the_displacement_that_both_halves_of_a_block_share():
    assert left_of([((1e6, (0.3, -0.4)),) * 2] * 3) == pytest.approx(0.5, rel=1e-3)
    # Halves that disagree are noise, and noise is no displacement.
    assert left_of([((1e6, (0.3, 0.0)), (1e6, (-0.3, 0.0)))]) == 0.0
    assert left_of([((1e6, (0.3, 0.0)), (1e6, (0.0, 0.3)))]) == pytest.approx(0.0)
    # Blocks of an error below a twentieth count alike, others by their information.
    many = [((1e6, (0.3, 0.0)),) * 2, ((1e8, (0.1, 0.0)),) * 2]
    assert left_of(many) == pytest.approx(math.sqrt((0.09 + 0.01) / 2.0), rel=1e-3)
    weak = [((1e6, (0.3, 0.0)),) * 2, ((400.0, (0.1, 0.0)),) * 2]
    assert left_of(weak) == pytest.approx(math.sqrt((0.09 + 0.25 * 0.01) / 1.25), rel=1e-3)
    assert math.isnan(left_of([((0.0, (0.0, 0.0)),) * 2]))


@pytest.mark.parametrize(
    ("shape", "coarsest", "finest"),
    [
        ((100, 160), 0, 0), ((100, 161), 1, 0), ((640, 480), 2, 0), ((640, 641), 3, 0),
        # No side of a level is shorter than 24 pixels, unless the picture's own is.
        ((48, 2000), 1, 0), ((47, 2000), 0, 0), ((20, 400), 0, 0),
        # Of 800,000 pixels the finest level has no more, and a quarter each level.
        ((800, 1000), 3, 0), ((800, 1001), 3, 1), ((1600, 2000), 4, 1), ((1600, 2001), 4, 2), ((49, 40000), 1, 1),
    ],
)  # fmt: skip
def test_levels_are_as_coarse_as_the_search_and_as_fine_as_the_pixels_allow(shape, coarsest, finest):
    pair = _Pair(None, None, shape, None)
    assert (pair.coarsest, pair.finest) == (coarsest, finest)


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_noise_simulates_information_by_the_kernel_of_the_derivatives(scale):
    """At each place by its weight, about the middle of the picture, in superpixels."""
    rng = np.random.default_rng(10)
    xy, weight = rng.integers(0, 40, (6, 5, 2)), rng.uniform(0.0, 1.0, (6, 5)).astype(np.float32)
    level = SimpleNamespace(places=SimpleNamespace(xy=xy, geometry=np.array([scale, 70.0, 60.0, 50.0])), scale=scale)
    found = _noise_information(level, SimpleNamespace(weight=weight, noise_share=0.2))
    spline = [BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False).derivative(n) for n in range(3)]
    value, first, second = (np.sum(one(np.arange(-2.0, 3.0)) ** 2) for one in spline)
    expected = np.zeros((4, 4))
    for (x, y), w in zip(xy.reshape(-1, 2), weight.ravel(), strict=True):
        u, v = ((x + 0.5) * scale - 0.5 - 70.0) / 50.0, ((y + 0.5) * scale - 0.5 - 60.0) / 50.0
        moves = np.array([[1.0, 0.0, u, -v], [0.0, 1.0, v, u]])
        expected += w * moves.T @ moves
    share = 0.2 * (second / first + first / value) / scale**2
    np.testing.assert_allclose(found, share * expected, rtol=1e-6, atol=1e-9)


def test_a_fit_has_content_whose_coherence_is_above_chance_by_four_standard_deviations():
    for places, least in ((400, 0.3), (10_000, 0.14)):
        for by, has in ((-0.01, False), (0.01, True)):
            assert _has_content(SimpleNamespace(coherence=least + by, places=places)) == has
