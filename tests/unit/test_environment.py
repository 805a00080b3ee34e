"""Light from everywhere: irradiance against closed forms, principal components against the full decomposition."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori import store
from irodori.colour import xyz_from_radiance
from irodori.environment import fill_masked, irradiance_map, prepare_environment
from irodori.errors import InputError
from irodori.light import Environment, directions
from irodori.principal import CompressOptions, compress, principal_basis
from irodori.recovery import Calibration
from irodori.spectra import spectrum

OBSERVERS = {"light": (xyz_from_radiance(spectrum("A")), xyz_from_radiance(spectrum("A")) @ spectrum("A"))}


@given(width=st.integers(1, 200), height=st.integers(1, 100))
@settings(deadline=None, max_examples=60)
def test_solid_angles_fill_the_sphere(width, height):
    unit, solid_angle = directions(width, height)
    assert solid_angle.shape == (height, width) and (solid_angle > 0).all()
    assert solid_angle.sum() == pytest.approx(4 * np.pi, rel=1e-12)
    assert np.allclose(np.linalg.norm(unit, axis=-1), 1.0, atol=1e-14)


def test_directions_follow_zenith_and_azimuth():
    unit, _ = directions(360, 180)
    assert unit[0, 0] @ [0, 0, 1] > 0.9999 and unit[-1, 0] @ [0, 0, -1] > 0.9999
    assert unit[90, 0] @ [1, 0, 0] > 0.999 and unit[90, 90] @ [0, 1, 0] > 0.999


@pytest.mark.parametrize("size", [(1000, 500), (514, 258), (256, 128)])
def test_constant_light_gives_pi_everywhere(size):
    radiance = np.array([1.0, 0.0, 7.5])
    out = irradiance_map(np.tile(radiance.astype(np.float32), (size[1], size[0], 1)), 64, 32)
    assert np.abs(out / np.pi - radiance).max() <= 0.002 * 7.5
    assert np.abs(out[..., 0] / np.pi - 1).max() <= 0.002


@pytest.mark.parametrize("place", [(3, 10), (60, 200), (64, 0), (100, 255), (126, 17)])
def test_one_bright_texel_gives_the_cosine_law(place):
    coefficients = np.zeros((128, 256, 2), dtype=np.float32)
    coefficients[place] = [5.0, 0.3]
    out = irradiance_map(coefficients, 64, 32)
    unit, solid_angle = directions(256, 128)
    cosine = directions(64, 32)[0] @ unit[place]
    expected = np.array([5.0, 0.3]) * (np.maximum(cosine, 0.0) * solid_angle[place])[..., None]
    # Only blocks cut by the horizon are approximate; a block of 4 x 4 texels spans 8 degrees.
    lit, dark = cosine > np.sin(np.radians(6)), cosine < -np.sin(np.radians(6))
    assert np.allclose(out[lit], expected[lit], rtol=0.005)
    assert (out[dark] == 0).all()


def test_irradiance_of_a_smooth_sky_matches_spherical_harmonics():
    unit, _ = directions(512, 256)
    axis = np.array([0.48, -0.6, 0.64])
    cosine = unit @ axis
    # L = 2 + cos + (3 cos² - 1): the clamped cosine multiplies degrees 0, 1, 2 by π, 2π/3, π/4 (Ramamoorthi 2001).
    coefficients = (2 + cosine + (3 * cosine**2 - 1))[..., None].astype(np.float32)
    normal = directions(40, 20)[0] @ axis
    expected = 2 * np.pi + 2 * np.pi / 3 * normal + np.pi / 4 * (3 * normal**2 - 1)
    assert np.allclose(irradiance_map(coefficients, 40, 20)[..., 0], expected, rtol=0.002)


@given(seed=st.integers(0, 2**32 - 1), factor=st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=20)
def test_irradiance_is_linear_and_turns_with_the_sky(seed, factor):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 1, (2, 32, 64, 3)).astype(np.float32)
    one, other = irradiance_map(a, 16, 8), irradiance_map(b, 16, 8)
    both = irradiance_map((a + np.float32(factor) * b).astype(np.float32), 16, 8)
    assert np.allclose(both, one + factor * other, rtol=1e-5)
    # A quarter turn about the zenith: 16 columns of the sky are 4 columns of the map.
    assert np.allclose(irradiance_map(np.roll(a, 16, axis=1), 16, 8), np.roll(one, 4, axis=1), rtol=1e-5)


def test_light_from_above_does_not_reach_normals_below():
    sky = np.zeros((64, 128, 1), dtype=np.float32)
    sky[:32] = 1.0
    out = irradiance_map(sky, 32, 33)[..., 0]
    theta = np.pi * (np.arange(33) + 0.5) / 33
    # A hemisphere seen by a tilted plane: π (1 + cosθ) / 2.
    assert np.allclose(out, (np.pi * (1 + np.cos(theta)) / 2)[:, None], atol=0.01 * np.pi)


def test_upward_white_is_the_radiance_of_a_diffuser_that_faces_up(tmp_path):
    basis = np.random.default_rng(1).uniform(0.1, 1, (61, 2))
    sky = np.tile(np.float32([2.0, 3.0]), (128, 256, 1))
    environment = Environment(sky, basis, irradiance_map(sky, 32, 16))
    assert np.allclose(environment.upward_white(), basis @ [2.0, 3.0], rtol=0.002)
    environment.save(tmp_path / "e.h5", store.Provenance("test"))
    loaded = Environment.load(tmp_path / "e.h5")
    for field in dataclasses.fields(Environment):
        assert np.array_equal(getattr(loaded, field.name), getattr(environment, field.name))


# --- principal components ----------------------------------------------------------------------------------------


def options(target: float, align: int) -> CompressOptions:
    """Bounds on the mean alone, exact storage."""
    return CompressOptions(target, np.inf, align, storage="single")


def image(seed: int, pixels: int = 400, rank: int = 6):
    rng = np.random.default_rng(seed)
    centres = np.linspace(0, 60, rank)
    basis = np.exp(-(((np.arange(61)[:, None] - centres) / 9.0) ** 2)) * rng.uniform(0.5, 2.0, rank)
    return rng.gamma(1.0, 0.3, (pixels, rank)) * rng.uniform(0.05, 1.0, rank), basis


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6))
@settings(deadline=None, max_examples=40)
def test_reconstruction_error_is_that_of_the_truncated_svd(seed, count):
    weights, basis = image(seed)
    full = weights @ basis.T
    vectors, transform = principal_basis(weights, basis)
    assert np.abs(vectors.T @ vectors - np.eye(6)).max() <= 1e-10
    decoded = (weights @ transform[:count].T) @ vectors[:, :count].T
    u, s, vt = np.linalg.svd(full, full_matrices=False)
    best = np.linalg.norm(full - (u[:, :count] * s[:count]) @ vt[:count])
    scale = np.linalg.norm(full)
    assert abs(np.linalg.norm(full - decoded) - best) <= 1e-6 * scale
    energies = np.linalg.norm(weights @ transform.T, axis=0)
    assert np.allclose(energies, s[:6], atol=1e-6 * s[0])


@pytest.mark.parametrize("align", [1, 2, 3, 4, 6, 8])
def test_an_image_of_rank_six_is_exact_with_six_bases(align):
    weights, basis = image(2)
    done = compress(weights, basis, OBSERVERS, options(0.0, align))
    full = weights @ basis.T
    assert done.basis.shape == (61, 6) and done.coefficients.shape == (400, 6)
    # Coefficients are single precision.
    assert np.abs(done.coefficients @ done.basis.T - full).max() <= 1e-6 * np.abs(full).max()
    assert done.errors["light"]["max"] <= 1e-3


@given(seed=st.integers(0, 2**32 - 1), target=st.floats(0.0, 30.0), align=st.integers(1, 8))
@settings(deadline=None, max_examples=60)
def test_the_fewest_aligned_bases_meet_the_target(seed, target, align):
    weights, basis = image(seed)
    done = compress(weights, basis, OBSERVERS, options(target, align))
    count = done.basis.shape[1]
    assert count % align == 0 or count == 6
    assert done.errors["light"]["mean"] <= target or count == 6
    assert done.errors["light"]["count"] == 400
    if count > align:  # the next smaller multiple would not have done
        less = max(k for k in range(align, count, align))
        fewer = compress(weights, basis, OBSERVERS, options(np.inf, less))
        assert fewer.basis.shape[1] == less
        assert fewer.errors["light"]["mean"] > target


def test_a_grey_image_needs_one_basis():
    weights = np.random.default_rng(3).uniform(0.1, 1.0, (300, 1)) * np.array([[0.2, 0.5, 0.9]])
    done = compress(weights, image(4, rank=3)[1], OBSERVERS, options(0.01, 1))
    assert done.basis.shape == (61, 1)
    assert np.allclose(done.coefficients @ done.basis.T, weights @ image(4, rank=3)[1].T, rtol=1e-5, atol=1e-6)


def test_negative_samples_are_counted():
    basis = np.eye(61)[:, :2]
    weights = np.tile([[1.0, -1.0], [1.0, 1.0]], (50, 1))
    done = compress(weights, basis, OBSERVERS, options(0.0, 1))
    assert done.negative_fraction == pytest.approx(0.5 / 61, rel=1e-9)
    assert compress(abs(weights), basis + 0.01, OBSERVERS, options(0.0, 1)).negative_fraction == 0


# --- the stage ---------------------------------------------------------------------------------------------------


def write_inputs(folder, response, valid, calibration, clipped=None):
    with store.create(folder / "linear.h5", store.Provenance("test")) as out:
        out.write("response", response.astype(np.float32), units="1", dims="row,column,band", quantity="response")
        out.write("valid", valid, units="1", dims="row,column", quantity="valid")
        clipped = 1 - valid if clipped is None else clipped
        out.write("clipped", clipped, units="1", dims="row,column", quantity="clipped")
        out.attribute("filters", ["out"])
    with store.create(folder / "calibration.h5", store.Provenance("test")) as out:
        for name in ("basis", "weights_from_response"):
            out.write(name, getattr(calibration, name), units="1", dims="a,b", quantity=name)
        out.write("light", calibration.light, units="1", dims="wavelength", quantity="light")
        out.attribute("filters", list(calibration.filters))


def stage(folder, target=0.0):
    prepare_environment(folder / "linear.h5", folder / "calibration.h5", folder / "e.h5", options(target, 4),
                        {"width": 32, "height": 16}, store.Provenance("test"))  # fmt: skip
    return Environment.load(folder / "e.h5")


def test_stage_recovers_radiance_as_light_times_reflectance(tmp_path):
    rng = np.random.default_rng(5)
    light = spectrum("A")
    basis = np.linalg.qr(image(6)[1])[0]
    sensitivity = rng.uniform(0.0, 1.0, (6, 61)) * light / 1e4
    matrix = np.linalg.inv(sensitivity @ basis).T  # weights = response @ M for reflectances in the basis
    reflectance = rng.uniform(0.0, 1.0, (40, 80, 6)) @ image(6)[1].T
    write_inputs(
        tmp_path, reflectance @ sensitivity.T, np.ones((40, 80), np.uint8), Calibration(basis, matrix, light, ("out",))
    )
    environment = stage(tmp_path)
    truth = reflectance * light
    assert np.abs(environment.coefficients @ environment.basis.T - truth).max() <= 1e-3 * truth.max()
    expected = irradiance_map(truth.astype(np.float32), 32, 16)
    assert np.abs(environment.irradiance @ environment.basis.T - expected).max() <= 1e-3 * expected.max()


def test_stage_refuses_pixels_without_a_valid_bracket(tmp_path):
    valid = np.ones((8, 16), np.uint8)
    valid[3, 4] = 0
    calibration = Calibration(np.eye(61)[:, :3], np.eye(3), np.ones(61), ("out",))
    write_inputs(tmp_path, np.ones((8, 16, 3)), valid, calibration)
    with pytest.raises(InputError, match="1 pixels saturated"):
        stage(tmp_path)
    assert not (tmp_path / "e.h5").exists()


def test_stage_refuses_bands_that_the_chart_did_not_have(tmp_path):
    calibration = Calibration(np.eye(61)[:, :3], np.eye(3), np.ones(61), ("out", "in"))
    write_inputs(tmp_path, np.ones((8, 16, 3)), np.ones((8, 16), np.uint8), calibration)
    with pytest.raises(InputError, match="filters"):
        stage(tmp_path)


def test_a_single_masked_pixel_takes_the_mean_of_its_neighbours_along_the_row(tmp_path, caplog):
    rng = np.random.default_rng(9)
    response = rng.uniform(0.2, 0.8, (8, 16, 3)).astype(np.float32)
    masked = np.zeros((8, 16), bool)
    masked[3, 4] = masked[5, 0] = masked[6, 15] = True  # two of them across the seam
    spoiled = np.where(masked[..., None], 0.0, response)
    filled = fill_masked(spoiled, masked)
    assert np.array_equal(filled[~masked], response[~masked])
    for row, column in ((3, 4), (5, 0), (6, 15)):
        assert np.allclose(filled[row, column], (response[row, column - 1] + response[row, (column + 1) % 16]) / 2)
    calibration = Calibration(np.eye(61)[:, :3], np.eye(3), np.ones(61), ("out",))
    valid = (~masked).astype(np.uint8)
    write_inputs(tmp_path, spoiled, valid, calibration, np.zeros_like(valid))
    with caplog.at_level("INFO", logger="irodori"):
        found = stage(tmp_path)
    assert "3 masked pixels filled" in caplog.text
    write_inputs(tmp_path, filled, np.ones_like(valid), calibration)
    assert np.allclose(found.coefficients, stage(tmp_path).coefficients)


def test_masked_pixels_beside_each_other_are_refused(tmp_path):
    valid = np.ones((8, 16), np.uint8)
    valid[3, [0, 15]] = 0  # neighbours across the seam
    calibration = Calibration(np.eye(61)[:, :3], np.eye(3), np.ones(61), ("out",))
    write_inputs(tmp_path, np.ones((8, 16, 3)), valid, calibration, np.zeros_like(valid))
    with pytest.raises(InputError, match="2 masked pixels beside each other"):
        stage(tmp_path)
