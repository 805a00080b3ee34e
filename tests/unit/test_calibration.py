"""Equations (2) to (4): exact recovery in the basis, the printed formulas, refusals, and one real photograph."""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from shortcuts import leave_one_out, read_patches

from irodori.calibration.chart import patch_centres
from irodori.calibration.paper_estimator import calibrate, spectral_basis
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.calibration.stage import calibrate_camera
from irodori.colour.colorimetry import spectral_rmse
from irodori.config.models import Camera, Chart
from irodori.config.parts import CalibratedCamera
from irodori.core import store
from irodori.core.errors import InputError
from irodori.ingest.mosaic import decode
from irodori.spectra.published import chart_spectra, spectrum

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
LIGHT = np.linspace(0.5, 1.5, 61)


def smooth_spectra(count: int, rank: int, rng) -> np.ndarray:
    """Positive spectra of exactly this rank: mixtures of overlapping bumps."""
    centres = np.linspace(0, 60, rank)
    bumps = np.exp(-(((np.arange(61) - centres[:, None]) / 12.0) ** 2))
    return rng.uniform(0.05, 0.9, (count, rank)) @ bumps


def camera(bands: int, rng) -> np.ndarray:
    """Sensitivities times light, (bands, 61)."""
    centres = np.linspace(8, 52, bands)
    return np.exp(-(((np.arange(61) - centres[:, None]) / rng.uniform(6, 12, (bands, 1))) ** 2)) * LIGHT / 20.0


@given(seed=st.integers(0, 2**32 - 1), bands=st.sampled_from([3, 6]), patches=st.integers(8, 40))
@settings(deadline=None, max_examples=60)
def test_spectra_in_the_basis_are_recovered_exactly(seed, bands, patches):
    rng = np.random.default_rng(seed)
    chart, unseen = np.split(smooth_spectra(patches + 5, bands, rng), [patches])
    sensitivity = camera(bands, rng)
    solved = calibrate(chart @ sensitivity.T, chart, bands, LIGHT)
    assert solved.weights_from_response.shape == (bands, bands)
    assert solved.basis.shape == (61, bands)
    assert np.abs(solved.spectra(chart @ sensitivity.T) - chart).max() <= 1e-8
    assert np.abs(solved.spectra(unseen @ sensitivity.T) - unseen).max() <= 1e-8


@pytest.mark.parametrize(("bands", "bases"), [(3, 3), (6, 6), (6, 3), (3, 8), (6, 10)])
def test_matrix_is_the_printed_formula(bands, bases):
    rng = np.random.default_rng(1)
    chart = rng.uniform(0.0, 1.0, (24, 61))
    response = chart @ camera(bands, rng).T + 0.001 * rng.normal(size=(24, bands))
    solved = calibrate(response, chart, bases, LIGHT)
    # Principal vectors by the eigenvectors of Λᵀ Λ, pseudo-inverses by the normal equations.
    values, vectors = np.linalg.eigh(chart.T @ chart)
    basis = vectors[:, np.argsort(values)[::-1][:bases]]
    weights = np.linalg.inv(basis.T @ basis) @ basis.T @ chart.T
    matrix = np.linalg.inv(response.T @ response) @ response.T @ weights.T
    assert solved.weights_from_response.shape == (bands, bases)
    assert np.allclose(solved.basis @ solved.basis.T, basis @ basis.T, atol=1e-9)
    probe = rng.uniform(0.0, 0.2, (2, 7, bands))
    assert np.allclose(solved.spectra(probe), probe @ matrix @ basis.T, rtol=1e-7, atol=1e-9)
    assert solved.spectra(probe).shape == (2, 7, 61)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 24))
@settings(deadline=None, max_examples=50)
def test_basis_is_orthonormal_and_best(seed, count):
    rng = np.random.default_rng(seed)
    chart = rng.uniform(0.0, 1.0, (24, 61))
    basis = spectral_basis(chart, count)
    assert np.abs(basis.T @ basis - np.eye(count)).max() <= 1e-12
    assert (basis.sum(axis=0) >= 0).all()
    # Eckart and Young: the residual is the energy of the singular values left out; no other basis does better.
    left = np.linalg.norm(chart - chart @ basis @ basis.T)
    values = np.linalg.svd(chart, compute_uv=False)
    assert left == pytest.approx(np.sqrt(np.sum(values[count:] ** 2)), rel=1e-9, abs=1e-9)


@pytest.mark.stability(stage="calibrate", case="responses scaled by 1e-6..1e6")
@given(seed=st.integers(0, 2**32 - 1), exponents=st.lists(st.floats(-6, 6), min_size=6, max_size=6))
@settings(deadline=None, max_examples=60)
@pytest.mark.heavy
def test_units_of_the_bands_do_not_matter(seed, exponents):
    rng = np.random.default_rng(seed)
    chart = smooth_spectra(24, 9, rng)
    response = chart @ camera(6, rng).T
    gain = 10.0 ** np.array(exponents)
    plain, scaled = calibrate(response, chart, 6, LIGHT), calibrate(response * gain, chart, 6, LIGHT)
    assert np.abs(scaled.spectra(response * gain) - plain.spectra(response)).max() <= 1e-7
    assert np.abs(
        leave_one_out(response * gain, chart, 6, LIGHT) - leave_one_out(response, chart, 6, LIGHT)
    ).max() <= 1e-6  # fmt: skip


def faulty(fault: str) -> np.ndarray:
    rng = np.random.default_rng(2)
    response = smooth_spectra(24, 9, rng) @ camera(6, rng).T
    if fault == "few patches":
        return response[:5]
    if fault == "dead band":
        response[:, 4] = 0.0
    elif fault == "identical bands":
        response[:, 4] = response[:, 1]
    elif fault == "proportional bands":
        response[:, 4] = 1e-3 * response[:, 1]
    elif fault == "grey chart":
        response[:] = response[:, :1]
    elif fault == "black chart":
        response[:] = 0.0
    else:
        response[7, 2] = float(fault)
    return response


FAULTS = ["few patches", "dead band", "identical bands", "proportional bands", "grey chart", "black chart",
          "nan", "inf", "-inf"]  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_charts_that_do_not_determine_the_matrix_are_refused(fault):
    response = faulty(fault)
    chart = smooth_spectra(len(response), 9, np.random.default_rng(2))
    with pytest.raises(ValueError, match="accepted"):
        calibrate(response, chart, min(6, len(response)), LIGHT)


@pytest.mark.parametrize("bases", [0, 25, 62])
def test_impossible_numbers_of_bases_are_refused(bases):
    with pytest.raises(ValueError, match="accepted"):
        spectral_basis(np.ones((24, 61)), bases)


def test_leave_one_out_leaves_the_patch_out():
    rng = np.random.default_rng(3)
    chart = smooth_spectra(24, 9, rng)
    response = chart @ camera(6, rng).T
    clean = leave_one_out(response, chart, 6, LIGHT)
    spoiled = chart.copy()
    spoiled[5] = rng.uniform(0, 1, 61)
    other = leave_one_out(response, spoiled, 6, LIGHT)
    # What patch 5 is said to be has no say in its own prediction, and a say in all the others.
    assert np.allclose(other[5], clean[5], atol=1e-12)
    assert (np.abs(np.delete(other - clean, 5, axis=0)).max(axis=1) > 1e-6).all()
    for patch in (0, 23):
        others = np.arange(24) != patch
        expected = calibrate(response[others], chart[others], 6, LIGHT).spectra(response[patch])
        assert np.array_equal(clean[patch], expected)


def test_leave_one_out_errors_are_above_the_errors_of_the_fit():
    rng = np.random.default_rng(4)
    chart = smooth_spectra(24, 12, rng)
    response = chart @ camera(6, rng).T + 0.002 * rng.normal(size=(24, 6))
    inside = np.linalg.norm(calibrate(response, chart, 6, LIGHT).spectra(response) - chart)
    assert np.linalg.norm(leave_one_out(response, chart, 6, LIGHT) - chart) > inside


@given(
    corners=st.lists(st.floats(-0.2, 0.2), min_size=8, max_size=8),
    rows=st.integers(2, 10),
    columns=st.integers(2, 14),
    size=st.floats(10, 2000),
)
@settings(deadline=None, max_examples=100)
def test_patch_centres_follow_perspective(corners, rows, columns, size):
    # A camera looks at a flat chart: any homography of the grid that keeps it in front of the camera.
    h = np.array([[1.0, corners[0], 3.0], [corners[1], 1.0, 2.0], [corners[2] / columns, corners[3] / rows, 1.0]])
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    homogeneous = np.stack([column, row, np.ones_like(row)], axis=-1) @ h.T
    truth = size * homogeneous[..., :2] / homogeneous[..., 2:]
    names = {"first": truth[0, 0], "row_end": truth[0, -1], "column_end": truth[-1, 0], "last": truth[-1, -1]}
    chart = {"rows": rows, "columns": columns, "centres_px": {k: v.tolist() for k, v in names.items()}}
    assert np.allclose(patch_centres(made(Chart, chart)), truth.reshape(-1, 2), atol=1e-7 * size * max(rows, columns))


CHART = {
    "rows": 2, "columns": 3, "patch_px": 6,
    "centres_px": {"first": [10, 10], "row_end": [50, 10], "column_end": [10, 30], "last": [50, 30]},
}  # fmt: skip


def chart_picture(rng):
    values = rng.uniform(0.1, 0.9, (6, 3))
    picture = np.full((40, 60, 3), 0.02)
    for value, (x, y) in zip(values, [(10, 10), (30, 10), (50, 10), (10, 30), (30, 30), (50, 30)], strict=True):
        picture[y - 5 : y + 5, x - 5 : x + 5] = value
    return picture, values


def test_patches_are_read_row_by_row_and_specks_are_trimmed():
    picture, values = chart_picture(np.random.default_rng(5))
    valid = np.ones(picture.shape[:2], dtype=np.uint8)
    assert np.allclose(read_patches(picture, valid, made(Chart, CHART), "x.h5").mean, values, rtol=1e-12)
    picture[9, 11] = 50.0  # dust that glitters, one pixel of 36
    assert np.allclose(read_patches(picture, valid, made(Chart, CHART), "x.h5").mean, values, rtol=1e-12)


def test_saturated_pixels_of_a_patch_are_left_out():
    picture, values = chart_picture(np.random.default_rng(6))
    valid = np.ones(picture.shape[:2], dtype=np.uint8)
    picture[7:10, 7:13], valid[7:10, 7:13] = 1e3, 0  # the upper half of the first patch, no more
    assert np.allclose(read_patches(picture, valid, made(Chart, CHART), "x.h5").mean, values, rtol=1e-12)


def test_a_saturated_patch_is_named():
    picture, _ = chart_picture(np.random.default_rng(7))
    valid = np.ones(picture.shape[:2], dtype=np.uint8)
    valid[5:15, 25:35] = 0
    with pytest.raises(InputError, match=r"chart\.h5.*patch 1 saturated"):
        read_patches(picture, valid, made(Chart, CHART), "chart.h5")


@pytest.mark.parametrize("corner", [[-20.0, 10.0], [10.0, 2.0], [1.0, 10.0]])
def test_a_patch_outside_the_picture_is_named(corner):
    picture, _ = chart_picture(np.random.default_rng(8))
    chart = CHART | {"centres_px": CHART["centres_px"] | {"first": corner}}
    with pytest.raises(InputError, match=r"chart\.h5: chart\.centres_px.*patch 0"):
        read_patches(picture, np.ones(picture.shape[:2]), made(Chart, chart), "chart.h5")


def write_linear(path, picture, pose=(0.0, 0.0, 0.0, 0.0)):
    with store.create(path, store.Provenance("test")) as out:
        out.write("response", picture.astype(np.float32), units="1", dims="row,column,band", quantity="response")
        out.write("valid", np.ones(picture.shape[:2], np.uint8), units="1", dims="row,column", quantity="valid")
        out.attribute("pose_deg", list(pose))
        out.attribute("sample_px", 2)
        out.attribute("filters", ["out"])
    return path


def read_table(path) -> list[list[str]]:
    return list(csv.reader(path.read_text(encoding="utf-8").splitlines()))


def whole_chart(name: str, rng, light_deg: float):
    """A picture of a chart of 4 x 6 patches lit at an angle, with its definition and true spectra."""
    spectra = chart_spectra(name)[1]
    response = spectra @ camera(3, rng).T * np.cos(np.radians(light_deg))
    picture = np.kron(response.reshape(4, 6, 3), np.ones((10, 10, 1)))
    corners = {"first": [5, 5], "row_end": [55, 5], "column_end": [5, 35], "last": [55, 35]}
    chart = {"spectra": name, "rows": 4, "columns": 6, "patch_px": 6, "centres_px": corners}
    # The responses are not relative to a white reference.
    settings = {"estimator": "pinv", "bases": 3, "max_level_difference": 1.0}
    return picture, {"chart": chart, "calibration": settings}, spectra


def test_stage_writes_the_calibration_and_honest_errors(tmp_path):
    rng = np.random.default_rng(9)
    picture, definition, spectra = whole_chart("BabelColor Average", rng, light_deg=40.0)
    linear = write_linear(tmp_path / "chart.h5", picture, pose=(40.0, 0.0, 0.0, 0.0))
    calibrate_camera(
        linear,
        made(Camera | CalibratedCamera, definition),
        "D65",
        tmp_path / "c.h5",
        tmp_path / "c.csv",
        store.Provenance("test"),
    )
    loaded = Calibration.load(tmp_path / "c.h5")
    # The light's angle is not the paint's colour: at normal incidence the same matrix must hold.
    direct = calibrate(picture[5::10, 5::10].reshape(24, 3) / np.cos(np.radians(40)), spectra, 3, spectrum("D65"))
    assert np.allclose(loaded.weights_from_response, direct.weights_from_response, rtol=1e-4)
    assert np.allclose(loaded.light, spectrum("D65"))
    rows = read_table(tmp_path / "c.csv")
    assert [row[0] for row in rows[-3:]] == ["mean", "p95", "max"] and len(rows) == 1 + 24 + 3
    patches = np.array([[float(cell) for cell in row[1:]] for row in rows[1:25]])
    assert np.allclose([float(cell) for cell in rows[-3][1:]], patches.mean(axis=0), atol=1e-5)
    assert np.allclose([float(cell) for cell in rows[-1][1:]], patches.max(axis=0), atol=1e-5)
    truth = leave_one_out(picture[5::10, 5::10].reshape(24, 3), spectra, 3, LIGHT)
    assert np.allclose(patches[:, 0], np.sqrt(np.mean((truth - spectra) ** 2, axis=1)), atol=2e-5)


@pytest.mark.parametrize("fault", ["dead band", "wrong count"])
def test_stage_refuses_as_input_error(tmp_path, fault):
    picture, definition, _ = whole_chart("BabelColor Average", np.random.default_rng(10), light_deg=0.0)
    if fault == "dead band":
        picture[..., 2] = 0.0
    else:
        definition["chart"]["rows"] = 3
    linear = write_linear(tmp_path / "chart.h5", picture)
    outputs = tmp_path / "c.h5", tmp_path / "c.csv"
    with pytest.raises(InputError):
        calibrate_camera(linear, made(Camera | CalibratedCamera, definition), "A", *outputs, store.Provenance("test"))
    assert not any(path.exists() for path in outputs)


@pytest.fixture(scope="module")
def real_chart():
    """A decoded photograph of a ColorChecker and its camera's definition with this chart's measured spectra."""
    photograph = DATA / "raw" / "powershot_s40_chart.crw"
    if not photograph.is_file():
        pytest.skip(f"no real photograph at {photograph}")
    definition = yaml.safe_load((ROOT / "config/cameras/powershot-s40.yaml").read_text())
    definition["chart"]["spectra"] = str(DATA / "reflectance" / "colorchecker_classic_24.csv")
    definition["calibration"]["max_level_difference"] = 1.0  # no white reference
    return decode(photograph), definition


def test_real_photograph_recovers_its_chart(real_chart):
    mosaic, definition = real_chart
    patches = read_patches(
        mosaic.superpixels, mosaic.largest < 0.98, made(Chart, definition["chart"]), "chart.crw"
    ).mean
    spectra = dict(zip(*chart_spectra(definition["chart"]["spectra"]), strict=True))
    # Row A begins with dark skin, row D holds the greys; the photograph is read row by row.
    spectra = np.stack([spectra[f"{row}{column}"] for row in "ABCD" for column in range(1, 7)])
    right = spectral_rmse(spectra, leave_one_out(patches, spectra, 3, LIGHT)).mean()
    assert right <= 0.06
    wrong = spectral_rmse(spectra, leave_one_out(patches[::-1], spectra, 3, LIGHT)).mean()
    assert wrong >= 2 * right


def test_stage_matches_the_patches_of_a_real_photograph_with_their_spectra(real_chart, tmp_path):
    mosaic, definition = real_chart
    linear = write_linear(tmp_path / "chart.h5", mosaic.superpixels / mosaic.full_scale)
    calibrate_camera(
        linear,
        made(Camera | CalibratedCamera, definition),
        "A",
        tmp_path / "c.h5",
        tmp_path / "c.csv",
        store.Provenance("test"),
    )
    mean = {row[0]: row[1] for row in read_table(tmp_path / "c.csv")}["mean"]
    assert float(mean) <= 0.06


def test_a_chart_at_full_resolution_is_read_at_the_same_places():
    rng = np.random.default_rng(12)
    picture, definition, _ = whole_chart("BabelColor Average", rng, light_deg=0.0)
    valid = np.ones(picture.shape[:2], bool)
    coarse = read_patches(picture, valid, made(Chart, definition["chart"]), "a.h5").mean
    picture, valid = picture.repeat(2, axis=0).repeat(2, axis=1), valid.repeat(2, axis=0).repeat(2, axis=1)
    assert np.allclose(read_patches(picture, valid, made(Chart, definition["chart"]), "a.h5", sample_px=1).mean, coarse)


def test_hot_pixels_in_a_patch_do_not_count():
    rng = np.random.default_rng(13)
    picture, definition, _ = whole_chart("BabelColor Average", rng, light_deg=0.0)
    expected = read_patches(picture, np.ones(picture.shape[:2], bool), made(Chart, definition["chart"]), "a.h5").mean
    hot = rng.uniform(size=picture.shape[:2]) < 0.1
    picture[hot] = 50.0
    assert np.allclose(read_patches(picture, ~hot, made(Chart, definition["chart"]), "a.h5").mean, expected)


@pytest.mark.parametrize("error", [np.nan, -0.1, 1.0])
def test_an_error_of_the_light_that_is_no_share_is_refused(tmp_path, error):
    solved = Calibration(np.eye(61)[:, :3], LinearMapping(np.eye(3)), np.ones(61), ("out",), light_error=error)
    with store.create(tmp_path / "c.h5", store.Provenance("test")) as out:
        solved.write(out)
    with pytest.raises(InputError, match="light_error"):
        Calibration.load(tmp_path / "c.h5")
