"""Recoveries of light that have one answer, for tests of what comes before and after them."""

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.light.light_prior import LightPrior
from irodori.light.light_recovery import LightRecovery


def as_it_is(basis: np.ndarray) -> LightRecovery:
    """Return the recovery by a camera whose responses are the weights on a basis (61, r)."""
    one = np.eye(basis.shape[1])[None]
    return LightRecovery(basis, np.zeros((1, *basis.shape)), np.ones(1), one, one)


def prior_of(calibration: Calibration) -> LightPrior:
    """Return the prior that knows a light to be the calibration's times a reflectance on its basis."""
    known = calibration.basis * calibration.light[:, None]
    return LightPrior((known @ known.T)[None], np.ones(1), 1)
