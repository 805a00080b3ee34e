"""Full resolution through LibRaw: linear, unbiased in the dark, masked where a fault or a highlight reaches."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from dng_files import write_any_dng
from raw_studio import ANGLE, DATA, PROVENANCE, SENSOR, SIZE, WHITE, Studio
from scipy import ndimage

from irodori.config.capture_table import Pose, Shot, write_captures
from irodori.core import store
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.develop import REACH_PX
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.mosaic import ALGORITHMS, decode, demosaic
from irodori.ingest.stage import ingest_raw

POSE = Pose(ANGLE, 0.0).name
NAMES = tuple(ALGORITHMS)


def full(name):
    return IngestOptions(demosaic=name, register=False)


def test_algorithms_are_those_of_the_options():
    for name in (*NAMES, "superpixel"):
        assert IngestOptions(demosaic=name).sample_px == (2 if name == "superpixel" else 1)
    with pytest.raises(ValueError, match="accepted: superpixel, linear"):
        IngestOptions(demosaic="amaze")
    with pytest.raises(ValueError, match="accepted: linear"):
        demosaic("a.dng", "amaze")


@pytest.mark.parametrize("name", NAMES)
def test_measured_samples_pass_unchanged(tmp_path, name):
    """No white balance, colour matrix, tone curve, automatic brightness or rotation: numbers stay what they are."""
    rng = np.random.default_rng(81)
    mosaic = rng.integers(300, 16000, (64, 96)).astype(np.uint16)
    bands = demosaic(write_any_dng(tmp_path / "a.dng", mosaic, orientation=6), name)
    assert bands.shape == (64, 96, 3)
    for row, column, band in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        assert np.array_equal(bands[row::2, column::2, band], mosaic[row::2, column::2])


@pytest.mark.parametrize("name", NAMES)
def test_the_mean_of_darkness_is_not_lifted_by_cutting_its_negative_half(tmp_path, name):
    studio = Studio(tmp_path, seed=82)
    darkness = np.zeros((SIZE[0] // 2, SIZE[1] // 2, 6))
    for _ in range(8):
        studio.shoot("dark", darkness, exposure_s=0.02)
    studio.shoot("object", darkness)
    with store.open_file(studio.linear(POSE, full(name))) as file:
        response, valid = file.read("response"), file.read("valid").astype(bool)
    noise = np.hypot(SENSOR.read_noise_e / SENSOR.electrons_per_dn, np.sqrt(1 / 12)) / (WHITE - 600) / 0.02
    # LibRaw rounds an interpolated number down, by half a number at most.
    half = 0.5 / (WHITE - 600) / 0.02
    # Without negative values the mean would be 0.4 of the standard deviation.
    assert valid.mean() > 0.99 and (response < 0).mean() > 0.3
    assert np.abs(response[valid].mean(axis=0)).max() < half + 0.05 * noise


@pytest.mark.default_cases(3)
@pytest.mark.parametrize("name", NAMES)
def test_a_smooth_scene_has_the_responses_of_its_superpixels(tmp_path, name):
    studio = Studio(tmp_path, seed=83)
    studio.references(frames=4, darks=8)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / max(SIZE)
    truth = np.stack([0.3 + 0.2 * np.sin(4 * x + b) * np.cos(3 * y) for b in range(6)], axis=-1)
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        studio.shoot("object", truth, state, exposure_s)
    response, valid, _, _ = studio.ingest(POSE, full(name))
    assert response.shape == (*SIZE, 6) and valid.mean() > 0.99
    error = np.where(valid[..., None] > 0, response - truth, 0.0)
    blocks = error.reshape(SIZE[0] // 20, 20, SIZE[1] // 20, 20, 6).mean(axis=(1, 3))
    assert np.abs(blocks).max() < 0.006


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("name", NAMES)
def test_photographs_developed_side_by_side_are_those_developed_one_by_one(tmp_path, name):
    """Two threads in LibRaw's VNG at once share a variable: pictures come out spoilt, or the process ends."""
    rng = np.random.default_rng(85)
    paths = [tmp_path / f"{i}.dng" for i in range(2)]
    for path in paths:
        write_any_dng(path, rng.integers(300, 16000, (128, 256)).astype(np.uint16))
    alone = [demosaic(path, name) for path in paths]
    with ThreadPoolExecutor(2) as pool:
        for first, second in pool.map(lambda _: [demosaic(path, name) for path in paths], range(40)):
            assert np.array_equal(first, alone[0]) and np.array_equal(second, alone[1])


@pytest.mark.default_cases(3)
@pytest.mark.parametrize("name", NAMES)
def test_no_valid_sample_knows_of_a_hot_or_clipped_pixel(tmp_path, name):
    reach = REACH_PX[name]
    places = np.array([[30, 41], [61, 90], [98, 160], [121, 53]])
    pictures = []
    for hot in (False, True):
        folder = tmp_path / str(hot)
        folder.mkdir()
        studio = Studio(folder, seed=84)
        darkness = np.zeros((SIZE[0] // 2, SIZE[1] // 2, 6))
        for _ in range(8):
            studio.shoot("dark", darkness)

        def spoil(mosaic, _):
            mosaic = mosaic.copy()
            mosaic[tuple(places.T)] = 9000
            return mosaic

        studio.spoil = spoil if hot else studio.spoil
        for _ in range(8):
            studio.shoot("dark", darkness)
        y, x = np.mgrid[: SIZE[0], : SIZE[1]] / max(SIZE)
        truth = np.stack([0.3 + 0.2 * np.sin(30 * x + b) * np.cos(20 * y) for b in range(6)], axis=-1)
        truth[70:74, 200:204] = 9.0
        studio.shoot("object", truth)
        with store.open_file(studio.linear(POSE, full(name))) as file:
            pictures.append([file.read(n) for n in ("response", "valid", "clipped")])
    response, valid, clipped = pictures[1]
    assert (valid[tuple(places.T)] == 0).all() and (clipped[tuple(places.T)] == 0).all()
    assert (valid[72, 202] == 0) and clipped[72, 202] == 1
    masked = np.zeros(SIZE, bool)
    masked[tuple(places.T)] = True
    near = ndimage.binary_dilation(masked, np.ones((2 * reach + 1,) * 2, bool))
    assert np.array_equal(valid == 0, near | (clipped == 1) | (pictures[0][1] == 0))
    # Outside the mask the hot pixels change nothing that noise would not: their 5000 numbers are nowhere to be seen.
    difference = np.abs(response - pictures[0][0]).max(axis=-1)[valid == 1]
    assert np.quantile(difference, 0.999) < 0.2 and difference.max() < 1.0


def test_a_real_camera_file_is_ingested_either_way(tmp_path):
    source = DATA / "powershot_s40_chart.crw"
    if not source.is_file():
        pytest.skip(f"no real photograph at {source}")
    table = tmp_path / "captures.csv"
    write_captures(table, [Shot(source.name, "chart", Pose(0.0, 0.0), "out", 0.01)])
    pictures = []
    for name in ("superpixel", "ahd"):
        options = full(name)
        ingest_reference(table, DATA, tmp_path / "r.h5", PROVENANCE, 1.0, options)
        ingest_raw(table, DATA, "chart", tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE, options=options)
        with store.open_file(tmp_path / "l.h5") as file:
            pictures.append(file.read("response"))
            assert file.attribute("sample_px") == options.sample_px
    halved = pictures[1].reshape(860, 2, 1156, 2, 3).mean(axis=(1, 3))
    blocks = [p.reshape(86, 10, 1156 // 4, 4, 3).mean(axis=(1, 3)) for p in (pictures[0], halved)]
    assert np.corrcoef(blocks[0].ravel(), blocks[1].ravel())[0, 1] > 0.999
    assert blocks[1].mean() == pytest.approx(blocks[0].mean(), rel=0.01)
    # Response rate is signal / (exposure x ISO / 100 / f²).
    mosaic = decode(source)
    rate = mosaic.superpixels / mosaic.full_scale / (0.01 * mosaic.iso / 100 / mosaic.f_number**2)
    assert np.allclose(pictures[0], np.where(pictures[0] == 0, 0, rate), rtol=1e-5, atol=1e-6)


def test_an_eight_bit_camera_file_is_ingested(tmp_path):
    source = DATA / "dc120_chart.kdc"
    if not source.is_file():
        pytest.skip(f"no real photograph at {source}")
    table = tmp_path / "captures.csv"
    write_captures(table, [Shot(source.name, "chart", Pose(0.0, 0.0), "out", 0.00376)])
    options = IngestOptions()
    ingest_reference(table, DATA, tmp_path / "r.h5", PROVENANCE, 1.0, options)
    ingest_raw(table, DATA, "chart", tmp_path / "r.h5", tmp_path / "l.h5", PROVENANCE, options=options)
    with store.open_file(tmp_path / "l.h5") as file:
        assert file.read("response").shape == (488, 424, 3) and file.read("valid").mean() > 0.99


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("share", [0.93, 0.975, 0.985, 1.0])
def test_a_bracket_whose_long_exposure_nears_clipping_does_not_lean(tmp_path, share):
    studio = Studio(tmp_path, seed=85)
    studio.references(frames=4, darks=8)
    # At the picture's centre the longer exposure fills this share of the range.
    truth = np.full((*SIZE, 6), share * SENSOR.response_at_full_well)
    for state in ("out", "in"):
        for exposure_s in (0.005, 0.02):
            studio.shoot("object", truth, state, exposure_s)
    response, valid, _, _ = studio.ingest(POSE, full("linear"))
    centre = (slice(SIZE[0] // 2 - 20, SIZE[0] // 2 + 20), slice(SIZE[1] // 2 - 20, SIZE[1] // 2 + 20))
    assert valid[centre].all()
    np.testing.assert_allclose(response[centre].mean(axis=(0, 1)) / truth[centre].mean(axis=(0, 1)), 1.0, atol=2e-3)
