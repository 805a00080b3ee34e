"""Eight texels fitted at once come out as each of them alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from irodori.fitting import judge
from irodori.fitting.shared_geometry import no_shared
from irodori.fitting.solvers import SOLVERS, FitOptions, _empty_output, problem_of
from irodori.fitting.texels import _fit_chunk
from irodori.fitting.vectorised_texels import fit_eight, new_eight
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.reflection.equation5 import reflect

LIGHT = np.radians(np.array([25.0, 45.0, 65.0]))[np.arange(24) % 3]
CAMERA = LIGHT + np.radians(np.linspace(-22.0, 12.0, 24))
ANGLES = np.stack([LIGHT, np.abs(CAMERA), np.abs(LIGHT + CAMERA) / 2, np.abs(LIGHT - CAMERA) / 2], axis=1)
NOISE = np.tile([1e-6, 1e-5], (len(ANGLES), 1))


def _alone(problem, rules):
    """Fit texel by texel: one geometry for all without its tables is a problem that goes no other way."""
    outputs = []
    for t in range(len(problem.response)):
        here = slice(t, t + 1)
        one = problem._replace(
            response=problem.response[here],
            weight=problem.weight[here],
            geometry=problem.geometry[here] if len(problem.geometry) > 1 else problem.geometry,
            clipped=problem.clipped[here] if len(problem.clipped) > 1 else problem.clipped,
        )
        outputs.append(_empty_output(1))
        run_chunks(_fit_chunk, 1, 1, one, rules, no_shared(), outputs[-1])
    return type(outputs[0])(*(np.concatenate([getattr(o, name) for o in outputs]) for name in outputs[0]._fields))


def _same(together, alone):
    """Assert one outcome: the same minimum, and where the gloss is determined the same parameters and errors."""
    assert_array_equal(together.status, alone.status)
    assert_array_equal(together.model, alone.model)
    assert_array_equal(np.isnan(together.table), np.isnan(alone.table))
    fitted = np.isfinite(alone.table[:, judge.SQUARES])
    one, other = together.table[fitted], alone.table[fitted]
    assert_allclose(one[:, judge.POWER], other[:, judge.POWER], rtol=1e-5)
    slack = 1e-4 * other[:, judge.SQUARES] + 1e-11 * other[:, judge.POWER]
    assert (np.abs(one[:, judge.SQUARES] - other[:, judge.SQUARES]) <= slack).all()
    known = alone.status[fitted] == judge.Status.OK
    for value, error in (
        (judge.ALPHA, judge.ALPHA_ERROR),
        (judge.BETA, judge.BETA_ERROR),
        (judge.LOG_MU, judge.LOG_MU_ERROR),
    ):
        gap = np.abs(one[known, value] - other[known, value])
        assert (gap <= 0.02 * other[known, error] + 2e-5 * np.abs(other[known, value])).all()
        assert_allclose(one[known, error], other[known, error], rtol=0.02, atol=1e-9)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("noise", [None, NOISE])
@given(
    seed=st.integers(0, 10_000),
    level=st.sampled_from([0.0, 0.003, 0.01, 0.05, 0.3]),
    scale=st.sampled_from([1.0, 1e-5, 1e5]),
    holes=st.sampled_from([0.0, 0.1, 0.7]),
    count=st.integers(1, 19),
)
@settings(max_examples=25, deadline=None)
def test_eight_at_once_are_as_each_alone(shared, noise, seed, level, scale, holes, count):
    rng = np.random.default_rng(seed)
    geometry = ANGLES if shared else ANGLES + np.radians(rng.uniform(0.0, 2.0, (count, 1, 4)))
    truth = (
        rng.uniform(0.0, 0.95, (count, 1)),
        10 ** rng.uniform(-2, 1.5, (count, 1)),
        rng.uniform(0.02, 0.5, (count, 1)),
    )
    clean = reflect(truth[0], 1.0, truth[1] * (rng.random((count, 1)) < 0.8), truth[2], geometry)
    response = scale * clean * (1.0 + level * rng.normal(size=clean.shape))
    weight = (rng.random(response.shape) >= holes).astype(np.float64)
    if holes:
        response[rng.random(response.shape) < 0.02] = np.nan
    clipped = rng.random(response.shape) < 0.002
    options = FitOptions()
    variance = None if noise is None else noise * [scale**2, scale]
    problem, rules = problem_of(response, geometry, weight, 1.5, 0.0, options, noise=variance, clipped=clipped)
    _same(SOLVERS["varpro"](problem, rules, options), _alone(problem, rules))


@njit(cache=True)
def _done(problem, rules, captures):
    return fit_eight(problem, no_shared(), rules, 0, len(problem.response), new_eight(captures, problem.nodes.size))


@pytest.mark.parametrize("count", [8, 5])
@pytest.mark.parametrize("noise", [None, NOISE])
def test_ordinary_texels_are_fitted_together_and_others_handed_back(count, noise):
    rng = np.random.default_rng(4)
    truth = rng.uniform(0.1, 0.9, (count, 1)), rng.uniform(1.0, 6.0, (count, 1)), rng.uniform(0.06, 0.3, (count, 1))
    geometry = np.tile(ANGLES, (count, 1, 1))
    response = reflect(truth[0], 1.0, truth[1], truth[2], geometry) * (
        1 + 0.005 * rng.normal(size=(count, len(ANGLES)))
    )
    response[2] = reflect(0.5, 1.0, 0.0, 0.1, ANGLES)  # matt: another model
    weight = np.ones_like(response)
    weight[4, 3:] = 0.0  # too few
    problem, rules = problem_of(response, geometry, weight, 1.5, 0.0, FitOptions(), noise=noise)
    assert _done(problem, rules, len(ANGLES)) == (1 << count) - 1 - (1 << 2) - (1 << 4)


def test_repeated_geometries_are_no_new_observations():
    few = np.repeat(ANGLES[:3], 8, axis=0)
    response = np.tile(reflect(0.5, 1.0, 2.0, 0.1, few), (8, 1))
    options = FitOptions()
    problem, rules = problem_of(response, few, np.ones_like(response), 1.5, 0.0, options, noise=None)
    _same(SOLVERS["varpro"](problem, rules, options), _alone(problem, rules))
