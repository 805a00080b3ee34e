"""Encoding of a scene's shapes, materials, light and shadows into the planes of a classroom page's payload.

The data are those of `irodori.rendering.interactive`, because the page uses the same algorithm: light as cube maps with
a border of one texel, levels of blurred light, gloss lobes as rows of round lobes. Data that the scene does not have
get no plane.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from irodori.core.errors import PlainError
from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.shadow_nodes import COLUMNS, GRID, ROWS
from irodori.light.environment_file import Environment
from irodori.reflection.lobes import Lobes
from irodori.rendering.interactive.channels import mean_spectra
from irodori.rendering.interactive.cube_maps import environment_pyramid, face_directions, from_equirectangular
from irodori.rendering.interactive.mesh_shadows import COUNT, FIRST, SEEN, SHAPE_NUMBERS, STRIDE, MeshShadows
from irodori.rendering.interactive.prepared_scene import gloss_for, needed_gloss
from irodori.rendering.interactive.round_lobes import gloss_power, ladder, lobe_table, roughness_at, roughness_place
from irodori.rendering.scene_arrays import Objects, coefficients_of, gloss_of, textures
from irodori.viewer.payload import StoredPlanes

#: Lobes that the page's shader knows; a lobe from elsewhere has no page.
LOBES = ("gaussian", "ggx")
#: Texels along the side of a cube of light, at most: the finest levels of a finer one are left out.
MOST_SIDE = 256
#: Levels of blurred light with more texels along the side are stored at half the side, with a border as wide as the
#: interpolation of `finer` needs.
HALVED_FROM, BORDER = 32, 4


@dataclass(frozen=True)
class LightMaps:
    """Light of one environment as the maps that the page looks up.

    Parameters
    ----------
    basis : (k, 61) float64
    white : (61,) float64
        Radiance of a perfect diffuser that faces up.
    sky : (k, 6, side, side) float, or None if the environment is dark
        Radiance, without border.
    irradiance : (k, 6, side + 2, side + 2) float, or None
        Irradiance, in the unit of radiance times sr.
    gloss : list of (k, 6, n, n) float
        Levels of blurred radiance as stored: at half the side with a border of `BORDER`, or with a border of 1.
    sides : list of int
        Texels along the side of each level when it is looked up.
    first : int
        Index of the first level in `irodori.light.blurred_light.WIDTHS_RAD`.
    """

    basis: np.ndarray
    white: np.ndarray
    sky: np.ndarray | None
    irradiance: np.ndarray | None
    gloss: list[np.ndarray]
    sides: list[int]
    first: int


def interpolation(offset: float) -> np.ndarray:
    """Return the weights of Lagrange interpolation at ``offset`` from values at the eight integers -3 to 4."""
    nodes = np.arange(-3, 5)
    return np.array([np.prod([(offset - m) / (n - m) for m in nodes if m != n]) for n in nodes])


def finer(stored: np.ndarray) -> np.ndarray:
    """Interpolate a stored level, (..., n + 8, n + 8), to twice the side with a border of 1, (..., 2 n + 2, 2 n + 2).

    Centres of the fine texels lie a quarter of a coarse texel beside the coarse centres. Blurred levels are smooth: for
    a lobe one and a half texels wide, the error of Lagrange interpolation is less than a thousandth.
    """
    for axis in (-2, -1):
        moved = np.moveaxis(stored, axis, -1)
        n = moved.shape[-1] - 2 * BORDER
        out = np.zeros((*moved.shape[:-1], 2 * n + 2))
        for place in range(2 * n + 2):
            coarse = (place - 0.5) / 2 - 0.5
            base = int(np.floor(coarse))
            window = moved[..., base + BORDER - 3 : base + BORDER + 5]
            out[..., place] = window @ interpolation(coarse - base)
        stored = np.moveaxis(out, -1, axis)
    return stored


def _cube(picture: np.ndarray, side: int, border: int) -> np.ndarray:
    """Resample an equirectangular picture, (h, w, k), to a cube map with a border, (k, 6, s, s) float32.

    ``s`` is side + 2 border.
    """
    if border == 1:
        faces = list(from_equirectangular(picture, side))
    else:
        from irodori.light.irradiance import irradiance_at

        faces = [irradiance_at(picture, face_directions(face, side, border)) for face in range(6)]
    return np.moveaxis(np.stack(faces), -1, 0).astype(np.float32)


def _principal(environment: Environment) -> tuple[np.ndarray, np.ndarray]:
    """Return an environment's principal vectors, (k, 61), and the matrix from stored to principal coefficients, (k, k).

    The stored coefficients may be on another basis of the same space. The first principal vector is positive, as light
    is, and so is its coefficient everywhere, so that a payload can store its logarithm.
    """
    vectors, stored = np.linalg.qr(environment.basis.astype(np.float64))
    flat = environment.coefficients.reshape(-1, environment.basis.shape[1]).astype(np.float32)
    moments = stored @ (flat.T @ flat).astype(np.float64) @ stored.T
    principal = np.linalg.eigh(moments)[1][:, ::-1]
    principal = principal * np.where((vectors @ principal).sum(axis=0) < 0.0, -1.0, 1.0)
    return np.ascontiguousarray((vectors @ principal).T), principal.T @ stored


def light_maps(environment: Environment, objects: Objects) -> LightMaps:
    """Return the maps of an environment that the materials of a scene's objects need."""
    white = environment.upward_white()
    if not environment.coefficients.any():
        return LightMaps(environment.basis.T.astype(np.float64), white, None, None, [], [], 0)
    basis, principal_from_stored = _principal(environment)
    k = len(basis)
    pyramid = environment_pyramid(environment.coefficients, principal_from_stored, k, half=False)
    level = next(i for i, side in enumerate(pyramid.side) if side <= MOST_SIDE)
    side, first = int(pyramid.side[level]), int(pyramid.first[level])
    whole = pyramid.texels[first : first + 6 * (side + 2) ** 2 * k].reshape(6, side + 2, side + 2, k)
    sky = np.moveaxis(whole[:, 1:-1, 1:-1], -1, 0)
    rows = environment.irradiance.shape[0]
    irradiance = _cube((environment.irradiance @ principal_from_stored.T).astype(np.float32), rows, 1)
    gloss, sides, number = [], [], 0
    if any(beta.any() for texels in textures(objects) for beta, _ in gloss_of(objects, texels)):
        maps = needed_gloss(gloss_for(environment, objects), objects)
        number = maps.first
        for level_of_file in maps.levels:
            picture = level_of_file @ principal_from_stored.T.astype(np.float32)
            wanted = int(np.ceil(picture.shape[0] * 2.0 / np.pi))
            if wanted > HALVED_FROM:
                gloss.append(_cube(picture, -(-wanted // 2), BORDER))
                sides.append(2 * -(-wanted // 2))
            else:
                gloss.append(_cube(picture, wanted, 1))
                sides.append(wanted)
    return LightMaps(basis, white, sky, irradiance, gloss, sides, number)


def add_light(planes: StoredPlanes, number: int, maps: LightMaps) -> dict:
    """Add the planes of an environment's maps and return the environment's entry for the header."""
    name = f"light/{number}"
    planes.add_floats(f"{name}/basis", maps.basis)
    planes.add_floats(f"{name}/white", maps.white)
    if maps.sky is not None and maps.irradiance is not None:
        planes.add_light(f"{name}/sky", maps.sky, maps.basis)
        planes.add_light(f"{name}/irradiance", maps.irradiance, maps.basis)
        for level, values in enumerate(maps.gloss):
            planes.add_light(f"{name}/gloss/{level}", values, maps.basis)
    return {"is_dark": maps.sky is None, "gloss_sides": maps.sides, "gloss_first": maps.first}


def decoded_light(planes: dict[str, np.ndarray], number: int, entry: dict) -> LightMaps:
    """Return the maps of an environment from decoded planes and its entry in the header."""
    name = f"light/{number}"
    gloss = [planes[f"{name}/gloss/{level}"] for level in range(len(entry["gloss_sides"]))]
    basis, white = (planes[f"{name}/{part}"].astype(np.float64) for part in ("basis", "white"))
    sky, irradiance = planes.get(f"{name}/sky"), planes.get(f"{name}/irradiance")
    return LightMaps(basis, white, sky, irradiance, gloss, entry["gloss_sides"], entry["gloss_first"])


def check_lobes(lobes: Lobes) -> None:
    """Raise an error for a lobe that the page's shader does not have.

    Raises
    ------
    PlainError
    """
    unknown = [name for name in lobes.names if name not in LOBES]
    if unknown:
        raise PlainError(f"the lobe {unknown[0]!r} has no page; accepted: {', '.join(LOBES)}.")


def add_materials(planes: StoredPlanes, objects: Objects) -> list[dict]:
    """Add the planes of the objects' materials and return each object's entry for the header."""
    check_lobes(objects.lobes)
    means, entries = mean_spectra(objects), []
    for i, texels in enumerate(textures(objects)):
        name, bases = f"object/{i}", int(objects.bases[i])
        planes.add_floats(f"{name}/basis", objects.basis[i, :bases])
        planes.add_floats(f"{name}/mean", means[i])
        planes.add_floats(f"{name}/index", np.stack([objects.n[i], objects.k[i]]))
        planes.add_linear(f"{name}/reflectance", np.moveaxis(coefficients_of(objects, texels)[..., :bases], -1, 0))
        lobes: list[int] = []
        components: list[int] = []
        for component, (beta, mu) in enumerate(gloss_of(objects, texels)):
            if not beta.any():
                continue
            kind = objects.lobes.names[objects.lobe[i, component]]
            planes.add_log(f"{name}/power/{len(lobes)}", gloss_power(beta, mu, kind)[None])
            planes.add_linear(f"{name}/place/{len(lobes)}", roughness_place(np.where(mu > 0, mu, 1.0), kind)[None])
            lobes.append(int(objects.lobe[i, component]))
            components.append(component)
        entries.append(
            {
                "texels": list(texels.shape[:2]),
                "bases": bases,
                "lobes": lobes,
                "components": components,
                "has_gloss": bool(lobes),
                "mirror": float(objects.mirror[i]),
                "is_grey": bool(objects.grey[i]),
                "wraps": bool(objects.wraps[i]),
            }
        )
    if any(entry["lobes"] for entry in entries):
        for number, kind in enumerate(objects.lobes.names):
            planes.add_floats(f"lobe/{number}", lobe_table(kind).entries)
    return entries


def lobe_entries(objects: Objects) -> list[dict]:
    """Return the lobes' entry for the header: names, and first ln μ and step of their tables over roughness."""
    pairs = zip(objects.lobes.names, ladder(objects.lobes), strict=True)
    return [{"name": name, "ladder": [float(first), float(step)]} for name, (first, step) in pairs]


def decoded_objects(objects: Objects, planes: dict[str, np.ndarray], entries: list[dict]) -> Objects:
    """Return a copy of a scene's objects with the texels decoded from a payload."""
    texels = np.zeros_like(objects.texels)
    found = objects._replace(texels=texels)
    gloss = objects.texels.shape[1] - 2 * objects.lobe.shape[1]
    for i, (own, entry) in enumerate(zip(textures(found), entries, strict=True)):
        own[..., : entry["bases"]] = np.moveaxis(planes[f"object/{i}/reflectance"], 0, -1)
        for number, (which, component) in enumerate(zip(entry["lobes"], entry["components"], strict=True)):
            kind = objects.lobes.names[which]
            mu = roughness_at(planes[f"object/{i}/place/{number}"][0], kind)
            unit = gloss_power(np.ones_like(mu), mu, kind)
            own[..., gloss + 2 * component] = planes[f"object/{i}/power/{number}"][0] / unit
            own[..., gloss + 2 * component + 1] = mu
    return found


def _mesh_planes(planes: StoredPlanes, name: str, mesh: Mesh) -> None:
    """Add the planes of a mesh: its distinct corners, and the triangles as indices of corners."""
    corners = np.concatenate([mesh.vertices_mm[mesh.faces], mesh.normals, mesh.uv], axis=-1).reshape(-1, 8)
    unique, inverse = np.unique(corners.astype(np.float32), axis=0, return_inverse=True)
    # Corners are in the order of first use by triangles, so that neighbours are close and differences small.
    order = np.argsort(np.unique(inverse.ravel(), return_index=True)[1], kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    unique = unique[order]
    planes.add_linear(f"{name}/vertices", unique[:, :3].T, bits=16)
    planes.add_linear(f"{name}/normals", unique[:, 3:6].T, bits=12)
    planes.add_linear(f"{name}/uv", unique[:, 6:].T, bits=14)
    planes.add_integers(f"{name}/faces", place[inverse.ravel()].reshape(-1, 3).T)


def _shadow_shape(grid: np.ndarray, nodes: int) -> tuple[int, ...]:
    """Return the array shape of a shadow grid: rows and columns, or a single row for the nodes of a mesh."""
    return (int(grid[ROWS]), int(grid[COLUMNS])) if grid[COLUMNS] else (1, nodes)


def add_shadows(planes: StoredPlanes, placements: list[Placement], shadows: MeshShadows | None) -> list[dict | None]:
    """Add the planes of ambient occlusion by meshes; return each shape's entry for the header, None for no occlusion.

    Parameters
    ----------
    planes : StoredPlanes
    placements : list of Placement
    shadows : MeshShadows, optional
        None if the scene has no shadows of meshes.
    """
    entries: list[dict | None] = [None] * len(placements)
    if shadows is None:
        return entries
    numbers = shadows.numbers.reshape(len(placements), SHAPE_NUMBERS)
    grids, triangle = shadows.grid.reshape(len(placements), GRID), 0
    for i, values in shadow_values(shadows):
        nodes = values.shape[1]
        planes.add_linear(f"object/{i}/shadow/values", values.reshape(len(values), *_shadow_shape(grids[i], nodes)))
        seen = numbers[i, SEEN : SEEN + numbers[i, COUNT]]
        entries[i] = {"layers": [int(mesh) for mesh in seen], "grid": [float(x) for x in grids[i]]}
    for i, placement in enumerate(placements):
        if placement.shape.triangles is None:
            continue
        own = slice(triangle, triangle + len(placement.shape.triangles.faces))
        triangle = own.stop
        parts = shadows.parts[own].astype(np.int64)
        if entries[i] is not None:
            first = int(shadows.first_corner[own.start])
            places = int(((parts + 1) * (parts + 2) // 2).sum())
            planes.add_integers(f"object/{i}/shadow/parts", parts[None])
            planes.add_integers(f"object/{i}/shadow/corners", shadows.corners[first : first + places][None])
    return entries


def shadow_values(shadows: MeshShadows) -> Iterator[tuple[int, np.ndarray]]:
    """Yield index and occlusion values, a view (values, nodes) float32, of each shape from which meshes hide light."""
    numbers = shadows.numbers.reshape(-1, SHAPE_NUMBERS)
    shapes = np.flatnonzero(numbers[:, STRIDE])
    ends = [*numbers[shapes[1:], FIRST], len(shadows.values)]
    for i, end in zip(shapes, ends, strict=True):
        yield int(i), shadows.values[numbers[i, FIRST] : end].reshape(-1, numbers[i, STRIDE]).T


def decoded_shadows(planes: dict[str, np.ndarray], shadows: MeshShadows) -> MeshShadows:
    """Return a copy of shadows with the occlusion values decoded from a payload."""
    found = shadows._replace(values=shadows.values.copy())
    for i, values in shadow_values(found):
        values[:] = planes[f"object/{i}/shadow/values"].reshape(values.shape)
    return found


def add_shapes(planes: StoredPlanes, placements: list[Placement]) -> list[dict]:
    """Add the planes of all meshes and return each shape's entry for the header: kind, size and placement."""
    entries = []
    for i, (placement, reach) in enumerate(zip(placements, reaches(placements), strict=True)):
        shape = placement.shape
        if shape.triangles is not None:
            _mesh_planes(planes, f"object/{i}/mesh", shape.triangles)
        entries.append(
            {
                "shape": shape.name,
                "size_mm": [float(size) for size in shape.size_mm] if not shape.is_endless else [0.0, 0.0],
                "reach_mm": float(reach),
                "scale": float(placement.scale),
                "position_mm": [float(x) for x in placement.translation_mm],
                "world_from_object": [[float(x) for x in row] for row in placement.rotation],
            }
        )
    return entries
