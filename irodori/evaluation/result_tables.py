"""Tables of errors as CSV files: their rows, written and read; what measures them is elsewhere and slow to import."""

import csv
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import TypeVar, get_type_hints

from irodori.core.atomic_files import written_whole

Row = TypeVar("Row")


@dataclass(frozen=True)
class BudgetRow:
    """One line of ``error_budget.csv``: CIEDE2000 of the pixels that show an object, with one part not true.

    ``predicted`` is the mean that what the stages know leads to, NaN where they know nothing; ``by`` says how, or why
    not.
    """

    stage: str
    mean: float
    p95: float
    p99: float
    max: float
    predicted: float
    by: str


@dataclass(frozen=True)
class CostRow:
    """One line of ``imperfections.csv``: the errors of an object's reflectance with one set of faults.

    ``beta`` and ``mu``, of the first gloss component, are medians of the relative error where the fit states them, NaN
    where the truth has no such parameter; ``known`` is the share of observed texels on which it does. Texels at seams
    are left out of all.
    """

    faults: str
    light: str
    count: int
    mean: float
    p95: float
    max: float
    beta: float
    mu: float
    known: float


@dataclass(frozen=True)
class ErrorRow:
    """One line of ``errors.csv``."""

    subject: str
    quantity: str
    light: str
    count: int
    mean: float
    p95: float
    p99: float
    max: float


@dataclass(frozen=True)
class PlanRow:
    """One line of ``planning.csv``: the error of one parameter after fits of photographs in one design.

    Parameters
    ----------
    object : str
    poses : int
    design : str
        ``planned``; ``planned-determinant``, the criterion ``determinant``; ``even-grid`` of as many light angles as
        a plan may have; ``even-one-light``; ``random``, poses of random settings, pooled over some draws.
    parameter : str
        ``alpha``, whose error is absolute; ``beta``, ``mu``, whose errors are relative.
    median, p95 : float
        Of the absolute value of the error where the fit states the parameter.
    identified_fraction : float
        Share of the fits that state it.
    expected_standard_error : float
        Median of what the information promises.
    """

    object: str
    poses: int
    design: str
    parameter: str
    median: float
    p95: float
    identified_fraction: float
    expected_standard_error: float


@dataclass(frozen=True)
class RegistrationRow:
    """One line of an object's ``registration.csv``: one capture that has both filter states.

    Parameters
    ----------
    capture : str
    source : str
        ``capture`` for its own transform; ``chart`` where it had too little content; ``none`` where the chart had too.
    residual_px : float
        Rms of what local blocks still find, superpixels; with the source ``chart`` it is the chart's.
    sigma_px : float
        Predicted standard error of the capture's own transform, superpixels.
    """

    capture: str
    source: str
    residual_px: float
    sigma_px: float


def write_rows(path, kind: type, rows: Iterable) -> None:
    """Write a table whose columns are the fields of a dataclass; a header alone where there is no row.

    Numbers have six significant digits. A row is written as it comes, the file appears once all are.
    """
    with written_whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [field.name for field in fields(kind)])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in asdict(row).items()})


def read_rows(path, kind: type[Row]) -> list[Row]:
    """Return the rows of a table as `write_rows` wrote it."""
    with open(path, newline="", encoding="utf-8") as stream:
        kinds = get_type_hints(kind)
        return [kind(**{key: kinds[key](text) for key, text in row.items()}) for row in csv.DictReader(stream)]
