"""Registration quality of the two shots of each capture, without and with the filter."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irodori.core import store
from irodori.evaluation.result_tables import RegistrationRow, write_rows

#: Sources of the transform that registered a capture; see `irodori.ingest.shot_alignment.Alignment`.
SOURCES = ("capture", "chart", "none")


@dataclass(frozen=True)
class RegistrationSummary:
    """Number of captures of an object by source of their transform, and residuals of those with their own transform.

    Parameters
    ----------
    by_capture, by_chart, by_none : int
        Number of captures with each of the `SOURCES`.
    median_px, max_px : float
        Residual of the captures with their own transform, superpixels; NaN if there is none.
    worst : str
        Name of the capture with the largest residual, empty if there is none.
    """

    by_capture: int
    by_chart: int
    by_none: int
    median_px: float
    max_px: float
    worst: str


def measure_registration(linear: Sequence, output) -> None:
    """Write ``registration.csv`` of one object; a header alone if no capture was registered.

    Parameters
    ----------
    linear : sequence of path
        Files of `irodori.ingest.stage.ingest_raw`, each named after its capture.
    output : path

    Raises
    ------
    ValueError
        If a file names a source that is not in `SOURCES`.
    """
    rows = []
    for path in map(Path, linear):
        with store.open_file(path) as file:
            if not file.has_attribute("registration_source"):
                continue
            source = file.attribute("registration_source")
            if source not in SOURCES:
                raise ValueError(f"{path}: registration_source {source!r}; accepted: {', '.join(SOURCES)}")
            residual, sigma = (float(file.attribute(f"registration_{name}_px")) for name in ("residual", "sigma"))
            rows.append(RegistrationRow(path.stem, source, residual, sigma))
    write_rows(output, RegistrationRow, rows)


def summarise(rows: Sequence[RegistrationRow]) -> RegistrationSummary:
    """Summarise the registration of the captures of an object, for the report."""
    by_capture, by_chart, by_none = (sum(row.source == source for row in rows) for source in SOURCES)
    own = [row for row in rows if row.source == "capture"]
    if not own:
        return RegistrationSummary(by_capture, by_chart, by_none, float("nan"), float("nan"), "")
    worst = max(own, key=lambda row: row.residual_px)
    median = float(np.median([row.residual_px for row in own]))
    return RegistrationSummary(by_capture, by_chart, by_none, median, worst.residual_px, worst.capture)
