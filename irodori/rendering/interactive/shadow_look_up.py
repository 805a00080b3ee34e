"""Look-up of ambient occlusion at a hit from the nodes around it."""

import numpy as np

from irodori.geometry.shapes import MESH, SPHERE
from irodori.jit.native import njit
from irodori.rendering.interactive.mesh_shadows import FIRST, SHAPE_NUMBERS, STRIDE
from irodori.rendering.interactive.packets import (
    BARYCENTRIC_B,
    BARYCENTRIC_C,
    CENTRE,
    KIND,
    RAYS,
    SHAPE,
    TEXTURE_U,
    TEXTURE_V,
    TRIANGLE,
    TURN,
)
from irodori.rendering.interactive.shadow_nodes import COLUMNS, DENSITY, GRID, LOW, MIDDLE, REACH, ROWS


@njit(cache=True, error_model="numpy")
def warped_place(offset):
    """Return the place of an offset in units of a grid's reach, see `shadow_nodes.warped`."""
    away = abs(offset)
    if away <= 1.0:
        return 0.5 * offset
    return 1.0 - 0.5 / away if offset > 0.0 else 0.5 / away - 1.0


@njit(cache=True)
def _lattice_place(parts, b, c):
    """Return the three places about a point of a triangle, the last of them twice, and their weights."""
    x, y = min(max(b, 0.0), 1.0) * parts, min(max(c, 0.0), 1.0) * parts
    j = min(int(y), parts - 1)
    i = min(int(x), parts - 1 - j)
    fx, fy = min(x - i, 1.0), min(y - j, 1.0)
    here = j * (parts + 1) - j * (j - 1) // 2 + i
    above = here + parts + 1 - j
    if i + j == parts - 1 and fx + fy > 1.0:
        # Beyond the triangle's third edge by rounding, where no further places are.
        fx = fx / (fx + fy)
        fy = 1.0 - fx
    if i + j == parts - 1 or fx + fy <= 1.0:
        return (here, here + 1, above, above), (1.0 - fx - fy, fx, fy, 0.0)
    return (above + 1, above, here + 1, here + 1), (fx + fy - 1.0, 1.0 - fx, 1.0 - fy, 0.0)


@njit(cache=True)
def _grid_place(column, row, columns, rows, wraps):
    """Return the four nodes about a place of a grid, and their weights."""
    y = min(max(row, 0.0), rows - 1.0)
    j = min(int(y), rows - 2)
    x = column if wraps else min(max(column, 0.0), columns - 1.0)
    i = int(np.floor(x)) if wraps else min(int(x), columns - 2)
    fx, fy = x - i, y - j
    left, right = i % columns, (i + 1) % columns
    at, below = j * columns, (j + 1) * columns
    weights = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (at + left, at + right, below + left, below + right), weights


@njit(cache=True)
def nodes_about(world, hits, ray, own, point):
    """Return the nodes about a hit of a shape, (4,) int, and their weights, (4,) float, which add up to 1."""
    shadows = world.shadows
    kind, f = world.shape[own * SHAPE + KIND], hits.f
    if kind == MESH:
        triangle = world.surfaces.first_face[own] + hits.i[TRIANGLE * RAYS + ray]
        b, c = np.float64(f[BARYCENTRIC_B * RAYS + ray]), np.float64(f[BARYCENTRIC_C * RAYS + ray])
        places, weights = _lattice_place(np.int64(shadows.parts[triangle]), b, c)
        first = shadows.first_corner[triangle]
        corners = shadows.corners
        return (
            np.int64(corners[first + places[0]]),
            np.int64(corners[first + places[1]]),
            np.int64(corners[first + places[2]]),
            np.int64(corners[first + places[3]]),
        ), weights
    grid, at = shadows.grid, own * GRID
    columns, rows = np.int64(grid[at + COLUMNS]), np.int64(grid[at + ROWS])
    if kind == SPHERE:
        column, row = f[TEXTURE_U * RAYS + ray] * columns - 0.5, f[TEXTURE_V * RAYS + ray] * rows - 0.5
        return _grid_place(np.float64(column), np.float64(row), columns, rows, True)
    table, place = world.shape, own * SHAPE
    x, y, z = (
        point[0] - table[place + CENTRE],
        point[1] - table[place + CENTRE + 1],
        point[2] - table[place + CENTRE + 2],
    )
    across = x * table[place + TURN] + y * table[place + TURN + 3] + z * table[place + TURN + 6]
    along = x * table[place + TURN + 1] + y * table[place + TURN + 4] + z * table[place + TURN + 7]
    column = (warped_place((across - grid[at + MIDDLE]) / grid[at + REACH]) - grid[at + LOW]) * grid[at + DENSITY]
    row = (warped_place((along - grid[at + MIDDLE + 1]) / grid[at + REACH + 1]) - grid[at + LOW + 1]) * grid[
        at + DENSITY + 1
    ]
    return _grid_place(column, row, columns, rows, False)


@njit(cache=True)
def mixed(shadows, own, about, number):
    """Return a number of the nodes about a hit, by their weights."""
    nodes, weights = about
    stride, first = shadows.numbers[own * SHAPE_NUMBERS + STRIDE], shadows.numbers[own * SHAPE_NUMBERS + FIRST]
    found = 0.0
    for corner in range(4):
        found += weights[corner] * shadows.values[first + nodes[corner] * stride + number]
    return found
