"""From files to linear responses: scale, noise, masks, order of bands, refusals."""

import dataclasses

import numpy as np
import pytest
import yaml
from dng_files import write_any_dng
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_studio import (
    ANGLE,
    BALANCE,
    BLACK,
    PROVENANCE,
    REFLECTANCE,
    ROOT,
    SENSOR,
    SIZE,
    SUPERPIXELS,
    WHITE,
    Studio,
    dng,
    scene,
    vignetting,
)

from irodori.config.capture_table import Pose, Shot, read_captures, write_captures
from irodori.config.models import Optics, RigPose
from irodori.config.parts import NearLamp, RigGeometry
from irodori.core import store
from irodori.core.custody import content_sha256
from irodori.core.errors import InputError
from irodori.geometry.lamp import Lamp
from irodori.geometry.pinhole import Pinhole
from irodori.ingest.camera_reference import Reference, ingest_reference
from irodori.ingest.develop import _noise_model
from irodori.ingest.flat_field import evaluate_flat, find_spot, fit_flat
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.merge import ExposureBracket
from irodori.ingest.mosaic import ALGORITHMS
from irodori.ingest.near_lamp import evenly_lit
from irodori.ingest.stage import ingest_raw
from irodori.light.environment_file import merged_variance


def test_responses_are_the_truth_within_their_noise(tmp_path):
    studio = Studio(tmp_path, seed=11)
    studio.references(frames=4)
    truth = scene(studio.rng)
    pose = Pose(ANGLE, 0.0)
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        studio.shoot("object", truth, state, exposure_s)
    response, valid, noise, pose_deg = studio.ingest(pose.name)
    assert response.shape == truth.shape and (valid == 1).all() and pose_deg == [ANGLE, 0.0, 0.0, 0.0, 0.0]
    error = response - truth
    # Without the flat field the corners would be a third too dark; with it no band leans anywhere.
    height, width = truth.shape[:2]
    corners = [error[y, x] for y in (slice(0, 20), slice(height - 20, None)) for x in
               (slice(0, 20), slice(width - 20, None))]  # fmt: skip
    for region in (*corners, error[height // 2 - 10 :][:20]):
        assert np.abs(region.mean(axis=(0, 1))).max() <= 0.004
    # At the centre, where the noise model holds, it predicts the scatter.
    middle = (slice(height // 2 - 20, height // 2 + 20), slice(width // 2 - 20, width // 2 + 20))
    predicted = np.sqrt(noise[:, 0] + noise[:, 1] * truth[middle])
    assert np.allclose((error[middle] / predicted).std(axis=(0, 1)), 1.0, atol=0.1)


def test_reference_measures_gain_and_read_noise(tmp_path):
    superpixels = (200, 260, 6)
    studio = Studio(tmp_path, seed=12)
    for _ in range(6):
        studio.shoot("dark", np.zeros(superpixels))
    for _ in range(2):
        studio.shoot("white", np.full(superpixels, 0.9))
    ingest_reference(studio.table(), tmp_path, tmp_path / "r.h5", PROVENANCE, 0.95, SUPERPIXELS)
    with store.open_file(tmp_path / "r.h5") as file:
        assert file.attribute("gain_e_per_dn") == pytest.approx(SENSOR.electrons_per_dn, rel=0.03)
        noise = np.hypot(SENSOR.read_noise_e / SENSOR.electrons_per_dn, np.sqrt(1 / 12))
        assert file.attribute("read_noise_dn") == pytest.approx(noise, rel=0.03)
    dark = Reference.load(tmp_path / "r.h5").dark
    assert abs(dark.signal_dn(0.02)).mean() < 3 * noise / np.sqrt(6)


@pytest.mark.stability(stage="ingest", case="saturated pixels")
def test_saturated_samples_are_invalid_and_only_they(tmp_path):
    studio = Studio(tmp_path, seed=13)
    studio.references()
    truth = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.4)
    truth[20:30, 40:60, 1] = 3.0  # far above the full well, in one band
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        studio.shoot("object", truth, state, exposure_s)
    valid = studio.ingest(Pose(ANGLE, 0.0).name)[1]
    expected = np.ones_like(valid)
    expected[20:30, 40:60] = 0
    assert np.array_equal(valid, expected)


def test_brackets_merge_to_one_linear_scale(tmp_path):
    studio = Studio(tmp_path, seed=14)
    studio.references(frames=4)
    steps = np.geomspace(0.02, 12.0, 6)
    truth = np.repeat(steps, 20)[None, :, None] * np.ones((SIZE[0] // 2, 1, 6))
    for state, base in (("out", 0.02), ("in", 0.05)):
        for factor in (1.0, 0.1):
            studio.shoot("object", truth, state, base * factor)
    response, valid, _, _ = studio.ingest(Pose(ANGLE, 0.0).name)
    assert (valid == 1).all()
    ratio = response / truth
    for column in range(0, 120, 20):
        assert np.allclose(ratio[:, column : column + 20].mean(axis=(0, 1)), 1.0, atol=0.005)


def test_a_picture_without_white_reference_is_in_full_scales_per_second(tmp_path):
    mosaic = np.full((64, 64), BLACK + 5000, np.uint16)
    dng(tmp_path / "a.dng", mosaic, exposure_s=0.25)
    write_captures(tmp_path / "captures.csv", [Shot("a.dng", "chart", Pose(0.0, 0.0), "out", 0.25)])
    table = tmp_path / "captures.csv"
    ingest_reference(table, tmp_path, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    ingest_raw(table, tmp_path, "chart", tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE, options=SUPERPIXELS)
    with store.open_file(tmp_path / "l.h5") as file:
        assert file.read("response").shape == (32, 32, 3)
        assert np.allclose(file.read("response"), 5000 / (WHITE - BLACK) / 0.25, rtol=1e-6)
        assert np.isnan(file.read("noise_model")).all()
        told = {name: file.attribute(name) for name in ("sample_px", "demosaic", "mosaic", "orientation")}
        assert told == {"sample_px": 2, "demosaic": "superpixel", "mosaic": "RGGB", "orientation": 0}
        assert file.dataset("response").attrs["units"] == "1/s"


def test_filter_states_of_different_sizes_are_refused(tmp_path):
    shots = []
    for state, shape in (("out", (64, 64)), ("in", (64, 62))):
        dng(tmp_path / f"{state}.dng", np.full(shape, BLACK + 5000, np.uint16))
        shots.append(Shot(f"{state}.dng", "object", Pose(45.0, 0.0), state, 0.02))
    table = tmp_path / "captures.csv"
    write_captures(table, shots)
    ingest_reference(table, tmp_path, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    with pytest.raises(InputError, match=r"in\.dng: size.*\(62, 64\).*\(64, 64\), as the other filter state"):
        ingest_raw(table, tmp_path, Pose(45.0, 0.0).name, tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE,
                   options=SUPERPIXELS)  # fmt: skip


def test_an_environment_of_another_size_keeps_the_scale(tmp_path):
    studio = Studio(tmp_path, seed=15)
    studio.references(frames=4)
    height, width = 50, 100
    mosaic = np.full((2 * height, 2 * width), 0.0)
    for state, base in (("out", 0.02), ("in", 0.05)):
        balance = BALANCE[("out", "in").index(state)]
        y, x = np.indices(mosaic.shape)
        seen = 0.8 * balance[y % 2 + x % 2]
        file = f"e-{state}.dng"
        dng(tmp_path / file, SENSOR.expose(seen, base, studio.rng), exposure_s=base)
        studio.shots.append(Shot(file, "environment", Pose(0.0, 0.0), state, base))
    response = studio.ingest("environment")[0]
    assert response.shape == (height, width, 6)
    assert np.allclose(response.mean(axis=(0, 1)), 0.8, rtol=0.01)


def test_a_place_is_not_divided_by_the_fall_off_of_a_near_lamp(tmp_path):
    """The white reference was lit unevenly, the place was not."""
    optics = Optics(focal_length_mm=50.0, pixel_pitch_um=100.0, width_px=SIZE[1], height_px=SIZE[0],
                    principal_point_px=(SIZE[1] / 2, SIZE[0] / 2))  # fmt: skip
    rig, pose = RigGeometry(camera_distance_mm=900.0, lamp_distance_mm=600.0), RigPose(light_deg=ANGLE, camera_deg=0.0)
    y, x = np.indices(SIZE)
    places = np.stack([x + 0.5, y + 0.5], axis=-1)
    power = Lamp.at(600.0).on_white(places, Pinhole.from_optics(optics), 900.0, Pose(ANGLE, 0.0))
    studio, even = Studio(tmp_path, seed=16), np.full((*SIZE, 6), 0.8)
    for _ in range(4):
        studio.shoot("dark", np.zeros((*SIZE, 6)))
        studio.shoot("white", REFLECTANCE * np.cos(np.radians(ANGLE)) * np.repeat(power[..., None], 6, axis=2))
    studio.shoot("environment", even)
    reference, linear, table = studio.reference(), tmp_path / "linear.h5", tmp_path / "captures.csv"
    found, lamp = {}, NearLamp(optics=optics, rig=rig, white_pose=pose)
    white = evenly_lit(Reference.load(reference).white["out"], (SIZE[1], SIZE[0]), lamp)
    flat = evaluate_flat(white, SIZE[0] // 2, SIZE[1] // 2) / vignetting()[::2, ::2, None]
    assert np.ptp(flat / flat.mean(axis=(0, 1)), axis=(0, 1)).max() < 0.03
    for near in (None, lamp):
        ingest_raw(table, tmp_path, "environment", reference, linear, PROVENANCE, options=SUPERPIXELS, near_lamp=near)
        with store.open_file(linear) as file:
            response = file.read("response")
        whole = response[:80, :120].reshape(4, 20, 6, 20, -1).mean(axis=(1, 3))
        found[near is not None] = np.abs(whole / 0.8 - 1.0).max()
    assert found[False] > 0.1
    assert found[True] < 0.01


@pytest.mark.parametrize("demosaic", ["superpixel", "linear"])
def test_an_environment_of_another_size_has_the_mean_dark_signal_subtracted(tmp_path, demosaic):
    """Per pixel it is not known where a stitched picture's pixels lay; offset and rate count as means."""
    table = []
    shots = [("dark", 0.01, 300), ("dark", 0.03, 500), ("white", 0.02, 400 + 3000)]
    shots += [("environment", 0.04, 600 + 1500), ("environment", 0.02, 400 + 750)]
    for number, (role, exposure_s, level) in enumerate(shots):
        shape = (32, 48) if role == "environment" else (64, 96)
        mosaic = np.full(shape, BLACK + level, np.uint16)
        write_any_dng(tmp_path / f"{number}.dng", mosaic, exposure_s=exposure_s, iso=100)
        table.append(Shot(f"{number}.dng", role, Pose(0.0, 0.0), "out", exposure_s))
    write_captures(tmp_path / "captures.csv", table)
    files, options = (tmp_path / "captures.csv", tmp_path), IngestOptions(demosaic=demosaic, register=False)
    ingest_reference(*files, tmp_path / "r.h5", PROVENANCE, 1.0, options)
    ingest_raw(*files, "environment", tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE, options=options)
    with store.open_file(tmp_path / "l.h5") as file:
        assert np.allclose(file.read("response"), 0.25, rtol=2e-3)


def test_ingest_refuses_what_it_cannot_normalise(tmp_path):
    studio = Studio(tmp_path, seed=16)
    studio.references()
    with pytest.raises(InputError, match="no-such-capture"):
        studio.ingest("no-such-capture")
    studio.shots = [s for s in studio.shots if s.filter == "out"]
    studio.shoot("chart", scene(studio.rng), "in", 0.05)
    with pytest.raises(InputError, match="filter"):
        studio.ingest("chart")
    studio.shots = studio.shots[:-1]
    studio.shoot("chart", np.full((50, 50, 6), 0.3))
    with pytest.raises(InputError, match="size"):
        studio.ingest("chart")


@pytest.mark.stability(stage="ingest", case="white reference overexposed")
def test_an_overexposed_white_reference_is_refused(tmp_path):
    studio = Studio(tmp_path, seed=17)
    studio.shoot("white", np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 4.0))
    with pytest.raises(InputError, match="saturated"):
        ingest_reference(studio.table(), tmp_path, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    assert not (tmp_path / "r.h5").exists()


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_a_fitted_flat_restores_any_polynomial_of_degree_four(seed):
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 44), indexing="ij")
    terms = [x**i * y**j for i in range(5) for j in range(5 - i)]
    truth = np.stack([1.0 + np.tensordot(rng.uniform(-0.1, 0.1, 15), terms, 1) for _ in range(3)], axis=-1)
    valid = rng.uniform(size=truth.shape[:2]) < 0.8
    spoiled = np.where(valid[..., None], truth, 1e3)
    assert np.allclose(evaluate_flat(fit_flat(spoiled, valid), *valid.shape), truth, rtol=1e-5)


def test_a_flat_reaches_from_edge_to_edge_and_is_at_its_centre_in_a_single_pixel():
    coefficients = np.zeros((1, 15))
    coefficients[0, [0, 1, 5]] = 2.0, 0.25, 0.5  # 1, y and x, in the order of powers
    np.testing.assert_allclose(evaluate_flat(coefficients, 2, 2)[..., 0], [[1.25, 2.25], [1.75, 2.75]])
    np.testing.assert_allclose(evaluate_flat(coefficients, 1, 3)[..., 0], [[1.5, 2.0, 2.5]])
    np.testing.assert_allclose(evaluate_flat(coefficients, 1, 1)[..., 0], [[2.0]])


def test_what_is_no_even_surface_is_no_flat():
    rng, valid = np.random.default_rng(3), np.ones((30, 40), bool)
    y, x = np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 40), indexing="ij")
    even = np.stack([1.0 + 0.2 * x - 0.1 * y**2] * 3, axis=-1)
    fit_flat(even * (1.0 + 0.04 * rng.standard_normal(even.shape)), valid)
    rough = even * (1.0 + np.array([0.0, 0.0, 0.07]) * rng.standard_normal(even.shape))
    for picture in (rough, even - 1.1, np.stack([even[..., 0], even[..., 1], x + y], axis=-1)):
        with pytest.raises(ValueError, match="about a smooth surface"):
            fit_flat(picture, valid)
    with pytest.raises(ValueError, match="without a single valid pixel"):
        fit_flat(even, ~valid)


@pytest.mark.parametrize(("depth", "radius_px"), [(0.15, 6.0), (0.15, 12.0), (-0.15, 9.0), (0.08, 12.0)])
def test_a_spot_on_a_white_reference_is_found_where_it_is(depth, radius_px):
    """The surface changes by a third from the middle to a corner, as behind a lens, and has 1 % of noise."""
    rng, valid = np.random.default_rng(4), np.ones((200, 300), bool)
    rows, columns = np.indices(valid.shape)
    even = (1.0 - 0.33 * (np.hypot(rows - 100, columns - 150) / 180.0) ** 2)[..., None] * [0.5, 0.8, 0.3]
    even = even * (1.0 + 0.01 * rng.standard_normal(even.shape))
    valid[0:30, 0:30] = False
    masked = np.where(valid[..., None], even, 9.0)
    assert find_spot(masked, valid, fit_flat(masked, valid)) is None
    blot = 1.0 - depth * (np.hypot(rows - 140, columns - 70) < radius_px)
    spoilt = masked * blot[..., None]
    found = find_spot(spoilt, valid, fit_flat(spoilt, valid))
    assert np.hypot(found.row - 140, found.column - 70) <= radius_px and found.difference * depth < 0.0
    assert 0.05 < abs(found.difference) <= abs(depth) + 0.02


def test_noise_of_a_dim_white_reference_is_no_spot():
    """Of pixels with 20 % of noise, the squares of 8 x 8 are off by up to 9 %."""
    rng, valid = np.random.default_rng(4), np.ones((200, 300), bool)
    flat = fit_flat(np.ones((*valid.shape, 3)), valid)
    noisy = 1.0 + 0.2 * rng.standard_normal((*valid.shape, 3))
    assert find_spot(noisy, valid, flat) is None
    noisy[80:90, 40:50] *= 0.6
    assert find_spot(noisy, valid, flat).difference < -0.25


def test_a_spot_on_the_white_reference_is_said(tmp_path, caplog):
    for depth in (0.0, 0.15):
        caplog.clear()
        folder = tmp_path / str(depth)
        folder.mkdir()
        studio = Studio(folder, seed=31)
        white = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.5)
        white[8:16, 8:16] *= 1.0 - depth
        studio.shoot("white", white)
        ingest_reference(studio.table(), folder, folder / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
        assert ("darker than a smooth surface, as by dust or a stain" in caplog.text) is (depth > 0.0)


def test_an_even_picture_is_a_flat_field_however_small_and_dim():
    """Sixteen rows and columns at a thousandth of the range vary by nothing."""
    even = np.full((16, 16, 3), 1e-3)
    assert np.allclose(evaluate_flat(fit_flat(even, np.ones((16, 16), bool)), 16, 16), even, rtol=1e-6)


def test_bands_stand_in_one_order_whatever_the_order_of_the_lines(tmp_path):
    pose = Pose(ANGLE, 0.0)
    pictures = []
    for number, states in enumerate([("out", "in"), ("in", "out")]):
        folder = tmp_path / str(number)
        folder.mkdir()
        studio = Studio(folder, seed=23)
        studio.references()
        truth = np.broadcast_to(np.linspace(0.1, 0.6, 6), (SIZE[0] // 2, SIZE[1] // 2, 6))
        for state in states:
            studio.shoot("object", truth, state, 0.02 if state == "out" else 0.05)
        pictures.append(studio.ingest(pose.name)[0].mean(axis=(0, 1)))
        np.testing.assert_allclose(pictures[-1], np.linspace(0.1, 0.6, 6), rtol=0.02)
        with store.open_file(folder / "linear.h5") as file:
            assert file.attribute("filters") == ["out", "in"]


def test_a_white_reference_that_does_not_fill_the_picture_is_refused(tmp_path):
    studio = Studio(tmp_path, seed=24)
    white = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.02)
    rows, columns = white.shape[0] // 4, white.shape[1] // 4
    white[rows:-rows, columns:-columns] = 0.9
    studio.shoot("white", white)
    with pytest.raises(InputError, match="fills the picture"):
        ingest_reference(studio.table(), tmp_path, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)


def test_identical_frames_tell_no_gain(tmp_path):
    studio = Studio(tmp_path, seed=27)
    studio.shoot("white", np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.9))
    twin = dataclasses.replace(studio.shots[0], file="twin.dng")
    (tmp_path / "twin.dng").write_bytes((tmp_path / studio.shots[0].file).read_bytes())
    studio.shots.append(twin)
    ingest_reference(studio.table(), tmp_path, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    with store.open_file(tmp_path / "r.h5") as file:
        assert np.isnan(file.attribute("gain_e_per_dn"))


def own_dng(folder, shots):
    """Write files of given ISO and aperture that saw the same light, and their table."""
    table = []
    for number, (role, exposure_s, iso, f_number, stated) in enumerate(shots):
        gain = exposure_s / 0.02 * (iso or 100) / 100 * (4.0 / (f_number or 4.0)) ** 2
        light = 0.0 if role == "dark" else 3000.0 * (0.3 if role == "object" else 1.0)
        values = np.full((64, 96), BLACK + light * gain).round().astype(np.uint16)
        write_any_dng(folder / f"{number}.dng", values, exposure_s=exposure_s, iso=iso, f_number=f_number)
        table.append(Shot(f"{number}.dng", role, Pose(0.0, 0.0), "out", exposure_s, *stated))
    write_captures(folder / "captures.csv", table)
    return folder / "captures.csv"


def run(folder, shots):
    table = own_dng(folder, shots)
    ingest_reference(table, folder, folder / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    capture = Pose(0.0, 0.0).name
    ingest_raw(table, folder, capture, folder / "r.h5", folder / "l.h5", PROVENANCE, options=SUPERPIXELS)
    with store.open_file(folder / "l.h5") as file:
        return file.read("response")


@pytest.mark.parametrize(
    ("exposure_s", "iso", "f_number"), [(0.02, 100, 4.0), (0.04, 100, 4.0), (0.02, 400, 4.0), (0.08, 200, 8.0)]
)
def test_exposure_iso_and_aperture_do_not_change_the_response(tmp_path, exposure_s, iso, f_number):
    response = run(tmp_path, [("white", 0.02, 100, 4.0, ()), ("object", exposure_s, iso, f_number, ())])
    assert np.allclose(response, 0.3, rtol=2e-3)
    with store.open_file(tmp_path / "l.h5") as file:
        assert file.dataset("response").attrs["units"] == "1"


def test_the_tables_settings_count_where_the_file_is_silent(tmp_path):
    response = run(tmp_path, [("white", 0.02, 0, 0.0, (100.0, 4.0)), ("object", 0.04, 0, 0.0, (200.0, 4.0))])
    # The files show twice the exposure in time; the table says that ISO doubled too, so the object is half as bright.
    assert np.allclose(response, 0.15, rtol=2e-3)


@pytest.mark.parametrize(("white", "own"), [(1.0, 1.25), (0.8, 1.0), (0.8, 0.6)])
def test_a_brighter_lamp_that_the_table_states_does_not_change_the_response(tmp_path, white, own):
    numbers = [("white", BLACK + 3000 * white, white), ("object", BLACK + 900 * own, own)]
    table = []
    for role, values, level in numbers:
        write_any_dng(tmp_path / f"{role}.dng", np.full((64, 96), round(values), np.uint16), exposure_s=0.02, iso=100)
        table.append(Shot(f"{role}.dng", role, Pose(0.0, 0.0), "out", 0.02, light_level=level))
    files = tmp_path / "captures.csv", tmp_path
    write_captures(files[0], table)
    assert read_captures(*files) == table
    ingest_reference(*files, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    capture = Pose(0.0, 0.0).name
    ingest_raw(*files, capture, tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE, options=SUPERPIXELS)
    with store.open_file(tmp_path / "l.h5") as file:
        assert np.allclose(file.read("response"), 0.3, rtol=2e-3)


OPTIONS = [SUPERPIXELS, IngestOptions(demosaic="linear", register=False)]


def photographs(folder, numbers, options, **tags):
    """Ingest photographs given as (role, exposure in s, ISO, digital numbers); return where the object's stand."""
    table = []
    for number, (role, exposure_s, iso, values) in enumerate(numbers):
        whole = np.broadcast_to(np.round(values), (64, 96)).astype(np.uint16)
        write_any_dng(folder / f"{number}.dng", whole, exposure_s=exposure_s, iso=iso, **tags)
        table.append(Shot(f"{number}.dng", role, Pose(0.0, 0.0), "out", exposure_s))
    write_captures(folder / "captures.csv", table)
    files = folder / "captures.csv", folder
    ingest_reference(*files, folder / "r.h5", PROVENANCE, 1.0, options)
    ingest_raw(*files, Pose(0.0, 0.0).name, folder / "r.h5", folder / "l.h5", PROVENANCE, options=options)
    return folder / "l.h5"


@pytest.mark.parametrize("darks", [0, 2])
@pytest.mark.parametrize("options", OPTIONS, ids=["superpixels", "demosaiced"])
def test_four_black_levels_are_each_subtracted_from_their_own_pixels(tmp_path, options, darks):
    """What is no light to each place of the mosaic shows in no response, and in none of its bands."""
    black = np.array([[300, 700], [1100, 1500]])
    level = np.tile(black, (32, 48))
    numbers = [("dark", 0.02, 100, level)] * darks
    numbers += [("white", 0.02, 100, level + 4000), ("object", 0.02, 100, level + 1000)]
    with store.open_file(photographs(tmp_path, numbers, options, black=black)) as file:
        assert np.allclose(file.read("response"), 0.25, rtol=1e-3)


@pytest.mark.parametrize("options", OPTIONS, ids=["superpixels", "demosaiced"])
def test_the_clip_level_lies_above_each_places_own_black(tmp_path, options):
    """Of two fields between which the clip level of one place lies, one is marked as clipped and the other not."""
    black, white = np.array([[300, 700], [1100, 1500]]), 8300
    level = np.tile(black, (32, 48))
    clip = level + options.saturation * (white - level)
    for offset, clips in ((-60.0, False), (60.0, True)):
        folder = tmp_path / str(clips)
        folder.mkdir()
        bright = level + 1000.0
        bright[::2, ::2] = clip[0, 0] + offset
        numbers = [("white", 0.02, 100, level + 4000), ("object", 0.02, 100, bright)]
        with store.open_file(photographs(folder, numbers, options, black=black, white=white)) as file:
            assert (file.read("clipped") == clips).all()


@pytest.mark.parametrize("options", OPTIONS, ids=["superpixels", "demosaiced"])
def test_the_dark_signal_is_amplified_with_the_iso_of_the_photograph(tmp_path, options):
    """Dark frames at ISO 100: at ISO 400 the same darkness counts four times as many digital numbers."""
    glow = np.random.default_rng(5).uniform(100.0, 300.0, (64, 96))
    for exposures in ((0.02,), (0.01, 0.02)):
        folder = tmp_path / str(len(exposures))
        folder.mkdir()
        numbers = [("dark", 0.02, 100, BLACK + glow), ("white", 0.02, 100, BLACK + glow + 3000)]
        numbers += [("object", t, 400, BLACK + 4 * t / 0.02 * (glow + 600)) for t in exposures]
        with store.open_file(photographs(folder, numbers, options)) as file:
            assert np.allclose(file.read("response"), 0.2, rtol=3e-3)


def test_a_dark_signal_below_one_digital_number_counts_in_dim_light(tmp_path):
    """LibRaw interpolates whole numbers; what rounding the dark signal leaves is subtracted all the same."""
    numbers = [("dark", 0.02, 100, BLACK + at) for at in (0, 1, 0, 1, 0)]
    numbers += [("white", 0.02, 100, BLACK + 4000), ("object", 0.02, 100, BLACK + 8)]
    for options in OPTIONS:
        folder = tmp_path / options.demosaic
        folder.mkdir()
        with store.open_file(photographs(folder, numbers, options)) as file:
            assert np.allclose(file.read("response"), 7.6 / 3999.6, rtol=2e-3)


@pytest.mark.parametrize("number", [0, 1])
def test_a_photograph_that_has_changed_since_its_hash_was_written_is_refused(tmp_path, number):
    """The white reference by what makes the camera's reference, the object by what makes its responses."""
    numbers = [("white", 0.02, 100, BLACK + 4000), ("object", 0.02, 100, BLACK + 1000)]
    photographs(tmp_path, numbers, SUPERPIXELS)
    table, shots = tmp_path / "captures.csv", read_captures(tmp_path / "captures.csv")
    write_captures(table, shots, {shot.file: content_sha256(tmp_path / shot.file) for shot in shots})
    output, capture = tmp_path / "l.h5", Pose(0.0, 0.0).name

    def run_again():
        ingest_reference(table, tmp_path, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
        ingest_raw(table, tmp_path, capture, tmp_path / "r.h5", output, PROVENANCE, options=SUPERPIXELS)

    run_again()
    changed = np.full((64, 96), BLACK + numbers[number][3] - 599, np.uint16)
    write_any_dng(tmp_path / f"{number}.dng", changed, exposure_s=0.02, iso=100)
    with pytest.raises(InputError, match=rf"{number}\.dng"):
        run_again()


def test_white_frames_that_repeat_an_exposure_are_brackets_of_their_own_that_count_alike(tmp_path):
    """Two of one exposure and one of half: a bracket of both exposures, and a frame alone under a brighter lamp."""
    numbers = [("white", t, 100, BLACK + level) for t, level in ((0.02, 4000), (0.02, 4400), (0.01, 2000))]
    numbers.append(("object", 0.02, 100, BLACK + 1050))
    with store.open_file(photographs(tmp_path, numbers, SUPERPIXELS)) as file:
        assert np.allclose(file.read("response"), 0.25, rtol=1e-3)


def test_a_white_reference_serves_while_half_of_it_is_not_saturated(tmp_path):
    """What is left of an even light tells it, and what is less than half of the picture does not."""
    for share, serves in ((0.42, True), (0.58, False)):
        folder = tmp_path / str(serves)
        folder.mkdir()
        white = np.full((64, 96), BLACK + 4000)
        white[:, : 2 * round(48 * share)] = 16383
        numbers = [("white", 0.02, 100, white), ("object", 0.02, 100, BLACK + 1000)]
        if serves:
            with store.open_file(photographs(folder, numbers, SUPERPIXELS)) as file:
                assert np.allclose(file.read("response"), 0.25, rtol=1e-3)
            continue
        with pytest.raises(InputError, match="saturated over 58%"):
            photographs(folder, numbers, SUPERPIXELS)


def test_the_size_of_captures_is_that_of_dark_frames_and_white_whatever_a_chart_has(tmp_path):
    table = []
    sizes = {"chart": (32, 48), "white": (64, 96), "object": (64, 96)}
    shots = [("chart", "out"), ("white", "out"), ("chart", "in"), ("object", "out")]
    for number, (role, state) in enumerate(shots):
        mosaic = np.full(sizes[role], BLACK + 3000, np.uint16)
        write_any_dng(tmp_path / f"{number}.dng", mosaic, exposure_s=0.02, iso=100)
        table.append(Shot(f"{number}.dng", role, Pose(0.0, 0.0), state, 0.02))
    write_captures(tmp_path / "captures.csv", table)
    files = tmp_path / "captures.csv", tmp_path
    ingest_reference(*files, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    reference = Reference.load(tmp_path / "r.h5")
    assert reference.size_px == (96, 64) and set(reference.white) == {"out"}
    arguments = tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE
    ingest_raw(*files, Pose(0.0, 0.0).name, *arguments, options=SUPERPIXELS)


@pytest.mark.parametrize(("light_deg", "tilt_deg"), [(50.0, 10.0), (50.0, -10.0), (-20.0, 40.0)])
def test_a_white_reference_that_leans_counts_by_the_angle_of_its_light(tmp_path, light_deg, tilt_deg):
    """One lit at normal incidence would be brighter by the cosine of what lies between light and normal."""
    table = []
    for number, (role, level, pose) in enumerate([("white", 4000, (light_deg, 0.0, tilt_deg)), ("object", 1000, ())]):
        write_any_dng(tmp_path / f"{number}.dng", np.full((64, 96), BLACK + level, np.uint16), exposure_s=0.02)
        table.append(Shot(f"{number}.dng", role, Pose(*pose) if pose else Pose(0.0, 0.0), "out", 0.02))
    write_captures(tmp_path / "captures.csv", table)
    files = tmp_path / "captures.csv", tmp_path
    ingest_reference(*files, tmp_path / "r.h5", PROVENANCE, 0.8, SUPERPIXELS)
    arguments = tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE
    ingest_raw(*files, Pose(0.0, 0.0).name, *arguments, options=SUPERPIXELS)
    with store.open_file(tmp_path / "l.h5") as file:
        expected = 0.25 * 0.8 * np.cos(np.radians(light_deg - tilt_deg))
        assert np.allclose(file.read("response"), expected, rtol=1e-3)


def test_a_chart_alone_says_nothing_of_the_size_of_captures(tmp_path):
    table = []
    for number, (role, shape) in enumerate([("chart", (32, 48)), ("object", (64, 96))]):
        write_any_dng(tmp_path / f"{number}.dng", np.full(shape, BLACK + 3000, np.uint16), exposure_s=0.02, iso=100)
        table.append(Shot(f"{number}.dng", role, Pose(0.0, 0.0), "out", 0.02))
    write_captures(tmp_path / "captures.csv", table)
    files = tmp_path / "captures.csv", tmp_path
    ingest_reference(*files, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
    assert Reference.load(tmp_path / "r.h5").size_px == (0, 0)
    output = tmp_path / "l.h5"
    ingest_raw(*files, Pose(0.0, 0.0).name, tmp_path / "r.h5", output, PROVENANCE, options=SUPERPIXELS)
    assert output.exists()


@pytest.mark.parametrize("level_dn", [400.0, 0.0])
def test_the_noise_model_is_that_of_the_photographs_iso(tmp_path, level_dn):
    """Gain and read noise are measured at ISO 100; the model of a photograph at ISO 800 predicts its own scatter."""
    rng = np.random.default_rng(6)

    def expose(level_dn, iso):
        electrons = rng.poisson(2.0 * level_dn, (64, 96)) + rng.normal(0.0, 12.0, (64, 96))
        return BLACK + electrons / 2.0 * iso / 100

    numbers = [(role, 0.02, 100, expose(level, 100)) for role, level in [("dark", 0)] * 6 + [("white", 4000)] * 4]
    numbers.append(("object", 0.02, 800, expose(level_dn, 800)))
    with store.open_file(photographs(tmp_path, numbers, SUPERPIXELS)) as file:
        response, noise = file.read("response").astype(float), file.read("noise_model")
    predicted = np.sqrt(noise[:, 0] + noise[:, 1] * response.mean(axis=(0, 1)))
    # Of two pixels the green of a superpixel is the mean: half the variance, with light and without.
    assert np.allclose(noise[[0, 2]], 2.0 * noise[1], rtol=0.02)
    assert np.allclose(response.std(axis=(0, 1)) / predicted, 1.0, atol=0.12)


@pytest.mark.parametrize("known", ["white", "object"])
def test_white_and_captures_are_normalised_alike_or_not_at_all(tmp_path, known):
    shots = [(role, 0.02, 100 if role == known else 0, 4.0, ()) for role in ("white", "object")]
    with pytest.raises(InputError, match=r"iso"):
        own = own_dng(tmp_path, shots)
        whites = [s for s in read_captures(own) if s.role == "white"]
        objects = [s for s in read_captures(own) if s.role == "object"]
        write_captures(tmp_path / "white.csv", whites)
        write_captures(tmp_path / "object.csv", objects)
        ingest_reference(tmp_path / "white.csv", tmp_path, tmp_path / "r.h5", PROVENANCE, 1.0, SUPERPIXELS)
        ingest_raw(
            tmp_path / "object.csv", tmp_path, Pose(0.0, 0.0).name, tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE,
            options=SUPERPIXELS,
        )  # fmt: skip


@pytest.mark.stability(stage="ingest", case="file contradicts the table")
def test_a_capture_that_the_table_contradicts_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"iso.*1\.dng"):
        run(tmp_path, [("white", 0.02, 100, 4.0, ()), ("object", 0.02, 100, 4.0, (200.0,))])


def test_the_noise_model_follows_the_exposures_that_were_merged(tmp_path):
    """Brackets of a grey field: the stored model predicts the scatter of one exposure, of two, and of one clipped."""
    for number, (level, exposures) in enumerate([(0.2, (0.02,)), (0.2, (0.01, 0.02)), (4.0, (0.004, 0.02))]):
        folder = tmp_path / str(number)
        folder.mkdir()
        studio = Studio(folder, seed=28)
        studio.references(frames=4, darks=12)
        truth = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), level)
        for state in ("out", "in"):
            for exposure_s in exposures:
                studio.shoot("object", truth, state, exposure_s)
        response, valid, noise, _ = studio.ingest(Pose(ANGLE, 0.0).name)
        middle = (slice(25, 55), slice(40, 80))
        assert valid[middle].all()
        for band in (0, 1, 2):
            # Differences of neighbours: the white's vignetting falls out.
            scatter = np.diff(response[middle][..., band], axis=1).std() / np.sqrt(2)
            assert scatter == pytest.approx(np.sqrt(noise[band, 0] + noise[band, 1] * level), rel=0.1), (number, band)


def test_the_noise_of_each_exposure_tells_the_noise_of_bright_and_dark_parts_of_one_picture(tmp_path):
    """The longer exposure is clipped in the bright half; through the filter there is one exposure alone."""
    studio = Studio(tmp_path, seed=29)
    studio.references(frames=4, darks=12)
    truth = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.2)
    truth[:, SIZE[1] // 4 :] = 4.0
    for state, exposure_s in (("out", 0.001), ("out", 0.02), ("in", 0.005)):
        studio.shoot("object", truth, state, exposure_s)
    with store.open_file(studio.linear(Pose(ANGLE, 0.0).name)) as file:
        response, valid = file.read("response").astype(float), file.read("valid")
        noise, limit = file.read("exposure_noise"), file.read("exposure_limit")
    assert noise.shape == (2, 6, 2) and valid[25:55, 40:80].all() and (limit[1, 3:] == 0.0).all()
    scatter = []
    for columns in (slice(30, 57), slice(63, 90)):
        part = response[20:60, columns]
        scatter.append(np.diff(part, axis=1).std(axis=(0, 1)) / np.sqrt(2))
        predicted = np.sqrt(merged_variance(noise, limit, part.mean(axis=(0, 1))))
        assert scatter[-1] == pytest.approx(predicted, rel=0.12)
    # With all exposures in the bright half, its noise would be a quarter.
    assert (scatter[1] > 3.0 * np.sqrt(merged_variance(noise, 9.0 + limit, np.full(6, 4.0))))[:3].all()


def test_the_noise_model_weighs_the_exposures_that_give_half_of_a_bands_samples():
    """Written out: each counts by the inverse of its variance, in light by its electrons and without by read noise."""
    bracket = ExposureBracket(
        exposure_dn=np.array([30.0, 100.0, 400.0]), dark_s=np.zeros(3), electrons_per_dn=np.array([2.0, 2.0, 0.5]),
        read_dn2=np.array([4.0, 4.0, 36.0]),
    )  # fmt: skip
    level, shares = np.array([0.5, 0.8, 0.3]), np.array([[0.1, 0.5, 0.49], [1.0, 1.0, 1.0], [0.0, 0.2, 0.6]])
    counted = ([0, 1], [0, 1, 2], [0, 2])
    for white, greens in ((level, 1.0), (level[:, None] * [1.0, 5.0], 2.0)):  # a polynomial, or its value at the centre
        found = _noise_model(bracket, white, shares.copy(), SUPERPIXELS, greens)
        for band, frames in enumerate(counted):
            samples = greens if band == 1 else 1.0
            dn = [level[band] * bracket.exposure_dn[n] for n in frames]
            read = sum(one**2 / bracket.read_dn2[n] for one, n in zip(dn, frames, strict=True))
            shot = sum(one * bracket.electrons_per_dn[n] for one, n in zip(dn, frames, strict=True))
            assert found[band] == pytest.approx([1.0 / read / samples, 1.0 / shot / samples])
    for unknown in ({"electrons_per_dn": np.array([2.0, np.nan, 1.0])}, {"read_dn2": np.array([np.nan, 1.0, 1.0])}):
        assert np.isnan(_noise_model(bracket._replace(**unknown), level, shares.copy(), SUPERPIXELS, 2.0)).all()
    assert np.isnan(_noise_model(bracket, None, shares.copy(), SUPERPIXELS, 2.0)).all()
    # Of demosaiced pictures neighbours share their noise.
    assert np.isnan(_noise_model(bracket, level, shares.copy(), OPTIONS[1], 2.0)).all()


def test_options_default_to_the_shipped_configuration():
    shipped = yaml.safe_load((ROOT / "config/config.yaml").read_text())["ingest"]
    assert IngestOptions(**shipped) == IngestOptions()
    schema = yaml.safe_load((ROOT / "irodori/config/schemas/config.schema.yaml").read_text())["properties"]["ingest"]
    accepted = schema["properties"]["demosaic"]["enum"]
    assert [IngestOptions(demosaic=name).demosaic for name in accepted] == ["superpixel", *ALGORITHMS]
