"""Spectra and their files: exact where the mathematics is, and refusals that name the place of the fault."""

import math
import re
import subprocess
import sys
from pathlib import Path

import colour
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made

from irodori.calibration.filter_table import read_filter
from irodori.calibration.filters import read_filters
from irodori.colour.colorimetry import delta_e_reflectance
from irodori.config.models import RefractiveIndex
from irodori.core.errors import InputError
from irodori.spectra.grid import TRAPEZOID_NM, WAVELENGTH_NM
from irodori.spectra.published import (
    camera_sensitivities,
    chart_spectra,
    light,
    read_spectra,
    refractive_index,
    spectrum,
)
from irodori.spectra.resampling import resample
from irodori.spectra.tables import wide_table
from irodori.spectra.white_reference import white_reflectance

ROOT = Path(__file__).resolve().parents[2]
COEFFICIENT = st.floats(-10.0, 10.0)
GRID = list(range(380, 721, 10))


def wide(path, wavelengths=GRID, rows=None):
    """Write a wide table; ``rows`` are lists of cells, by default one spectrum of 0.5."""
    rows = [["one", *[0.5] * len(wavelengths)]] if rows is None else rows
    lines = [["name", *wavelengths], *rows]
    path.write_text("\n".join(",".join(map(str, line)) for line in lines) + "\n")
    return path


def columns(path, rows, header="wavelength_nm,r,g,b"):
    path.write_text("\n".join([header, *[",".join(map(str, row)) for row in rows]]) + "\n")
    return path


def refusal(call, *arguments):
    with pytest.raises(InputError) as caught:
        call(*arguments)
    return caught.value


# Integration and interpolation


@given(a=COEFFICIENT, b=COEFFICIENT)
def test_the_trapezoid_integrates_a_line_exactly(a, b):
    exact = a * 300.0 + b * (700.0 - 400.0) / 2
    line = a + b * (WAVELENGTH_NM - 400.0) / 300.0
    assert line @ TRAPEZOID_NM == pytest.approx(exact, rel=1e-12, abs=1e-10)


@given(
    a=COEFFICIENT,
    b=COEFFICIENT,
    steps=st.lists(st.floats(0.5, 20.0), min_size=20, max_size=60),
    start=st.floats(360.0, 400.0),
)
def test_resampling_a_line_gives_the_line_at_any_spacing(a, b, steps, start):
    wavelengths = start + np.concatenate([[0.0], np.cumsum(steps)])
    wavelengths = np.append(wavelengths, np.arange(wavelengths[-1] + 10.0, 711.0, 10.0))
    values = np.stack([a + b * (wavelengths - 550.0) / 100, np.ones_like(wavelengths)])
    if wavelengths[-1] < 700.0:
        wavelengths, values = np.append(wavelengths, 715.0), np.c_[values, [a + b * 1.65, 1.0]]
    result = resample(wavelengths, values, "made up")
    assert result.shape == (2, 61)
    assert result[0] == pytest.approx(a + b * (WAVELENGTH_NM - 550.0) / 100, abs=1e-11)
    assert result[1] == pytest.approx(np.ones(61), abs=1e-15)


@given(
    coefficients=st.lists(COEFFICIENT, min_size=1, max_size=5),
    step=st.sampled_from([1.0, 2.0, 10.0 / 3.0, 4.0, 7.0, 10.0, 16.0, 20.0]),
    start=st.floats(360.0, 400.0),
)
@settings(deadline=None)
def test_sprague_gives_a_polynomial_of_degree_four_exactly_within_and_a_line_everywhere(coefficients, step, start):
    wavelengths = start + step * np.arange(np.ceil((700.0 - start) / step) + 1)
    polynomial = np.polynomial.Polynomial(coefficients, domain=[300.0, 800.0])
    result = resample(wavelengths, polynomial(wavelengths), "made up", method="sprague")
    within = (wavelengths[2] <= WAVELENGTH_NM) & (wavelengths[-3] >= WAVELENGTH_NM)
    assert result[within] == pytest.approx(polynomial(WAVELENGTH_NM)[within], abs=1e-9)
    line = polynomial.cutdeg(1)
    result = resample(wavelengths, line(wavelengths), "made up", method="sprague")
    assert result == pytest.approx(line(WAVELENGTH_NM), abs=1e-9)


@given(
    a=COEFFICIENT, b=COEFFICIENT, step=st.floats(0.3, 5.0), start=st.floats(380.0, 400.0), end=st.floats(700.0, 720.0)
)
def test_averaging_a_line_gives_the_line_and_its_end_values_beyond(a, b, step, start, end):
    wavelengths = np.append(np.arange(start, end - 0.1, step), end)
    result = resample(wavelengths, a + b * (wavelengths - 550.0) / 100, "made up", method="average")
    # The mean over a triangle of what a level end differs by from the line that it ends.
    below, above = (
        np.maximum(5.0 - beyond, 0.0) ** 3 / 150.0 for beyond in (WAVELENGTH_NM - start, end - WAVELENGTH_NM)
    )
    assert result == pytest.approx(a + b * (WAVELENGTH_NM + below - above - 550.0) / 100, abs=1e-9)


@pytest.mark.parametrize("line_nm", [403.0, 404.66, 696.5])
def test_a_line_near_the_end_of_a_table_keeps_its_power(line_nm):
    """As that of mercury at 404.7 nm in a table from 400 nm on: the whole table says the same."""
    whole, cut = np.arange(380.0, 781.0), np.arange(400.0, 701.0)

    def averaged(wavelengths):
        power = 1.0 + 100.0 * np.exp(-0.5 * (wavelengths - line_nm) ** 2)
        return resample(wavelengths, power, "made up", method="average")

    wanted = averaged(whole)
    assert wanted[[0, -1]].max() > 3.0
    assert averaged(cut) == pytest.approx(wanted, rel=0.03)


_ONE, _BANDS, _INDEX = "wavelength_nm,x\n", "wavelength_nm,r,g,b\n", "wavelength_nm,n,k\n"


@pytest.mark.parametrize(("reader", "header", "row"), [
    (light, _ONE, "1"),
    (spectrum, _ONE, "0.5"),
    (white_reflectance, _ONE, "0.5"),
    (chart_spectra, _ONE, "0.5"),
    (read_filters, _ONE, "0.5"),
    (lambda path: read_filter(path, None, 2.0), _ONE, "0.5"),
    (camera_sensitivities, _BANDS, "1,1,1"),
    (lambda path: refractive_index(made(RefractiveIndex, {"file": path})), _INDEX, "1.5,0"),
], ids=["light", "surface", "white", "chart", "filters", "filter", "camera", "index"])  # fmt: skip
@pytest.mark.parametrize(("first", "last"), [(402, 780), (380, 698)])
def test_every_kind_of_table_that_does_not_cover_the_grid_is_refused_alike(tmp_path, reader, header, row, first, last):
    path = tmp_path / "short.csv"
    path.write_text(header + "".join(f"{nm},{row}\n" for nm in range(first, last + 1, 2)))
    error = refusal(reader, str(path))
    assert error.found == f"{first}..{last} nm" and error.accepted == "a range that covers 400..700 nm"


@given(seed=st.integers(0, 2**32 - 1), step=st.sampled_from([5.0, 8.0, 10.0, 20.0]))
def test_the_chosen_method_makes_no_negative_value_and_keeps_measured_ones(seed, step):
    wavelengths = np.arange(380.0, 721.0, step)
    values = np.random.default_rng(seed).random((3, wavelengths.size)) ** 8
    result = resample(wavelengths, values, "made up", method="auto")
    assert (result >= 0.0).all()
    shared, ours, theirs = np.intersect1d(WAVELENGTH_NM, wavelengths, return_indices=True)
    assert shared.size > 3
    assert result[:, ours] == pytest.approx(values[:, theirs], abs=1e-12)


@pytest.mark.parametrize(
    "wavelengths",
    [np.arange(380.0, 731.0, 10.0), np.arange(400.0, 701.0, 20.0), np.arange(390.0, 731.0, 4.0),
     np.linspace(398.7, 702.1, 37), np.arange(360.0, 831.0), np.arange(400.0, 701.0, 60.0)],
    ids=["10 nm", "20 nm", "4 nm", "uneven places", "1 nm", "as few as it takes"],
)  # fmt: skip
def test_sprague_is_that_of_colour_science(wavelengths):
    values = np.random.default_rng(len(wavelengths)).normal(size=wavelengths.size)
    expected = colour.SpragueInterpolator(wavelengths, values)(WAVELENGTH_NM)
    gap = float(np.diff(wavelengths).max())
    found = resample(wavelengths, values, "made up", max_gap_nm=gap, method="sprague")
    assert found == pytest.approx(expected, abs=1e-12)


def test_a_measured_lamp_is_read_without_the_library_of_colours():
    """It takes a second to load, in each of the jobs that read one."""
    code = "import sys; from irodori.spectra.published import light; light(sys.argv[1]); print(*sys.modules)"
    lamp = ROOT / "config/lamps/halogen-measured.csv"
    loaded = subprocess.run([sys.executable, "-c", code, lamp], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "irodori.spectra.resampling" in loaded.stdout.split() and not {"colour", "pandas"} & {*loaded.stdout.split()}


def test_uneven_steps_are_interpolated_linearly_and_refused_by_sprague():
    wavelengths = np.delete(np.arange(390.0, 711.0, 10.0), 7)
    values = np.sin(wavelengths / 30.0)
    assert np.array_equal(
        resample(wavelengths, values, "made up", method="auto"), resample(wavelengths, values, "made up")
    )
    assert "uniform" in refusal(lambda: resample(wavelengths, values, "made up", method="sprague")).accepted


def test_an_unknown_method_is_refused_with_the_accepted_ones():
    with pytest.raises(ValueError, match="auto, average, linear, sprague"):
        resample(WAVELENGTH_NM, np.ones(61), "made up", method="cubic")


@pytest.mark.parametrize("thinned_nm", [10.0, 20.0])
def test_sprague_is_nearer_than_linear_on_measured_reflectances(thinned_nm):
    file = Path("../shared/data/reflectance/munsell_matt_1269.csv")
    if not file.is_file():
        pytest.skip(f"{file} is not here")
    _names, wavelengths, values = wide_table(file)
    wavelengths, values = np.array(wavelengths), np.array(values)
    thin = wavelengths % thinned_nm == 0
    truth = resample(wavelengths, values, file)
    errors = {
        method: delta_e_reflectance(truth, resample(wavelengths[thin], values[:, thin], file, method=method)).mean()
        for method in ("sprague", "linear")
    }
    # The figures of `irodori.spectra.resampling`.
    assert errors["sprague"] == pytest.approx({10.0: 0.0353, 20.0: 0.1096}[thinned_nm], abs=2e-3)
    assert errors["linear"] == pytest.approx({10.0: 0.0619, 20.0: 0.2602}[thinned_nm], abs=2e-3)


def test_a_file_on_the_grid_is_read_back_unchanged(tmp_path):
    values = np.random.default_rng(1).random((3, 61))
    rows = [[f"patch {i}", *[repr(float(v)) for v in row]] for i, row in enumerate(values)]
    names, spectra = read_spectra(wide(tmp_path / "chart.csv", WAVELENGTH_NM, rows))
    assert names == ["patch 0", "patch 1", "patch 2"]
    assert np.array_equal(spectra, values)


def test_columns_are_read_by_name_and_resampled(tmp_path):
    file = columns(tmp_path / "camera.csv", [[w, w / 1000, 1 - w / 1000, 0.25] for w in GRID])
    names, spectra = read_spectra(file)
    assert names == ["r", "g", "b"]
    assert spectra == pytest.approx(np.stack([WAVELENGTH_NM / 1000, 1 - WAVELENGTH_NM / 1000, np.full(61, 0.25)]))
    assert camera_sensitivities(str(file)) == pytest.approx(spectra)


def test_a_byte_order_mark_and_blank_lines_do_no_harm(tmp_path):
    file = wide(tmp_path / "excel.csv")
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n") + b"\r\n\r\n")
    names, spectra = read_spectra(file)
    assert names == ["one"] and spectra == pytest.approx(np.full((1, 61), 0.5))


# Refusals


def test_a_missing_file_is_refused_by_name(tmp_path):
    error = refusal(read_spectra, tmp_path / "absent.csv")
    assert "absent.csv" in str(error) and "no such file" in error.found


@pytest.mark.parametrize("cell", ["", " ", "n/a", "0,5", "nan", "inf", "-inf"])
def test_a_wide_table_without_a_number_names_line_and_wavelength(tmp_path, cell):
    cells = [0.5] * len(GRID)
    cells[GRID.index(550)] = f'"{cell}"'
    file = wide(tmp_path / "chart.csv", rows=[["one", *[0.5] * len(GRID)], ["two", *cells]])
    error = refusal(read_spectra, file)
    assert error.file == str(file)
    assert "line 3" in error.field and "550 nm" in error.field


@pytest.mark.parametrize("cell", ["", "green", "nan"])
def test_a_column_table_without_a_number_names_line_and_column(tmp_path, cell):
    rows = [[w, 0.1, 0.2, 0.3] for w in GRID]
    rows[4][2] = cell
    error = refusal(read_spectra, columns(tmp_path / "camera.csv", rows))
    assert error.file.endswith("camera.csv")
    assert "line 6" in error.field and re.search(r"\bg\b", error.field)


@pytest.mark.stability(stage="calibrate", case="missing wavelengths")
@pytest.mark.parametrize(("first", "last"), [(410, 720), (380, 690)])
def test_a_range_that_is_too_short_is_refused_and_not_extrapolated(tmp_path, first, last):
    grid = [w for w in GRID if first <= w <= last]
    error = refusal(read_spectra, wide(tmp_path / "short.csv", grid))
    assert error.file.endswith("short.csv") and error.field
    assert f"{first}..{last}" in error.found and "400..700" in error.accepted


@pytest.mark.stability(stage="calibrate", case="missing wavelengths")
def test_a_gap_is_refused_where_it_stands(tmp_path):
    grid = [w for w in GRID if not 500 < w < 540]
    error = refusal(read_spectra, wide(tmp_path / "gap.csv", grid))
    assert error.file.endswith("gap.csv") and error.field
    assert "40 nm after 500 nm" in error.found


@pytest.mark.stability(stage="environment", case="duplicate wavelengths")
@pytest.mark.parametrize("swap", [(500, 510), (500, 490)])
def test_wavelengths_that_do_not_increase_are_refused(tmp_path, swap):
    grid = [swap[1] if w == swap[0] else w for w in GRID]
    error = refusal(read_spectra, wide(tmp_path / "mixed.csv", grid))
    assert error.file.endswith("mixed.csv") and error.field
    assert "increas" in error.found


def test_a_header_that_is_no_wavelength_names_its_column(tmp_path):
    grid = [*GRID]
    grid[2] = "400nm"
    error = refusal(read_spectra, wide(tmp_path / "units.csv", grid))
    assert "units.csv" in str(error) and "4" in error.field and "400nm" in error.found


@pytest.mark.parametrize("change", [-1, 1])
def test_a_ragged_row_is_refused_with_both_counts(tmp_path, change):
    file = wide(tmp_path / "ragged.csv", rows=[["one", *[0.5] * (len(GRID) + change)]])
    error = refusal(read_spectra, file)
    assert error.file == str(file) and "line 2" in error.field
    assert str(len(GRID) + 1 + change) in error.found and str(len(GRID) + 1) in error.accepted


@pytest.mark.parametrize("content", [b"", b"name\n", b"name,400,700\n", b"\xff\xfe\x00\x01\n\x9f,1\n"])
def test_a_file_that_holds_no_table_is_refused_by_name(tmp_path, content):
    file = tmp_path / "broken.csv"
    file.write_bytes(content)
    assert refusal(read_spectra, file).file == str(file)


@pytest.mark.parametrize("values", [[1.0, np.nan], [np.inf, 1.0]])
def test_resampling_refuses_values_that_are_not_finite(values):
    wavelengths = np.linspace(400, 700, 31)
    error = refusal(resample, wavelengths, np.resize(values, 31), "made up")
    assert error.file == "made up"


def test_unknown_names_list_the_accepted_ones():
    error = refusal(spectrum, "D66")
    assert "D66" in error.found and "D65" in error.accepted and "TCS98" in error.accepted
    error = refusal(chart_spectra, "Macbeth")
    assert "Macbeth" in error.found and "BabelColor Average" in error.accepted
    error = refusal(camera_sensitivities, "Nikon")
    assert "Nikon" in error.found and "Nikon 5100 (NPL)" in error.accepted


def test_a_test_colour_beyond_the_last_is_refused_with_the_range():
    assert "TCS98" in refusal(spectrum, "TCS99").accepted


def test_one_spectrum_is_asked_for_and_two_are_refused(tmp_path):
    file = wide(tmp_path / "two.csv", rows=[["one", *[0.5] * len(GRID)], ["two", *[0.5] * len(GRID)]])
    assert refusal(spectrum, str(file)).file == str(file)


def test_a_camera_with_two_bands_is_refused(tmp_path):
    file = columns(tmp_path / "two.csv", [[w, 1, 1] for w in GRID], header="wavelength_nm,r,g")
    assert "2 bands" in refusal(camera_sensitivities, str(file)).found


def test_refractive_index_is_constant_or_from_a_file_and_never_unphysical(tmp_path):
    n, k = refractive_index(made(RefractiveIndex, {"n": 1.5, "k": 0.0}))
    assert (n == 1.5).all() and (k == 0.0).all() and n.shape == k.shape == (61,)
    file = columns(tmp_path / "gold.csv", [[w, w / 500, w / 200] for w in GRID], header="wavelength_nm,n,k")
    n, k = refractive_index(made(RefractiveIndex, {"file": str(file)}))
    assert n == pytest.approx(WAVELENGTH_NM / 500) and k == pytest.approx(WAVELENGTH_NM / 200)
    negative = columns(tmp_path / "bad.csv", [[w, 1.5, -0.1] for w in GRID], header="wavelength_nm,n,k")
    assert refusal(refractive_index, made(RefractiveIndex, {"file": str(negative)})).file == str(negative)
    swapped = columns(tmp_path / "swapped.csv", [[w, 1, 2] for w in GRID], header="wavelength_nm,k,n")
    assert refusal(refractive_index, made(RefractiveIndex, {"file": str(swapped)})).file == str(swapped)


# Published spectra


@pytest.mark.parametrize("name", ["D65", "A", "D50"])
def test_cie_illuminants_are_100_at_560_nm(name):
    assert spectrum(name)[WAVELENGTH_NM == 560.0] == pytest.approx(100.0, abs=5e-4)


def test_illuminant_a_is_plancks_law():
    # CIE 15: S_A(λ) = 100 (560/λ)^5 [exp(1.435e7 / (2848 × 560)) - 1] / [exp(1.435e7 / (2848 λ)) - 1]; six digits.
    planck = (
        100
        * (560 / WAVELENGTH_NM) ** 5
        * (math.exp(1.435e7 / (2848 * 560)) - 1)
        / (np.exp(1.435e7 / (2848 * WAVELENGTH_NM)) - 1)
    )
    assert spectrum("A") == pytest.approx(planck, rel=5e-5)


@pytest.mark.parametrize("name", ["TCS0", "TCS42", "TCS98"])
def test_measured_materials_reflect_between_nothing_and_everything(name):
    material = spectrum(name)
    assert material.shape == (61,) and (material > 0).all() and (material < 1).all()


def test_the_colour_checker_has_24_reflectances_and_its_greys_are_in_order():
    names, patches = chart_spectra("BabelColor Average")
    assert len(names) == 24 and patches.shape == (24, 61)
    assert (patches > 0).all() and (patches < 1).all()
    assert (np.diff(patches[18:].mean(axis=1)) < 0).all()
