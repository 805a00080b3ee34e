"""Gloss from the neighbourhood: known truth is found where no texel alone can tell it, and materials stay apart."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from test_fitting import K, N, model
from test_fitting_hard import in_plane

from irodori.fitting.pooling import pool
from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status
from irodori.reflection.equation5 import angles_from_directions

SIDE = 20
RADIUS = 3


def direction(angle_deg, side):
    a = np.radians(angle_deg)
    return np.stack([side * np.sin(a), 0 * a, np.cos(a)], axis=-1)


def sphere_tile(poses=14, side=SIDE) -> np.ndarray:
    """Angles of a patch of a sphere under far light and camera, (side², poses, 4) rad: few see a narrow lobe twice."""
    x, y = np.meshgrid(np.linspace(-0.34, 0.34, side), np.linspace(-0.2, 0.2, side))
    normal = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1).reshape(-1, 1, 3)
    light, camera = np.linspace(20, 65, poses), np.linspace(55, 28, poses)[np.random.default_rng(0).permutation(poses)]
    return angles_from_directions(normal, direction(light, 1.0)[None], direction(camera, -1.0)[None])


def rendered(alpha, beta, mu, geometry, noise, seed):
    """Responses with noise, (texels, J)."""
    clean = np.array([model(a, b, m, g) for a, b, m, g in zip(alpha, beta, mu, geometry, strict=True)])
    rng = np.random.default_rng(seed)
    return clean + np.sqrt(noise[0] + noise[1] * np.maximum(clean, 0)) * rng.normal(size=clean.shape)


CAMERA = (1e-6, 2e-5)
EXACT = {"pose_error_deg": 0.0, "model_error": 0.002}


def both(response, geometry, weight=None, width=SIDE, radius=RADIUS, camera=CAMERA, **options):
    """The fit of each texel by itself, and with its neighbourhood."""
    options = FitOptions(pooling_radius_texels=radius, **(EXACT | options))
    weight = np.ones(response.shape) if weight is None else weight
    noise = None if camera is None else np.tile(camera, (response.shape[1], 1))
    alone = fit(response, geometry, weight, N, K, options, noise=noise)
    return alone, pool(alone, response, geometry, weight, n=N, k=K, options=options, noise=noise, width=width)


def patch(beta, mu, noise=CAMERA, seed=1, poses=14, **options):
    """A patch of a sphere, its true α, and its fits alone and pooled."""
    geometry = sphere_tile(poses)
    alpha = np.random.default_rng(seed).uniform(0.05, 0.8, SIDE * SIDE)
    beta, mu = (np.broadcast_to(v, SIDE * SIDE) for v in (beta, mu))
    response = rendered(alpha, beta, mu, geometry, noise, seed)
    return alpha, *both(response, geometry, camera=noise, **options)


LEFT = np.arange(SIDE * SIDE) % SIDE < SIDE // 2


@pytest.mark.parametrize(("beta", "mu", "poses"), [(3.0, 0.05, 14), (2.0, 0.06, 8), (6.0, 0.03, 14)])
def test_gloss_that_no_texel_sees_often_enough_is_found_from_its_neighbours(beta, mu, poses):
    alpha, alone, pooled = patch(beta, mu, poses=poses)
    open_ = np.isin(alone.status, (Status.MU_UNIDENTIFIABLE, Status.AT_BOUND))
    found = pooled.status == Status.POOLED
    assert open_.sum() > 50 and found[open_].mean() > 0.7
    for name, truth in (("alpha", alpha), ("beta", np.full(alpha.shape, beta)), ("mu", np.full(alpha.shape, mu))):
        error, off = getattr(pooled, f"{name}_error")[found], np.abs(getattr(pooled, name) - truth)[found]
        assert np.isfinite(off).all()
        assert (off < 2 * error).mean() > 0.9
    assert np.median(np.abs(pooled.beta / beta - 1)[found]) < 0.05
    assert np.median(np.abs(pooled.mu / mu - 1)[found]) < 0.03


def test_texels_with_gloss_of_their_own_keep_it_and_every_field_agrees_with_the_status():
    _, alone, pooled = patch(3.0, 0.05)
    kept = pooled.status != Status.POOLED
    for field in dataclasses.fields(alone):
        before, after = getattr(alone, field.name), getattr(pooled, field.name)
        if not isinstance(before, np.ndarray):  # the lobes, and what a second one would have
            assert after == before
            continue
        np.testing.assert_array_equal(after[kept], before[kept])
        assert after.dtype == before.dtype and after.shape == before.shape
    stated = np.isin(pooled.status, (Status.OK, Status.POOLED))
    for name in ("beta", "mu", "beta_error", "mu_error"):
        assert np.array_equal(np.isfinite(getattr(pooled, name)), stated)
    assert np.array_equal(pooled.pooled_from > 1, ~kept) and pooled.pooled_from.max() <= 29
    np.testing.assert_array_equal(pooled.gloss[~kept], np.stack([pooled.beta, pooled.mu], axis=1)[~kept])


@pytest.mark.parametrize(("left", "right"), [((3.0, 0.05), (3.0, 0.12)), ((6.0, 0.05), (1.5, 0.05))])
def test_two_materials_side_by_side_are_not_mixed(left, right):
    beta, mu = (np.where(LEFT, a, b) for a, b in zip(left, right, strict=True))
    _, _, pooled = patch(beta, mu)
    found = pooled.status == Status.POOLED
    assert found[LEFT].sum() > 20  # those near the other material are not stated: gloss varies there
    for name, truth, ends in (("beta", beta, (left[0], right[0])), ("mu", mu, (left[1], right[1]))):
        off = np.abs(getattr(pooled, name) - truth)[found]
        assert (off < 3 * getattr(pooled, f"{name}_error")[found]).mean() > 0.97
        if ends[0] != ends[1]:  # closer to its own side's than to the other's
            share = np.log(getattr(pooled, name) / truth)[found] / np.log(ends[1] / ends[0])
            assert (np.abs(share) < 0.5).mean() > 0.99


def test_a_matt_neighbour_takes_no_gloss_that_its_observations_deny():
    beta = np.where(LEFT, 3.0, 0.0)
    _, _, pooled = patch(beta, 0.05, poses=40)
    assert (pooled.status[~LEFT] == Status.POOLED).mean() < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_many_matt_texels_does_not_become_gloss(seed):
    _, alone, pooled = patch(0.0, 0.1, noise=(1e-4, 1e-3), seed=seed)
    assert (alone.status == Status.MU_UNIDENTIFIABLE).sum() > 2  # there is something to be taken in by
    assert (pooled.status == Status.POOLED).mean() < 0.005


def test_gloss_that_nobody_around_can_tell_stays_unknown():
    geometry = np.tile(in_plane([45.0] * 8, [40.0] * 8), (SIDE * SIDE, 1, 1))  # one geometry, repeated
    alpha = np.full(SIDE * SIDE, 0.3)
    response = rendered(alpha, np.full(alpha.shape, 4.0), np.full(alpha.shape, 0.1), geometry, CAMERA, 3)
    alone, pooled = both(response, geometry)
    assert (alone.status != Status.OK).all() and (pooled.status != Status.POOLED).all()
    np.testing.assert_array_equal(pooled.status, alone.status)


def test_a_tile_is_a_neighbourhood_of_its_own_and_rows_do_not_join():
    geometry = sphere_tile()
    alpha = np.random.default_rng(1).uniform(0.05, 0.8, SIDE * SIDE)
    response = rendered(alpha, np.full(alpha.shape, 3.0), np.full(alpha.shape, 0.05), geometry, CAMERA, 1)
    _, whole = both(response, geometry)
    half = SIDE * SIDE // 2
    _, upper = both(response[:half], geometry[:half])
    inner = np.arange(half) < half - RADIUS * SIDE  # further from the border than a neighbourhood reaches
    np.testing.assert_array_equal(whole.status[:half][inner], upper.status[inner])
    np.testing.assert_allclose(whole.mu[:half][inner], upper.mu[inner], rtol=1e-9, equal_nan=True)
    # The last texel of a row and the first of the next are not neighbours: with a column for a row, nobody is beside.
    order = np.arange(SIDE * SIDE).reshape(SIDE, SIDE).T.ravel()
    _, turned = both(response[order], geometry[order])
    np.testing.assert_array_equal(turned.status, whole.status[order])


def test_without_a_radius_nothing_is_pooled_and_what_cannot_be_is_refused():
    geometry = sphere_tile()
    alpha = np.full(SIDE * SIDE, 0.3)
    response = rendered(alpha, np.full(alpha.shape, 3.0), np.full(alpha.shape, 0.05), geometry, CAMERA, 1)
    alone, same = both(response, geometry, radius=0)
    assert same is alone and (alone.pooled_from == 0).all()
    with pytest.raises(ValueError, match="accepted: whole rows"):
        both(response, geometry, width=SIDE + 1)
    with pytest.raises(ValueError, match="pooling_radius_texels 9; accepted: 0 to 8"):
        FitOptions(pooling_radius_texels=9)
    nothing, pooled = both(np.zeros((0, 5)), np.zeros((0, 5, 4)), width=1)
    assert len(pooled.status) == 0 and pooled.status.dtype == nothing.status.dtype


@pytest.mark.stability(stage="fit", case="random data")
@given(
    response=npst.arrays(np.float32, (12, 9), elements=st.floats(-10, 10, width=32) | st.just(np.nan)),
    angles=npst.arrays(np.float32, (12, 9, 4), elements=st.floats(0.0, 1.75, width=32) | st.just(np.nan)),
    weight=npst.arrays(np.float32, (12, 9), elements=st.sampled_from([0.0, 1.0])),
    known=st.booleans(),
    options=st.sampled_from([{}, {"huber": 2.0}, {"weights": "equal"}, {"refractive_index": "fitted"}]),
)  # fmt: skip
@settings(deadline=None, max_examples=60)
def test_whatever_the_data_pooling_ends_finite_or_flagged(response, angles, weight, known, options):
    with np.errstate(invalid="ignore", over="ignore"):
        alone, pooled = both(response, angles, weight, 4, 2, CAMERA if known else None, **options)
    stated = np.isin(pooled.status, (Status.OK, Status.POOLED))
    for name in ("beta", "mu", "beta_error", "mu_error"):
        assert np.array_equal(np.isfinite(getattr(pooled, name)), stated)
    for name, (low, high) in (("alpha", (0, 2)), ("beta", (0, 1e4)), ("mu", (0.005, 1.2))):
        values = getattr(pooled, name)[pooled.status == Status.POOLED]
        assert ((values >= low) & (values <= high)).all()
    untouched = ~np.isin(alone.status, (Status.MU_UNIDENTIFIABLE, Status.AT_BOUND, Status.DIFFUSE_ONLY))
    np.testing.assert_array_equal(pooled.status[untouched], alone.status[untouched])


def test_pooled_errors_know_how_gloss_varies_in_the_neighbourhood():
    rng = np.random.default_rng(12)
    beta = 3.0 * np.exp(0.25 * rng.normal(size=SIDE * SIDE))
    _, _, pooled = patch(beta, 0.08)
    new = pooled.status == Status.POOLED
    assert new.sum() > 10
    off = np.abs(pooled.beta / beta - 1)[new] / (pooled.beta_error / pooled.beta)[new]
    assert (off < 2).mean() > 0.85


def test_nothing_is_pooled_where_the_noise_is_not_known():
    geometry = sphere_tile()
    response = rendered(
        np.full(SIDE * SIDE, 0.3), np.full(SIDE * SIDE, 3.0), np.full(SIDE * SIDE, 0.08), geometry, CAMERA, 1
    )
    alone, pooled = both(response, geometry, camera=None)
    assert (pooled.status == alone.status).all() and not pooled.pooled_from.any()
