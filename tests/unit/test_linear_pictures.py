"""Linear TIFF and PNG pictures in place of RAW files: the same light, no mosaic, and tone curves that numbers show."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from linear_files import develop_linearly, write_samples
from raw_studio import ANGLE, Studio, dng, random_mosaic, scene

from irodori.config.capture_table import Pose, read_captures
from irodori.core.errors import InputError
from irodori.ingest.first_look import check_captures
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.linear_pictures import refuse_tone_curve
from irodori.ingest.mosaic import decode


def srgb(share: np.ndarray) -> np.ndarray:
    return np.where(share <= 0.0031308, 12.92 * share, 1.055 * np.maximum(share, 1e-9) ** (1 / 2.4) - 0.055)


CURVES = {
    "sRGB": srgb,
    "gamma 1.8": lambda share: share ** (1 / 1.8),
    "gamma 2.6": lambda share: share ** (1 / 2.6),
}


def ball(width: int = 300) -> np.ndarray:
    """Return a shaded sphere with noise, (width, width, 3), shares of the range."""
    y, x = np.mgrid[-1 : 1 : width * 1j, -1 : 1 : width * 1j]
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    shade = np.maximum(0.4 * x + 0.5 * y + 0.77 * z, 0.0)[..., None] * np.array([0.8, 0.75, 0.6])
    return np.clip(shade + np.random.default_rng(3).normal(0.0, 0.004, shade.shape), 0.0, 1.0)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".TIFF"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_each_pixel_is_a_superpixel_of_its_own(tmp_path, suffix, kind):
    samples = np.random.default_rng(1).integers(0, np.iinfo(kind).max, (31, 45, 3), dtype=kind, endpoint=True)
    mosaic = decode(write_samples(tmp_path / f"a{suffix}", samples), linear=True)
    assert mosaic.size == (90, 62) and mosaic.linear and mosaic.full_scale == np.iinfo(kind).max
    assert np.array_equal(mosaic.superpixels, samples)
    assert np.allclose(mosaic.largest, samples.max(axis=2) / np.iinfo(kind).max)


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("top", [255, 65535])
def test_a_tone_curve_on_eight_bits_is_seen(curve, top):
    developed = np.rint(255.0 * ball()).astype(np.uint8)
    refuse_tone_curve("a.png", developed)
    bent = np.rint(top * CURVES[curve](developed / 255.0)).astype(np.uint8 if top == 255 else np.uint16)
    with pytest.raises(InputError, match=r"a\.png: linear: .*a tone curve: numbers lie .* apart"):
        refuse_tone_curve("a.png", bent)


@pytest.mark.parametrize("factor", [1.0, 1.37, 4.0, 16.0, 257.0])
@pytest.mark.parametrize("steps", [255, 4095])
def test_no_linear_picture_is_taken_for_a_bent_one(factor, steps):
    """Whatever the first counts were and whatever they were multiplied by, numbers are equally far apart."""
    for light in (0.2, 1.0):
        numbers = np.rint(factor * np.rint(steps * light * ball()))
        refuse_tone_curve("a.tif", np.clip(numbers, 0, 65535).astype(np.uint16))


def test_what_is_no_linear_picture_is_refused(tmp_path):
    png = write_samples(tmp_path / "a.png", np.zeros((8, 8, 4), dtype=np.uint8))
    with pytest.raises(InputError, match=r"4 bands of uint8.*without transparency"):
        decode(png, linear=True)
    with pytest.raises(InputError, match="no such file"):
        decode(tmp_path / "b.png", linear=True)
    (tmp_path / "c.tif").write_bytes(b"II*\0" + bytes(40))
    with pytest.raises(InputError, match=r"c\.tif"):
        decode(tmp_path / "c.tif", linear=True)
    # Without the word of the user nothing that is no RAW file is decoded.
    with pytest.raises(InputError, match="a PNG picture"):
        decode(png)


def table(tmp_path, *cells: str) -> str:
    lines = ["file,role,light_deg,camera_deg,filter,exposure_s,linear", *cells]
    (tmp_path / "captures.csv").write_text("\n".join(lines) + "\n")
    return tmp_path / "captures.csv"


def test_only_the_user_says_that_a_picture_is_linear(tmp_path):
    write_samples(tmp_path / "a.png", np.zeros((8, 8, 3), dtype=np.uint16))
    dng(tmp_path / "b.dng", random_mosaic(np.random.default_rng(1)))
    row = "{},object,30,0,out,1,{}"
    (shot,) = read_captures(table(tmp_path, row.format("a.png", "yes")), tmp_path)
    assert shot.linear
    for name, said, told in (
        ("a.png", "", "a PNG picture.*yes in the column linear"),
        ("a.png", "no", "a PNG picture"),
        ("a.png", "perhaps", "'perhaps'"),
        ("b.dng", "yes", "no TIFF or PNG picture.*an empty cell for a RAW file"),
    ):
        with pytest.raises(InputError, match=told):
            read_captures(table(tmp_path, row.format(name, said)), tmp_path)


def as_pictures(studio: Studio, suffix: str) -> None:
    """Put linear pictures in place of a session's RAW files."""
    for at, shot in enumerate(studio.shots):
        name = shot.file.replace(".dng", suffix)
        develop_linearly(studio.folder / shot.file, studio.folder / name)
        studio.shots[at] = replace(shot, file=name, linear=True)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_responses_are_those_of_the_raw_files(tmp_path, suffix):
    """Black is gone from the pictures. What the noise of one band is, all bands tell together."""
    studio = Studio(tmp_path, seed=11)
    studio.references()
    truth = scene(studio.rng)
    studio.shoot("object", truth, "out", 0.02)
    pose = Pose(ANGLE, 0.0).name
    response, valid, noise, _ = studio.ingest(pose)
    as_pictures(studio, suffix)
    check_captures(studio.table(), tmp_path, tmp_path / "checked.csv", ("object", "white"))
    assert all(shot.linear for shot in read_captures(tmp_path / "checked.csv"))
    own, own_valid, own_noise, _ = studio.ingest(pose)
    assert own.shape == response.shape
    both = (valid == 1) & (own_valid == 1)
    assert both.mean() > 0.99
    assert np.abs(own - response)[both].max() < 2e-3
    ratio = own_noise[:, 1] / noise[:, 1]
    assert (ratio > 0.6).all() and (ratio < 1.7).all()


def test_a_camera_that_bends_the_light_is_refused_by_its_exposure_series(tmp_path):
    studio = Studio(tmp_path, seed=4)
    white = np.full((80, 120, 6), 0.6)
    for exposure_s in (0.005, 0.01, 0.02):
        studio.shoot("white", white, "out", exposure_s)
    as_pictures(studio, ".png")
    studio.reference()
    for shot in studio.shots:
        path = tmp_path / shot.file
        share = decode(path, linear=True).superpixels / 65535.0
        noisy = np.random.default_rng(1).uniform(-0.5, 0.5, share.shape)
        write_samples(path, np.clip(np.rint(65535.0 * share ** (1 / 1.2) + noisy), 0, 65535).astype(np.uint16))
    with pytest.raises(InputError, match="deviates by"):
        studio.reference()


def test_eight_bits_are_warned_of_once(tmp_path, caplog):
    for name in ("a.png", "b.png"):
        write_samples(tmp_path / name, np.rint(200.0 * ball(60) * (1.0 if name == "a.png" else 0.9)).astype(np.uint8))
    csv = table(tmp_path, "a.png,object,30,0,out,1,yes", "b.png,object,40,0,out,1,yes")
    with caplog.at_level(logging.WARNING):
        check_captures(csv, tmp_path, tmp_path / "checked.csv", ("object",))
    assert caplog.text.count("8 bits a band") == 1


def test_a_picture_is_not_interpolated(tmp_path):
    studio = Studio(tmp_path, seed=11)
    studio.references(darks=0)
    studio.shoot("object", scene(studio.rng), "out", 0.02)
    as_pictures(studio, ".tif")
    with pytest.raises(InputError, match="superpixel, which takes each pixel of a picture as it is"):
        studio.ingest(Pose(ANGLE, 0.0).name, IngestOptions(demosaic="linear", register=False))
