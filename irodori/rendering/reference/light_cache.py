"""Cache of the light on a scene's surfaces, which ends paths of the path tracer after their first diffuse reflection.

Most of a path's time is spent on light that has been reflected several times, which adds little and varies little from
place to place. The cache holds the light on coarse texels of all surfaces, direct light included, as the radiance of a
perfect diffuser there. A path that meets a surface after a diffuse reflection takes the surface's diffuse light from a
texel around the hit, chosen by the weights of bilinear interpolation, and goes on with gloss and mirror only (final
gathering: Reichert 1992; Jensen 1996).

No texel is ever seen, neither directly nor in a mirror: the cache is used only if the path may have arrived anywhere in
an area larger than a texel. That area is the square of each distance times the solid angle over which the path's
direction was spread before (from its sampling density). Where surfaces are close together, as in corners and beside
contacts, paths therefore go on without the cache.

Texels have the places of light maps (`irodori.rendering.map_layouts`). Their light is path-traced in passes. The paths
of the first pass are complete; those of the next passes end in the cache of the pass before, so that their noise is a
fraction of the former's. Each pass is unbiased, but for the size of the texels. The two independent sets of a picture's
paths have each their own half of all this, so that the difference between the sets shows the noise of the cache too.
"""

from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import hit_barycentric, hit_primitive
from irodori.geometry.shapes.mesh_nodes import lattice_place
from irodori.geometry.shapes.surface_nodes import warped_place
from irodori.jit.compilation import uncounted
from irodori.rendering.scene_lights import PADDED


class Cache(NamedTuple):
    """Light on the texels of all surfaces, for compiled loops; without nodes if there is no cache.

    The texels of a picture are numbered row by row, those of a mesh as in `irodori.geometry.shapes.surface_nodes`.
    """

    light: np.ndarray  # (2, texels, 64) float32 radiance of a perfect diffuser, for each of two sets of paths
    least_mm2: np.ndarray  # (texels,) float32 area from which on a texel is used, infinite inside other objects
    first: np.ndarray  # (surfaces,) int64 first texel of a surface, -1 without a cache
    size: np.ndarray  # (surfaces, 2) int64 rows and columns of a picture; 0 rows for a mesh
    wraps: np.ndarray  # (surfaces,) int64 1 if the first column is beside the last
    grid: np.ndarray  # (surfaces, 4) middle and reach of an endless plane's picture, mm; zeros for other shapes
    parts: np.ndarray  # (triangles,) int32 parts of the edges of a mesh's triangle
    corner: np.ndarray  # (triangles,) int64 index of the triangle's first corner
    corners: np.ndarray  # int32, texels at the points of the divided triangles


def no_cache(surfaces: int) -> Cache:
    """Return a cache without texels for a number of surfaces."""
    return Cache(
        np.zeros((2, 0, PADDED), np.float32),
        np.zeros(0, np.float32),
        np.full(surfaces, -1, np.int64),
        np.zeros((surfaces, 2), np.int64),
        np.zeros(surfaces, np.int64),
        np.zeros((surfaces, 4)),
        np.zeros(0, np.int32),
        np.zeros(0, np.int64),
        np.zeros(0, np.int32),
    )


@uncounted(forceinline=True)
def _chosen(fraction, number):
    """Return 0 or 1, the latter with the probability ``fraction``, and a number that is uniform again."""
    if number < fraction:
        return 1, number / fraction
    return 0, (number - fraction) / (1.0 - fraction)


@uncounted(forceinline=True)
def _texel_of_picture(cache, index, u, v, number):
    """Return a texel around a place of a surface's picture, chosen by the weights of bilinear interpolation."""
    rows, columns = cache.size[index, 0], cache.size[index, 1]
    x, y = u * columns - 0.5, min(max(v * rows - 0.5, 0.0), rows - 1.0)
    if cache.wraps[index] == 0:
        x = min(max(x, 0.0), columns - 1.0)
    left, above = np.int64(np.floor(x)), np.int64(y)
    right, number = _chosen(x - left, number)
    below, number = _chosen(y - above, number)
    row, column = min(above + below, rows - 1), left + right
    column = column + columns if column < 0 else column
    column = column - columns if column >= columns else column
    return row * columns + column


@uncounted(forceinline=True)
def _texel_of_mesh(cache, face, ray, number):
    """Return a texel around a hit on a triangle, chosen by the weights of linear interpolation."""
    b, c = hit_barycentric(ray)
    places, weights = lattice_place(np.int64(cache.parts[face]), float(b), float(c))
    place = places[2]
    if number < weights[0]:
        place = places[0]
    elif number < weights[0] + weights[1]:
        place = places[1]
    return np.int64(cache.corners[cache.corner[face] + place])


@uncounted(forceinline=True)
def cached_texel(world, ray, work, index, number):
    """Return the texel whose light stands for that on the surface that a path has met, or -1 if none may.

    Parameters
    ----------
    world : World
    ray : as in `irodori.geometry.embree.trace`
    work : Work
        Its ``spread`` has the area in which the path may have arrived; ``place`` the hit's texture coordinates.
    index : int
        Number of the surface.
    number : float
        Uniform random number in [0, 1).
    """
    cache = world.cache
    first = cache.first[index]
    if first < 0:
        return -1
    if cache.size[index, 0] == 0:
        texel = first + _texel_of_mesh(cache, world.surfaces.first_face[index] + hit_primitive(ray), ray, number)
    else:
        u, v = work.place[0], work.place[1]
        if cache.grid[index, 2] > 0.0:
            u, v = _place_on_plane(world, work, index)
        texel = first + _texel_of_picture(cache, index, u, v, number)
    return texel if work.spread[1] >= cache.least_mm2[texel] else -1


@uncounted(forceinline=True)
def _place_on_plane(world, work, index):
    """Return the place, 0..1, of a path's hit in the picture of an endless plane."""
    across, along, surfaces, grid = 0.0, 0.0, world.surfaces, world.cache.grid
    for axis in range(3):
        away = work.point[axis] - surfaces.translation_mm[index, axis]
        across += away * surfaces.rotation[index, axis, 0]
        along += away * surfaces.rotation[index, axis, 1]
    u = warped_place((across - grid[index, 0]) / grid[index, 2])
    return 0.5 + 0.5 * u, 0.5 + 0.5 * warped_place((along - grid[index, 1]) / grid[index, 3])
