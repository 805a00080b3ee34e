"""The virtual rig's other reflection models are physical, and what a measured table says is what is seen."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.core.errors import InputError
from irodori.reflection.equation5 import angles_from_directions
from irodori.simulation.virtual_rig.sample_reflection import GGX, PAPER, gloss_lobe, measured_lobe, read_measured

DATA = Path(__file__).resolve().parents[3] / "shared/data/brdf"
ANGLES = st.floats(0.0, 1.5)
WIDTHS = st.floats(0.005, 1.2)


def lobe(model: int, mu: float, theta_i: float, theta_r, azimuth):
    """Return the gloss lobe over cosθ_i, a BRDF up to a constant; θ_r and azimuth broadcast."""
    theta_r, azimuth = np.broadcast_arrays(theta_r, azimuth)
    light = np.array([np.sin(theta_i), 0.0, np.cos(theta_i)])
    view = np.stack([np.sin(theta_r) * np.cos(azimuth), np.sin(theta_r) * np.sin(azimuth), np.cos(theta_r)], axis=-1)
    ci, cr, ch, cp = np.moveaxis(np.cos(angles_from_directions(np.array([0.0, 0.0, 1.0]), light, view)), -1, 0)
    seen = [gloss_lobe(model, mu, *cosines) for cosines in zip(ci.flat, cr.flat, cp.flat, ch.flat, strict=True)]
    return np.reshape(seen, theta_r.shape)[()] / np.cos(theta_i)


@settings(deadline=None)
@given(WIDTHS, ANGLES, ANGLES, st.floats(0.0, np.pi))
def test_either_lobe_is_reciprocal(mu, theta_i, theta_r, azimuth):
    for model in (PAPER, GGX):
        forth, back = lobe(model, mu, theta_i, theta_r, azimuth), lobe(model, mu, theta_r, theta_i, azimuth)
        assert forth == pytest.approx(back, rel=1e-6, abs=1e-12)


@settings(deadline=None)
@given(WIDTHS)
def test_either_lobe_is_1_head_on(mu):
    assert lobe(PAPER, mu, 0.0, 0.0, 0.0) == pytest.approx(1.0, rel=1e-9)
    assert lobe(GGX, mu, 0.0, 0.0, 0.0) == pytest.approx(1.0, rel=1e-9)


def test_ggx_has_the_longer_tail():
    assert lobe(GGX, 0.1, 0.8, 0.0, 0.0) > 1000 * lobe(PAPER, 0.1, 0.8, 0.0, 0.0)


@pytest.mark.parametrize("mu", [0.1, 0.3, 0.8])
def test_ggx_facets_fill_the_surface_and_reflect_no_more_than_they_get(mu):
    # In terms of the normalised distribution the BRDF is D G2 / (4 cosθ_i cosθ_r); the lobe leaves out 1 / (4 μ²).
    theta = np.linspace(0, np.pi / 2, 301)[1:-1]
    # Dense about the mirror direction, where the lobe of grazing light is narrow.
    azimuth = np.pi - np.pi * np.linspace(1, 0, 61) ** 2
    for theta_i in (0.0, 0.6, 1.2):
        values = lobe(GGX, mu, theta_i, theta[:, None], azimuth[None])
        weight = (np.sin(theta) * np.cos(theta))[:, None]
        albedo = 2 * np.trapezoid(np.trapezoid(values * weight, azimuth, axis=1), theta) / (4 * mu**2 * np.pi)
        assert 0.3 < albedo <= 1.0 + 2e-3
        # What a rough surface reflects twice is left out of the model, and little of that where it is smooth.
        if theta_i == 0.0 and mu == 0.1:
            assert albedo > 0.97


def table(tmp_path, value, rows: int = 4000) -> Path:
    """Write a table of a BRDF that is a function of the half angle, at random directions."""
    rng = np.random.default_rng(7)
    theta_i, theta_r = rng.uniform(0, 1.4, rows), rng.uniform(0, 1.4, rows)
    phi_i, phi_r = rng.uniform(0, 2 * np.pi, rows), rng.uniform(0, 2 * np.pi, rows)

    def direction(theta, phi):
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)

    phi = angles_from_directions(np.array([0, 0, 1.0]), direction(theta_i, phi_i), direction(theta_r, phi_r))[:, 3]
    nm = np.arange(400, 701, 20)
    spectra = value(phi)[:, None] * np.linspace(0.5, 1.0, nm.size)
    path = tmp_path / "brdf.csv"
    head = ",".join(["theta_i_rad", "phi_i_rad", "theta_r_rad", "phi_r_rad", *map(str, nm)])
    np.savetxt(
        path, np.column_stack([theta_i, phi_i, theta_r, phi_r, spectra]), delimiter=",", header=head, comments=""
    )
    return path


def test_a_diffuse_table_comes_back(tmp_path):
    grid = read_measured(table(tmp_path, lambda phi: np.full(phi.shape, 0.2)))
    for cos_phi, cos_h in ((1.0, 1.0), (0.9, 0.8), (0.3, 0.99)):
        assert measured_lobe(grid, cos_phi, cos_h, 60) == pytest.approx(np.pi * 0.2)
        assert measured_lobe(grid, cos_phi, cos_h, 0) == pytest.approx(np.pi * 0.1)


def test_a_lobe_comes_back_within_the_grid(tmp_path):
    grid = read_measured(table(tmp_path, lambda phi: 0.05 + np.exp(-((phi / 0.4) ** 2)), rows=20_000))
    for phi in (0.15, 0.3, 0.5, 0.8):
        seen = measured_lobe(grid, np.cos(phi), np.cos(0.5), 60) / np.pi
        assert seen == pytest.approx(0.05 + np.exp(-((phi / 0.4) ** 2)), rel=0.1)


@pytest.mark.parametrize("name", ["cornell_acryl_blue", "cornell_garnet_red", "cornell_krylon_blue"])
def test_real_measurements_make_a_finite_table(name):
    if not (DATA / f"{name}.csv").is_file():
        pytest.skip("the measured BRDFs of ../shared/data are not here")
    grid = read_measured(DATA / f"{name}.csv")
    assert np.isfinite(grid).all() and (grid >= 0).all() and grid.max() > 0


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("theta_i,phi_i,theta_r,phi_r,400,700\n0,0,0,0,1,1\n", "theta_i"),
        ("theta_i_rad,phi_i_rad,theta_r_rad,phi_r_rad,400,700\n0,0,0,0,1,1\n", "400"),
        (
            "theta_i_rad,phi_i_rad,theta_r_rad,phi_r_rad,"
            + ",".join(map(str, range(400, 701, 20)))
            + "\n1.5,0,0,0"
            + ",1" * 16,
            "80",
        ),
    ],
)
def test_a_table_that_says_nothing_is_refused(tmp_path, text, found):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(InputError, match=found):
        read_measured(tmp_path / "bad.csv")
