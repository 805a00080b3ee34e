"""Cube maps of pictures over the sphere, smooth across the edges.

Each face is the gnomonic picture of its side, stored with a border of one texel that continues it beyond the edges, so
that bilinear look-up needs no case and errs with the square of a texel everywhere. (Between texels on either side of a
fold, an octahedral map errs with the texel itself: 0.8 % with 128 of them.) Faces follow each other as +x, -x, +y, -y,
+z, -z; on that of an axis the two others are read in cyclic order. Maps are flat: with ``stride = side + 2``, texel
(row, column) of a face and channel c stands at
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
from irodori.jit.vector_memory import channel_count, lane, load, load_like
from irodori.light.equirectangular import direction_uv, look_up

FACES = 6
_COARSEST_SIDE = 4
#: Points along each side of a texel of an environment, and rows of it that are made at a time.
_PARTS, _ROWS = 3, 64


def _on_face(face: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the unit vectors at places (...) of a face, (..., 3)."""
    axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
    unit = np.empty((*u.shape, 3))
    unit[..., axis], unit[..., (axis + 1) % 3], unit[..., (axis + 2) % 3] = sign, u, v
    return unit / np.linalg.norm(unit, axis=-1, keepdims=True)


def _on_faces(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the unit vectors at places (...) of all faces, (6, ..., 3)."""
    return np.stack([_on_face(face, u, v) for face in range(FACES)])


def _texel_places(side: int, border: int) -> tuple[np.ndarray, np.ndarray]:
    place = 2.0 * (np.arange(-border, side + border) + 0.5) / side - 1.0
    u, v = np.meshgrid(place, place)
    return u, v


def face_directions(face: int, side: int, border: int = 0) -> np.ndarray:
    """Return the unit vectors of a face's texels' centres, borders included, (side, side, 3) float64."""
    return _on_face(face, *_texel_places(side, border))


def places_of(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the faces of directions (..., 3) and their places u, v on them, -1..1."""
    axis = np.argmax(np.abs(unit), axis=-1)
    main, a, b = (np.take_along_axis(unit, ((axis + i) % 3)[..., None], axis=-1)[..., 0] for i in range(3))
    return 2 * axis + (main < 0), a / np.abs(main), b / np.abs(main)


def look_up_cube(stored: np.ndarray, unit: np.ndarray, reach: float = 0.5) -> np.ndarray:
    """Return a stored map, (6, side + 2, side + 2, k), bilinearly in directions (..., 3), as (..., k).

    ``reach`` is how far beyond the outermost texels' centres places may lie, in texels: 0 uses no border.
    """
    side = stored.shape[1] - 2
    face, u, v = places_of(unit)
    x, y = (np.clip((p + 1) * side / 2 + 0.5, 1.0 - reach, side + reach) for p in (u, v))
    column, row = (np.minimum(np.floor(p).astype(int), side) for p in (x, y))
    fx, fy = (x - column)[..., None], (y - row)[..., None]
    top = stored[face, row, column] * (1 - fx) + stored[face, row, column + 1] * fx
    return top * (1 - fy) + (stored[face, row + 1, column] * (1 - fx) + stored[face, row + 1, column + 1] * fx) * fy


def fill_borders(stored: np.ndarray) -> None:
    """Fill the borders of a map, (6, side + 2, side + 2, k) of any float, from what the other faces show there."""
    edge = np.ones(stored.shape[1:3], dtype=bool)
    edge[1:-1, 1:-1] = False
    u, v = _texel_places(stored.shape[1] - 2, 1)
    stored[:, edge] = look_up_cube(stored, _on_faces(u[edge], v[edge]), reach=0.0)
    # A corner lies between the outermost texels of the two other faces.
    corners = _on_faces(u[:: len(u) - 1, :: len(u) - 1], v[:: len(u) - 1, :: len(u) - 1])
    for face, row, column in itertools.product(range(FACES), (0, 1), (0, 1)):
        sides = np.repeat(corners[face, row, column][None], 2, axis=0)
        for side, turn in zip(sides, (1, 2), strict=True):
            other = (face // 2 + turn) % 3
            side[other] = np.copysign(side[face // 2], side[other])
        stored[face, -row, -column] = look_up_cube(stored, sides, reach=0.0).mean(axis=0)


def from_equirectangular(picture: np.ndarray, side: int) -> Iterator[np.ndarray]:
    """Yield the faces of an equirectangular picture, (h, w, k), looked up at a map's texels.

    Each is (side + 2, side + 2, k) float64. Of a fine map all faces together would take several times its memory.
    """
    picture = np.ascontiguousarray(picture, dtype=np.float32)
    for face in range(FACES):
        unit = face_directions(face, side, 1)
        found = np.empty((unit.size // 3, picture.shape[2]))
        look_up(picture, unit.reshape(-1, 3), found)
        yield found.reshape(*unit.shape[:2], -1)


class CubePyramid(NamedTuple):
    """A map and its halvings, finest first."""

    texels: np.ndarray  # flat; uint16 holds half-precision floats
    first: np.ndarray  # (levels,) int64, of numbers
    side: np.ndarray  # (levels,) texels
    scale: np.ndarray  # (s,) numbers are values divided by this


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
    """Fill a row of texels, (side, k), with the means of the bilinear picture at even points of the face."""
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
            # A texel spans several pixels at the poles: there the row itself stands for what lies beyond it.
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
    """Give up the memory of an array's file where it is mapped from one; its pages come back when they are read."""
    base: np.ndarray | None = array
    while isinstance(base, np.ndarray) and not isinstance(base, np.memmap):
        base = base.base
    if isinstance(base, np.memmap) and base.mode in ("r", "r+"):
        mapped = base._mmap  # type: ignore[attr-defined]
        if mapped is not None:
            mapped.madvise(mmap.MADV_DONTNEED)


def environment_side(height: int) -> int:
    """Return the side of a cube whose texels have the mean solid angle of an equirectangular picture's at its equator.

    4 pi / (6 side²) is (pi / height)²; the side halves often.
    """
    return max(int(np.ceil(height * np.sqrt(2.0 / (3.0 * np.pi)) / 64.0)) * 64, 64)


def environment_pyramid(picture: np.ndarray, stored_from_light: np.ndarray, channels: int, half: bool) -> CubePyramid:
    """Return an environment as a cube of about its resolution, with its halvings.

    Parameters
    ----------
    picture : (height, width, k) float32 or float16
        Radiance, equirectangular; without rows for a map without levels, which nothing may be looked up in.
    stored_from_light : (s, k) float
        What is stored of it.
    channels : int
        Numbers a texel, s or more; the others are zero.
    half : bool
        Whether to store half-precision floats, each channel divided by a power of two so that none overflows.
    """
    height, width, k = picture.shape
    if height == 0:
        none = np.zeros(0, dtype=np.int64)
        return CubePyramid(np.zeros(0, np.uint16 if half else np.float32), none, none, np.ones(len(stored_from_light)))
    bound = [max(abs(float(picture[..., i].max())), abs(float(picture[..., i].min()))) for i in range(k)]
    largest = np.abs(stored_from_light) @ np.array(bound)
    scale = np.exp2(np.ceil(np.log2(np.where(largest > 0, largest, 1.0))) - 15.0) if half else np.ones(len(largest))
    sides = [environment_side(height)]
    while sides[-1] % 2 == 0 and sides[-1] // 2 >= _COARSEST_SIDE:
        sides.append(sides[-1] // 2)
    first = np.concatenate([[0], np.cumsum([FACES * (s + 2) ** 2 * channels for s in sides])])
    texels = np.zeros(first[-1], dtype=np.float16 if half else np.float32)
    maps = [
        texels[a:b].reshape(FACES, s + 2, s + 2, channels) for a, b, s in zip(first, first[1:], sides, strict=False)
    ]
    pixels = picture.ravel()
    pixels = pixels.view(np.uint16) if pixels.dtype == np.float16 else pixels.astype(np.float32, copy=False)
    matrix = (stored_from_light / scale[:, None]).astype(np.float32)
    for face, row in itertools.product(range(FACES), range(0, sides[0], _ROWS)):
        rows = np.empty((min(_ROWS, sides[0] - row), sides[0], k), dtype=np.float32)
        _fill_rows(_Picture(pixels, height, width), face, row, rows)
        maps[0][face, 1 + row : 1 + row + len(rows), 1:-1, : len(matrix)] = rows @ matrix.T
        if row + len(rows) == sides[0]:
            give_back(picture)  # the next face reads other parts of it
    for finer, coarser in itertools.pairwise(maps):
        for fine, coarse in zip(finer, coarser, strict=True):
            inner = fine[1:-1, 1:-1].astype(np.float32)
            side = len(inner) // 2
            coarse[1:-1, 1:-1] = inner.reshape(side, 2, side, 2, channels).mean(axis=(1, 3))
    for stored in maps:
        fill_borders(stored)
    return CubePyramid(texels.view(np.uint16) if half else texels, first[:-1], np.array(sides), scale)


# --- in compiled code ----------------------------------------------------------------------------------------------


@uncounted(forceinline=True)
def face_of(x, y, z):
    """Return faces, as float, and places on them, -1..1, of directions of any length; vectors of rays."""
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
    """Return where the four texels about places begin (their number), and the ways to the next.

    ``side`` is a vector of float, whole numbers.
    """
    # A place that is not a number becomes the first texel: what is looked up there is never used.
    x = lower_of(upper_of((u + 1.0) * (side * 0.5) + 0.5, 0.0), side + 0.5)
    y = lower_of(upper_of((v + 1.0) * (side * 0.5) + 0.5, 0.0), side + 0.5)
    column, row, stride = truncated(x), truncated(y), truncated(side + 2.0)
    start = truncated(lower_of(upper_of(face, 0.0), 5.0)) * stride
    return (start + row) * stride + column, x - as_float(column), y - as_float(row)


class MapPlace(NamedTuple):
    """A place in a flat map."""

    cell: int | np.integer  # number of the upper left of the four texels about it
    x: float | np.floating  # the ways to the next column and the next row, 0..1
    y: float | np.floating


@uncounted(forceinline=True)
def bilinear(texels, first, stride, place, like):
    """Return the bilinear value at a place of a flat map.

    Parameters
    ----------
    texels : flat array
    first : int
        Number at which the map begins.
    stride : int
        Texels a stored row.
    place : MapPlace
    like : vector
        As many channels as the map has.
    """
    width, fx, fy = channel_count(like), place.x, place.y
    a = first + place.cell * width
    b = a + stride * width
    # Weights, not differences: what is not negative stays so, beside a sun too.
    left, upper = 1.0 - fx, 1.0 - fy
    top = left * load_like(texels, a, like) + fx * load_like(texels, a + width, like)
    bottom = left * load_like(texels, b, like) + fx * load_like(texels, b + width, like)
    return upper * top + fy * bottom
