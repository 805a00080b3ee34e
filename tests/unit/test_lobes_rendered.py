"""Scenes of GGX, of two gloss components and of a lobe from outside the package: both integrators beside quadrature.

The formulas here are written out once more, in NumPy and from the papers, and know nothing of the package's kernels.
"""

import math

import numpy as np
import pytest
import toy_lobe
from lobe_scenes import beside, surface
from made import made
from path_scenes import DARK, deviations, traced
from scenes import (
    BALL,
    ONES,
    constant_light,
    fresnel,
    gloss_maps,
    plate,
    smooth_light,
    smooth_sky,
    sphere_hits,
)

from irodori.config.models import Size, View
from irodori.fitting.solvers import FitOptions
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.placement import Placement
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, light_of, prepare_scene, render_frame
from irodori.rendering.interactive.round_lobes import ANGLES, ROUGHNESSES, lobe_table, roughness_at
from irodori.rendering.scene_arrays import make_objects, make_view

#: Components (lobe, β, μ) of a surface: one of long tails, sums, and a form that the package has never seen.
SURFACES = {
    "ggx": (("ggx", 1 / (4 * 0.15**2), 0.15),),
    "ggx-rough": (("ggx", 1 / (4 * 0.5**2), 0.5),),
    "ggx+ggx": (("ggx", 0.3, 0.5), ("ggx", 4.0, 0.12)),
    "gaussian+ggx": (("gaussian", 5.0, 0.1), ("ggx", 0.6, 0.4)),
    "toy": (("toy", 8.0, 0.2),),
}
GLOSSY = pytest.mark.parametrize("components", SURFACES.values(), ids=SURFACES)


def term(name, mu, cos_i, cos_r, cos_phi, cos_h):
    """D G / cosθ_r where all cosines are positive."""
    grooves = np.minimum(1.0, 2 * cos_phi / cos_h * np.minimum(cos_i, cos_r)) / cos_r
    if name == "gaussian":
        return np.exp(-((np.arccos(np.minimum(cos_phi, 1.0)) / mu) ** 2)) * grooves
    if name == "toy":
        return cos_phi ** (2 / mu**2) * grooves
    tan2 = 1 / cos_phi**2 - 1
    scaled = 1 / (cos_phi**4 * (1 + tan2 / mu**2) ** 2)
    smith = [0.5 * (np.sqrt(1 + mu**2 * (1 / c**2 - 1)) - 1) for c in (cos_i, cos_r)]
    return scaled / (1 + smith[0] + smith[1]) / cos_r


def paths(shape, components, light, samples, *given, **view):
    """Return a picture by paths of a surface in the origin; further numbers are those of `surface`."""
    shapes, materials, places = beside(shape, surface(components, *given))
    return traced(shapes, materials, light, samples, places=places, **view)


def integral(normal, view, components, n, k, light_of=smooth_light) -> float:
    """Σ β/π ∫ L F D G / cosθ_r dω over half vectors, each component with nodes that follow its own width and tails."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    around = (np.arange(256) + 0.5) * 2 * np.pi / 256
    tangent = np.cross(normal, [0.3, 0.9, -0.2])
    tangent /= np.linalg.norm(tangent)
    bitangent, whole = np.cross(normal, tangent), 0.0
    for name, beta, mu in components:
        end = math.asinh(1e5 / mu)
        s, ds = (nodes + 1) / 2 * end, weights * end / 2
        slope = mu * np.sinh(s)
        phi, dphi = np.arctan(slope), ds * mu * np.cosh(s) / (1 + slope**2)
        phi, turn = np.meshgrid(phi, around, indexing="ij")
        ring = np.cos(turn)[..., None] * tangent + np.sin(turn)[..., None] * bitangent
        half = np.cos(phi)[..., None] * normal + np.sin(phi)[..., None] * ring
        cos_h = half @ view
        light = 2 * cos_h[..., None] * half - view
        lit = (cos_h > 1e-9) & (light @ normal > 1e-9)
        cos_i, cos_h = np.where(lit, light @ normal, 1.0), np.where(lit, cos_h, 1.0)
        found = light_of(light) * fresnel(cos_h, n, k) * term(name, mu, cos_i, normal @ view, np.cos(phi), cos_h)
        solid_angle = np.sin(phi) * dphi[:, None] * 2 * np.pi / 256 * 4 * cos_h
        whole += beta / np.pi * float(np.sum(np.where(lit, found, 0.0) * solid_angle))
    return whole


@pytest.mark.default_cases(10)
@GLOSSY
@pytest.mark.parametrize("theta_deg", [0.0, 50.0, 80.0])
@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4)], ids=["lacquer", "metal"])
def test_reference_renders_the_lobes_integrated_over_the_light(components, theta_deg, n, k):
    """A small part of a plate under light that varies slowly, as the Gaussian lobe is tested."""
    theta = np.radians(theta_deg)
    view = np.array([0.0, -np.sin(theta), np.cos(theta)])
    picture = paths(plate(2000.0), components, smooth_sky(), 8192, n, k,
                    position=500 * view, size=(1, 1), fov=0.1, up=(0.0, np.cos(theta), np.sin(theta)))  # fmt: skip
    expected = integral(np.array([0.0, 0.0, 1.0]), view, components, n, k)
    assert picture.standard_error[0, 0, 0] <= 8e-3 * expected
    assert abs(picture.radiance[0, 0, 0] - expected) <= 5 * picture.standard_error[0, 0, 0] + 5e-4 * expected


@pytest.mark.default_cases(6)
@pytest.mark.parametrize("mu", [0.02, 0.1, 0.3, 0.7])
@pytest.mark.parametrize("lobes", [("ggx",), ("ggx", "ggx"), ("gaussian", "ggx"), ("toy",)], ids="+".join)
def test_a_furnace_gives_no_more_light_than_it_has(lobes, mu):
    """β F of each component is such that its facets cover the surface once; of two, each covers half of it."""
    components = tuple((name, 1 / (4 * mu**2) / len(lobes), mu) for name in lobes)
    picture = paths(BALL, components, constant_light(1.0), 1024, 0.01, 20.0, size=(11, 11))
    assert deviations(picture, 1.0).max() < 6
    # What is missing has met a second facet, which a lobe does not follow.
    steep = np.array([0.0, 0.0, 1.0])
    expected = integral(steep, steep, components, 0.01, 20.0, lambda direction: np.ones(direction.shape[:-1]))
    assert picture.radiance[5, 5, 30] == pytest.approx(expected, rel=0.01)


@GLOSSY
def test_a_surface_sends_as_much_one_way_as_the_other(components):
    """Helmholtz: light from one direction seen from another, and the other way round, over the light's cosine."""

    def seen(from_deg, to_deg) -> float:
        lamp = {"kind": "collimated", "spectrum": "E", "azimuth_deg": 0.0, "elevation_deg": 90.0 - from_deg,
                "irradiance": 1.0}  # fmt: skip
        turn = np.radians(to_deg)
        eye = (-400 * np.sin(turn), 30.0, 400 * np.cos(turn))
        found = paths(plate(40.0), components, DARK, 8, 1.5, 0.0, 0.3, lights=[lamp], size=(1, 1), position=eye,
                      fov=0.01, up=(0, 1, 0))  # fmt: skip
        return float(found.radiance[0, 0, 30]) / math.cos(math.radians(from_deg))

    # The eye stands a little beside the plane of incidence; from the light's place it does so for the lamp, too.
    for one, other in ((20.0, 55.0), (5.0, 75.0)):
        assert seen(one, other) == pytest.approx(seen(other, one), rel=0.02)


def interactive(components, light, n=1.5, k=0.0, lamps=(), size=(41, 41)):
    """Radiance of a ball, the same in all bands, by coefficients, whose loops compile fastest."""
    shapes, materials, places = beside(BALL, surface(components, n, k))
    placements = [Placement(shape, translation_mm=np.array(p)) for shape, p in zip(shapes, places, strict=True)]
    objects, _ = make_objects(placements, materials)
    ready = prepare_scene(objects, light_of(light), gloss_maps(light), Tracer(placements),
                          "coefficients", ONES, lamps=np.ones((len(lamps), 61)), least_throughput=0.0)  # fmt: skip
    seen = {"position_mm": (0.0, -200.0, 0.0), "target_mm": (0.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0),
            "field_of_view_deg": 13.0}  # fmt: skip
    view = make_view(made(View, seen), Size(width=size[0], height=size[1]))
    return render_frame(ready, view, lamps=tuple(CollimatedLamp(np.asarray(d)) for d in lamps))[..., 1] / 100


@pytest.mark.default_cases(5)
@GLOSSY
@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4)], ids=["lacquer", "metal"])
def test_interactive_renders_the_lobes_integrated_over_the_light(components, n, k):
    """Within the tolerances of the Gaussian lobe of the same roughness."""
    light = smooth_sky(256, 128)
    found = interactive(components, light, n, k)
    ray, normal = sphere_hits()
    tolerance = 0.01 if max(mu for _, _, mu in components) < 0.3 else 0.04
    for y, x in [(20, 20), (14, 20), (20, 27), (28, 12), (10, 14), (25, 33), (33, 24)]:
        true = integral(normal[y, x], -ray[y, x], components, n, k)
        assert found[y, x] == pytest.approx(true, rel=tolerance)


@GLOSSY
def test_interactive_shows_highlights_of_lamps_as_the_formula_has_them(components):
    towards = np.array([0.3, -0.8, 0.5]) / np.linalg.norm([0.3, -0.8, 0.5])
    found = interactive(components, constant_light(0.0), lamps=[towards])
    ray, normal = sphere_hits()
    half = towards - ray
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cosines = normal @ towards, -np.sum(ray * normal, axis=-1), np.sum(half * normal, axis=-1), half @ towards
    lit = np.all([c > 0.05 for c in cosines], axis=0)
    safe = [np.where(lit, c, 1.0) for c in cosines]
    true = sum(b * term(name, mu, *safe) for name, b, mu in components) * fresnel(safe[3], 1.5, 0.0) / np.pi
    assert lit.sum() > 500
    np.testing.assert_allclose(found[lit], true[lit], rtol=2e-3, atol=1e-5 * true[lit].max())


@pytest.mark.default_cases(2)
@GLOSSY
def test_interactive_and_reference_show_the_same_ball(components):
    light = smooth_sky(256, 128)
    fast = interactive(components, light, size=(21, 21))
    slow = paths(BALL, components, light, 1024, size=(21, 21)).radiance[..., 30]
    _, normal = sphere_hits(size=(21, 21))
    ray, _ = sphere_hits(size=(21, 21))
    facing = -np.sum(ray * normal, axis=-1) > 0.5
    difference = np.abs(fast - slow)[facing] / slow[facing]
    rough = max(mu for _, _, mu in components) > 0.3
    assert np.median(difference) < (0.03 if rough else 0.01) and difference.max() < 0.06


@pytest.mark.parametrize(("name", "parts"), [("gaussian", 1), ("ggx", 3), ("toy", 1)])
def test_rows_are_near_every_form_of_lobe(name, parts):
    """The bounds are those of the Gaussian; tails beyond the widest blurred light cost GGX a little more."""
    table = lobe_table(name)
    assert len(table.entries) == parts
    theta = np.degrees(np.arccos(np.linspace(0, 1, ANGLES) ** 2))
    mu = roughness_at(np.arange(ROUGHNESSES), name)
    assert table.distance[np.ix_(mu < 0.22, theta < 60)].max() <= (0.16 if name == "ggx" else 0.12)
    assert table.distance[np.ix_((mu > 0.1) & (mu < 0.35), theta < 77)].max() <= 0.33
    assert table.distance[np.ix_(mu > 0.35, theta < 60)].max() <= 0.41


def test_a_lobe_that_no_texel_has_weight_in_changes_nothing():
    """A second component of β = 0 leaves the picture to the last bit of rounding."""
    light = smooth_sky(256, 128)
    one = interactive((("ggx", 3.0, 0.2),), light)
    two = interactive((("gaussian", 0.0, 0.4), ("ggx", 3.0, 0.2)), light)
    np.testing.assert_allclose(two, one, rtol=1e-6, atol=1e-7)


def test_a_lobe_from_outside_is_fitted_within_its_own_bounds():
    options = FitOptions(lobes=("toy",), bounds={"mu_rad": (0.005, 1.2)})
    assert options.limits("mu_rad") == (toy_lobe.ROUGHNESS.low, toy_lobe.ROUGHNESS.high)


def test_the_toy_lobe_is_no_part_of_the_package():
    assert not toy_lobe.__name__.startswith("irodori")
