"""A white reference whose reflectance varies with the wavelength."""

from pathlib import Path

import numpy as np
import pytest
from definitions import CAMERA_FILE, edit, fault, load
from hypothesis import given
from hypothesis import strategies as st
from made import made
from raw_studio import CAMERA, PROVENANCE, SUPERPIXELS, Studio

from irodori.config.capture_table import Pose
from irodori.config.models import Camera, Rig
from irodori.core import store
from irodori.core.errors import InputError
from irodori.ingest.camera_reference import ingest_reference
from irodori.simulation.virtual_rig.subjects import white_mosaic
from irodori.spectra.grid import TRAPEZOID_NM
from irodori.spectra.published import camera_sensitivities, spectrum
from irodori.spectra.white_reference import white_reflectance

GRID = range(380, 731, 10)
WEIGHTS = camera_sensitivities("Nikon 5100 (NPL)") * spectrum("A") * TRAPEZOID_NM


def tile(folder, values):
    lines = ["wavelength_nm,tile", *(f"{w},{v}" for w, v in zip(GRID, values, strict=True))]
    file = folder / "tile.csv"
    file.write_text("\n".join(lines))
    return str(file)


@given(factor=st.floats(0.01, 1.2))
def test_a_number_is_the_factor_of_every_band_and_certain(factor):
    assert white_reflectance(factor) == (factor, 0.0)
    assert white_reflectance(factor, WEIGHTS)[0] == pytest.approx(np.full(3, factor))


def test_a_flat_spectrum_is_as_good_as_its_number(tmp_path):
    file = tile(tmp_path, [0.97] * 36)
    for weights in (None, WEIGHTS):
        factor, uncertainty = white_reflectance(file, weights)
        assert factor == pytest.approx(0.97) and uncertainty == pytest.approx(0.0, abs=1e-12)


def test_with_sensitivities_a_white_divided_by_its_factor_is_a_perfect_diffuser(tmp_path):
    file = tile(tmp_path, np.linspace(0.80, 0.98, 36))
    factor, uncertainty = white_reflectance(file, WEIGHTS)
    assert WEIGHTS @ spectrum(file) / factor == pytest.approx(WEIGHTS.sum(axis=1))
    assert factor[0] > factor[1] > factor[2] and uncertainty == 0.0


def test_without_sensitivities_every_band_lies_within_the_stated_uncertainty(tmp_path):
    file = tile(tmp_path, np.linspace(0.80, 0.98, 36))
    factor, uncertainty = white_reflectance(file)
    # A ramp of ±b/2 about its mean has a standard deviation of b / √12.
    ramp = 0.18 * 300 / 350
    assert factor == pytest.approx(0.80 + 0.18 * 170 / 350, rel=1e-9)
    assert uncertainty == pytest.approx(ramp / np.sqrt(12.0) / factor, rel=1e-3)
    bands, _ = white_reflectance(file, WEIGHTS)
    assert np.abs(bands / factor - 1.0).max() < 2.0 * uncertainty


@pytest.mark.parametrize("value", [0.0, -0.005, 1.3, 97.0])
def test_what_is_no_white_is_refused(tmp_path, value):
    file = tile(tmp_path, [0.9] * 10 + [value] + [0.9] * 25)
    with pytest.raises(InputError) as caught:
        white_reflectance(file)
    assert caught.value.file == file and "not percent" in caught.value.accepted


def test_a_configuration_may_name_the_file_of_the_tile(root):
    tile(root, [0.97] * 36)
    edit(root, CAMERA_FILE, "white.reflectance_factor", "tile.csv")
    load(root)


@pytest.mark.parametrize(
    ("value", "accepted"), [(0, "above 0"), (1.3, "1.2"), ("tile.csv", "path of a file"), ("white", "TCS0 to TCS98")]
)
def test_a_configuration_with_another_white_is_refused(root, value, accepted):
    edit(root, CAMERA_FILE, "white.reflectance_factor", value)
    error = fault(root)
    assert (Path(error.file).name, error.field) == (Path(CAMERA_FILE).name, "white.reflectance_factor")
    assert accepted in error.accepted


def test_the_reference_of_a_camera_takes_the_mean_of_the_tiles_spectrum_and_states_its_spread(tmp_path):
    studio = Studio(tmp_path, 1)
    studio.references()
    table, file = studio.table(), tile(tmp_path, np.linspace(0.80, 0.98, 36))
    factor, uncertainty = white_reflectance(file)
    white = []
    for name, definition in (("file", file), ("number", float(factor))):
        ingest_reference(table, tmp_path, tmp_path / f"{name}.h5", PROVENANCE, definition, SUPERPIXELS)
        with store.open_file(tmp_path / f"{name}.h5") as stored:
            white.append(stored.read("white"))
            assert stored.attribute("white_factor") == pytest.approx(factor)
            stated = stored.attribute("white_factor_uncertainty")
            assert stated == pytest.approx(uncertainty if name == "file" else 0.0)
    assert np.array_equal(*white)


def test_the_virtual_rig_photographs_the_tiles_spectrum(tmp_path):
    file = tile(tmp_path, np.linspace(0.80, 0.98, 36))
    pose = Pose(40.0, 0.0)
    rig = {"light": {"spectrum": "A"}, "camera_distance_mm": 900.0}
    mosaic = white_mosaic(
        made(Camera, CAMERA | {"white": {"reflectance_factor": file}}), made(Rig, rig), pose, np.eye(2, 3), WEIGHTS
    )
    expected = WEIGHTS @ spectrum(file) * np.cos(np.radians(40.0))
    assert sorted(set(mosaic.ravel())) == pytest.approx(sorted(expected))
