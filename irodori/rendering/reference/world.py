"""Scene data and per-thread buffers of the path tracer, in the form of compiled loops.

numba passes a tuple of arrays to a function word by word and counts references to each array, which would take most of
the time. The functions with these arguments are therefore inlined (``forceinline``) and do not count references
(`uncounted`).
"""

from typing import NamedTuple

import numpy as np

from irodori.geometry.surfaces import Surfaces
from irodori.jit.compilation import njit
from irodori.rendering.reference.light_cache import Cache
from irodori.rendering.reference.sky_sampling import Sky
from irodori.rendering.reference.sun_images import COLUMNS, LONGEST, Images
from irodori.rendering.scene_arrays import Objects
from irodori.rendering.scene_lights import PADDED, Lights

#: Columns of `Work.seen`: means over three parts of the spectrum of the diffuse reflectance (or of the radiance, if a
#: light is hit first), the normal, the position in mm, and the share of gloss and mirror in the reflected light.
ALBEDO, NORMAL, PLACE, SHINE, SEEN = 0, 3, 6, 9, 10


class Bands(NamedTuple):
    """Bases and refractive indices of the objects' materials, with the band axis padded to 64."""

    basis: np.ndarray  # (objects, k, 64) float32
    n: np.ndarray  # (objects, 64) float32
    k: np.ndarray  # (objects, 64) float32


class World(NamedTuple):
    """Scene for path tracing; surface i is object i, and the surfaces of lights follow."""

    surfaces: Surfaces
    objects: Objects
    bands: Bands
    sky: Sky
    lights: Lights
    intersect: int
    occluded: int
    scene: int
    offset_mm: np.ndarray  # (surfaces,) height above a surface at which rays leave it, at the origin
    steps: float  # additional height relative to the coordinates, for single precision
    images: Images
    cache: Cache
    placed: int  # number of the objects' placed shapes


class Branch(NamedTuple):
    """A branch of a path, stored until the other branch is finished."""

    origin: np.ndarray  # (3,)
    direction: np.ndarray  # (3,)
    throughput: np.ndarray  # (64,) float32


class Work(NamedTuple):
    """Buffers of one thread for the current path and hit."""

    origin: np.ndarray  # (3,)
    direction: np.ndarray  # (3,)
    point: np.ndarray  # (3,)
    normal: np.ndarray  # (3,)
    facet: np.ndarray  # (3,)
    to_eye: np.ndarray  # (3,)
    light: np.ndarray  # (3,) towards a light
    texel: np.ndarray  # (k + 2 c,)
    gloss: np.ndarray  # (c, 5) for each gloss component: share of the gloss, β, μ, and the lobe's two constants
    coefficients: np.ndarray  # (k + 1,) of the environment
    share: np.ndarray  # (lights + 1,) probability of choosing each light, the environment last
    throughput: np.ndarray  # (64,) float32, as are the others
    diffuse: np.ndarray
    fresnel: np.ndarray
    radiance: np.ndarray
    mixture: np.ndarray
    total: np.ndarray
    kept: Branch
    seen: np.ndarray  # (SEEN,) sums of the features of first hits over a pixel's paths
    #: (3,) share of directions aimed at images; density relative to that without, of a direction and of the path.
    aimed: np.ndarray
    image: np.ndarray  # (chains,) probability of each chain of mirrors
    glint: np.ndarray  # (chains,) the same for the eye
    spheres: np.ndarray  # (LONGEST, COLUMNS) of a chain, see `irodori.rendering.reference.sun_images`
    through_texel: np.ndarray  # (k + 2 c,) of the transmittance of a sheet
    through: np.ndarray  # (64,) float32 transmittance
    #: (2,) solid angle over which the path's direction is spread, sr, and area in which it may have arrived, mm².
    spread: np.ndarray
    place: np.ndarray  # (2,) texture coordinates u, v


@njit(cache=True)
def new_work(world):
    """Return new buffers for one thread."""
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
        np.zeros(3),
        np.zeros(world.images.weight.size),
        np.zeros(world.images.weight.size),
        np.zeros((LONGEST, COLUMNS)),
        np.zeros(world.objects.texels.shape[1]),
        np.zeros(PADDED, np.float32),
        np.zeros(2),
        np.zeros(2),
    )
