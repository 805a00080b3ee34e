"""Camera calibration: equations (2) to (4), and estimators that know more."""
