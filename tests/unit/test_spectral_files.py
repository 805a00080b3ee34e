"""Files of spectra: what is written is read back, and a fault is refused with its place."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tm27_files import tm27

from irodori.core.errors import InputError
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import chart_spectra, light, read_spectra, spectrum
from irodori.spectra.spectral_files import SUFFIXES, filter_row, spectral_table

GRID = [float(w) for w in range(380, 731, 10)]
VALUES = st.lists(st.floats(0.0, 1.0), min_size=len(GRID), max_size=len(GRID))
SPECTRA = st.lists(VALUES, min_size=1, max_size=4)


def wide(spectra, grid=GRID, separator=","):
    lines = [["name", *grid], *([f"A{i + 1}", *row] for i, row in enumerate(spectra))]
    return "\n".join(separator.join(map(str, line)) for line in lines) + "\n"


def columns(spectra, grid=GRID):
    lines = [["wavelength_nm", *(f"A{i + 1}" for i in range(len(spectra)))], *zip(grid, *spectra, strict=True)]
    return "\n".join(",".join(map(str, line)) for line in lines) + "\n"


def long(spectra, grid=GRID):
    rows = [f"A{i + 1},{w},{v}" for i, row in enumerate(spectra) for w, v in zip(grid, row, strict=True)]
    return "\n".join(["sample,wavelength_nm,reflectance", *rows]) + "\n"


def ti3(spectra, grid=GRID, norm=100.0, keywords=True):
    head = ["CTI3   ", "", 'ORIGINATOR "a test"', "# a comment", f'SPECTRAL_NORM "{norm:f}"']
    if keywords:
        head += [f'SPECTRAL_BANDS "{len(grid)}"', f'SPECTRAL_START_NM "{grid[0]}"', f'SPECTRAL_END_NM "{grid[-1]}"']
    fields = ["SAMPLE_ID", "SAMPLE_LOC", "XYZ_X", *(f"SPEC_{w:03.0f}" for w in grid)]
    head += [f"NUMBER_OF_FIELDS {len(fields)}", "BEGIN_DATA_FORMAT", " ".join(fields), "END_DATA_FORMAT"]
    rows = [
        " ".join([str(100 - i), f'"A{i + 1}"', "9.5", *(repr(v * norm) for v in row)]) for i, row in enumerate(spectra)
    ]
    return "\n".join([*head, f"NUMBER_OF_SETS {len(rows)}", "BEGIN_DATA", *rows, "END_DATA"]) + "\n"


def spd(values, grid=GRID):
    return "# lamp\n\nwavelength power\n" + "".join(f"{w}\t{v}\n" for w, v in zip(grid, values, strict=True))


def write(folder, name, text):
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def refusal(call, *arguments):
    with pytest.raises(InputError) as caught:
        call(*arguments)
    return caught.value


# Round trips


@pytest.mark.parametrize(
    ("suffix", "writer"), [(".csv", wide), (".csv", columns), (".csv", long), (".ti3", ti3), (".txt", ti3)]
)
@given(spectra=SPECTRA)
@settings(max_examples=25)
def test_what_is_written_is_read_back(tmp_path_factory, suffix, writer, spectra):
    file = write(tmp_path_factory.mktemp("spectra"), "set" + suffix, writer(spectra))
    table = spectral_table(file)
    assert table.names == [f"A{i + 1}" for i in range(len(spectra))]
    assert table.wavelength_nm == pytest.approx(GRID, abs=1e-9)
    assert np.allclose(table.values, spectra, rtol=1e-12, atol=0)


@given(values=VALUES)
def test_the_text_of_a_light_is_read_back_and_is_power(tmp_path_factory, values):
    table = spectral_table(write(tmp_path_factory.mktemp("spectra"), "lamp.spd", spd(values)))
    assert (table.names, table.wavelength_nm, table.values) == (["lamp"], GRID, [values])
    assert table.is_power


@pytest.mark.parametrize("norm", [1.0, 100.0])
def test_the_scale_of_a_ti3_is_that_of_its_norm(tmp_path, norm):
    file = write(tmp_path, "set.ti3", ti3([[0.5] * len(GRID)], norm=norm))
    assert spectral_table(file).values[0] == pytest.approx([0.5] * len(GRID))
    assert chart_spectra(str(file))[1] == pytest.approx(np.full((1, 61), 0.5))


def test_wavelengths_of_a_ti3_are_exact_where_its_columns_are_rounded(tmp_path):
    grid = list(np.linspace(380.0, 730.0, 106))
    table = spectral_table(write(tmp_path, "set.ti3", ti3([[0.5] * len(grid)], grid)))
    assert table.wavelength_nm == pytest.approx(grid, abs=1e-9)


def test_a_sample_of_a_ti3_may_be_broken_over_lines(tmp_path):
    text = ti3([[0.25] * len(GRID), [0.5] * len(GRID)]).replace(" 25.0 25.0 ", " 25.0\n25.0 ")
    assert np.array(spectral_table(write(tmp_path, "set.ti3", text)).values)[:, 3] == pytest.approx([0.25, 0.5])


def test_argylls_sp_is_a_light(tmp_path):
    file = write(tmp_path, "lamp.sp", ti3([[2.0] * len(GRID)], norm=1.0).replace("CTI3", "SPECT"))
    assert spectral_table(file).is_power
    assert light(str(file)) == pytest.approx(np.full(61, 2.0))


def test_tm27_is_read_as_colour_science_reads_what_it_writes(tmp_path):
    import colour

    power = dict(zip(GRID, np.random.default_rng(1).random(len(GRID)), strict=True))
    path = str(tmp_path / "lamp.spdx")
    header = colour.io.Header_IESTM2714(description="a lamp", document_creator="a test", report_date="2026-01-01")
    colour.SpectralDistribution_IESTM2714(path, header, spectral_quantity="radiance", data=power).write()
    theirs = colour.SpectralDistribution_IESTM2714(path).read()
    table = spectral_table(path)
    assert table.wavelength_nm == list(theirs.wavelengths) and table.values[0] == pytest.approx(theirs.values)
    assert table.is_power and light(path).shape == (61,)


@pytest.mark.parametrize("change", ["bom", "crlf", "semicolons", "tabs", "decimal commas"])
def test_what_spreadsheets_do_to_a_table_does_no_harm(tmp_path, change):
    values = list(np.round(np.linspace(0.1, 0.8, len(GRID)), 4))
    text = wide([values], separator={"semicolons": ";", "tabs": "\t", "decimal commas": ";"}.get(change, ","))
    if change == "decimal commas":
        text = text.replace(".", ",")
    data = text.replace("\n", "\r\n" if change == "crlf" else "\n").encode("utf-8-sig" if change == "bom" else "utf-8")
    (tmp_path / "set.csv").write_bytes(data)
    assert spectral_table(tmp_path / "set.csv").values[0] == pytest.approx(values)


@pytest.mark.parametrize(
    "line", ["{w:g} {v:g}", "{w:g}\t{v:g}", "{w:g},{v:g}", "{w:g}, {v:g}", "{w:g};{v:g}", "  {w:g}   {v:e}  # as read"]
)
def test_the_text_of_a_light_may_be_separated_in_many_ways(tmp_path, line):
    values = np.linspace(0.5, 2.0, len(GRID))
    text = "\n".join(line.format(w=w, v=v) for w, v in zip(GRID, values, strict=True))
    table = spectral_table(write(tmp_path, "lamp.txt", "// lamp\n% of the rig\n" + text))
    assert table.values[0] == pytest.approx(values, rel=1e-5)


def test_the_text_of_a_light_may_have_decimal_commas(tmp_path):
    file = write(tmp_path, "lamp.spd", spd(np.linspace(0.5, 2.0, len(GRID))).replace(".", ","))
    assert spectral_table(file).values[0] == pytest.approx(np.linspace(0.5, 2.0, len(GRID)))


def test_rows_of_a_long_table_may_stand_in_any_order(tmp_path):
    spectra = np.random.default_rng(2).random((3, len(GRID))).tolist()
    header, *rows = long(spectra).splitlines()
    rows = sorted(rows, key=lambda row: (-float(row.split(",")[1]), row))
    table = spectral_table(write(tmp_path, "set.csv", "\n".join([header, *rows])))
    assert sorted(table.names) == ["A1", "A2", "A3"]
    assert np.allclose([table.values[table.names.index(f"A{i}")] for i in (1, 2, 3)], spectra)


def test_patches_of_a_chart_come_in_the_same_order_from_every_format(tmp_path):
    spectra = np.random.default_rng(3).random((4, len(GRID))).tolist()
    read = [
        chart_spectra(str(write(tmp_path, name, writer(spectra))))
        for name, writer in (("wide.csv", wide), ("long.csv", long), ("columns.csv", columns), ("set.ti3", ti3))
    ]
    for names, reflectance in read:
        assert names == ["A1", "A2", "A3", "A4"]
        assert reflectance == pytest.approx(read[0][1], abs=1e-12)


# Refusals

HALF = [0.5] * len(GRID)


@pytest.mark.parametrize("suffix", ["", ".xlsx", ".cvs", ".h5"])
def test_an_unknown_suffix_is_refused_with_the_accepted_ones(tmp_path, suffix):
    error = refusal(spectral_table, write(tmp_path, "set" + suffix, wide([HALF])))
    assert all(known in error.accepted for known in SUFFIXES)


@pytest.mark.parametrize(
    ("name", "text", "field", "found", "accepted"),
    [
        ("a.csv", "patch,red,green\nA1,0.1,0.2\n", "line 1", "patch, red, green", "wide"),
        ("a.csv", "", "line 1", "nothing", "wide"),
        ("a.csv", wide([HALF]).replace("A1,0.5", "A1,nan"), "line 2, 380 nm", "nan", "finite"),
        ("a.csv", wide([HALF], [*GRID[:5], GRID[4], *GRID[6:]]), "wavelength", "420 nm after 420 nm", "each once"),
        ("a.csv", wide([HALF], GRID[::-1]), "wavelength", "720 nm after 730 nm", "increasing"),
        ("a.csv", wide([HALF], separator=";").replace("0.5;", "0,5;"), "line 1", "'380.0'", "throughout"),
        ("a.csv", long([HALF, HALF]).replace("A2,500.0,0.5\n", ""), "A2", "no value at 500 nm", "every spectrum"),
        ("a.csv", long([HALF]) + "A1,500,0.5\n", "line 38", "A1 at 500 nm twice", "once"),
        ("a.csv", long([HALF]).replace("A1,500.0,0.5", "A1,500.0"), "line 14", "2 columns", "3 columns"),
        ("a.csv", long([HALF]).replace("A1,500.0,0.5", "A1,500.0,"), "line 14, 500 nm", "nothing", "finite"),
        ("a.csv", long([HALF], [*GRID[:8], *(w + 30 for w in GRID[8:])]), "wavelength", "40 nm after 450", "20 nm"),
        ("a.spd", "380 1\n390 1 2\n", "line 2", "3 columns", "two columns"),
        ("a.spd", spd(HALF).replace("500.0\t0.5", "500.0\tinf"), "line 16, 500 nm", "'inf'", "finite"),
        ("a.spd", spd(HALF[3:], GRID[3:]), "wavelength", "410..730 nm", "400..700"),
        ("a.spd", spd(HALF, [w / 1000 for w in GRID]), "wavelength", "0.38..0.73 nm", "400..700"),
        ("a.spd", "# nothing\n", "", "no numbers", "two columns"),
        ("a.spd", spd(HALF).replace("500.0\t0.5", "500.0\t0,5"), "line 4", "'380.0'", "throughout"),
        ("a.ti3", wide([HALF]), "", "no BEGIN_DATA", "whole"),
        ("a.ti3", ti3([HALF]).replace("END_DATA\n", ""), "", "no END_DATA", "whole"),
        ("a.ti3", ti3([HALF]).replace("SPEC_", "LAB_"), "BEGIN_DATA_FORMAT", "0 tables", "SPEC_400"),
        ("a.ti3", ti3([HALF]) * 2, "BEGIN_DATA_FORMAT", "2 tables", "one table"),
        ("a.ti3", ti3([HALF]).replace('S "36"', 'S "35"'), "SPECTRAL_BANDS", "35 bands for 36 columns", "a band"),
        ("a.ti3", ti3([HALF]).replace("START_NM", "STARTS"), "SPECTRAL_BANDS", "only SPECTRAL_BANDS", "or none"),
        ("a.ti3", ti3([HALF]).replace('"380.0"', '"390.0"'), "SPECTRAL_START_NM", "380 nm where", "of the keywords"),
        ("a.ti3", ti3([HALF]).replace("100.000000", "0"), "SPECTRAL_NORM", "0", "above 0"),
        ("a.ti3", ti3([HALF]).replace("SETS 1", "SETS 2"), "BEGIN_DATA", "1 sample where", "as many"),
        ("a.ti3", ti3([HALF]).replace("9.5 50.0", "9.5"), "line 15", "38 values", "39 values"),
        ("a.ti3", ti3([HALF]).replace("9.5 50.0", "9.5 -"), "line 15, 380 nm", "'-'", "finite"),
        ("a.csv", wide([HALF]).replace("A1,0.5", "A1,1_0.5"), "line 2, 380 nm", "'1_0.5'", "finite"),
        ("a.csv", columns([HALF]).replace("400.0,", "4_00.0,"), "line 4, wavelength_nm", "'4_00.0'", "finite"),
        ("a.spd", spd(HALF).replace("500.0\t0.5", "500.0\t0_5"), "line 16, 500 nm", "'0_5'", "finite"),
        ("a.ti3", ti3([HALF]).replace("100.000000", "1_00"), "line 5, SPECTRAL_NORM", "'1_00'", "finite"),
        ("a.csv", columns([HALF, HALF]).replace("A2", "A1"), "", "two spectra of the name 'A1'", "once"),
        ("a.csv", wide([HALF, HALF]).replace("A2", " A1 "), "", "two spectra of the name 'A1'", "once"),
        ("a.ti3", ti3([HALF, HALF]).replace("A2", "A1"), "", "two spectra of the name 'A1'", "once"),
        ("a.spdx", "<a>", "", "broken XML", "TM-27"),
        ("a.spdx", "<a/>", "", "'a'", "TM-27"),
    ],
)  # fmt: skip
def test_a_fault_is_refused_with_its_place(tmp_path, name, text, field, found, accepted):
    error = refusal(spectral_table, write(tmp_path, name, text))
    assert error.file == str(tmp_path / name)
    assert error.field == field
    assert found in error.found
    assert accepted in error.accepted


@pytest.mark.parametrize(("quantity", "is_light", "is_reflectance"), [
    ("flux", True, False), ("irradiance", True, False), ("Spectral Radiance", True, False), ("relative", True, False),
    ("intensity", True, False), ("exitance", True, False), ("", True, True), ("reflectance", False, True),
    ("R-Factor", False, True), ("transmittance", False, True), ("spectral transmittance", False, True),
    ("absorptance", False, False), ("photonflux", False, False), ("photon irradiance", False, False),
    ("luminous flux", False, False), ("other", False, False),
])  # fmt: skip
def test_a_file_that_states_its_quantity_is_used_for_no_other(tmp_path, quantity, is_light, is_reflectance):
    path = str(write(tmp_path, "a.spdx", tm27(quantity)))
    for reader, accepted, said in ((light, is_light, "power of a light"), (chart_spectra, is_reflectance, "reflect")):
        if accepted:
            reader(path)
        else:
            error = refusal(reader, path)
            assert error.field == "SpectralQuantity" and error.found == quantity and said in error.accepted
    table = spectral_table(path)
    if "transmittance" in quantity or not quantity:
        assert filter_row(table, None, path) == table.values[0]
    else:
        assert refusal(filter_row, table, None, path).accepted == "transmittance"


def test_a_test_colour_is_no_light():
    assert "TCS3" in str(refusal(light, "TCS3")) and spectrum("TCS3").shape == (61,)


@pytest.mark.parametrize("value", [-0.02, 1.21, 50.0])
@pytest.mark.parametrize(("name", "writer"), [("a.csv", wide), ("a.csv", long), ("a.ti3", ti3)])
def test_a_reflectance_that_cannot_be_is_refused(tmp_path, name, writer, value):
    values = [*HALF[:12], value, *HALF[13:]]
    error = refusal(chart_spectra, str(write(tmp_path, name, writer([HALF, values]))))
    assert error.field == "A2, 500 nm"
    assert f"{value:g}" in error.found and "not percent" in error.accepted


@pytest.mark.parametrize(("values", "found"), [([0.0] * 36, "no power"), ([*HALF[:5], -0.1, *HALF[6:]], "-0.1")])
def test_a_light_that_cannot_be_is_refused(tmp_path, values, found):
    assert found in refusal(light, str(write(tmp_path, "lamp.spd", spd(values)))).found


@given(data=st.binary(max_size=300))
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_no_content_makes_a_reader_fail_otherwise_than_by_a_refusal(tmp_path_factory, suffix, data):
    file = tmp_path_factory.mktemp("spectra") / f"noise{suffix}"
    file.write_bytes(data)
    refusal(spectral_table, file)


@given(text=st.text(alphabet='019.,;"#\t\n e-ABEGIN_DATAFORMSPC', max_size=200))
@pytest.mark.parametrize("suffix", [".csv", ".txt", ".ti3", ".spd"])
def test_no_text_makes_a_reader_fail_otherwise_than_by_a_refusal(tmp_path_factory, suffix, text):
    refusal(spectral_table, write(tmp_path_factory.mktemp("spectra"), f"noise{suffix}", text))


def test_the_readers_load_no_heavy_module():
    code = (
        "import sys, irodori.spectra.spectral_files, irodori.config.cross_checks.named_spectra;"
        "print([m for m in ('numpy', 'colour', 'h5py', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# Lights by name


def test_daylight_of_6504_kelvin_is_d65_and_a_blackbody_of_2856_is_a():
    # D65 is tabulated to six digits from the same components; A is defined with another constant, 2856 K being 2855.5.
    assert spectrum("D6504") == pytest.approx(spectrum("D65"), abs=0.06)
    assert spectrum("P2856") == pytest.approx(spectrum("A"), rel=1e-3)


@pytest.mark.parametrize("temperature_k", [1000, 3200, 20000])
def test_a_blackbody_follows_planck(temperature_k):
    planck = WAVELENGTH_NM**-5.0 / np.expm1(1.4388e7 / (WAVELENGTH_NM * temperature_k))
    at_560 = 560.0**-5.0 / np.expm1(1.4388e7 / (560.0 * temperature_k))
    assert spectrum(f"P{temperature_k}") == pytest.approx(100.0 * planck / at_560, rel=1e-9)


@pytest.mark.parametrize("name", ["D3999", "D25001", "P999", "P20001", "D65000", "daylight"])
def test_a_light_out_of_range_is_refused_with_what_is_accepted(name):
    error = refusal(light, name)
    for word in ("D4000 to D25000", "P1000 to P20000", "LED-B3", "a file"):
        assert word in error.accepted


def test_a_line_of_a_lamp_keeps_its_power_wherever_it_falls(tmp_path):
    grid = np.arange(390.0, 711.0)
    for centre in (500.0, 501.0, 502.5, 504.0):
        line = np.exp(-0.5 * ((grid - centre) / 0.85) ** 2)
        file = write(tmp_path, "lamp.csv", wide([(0.01 + line).tolist()], grid.tolist()))
        averaged = light(str(file))
        assert averaged.sum() * 5.0 == pytest.approx(0.01 * 61 * 5.0 + line.sum(), rel=1e-6)
        # Interpolation, right for a reflectance, gives the line anything from nothing to more than twice its power.
        assert read_spectra(file)[1].sum() * 5.0 != pytest.approx(averaged.sum() * 5.0, rel=0.05)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("lamp.csv", "Wavelength [nm],Photon flux [umol]\n"),
        ("lamp.csv", "wavelength_nm;spectral_photon_flux\n"),
        ("lamp.csv", "nm,µmol m-2 s-1\n"),
        ("lamp.spd", "# photon flux\n"),
        ("lamp.spd", "# PhotonFlux\n"),
        ("lamp.txt", "; quanta per second\nwavelength value\n"),
        ("lamp.txt", "380 1 # quantum flux\n"),
    ],
)
def test_numbers_of_photons_are_no_power(tmp_path, name, words):
    separator = ";" if ";" in words and name.endswith("csv") else "," if name.endswith("csv") else " "
    rows = "".join(f"{w}{separator}1.5\n" for w in GRID if not words.startswith("380") or w > 380)
    error = refusal(light, str(write(tmp_path, name, words + rows)))
    assert error.field.startswith("line 1") and "divided by the wavelength" in error.accepted


@pytest.mark.parametrize("words", ["# Hamamatsu Photonics\n", "# quantity: power\n", "# photonic crystal, 3 mol\n"])
def test_a_firm_of_photonics_measures_power(tmp_path, words):
    assert light(str(write(tmp_path, "photons.spd", words + spd([1.5] * len(GRID))))).min() > 0.0
