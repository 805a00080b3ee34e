"""One transport, four ways to carry colour: furnaces, agreement with a plain loop and with each other."""

import dataclasses

import numpy as np
import pytest
from scenes import BALL, GOLD_K, GOLD_N, THIRDS, material, plate
from shortcuts import irradiance_map
from studio import (
    BANDS,
    BASIS,
    REPRESENTATIONS,
    even_light,
    picture,
    placed,
    plain_picture,
    prepared,
    sky_of,
    spectrum_of,
    view_of,
)

from irodori.colour.colorimetry import delta_e, lab_from_xyz, summary, xyz_from_radiance
from irodori.light.environment_file import Environment, directions
from irodori.light.irradiance import irradiance_at
from irodori.rendering.interactive import frame_renderer
from irodori.rendering.interactive.frame_renderer import render_frame
from irodori.rendering.interactive.quadrature import Quadrature, solve_quadrature


@pytest.fixture(autouse=True)
def as_wide_as_coefficients(monkeypatch):
    """Give ``rgb`` the sixteen lanes of ``coefficients``, whose loop it then shares; eight of them are empty."""
    own = frame_renderer.rgb_channels
    monkeypatch.setattr(frame_renderer, "rgb_channels", lambda *given: dataclasses.replace(own(*given), surface=16))


def expected(radiance, representation, white):
    """What a representation returns of a radiance."""
    return radiance if representation == "spectral" else radiance @ xyz_from_radiance(white).T


def nodes(representation, light) -> dict:
    """Fourteen wavelengths whose sums are XYZ of one spectrum in any amount, for the representation that has them.

    The fewer that would be solved for an even light have a loop of their own, and these that of a still life.
    """
    if representation != "quadrature":
        return {}
    samples, matrix = np.arange(3, 58, 4), xyz_from_radiance(light.upward_white())
    some = matrix[:, samples]
    level = (matrix @ spectrum_of()) / (some @ spectrum_of()[samples])
    return {"quadrature": Quadrature(samples, level[:, None] * some, 0.0, 0.0)}


@pytest.mark.stability(stage="render", case="white furnace")
@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_white_objects_vanish_in_an_even_light(representation):
    shapes, places = [plate(100.0), BALL, BALL], [(0, 0, 0), (-21, 0, 20), (21, 0, 20)]
    view = {"position": (0, -250, 120), "target": (0, 0, 12), "fov": 24, "size": (40, 32)}
    light = even_light()
    scene = {"places": places, **nodes(representation, light)}
    found = picture(shapes, [material(1.0)] * 3, light, representation, view, **scene)
    truth = expected(spectrum_of(), representation, light.upward_white())
    assert np.abs(found / truth - 1).max() <= 1e-3


@pytest.mark.parametrize("representation", ["coefficients", "rgb"])
def test_a_perfect_diffuser_that_faces_up_is_white_where_all_light_comes_from_above(representation):
    """Y is 100 on it, whatever lights the floor: white is what the light from above makes of it."""
    light = sky_of(lambda d: np.where(d[..., 2] > 0.0, 1.0, 0.05), height=64)
    view = {"position": (0.0, -120.0, 160.0), "size": (9, 9), "fov": 6.0}
    found = picture([plate(100.0)], [material(1.0)], light, representation, view, white=None)
    assert np.allclose(found[..., 1], 100.0, rtol=5e-3)


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_a_mirror_that_reflects_everything_vanishes_too(representation):
    """Total reflection: a real index of next to nothing seen from air has |r| = 1 but for the smallest angles."""
    light = even_light()
    mirror, scene = material(mirror=1.0, n=0.001, k=50.0), nodes(representation, light)
    found = picture([BALL], [mirror], light, representation, **scene)
    truth = expected(spectrum_of(), representation, light.upward_white())
    assert found.max() <= 1.001 * truth.max() and np.abs(found / truth - 1).max() <= 1e-3


@pytest.mark.stability(stage="render", case="energy")
@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_a_surface_sends_no_more_than_it_gets(representation):
    """Diffuse albedo and mirror add to one; gloss and its β is such that the lobe's albedo is under what is left."""
    materials = [material(0.5, mirror=0.3, n=1.5, k=2.0), material(0.6, beta=0.3 / (4 * 0.2**2), mu=0.2, n=0.05, k=9.0),
                 material(0.9, mirror=0.1, n=0.05, k=9.0)]  # fmt: skip
    light = even_light()
    shapes, places = [plate(100.0), BALL, BALL], [(0, 0, 0), (-21, 0, 20), (21, 0, 20)]
    view = {"position": (0, -250, 120), "target": (0, 0, 12), "fov": 24, "size": (40, 32)}
    scene = {"places": places, "max_bounces": 12, **nodes(representation, light)}
    found = picture(shapes, materials, light, representation, view, **scene)
    truth = expected(spectrum_of(), representation, light.upward_white())
    assert (found <= 1.002 * truth).all() and (found >= 0).all()


def uneven_light(height=64) -> Environment:
    unit = directions(2 * height, height)[0]
    x, y, z = np.moveaxis(unit, -1, 0)
    window = np.exp(12.0 * (0.8 * x + 0.6 * z - 1.0))
    lamp = np.exp(20.0 * (0.3 * x - 0.5 * y + 0.81 * z - 1.0))
    coefficients = np.stack([0.3 + 0.1 * z + 4.0 * window, 0.2 - 0.1 * z + 5.0 * lamp, 0.15 + 0.1 * y], axis=-1)
    coefficients = coefficients.astype(np.float32)
    return Environment(coefficients, BASIS, irradiance_map(coefficients, 128, 64))


def tiles(materials):
    """A material of a row of others, with a texel's edge between them."""
    first = materials[0]
    stack = {name: np.concatenate([getattr(m, name) for m in materials], axis=1)
             for name in ("alpha", "beta", "mu", "green_response")}  # fmt: skip
    basis = np.concatenate([m.basis for m in materials], axis=1)
    coefficients = np.zeros((first.alpha.shape[0], 0, len(materials)), np.float32)
    for i, one in enumerate(materials):
        block = np.zeros((*one.alpha.shape, len(materials)), np.float32)
        block[..., i] = 1.0
        coefficients = np.concatenate([coefficients, block], axis=1)
    return dataclasses.replace(first, **stack, basis=basis, coefficients=coefficients)


def reddish(level=0.8):
    return level / (1 + np.exp(-(BANDS - 38) / 3.0)) + 0.03


def greenish(level=0.6):
    return level * np.exp(-(((BANDS - 27) / 8.0) ** 2)) + 0.04


def still_life(**mirror):
    mirror = mirror or {"n": 1.5, "k": 0.0}
    paints = [material(reddish(), 3.0, 0.1, 0.5), material(greenish(), 2.0, 0.2, 0.5), material(0.7, 1.0, 0.3, 0.5),
              material(np.linspace(0.6, 0.1, 61), 4.0, 0.08, 0.5)]  # fmt: skip
    balls = [material(reddish(0.6), 2.0, 0.15, 1.0, **mirror),
             material(np.linspace(0.5, 0.1, 61), 1.0, 0.2, 0.8, **mirror),
             material(greenish(), 4.0, 0.1, 0.8)]  # fmt: skip
    shapes = [plate(160.0), BALL, BALL, BALL]
    places = [(0, 0, 0), (-30, 5, 20.0), (6, 30, 20.0), (26, -22, 20.0)]
    return shapes, [tiles(paints), *balls], places


STILL_LIFE_VIEW = {"position": (0, -250, 140), "target": (0, 0, 12), "fov": 30, "size": (96, 72)}


@pytest.mark.parametrize(("representation", "mean", "p99"), [("coefficients", 0.01, 0.05), ("quadrature", 0.3, 1.0)])
@pytest.mark.parametrize("coloured", [False, True])
def test_representations_show_what_the_bands_show(representation, mean, p99, coloured):
    gold = {"n": np.array(GOLD_N)[THIRDS], "k": np.array(GOLD_K)[THIRDS]} if coloured else {}
    if coloured and representation == "coefficients":
        pytest.skip("coefficients are for grey mirrors")
    shapes, materials, places = still_life(**gold)
    light = uneven_light()
    white = light.upward_white()
    matrix = xyz_from_radiance(white)
    scene = {"places": places, "least_throughput": 0.0}
    truth = picture(shapes, materials, light, "spectral", STILL_LIFE_VIEW, **scene) @ matrix.T
    found = picture(shapes, materials, light, representation, STILL_LIFE_VIEW, **scene)
    error = summary(delta_e(lab_from_xyz(truth, matrix @ white), lab_from_xyz(found, matrix @ white)))
    assert error["mean"] <= mean and error["p99"] <= p99
    if coloured:  # for three products of coloured mirrors a loop of their own would be compiled
        return
    # Three products do not: were they as good, the others would be for nothing.
    plain = picture(shapes, materials, light, "rgb", STILL_LIFE_VIEW, **scene)
    assert delta_e(lab_from_xyz(truth, matrix @ white), lab_from_xyz(plain, matrix @ white)).mean() > 3 * error["mean"]


def test_paths_end_within_the_error_that_their_limit_promises():
    shapes, materials, places = still_life()
    light = uneven_light()
    whole, cut = (picture(shapes, materials, light, "coefficients", STILL_LIFE_VIEW, places=places, least_throughput=t)
                  for t in (0.0, 1e-2))  # fmt: skip
    brightest = (light.coefficients @ light.basis.T).max(axis=(0, 1)) @ xyz_from_radiance(light.upward_white()).T
    lost = whole - cut
    assert lost.max() > 0
    # One path's end and the lobes of six surfaces, each under the limit.
    assert lost.max() <= 7e-2 * brightest.max() and lost.min() >= -1e-4 * brightest.max()


def test_bands_agree_with_a_plain_loop():
    """Three spheres that touch a plate and each other, gold among them; five reflections; 1e-4."""
    gold = {"n": np.array(GOLD_N)[THIRDS], "k": np.array(GOLD_K)[THIRDS]}
    materials = [material(greenish(), mirror=0.5), material(reddish(), mirror=1.0), material(0.05, mirror=1.0, **gold),
                 material(np.linspace(0.5, 0.1, 61), mirror=0.8, n=2.2, k=1.1)]  # fmt: skip
    shapes = [plate(120.0), BALL, BALL, BALL]
    places = [(0, 0, 0), (-20, 0, 20), (20, 0, 20), (0, 20 * np.sqrt(3), 20)]
    view = {"position": (13.0, -250.0, 141.0), "target": (0, 8, 12), "size": (32, 24), "fov": 24}
    light = even_light((0.7, 0.9, 0.4))
    # An irradiance that varies, though the light does not: what is looked up is told from what is computed.
    unit = directions(512, 256)[0]
    weights = np.stack([2 + unit[..., 0], 1.5 - unit[..., 2], 1 + unit[..., 1] * unit[..., 0]], axis=-1)
    light = dataclasses.replace(light, irradiance=weights.astype(np.float32))
    white = np.ones(61)
    found = picture(shapes, materials, light, "spectral", view, places=places, white=white, least_throughput=0.0)
    truth = plain_picture(
        placed(shapes, places), materials, lambda d: spectrum_of((0.7, 0.9, 0.4)),
        lambda n: BASIS @ np.array([2 + n[0], 1.5 - n[2], 1 + n[1] * n[0]]), 5, **view,
    )  # fmt: skip
    assert np.abs(found - truth).max() <= 1e-4 * truth.max()
    # Some bands by the loop of a still life with coloured mirrors: their sums under three weights.
    few = Quadrature(np.arange(3, 58, 4), np.random.default_rng(1).random((3, 14)), 0.0, 0.0)
    exact = picture(shapes, materials, light, "quadrature", view, places=places, white=white, least_throughput=0.0,
                    quadrature=few)  # fmt: skip
    sums = truth[..., few.samples] @ few.weights.T
    assert np.abs(exact - sums).max() <= 1e-4 * sums.max()


def test_a_quadrature_takes_more_wavelengths_for_smaller_errors():
    rng = np.random.default_rng(3)
    smooth = np.exp(rng.normal(size=(600, 6)) @ np.stack([np.cos(np.pi * i * BANDS / 60) for i in range(6)]) * 0.4)
    lines = smooth * (1 + 5 * np.exp(-(((BANDS - 21) / 1.2) ** 2)) * rng.random((600, 1)))
    white = np.ones(61)
    matrix = xyz_from_radiance(white)
    coarse, fine = (solve_quadrature(lines, matrix, white, t, 5 * t) for t in (3.0, 0.05))
    assert len(coarse.samples) < len(fine.samples)
    for found in (coarse, fine):
        error = delta_e(
            lab_from_xyz(lines[1::2] @ matrix.T, matrix @ white),
            lab_from_xyz(lines[1::2][:, found.samples] @ found.weights.T, matrix @ white),
        )
        # Brightness aside, which the solution makes equal.
        assert np.isfinite(error).all() and error.mean() <= 5 * max(found.delta_e_mean, 0.02)


def test_the_quadrature_of_an_even_light_has_its_brightness_and_colour():
    """All spectra of the scene are one, so that weights have one degree of freedom in three."""
    light = even_light()
    matrix = xyz_from_radiance(light.upward_white())
    for one in (material(1.0), material(mirror=1.0, n=0.001, k=50.0), material(0.5, mirror=0.3, n=1.5, k=2.0)):
        found = prepared([BALL], [one], light, "quadrature").quadrature
        assert found.weights @ spectrum_of()[found.samples] == pytest.approx(matrix @ spectrum_of(), rel=1e-3)


def test_unknown_and_unfit_choices_are_refused():
    light = even_light()
    with pytest.raises(ValueError, match="accepted: spectral, coefficients, quadrature, rgb"):
        prepared([BALL], [material(0.5)], light, "cmyk")
    gold = material(mirror=1.0, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS])
    with pytest.raises(ValueError, match="accepted representations: spectral, quadrature, rgb"):
        prepared([BALL], [gold], light, "coefficients")
    # A coloured index that nothing shows is no reason.
    prepared([BALL], [dataclasses.replace(gold, mirror=0.0)], light, "coefficients")
    with pytest.raises(ValueError, match="accepted: spectral"):
        render_frame(prepared([BALL], [material(0.5)], light, "rgb"), view_of(), bands=True)


def test_the_irradiance_map_is_looked_up_as_it_stands():
    light = uneven_light()
    white = light.upward_white()
    found = picture([BALL], [material(1.0)], light, "coefficients")
    normals = np.array([[0.0, -1.0, 0.0]])
    truth = light.basis @ irradiance_at(light.irradiance, normals)[0] / np.pi
    assert np.allclose(found[20, 20], xyz_from_radiance(white) @ truth, rtol=2e-3)
