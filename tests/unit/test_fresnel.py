"""Fresnel reflectance against complex amplitudes, for numbers and vectors of both precisions."""

import math

import numba
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from irodori.jit.vector_memory import load, store
from irodori.reflection.fresnel import fresnel

#: Largest relative error, some units in the last place.
TOLERANCE = {np.float64: 2e-15, np.float32: 1e-6}
#: Grazing and normal incidence and what is near them; dielectrics, metals, and what is hardly a surface.
NEAR_ZERO = st.floats(-12.0, 0.0).map(lambda e: 10.0**e)
COSINE = st.one_of(st.floats(0.0, 1.0), NEAR_ZERO, NEAR_ZERO.map(lambda x: 1.0 - x), st.sampled_from([0.0, 1.0]))
INDEX = st.one_of(st.floats(0.01, 30.0), NEAR_ZERO.map(lambda x: 1.0 + x), NEAR_ZERO.map(lambda x: 1.0 - 0.99 * x))
ABSORPTION = st.one_of(st.just(0.0), st.floats(0.0, 100.0), NEAR_ZERO)


def complex_fresnel(cosine, n, k):
    """The mean of R_s and R_p from complex amplitudes, with more digits than float64 has."""
    cosine, n, k = (np.longdouble(x) for x in (cosine, n, k))
    if n == 1 and k == 0:
        return np.longdouble(0)  # no surface at all
    index = n + 1j * k
    # (n + ik)² - sin² without the cancellation at grazing incidence.
    inside = np.sqrt((n - 1) * (n + 1) - k * k + cosine * cosine + 2j * n * k)
    if inside == 0:
        return np.longdouble(1)
    s = (cosine - inside) / (cosine + inside)
    p = (index**2 * cosine - inside) / (index**2 * cosine + inside)
    return (abs(s) ** 2 + abs(p) ** 2) / 2


def tolerance(cosine, n, k, exact, dtype) -> float:
    """Relative, but near the critical angle n² = sin²: a branch point, where the root of a rounding shows."""
    distance = abs(complex(n, k) ** 2 - 1.0 + float(cosine) ** 2)
    rounding = float(np.finfo(dtype).eps)
    branch = 8.0 * min(math.sqrt(rounding), rounding / math.sqrt(distance + 1e-300)) if distance < 1e-2 < exact else 0.0
    return TOLERANCE[dtype] * float(exact) + branch + 1e-22  # the last is the rounding of the amplitudes


@numba.njit
def _vectors(cosine, n, k, out):
    store(out, 0, fresnel(load(cosine, 0), load(n, 0), load(k, 0)))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@given(cases=st.lists(st.tuples(COSINE, INDEX, ABSORPTION), min_size=8, max_size=8))
@example(cases=[(0.0, 1.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.999, 0.0), (0.0, 1.5, 0.0), (0.2, 1.5, 100.0),
                (1.0, 0.011, 0.0), (0.6, 0.8, 0.0), (0.5, 1.0 + 1e-6, 0.0)])  # fmt: skip
@settings(deadline=None, max_examples=100)
def test_numbers_and_vectors_agree_with_complex_amplitudes(dtype, cases):
    given_ = np.array(cases, dtype).T.copy()
    out = np.empty(8, dtype)
    _vectors(*given_, out)
    for found, case in zip(out, given_.T, strict=True):
        exact = complex_fresnel(*case)
        assert 0.0 <= found <= 1.0
        assert abs(found - exact) <= tolerance(*case, exact, dtype)
        assert abs(fresnel(*map(float, case)) - exact) <= tolerance(*case, exact, np.float64)


def test_cosines_beyond_their_range_are_those_at_its_ends():
    assert fresnel(-0.1, 1.5, 0.0) == fresnel(np.nan, 1.5, 0.0) == 1.0
    assert fresnel(1.1, 1.5, 0.0) == fresnel(1.0, 1.5, 0.0) == pytest.approx(0.04, rel=1e-15)


def test_no_surface_reflects_nothing_at_any_angle():
    assert {fresnel(c, 1.0, 0.0) for c in (0.0, 1e-300, 1e-20, 0.5, 1.0)} == {0.0}
