"""Angles of observations, computed as they are read from the texels' surface and the places of light and camera.

A tile of observations does not hold the four angles of every texel in every photograph, which would take almost as much
space as the responses, and longer to unpack than to compute. It holds position and normal of each texel, and light and
camera of each photograph, all in the frame of the object.
"""

from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.reflection.angle_kernels import angles_between, unit

#: Datasets of a tile that determine the angles, with their axes.
AXES = {
    "position": "texel,component",
    "normal": "texel,component",
    "light": "capture,component",
    "camera": "capture,component",
}
#: Dataset of earlier tiles, which hold the angles themselves.
STORED = "geometry"
_NEAR = "near_light"
_CHUNK = 4096  # texels that a thread takes at a time
_FAR = 4096  # texels that are skipped rather than read: about those of a packed piece of responses


class Surroundings(NamedTuple):
    """Surface of n texels, and light and camera in J photographs, in the frame of the object.

    Parameters
    ----------
    position, normal : (n, 3) float64
        Positions in mm and unit normals; both 0 where there is no surface.
    light : (J, 3) float64
        Position of a near light, mm, or unit vector to a far one.
    camera : (J, 3) float64
        Centre of projection, mm.
    is_near : bool
        Whether ``light`` has positions.
    """

    position: np.ndarray
    normal: np.ndarray
    light: np.ndarray
    camera: np.ndarray
    is_near: bool


@njit(cache=True, nogil=True, error_model="numpy")
def _angles_chunk(surface, places, out, first, last):
    """Fill the angles of texels.

    ``surface`` has positions and normals; ``places`` light and camera, (3, J) each, and 1 for positions of the light.
    """
    (position, normal), (light, camera, near) = surface, places
    captures = light.shape[1]
    row = np.empty((4, captures))
    for t in range(first, last):
        px, py, pz = position[t, 0], position[t, 1], position[t, 2]
        nx, ny, nz = normal[t, 0], normal[t, 1], normal[t, 2]
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            out[t] = 0.0
            continue
        for j in range(captures):
            lx, ly, lz, _ = unit(light[0, j] - near * px, light[1, j] - near * py, light[2, j] - near * pz)
            vx, vy, vz, _ = unit(camera[0, j] - px, camera[1, j] - py, camera[2, j] - pz)
            row[0, j], row[1, j], row[2, j], row[3, j] = angles_between((nx, ny, nz), (lx, ly, lz), (vx, vy, vz))
        for j in range(captures):
            for i in range(4):
                out[t, j, i] = row[i, j]


def angles_of(around: Surroundings) -> np.ndarray:
    """Return θ_i, θ_r, θ_H and φ of every texel in every photograph, (n, J, 4) float32 rad; 0 without a surface."""
    out = np.empty((len(around.position), len(around.light), 4), dtype=np.float32)
    light, camera = (np.ascontiguousarray(places.T) for places in (around.light, around.camera))
    surface, places = (around.position, around.normal), (light, camera, float(around.is_near))
    run_chunks(_angles_chunk, len(out), _CHUNK, surface, places, out)
    return out


def write_surroundings(out: store.Writer, around: Surroundings) -> None:
    """Write what determines the angles of a tile's observations."""
    described = {
        "position": ("mm", "texel_number", "position of the texel"),
        "normal": ("1", "texel_number", "unit normal of the surface"),
        "light": ("mm", "capture", "position of the light")
        if around.is_near
        else ("1", "capture", "unit vector to the light"),
        "camera": ("mm", "capture", "centre of projection of the camera"),
    }
    out.coordinate("component", ["x", "y", "z"], units="1", quantity="component of a vector in the frame of the object")
    for name, (units, axis, quantity) in described.items():
        out.write(
            name,
            getattr(around, name),
            units=units,
            dims=f"{axis},component",
            quantity=f"{quantity}, frame of the object",
        )
    out.attribute(_NEAR, around.is_near)


def read_angles(file: store.Reader, texels=slice(None)) -> np.ndarray:
    """Return θ_i, θ_r, θ_H and φ of a tile's observations, (n, J, 4) float32 rad, of texels as in `read_texels`.

    Raises
    ------
    InputError
        If the file has neither what determines the angles nor the angles, or is damaged.
    """
    if STORED in file:
        file.require_axes({STORED: "texel,capture,angle"}, angle=4)
        return read_texels(file, STORED, texels)
    file.require_axes(AXES, component=3)
    places = {name: file.read(name) for name in ("light", "camera")}
    places |= {name: read_texels(file, name, texels) for name in ("position", "normal")}
    doubled = {name: values.astype(np.float64, copy=False) for name, values in places.items()}
    return angles_of(Surroundings(**doubled, is_near=bool(file.attribute(_NEAR))))


def read_texels(file: store.Reader, name: str, texels=slice(None)) -> np.ndarray:
    """Return a dataset at some texels, a slice or sorted numbers; what lies far from all of them is not read."""
    if isinstance(texels, slice):
        return file.read(name, texels)
    runs = np.split(texels, np.flatnonzero(np.diff(texels) > _FAR) + 1)
    spans = [(run, slice(run[0], run[-1] + 1)) for run in runs if len(run)] or [(texels, slice(0, 0))]
    return np.concatenate([file.read(name, span)[run - span.start] for run, span in spans])
