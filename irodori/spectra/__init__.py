"""Wavelength grid, published spectra, and readers for measured spectra.

Every spectral array of the package has the wavelength on its last axis: 61 samples, 400..700 nm, in steps of 5 nm.
"""
