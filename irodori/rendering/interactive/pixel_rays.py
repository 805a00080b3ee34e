"""Interactive rendering of chosen pixels without the rest of the picture."""

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from irodori.jit.array_views import Memory
from irodori.rendering.interactive.frame_renderer import Lamp, Prepared, frame_of
from irodori.rendering.interactive.tile_loop import FIGURES, TRACED, render_tiles
from irodori.rendering.scene_arrays import View
from irodori.rendering.single_pixels import pixel_view


def _ray(prepared: Prepared, seen: View, lamps) -> np.ndarray:
    """Return XYZ of a view of one pixel, (3,): `render_frame` without the threads of a whole frame."""
    image, counted = np.empty(3, dtype=np.float32), np.zeros(FIGURES, dtype=np.int64)
    limits = prepared.limits._replace(visibility=TRACED)
    frame = frame_of(prepared, seen, None, lamps)
    none = np.zeros(0, dtype=np.float32)
    scene = (prepared.world, frame, prepared.layout, limits, Memory(image), 3, Memory(none), Memory(counted))
    render_tiles(*scene, 0, 1)
    return image


def render_pixels(
    prepared: Prepared, view: View, pixels: np.ndarray, side: int = 1, lamps: tuple[Lamp, ...] = ()
) -> np.ndarray:
    """Return chosen pixels of a view, (n, 3) float64 XYZ: what `render_frame` has there, within its rounding.

    Parameters
    ----------
    prepared : Prepared
    view : View
    pixels : (n, 2) int
        Column and row.
    side : int
        Rays along each side of a pixel, whose mean is taken; their cones are as much narrower.
    lamps : tuple of Lamp
    """
    fine = view._replace(focal_px=view.focal_px * side, width=view.width * side, height=view.height * side)

    def one(pixel: np.ndarray) -> np.ndarray:
        total = np.zeros(3)
        for part in range(side * side):
            place = side * pixel + np.array([part % side, part // side]) + 0.5
            total += _ray(prepared, pixel_view(fine, *place), lamps)
        return total / side**2

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return np.array(list(pool.map(one, pixels))).reshape(-1, 3)
