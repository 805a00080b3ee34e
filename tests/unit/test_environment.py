"""Light from everywhere: irradiance against closed forms, principal components against the full decomposition."""

import dataclasses

import h5py
import numba
import numpy as np
import pytest
from compressing import compress
from exact_light import prior_of
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from shortcuts import irradiance_map
from threadpoolctl import threadpool_limits

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.models import CapturesSource, IrradianceMap, MirrorBallSource
from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError
from irodori.light.environment_file import Environment, PixelNoise, directions
from irodori.light.irradiance import irradiance_at
from irodori.light.omnidirectional import MeanLight, OmnidirectionalPicture, to_panorama
from irodori.light.stage import SURFACES, fill_masked, observers, prepare_environment, write_environment
from irodori.material.principal_components.basis_count import CompressOptions, choose
from irodori.material.principal_components.decomposition import decompose
from irodori.material.principal_components.second_moments import second_moments
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.published import spectrum

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


def test_the_mean_light_is_that_over_the_sphere_in_whatever_order_its_parts_are_read():
    rng = np.random.default_rng(3)
    weights, basis = rng.uniform(0.0, 1.0, (10, 8, 2)), rng.uniform(0.1, 1.0, (61, 2)) * [1.0, -0.5]
    expected = (basis @ (weights * directions(8, 10)[1][..., None]).sum(axis=(0, 1))) / (4.0 * np.pi)
    mean, flat = MeanLight((10, 8)), weights.reshape(-1, 2)
    for first, last in ((21, 80), (0, 3), (3, 21)):
        mean.add(flat[first:last], first)
    mean.add(flat[:3], 0)  # read again
    assert expected.min() < 0.0 < expected.max()
    np.testing.assert_allclose(mean.light(basis), np.maximum(expected, 0.0), rtol=1e-9, atol=1e-12)
    assert (mean.light(-np.abs(basis)) == 1.0).all()


def test_upward_white_is_the_radiance_of_a_diffuser_that_faces_up(tmp_path):
    basis = np.random.default_rng(1).uniform(0.1, 1, (61, 2))
    sky = np.tile(np.float32([2.0, 3.0]), (128, 256, 1))
    environment = Environment(sky, basis, irradiance_map(sky, 32, 16))
    assert np.allclose(environment.upward_white(), basis @ [2.0, 3.0], rtol=0.002)
    environment.save(tmp_path / "e.h5", store.Provenance("test"))
    loaded = Environment.load(tmp_path / "e.h5")
    for name in {field.name for field in dataclasses.fields(Environment)} - {"file"}:
        assert np.array_equal(getattr(loaded, name), getattr(environment, name))
    assert loaded.file == tmp_path / "e.h5" and environment.file is None


@pytest.mark.parametrize("name", ["irradiance", "basis_errors", "noise/response", "noise/light"])
def test_a_light_whose_parts_have_different_numbers_of_bases_is_refused(tmp_path, name):
    path, sky = tmp_path / "e.h5", np.ones((8, 16, 2), np.float32)
    noise = PixelNoise(np.ones((1, 3, 2)), np.ones((1, 3)), np.ones((3, 61)), np.ones((3, 61)))
    whole = Environment(sky, np.ones((61, 2)), irradiance_map(sky, 8, 4), basis_errors=np.ones((5, 61, 2)), noise=noise)
    whole.save(path, store.Provenance("test"))
    with h5py.File(path, "r+") as file:
        values = file[name][..., :1]
        del file[name]
        file[name] = values
    accept(path)
    with pytest.raises(InputError) as caught:
        Environment.load(path)
    assert caught.value.field == name


# --- principal components ----------------------------------------------------------------------------------------


def options(target: float, align: int) -> CompressOptions:
    """Bounds on the mean alone, exact storage."""
    return CompressOptions(target_delta_e_mean=target, target_delta_e_p99=np.inf, align=align, storage="single")


def image(seed: int, pixels: int = 400, rank: int = 6):
    rng = np.random.default_rng(seed)
    centres = np.linspace(0, 60, rank)
    basis = np.exp(-(((np.arange(61)[:, None] - centres) / 9.0) ** 2)) * rng.uniform(0.5, 2.0, rank)
    return rng.gamma(1.0, 0.3, (pixels, rank)) * rng.uniform(0.05, 1.0, rank), basis


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6))
@settings(deadline=None, max_examples=15)
def test_reconstruction_error_is_that_of_the_truncated_svd(seed, count):
    weights, basis = image(seed)
    full = weights @ basis.T
    vectors, transform = decompose(weights, basis).truncated(6)
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
@settings(deadline=None, max_examples=25)
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


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("weighting", ["nothing", "visual"])
@pytest.mark.parametrize("names", [("D65", "A"), ("D65", "FL11", "HP1")])
def test_compressed_light_keeps_the_colours_of_what_it_shines_on(names, weighting):
    rng = np.random.default_rng(4)
    materials = np.stack([spectrum(f"TCS{i}") for i in range(99)])
    lights = np.stack([spectrum(name) / spectrum(name).mean() for name in names])
    first, second = (materials[None] * lights[:, None]).reshape(-1, 61)[rng.integers(99 * len(names), size=(2, 4000))]
    mix = rng.uniform(size=(4000, 1))
    radiance = (first * mix + second * (1 - mix)).astype(np.float32)
    white = radiance.mean(axis=0).astype(float)
    found = choose(second_moments(radiance), None, observers(white), CompressOptions(weighting=weighting))
    assert found.budget_met and set(found.errors) == {"light", *(f"light on {name}" for name in SURFACES)}
    decoded = found.decode(found.encode(radiance)) @ found.basis.T
    matrix, white = observers(white)["light"]
    # On every third material: 130,000 pairs tell a mean and a 99th percentile.
    shown = materials[::3]
    colours = [[lab_from_xyz((light * one) @ matrix.T, white) for light in (radiance, decoded)] for one in shown]
    errors = np.concatenate([delta_e(*pair) for pair in colours])
    assert errors.mean() <= 0.1 and np.percentile(errors, 99) <= 0.5


# --- the stage ---------------------------------------------------------------------------------------------------


def write_inputs(folder, response, valid, calibration, clipped=None, noise=None):
    with store.create(folder / "linear.h5", store.Provenance("test")) as out:
        out.write("response", response.astype(np.float32), units="1", dims="row,column,band", quantity="response")
        out.write("valid", valid, units="1", dims="row,column", quantity="valid")
        clipped = 1 - valid if clipped is None else clipped
        out.write("clipped", clipped, units="1", dims="row,column", quantity="clipped")
        if noise is not None:
            out.write("exposure_noise", noise[None], units="1", dims="exposure,band,term", quantity="noise")
            out.write("exposure_limit", np.ones((1, len(noise))), units="1", dims="exposure,band", quantity="limit")
        out.attribute("filters", ["out"])
    with store.create(folder / "calibration.h5", store.Provenance("test")) as out:
        write_wavelength(out)
        for name, dims in (("basis", "wavelength,component"), ("weights_from_response", "band,component")):
            out.write(name, getattr(calibration, name), units="1", dims=dims, quantity=name)
        out.write("light", calibration.light, units="1", dims="wavelength", quantity="light")
        model = np.linalg.pinv(calibration.weights_from_response.T) @ calibration.basis.T
        out.write("band_response", model, units="1", dims="band,wavelength", quantity="model")
        out.write(
            "band_response_covariance",
            np.zeros((len(model), 61, len(model), 61)),
            units="1",
            dims="band,wavelength,other_band,other_wavelength",
            quantity="model",
        )
        out.attribute("filters", list(calibration.filters))


def stage(folder, target=0.0):
    prepare_environment(
        folder / "linear.h5",
        folder / "calibration.h5",
        folder / "e.h5",
        options(target, 4),
        made(IrradianceMap, {"max_error": 0.002, "max_height": 64}),
        store.Provenance("test"),
        prior=prior_of(Calibration.load(folder / "calibration.h5")),
    )
    return Environment.load(folder / "e.h5")


def test_stage_recovers_a_radiance_that_its_prior_holds(tmp_path):
    rng = np.random.default_rng(5)
    light = spectrum("A")
    basis = np.linalg.qr(image(6)[1])[0]
    sensitivity = rng.uniform(0.0, 1.0, (6, 61)) * light / 1e4
    matrix = np.linalg.inv(sensitivity @ basis).T  # weights = response @ M for reflectances in the basis
    reflectance = rng.uniform(0.0, 1.0, (40, 80, 6)) @ image(6)[1].T
    write_inputs(
        tmp_path,
        to_panorama(reflectance) @ sensitivity.T,
        np.ones((40, 80), np.uint8),
        Calibration(basis, LinearMapping(matrix), light, ("out",)),
    )
    environment = stage(tmp_path)
    truth = reflectance * light
    assert np.abs(environment.coefficients @ environment.basis.T - truth).max() <= 1e-3 * truth.max()
    normals = directions(32, 16)[0]
    expected = irradiance_map(truth.astype(np.float32), 32, 16)
    found = irradiance_at(environment.irradiance, normals) @ environment.basis.T
    assert np.abs(found - expected).max() <= 3e-3 * expected.max()
    with store.open_file(tmp_path / "e.h5") as file:
        errors = file.attribute("errors")["irradiance"]
    assert errors["height"] == len(environment.irradiance) and errors["max_error"] <= 0.002


def test_the_stage_states_the_noise_of_the_photograph_and_says_so_where_the_camera_has_none(tmp_path, caplog):
    rng = np.random.default_rng(9)
    calibration = Calibration(np.eye(61)[:, [10, 30, 50]], LinearMapping(np.eye(3)), np.full(61, 2.0), ("out",))
    response = rng.uniform(0.2, 1.0, (32, 64, 3))
    model = np.array([[1e-4, 4e-3], [4e-4, 0.0], [1e-6, 1e-3]])
    noisy = response + np.sqrt(model[:, 0] + model[:, 1] * response) * rng.standard_normal(response.shape)
    write_inputs(tmp_path, noisy, np.ones((32, 64), np.uint8), calibration, noise=model)
    light = stage(tmp_path)
    # Each wavelength is twice the response of its band.
    true = 2.0 * to_panorama(response)
    off = (light.coefficients @ light.basis.T)[..., [10, 30, 50]] - true
    deviation = light.noise.deviation(light.coefficients, light.basis)
    drawn = np.stack([light.noise.drawn(deviation, light.basis, rng) @ light.basis.T for _ in range(200)])
    stated = drawn[..., [10, 30, 50]].std(axis=0)
    np.testing.assert_allclose(np.mean(stated**2, axis=(0, 1)), 4.0 * (model[:, 0] + 0.6 * model[:, 1]), rtol=0.1)
    for limit, least, most in ((1.0, 0.62, 0.75), (2.0, 0.93, 1.0)):
        assert least < np.mean(np.abs(off) <= limit * stated) < most
    assert "noise" not in caplog.text
    for unknown in (None, np.full((3, 2), np.nan)):
        caplog.clear()
        write_inputs(tmp_path, noisy, np.ones((32, 64), np.uint8), calibration, noise=unknown)
        assert stage(tmp_path).noise is None
        assert "linear.h5: the camera's noise is not known" in caplog.text


def test_threads_do_not_change_a_bit_of_an_environment(tmp_path):
    """One thread and two write the same datasets and state the same errors."""
    rng = np.random.default_rng(15)
    calibration = Calibration(np.linalg.qr(image(6)[1])[0], LinearMapping(rng.normal(size=(6, 6)) + 3 * np.eye(6)),
                              spectrum("A"), ("out",))  # fmt: skip
    response = rng.uniform(0.0, 1.0, (128, 256, 6)) ** 4
    write_inputs(tmp_path, response, np.ones((128, 256), np.uint8), calibration)
    before, found = numba.get_num_threads(), []
    try:
        for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(count)
            with threadpool_limits(count):
                stage(tmp_path)
            with h5py.File(tmp_path / "e.h5") as file:
                found.append({name: file[name][()].tobytes() for name in ("coefficients", "basis", "irradiance")})
                found[-1]["errors"] = str(file.attrs["errors"])
    finally:
        numba.set_num_threads(before)
    assert found[0] == found[1]


@pytest.mark.parametrize(("bases", "readings"), [(8, 1), (9, 2)])
def test_pictures_of_few_weights_are_read_once_and_give_the_same_file(tmp_path, bases, readings, monkeypatch):
    """Tiles end elsewhere when a picture is read again, which changes the rounding only."""
    rng, count = np.random.default_rng(7), []
    basis, mixed = np.linalg.qr(rng.normal(size=(61, bases)))[0], rng.uniform(0.1, 1.0, (5, bases))
    weights = (rng.uniform(size=(40, 80, 5)) @ mixed).astype(np.float32)

    def read():
        count.append(1)
        yield from np.split(weights, 5)

    picture = OmnidirectionalPicture((40, 80), basis, read)
    found = []
    for name in ("own.h5", "always-twice.h5"):
        write_environment(
            picture, spectrum("D65"), tmp_path / name, options(0.0, 1),
            made(IrradianceMap, {"max_error": 0.01, "max_height": 32}), store.Provenance("test"),
        )  # fmt: skip
        light = Environment.load(tmp_path / name)
        found.append([part @ light.basis.T for part in (light.coefficients, light.irradiance)])
        monkeypatch.setattr("irodori.light.stage._KEPT", 0)
    assert len(count) == readings + 2
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5 * np.abs(other).max())
    np.testing.assert_allclose(found[0][0], weights @ basis.T, atol=2e-3 * np.abs(weights).max())


@pytest.mark.parametrize("centre_azimuth_deg", [0.0, 90.0])
def test_what_stood_to_the_right_of_a_photographs_middle_has_a_smaller_azimuth(tmp_path, centre_azimuth_deg):
    response = np.full((8, 16, 3), 0.1)
    response[4, 11] = 0.9  # 3.5 columns of 22.5 degrees to the right of the middle
    calibration = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out",))
    write_inputs(tmp_path, response, np.ones((8, 16), np.uint8), calibration)
    source = {"kind": "captures", "centre_azimuth_deg": centre_azimuth_deg}
    prepare_environment(
        tmp_path / "linear.h5",
        tmp_path / "calibration.h5",
        tmp_path / "e.h5",
        options(0.0, 4),
        made(IrradianceMap, {"max_error": 0.1, "max_height": 32}),
        store.Provenance("test"),
        source=made(CapturesSource | MirrorBallSource, source),
        prior=prior_of(calibration),
    )
    found = Environment.load(tmp_path / "e.h5").coefficients
    row, column = np.unravel_index(np.linalg.norm(found, axis=-1).argmax(), (8, 16))
    x, y, _ = directions(16, 8)[0][row, column]
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(centre_azimuth_deg - 3.5 * 22.5)


@pytest.mark.stability(stage="light", case="saturated window")
def test_stage_refuses_pixels_without_a_valid_bracket(tmp_path):
    valid = np.ones((8, 16), np.uint8)
    valid[3, 4] = 0
    calibration = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out",))
    write_inputs(tmp_path, np.ones((8, 16, 3)), valid, calibration)
    with pytest.raises(InputError, match="1 pixel saturated"):
        stage(tmp_path)
    assert not (tmp_path / "e.h5").exists()


def test_stage_refuses_a_photograph_whose_data_is_damaged(tmp_path):
    calibration = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out",))
    response = np.random.default_rng(2).uniform(0.1, 1, (80, 160, 3))
    write_inputs(tmp_path, response, np.ones((80, 160), np.uint8), calibration)
    with h5py.File(tmp_path / "linear.h5") as file:
        chunk = file["response"].id.get_chunk_info(0)
    content = bytearray((tmp_path / "linear.h5").read_bytes())
    middle = chunk.byte_offset + chunk.size // 2
    content[middle : middle + 64] = bytes(64)
    (tmp_path / "linear.h5").write_bytes(content)
    accept(tmp_path / "linear.h5")
    with pytest.raises(InputError, match="response: found unreadable data"):
        stage(tmp_path)
    assert not (tmp_path / "e.h5").exists()


def test_stage_refuses_bands_that_the_chart_did_not_have(tmp_path):
    calibration = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out", "in"))
    write_inputs(tmp_path, np.ones((8, 16, 3)), np.ones((8, 16), np.uint8), calibration)
    with pytest.raises(InputError, match="filters"):
        stage(tmp_path)


def test_an_environments_errors_are_those_of_its_light_and_its_map_and_gloss_is_blurred_if_asked_for(tmp_path, caplog):
    sky = np.random.default_rng(5).uniform(0.2, 1.0, (16, 32, 3)).astype(np.float32)
    picture = OmnidirectionalPicture((16, 32), np.eye(61)[:, [10, 30, 50]], lambda: iter([sky]))
    irradiance = made(IrradianceMap, {"max_error": 0.002, "max_height": 64})
    for name, glossy in (("plain", False), ("glossy", True)):
        file = tmp_path / f"{name}.h5"
        with caplog.at_level("INFO", logger="irodori"):
            write_environment(
                picture, None, file, options(0.0, 3), irradiance, store.Provenance("test"), gloss_maps=glossy
            )
        with store.open_file(file) as found:
            errors = found.attribute("errors")
            assert ("gloss/width" in found) == glossy
        assert {"delta_e", "negative_fraction", "compression", "irradiance"} == set(errors)
        assert errors["irradiance"]["height"] == 64 and 0.0 < errors["irradiance"]["max_error"] < 0.01
        assert "3 bases of 3" in caplog.text and "above its target" in caplog.text


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
    calibration = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out",))
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
    calibration = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out",))
    write_inputs(tmp_path, np.ones((8, 16, 3)), valid, calibration, np.zeros_like(valid))
    with pytest.raises(InputError, match="2 masked pixels beside each other"):
        stage(tmp_path)
