"""Cross-validation, the choice, and the stage that writes both."""

import csv
from dataclasses import replace

import h5py
import numpy as np
import pytest
from made import made
from made_up_camera import patches, system, training
from shortcuts import leave_one_out

from irodori.calibration.estimator_choice import BASES, SelectionRow, choose, cross_validate, safest
from irodori.calibration.estimators import ESTIMATORS, fit
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.stage import calibrate_camera
from irodori.calibration.unseen_patches import folds
from irodori.colour.colorimetry import delta_e_reflectance, spectral_rmse
from irodori.config.models import Camera
from irodori.config.parts import CalibratedCamera
from irodori.core import store
from irodori.core.errors import InputError


@pytest.fixture(scope="module")
def judged():
    """The table of a chart without noise, and what was recovered."""
    return cross_validate(training(), ("D65", "A"))


def test_the_table_has_every_estimator_and_number_of_bases(judged):
    rows, _ = judged
    assert [(r.estimator, r.bases) for r in rows] == [(name, k) for name in ESTIMATORS for k in BASES]
    assert all(set(r.delta_e_mean) == {"D65", "A"} and r.multiply_adds >= 6 * r.bases for r in rows)


def test_errors_are_those_of_patches_left_out(judged):
    rows, recovered = judged
    expected = leave_one_out(training().response, patches(), 6, training().light)
    assert np.allclose(recovered["pinv", 6], expected, atol=1e-8)
    row = next(r for r in rows if (r.estimator, r.bases) == ("pinv", 6))
    delta_e = delta_e_reflectance(patches(), expected, "A")
    assert row.delta_e_mean["A"] == pytest.approx(delta_e.mean(), rel=1e-6)
    assert row.delta_e_max["A"] == pytest.approx(delta_e.max(), rel=1e-6)
    assert row.rmse_mean == pytest.approx(spectral_rmse(patches(), expected).mean(), rel=1e-6)


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_a_patch_has_no_say_in_its_own_recovery(judged, name):
    chart = training()
    spectra = chart.spectra.copy()
    spectra[5] = np.linspace(0.8, 0.1, 61)
    _, spoiled = cross_validate(replace(chart, spectra=spectra), ("D65",), bases=(6,), estimators=(name,))
    change = np.abs(spoiled[name, 6] - judged[1][name, 6]).max(axis=1)
    assert change[5] <= 1e-12
    assert np.delete(change, 5).min() > 1e-7


def test_charts_are_left_out_whole():
    charts = np.repeat([0, 1, 2], [5, 9, 10])
    assert [int(f.sum()) for f in folds(24, charts)] == [5, 9, 10]
    assert all(len(np.unique(charts[f])) == 1 for f in folds(24, charts))
    assert len(folds(24, np.zeros(24))) == len(folds(24)) == 24
    parts = folds(140)
    assert len(parts) == 12 and (np.sum(parts, axis=0) == 1).all()


def test_noise_of_a_pixel_counts_in_the_choice(judged):
    quiet, _ = judged
    loud, _ = cross_validate(training(0.01), ("D65",))
    score = {key: {(r.estimator, r.bases): r.score for r in rows} for key, rows in (("quiet", quiet), ("loud", loud))}
    assert score["loud"]["pinv", 6] >= score["quiet"]["pinv", 6] + 1.0
    assert score["loud"]["wiener", 6] <= 0.7 * score["loud"]["pinv", 6]
    assert (safest(training(0.001)), safest(training(0.01)), safest(training(0.0, known=False))) == (
        "broad", "local", "broad"
    )  # fmt: skip


def row(name: str, bases: int, score: float, cost: int) -> SelectionRow:
    return SelectionRow(name, bases, score, {}, {}, {}, 0.0, 0.0, cost)


def test_the_smallest_score_is_chosen_and_the_cheaper_of_equals():
    rows = [row("pinv", 6, 1.0, 36), row("wiener", 6, 0.5, 36), row("local", 6, 0.5 - 1e-9, 900),
            row("local", 8, 0.4, 1200)]  # fmt: skip
    assert choose(rows, "auto", "auto") == ("local", 8)
    assert choose(rows, "auto", 6) == ("wiener", 6)
    assert choose(rows, "local", "auto") == ("local", 8)
    assert choose(rows, "pinv", 6) == ("pinv", 6)
    with pytest.raises(ValueError, match="unknown estimator 'best'; accepted: auto, pinv, ridge"):
        choose(rows, "best", 6)
    with pytest.raises(ValueError, match="accepted: 6, 8"):
        choose(rows, "auto", 7)


def test_the_choice_is_the_widest_prior_unless_the_chart_clearly_contradicts_it():
    rows = [row("ridge", 6, 0.8, 36), row("kernel", 6, 0.9, 36), row("broad", 6, 1.1, 36), row("broad", 8, 1.0, 48)]
    assert choose(rows, "auto", "auto") == ("broad", 8)
    assert choose(rows, "auto", 6) == ("broad", 6)
    assert choose(rows, "kernel", "auto") == ("kernel", 6)
    assert choose(rows, "auto", "auto", "kernel") == ("kernel", 6)
    assert choose([*rows, row("local", 6, 0.69, 900)], "auto", "auto") == ("local", 6)


# ---- the stage


def photograph(path, noise_model=None):
    """Write a chart of 4 x 6 patches as its linear file and return what the stage needs."""
    picture = np.kron((patches() @ system().T).reshape(4, 6, 6), np.ones((10, 10, 1))).astype(np.float32)
    with store.create(path, store.Provenance("test")) as out:
        out.write("response", picture, units="1", dims="row,column,band", quantity="response")
        out.write("valid", np.ones((40, 60), np.uint8), units="1", dims="row,column", quantity="valid")
        if noise_model is not None:
            out.write("noise_model", noise_model, units="1", dims="band,term", quantity="variance c0 + c1 rho")
        out.attribute("pose_deg", [0.0, 0.0, 0.0, 0.0])
        out.attribute("sample_px", 2)
        out.attribute("filters", ["out", "in"])
    corners = {"first": [5, 5], "row_end": [55, 5], "column_end": [5, 35], "last": [55, 35]}
    return {"spectra": "BabelColor Average", "rows": 4, "columns": 6, "patch_px": 6, "centres_px": corners}


def run(folder, settings: dict, noise_model=None, name="a"):
    """Run the stage and return its three outputs."""
    chart = photograph(folder / "chart.h5", noise_model)
    outputs = [folder / f"{name}.h5", folder / f"{name}.csv", folder / f"{name}-selection.csv"]
    camera = {"chart": chart, "calibration": settings}
    calibrate_camera(
        folder / "chart.h5",
        made(Camera | CalibratedCamera, camera),
        "A",
        *outputs[:2],
        store.Provenance("test"),
        selection=outputs[2],
    )
    return outputs


def contents(path) -> dict:
    """Return every dataset and attribute of a file."""
    found = {}
    with h5py.File(path) as file:
        found.update(file.attrs)
        file.visititems(
            lambda n, item: found.update({n: item[()].tobytes()}) if isinstance(item, h5py.Dataset) else None
        )
    return found


@pytest.mark.default_cases(2)
@pytest.mark.parametrize(("estimator", "bases"), [("pinv", 6), ("auto", "auto"), ("kernel", 4), ("auto", 5)])
def test_the_stage_records_its_choice_and_the_whole_table(tmp_path, estimator, bases):
    noise = np.tile([1e-7, 1e-5], (6, 1))
    output, errors, selection = run(tmp_path, {"estimator": estimator, "bases": bases}, noise)
    with selection.open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert len(table) == len(ESTIMATORS) * len(BASES)
    (chosen,) = [line for line in table if line["chosen"] == "1"]
    loaded = Calibration.load(output)
    assert (chosen["estimator"], int(chosen["bases"])) == (loaded.estimator, loaded.basis.shape[1])
    assert estimator in ("auto", loaded.estimator) and bases in ("auto", loaded.basis.shape[1])
    allowed = [line for line in table if loaded.estimator == line["estimator"]
               and bases in ("auto", int(line["bases"]))]  # fmt: skip
    assert float(chosen["score"]) == min(float(line["score"]) for line in allowed)
    assert all(float(line["evaluation_ns_per_pixel"]) > 0 for line in table)
    with store.open_file(output) as file:
        assert file.attribute("condition_number") > 1 and file.attribute("noise_amplification") > 0
    assert len(errors.read_text().splitlines()) == 1 + 24 + 3
    assert np.abs(loaded.spectra(patches() @ system().T) - patches()).mean() <= 0.03


def test_calibrations_are_the_same_to_the_bit(tmp_path):
    settings = {"estimator": "auto", "bases": "auto"}
    first, second = (run(tmp_path, settings, np.tile([1e-7, 1e-5], (6, 1)), name) for name in "ab")
    assert contents(first[0]) == contents(second[0])
    assert first[1].read_bytes() == second[1].read_bytes()
    rows = [[line.rsplit(",", 1)[0] for line in paths[2].read_text().splitlines()] for paths in (first, second)]
    assert rows[0] == rows[1]


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"estimator": "pinv", "bases": 6, "max_condition": 10.0}, "condition number .* accepted: up to 10"),
        ({"estimator": "pinv", "bases": 6, "max_noise_amplification": 0.01}, "amplifies the noise of band .*filter"),
        ({"estimator": "best", "bases": 6}, "unknown estimator 'best'; accepted: auto, pinv"),
        ({"estimator": "wiener", "bases": 30}, "30 bases of 24 patches; accepted"),
    ],
)
def test_the_stage_refuses_beyond_the_limits_and_writes_nothing(tmp_path, settings, reason):
    with pytest.raises(InputError, match=reason):
        run(tmp_path, settings)
    assert [path.name for path in tmp_path.iterdir()] == ["chart.h5"]


def test_a_chart_that_stands_on_its_head_is_refused(tmp_path):
    chart = photograph(tmp_path / "chart.h5", None)
    corners = chart["centres_px"]
    turned = dict(zip(("first", "row_end", "column_end", "last"),
                      (corners[k] for k in ("last", "column_end", "row_end", "first")), strict=True))  # fmt: skip
    camera = {"chart": chart | {"centres_px": turned}, "calibration": {"estimator": "pinv", "bases": 6}}
    with pytest.raises(InputError, match="when the chart is read turned"):
        calibrate_camera(
            tmp_path / "chart.h5",
            made(Camera | CalibratedCamera, camera),
            "A",
            tmp_path / "c.h5",
            tmp_path / "c.csv",
            store.Provenance("test"),
        )
    assert not (tmp_path / "c.h5").exists()


def test_the_noise_of_the_linear_file_is_used(tmp_path):
    settings = {"estimator": "wiener", "bases": 6}
    loud = Calibration.load(run(tmp_path, settings, np.tile([1e-4, 0.0], (6, 1)))[0])
    chart = training()
    # What is recovered is a mean over 16 photographs where the definition does not say.
    known = fit("wiener", replace(chart, noise=replace(chart.noise, pixel=np.full(6, 1e-4 / 16),
                                                       patch=np.zeros(6))), 6)  # fmt: skip
    assert np.allclose(loud.weights_from_response, known.weights_from_response, rtol=1e-3, atol=1e-3)
    unknown = Calibration.load(run(tmp_path, settings, np.full((6, 2), np.nan), "b")[0])
    assert np.linalg.norm(loud.weights_from_response) <= 0.8 * np.linalg.norm(unknown.weights_from_response)
