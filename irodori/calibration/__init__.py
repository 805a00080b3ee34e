"""Camera calibration: equations (2) to (4)."""

from irodori.calibration.chart import patch_centres, read_chart
from irodori.calibration.linear import calibrate, leave_one_out, spectral_basis
from irodori.calibration.ranking import rank_filters
from irodori.calibration.stage import calibrate_camera

__all__ = [
    "calibrate",
    "calibrate_camera",
    "leave_one_out",
    "patch_centres",
    "rank_filters",
    "read_chart",
    "spectral_basis",
]
