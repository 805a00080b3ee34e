"""Pictures of one scene without and with a comb-filter plate, with the plate's geometry applied analytically.

A scene is a random pile of discs and rectangles ("dead leaves"), each with two smooth random reflectance spectra mixed
by a sine wave. It is a function of continuous coordinates, so that the picture through the plate is rendered at
transformed coordinates and never resampled. The camera is that of the virtual rig, with its band weights, mosaic, pixel
aperture, noise and quantisation.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import yaml

from irodori.config.definition import typed
from irodori.config.models import Camera
from irodori.ingest.registration.similarity import Registration
from irodori.simulation.virtual_rig.aperture import gather_rows, place_in_cell
from irodori.simulation.virtual_rig.sensor import Sensor, band_weights
from irodori.spectra.grid import SAMPLES
from irodori.spectra.published import spectrum

CAMERA = yaml.safe_load((Path(__file__).resolve().parents[1] / "config/cameras/d5100-comb.yaml").read_text())
SATURATION = 0.98
#: No shift of the picture.
AT_REST = Registration(0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
_EXPOSURE_S = (0.02, 0.05)
_CELL_PX = 16.0
_MARGIN_PX = 48.0
_BLOCK_ROWS = 16  # of the mosaic, even


@dataclass(frozen=True)
class Scene:
    """A pile of leaves in superpixel coordinates; later leaves cover earlier ones.

    Parameters
    ----------
    leaves : (n, 9) float64
        x, y, half width, half height, orientation (rad), phase (rad), wave vector x and y (rad/superpixel), kind
        (0 ellipse, 1 rectangle).
    bands : (n, 2, 6) float64
        Responses of the two spectra of each leaf.
    background : (6,) float64
    """

    leaves: np.ndarray
    bands: np.ndarray
    background: np.ndarray


@cache
def white_weights() -> np.ndarray:
    """Return band weights, (6, 61), with which a perfect diffuser has the response 1 in every band."""
    weights = band_weights(typed(Camera, CAMERA), spectrum("A"))
    return weights / weights.sum(axis=1, keepdims=True)


def sensor() -> Sensor:
    """Return the sensor of the camera."""
    return Sensor(**CAMERA["virtual"]["sensor"])


def random_reflectances(count: int, rng: np.random.Generator) -> np.ndarray:
    """Return smooth random reflectances between 0.02 and 0.95, (count, 61)."""
    wavelength = np.linspace(0.0, 1.0, SAMPLES)
    order = np.arange(8)
    amplitude = rng.normal(size=(count, 8)) * np.array([1.2, 1.5, 1.3, 1.1, 0.9, 0.7, 0.5, 0.4])
    return 0.02 + 0.93 / (1.0 + np.exp(0.5 - amplitude @ np.cos(np.pi * order[:, None] * wavelength)))


def leaves_scene(
    width_px: int,
    height_px: int,
    rng: np.random.Generator,
    *,
    size_px=(3.0, 40.0),
    cover: float = 3.0,
    texture: float = 1.0,
    inside=None,
) -> Scene:
    """Return a random scene that covers a picture and a margin around it.

    Parameters
    ----------
    width_px, height_px : int, superpixels
    rng : numpy Generator
    size_px : (2,) float
        Smallest and largest half width of a leaf; their density falls with the third power of the size.
    cover : float
        Area of all leaves over that of the picture.
    texture : float
        0 for leaves of one colour, 1 for leaves that alternate between their two spectra.
    inside : (3,) float, optional
        x, y and radius of a disc that holds all leaves; outside it is black.
    """
    small, large = size_px
    area = (width_px + 2 * _MARGIN_PX) * (height_px + 2 * _MARGIN_PX)
    if inside is not None:
        area = np.pi * inside[2] ** 2
    draws = rng.random(200_000)
    sizes = 1.0 / np.sqrt(1.0 / small**2 - draws * (1.0 / small**2 - 1.0 / large**2))
    count = min(len(sizes), 4 + int(np.searchsorted(np.cumsum(4.0 * sizes**2 * 0.7), cover * area)))
    leaves = np.empty((count, 9))
    if inside is None:
        leaves[:, 0] = rng.uniform(-_MARGIN_PX, width_px + _MARGIN_PX, count)
        leaves[:, 1] = rng.uniform(-_MARGIN_PX, height_px + _MARGIN_PX, count)
    else:
        angle, radius = rng.uniform(0, 2 * np.pi, count), inside[2] * np.sqrt(rng.random(count))
        leaves[:, 0], leaves[:, 1] = inside[0] + radius * np.cos(angle), inside[1] + radius * np.sin(angle)
    leaves[:, 2] = sizes[:count]
    leaves[:, 3] = sizes[:count] * rng.uniform(0.4, 1.0, count)
    leaves[:, 4:6] = rng.uniform(0, 2 * np.pi, (count, 2))
    leaves[:, 6:8] = texture * rng.normal(size=(count, 2)) * 2 * np.pi / 20.0
    leaves[:, 8] = rng.integers(0, 2, count)
    spectra = random_reflectances(2 * count, rng).reshape(count, 2, SAMPLES)
    if texture == 0.0:
        spectra[:, 1] = spectra[:, 0]
    background = np.zeros(6) if inside is not None else np.full(6, 0.2)
    return Scene(leaves, spectra @ white_weights().T, background)


class _Sheet(NamedTuple):
    """Leaves in the bands of one filter state, with a grid of cells that lists the leaves touching each cell."""

    low: np.ndarray  # (2,) corner of the grid, x then y
    columns: int
    rows: int
    starts: np.ndarray  # (cells + 1,) index of each cell's first leaf in `listed`
    listed: np.ndarray  # indices of leaves, topmost first
    leaves: np.ndarray  # (leaves, 9), see `Scene`
    bands: np.ndarray  # (leaves, 2, 3)
    background: np.ndarray  # (3,)


def _sheet(scene: Scene, low, high, seen: slice) -> _Sheet:
    """Return the `_Sheet` of a scene between two corners, in the bands that a slice selects."""
    columns, rows = (int(n) for n in np.ceil((high - low) / _CELL_PX))
    reach = np.hypot(scene.leaves[:, 2], scene.leaves[:, 3])
    first = np.floor((scene.leaves[:, :2] - reach[:, None] - low) / _CELL_PX).astype(int)
    last = np.floor((scene.leaves[:, :2] + reach[:, None] - low) / _CELL_PX).astype(int)
    holds = [[] for _ in range(rows * columns)]
    for leaf in range(len(scene.leaves) - 1, -1, -1):
        for row in range(max(first[leaf, 1], 0), min(last[leaf, 1], rows - 1) + 1):
            for column in range(max(first[leaf, 0], 0), min(last[leaf, 0], columns - 1) + 1):
                holds[row * columns + column].append(leaf)
    starts = np.cumsum([0] + [len(h) for h in holds])
    listed = np.array([leaf for h in holds for leaf in h], dtype=np.int64)
    bands, background = np.ascontiguousarray(scene.bands[..., seen]), np.ascontiguousarray(scene.background[seen])
    return _Sheet(low, columns, rows, starts, listed, scene.leaves, bands, background)


@numba.njit(cache=True)
def _see(out, x, y, sheet):
    """Fill ``out`` with the responses of the topmost leaf at a point (x, y) of the scene."""
    low, columns, rows, starts, listed, leaves, bands, background = sheet
    column, row = int((x - low[0]) / _CELL_PX), int((y - low[1]) / _CELL_PX)
    out[:] = background
    if column < 0 or row < 0 or column >= columns or row >= rows:
        return
    cell = row * columns + column
    for at in range(starts[cell], starts[cell + 1]):
        leaf = leaves[listed[at]]
        dx, dy = x - leaf[0], y - leaf[1]
        c, s = np.cos(leaf[4]), np.sin(leaf[4])
        u, v = (c * dx + s * dy) / leaf[2], (c * dy - s * dx) / leaf[3]
        covered = (u * u + v * v < 1.0) if leaf[8] == 0.0 else (abs(u) < 1.0 and abs(v) < 1.0)
        if covered:
            mix = 0.5 + 0.5 * np.sin(leaf[6] * dx + leaf[7] * dy + leaf[5])
            for band in range(out.size):
                out[band] = mix * bands[listed[at], 0, band] + (1.0 - mix) * bands[listed[at], 1, band]
            return


@numba.njit(cache=True)
def _mosaic_rows(out, first, inverse, barrel, sheet):
    count = min(_BLOCK_ROWS, out.shape[0] - first)
    points = np.empty((2 * count + 2, 2 * out.shape[1] + 2, 3))
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            x, y = place_in_cell(2 * first + i - 1, j - 1)
            # A mosaic pixel spans 0..1; the centre of a superpixel is an integer.
            dx, dy = x / 2.0 - 0.5 - inverse[2, 0], y / 2.0 - 0.5 - inverse[2, 1]
            bend = 1.0 + barrel * (dx * dx + dy * dy)
            qx = inverse[0, 0] * dx * bend + inverse[0, 1] * dy * bend + inverse[0, 2]
            qy = inverse[1, 0] * dx * bend + inverse[1, 1] * dy * bend + inverse[1, 2]
            _see(points[i, j], qx, qy, sheet)
    gather_rows(points, first, out)


@numba.njit(cache=True, parallel=True)
def _mosaic(out, inverse, barrel, sheet):
    for block in numba.prange(-(-out.shape[0] // _BLOCK_ROWS)):
        _mosaic_rows(out, block * _BLOCK_ROWS, inverse, barrel, sheet)


def render(scene: Scene, width_px: int, height_px: int, state: int, truth: Registration, barrel_px: float = 0.0):
    """Render the mosaic of a picture without noise, (2 height, 2 width); ``truth`` maps the scene onto the picture.

    ``barrel_px`` is a radial distortion proportional to the third power of the radius: the approximate outward
    displacement of the picture's corners, superpixels.
    """
    low = np.array([-_MARGIN_PX, -_MARGIN_PX])
    high = np.array([width_px, height_px]) + _MARGIN_PX
    centre = np.array([(width_px - 1) / 2, (height_px - 1) / 2])
    c, s = np.cos(truth.rotation_rad) / truth.scale, np.sin(truth.rotation_rad) / truth.scale
    back = np.array([[c, s], [-s, c]])
    inverse = np.zeros((3, 3))
    inverse[:2, :2] = back
    inverse[:2, 2] = centre
    inverse[2, :2] = np.add(centre, (truth.dx_px, truth.dy_px))
    radius = np.hypot(*centre)
    out = np.empty((2 * height_px, 2 * width_px))
    _mosaic(out, inverse, -barrel_px / radius**3, _sheet(scene, low, high, slice(3 * state, 3 * state + 3)))
    return out


def photograph(mosaic: np.ndarray, state: int, rng: np.random.Generator, light: float = 1.0, vignetting: float = 0.08):
    """Photograph a mosaic of responses with noise; return responses of superpixels and a mask of valid ones.

    ``light`` is the brightness relative to that of the white reference, which is not corrected. Vignetting is corrected
    as by a flat field, so that only its effect on the noise remains.
    """
    device = sensor()
    white = band_weights(typed(Camera, CAMERA), spectrum("A"))[3 * state : 3 * state + 3].sum(axis=1)
    y, x = np.ogrid[: mosaic.shape[0], : mosaic.shape[1]]
    radius2 = (x - mosaic.shape[1] / 2) ** 2 + (y - mosaic.shape[0] / 2) ** 2
    flat = 1.0 - vignetting * radius2 / radius2.max()
    band = y % 2 + x % 2
    exposure = _EXPOSURE_S[state]
    numbers = device.expose(mosaic * white[band] * light * flat, exposure, rng).astype(np.float64)
    per_response = device.full_well_e / device.response_at_full_well * exposure / device.base_exposure_s
    rate = (numbers - device.black_level) * device.electrons_per_dn / per_response / white[band]
    rate /= flat
    fraction = (numbers - device.black_level) / (device.white_level - device.black_level)
    largest = np.maximum.reduce([fraction[r::2, c::2] for r in (0, 1) for c in (0, 1)])
    picture = np.stack([rate[::2, ::2], 0.5 * (rate[::2, 1::2] + rate[1::2, ::2]), rate[1::2, 1::2]], axis=-1)
    return picture.astype(np.float32), largest < SATURATION


def random_truth(rng: np.random.Generator, shift_px: float = 8.0, rotation_deg: float = 0.5, scale: float = 0.01):
    """Return a random transform of the filter plate, uniform within the given limits."""
    dx, dy, angle, zoom = rng.uniform(-1.0, 1.0, 4)
    return Registration(
        dx_px=shift_px * dx, dy_px=shift_px * dy, rotation_rad=np.radians(rotation_deg) * angle,
        scale=1.0 + scale * zoom, residual_px=0.0, sigma_px=0.0,
    )  # fmt: skip


def errors_px(found: Registration, truth: Registration, width_px: int, height_px: int) -> np.ndarray:
    """Return the distances between two transforms at the picture's four corners and its centre, (5,), superpixels."""
    right, bottom = width_px - 1.0, height_px - 1.0
    centre = np.array([right / 2, bottom / 2])
    places = np.array([[0, 0], [right, 0], [0, bottom], [right, bottom], centre])
    moved = []
    for r in (found, truth):
        c, s = r.scale * np.cos(r.rotation_rad), r.scale * np.sin(r.rotation_rad)
        moved.append((places - centre) @ np.array([[c, s], [-s, c]]) + centre + (r.dx_px, r.dy_px))
    return np.hypot(*(moved[0] - moved[1]).T)
