"""Virtual classroom as an omnidirectional image: daylight windows, ceiling lamps, walls.

The image is equirectangular, as seen from the room's eye point: columns are azimuth from +x towards +y over 2π, rows
the angle from the zenith. Radiance is relative: 1 is a perfect diffuser lit at normal incidence by the rig's light.
"""

from dataclasses import replace

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights
from irodori.config.models import PlacedChart, RoomLamps, RoomWindow, VirtualRoom
from irodori.light.environment_file import directions
from irodori.spectra.published import light, spectrum

_BLOCK_ROWS = 16  # of a panorama that are traced at once: what the processor's cache holds
_CHART_COLUMNS = 400  # columns of the room's image from which the irradiance of a chart is summed


def equal_luminance(power: np.ndarray, rig_light: np.ndarray) -> np.ndarray:
    """Return a light's spectrum scaled to the luminance of the rig's light, (61,)."""
    weight = colour_matching_weights()[1]
    return power * (weight @ rig_light) / (weight @ power)


def source_spectra(room: VirtualRoom, rig_light: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Return the spectral radiance of the room's surfaces and lights.

    Returns
    -------
    names : list of str
    radiance : (sources, 61) float64; surfaces reflect the ambient light, window and lamps have spectra of their own
    """
    ambient = equal_luminance(light(room.ambient_light), rig_light)
    names, spectra = [], []
    for name in ("ceiling", "floor", "walls", "board"):
        surface = getattr(room.surfaces, name)
        names.append(name)
        spectra.append(surface.irradiance * spectrum(surface.spectrum) * ambient)
    sources: dict[str, RoomWindow | RoomLamps] = {"window": room.window, "lamps": room.lamps}
    for name, source in sources.items():
        names.append(name)
        spectra.append(source.radiance * equal_luminance(light(source.spectrum), rig_light))
    return names, np.stack(spectra)


def trace_room(room: VirtualRoom, width: int, height: int, rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Return the source that is visible in each direction of some rows of a panorama, and its shading.

    Returns
    -------
    source : (rows, width) int8, index into `source_spectra`
    shading : (rows, width) float64, factor on the source's radiance
    """
    size = np.array([room.room_m.width, room.room_m.depth, room.room_m.height])
    eye = np.asarray(room.eye_m)
    low, high = np.array([-size[0] / 2, -size[1] / 2, 0.0]), np.array([size[0] / 2, size[1] / 2, size[2]])
    direction, _ = directions(width, height, rows)
    with np.errstate(divide="ignore"):
        distance = np.where(direction > 0, (high - eye) / direction, (low - eye) / direction)
    axis = np.argmin(distance, axis=-1)
    point = eye + direction * np.min(distance, axis=-1)[..., None]
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    upward = np.take_along_axis(direction, axis[..., None], axis=-1)[..., 0] > 0

    source = np.full(axis.shape, 2, dtype=np.int8)
    source[(axis == 2) & upward] = 0
    source[(axis == 2) & ~upward] = 1
    source[(axis == 1) & upward & (np.abs(x) < 2.0) & (np.abs(z - 1.5) < 0.6)] = 3
    columns = room.window.columns
    pane = (y / size[1] + 0.5) * columns
    glass = (np.abs(pane - np.floor(pane) - 0.5) < 0.42) & (z > 0.9) & (z < size[2] - 0.4)
    source[(axis == 0) & upward & glass] = 4
    lamps = room.lamps
    across = (x / size[0] + 0.5) * lamps.columns
    along = (y / size[1] + 0.5) * lamps.rows
    inside_x = np.abs(across - np.floor(across) - 0.5) * size[0] / lamps.columns < lamps.width_m / 2
    inside_y = np.abs(along - np.floor(along) - 0.5) * size[1] / lamps.rows < lamps.depth_m / 2
    source[(axis == 2) & upward & inside_x & inside_y] = 5
    # Surfaces darken away from the windows and towards the floor; lamps and panes are uniform.
    shading = np.where(source < 4, 0.7 + 0.2 * (x / size[0] + 0.5) + 0.1 * z / size[2], 1.0)
    return source, shading


def room_coefficients(room: VirtualRoom, width: int, height: int) -> np.ndarray:
    """Return the share of each source in every pixel, (height, width, sources) float32, from 2 x 2 samples a pixel."""
    sources = len(source_spectra(room, np.ones(61))[0])
    shares = np.empty((height, width, sources), dtype=np.float32)
    for first in range(0, height, _BLOCK_ROWS):
        block = shares[first : first + _BLOCK_ROWS]
        rows = slice(2 * first, 2 * (first + len(block)))
        source, shading = trace_room(room, 2 * width, 2 * height, rows)
        fine = np.eye(sources, dtype=np.float32)[source] * shading[..., None].astype(np.float32)
        block[:] = fine.reshape(len(block), 2, width, 2, sources).mean(axis=(1, 3))
    return shares


def light_on_chart(room: VirtualRoom, place: PlacedChart, rig_light: np.ndarray) -> np.ndarray:
    """Return the radiance of a perfect diffuser at the position and orientation of a chart in the room, (61,)."""
    direction, solid_angle = directions(_CHART_COLUMNS, _CHART_COLUMNS // 2)
    facing = np.asarray(place.facing) / np.linalg.norm(place.facing)
    falls = np.maximum(direction @ facing, 0.0) * solid_angle / np.pi
    seen = room_coefficients(replace(room, eye_m=place.position_m), _CHART_COLUMNS, _CHART_COLUMNS // 2)
    return np.tensordot(falls, seen, axes=2) @ source_spectra(room, rig_light)[1]
