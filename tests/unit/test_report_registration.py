"""The report's registration residuals: read from the linear files, and summed up for each object."""

import math

import numpy as np
import pytest

from irodori.core import store
from irodori.evaluation.registration_errors import (
    RegistrationSummary,
    measure_registration,
    summarise,
)
from irodori.evaluation.result_tables import RegistrationRow, read_rows
from irodori.ingest.shot_alignment import UNMOVED, Alignment
from irodori.report.html_page import fragment
from irodori.report.page import registrations

MADE = store.Provenance("test", "config", "code")


def linear(folder, name: str, alignment: Alignment | None):
    """Return a file as the ingestion writes its registration; without one for a single filter state."""
    path = folder / f"{name}.h5"
    with store.create(path, MADE) as out:
        out.write("valid", np.ones((2, 2), np.uint8), units="1", dims="row,column", quantity="1 where measured")
        if alignment is not None:
            alignment.write(out)
    return path


def own(residual_px: float) -> Alignment:
    return Alignment((1.6, -0.9, 0.0, 1.0), residual_px, 0.01, "capture")


@pytest.fixture
def table(tmp_path):
    chart = Alignment((1.6, -0.9, 0.0, 1.0), 0.9, 0.4, "chart")
    alignments = [own(0.02), own(0.30), chart, own(0.04), UNMOVED, None]
    files = [linear(tmp_path, f"c{number}", alignment) for number, alignment in enumerate(alignments)]
    measure_registration(files, tmp_path / "registration.csv")
    return tmp_path / "registration.csv"


def test_every_capture_with_two_filter_states_has_a_line_in_the_given_order(table):
    rows = read_rows(table, RegistrationRow)
    assert [(row.capture, row.source) for row in rows] == [
        ("c0", "capture"), ("c1", "capture"), ("c2", "chart"), ("c3", "capture"), ("c4", "none"),
    ]  # fmt: skip
    assert [row.residual_px for row in rows[:4]] == [0.02, 0.30, 0.9, 0.04]
    assert math.isnan(rows[4].residual_px) and math.isinf(rows[4].sigma_px)


def test_residuals_are_those_of_the_captures_with_their_own_transform(table):
    """The chart's residual, larger here, says nothing of a capture that took its transform."""
    assert summarise(read_rows(table, RegistrationRow)) == RegistrationSummary(3, 1, 1, 0.04, 0.30, "c1")


def test_an_object_without_a_registered_capture_has_no_residual(tmp_path):
    measure_registration([linear(tmp_path, "c0", None)], tmp_path / "registration.csv")
    rows = read_rows(tmp_path / "registration.csv", RegistrationRow)
    found = summarise(rows)
    assert rows == [] and found.by_capture == found.by_chart == found.by_none == 0
    assert math.isnan(found.median_px) and math.isnan(found.max_px) and found.worst == ""


def test_captures_that_all_take_the_charts_transform_are_counted_as_that(tmp_path):
    chart = Alignment((1.6, -0.9, 0.0, 1.0), 0.9, 0.4, "chart")
    files = [linear(tmp_path, f"c{number}", one) for number, one in enumerate([chart, chart, UNMOVED])]
    measure_registration(files, tmp_path / "registration.csv")
    found = summarise(read_rows(tmp_path / "registration.csv", RegistrationRow))
    assert (found.by_capture, found.by_chart, found.by_none) == (0, 2, 1)
    assert math.isnan(found.median_px) and found.worst == ""


def test_a_source_that_the_ingestion_does_not_know_is_refused(tmp_path):
    path = linear(tmp_path, "c0", Alignment((0.0, 0.0, 0.0, 1.0), 0.1, 0.1, "guess"))
    with pytest.raises(ValueError, match="accepted: capture, chart, none"):
        measure_registration([path], tmp_path / "registration.csv")


def test_the_page_says_for_each_object_how_many_took_whose_transform_and_what_is_left(table, tmp_path):
    measure_registration([], tmp_path / "none.csv")
    found = registrations(["plate", "leaf"], [table, tmp_path / "none.csv"])
    page = fragment("registration.html.j2", registrations=found)
    cells = "".join(f"<td>{cell}</td>" for cell in ("plate", 3, 1, 1, 0.04, 0.3, "c1"))
    assert f"<tr>{cells}</tr>" in page
    cells = "".join(f"<td>{cell}</td>" for cell in ("leaf", 0, 0, 0, "–", "–", "–"))
    assert f"<tr>{cells}</tr>" in page
