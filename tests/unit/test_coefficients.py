"""Coefficients in files: half precision keeps eleven bits of any range, and what is damaged is refused."""

import itertools
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from irodori.core import store
from irodori.core.errors import InputError
from irodori.jit.half_precision import half_from_single, single_from_half
from irodori.material.coefficients import (
    from_half,
    half_scale,
    read_coefficients,
    to_half,
    write_coefficients,
)

PROVENANCE = store.Provenance("test")
REUSED = [HealthCheck.function_scoped_fixture]


@given(
    seed=st.integers(0, 2**32 - 1),
    decades=st.floats(0, 8),
    unit=st.sampled_from([1e-30, 1e-3, 1.0, 1e6, 1e30]),
)
@settings(deadline=None, max_examples=60)
def test_half_precision_keeps_eleven_bits_over_eight_decades(seed, decades, unit):
    rng = np.random.default_rng(seed)
    values = rng.choice([-1, 1], (200, 3)) * unit * 10 ** -rng.uniform(0, decades, (200, 3))
    values = values.astype(np.float32)
    scale = half_scale(np.abs(values).max(axis=0))
    assert np.array_equal(np.exp2(np.round(np.log2(scale))).astype(np.float32), scale)
    back = from_half(to_half(values, scale), scale)
    assert np.abs(back / values - 1).max() <= 2.0**-11
    # What was rounded once is kept as it is, with any other scale that fits.
    other = half_scale(3 * np.abs(values).max(axis=0))
    assert np.array_equal(from_half(to_half(back, other), other), back)


def test_rounding_is_to_the_nearest_half_as_ieee_754_has_it():
    every = np.arange(1 << 16, dtype=np.uint16).view(np.float16)
    finite = every[np.isfinite(every)]
    between = 0.5 * (finite[:-1].astype(np.float64) + finite[1:])
    with np.errstate(over="ignore"):
        values = np.concatenate([finite, between, between * (1 + 1e-7)]).astype(np.float32)
        values = values[np.abs(values) < 65504]
    found = half_from_single(values)
    assert found.dtype == np.float16 and np.array_equal(found, values.astype(np.float16))
    assert np.isnan(half_from_single(np.array([[np.nan, 1.0]], np.float32))[0, 0])
    assert half_from_single(np.zeros((0, 4), np.float32)).shape == (0, 4)
    assert np.array_equal(single_from_half(every), every.astype(np.float32), equal_nan=True)
    ones = np.ones(1, np.float32)
    assert np.array_equal(from_half(finite[:, None], ones)[:, 0], finite.astype(np.float32))


def test_a_bound_that_is_not_finite_has_no_scale():
    with pytest.raises(ValueError, match="accepted"):
        half_scale([1.0, np.inf])


@pytest.mark.parametrize(("storage", "codec"), [*itertools.product(["half", "single"], ["gzip", "lzf"])])
def test_coefficients_come_back_from_their_file(tmp_path, storage, codec):
    rng = np.random.default_rng(9)
    values = (rng.normal(size=(60, 50, 5)) * [1e5, 1, 1e-3, 1e-12, 0]).astype(np.float32)
    values[10:12] = np.nan
    with store.create(tmp_path / "c.h5", PROVENANCE) as out:
        write_coefficients(out, "map/c", values, quantity="coefficients", storage=storage, codec=codec)
    with store.open_file(tmp_path / "c.h5") as file:
        found, part = read_coefficients(file, "map/c"), read_coefficients(file, "map/c", slice(5, 20))
        assert file.dataset("map/c").dtype.itemsize == (2 if storage == "half" else 4)
    assert found.dtype == np.float32 and np.array_equal(part, found[5:20], equal_nan=True)
    assert np.array_equal(np.isnan(found), np.isnan(values))
    error = np.nanmax(np.abs(found - values) / np.nanmax(np.abs(values) + 1e-30, axis=(0, 1)))
    assert error <= (2.0**-11 if storage == "half" else 0)


def test_half_precision_without_its_scale_and_integers_are_refused(tmp_path):
    with store.create(tmp_path / "c.h5", PROVENANCE) as out:
        names = {"units": "1", "dims": "row,column,component", "quantity": "coefficients"}
        out.write("half", np.ones((2, 3, 4), np.float16), **names)
        out.write("whole", np.ones((2, 3, 4), np.int32), **names)
        out.write("other", np.ones((2, 3, 4), np.float16), **names)
        out.write("other_scale", np.ones(3), units="1", dims="three", quantity="scale")
    with store.open_file(tmp_path / "c.h5") as file:
        for name, found in (("half", "no such dataset"), ("whole", "int32"), ("other", r"shape \(3,\)")):
            with pytest.raises(InputError, match=found):
                read_coefficients(file, name)


@given(share=st.floats(0.0, 1.0, exclude_max=True), storage=st.sampled_from(["half", "single"]))
@settings(deadline=None, suppress_health_check=REUSED, max_examples=40)
def test_a_file_of_coefficients_cut_short_anywhere_is_refused(tmp_path, share, storage):
    path = tmp_path / f"{storage}.h5"
    values = np.random.default_rng(11).normal(size=(100, 80, 4)).astype(np.float32)
    with store.create(path, PROVENANCE) as out:
        write_coefficients(out, "c", values, quantity="coefficients", storage=storage, codec="lzf")
    path.write_bytes(path.read_bytes()[: int(share * os.path.getsize(path))])
    with pytest.raises(InputError, match="accepted"), store.open_file(path) as file:
        read_coefficients(file, "c")
