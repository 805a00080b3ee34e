"""Spectra: published names and the tables of a user."""

import sys
from pathlib import Path
from subprocess import run

import h5py
import numpy as np
import pytest
from definitions import CAMERA_FILE, PLATE_FILE, ROOM_FILE, ROOT, edit, fault, load

from irodori.core.errors import InputError
from irodori.spectra import published_names
from irodori.spectra.published import spectrum
from irodori.spectra.published_tables import TABLES, published_matrix, published_table

DATA = ROOT.parent / "shared" / "data"
POSE = "l0450-c0000-t000-r0000"


# ---- spectra


@pytest.mark.parametrize(
    ("file", "path", "value", "field", "accepted"),
    [
        ("rigs/virtual.yaml", "light.spectrum", "D56", "light.spectrum", "'D55'"),
        ("rigs/virtual.yaml", "light.spectrum", "d65", "light.spectrum", "did you mean 'D65'"),
        ("rigs/virtual.yaml", "light.spectrum", "TCS4", "light.spectrum", "the illuminants A, B, C"),
        ("config.yaml", "report.lights", ["D65", "LEDB3"], "report.lights[1]", "did you mean 'LED-B3'"),
        (ROOM_FILE, "virtual.ambient_light", "daylight", "virtual.ambient_light", "or the path of a file"),
        (ROOM_FILE, "virtual.window.spectrum", "D 65", "virtual.window.spectrum", "'D65'"),
        (ROOM_FILE, "virtual.lamps.spectrum", "FL13", "virtual.lamps.spectrum", "'FL3.13'"),
        (ROOM_FILE, "virtual.surfaces.walls.spectrum", "D65", "virtual.surfaces.walls.spectrum", "TCS0 to TCS98"),
        (PLATE_FILE, "virtual.materials.2.spectrum", "TCS99", "virtual.materials[2].spectrum", "TCS0 to TCS98"),
        (PLATE_FILE, "virtual.materials.2.spectrum", "TSC9", "virtual.materials[2].spectrum", "'TCS9'"),
        (CAMERA_FILE, "chart.spectra", "Babelcolor", "chart.spectra", "did you mean 'BabelColor Average'"),
        (CAMERA_FILE, "virtual.sensitivities", "Nikon D5100", "virtual.sensitivities", "'Nikon 5100 (NPL)'"),
    ],
)  # fmt: skip
def test_a_name_of_no_spectrum_is_refused_with_the_nearest(root, file, path, value, field, accepted):
    edit(root, file, path, value)
    error = fault(root)
    assert (Path(error.file).name, error.field) == (Path(file).name, field)
    assert repr(value if isinstance(value, str) else value[-1]) == error.found
    assert accepted in error.accepted


def wide(root: Path, *rows: float) -> None:
    header = "name," + ",".join(map(str, range(400, 701, 10)))
    (root / "wide.csv").write_text("\n".join([header, *(f"p{i}" + f",{v}" * 31 for i, v in enumerate(rows))]))


LAMP, PAINT, CHART = (
    ("rigs/virtual.yaml", "light.spectrum"),
    (PLATE_FILE, "virtual.materials.0.spectrum"),
    (CAMERA_FILE, "chart.spectra"),
)


@pytest.mark.parametrize(
    ("where", "rows", "field", "found", "accepted"),
    [
        (LAMP, [140.0], None, "", ""),
        (LAMP, [140.0, 1.0], "", "2 spectra", "one spectrum"),
        (PAINT, [0.5, 0.5], "", "2 spectra", "one spectrum"),
        (PAINT, [50.0], "p0, 400 nm", "50, as if the table were in percent", "from -0.01 to 1.2"),
        (CHART, [-0.01, 1.2] * 12, None, "", ""),
        (CHART, [0.5] * 23 + [1.3], "p23, 400 nm", "1.3", "where 1 is a perfect diffuser"),
        (CHART, [0.5] * 23 + [-0.02], "p23, 400 nm", "-0.02", "from -0.01 to 1.2"),
        (CHART, [3.0] + [90.0] * 23, "p0, 400 nm", "percent", "not percent"),
        (CHART, [0.5] * 23, "chart.rows", "4 rows of 6 patches, 24 in all", "make 23 patches, as in wide.csv"),
    ],
)  # fmt: skip
def test_a_table_of_spectra_holds_what_its_key_asks_for(root, where, rows, field, found, accepted):
    wide(root, *rows)
    edit(root, *where, "wide.csv")
    if field is None:
        load(root)
        return
    error = fault(root)
    assert Path(error.file).name == (Path(where[0]).name if field == "chart.rows" else "wide.csv")
    assert error.field == field
    assert found in error.found
    assert accepted in error.accepted


@pytest.mark.parametrize(
    ("header", "good"),
    [("r,g,b", True), ("Red,Green,BLUE", True), ("b,g,r", False), ("r,g", False), ("r,g,b,ir", False)],
)  # fmt: skip
def test_sensitivities_stand_in_the_order_red_green_blue(root, header, good):
    columns = len(header.split(","))
    lines = [f"wavelength_nm,{header}", *(f"{at}" + ",0.5" * columns for at in range(400, 701, 10))]
    (root / "rgb.csv").write_text("\n".join(lines))
    edit(root, CAMERA_FILE, "virtual.sensitivities", "rgb.csv")
    if good:
        load(root)
    else:
        error = fault(root)
        assert (Path(error.file).name, error.field) == ("rgb.csv", "line 1")
        assert "wavelength_nm, r, g, b in this order" in error.accepted


def test_a_file_of_spectra_without_a_suffix(root):
    wide(root, 0.5)
    (root / "wide.csv").rename(root / "wide")
    edit(root, *PAINT, "wide")
    assert "ends in .csv" in fault(root).accepted


def test_the_patches_of_a_published_chart_are_counted(root):
    edit(root, CAMERA_FILE, "chart.spectra", "PMC")
    error = fault(root)
    assert (error.field, error.accepted) == ("chart.rows", "rows and columns that make 30 patches, as in PMC")


def test_published_tables_are_those_of_colour_science():
    from irodori.spectra.write_published_tables import library_matrices, library_tables

    for name, table in library_tables():
        shipped = published_table(name)
        assert shipped.names == table.names
        np.testing.assert_array_equal(shipped.wavelength_nm, table.wavelength_nm)
        np.testing.assert_array_equal(shipped.spectra, table.spectra)
    for name, matrix in library_matrices():
        np.testing.assert_array_equal(published_matrix(name), matrix)


@pytest.mark.heavy
def test_published_tables_name_their_axes_to_any_reader():
    xarray = pytest.importorskip("xarray")
    groups: set[str] = set()
    with h5py.File(TABLES) as file:
        file.visititems(lambda name, item: groups.add(item.parent.name) if isinstance(item, h5py.Dataset) else None)
    assert len(groups) > 70
    for group in groups:
        with xarray.open_dataset(TABLES, group=group, engine="h5netcdf") as found:
            assert {"wavelength", "spectrum"} <= set(found.coords) or {"tristimulus", "seen"} & set(found.coords), group
            assert set(found.dims) == set(found.coords)
            assert all(values.attrs["quantity"] and values.attrs["units"] == "1" for values in found.values()), group
            if "wavelength" in found:
                assert found.wavelength.attrs["units"] == "nm"


def test_a_job_that_needs_published_spectra_does_not_import_colour_science():
    use = """
import sys
from irodori.colour.colorimetry import delta_e_reflectance
from irodori.colour.display import standard_display
from irodori.viewer import colours
from irodori.spectra.published import camera_sensitivities, chart_spectra, spectrum
delta_e_reflectance(chart_spectra("PMC")[1], spectrum("TCS3"))
camera_sensitivities("Nikon 5100 (NPL)")
standard_display("Display P3")
colours.observers(), colours.daylight(), colours.displays(), colours.deficiencies()
standard_display("sRGB").linear_rgb(spectrum("D65")[:3], spectrum("A")[:3])
print("colour" in sys.modules)
"""
    assert run([sys.executable, "-c", use], capture_output=True, text=True, check=True).stdout == "False\n"


def test_published_names_are_those_of_colour_science():
    import colour
    from colour.characterisation import SDS_COLOURCHECKERS

    assert sorted(published_names.ILLUMINANTS) == sorted(colour.SDS_ILLUMINANTS)
    assert {name: len(chart) for name, chart in SDS_COLOURCHECKERS.items()} == published_names.CHART_PATCHES
    assert sorted(published_names.CAMERAS) == sorted(colour.MSDS_CAMERA_SENSITIVITIES)
    for name in (*published_names.ILLUMINANTS, published_names.TEST_COLOURS[0], published_names.TEST_COLOURS[-1]):
        assert spectrum(name).shape == (61,)
    with pytest.raises(InputError, match="TCS0 to TCS98"):
        spectrum(f"TCS{len(published_names.TEST_COLOURS)}")
