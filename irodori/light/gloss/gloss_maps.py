"""Gloss maps: gloss reflection of rough surfaces from blurred light and a table of lobes [eq. 5, 9].

A compiled loop gets the tables of a lobe from `GlossMaps.tables`. With these, a normal, the direction to the eye and a
roughness, `add_gloss_radiance` computes the k coefficients of the radiance on the environment's basis:

    tables = GlossMaps.load("results/environments/room.h5").tables("ggx")  # a NamedTuple of arrays
    add_gloss_radiance(tables, Seen(normal, to_eye), (beta, mu), (n, k), coefficients)  # adds to (bases,) float64

`gloss_radiance` does the same for arrays. Up to a roughness of 0.32, four entries of the table are interpolated, each
with at most forty bilinear look-ups. From 0.4 on, the exact lobe is summed over the light in the form of about 1300
points (`irodori.light.gloss.point_sources`), so that the horizon cuts the lobe exactly. Between these roughnesses, both
are mixed. `irodori.light.gloss.look_up_errors` measures the errors against the exact integral; they are stored in the
environment's file and shown in the report.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.light.blurred_light import WIDTHS_RAD, prefiltered
from irodori.light.environment_file import Environment
from irodori.light.equirectangular import StackedPicture, add_interpolated
from irodori.light.gloss.lobe_table import fitted_lobes
from irodori.light.gloss.point_sources import PointLights, Seen, add_from_points, place_of, point_lights
from irodori.material.coefficients import read_coefficients, write_coefficients
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import Lobes

#: Up to the first roughness blurred light is looked up; from the second on points are summed; both between.
_SMOOTH, _ROUGH = 0.32, 0.4
_AT_A_TIME = 64  # places that a thread takes at a time


class GlossTables(NamedTuple):
    """Gloss maps and the table of one lobe as flat arrays for compiled loops.

    The fields from ``mu`` on are those of `irodori.light.gloss.lobe_table.LobeTable`, the last two those of
    `PointLights`.
    """

    lobes: Lobes  # the lobe
    pixels: np.ndarray  # (all pixels, k) float32
    first_pixel: np.ndarray  # (widths,), first pixel of the map for each width; finer ones use the finest map
    size: np.ndarray  # (widths, 2) columns, rows
    mu: np.ndarray  # (m,) in the unit of the lobe
    theta_r: np.ndarray  # (t,) rad
    width: np.ndarray  # (m, t, lobes)
    offset: np.ndarray  # (m, t, lobes) rad
    across: np.ndarray  # (m, t, lobes) rad
    weight: np.ndarray  # (m, t, lobes) sr
    incidence: np.ndarray  # (m, t, lobes) rad
    direction: np.ndarray  # (n, 3) of the light as points
    power: np.ndarray  # (n, k) float64


@dataclass(frozen=True)
class GlossMaps:
    """Blurred light of an environment, on its basis.

    Parameters
    ----------
    first : int
        Level of the finest map in `irodori.light.blurred_light.WIDTHS_RAD`.
    levels : tuple of (h, 2 h, k) float32
        Mean radiance weighted by lobes of increasing width.
    points : PointLights
        The light as points, for very rough surfaces.
    """

    first: int
    levels: tuple[np.ndarray, ...]
    points: PointLights

    @classmethod
    def of(cls, coefficients: np.ndarray) -> "GlossMaps":
        """Compute the maps of an equirectangular picture, (height, width, k)."""
        first, levels = prefiltered(coefficients)
        return cls(first, tuple(levels), point_lights(coefficients))

    def write(self, out, storage: str = "single") -> "GlossMaps":
        """Write ``/gloss`` into an open file of `irodori.core.store`; return the maps as they will be read from it.

        ``storage`` is described in `irodori.material.coefficients`.
        """
        widths = WIDTHS_RAD[self.first :]
        out.write("gloss/width", widths, units="rad", dims="level", quantity="width 1/√κ of the blurring lobe")
        levels = tuple(np.empty(level.shape, dtype=np.float32) for level in self.levels)
        for number, (level, decoded) in enumerate(zip(self.levels, levels, strict=True), start=self.first):
            write_coefficients(
                out,
                f"gloss/level-{number:02d}",
                level,
                quantity="coefficients of the radiance blurred by a von Mises-Fisher lobe",
                storage=storage,
                codec="lzf",
                dims=f"theta_{number:02d},azimuth_{number:02d},component",
                decoded=decoded,
            )
        names = {"direction": ("1", "point,axis", "centre of power of a part of the sphere"),
                 "power": ("sr", "point,component", "coefficients of its radiance times its solid angle")}  # fmt: skip
        for (name, (units, dims, quantity)), values in zip(names.items(), self.points, strict=True):
            out.write(f"gloss/{name}", values, units=units, dims=dims, quantity=quantity)
        return GlossMaps(self.first, levels, self.points)

    @classmethod
    def stored(cls, environment: Environment, levels: tuple[int, int] | None = None) -> "GlossMaps | None":
        """Read the maps from the file of an environment; None if there is no file, or it has no maps.

        Other parameters and errors are those of `load`.
        """
        if environment.file is None:
            return None
        with store.open_file(environment.file) as file:
            if "gloss/width" not in file:
                return None
        return cls.load(environment.file, levels)

    @classmethod
    def load(cls, path, levels: tuple[int, int] | None = None) -> "GlossMaps":
        """Read ``/gloss`` from the file of an environment.

        Parameters
        ----------
        path : path
        levels : (int, int), optional
            First level of `irodori.light.blurred_light.WIDTHS_RAD`, and one after the last, as in
            `irodori.light.blurred_light.prefiltered`.

        Raises
        ------
        InputError
            If the file has no maps, or maps with the widths of another version.
        """
        with store.open_file(path) as file:
            widths = file.read("gloss/width")
            first = len(WIDTHS_RAD) - len(widths)
            if first < 0 or not np.allclose(widths, WIDTHS_RAD[first:]):
                accepted = f"{WIDTHS_RAD[0]:.4g} rad and every factor of √2 to {WIDTHS_RAD[-1]:.4g}"
                raise InputError(path, "gloss/width", "other widths", accepted)
            wanted = levels or (first, len(WIDTHS_RAD))
            first = max(first, wanted[0])
            last = max(first + 1, wanted[1])
            maps = tuple(read_coefficients(file, f"gloss/level-{n:02d}") for n in range(first, last))
            return cls(first, maps, PointLights(file.read("gloss/direction"), file.read("gloss/power")))

    def tables(self, lobe: str = "gaussian") -> GlossTables:
        """Return the maps and the table of a lobe as flat arrays for `add_gloss_radiance`.

        Raises
        ------
        InputError
            If the lobe has no table; the message names the command that makes one.
        """
        sizes = np.array([level.shape[1::-1] for level in self.levels])
        starts = np.concatenate([[0], np.cumsum(sizes.prod(axis=1))[:-1]])
        pixels = np.concatenate([level.reshape(-1, level.shape[2]) for level in self.levels])
        # Widths finer than the picture use the finest map.
        of_width = np.maximum(np.arange(len(WIDTHS_RAD)) - self.first, 0)
        maps = pixels, starts[of_width], sizes[of_width]
        return GlossTables(Lobes.of(lobe), *maps, *fitted_lobes(lobe), *self.points)


@njit(cache=True, forceinline=True)
def _between(ladder, value):
    """Return the index of the interval of an ascending ladder that contains a value, and the fraction within it.

    Values beyond the ends are clamped.
    """
    last = ladder.size - 2
    i = min(max(np.searchsorted(ladder, value) - 1, 0), last)
    part = (value - ladder[i]) / (ladder[i + 1] - ladder[i])
    return i, min(max(part, 0.0), 1.0)


@njit(cache=True)
def _across(normal, view, cos_r):
    """Return two unit tangents, in the plane of incidence away from the view and across it, and the view angle, rad."""
    tx, ty, tz = cos_r * normal[0] - view[0], cos_r * normal[1] - view[1], cos_r * normal[2] - view[2]
    sin_r = math.sqrt(tx * tx + ty * ty + tz * tz)
    if sin_r > 1e-9:
        tx, ty, tz = tx / sin_r, ty / sin_r, tz / sin_r
    else:  # any direction across the normal
        sign = math.copysign(1.0, normal[2])
        a = -1.0 / (sign + normal[2])
        tx, ty, tz = 1.0 + sign * normal[0] ** 2 * a, sign * normal[0] * normal[1] * a, -sign * normal[0]
    bx, by, bz = normal[1] * tz - normal[2] * ty, normal[2] * tx - normal[0] * tz, normal[0] * ty - normal[1] * tx
    return tx, ty, tz, bx, by, bz, math.atan2(sin_r, cos_r)


@njit(cache=True, error_model="numpy")
def _add_entry(maps, entry, share, frame, index, out):
    """Add the look-ups of one entry of the table (a roughness and a view angle), multiplied by ``share``.

    ``frame`` is the normal, and the result of `_across`.
    """
    (i, j), (normal, (tx, ty, tz, bx, by, bz, theta_r)) = entry, frame
    for lobe in range(maps.weight.shape[2]):
        weight = maps.weight[i, j, lobe]
        if weight <= 0.0:
            break
        facet = min(max(theta_r + maps.incidence[i, j, lobe], 0.0), 0.5 * math.pi)
        scale = share * weight * fresnel(math.cos(facet), index[0], index[1])
        angle, across, width = theta_r + maps.offset[i, j, lobe], maps.across[i, j, lobe], maps.width[i, j, lobe]
        level = StackedPicture(maps.pixels, maps.first_pixel[width], maps.size[width, 0], maps.size[width, 1])
        c, s = math.cos(angle), math.sin(angle)
        x, y, z = c * normal[0] + s * tx, c * normal[1] + s * ty, c * normal[2] + s * tz
        if across == 0.0:
            add_interpolated(level, (x, y, z), scale, out)
            continue
        c, s = math.cos(across), math.sin(across)
        x, y, z, scale = c * x, c * y, c * z, 0.5 * scale
        add_interpolated(level, (x + s * bx, y + s * by, z + s * bz), scale, out)
        add_interpolated(level, (x - s * bx, y - s * by, z - s * bz), scale, out)


@njit(cache=True, error_model="numpy")
def _add_from_maps(maps, seen, mu, index, scale, out):
    """Add ``scale`` times ∫ L F D G / cosθ_r dω [eq. 5] by look-ups in blurred light."""
    normal, view = seen
    frame = _across(normal, view, normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2])
    lowest, highest = maps.mu[0], maps.mu[-1]
    held = min(max(mu, lowest), highest)
    scale *= (min(mu, lowest) / lowest) ** 2
    i, _ = _between(maps.mu, held)
    # Interpolation that is linear in the squared roughness keeps both the peak and the power of the lobe.
    part_i = (held**2 - maps.mu[i] ** 2) / (maps.mu[i + 1] ** 2 - maps.mu[i] ** 2)
    j, part_j = _between(maps.theta_r, frame[6])
    for corner in range(4):
        share = (part_i if corner // 2 else 1.0 - part_i) * (part_j if corner % 2 else 1.0 - part_j)
        if share > 1e-6:
            _add_entry(maps, (i + corner // 2, j + corner % 2), share * scale, (normal, frame), index, out)


@njit(cache=True, error_model="numpy")
def add_gloss_radiance(maps, seen, gloss, index, out):
    """Add the coefficients of the gloss radiance β/π ∫ L F D G / cosθ_r dω [eq. 5, 9].

    Parameters
    ----------
    maps : GlossTables
    seen : Seen
        A single place.
    gloss : (beta, mu)
        Weight and roughness; with NaN or 0 nothing is added.
    index : (n, k)
        Refractive index at one wavelength; if it varies, call the function for each wavelength.
    out : (bases,) float
        Array to which the coefficients are added.

    Notes
    -----
    Below the smallest roughness of the table, 0.01, the light is blurred as for 0.01, but its power is exact.
    """
    (normal, view), (beta, mu) = seen, gloss
    cos_r = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    if not (beta > 0.0 and mu > 0.0 and cos_r > 0.0):
        return
    rough = min(max((mu - _SMOOTH) / (_ROUGH - _SMOOTH), 0.0), 1.0)
    if rough > 0.0:
        add_from_points(maps, seen, mu, index, rough * beta / math.pi, out)
    if rough < 1.0:
        _add_from_maps(maps, seen, mu, index, (1.0 - rough) * beta / math.pi, out)


@njit(cache=True, nogil=True)
def _add_to_places(maps, seen, surfaces, out, first, last):
    gloss, index = surfaces  # (n, 2) β and μ in rad; n and k
    for i in range(first, last):
        add_gloss_radiance(maps, place_of(seen, i), (gloss[i, 0], gloss[i, 1]), index, out[i])


def gloss_radiance(maps: GlossTables, normal, view, beta, mu, index: tuple[float, float]) -> np.ndarray:
    """Return coefficients of the gloss radiance, see `add_gloss_radiance`.

    Parameters
    ----------
    maps : GlossTables
    normal, view : (..., 3) float
        Unit vectors, broadcast against each other.
    beta, mu : (...) float
    index : (n, k)
        Refractive index.

    Returns
    -------
    (..., bases) float64
    """
    normal, view = np.broadcast_arrays(np.asarray(normal, dtype=np.float64), np.asarray(view, dtype=np.float64))
    shape = normal.shape[:-1]
    gloss = np.stack([np.broadcast_to(v, shape).ravel() for v in (beta, mu)], axis=-1).astype(np.float64)
    out = np.zeros((len(gloss), maps.pixels.shape[1]))
    normal, view = (np.ascontiguousarray(v).reshape(-1, 3) for v in (normal, view))
    n, k = index
    surfaces = gloss, (float(n), float(k))
    run_chunks(_add_to_places, len(out), _AT_A_TIME, maps, Seen(normal, view), surfaces, out)
    return out.reshape(*shape, -1)
