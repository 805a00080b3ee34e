"""Encoding of a scene's shapes, materials and light into the planes of a classroom page's payload.

The data are those of `irodori.rendering.interactive`, because the page uses the same algorithm: light as cube maps with
a border of one texel, levels of blurred light, gloss lobes as rows of round lobes. Data that the scene does not have
get no plane.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from irodori.core.errors import PlainError
from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.light.environment_file import Environment
from irodori.reflection.lobes import Lobes
from irodori.rendering.interactive.cube_maps import environment_pyramid, face_directions, from_equirectangular
from irodori.rendering.interactive.prepared_scene import gloss_for, needed_gloss
from irodori.rendering.interactive.round_lobes import gloss_power, ladder, lobe_table, roughness_at, roughness_place
from irodori.rendering.light_transfer import LEAST_SHINE, mean_coefficients, shine_of, thinned
from irodori.rendering.map_layouts import make_layout
from irodori.rendering.scene_arrays import Objects, coats_of, coefficients_of, gloss_of, placed_of_rows, textures
from irodori.viewer.payload import StoredPlanes

#: Lobes that the page's shader knows; a lobe from elsewhere has no page.
LOBES = ("gaussian", "ggx")
#: Texels along the side of a cube of light, at most: the finest levels of a finer one are left out.
MOST_SIDE = 256
#: Levels of blurred light with more texels along the side are stored at half the side, with a border as wide as the
#: interpolation of `finer` needs.
HALVED_FROM, BORDER = 32, 4
#: Texels of the light map of an object and of a body, about; those of a mesh of many corners that are traced.
MOST_TEXELS, MOST_BODY_TEXELS, MOST_TRACED = 1 << 10, 1 << 12, 1 << 12


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
    under_coats : tuple of (k, 6, side + 2, side + 2) float
        Irradiance under each of the scene's coats; empty if the environment is dark.
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
    under_coats: tuple[np.ndarray, ...]
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
        return LightMaps(environment.basis.T.astype(np.float64), white, None, None, (), [], [], 0)
    basis, principal_from_stored = _principal(environment)
    k = len(basis)
    pyramid = environment_pyramid(environment.coefficients, principal_from_stored, k)
    level = next(i for i, side in enumerate(pyramid.side) if side <= MOST_SIDE)
    side, first = int(pyramid.side[level]), int(pyramid.first[level])
    whole = pyramid.texels[first : first + 6 * (side + 2) ** 2 * k].reshape(6, side + 2, side + 2, k)
    sky = np.moveaxis(whole[:, 1:-1, 1:-1], -1, 0)
    rows = environment.irradiance.shape[0]
    under = [environment.irradiance_under(n, k) for n, k in coats_of(objects).n_k.tolist()]
    irradiance, *coated = (
        _cube((one @ principal_from_stored.T).astype(np.float32), rows, 1) for one in (environment.irradiance, *under)
    )
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
    return LightMaps(basis, white, sky, irradiance, tuple(coated), gloss, sides, number)


def add_light(planes: StoredPlanes, number: int, maps: LightMaps) -> dict:
    """Add the planes of an environment's maps and return the environment's entry for the header."""
    name = f"light/{number}"
    planes.add_floats(f"{name}/basis", maps.basis)
    planes.add_floats(f"{name}/white", maps.white)
    if maps.sky is not None and maps.irradiance is not None:
        planes.add_light(f"{name}/sky", maps.sky, maps.basis)
        planes.add_light(f"{name}/irradiance", maps.irradiance, maps.basis)
        for coat, values in enumerate(maps.under_coats):
            planes.add_light(f"{name}/irradiance/{coat}", values, maps.basis)
        for level, values in enumerate(maps.gloss):
            planes.add_light(f"{name}/gloss/{level}", values, maps.basis)
    return {"is_dark": maps.sky is None, "gloss_sides": maps.sides, "gloss_first": maps.first}


def decoded_light(planes: dict[str, np.ndarray], number: int, entry: dict) -> LightMaps:
    """Return the maps of an environment from decoded planes and its entry in the header."""
    name = f"light/{number}"
    gloss = [planes[f"{name}/gloss/{level}"] for level in range(len(entry["gloss_sides"]))]
    basis, white = (planes[f"{name}/{part}"].astype(np.float64) for part in ("basis", "white"))
    sky, irradiance = planes.get(f"{name}/sky"), planes.get(f"{name}/irradiance")
    coats = itertools.takewhile(planes.__contains__, (f"{name}/irradiance/{coat}" for coat in itertools.count()))
    under = tuple(planes[coat] for coat in coats)
    return LightMaps(basis, white, sky, irradiance, under, gloss, entry["gloss_sides"], entry["gloss_first"])


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
    """Add the planes of all materials of `Objects` and return each one's entry for the header."""
    check_lobes(objects.lobes)
    entries, coats = [], coats_of(objects).of_side
    for i, texels in enumerate(textures(objects)):
        name, bases = f"object/{i}", int(objects.bases[i])
        planes.add_floats(f"{name}/basis", objects.basis[i, :bases])
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
                "coat": int(coats[i]) if i < len(coats) else 0,
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


def add_maps(planes: StoredPlanes, placements: list[Placement], objects: Objects, bodies: int) -> list[dict]:
    """Add what the page needs to find the light on objects; return each side's entry for the header, see `Objects`.

    For each texel of its light map, a side has the coefficients of its mean reflectance, and a sheet those of its
    transmittance. A mesh also has the places of its texels, which are nodes of its triangles. If it has many nodes,
    light is found at some, and spread to all. The last placements are those of ``bodies``, such as tables and walls,
    which are large beside objects.
    """
    layouts, places = [], []
    for index, placement in enumerate(placements):
        name, layout = f"object/{index}/map", make_layout(placements, index)
        most = MOST_TEXELS if index < len(placements) - bodies else MOST_BODY_TEXELS
        rows, columns = layout.size(most)
        grid, points = layout.grid.copy(), layout.points(most)
        if placement.shape.triangles is not None:
            points, spread = thinned(points, MOST_TRACED)
            turn = placement.rotation
            local = (points.point - placement.translation_mm) @ turn / placement.scale
            planes.add_linear(f"{name}/point", local.T, bits=16)
            planes.add_linear(f"{name}/normal", (points.normal @ turn).T, bits=12)
            planes.add_linear(f"{name}/facet", (points.facet @ turn).T, bits=12)
            for part, numbers in zip(("parts", "corners"), layout.triangles(most), strict=True):
                planes.add_integers(f"{name}/{part}", numbers[None].astype(np.int64))
            if spread is not None:
                planes.add_integers(f"{name}/near", spread.indices.reshape(columns, -1).T.astype(np.int64))
                planes.add_linear(f"{name}/share", spread.data.reshape(columns, -1).T)
        else:
            # In the page, places on a plane are relative to where it stands.
            away = placement.shape.frame_origin(placement) - placement.translation_mm
            grid[:2] += (away @ placement.rotation)[:2]
        places.append(points)
        layouts.append({"rows": rows, "columns": columns, "grid": [float(x) for x in grid]})
    for row, index in enumerate(placed_of_rows(objects)):
        colour, shape = mean_coefficients(placements[index], objects, row, places[index]), layouts[index]
        size = (shape["rows"], shape["columns"]) if placements[index].shape.triangles is None else (-1,)
        planes.add_linear(f"object/{row}/map/colour", colour.T.reshape(colour.shape[1], *size))
    entries = []
    for row, index in enumerate(objects.shape):
        shine = [float(x) for x in shine_of(objects, row).mean(axis=1)]
        entries.append(layouts[index] | {"shine": shine if max(shine) > LEAST_SHINE else None})
    return entries


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
