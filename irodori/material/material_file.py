"""Material files: parameter maps and reflectance, stored and loaded for rendering."""

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from scipy import ndimage

from irodori.core import store
from irodori.material.coefficients import read_coefficients, write_coefficients
from irodori.spectra.grid import SAMPLES

_DARKEST_GREEN = 1e-3
#: Maps of a material's own file: units and quantity.
MAPS = {
    "alpha": ("1", "diffuse weight"),
    "beta": ("1", "gloss weight"),
    "mu": ("rad", "roughness"),
    "green_response": ("1", "green-band response of S"),
}
COEFFICIENTS, QUANTITY = "reflectance/coefficients", "coefficients of the reflectance factor"


class Status(IntEnum):
    """Outcome of a texel's fit."""

    OK = 0
    MU_UNIDENTIFIABLE = 1  # gloss is there, but the data leaves β or μ open: both are NaN
    AT_BOUND = 2
    TOO_FEW_OBSERVATIONS = 3
    NON_FINITE = 4  # too few observations, because those with weight are not numbers
    DIFFUSE_ONLY = 5  # the observations show no gloss
    SATURATED = 6  # the camera clips where the highlight is
    DARK = 7  # no light beyond the noise
    POOLED = 8  # β and μ are those of the texels around it, whose observations agree with its own


@dataclass(frozen=True)
class Material:
    """Parameters of equation (5) over a texture.

    Parameters
    ----------
    alpha, beta, mu, green_response : (height, width) float
        Weights, roughness in rad and S_G; NaN where the data does not determine them.
    coefficients : (height, width, k) float32
    basis : (61, k) float
        S(λ) = basis @ coefficients, absolute reflectance factor.
    n, k : (61,) float
        Complex refractive index.
    mirror : float, χ
    typical_gloss : (2,) tuple
        β and μ of the object's well-determined texels, for those whose own data is silent.
    extra : dict
        Further maps: name -> (values, units, quantity).
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    green_response: np.ndarray
    coefficients: np.ndarray
    basis: np.ndarray
    n: np.ndarray
    k: np.ndarray
    mirror: float
    typical_gloss: tuple[float, float]
    extra: dict = field(default_factory=dict)

    @classmethod
    def uniform(cls, reflectance, beta: float = 0.0, mu: float = 0.1, mirror: float = 0.0, n=1.5, k=0.0) -> "Material":
        """Return the same parameters everywhere.

        Parameters
        ----------
        reflectance : float or (61,) float
            Absolute reflectance factor α S / S_G of the diffuse term.
        beta, mu, mirror : float
            Weight of the gloss and its roughness in rad, weight of the mirror term.
        n, k : float or (61,) float
            Complex refractive index.
        """
        one = np.ones((2, 2))
        spectrum, n, k = (np.broadcast_to(np.asarray(v, dtype=np.float64), SAMPLES).copy() for v in (reflectance, n, k))
        coefficients = np.ones((2, 2, 1), dtype=np.float32)
        maps = {"alpha": one, "beta": beta * one, "mu": mu * one, "green_response": one}
        return cls(
            **maps,
            coefficients=coefficients,
            basis=spectrum[:, None],
            n=n,
            k=k,
            mirror=mirror,
            typical_gloss=(beta, mu),
        )

    def save(
        self,
        path,
        provenance: store.Provenance,
        errors: dict | None = None,
        *,
        storage: str = "single",
        codec: str = "gzip",
    ) -> None:
        """Write ``material.h5``; ``errors`` is kept as an attribute.

        ``storage`` and ``codec`` are those of `irodori.material.coefficients`.
        """
        with store.create(path, provenance) as out:
            maps = {name: (getattr(self, name), units, what) for name, (units, what) in MAPS.items()}
            store.write_maps(out, maps | self.extra, "row,column,component")
            write_coefficients(
                out,
                COEFFICIENTS,
                self.coefficients,
                quantity=QUANTITY,
                storage=storage,
                codec=codec,
            )
            write_constants(out, self.basis, self.n, self.k, self.mirror, self.typical_gloss, errors)

    @classmethod
    def load(cls, path) -> "Material":
        """Read ``material.h5``.

        Raises
        ------
        InputError
            If it is none, damaged, or its datasets do not fit together.
        """
        axes = {
            **dict.fromkeys(MAPS, "row,column"),
            COEFFICIENTS: "row,column,basis",
            "reflectance/basis": "wavelength,basis",
            "refractive_index/n": "wavelength",
            "refractive_index/k": "wavelength",
        }
        with store.open_file(path) as file:
            file.require_axes(axes, wavelength=SAMPLES)
            return cls(
                **{name: file.read(name) for name in MAPS},
                coefficients=read_coefficients(file, COEFFICIENTS),
                basis=file.read("reflectance/basis"),
                n=file.read("refractive_index/n"),
                k=file.read("refractive_index/k"),
                mirror=file.attribute("mirror", (float, int)),
                typical_gloss=tuple(file.attribute("typical_gloss", list)),
            )

    @property
    def observed(self) -> np.ndarray:
        """Texels with a diffuse reflectance of their own, (height, width) bool."""
        finite = np.isfinite(self.alpha) & np.isfinite(self.coefficients).all(axis=-1)
        return finite & np.isfinite(self.green_response)

    @property
    def spectrum_scale(self) -> np.ndarray:
        """The factor α / S_G that rendering puts on S(λ), (height, width); 1 where S_G is too dark to divide by."""
        bright = self.green_response > _DARKEST_GREEN
        return np.divide(self.alpha, self.green_response, out=np.ones_like(self.alpha), where=bright)

    def filled(self, covered: np.ndarray | None = None) -> tuple["Material", float]:
        """Return a copy without gaps, and the share of texels that were filled.

        A texel that no capture determined takes the colour of the nearest observed texel (the texture's sides are
        joined), and gloss that its own data is silent about is the object's typical gloss.

        Parameters
        ----------
        covered : (height, width) bool, optional
            Which texels lie on the surface, all where absent. The others are filled too, with the gloss of the nearest
            texel that is one, and count for nothing in the share.
        """
        observed = self.observed
        if covered is not None and not covered.all():
            return self._padded(covered)
        if not observed.any():
            raise ValueError("a material without a single observed texel; accepted: at least one")
        width = observed.shape[1]
        wrapped = np.concatenate([observed, observed, observed], axis=1)
        row, column = ndimage.distance_transform_edt(~wrapped, return_distances=False, return_indices=True)
        row, column = row[:, width : 2 * width], column[:, width : 2 * width] % width
        beta, mu = self.typical_gloss
        known = np.isfinite(self.beta) & np.isfinite(self.mu)
        filled = replace(
            self,
            alpha=self.alpha[row, column],
            green_response=self.green_response[row, column],
            coefficients=self.coefficients[row, column],
            beta=np.where(known, self.beta, beta),
            mu=np.where(known, self.mu, mu),
        )
        return filled, float(1.0 - observed.mean())

    def _padded(self, covered: np.ndarray) -> tuple["Material", float]:
        """Fill the texels of the surface from each other, then those beside it from the nearest of the surface."""
        observed = self.observed & covered
        own = replace(self, alpha=np.where(covered, self.alpha, np.nan))
        inside, _ = own.filled()
        row, column = ndimage.distance_transform_edt(~covered, return_distances=False, return_indices=True)
        maps = {name: getattr(inside, name)[row, column] for name in (*MAPS, "coefficients")}
        return replace(inside, **maps), float(1.0 - observed.sum() / covered.sum())

    def spectra(self) -> np.ndarray:
        """Return S(λ) of every texel, (height, width, 61)."""
        return self.coefficients @ self.basis.T


def write_constants(
    out: store.Writer, basis, n, k, mirror: float, typical_gloss: tuple[float, float], errors: dict | None
) -> None:
    """Write what a material's file holds beside its maps into an open file; see `Material` and `Material.save`."""
    out.write("reflectance/basis", basis, units="1", dims="wavelength,basis", quantity="spectral basis")
    names = {"units": "1", "dims": "wavelength", "quantity": "complex refractive index n + ik"}
    for name, values in (("n", n), ("k", k)):
        out.write(f"refractive_index/{name}", values, **names)
    out.attribute("mirror", mirror)
    out.attribute("typical_gloss", list(typical_gloss))
    out.attribute("errors", errors or {})
