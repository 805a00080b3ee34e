"""Camera calibration: estimators of reflectance spectra from camera responses [eq. 2 to 4]."""
