"""Wavelength grid: 61 samples, 400..700 nm in steps of 5 nm, on the last axis of every spectral array."""

import numpy as np

WAVELENGTH_NM = np.arange(400.0, 701.0, 5.0)
SAMPLES = WAVELENGTH_NM.size
STEP_NM = 5.0
#: Grid steps between the wavelengths at which errors of reflectances are stated, and these wavelengths, nm: they are
#: closer than the correlation length of the errors.
ERROR_STRIDE = 4
ERROR_NM = WAVELENGTH_NM[::ERROR_STRIDE]
#: Trapezoidal weights on the grid, nm: ``integral = spectrum @ TRAPEZOID_NM`` [eq. 1].
TRAPEZOID_NM = np.full(SAMPLES, STEP_NM)
TRAPEZOID_NM[[0, -1]] *= 0.5
