"""Light maps: the light that falls on objects, baked on their own textures by path tracing.

A map holds, for each of its texels, the radiance of a perfect diffuser under the environment, with shadows and
reflections between objects. The integrator `interactive` looks it up instead of the environment's irradiance, which
does not account for neighbouring objects. A map is valid for one arrangement of objects in one light: its key is a hash
of everything on which it depends, and a map with another key is refused.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.grid import SAMPLES

#: Relative norm of the part of the maps that their basis leaves out, the square root of its share of the energy.
LEFT_OUT = 1e-3


class Bake(NamedTuple):
    """Size and errors of a map; errors are shares of the mean light on the object."""

    texels: int
    paths: int  # per texel
    noise: float  # root mean square of the standard errors of the texels
    error: float  # root mean square interpolation error between texels, with the noise of the comparison removed
    most: int  # number of texels that was asked for, from which the places of a mesh's texels follow


@dataclass(frozen=True)
class LightMaps:
    """Baked light on the objects of a scene.

    Parameters
    ----------
    maps : tuple of (rows, columns, k) float32
        For each object, coefficients of the radiance of a perfect diffuser in place of the surface, see
        `irodori.rendering.map_layouts`.
    basis : (61, k) float
    key : str
        Hash of everything on which the maps depend, see `irodori.rendering.reference.baking.maps_key`.
    bakes : tuple of Bake
        Size and errors of each map.
    """

    maps: tuple[np.ndarray, ...]
    basis: np.ndarray
    key: str
    bakes: tuple[Bake, ...]

    def of(self, index: int) -> np.ndarray:
        """Return the spectra of an object's map, (rows, columns, 61)."""
        return self.maps[index] @ self.basis.T.astype(np.float32)

    def under(self, filter_ratio) -> "LightMaps":
        """Return the maps for light that is multiplied by a spectrum, (61,), without tracing again.

        Light transport is linear and separate for each wavelength, so that the light on surfaces changes by the same
        factors as the sources.
        """
        return replace(self, basis=self.basis * np.asarray(filter_ratio, dtype=np.float64)[:, None])

    def weighted_basis(self) -> np.ndarray:
        """Return the basis, (61, k), each vector scaled by the norm of its coefficients over all maps."""
        squares = sum((np.square(one, dtype=np.float64).sum(axis=(0, 1)) for one in self.maps), np.zeros(1))
        return self.basis * np.sqrt(squares)

    def save(self, path, provenance: store.Provenance) -> None:
        """Write the maps to a file."""
        with store.create(path, provenance) as out:
            write_wavelength(out)
            out.write(
                "basis", self.basis, units="1", dims="wavelength,component", quantity="spectral basis of the light"
            )
            for index, stored in enumerate(self.maps):
                dims = f"row_{index},column_{index},component"
                quantity = "coefficients of the radiance of a perfect diffuser on the object"
                out.write(f"map_{index}", stored, units="1", dims=dims, quantity=quantity)
            out.attribute("key", self.key)
            out.attribute("bakes", [bake._asdict() for bake in self.bakes])

    @classmethod
    def load(cls, path, key: str) -> "LightMaps":
        """Read maps from a file.

        Raises
        ------
        InputError
            If the file is damaged, or its key differs from the given one.
        """
        with store.open_file(path) as file:
            if file.attribute("key", str) != key:
                accepted = (
                    "maps of the scene, its materials, its light and this code; remove the file to bake them anew"
                )
                raise InputError(path, "key", "light maps of something else", accepted)
            bakes = tuple(Bake(**bake) for bake in file.attribute("bakes", list))
            axes = {f"map_{index}": f"row_{index},column_{index},component" for index in range(len(bakes))}
            file.require_axes({"basis": "wavelength,component"} | axes, wavelength=SAMPLES)
            return cls(tuple(map(file.read_within, axes)), file.read_within("basis"), key, bakes)


def look_up(picture: np.ndarray, u: np.ndarray, v: np.ndarray, wraps: bool) -> np.ndarray:
    """Interpolate a texture (rows, columns, k) bilinearly at u and v (n,); with ``wraps`` the sides are joined."""
    rows, columns, _ = picture.shape
    x, y = u * columns - 0.5, np.clip(v * rows - 0.5, 0.0, rows - 1.0)
    column, row = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), max(rows - 2, 0))
    fx, fy = (x - column)[:, None], (y - row)[:, None]
    left, right = (c % columns if wraps else np.clip(c, 0, columns - 1) for c in (column, column + 1))
    below = np.minimum(row + 1, rows - 1)
    top = picture[row, left] * (1.0 - fx) + picture[row, right] * fx
    return top * (1.0 - fy) + (picture[below, left] * (1.0 - fx) + picture[below, right] * fx) * fy
