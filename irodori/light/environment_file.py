"""Environment files: light from all directions, stored and loaded for rendering.

The pictures are equirectangular: rows are the angle from the zenith (+z), columns the azimuth from +x towards +y, both
at pixel centres. Radiance is relative: 1 is that of a perfect diffuser lit at normal incidence by the rig's light.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.material.coefficients import read_coefficients, write_coefficients
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.grid import SAMPLES

#: Description of the coefficients in the file.
QUANTITY = "coefficients of the radiance"


def merged_variance(exposure_noise: np.ndarray, exposure_limit: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return the variance of responses, (..., bands), merged from exposures with inverse variances as weights.

    Parameters
    ----------
    exposure_noise : (exposures, bands, 2) float
        c0 and c1 of the variance c0 + c1 ρ of a response ρ in each exposure alone, the shortest first.
    exposure_limit : (exposures, bands) float
        Response from which an exposure no longer counts; the shortest always does.
    response : (..., bands) float
        The result has its type.
    """
    lit, (first, *longer) = np.maximum(response, 0), exposure_noise.astype(response.dtype)
    known = 1 / (first[:, 0] + first[:, 1] * lit)
    for model, limit in zip(longer, exposure_limit[1:], strict=True):
        known += (lit < limit) / (model[:, 0] + model[:, 1] * lit)
    return np.divide(1, known, out=known)


@dataclass(frozen=True)
class PixelNoise:
    """Noise of a photograph, independent from pixel to pixel, in the light that was recovered from it.

    The noise of each band changes the light by a spectrum, the same in all directions: the mean slope of the recovery.

    Parameters
    ----------
    exposure_noise, exposure_limit
        See `merged_variance`.
    response : (bands, 61) float64
        Responses to light L(λ): response @ L.
    light : (bands, 61) float64
        Change of the light per response.
    """

    exposure_noise: np.ndarray
    exposure_limit: np.ndarray
    response: np.ndarray
    light: np.ndarray

    def deviation(self, coefficients: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the responses to light, (..., bands) float32.

        The light is given by coefficients, (..., k) float32, on a basis, (61, k).
        """
        response = coefficients @ np.float32(basis.T @ self.response.T)
        variance = merged_variance(self.exposure_noise, self.exposure_limit, response)
        return np.sqrt(variance, out=variance)

    def drawn(self, deviation: np.ndarray, basis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draw noise of the light for every pixel, (..., k) float32, from what `deviation` gives on the same basis."""
        noise = rng.standard_normal(deviation.shape, dtype=np.float32)
        noise *= deviation
        return noise @ np.float32(self.light @ np.linalg.pinv(basis).T)


#: Datasets of the noise in the file, by field: their axes and what they are.
_NOISE = {
    "exposure_noise": ("exposure,band,term", "variance c0 + c1 rho of one exposure"),
    "exposure_limit": ("exposure,band", "response from which an exposure no longer counts"),
    "response": ("band,wavelength", "response per radiance"),
    "light": ("band,wavelength", "change of the recovered radiance per response"),
}


@dataclass(frozen=True)
class Environment:
    """Spectral light from all directions, as coefficients on a basis.

    Parameters
    ----------
    coefficients : (height, width, k) float32
    basis : (61, k) float
        L(λ) = basis @ coefficients.
    irradiance : (h, w, k) float32
        I_d of equation (8) for normals on the same kind of grid, on the same basis.
    file : Path, optional
        File from which the coefficients were read; blurred light stored there belongs to them, independent of the
        basis.
    basis_errors : (q, 61, k) float, optional
        For recovered light: independent errors of the basis. Their sum, each multiplied by a standard normal number, is
        a random error that the camera's responses allow. It is an error of the basis because it is the same wherever
        the light of a lamp falls.
    noise : PixelNoise, optional
        For recovered light, if the camera's noise is known.
    """

    coefficients: np.ndarray
    basis: np.ndarray
    irradiance: np.ndarray
    file: Path | None = None
    basis_errors: np.ndarray | None = None
    noise: PixelNoise | None = None

    def irradiance_under(self, n: float, k: float) -> np.ndarray:
        """Return the irradiance under a coat of the index n + ik, (h, w, k) float32, for the normals of `irradiance`.

        Each light counts by the share that passes the surface at its angle, see `irodori.reflection.coat.passed`.
        """
        if (n, k) not in self._under:
            from irodori.light.irradiance import Integrator
            from irodori.reflection.coat import passed_array

            normals = directions(self.irradiance.shape[1], self.irradiance.shape[0])[0]
            found = Integrator(self.coefficients)(normals, lambda cosine: passed_array(cosine, n, k))
            self._under[n, k] = found.astype(np.float32)
        return self._under[n, k]

    @cached_property
    def _under(self) -> dict[tuple[float, float], np.ndarray]:
        return {}

    def save(
        self,
        path,
        provenance: store.Provenance,
        errors: dict | None = None,
        gloss=None,
        origin: dict | None = None,
        *,
        storage: str = "single",
    ) -> None:
        """Write the file of an environment.

        Parameters
        ----------
        path : path
        provenance : Provenance
        errors : dict, optional
        gloss : irodori.light.gloss_maps.GlossMaps, optional
            Blurred light for rough reflection.
        origin : dict, optional
            Source of the light, and assumptions about it.
        storage : str
            See `irodori.material.coefficients`.
        """
        with store.create(path, provenance) as out:
            write_coefficients(out, "coefficients", self.coefficients, quantity=QUANTITY, storage=storage, codec="gzip")
            if gloss is not None:
                gloss.write(out, storage)
            self.write_rest(out, errors, origin)

    def write_rest(self, out: store.Writer, errors: dict | None = None, origin: dict | None = None) -> None:
        """Write everything except the coefficients and the blurred light into an open file; see `save`."""
        write_wavelength(out)
        out.write("basis", self.basis, units="1", dims="wavelength,component", quantity="spectral basis of the light")
        names = {"units": "sr", "dims": "theta,azimuth,component", "quantity": "coefficients of the irradiance map"}
        out.write("irradiance", self.irradiance, **names)
        if self.basis_errors is not None:
            dims, quantity = "error,wavelength,component", "independent errors of the basis of the light"
            out.write("basis_errors", self.basis_errors, units="1", dims=dims, quantity=quantity)
        if self.noise is not None:
            for name, (dims, quantity) in _NOISE.items():
                out.write(f"noise/{name}", getattr(self.noise, name), units="1", dims=dims, quantity=quantity)
        out.attribute("errors", errors or {})
        out.attribute("origin", origin or {})

    @classmethod
    def load(cls, path) -> "Environment":
        """Read the file of an environment.

        Raises
        ------
        InputError
            If it is not the file of an environment, is damaged, has datasets of inconsistent shapes, or a number is not
            finite.
        """
        axes = {
            "coefficients": "row,column,component",
            "basis": "wavelength,component",
            "irradiance": "theta,azimuth,component",
        }
        with store.open_file(path) as file:
            if "basis_errors" in file:
                axes["basis_errors"] = "error,wavelength,component"
            noisy = "noise" in file
            if noisy:
                axes |= {f"noise/{name}": dims for name, (dims, _) in _NOISE.items()}
            file.require_axes(axes, wavelength=SAMPLES)
            coefficients = read_coefficients(file, "coefficients")
            if not np.isfinite(coefficients).all():
                raise InputError(path, "coefficients", "a pixel that is not finite", "finite radiance everywhere")
            return cls(
                coefficients,
                file.read_within("basis"),
                file.read_within("irradiance"),
                Path(path),
                file.read_within("basis_errors") if "basis_errors" in file else None,
                PixelNoise(*(file.read_within(f"noise/{name}") for name in _NOISE)) if noisy else None,
            )

    def drawn(self, rng: np.random.Generator) -> "Environment":
        """Return the light with random errors: another light that is compatible with the photograph.

        The basis has one error, which all directions share; each pixel has noise of its own.

        Raises
        ------
        ValueError
            If the light has no stated errors.
        """
        if self.basis_errors is None:
            raise ValueError("a light without errors; accepted: one that was recovered from a photograph")
        # The irradiance map has the same basis: of it, too, only the basis changes.
        error = np.tensordot(rng.standard_normal(len(self.basis_errors)), self.basis_errors, axes=1)
        other = replace(self, basis=self.basis + error)
        if self.noise is None:
            return other
        from irodori.light.irradiance import Integrator

        noise = self.noise.drawn(self._deviation, self.basis, rng)
        height, width = self.irradiance.shape[:2]
        of_noise = Integrator(noise)(directions(width, height)[0]).astype(np.float32)
        # Blurred light in the file is that of the photograph, without this noise.
        return replace(other, coefficients=self.coefficients + noise, irradiance=self.irradiance + of_noise, file=None)

    @cached_property
    def _deviation(self) -> np.ndarray:
        """The standard deviation of the responses, which all draws share, (height, width, bands) float32."""
        assert self.noise is not None  # as `drawn` has seen
        return self.noise.deviation(self.coefficients, self.basis)

    def upward_white(self) -> np.ndarray:
        """Return the radiance of a perfect diffuser that faces up, (61,): the scene's white."""
        return self.basis @ self.irradiance[0].astype(np.float64).mean(axis=0) / np.pi


def row_solid_angles(width: int, height: int) -> np.ndarray:
    """Return the solid angle, sr, for which a pixel of each row of an interpolated picture counts, (height,).

    Pictures are interpolated between the centres of their pixels (`irodori.light.equirectangular`), so the light of a
    pixel is its value times the integral of its share. That is the area of the pixel, but for rows at the poles, where
    it is a twelfth more: beyond the last centre there is no other row to share with. The integrals sum to 4π.
    """
    step = np.pi / height
    shares = 4.0 * np.sin(np.pi * (np.arange(height) + 0.5) / height) * np.sin(0.5 * step) ** 2 / step
    # The integral of sinθ up to the centre, and of the falling share from there to the next centre.
    shares[[0, -1]] = 2.0 if height == 1 else 1.0 - 2.0 * np.cos(step) * np.sin(0.5 * step) / step
    return shares * (2.0 * np.pi / width)


def directions(width: int, height: int, rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors, (height, width, 3), and solid angles in sr, (height, width), of the pixels of some rows.

    Solid angles are exact: the difference of the cosines of a row's edges times the width of a pixel in azimuth.
    """
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    theta = np.pi * ((np.arange(height) + 0.5) / height)[rows]
    azimuth = 2 * np.pi * (np.arange(width) + 0.5) / width
    unit = np.stack(
        [
            np.outer(np.sin(theta), np.cos(azimuth)),
            np.outer(np.sin(theta), np.sin(azimuth)),
            np.repeat(np.cos(theta)[:, None], width, axis=1),
        ],
        axis=-1,
    )
    of_row = (edges[:-1] - edges[1:])[rows] * (2 * np.pi / width)
    return unit, np.repeat(of_row[:, None], width, axis=1)
