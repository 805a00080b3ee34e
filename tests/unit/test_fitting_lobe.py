"""The fit's own form of the gloss, which its loops vectorise."""

import numpy as np
import pytest

from irodori.fitting.texel_rows import COSINE, GLOSS, ROWS, SPOILED, SQUARE, pack_geometry, padded
from irodori.reflection.equation5 import gloss_factors


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.2), (1.0001, 0.0)])
def test_vector_form_of_the_gloss_is_that_of_the_reflection_model(n, k):
    geometry = np.random.default_rng(0).uniform(0.0, 1.7, (53, 4))
    block = np.zeros((ROWS, padded(53)))
    pack_geometry(geometry, n, k, np.zeros((4, padded(53))), block)
    np.testing.assert_allclose(block[GLOSS, :53], gloss_factors(geometry, n, k), rtol=1e-12, atol=1e-15)
    seen = (geometry[:, :2] < np.pi / 2).all(axis=1)
    np.testing.assert_allclose(block[COSINE, :53], np.cos(geometry[:, 0]) * seen, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(block[SQUARE, :53], geometry[:, 3] ** 2, rtol=1e-14)
    assert (block[SPOILED] == 0).all()
