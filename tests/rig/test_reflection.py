"""Reflection of the virtual rig's materials: that of their lobes, and what a measured table says."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.core.errors import InputError
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.lobe_arrays import evaluate
from irodori.simulation.virtual_rig.sample_reflection import (
    gloss_components,
    gloss_term,
    measured_lobe,
    read_measured,
)

DATA = Path(__file__).resolve().parents[3] / "shared/data/brdf"
ANGLES = st.floats(0.0, 1.5)
WIDTHS = st.floats(0.005, 1.2)


@settings(deadline=None, max_examples=40)
@given(WIDTHS, WIDTHS, ANGLES, ANGLES, st.floats(0.0, np.pi))
def test_a_material_reflects_as_its_lobes_do(mu, other, theta_i, theta_r, azimuth):
    light = np.array([np.sin(theta_i), 0.0, np.cos(theta_i)])
    view = np.array([np.sin(theta_r) * np.cos(azimuth), np.sin(theta_r) * np.sin(azimuth), np.cos(theta_r)])
    geometry = angles_from_directions(np.array([0.0, 0.0, 1.0]), light, view)
    ci, cr, ch, cp = map(float, np.cos(geometry))
    kinds = [("gaussian",), ("ggx",), ("ggx", "gaussian"), (), ("gaussian", "gaussian")]
    beta = np.array([[2.0, 0], [3.0, 0], [0.5, 4.0], [0, 0], [1.0, 2.0]])
    gloss = gloss_components(kinds, beta, np.tile([mu, other], (5, 1)))
    for material, names in enumerate(kinds):
        found = gloss_term(gloss, material, ci, cr, cp, ch)
        pairs = zip(names, beta[material], (mu, other), strict=False)
        expected = sum(weight * evaluate(name, roughness, geometry) for name, weight, roughness in pairs)
        # The angle of a half vector next to the normal has the digits that its cosine has.
        assert found == pytest.approx(expected, rel=1e-6 if geometry[3] > 1e-4 else 2e-4, abs=1e-12)


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
