"""Omnidirectional picture from a photograph of a mirror ball, divided by the reflectance of the ball.

The camera is assumed to be far away, with parallel rays (orthographic). A point of the image at the distance s·radius
from the centre of the ball then shows the direction at an angle of 2 asin(s) from the direction to the camera. Near the
edge of the ball, directions opposite to the camera are compressed into few pixels. For directions seen beyond `RIM` the
values at `RIM` are used. The recovery of the light takes the ball's mean reflectance into account, because its prior
describes the light before the ball; the rest of the reflectance is divided out here.
"""

import math
from collections.abc import Iterator

import numpy as np

from irodori.config.models import MirrorBallSource, Size
from irodori.core.errors import InputError, counted
from irodori.core.progress import LOGGER
from irodori.geometry.circle_search import LEAST_SEEN, Circle, find_circle, seen_along
from irodori.light.environment_file import directions
from irodori.light.light_recovery import LightRecovery
from irodori.light.omnidirectional import OmnidirectionalPicture, bands
from irodori.light.placed_lights import direction_of
from irodori.reflection.fresnel import fresnel
from irodori.spectra.grid import SAMPLES
from irodori.spectra.published import refractive_index, spectrum

#: Largest used distance from the centre, relative to the radius; beyond it a pixel covers many degrees.
RIM = 0.98
#: Largest difference of the typed circle from the outline in the photograph, as a share of the radius: about twice the
#: largest error of outlines of which three quarters showed, in drawn photographs of balls in four measured places.
_NEAR = 0.08
#: Least share along which edges show of a circle that is surely the ball's outline; along circles that were mistaken
#: for it in those photographs, reflections showed along up to 0.64.
_SURE = 0.75
#: Largest number of pixels along the shorter side in which the outline is looked for. Among more, noise alone has edges
#: along every circle.
_SEARCHED_PX = 200
_ANGLES = 96
_RANK_TOLERANCE = 1e-5
_LEAST_SHARE = 1e-3


def ball_reflectance(source: MirrorBallSource, cos_h: np.ndarray) -> np.ndarray:
    """Return the reflectance of the ball, (n, 61), at cosines of the angle of incidence.

    Parameters
    ----------
    source : MirrorBallSource
        A ``reflectance_factor``, number or spectrum, applies to all angles; from a ``refractive_index`` the exact
        Fresnel reflectance is computed.
    cos_h : (n,) float
    """
    given = source.reflectance_factor
    if given is not None:
        values = spectrum(given) if isinstance(given, str) else np.full(SAMPLES, float(given))
        return np.broadcast_to(values, (len(cos_h), SAMPLES))
    if source.refractive_index is None:
        raise ValueError("a mirror ball without reflectance; accepted: refractive_index or reflectance_factor")
    n, k = refractive_index(source.refractive_index)
    return np.array([[fresnel(c, a, b) for a, b in zip(n, k, strict=True)] for c in cos_h])


def mean_reflectance(source: MirrorBallSource) -> np.ndarray:
    """Return the mean reflectance of the used part of the ball over solid angle, (61,)."""
    # Equal areas of the image of the ball show equal solid angles.
    area = (np.arange(_ANGLES) + 0.5) / _ANGLES
    return ball_reflectance(source, np.sqrt(1.0 - RIM**2 * area)).mean(axis=0)


def inverse_reflectance(source: MirrorBallSource, cos_h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Decompose 1 / F into a sum of few products: factors per angle, (n, t), and spectra, (61, t)."""
    angles = np.linspace(math.sqrt(1.0 - RIM**2), 1.0, _ANGLES)
    reflectance = ball_reflectance(source, angles)
    if (reflectance <= 1e-3).any():
        raise ValueError("a ball that reflects less than a thousandth at some wavelength; accepted: a mirror")
    u, s, vt = np.linalg.svd(1.0 / reflectance)
    count = int((s > _RANK_TOLERANCE * s[0]).sum())
    factors = [np.interp(cos_h, angles, u[:, i] * s[i]) for i in range(count)]
    return np.stack(factors, axis=-1), vt[:count].T


def used_part(source: MirrorBallSource, height: int, width: int) -> np.ndarray:
    """Return the pixels of the photograph of a ball that are used, (height, width) bool."""
    (x, y), radius = source.centre_px, source.radius_px
    return np.hypot(np.arange(width) - x, np.arange(height)[:, None] - y) <= RIM * radius + 1.0


def outline_doubt(source: MirrorBallSource, response, path) -> str | None:
    """Compare the typed circle of a ball with the edges in its photograph.

    The outline shows neither where the camera stood nor how it was turned.

    Parameters
    ----------
    source : MirrorBallSource
    response : (rows, columns, bands) float
        The photograph.
    path : path
        The photograph, for the error message.

    Returns
    -------
    str or None
        Words of a warning if another circle may be the ball's, or if no outline shows.

    Raises
    ------
    InputError
        If there is the outline of a ball elsewhere, and none where it was typed.
    """
    bright = np.maximum(response, 0.0).mean(axis=-1)
    step = math.ceil(min(bright.shape) / _SEARCHED_PX)
    rows, columns = (side // step for side in bright.shape)
    small = bright[: rows * step, : columns * step].reshape(rows, step, columns, step).mean(axis=(1, 3))
    (x, y), radius = source.centre_px, source.radius_px
    middle = 0.5 * (step - 1)
    typed = Circle((x - middle) / step, (y - middle) / step, radius / step)
    shows = seen_along(small, typed)
    try:
        found = find_circle(small, path)
    except InputError:
        unseen = (
            "no outline of a ball shows in the photograph, and nothing tells whether centre_px and radius_px are right"
        )
        return unseen if shows < LEAST_SEEN else None
    apart = max(math.hypot(found.x - typed.x, found.y - typed.y), abs(found.radius - typed.radius))
    other = seen_along(small, found)
    if apart <= _NEAR * typed.radius or (shows >= LEAST_SEEN and (other < _SURE or shows >= other)):
        return None
    shown = f"about {found.x * step + middle:.0f}, {found.y * step + middle:.0f} of radius {found.radius * step:.0f}"
    words = f"edges like those of a ball {shown}, which was typed as about {x:g}, {y:g} of radius {radius:g}"
    if shows < LEAST_SEEN and other >= _SURE:
        raise InputError(path, "radius_px", words, "centre_px and radius_px of the outline, in superpixels")
    return f"{words}: are centre_px and radius_px right?"


def ball_places(
    source: MirrorBallSource, width: int, height: int, rows: slice = slice(None)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the positions in the photograph of a ball at which directions of an equirectangular picture are seen.

    Returns
    -------
    x_px, y_px : (height, width) float64
        Pixel coordinates, 0 at the centre of the first pixel, y down.
    sine : (height, width) float64
        Distance from the centre of the ball relative to its radius, before it is limited to `RIM`.
    """
    to_camera = direction_of(source.camera_azimuth_deg, source.camera_elevation_deg)
    # The frame of an upright camera, rotated by the roll angle about the line of sight.
    azimuth, roll = np.radians([source.camera_azimuth_deg, source.roll_deg])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(to_camera, right)
    right, up = np.cos(roll) * right + np.sin(roll) * up, np.cos(roll) * up - np.sin(roll) * right
    unit = directions(width, height, rows)[0]
    half = unit + to_camera
    length = np.linalg.norm(half, axis=-1, keepdims=True)
    half = np.divide(half, length, out=np.broadcast_to(right, half.shape).copy(), where=length > 1e-9)
    a, b = half @ right, half @ up
    sine = np.hypot(a, b)
    held = np.minimum(sine, RIM) / np.maximum(sine, 1e-12) * source.radius_px
    x, y = source.centre_px
    return x + a * held, y - b * held, sine


def _bilinear(values: np.ndarray, valid: np.ndarray, x: np.ndarray, y: np.ndarray, path) -> np.ndarray:
    """Interpolate pixels bilinearly, without masked ones; raise an error if all four neighbours are masked."""
    height, width = valid.shape
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    # Weights are never zero, so that a look-up at the centre of a masked pixel uses the three others.
    x, y = (first + np.clip(at - first, _LEAST_SHARE, 1.0 - _LEAST_SHARE) for at, first in ((x, x0), (y, y0)))
    total, weight = np.zeros((*x.shape, values.shape[-1])), np.zeros(x.shape)
    for dy in (0, 1):
        for dx in (0, 1):
            row, column = np.clip(y0 + dy, 0, height - 1), np.clip(x0 + dx, 0, width - 1)
            share = np.abs(1 - dx - (x - x0)) * np.abs(1 - dy - (y - y0)) * valid[row, column]
            total += np.where(share > 0, share, 0.0)[..., None] * np.where(
                valid[row, column, None], values[row, column], 0
            )
            weight += share
    lost = int((weight == 0.0).sum())
    if lost:
        raise InputError(
            path, "valid", f"{counted(lost, 'direction')} whose pixels are all masked", "single masked pixels at most"
        )
    return total / weight[..., None]


def unwrapped(
    source: MirrorBallSource, image: Size, response, valid, recovery: LightRecovery, path
) -> OmnidirectionalPicture:
    """Make the omnidirectional picture from a mirror ball; the whole photograph is kept in memory.

    Parameters
    ----------
    source : MirrorBallSource
    image : Size
        Size of the equirectangular picture, px.
    response : (rows, columns, bands) float
        The photograph.
    valid : (rows, columns) bool
    recovery : LightRecovery
        Recovery of light that the mean reflectance of the ball reflects to the camera.
    path : path
        The photograph, for the error message.

    Raises
    ------
    InputError
        If the ball does not lie within the photograph. While the picture is read: if four adjacent pixels are masked.
    """
    rows, columns = valid.shape
    (x, y), radius = source.centre_px, source.radius_px
    if min(x, y) - radius < -0.5 or x + radius > columns - 0.5 or y + radius > rows - 0.5:
        found = f"a ball about {x:g}, {y:g} of radius {radius:g}, beyond the photograph"
        raise InputError(path, "response", found, f"a ball within {columns} x {rows} pixels")
    # The directions beyond the rim form a cone around the line of sight with a half-angle of π - 2 asin(RIM).
    blind = 1.0 - RIM**2
    LOGGER.info("mirror ball: %.1f %% of the sphere lies behind it and takes the values of its rim", 100 * blind)
    size = image.height, image.width
    # The recovery has divided by the mean reflectance.
    weights, inverse = recovery.weights(response), inverse_reflectance(source, np.ones(1))[1]
    inverse = mean_reflectance(source)[:, None] * inverse

    def divided(basis: np.ndarray) -> np.ndarray:
        """Multiply spectra, (..., 61, r), by each of those of mean F / F; return (..., 61, parts r)."""
        return np.einsum("lt,...lr->...ltr", inverse, basis).reshape(*basis.shape[:-1], -1)

    def read() -> Iterator[np.ndarray]:
        for part in bands(size[0]):
            x_px, y_px, sine = ball_places(source, size[1], size[0], part)
            seen = _bilinear(weights, valid, x_px, y_px, path)
            factors, _ = inverse_reflectance(source, np.sqrt(1.0 - np.minimum(sine, RIM) ** 2).ravel())
            out = seen.reshape(-1, 1, seen.shape[-1]) * factors[:, :, None]
            yield out.reshape(*x_px.shape, -1).astype(np.float32)

    origin = {
        "kind": "mirror_ball",
        "assumption": "an orthographic camera: it stands far from the ball against the ball's radius",
        "blind_fraction": blind,
    }
    return OmnidirectionalPicture(
        size, divided(recovery.basis), read, path, origin, basis_errors=divided(recovery.errors)
    )
