"""The lobes of rough gloss: physics, derivatives, sampling, and other implementations of the same formulas."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from lobe_albedos import lobe_albedo
from scipy.stats import chi2

from irodori.jit.compilation import njit
from irodori.jit.vector_memory import load, store
from irodori.jit.vectors import LANES
from irodori.reflection import albedo
from irodori.reflection import lobes as kernels
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.lobe_arrays import evaluate, evaluate_with_derivatives
from irodori.reflection.lobes import Lobes
from irodori.reflection.registry import lobe, names

every_lobe = pytest.mark.parametrize("name", names())
ANGLES = st.floats(0.0, 1.55)
AZIMUTHS = st.floats(0.0, math.pi)
SHARES = st.floats(0.0, 1.0)


def roughness(name: str, share: float) -> float:
    """Return a roughness between the bounds of a lobe, evenly in the logarithm."""
    bounds = lobe(name).roughness
    return bounds.low * (bounds.high / bounds.low) ** share


def geometry(theta_i, theta_r, azimuth) -> np.ndarray:
    """Return θ_i, θ_r, θ_H, φ of light and view an azimuth apart; π is the plane of incidence."""
    theta_i, theta_r, azimuth = np.broadcast_arrays(theta_i, theta_r, azimuth)

    def direction(theta, turn):
        return np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)], axis=-1)

    return angles_from_directions(
        np.array([0.0, 0.0, 1.0]), direction(theta_i, 0 * azimuth), direction(theta_r, azimuth)
    )


@njit(cache=True, error_model="numpy")
def _draws(lobes, mu, view, numbers, out):
    for j in range(numbers.shape[0]):
        out[j] = kernels.draw(lobes, 0, mu, view[0], view[1], view[2], numbers[j, 0], numbers[j, 1])


@njit(cache=True, error_model="numpy")
def _densities(lobes, mu, view, half, out):
    for j in range(half.shape[0]):
        cos_h = half[j, 0] * view[0] + half[j, 1] * view[1] + half[j, 2] * view[2]
        phi = math.atan2(math.hypot(half[j, 0], half[j, 1]), half[j, 2])
        # Of the half vector: directions of light are 4 cosθ_H times as far apart.
        out[j] = 4.0 * cos_h * kernels.density(lobes, 0, mu, view[2], half[j, 2], cos_h, phi) if cos_h > 0.0 else 0.0


def view_at(theta: float) -> np.ndarray:
    return np.array([math.sin(theta), 0.0, math.cos(theta)])


def draws(name: str, mu: float, theta: float, count: int, seed: int = 0) -> np.ndarray:
    """Return half vectors drawn for a view at an angle, (count, 3)."""
    out = np.empty((count, 3))
    _draws(Lobes.of(name), mu, view_at(theta), np.random.default_rng(seed).random((count, 2)), out)
    return out


def half_density(name: str, mu: float, theta: float, phi, azimuth) -> np.ndarray:
    """Return the density of the drawn half vectors times sinφ, per rad of φ and of azimuth."""
    phi, azimuth = np.broadcast_arrays(phi, azimuth)
    sine = np.sin(phi)
    half = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(phi)], axis=-1).reshape(-1, 3)
    out = np.empty(len(half))
    _densities(Lobes.of(name), mu, view_at(theta), half, out)
    return out.reshape(phi.shape) * sine


# --- what every lobe is --------------------------------------------------------------------------------------------


@every_lobe
@settings(deadline=None, max_examples=100)
@given(share=SHARES, theta_i=ANGLES, theta_r=ANGLES, azimuth=AZIMUTHS)
@example(share=0.0, theta_i=1.5, theta_r=1.5, azimuth=math.pi)
def test_light_and_view_may_be_exchanged(name, share, theta_i, theta_r, azimuth):
    mu = roughness(name, share)
    forth = evaluate(name, mu, geometry(theta_i, theta_r, azimuth)) / math.cos(theta_i)
    back = evaluate(name, mu, geometry(theta_r, theta_i, azimuth)) / math.cos(theta_r)
    # Angles come from directions, whose last digits weigh (φ / μ²) as much.
    assert forth == pytest.approx(back, rel=1e-9, abs=1e-13)


@every_lobe
@settings(deadline=None, max_examples=50)
@given(share=SHARES)
def test_the_term_is_one_head_on(name, share):
    assert evaluate(name, roughness(name, share), np.zeros(4)) == pytest.approx(1.0, rel=1e-12)


@every_lobe
def test_nothing_is_reflected_to_or_from_under_the_horizon(name):
    below = np.array([[1.6, 0.2, 0.8, 0.7], [0.2, 1.6, 0.8, 0.7], [math.pi / 2, 0.0, 0.7, 0.7], [2.0, 2.0, 0.1, 2.0]])
    assert (evaluate_with_derivatives(name, 0.3, below) == 0.0).all()


def _difference(function, order: int, step: float) -> float:
    """Return a derivative of order 1 or 2 at 0 by central differences, extrapolated once."""

    def plain(h):
        low, middle, high = function(-h), function(0.0), function(h)
        return (high - low) / (2 * h) if order == 1 else (high - 2 * middle + low) / h**2

    return (4.0 * plain(step / 2) - plain(step)) / 3.0


@every_lobe
@settings(deadline=None, max_examples=100)
@given(share=SHARES, widths=st.floats(0.0, 4.0), theta_r=st.floats(0.0, 1.4), azimuth=AZIMUTHS)
@example(share=0.0, widths=0.0, theta_r=0.0, azimuth=0.0)
@example(share=0.0, widths=1.0, theta_r=1.4, azimuth=math.pi)
def test_derivatives_are_those_of_the_value(name, share, widths, theta_r, azimuth):
    mu = roughness(name, share)
    # Light that is mirrored at a facet so many roughnesses from the normal, as far as it is above the horizon.
    phi = min(widths * mu, 0.7)
    half = np.array([math.sin(phi) * math.cos(azimuth), math.sin(phi) * math.sin(azimuth), math.cos(phi)])
    view = view_at(theta_r)
    light = 2.0 * (half @ view) * half - view
    seen = angles_from_directions(np.array([0.0, 0.0, 1.0]), light, view)
    _, first, second = evaluate_with_derivatives(name, mu, seen)

    def at(t):
        return float(evaluate(name, mu * math.exp(t), seen))

    # exp(-x) is at most e^-16 here; the sixth derivative of the lobe by ln μ some 1e6 of its largest value nearby.
    # A step h errs by h⁴ / 480 of the fifth derivative, which is up to 1e6 of the first: 1e-2 would be too wide.
    scale = max(at(t) for t in (-0.1, 0.0, 0.1))
    assert first == pytest.approx(_difference(at, 1, 5e-3), rel=1e-5, abs=1e-5 * scale)
    assert second == pytest.approx(_difference(at, 2, 2e-2), rel=1e-3, abs=1e-3 * scale)


@every_lobe
def test_only_a_lobe_that_says_so_is_squared_by_half_an_octave(name):
    seen = geometry(0.4, np.linspace(0.0, 1.2, 30), 2.5)
    rough, smooth = evaluate(name, 0.2, seen), evaluate(name, 0.2 / math.sqrt(2.0), seen)
    factor = evaluate("gaussian", 1e6, seen)
    is_square = np.allclose(smooth * factor, rough**2, rtol=1e-9, atol=1e-30)
    assert is_square == lobe(name).squares_at_half_octave


@every_lobe
def test_beyond_its_reach_a_lobe_is_nothing(name):
    for share in np.linspace(0.0, 1.0, 7):
        mu = roughness(name, share)
        reach = lobe(name).reach(mu)
        assert 0.0 < reach <= math.pi / 2
        if reach < 0.7:
            # At normal view light that is mirrored at φ comes from 2 φ; what is left beside D is smooth.
            at = np.array([2.0 * reach, 0.0, reach, reach])
            assert evaluate(name, mu, at) <= 2.5e-4


@every_lobe
def test_strength_is_about_the_albedo_of_a_steep_view(name):
    mu = np.geomspace(lobe(name).roughness.low, lobe(name).roughness.high, 25)
    strength = np.array([lobe(name).strength(one) for one in mu])
    assert (strength > 0.0).all()
    off = np.abs(np.log(strength / lobe_albedo(name, mu, 0.9)[:, 0]))
    assert off[mu <= 0.3].max() <= math.log(1.5) and off.max() <= math.log(6.0)


# --- vectors -------------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def _by_lanes(lobes, t, cosines, factor, out):
    constant = kernels.constants(lobes, t)
    for place in range(0, cosines.shape[1], LANES):
        c = load(cosines[0], place), load(cosines[1], place), load(cosines[2], place), load(cosines[3], place)
        f, f0, f1, f2 = kernels.features(lobes, c[0], c[1], c[2], c[3], load(cosines[4], place))
        store(factor, place, f)
        store(out[3], place, kernels.value(lobes, constant, f0, f1, f2))
        value, first, second = kernels.derivatives(lobes, constant, f0, f1, f2)
        store(out[0], place, value)
        store(out[1], place, first)
        store(out[2], place, second)


@njit(cache=True, error_model="numpy")
def _by_numbers(lobes, t, cosines, factor, out):
    constant = kernels.constants(lobes, t)
    for j in range(cosines.shape[1]):
        f, f0, f1, f2 = kernels.features(
            lobes, cosines[0, j], cosines[1, j], cosines[2, j], cosines[3, j], cosines[4, j]
        )
        factor[j], out[3, j] = f, kernels.value(lobes, constant, f0, f1, f2)
        out[0, j], out[1, j], out[2, j] = kernels.derivatives(lobes, constant, f0, f1, f2)


@every_lobe
@pytest.mark.parametrize("mu", [0.005, 0.1, 1.2])
def test_vectors_are_as_good_as_numbers(name, mu):
    rng = np.random.default_rng(3)
    count = 40 * LANES
    theta_i, theta_r = rng.uniform(0.0, 1.57, (2, count))
    theta_i[: count // 2] = theta_r[: count // 2] + rng.normal(0.0, mu, count // 2)
    angles = geometry(
        np.abs(theta_i), theta_r, np.where(rng.random(count) < 0.7, math.pi, rng.uniform(0, math.pi, count))
    )
    cosines = np.vstack([np.cos(angles[:, [0, 1, 3, 2]]).T, angles[:, 3]])
    cosines[:4, ::9] = -cosines[:4, ::9]  # under the horizon
    found = [(np.empty(count), np.empty((4, count))) for _ in range(2)]
    for run, (factor, out) in zip((_by_lanes, _by_numbers), found, strict=True):
        run(Lobes.of(name), math.log(mu), cosines, factor, out)
    (factor, lanes), (other, numbers) = found
    np.testing.assert_allclose(factor, other, rtol=1e-14)
    assert (factor[::9] == 0.0).all() and (factor[1::9] > 0.0).any()
    np.testing.assert_allclose(lanes[[0, 3]], numbers[[0, 3]], rtol=1e-12)
    np.testing.assert_allclose(lanes[0], lanes[3], rtol=1e-13)
    # Differences of large numbers: what is left has their last digits.
    np.testing.assert_allclose(lanes[1:3], numbers[1:3], rtol=1e-9, atol=1e-13 * np.abs(numbers[0]).max())


# --- draws ---------------------------------------------------------------------------------------------------------

VIEWS = pytest.mark.parametrize("theta", [0.0, 0.7, 1.3, 1.5])
WIDTHS = pytest.mark.parametrize("mu", [0.005, 0.08, 0.5, 1.2])


@every_lobe
@settings(deadline=None, max_examples=100)
@given(
    share=SHARES,
    theta=st.floats(0.0, math.pi / 2),
    turn=AZIMUTHS,
    u=st.tuples(*[st.floats(0.0, 1.0, exclude_max=True)] * 2),
)
@example(share=1.0, theta=math.pi / 2, turn=0.0, u=(0.999999999, 0.5))
def test_draws_are_unit_vectors_above_the_surface(name, share, theta, turn, u):
    v = math.sin(theta) * math.cos(turn), math.sin(theta) * math.sin(turn), math.cos(theta)
    half = np.array(lobe(name).draw(roughness(name, share), *v, *u))
    assert np.linalg.norm(half) == pytest.approx(1.0, abs=1e-9)
    assert half[2] >= -1e-12


def _grid(name: str, mu: float, nodes: int, furthest: float = math.pi / 2):
    """Return nodes and weights in φ, dense about the normal, and in azimuth from the view."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    t = 0.5 * (node + 1.0) * math.asinh(furthest / mu)
    phi, step = mu * np.sinh(t), 0.5 * weight * math.asinh(furthest / mu) * mu * np.cosh(t)
    azimuth = 0.5 * (node + 1.0) * math.pi
    return phi, step, azimuth, weight * math.pi  # both sides of the plane of incidence


@pytest.mark.default_cases(16)
@every_lobe
@VIEWS
@WIDTHS
def test_density_adds_up_to_the_share_of_useful_draws(name, mu, theta):
    phi, step, azimuth, around = _grid(name, mu, 200)
    value = half_density(name, mu, theta, phi[:, None], azimuth[None])
    view, count = view_at(theta), 100_000
    cos_h = math.cos(theta) * np.cos(phi)[:, None] + math.sin(theta) * np.sin(phi)[:, None] * np.cos(azimuth)
    lit = 2.0 * cos_h * np.cos(phi)[:, None] - view[2] > 0.0
    half = draws(name, mu, theta, count)
    drawn_cos_h = half @ view
    for useful, drawn in (
        (np.ones_like(lit), drawn_cos_h > 0.0),
        (lit, (drawn_cos_h > 0.0) & (2.0 * drawn_cos_h * half[:, 2] > view[2])),
    ):
        total = float(step @ (value * useful) @ around)
        share = float(drawn.mean())
        assert total <= 1.0 + 1e-3
        assert total == pytest.approx(share, abs=5.0 * math.sqrt(share * (1.0 - share) / count) + 2e-3)


@pytest.mark.default_cases(12)
@every_lobe
@pytest.mark.parametrize("theta", [0.0, 0.7, 1.3])
@WIDTHS
def test_draws_follow_their_density(name, mu, theta):
    count, columns = 200_000, 10
    half = draws(name, mu, theta, count, seed=1)
    phi = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    azimuth = np.abs(np.arctan2(half[:, 1], half[:, 0]))
    edges = np.concatenate([[0.0], np.quantile(phi, np.linspace(0.04, 0.98, 18)), [math.pi / 2]])
    sides = np.linspace(0.0, math.pi, columns + 1)
    drawn = np.histogram2d(phi, azimuth, bins=[edges, sides])[0]
    node, weight = np.polynomial.legendre.leggauss(12)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    p = edges[:-1, None] + np.diff(edges)[:, None] * node  # (bins, nodes)
    a = sides[:-1, None] + np.diff(sides)[:, None] * node
    value = half_density(name, mu, theta, p[:, :, None, None], a[None, None])
    area = np.diff(edges)[:, None] * np.diff(sides)
    expected = 2.0 * count * np.einsum("ipaq,p,q->ia", value, weight, weight) * area
    # A bin that the horizon of the view cuts through has a step that its nodes miss.
    whole = (value > 0.0).all(axis=(1, 3)) & (expected > 30.0)
    assert whole.sum() >= 60
    squares = ((drawn - expected)[whole] ** 2 / expected[whole]).sum()
    assert chi2.sf(squares, whole.sum()) > 1e-4
    assert drawn[whole].sum() == pytest.approx(expected[whole].sum(), rel=0.01)


# --- GGX -----------------------------------------------------------------------------------------------------------


def _ggx_of_the_papers(alpha, cos_i, cos_r, cos_m, context=np):
    """Return D, G₁ of both directions and G₂: Walter 2007 eq. 33 and 34, Heitz 2014 eq. 72 and 99."""
    tan2_m = (1 - cos_m**2) / cos_m**2
    d = alpha**2 / (context.pi * cos_m**4 * (alpha**2 + tan2_m) ** 2)

    def slope(c):
        return (context.sqrt(1 + alpha**2 * (1 - c**2) / c**2) - 1) / 2

    return d, 1 / (1 + slope(cos_i)), 1 / (1 + slope(cos_r)), 1 / (1 + slope(cos_i) + slope(cos_r))


@settings(deadline=None, max_examples=100)
@given(share=SHARES, theta_i=ANGLES, theta_r=ANGLES, azimuth=AZIMUTHS)
def test_ggx_is_that_of_the_papers(share, theta_i, theta_r, azimuth):
    mu, seen = roughness("ggx", share), geometry(theta_i, theta_r, azimuth)
    ci, cr = math.cos(theta_i), math.cos(theta_r)
    d, _, _, g = _ggx_of_the_papers(mu, ci, cr, math.cos(seen[3]))
    brdf = d * g / (4.0 * ci * cr)
    # β = 1 / (4 μ²) and F = 1: π L_o / E_n = π f cosθ_i.
    found = evaluate("ggx", mu, seen) / (4.0 * mu**2)
    assert found == pytest.approx(math.pi * brdf * ci, rel=1e-6 if seen[3] < 1e-2 else 1e-9)


def test_ggx_reflects_and_is_drawn_as_in_mitsuba():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rng = np.random.default_rng(4)
    for mu in (0.05, 0.3, 0.9):
        surface = mi.load_dict({"type": "roughconductor", "distribution": "ggx", "alpha": mu, "material": "none"})
        for _ in range(60):
            theta_r, theta_i = rng.uniform(0.02, 1.4), rng.uniform(0.02, 1.4)
            azimuth = rng.uniform(2.0, math.pi)
            seen = geometry(theta_i, theta_r, azimuth)
            light = mi.Vector3f(math.sin(theta_i), 0.0, math.cos(theta_i))
            view = [math.sin(theta_r) * math.cos(azimuth), math.sin(theta_r) * math.sin(azimuth), math.cos(theta_r)]
            interaction = mi.SurfaceInteraction3f()
            interaction.wi = mi.Vector3f(view)
            other = surface.eval(mi.BSDFContext(), interaction, light)[0]  # f cosθ_i, G = G₁ G₁
            ci, cr = math.cos(theta_i), math.cos(theta_r)
            _, g_i, g_r, g = _ggx_of_the_papers(mu, ci, cr, math.cos(seen[3]))
            found = evaluate("ggx", mu, seen) / (4.0 * mu**2) / math.pi
            assert found == pytest.approx(other * g / (g_i * g_r), rel=2e-4, abs=1e-6)
            density = lobe("ggx").density(mu, cr, math.cos(seen[3]), math.cos(seen[2]), seen[3])
            assert density == pytest.approx(surface.pdf(mi.BSDFContext(), interaction, light), rel=2e-4, abs=1e-6)


def test_a_ggx_surface_in_even_light_is_never_brighter_than_the_light():
    mu = np.geomspace(0.005, 1.2, 9)
    found = lobe_albedo("ggx", mu, np.cos(np.radians([0, 30, 60, 75, 85, 89]))) / (4.0 * mu[:, None] ** 2)
    assert (found <= 1.0 + 1e-5).all()
    # What facets reflect twice is left out, and of a smooth surface's little.
    assert (found[:3, :3] >= 0.998).all() and (found > 0.2).all()


@VIEWS
@WIDTHS
def test_visible_facets_of_ggx_fill_the_view(mu, theta):
    """The weak furnace of Smith's G₁: ∫ D G₁ max(V·H, 0) dω_H is cosθ_r."""
    phi, step, azimuth, around = _grid("ggx", mu, 400)
    value = half_density("ggx", mu, theta, phi[:, None], azimuth[None])
    assert float(step @ value @ around) == pytest.approx(1.0, abs=5e-4)


# --- the Gaussian --------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=100)
@given(share=SHARES, theta_i=ANGLES, theta_r=ANGLES, azimuth=AZIMUTHS)
def test_the_gaussian_is_that_of_equation_5(share, theta_i, theta_r, azimuth):
    mu, seen = roughness("gaussian", share), geometry(theta_i, theta_r, azimuth)
    ci, cr, ch, cp = np.cos(seen)
    d = np.exp(-((seen[3] / mu) ** 2))
    g = np.min([1.0, 2.0 * cp * cr / ch, 2.0 * cp * ci / ch])
    assert evaluate("gaussian", mu, seen) == pytest.approx(d * g / cr, rel=1e-12, abs=1e-70)


# --- digits --------------------------------------------------------------------------------------------------------


def _exact(name: str, t, angles):
    """Return D G / cosθ_r in forty digits."""
    mu, (theta_i, theta_r, theta_h, phi) = mpmath.e**t, angles
    ci, cr, ch, cp = (mpmath.cos(x) for x in (theta_i, theta_r, theta_h, phi))
    if name == "gaussian":
        return mpmath.e ** (-((phi / mu) ** 2)) * min(1, 2 * cp * cr / ch, 2 * cp * ci / ch) / cr
    d, _, _, g = _ggx_of_the_papers(mu, ci, cr, cp, mpmath.mp)
    return mpmath.pi * d * mu**2 * g / cr


@pytest.mark.parametrize("name", ["gaussian", "ggx"])
@settings(deadline=None, max_examples=100)
@given(share=SHARES, angles=st.tuples(*[st.floats(1e-9, 1.5)] * 3), phi=st.floats(1e-9, 1.5), small=st.floats(0.0, 8.0))
@example(share=0.0, angles=(1e-3, 1e-3, 1e-3), phi=1e-3, small=0.0)
@example(share=0.0, angles=(1e-8, 1e-8, 1e-8), phi=1e-8, small=0.0)
@example(share=0.0, angles=(1.4, 1.4, 1.4), phi=0.05, small=0.0)
def test_value_and_derivatives_have_their_digits(name, share, angles, phi, small):
    """Against forty digits, at angles that need not belong together; down to 1e-17 rad and a roughness of 0.005."""
    mu = roughness(name, share)
    seen = np.array([*angles, phi * 10.0**-small])
    found = evaluate_with_derivatives(name, mu, seen)
    with mpmath.workdps(40):
        exact = [mpmath.mpf(float(x)) for x in seen]
        t = mpmath.mpf(math.log(mu))
        true = [mpmath.diff(lambda s: _exact(name, s, exact), t, order, h=mpmath.mpf(10) ** -12) for order in (0, 1, 2)]
        # exp(-x) has the digits of x, and stays at 1e-74.
        steep = 1.0 + (seen[3] / mu) ** 2 if name == "gaussian" else 1.0
        tolerance = 1e-14 * steep * (1.0 + abs(math.log(mu)))
        # Terms of the derivatives that cancel have a size of their own.
        size = float(true[0]) * (1.0 if name == "ggx" else steep)
        for order, (one, two) in enumerate(zip(found, true, strict=True)):
            bound = 30.0 * tolerance * max(abs(float(two)), 16.0 * size * steep**order) + 1e-72 * steep**order
            assert abs(float(one - two)) <= bound, (order, one, float(two))


# --- albedo --------------------------------------------------------------------------------------------------------


@every_lobe
def test_more_nodes_hardly_change_the_albedo(name, monkeypatch):
    mu, cosine = np.geomspace(0.005, 1.2, 6), [1.0, 0.7, 0.3, 0.1, 0.02]
    usual = lobe_albedo(name, mu, cosine)
    monkeypatch.setattr(albedo, "_NODES", 300)
    albedo._kept_integrals.cache_clear()
    finer = lobe_albedo(name, mu, cosine)
    albedo._kept_integrals.cache_clear()
    assert usual == pytest.approx(finer, rel=1e-3)


@pytest.mark.default_cases(4)
@every_lobe
@pytest.mark.parametrize("mu", [0.1, 0.5, 1.2])
def test_albedo_is_the_integral_over_the_light(name, mu):
    theta_r = 0.8
    step = math.pi / 2 / 1000
    theta = (np.arange(1000) + 0.5) * step
    azimuth = (np.arange(240) + 0.5) * math.pi / 240
    value = evaluate(name, mu, geometry(theta[:, None], theta_r, azimuth[None]))
    total = 2.0 * (value * np.sin(theta)[:, None]).sum() * step / 240
    assert lobe_albedo(name, mu, math.cos(theta_r))[0, 0] == pytest.approx(total, rel=1e-4)
