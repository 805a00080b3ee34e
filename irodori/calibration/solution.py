"""Solution of a calibration: the configured estimator, or the one chosen by cross-validation."""

from dataclasses import dataclass, replace

import numpy as np

from irodori.calibration.conditioning import condition_number, noise_amplification
from irodori.calibration.estimator_choice import BASES, SelectionRow, choose, cross_validate, safest
from irodori.calibration.estimators import ESTIMATORS, fit
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.training import Training
from irodori.config.models import CalibrationOptions
from irodori.core.progress import LOGGER

_AUTO = "auto"


@dataclass(frozen=True)
class Solution:
    """Calibration, the cross-validation table that it was chosen from, and recovered spectra of patches left out.

    ``recovered``, (m, 61), has each patch left out; ``recovered_by_chart`` has its whole chart left out, and is None if
    there is one chart or no chart can be left out.
    """

    calibration: Calibration
    rows: list[SelectionRow]
    chosen: tuple[str, int]
    recovered: np.ndarray
    recovered_by_chart: np.ndarray | None
    numbers: dict[str, float]


def solve(
    training: Training, settings: CalibrationOptions, filters: tuple[str, ...], lights, timed: bool, charts=None
) -> Solution:
    """Cross-validate estimators, choose one and fit it to all patches.

    ``charts``, (m,) int, is the number of the chart of each patch; None stands for a single chart.

    Raises
    ------
    ValueError
        If the settings or the responses allow no calibration.
    """
    bases = _bases_of(settings, training.response.shape[1])
    rows, recovered, by_chart = _judge(training, (settings.estimator, bases), lights, timed, charts)
    chosen = choose(rows, settings.estimator, bases, safest(training))
    calibration = replace(fit(chosen[0], training, chosen[1], settings.max_condition), filters=filters)
    numbers = {
        "condition_number": condition_number(training.response),
        "noise_amplification": noise_amplification(calibration),
    }
    return Solution(calibration, rows, chosen, recovered[chosen], by_chart.get(chosen), numbers)


def _bases_of(settings: CalibrationOptions, bands: int) -> int | str:
    """Return the configured number of bases; by default ``auto`` for the estimator ``auto``, else that of the bands."""
    if settings.bases is not None:
        return settings.bases
    return _AUTO if settings.estimator == _AUTO else bands


def _judge(training: Training, asked: tuple[str, int | str], lights, timed: bool, charts):
    """Return the cross-validation table, and the recovered spectra with patches and with whole charts left out.

    The table has all estimators and numbers of bases if it will be written (``timed``) or the choice is open. Patches
    are left out in turn; if there are several charts, further rows have whole charts left out.
    """
    estimator, bases = asked
    if estimator not in (_AUTO, *ESTIMATORS):
        raise ValueError(f"unknown estimator {estimator!r}; accepted: {_AUTO}, {', '.join(ESTIMATORS)}")
    tried = BASES if timed or bases == _AUTO else ()
    counts = sorted({*tried, *(() if bases == _AUTO else (bases,))})
    names = tuple(ESTIMATORS) if timed or estimator == _AUTO else (estimator,)
    rows, recovered = cross_validate(training, lights, bases=counts, timed=timed, estimators=names)
    if bases != _AUTO and not any(row.bases == bases for row in rows):
        accepted = max((row.bases for row in rows), default=0)
        raise ValueError(f"{bases} bases of {len(training.spectra)} patches; accepted: up to {accepted}")
    if charts is None or np.unique(charts).size < 2:
        return rows, recovered, {}
    others, by_chart = cross_validate(training, lights, charts=charts, bases=counts, estimators=names, costs=False)
    costs = {(r.estimator, r.bases): {k: getattr(r, k) for k in ("multiply_adds", "ns_per_pixel")} for r in rows}
    rows += [replace(row, **costs[row.estimator, row.bases]) for row in others]
    if not others:
        LOGGER.warning("no chart can be left out: the others would leave fewer patches than bands or bases")
    return rows, recovered, by_chart
