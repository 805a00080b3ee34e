"""Errors of an estimator on patches left out of its training."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from irodori.calibration.estimators import fit_mapping
from irodori.calibration.paper_estimator import spectral_basis
from irodori.calibration.training import Training, twins
from irodori.colour.colorimetry import delta_e_reflectance

_SINGLE_FOLDS = 32  # patches, up to which each is left out alone
_FOLDS = 12  # of larger charts, every 12th patch together
_GROUPS = 4


def folds(patches: int, charts=None, groups: int | None = None) -> list[np.ndarray]:
    """Return the sets of patches that are left out in turn, as bool arrays (patches,).

    Parameters
    ----------
    patches : int
    charts : (patches,) int, optional
        Number of the chart that each patch belongs to; with several, whole charts are left out. Of one chart up to
        32 patches are left out one by one, of a larger one in 12 groups of every 12th.
    groups : int, optional
        Number of groups in place of the default.
    """
    if charts is not None and np.unique(charts).size > 1:
        return [np.asarray(charts) == chart for chart in np.unique(charts)]
    groups = groups or (patches if patches <= _SINGLE_FOLDS else _FOLDS)
    group = np.arange(patches) % groups
    return [group == number for number in range(group.max() + 1)]


@dataclass(frozen=True)
class Fold:
    """Fold of a cross-validation: the patches that are left out, and the training data of the others.

    Parameters
    ----------
    left_out : (m,) bool
    unseen : (m,) bool
        The patches left out and all patches of the same paint (see `twins`).
    seen : Training
        Training data of the other patches.
    """

    left_out: np.ndarray
    unseen: np.ndarray
    seen: Training


def split(training: Training, sets: list[np.ndarray], least: int = 0, pixel_levels: bool = False) -> list[Fold]:
    """Return a fold for each set of patches (see `folds`) that leaves at least ``least`` patches for training."""
    paint = twins(training.spectra)
    found = []
    for left_out in sets:
        unseen = np.isin(paint, paint[left_out])
        if (~unseen).sum() >= least:
            found.append(Fold(left_out, unseen, training.without(unseen, pixel_levels)))
    return found


def error_of_unseen(training: Training, chosen: tuple[str, int], light: str) -> Callable[[np.ndarray], float]:
    """Return a function that computes the mean CIEDE2000 of patches left out, without pixel noise, from all responses.

    The patches are left out in four groups if enough others remain. The results of this function can be compared with
    each other, but not with those of `cross_validate`.

    Parameters
    ----------
    training : Training
    chosen : (str, int)
        Estimator and number of bases.
    light : str

    Returns
    -------
    callable from responses (m, bands) to a number
    """
    name, bases = chosen
    patches, bands = training.response.shape
    groups = _GROUPS if patches - -(-patches // _GROUPS) >= max(bands, bases) else None
    # Values that depend on the spectra alone are computed once.
    parts = [(fold, spectral_basis(fold.seen.spectra, bases)) for fold in split(training, folds(patches, None, groups))]

    def error(response: np.ndarray) -> float:
        recovered = np.empty_like(training.spectra)
        for fold, basis in parts:
            mapping = fit_mapping(name, fold.seen.answering(response[~fold.unseen])).on_basis(basis)
            weights = np.empty((int(fold.left_out.sum()), bases))
            mapping.weights(response[fold.left_out], None, weights)
            recovered[fold.left_out] = weights @ basis.T
        return float(delta_e_reflectance(training.spectra, recovered, light).mean())

    return error
