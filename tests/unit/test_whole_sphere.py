"""Pictures twice as wide as high that do not show all directions are refused, and panoramas with faults are not."""

import numpy as np
import OpenImageIO as oiio
import pytest
from scenes import DATA
from test_environment import stage, write_inputs

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.core.errors import InputError
from irodori.export.pictures import layer_names, picture_bands
from irodori.light.environment_file import directions
from irodori.light.light_files import rgb_picture, spectral_picture
from irodori.light.whole_sphere import contradiction, whole_sphere

HEIGHT, WIDTH = 96, 192
MIDDLE = np.s_[HEIGHT // 4 : 3 * HEIGHT // 4, WIDTH // 4 : 3 * WIDTH // 4]


def room(seed=0, noise=0.0):
    """Brightness in a box of 6 x 4 x 3 m with squares of different reflectance on its walls, the zenith at the top."""
    rng = np.random.default_rng(seed)
    towards = directions(WIDTH, HEIGHT)[0].reshape(-1, 3)
    far = np.where(towards > 0, [3.3, 2.2, 1.6], [2.7, 1.8, 1.4]) / np.maximum(np.abs(towards), 1e-9)
    wall = far.argmin(axis=1)
    hit = towards * far.min(axis=1)[:, None]
    side = 2 * wall + (towards[np.arange(len(wall)), wall] > 0)
    squares = np.floor((hit + 0.37) / 0.9).astype(int) + 5
    squares[np.arange(len(wall)), wall] = 0
    level = np.exp(rng.normal(0, 0.8, (6, 10, 10, 10)))[side, squares[:, 0], squares[:, 1], squares[:, 2]]
    lamp = (side == 5) & (np.abs(hit[:, 0] - 0.8) < 0.5) & (np.abs(hit[:, 1]) < 0.7)
    return np.where(lamp, 60.0, level).reshape(HEIGHT, WIDTH) * rng.normal(1.0, noise, (HEIGHT, WIDTH))


def write(path, brightness, names=("R", "G", "B"), **attributes):
    spec = oiio.ImageSpec(brightness.shape[1], brightness.shape[0], len(names), "float")
    spec.channelnames = tuple(names)
    for name, value in attributes.items():
        spec.attribute(name, value)
    output = oiio.ImageOutput.create(str(path))
    pixels = np.repeat(brightness[..., None], len(names), axis=-1).astype(np.float32)
    assert output.open(str(path), spec) and output.write_image(pixels) and output.close()
    return path


@pytest.mark.parametrize("seed", range(6))
def test_the_middle_of_a_panorama_is_refused_and_the_whole_is_not(seed):
    for noise in (0.0, 0.05):
        whole = room(seed, noise)
        assert not any(contradiction(np.roll(whole, shift, axis=1)) for shift in range(0, WIDTH, 12))
        assert "first" in contradiction(whole[MIDDLE])


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("name", ["lobby", "hall", "workshop", "museum"])
def test_measured_places_are_panoramas_wherever_they_are_cut_and_their_middle_is_none(name):
    path = DATA / "environments" / f"{name}.exr"
    if not path.is_file():
        pytest.skip(f"no picture at {path}")
    whole = np.maximum(np.concatenate([band for _, band in picture_bands(path, 32)]), 0.0).sum(axis=-1)
    assert not any(contradiction(np.roll(whole, shift, axis=1)) for shift in range(0, 512, 8))
    assert contradiction(whole[64:192, 128:384])


@pytest.mark.parametrize(("reader", "names"), [(rgb_picture, "RGB"), (spectral_picture, layer_names("S0"))])
def test_both_kinds_of_picture_files_are_judged(tmp_path, reader, names):
    assert reader(write(tmp_path / "whole.exr", room(), names)).weights.shape[:2] == (HEIGHT, WIDTH)
    picture = reader(write(tmp_path / "part.exr", room()[MIDDLE], names))
    with pytest.raises(
        InputError, match=r"part\.exr: found .*; accepted: an equirectangular panorama of all directions"
    ):
        _ = picture.weights


def test_a_photographed_part_of_a_room_is_refused(tmp_path):
    calibration = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out",))
    part = np.repeat(room(2, 0.01)[MIDDLE][..., None], 3, axis=-1)
    write_inputs(tmp_path, part, np.ones(part.shape[:2], np.uint8), calibration)
    with pytest.raises(
        InputError, match=r"linear\.h5: found .*; accepted: an equirectangular panorama of all directions"
    ):
        stage(tmp_path)


def test_two_fisheye_pictures_beside_each_other_are_refused():
    across = (np.arange(WIDTH) + 0.5) % HEIGHT - HEIGHT / 2
    disc = np.hypot(across, np.arange(HEIGHT)[:, None] + 0.5 - HEIGHT / 2) < HEIGHT / 2
    assert "two discs" in contradiction(np.where(disc, room(), 0.0))
    assert not contradiction(np.where(disc, 0.0, room()))


def _painted(whole):
    return np.concatenate([whole[:-12], np.zeros((12, WIDTH))])


def _smeared_at_the_nadir(whole):
    return np.concatenate([whole[:-6], np.repeat(whole[-7:-6], 6, axis=0)])


def _brighter_half(whole):
    return whole * np.where(np.arange(WIDTH) < WIDTH // 2, 1.0, 1.15)


@pytest.mark.parametrize("change", [_painted, _smeared_at_the_nadir, _brighter_half])
def test_faults_of_stitched_panoramas_are_no_reason_to_refuse(change):
    for seed in range(6):
        assert not contradiction(change(room(seed, 0.02)))


def test_drawn_skies_are_panoramas():
    below, left = np.indices((HEIGHT, WIDTH)) // np.array([HEIGHT // 2, WIDTH // 2])[:, None, None]
    towards = directions(WIDTH, HEIGHT)[0]
    lamp_that_ends_at_the_zenith = 0.1 + 9.0 * (towards @ [np.sin(0.2), 0.0, np.cos(0.2)] > np.cos(0.2))
    noise = np.random.default_rng(1).uniform(0, 1, (HEIGHT, WIDTH))
    even = np.ones((HEIGHT, WIDTH))
    for sky in (1.0 - 0.9 * below, 1.0 - 0.9 * left, lamp_that_ends_at_the_zenith, noise, even, 0.0 * even):
        assert not contradiction(sky)


def test_the_bands_come_back_as_they_were():
    whole = room()[..., None]
    parts = [whole[:40], whole[40:]]
    assert all(one is other for one, other in zip(whole_sphere(parts, (HEIGHT, WIDTH), "a"), parts, strict=True))


@pytest.mark.parametrize(("name", "stated", "accepted"), [
    ("textureformat", "CubeFace Environment", False), ("textureformat", "LatLong Environment", True),
    ("textureformat", "Plain Texture", True), ("GPano:ProjectionType", "cylindrical", False),
    ("GPano:ProjectionType", "equirectangular", True),
])  # fmt: skip
def test_a_file_that_states_another_projection_is_refused(tmp_path, name, stated, accepted):
    path = write(tmp_path / "a.exr", room(), **{name: stated})
    if accepted:
        assert rgb_picture(path).size == (HEIGHT, WIDTH)
    else:
        with pytest.raises(InputError, match=rf"a\.exr: projection: found {stated}; accepted: an equirectangular"):
            rgb_picture(path)
