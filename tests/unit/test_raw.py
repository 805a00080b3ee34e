"""RAW files and the sensor behind them: bit-exact decoding, refusals, photon statistics, linear responses."""

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pytest
import rawpy
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori import raw, store
from irodori.captures import ROLES, Pose, Shot, read_captures, write_captures
from irodori.errors import InputError
from irodori.mosaic import decode
from irodori.rig.virtual.dng import write_dng
from irodori.rig.virtual.sensor import Sensor

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "raw"
CAMERA = yaml.safe_load((ROOT / "config/cameras/d5100-comb.yaml").read_text())
BLACK, WHITE = 600, 16383
PROVENANCE = store.Provenance("test")


def dng(path, mosaic, black=BLACK, white=WHITE, exposure_s=0.02):
    write_dng(path, mosaic, black_level=black, white_level=white, exposure_s=exposure_s, model="test")
    return path


def random_mosaic(rng, height=64, width=96, top=WHITE) -> np.ndarray:
    return rng.integers(0, top + 1, (height, width), dtype=np.uint16)


# --- the file format ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "width", "black", "white"), [(64, 96, 600, 16383), (66, 38, 0, 4095), (200, 200, 1023, 65535)]
)
def test_dng_decodes_bit_exactly(tmp_path, height, width, black, white):
    mosaic = random_mosaic(np.random.default_rng(height), height, width, white)
    with rawpy.imread(str(dng(tmp_path / "a.dng", mosaic, black, white))) as file:
        assert np.array_equal(file.raw_image_visible, mosaic)
        assert file.white_level == white
        assert list(file.black_level_per_channel) == [black] * 4
        colours = file.color_desc.decode()
        pattern = [[colours[c] for c in row] for row in file.raw_colors_visible[:2, :2]]
        assert pattern == [["R", "G"], ["G", "B"]]


@given(exposure_s=st.floats(1e-4, 30.0))
@settings(deadline=None, max_examples=20)
def test_exposure_time_survives_the_file(tmp_path_factory, exposure_s):
    path = tmp_path_factory.mktemp("exposure") / "a.dng"
    dng(path, np.full((64, 64), 700, np.uint16), exposure_s=exposure_s)
    assert decode(path).exposure_s == pytest.approx(exposure_s, rel=1e-2)


def test_superpixels_are_red_mean_green_blue_above_black(tmp_path):
    rng = np.random.default_rng(1)
    mosaic = random_mosaic(rng)
    decoded = decode(dng(tmp_path / "a.dng", mosaic))
    numbers = mosaic.astype(np.float64)
    red, green_a, green_b, blue = numbers[::2, ::2], numbers[::2, 1::2], numbers[1::2, ::2], numbers[1::2, 1::2]
    expected = np.stack([red - BLACK, (green_a + green_b) / 2 - BLACK, blue - BLACK], axis=-1)
    assert decoded.superpixels.dtype == np.float32
    assert np.array_equal(decoded.superpixels, expected)
    assert decoded.full_scale == WHITE - BLACK
    largest = np.max([red, green_a, green_b, blue], axis=0)
    assert np.allclose(decoded.largest, (largest - BLACK) / (WHITE - BLACK), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("mosaic", [np.zeros((65, 64), np.uint16), np.zeros((64, 63), np.uint16), np.zeros((64, 64))])
def test_mosaics_that_no_sensor_gives_are_not_written(tmp_path, mosaic):
    with pytest.raises(ValueError, match="accepted"):
        dng(tmp_path / "a.dng", mosaic)
    assert list(tmp_path.iterdir()) == []


def refused(path):
    with pytest.raises(InputError) as caught:
        decode(path)
    assert str(path) in str(caught.value)


# What to keep of a file's n bytes.
CUTS = {
    "nothing": lambda n: 0, "one byte": lambda n: 1, "header": lambda n: 8, "tags": lambda n: 512,
    "quarter": lambda n: n // 4, "half": lambda n: n // 2, "three quarters": lambda n: 3 * n // 4,
    "all but 1000 bytes": lambda n: n - 1000, "all but two bytes": lambda n: n - 2,
    "all but one byte": lambda n: n - 1,
}  # fmt: skip


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("size", [(64, 96), (600, 800)], ids=["small", "large"])
def test_a_truncated_dng_is_refused(tmp_path, size, cut):
    path = dng(tmp_path / "cut.dng", random_mosaic(np.random.default_rng(2), *size))
    content = path.read_bytes()
    path.write_bytes(content[: CUTS[cut](len(content))])
    refused(path)


@pytest.mark.parametrize("cut", ["header", "half", "all but 1000 bytes"])
def test_a_truncated_camera_file_is_refused(tmp_path, cut):
    source = DATA / "powershot_s40_chart.crw"
    if not source.is_file():
        pytest.skip(f"no real photograph at {source}")
    content = source.read_bytes()
    path = tmp_path / "cut.crw"
    path.write_bytes(content[: CUTS[cut](len(content))])
    refused(path)


def test_what_is_no_raw_file_is_refused(tmp_path):
    text = tmp_path / "text.dng"
    text.write_text("This is not a photograph.\n" * 500)
    noise = tmp_path / "noise.dng"
    noise.write_bytes(np.random.default_rng(3).bytes(50_000))
    for path in (text, noise, tmp_path / "missing.dng", tmp_path):
        refused(path)


@given(content=st.binary(max_size=300), tiff=st.booleans())
@settings(deadline=None, max_examples=60)
def test_no_bytes_raise_anything_else(tmp_path_factory, content, tiff):
    path = tmp_path_factory.mktemp("bytes") / "a.dng"
    path.write_bytes(b"II*\0\x08\0\0\0" + content if tiff else content)
    refused(path)


SENSOR = Sensor(**CAMERA["virtual"]["sensor"])


# --- from files to linear responses ------------------------------------------------------------------------------

SIZE = (160, 240)
BALANCE = np.array([[0.7, 1.0, 0.5], [0.30, 0.45, 0.2]])  # of a perfect diffuser's bands, without and with filter
REFLECTANCE, ANGLE = 0.95, 40.0


def vignetting(height=SIZE[0], width=SIZE[1]) -> np.ndarray:
    y, x = np.ogrid[:height, :width]
    radius2 = ((x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2) / ((height**2 + width**2) / 4)
    return 1.0 - 0.3 * radius2


def scene(rng) -> np.ndarray:
    """True responses of six bands on superpixels: a gradient and blocks, 0.02..0.9."""
    height, width = SIZE[0] // 2, SIZE[1] // 2
    blocks = np.kron(rng.uniform(0.05, 0.9, (height // 20, width // 20, 6)), np.ones((20, 20, 1)))
    return blocks * np.linspace(0.5, 1.0, width)[None, :, None]


class Studio:
    """A session of photographs with vignetting, seen by the sensor of the example camera."""

    def __init__(self, folder: Path, seed: int, sensor: Sensor = SENSOR) -> None:
        self.folder, self.rng, self.sensor, self.shots = folder, np.random.default_rng(seed), sensor, []

    def shoot(self, role, truth, state="out", exposure_s=0.02, light_deg=ANGLE):
        index = ("out", "in").index(state)
        bands = truth[..., 3 * index : 3 * index + 3] * BALANCE[index]
        bands = bands.repeat(2, axis=0).repeat(2, axis=1)
        y, x = np.indices(bands.shape[:2])
        mosaic = np.take_along_axis(bands, (y % 2 + x % 2)[..., None], axis=2)[..., 0] * vignetting(*bands.shape[:2])
        file = f"{len(self.shots):03d}.dng"
        dng(self.folder / file, self.sensor.expose(mosaic, exposure_s, self.rng), exposure_s=exposure_s)
        self.shots.append(Shot(file, role, Pose(light_deg, 0.0), state, exposure_s))

    def table(self) -> Path:
        write_captures(self.folder / "captures.csv", self.shots)
        return self.folder / "captures.csv"

    def references(self, frames=2):
        superpixels = (SIZE[0] // 2, SIZE[1] // 2, 6)
        for _ in range(4):
            self.shoot("dark", np.zeros(superpixels), exposure_s=0.02)
        white = np.full(superpixels, REFLECTANCE * np.cos(np.radians(ANGLE)))
        for state, exposure_s in (("out", 0.02), ("in", 0.05)):
            for _ in range(frames):
                self.shoot("white", white, state, exposure_s)

    def ingest(self, capture: str):
        table = self.table()
        reference, output = self.folder / "reference.h5", self.folder / "linear.h5"
        raw.ingest_reference(table, self.folder, 0.98, reference, PROVENANCE, REFLECTANCE)
        raw.ingest_raw(table, self.folder, capture, reference, 0.98, output, PROVENANCE)
        with store.open_file(output) as file:
            return file.read("response"), file.read("valid"), file.read("noise_model"), file.attribute("pose_deg")


def test_responses_are_the_truth_within_their_noise(tmp_path):
    studio = Studio(tmp_path, seed=11)
    studio.references(frames=4)
    truth = scene(studio.rng)
    pose = Pose(ANGLE, 0.0)
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        studio.shoot("object", truth, state, exposure_s)
    response, valid, noise, pose_deg = studio.ingest(pose.name)
    assert response.shape == truth.shape and (valid == 1).all() and pose_deg == [ANGLE, 0.0, 0.0, 0.0]
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
    raw.ingest_reference(studio.table(), tmp_path, 0.98, tmp_path / "r.h5", PROVENANCE, 0.95)
    with store.open_file(tmp_path / "r.h5") as file:
        assert file.attribute("gain_e_per_dn") == pytest.approx(SENSOR.electrons_per_dn, rel=0.03)
        noise = np.hypot(SENSOR.read_noise_e / SENSOR.electrons_per_dn, np.sqrt(1 / 12))
        assert file.attribute("read_noise_dn") == pytest.approx(noise, rel=0.03)
        assert abs(file.read("dark")).mean() < 3 * noise / np.sqrt(6)


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
    raw.ingest_reference(tmp_path / "captures.csv", tmp_path, 0.98, tmp_path / "r.h5", PROVENANCE, 1.0)
    raw.ingest_raw(tmp_path / "captures.csv", tmp_path, "chart", tmp_path / "r.h5", 0.98, tmp_path / "l.h5", PROVENANCE)
    with store.open_file(tmp_path / "l.h5") as file:
        assert file.read("response").shape == (32, 32, 3)
        assert np.allclose(file.read("response"), 5000 / (WHITE - BLACK) / 0.25, rtol=1e-6)
        assert np.isnan(file.read("noise_model")).all()


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


def test_an_overexposed_white_reference_is_refused(tmp_path):
    studio = Studio(tmp_path, seed=17)
    studio.shoot("white", np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 4.0))
    with pytest.raises(InputError, match="saturated"):
        raw.ingest_reference(studio.table(), tmp_path, 0.98, tmp_path / "r.h5", PROVENANCE, 1.0)
    assert not (tmp_path / "r.h5").exists()


def test_check_captures_notes_the_hash_of_every_file(tmp_path):
    studio = Studio(tmp_path, seed=18)
    studio.references()
    table, output = studio.table(), tmp_path / "checked.csv"
    raw.check_captures(table, tmp_path, output, ROLES)
    assert read_captures(output, tmp_path) == read_captures(table, tmp_path)
    lines = output.read_text().splitlines()
    assert lines[0].split(",")[-1] == "sha256"
    for line in lines[1:]:
        file, *_, digest = line.split(",")
        assert digest == hashlib.sha256((tmp_path / file).read_bytes()).hexdigest()


@pytest.mark.parametrize("fault", ["exposure", "size", "truncated", "missing"])
def test_check_captures_refuses(tmp_path, fault):
    studio = Studio(tmp_path, seed=19)
    studio.references()
    culprit = studio.shots[-1].file
    if fault == "exposure":
        studio.shots[-1] = dataclasses.replace(studio.shots[-1], exposure_s=studio.shots[-1].exposure_s * 1.2)
    elif fault == "size":
        dng(tmp_path / culprit, np.full((64, 64), 700, np.uint16), exposure_s=0.05)
    elif fault == "truncated":
        content = (tmp_path / culprit).read_bytes()
        (tmp_path / culprit).write_bytes(content[: len(content) // 2])
    else:
        (tmp_path / culprit).unlink()
    table, output = studio.table(), tmp_path / "checked.csv"
    with pytest.raises(InputError, match=culprit):
        raw.check_captures(table, tmp_path, output, ROLES)
    assert not output.exists()


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_smooth_flat_restores_any_polynomial_of_degree_four(seed):
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 44), indexing="ij")
    terms = [x**i * y**j for i in range(5) for j in range(5 - i)]
    truth = np.stack([1.0 + np.tensordot(rng.uniform(-0.1, 0.1, 15), terms, 1) for _ in range(3)], axis=-1)
    valid = rng.uniform(size=truth.shape[:2]) < 0.8
    spoiled = np.where(valid[..., None], truth, 1e3)
    assert np.allclose(raw.smooth_flat(spoiled, valid), truth, rtol=1e-5)


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


def test_a_white_reference_that_does_not_fill_the_picture_is_refused(tmp_path):
    studio = Studio(tmp_path, seed=24)
    white = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.02)
    rows, columns = white.shape[0] // 4, white.shape[1] // 4
    white[rows:-rows, columns:-columns] = 0.9
    studio.shoot("white", white)
    with pytest.raises(InputError, match="fills the picture"):
        raw.ingest_reference(studio.table(), tmp_path, 0.98, tmp_path / "r.h5", PROVENANCE, 1.0)


def test_check_captures_holds_files_to_the_stated_size(tmp_path):
    studio = Studio(tmp_path, seed=25)
    studio.references()
    table = studio.table()
    raw.check_captures(table, tmp_path, tmp_path / "a.csv", ROLES, (SIZE[1], SIZE[0]))
    with pytest.raises(InputError, match="9000 x 6000"):
        raw.check_captures(table, tmp_path, tmp_path / "b.csv", ROLES, (9000, 6000))


def test_check_captures_keeps_the_shots_of_its_own_set(tmp_path):
    studio = Studio(tmp_path, seed=26)
    studio.references()
    studio.shoot("object", np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.3))
    raw.check_captures(studio.table(), tmp_path, tmp_path / "object.csv", ["object"])
    assert [shot.role for shot in read_captures(tmp_path / "object.csv")] == ["object"]


def test_identical_frames_tell_no_gain(tmp_path):
    studio = Studio(tmp_path, seed=27)
    studio.shoot("white", np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.9))
    twin = dataclasses.replace(studio.shots[0], file="twin.dng")
    (tmp_path / "twin.dng").write_bytes((tmp_path / studio.shots[0].file).read_bytes())
    studio.shots.append(twin)
    raw.ingest_reference(studio.table(), tmp_path, 0.98, tmp_path / "r.h5", PROVENANCE, 1.0)
    with store.open_file(tmp_path / "r.h5") as file:
        assert np.isnan(file.attribute("gain_e_per_dn"))
