"""Spectra below zero, and products of spectra: what compression leaves that its colour error does not show."""

import numpy as np
import pytest
from compressing import compress
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.colour.colorimetry import xyz_from_reflectance
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.material.principal_components.repeated_reflection import drift
from irodori.rendering.reference.band_loops import BANDS, decode, padded
from irodori.spectra.published import spectrum


def observers() -> dict:
    return {name: (matrix := xyz_from_reflectance(name), matrix.sum(axis=1)) for name in ("D65", "A")}


WAVELENGTHS = padded(np.eye(BANDS))[None]


def guarded(spectra):
    """Spectra as rendering decodes them from coefficients, each a wavelength."""
    out = np.zeros((len(spectra), WAVELENGTHS.shape[2]), dtype=np.float32)
    for row, coefficients in zip(out, spectra, strict=True):
        decode(WAVELENGTHS, 0, BANDS, coefficients, row)
    assert (out[:, BANDS:] == 0).all()
    return out[:, :BANDS].astype(np.float64)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=40)
def test_rendering_leaves_nothing_below_zero_and_adds_no_light(seed):
    spectra = np.random.default_rng(seed).normal(0.2, 0.3, (50, 61))
    found = guarded(spectra)
    assert (found >= 0).all()
    assert np.allclose(found.sum(axis=1), np.maximum(spectra.sum(axis=1), 0), rtol=1e-4, atol=1e-4)
    assert np.allclose(guarded(np.abs(spectra)), np.abs(spectra), rtol=1e-6)


def test_clipping_would_brighten_dark_noise_and_rendering_does_not():
    rng = np.random.default_rng(12)
    noisy = 0.02 + 0.02 * rng.standard_normal((4000, 61))
    assert np.maximum(noisy, 0).mean() > 1.05 * noisy.mean()
    assert guarded(noisy).mean() == pytest.approx(noisy.mean(), rel=1e-6)


# --- repeated reflection


@pytest.mark.stability(stage="compress", case="drift of products")
def test_errors_of_products_grow_with_the_reflections_as_relative_errors_add():
    truth = np.tile(np.linspace(0.3, 0.6, 61), (50, 1))
    decoded = truth * 1.01
    rows = drift(truth, decoded, np.linalg.qr(np.stack([truth[0] ** n for n in range(6)], axis=1))[0], observers())
    assert [row["reflections"] for row in rows] == [1, 2, 3, 4, 5]
    rmse = np.array([row["rmse"] for row in rows])
    level = np.array(
        [np.sqrt(np.mean(truth[0] ** (2 * n))) * truth.mean() / np.mean(truth[0] ** n) for n in range(1, 6)]
    )
    assert np.allclose(rmse, (1.01 ** np.arange(1, 6) - 1) * level, rtol=1e-9)
    # The powers of the spectrum up to the fifth are in the span: bringing products back to it costs nothing.
    assert np.allclose([row["projected_rmse"] for row in rows], rmse, rtol=1e-6)


def test_products_leave_the_span_and_projecting_them_costs_more():
    source = np.stack([spectrum(f"TCS{i}") for i in range(99)])
    done = compress(source, None, observers(), CompressOptions(storage="single"), bases=6)
    rows = drift(source, done.coefficients @ done.basis.T, done.basis, observers())
    means = [row["delta_e"]["D65"]["mean"] for row in rows]
    assert (np.diff(means) > 0).all()
    first, last = rows[0], rows[-1]
    assert first["projected_rmse"] == pytest.approx(first["rmse"], rel=1e-3)
    assert last["projected_rmse"] > 1.2 * last["rmse"]
    exact = drift(source, source, np.eye(61), observers())
    assert max(row["rmse"] for row in exact) == 0 and max(row["projected_delta_e"]["A"]["max"] for row in exact) < 1e-6


@pytest.mark.stability(stage="compress", case="all-black")
def test_a_black_picture_stays_black_through_all_reflections():
    rows = drift(np.zeros((3, 61)), np.zeros((3, 61)), np.eye(61)[:, :2], observers())
    assert all(row["rmse"] == 0 and row["delta_e"]["D65"]["max"] == 0 for row in rows)
