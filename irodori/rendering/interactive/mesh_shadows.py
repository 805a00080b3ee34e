"""Ambient occlusion by triangle meshes: rays are traced when the scene is prepared, results are looked up at each hit.

From every node of every shape (`irodori.geometry.shapes.shadow_nodes`), cosine-distributed rays are traced. They give
the share of directions that meshes leave free, among those that no other kind of shape hides, and the share that hits
the front of each mesh first, with the mean normal there. Spheres and flat shapes keep their closed formulas
(`irodori.geometry.shapes`), so that their shadows have exact edges; directions that both a mesh and such a shape hide
count once. A mesh also hides light from itself.

Objects do not move, so that the rays are traced once: `make_mesh_shadows` keeps its last result for the next scene with
the same shapes in the same places. The results do not depend on the number of threads.
"""

from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import NO_HIT, Tracer, hit_shape, is_blocked, new_ray, trace
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.shadow_nodes import GRID, Nodes, extend_to_closed
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

#: Rays per node, a power of two; the least number, in scenes with many more nodes than `_FULL_NODES`.
RAYS_PER_NODE, _LEAST_RAYS, _FULL_NODES = 512, 64, 1 << 18
#: Number of meshes whose reflected light is kept separately for each shape: those that may hide most from it. Occlusion
#: by other meshes counts too; their reflected light is taken to be that of the last of these.
MOST_MESHES = 4
#: A node is inside a mesh or a sphere if this share of its rays hits surfaces from behind.
_ENCLOSED = 0.9
#: Directions above the shading normal's horizon but below the facet are lifted to this height above the facet.
_LIFT = 1e-3
#: Values of a node: share that meshes leave free of the directions that no other shape hides; share that they leave
#: visible of other shapes; share of all directions in which they are hit first; then for each mesh the share that hits
#: its front, and the sum of normals over that share.
LEFT, UNCOVERED, HIDDEN, LAYERS, LAYER = 0, 1, 2, 3, 4
#: Integers of a shape: values per node (0 if meshes hide nothing from it), index of its first value, number of meshes
#: that are kept separately, and their indices.
STRIDE, FIRST, COUNT, SEEN, SHAPE_NUMBERS = 0, 1, 2, 3, 3 + MOST_MESHES
_CHUNK = 256


class MeshShadows(NamedTuple):
    """Ambient occlusion by meshes as flat arrays for the kernel."""

    numbers: np.ndarray  # (objects * SHAPE_NUMBERS,) int64
    grid: np.ndarray  # (objects * GRID,) float64
    first_corner: np.ndarray  # (triangles,) int64, of all meshes
    parts: np.ndarray  # (triangles,) int32
    corners: np.ndarray  # int32, nodes at the points of the triangles' grids
    values: np.ndarray  # float32


def no_mesh_shadows() -> MeshShadows:
    """Return the `MeshShadows` of a scene without meshes."""
    kinds = (np.int64, np.float64, np.int64, np.int32, np.int32, np.float32)
    return MeshShadows(*(np.zeros(1, kind) for kind in kinds))


class Bounds(NamedTuple):
    """Bounding spheres of the meshes, for compiled loops."""

    centre: np.ndarray  # (shapes, 3), mm
    radius: np.ndarray  # (shapes,), mm; 0 for shapes with a closed formula
    is_cast: np.ndarray  # (shapes,) bool, whether the shape's occlusion is found by rays
    has_inside: np.ndarray  # (shapes,) bool


def _bounds(placements: tuple[Placement, ...]) -> Bounds:
    bounds = Bounds(
        np.zeros((len(placements), 3)),
        np.zeros(len(placements)),
        np.array([p.shape.hides_by_rays for p in placements]),
        np.array([p.shape.has_inside for p in placements]),
    )
    for number, placement in enumerate(placements):
        if placement.shape.hides_by_rays:
            points = placement.points(placement.shape.hull_mm)
            bounds.centre[number] = 0.5 * (points.min(axis=0) + points.max(axis=0))
            bounds.radius[number] = np.linalg.norm(points - bounds.centre[number], axis=1).max()
    return bounds


def _strongest(nodes: Nodes, bounds: Bounds) -> np.ndarray:
    """Return up to `MOST_MESHES` meshes whose bounding spheres hide most from nodes on average, strongest first."""
    meshes = np.flatnonzero(bounds.is_cast)
    step = max(len(nodes.origin) // 1024, 1)
    hidden = np.zeros(len(meshes))
    for place, mesh in enumerate(meshes):
        away = bounds.centre[mesh] - nodes.origin[::step]
        square = (away**2).sum(axis=1)
        share = np.minimum(bounds.radius[mesh] ** 2 / np.maximum(square, 1e-300), 1.0)
        # A mesh below the horizon, such as the plate on which other objects stand, hides nothing.
        rises = (away * nodes.normal[::step]).sum(axis=1) > -bounds.radius[mesh]
        hidden[place] = np.mean(share * rises)
    return meshes[np.argsort(-hidden, kind="stable")[:MOST_MESHES]]


def _points(count: int) -> np.ndarray:
    """Return Hammersley points in the unit square, (count, 2)."""
    number, mirrored, digit = np.arange(count), np.zeros(count), 0.5
    while number.any():
        mirrored += digit * (number & 1)
        number, digit = number >> 1, 0.5 * digit
    return np.stack([(np.arange(count) + 0.5) / count, mirrored], axis=1)


@njit(cache=True, error_model="numpy")
def _may_see(bounds, origin, normal):
    """Return whether the bounding sphere of any mesh rises above a node's horizon."""
    for mesh in range(bounds.radius.size):
        radius = bounds.radius[mesh]
        if radius <= 0.0:
            continue
        x, y, z = (
            bounds.centre[mesh, 0] - origin[0],
            bounds.centre[mesh, 1] - origin[1],
            bounds.centre[mesh, 2] - origin[2],
        )
        if x * normal[0] + y * normal[1] + z * normal[2] > -1.001 * radius:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _direction(normal, facet, tangent, bitangent, u, v):
    """Map a point of the unit square to a direction, cosine-distributed around a normal and above the facet."""
    around, far = 2.0 * np.pi * v, np.sqrt(u)
    a, b, c = far * np.cos(around), far * np.sin(around), np.sqrt(max(1.0 - u, 0.0))
    x = a * tangent[0] + b * bitangent[0] + c * normal[0]
    y = a * tangent[1] + b * bitangent[1] + c * normal[1]
    z = a * tangent[2] + b * bitangent[2] + c * normal[2]
    height = x * facet[0] + y * facet[1] + z * facet[2]
    if height < _LIFT:
        up = _LIFT - height
        x, y, z = x + up * facet[0], y + up * facet[1], z + up * facet[2]
        inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
        x, y, z = x * inverse, y * inverse, z * inverse
    return x, y, z


@njit(cache=True)
def _tangents(normal):
    """Return two unit vectors perpendicular to a normal and to each other (Duff et al. 2017)."""
    x, y, z = normal
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


class _Rays(NamedTuple):
    """Addresses of Embree's functions, of the scene, and of the scene without its meshes."""

    intersect: int
    occluded: int
    scene: int
    others: int


class _Casting(NamedTuple):
    """Scene into which rays are traced from the nodes of one shape, and sample points for their directions."""

    rays: _Rays
    bounds: Bounds
    layer_of: np.ndarray  # (shapes,) int64, number of the mesh among those that are kept separately
    points: np.ndarray  # (n, 2) in the unit square, one for each direction


@njit(cache=True, error_model="numpy")
def _add_ray(casting, ray, origin, direction, values, node):
    """Add a traced ray to a node's sums; return whether no other shape hides it, and whether it hits an inside."""
    rays, bounds = casting.rays, casting.bounds
    trace(rays.intersect, rays.scene, ray, origin, direction, np.inf)
    shape = hit_shape(ray)
    if shape == NO_HIT:
        values[node, LEFT] += 1.0
        return True, False
    x, y, z = float(ray.f[ray.at + 12]), float(ray.f[ray.at + 13]), float(ray.f[ray.at + 14])
    front = x * direction[0] + y * direction[1] + z * direction[2] < 0.0
    if not bounds.is_cast[shape]:
        values[node, UNCOVERED] += 1.0
        return False, bounds.has_inside[shape] and not front
    values[node, HIDDEN] += 1.0
    length = np.sqrt(x * x + y * y + z * z)
    if front and length > 0.0:
        at = LAYERS + LAYER * casting.layer_of[shape]
        values[node, at] += 1.0
        values[node, at + 1] += x / length
        values[node, at + 2] += y / length
        values[node, at + 3] += z / length
    trace(rays.occluded, rays.others, ray, origin, direction, np.inf)
    return not is_blocked(ray), not front


@njit(cache=True, error_model="numpy")
def _cast(casting, ray, nodes, number, values):
    """Compute the values of a node by rays; return whether it lies in the open, not inside or behind a surface.

    ``nodes`` has origin, normal, facet and probe of all nodes, (n, 3) each.
    """
    points = casting.points
    origin = (nodes[0][number, 0], nodes[0][number, 1], nodes[0][number, 2])
    normal = (nodes[1][number, 0], nodes[1][number, 1], nodes[1][number, 2])
    facet = (nodes[2][number, 0], nodes[2][number, 1], nodes[2][number, 2])
    if not _may_see(casting.bounds, origin, normal):
        values[number, LEFT] = values[number, UNCOVERED] = 1.0
        return True
    tangent, bitangent = _tangents(normal)
    # Every node shifts the points differently (Roberts' sequence), so that errors appear as noise and not as steps.
    shift_u, shift_v = (number * 0.7548776662466927) % 1.0, (number * 0.5698402909980532) % 1.0
    free = inside = 0
    for sample in range(points.shape[0]):
        u, v = (points[sample, 0] + shift_u) % 1.0, (points[sample, 1] + shift_v) % 1.0
        direction = _direction(normal, facet, tangent, bitangent, u, v)
        one = _add_ray(casting, ray, origin, direction, values, number)
        free += one[0]
        inside += one[1]
    others = points.shape[0] - free
    values[number, LEFT] = values[number, LEFT] / free if free > 0 else 1.0
    values[number, UNCOVERED] = values[number, UNCOVERED] / others if others > 0 else 1.0
    for field in range(HIDDEN, values.shape[1]):
        values[number, field] /= points.shape[0]
    return inside < _ENCLOSED * points.shape[0] and not _is_cut_off(casting.rays, ray, nodes[3], number, origin)


@njit(cache=True, error_model="numpy")
def _is_cut_off(rays, ray, probe, number, origin):
    """Return whether a surface lies between a node and its probe point."""
    way = (probe[number, 0] - origin[0], probe[number, 1] - origin[1], probe[number, 2] - origin[2])
    length = np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    if length <= 0.0:
        return False
    way = (way[0] / length, way[1] / length, way[2] / length)
    trace(rays.occluded, rays.scene, ray, origin, way, length)
    return is_blocked(ray)


@njit(cache=True, nogil=True)
def _cast_some(casting, nodes, values, is_open, first, last):
    ray = new_ray()
    for number in range(first, last):
        is_open[number] = _cast(casting, ray, nodes, number, values)


def _values(nodes: Nodes, rays: _Rays, bounds: Bounds, layers: np.ndarray, count: int) -> np.ndarray:
    """Return the occlusion values of a shape's nodes, (n, LAYERS + LAYER * layers) float32."""
    layer_of = np.full(len(bounds.is_cast), len(layers) - 1, dtype=np.int64)
    layer_of[layers] = np.arange(len(layers))
    values = np.zeros((len(nodes.origin), LAYERS + LAYER * len(layers)), dtype=np.float32)
    is_open = np.zeros(len(values), dtype=np.bool_)
    places = tuple(np.ascontiguousarray(p) for p in (nodes.origin, nodes.normal, nodes.facet, nodes.probe))
    casting = _Casting(rays, bounds, layer_of, _points(count))
    run_chunks(_cast_some, len(values), _CHUNK, casting, places, values, is_open)
    extend_to_closed(values, is_open, nodes.cells)
    return values


_found: list = []


def make_mesh_shadows(tracer: Tracer) -> MeshShadows | None:
    """Return the ambient occlusion by a scene's meshes, or None if no mesh hides light.

    The last result is kept and returned again for the same shapes in the same places.
    """
    key = [(p.shape, p.rotation.tobytes(), p.translation_mm.tobytes(), p.scale) for p in tracer.placements]
    if not _found or _found[0] != key:
        _found[:] = key, _make(tracer)
    return _found[1]


def _make(tracer: Tracer) -> MeshShadows | None:
    placements = tracer.placements
    bounds = _bounds(placements)
    if not bounds.is_cast.any():
        return None
    others = Tracer([p for p in placements if not p.shape.hides_by_rays])
    rays = _Rays(tracer.intersect_address, tracer.occluded_address, tracer.scene, others.scene)
    points = [p.points(p.shape.hull_mm) for p in placements if p.shape.hides_by_rays]
    numbers, grid = np.zeros((len(placements), SHAPE_NUMBERS), np.int64), np.zeros((len(placements), GRID))
    made = [p.shape.nodes(p, r, points) for p, r in zip(placements, reaches(placements), strict=True)]
    total = sum(len(nodes.origin) for nodes in made if nodes is not None)
    count = max(RAYS_PER_NODE >> max(int(np.ceil(np.log2(total / _FULL_NODES))), 0), _LEAST_RAYS)
    values: list[np.ndarray] = []
    parts, corners = [], []
    for shape, nodes in enumerate(made):
        if nodes is None:
            continue
        layers = _strongest(nodes, bounds)
        found = _values(nodes, rays, bounds, layers, count)
        seen = np.flatnonzero(found[:, LAYERS::LAYER].any(axis=0))
        if found[:, HIDDEN].any():
            kept = np.concatenate([np.arange(LAYERS), (LAYERS + LAYER * seen[:, None] + np.arange(LAYER)).ravel()])
            numbers[shape, STRIDE], numbers[shape, COUNT] = len(kept), len(seen)
            numbers[shape, FIRST] = sum(part.size for part in values)
            numbers[shape, SEEN : SEEN + len(seen)] = layers[seen]
            grid[shape] = nodes.grid
            values.append(found[:, kept].ravel())
        parts.append(nodes.parts)
        corners.append(nodes.corners)
    if not values:
        return None
    sides = np.concatenate(parts)
    sizes = (sides.astype(np.int64) + 1) * (sides + 2) // 2
    stored = (numbers.ravel(), grid.ravel(), np.cumsum(sizes) - sizes, sides, np.concatenate(corners))
    return MeshShadows(*stored, np.concatenate(values))
