"""The command `irodori preview`: a page of all photographs with outlines and findings."""

import math
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from made import made
from sessions import definitions
from test_check import project, write  # noqa: F401 - the fixture of a project of files

from irodori.check.contact_sheet import ContactSheet, angles_in_words
from irodori.command_line import main
from irodori.config.capture_table import Pose, Shot
from irodori.config.models import Object, Optics, Rig
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.projected_outline import silhouette, svg_path
from irodori.geometry.shapes.shape import Shape
from irodori.ingest.mosaic import decode
from irodori.lens.printed_sheets import OBJECT_SHEET
from irodori.simulation.virtual_rig.dng_writer import write_dng

OPTICS = {"focal_length_mm": 50.0, "pixel_pitch_um": 20.0, "width_px": 400, "height_px": 300,
          "principal_point_px": [200.0, 150.0]}  # fmt: skip


def figure_of(page: str, name: str) -> str:
    return next(part for part in page.split("<figure")[1:] if f"<b>{name}</b>" in part)


def test_a_finding_stands_beside_its_photograph(project, tmp_path, capsys, monkeypatch):  # noqa: F811
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    dark = sorted((folder / "plate").glob("*-in-*.dng"))[0]
    lit = sorted((folder / "plate").glob("*-out-*.dng"))[0]
    dark.write_bytes(lit.read_bytes())
    table = folder / "plate/captures.csv"
    table.write_text("\n".join(line.rpartition(",")[0] for line in table.read_text().splitlines()))
    assert main(["preview", "-o", "sheet.html"]) == 1
    page = (folder / "sheet.html").read_text()
    assert page.count("<figure") == 14 and 'name="viewport"' in page
    assert not re.search(r'(src|href)="(?!data:)', page), "the page reads nothing from elsewhere"
    assert 'class="error"' in figure_of(page, dark.name) and 'class="error"' not in figure_of(page, lit.name)
    assert "<path" in figure_of(page, lit.name)
    light, camera = (int(part[1:]) // 10 for part in lit.name.split("-")[:2])
    said = f"object · light at {light}°, camera at {camera}°, table tilted by 0° and turned by 0° · filter out"
    assert said in figure_of(page, lit.name)
    assert "azimuth" not in page, "this rig's lamp stays in the rig's plane"
    assert figure_of(page, "chart-out-20000us.dng").count("<polygon") == 24


def test_a_caption_states_the_azimuth_where_lamps_may_stand_anywhere():
    pose = Pose(45.0, 20.0, 5.0, 90.0, light_azimuth_deg=-120.0)
    assert angles_in_words(pose, True) == (
        "light at 45° and azimuth -120°, camera at 20°, table tilted by 5° and turned by 90°"
    )
    assert angles_in_words(pose, False) == angles_in_words(pose, True), "a mistake is shown"
    assert "azimuth 0°" in angles_in_words(Pose(45.0, 20.0), True)
    assert "azimuth" not in angles_in_words(Pose(45.0, 20.0), False)


def test_the_outline_is_that_of_the_photographed_object(project):  # noqa: F811
    plate, camera, _ = definitions()
    camera["optics"] |= {"width_px": 240, "height_px": 160, "pixel_pitch_um": 33.0, "principal_point_px": [120.0, 80.0]}
    # The lens of the virtual rig is 1 % longer than stated, and the object lies 0.8 mm along x and -0.6 mm along y.
    camera["optics"]["focal_length_mm"] *= 1.01
    px_per_mm = camera["optics"]["focal_length_mm"] / (900.0 * 0.033)
    pose = Pose(45.0, 20.0)
    shape = Shape.from_definition(made(Object, plate).shape)
    mask = silhouette(shape, Pinhole.from_optics(made(Optics, camera["optics"])), 900.0, pose)
    green = decode(sorted((project / "plate").glob("*-out-*.dng"))[0]).superpixels[..., 1]
    lit = green > 0.08 * np.percentile(green, 90.0)
    # In mosaic pixels: rows and columns of the plate's outline, at the picture's middle.
    aside = 0.8 * math.cos(math.radians(20.0)) * px_per_mm, 0.6 * px_per_mm
    for seen, said, by in ((lit[40], mask[40], aside[0]), (lit[:, 60], mask[:, 60], aside[1])):
        seen, said = np.flatnonzero(seen), np.flatnonzero(said)
        assert abs(2 * (seen[0] - said[0]) - by) <= 3 and abs(2 * (seen[-1] - said[-1]) - by) <= 3


def test_the_outline_of_a_ball_before_a_pinhole_is_a_circle():
    shape = Shape.from_definition(
        made(Object, {"camera": "c", "shape": {"kind": "sphere", "radius_mm": 30.0},
                      "texels": {"width": 4, "height": 4}}).shape
    )  # fmt: skip
    mask = silhouette(shape, Pinhole.from_optics(made(Optics, OPTICS)), 900.0, Pose(45.0, 30.0))
    radius = 30.0 / np.sqrt(900.0**2 - 30.0**2) * 2500.0 / 2.0  # superpixels
    y, x = np.indices(mask.shape)
    away = np.hypot(x - 99.5, y - 74.5)
    assert mask[away < radius - 0.5].all() and not mask[away > radius + 0.5].any()


def test_the_path_runs_about_what_is_covered():
    mask = np.zeros((4, 5), dtype=bool)
    mask[1:3, 1:4] = True
    assert sorted(re.findall(r"M\d+ \d+[hv]\d+", svg_path(mask))) == ["M1 1h3", "M1 1v2", "M1 3h3", "M4 1v2"]


@pytest.mark.parametrize("markers, corners", [({"paper": "A4"}, 48), (None, 0)])
def test_the_corners_of_the_printed_sheet_that_are_found_are_drawn(tmp_path, markers, corners):
    drawn = 0.1 + 0.8 * OBJECT_SHEET.picture(24) / 255.0
    level = np.pad(drawn, 40, constant_values=0.5).repeat(2, axis=0).repeat(2, axis=1)
    mosaic = (512 + 9000 * level).astype(np.uint16)
    write_dng(tmp_path / "a.dng", mosaic, black_level=512, white_level=16383, exposure_s=0.02, model="test")
    plate, _, rig = definitions()
    definition = made(Object, plate | ({} if markers is None else {"markers": markers}))
    loaded = SimpleNamespace(objects={"plate": definition}, cameras={"eye": SimpleNamespace(optics=None, rig="table")},
                             rigs={"table": made(Rig, rig)})  # fmt: skip
    one = SimpleNamespace(kind="objects", name="objects/plate", subject="plate", camera="eye")
    shot = Shot("a.dng", "object", Pose(45.0, 0.0), "out", 0.02)
    sheet = ContactSheet(loaded)
    sheet.add(one, shot, tmp_path / "a.dng", decode(tmp_path / "a.dng"))
    (picture,) = sheet.sets["objects/plate"]
    assert len(picture.patches) == corners and ("48 corners of the printed sheet" in picture.caption) == bool(corners)
    middles = {tuple(np.array([p.split(",") for p in patch.split()], float).mean(axis=0)) for patch in picture.patches}
    # In superpixels whose left edge is an integer: the first corner lies one square from the first of the board.
    assert not corners or min(np.hypot(x - 64.0, y - 64.0) for x, y in middles) < 0.2
