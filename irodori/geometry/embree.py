"""Ray tracing with Embree, through the C interface of the library that the package embreex contains.

embreex itself supports triangle meshes only. The C interface also has exact spheres, and compiled loops can call it
without returning to Python. The addresses of Embree's functions are passed to the compiled functions as integers, so
that numba can cache these between processes.
"""

import ctypes
import os
from collections.abc import Sequence
from functools import lru_cache
from importlib.metadata import files
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import types

from irodori.jit.c_functions import c_function
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

if TYPE_CHECKING:
    from irodori.geometry.shapes.placement import Placement

_TRIANGLE, _SPHERE_POINT, _ORIENTED_DISC_POINT = 0, 50, 52  # enum RTCGeometryType
_INDEX_BUFFER, _VERTEX_BUFFER, _NORMAL_BUFFER = 0, 1, 3  # enum RTCBufferType
_UINT3, _FLOAT3, _FLOAT4 = 0x5003, 0x9003, 0x9004  # enum RTCFormat
_ROBUST = 1 << 2  # RTC_SCENE_FLAG_ROBUST: no ray slips between triangles that share an edge
_HIGH_QUALITY = 2

NO_HIT = -1
# RTCRayHit as 32-bit words: origin 0-2, tnear 3, direction 4-6, time 7, tfar 8, mask 9, id 10, flags 11,
# Ng 12-14, u 15, v 16, primID 17, geomID 18, instID 19. Twice the size, so that an aligned part can be used.
_WORDS = 64
_CHUNK = 4096  # rays that a thread takes at a time

_BUILD_THREADS = "IRODORI_BUILD_THREADS"  # environment variable, read when the first scene is made


_call = c_function(types.void, types.uintp, types.uintp, types.uintp)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    import embreex.rtcore_scene  # noqa: F401  loads the shared library and its TBB with the right search path

    candidates = [f for f in files("embreex") or [] if f.name.startswith("libembree4")]
    if not candidates:
        raise ImportError("embreex is installed without libembree4; the pinned wheel ships it")
    library = ctypes.CDLL(str(candidates[0].locate()))
    pointer = ctypes.c_void_p
    for name, arguments, result in (
        ("rtcNewDevice", [ctypes.c_char_p], pointer),
        ("rtcGetDeviceError", [pointer], ctypes.c_int),
        ("rtcNewScene", [pointer], pointer),
        ("rtcSetSceneFlags", [pointer, ctypes.c_int], None),
        ("rtcSetSceneBuildQuality", [pointer, ctypes.c_int], None),
        ("rtcNewGeometry", [pointer, ctypes.c_int], pointer),
        (
            "rtcSetSharedGeometryBuffer",
            [pointer, ctypes.c_int, ctypes.c_uint, ctypes.c_int, pointer] + [ctypes.c_size_t] * 3,
            None,
        ),
        ("rtcCommitGeometry", [pointer], None),
        ("rtcAttachGeometryByID", [pointer, pointer, ctypes.c_uint], None),
        ("rtcReleaseGeometry", [pointer], None),
        ("rtcCommitScene", [pointer], None),
        ("rtcReleaseScene", [pointer], None),
    ):
        function = getattr(library, name)
        function.argtypes, function.restype = arguments, result
    return library


@lru_cache(maxsize=1)
def _device() -> int:
    device = _library().rtcNewDevice(f"threads={os.environ.get(_BUILD_THREADS, '1')}".encode())
    if not device:
        raise RuntimeError(f"Embree gave no device, error {_library().rtcGetDeviceError(None)}")
    return device


def _address(name: str) -> int:
    address = ctypes.cast(getattr(_library(), name), ctypes.c_void_p).value
    assert address is not None  # a function of a loaded library has one
    return address


class Ray(NamedTuple):
    """Memory of a ray and its hit in Embree's layout, for compiled loops; each thread has its own.

    ``f`` and ``i`` are a float and an integer view of the same words, which begin at index ``at``.
    """

    f: np.ndarray
    i: np.ndarray
    address: np.uintp
    at: int


class _Rays(NamedTuple):
    """Rays that are traced together."""

    origins: np.ndarray  # (n, 3) mm
    directions: np.ndarray  # (n, 3) unit


class _Hits(NamedTuple):
    """Hits of rays."""

    distance: np.ndarray  # (n,) mm
    shape: np.ndarray  # (n,) int32, identifier of the shape
    triangle: np.ndarray  # (n,) int32, within the shape


@njit(cache=True)
def new_ray():
    """Allocate a ray with its words aligned to 64 bytes."""
    f = np.empty(_WORDS, np.float32)
    skip = (64 - f.ctypes.data % 64) % 64
    return Ray(f, f.view(np.int32), np.uintp(f.ctypes.data + skip), skip // 4)


@njit(cache=True, inline="always")
def trace(function, scene, ray, origin, direction, far):
    """Trace a ray by rtcIntersect1 or rtcOccluded1; `hit_shape`, `hit_distance` and `is_blocked` read the result.

    Parameters
    ----------
    function, scene : int
        Address of the function, and Embree's scene, from `Tracer`.
    ray : Ray
    origin, direction : (3,) float
        In the world, mm; and a unit vector.
    far : float
        Largest distance, mm.
    """
    f, i, at = ray.f, ray.i, ray.at
    f[at], f[at + 1], f[at + 2], f[at + 3] = origin[0], origin[1], origin[2], 0.0
    f[at + 4], f[at + 5], f[at + 6], f[at + 7] = direction[0], direction[1], direction[2], 0.0
    f[at + 8] = far
    i[at + 9], i[at + 10], i[at + 11] = -1, 0, 0
    i[at + 17], i[at + 18], i[at + 19], i[at + 20] = NO_HIT, NO_HIT, NO_HIT, NO_HIT
    _call(function, scene, ray.address, np.uintp(0))


@njit(cache=True, inline="always")
def hit_shape(ray):
    """Return the identifier of the shape that was hit, or `NO_HIT`."""
    return ray.i[ray.at + 18]


@njit(cache=True, inline="always")
def hit_distance(ray):
    """Return the distance of the hit, mm; infinite if nothing was hit."""
    return ray.f[ray.at + 8]


@njit(cache=True, inline="always")
def hit_primitive(ray):
    """Return the index of the triangle that was hit within its shape."""
    return ray.i[ray.at + 17]


@njit(cache=True, inline="always")
def hit_barycentric(ray):
    """Return the barycentric weights of the second and third corner of the triangle that was hit."""
    return ray.f[ray.at + 15], ray.f[ray.at + 16]


@njit(cache=True, inline="always")
def is_blocked(ray):
    """Return whether rtcOccluded1 found an obstacle on the ray."""
    return ray.f[ray.at + 8] < 0.0


@njit(cache=True, nogil=True)
def _intersect(function, scene, rays, hits, first, last):
    ray = new_ray()
    for r in range(first, last):
        trace(function, scene, ray, rays.origins[r], rays.directions[r], np.inf)
        hits.shape[r] = hit_shape(ray)
        hits.triangle[r] = hit_primitive(ray)
        hits.distance[r] = hit_distance(ray)


@njit(cache=True, nogil=True)
def _occluded(function, scene, segments, out, first, last):
    (rays, far), ray = segments, new_ray()
    for r in range(first, last):
        trace(function, scene, ray, rays.origins[r], rays.directions[r], far[r])
        out[r] = is_blocked(ray)


class Primitive(NamedTuple):
    """Geometry for Embree: its type, and its buffers, each with buffer type, format, items and their dtype."""

    kind: int
    buffers: tuple[tuple[int, int, np.ndarray, str], ...]


def triangles(vertices_mm: np.ndarray, faces: np.ndarray) -> Primitive:
    """Return the geometry of triangles.

    Parameters
    ----------
    vertices_mm : (m, 3) float
        In the world.
    faces : (n, 3) int
        Indices of corners, counter-clockwise seen from the front.
    """
    vertices = (_VERTEX_BUFFER, _FLOAT3, vertices_mm, "f4")
    return Primitive(_TRIANGLE, (vertices, (_INDEX_BUFFER, _UINT3, faces, "u4")))


def sphere_point(centre_mm: np.ndarray, radius_mm: float) -> Primitive:
    """Return the geometry of a sphere; the centre, (3,), is in the world."""
    return Primitive(_SPHERE_POINT, ((_VERTEX_BUFFER, _FLOAT4, np.append(centre_mm, radius_mm)[None], "f4"),))


def oriented_disc(centre_mm: np.ndarray, normal: np.ndarray, radius_mm: float) -> Primitive:
    """Return the geometry of a disc; the centre, (3,), and the unit normal, (3,), are in the world."""
    centre = (_VERTEX_BUFFER, _FLOAT4, np.append(centre_mm, radius_mm)[None], "f4")
    return Primitive(_ORIENTED_DISC_POINT, (centre, (_NORMAL_BUFFER, _FLOAT3, normal[None], "f4")))


class Tracer:
    """Ray tracer for placed shapes, using Embree.

    Parameters
    ----------
    placements : sequence of Placement
        Shape i has the identifier i; its geometry comes from `Shape.primitive`.

    Attributes
    ----------
    scene, intersect_address, occluded_address : int
        Arguments of `trace`, for compiled loops.
    intersect16_address, occluded16_address : int
        Addresses of the functions for packets of sixteen rays.
    """

    def __init__(self, placements: "Sequence[Placement]") -> None:
        self._library = _library()
        self._buffers: list[np.ndarray] = []
        self.placements = tuple(placements)
        self.scene = self._library.rtcNewScene(_device())
        self._library.rtcSetSceneFlags(self.scene, _ROBUST)
        self._library.rtcSetSceneBuildQuality(self.scene, _HIGH_QUALITY)
        for identifier, placement in enumerate(self.placements):
            self._attach(identifier, placement)
        self._library.rtcCommitScene(self.scene)
        error = self._library.rtcGetDeviceError(_device())
        if error:
            raise RuntimeError(f"Embree refused the scene, error {error}")
        self.intersect_address = _address("rtcIntersect1")
        self.occluded_address = _address("rtcOccluded1")
        self.intersect16_address = _address("rtcIntersect16")
        self.occluded16_address = _address("rtcOccluded16")

    def _attach(self, identifier: int, placement: "Placement") -> None:
        primitive = placement.shape.primitive(placement)
        geometry = self._library.rtcNewGeometry(_device(), primitive.kind)
        for buffer in primitive.buffers:
            self._share(geometry, *buffer)
        self._library.rtcCommitGeometry(geometry)
        self._library.rtcAttachGeometryByID(self.scene, geometry, identifier)
        self._library.rtcReleaseGeometry(geometry)

    def _share(self, geometry, buffer_type, buffer_format, items, dtype) -> None:
        # Embree reads 16 bytes at every vertex, so the buffer has one item more.
        array = np.zeros((len(items) + 1, items.shape[1]), dtype=dtype)
        array[:-1] = items
        self._buffers.append(array)
        self._library.rtcSetSharedGeometryBuffer(
            geometry, buffer_type, 0, buffer_format, array.ctypes.data, 0, array.strides[0], len(items)
        )

    def __del__(self) -> None:
        if getattr(self, "scene", None):
            self._library.rtcReleaseScene(self.scene)
            self.scene = None

    def intersect(self, origins, directions) -> tuple[np.ndarray, np.ndarray]:
        """Find the nearest hit of each ray.

        Parameters
        ----------
        origins, directions : (n, 3) float
            In mm, and unit vectors.

        Returns
        -------
        distance : (n,) float64
            In mm; infinite where nothing is hit. Embree's single-precision distances are refined in double precision,
            see `polish`.
        shape : (n,) int32
            Identifier of the shape; `NO_HIT` where nothing is hit.
        """
        origins = np.ascontiguousarray(origins, dtype=np.float64)
        directions = np.ascontiguousarray(directions, dtype=np.float64)
        distance = np.empty(len(origins))
        shape, triangle = np.empty((2, len(origins)), dtype=np.int32)
        hits = _Hits(distance, shape, triangle)
        rays = _Rays(origins, directions)
        run_chunks(_intersect, len(origins), _CHUNK, self.intersect_address, self.scene, rays, hits)
        distance[shape == NO_HIT] = np.inf
        for identifier, placement in enumerate(self.placements):
            chosen = shape == identifier
            if chosen.any():
                traced = (origins[chosen], directions[chosen], distance[chosen])
                distance[chosen] = polish(placement, *traced, triangle[chosen])
        return distance, shape

    def occluded(self, origins, directions, far=np.inf) -> np.ndarray:
        """Return whether each ray meets an obstacle before the distance ``far`` (mm), (n,) bool.

        ``origins`` (mm) and ``directions`` (unit vectors) are (n, 3).
        """
        # Writeable arrays only: for read-only ones the loop would be compiled again.
        origins = np.require(origins, np.float64, ("C", "W"))
        directions = np.require(directions, np.float64, ("C", "W"))
        out = np.empty(len(origins), dtype=np.bool_)
        far = np.broadcast_to(np.asarray(far, dtype=np.float32), len(origins)).copy()
        segments = (_Rays(origins, directions), far)
        run_chunks(_occluded, len(out), _CHUNK, self.occluded_address, self.scene, segments, out)
        return out


def polish(placement: "Placement", origins, directions, distance, triangle=None) -> np.ndarray:
    """Recompute hit distances in double precision from the equation of the shape, (n,) mm.

    Of several solutions, the one nearest to the traced distance is returned, also for a ray that starts inside a
    sphere. For a mesh, ``triangle``, (n,), has the indices of the triangles that were hit.
    """
    local_o = (origins - placement.translation_mm) @ placement.rotation / placement.scale
    local_d = directions @ placement.rotation / placement.scale
    return placement.shape.refined(local_o, local_d, distance, triangle)
