"""Spectral recovery: what a calibration is, and how responses become spectra with it [eq. 2, 4]."""

from dataclasses import dataclass

import numpy as np

from irodori import store
from irodori.errors import InputError


@dataclass(frozen=True)
class Calibration:
    """What turns responses into spectra: s = B' Mᵀ ρ [eq. 2, 4].

    Parameters
    ----------
    basis : (61, k) float, B'
    weights_from_response : (bands, k) float, M
    light : (61,) float
        E(λ) under which the responses were calibrated.
    filters : tuple of str
        Filter states of the bands, three bands each, in order.
    """

    basis: np.ndarray
    weights_from_response: np.ndarray
    light: np.ndarray
    filters: tuple[str, ...] = ()

    @classmethod
    def load(cls, path) -> "Calibration":
        """Read a calibration file."""
        with store.open_file(path) as file:
            return cls(
                file.read("basis"),
                file.read("weights_from_response"),
                file.read("light"),
                tuple(file.attribute("filters")),
            )

    def require_filters(self, filters, path) -> None:
        """Refuse responses whose bands are not those of the chart.

        Raises
        ------
        InputError
            Naming the file of the responses, its filter states and those of the calibration.
        """
        if tuple(filters) != self.filters:
            found = ", ".join(filters) or "none"
            raise InputError(path, "filters", found, f"{', '.join(self.filters)}, as in the chart's photographs")

    def weights(self, response: np.ndarray) -> np.ndarray:
        """Return basis weights of responses, (..., bands) to (..., k)."""
        return np.asarray(response) @ self.weights_from_response

    def spectra(self, response: np.ndarray) -> np.ndarray:
        """Return recovered reflectance spectra of responses, (..., bands) to (..., 61)."""
        return self.weights(response) @ self.basis.T
