"""Interactive rendering of chosen pixels without the rest of the picture."""

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.rendering.compiled_calls import resolved
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, Prepared, frame_of
from irodori.rendering.interactive.packets import PATHS, TILE
from irodori.rendering.interactive.tile_loop import COUNTED, FIGURES, LISTED, TRACED, FrameBuffers, Job, render_tiles
from irodori.rendering.scene_arrays import View
from irodori.rendering.single_pixels import pixel_view
from irodori.rendering.view_cameras import ORTHOGRAPHIC
from irodori.spectra.grid import SAMPLES


def rays_through(view: View, places: np.ndarray) -> np.ndarray:
    """Return the rays through points of a view's picture, (n, LISTED) float32, each with the cone of a pixel.

    Parameters
    ----------
    view : View
    places : (n, 2) float
        Column and row in pixels from the upper left corner.

    Raises
    ------
    ValueError
        If the view has a lens, because many rays then pass through each point.
    """
    rays = np.zeros((len(places), LISTED), dtype=np.float32)
    for ray, place in zip(rays, places, strict=True):
        seen = pixel_view(view, *place)
        ray[:3], ray[3:6] = seen.position_mm, seen.world_from_camera[:, 2]
        ray[6 if view.kind == ORTHOGRAPHIC else 7] = 1.0 / view.focal_px
    return rays


def render_rays(
    prepared: Prepared,
    view: View,
    rays: np.ndarray,
    lamps: tuple[CollimatedLamp, ...] = (),
    *,
    bands: bool = False,
    figures: dict | None = None,
) -> np.ndarray:
    """Render the colours along given rays of a view.

    Parameters
    ----------
    prepared : Prepared
    view : View
    rays : (n, LISTED) float32
        Rays made by `rays_through`.
    lamps : tuple of Lamp
    bands : bool
        Whether to return the 61 bands; only for the representation ``spectral``.
    figures : dict, optional
        Filled with counts, see `irodori.rendering.interactive.frame_renderer.render_frame`.

    Returns
    -------
    (n, 3) float64 XYZ, or (n, 61) radiance
    """
    rows, channels = -(-len(rays) // TILE), SAMPLES if bands else 3
    if rows == 0:
        return np.zeros((0, channels))
    frame = frame_of(prepared, view._replace(width=TILE, height=rows), None, lamps)
    frame = frame._replace(rays=rays.ravel(), listed=len(rays))
    tiles = -(-len(rays) // PATHS)
    image, counted = np.empty((rows * TILE, channels), dtype=np.float32), np.zeros((tiles, FIGURES), dtype=np.int64)
    limits, kept = prepared.limits._replace(visibility=TRACED, outlines=0), np.zeros(0, dtype=np.float32)
    job = Job(prepared.world, frame, prepared.layout, limits)
    target = FrameBuffers(image.ravel(), channels, kept, counted.ravel())
    run_chunks(resolved(render_tiles, job, target, 0, 0), tiles, 1, job, target)
    if figures is not None:
        figures |= dict(zip(COUNTED, counted.sum(axis=0).tolist(), strict=True))
    return image[: len(rays)].astype(np.float64)


def render_pixels(
    prepared: Prepared, view: View, pixels: np.ndarray, side: int = 1, lamps: tuple[CollimatedLamp, ...] = ()
) -> np.ndarray:
    """Render chosen pixels of a view, (n, 3) float64 XYZ, equal to those of `render_frame` within rounding.

    Outlines have no more rays than other places here.

    Parameters
    ----------
    prepared : Prepared
    view : View
    pixels : (n, 2) int
        Column and row.
    side : int
        Number of rays along each side of a pixel, which are averaged; their cones are narrower by this factor.
    lamps : tuple of Lamp
    """
    fine = view.finer(side)
    parts = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(1, -1, 2)
    places = side * np.asarray(pixels).reshape(-1, 1, 2) + parts + 0.5
    found = render_rays(prepared, fine, rays_through(fine, places.reshape(-1, 2)), lamps)
    return found.reshape(-1, side * side, 3).mean(axis=1)
