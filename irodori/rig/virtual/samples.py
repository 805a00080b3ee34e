"""What really stands on the virtual rig: measured spectra and known parameters of equation (5)."""

from dataclasses import dataclass

import numpy as np

from irodori.geometry.shapes import Shape
from irodori.spectra import refractive_index, spectrum


@dataclass(frozen=True)
class Sample:
    """Ground truth of an object.

    Parameters
    ----------
    shape : Shape
    columns, rows : int
        Checks over the texture; a uniform sample has one.
    reflectance : (m, 61) float, S(λ) of each material
    beta : (m,) float
    mu_rad : (m,) float
    mirror : float, χ
    n, k : (61,) float
    """

    shape: Shape
    columns: int
    rows: int
    reflectance: np.ndarray
    beta: np.ndarray
    mu_rad: np.ndarray
    mirror: float
    n: np.ndarray
    k: np.ndarray

    @classmethod
    def from_definition(cls, definition: dict) -> "Sample":
        """Return the sample of an object's definition with its ``virtual`` block."""
        virtual = definition["virtual"]
        pattern, materials = virtual["pattern"], virtual["materials"]
        n, k = refractive_index(definition["refractive_index"])
        checks = pattern["kind"] == "checks"
        return cls(
            shape=Shape.from_definition(definition["shape"]),
            columns=pattern["columns"] if checks else 1,
            rows=pattern["rows"] if checks else 1,
            reflectance=np.stack([spectrum(m["spectrum"]) for m in materials]),
            beta=np.array([m["beta"] for m in materials], dtype=np.float64),
            mu_rad=np.array([m["mu_rad"] for m in materials], dtype=np.float64),
            mirror=float(definition["mirror_weight"]),
            n=n,
            k=k,
        )

    def material_index(self, width: int, height: int) -> np.ndarray:
        """Return the material of each texel centre, (height, width) int."""
        column = np.floor((np.arange(width) + 0.5) / width * self.columns).astype(int)
        row = np.floor((np.arange(height) + 0.5) / height * self.rows).astype(int)
        return (row[:, None] * self.columns + column[None, :]) % len(self.beta)
