"""Rows of the tables of errors, and their CSV files.

The code that measures the errors is in other modules, because it is slow to import.
"""

import csv
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import TypeVar, get_type_hints

from irodori.core.atomic_files import written_whole

Row = TypeVar("Row")


@dataclass(frozen=True)
class BudgetRow:
    """One line of ``error_budget.csv``: CIEDE2000 of the pixels that show an object, due to the result of one stage.

    ``predicted`` is the mean that was predicted from the error estimates of the stages, NaN if there are none. ``by``
    is the way it was predicted, or the reason why it was not.
    """

    stage: str
    mean: float
    p95: float
    p99: float
    max: float
    predicted: float
    by: str


@dataclass(frozen=True)
class ErrorRow:
    """One line of ``errors.csv``: statistics of one kind of error of an object, environment, camera or view."""

    subject: str
    quantity: str
    light: str
    count: int
    mean: float
    p95: float
    p99: float
    max: float


@dataclass(frozen=True)
class RegistrationRow:
    """One line of ``registration.csv`` of an object: one capture that was photographed without and with the filter.

    Parameters
    ----------
    capture : str
    source : str
        Source of the transform: ``capture``, estimated from the capture itself; ``chart``, taken from the chart because
        the capture has too little structure; ``none`` if the chart has too little, too.
    residual_px : float
        RMS of the shifts that remain in local blocks, superpixels; with the source ``chart``, those of the chart.
    sigma_px : float
        Predicted standard error of the transform from the capture itself, superpixels.
    """

    capture: str
    source: str
    residual_px: float
    sigma_px: float


def write_rows(path, kind: type, rows: Iterable) -> None:
    """Write a CSV table with the fields of the dataclass ``kind`` as columns; a header alone if there is no row.

    Numbers have six significant digits. Each row is written when the iterable yields it; the file appears under its
    name when all rows are written.
    """
    with written_whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [field.name for field in fields(kind)])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in asdict(row).items()})


def read_rows(path, kind: type[Row]) -> list[Row]:
    """Read the rows of a table that `write_rows` wrote, as instances of the dataclass ``kind``."""
    with open(path, newline="", encoding="utf-8") as stream:
        kinds = get_type_hints(kind)
        return [kind(**{key: kinds[key](text) for key, text in row.items()}) for row in csv.DictReader(stream)]
