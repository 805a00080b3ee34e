"""An unbiased spectral path tracer: each path carries all bands; it converges to the rendering equation [eq. 5]."""

from irodori.rendering.reference.picture import (
    REPLICATES,
    Picture,
    Scene,
    Tiles,
    check_samples,
    make_scene,
    picture_key,
    pooled,
    render,
    render_rows,
)

__all__ = [
    "REPLICATES",
    "Picture",
    "Scene",
    "Tiles",
    "check_samples",
    "make_scene",
    "picture_key",
    "pooled",
    "render",
    "render_rows",
]
