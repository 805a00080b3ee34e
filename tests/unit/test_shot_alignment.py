"""The two shots of a pose on one grid: a shift is found, applied, stored, and refused where it does not fit."""

import numpy as np
import pytest
from raw_studio import ANGLE, BALANCE, PROVENANCE, REFLECTANCE, Studio, vignetting

from irodori.config.capture_table import Pose, write_captures
from irodori.core import store
from irodori.core.errors import InputError
from irodori.ingest.develop import Developed
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.shot_alignment import Alignment, _superpixels, align_states, move
from irodori.ingest.stage import ingest_raw

HEIGHT, WIDTH = 320, 432  # mosaic pixels
SHIFT_PX, ROTATION_RAD, SCALE = np.array([2.3, -1.4]), 0.002, 1.003  # of the filtered picture, superpixels
POSE = Pose(ANGLE, 0.0).name
OPTIONS = IngestOptions()


def coordinates(state, shift_px=SHIFT_PX, sample_px=1):
    """Where each mosaic pixel of a filter state looks in the scene, superpixels, x then y."""
    y, x = (np.mgrid[: HEIGHT // sample_px, : WIDTH // sample_px] + 0.5) * sample_px / 2 - 0.5
    if state == "out":
        return x, y
    centre = np.array([WIDTH / 4 - 0.5, HEIGHT / 4 - 0.5])
    dx, dy = x - centre[0] - shift_px[0], y - centre[1] - shift_px[1]
    cosine, sine = np.cos(ROTATION_RAD) / SCALE, np.sin(ROTATION_RAD) / SCALE
    return centre[0] + cosine * dx + sine * dy, centre[1] - sine * dx + cosine * dy


def paint(x, y, contrast=1.0):
    """Six bands of a pattern of many directions, 0.2..0.6, whose colours share their edges."""
    rng = np.random.default_rng(91)
    waves = sum(np.sin(rng.uniform(0.1, 0.6) * x + rng.uniform(-0.6, 0.6) * y + rng.uniform(0, 6)) for _ in range(24))
    waves = np.tanh(waves / 2) * 3  # edges
    bands = [0.4 + contrast * rng.uniform(0.06, 0.12) * waves / 2 for _ in range(6)]
    return np.clip(np.stack(bands, axis=-1), 0.02, 0.9)


def session(folder, *, contrast=1.0, object_shift_px=SHIFT_PX, chart=True):
    """Dark, white and chart through a filter that moves the picture, and an object that may have moved on its own."""
    studio = Studio(folder, seed=92)
    dark, white = np.zeros((HEIGHT, WIDTH)), np.full((HEIGHT, WIDTH, 6), REFLECTANCE * np.cos(np.radians(ANGLE)))

    def shoot(role, bands, state, exposure_s):
        index = ("out", "in").index(state)
        y, x = np.indices((HEIGHT, WIDTH))
        picked = np.take_along_axis(
            bands[..., 3 * index : 3 * index + 3] * BALANCE[index], (y % 2 + x % 2)[..., None], 2
        )
        studio.expose(role, picked[..., 0] * vignetting(HEIGHT, WIDTH), state, exposure_s)

    for _ in range(4):
        studio.expose("dark", dark)
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        for _ in range(2):
            shoot("white", white, state, exposure_s)
        if chart:
            shoot("chart", paint(*coordinates(state)), state, exposure_s)
        shoot("object", paint(*coordinates(state, object_shift_px), contrast), state, exposure_s)
    return studio


def ingest(studio, capture, options=OPTIONS):
    path = studio.linear(capture, options)
    with store.open_file(path) as file:
        found = {name: file.read(name) for name in ("response", "valid", "clipped")}
        if "registration" in file:
            names = ("registration_source", "registration_residual_px", "registration_sigma_px")
            found |= {"registration": file.read("registration")} | {name: file.attribute(name) for name in names}
    return found


def apart_px(transform, shift_px=SHIFT_PX):
    """Largest distance between a transform and the truth over the picture, superpixels."""
    dx, dy, rotation, scale = transform
    y, x = np.mgrid[: HEIGHT // 2, : WIDTH // 2]
    p = (x - WIDTH / 4 + 0.5) + 1j * (y - HEIGHT / 4 + 0.5)
    found = scale * np.exp(1j * rotation) * p + complex(dx, dy)
    return np.abs(found - SCALE * np.exp(1j * ROTATION_RAD) * p - complex(*shift_px)).max()


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("options", [OPTIONS, IngestOptions(demosaic="linear")], ids=["superpixel", "linear"])
def test_the_filtered_bands_lie_on_the_unfiltered_ones(tmp_path, options):
    found = ingest(session(tmp_path), POSE, options)
    assert apart_px(found["registration"]) < 0.08 and found["registration_source"] == "capture"
    assert found["registration_sigma_px"] < 0.05 and found["registration_residual_px"] < 0.1
    truth = paint(*coordinates("out", sample_px=options.sample_px))
    border = 12 // options.sample_px
    inside = np.zeros(found["valid"].shape, bool)
    inside[border:-border, border:-border] = True
    # What the filtered picture does not cover is neither measured nor clipped.
    assert (found["valid"][inside] == 1).all() and not found["clipped"].any() and (found["valid"] == 0).any()
    error = (found["response"] - truth)[inside]
    assert np.abs(error.mean(axis=0)).max() < 0.005
    # Unregistered, the filtered bands miss by several times their noise.
    plain = ingest(session(tmp_path), POSE, IngestOptions(demosaic=options.demosaic, register=False))
    missed = (plain["response"] - truth)[inside]
    assert (missed[:, 3:].std(axis=0) > 2 * error[:, 3:].std(axis=0)).all() and "registration" not in plain


@pytest.fixture
def small(monkeypatch):
    """Pictures of a third of the size."""
    monkeypatch.setitem(globals(), "HEIGHT", 192)
    monkeypatch.setitem(globals(), "WIDTH", 256)


@pytest.mark.parametrize("sample_px", [1, 2])
@pytest.mark.parametrize("start", [None, Alignment((2.0, -1.0, 0.0, 1.0), 0.0, 0.01, "capture")])
def test_pictures_of_either_sampling_are_aligned_in_superpixels_and_moved(small, sample_px, start):
    rng, states = np.random.default_rng(4), []
    for state, bands in (("out", slice(0, 3)), ("in", slice(3, 6))):
        response = paint(*coordinates(state, sample_px=sample_px))[..., bands].astype(np.float32)
        response += rng.normal(0.0, 0.002, response.shape).astype(np.float32)
        nothing = np.zeros(response.shape[:2], bool)
        clipped, hot = nothing.copy(), nothing.copy()
        clipped[40:44, 50:54] = hot[70:72, 30:33] = True
        response[clipped | hot] = 0.0
        states.append(Developed(response, clipped, hot, np.zeros((3, 2)), np.zeros((1, 3, 3)), "RGGB"))
    options = IngestOptions() if sample_px == 2 else IngestOptions(demosaic="linear")
    # The colours of these pictures lie on one place: what a mosaic has apart, a quarter of a superpixel, is no error.
    found = align_states(*states, start, options, "captures.csv", "a")
    assert apart_px(found.transform) < (0.3 if sample_px == 2 else 0.1) and found.source == "capture"
    assert 0.0 < found.sigma_px < 0.05
    exact = Alignment((*SHIFT_PX, ROTATION_RAD, SCALE), 0.0, 0.0, "capture")
    moved = move(states[1], exact, sample_px, np.empty_like(states[1].response))
    truth = paint(*coordinates("out", sample_px=sample_px))[..., 3:]
    assert moved.valid.mean() > 0.9 and np.abs(moved.response - truth)[moved.valid].mean() < 0.004
    # Both masks are where the picture shows what they mark.
    shift = SHIFT_PX * 2 / sample_px
    for mask, row, column in ((moved.clipped, 41.5, 51.5), (moved.hot[60:80, 20:40], 10.5, 11.0)):
        assert np.mean(np.argwhere(mask), axis=0) == pytest.approx([row - shift[1], column - shift[0]], abs=1.0)


def test_what_another_band_shows_behind_the_filter_tells_where_it_is_by_its_place_in_the_mosaic(small):
    """Green alone has a pattern, and behind the filter red alone: a quarter of a superpixel from it each way."""
    rng, states = np.random.default_rng(4), []
    for state, band, offset in (("out", 1, 0.0), ("in", 0, -0.25)):
        x, y = coordinates(state, sample_px=2)
        response = np.full((*x.shape, 3), 0.4)
        response[..., band] = paint(x + offset, y + offset)[..., 0]
        response += rng.normal(0.0, 0.002, response.shape)
        nothing = np.zeros(x.shape, bool)
        states.append(
            Developed(response.astype(np.float32), nothing, nothing, np.zeros((3, 2)), np.zeros((1, 3, 3)), "RGGB")
        )
    found = align_states(*states, None, IngestOptions(), "captures.csv", "a")
    assert found.source == "capture" and apart_px(found.transform) < 0.1


@pytest.mark.stability(stage="ingest", case="picture without content")
def test_a_capture_without_content_takes_the_charts_transform(tmp_path, small):
    studio = session(tmp_path, contrast=0.0)
    found = ingest(studio, POSE)
    assert found["registration_source"] == "chart" and found["registration_sigma_px"] > 0.1
    assert apart_px(found["registration"]) < 0.08
    with store.open_file(tmp_path / "reference.h5") as file:
        assert np.array_equal(file.read("registration"), found["registration"])


@pytest.mark.stability(stage="ingest", case="picture without content")
def test_without_a_chart_and_without_content_nothing_is_moved_and_the_file_says_so(tmp_path, small):
    found = ingest(session(tmp_path, contrast=0.0, chart=False), POSE)
    assert found["registration_source"] == "none" and np.array_equal(found["registration"], [0, 0, 0, 1])
    assert found["valid"].all()


def test_an_object_that_moved_between_the_shots_is_found_where_it_is(tmp_path):
    moved = SHIFT_PX + np.array([1.5, 2.0])
    found = ingest(session(tmp_path, object_shift_px=moved), POSE)
    assert apart_px(found["registration"], moved) < 0.08


@pytest.mark.stability(stage="ingest", case="shots do not register")
def test_a_residual_above_the_limit_names_the_capture(tmp_path):
    studio = session(tmp_path)
    # Half of the picture moves and half stays: no one transform fits.
    x, y = coordinates("in")
    bands = paint(np.where(x > WIDTH / 4, x + 2.5, x), y)
    studio.shots = [s for s in studio.shots if not (s.role == "object" and s.filter == "in")]
    iy, ix = np.indices((HEIGHT, WIDTH))
    picked = np.take_along_axis(bands[..., 3:] * BALANCE[1], (iy % 2 + ix % 2)[..., None], 2)[..., 0]
    studio.expose("object", picked * vignetting(HEIGHT, WIDTH), "in", 0.05)
    write_captures(tmp_path / "captures.csv", studio.shots)
    reference = studio.reference(OPTIONS)
    with pytest.raises(InputError, match=rf"{POSE}.*max_registration_px"):
        ingest_raw(tmp_path / "captures.csv", tmp_path, POSE, reference, tmp_path / "l.h5", PROVENANCE, options=OPTIONS)
    assert not (tmp_path / "l.h5").exists()


def test_clipping_in_the_filtered_shot_moves_with_it(tmp_path):
    studio = session(tmp_path)
    clean = studio.sensor.white_level
    studio.shots = [s for s in studio.shots if not (s.role == "object" and s.filter == "in")]

    def spoil(mosaic, _):
        mosaic = mosaic.copy()
        mosaic[150:170, 200:220] = clean
        return mosaic

    studio.spoil = spoil
    bands = paint(*coordinates("in"))
    iy, ix = np.indices((HEIGHT, WIDTH))
    picked = np.take_along_axis(bands[..., 3:] * BALANCE[1], (iy % 2 + ix % 2)[..., None], 2)[..., 0]
    studio.expose("object", picked * vignetting(HEIGHT, WIDTH), "in", 0.05)
    studio.spoil = lambda mosaic, _: mosaic
    found = ingest(studio, POSE)
    x, y = coordinates("in", sample_px=2)
    there = np.stack([x[75:85, 100:110].ravel(), y[75:85, 100:110].ravel()], axis=1).round().astype(int)
    assert (found["valid"][there[:, 1], there[:, 0]] == 0).all()
    assert (found["clipped"][there[:, 1], there[:, 0]] == 1).all()
    far = np.ones(found["valid"].shape, bool)
    far[65:100, 90:120] = False
    assert not found["clipped"][far].any()


def test_a_superpixel_of_a_full_picture_is_the_mean_of_its_four_and_valid_where_all_are():
    image = np.random.default_rng(4).uniform(size=(6, 8, 3)).astype(np.float32)
    valid = np.ones((6, 8), bool)
    valid[[0, 3, 4, 5], [1, 2, 6, 7]] = False  # one of each place; two of them in one superpixel
    found, mask = _superpixels(image, valid, 1)
    for row in range(3):
        for column in range(4):
            four = np.s_[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
            assert found[row, column] == pytest.approx(image[four].mean(axis=(0, 1)), rel=1e-6)
            assert mask[row, column] == valid[four].all()
