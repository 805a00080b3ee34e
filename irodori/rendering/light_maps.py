"""Light maps: the light that falls on objects, baked on their surfaces.

A map holds, for each of its texels, the radiance of a perfect diffuser under the environment, with shadows and
reflections between objects. The integrator `interactive` looks it up instead of the environment's irradiance, which
does not account for neighbouring objects. For gloss, coarser maps hold which directions other objects hide, and the
light that comes from these objects. Maps are valid for one arrangement of objects in one light: their key is a hash of
everything on which they depend, and maps with another key are refused.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.grid import SAMPLES

#: Relative norm of the part of the maps that their basis leaves out, the square root of its share of the energy.
LEFT_OUT = 1e-3
_MAP, _SEEN = "row_{0},column_{0},component", "seen_row_{0},seen_column_{0},face,cell_row,cell_column,number"


class Bake(NamedTuple):
    """Size and error of a map."""

    texels: int
    error: float  # root mean square error between texels, relative to the mean light, with its own noise removed
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
    seen : tuple of (rows, columns, 6, side + 2, side + 2, 1 + m) float32
        For each object and coarse texel, a cube map of what gloss sees there: the share of directions that lead to the
        environment, then coefficients of the radiance of other objects; without rows for a mesh. Empty if there are
        none, see `irodori.rendering.interactive.surroundings`.
    seen_basis : (61, m) float
    """

    maps: tuple[np.ndarray, ...]
    basis: np.ndarray
    key: str
    bakes: tuple[Bake, ...]
    seen: tuple[np.ndarray, ...] = ()
    seen_basis: np.ndarray = field(default_factory=lambda: np.zeros((SAMPLES, 0)))

    def of(self, index: int) -> np.ndarray:
        """Return the spectra of an object's map, (rows, columns, 61)."""
        return self.maps[index] @ self.basis.T.astype(np.float32)

    def under(self, filter_ratio) -> "LightMaps":
        """Return the maps for light that is multiplied by a spectrum, (61,), without tracing again.

        Light transport is linear and separate for each wavelength, so that the light on surfaces changes by the same
        factors as the sources.
        """
        ratio = np.asarray(filter_ratio, dtype=np.float64)[:, None]
        return replace(self, basis=self.basis * ratio, seen_basis=self.seen_basis * ratio)

    def weighted_basis(self) -> np.ndarray:
        """Return the basis, (61, k), each vector scaled by the root mean square of its coefficients over all maps."""
        squares = [np.square(one, dtype=np.float64).mean(axis=(0, 1)) for one in self.maps]
        return self.basis * np.sqrt(np.mean(squares, axis=0))

    def save(self, path, provenance: store.Provenance) -> None:
        """Write the maps to a file."""
        with store.create(path, provenance) as out:
            write_wavelength(out)
            quantity = "spectral basis of the light"
            out.write("basis", self.basis, units="1", dims="wavelength,component", quantity=quantity)
            quantity = "spectral basis of the light of other objects"
            out.write("seen_basis", self.seen_basis, units="1", dims="wavelength,colour", quantity=quantity)
            for index, stored in enumerate(self.maps):
                quantity = "coefficients of the radiance of a perfect diffuser on the object"
                out.write(f"map_{index}", stored, units="1", dims=_MAP.format(index), quantity=quantity)
            for index, stored in enumerate(self.seen):
                if stored.size:
                    quantity = "share of free directions, and coefficients of the radiance of other objects"
                    out.write(f"seen_{index}", stored, units="1", dims=_SEEN.format(index), quantity=quantity)
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
            axes = {f"map_{index}": _MAP.format(index) for index in range(len(bakes))}
            seen = {f"seen_{index}": _SEEN.format(index) for index in range(len(bakes)) if f"seen_{index}" in file}
            of_basis = {"basis": "wavelength,component", "seen_basis": "wavelength,colour"}
            file.require_axes(of_basis | axes | seen, wavelength=SAMPLES)
            basis, seen_basis = (file.read_within(name) for name in of_basis)
            none = np.zeros((0,) * 6, np.float32)
            around = tuple(file.read_within(n) if n in seen else none for n in (f"seen_{i}" for i in range(len(bakes))))
            return cls(tuple(map(file.read_within, axes)), basis, key, bakes, around, seen_basis)


def spectral_basis(spectra: list[np.ndarray]) -> np.ndarray:
    """Return orthonormal vectors (61, k) that represent spectra (..., 61) up to the relative norm `LEFT_OUT`."""
    squares = sum((flat.T @ flat for flat in (one.reshape(-1, SAMPLES) for one in spectra)), np.zeros((SAMPLES,) * 2))
    values, vectors = np.linalg.eigh(squares)
    energy = np.maximum(values[::-1], 0.0)
    left = np.append(energy[::-1].cumsum()[::-1], 0.0)  # left out with 0, 1, 2, ... vectors
    count = max(int(np.argmax(left <= LEFT_OUT**2 * left[0])), 1)
    return np.ascontiguousarray(vectors[:, ::-1][:, :count])


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
