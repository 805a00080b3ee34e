"""Evaluation of a lobe over arrays, for callers in Python."""

import math

import numpy as np

from irodori.jit.compilation import njit
from irodori.reflection.lobes import Lobes, constants, derivatives, features, value


@njit(cache=True, error_model="numpy")
def _fill_features(lobes, geometry, out):
    for j in range(geometry.shape[0]):
        theta_i, theta_r, theta_h, phi = geometry[j, 0], geometry[j, 1], geometry[j, 2], geometry[j, 3]
        if theta_i < 0.5 * math.pi and theta_r < 0.5 * math.pi:
            out[j, 0], out[j, 1], out[j, 2], out[j, 3] = features(
                lobes, math.cos(theta_i), math.cos(theta_r), math.cos(phi), math.cos(theta_h), phi
            )


@njit(cache=True, error_model="numpy")
def _fill_features_under_lamps(lobes, normal, view, lamp, out):
    for t in range(normal.shape[0]):
        nx, ny, nz = normal[t, 0], normal[t, 1], normal[t, 2]
        cos_r = nx * view[t, 0] + ny * view[t, 1] + nz * view[t, 2]
        for j in range(lamp.shape[0]):
            cos_i = nx * lamp[j, 0] + ny * lamp[j, 1] + nz * lamp[j, 2]
            if cos_i > 0.0 and cos_r > 0.0:  # the half vector is not of opposite directions then
                hx, hy, hz = view[t, 0] + lamp[j, 0], view[t, 1] + lamp[j, 1], view[t, 2] + lamp[j, 2]
                length = math.sqrt(hx * hx + hy * hy + hz * hz)
                hx, hy, hz = hx / length, hy / length, hz / length
                x, y, z = ny * hz - nz * hy, nz * hx - nx * hz, nx * hy - ny * hx
                cos_phi = nx * hx + ny * hy + nz * hz
                phi = math.atan2(math.sqrt(x * x + y * y + z * z), cos_phi)
                # Of unit vectors, V + L is twice the cosine between L and the half vector long.
                out[t, j, 0], out[t, j, 1], out[t, j, 2], out[t, j, 3] = features(
                    lobes, cos_i, cos_r, cos_phi, 0.5 * length, phi
                )


@njit(cache=True, error_model="numpy")
def _fill_values(lobes, mu, seen, out):
    last, constant, each = mu[0], constants(lobes, math.log(mu[0])), min(mu.size - 1, 1)
    for j in range(seen.shape[0]):
        if seen[j, 0] != 0.0:
            if mu[each * j] != last:
                last, constant = mu[each * j], constants(lobes, math.log(mu[each * j]))
            out[j] = seen[j, 0] * value(lobes, constant, seen[j, 1], seen[j, 2], seen[j, 3])


@njit(cache=True, error_model="numpy")
def _fill_derivatives(lobes, mu, seen, out):
    last, constant, each = mu[0], constants(lobes, math.log(mu[0])), min(mu.size - 1, 1)
    for j in range(seen.shape[0]):
        if seen[j, 0] != 0.0:
            if mu[each * j] != last:
                last, constant = mu[each * j], constants(lobes, math.log(mu[each * j]))
            here, first, second = derivatives(lobes, constant, seen[j, 1], seen[j, 2], seen[j, 3])
            out[0, j], out[1, j], out[2, j] = seen[j, 0] * here, seen[j, 0] * first, seen[j, 0] * second


class LobeAtAngles:
    """A lobe under given angles, for one roughness after another.

    What depends on the angles alone, which is most of the work, is computed once.

    Parameters
    ----------
    name : str
        Name of a registered lobe.
    geometry : (..., 4) float
        θ_i, θ_r, θ_H, φ in rad.

    Raises
    ------
    ValueError
        If there is no lobe of that name.
    """

    def __init__(self, name: str, geometry) -> None:
        geometry = np.asarray(geometry, dtype=np.float64)
        self._lobes, self._seen = Lobes.of(name), np.zeros(geometry.shape)
        _fill_features(self._lobes, np.ascontiguousarray(geometry).reshape(-1, 4), self._seen.reshape(-1, 4))

    @classmethod
    def under_lamps(cls, name: str, normal, view, lamp) -> "LobeAtAngles":
        """Return a lobe at T places under J lamps, (T, J), without the way from directions to angles and back.

        Parameters
        ----------
        name : str
            Name of a registered lobe.
        normal, view : (T, 3) float
            Unit vectors of the surface normals and towards the camera.
        lamp : (J, 3) float
            Unit vectors towards the lamps.
        """
        vectors = (np.ascontiguousarray(one, dtype=np.float64) for one in (normal, view, lamp))
        made = cls.__new__(cls)
        made._lobes, made._seen = Lobes.of(name), np.zeros((len(normal), len(lamp), 4))
        _fill_features_under_lamps(made._lobes, *vectors, made._seen)
        return made

    def value(self, mu) -> np.ndarray:
        """Return D G / cosθ_r, (...) float64, for roughnesses that are broadcast with the angles, see `evaluate`."""
        shape, mu, seen = self._broadcast(mu)
        out = np.zeros(len(seen))
        if mu.size:
            _fill_values(self._lobes, mu, seen, out)
        return out.reshape(shape)

    def derivatives(self, mu) -> np.ndarray:
        """Return D G / cosθ_r and its first two derivatives by ln μ, (3, ...) float64."""
        shape, mu, seen = self._broadcast(mu)
        out = np.zeros((3, len(seen)))
        if mu.size:
            _fill_derivatives(self._lobes, mu, seen, out)
        return out.reshape(3, *shape)

    def _broadcast(self, mu) -> tuple[tuple[int, ...], np.ndarray, np.ndarray]:
        mu, shape = np.asarray(mu, dtype=np.float64), self._seen.shape[:-1]
        if mu.size == 1 and mu.ndim <= len(shape):  # of all: nothing is copied
            return shape, mu.reshape(1), self._seen.reshape(-1, 4)
        shape = np.broadcast_shapes(mu.shape, shape)
        mu = np.ascontiguousarray(np.broadcast_to(mu, shape)).reshape(-1)
        return shape, mu, np.ascontiguousarray(np.broadcast_to(self._seen, (*shape, 4))).reshape(-1, 4)


def evaluate_with_derivatives(name: str, mu, geometry) -> np.ndarray:
    """Return D G / cosθ_r of a lobe and its first two derivatives by ln μ.

    Parameters
    ----------
    name : str
        Name of a registered lobe.
    mu : float or (...) float
        Roughness, in the unit of the lobe.
    geometry : (..., 4) float
        θ_i, θ_r, θ_H, φ in rad.

    Returns
    -------
    (3, ...) float64; zero where N·L <= 0 or N·V <= 0

    Raises
    ------
    ValueError
        If there is no lobe of that name.
    """
    return LobeAtAngles(name, geometry).derivatives(mu)


def evaluate(name: str, mu, geometry) -> np.ndarray:
    """Return D G / cosθ_r of a lobe, (...) float64; parameters and errors as in `evaluate_with_derivatives`.

    Examples
    --------
    The Gaussian lobe of roughness 0.1 rad, for light and camera at the normal, and for facets tilted by 0.1 rad:

    >>> evaluate("gaussian", 0.1, [[0.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.0, 0.1]]).round(3).tolist()
    [1.0, 0.37]
    """
    return LobeAtAngles(name, geometry).value(mu)
