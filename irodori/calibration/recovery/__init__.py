"""Recovery of spectra from responses with a stored calibration [eq. 2, 4]."""
