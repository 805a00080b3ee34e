"""Cameras of views: perspective with an optional thin lens, or orthographic.

A thin lens gathers over its disc what a place of the plane in focus sends: a point at the depth z (mm along the axis)
is spread over a circle of the diameter ``A |z - f| / z`` in that plane, with A the lens' diameter and f the focus
distance; in the picture it is ``A |z - f| / (z f)`` times the focal length (Potmesil and Chakravarty 1982). A pixel is
the mean radiance over the lens: no fall-off towards the corners is added.
"""

import math

from irodori.jit.compilation import uncounted

PERSPECTIVE, ORTHOGRAPHIC = 0, 1
KINDS = {"perspective": PERSPECTIVE, "orthographic": ORTHOGRAPHIC}


@uncounted(forceinline=True)
def aim(view, place, on_lens, origin, direction):
    """Fill where the ray through a place of the picture starts, and its unit direction.

    Parameters
    ----------
    view : irodori.rendering.scene_arrays.View
    place : (x, y)
        From the picture's left and upper edge, px.
    on_lens : (u, v)
        Place on the lens, even in [0, 1); not read without one.
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
