"""The fit's own form of the gloss, which its loops vectorise."""

import numpy as np
import pytest
from equation5_written_out import gloss_factors
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.fitting.texel_rows import COSINE, F0, GLOSS, LOBE, SPOILED, fill_lobe, new_rows, pack_geometry
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import Lobes
from irodori.reflection.registry import lobe, names

GAUSSIAN = Lobes(("gaussian",))


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.2), (1.0001, 0.0)])
def test_vector_form_of_the_gloss_is_that_of_the_reflection_model(n, k):
    geometry = np.random.default_rng(0).uniform(0.0, 1.7, (53, 4))
    rows = new_rows(53)
    pack_geometry(geometry, GAUSSIAN, n, k, False, rows)
    np.testing.assert_allclose(rows[GLOSS, :53], gloss_factors(geometry, n, k), rtol=1e-12, atol=1e-15)
    seen = (geometry[:, :2] < np.pi / 2).all(axis=1)
    np.testing.assert_allclose(rows[COSINE, :53], np.cos(geometry[:, 0]) * seen, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(rows[F0, :53], geometry[:, 3] ** 2, rtol=1e-14)
    assert (rows[SPOILED] == 0).all()


@pytest.mark.parametrize("name", names())
def test_rows_of_a_texel_hold_the_value_of_its_lobe(name):
    geometry, log_mu = np.random.default_rng(1).uniform(0.0, 1.4, (21, 4)), np.log(0.2)
    rows, kind = new_rows(21), lobe(name)
    pack_geometry(geometry, Lobes((name,)), 1.5, 0.0, False, rows)
    fill_lobe(rows, Lobes((name,)), log_mu)
    for j, (theta_i, theta_r, theta_h, phi) in enumerate(geometry):
        factor, *features = kind.features(np.cos(theta_i), np.cos(theta_r), np.cos(phi), np.cos(theta_h), phi)
        expected = fresnel(np.cos(theta_h), 1.5, 0.0) * factor * kind.value(kind.constants(log_mu), *features)
        assert rows[LOBE, j] == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("name", names())
@given(phi=st.floats(0.01, 1.2), mu=st.floats(0.02, 1.0))
@settings(deadline=None)
def test_a_lobe_falls_from_its_peak_as_its_flank_says(name, phi, mu):
    kind, step = lobe(name), 1e-5
    constant = kind.constants(np.log(mu))

    def share(angle):
        _, *features = kind.features(0.8, 0.7, np.cos(angle), 0.9, angle)
        return kind.flank(constant, *features)

    def value(angle):
        _, *features = kind.features(0.8, 0.7, np.cos(angle), 0.9, angle)
        return kind.value(constant, *features)

    assert share(phi)[0] == pytest.approx(value(phi) / value(0.0), rel=1e-9)
    if value(phi) > 1e-60 * value(0.0):
        slope = (np.log(value(phi + step)) - np.log(value(phi - step))) / (2 * step)
        assert np.sqrt(share(phi)[1]) == pytest.approx(abs(slope), rel=1e-4, abs=1e-4)
