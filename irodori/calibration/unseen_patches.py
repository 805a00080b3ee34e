"""Patches that are left out of an estimator's training in turn."""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.training import Training, twins

_SINGLE_FOLDS = 32  # patches, up to which each is left out alone
_FOLDS = 12  # of larger charts, every 12th patch together


def folds(patches: int, charts=None) -> list[np.ndarray]:
    """Return the sets of patches that are left out in turn, as bool arrays (patches,).

    Parameters
    ----------
    patches : int
    charts : (patches,) int, optional
        Number of the chart that each patch belongs to; with several, whole charts are left out. Of one chart up to
        32 patches are left out one by one, of a larger one in 12 groups of every 12th.
    """
    if charts is not None and np.unique(charts).size > 1:
        return [np.asarray(charts) == chart for chart in np.unique(charts)]
    group = np.arange(patches) % (patches if patches <= _SINGLE_FOLDS else _FOLDS)
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
