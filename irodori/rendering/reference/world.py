"""Scene data and per-thread scratch space of the path tracer, as compiled loops take them.

numba passes a tuple of arrays to a function word by word, and counts the owners of each: the functions that take these
are inlined (``forceinline``) and count no references (`uncounted`), or most of the time would go there.
"""

from typing import NamedTuple

import numpy as np

from irodori.geometry.surfaces import Surfaces
from irodori.jit.compilation import njit
from irodori.rendering.reference.sky_sampling import Sky
from irodori.rendering.scene_arrays import Objects
from irodori.rendering.scene_lights import PADDED, Lights

#: Columns of `Work.seen`: means over three parts of the spectrum of the diffuse reflectance (of light that is met: of
#: its radiance), the normal, the place in mm, and the share of gloss and mirror in what is reflected.
ALBEDO, NORMAL, PLACE, SHINE, SEEN = 0, 3, 6, 9, 10


class Bands(NamedTuple):
    """Values of the materials in each band, padded; the first axis counts the objects."""

    basis: np.ndarray  # (objects, k, 64) float32
    n: np.ndarray  # (objects, 64) float32
    k: np.ndarray  # (objects, 64) float32


class World(NamedTuple):
    """Scene as paths travel through it; surface i is object i, and those of lights follow."""

    surfaces: Surfaces
    objects: Objects
    bands: Bands
    sky: Sky
    lights: Lights
    intersect: int
    occluded: int
    scene: int
    offset_mm: np.ndarray  # (surfaces,) height above a surface at which rays leave it, at the origin
    steps: float  # further height, a part of the coordinates' size: single precision


class Branch(NamedTuple):
    """The part of a path that waits until the other part is followed."""

    origin: np.ndarray  # (3,)
    direction: np.ndarray  # (3,)
    throughput: np.ndarray  # (64,) float32


class Work(NamedTuple):
    """Buffers of one thread."""

    origin: np.ndarray  # (3,)
    direction: np.ndarray  # (3,)
    point: np.ndarray  # (3,)
    normal: np.ndarray  # (3,)
    facet: np.ndarray  # (3,)
    to_eye: np.ndarray  # (3,)
    light: np.ndarray  # (3,) towards a light
    texel: np.ndarray  # (k + 2 c,)
    gloss: np.ndarray  # (c, 5) of each gloss component: share of the gloss, β, μ, and the lobe's two constants
    coefficients: np.ndarray  # (k + 1,) of the environment
    share: np.ndarray  # (lights + 1,) of the choice among lights, the environment last
    throughput: np.ndarray  # (64,) float32, as are the others
    diffuse: np.ndarray
    fresnel: np.ndarray
    radiance: np.ndarray
    mixture: np.ndarray
    total: np.ndarray
    kept: Branch
    seen: np.ndarray  # (SEEN,) sums over a pixel's paths of what they met first


@njit(cache=True)
def new_work(world):
    """Return the buffers of one thread."""
    return Work(
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(world.objects.texels.shape[1]),
        np.zeros((world.objects.lobe.shape[1], 5)),
        np.empty(world.sky.pixels.shape[1]),
        np.zeros(world.lights.kind.size + 1),
        np.zeros(PADDED, np.float32),
        np.zeros(PADDED, np.float32),
        np.zeros(PADDED, np.float32),
        np.zeros(PADDED, np.float32),
        np.zeros(PADDED, np.float32),
        np.zeros(PADDED, np.float32),
        Branch(np.zeros(3), np.zeros(3), np.zeros(PADDED, np.float32)),
        np.zeros(SEEN),
    )
