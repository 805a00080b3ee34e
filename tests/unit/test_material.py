"""The material: gaps, files, and what rendering makes of them."""

import dataclasses

import h5py
import numpy as np
import pytest
from scenes import (
    ONES,
    material,
)

from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError
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
    told = np.isin(whole.alpha, code[known])  # gloss comes with the colour
    assert np.array_equal(whole.beta, np.where(told, 5.0, 7.0))
    assert np.array_equal(whole.mu, np.where(told, 0.3, 0.25))
    assert np.array_equal(whole.alpha[observed], code[observed])


def test_a_material_of_gaps_alone_is_refused():
    empty = dataclasses.replace(material(0.5), alpha=np.full((4, 8), np.nan))
    with pytest.raises(ValueError, match="accepted"):
        empty.filled()


def same(a: Material, b: Material) -> bool:
    apart = ("extra", "lobes", "through", "back", "transmittance", "coat")
    names = [field.name for field in dataclasses.fields(Material) if field.name not in apart]
    alike = all(np.array_equal(getattr(a, n), getattr(b, n), equal_nan=True) for n in names)
    if a.through is not None or b.through is not None:
        alike &= np.array_equal(a.through.spectra(), b.through.spectra())
    return alike and (a.lobes, a.transmittance, a.coat) == (b.lobes, b.transmittance, b.coat)


def test_a_material_survives_its_file(tmp_path):
    saved = material(np.linspace(0.1, 0.9, 61), beta=np.nan, mu=np.nan, mirror=0.4, n=np.linspace(1.4, 1.6, 61))
    sheet = Material.diffuse(np.random.default_rng(3).random((4, 8, 2), dtype=np.float32), np.ones((61, 2)))
    for one in (
        dataclasses.replace(saved, through=sheet, transmittance="assumed"),
        dataclasses.replace(saved, coat="coupled"),
    ):
        one.save(tmp_path / "m.h5", store.Provenance("test"))
        loaded = Material.load(tmp_path / "m.h5")
        assert same(loaded, one)
    assert np.allclose(loaded.spectra(), np.linspace(0.1, 0.9, 61))


def two_components() -> Material:
    return Material.uniform(0.3, 2.0, 0.4, lobes=("ggx", "gaussian"), further_gloss=((5.0, 0.05),))


def test_every_gloss_component_survives_the_file_in_the_unit_of_its_lobe(tmp_path):
    saved = two_components()
    saved.save(tmp_path / "m.h5", store.Provenance("test"))
    loaded = Material.load(tmp_path / "m.h5")
    assert same(loaded, saved) and loaded.typical_gloss == (2.0, 0.4, 5.0, 0.05)
    assert [(name, beta[0, 0], mu[0, 0]) for name, beta, mu in loaded.gloss] == [
        ("ggx", 2.0, 0.4), ("gaussian", 5.0, 0.05)
    ]  # fmt: skip
    with store.open_file(tmp_path / "m.h5") as file:
        assert [file.dataset(name).attrs["units"] for name in ("mu", "mu_2")] == ["1", "rad"]


def test_gaps_of_a_component_take_its_own_typical_gloss():
    gaps = two_components()
    hole = np.array([[True, False], [False, False]])
    (_, beta, mu), (_, beta_2, mu_2) = gaps.gloss
    gaps = gaps.with_gloss([(beta, mu), (np.where(hole, np.nan, beta_2 * 3), mu_2 * 2)])
    whole, _ = gaps.filled()
    assert np.array_equal(whole.beta, beta) and np.array_equal(whole.mu, mu)
    (further,) = whole.further_gloss
    assert np.array_equal(further[0], np.where(hole, 5.0, 15.0)) and np.array_equal(
        further[1], np.where(hole, 0.05, 0.1)
    )
    # A component that reflects nothing has no roughness to be known.
    nothing = gaps.with_gloss([(beta, mu), (np.where(hole, 0.0, beta_2), np.where(hole, np.nan, mu_2))])
    (further,) = nothing.filled()[0].further_gloss
    assert np.array_equal(further[0], np.where(hole, 0.0, beta_2)) and np.isfinite(further[1]).all()
    # Beside the surface a texel has all components of the nearest that lies on it.
    padded, _ = gaps.filled(np.array([[False, True], [False, True]]))
    assert np.array_equal(padded.further_gloss[0][0], np.full((2, 2), 15.0))


def test_the_components_of_a_material_fit_together():
    with pytest.raises(ValueError, match="accepted: 2, one a lobe"):
        dataclasses.replace(material(0.5), lobes=("gaussian", "ggx"))
    with pytest.raises(ValueError, match="no lobe 'beckmann'"):
        dataclasses.replace(material(0.5), lobes=("beckmann",))


def test_a_file_names_its_lobes_or_is_of_the_version_that_knew_one(tmp_path):
    path = tmp_path / "m.h5"
    two_components().save(path, store.Provenance("test"))
    with h5py.File(path, "r+") as file:
        file.attrs["lobes"] = 'json:["ggx", "beckmann"]'
    accept(path)
    with pytest.raises(InputError, match=r"lobes: found ggx, beckmann; accepted: one or more of: gaussian, ggx"):
        Material.load(path)
    material(0.5).save(path, store.Provenance("test"))
    with h5py.File(path, "r+") as file:
        del file.attrs["lobes"]
    accept(path)
    with pytest.raises(InputError, match="lobes: found no such attribute"):
        Material.load(path)
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = 1
    accept(path)
    assert Material.load(path).lobes == ("gaussian",)
