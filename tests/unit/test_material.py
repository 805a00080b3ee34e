"""The material: gaps, files, and what rendering makes of them."""

import dataclasses

import numpy as np
import pytest
from scenes import (
    ONES,
    material,
)

from irodori.core import store
from irodori.material.material_file import Material


def test_gaps_take_the_nearest_observed_texel_around_the_seam():
    rng = np.random.default_rng(1)
    height, width = 12, 24
    observed = rng.uniform(size=(height, width)) < 0.1
    observed[:, :8] = False
    observed[5, 23] = True
    code = np.arange(height * width, dtype=np.float64).reshape(height, width) + 1
    known = observed & (rng.uniform(size=observed.shape) < 0.5)
    gaps = Material(
        alpha=np.where(observed, code, np.nan), green_response=np.where(observed, code * 2, np.nan),
        beta=np.where(known, 5.0, np.nan), mu=np.where(known, 0.3, np.nan),
        coefficients=np.where(observed, code * 3, np.nan)[..., None].astype(np.float32), basis=np.ones((61, 1)),
        n=ONES, k=ONES, mirror=0.0, typical_gloss=(7.0, 0.25),
    )  # fmt: skip
    whole, share = gaps.filled()
    assert share == pytest.approx(1 - observed.mean())
    rows, columns = np.nonzero(observed)
    for y in range(height):
        for x in range(width):
            across = np.abs(columns - x)
            distance2 = (rows - y) ** 2 + np.minimum(across, width - across) ** 2
            nearest = code[rows, columns][distance2 == distance2.min()]
            assert whole.alpha[y, x] in nearest
            assert whole.green_response[y, x] == 2 * whole.alpha[y, x]
            assert whole.coefficients[y, x, 0] == 3 * whole.alpha[y, x]
    assert np.array_equal(whole.beta, np.where(known, 5.0, 7.0))
    assert np.array_equal(whole.mu, np.where(known, 0.3, 0.25))
    assert np.array_equal(whole.alpha[observed], code[observed])


def test_a_material_of_gaps_alone_is_refused():
    empty = dataclasses.replace(material(0.5), alpha=np.full((4, 8), np.nan))
    with pytest.raises(ValueError, match="accepted"):
        empty.filled()


def test_a_material_survives_its_file(tmp_path):
    saved = material(np.linspace(0.1, 0.9, 61), beta=np.nan, mu=np.nan, mirror=0.4, n=np.linspace(1.4, 1.6, 61))
    saved.save(tmp_path / "m.h5", store.Provenance("test"))
    loaded = Material.load(tmp_path / "m.h5")
    for field in dataclasses.fields(Material):
        assert np.array_equal(getattr(loaded, field.name), getattr(saved, field.name), equal_nan=field.name != "extra")
    assert np.allclose(loaded.spectra(), np.linspace(0.1, 0.9, 61))
