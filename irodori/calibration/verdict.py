"""Comparison of a calibration's errors with the tolerances of heritage imaging guidelines.

Each tolerance has its source, and a note whether it was read in the guideline or in a secondary source:

* **FADGI 2016**: Federal Agencies Digital Guidelines Initiative, *Technical Guidelines for Digitizing Cultural Heritage
  Materials: Creation of Raster Image Files*, September 2016, table of "Paintings and Other Two-Dimensional Art (Other
  Than Prints)", row "Color Accuracy Mean (ΔE2000)". Read in the document.
* **FADGI 2023**: the same, third edition, May 2023. **Not read in the document**: a search of November 2026 found the
  guideline's page of comments and older editions, but not this text. All figures are those of a published comparison
  (skandalski.pl, "tabela FADGI ISO Metamorfoze", column "FADGI 2023 (Bound General Collections)"). The colour figures
  of four stars, 2 and 4, are also in the source code of arte-profiler, for "Paintings and Other Two-Dimensional Art
  (Other Than Prints)"; the others have one source. Check them before you quote them.
* **Metamorfoze 1.0**: H. van Dormolen, *Metamorfoze Preservation Imaging Guidelines, Image Quality*, version 1.0,
  January 2012, sections 1.2 and 2.10: mean and maximum of CIE 1976 over the patches of the Digital ColorChecker SG,
  with the white of the ICC profile. Read in the document.
* **Metamorfoze 2.0**: **not read in the guideline**. The colour figures are those of the announcement of its draft of
  June 2023 (preservationimaging.com, "Version 2.0"), which says: formula CIE2000 with S_L = 1; Full mean at most 3,
  maximum at most 7; Light 4 and 14. It names none for Extra Light. The figures of tone and white balance are those of
  the comparison above. A draft: the published version may differ.
* **ISO 19264-1:2021**: **not read in the standard**, which is sold; the figures are those of the same comparison. It
  does not name the formula of the colour difference, so the largest value of the three formulas of the other guidelines
  is compared with the limit: a pass holds for each of them, but a failure may be a pass by the standard's own formula.

Tone response and white balance are judged on the chart's neutral patches, those of a CIELAB chroma of at most
`NEUTRAL_CHROMA`; a chart without any has no figure.

The tolerances are for the whole chain up to an encoded picture of the guideline's own target; here they are applied to
recovered reflectances, so passing is necessary and not sufficient. Noise, sharpness, evenness and geometry of the
encoded picture are not judged. CIELAB is computed for D50 and the 2° observer, because D50 is the white of the ICC
profile (eciRGBv2) in which pictures under these guidelines are encoded.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_reflectance

LIGHT = "D50"
#: Largest chroma, in CIELAB, of a patch that counts as neutral.
NEUTRAL_CHROMA = 5.0

_COLOUR, _TONE, _WHITE = "colour accuracy", "tone response", "white balance"
_LIGHTNESS, _CHROMA, _LARGEST = "ΔL*", "Δ(a*, b*)", "largest of the three formulas"


@dataclass(frozen=True)
class Tolerance:
    """One limit of one level of a guideline.

    Parameters
    ----------
    guideline, level : str
    quantity : str
        ``colour accuracy``, ``tone response`` or ``white balance``.
    metric : str
        ``CIEDE2000``, ``CIE 1976``, ``CIEDE2000 S_L=1`` or ``largest of the three formulas`` over all patches;
        ``ΔL*`` or ``Δ(a*, b*)`` over neutral ones.
    statistic : str
        ``mean``, ``p90`` or ``max`` over the patches.
    limit : float
    strict : bool
        Whether the guideline states "below" and not "at most".
    source : str
        Where the limit was read.
    verified : bool
        Whether it was read in the guideline itself.
    """

    guideline: str
    level: str
    quantity: str
    metric: str
    statistic: str
    limit: float
    strict: bool
    source: str
    verified: bool


@dataclass(frozen=True)
class ToleranceCheck:
    """Tolerance, the value in its metric and statistic (NaN without a suitable patch), and whether it passes."""

    tolerance: Tolerance
    measured: float
    passes: bool


@dataclass(frozen=True)
class _Guideline:
    """Common part of the limits of one guideline, and its levels from the strictest on."""

    name: str
    levels: tuple[str, ...]
    strict: bool

    def limits(self, kind: tuple[str, str, str], values: tuple[float, ...], source: str, verified: bool = False):
        """Return the tolerances of a (quantity, metric, statistic), level by level; later levels may have none."""
        return [
            Tolerance(self.name, level, *kind, limit, self.strict, source, verified)
            for level, limit in zip(self.levels, values, strict=False)
        ]


def _tolerances() -> Iterator[Tolerance]:
    comparison = "a published comparison (skandalski.pl, FADGI/ISO/Metamorfoze)"
    stars = ("4 star", "3 star", "2 star", "1 star")
    tone, white = (_TONE, _LIGHTNESS, "max"), (_WHITE, _CHROMA, "max")

    older = _Guideline("FADGI 2016", stars, strict=True)
    table = "September 2016, Paintings and Other Two-Dimensional Art, Color Accuracy Mean"
    yield from older.limits((_COLOUR, "CIEDE2000", "mean"), (2.0, 4.0, 6.0, 10.0), table, True)

    newer = _Guideline("FADGI 2023", stars, strict=True)
    bound = f"{comparison}, column Bound General Collections"
    yield from newer.limits((_COLOUR, "CIEDE2000", "mean"), (2.0, 3.5, 5.0, 6.5), bound)
    yield from newer.limits((_COLOUR, "CIEDE2000", "p90"), (4.0, 7.0, 10.0, 13.0), bound)
    yield from newer.limits(tone, (1.5, 3.0, 4.5, 6.0), bound)
    yield from newer.limits(white, (2.0, 4.0, 6.0, 8.0), bound)

    levels = ("full", "light", "extra light")
    first = _Guideline("Metamorfoze 1.0", levels, strict=False)
    sections = "version 1.0, January 2012, 1.2 and 2.10"
    yield from first.limits((_COLOUR, "CIE 1976", "mean"), (4.0, 5.0, 5.0), sections, True)
    yield from first.limits((_COLOUR, "CIE 1976", "max"), (10.0, 18.0, 18.0), sections, True)

    draft = _Guideline("Metamorfoze 2.0", levels, strict=False)
    announced = "the announcement of the draft of June 2023"
    yield from draft.limits((_COLOUR, "CIEDE2000 S_L=1", "mean"), (3.0, 4.0), announced)
    yield from draft.limits((_COLOUR, "CIEDE2000 S_L=1", "max"), (7.0, 14.0), announced)
    yield from draft.limits(tone, (2.0, 2.0, 4.0), comparison)
    yield from draft.limits(white, (3.0, 3.0, 5.0), comparison)

    standard = _Guideline("ISO 19264-1:2021", ("level A", "level B", "level C"), strict=False)
    unnamed = f"{comparison}, which names no formula"
    yield from standard.limits((_COLOUR, _LARGEST, "mean"), (4.0, 5.0, 5.0), unnamed)
    yield from standard.limits((_COLOUR, _LARGEST, "max"), (10.0, 15.0, 15.0), unnamed)
    yield from standard.limits(tone, (2.0, 3.0, 4.0), comparison)
    yield from standard.limits(white, (3.0, 4.0, 5.0), comparison)


TOLERANCES = tuple(_tolerances())
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
    return differences_of_lab(*_lab(truth, estimate))


def neutral_differences(truth: np.ndarray, estimate: np.ndarray) -> dict[str, np.ndarray]:
    """Return the differences in lightness and in (a*, b*) of the patches that are truly neutral, D50 and 2° observer.

    Parameters
    ----------
    truth, estimate : (n, 61) float

    Returns
    -------
    dict of (m,) float64, by the metric's name; m = 0 where no patch is neutral
    """
    first, second = _lab(truth, estimate)
    neutral = np.hypot(first[:, 1], first[:, 2]) <= NEUTRAL_CHROMA
    lightness, *chroma = np.abs(second - first)[neutral].T
    return {_LIGHTNESS: lightness, _CHROMA: np.hypot(*chroma)}


def _lab(truth, estimate) -> tuple[np.ndarray, np.ndarray]:
    matrix = xyz_from_reflectance(LIGHT)
    white = matrix.sum(axis=1)
    first, second = (lab_from_xyz(np.asarray(values) @ matrix.T, white) for values in (truth, estimate))
    return first, second


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
    """Compare recovered reflectances with every tolerance.

    Parameters
    ----------
    truth, estimate : (n, 61) float
        Measured reflectances of patches, and reflectances recovered by estimators that were trained without the patch.

    Returns
    -------
    list of ToleranceCheck, in the order of `TOLERANCES`

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
    colour = colour_differences(truth, estimate)
    measured = {_LARGEST: np.maximum.reduce(list(colour.values())), **colour, **neutral_differences(truth, estimate)}
    return [_check(line, measured[line.metric]) for line in TOLERANCES]


def _check(line: Tolerance, differences: np.ndarray) -> ToleranceCheck:
    value = float(_STATISTICS[line.statistic](differences)) if len(differences) else math.nan
    return ToleranceCheck(line, value, value < line.limit if line.strict else value <= line.limit)
