"""Cube maps of pictures over the sphere, smooth across the edges.

Each face is the gnomonic projection of its side, stored with a border of one texel that continues it beyond the edges.
Bilinear look-up therefore needs no special case at edges, and its error is of second order in the texel size
everywhere. (At the folds of an octahedral map, the error is of first order: 0.8 % for a side of 128.) Faces are in the
order +x, -x, +y, -y, +z, -z; the coordinates on a face are the two other axes in cyclic order. Maps are flat arrays:
with ``stride = side + 2``, channel c of texel (row, column) of a face has the index
``first + ((face * stride + row + 1) * stride + column + 1) * channels + c``.
"""

import itertools
import mmap
from collections.abc import Iterator
from typing import NamedTuple

import numba
import numpy as np

from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import as_float, lower_of, magnitude, select, truncated, upper_of
from irodori.jit.vector_memory import channel_count, lane, load, load_like, store
from irodori.light.equirectangular import direction_uv, look_up
from irodori.rendering.interactive.prefetching import prefetch

FACES = 6
_COARSEST_SIDE = 4
#: Side of an environment's cube map from which on its texels are as wide as the picture's pixels.
_FINE_SIDE = 256
#: Samples along each side of a texel of an environment, and rows of texels that are computed at a time.
_PARTS, _ROWS = 3, 64
_LINE = 64  # bytes of a line of the processor's cache


def _on_face(face: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the unit vectors (..., 3) at coordinates u, v (...) on a face."""
    axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
    unit = np.empty((*u.shape, 3))
    unit[..., axis], unit[..., (axis + 1) % 3], unit[..., (axis + 2) % 3] = sign, u, v
    return unit / np.linalg.norm(unit, axis=-1, keepdims=True)


def _on_faces(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the unit vectors (6, ..., 3) at coordinates u, v (...) on all faces."""
    return np.stack([_on_face(face, u, v) for face in range(FACES)])


def _texel_places(side: int, border: int) -> tuple[np.ndarray, np.ndarray]:
    place = 2.0 * (np.arange(-border, side + border) + 0.5) / side - 1.0
    u, v = np.meshgrid(place, place)
    return u, v


def face_directions(face: int, side: int, border: int = 0) -> np.ndarray:
    """Return the unit vectors at the centres of a face's texels, border included, (s, s, 3), s = side + 2 border."""
    return _on_face(face, *_texel_places(side, border))


def places_of(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the faces that directions (..., 3) hit, and the coordinates u, v on them, -1..1."""
    axis = np.argmax(np.abs(unit), axis=-1)
    main, a, b = (np.take_along_axis(unit, ((axis + i) % 3)[..., None], axis=-1)[..., 0] for i in range(3))
    return 2 * axis + (main < 0), a / np.abs(main), b / np.abs(main)


def look_up_cube(stored: np.ndarray, unit: np.ndarray, reach: float = 0.5) -> np.ndarray:
    """Interpolate a stored map, (6, side + 2, side + 2, k), bilinearly in directions (..., 3); returns (..., k).

    Coordinates are limited to ``reach`` texels beyond the outermost texel centres; with 0 the border is not used.
    """
    side = stored.shape[1] - 2
    face, u, v = places_of(unit)
    x, y = (np.clip((p + 1) * side / 2 + 0.5, 1.0 - reach, side + reach) for p in (u, v))
    column, row = (np.minimum(np.floor(p).astype(int), side) for p in (x, y))
    fx, fy = (x - column)[..., None], (y - row)[..., None]
    top = stored[face, row, column] * (1 - fx) + stored[face, row, column + 1] * fx
    return top * (1 - fy) + (stored[face, row + 1, column] * (1 - fx) + stored[face, row + 1, column + 1] * fx) * fy


def fill_borders(stored: np.ndarray) -> None:
    """Fill the borders of a map, (6, side + 2, side + 2, k) float of any precision, from the adjoining faces."""
    edge = np.ones(stored.shape[1:3], dtype=bool)
    edge[1:-1, 1:-1] = False
    u, v = _texel_places(stored.shape[1] - 2, 1)
    stored[:, edge] = look_up_cube(stored, _on_faces(u[edge], v[edge]), reach=0.0)
    # A corner is the mean of the outermost texels of the two adjoining faces.
    corners = _on_faces(u[:: len(u) - 1, :: len(u) - 1], v[:: len(u) - 1, :: len(u) - 1])
    for face, row, column in itertools.product(range(FACES), (0, 1), (0, 1)):
        sides = np.repeat(corners[face, row, column][None], 2, axis=0)
        for side, turn in zip(sides, (1, 2), strict=True):
            other = (face // 2 + turn) % 3
            side[other] = np.copysign(side[face // 2], side[other])
        stored[face, -row, -column] = look_up_cube(stored, sides, reach=0.0).mean(axis=0)


def from_equirectangular(picture: np.ndarray, side: int) -> Iterator[np.ndarray]:
    """Resample an equirectangular picture, (h, w, k), to a cube map; yield its faces, (side + 2, side + 2, k) float64.

    Faces are yielded one by one because all together would need several times the memory of a fine map.
    """
    picture = np.ascontiguousarray(picture, dtype=np.float32)
    for face in range(FACES):
        unit = face_directions(face, side, 1)
        found = np.empty((unit.size // 3, picture.shape[2]))
        look_up(picture, unit.reshape(-1, 3), found)
        yield found.reshape(*unit.shape[:2], -1)


def on_cache_lines(count: int, dtype: type = np.float32) -> np.ndarray:
    """Return zeros, (count,), that begin with a line of the processor's cache, so that few texels lie in two lines."""
    room: np.ndarray = np.zeros(count + _LINE // np.dtype(dtype).itemsize, dtype)
    first = -room.ctypes.data % _LINE // room.itemsize
    return room[first : first + count]


class CubePyramid(NamedTuple):
    """A cube map and its levels of half the side each, finest first."""

    texels: np.ndarray  # flat, float32
    first: np.ndarray  # (levels,) int64, of numbers
    side: np.ndarray  # (levels,) texels


class _Picture(NamedTuple):
    """An equirectangular picture for compiled loops."""

    pixels: np.ndarray  # flat; uint16 holds half-precision floats
    height: int
    width: int


@njit(cache=True)
def _add_pixel(pixels, index, weight, out):
    for channel in range(out.size):
        out[channel] += weight * lane(load(pixels, index * out.size + channel, 1), 0)


@njit(cache=True)
def _fill_row(picture, face, row, out, total):
    """Fill a row of a face's texels, (side, k), with means of the interpolated picture over a grid in each texel."""
    pixels, height, width = picture
    side, sign = out.shape[0], 1.0 - 2.0 * (face % 2)
    for column in range(side):
        total[:] = 0.0
        for part in range(_PARTS * _PARTS):
            a = 2.0 * (column + (part % _PARTS + 0.5) / _PARTS) / side - 1.0
            b = 2.0 * (row + (part // _PARTS + 0.5) / _PARTS) / side - 1.0
            axis = face // 2
            x, y, z = (sign, a, b) if axis == 0 else ((b, sign, a) if axis == 1 else (a, b, sign))
            u, v = direction_uv(x, y, z / np.sqrt(x * x + y * y + z * z))
            # Beyond the first and last row, at the poles, the row itself is used.
            left, upper = u * width - 0.5, min(max(v * height - 0.5, 0.0), height - 1.0)
            i, first = int(upper), int(np.floor(left))
            fx, fy, j = left - first, upper - i, min(i + 1, height - 1)
            c, d = first % width, (first + 1) % width
            _add_pixel(pixels, i * width + c, (1.0 - fx) * (1.0 - fy), total)
            _add_pixel(pixels, i * width + d, fx * (1.0 - fy), total)
            _add_pixel(pixels, j * width + c, (1.0 - fx) * fy, total)
            _add_pixel(pixels, j * width + d, fx * fy, total)
        for channel in range(total.size):
            out[column, channel] = total[channel] / (_PARTS * _PARTS)


@njit(cache=True, parallel=True, nogil=True)
def _fill_rows(picture, face, first, out):
    for row in numba.prange(out.shape[0]):
        _fill_row(picture, face, first + row, out[row], np.empty(out.shape[2]))


def give_back(array: np.ndarray) -> None:
    """Release the memory of an array that is mapped from a file; its pages are read again when used."""
    base: np.ndarray | None = array
    while isinstance(base, np.ndarray) and not isinstance(base, np.memmap):
        base = base.base
    if isinstance(base, np.memmap) and base.mode in ("r", "r+"):
        mapped = base._mmap  # type: ignore[attr-defined]
        if mapped is not None:
            mapped.madvise(mmap.MADV_DONTNEED)


def environment_side(height: int) -> int:
    """Return the side of a cube map for an equirectangular picture of this many rows.

    Its texels are half as wide as a pixel at the equator, because a flat mirror magnifies the picture: texels as wide
    as pixels blur a small lamp by a pixel. They are wider, up to a pixel, if the side would exceed `_FINE_SIDE`. A side
    whose texels have on average a pixel's solid angle follows from 4 π / (6 side²) = (π / height)². Sides are rounded
    up to multiples of 64, so that they can be halved several times.
    """
    same, finer = (max(int(np.ceil(n * height * np.sqrt(2.0 / (3.0 * np.pi)) / 64.0)) * 64, 64) for n in (1, 2))
    return max(same, min(finer, _FINE_SIDE))


def environment_pyramid(picture: np.ndarray, stored_from_light: np.ndarray, channels: int) -> CubePyramid:
    """Return an environment as a cube map, see `environment_side`, with its levels of half the side each.

    Parameters
    ----------
    picture : (height, width, k) float32 or float16
        Radiance, equirectangular; a picture without rows gives a map without levels, in which nothing may be looked up.
    stored_from_light : (s, k) float
        Matrix from the coefficients of the radiance to the stored numbers.
    channels : int
        Numbers per texel, at least s; the rest are zero.
    """
    height, width, k = picture.shape
    if height == 0:
        none = np.zeros(0, dtype=np.int64)
        return CubePyramid(np.zeros(0, np.float32), none, none)
    sides = [environment_side(height)]
    while sides[-1] % 2 == 0 and sides[-1] // 2 >= _COARSEST_SIDE:
        sides.append(sides[-1] // 2)
    first = np.concatenate([[0], np.cumsum([FACES * (s + 2) ** 2 * channels for s in sides])])
    texels = on_cache_lines(first[-1])
    maps = [
        texels[a:b].reshape(FACES, s + 2, s + 2, channels) for a, b, s in zip(first, first[1:], sides, strict=False)
    ]
    pixels = picture.ravel()
    pixels = pixels.view(np.uint16) if pixels.dtype == np.float16 else pixels.astype(np.float32, copy=False)
    matrix = stored_from_light.astype(np.float32)
    for face, row in itertools.product(range(FACES), range(0, sides[0], _ROWS)):
        rows = np.empty((min(_ROWS, sides[0] - row), sides[0], k), dtype=np.float32)
        _fill_rows(_Picture(pixels, height, width), face, row, rows)
        maps[0][face, 1 + row : 1 + row + len(rows), 1:-1, : len(matrix)] = rows @ matrix.T
        if row + len(rows) == sides[0]:
            give_back(picture)  # the next face reads other parts of it
    for finer, coarser in itertools.pairwise(maps):
        for fine, coarse in zip(finer, coarser, strict=True):
            inner = fine[1:-1, 1:-1]
            side = len(inner) // 2
            coarse[1:-1, 1:-1] = inner.reshape(side, 2, side, 2, channels).mean(axis=(1, 3))
    for stored in maps:
        fill_borders(stored)
    return CubePyramid(texels, first[:-1], np.array(sides))


# --- in compiled code ----------------------------------------------------------------------------------------------


@uncounted(forceinline=True)
def face_of(x, y, z):
    """Return the faces, as float, that directions of any length hit, and coordinates on them, -1..1; lane vectors."""
    ax, ay, az = magnitude(x), magnitude(y), magnitude(z)
    along_x = (ax >= ay) & (ax >= az)
    along_y = ay >= az
    main = select(along_x, x, select(along_y, y, z))
    a = select(along_x, y, select(along_y, z, x))
    b = select(along_x, z, select(along_y, x, y))
    axis = select(along_x, 0.0, select(along_y, magnitude(x) * 0.0 + 2.0, 4.0))
    inverse = 1.0 / upper_of(magnitude(main), 1e-30)
    return axis + select(main < 0.0, magnitude(x) * 0.0 + 1.0, 0.0), a * inverse, b * inverse


@uncounted(forceinline=True)
def cell_of(face, u, v, side):
    """Return the index of the upper left of the four texels around each point, and the fractions to the next ones.

    ``side`` is a vector of integers as float.
    """
    # NaN becomes the first texel; values that are looked up there are never used.
    x = lower_of(upper_of((u + 1.0) * (side * 0.5) + 0.5, 0.0), side + 0.5)
    y = lower_of(upper_of((v + 1.0) * (side * 0.5) + 0.5, 0.0), side + 0.5)
    column, row, stride = truncated(x), truncated(y), truncated(side + 2.0)
    start = truncated(lower_of(upper_of(face, 0.0), 5.0)) * stride
    return (start + row) * stride + column, x - as_float(column), y - as_float(row)


class Corners(NamedTuple):
    """Places in the buffers of the four texels around each of sixteen points, see `keep_corners`."""

    weights: np.ndarray
    first_weight: int  # of the upper left texel; those of the upper right, lower left and lower right follow after 16
    texels: np.ndarray
    first_texel: int  # index of the upper left texel; that of the lower left follows after 16


@uncounted(forceinline=True)
def keep_corners(corners, texel, stride, place, weight):
    """Store weights and indices of the four texels around each of sixteen points.

    Weights instead of differences: non-negative values stay non-negative, also next to a sun.

    Parameters
    ----------
    corners : Corners
    texel, stride : vectors of int
        Index of the upper left texel, and texels from a row to the next one.
    place : two vectors of float
        Fractions of the way to the next column and the next row.
    weight : vector of float
        Sum of the weights.
    """
    weights, first, texels, number = corners
    x, y = place
    right, upper = weight * x, 1.0 - y
    left = weight - right
    store(weights, first, upper * left)
    store(weights, first + 16, upper * right)
    store(weights, first + 32, y * left)
    store(weights, first + 48, y * right)
    store(texels, number, texel)
    store(texels, number + 16, texel + stride)


@uncounted(forceinline=True)
def corners_apart(array, corners, ray, steps, like):
    """Add up the four texels around one of the points of `keep_corners`, with their weights.

    Parameters
    ----------
    array : flat array
    corners : Corners
    ray : int
        Number of the point.
    steps : (int, int)
        Numbers of a texel, and numbers from the left texel to the right one.
    like : vector
        Vector with as many lanes as there are numbers to read at each of the four places.
    """
    upper, lower, weights = texels_kept(corners, ray)
    return mix_corners(array, (upper * steps[0], lower * steps[0], steps[1]), weights, like)


@uncounted(forceinline=True)
def texels_kept(corners, ray):
    """Return the texels to the upper and lower left of a point, the array of weights, and the index of the first."""
    weights, first, texels, number = corners
    return np.int64(texels[number + ray]), np.int64(texels[number + 16 + ray]), (weights, first + ray)


@uncounted(forceinline=True)
def opposite_texel(texel, side):
    """Return the texel of a cube map, with ``side`` texels along a face, that is opposite to another."""
    size = (np.int64(side) + 2) * (np.int64(side) + 2)
    return ((texel // size) ^ 1) * size + size - 1 - texel % size


@uncounted(forceinline=True)
def mix_corners(array, places, weights, like):
    """Add up four texels with their weights.

    Parameters
    ----------
    array : flat array
    places : (int, int, int)
        Index of the first number of the upper left and of the lower left texel, and numbers from these to the right.
    weights : (array, int)
        See `texels_kept`.
    like : vector
        Vector with as many lanes as there are numbers to read at each of the four places.
    """
    (upper, lower, right), (weights, at) = places, weights
    top = weights[at] * load_like(array, upper, like) + weights[at + 16] * load_like(array, upper + right, like)
    bottom = weights[at + 32] * load_like(array, lower, like)
    return top + (bottom + weights[at + 48] * load_like(array, lower + right, like))


@uncounted(forceinline=True)
def at_corners(array, corners, ray, like):
    """Add up four adjacent texels like `corners_apart`; a texel has as many numbers as ``like`` has lanes."""
    width = channel_count(like)
    return corners_apart(array, corners, ray, (width, width), like)


@uncounted(forceinline=True)
def prefetch_corners(array, corners, ray, width):
    """Ask for the texels that `at_corners` reads soon; ``width`` is the count of their numbers."""
    upper = np.int64(corners.texels[corners.first_texel + ray]) * width
    lower = np.int64(corners.texels[corners.first_texel + 16 + ray]) * width
    prefetch(array, upper)
    prefetch(array, lower)
    if width > 8:  # else they are mostly in one line
        prefetch(array, upper + width)
        prefetch(array, lower + width)
