"""The compiled loops of the non-linear mappings compute what their definition says, pixel by pixel."""

from dataclasses import replace

import numpy as np
import pytest

from irodori.calibration.recovery.mappings import LocalMapping, PolynomialMapping, polynomial_count


def local(bands: int, anchors: int, bases: int, seed: int = 0) -> LocalMapping:
    rng = np.random.default_rng(seed)
    directions = np.abs(rng.normal(1.0, 0.5, (anchors, bands)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    levels = np.log(10.0) * np.arange(-4.0, 1.0)
    maps = rng.normal(size=(len(levels) + 1, anchors, bands, bases))
    return LocalMapping(rng.uniform(0.5, 2.0, bands), directions, 0.1, levels, 20.0, maps)


def plain(mapping: LocalMapping, response: np.ndarray, variance=None) -> np.ndarray:
    """The definition of `LocalMapping`, one pixel after the other."""
    out = []
    for n, own in enumerate(response):
        x = own / mapping.scale
        squared = x @ x
        width, maps = mapping.width**2, mapping.maps[0]
        if variance is not None:
            noise = np.mean(variance[n] / mapping.scale**2)
            signal = max(squared - x.size * noise, 1e-3 * squared)
            level = np.log(max(noise / signal, 1e-300))
            position = np.interp(level, mapping.levels, np.arange(mapping.levels.size))
            width += mapping.spread * np.exp(np.clip(level, mapping.levels[0], mapping.levels[-1]))
            lower = min(int(position), mapping.levels.size - 2)
            maps = (1 - position + lower) * mapping.maps[lower + 1] + (position - lower) * mapping.maps[lower + 2]
        share = np.exp((mapping.anchors @ x / np.sqrt(squared) - 1.0) / width)
        out.append(x @ np.tensordot(share / share.sum(), maps, 1))
    return np.array(out)


def weights(mapping, response, variance=None) -> np.ndarray:
    out = np.empty((len(response), mapping.bases), response.dtype)
    mapping.weights(response, variance, out)
    return out


@pytest.mark.default_cases(4)
@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize(("bands", "anchors", "bases"), [(6, 24, 6), (3, 5, 3), (6, 48, 12), (6, 1, 7), (9, 7, 4)])
def test_the_blend_of_matrices_is_that_of_its_definition(bands, anchors, bases, stated):
    mapping, rng = local(bands, anchors, bases), np.random.default_rng(1)
    response = np.abs(rng.normal(0.5, 0.4, (131, bands))) * 10.0 ** rng.uniform(-3, 1, (131, 1))
    variance = 10.0 ** rng.uniform(-9, 1, (131, bands)) if stated else None
    expected = plain(mapping, response, variance)
    size = np.linalg.norm(response / mapping.scale, axis=1, keepdims=True)
    assert np.abs(weights(mapping, response, variance) - expected).max() <= 1e-5 * size.max()
    # Shares under 1e-7 are left out, and no others.
    assert (np.abs(weights(mapping, response, variance) - expected) <= 2e-6 * anchors * size).all()
    single = weights(mapping, response.astype(np.float32), None if variance is None else variance.astype(np.float32))
    assert (np.abs(single - expected) <= 1e-5 * size * np.abs(mapping.maps).max()).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_one_variance_for_all_pixels_is_that_variance_at_each(kind):
    mapping = local(6, 24, 6)
    response = np.abs(np.random.default_rng(6).normal(0.5, 0.2, (100, 6))).astype(kind)
    one = np.geomspace(1e-6, 1e-3, 6).astype(kind)
    each = np.tile(one, (100, 1))
    assert np.array_equal(weights(mapping, response, np.broadcast_to(one, response.shape)),
                          weights(mapping, response, each))  # fmt: skip
    # A view of every second row, and variances that are not those of the responses, are read in place.
    assert np.array_equal(weights(mapping, response, np.repeat(each, 2, axis=0)[::2]), weights(mapping, response, each))


def test_an_anchor_that_stands_twice_counts_as_two():
    mapping = local(6, 24, 6)
    twice = replace(
        mapping,
        anchors=np.repeat(mapping.anchors, 2, axis=0),
        maps=np.repeat(mapping.maps, 2, axis=1),
    )
    response = np.abs(np.random.default_rng(7).normal(0.5, 0.2, (90, 6)))
    variance = 10.0 ** np.random.default_rng(8).uniform(-9, 0, (90, 6))
    for own in (None, variance):
        assert np.allclose(weights(twice, response, own), weights(mapping, response, own), rtol=0, atol=1e-4)
        assert np.allclose(weights(twice, response, own), plain(twice, response, own), rtol=0, atol=1e-4)


@pytest.mark.stability(stage="calibrate", case="pixels without light or not finite")
@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("stated", [False, True])
def test_responses_that_are_no_numbers_or_none_spoil_no_neighbour(kind, stated):
    mapping = local(6, 24, 6)
    response = np.abs(np.random.default_rng(9).normal(0.5, 0.2, (70, 6))).astype(kind)
    variance = np.full((70, 6), 1e-4, kind) if stated else None
    expected = weights(mapping, response, variance)
    response[3, 2], response[4, 0], response[5] = np.nan, np.inf, 0.0
    found = weights(mapping, response, variance)
    assert np.isnan(found[3:5]).all() and not found[5].any()
    assert np.array_equal(np.delete(found, [3, 4, 5], axis=0), np.delete(expected, [3, 4, 5], axis=0))


def test_the_polynomial_is_that_of_its_definition():
    rng = np.random.default_rng(2)
    mapping = PolynomialMapping(rng.uniform(0.5, 2.0, 6), rng.normal(size=(polynomial_count(6), 5)))
    response = rng.normal(0.5, 0.4, (70, 6))
    x = response / mapping.scale
    length = np.linalg.norm(x, axis=1)
    terms = [x[:, i] for i in range(6)]
    terms += [x[:, i] * x[:, j] / length for i in range(6) for j in range(i, 6)]
    terms += [x[:, i] * x[:, j] * x[:, k] / length**2 for i in range(6) for j in range(i, 6) for k in range(j, 6)]
    assert np.allclose(weights(mapping, response), np.stack(terms, axis=1) @ mapping.coefficients, rtol=0, atol=1e-12)


@pytest.mark.parametrize("stated", [False, True])
def test_a_pixel_has_the_same_bits_among_any_neighbours(stated):
    mapping, rng = local(6, 24, 6), np.random.default_rng(3)
    response = np.abs(rng.normal(0.5, 0.4, (9000, 6))).astype(np.float32)
    variance = (10.0 ** rng.uniform(-9, 0, (9000, 6))).astype(np.float32) if stated else None
    whole = weights(mapping, response, variance)
    for part in (slice(0, 1), slice(17, 100), slice(4999, 5200)):
        own = None if variance is None else variance[part]
        assert np.array_equal(weights(mapping, response[part], own), whole[part])


@pytest.mark.parametrize("fault", [np.nan, -1e-6])
def test_a_variance_that_is_none_gives_no_number_and_spoils_no_neighbour(fault):
    mapping = local(6, 24, 6)
    response = np.abs(np.random.default_rng(4).normal(0.5, 0.2, (80, 6)))
    variance = np.full((80, 6), 1e-5)
    expected = weights(mapping, response, variance)
    variance[7] = fault
    found = weights(mapping, response, variance)
    assert np.isnan(found[7]).all()
    assert np.array_equal(np.delete(found, 7, axis=0), np.delete(expected, 7, axis=0))


def test_no_noise_is_the_lowest_level_and_endless_noise_the_highest():
    mapping = local(6, 24, 6)
    response = np.abs(np.random.default_rng(5).normal(0.5, 0.2, (3, 6)))
    squared = ((response / mapping.scale) ** 2).sum(axis=1)
    scale = mapping.scale**2
    none, least = (weights(mapping, response, v * np.ones((3, 1)) * scale) for v in (0.0, 1e-12))
    assert np.array_equal(none, least)
    endless = weights(mapping, response, np.full((3, 6), np.inf))
    assert np.allclose(endless, weights(mapping, response, 10.0 * squared[:, None] * scale), atol=1e-12)
