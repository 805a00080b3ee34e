"""Camera calibration: equations (2) to (4), and estimators that know more."""

from irodori.calibration.chart import patch_centres, read_chart
from irodori.calibration.estimators import ESTIMATORS, fit
from irodori.calibration.linear import calibrate, leave_one_out, spectral_basis
from irodori.calibration.numerics import Limits, condition_number, noise_amplification
from irodori.calibration.ranking import rank_filters
from irodori.calibration.selection import choose, cross_validate
from irodori.calibration.stage import calibrate_camera
from irodori.calibration.training import Noise, Training

__all__ = [
    "ESTIMATORS",
    "Limits",
    "Noise",
    "Training",
    "calibrate",
    "calibrate_camera",
    "choose",
    "condition_number",
    "cross_validate",
    "fit",
    "leave_one_out",
    "noise_amplification",
    "patch_centres",
    "rank_filters",
    "read_chart",
    "spectral_basis",
]
