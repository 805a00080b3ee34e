"""One-pixel views, and rays, of chosen points of a large picture."""

import numpy as np

from irodori.rendering.scene_arrays import View
from irodori.rendering.view_cameras import ORTHOGRAPHIC


def pixel_view(view: View, x: float, y: float) -> View:
    """Return the view of a single pixel, for who sends one ray through its centre.

    That ray is the one through the point (x, y) of the view's picture, in pixels from the upper left corner, and its
    cone is as wide as a pixel's of the view.

    Raises
    ------
    ValueError
        If the view has a lens: its rays are many.
    """
    if view.lens_mm > 0.0:
        raise ValueError(f"one ray of a view with a lens of {view.lens_mm:g} mm; accepted: a view without a lens")
    if view.kind == ORTHOGRAPHIC:
        return sheared_view(view, x, y)
    away = np.array([*_from_axis(view, x, y), 1.0])
    forward = view.world_from_camera @ (away / np.linalg.norm(away))
    # The camera's own sides, turned as little as possible: edges of the pixel stay along the picture's.
    right = view.world_from_camera[:, 0] - forward * (view.world_from_camera[:, 0] @ forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return View(view.position_mm, np.ascontiguousarray(rotation), view.focal_px, 1, 1)


def sheared_view(view: View, x: float, y: float) -> View:
    """Return the view of the pixel about a point (x, y) of a view's picture, for `irodori.rendering.view_cameras.aim`.

    All its rays are those of the view: the line of sight is sheared, and the plane of the picture, and of the lens,
    stays. Parallel rays start beside the view's own.
    """
    sides, away = view.world_from_camera[:, :2], _from_axis(view, x, y)
    if view.kind == ORTHOGRAPHIC:
        return view._replace(position_mm=view.position_mm + sides @ away, width=1, height=1)
    axes = np.column_stack([sides, view.world_from_camera[:, 2] + sides @ away])
    return view._replace(world_from_camera=np.ascontiguousarray(axes), width=1, height=1)


def middle_rays(view: View, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and directions, (n, 3) each, of the rays of a view's points through the middle of its lens.

    Parameters
    ----------
    view : View
    places : (n, 2) float
        In pixels from the upper left corner.
    """
    sides, (x, y) = view.world_from_camera[:, :2], np.asarray(places, dtype=np.float64).T
    across, middle = _from_axis(view, x, y).T @ sides.T, np.broadcast_to(view.position_mm, (x.size, 3))
    forward = np.broadcast_to(view.world_from_camera[:, 2], (x.size, 3))
    if view.kind == ORTHOGRAPHIC:
        return middle + across, forward.copy()
    away = across + forward
    return middle.copy(), away / np.linalg.norm(away, axis=1, keepdims=True)


def _from_axis(view: View, x, y) -> np.ndarray:
    """Return how far points of the picture lie from its middle: slopes, or mm of parallel rays, (2, ...)."""
    return np.array([x - 0.5 * view.width, y - 0.5 * view.height]) / view.focal_px
