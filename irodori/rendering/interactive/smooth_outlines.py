"""Outlines in a picture: pixels whose one ray says little about their colour, and the rays that they get in addition.

It is noted which shape the ray through the middle of each pixel meets, for a tile's pixels and those around the tile.
A pixel is at an outline if one of its four neighbours shows another shape. Of a mesh, the inverse of the distance is
noted too, which a flat surface makes linear in the picture: where it bends, the mesh has an edge or hides another part
of itself.

At an outline, `SIDE` × `SIDE` further rays find what share of the pixel each shape covers; parts of a mesh at unlike
distances count as shapes. Four of the rays are shaded, and one of each shape that none of the four meets. Each counts
for the share of its shape. If all rays meet the same shape and nothing bends, the pixel keeps the colour of its first
ray. Tiles do not depend on each other.
"""

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from irodori.jit.compilation import uncounted
from irodori.jit.functions import as_float, magnitude, select
from irodori.jit.vector_memory import lane, load, mask_bits, pointer, store
from irodori.rendering.interactive.shading import bits_set

#: Change of the slope of a surface towards the picture, from a pixel to the next, that makes an outline. A right angle
#: seen from its bisector has 2, and a ball one of 1.5 two pixels inside its outline.
_BEND = 1.5
#: Difference of distances, in widths of a pixel, beyond which two places of a mesh are not of one surface.
_STEP = 8.0
#: Rays along each side of a pixel at an outline, and those, as bits, that are shaded of each shape.
SIDE, _SHADED = 4, 1 << 4 | 1 << 13 | 1 << 2 | 1 << 11
_TILE = 16
#: Numbers from a row of a `Met` to the next, and numbers in all: rows of 16, what is around them, and room for loads.
_STRIDE = _TILE + 2
MET = _STRIDE * _STRIDE + _TILE


class Met(NamedTuple):
    """Shapes that the rays through the pixels of a tile and those around it meet, in rows; see `place_in`."""

    number: np.ndarray  # (MET,) int32, of the shape; -1 for none
    inverse: np.ndarray  # (MET,) float32, of the distance to a mesh, 1 / mm; 0 for all else


def spread_points() -> np.ndarray:
    """Return points in a pixel, (SIDE², 2) float32 from 0 to 1: a square grid, turned by the arctangent of 1 / SIDE.

    Each of SIDE × SIDE equal cells holds one of them, and so does each of SIDE² strips across the pixel, and along. An
    upright edge thus moves over one at a time, while a grid that is not turned loses SIDE of them at once.
    """
    column, row = (axis.ravel() for axis in np.meshgrid(np.arange(SIDE), np.arange(SIDE)))
    x, y = column + (row + 0.5) / SIDE, row + (SIDE - 0.5 - column) / SIDE
    return (np.stack([x, y], axis=1) / SIDE).astype(np.float32)


@intrinsic
def _store_block(typingctx, array, place, value):
    """Store a vector of sixteen as a block of 4 × 4 pixels of a `Met`, of which the first is at ``place``."""

    def codegen(context, builder, sig, args):
        number = ir.IntType(32)
        for row in range(4):
            mask = ir.Constant(ir.VectorType(number, 4), [4 * row + column for column in range(4)])
            part = builder.shuffle_vector(args[2], args[2], mask)
            at = builder.add(args[1], ir.Constant(args[1].type, row * _STRIDE))
            target = pointer(context, builder, sig.args[0], args[0], at)
            builder.store(part, builder.bitcast(target, part.type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@uncounted(forceinline=True)
def place_in(column, row):
    """Return the place in a `Met` of a pixel, given from the first one of the tile; -1 is beside the tile."""
    return (row + 1) * _STRIDE + column + 1


@uncounted(forceinline=True)
def note_block(met, column, row, number, inverse):
    """Note what the rays of a block of 4 × 4 pixels, given by the first one, meet."""
    at = place_in(column, row)
    _store_block(met.number, at, number)
    _store_block(met.inverse, at, inverse)


@uncounted(forceinline=True)
def note_row(met, row, number, inverse):
    """Note what the rays of the sixteen pixels of a row meet."""
    at = place_in(0, row)
    store(met.number, at, number)
    store(met.inverse, at, inverse)


@uncounted(forceinline=True)
def note_pixel(met, column, row, number, inverse):
    """Note what the ray of a pixel meets."""
    at = place_in(column, row)
    met.number[at], met.inverse[at] = number, inverse


@uncounted(forceinline=True)
def outline_bits(frame, met, row):
    """Return which of the sixteen pixels in a row of a tile are beside another shape, and at which a mesh bends."""
    at = place_in(0, row)
    own, middle = load(met.number, at, 16), load(met.inverse, at, 16)
    # Lengths of a pixel at the hit: a part of its distance, or the same everywhere if rays are parallel.
    most = _BEND * frame.pixel * (middle * float(1 - frame.parallel) + middle * middle * float(frame.parallel))
    beside = bent = most < 0.0
    for step in (1, _STRIDE):
        same = (load(met.number, at - step, 16) == own) & (load(met.number, at + step, 16) == own)
        across = magnitude(load(met.inverse, at - step, 16) + load(met.inverse, at + step, 16) - 2.0 * middle)
        beside, bent = beside | ~same, bent | (same & (across > most))
    return mask_bits(beside), mask_bits(bent)


@uncounted()
def shaded_rays(frame, shape, inverse):
    """Return which of a pixel's rays to shade, as bits, and the share of the pixel for which each of them counts.

    ``shape`` and ``inverse`` are what the rays meet, as in a `Met`.
    """
    left, chosen, share = 0xFFFF, 0, as_float(shape) * 0.0
    while left:
        first = left & -left
        number = 0
        while first >> number > 1:
            number += 1
        near = lane(inverse, number)
        most = _STEP * frame.pixel * (near * float(1 - frame.parallel) + near * near * float(frame.parallel))
        alike = (shape == lane(shape, number)) & ~(magnitude(inverse - near) > most)
        members = mask_bits(alike) & left
        some = members & _SHADED
        some = some if some else first
        share = select(alike & (share == 0.0), np.float32(bits_set(members)) / np.float32(16 * bits_set(some)), share)
        left, chosen = left & ~members, chosen | some
    return chosen, share
