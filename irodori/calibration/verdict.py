"""Comparison of a calibration's colour errors with the tolerances of heritage imaging guidelines.

* **FADGI 2016**: Federal Agencies Digital Guidelines Initiative, *Technical Guidelines for Digitizing Cultural Heritage
  Materials: Creation of Raster Image Files*, September 2016, table of "Paintings and Other Two-Dimensional Art (Other
  Than Prints)", row "Color Accuracy Mean (ΔE2000)". Read in the document.
* **FADGI 2023**: the same, third edition, May 2023; mean and 90th percentile of CIEDE2000. **Not read in the
  document**: a search of November 2026 found the guideline's page of comments and older editions, but not this text.
  All eight figures are those of a comparison (skandalski.pl, "tabela FADGI ISO Metamorfoze", column "FADGI 2023 (Bound
  General Collections)"); its excerpt read again then ended before the 90th percentile of one star. Those of four
  stars, 2 and 4, stand also in the source of arte-profiler, for "Paintings and Other Two-Dimensional Art (Other Than
  Prints)"; the others have one source. To be checked before they are quoted.
* **Metamorfoze 1.0**: H. van Dormolen, *Metamorfoze Preservation Imaging Guidelines, Image Quality*, version 1.0,
  January 2012, sections 1.2 and 2.10: mean and maximum of CIE 1976 over the patches of the Digital ColorChecker SG,
  with the white of the ICC profile. Read in the document.
* **Metamorfoze 2.0**: **not read in the guideline**, but in the announcement of its draft of June 2023
  (preservationimaging.com, "Version 2.0"), which says: formula CIE2000 with S_L = 1; Full mean at most 3, maximum at
  most 7; Light 4 and 14. It names none for Extra Light; the comparison above has the same four figures and no other.
  A draft: the published version may differ.

The tolerances are for the whole chain up to an encoded picture of the guideline's own target; here they meet recovered
reflectances, so passing is necessary and not sufficient. CIELAB is computed for D50 and the 2° observer, the white of
the ICC profiles (eciRGBv2) in which pictures under these guidelines are encoded.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_reflectance

LIGHT = "D50"


@dataclass(frozen=True)
class Tolerance:
    """One line of a guideline.

    Parameters
    ----------
    guideline, level : str
    metric : str
        ``CIEDE2000``, ``CIE 1976`` or ``CIEDE2000 S_L=1``.
    statistic : str
        ``mean``, ``p90`` or ``max`` over the patches.
    limit : float
    strict : bool
        The guideline says "below" and not "at most".
    source : str
        Edition and table.
    verified : bool
        The figure was read in the guideline itself.
    """

    guideline: str
    level: str
    metric: str
    statistic: str
    limit: float
    strict: bool
    source: str
    verified: bool


@dataclass(frozen=True)
class ToleranceCheck:
    """A tolerance, what was measured in its metric and statistic, and whether that passes."""

    tolerance: Tolerance
    measured: float
    passes: bool


def _fadgi_2016() -> list[Tolerance]:
    source = "September 2016, Paintings and Other Two-Dimensional Art, Color Accuracy Mean"
    return [
        Tolerance("FADGI 2016", f"{stars} star", "CIEDE2000", "mean", limit, True, source, True)
        for stars, limit in ((4, 2.0), (3, 4.0), (2, 6.0), (1, 10.0))
    ]


def _fadgi_2023() -> list[Tolerance]:
    source = "third edition, May 2023, Color Accuracy; from a secondary source"
    return [
        Tolerance("FADGI 2023", f"{stars} star", "CIEDE2000", statistic, limit, True, source, False)
        for stars, mean, p90 in ((4, 2.0, 4.0), (3, 3.5, 7.0), (2, 5.0, 10.0), (1, 6.5, 13.0))
        for statistic, limit in (("mean", mean), ("p90", p90))
    ]


def _metamorfoze() -> list[Tolerance]:
    first, second = "version 1.0, January 2012, 1.2 and 2.10", "version 2.0, draft of June 2023; from its announcement"
    levels = (
        ("Metamorfoze 1.0", "full", "CIE 1976", 4.0, 10.0, first, True),
        ("Metamorfoze 1.0", "light", "CIE 1976", 5.0, 18.0, first, True),
        ("Metamorfoze 1.0", "extra light", "CIE 1976", 5.0, 18.0, first, True),
        ("Metamorfoze 2.0", "full", "CIEDE2000 S_L=1", 3.0, 7.0, second, False),
        ("Metamorfoze 2.0", "light", "CIEDE2000 S_L=1", 4.0, 14.0, second, False),
    )
    return [
        Tolerance(guideline, level, metric, statistic, limit, False, source, verified)
        for guideline, level, metric, mean, largest, source, verified in levels
        for statistic, limit in (("mean", mean), ("max", largest))
    ]


TOLERANCES = (*_fadgi_2016(), *_fadgi_2023(), *_metamorfoze())
_STATISTICS: dict[str, Callable] = {"mean": np.mean, "p90": lambda values: np.percentile(values, 90), "max": np.max}


def colour_differences(truth: np.ndarray, estimate: np.ndarray) -> dict[str, np.ndarray]:
    """Return the differences of reflectances in every metric of the guidelines, D50 and 2° observer.

    Parameters
    ----------
    truth, estimate : (n, 61) float

    Returns
    -------
    dict of (n,) float64, by the metric's name
    """
    matrix = xyz_from_reflectance(LIGHT)
    white = matrix.sum(axis=1)
    first, second = (lab_from_xyz(np.asarray(values) @ matrix.T, white) for values in (truth, estimate))
    return differences_of_lab(first, second)


def differences_of_lab(first: np.ndarray, second: np.ndarray) -> dict[str, np.ndarray]:
    """Return the differences of CIELAB values (n, 3) in every metric of the guidelines.

    CIEDE2000 with S_L = 1 weighs lightness alike at all levels; only the lightness term of its sum of squares differs.
    """
    two_thousand = delta_e(first, second)
    step = second[..., 0] - first[..., 0]
    offset = (0.5 * (first[..., 0] + second[..., 0]) - 50.0) ** 2
    lightness_weight = 1.0 + 0.015 * offset / np.sqrt(20.0 + offset)
    # Rounding may take a difference in lightness alone below zero by some 1e-16.
    others = np.maximum(two_thousand**2 - (step / lightness_weight) ** 2, 0.0)
    return {
        "CIEDE2000": two_thousand,
        "CIE 1976": np.linalg.norm(second - first, axis=-1),
        "CIEDE2000 S_L=1": np.sqrt(others + step**2),
    }


def judge(truth: np.ndarray, estimate: np.ndarray) -> list[ToleranceCheck]:
    """Hold recovered reflectances against every tolerance.

    Parameters
    ----------
    truth, estimate : (n, 61) float
        Measured reflectances of patches, and those recovered of patches that did not train the estimator.

    Returns
    -------
    list of ToleranceCheck, one a line of a guideline, in the order of `TOLERANCES`

    Raises
    ------
    ValueError
        For no patches, shapes that differ, and values that are not finite.
    """
    truth, estimate = np.asarray(truth, dtype=np.float64), np.asarray(estimate, dtype=np.float64)
    if truth.ndim != 2 or truth.shape != estimate.shape or not len(truth):
        raise ValueError(f"reflectances of shapes {truth.shape} and {estimate.shape}; accepted: patches of one shape")
    if not (np.isfinite(truth).all() and np.isfinite(estimate).all()):
        raise ValueError("reflectances that are not finite; accepted: finite reflectances")
    differences = colour_differences(truth, estimate)
    verdicts = []
    for line in TOLERANCES:
        measured = float(_STATISTICS[line.statistic](differences[line.metric]))
        verdicts.append(
            ToleranceCheck(line, measured, measured < line.limit if line.strict else measured <= line.limit)
        )
    return verdicts
