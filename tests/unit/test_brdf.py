"""The reflection model: Fresnel against complex arithmetic and textbooks, reciprocity, energy, no light from below."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from irodori.reflection import gaussian
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.reflection.fresnel import fresnel, fresnel_array

NORMAL = np.array([0.0, 0.0, 1.0])
COSINES = st.floats(0.0, 1.0)
MU = st.floats(gaussian.ROUGHNESS.low, gaussian.ROUGHNESS.high)
#: Transparent and absorbing media alike: n from a metal's 0.02 to a semiconductor's 6.
INDEX = st.one_of(
    st.tuples(st.floats(1.0, 6.0), st.floats(0.0, 100.0)),
    st.tuples(st.floats(0.02, 1.0), st.floats(1.0, 100.0)),
)


def facet_distribution(phi, mu):
    """Return D of the paper's lobe."""
    return gaussian.value(gaussian.constants(math.log(mu)), phi * phi, phi, phi)


def attenuation_over_cosine(cos_i, cos_r, cos_phi, cos_h):
    """Return G / cosθ_r of the paper's lobe."""
    return gaussian.features(cos_i, cos_r, cos_phi, cos_h, math.acos(min(cos_phi, 1.0)))[0]


def directions(max_deg=89.9):
    """Return a strategy for unit vectors above the horizon."""

    def vector(polar, azimuth):
        return np.array([math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)])

    return st.builds(vector, st.floats(0.0, math.radians(max_deg)), st.floats(0.0, 2 * math.pi))


def complex_fresnel(cosine, n, k):
    """Return R_s, R_p by complex amplitudes, the form found in optics textbooks."""
    index2 = np.complex128(complex(n, k)) ** 2
    # (n + ik)² - sin² without the cancellation at grazing incidence.
    inside = np.sqrt(complex((n - 1) * (n + 1) - k * k, 2 * n * k) + cosine * cosine)
    rs = (cosine - inside) / (cosine + inside)
    rp = (index2 * cosine - inside) / (index2 * cosine + inside)
    return abs(rs) ** 2, abs(rp) ** 2


def hemisphere(samples=200, azimuths=400):
    """Return unit vectors and weights that integrate cosθ dω / π over the upper hemisphere."""
    x, w = np.polynomial.legendre.leggauss(samples)
    cosine, w = 0.5 * (x + 1.0), 0.5 * w
    azimuth = (np.arange(azimuths) + 0.5) * 2 * np.pi / azimuths
    sine = np.sqrt(1 - cosine**2)[:, None]
    unit = np.stack(
        [sine * np.cos(azimuth), sine * np.sin(azimuth), np.broadcast_to(cosine[:, None], (samples, azimuths))], axis=-1
    )
    return unit, np.broadcast_to((w * cosine)[:, None] * 2 / azimuths, (samples, azimuths))


def gloss_albedo(theta_i, mu, beta, n, k, samples=300):
    """Return the directional albedo of the gloss term, integrated over the facets' normals.

    Each facet normal H sends the light to V = 2 (L·H) H - L, and dω_V = 4 (L·H) dω_H.
    """
    light = np.array([math.sin(theta_i), 0.0, math.cos(theta_i)])
    limit = min(7.0 * mu, math.pi / 2)
    x, w = np.polynomial.legendre.leggauss(samples)
    phi, w = 0.5 * limit * (x + 1.0), 0.5 * limit * w
    azimuth = (np.arange(2 * samples) + 0.5) * math.pi / samples
    sine = np.sin(phi)[:, None]
    facet = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(phi)[:, None] + 0 * azimuth], axis=-1)
    cos_h = facet @ light
    camera = 2 * cos_h[..., None] * facet - light
    seen = (cos_h > 0) & (camera[..., 2] > 0)
    response = np.zeros(cos_h.shape)
    response[seen] = reflect(0.0, 0.0, beta, mu, angles_from_directions(NORMAL, light, camera[seen]), n=n, k=k)
    integrand = response * np.maximum(camera[..., 2], 0.0) * 4 * np.maximum(cos_h, 0.0) * sine * w[:, None]
    return integrand.sum() * (math.pi / samples) / (math.pi * math.cos(theta_i))


# Fresnel


@given(cosine=COSINES, index=INDEX)
@example(cosine=0.0, index=(1.5, 0.0))
@example(cosine=1.0, index=(1.0, 0.0))
@example(cosine=0.2, index=(1.5, 100.0))
@settings(deadline=None, max_examples=200)
def test_fresnel_of_glasses_and_metals_agrees_with_complex_amplitudes(cosine, index):
    n, k = index
    assume(cosine > 1e-3 or abs(complex(n - 1, k)) > 1e-3)  # grazing light on no surface at all: 0/0
    assert fresnel(cosine, n, k) == pytest.approx(np.mean(complex_fresnel(cosine, n, k)), rel=0, abs=1e-12)


@given(cosine=COSINES, n=st.floats(0.02, 1.0), k=st.floats(0.0, 100.0))
@settings(deadline=None, max_examples=200)
def test_fresnel_of_media_thinner_than_air_agrees_with_complex_amplitudes(cosine, n, k):
    # At the critical angle n² = sin² the reflectance has a square-root branch point: no arithmetic keeps its digits.
    assume(abs(complex(n, k) ** 2 - (1 - cosine**2)) > 1e-2)
    assert fresnel(cosine, n, k) == pytest.approx(np.mean(complex_fresnel(cosine, n, k)), rel=0, abs=1e-12)


@given(cosine=st.floats(1e-6, 1.0))
def test_an_index_like_airs_reflects_nothing(cosine):
    assert fresnel(cosine, 1.0, 0.0) == pytest.approx(0.0, abs=1e-9)


def test_no_index_near_airs_reflects_less_than_nothing():
    rng = np.random.default_rng(4)
    cosine, above, k = rng.random(20000), *10 ** rng.uniform(-16, -2, (2, 20000))
    assert min(map(fresnel, cosine, 1 + above, k)) >= 0.0


@pytest.mark.stability(stage="render", case="Fresnel with large k")
@given(cosine=st.floats(-0.1, 1.1), n=st.floats(1e-3, 100.0), k=st.floats(0.0, 100.0))
@example(cosine=0.5, n=1.5, k=100.0)
@example(cosine=0.0, n=0.05, k=100.0)
@example(cosine=0.3, n=0.9, k=0.0)
@example(cosine=0.0, n=1.0, k=0.0)
@example(cosine=1.0, n=1.0, k=0.0)
@settings(deadline=None, max_examples=200)
def test_fresnel_reflects_between_nothing_and_everything(cosine, n, k):
    assert 0.0 <= fresnel(cosine, n, k) <= 1.0


@given(n=st.floats(0.02, 100.0), k=st.floats(0.0, 100.0))
@settings(deadline=None)
def test_fresnel_at_normal_incidence_is_the_textbook_quotient(n, k):
    assert fresnel(1.0, n, k) == pytest.approx(((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), rel=1e-12, abs=1e-14)


@pytest.mark.stability(stage="render", case="Fresnel at 90°")
@given(n=st.floats(0.02, 100.0), k=st.floats(0.0, 100.0))
@settings(deadline=None)
def test_everything_is_a_mirror_at_grazing_incidence(n, k):
    assume(abs(n - 1) > 1e-6 or k > 1e-6)
    assert fresnel(0.0, n, k) == pytest.approx(1.0, abs=1e-12)


@given(n=st.floats(1.01, 10.0))
@settings(deadline=None)
def test_brewster_angle_reflects_no_p_polarised_light(n):
    # At tan θ = n the s reflectance is ((n² - 1) / (n² + 1))², and the unpolarised one is half of it.
    expected = 0.5 * ((n * n - 1) / (n * n + 1)) ** 2
    assert fresnel(math.cos(math.atan(n)), n, 0.0) == pytest.approx(expected, abs=1e-14)


@given(n=st.floats(0.1, 0.95), fraction=st.floats(0.01, 1.0))
@settings(deadline=None)
def test_light_beyond_the_critical_angle_is_totally_reflected(n, fraction):
    critical = math.asin(n)
    theta = critical + fraction * (math.pi / 2 - critical)
    assert fresnel(math.cos(theta), n, 0.0) == pytest.approx(1.0, abs=1e-12)


@given(index=INDEX)
@settings(deadline=None)
def test_at_45_degrees_p_reflectance_is_the_square_of_s(index):
    # Abelès' relation R_p = R_s² at 45°, for dielectrics and metals alike (Born and Wolf, §14.2): it fixes R_p, R_s.
    total = fresnel(math.sqrt(0.5), *index)
    rs = (math.sqrt(1 + 8 * total) - 1) / 2
    assert rs == pytest.approx(complex_fresnel(math.sqrt(0.5), *index)[0], abs=1e-12)


def test_glass_at_45_degrees_reflects_5_percent():
    # Hecht, Optics, §4.6.2, from R_s = sin²(θi-θt) / sin²(θi+θt), R_p = tan²(θi-θt) / tan²(θi+θt).
    assert fresnel(math.cos(math.radians(45)), 1.5, 0.0) == pytest.approx(0.0502, abs=5e-5)


@pytest.mark.stability(stage="render", case="Fresnel with large k")
@pytest.mark.parametrize(
    ("n", "k", "reflectance"),
    [(0.20, 3.44, 0.94), (0.47, 2.83, 0.82), (1.44, 5.23, 0.83)],
    ids=["silver", "gold", "aluminium"],
)
def test_metals_reflect_what_born_and_wolf_tabulate(n, k, reflectance):
    # Principles of Optics, table 14.1, sodium D light at normal incidence, two decimals.
    assert fresnel(1.0, n, k) == pytest.approx(reflectance, abs=0.005)


def test_glass_reflects_9_percent_of_diffuse_light():
    # Judd (1942), J. Res. NBS 29, 329: 0.0918 for n = 1.50, all angles weighted by cosθ dω / π.
    x, w = np.polynomial.legendre.leggauss(200)
    cosine = 0.5 * (x + 1)
    total = sum(weight * c * fresnel(c, 1.5, 0.0) for c, weight in zip(cosine, w, strict=True))
    assert total == pytest.approx(0.0918, abs=5e-5)


# Facets


@given(mu=MU, phi=st.floats(0.0, math.pi / 2))
def test_facet_distribution_is_one_at_the_normal_and_falls_with_the_angle(mu, phi):
    assert facet_distribution(0.0, mu) == 1.0
    assert facet_distribution(mu, mu) == pytest.approx(math.exp(-1), rel=1e-14)
    assert 0.0 <= facet_distribution(phi, mu) <= 1.0
    assert facet_distribution(phi, mu) >= facet_distribution(phi + 0.01, mu)


@given(light=directions(90), camera=directions(90))
@settings(deadline=None, max_examples=150)
def test_shadowing_over_cosine_is_bounded_at_grazing_angles(light, camera):
    half = light + camera
    half /= np.linalg.norm(half)
    cos_i, cos_r, cos_phi, cos_h = light[2], camera[2], half[2], half @ camera
    assume(cos_h > 1e-6)
    value = attenuation_over_cosine(cos_i, cos_r, cos_phi, cos_h)
    assert 0.0 <= value <= 2 * cos_phi / cos_h * (1 + 1e-12)
    assert value * cos_r <= 1.0 + 1e-12


@given(light=directions(80), camera=directions(80))
@settings(deadline=None)
def test_shadowing_is_the_v_cavity_factor(light, camera):
    half = light + camera
    half /= np.linalg.norm(half)
    factor = min(1.0, 2 * half[2] * camera[2] / (camera @ half), 2 * half[2] * light[2] / (camera @ half))
    value = attenuation_over_cosine(light[2], camera[2], half[2], half @ camera)
    assert value * camera[2] == pytest.approx(factor, rel=1e-12)


# The whole model


@pytest.mark.stability(stage="render", case="reciprocity")
@given(
    light=directions(),
    camera=directions(),
    index=INDEX,
    mu=MU,
    alpha=st.floats(0.0, 1.0),
    beta=st.floats(0.0, 1000.0),
)
@settings(deadline=None, max_examples=200)
def test_reflection_is_reciprocal(light, camera, index, mu, alpha, beta):
    assume(abs(complex(*index) - 1) > 0.01)  # an index like air's reflects 0, of which no relative digits exist
    there = angles_from_directions(NORMAL, light, camera)
    back = angles_from_directions(NORMAL, camera, light)
    f_there = reflect(alpha, 0.7, beta, mu, there, n=index[0], k=index[1]) / light[2]
    f_back = reflect(alpha, 0.7, beta, mu, back, n=index[0], k=index[1]) / camera[2]
    # exp(-(φ/μ)²) magnifies the rounding of φ by 2 (φ/μ)²; below 1e-200 it is darkness.
    assert f_there == pytest.approx(f_back, rel=1e-10, abs=1e-200)


@given(light=directions(180), camera=directions(180), index=INDEX, mu=MU)
@settings(deadline=None, max_examples=150)
def test_no_light_comes_from_or_goes_below_the_surface(light, camera, index, mu):
    assume(np.linalg.norm(light + camera) > 1e-9)
    value = reflect(0.8, 1.0, 10.0, mu, angles_from_directions(NORMAL, light, camera), n=index[0], k=index[1])
    assert np.isfinite(value) and value >= 0.0
    if light[2] <= 0 or camera[2] <= 0:
        assert value == 0.0


@pytest.mark.parametrize("theta_i", [0.0, 1.0, math.pi / 2, 2.0])
@pytest.mark.parametrize("theta_r", [math.pi / 2, 1.7, 3.0])
def test_exactly_on_the_horizon_there_is_no_light(theta_i, theta_r):
    geometry = np.array([[theta_i, theta_r, 0.5 * abs(theta_i - theta_r), 0.5 * (theta_i + theta_r)]])
    assert reflect(0.8, 1.0, 10.0, 0.3, geometry)[0] == 0.0
    assert reflect(0.8, 1.0, 10.0, 0.3, geometry[:, [1, 0, 2, 3]])[0] == 0.0


@given(cosine=COSINES, index=INDEX)
@settings(deadline=None)
def test_fresnel_over_an_array_is_that_of_each_of_its_numbers(cosine, index):
    assert fresnel_array(np.full((2, 3), cosine), *index) == pytest.approx(np.full((2, 3), fresnel(cosine, *index)))


@given(polar=st.floats(0.0, math.radians(89)), alpha=st.floats(0.0, 1.0), reflectance=st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=20)
def test_a_matte_surface_reflects_alpha_times_its_reflectance(polar, alpha, reflectance):
    light = np.array([math.sin(polar), 0.0, math.cos(polar)])
    unit, weight = hemisphere(24, 16)
    response = reflect(alpha, reflectance, 0.0, 0.1, angles_from_directions(NORMAL, light, unit))
    albedo = np.sum(weight * response) / light[2]
    assert albedo == pytest.approx(alpha * reflectance, rel=1e-10)


@pytest.mark.default_cases(10)
@pytest.mark.parametrize("mu", [gaussian.ROUGHNESS.low, 0.02, 0.1, 0.3, 0.6, gaussian.ROUGHNESS.high])
@pytest.mark.parametrize("theta_deg", [0.0, 30.0, 60.0, 80.0, 89.0])
def test_gloss_up_to_a_quarter_over_mu_squared_conserves_energy(mu, theta_deg):
    # Facets of V cavities reflect no more than they receive when ∫ D cosφ dω <= 1; for the Gaussian that integral is
    # below π μ², hence β <= 1 / (4 μ²). n + ik is an almost perfect mirror, F > 0.9999. The quadrature's own error is
    # measured by doubling it, and only that much is granted.
    theta = math.radians(theta_deg)
    coarse, fine = (gloss_albedo(theta, mu, 0.25 / mu**2, 1.0, 1e5, samples) for samples in (100, 200))
    assert fine == pytest.approx(coarse, abs=2e-3)
    assert 0.0 < fine <= 1.0 + abs(fine - coarse) + 1e-4


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("mu", [gaussian.ROUGHNESS.low, 0.02, 0.05])
def test_smooth_gloss_of_a_quarter_over_mu_squared_returns_all_light(mu):
    # The white furnace: a perfect mirror's narrow lobe loses only O(μ²).
    assert gloss_albedo(0.0, mu, 0.25 / mu**2, 1.0, 1e5) == pytest.approx(1.0, abs=2 * mu**2 + 1e-4)
    assert gloss_albedo(math.radians(45), mu, 0.25 / mu**2, 1.0, 1e5) == pytest.approx(1.0, abs=10 * mu**2 + 1e-4)


def test_gloss_integrated_over_views_equals_gloss_integrated_over_facets():
    light = np.array([math.sin(0.7), 0.0, math.cos(0.7)])
    unit, weight = hemisphere()
    over_views = np.sum(weight * reflect(0.0, 0.0, 1.0, 0.4, angles_from_directions(NORMAL, light, unit))) / light[2]
    assert over_views == pytest.approx(gloss_albedo(0.7, 0.4, 1.0, 1.5, 0.0), rel=1e-3)


# Angles


@given(angle=st.floats(1e-7, 1e-3), azimuth=st.floats(0.0, 2 * math.pi), tilt=st.floats(0.0, 3.0))
def test_small_angles_keep_their_digits(angle, azimuth, tilt):
    def place(v):
        c, s = math.cos(tilt), math.sin(tilt)
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ v

    def from_normal(a):
        return np.array([math.sin(a) * math.cos(azimuth), math.sin(a) * math.sin(azimuth), math.cos(a)])

    theta_i, theta_r, theta_h, phi = angles_from_directions(
        place(NORMAL), place(from_normal(angle)), place(from_normal(-3 * angle))
    )
    # Unit vectors rounded to 1e-16 know an angle to a few 1e-16 rad.
    assert theta_i == pytest.approx(angle, abs=1e-15)
    assert theta_r == pytest.approx(3 * angle, abs=1e-15)
    assert theta_h == pytest.approx(2 * angle, abs=1e-15)
    assert phi == pytest.approx(angle, abs=1e-15)


@given(light=directions(), camera=directions())
def test_angles_agree_with_the_arc_cosine_where_that_is_accurate(light, camera):
    half = (light + camera) / np.linalg.norm(light + camera)
    angles = angles_from_directions(NORMAL, light, camera)
    cosines = np.array([light[2], camera[2], half @ light, half[2]])
    wide = np.abs(cosines) < 0.99
    assert angles[wide] == pytest.approx(np.arccos(cosines[wide]), abs=1e-14)


def test_light_opposite_to_the_camera_gives_no_nan():
    light = np.array([[1.0, 0.0, 0.0], [0.6, 0.0, 0.8]])
    angles = angles_from_directions(NORMAL, light, -light)
    assert np.isfinite(angles).all()
    assert (reflect(1.0, 1.0, 1.0, 0.1, angles) == 0.0).all()


def test_angles_broadcast_normals_lights_and_one_camera():
    rng = np.random.default_rng(3)
    normal, light = rng.normal(size=(5, 1, 3)), rng.normal(size=(4, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light /= np.linalg.norm(light, axis=-1, keepdims=True)
    angles = angles_from_directions(normal, light, NORMAL)
    assert angles.shape == (5, 4, 4)
    assert angles[3, 2] == pytest.approx(angles_from_directions(normal[3, 0], light[2], NORMAL), abs=1e-15)
