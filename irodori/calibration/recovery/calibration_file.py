"""Calibration files: loading, and application to pictures."""

from dataclasses import dataclass, fields

import numpy as np

from irodori.calibration.recovery.mappings import KINDS, LinearMapping, Mapping
from irodori.core import store
from irodori.core.errors import InputError
from irodori.spectra.coordinates import write_bands, write_wavelength
from irodori.spectra.grid import SAMPLES
from irodori.spectra.published import NAMED_LAMP_ERROR

_UNITS = {"units": "1", "quantity": "parameter of the mapping from responses to weights"}
_AXES = {
    "scale": "band",
    "anchors": "anchor,band",
    "levels": "level",
    "maps": "interval,anchor,band,component",  # one more than levels: below, between and above them
    "coefficients": "monomial,component",
}
_MATRIX = "weights_from_response"
_COVARIANCE = "band_response_covariance"
_OPTIONAL = {"chart_response": "patch,band", "band_response": "band,wavelength",
             "band_response_covariance": "band,wavelength,other_band,other_wavelength"}  # fmt: skip


@dataclass(frozen=True)
class Calibration:
    """Map from responses to spectra; for linear estimators s = B' Mᵀ ρ [eq. 2, 4].

    Parameters
    ----------
    basis : (61, k) float, B', orthonormal columns
    mapping : Mapping
        From responses to weights on the basis; ``LinearMapping(M)`` where the estimator is linear.
    light : (61,) float
        E(λ) under which the responses were calibrated.
    filters : tuple of str
        Filter states of the bands, three bands each, in order.
    estimator : str
        Name of the estimator.
    training : (m, bands) float, optional
        Responses of the chart, for `band_scale`.
    band_response : (bands, 61) float, optional
        Response per unit reflectance at each wavelength, estimated from the chart.
    band_response_covariance : (bands, 61, bands, 61) float, optional
        Posterior covariance of the band response.
    light_error : float
        Standard deviation of smooth relative differences of the real light from ``light``.
    level : tuple of float
        Response of a perfect diffuser in each band by the chart's spectra, where the white reference gives 1; empty
        without a white reference. `irodori.calibration.stage` writes it.
    """

    basis: np.ndarray
    mapping: Mapping
    light: np.ndarray
    filters: tuple[str, ...] = ()
    estimator: str = "pinv"
    training: np.ndarray | None = None
    band_response: np.ndarray | None = None
    band_response_covariance: np.ndarray | None = None
    light_error: float = NAMED_LAMP_ERROR
    level: tuple[float, ...] = ()

    @property
    def weights_from_response(self) -> np.ndarray | None:
        """Matrix M, (bands, k) float; None if the estimator is not linear."""
        return self.mapping.matrix if isinstance(self.mapping, LinearMapping) else None

    @classmethod
    def load(cls, path) -> "Calibration":
        """Read a calibration file.

        Raises
        ------
        InputError
            If the file is not a calibration, is damaged, of an unknown kind, has datasets that do not fit together, or
            a number that is not finite.
        """
        with store.open_file(path) as file:
            kind = file.attribute("mapping", str) if file.has_attribute("mapping") else LinearMapping.kind
            if kind not in KINDS:
                raise InputError(path, "mapping", repr(kind), f"one of: {', '.join(KINDS)}")
            axes = {"basis": "wavelength,component", "light": "wavelength"}
            optional = {name: dims for name, dims in _OPTIONAL.items() if name in file}
            axes |= optional
            own = fields(KINDS[kind]) if kind != LinearMapping.kind else ()
            axes |= {f"mapping/{field.name}": _AXES[field.name] for field in own if field.name in _AXES}
            file.require_axes(axes if own else axes | {_MATRIX: "band,component"}, wavelength=SAMPLES)
            if not own:
                values = {"matrix": file.read_within(_MATRIX)}
            else:
                values = {}
                for field in own:
                    name = f"mapping/{field.name}"
                    in_dataset = field.name in _AXES
                    values[field.name] = (
                        file.read_within(name) if in_dataset else file.attribute(field.name, (float, int))
                    )
            light_error = (
                file.attribute("light_error", float) if file.has_attribute("light_error") else NAMED_LAMP_ERROR
            )
            if not 0.0 <= light_error < 1.0:
                raise InputError(path, "light_error", f"{light_error:g}", "a number from 0 to below 1")
            known = {name: file.read_within(name) for name in optional}
            return cls(
                file.read_within("basis"),
                KINDS[kind](**values),
                file.read_within("light"),
                tuple(file.attribute("filters", list)),
                file.attribute("estimator", str) if file.has_attribute("estimator") else "pinv",
                known.get("chart_response"),
                known.get("band_response"),
                known.get(_COVARIANCE),
                light_error,
                tuple(file.attribute("level", list)) if file.has_attribute("level") else (),
            )

    def write(self, out: store.Writer) -> None:
        """Write the calibration into an open file, in the form that `load` reads."""
        write_wavelength(out)
        if self.filters:
            write_bands(out, self.filters)
        out.write("basis", self.basis, units="1", dims="wavelength,component", quantity="spectral basis B'")
        if self.weights_from_response is not None:
            matrix = self.weights_from_response
            out.write(
                "weights_from_response", matrix, units="1", dims="band,component", quantity="matrix M of equation (4)"
            )
        else:
            for field in fields(self.mapping):
                value = getattr(self.mapping, field.name)
                if field.name in _AXES:
                    out.write(f"mapping/{field.name}", value, dims=_AXES[field.name], **_UNITS)
                else:
                    out.attribute(field.name, float(value))
        out.write("light", self.light, units="1", dims="wavelength", quantity="relative power of the light")
        if self.training is not None:
            out.write(
                "chart_response", self.training, units="1", dims="patch,band", quantity="responses P of the chart"
            )
        if self.band_response is not None:
            quantity = "response per unit reflectance at each wavelength"
            out.write("band_response", self.band_response, units="1", dims="band,wavelength", quantity=quantity)
        if self.band_response_covariance is not None:
            quantity, dims = "covariance of the response per unit reflectance", _OPTIONAL[_COVARIANCE]
            out.write(_COVARIANCE, self.band_response_covariance, units="1", dims=dims, quantity=quantity)
        out.attribute("light_error", self.light_error)
        out.attribute("level", list(self.level))
        out.attribute("filters", list(self.filters))
        out.attribute("estimator", self.estimator)
        out.attribute("mapping", self.mapping.kind)

    def require_filters(self, filters, path) -> None:
        """Raise an error for responses with other bands than those of the chart.

        Raises
        ------
        InputError
            The message names the file of the responses, its filter states and those of the calibration.
        """
        if tuple(filters) != self.filters:
            found = ", ".join(filters) or "none"
            raise InputError(path, "filters", found, f"{', '.join(self.filters)}, as in the chart's photographs")

    def weights(self, response: np.ndarray, response_variance: np.ndarray | None = None) -> np.ndarray:
        """Return basis weights of responses.

        The weights are positively homogeneous of degree 1 in the response; if a variance is given, in the response and
        its standard deviation together. Only the estimator ``local`` uses the variance.

        Parameters
        ----------
        response : (..., bands) float32 or float64
        response_variance : (..., bands) or (bands,) float, optional

        Returns
        -------
        (..., k), float32 for float32 responses, otherwise float64; NaN where the response is not finite, and with
        ``local`` where the variance is NaN or negative
        """
        response = np.asarray(response)
        dtype = np.float32 if response.dtype == np.float32 else np.float64
        flat = response.reshape(-1, response.shape[-1]).astype(dtype, copy=False)
        variance = None if response_variance is None else self._flat_variance(response_variance, response.shape)
        out = np.empty((len(flat), self.basis.shape[1]), dtype=dtype)
        self.mapping.weights(flat, variance, out)
        return out.reshape((*response.shape[:-1], out.shape[1]))

    @staticmethod
    def _flat_variance(variance, shape) -> np.ndarray:
        return np.broadcast_to(np.asarray(variance), shape).reshape(-1, shape[-1])

    def spectra(self, response: np.ndarray, response_variance: np.ndarray | None = None) -> np.ndarray:
        """Return recovered reflectance spectra of responses, (..., bands) to (..., 61)."""
        return self.weights(response, response_variance) @ self.basis.T

    def band_scale(self) -> np.ndarray:
        """Return the largest response of the chart in every band, (bands,); bands are compared in these units.

        Raises
        ------
        ValueError
            If the calibration does not have the responses of its chart.
        """
        if self.training is None:
            raise ValueError("a calibration without the responses of its chart; accepted: one that the stage wrote")
        return np.abs(self.training).max(axis=0)
