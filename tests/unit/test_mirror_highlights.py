"""Directions to lamps by their mirror images on a ball."""

import glob
from pathlib import Path

import numpy as np
import pytest
import tifffile
from documented import of_kind, words_of
from dome_pictures import BALL, SIZE, eight_bits, lamps, mirror_ball, supersampled
from linear_files import write_samples
from raw_studio import ROOT

from irodori.command_line import main
from irodori.core.errors import InputError
from irodori.first_project.light_places import read_light_places
from irodori.first_project.mirror_highlights import brightness, lamp_direction, outline
from irodori.geometry.circle_search import Circle, circle_of_mask, find_circle

REAL = ROOT.parent / "shared" / "data" / "photographs" / "ball"


def apart_deg(one, other) -> float:
    one, other = (np.asarray(v) / np.linalg.norm(v) for v in (one, other))
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))


def disc(circle=BALL) -> np.ndarray:
    return supersampled(lambda normals: np.ones((len(normals), 3)), ball=circle)[..., 0] > 0.5


@pytest.mark.parametrize("ball", [BALL, (40.2, 70.0, 25.0), (100.0, 60.5, 55.0)])
def test_an_outline_is_found_whatever_else_has_edges(ball):
    lamp = np.array([0.5, 0.4, 0.77])
    for shade in (
        lambda normals: np.maximum(normals @ lamp, 0.0)[:, None] * np.array([0.8, 0.7, 0.5]),
        lambda normals: np.where(np.sin(12.0 * normals[:, 2:]) > 0.0, 0.6, 0.2) * np.ones(3),
        lambda normals: np.where(np.sin(9.0 * normals[:, :1]) > 0.0, 0.5, 0.25) * np.ones(3),
    ):
        found = find_circle(supersampled(shade, ball=ball).mean(axis=-1), "a.png")
        assert np.abs(np.subtract(found, ball)).max() < 0.6


def test_what_shows_no_ball_is_refused():
    rng = np.random.default_rng(2)
    with pytest.raises(InputError, match="without edges"):
        find_circle(np.ones(SIZE), "a.png")
    square = np.zeros(SIZE)
    square[30:80, 40:120] = 1.0
    for picture in (rng.uniform(0.0, 1.0, SIZE), square):
        with pytest.raises(InputError, match="outline"):
            find_circle(picture, "a.png")


def test_a_mask_gives_the_circle_of_its_area():
    assert np.abs(np.subtract(circle_of_mask(disc().astype(float), "m.png"), BALL)).max() < 0.1
    for mask in (np.zeros(SIZE), np.indices(SIZE)[0] > 30):
        with pytest.raises(InputError, match="no disc"):
            circle_of_mask(mask.astype(float), "m.png")


def test_lamps_stand_where_their_images_say():
    """Clipping leaves the place of an image open by a third of a pixel, which is 0.8 degrees on a ball this small."""
    directions = lamps(8)
    pictures = [mirror_ball(lamp).min(axis=-1) for lamp in directions]
    circle = outline(pictures, "a.png")
    assert np.abs(np.subtract(circle, BALL)).max() < 0.5
    for lamp, picture in zip(directions, pictures, strict=True):
        assert apart_deg(lamp_direction(picture, Circle(*BALL), "a.png"), lamp) < 1.0
        assert apart_deg(lamp_direction(picture, circle, "a.png"), lamp) < 1.25


def test_no_lamp_and_two_lamps_are_refused():
    circle = Circle(*BALL)
    with pytest.raises(InputError, match=r"a\.png: .*no highlight"):
        lamp_direction(supersampled(lambda n: 0.1 + 0.0 * n).min(axis=-1), circle, "a.png")
    both = np.maximum(*(mirror_ball(lamp).min(axis=-1) for lamp in lamps(2)))
    with pytest.raises(InputError, match="2 highlights"):
        lamp_direction(both, circle, "a.png")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number, lamp in enumerate(lamps(11)):
        write_samples(tmp_path / f"chrome.{number}.png", eight_bits(mirror_ball(lamp)))
    write_samples(tmp_path / "mask.png", eight_bits(disc()[..., None].repeat(3, axis=2)))
    return [f"chrome.{number}.png" for number in (10, *range(10))]


def test_the_command_lists_the_photographs_of_the_object_in_counting_order(folder, capsys):
    names = [f"plate/plate_{number:d}.tif" for number in (10, *range(10))]
    assert main(["lights", *folder, "mask.png", "--mask", "mask.png", "--names", *names]) == 0
    places = read_light_places("lights.lp")
    assert len(places) == 11
    for number, lamp in enumerate(lamps(11)):
        assert apart_deg(places[f"plate_{number}"], lamp) < 1.0
    assert "light_azimuth_deg" in capsys.readouterr().out
    # The object was photographed while the camera's numbers began again after 9999.
    names = [f"IMG_{number:04d}.NEF" for number in (*range(1, 9), 9997, 9998, 9999)]
    assert main(["lights", *folder, "--circle", *map(str, BALL), "--names", *names]) == 0
    for name, lamp in zip([*names[-3:], *names[:-3]], lamps(11), strict=True):
        assert apart_deg(read_light_places("lights.lp")[name[:-4].lower()], lamp) < 1.0
    assert main(["lights", *folder, "--circle", *map(str, BALL), "--into", "b.lp"]) == 0
    for number, lamp in enumerate(lamps(11)):
        assert apart_deg(read_light_places("b.lp")[f"chrome.{number}"], lamp) < 1.0


def test_the_order_of_names_matters_only_where_other_names_are_listed(folder, capsys):
    numbers = [500, 1000, 1600, 9500]
    for at, number in enumerate(numbers):
        Path(f"chrome.{at}.png").rename(f"img_{number:04d}.png")
    own = [f"img_{number:04d}.png" for number in numbers]
    circle = ["--circle", *map(str, BALL)]
    assert main(["lights", *own, *circle]) == 0
    for name, lamp in zip(own, lamps(11), strict=False):
        assert apart_deg(read_light_places("lights.lp")[Path(name).stem], lamp) < 1.0
    capsys.readouterr()
    Path("lights.lp").unlink()
    plain = ["plate_1.tif", "plate_2.tif", "plate_3.tif", "plate_4.tif"]
    for ball, names in ((own, plain), (sorted(folder)[-4:], [f"plate/{name}" for name in own])):
        assert main(["lights", *ball, *circle, "--names", *names]) == 2
        said = capsys.readouterr().err
        assert "img_9500.png: found numbers up to img_9500.png, after which" in said and said.count("\n") == 1
        names = "names that tell, such as a-img_9500.png before b-img_0500.png if it has.\n"
        assert said.endswith(f"accepted: --order names if it has not, or {names}")
        assert not Path("lights.lp").exists()
    renamed = ["a-img_9500.png", *(f"b-{name}" for name in own[:3])]
    for name, new in zip([own[3], *own[:3]], renamed, strict=True):
        Path(name).rename(new)
    assert main(["lights", *renamed, *circle, "--names", *plain]) == 0
    assert apart_deg(read_light_places("lights.lp")["plate_1"], lamps(11)[3]) < 1.0


def test_the_clock_tells_which_photograph_of_the_object_each_lamp_lit(folder, capsys):
    """Names that do not count photographs, and a count that began again, by the times in the files."""
    Path("plate").mkdir()

    def taken(*names: str) -> list[str]:
        for minute, name in enumerate(names):
            tags = [(36867, "s", 0, f"2026:11:23 08:{minute:02d}:00", True)]
            tifffile.imwrite(f"plate/{name}", np.zeros((2, 2), np.uint16), extratags=tags, metadata=None)
        return [f"plate/{name}" for name in names]

    begun_again = [f"IMG_{number:04d}.tif" for number in (9990, 9994, 9998, 3, 4, 5, 6, 7, 8, 9, 10)]
    turned = [f"{letter}-side.tif" for letter in "hbkacdegfij"]
    words = ["lights", *folder, "--circle", *map(str, BALL)]
    for names in (begun_again, turned):
        assert main([*words, "--names", *sorted(taken(*names))]) == 0
        for name, lamp in zip(names, lamps(11), strict=True):
            assert apart_deg(read_light_places("lights.lp")[name[:-4].lower()], lamp) < 1.0
    Path("lights.lp").unlink()
    capsys.readouterr()
    backwards = taken(*(f"IMG_{number:04d}.tif" for number in range(20, 9, -1)))
    assert main([*words, "--names", *backwards]) == 2
    said = capsys.readouterr().err
    assert "IMG_0011.tif: time: found 2026-11-23T08:09:00, before 2026-11-23T08:10:00 of IMG_0010.tif" in said
    assert "--order names if" in said and said.count("\n") == 1 and not Path("lights.lp").exists()
    silent = [f"none/{number}.tif" for number in range(11)]
    assert main([*words, "--names", *silent[:10], silent[3]]) == 2
    assert "3.tif: found a photograph that is listed twice; accepted: each photograph" in capsys.readouterr().err
    assert main([*words, "--names", *silent, "--order", "clock"]) == 2
    assert "time: found none; accepted: --order clock where every file" in capsys.readouterr().err
    for order, first in (("names", "img_0010"), ("clock", "img_0020")):
        assert main([*words, "--names", *backwards, "--order", order]) == 0
        assert apart_deg(read_light_places("lights.lp")[first], lamps(11)[0]) < 1.0


@pytest.mark.parametrize("command", of_kind("lights"))
def test_a_documented_command_finds_lamps(command, folder, tmp_path):
    """What a shell makes of a star is for it to do."""
    words = words_of(command)[1:]
    for word in words:
        if "*" in word or word.endswith(".png"):
            Path(word).parent.mkdir(exist_ok=True)
    for number in range(11):
        Path("Mirror ball", f"{number}.png").write_bytes(Path(f"chrome.{number}.png").read_bytes())
        Path("My plate", f"{number}.png").write_bytes(b"")
    Path("mask.png").rename(Path("Mirror ball", "mask.png"))
    expanded = [name for word in words for name in (sorted(glob.glob(word)) if "*" in word else [word])]
    assert main(expanded) == 0
    assert len(read_light_places("dome.lp")) == 11


def test_the_command_refuses_in_one_sentence(folder, capsys):
    for more, told in (
        (["--names", "a.png"], "11 photographs of the ball and 1 name;"),
        (["--mask", "small.png"], "20 x 20 pixels; accepted: 170 x 120"),
        (["small.png"], "20 x 20 pixels; accepted: 170 x 120 pixels, as chrome.0.png"),
        (["none.png"], "none.png"),
    ):
        write_samples("small.png", np.zeros((20, 20, 3), dtype=np.uint8))
        assert main(["lights", *folder, *more, "--into", "none.lp"]) == 2
        error = capsys.readouterr().err
        assert told in error and error.count("\n") == 1


@pytest.mark.skipif(not REAL.is_dir(), reason="no measured photographs beside the repository")
def test_real_lamps_stand_where_they_were_found_before():
    """The directions in the list of the data were found by other means; each lamp's is found again in each band."""
    paths = [REAL / f"chrome.{number}.png" for number in range(12)]
    pictures = [brightness(path) for path in paths]
    circle = circle_of_mask(brightness(REAL / "chrome.mask.png"), "mask")
    for number, known in ((0, (0.495, 0.471, 0.730)), (4, (-0.323, 0.510, 0.797))):
        assert apart_deg(lamp_direction(pictures[number], circle, "x"), known) < 1.0
    found = outline(pictures, "x")
    for path, picture in zip(paths, pictures, strict=True):
        direction = lamp_direction(picture, circle, path)
        assert apart_deg(lamp_direction(picture, found, path), direction) < 1.5
