"""Texels at a seam between two paints: which show a mixture, and what is stated of their gloss."""

from dataclasses import replace
from math import erf

import numpy as np
import pytest
from test_fitting import model
from test_paints import BANDS, CAMERA, GREEN, OPTICS, SIDE, TWO_BETA, TWO_MU, colours_of, fitted, painted, sphere

from irodori.fitting.diffuse_response import Observed
from irodori.fitting.gloss_search import PairGloss
from irodori.fitting.mixtures import LEAST_SHARE, Mixtures, find_mixtures, gloss_between, seams
from irodori.fitting.paint_colours import Colours
from irodori.fitting.paint_gloss import PaintGloss, share
from irodori.fitting.paint_stage import _share_tile
from irodori.fitting.paints import by_colour, find_paints, sample_of, share_by_paint
from irodori.material.material_file import Status

WIDTH = 64
BASE = np.array([0.52, 0.4, 0.3])
COLUMN = np.tile(np.arange(WIDTH), SIDE)
#: Distance from the seam, 1 for the texels beside it.
DISTANCE = np.where(COLUMN >= WIDTH // 2, COLUMN - WIDTH // 2 + 1, WIDTH // 2 - COLUMN)
RIGHT = (COLUMN >= WIDTH // 2).astype(int)
#: Angles near and beside a highlight, at which the gloss of two surfaces is compared.
SEEN_AT = np.stack([np.full(9, 0.7)] * 3 + [np.linspace(0.0, 0.4, 9)], axis=-1)


def seam(seed, apart, gloss_of_right=1):
    """Photographs of two paints on a sphere, blurred over 0.7 texels and shifted by 0.2 (standard deviations).

    ``apart`` is the difference of their colours in each band, in percent. Returns the share of the right paint in every
    texel, and what is observed.
    """
    rng, geometry = np.random.default_rng([seed, 99]), sphere(width=WIDTH)
    lit, both = np.clip(np.cos(geometry[..., 0]), 0.0, None), []
    for colour, gloss in ((BASE, 0), (BASE * np.exp(0.01 * apart * np.array([1.0, -1.0, 1.0])), gloss_of_right)):
        green = model(*(np.full(len(geometry), v) for v in (colour[GREEN], TWO_BETA[gloss], TWO_MU[gloss])), geometry)
        both.append(green[..., None] + lit[..., None] * (colour - colour[GREEN]))
    off = (COLUMN + 0.5 - WIDTH / 2)[:, None] - 0.25 - 0.2 * rng.normal(size=geometry.shape[1])
    part = 0.5 * (1.0 + np.vectorize(erf)(off / (0.7 * np.sqrt(2.0))))
    clean = (1.0 - part[..., None]) * both[0] + part[..., None] * both[1]
    response = clean + np.sqrt(CAMERA[0] + CAMERA[1] * clean) * rng.normal(size=clean.shape)
    weight, noise = np.ones(part.shape), np.tile(CAMERA, (part.shape[1], BANDS, 1))
    return part.mean(axis=1), Observed(response, geometry, weight, np.zeros(part.shape, np.uint8), noise)


def as_rendered(beta, mu, part) -> np.ndarray:
    """Relative error of a texel's gloss, compared with the mixture of both paints' that it shows."""
    left, right = (model(0.0, TWO_BETA[side], TWO_MU[side], SEEN_AT) for side in (0, 1))
    true = (1.0 - part[:, None]) * left + part[:, None] * right
    return np.sqrt(((model(np.zeros(len(beta)), beta, mu, SEEN_AT) - true) ** 2).mean(axis=1) / (true**2).mean(axis=1))


@pytest.mark.parametrize(("apart", "seeds"), [(6, (21, 22, 23)), (10, (20, 21)), (30, (20, 21))])
def test_a_texel_at_a_seam_has_an_error_that_contains_the_gloss_of_both_paints(apart, seeds):
    """Colours that are nearly the same, so that mixtures have the colour of one of them, and others."""
    rendered = []
    for seed in seeds:
        part, seen = seam(seed, apart)
        _, paints, found = painted(seen, WIDTH)
        assert len(paints.known) == 2
        mixed = np.zeros(len(part), dtype=bool)
        mixed[found.texel] = found.is_mixture
        assert mixed[DISTANCE == 1].mean() > 0.9 and not mixed[DISTANCE > 2].any()
        for name, values in (("beta", TWO_BETA), ("mu", TWO_MU)):
            value, error = (getattr(found.shared, key)[found.is_mixture] for key in (name, f"{name}_error"))
            for one in values:
                # The paints' own gloss is known to a few percent.
                assert (np.abs(np.log(value / one)) <= 2.0 * error / value + 0.03).all()
        # Away from the seam, gloss is that of the paint, and known far better.
        own = ~found.is_mixture & (DISTANCE[found.texel] > 2)
        off = found.shared.beta[own] / TWO_BETA[RIGHT[found.texel[own]]] - 1.0
        assert own.sum() > 0.9 * (DISTANCE > 2).sum() and np.abs(off).max() < 0.05
        here = found.is_mixture & (DISTANCE[found.texel] == 1)
        rendered.append(as_rendered(found.shared.beta[here], found.shared.mu[here], part[found.texel[here]]))
    # With the gloss of the paint at their centre, it would be 0.3. Colours that are nearly the same do not tell more.
    assert apart < 10 or np.sqrt((np.concatenate(rendered) ** 2).mean()) < 0.2


@pytest.mark.parametrize("apart", [30, 120])
def test_the_error_of_alpha_of_a_mixture_contains_both_paints(apart):
    """Also if it is far larger than a texel of one paint may state without losing its gloss."""
    _, seen = seam(27, apart)
    _, _, found = painted(seen, WIDTH)
    alpha, error = (getattr(found.shared, name)[found.is_mixture] for name in ("alpha", "alpha_error"))
    # The α of a mixture is known to some percent.
    for one in BASE[GREEN] * np.exp(0.01 * apart * np.array([0.0, -1.0])):
        assert (np.abs(alpha - one) <= 2.0 * error + 0.04 * one).all()
    mixed = found.texel[found.is_mixture]
    assert np.isin(mixed, np.flatnonzero(DISTANCE == 1)).sum() > 0.45 * (DISTANCE == 1).sum()
    # And no further than to the further of the two.
    assert (error <= 0.5 * BASE[GREEN] * -np.expm1(-0.01 * apart) + 0.03 * BASE[GREEN]).all()


def painted_tile(seen):
    """A tile, and its paints."""
    tile, own = fitted(seen)
    colours = colours_of(tile, WIDTH)
    seen_at_all = np.any(seen.weight > 0.0, axis=1)
    sample = sample_of(by_colour(tile.response, tile.variance, colours), seen_at_all, colours, WIDTH, 1)
    return tile, own, find_paints([tile[sample]], colours, OPTICS)


def test_status_and_paint_say_what_a_mixture_is():
    _, seen = seam(24, 20)
    tile, own, paints = painted_tile(seen)
    maps = {name: np.array(getattr(own, name)) for name in ("alpha", "alpha_error", "beta", "beta_error", "mu",
            "mu_error", "residual_rms", "relative_residual", "status", "model")}  # fmt: skip
    maps |= {"diffuse_response": tile.response.copy(), "diffuse_variance": tile.variance.copy()}
    _share_tile(tile, maps, paints, WIDTH, OPTICS)
    mixed = maps["status"] == Status.MIXTURE
    assert mixed[DISTANCE == 1].mean() > 0.9 and (maps["paint"][mixed] == -1).all()
    assert np.isfinite(maps["beta"][mixed]).all() and (maps["beta_error"] > 0.2 * maps["beta"])[mixed].all()


def test_beside_a_surface_of_unknown_paint_no_texel_takes_the_gloss_of_the_paint_next_to_it():
    """On the right, every texel has a colour of its own, so that there is no paint."""
    _, seen = seam(25, 10, gloss_of_right=0)
    many = 0.3 + 0.7 * np.random.default_rng(25).random((len(COLUMN), BANDS))
    factor = np.where(RIGHT[:, None] == 1, many, 1.0)[:, None]
    tile, _, paints = painted_tile(replace(seen, response=seen.response * factor))
    found = share_by_paint(tile, paints, WIDTH, OPTICS)
    assert len(paints.known) == 1
    taken = np.zeros(len(COLUMN), dtype=bool)
    taken[found.texel] = True
    assert taken[(RIGHT == 0) & (DISTANCE > 1)].mean() > 0.95 and taken[RIGHT == 1].mean() < 0.02


def mixtures_in(found, filled, response, colours):
    """Paints without the mixtures, and the mixtures, of texels with these responses."""
    edge = np.flatnonzero(seams(filled))
    return find_mixtures(edge, found, filled, response[edge], np.zeros((len(edge), BANDS)), colours)


def strip(colour):
    """Texels of two paints, and between them a strip two texels wide of a third paint with a colour of its own."""
    colours = np.array([[0.6, 0.3, 0.2], [0.2, 0.3, 0.6], colour])
    paint = np.tile(np.r_[[0] * 8, [2] * 2, [1] * 8], (10, 1))
    floor = np.full(BANDS, 0.001)
    none = Colours(floor, np.empty((0, BANDS)), np.empty(0, dtype=int))
    return paint, Colours(floor, none.scaled(colours), np.arange(3)), colours[paint].reshape(-1, BANDS)


def test_a_strip_with_the_colour_of_a_third_paint_is_a_mixture_if_its_neighbours_mix_to_that_colour():
    paint, colours, response = strip([0.4, 0.3, 0.4])
    left, mixtures = mixtures_in(paint, paint, response, colours)
    assert np.array_equal(left < 0, paint == 2) and set(mixtures.one) | set(mixtures.other) == {0, 1}
    np.testing.assert_allclose(mixtures.share, 0.5)
    paint, colours, response = strip([0.4, 0.6, 0.4])
    left, mixtures = mixtures_in(paint, paint, response, colours)
    assert np.array_equal(left, paint) and len(mixtures.texel) == 0


def test_a_texel_without_a_paint_has_the_one_of_which_it_surely_shows_most():
    """The nearest paint is not it where a blur is not symmetrical."""
    paint, colours, response = strip([0.26, 0.3, 0.54])
    found = np.where(paint == 2, -1, paint)
    left, mixtures = mixtures_in(found, np.where(paint == 2, 0, paint), response, colours)
    assert (left[paint == 2] == 1).all() and len(mixtures.texel) == 0


@pytest.mark.parametrize("parameters", [2, 4])
def test_gloss_between_two_paints_is_their_mean_and_contains_both(parameters):
    rng, variance = np.random.default_rng(parameters), 1e-4 * np.eye(parameters)
    kind, further = (PaintGloss, (variance,)) if parameters == 2 else (PairGloss, ())
    one, other = (kind(rng.normal(size=parameters), variance, variance, 1.0, 50, *further) for _ in range(2))
    part = np.array([0.0, 0.05, LEAST_SHARE, 0.5, 0.9, 1.0])
    mixtures = Mixtures(np.arange(6), np.zeros(6, dtype=int), np.full(6, 2), part, np.zeros(6))
    found = gloss_between([one, None, other], mixtures)
    np.testing.assert_allclose(found.log_gloss, one.log_gloss + part[:, None] * (other.log_gloss - one.log_gloss))
    sigma = np.sqrt(np.einsum("tii->ti", found.error))
    for paint in (one, other):
        assert (np.abs(found.log_gloss - paint.log_gloss) <= 2.0 * sigma).all()
    # Two standard errors reach no further than to the further of the two.
    reach = np.maximum(part, 1.0 - part)[:, None] * np.abs(other.log_gloss - one.log_gloss)
    middle = np.abs(part - 0.5) >= 0.3
    assert (sigma[middle] <= 0.5 * reach[middle] + 0.02).all()


def test_one_gloss_for_all_texels_gives_what_the_same_gloss_for_each_gives():
    _, seen = seam(26, 30)
    tile, _, paints = painted_tile(seen)
    gloss = paints.gloss[paints.known[0]]
    some = tile[:40]
    each = type(gloss)(*(np.tile(value, (40, *[1] * np.ndim(value))) for value in vars(gloss).values()))
    surface = some.surface(OPTICS, sides=False)
    together, apart = share(surface, gloss), share(surface, each)
    for name in ("alpha", "gloss", "own"):
        np.testing.assert_allclose(getattr(apart, name), getattr(together, name), rtol=1e-9)
    agrees = together.agrees
    np.testing.assert_allclose(apart.alpha_error[agrees], together.alpha_error[agrees], rtol=1e-9)
    assert agrees.sum() > 10
