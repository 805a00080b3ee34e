"""Cross-validation of every estimator and number of bases, and the choice among them."""

import time
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from threadpoolctl import threadpool_limits

from irodori.calibration.estimators import ESTIMATORS, fit_mapping
from irodori.calibration.paper_estimator import spectral_basis
from irodori.calibration.recovery.mappings import Mapping
from irodori.calibration.training import Training
from irodori.calibration.unseen_patches import Fold, folds, split
from irodori.colour.colorimetry import delta_e_reflectance, spectral_rmse

BASES = (3, 4, 5, 6, 7, 8, 10, 12)
LEFT_OUT = ("patch", "chart")
#: Estimators that are one matrix, and those that are not.
KINDS = {"linear": ("pinv", "ridge", "wiener"), "non-linear": ("local", "kernel", "broad")}
_NOISY = 0.002  # of the chart's largest response: noise of a texel from which an estimator that uses it is preferred
_CONTRADICTED = 0.7  # of the score of the preferred estimator: another one below that replaces it
_RMSE_WEIGHT = 50.0  # CIEDE2000 that a spectral RMSE of one counts for in the score: 0.02 is as bad as 1
_TIMED_PIXELS = 1024


@dataclass(frozen=True)
class SelectionRow:
    """Errors of one estimator and number of bases on patches that it has not seen.

    Parameters
    ----------
    estimator : str
    bases : int
    score : float
        Mean CIEDE2000 over the lights plus 50 times the mean spectral RMSE, with the noise of a pixel where known.
    delta_e_mean, delta_e_p95, delta_e_max : dict of str to float
        By light.
    rmse_mean, rmse_max : float
    multiply_adds : int
        Operations per pixel, see `irodori.calibration.recovery.mappings.Mapping`.
    ns_per_pixel : float
        Measured time in double precision; NaN if not measured. It does not affect the choice.
    left_out : str
        ``patch`` or ``chart``: what was left out in turn.
    """

    estimator: str
    bases: int
    score: float
    delta_e_mean: dict[str, float]
    delta_e_p95: dict[str, float]
    delta_e_max: dict[str, float]
    rmse_mean: float
    rmse_max: float
    multiply_adds: int
    ns_per_pixel: float = float("nan")
    left_out: str = "patch"


def cross_validate(
    training: Training,
    lights=("D65", "A"),
    *,
    charts=None,
    bases=BASES,
    timed: bool = False,
    estimators=tuple(ESTIMATORS),
    costs: bool = True,
) -> tuple[list[SelectionRow], dict[tuple[str, int], np.ndarray]]:
    """Return the errors of every estimator and number of bases, and the spectra that each recovers of unseen patches.

    If the noise of a pixel is known, every patch left out is also recovered from two responses for each band, √bands
    standard deviations above and below the measured one: together they have the second moments of the noise. Score and
    errors are then means over these. ``local`` receives their variance, as it does for the texels of a material.

    Parameters
    ----------
    training : Training
    lights : sequence of str
    charts : see `folds`
        A chart is never left out if fewer patches than bands or bases would remain; if no chart can be left out, the
        results are empty. Patches of the same paint (see `twins`) are left out together.
    bases : sequence of int
        Numbers of bases; those above the number of training patches in the smallest fold are skipped.
    timed : bool
        Whether evaluation is timed.
    estimators : sequence of str
        Names of the estimators to judge.
    costs : bool
        Whether to train the estimators on all patches too, for ``multiply_adds`` (otherwise 0) and times.

    Returns
    -------
    rows : list of SelectionRow, by estimator, then bases; empty if no chart can be left out
    recovered : dict of (estimator, bases) to (m, 61) float64, without noise; NaN for patches that are never left out
    """
    by_chart = charts is not None and np.unique(charts).size > 1
    sets = folds(len(training.spectra), charts)
    offsets = _noise_offsets(training)
    least = max(*bases, training.response.shape[1]) if by_chart else 0
    with threadpool_limits(1):  # small matrices, and the same sums whatever the threads
        parts = split(training, sets, least, pixel_levels=len(offsets) > 1)
        if not parts:
            return [], {}
        smallest = min(len(part.seen.spectra) for part in parts)
        fitting = [count for count in bases if count <= smallest]
        if not fitting:
            raise ValueError(f"{min(bases)} bases of {len(training.spectra)} patches; accepted: up to {smallest}")
        recovered = _recover(training, parts, offsets, fitting, estimators)
        judged = np.any([part.left_out for part in parts], axis=0)
        kind = LEFT_OUT[by_chart]
        rows = [
            _row(training.spectra[judged], key, values[:, judged], lights, kind) for key, values in recovered.items()
        ]
        if costs:
            rows = _with_costs(rows, training, len(offsets) > 1, timed)
    return rows, {key: values[0] for key, values in recovered.items()}


def _recover(training: Training, parts: list[Fold], offsets, bases, estimators) -> dict[tuple[str, int], np.ndarray]:
    """Return spectra (offsets, m, 61) of patches left out, NaN where never left out, by estimator and bases."""
    recovered = {
        (name, count): np.full((len(offsets), *training.spectra.shape), np.nan)
        for name in estimators
        for count in bases
    }
    for part in parts:
        largest = spectral_basis(part.seen.spectra, max(bases))
        queries = (training.response[part.left_out] + offsets[:, None]).reshape(-1, training.response.shape[1])
        for name in estimators:
            mapping = fit_mapping(name, part.seen).on_basis(largest)
            coefficients = np.empty((len(queries), largest.shape[1]))
            # The patches as they were read come first; the others are pixels.
            read = int(part.left_out.sum())
            mapping.weights(queries[:read], None, coefficients[:read])
            if training.noise.pixel is not None and len(offsets) > 1:
                variance = np.broadcast_to(training.noise.pixel, queries[read:].shape)
                mapping.weights(queries[read:], variance, coefficients[read:])
            for count in bases:
                # The bases are nested and orthonormal: the first of many weights are those of few.
                spectra = coefficients[:, :count] @ largest[:, :count].T
                recovered[name, count][:, part.left_out] = spectra.reshape(len(offsets), -1, spectra.shape[1])
    return recovered


def _with_costs(rows: list[SelectionRow], training: Training, stated: bool, timed: bool) -> list[SelectionRow]:
    """Return the rows with the costs per pixel of the estimators after training on all patches."""
    full = spectral_basis(training.spectra, max(row.bases for row in rows))
    whole = {name: fit_mapping(name, training).on_basis(full) for name in dict.fromkeys(row.estimator for row in rows)}
    done = []
    for row in rows:
        mapping = whole[row.estimator].on_basis(np.eye(full.shape[1])[:, : row.bases])
        ns = _evaluation_ns(mapping, training, row.bases, stated) if timed else float("nan")
        done.append(replace(row, multiply_adds=mapping.multiply_adds(), ns_per_pixel=ns))
    return done


def scores_of(rows: list[SelectionRow]) -> dict[tuple[str, int], float]:
    """Return the score of each estimator and number of bases, the mean of those with patches and with charts left out.

    Combinations that do not have a score for each of these are omitted.
    """
    by_key: dict[tuple[str, int], list[float]] = {}
    for row in rows:
        by_key.setdefault((row.estimator, row.bases), []).append(row.score)
    ways = len({row.left_out for row in rows})
    return {key: sum(scores) / ways for key, scores in by_key.items() if len(scores) == ways}


def best_of(rows: list[SelectionRow], estimators: tuple[str, ...]) -> dict | None:
    """Return ``estimator``, ``bases`` and ``score`` of the best of some estimators; None if none has a score."""
    scores = {key: score for key, score in scores_of(rows).items() if key[0] in estimators}
    if not scores:
        return None
    best = min(scores, key=scores.__getitem__)
    return {"estimator": best[0], "bases": best[1], "score": scores[best]}


def safest(training: Training) -> str:
    """Return the estimator that ``auto`` prefers, by the noise of a texel, unless cross-validation contradicts it.

    Cross-validation on a chart favours estimators that assume paints, and matrices, because its patches are paints. On
    other objects ``broad`` has the smallest errors at low noise, and ``local``, which uses the noise, at higher noise.
    """
    known = training.noise.pixel is not None
    return "local" if known and sqrt(np.mean(training.pixel_variance)) >= _NOISY else "broad"


def choose(rows: list[SelectionRow], estimator: str, bases: int | str, preferred: str = "broad") -> tuple[str, int]:
    """Return the estimator and number of bases with the smallest score among those that the configuration allows.

    The score is the mean of those with patches left out and, if there are several charts, with charts left out. If the
    estimator is ``auto``, the preferred one is chosen unless the smallest score is below 0.7 of the preferred one's.

    Parameters
    ----------
    rows : list of SelectionRow
    estimator : str
        A name, or ``auto``.
    bases : int or str
        A number, or ``auto``.
    preferred : str
        See `safest`.

    Raises
    ------
    ValueError
        For an unknown estimator, or where the table has no row that fits.
    """
    if estimator != "auto" and estimator not in ESTIMATORS:
        raise ValueError(f"unknown estimator {estimator!r}; accepted: auto, {', '.join(ESTIMATORS)}")
    if "auto" not in (estimator, bases):
        return estimator, int(bases)
    scores, cost = scores_of(rows), {(r.estimator, r.bases): r.multiply_adds for r in rows}
    fitting = [key for key in scores if estimator in ("auto", key[0]) and bases in ("auto", key[1])]
    if not fitting:
        accepted = ", ".join(str(n) for n in sorted({r.bases for r in rows}))
        raise ValueError(f"{bases} bases with estimator {estimator}; accepted: {accepted}")

    def smallest(keys: list[tuple[str, int]]) -> tuple[str, int]:
        # Rounded, so that equal errors go to the simpler estimator and the fewer bases whatever the last bits are.
        return min(keys, key=lambda key: (round(scores[key], 6), cost[key]))

    best = smallest(fitting)
    safe = [key for key in fitting if key[0] == preferred]
    if estimator == "auto" and safe and scores[best] >= _CONTRADICTED * scores[smallest(safe)]:
        return smallest(safe)
    return best


def _noise_offsets(training: Training) -> np.ndarray:
    """Return the offsets of a response that represent its noise, (1 or 1 + 2 bands, bands); the first row is zero."""
    bands = training.response.shape[1]
    if training.noise.pixel is None or not np.any(training.noise.pixel):
        return np.zeros((1, bands))
    step = np.diag(np.sqrt(training.noise.pixel)) * sqrt(bands)
    return np.concatenate([np.zeros((1, bands)), step, -step])


def _row(spectra: np.ndarray, key: tuple[str, int], recovered: np.ndarray, lights, left_out: str) -> SelectionRow:
    # Responses without noise are judged only if there are none with noise.
    judged = recovered[1:] if len(recovered) > 1 else recovered
    truth = np.broadcast_to(spectra, judged.shape)
    rmse = spectral_rmse(truth, judged)
    delta_e = {light: delta_e_reflectance(truth, judged, light) for light in lights}
    colour = float(np.mean([values.mean() for values in delta_e.values()]))
    return SelectionRow(
        *key,
        score=colour + _RMSE_WEIGHT * float(rmse.mean()),
        delta_e_mean={light: float(values.mean()) for light, values in delta_e.items()},
        delta_e_p95={light: float(np.percentile(values, 95)) for light, values in delta_e.items()},
        delta_e_max={light: float(values.max()) for light, values in delta_e.items()},
        rmse_mean=float(rmse.mean()),
        rmse_max=float(rmse.max()),
        multiply_adds=0,
        left_out=left_out,
    )


def _evaluation_ns(mapping: Mapping, training: Training, bases: int, stated: bool) -> float:
    """Return the shortest time of three evaluations, ns per pixel, after compilation; with variances if ``stated``.

    The evaluation has double precision, as cross-validation has: single precision, in which a material is recovered,
    would compile every loop once more for these figures alone.
    """
    pixels = np.resize(training.response, (_TIMED_PIXELS, training.response.shape[1]))
    variance = np.broadcast_to(np.float64(training.noise.pixel), pixels.shape).copy() if stated else None
    out = np.empty((_TIMED_PIXELS, bases))
    mapping.weights(pixels, variance, out)
    best = float("inf")
    for _ in range(3):
        start = time.perf_counter()
        mapping.weights(pixels, variance, out)
        best = min(best, time.perf_counter() - start)
    return 1e9 * best / _TIMED_PIXELS
