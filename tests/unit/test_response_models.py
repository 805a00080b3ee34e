"""Response models from a chart, a table of the filter and given sensitivities, against cameras that are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from definitions import CAMERA_FILE, edit, fault, load
from made import made
from threadpoolctl import threadpool_limits

from benchmarks.light import adapted_errors, camera, recovered
from benchmarks.response_models import (
    CAMERAS,
    DATA,
    Trial,
    Wrong,
    errors,
    given_sensitivities,
    published_filter,
    shares,
    trial,
)
from irodori.calibration.best_response import (
    CHART,
    FILTER,
    NOTHING,
    SENSITIVITIES,
    BestResponse,
    Given,
    best_response,
)
from irodori.calibration.estimator_choice import SelectionRow
from irodori.calibration.filter_fit import FILTERED, fit_filter
from irodori.calibration.filter_table import FilterTable, read_filter
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.sensitivity_prior import Posteriors, prior_about, prior_of_chart
from irodori.calibration.simulated_responses import band_weights
from irodori.calibration.stage import calibrate_camera, write_selection
from irodori.config.models import CombFilter, Passband
from irodori.config.parts import CalibratedCamera
from irodori.core import store
from irodori.core.errors import InputError
from irodori.light.light_prior import prior_of_any_lamp
from irodori.light.light_recovery import ResponseModel
from irodori.report.calibration_part import camera_calibrations
from irodori.report.html_page import fragment
from irodori.simulation.virtual_rig.sensor import comb_transmittance
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import camera_sensitivities, chart_spectra, spectrum

NIKON, SIGMA = (camera_sensitivities(f"{name} (NPL)") for name in ("Nikon 5100", "Sigma SDMerill"))
FINE_NM = np.arange(380.0, 781.0)


def passbands(*bands: tuple[float, float]) -> np.ndarray:
    """Return the transmittance of a comb filter of given centres and widths, nm, at fine steps."""
    distance = [np.abs(2.0 * (FINE_NM - centre) / width) for centre, width in bands]
    return 0.005 + 0.92 * sum(np.exp(-np.log(2.0) * d**8) for d in distance)


COMB = passbands((440.0, 35.0), (555.0, 30.0), (640.0, 40.0))
NOTCH = 1.0 - 0.97 * passbands((575.0, 25.0))
NOISES = [0.0, 0.001, 0.01]


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Let the small matrices here be computed by one thread: several would mostly wait for each other."""
    with threadpool_limits(1):
        yield


def photographed(transmittance: np.ndarray, noise: float, seed: int = 0) -> Trial:
    return Trial(NIKON, np.interp(WAVELENGTH_NM, FINE_NM, transmittance), noise, seed)


def assert_within(best: BestResponse, true: np.ndarray) -> None:
    """What is stated holds: a third of one camera's errors may lie beyond one σ, few beyond two."""
    one, two = shares(best.mean, best.covariance, true)
    assert one >= 0.55 and two >= 0.88


@pytest.mark.default_cases(3)
@pytest.mark.stability(stage="calibrate", case="filter 3 nm off its table", shift=3.0)
@pytest.mark.stability(stage="calibrate", case="filter's table 10 % too low", level=0.9)
@pytest.mark.stability(stage="calibrate", case="filter with a narrow notch", curve="notch")
@pytest.mark.stability(stage="calibrate", case="chart without noise", noise=0.0)
@pytest.mark.stability(stage="calibrate", case="chart of 1 % noise", noise=0.01)
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize(("curve", "shift", "level"), [("comb", 3.0, 1.0), ("comb", -1.2, 0.9), ("notch", 1.2, 1.0)])
def test_shift_and_gain_of_a_filter_are_found_with_the_response_model(curve, shift, level, noise):
    transmittance = {"comb": COMB, "notch": NOTCH}[curve]
    own = photographed(transmittance, noise)
    best, true = own.found(Given(Wrong(shift, 1.0, level).table(FINE_NM, transmittance)))
    alone, _ = own.found(Given())
    assert best.sources == (CHART, FILTER) and not best.ignored()
    found, error = best.filter.departures[0], best.filter.errors[0]
    # A sample every 5 nm, as the virtual rig takes them, places an edge to some tenths of a nanometre.
    assert abs(found - shift) <= 3.0 * error + 0.4
    assert noise == 0.01 or error <= 0.5
    assert errors(best.mean, true)[3:].mean() <= 0.7 * errors(alone.mean, true)[3:].mean()
    assert_within(best, true)
    whole = best.covariance.reshape(best.mean.size, -1)
    assert np.linalg.eigvalsh(whole).min() >= -1e-9 * whole.max()


def test_a_chart_that_is_photographed_three_times_is_one_of_a_third_of_the_noise():
    """In all that is found; the evidence by what three readings of a patch are worth as densities, written out.

    Three charts have more patches than there are wavelengths, and are combined first.
    """
    own = photographed(COMB, 0.003)
    response, spectra, *_ = own.chart()
    table = FilterTable(FINE_NM, COMB)
    priors = [prior_of_chart(one, spectra, own.light, 1e-5) for one in response.T[:FILTERED]]
    third = [replace(prior, noise=prior.noise / 3.0) for prior in priors]
    thrice = fit_filter(np.tile(response, (3, 1)), np.tile(spectra, (3, 1)), table, priors, np.zeros(6))
    once = fit_filter(response, spectra, table, third, np.zeros(6))
    for name in ("mean", "covariance", "departures", "errors", "gains"):
        found, expected = getattr(thrice, name), getattr(once, name)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    square = np.mean(response**2, axis=0)
    noise = np.array([prior.noise for prior in priors])
    noise = np.concatenate([noise, np.mean(noise / square[:FILTERED]) * square[FILTERED:]])
    count = len(spectra)
    further = 0.5 * (6 * count * np.log(3.0) + 2 * count * np.log(noise).sum())
    assert thrice.log_evidence == pytest.approx(once.log_evidence - further, rel=1e-9)


@pytest.mark.parametrize("noise", NOISES)
def test_a_filter_without_a_table_is_one_filter_for_all_bands(noise):
    """It lets no band see what the band does not see without it, and that is stated."""
    own = photographed(COMB, noise)
    response, spectra, variance, true = own.chart()
    best = best_response(response, spectra, own.light, variance, NOTHING)
    each = [
        prior_of_chart(*one, spectra, own.light, v) for one, v in zip(zip(response.T), variance + 1e-8, strict=True)
    ]
    apart = Posteriors.of(each, response, spectra)
    assert best.sources == (CHART,) and best.filter is None and not best.ignored()
    blue, red_nm = 5, WAVELENGTH_NM > 600.0
    stated, before = (np.sqrt(np.diagonal(one.covariance[blue, :, blue]))[red_nm].max() for one in (best, apart))
    assert stated < 0.8 * before and np.abs((best.mean - true)[blue, red_nm]).max() <= 3.0 * stated
    assert_within(best, true)


def test_an_error_of_a_sensitivity_is_stated_as_an_error_of_the_band_with_the_filter_too():
    """In the mean over four draws of noise, errors of a band without and with the filter have the covariance stated."""
    found, stated = 0.0, 0.0
    for seed in range(4):
        best, true = photographed(COMB, 0.01, seed).found(NOTHING)
        off = best.mean - true
        found += float(np.sum(off[:3] * off[3:]))
        stated += sum(float(np.trace(best.covariance[band, :, band + 3])) for band in range(3))
    assert 0.4 <= found / stated <= 2.0


def test_six_bands_that_no_filter_relates_are_estimated_one_by_one():
    light, spectra = spectrum("A"), chart_spectra("BabelColor Average")[1]
    true = band_weights(np.concatenate([NIKON[::-1], SIGMA * np.linspace(0.0, 3.0, 61)]), light)
    response = spectra @ true.T
    response, variance = response / response.max(axis=0), np.full(6, 1e-8)
    best = best_response(response, spectra, light, variance, NOTHING)
    apart = Posteriors.of([prior_of_chart(one, spectra, light, 1e-8) for one in response.T], response, spectra)
    assert best.mean == pytest.approx(apart.mean, rel=1e-2, abs=1e-3)


WRONG = {
    "another comb": passbands((460.0, 30.0), (520.0, 30.0), (610.0, 40.0)),
    "a notch": NOTCH,
    "grey": np.full(len(FINE_NM), 0.9),
    "a ramp": np.linspace(0.0, 1.0, len(FINE_NM)),
}


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="calibrate", case="table of another filter")
@pytest.mark.parametrize(("wrong", "noise"), list(zip(WRONG, (0.0, 0.001, 0.01, 0.01), strict=True)))
def test_the_table_of_another_filter_is_found_out_and_not_used(wrong, noise):
    own = photographed(COMB, noise)
    best, _ = own.found(Given(FilterTable(FINE_NM, WRONG[wrong])))
    alone, _ = own.found(Given())
    assert best.sources == (CHART,) and best.filter is None
    assert best.ignored() == (FILTER,) and best.ignored_by(FILTER) > 10.0
    assert np.array_equal(best.mean, alone.mean) and np.array_equal(best.covariance, alone.covariance)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_sensitivities_with_their_error_make_all_bands_better(noise):
    own = photographed(COMB, noise)
    table, known = Wrong(1.2).table(FINE_NM, COMB), given_sensitivities(NIKON)
    with_table, true = own.found(Given(table))
    both, _ = own.found(Given(table, known))
    plain, _ = own.found(Given(sensitivities=known))
    assert both.sources == (CHART, FILTER, SENSITIVITIES) and plain.sources == (CHART, SENSITIVITIES)
    assert (errors(both.mean, true) < errors(with_table.mean, true)).mean() >= 0.8
    assert errors(plain.mean, true)[:3].max() <= 0.06
    rows = [shares(both.mean, both.covariance, true)]
    for seed in (1, 2, 3):  # a single draw of what is wrong with table and sensitivities decides much
        given = Given(Wrong(1.2).table(FINE_NM, COMB, seed), given_sensitivities(NIKON, seed=seed))
        drawn, own_true = photographed(COMB, noise, seed).found(given)
        rows.append(shares(drawn.mean, drawn.covariance, own_true))
    one, two = np.mean(rows, axis=0)
    assert 0.55 <= one <= 0.85 and two >= 0.9


def test_errors_of_given_sensitivities_are_as_smooth_at_the_edges_of_cut_filters_as_elsewhere():
    """Wrong readings of a lamp or a monochromator have nothing to do with the camera."""
    flat, chart = np.ones(len(WAVELENGTH_NM)), chart_spectra("BabelColor Average")[1]
    covariance = prior_about(flat, 0.1, chart @ flat, chart, flat, 1e-6).covariance
    beside = covariance.diagonal(3) / covariance.diagonal()[3:]
    assert beside == pytest.approx(np.full(len(beside), beside.mean()), rel=0.02)


def test_given_sensitivities_are_right_at_the_ends_of_the_range_too():
    """There a sample of the response is half an integral's step."""
    sensitivities = NIKON + 0.2 * NIKON.max(axis=1, keepdims=True)
    own = Trial(sensitivities, np.interp(WAVELENGTH_NM, FINE_NM, COMB), 0.001)
    best, true = own.found(Given(sensitivities=given_sensitivities(sensitivities, 0.02)))
    assert best.sources == (CHART, SENSITIVITIES)
    assert best.mean[:3, [0, -1]] == pytest.approx(true[:3, [0, -1]], rel=0.1)


@pytest.mark.stability(stage="calibrate", case="sensitivities of another camera")
def test_sensitivities_of_another_camera_are_found_out_and_not_used():
    own, table = photographed(COMB, 0.001), Wrong(1.2).table(FINE_NM, COMB)
    best, _ = own.found(Given(table, given_sensitivities(SIGMA)))
    assert best.sources == (CHART, FILTER) and best.ignored() == (SENSITIVITIES,)
    assert np.array_equal(best.mean, own.found(Given(table))[0].mean)


def test_units_of_bands_and_table_do_not_matter():
    own = photographed(COMB, 0.001)
    table = Wrong(1.2).table(FINE_NM, COMB)
    best, _ = own.found(Given(table))
    half, _ = own.found(Given(FilterTable(FINE_NM, 0.5 * table.transmittance)))
    assert half.mean == pytest.approx(best.mean, abs=1e-9) and half.covariance == pytest.approx(best.covariance)


@pytest.mark.heavy
@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_what_is_stated_holds_on_cameras_and_filters_that_had_no_part_in_it(noise):
    if not DATA.is_dir():
        pytest.skip(f"no measured data at {DATA}")
    rows, better = [], []
    for seed, (name, of) in enumerate(zip(CAMERAS, ("Schott_BG36", "MIDOPT_NF550") * 2, strict=True)):
        own = trial(name, of, noise, seed)
        best, true = own.found(Given(Wrong.of(seed).table(*published_filter(of), seed)))
        rows.append(shares(best.mean, best.covariance, true))
        better.append(errors(best.mean, true)[3:].mean() / errors(own.found(Given())[0].mean, true)[3:].mean())
        assert best.sources == (CHART, FILTER)
    one, two = np.mean(rows, axis=0)
    # At 1 % stated errors are somewhat too wide. At 0.1 % more errors than the aim of 0.07 lie beyond two standard
    # deviations: at the edges of passbands.
    assert 0.62 <= one <= (0.75 if noise == 0.001 else 0.78) and two >= (0.91 if noise == 0.001 else 0.93)
    assert np.mean(better) <= 0.6


# ---- the light


def test_light_is_recovered_better_where_the_table_of_the_filter_is_given():
    with_table, alone, prior = camera(table=True), camera(), prior_of_any_lamp()
    lamps = [spectrum(name) * spectrum(wall) for name in ("FL7", "LED-B4", "HP2") for wall in ("TCS12", "TCS60")]
    found = {
        name: np.mean([adapted_errors(lamp, recovered(seen, lamp, prior)) for lamp in lamps])
        for name, seen in (("alone", alone), ("table", with_table))
    }
    assert found["table"] <= 0.9 * found["alone"]


# ---- the table


def test_a_shift_moves_the_curve_to_longer_wavelengths_and_slopes_are_derivatives():
    table = FilterTable(FINE_NM, np.exp(-0.5 * ((FINE_NM - 550.0) / 20.0) ** 2))
    plain, moved = (table.at(np.array([shift, 0.0, 0.0, 0.0])) for shift in (0.0, 5.0))
    assert WAVELENGTH_NM[plain.argmax()] == 550.0 and WAVELENGTH_NM[moved.argmax()] == 555.0
    assert plain.max() == pytest.approx(1.0, abs=2e-3)
    # A bell's variances add: the blur of 50 nm² widens 20 nm to sqrt(450) nm and lowers the top to first order.
    wider = table.at(np.array([0.0, 0.0, 50.0, 0.0]))
    assert wider.max() == pytest.approx(1.0 - 25.0 / 400.0, abs=5e-3)
    assert table.at(np.array([0.0, 0.0, 0.0, 0.01])) == pytest.approx(plain + 0.01)
    tilted = table.at(np.array([0.0, 10.0, 0.0, 0.0]))
    assert tilted[30] == plain[30] and tilted.argmax() == plain.argmax()
    at, slopes = np.array([1.0, 0.5, 2.0, 0.001]), table.slopes(np.array([1.0, 0.5, 2.0, 0.001]))
    for which, step in enumerate((0.01, 0.01, 0.1, 0.001)):
        change = np.eye(4)[which] * step
        assert (table.at(at + change) - table.at(at)) / step == pytest.approx(slopes[:, which], abs=2e-3)


def test_a_coarse_table_is_kept_at_its_own_samples():
    grid = np.arange(380.0, 781.0, 5.0)
    values = np.interp(grid, FINE_NM, COMB)
    at = FilterTable(grid, values).at(np.zeros(4))
    assert at * values.max() == pytest.approx(values[np.isin(grid, WAVELENGTH_NM)], abs=1e-9)


def table_file(path: Path, columns: dict[str, float], start: float = 380.0) -> Path:
    rows = [f"{at:g}," + ",".join(f"{value:g}" for value in columns.values()) for at in np.arange(start, 781.0, 5.0)]
    path.write_text("\n".join([f"wavelength_nm,{','.join(columns)}", *rows]), encoding="utf-8")
    return path


def test_a_file_of_several_filters_needs_a_name(tmp_path):
    file = table_file(tmp_path / "f.csv", {"clear": 0.9, "grey": 0.3})
    assert read_filter(file, "grey", 1.5).transmittance == pytest.approx(0.3)
    for name, found in ((None, "2 spectra and no name"), ("green", "no spectrum of this name")):
        with pytest.raises(InputError) as caught:
            read_filter(file, name, 2.0)
        assert caught.value.found == found and "clear" in caught.value.accepted


@pytest.mark.parametrize(
    ("columns", "start", "found"),
    [({"f": 0.9}, 410.0, "410"), ({"f": 90.0}, 380.0, "percent"), ({"f": 0.0}, 380.0, "no transmittance")],
)
def test_definitions_with_a_table_of_no_filter_are_refused(root, columns, start, found):
    table_file(root / "f.csv", columns, start)
    edit(root, CAMERA_FILE, "comb_filter", {"transmittance": "f.csv"})
    error = fault(root)
    assert Path(error.file).name == "f.csv" and found in error.found


def test_definitions_name_tables_that_are_there(root):
    edit(root, CAMERA_FILE, "comb_filter", {"transmittance": "none.csv"})
    error = fault(root)
    assert (error.field, error.found) == ("comb_filter.transmittance", "no such file: none.csv")
    edit(root, CAMERA_FILE, "comb_filter", ...)
    edit(root, CAMERA_FILE, "sensitivities", {"file": "Nikon D5100"})
    assert "'Nikon 5100 (NPL)'" in fault(root).accepted
    edit(root, CAMERA_FILE, "sensitivities", {"file": "Nikon 5100 (NPL)", "error_percent": 5.0})
    assert load(root).cameras["d5100-comb"].sensitivities.error_percent == 5.0


def test_the_table_of_the_default_camera_is_its_filter_as_a_data_sheet_could_have_it(root):
    definition = load(root).cameras["d5100-comb"]
    table = read_filter(root / definition.comb_filter.transmittance, None, definition.comb_filter.shift_nm)
    true = comb_transmittance(
        CombFilter(passbands=tuple(Passband(**vars(p)) for p in definition.virtual.comb_filter.passbands), floor=0.005)
    )
    off = [np.abs(table.at(np.array([shift, 0.0, -4.0, 0.0])) - true / true.max()).mean() for shift in (-1.1, 0.0, 1.1)]
    assert off[0] < 0.5 * off[1] < off[2]
    assert table.transmittance.max() == pytest.approx(0.95 * 0.925, abs=0.02)


# ---- the stage


def calibrated(folder: Path, filters: list[str], light: str = "A", **known) -> tuple[dict, Calibration]:
    """Return what the stage tells of the response model of a chart photographed in some filter states, and it."""
    whole = photographed(COMB, 0.001).chart()[0][:, : 3 * len(filters)]
    picture = np.kron(whole.reshape(4, 6, -1), np.ones((10, 10, 1))).astype(np.float32)
    with store.create(folder / "chart.h5", store.Provenance("test")) as out:
        out.write("response", picture, units="1", dims="row,column,band", quantity="response")
        out.write("valid", np.ones(picture.shape[:2], np.uint8), units="1", dims="row,column", quantity="valid")
        for name, value in {"pose_deg": [0.0] * 4, "sample_px": 2, "filters": filters}.items():
            out.attribute(name, value)
    corners = {"first": [5, 5], "row_end": [55, 5], "column_end": [5, 35], "last": [55, 35]}
    chart = {"spectra": "BabelColor Average", "rows": 4, "columns": 6, "patch_px": 6, "centres_px": corners}
    # The brightest patch, not a white reference, has the response 1.
    settings = {"estimator": "pinv", "bases": len(whole[0]), "max_level_difference": 0.5}
    camera_file = {"chart": chart, "calibration": settings, **known}
    outputs = folder / "c.h5", folder / "c.csv"
    camera = made(CalibratedCamera, camera_file)
    calibrate_camera(folder / "chart.h5", camera, light, *outputs, store.Provenance("test"))
    with store.open_file(outputs[0]) as file:
        return file.attribute("response_model"), Calibration.load(outputs[0])


def write_table(path: Path, transmittance: np.ndarray) -> str:
    rows = [f"{at:g},{value:.4f}" for at, value in zip(FINE_NM, np.clip(transmittance, 0.0, 1.0), strict=True)]
    path.write_text("\n".join(["wavelength_nm,transmittance", *rows]), encoding="utf-8")
    return str(path)


def test_the_stage_says_what_the_response_model_rests_on_and_what_it_did_not_use(tmp_path, caplog):
    caplog.set_level("INFO", logger="irodori")
    sheet = write_table(tmp_path / "sheet.csv", Wrong(1.2).table(FINE_NM, COMB).transmittance)
    told, solved = calibrated(tmp_path, ["out", "in"], comb_filter={"transmittance": sheet})
    assert told["sources"] == [CHART, FILTER] and not told["ignored"]
    assert told["filter"]["shift_nm"][0] == pytest.approx(1.2, abs=0.8)
    assert f"response model from: {CHART}, {FILTER}" in caplog.text
    true = photographed(COMB, 0.0).chart()[3]
    assert errors(solved.band_response, true)[3:].max() < 0.12
    wrong = write_table(tmp_path / "wrong.csv", WRONG["another comb"])
    told, other = calibrated(tmp_path, ["out", "in"], comb_filter={"transmittance": wrong})
    assert told["sources"] == [CHART] and list(told["ignored"]) == [FILTER] and not told["filter"]
    assert f"{FILTER} not used" in caplog.text
    # The estimator does not depend on it.
    assert np.array_equal(other.weights_from_response, solved.weights_from_response)


def test_the_rigs_lamp_is_known_better_by_its_measured_spectrum_than_by_a_name(tmp_path):
    rows = [f"{at:g},{power:.4f}" for at, power in zip(WAVELENGTH_NM, spectrum("A"), strict=True)]
    (tmp_path / "lamp.csv").write_text("\n".join(["wavelength_nm,power", *rows]), encoding="utf-8")
    named, measured = (calibrated(tmp_path, ["out"], light)[1] for light in ("A", str(tmp_path / "lamp.csv")))
    stated = [ResponseModel.of(one).rig_lamp_errors.std() for one in (named, measured)]
    assert stated[0] / stated[1] == pytest.approx(0.05 / 0.02, rel=1e-3)


def test_the_stage_refuses_a_filter_of_a_chart_that_was_not_photographed_with_it(tmp_path):
    with pytest.raises(InputError) as caught:
        calibrated(tmp_path, ["out"], comb_filter={"transmittance": write_table(tmp_path / "sheet.csv", COMB)})
    assert caught.value.field == "comb_filter" and "with filter out, in, or no comb_filter" in caught.value.accepted


def test_the_report_names_what_the_response_model_rests_on(tmp_path):
    tables = {name: write_table(tmp_path / f"{name}.csv", curve) for name, curve in (("right", COMB), ("wrong", NOTCH))}
    pages = []
    for table in tables.values():
        calibrated(tmp_path, ["out", "in"], comb_filter={"transmittance": table})
        only = SelectionRow("pinv", 6, 1.0, *[{"D65": 1.0}] * 3, 0.1, 0.1, 36, 1.0)
        write_selection(tmp_path / "s.csv", [only], ("pinv", 6))
        rows = camera_calibrations(["six"], [tmp_path / "c.h5"], [tmp_path / "c.csv"], [tmp_path / "s.csv"])
        pages.append(fragment("calibration.html.j2", calibrations=rows))
    assert f"{CHART}, {FILTER}" in pages[0] and "nm at 550 nm" in pages[0]
    assert "given and not used" in pages[1] and "nm at 550 nm" not in pages[1]
