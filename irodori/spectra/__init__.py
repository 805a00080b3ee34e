"""Spectral grid and measured spectra.

Every spectral array of the package has the wavelength on its last axis: 61 samples, 400..700 nm, step 5 nm.
"""
