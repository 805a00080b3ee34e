"""Views of single pixels, and rays through chosen points, of a large picture."""

import numpy as np

from irodori.rendering.scene_arrays import View
from irodori.rendering.view_cameras import ORTHOGRAPHIC


def pixel_view(view: View, x: float, y: float) -> View:
    """Return a view of one pixel, whose central ray passes through a point (x, y) of a view's picture.

    The point is given in pixels from the upper left corner. The cone of the ray is as wide as that of a pixel of the
    original view.

    Raises
    ------
    ValueError
        If the view has a lens, because many rays then pass through each point.
    """
    if view.lens_mm > 0.0:
        raise ValueError(f"one ray of a view with a lens of {view.lens_mm:g} mm; accepted: a view without a lens")
    if view.kind == ORTHOGRAPHIC:
        return sheared_view(view, x, y)
    away = np.array([*_from_axis(view, x, y), 1.0])
    forward = view.world_from_camera @ (away / np.linalg.norm(away))
    # The camera's axes are rotated as little as possible, so that edges of the pixel stay parallel to the picture's.
    right = view.world_from_camera[:, 0] - forward * (view.world_from_camera[:, 0] @ forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return View(view.position_mm, np.ascontiguousarray(rotation), view.focal_px, 1, 1)


def sheared_view(view: View, x: float, y: float) -> View:
    """Return a view of the pixel around a point (x, y) of a view's picture, for `irodori.rendering.view_cameras.aim`.

    Its rays are exactly those of the original view: the line of sight is sheared, while the planes of the picture and
    the lens stay the same. For parallel rays, the position is shifted instead.
    """
    sides, away = view.world_from_camera[:, :2], _from_axis(view, x, y)
    if view.kind == ORTHOGRAPHIC:
        return view._replace(position_mm=view.position_mm + sides @ away, width=1, height=1)
    axes = np.column_stack([sides, view.world_from_camera[:, 2] + sides @ away])
    return view._replace(world_from_camera=np.ascontiguousarray(axes), width=1, height=1)


def middle_rays(view: View, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and directions, (n, 3) each, of rays through points of a view's picture and the lens centre.

    Parameters
    ----------
    view : View
    places : (n, 2) float
        Column and row of the points, in pixels from the upper left corner.
    """
    sides, (x, y) = view.world_from_camera[:, :2], np.asarray(places, dtype=np.float64).T
    across, middle = _from_axis(view, x, y).T @ sides.T, np.broadcast_to(view.position_mm, (x.size, 3))
    forward = np.broadcast_to(view.world_from_camera[:, 2], (x.size, 3))
    if view.kind == ORTHOGRAPHIC:
        return middle + across, forward.copy()
    away = across + forward
    return middle.copy(), away / np.linalg.norm(away, axis=1, keepdims=True)


def _from_axis(view: View, x, y) -> np.ndarray:
    """Return the offsets of points from the picture's centre, (2, ...): slopes of rays, or mm for parallel rays."""
    return np.array([x - 0.5 * view.width, y - 0.5 * view.height]) / view.focal_px
