"""Spectral recovery: what a calibration is, and how responses become spectra with it [eq. 2, 4]."""
