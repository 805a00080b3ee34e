"""A coupled coat: what it takes from diffuse light, in the fit, in the choice by photographs, and in pictures."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import made
from scenes import plate
from test_fitting_two_lobes import ANGLES, EXACT, NOISE, gloss, two_components
from test_flat_shapes import seen
from test_lobe_choice import OPTIONS, sample_of
from test_measured_materials import needs_data

from benchmarks import materials
from irodori.config.cross_checks.object_lobes import check_coat
from irodori.config.models import BodyShape, Object, ObjectShape
from irodori.core.errors import InputError
from irodori.fitting.lobe_choice import candidates, choose
from irodori.fitting.solvers import SOLVERS, FitOptions, fit
from irodori.fitting.texel_sample import Readings
from irodori.geometry.shapes.shape import Shape
from irodori.material.energy import energy_of
from irodori.material.material_file import Material, Status
from irodori.reflection.coat import COATS, COUPLED, SUM, diffuse_albedo, diffuse_cosine, passed_array
from irodori.reflection.equation5 import reflect

N, K = 1.5, 0.0
REFERENCE = {"kind": "reference", "samples": 256, "seed": 0, "denoise": False}


def glass(cosine):
    """Share of light that passes a surface of glass, by Snell's and Fresnel's laws, relative to normal incidence."""
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / N**2)
    s, p = (cosine - N * inner) / (cosine + N * inner), (N * cosine - inner) / (N * cosine + inner)
    return (1.0 - 0.5 * (s**2 + p**2)) / (1.0 - ((N - 1.0) / (N + 1.0)) ** 2)


def test_what_passes_is_what_is_not_reflected():
    cosine = np.linspace(0.01, 1.0, 50)
    np.testing.assert_allclose(passed_array(cosine, N, K), glass(cosine), rtol=1e-12)


@given(light=st.floats(0.0, 1.5), view=st.floats(0.0, 1.5), n=st.floats(1.0, 3.0))
def test_light_and_view_can_be_exchanged(light, view, n):
    there, back = (
        diffuse_cosine(np.array([a, b, 0.3, 0.1]), n, K, True) / np.cos(a) for a, b in ((light, view), (view, light))
    )
    assert there == pytest.approx(back, rel=1e-12) and 0.0 < there <= 1.0


@pytest.mark.stability(stage="fit", case="a white ground under a coat at grazing angles")
def test_a_white_ground_and_the_mirror_above_it_send_back_no_more_than_falls_on_them():
    cosine = np.linspace(0.02, 1.0, 40)
    ground = diffuse_albedo(cosine, N, K)
    node, weight = np.polynomial.legendre.leggauss(200)
    out = 0.5 * (node + 1.0)
    np.testing.assert_allclose(ground, glass(cosine) * np.sum(weight * out * glass(out)), rtol=1e-4)
    reflected = 1.0 - glass(cosine) * (1.0 - 0.04)
    assert (ground + reflected < 1.0).all() and (1.0 + reflected > 1.03).all()
    rim = [energy_of(Material.uniform(1.0, mirror=1.0, coat=coat)).rim_max for coat in COATS]
    assert rim[0] > 1.5 and rim[1] == pytest.approx(max(1.0, (ground + reflected).max()), abs=0.02)


def coated(alpha, beta, mu) -> np.ndarray:
    """Responses of materials under a coupled coat, (texels, J), from the lobe's kernels and Fresnel's laws."""
    ground = np.cos(ANGLES[:, 0]) * glass(np.cos(ANGLES[:, 0])) * glass(np.cos(ANGLES[:, 1]))
    return np.array([a * ground + b * gloss("gaussian", m) for a, b, m in zip(alpha, beta, mu, strict=True)])


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_fit_finds_what_a_coupled_coat_covers(solver):
    alpha, (beta, mu), _ = two_components(12, 3)
    clean, weight = coated(alpha, beta, mu), np.ones((12, len(ANGLES)))
    given_ = FitOptions(solver=solver, coat=COUPLED, **EXACT)
    found = fit(clean, ANGLES, weight, N, K, given_, noise=1e-6 * NOISE)
    assert (found.status == Status.OK).all()
    for name, true in (("alpha", alpha), ("beta", beta), ("mu", mu)):
        np.testing.assert_allclose(getattr(found, name), true, rtol=1e-5)
    # The same angles for all texels, which another loop fits, and the model over arrays.
    rendered = reflect(found.alpha[:, None], 1.0, found.beta[:, None], found.mu[:, None], ANGLES, n=N, coupled=True)
    np.testing.assert_allclose(rendered, clean, rtol=1e-5)
    several = fit(clean, np.broadcast_to(ANGLES, (12, *ANGLES.shape)), weight, N, K, given_, noise=1e-6 * NOISE)
    np.testing.assert_allclose(several.alpha, alpha, rtol=1e-5)
    assert not np.allclose(fit(clean, ANGLES, weight, N, K, replace(given_, coat=SUM)).alpha, alpha, rtol=1e-3)


@pytest.mark.parametrize("coat", COATS)
def test_photographs_choose_the_coat_that_made_them(coat):
    alpha, (beta, mu), _ = two_components(24, 1)
    clean = (
        coated(alpha, beta, mu) if coat == COUPLED else reflect(alpha[:, None], 1.0, beta[:, None], mu[:, None], ANGLES)
    )
    chosen, found = choose(sample_of(clean), OPTIONS, candidates(OPTIONS, ("gaussian",), COATS))
    assert chosen == (("gaussian",), coat) and [one.coat for one in found] == list(COATS)
    assert next(one for one in found if one.coat != coat).behind > 0.0


@needs_data
def test_left_out_directions_of_sintered_ptfe_are_predicted_better_under_a_coupled_coat():
    measured = materials.read(materials.PTFE)[0]
    kept = np.flatnonzero(measured.trusted.all(axis=0) & (measured.geometry[:, :2] < np.radians(75)).all(axis=1))
    order = np.random.default_rng(0).permutation(kept)[:400]
    response = measured.response[:, order]
    angles = np.broadcast_to(measured.geometry[order], (len(response), len(order), 4))
    sample = Readings(response, np.ones(response.shape), angles, np.full((len(order), 2), np.nan), N, K)
    options = FitOptions()
    chosen, _ = choose(sample, options, candidates(options, ("ggx",), COATS))
    assert chosen.coat == COUPLED


@pytest.mark.parametrize("angle_deg", [5.0, 60.0, 80.0])
def test_under_even_light_the_path_tracer_shows_the_albedo_of_the_ground(angle_deg):
    floor, angle = Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "plane"})), np.radians(angle_deg)
    eye = 3000.0 * np.array([0.0, -np.sin(angle), np.cos(angle)])
    own = Material.uniform(0.5, n=1.4, coat=COUPLED)
    picture = seen([floor], [own], [(0.0, 0.0, 0.0)], REFERENCE, position=eye, target=(0, 0, 0), size=(8, 8), fov=0.5)
    assert picture.mean() == pytest.approx(0.5 * float(diffuse_albedo(np.cos(angle), 1.4, K)), rel=0.004)


def test_coats_that_cannot_be_had_are_refused():
    with pytest.raises(ValueError, match="the coat 'double'; accepted: sum, coupled"):
        Material.uniform(0.5, coat="double")
    leaf = Material.uniform(0.5, coat=COUPLED, transmittance=0.2)
    with pytest.raises(ValueError, match="coupled coat on a thin sheet that lets light through; accepted: the"):
        seen([plate(9.0)], [leaf], [(0, 0, 0)], {"kind": "interactive", "light_maps": False})
    sheet = {"camera": "c", "shape": {"kind": "plate", "width_mm": 9.0, "height_mm": 9.0}, "coat": "auto",
             "texels": {"width": 4, "height": 4}, "sheet": {}}  # fmt: skip
    with pytest.raises(InputError, match="auto of a thin sheet; accepted: sum of a sheet"):
        check_coat(made(Object, sheet), "leaf.yaml")
