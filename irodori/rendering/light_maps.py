"""Light maps: the light that falls on objects, baked on their own textures by path tracing.

A map holds, for each of its texels, what a perfect diffuser there would reflect of the environment after shadows and
reflections between objects. The integrator `interactive` looks it up in place of the environment's irradiance, which
knows of no neighbours. A map belongs to one arrangement of objects in one light: its key is a hash of everything it
depends on, and a map of another key is refused.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.grid import SAMPLES

#: What the basis of the maps leaves out, over all that they hold; the square root of a share of the energy.
LEFT_OUT = 1e-3


class Bake(NamedTuple):
    """Size and errors of a map; errors are shares of the mean light on the object."""

    texels: int
    paths: int  # a texel
    noise: float  # root mean square standard error of a texel
    error: float  # root mean square distance between the texels, the noise of what it is compared with taken out


@dataclass(frozen=True)
class LightMaps:
    """The light that falls on the objects of a scene.

    Parameters
    ----------
    maps : tuple of (rows, columns, k) float32
        Of each object, coefficients of the radiance of a perfect diffuser in place of the surface; without rows where
        an object has none, see `irodori.rendering.reference.baking.has_map`.
    basis : (61, k) float
    key : str
        Of everything that the maps depend on, see `irodori.rendering.reference.baking.maps_key`.
    bakes : tuple of Bake
    """

    maps: tuple[np.ndarray, ...]
    basis: np.ndarray
    key: str
    bakes: tuple[Bake, ...]

    def of(self, index: int) -> np.ndarray:
        """Return the spectra of an object's map, (rows, columns, 61)."""
        return self.maps[index] @ self.basis.T.astype(np.float32)

    def under(self, filter_ratio) -> "LightMaps":
        """Return the maps where all light is multiplied by a spectrum, (61,); shadows and reflections stay theirs.

        Light is carried wavelength by wavelength, so that the light on a surface is multiplied as its sources are.
        """
        return replace(self, basis=self.basis * np.asarray(filter_ratio, dtype=np.float64)[:, None])

    def weighted_basis(self) -> np.ndarray:
        """Return the basis, each vector as long as what the maps hold of it, (61, k)."""
        squares = sum((np.square(one, dtype=np.float64).sum(axis=(0, 1)) for one in self.maps), np.zeros(1))
        return self.basis * np.sqrt(squares)

    def save(self, path, provenance: store.Provenance) -> None:
        """Write the maps."""
        with store.create(path, provenance) as out:
            write_wavelength(out)
            out.write(
                "basis", self.basis, units="1", dims="wavelength,component", quantity="spectral basis of the light"
            )
            for index, stored in enumerate(self.maps):
                dims = f"row_{index},column_{index},component"
                if stored.size:
                    quantity = "coefficients of the radiance of a perfect diffuser on the object"
                    out.write(f"map_{index}", stored, units="1", dims=dims, quantity=quantity)
            out.attribute("key", self.key)
            out.attribute("bakes", [bake._asdict() for bake in self.bakes])

    @classmethod
    def load(cls, path, key: str) -> "LightMaps":
        """Read maps.

        Raises
        ------
        InputError
            If the file is damaged, or its maps were baked of something else than the key says.
        """
        with store.open_file(path) as file:
            if file.attribute("key", str) != key:
                accepted = (
                    "maps of the scene, its materials, its light and this code; remove the file to bake them anew"
                )
                raise InputError(path, "key", "light maps of something else", accepted)
            bakes = tuple(Bake(**bake) for bake in file.attribute("bakes", list))
            axes = {"basis": "wavelength,component"}
            there = [f"map_{index}" in file for index in range(len(bakes))]
            axes |= {f"map_{i}": f"row_{i},column_{i},component" for i, is_there in enumerate(there) if is_there}
            file.require_axes(axes, wavelength=SAMPLES)
            basis = file.read_within("basis")
            none = np.zeros((0, 0, basis.shape[1]), np.float32)
            maps = tuple(file.read_within(f"map_{i}") if is_there else none for i, is_there in enumerate(there))
            return cls(maps, basis, key, bakes)


def look_up(picture: np.ndarray, u: np.ndarray, v: np.ndarray, wraps: bool) -> np.ndarray:
    """Return a texture (rows, columns, k) bilinearly at u and v (n,) as renderers do; joined sides continue."""
    rows, columns, _ = picture.shape
    x, y = u * columns - 0.5, np.clip(v * rows - 0.5, 0.0, rows - 1.0)
    column, row = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), max(rows - 2, 0))
    fx, fy = (x - column)[:, None], (y - row)[:, None]
    left, right = (c % columns if wraps else np.clip(c, 0, columns - 1) for c in (column, column + 1))
    below = np.minimum(row + 1, rows - 1)
    top = picture[row, left] * (1.0 - fx) + picture[row, right] * fx
    return top * (1.0 - fy) + (picture[below, left] * (1.0 - fx) + picture[below, right] * fx) * fy
