"""Spectral recovery: what a calibration is, and how responses become spectra with it [eq. 2, 4]."""

from irodori.recovery.calibration import Calibration
from irodori.recovery.mappings import LinearMapping, LocalMapping, Mapping, PolynomialMapping

__all__ = ["Calibration", "LinearMapping", "LocalMapping", "Mapping", "PolynomialMapping"]
