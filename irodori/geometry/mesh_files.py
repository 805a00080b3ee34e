"""Reading of OBJ, PLY and glTF meshes with the library trimesh."""

import logging
from io import BytesIO
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.geometry.mesh import ACCEPTED_UV, Mesh, make_mesh
from irodori.geometry.mesh_sizes import check_declared
from irodori.geometry.mesh_sources import mesh_files
from irodori.geometry.obj_text import obj_text

MM_IN = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
#: Largest coordinate (1000 km): its square and cube are far below the largest double-precision number.
_FARTHEST_MM = 1e9
_Z_FROM = {"z": np.eye(3), "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])}


def read_mesh(path, unit: str, up: str = "z", pivot_mm=None, crease_deg: float = 40.0) -> Mesh:
    """Read a mesh into the object's frame.

    Parameters
    ----------
    path : path
        OBJ, PLY, GLB or glTF; all its parts share one texture.
    unit : {"mm", "cm", "m", "inch"}
        Unit of the coordinates in the file.
    up : {"z", "y"}
        Axis of the file that points up and becomes the object's z; it is y in glTF.
    pivot_mm : (3,) float, optional
        Point that becomes the origin, in mm after unit and up; the centre of the bounding box by default.
    crease_deg : float
        See `irodori.geometry.normals.corner_normals`; used if the file has no normals.

    Raises
    ------
    InputError
        If the file cannot be read, or `irodori.geometry.mesh.make_mesh` refuses it.
    ValueError
        If `unit` or `up` is unknown.
    """
    for name, value, known in (("unit", unit, MM_IN), ("up", up, _Z_FROM)):
        if value not in known:
            raise ValueError(f"unknown {name} {value!r}; accepted: {', '.join(known)}")
    files = mesh_files(path)
    held = sum(Path(file).stat().st_size for file in files)
    check_declared(path, held)
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite raise an error below
            corners, uv, normals = _parts(path, files, held)
    except InputError:
        raise
    except Exception as error:  # trimesh passes on exceptions of any kind from its parsers
        kind, reason = Path(path).suffix.lower().removeprefix(".").upper(), " ".join(str(error).split())[:200]
        found = f"{type(error).__name__}: {reason}"
        raise InputError(path, "", found, f"a valid {kind} file of triangles") from None
    if uv is None and _is_gltf(path):
        accepted = f"{ACCEPTED_UV}; a glTF needs a material too, without which its UV coordinates are not read"
        raise InputError(path, "UV", "no texture coordinates", accepted)
    corners = MM_IN[unit] * _turned(corners, _Z_FROM[up])
    normals = None if normals is None else _turned(normals, _Z_FROM[up])
    if (np.abs(corners) > _FARTHEST_MM).any():
        found = f"coordinates up to {np.nanmax(np.abs(corners)):g} mm"
        raise InputError(path, "vertices", found, f"an object within {_FARTHEST_MM:g} mm, of the unit that is stated")
    if np.isfinite(corners).all():
        flat = corners.reshape(-1, 3)
        corners -= 0.5 * (flat.min(axis=0) + flat.max(axis=0)) if pivot_mm is None else np.asarray(pivot_mm, float)
    mesh = make_mesh(corners, uv, normals, crease_deg, path)
    origin = "computed" if normals is None else "of the file"
    LOGGER.info("%s: %d triangles, normals %s, %.3g mm wide", path, len(mesh.faces), origin, 2 * mesh.reach_mm)
    return mesh


def _parts(path, files: list[str], held: int) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Read the triangles of all parts of a file.

    Returns
    -------
    corners : (m, 3, 3) float64
    uv : (m, 3, 2) float64 or None
        Texture coordinates with v from the top.
    normals : (m, 3, 3) float64 or None
    """
    is_ply = Path(path).suffix.lower() == ".ply"
    # trimesh sorts the vertices of a PLY by texture coordinates and leaves the normals in the old order.
    unsorted = _load(path, files, **({"fix_texture": False} if is_ply else {}))
    # Only texture coordinates of triangles need vertices of their own: those of vertices fit as they are.
    scene = _load(path, files) if is_ply and _has_uv_by_triangle(path) else unsorted
    corners, uvs, normals = [], [], []
    count = 0
    for node in scene.graph.nodes_geometry:
        world, name = scene.graph[node]
        part, original = scene.geometry[name], unsorted.geometry[name]
        if not hasattr(part, "faces") or not len(part.faces):
            continue
        faces = np.asarray(part.faces)
        if faces.min() < 0 or faces.max() >= len(part.vertices):
            found = f"a triangle on the vertex {faces.max()} of {len(part.vertices)}"
            raise InputError(path, "faces", found, "triangles on vertices of the file")
        count += len(faces)
        if count > held:
            found = f"parts placed so often that they make {count} triangles, more than the file has bytes"
            raise InputError(path, "nodes", found, "each part once: its texture serves one place")
        uv = getattr(part.visual, "uv", None)
        uvs.append(None if uv is None or len(uv) != len(part.vertices) else np.asarray(uv, dtype=np.float64)[faces])
        normals.append(_normals(original, world))
        corners.append((np.asarray(part.vertices, dtype=np.float64) @ world[:3, :3].T + world[:3, 3])[faces])
        if np.linalg.det(world[:3, :3]) < 0:  # a mirrored part is wound the other way round
            for part_list in (corners, uvs, normals):
                part_list[-1] = None if part_list[-1] is None else part_list[-1][:, ::-1]
    if not corners:
        raise InputError(path, "faces", "no triangles", "a triangle mesh with UV coordinates")
    uv = _joined(uvs)
    if uv is not None:
        uv = np.stack([uv[..., 0], 1.0 - uv[..., 1]], axis=-1)
    return np.concatenate(corners), uv, _joined(normals)


def _turned(corners: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return vectors (m, 3, 3) turned by a matrix (3, 3)."""
    return (corners.reshape(-1, 3) @ rotation.T).reshape(corners.shape)


def _has_uv_by_triangle(path) -> bool:
    """Return whether the header of a PLY names texture coordinates of triangles."""
    with open(path, "rb") as file:
        for line in iter(file.readline, b""):
            words = line.split()
            if words[:1] == [b"end_header"]:
                break
            if words[:1] == [b"property"] and words[-1] == b"texcoord":
                return True
    return False


def _joined(parts: list[np.ndarray | None]) -> np.ndarray | None:
    """Concatenate the arrays of all parts; None if any part has none."""
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if len(known) == len(parts) else None


def _normals(part, world) -> np.ndarray | None:
    """Return the normals of a part's corners that are stored in the file; None if there are none."""
    # trimesh computes missing normals on access; only those of the file are in its cache before.
    if "vertex_normals" not in part._cache.cache:
        return None
    normals = np.asarray(part._cache.cache["vertex_normals"], dtype=np.float64)
    if len(normals) != len(part.vertices):
        return None
    return (normals @ np.linalg.inv(world[:3, :3]))[np.asarray(part.faces)]


def _is_gltf(path) -> bool:
    return Path(path).suffix.lower() in (".glb", ".gltf")


class _OwnBuffers:
    """Resolver, for trimesh, of files to which a mesh refers: only the checked buffers, no pictures or materials."""

    def __init__(self, files: list[str]) -> None:
        self._folder, self._files = Path(files[0]).parent, files

    def get(self, name: str) -> bytes:
        """Return the content of a buffer; raise KeyError for any other file."""
        path = self._folder / unquote(name)
        if str(path) not in self._files:
            raise KeyError(name)
        return path.read_bytes()

    __getitem__ = get


def _load(path, files: list[str], **options):
    """Load a file as a trimesh scene, without processing its vertices."""
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.ERROR)  # it reports pictures that the project does not read
    # trimesh gives the UV coordinates of a glTF with its material only.
    options |= {"process": False, "skip_materials": not _is_gltf(path), "resolver": _OwnBuffers(files)}
    kind = Path(path).suffix.lower().removeprefix(".")
    with BytesIO(obj_text(path)) if kind == "obj" else open(path, "rb") as file:
        return trimesh.load_scene(file, file_type=kind, **options)
