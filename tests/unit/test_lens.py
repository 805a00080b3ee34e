"""A lens is measured from photographs of the printed sheet, and what cannot be told from them is refused."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from documented import of_kind, words_of
from drawn_sheets import COLUMNS, HEIGHT, PITCH_UM, PLACES, ROWS, STRAIGHT, TRUE, WIDTH, photographed, seen_sheet, store
from made import made
from scipy.spatial.transform import Rotation

from irodori.command_line import main
from irodori.config.capture_table import COLUMNS as COLUMNS_OF_TABLE
from irodori.config.models import Optics
from irodori.core.errors import InputError
from irodori.core.left_out import simplest
from irodori.geometry.distortion import COEFFICIENTS
from irodori.geometry.pinhole import Pinhole
from irodori.lens.lens_file import LensFile, optics_in_use
from irodori.lens.lens_models import Sheet, fit_lens
from irodori.lens.printed_sheets import LENS_SHEET, OBJECT_SHEET
from irodori.lens.stage import MeasuredLens, calibrate_lens, compared


def corners(lens: Pinhole, places, sigma=0.02, seed=1) -> list[Sheet]:
    """Corners as the sheet's `find` would find them, with errors of a standard deviation in superpixels."""
    random = np.random.default_rng(seed)
    plane = np.stack(np.meshgrid(np.arange(1, COLUMNS), np.arange(1, ROWS)), axis=-1).reshape(-1, 2)
    sheets = []
    for number, place in enumerate(places):
        origin, axes = seen_sheet(lens, *place)
        seen = lens.project(origin + plane @ axes[:, :2].T, np.zeros(3), np.eye(3))
        seen += random.normal(0.0, sigma, seen.shape)
        sheets.append(Sheet(f"{number}.dng", plane.astype(np.float32), seen.astype(np.float32)))
    return sheets


def apart_px(lens: Pinhole, found: Pinhole) -> float:
    """Largest distance between where two lenses show a direction, after the turn that brings them closest, pixels.

    A turn of the camera is not the lens's: a principal point that is off by a pixel and a turn that undoes it are one.
    """
    x, y = np.meshgrid(np.linspace(0, WIDTH, 13), np.linspace(0, HEIGHT, 9))
    at = np.stack([x, y], axis=-1).reshape(-1, 2)
    true, other = lens.directions(at, np.eye(3)), found.directions(at, np.eye(3))
    turn, _ = Rotation.align_vectors(true, other)
    return float(np.linalg.norm(turn.apply(other) - true, axis=1).max() * lens.focal_px)


@pytest.mark.heavy
def test_a_lens_is_found_in_raw_photographs_of_the_sheet(tmp_path, capsys):
    store(tmp_path / "lens", [photographed(TRUE, place, seed) for seed, place in enumerate(PLACES)])
    assert main(["lens", str(tmp_path / "lens"), "--pixel-pitch-um", str(PITCH_UM)]) == 0
    said = capsys.readouterr()
    found = Pinhole.from_optics(made(Optics, yaml.safe_load(said.out)["optics"]))
    assert found.focal_px == pytest.approx(TRUE.focal_px, rel=2e-3)
    assert found.centre_px == pytest.approx(TRUE.centre_px, abs=3.0)
    assert (found.width_px, found.height_px) == (WIDTH, HEIGHT)
    assert apart_px(TRUE, found) < 0.5
    assert "10 photographs" in said.err and "± " in said.err


def test_a_photograph_without_the_sheet_and_one_of_a_bent_sheet_are_named_and_left_out(tmp_path, capsys):
    mosaics = [photographed(TRUE, place, seed) for seed, place in enumerate(PLACES[:7])]
    mosaics[2] = np.full_like(mosaics[2], 4000)
    mosaics[4] = photographed(TRUE, PLACES[4], 4, bend=0.03)
    store(tmp_path / "lens", mosaics)
    assert main(["lens", str(tmp_path / "lens"), "--pixel-pitch-um", "5"]) == 0
    said = capsys.readouterr()
    assert "sheet02.dng: left out, 0 of the sheet's corners found" in said.err
    assert "sheet04.dng: left out, it fits no lens that fits the others" in said.err and "5 photographs" in said.err
    found = Pinhole.from_optics(made(Optics, yaml.safe_load(said.out)["optics"]))
    assert found.focal_px == pytest.approx(TRUE.focal_px, rel=5e-3)


@pytest.mark.parametrize(("lens", "distorted"), [(STRAIGHT, False), (TRUE, True)])
def test_distortion_is_modelled_only_where_left_out_photographs_call_for_it(lens, distorted):
    found, far = fit_lens(corners(lens, PLACES), (WIDTH // 2, HEIGHT // 2))
    assert not far and bool(found.coefficients.any()) is distorted
    assert found.rms < 0.05


@pytest.mark.default_cases(3)
@pytest.mark.parametrize("seed", range(6))
def test_stated_errors_hold(seed):
    found, _ = fit_lens(corners(TRUE, PLACES, sigma=0.05, seed=seed), (WIDTH // 2, HEIGHT // 2))
    # Four standard errors: six draws of three numbers each stay within them but once in a thousand runs.
    assert abs(2.0 * found.focal - TRUE.focal_px) < 4.0 * 2.0 * found.focal_error
    apart = 2.0 * (found.centre + 0.5) - np.array(TRUE.centre_px)
    assert (np.abs(apart) < 4.0 * 2.0 * found.centre_error).all()
    assert found.focal_error < 0.003 * found.focal


def test_sheets_that_all_face_the_camera_do_not_tell_the_focal_length(tmp_path, capsys):
    places = [(0, 0, x, y) for x, y in [(0.5, 0.5), (0.4, 0.5), (0.6, 0.5), (0.5, 0.4), (0.5, 0.6), (0.4, 0.4)]]
    store(tmp_path / "lens", [photographed(STRAIGHT, place, seed) for seed, place in enumerate(places)])
    assert main(["lens", str(tmp_path / "lens"), "--pixel-pitch-um", "5"]) == 2
    said = capsys.readouterr()
    assert not said.out and "found a focal length known to" in said.err and "tilt the sheet" in said.err


def test_of_models_as_good_as_each_other_the_simplest_is_taken():
    noise = np.random.default_rng(3).chisquare(100, 12) / 100.0
    scatter = np.resize([0.01, -0.01], 12)  # its mean has a standard error of 0.003
    errors = {"none": noise + 0.004 + scatter, "k1": noise + 0.002 + scatter, "k1 k2": noise}
    assert simplest(errors) == "k1"


def test_too_few_photographs_and_files_without_a_pixel_pitch_are_refused(tmp_path, capsys):
    store(tmp_path / "lens", [photographed(TRUE, PLACES[0])])
    assert main(["lens", str(tmp_path / "lens"), "--pixel-pitch-um", "5"]) == 2
    assert "found the sheet in 1 photograph; accepted: 5 or more" in capsys.readouterr().err
    assert main(["lens", str(tmp_path / "lens")]) == 2
    assert "--pixel-pitch-um" in capsys.readouterr().err


def test_photographs_of_several_sizes_are_refused(tmp_path, capsys):
    mosaic = photographed(TRUE, PLACES[0])
    store(tmp_path / "lens", [mosaic, mosaic[: HEIGHT // 2]])
    assert main(["lens", str(tmp_path / "lens"), "--pixel-pitch-um", "5"]) == 2
    assert "sheet01.dng: size: found 1200 x 400 pixels; accepted: 1200 x 800" in capsys.readouterr().err


@pytest.mark.default_cases(3)
@pytest.mark.parametrize(
    "sheet, corners, paper",
    [
        *[
            pytest.param(LENS_SHEET, (COLUMNS - 1) * (ROWS - 1), paper, id=f"lens {paper}")
            for paper in LENS_SHEET.papers_mm
        ],
        # A ring of two squares: the outline of 15 by 10 corners, and two corners of the black middle.
        *[pytest.param(OBJECT_SHEET, 48, paper, id=f"object {paper}") for paper in OBJECT_SHEET.papers_mm],
    ],
)
def test_a_printed_sheet_is_of_its_size_and_is_found_as_itself(tmp_path, sheet, corners, paper):
    """A page of the stated size; of its picture, with print and paper of ordinary brightness, all corners are seen."""
    sheet.write(tmp_path / "sheet.pdf", paper)
    width_mm, height_mm, square_mm = sheet.papers_mm[paper]
    text = (tmp_path / "sheet.pdf").read_bytes()
    box = text[text.index(b"/MediaBox") :].split(b"[")[1].split(b"]")[0].split()
    assert [float(value) * 25.4 / 72.0 for value in box[2:]] == pytest.approx([width_mm, height_mm], abs=0.1)
    assert sheet.columns * square_mm < width_mm - 10 and sheet.rows * square_mm < height_mm - 10
    picture = np.pad(0.1 + 0.8 * sheet.picture(20).astype(np.float32) / 255.0, 30, constant_values=0.9)
    plane, seen = sheet.find(picture)
    assert len(plane) == corners
    np.testing.assert_allclose(seen, plane * 20.0 + 29.5, atol=0.1)
    other = LENS_SHEET if sheet is OBJECT_SHEET else OBJECT_SHEET
    assert len(other.find(picture)[0]) == 0


def test_the_sheet_has_a_name_and_a_folder_or_is_refused(tmp_path, capsys):
    for name in ("sheet.png", "nowhere/sheet.pdf"):
        assert main(["lens", "--print", str(tmp_path / name)]) == 2
        assert "accepted: a" in capsys.readouterr().err
    assert main(["lens", "--print", str(tmp_path / "sheet.pdf"), "--paper", "A3"]) == 0
    with pytest.raises(SystemExit):
        main(["lens"])


TYPED = {"focal_length_mm": 7.0, "pixel_pitch_um": PITCH_UM, "width_px": WIDTH, "height_px": HEIGHT,
         "principal_point_px": [600.0, 400.0]}  # fmt: skip


def camera_table(folder, mosaics):
    """Store photographs of the sheet beside one of a chart, as a camera's table lists them."""
    store(folder, mosaics)
    lines = [f"sheet{number:02}.dng,lens,0,0,0,0,out,0.02" for number in range(len(mosaics))]
    (folder / "chart.dng").write_bytes(b"not opened")
    lines.insert(1, "chart.dng,chart,45,0,0,0,out,0.02")
    table = folder / "captures.csv"
    table.write_text("\n".join([",".join(COLUMNS_OF_TABLE), *lines]))
    return table


def test_the_workflows_lens_is_measured_from_the_sheets_of_the_cameras_table_and_used_in_place_of_the_typed(tmp_path):
    table = camera_table(tmp_path / "lens", [photographed(TRUE, place, seed) for seed, place in enumerate(PLACES)])
    typed = made(Optics, TYPED)
    calibrate_lens(table, table.parent, typed, tmp_path / "lens.yaml")
    assert optics_in_use(typed, []) == typed
    found = Pinhole.from_optics(optics_in_use(typed, [tmp_path / "lens.yaml"]))
    assert apart_px(TRUE, found) < 0.5
    assert optics_in_use(replace(typed, roll_deg=180), [tmp_path / "lens.yaml"]).roll_deg == 180
    loaded = LensFile.load(tmp_path / "lens.yaml")
    # 1500 pixels of 5 um are 7.5 mm, and 7 mm were typed.
    assert abs(loaded.optics.focal_length_mm - 7.5) < 4.0 * loaded.focal_length_error_mm < 0.1
    assert "7.1 % more than the typed 7 mm" in loaded.remarks[0]
    assert any("10 photographs" in remark for remark in loaded.remarks)


def test_photographs_of_the_sheet_of_another_size_than_typed_are_refused(tmp_path):
    table = camera_table(tmp_path / "lens", [photographed(STRAIGHT, place, seed) for seed, place in enumerate(PLACES)])
    typed = made(Optics, TYPED | {"width_px": 1280})
    with pytest.raises(InputError, match="width_px: found photographs of the role lens of 1200 pixels; accepted: 1280"):
        calibrate_lens(table, table.parent, typed, tmp_path / "lens.yaml")
    assert not (tmp_path / "lens.yaml").exists()


@pytest.mark.parametrize(
    ("typed_mm", "said"),
    [
        (50.08, "as typed (50.08 mm)"),
        (48.0, "4.2 % more than the typed 48 mm"),
        (55.0, "9.1 % less than the typed 55 mm"),
    ],
)
def test_the_measured_focal_length_is_held_against_the_typed_one_in_a_sentence(typed_mm, said):
    found = MeasuredLens(TYPED | {"focal_length_mm": 50.0}, 0.05, [])
    sentence = compared(found, made(Optics, TYPED | {"focal_length_mm": typed_mm}))
    assert sentence.startswith("focal length 50.000 ± 0.050 mm, ") and said in sentence


def test_coefficients_come_in_the_order_of_opencv():
    cv2 = pytest.importorskip("cv2")
    seen, _ = cv2.projectPoints(
        np.array([[[0.2, 0.1, 1.0]]]), np.zeros(3), np.zeros(3),
        np.array([[1500, 0, 612], [0, 1500, 391], [0, 0, 1.0]]), np.array(TRUE.distortion),
    )  # fmt: skip
    ours = TRUE.project(np.array([0.2, 0.1, 1.0]), np.zeros(3), np.eye(3))
    np.testing.assert_allclose(2.0 * (ours + 0.5), seen.ravel(), rtol=1e-12)
    assert COEFFICIENTS[:4] == ("k1", "k2", "p1", "p2")


def test_a_black_picture_shows_no_sheet():
    plane, seen = LENS_SHEET.find(np.zeros((50, 60), np.float32))
    assert len(plane) == len(seen) == 0


def test_the_documented_commands_print_a_sheet_and_measure_a_lens(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    store(tmp_path / "My lens", [photographed(TRUE, place, seed) for seed, place in enumerate(PLACES)])
    for command in of_kind("lens"):
        program, *words = words_of(command)
        assert program == "irodori" and main(words) == 0, command
    assert (tmp_path / "sheet.pdf").stat().st_size > 1000 and "focal_length_mm: 1" in capsys.readouterr().out
