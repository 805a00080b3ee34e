"""Cameras of views: perspective with an optional thin lens, or orthographic.

All rays from a thin lens through a pixel meet in one point of the plane in focus. A point at depth z (mm along the
axis) is blurred to a circle of diameter ``A |z - f| / z`` in that plane, with the lens diameter A and the focus
distance f; in the picture, the diameter is ``A |z - f| / (z f)`` times the focal length (Potmesil and Chakravarty
1982). A pixel is the mean radiance over the lens, without the fall-off of a real lens towards the corners.
"""

import math

from irodori.jit.compilation import uncounted

PERSPECTIVE, ORTHOGRAPHIC = 0, 1
KINDS = {"perspective": PERSPECTIVE, "orthographic": ORTHOGRAPHIC}


@uncounted(forceinline=True)
def aim(view, place, on_lens, origin, direction):
    """Compute origin and unit direction of the ray through a point of the picture.

    Parameters
    ----------
    view : irodori.rendering.scene_arrays.View
    place : (x, y)
        Point, px from the picture's left and upper edge.
    on_lens : (u, v)
        Random numbers, uniform in [0, 1), that select a point on the lens; not read without a lens.
    origin, direction : (3,) float64
    """
    (x, y), (u, v) = place, on_lens
    px, py = (x - 0.5 * view.width) / view.focal_px, (y - 0.5 * view.height) / view.focal_px
    ox, oy = 0.0, 0.0
    if view.kind == ORTHOGRAPHIC:
        ox, oy, px, py = px, py, 0.0, 0.0
    elif view.lens_mm > 0.0:
        radius, angle = 0.5 * view.lens_mm * math.sqrt(u), 2.0 * math.pi * v
        ox, oy = radius * math.cos(angle), radius * math.sin(angle)
        px, py = px - ox / view.focus_mm, py - oy / view.focus_mm
    axes, square = view.world_from_camera, 0.0
    for a in range(3):
        direction[a] = axes[a, 0] * px + axes[a, 1] * py + axes[a, 2]
        square += direction[a] * direction[a]
        origin[a] = view.position_mm[a] + axes[a, 0] * ox + axes[a, 1] * oy
    size = 1.0 / math.sqrt(square)  # the line of sight of a single pixel is sheared
    for a in range(3):
        direction[a] *= size
