"""Views of one pixel each, so that chosen pixels of a large picture can be rendered without the others."""

import numpy as np

from irodori.rendering.scene import View


def pixel_view(view: View, x: float, y: float) -> View:
    """Return the view of a single pixel.

    Its one ray is that through the point (x, y) of the view's picture, in pixels from the upper left corner, and its
    cone is as wide as a pixel's of the view. Whoever draws rays over the whole pixel draws them from a square that
    has, off the view's axis, up to 1 / cos³ of the angle more solid angle than the pixel; `same_solid_angle` mends it.
    """
    away = np.array([(x - 0.5 * view.width) / view.focal_px, (y - 0.5 * view.height) / view.focal_px, 1.0])
    forward = view.world_from_camera @ (away / np.linalg.norm(away))
    # The camera's own sides, turned as little as possible: edges of the pixel stay along the picture's.
    right = view.world_from_camera[:, 0] - forward * (view.world_from_camera[:, 0] @ forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return View(view.position_mm, np.ascontiguousarray(rotation), view.focal_px, 1, 1)


def same_solid_angle(view: View, pixel: View) -> View:
    """Return the view of a pixel with the solid angle that the pixel has in the view it was taken from."""
    cosine = float(view.world_from_camera[:, 2] @ pixel.world_from_camera[:, 2])
    return pixel._replace(focal_px=view.focal_px / cosine**1.5)
