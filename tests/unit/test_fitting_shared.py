"""One geometry for all texels: its tables hold what the sums over observations hold."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from irodori.fitting.shared_geometry import padded_nodes, scan_shared, tabulate
from irodori.fitting.solvers import FitOptions, fit
from irodori.fitting.texel_rows import WEIGHT, WEIGHTED_COSINE, WEIGHTED_RESPONSE, new_rows, pack_geometry
from irodori.fitting.varpro import SUMS, moments
from irodori.jit.table_sums import Place, vector_times_table
from irodori.jit.vector_memory import aligned
from irodori.jit.vectors import LANES
from irodori.material.material_file import Status
from irodori.reflection.equation5 import reflect
from irodori.reflection.lobes import Lobes
from irodori.reflection.registry import names

NODES = FitOptions().nodes()
_times_16 = vector_times_table(2 * LANES, 2)


@numba.njit
def _multiply(vectors, table, sums):
    """Put the second vector times the second table into the second row of the sums."""
    size = vectors.shape[1] * 2 * LANES
    _times_16(vectors, 1, Place(table, size), Place(sums, 2 * LANES))


def poses(light_deg, camera_deg) -> np.ndarray:
    light, camera = np.radians(np.asarray(light_deg, float)), np.radians(np.asarray(camera_deg, float))
    return np.stack([light, np.abs(camera), np.abs(light + camera) / 2, np.abs(light - camera) / 2], axis=-1)


def block_of(geometry, lobes: Lobes, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    block = new_rows(len(geometry))
    pack_geometry(geometry, lobes, 1.5, 0.0, False, block)
    filled = [WEIGHT, WEIGHTED_COSINE, WEIGHTED_RESPONSE]
    block[filled] = 0.0
    block[filled, : len(geometry)] = rng.uniform(0.1, 2.0, (3, len(geometry)))
    return block


@pytest.mark.parametrize("name", names())
@given(spread=st.floats(0.5, 60.0), seed=st.integers(0, 99))
def test_tables_hold_the_sums_and_their_slopes_at_every_node(name, spread, seed):
    lobes = Lobes((name,))
    light = np.array([20.0, 40.0, 60.0])[np.arange(13) % 3]
    block = block_of(poses(light, light - np.linspace(0.0, spread, 13)), lobes, seed)
    sums = aligned(SUMS * padded_nodes(NODES.size)).reshape(SUMS, -1)
    scan_shared(block, tabulate(block, lobes, NODES), sums, True)
    for i, log_mu in enumerate(NODES):
        expected = np.array(moments(block, lobes, log_mu))[[0, 3, 6, 1, 4, 7]]
        # Slopes of either sign cancel: their digits are those of the largest sum.
        slack = 1e-14 * np.abs(expected).max() + 1e-70
        np.testing.assert_allclose(sums[:6, i], expected, rtol=1e-12, atol=slack)


@pytest.mark.parametrize("mu_rad", [(0.005, 1.2), (0.03, 0.031), (0.1, 0.9)])
def test_one_geometry_for_all_gives_what_a_geometry_each_gives(mu_rad):
    rng = np.random.default_rng(3)
    light = np.array([25.0, 45.0, 65.0])[np.arange(37) % 3]
    geometry = poses(light, light - np.linspace(-12.0, 20.0, 37))
    alpha, beta = rng.uniform(0.0, 0.9, (400, 1)), 10 ** rng.uniform(-1.5, 1.2, (400, 1))
    mu = np.exp(rng.uniform(np.log(0.004), np.log(1.5), (400, 1)))  # some beyond the bounds
    clean = reflect(alpha, 1.0, beta, mu, geometry[None], n=1.5, k=0.0)
    response = clean * (1 + 0.01 * rng.normal(size=clean.shape))
    options = FitOptions(bounds={"mu_rad": list(mu_rad)})
    noise = np.tile([1e-6, 1e-5], (37, 1))
    one = fit(response, geometry, np.ones_like(response), options=options, noise=noise)
    each = fit(response, np.tile(geometry, (400, 1, 1)), np.ones_like(response), options=options, noise=noise)
    assert (one.status == each.status).mean() > 0.995
    both = (one.status == Status.OK) & (each.status == Status.OK)
    np.testing.assert_allclose(one.residual_rms[both], each.residual_rms[both], rtol=1e-6)
    for name in ("alpha", "beta", "mu"):
        error = getattr(each, f"{name}_error")[both]
        assert (np.abs(getattr(one, name) - getattr(each, name))[both] < 1e-3 * error).all(), name
        np.testing.assert_allclose(getattr(one, f"{name}_error")[both], error, rtol=1e-3, err_msg=name)


@given(seed=st.integers(0, 10_000), noise=st.sampled_from([1e-4, 0.02, 0.3]), holes=st.sampled_from([0.0, 0.1, 0.7]),
       known=st.booleans())  # fmt: skip
@settings(max_examples=12, deadline=None)
def test_the_error_of_alpha_does_not_depend_on_whether_the_geometry_is_shared(seed, noise, holes, known):
    """Poses at random: where one photograph alone sees the lobe, β and μ are anything along a valley, and α is not."""
    rng = np.random.default_rng(seed)
    geometry = poses(rng.uniform(0.0, 80.0, 24), rng.uniform(-80.0, 80.0, 24))
    alpha, beta = rng.uniform(0.0, 0.95, (600, 1)), 10 ** rng.uniform(-2.0, 1.5, (600, 1))
    mu = np.exp(rng.uniform(np.log(0.01), np.log(1.2), (600, 1)))
    clean = reflect(alpha, 1.0, beta * (rng.random((600, 1)) < 0.8), mu, geometry[None], n=1.5, k=0.0)
    response = clean * (1 + noise * rng.normal(size=clean.shape))
    weight = (rng.random(response.shape) >= holes).astype(np.float64)
    variance = np.tile([1e-6, 1e-5], (24, 1)) if known else None
    one, each = (fit(response, angles, weight, noise=variance) for angles in (geometry, np.tile(geometry, (600, 1, 1))))
    # In a valley without a floor a search may end elsewhere; that is another minimum, and another error. Of those that
    # agree, one in 600 was seen to differ by 1e-5: the lowest point of a valley that is almost flat.
    same = np.isclose(one.residual_rms, each.residual_rms, rtol=1e-6) | np.isnan(one.residual_rms)
    assert same.mean() > 0.995
    np.testing.assert_array_equal(one.status[same], each.status[same])
    np.testing.assert_allclose(one.alpha_error[same], each.alpha_error[same], rtol=1e-4)
    assert (np.abs(one.alpha_error / each.alpha_error - 1)[same] > 1e-6).sum() <= 1


@given(
    hnp.arrays(np.float64, st.integers(1, 9).map(lambda n: (2, 8 * n)), elements=st.floats(-1e3, 1e3)),
    st.integers(0, 99),
)
def test_a_vector_times_a_table_is_the_matrix_product(vectors, seed):
    table = np.random.default_rng(seed).normal(size=(2, vectors.shape[1], 2 * LANES))
    sums = aligned(2 * 2 * LANES).reshape(2, 2 * LANES)
    _multiply(vectors, np.ascontiguousarray(table), sums)
    scale = np.abs(vectors).max() * vectors.shape[1]
    np.testing.assert_allclose(sums, [[0.0] * 2 * LANES, vectors[1] @ table[1]], atol=1e-13 * scale)


def test_aligned_memory_begins_with_a_line_of_the_cache():
    assert {aligned(n).ctypes.data % 64 for n in range(1, 40)} == {0}
    assert all(aligned(n).shape == (n,) and not aligned(n).any() for n in (1, 7, 100))
