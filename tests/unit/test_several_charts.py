"""A camera with several charts: photographed, trained on together, and left out patch by patch and chart by chart."""

import csv
import shutil
from dataclasses import replace

import numpy as np
import pytest
from definitions import CAMERA_FILE, ROOT, edit, fault, load
from made import made

from irodori.calibration.estimator_choice import choose, cross_validate, scores_of
from irodori.calibration.estimators import ESTIMATORS, fit
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.solution import solve
from irodori.calibration.stage import calibrate_camera
from irodori.calibration.training import Training
from irodori.capture.shot_list import camera_shots
from irodori.config.capture_table import Pose, Shot, read_captures, write_captures
from irodori.config.models import CalibrationOptions, Camera
from irodori.config.parts import CalibratedCamera
from irodori.core import store
from irodori.core.errors import InputError
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.stage import ingest_raw
from irodori.report.calibration_part import camera_calibrations
from irodori.report.html_page import fragment
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera
from irodori.spectra.published import chart_spectra, spectrum

CLASSIC, PMC = (chart_spectra(name)[1] for name in ("BabelColor Average", "PMC"))
#: Centres of the corner patches of charts of four and five rows in a picture of 400 x 300 mosaic pixels, superpixels.
FOUR, FIVE = (
    {"first": [47.42, y], "row_end": [151.58, y], "column_end": [47.42, 149.0 - y], "last": [151.58, 149.0 - y]}
    for y in (43.25, 32.83)
)
SECOND = {"spectra": "PMC", "rows": 5, "columns": 6, "centres_px": FIVE, "patch_px": 8}
MADE = store.Provenance("test")


def two_charts(root, settings=None) -> dict:
    """Return the definitions of a small virtual session with a second chart."""
    for key, value in {
        "further_charts": {"pmc": SECOND},
        "calibration": settings or {"estimator": "auto", "bases": "auto"},
        "chart.centres_px": FOUR,
        "chart.patch_px": 8,
        "optics": {
            "focal_length_mm": 50.0,
            "pixel_pitch_um": 20.0,
            "width_px": 400,
            "height_px": 300,
            "principal_point_px": [200.0, 150.0],
        },
        "dark_frames": 0,
        "linearity_exposure_s": [],
    }.items():
        edit(root, CAMERA_FILE, key, value)
    return load(root)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Return the folder of a virtual session with two charts, calibrated, and the camera's definition."""
    root = tmp_path_factory.mktemp("charts")
    shutil.copytree(ROOT / "config", root / "config")
    definitions = two_charts(root)
    camera, rig = definitions.cameras["d5100-comb"], definitions.rigs["virtual"]
    shots, bench = camera_shots(camera, ".dng"), Bench()
    virtual = VirtualCamera(camera, rig, bench, "camera", shots)
    for shot in shots:
        bench.set({"subject": shot.subject, "filter": shot.filter, **vars(shot.pose)})
        virtual.capture(shot, root / shot.file)
    table = root / "captures.csv"
    write_captures(table, shots)
    ingest_reference(table, root, root / "reference.h5", MADE, 0.99, IngestOptions())
    linear = []
    for capture in definitions.captures_of("cameras", "d5100-comb", root):
        linear.append(root / f"{capture}.h5")
        ingest_raw(table, root, capture, root / "reference.h5", linear[-1], MADE, options=IngestOptions())
    outputs = [root / name for name in ("c.h5", "errors.csv", "selection.csv")]
    calibrate_camera(
        linear,
        camera,
        rig.light.spectrum,
        *outputs[:2],
        MADE,
        selection=outputs[2],
    )
    return root, camera.plain(), linear


def rows_of(path) -> list[dict]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


@pytest.mark.heavy
def test_the_table_names_the_further_chart(session):
    root, _, linear = session
    shots = [shot for shot in read_captures(root / "captures.csv", root) if shot.role == "chart"]
    assert {(shot.capture, shot.chart, shot.filter) for shot in shots} == {
        (capture, chart, state) for capture, chart in (("chart", ""), ("chart-pmc", "pmc")) for state in ("out", "in")
    }
    assert [path.name for path in linear] == ["chart.h5", "chart-pmc.h5"]


def test_the_calibration_is_trained_on_the_patches_of_both(session):
    root, _, _ = session
    loaded = Calibration.load(root / "c.h5")
    assert loaded.training.shape == (54, 6)
    both = np.concatenate([CLASSIC, PMC])
    assert np.sqrt(((loaded.spectra(loaded.training) - both) ** 2).mean(axis=1)).mean() <= 0.02


def test_errors_are_told_for_patches_and_for_whole_charts_left_out(session):
    root, _, _ = session
    errors = rows_of(root / "errors.csv")
    patches, mean = errors[:54], errors[-3]
    assert sum(row["patch"].startswith("pmc/") for row in patches) == 30
    for row in patches:
        assert float(row["delta_e_d65"]) > 0 and float(row["delta_e_d65_by_chart"]) > 0
    assert 0.0 < float(mean["spectral_rmse"]) <= 0.03 and 0.0 < float(mean["spectral_rmse_by_chart"]) <= 0.03
    with store.open_file(root / "c.h5") as file:
        assert file.attribute("charts") == {"chart": 24, "chart-pmc": 30}
        told = file.read("leave_one_chart_out/rmse").mean()
    assert told == pytest.approx(float(mean["spectral_rmse_by_chart"]), abs=1e-5)


def test_the_choice_weighs_both_ways_of_leaving_out(session):
    """Over all estimators of the table that is written, not the chosen one's numbers of bases alone."""
    root, _, _ = session
    table = rows_of(root / "selection.csv")
    chosen = [row for row in table if row["chosen"] == "1"]
    assert {row["left_out"] for row in chosen} == {"patch", "chart"}
    ((name, bases),) = {(row["estimator"], row["bases"]) for row in chosen}
    assert {row["estimator"] for row in table} == set(ESTIMATORS)
    total: dict = {}
    for row in table:
        total.setdefault((row["estimator"], row["bases"]), []).append(float(row["score"]))
    score = {key: np.mean(both) for key, both in total.items() if len(both) == 2}
    assert score[name, bases] <= min(value for key, value in score.items() if key[0] == name) + 1e-4
    # The safe one stays unless another's score is under 0.7 of its own.
    safe = min(value for key, value in score.items() if key[0] == "broad")
    assert name == ("broad" if min(score.values()) >= 0.7 * safe else min(score, key=score.__getitem__)[0])


def test_the_report_says_both(session):
    root, _, _ = session
    files = [root / "c.h5"], [root / "errors.csv"], [root / "selection.csv"]
    page = fragment("calibration.html.j2", calibrations=camera_calibrations(["d5100-comb"], *files))
    assert "chart of 24 patches, chart-pmc of 30 patches" in page
    assert "left out patch by patch" in page and "left out chart by chart" in page


def test_charts_of_other_filter_states_or_in_other_number_are_refused(session, tmp_path):
    _, camera, linear = session
    outputs = tmp_path / "c.h5", tmp_path / "c.csv"
    with pytest.raises(ValueError, match="1 file of charts; accepted: 2"):
        calibrate_camera(linear[:1], made(Camera | CalibratedCamera, camera), "A", *outputs, MADE)
    with store.open_file(linear[1]) as file, store.create(tmp_path / "out.h5", MADE) as out:
        for name in ("response", "valid"):
            values = file.read(name)[..., :3] if name == "response" else file.read(name)
            out.write(name, values, units="1", dims="row,column,band"[: 10 if name == "valid" else None], quantity=name)
        out.attribute("pose_deg", file.attribute("pose_deg"))
        out.attribute("sample_px", 2)
        out.attribute("filters", ["out"])
    with pytest.raises(InputError, match="filters: found out; accepted: out, in"):
        calibrate_camera([linear[0], tmp_path / "out.h5"], made(Camera | CalibratedCamera, camera), "A", *outputs, MADE)
    assert not outputs[0].exists()


def altered(path, out_path, change) -> str:
    """Write a chart's linear responses with a change to them, in place, and return the path."""
    with store.open_file(path) as file, store.create(out_path, MADE) as out:
        response = file.read("response")
        change(response)
        out.write("response", response, units="1", dims="row,column,band", quantity="response")
        out.write("valid", file.read("valid"), units="1", dims="row,column", quantity="valid")
        for name in ("pose_deg", "sample_px", "filters"):
            out.attribute(name, file.attribute(name))
    return out_path


def negative(response) -> None:
    # The patch in the second row and third column of the chart, and some way about it.
    x, y = (round(FIVE["first"][a] + step * (FIVE["last"][a] - FIVE["first"][a])) for a, step in ((0, 0.4), (1, 0.25)))
    response[y - 6 : y + 7, x - 6 : x + 7] = -0.2


def brighter(response) -> None:
    response *= 1.2


def turned(response) -> None:
    response[:] = response[::-1, ::-1].copy()


@pytest.mark.parametrize(
    ("change", "field", "found"),
    [
        (negative, "further_charts.pmc", "patch 8 at -"),
        (brighter, "further_charts.pmc", "times as bright as the others predict"),
        (turned, "further_charts.pmc", "when the chart is read turned .*further_charts.pmc.centres_px from the first"),
    ],
)
def test_a_further_chart_that_is_at_fault_is_named_with_its_file(session, tmp_path, change, field, found):
    _, camera, linear = session
    spoiled = altered(linear[1], tmp_path / "spoiled.h5", change)
    with pytest.raises(InputError, match=found) as caught:
        calibrate_camera(
            [linear[0], spoiled],
            made(Camera | CalibratedCamera, camera),
            "A",
            tmp_path / "c.h5",
            tmp_path / "c.csv",
            MADE,
        )
    assert (caught.value.file, caught.value.field) == (str(spoiled), field)
    assert not (tmp_path / "c.h5").exists()


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [("patch_px", 60, "further_charts.pmc.patch_px"), ("find", "chart", "further_charts.pmc.find"),
     ("centres_px", FIVE | {"last": [400.0, 300.0]}, "further_charts.pmc.centres_px")],
)  # fmt: skip
def test_a_key_of_a_further_chart_that_its_photograph_refutes_is_named(session, tmp_path, key, value, field):
    _, camera, linear = session
    chart = camera["further_charts"]["pmc"] | {"find": "edges" if key == "patch_px" else "nothing"} | {key: value}
    camera = camera | {"further_charts": {"pmc": chart}}
    with pytest.raises(InputError) as caught:
        calibrate_camera(
            linear, made(Camera | CalibratedCamera, camera), "A", tmp_path / "c.h5", tmp_path / "c.csv", MADE
        )
    assert (caught.value.file, caught.value.field) == (str(linear[1]), field)


def test_what_all_charts_together_lack_names_all_of_them(session, tmp_path):
    _, camera, linear = session
    camera = camera | {"calibration": {"estimator": "pinv", "bases": 6, "max_condition": 2.0}}
    with pytest.raises(InputError, match="condition number") as caught:
        calibrate_camera(
            linear, made(Camera | CalibratedCamera, camera), "A", tmp_path / "c.h5", tmp_path / "c.csv", MADE
        )
    assert (caught.value.file, caught.value.field) == (str(linear[0]), "chart, further_charts.pmc")


# ---- without photographs


def training(count: int = 30) -> tuple[Training, np.ndarray]:
    """Return exact responses of two charts, six bands, and the chart of each patch."""
    wavelength_nm = np.arange(400.0, 701.0, 5.0)
    centres, widths = (600, 540, 460, 640, 570, 490), (38, 36, 30, 20, 18, 18)
    rows = np.array([np.exp(-(((wavelength_nm - c) / w) ** 2)) for c, w in zip(centres, widths, strict=True)])
    system = rows * spectrum("A") / (rows * spectrum("A")).sum(axis=1, keepdims=True)
    spectra = np.concatenate([CLASSIC, PMC[:count]])
    return Training(spectra @ system.T, spectra, spectrum("A")), np.repeat([0, 1], [24, count])


@pytest.mark.parametrize("name", ["pinv", "wiener", "local"])
def test_a_chart_left_out_is_recovered_by_the_others_alone(name):
    both, charts = training()
    _, recovered = cross_validate(both, ("D65",), charts=charts, bases=(6,), estimators=(name,))
    first = Training(both.response[:24], both.spectra[:24], both.light)
    expected = fit(name, first, 6).spectra(both.response[24:])
    assert np.allclose(recovered[name, 6][24:], expected, atol=1e-7)


def test_a_chart_that_alone_would_determine_nothing_is_never_all_that_is_left():
    both, charts = training(count=4)
    rows, recovered = cross_validate(both, ("D65",), charts=charts, bases=(6,), estimators=("pinv",))
    spectra = recovered["pinv", 6]
    assert np.isnan(spectra[:24]).all() and np.isfinite(spectra[24:]).all()
    assert np.isfinite(rows[0].score)
    # With hardly any patches in each, none can be left out, and patches alone decide.
    small = np.r_[0:4, 24:28]
    few = replace(both, response=both.response[small], spectra=both.spectra[small])
    assert cross_validate(few, ("D65",), charts=charts[small], bases=(6,), estimators=("pinv",)) == ([], {})
    solved = solve(
        few, made(CalibrationOptions, {"estimator": "pinv", "bases": 3}), ("out", "in"), ("D65",), False, charts[small]
    )
    assert solved.recovered_by_chart is None and {row.left_out for row in solved.rows} == {"patch"}


def test_scores_of_two_ways_are_averaged_and_what_lacks_one_does_not_count():
    both, charts = training()
    rows, _ = cross_validate(both, ("D65",), bases=(3, 6), estimators=("wiener",))
    others, _ = cross_validate(both, ("D65",), charts=charts, bases=(6,), estimators=("wiener",))
    (by_patch,) = (row.score for row in rows if row.bases == 6)
    assert scores_of(rows + others) == {("wiener", 6): pytest.approx((by_patch + others[0].score) / 2)}
    assert choose(rows + others, "wiener", "auto") == ("wiener", 6)


@pytest.mark.parametrize(
    ("by_chart", "taken"),
    [
        # Best when patches are left out is one, when charts are another; their mean decides for a third.
        ({"pinv": 8.0, "broad": 4.0, "wiener": 1.0}, ("broad", 6)),
        # Half the preferred one's mean is better beyond doubt, three quarters of it is not.
        ({"pinv": 1.0, "broad": 4.0, "wiener": 8.0}, ("pinv", 6)),
        ({"pinv": 3.5, "broad": 4.0, "wiener": 8.0}, ("broad", 6)),
    ],
)
def test_the_choice_among_all_estimators_is_by_the_mean_of_both_ways(by_chart, taken):
    both, _ = training()
    rows, _ = cross_validate(both, ("D65",), bases=(6,), estimators=("pinv", "wiener", "broad"), costs=False)
    by_patch = {"pinv": 1.0, "broad": 2.0, "wiener": 8.0}
    rows = [replace(row, score=by_patch[row.estimator]) for row in rows]
    rows += [replace(row, score=by_chart[row.estimator], left_out="chart") for row in rows]
    assert choose(rows, "auto", "auto") == taken


# ---- configuration


def test_a_name_with_capitals_is_no_chart(tmp_path):
    table = tmp_path / "captures.csv"
    table.write_text(
        "file,role,light_deg,camera_deg,filter,exposure_s\na.dng,chart-SG,45,0,out,0.01\n", encoding="utf-8"
    )
    with pytest.raises(InputError, match="line 2, role: found 'chart-SG'"):
        read_captures(table)


def test_the_captures_of_a_camera_are_its_charts(root):
    definitions = two_charts(root)
    assert definitions.captures_of("cameras", "d5100-comb", root) == ["chart", "chart-pmc"]
    shots = camera_shots(definitions.cameras["d5100-comb"], ".dng")
    assert "chart-pmc-in-50000us.dng" in {shot.file for shot in shots}


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [("rows", 4, "further_charts.pmc.rows"), ("patch_px", ..., "further_charts.pmc.patch_px"),
     ("spectra", "PNC", "further_charts.pmc.spectra")],
)  # fmt: skip
def test_a_fault_of_a_further_chart_names_it(root, key, value, field):
    edit(root, CAMERA_FILE, "further_charts", {"pmc": SECOND})
    edit(root, CAMERA_FILE, f"further_charts.pmc.{key}", value)
    assert fault(root).field == field


@pytest.mark.parametrize(
    ("charts", "found"),
    [(["chart"], "no photograph of the role chart-pmc"), (["chart", "chart-pmc", "chart-sg"], "chart-sg"),
     (["chart-pmc"], "no photograph of the role chart")],
)  # fmt: skip
def test_a_real_camera_has_photographs_of_exactly_its_charts(root, charts, found):
    for key in ("virtual", "poses", "exposure_s", "dark_frames", "white_frames", "linearity_exposure_s", "white"):
        edit(root, CAMERA_FILE, key, ...)
    edit(root, CAMERA_FILE, "rig", "copy-stand")
    edit(root, CAMERA_FILE, "captures", {"table": "photographs/captures.csv"})
    edit(root, CAMERA_FILE, "further_charts", {"pmc": SECOND})
    folder = root / "photographs"
    folder.mkdir()
    shots = []
    for chart in charts:
        for state in ("out", "in"):
            (folder / f"{chart}-{state}.dng").write_bytes(b"raw")
            shots.append(
                Shot(f"{chart}-{state}.dng", "chart", Pose(45.0, 0.0), state, 0.02, chart=chart.partition("-")[2])
            )
    write_captures(folder / "captures.csv", shots)
    error = fault(root, scenes=[], cameras=["d5100-comb"])
    assert error.field.startswith("role") and found in error.found
