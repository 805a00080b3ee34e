"""An unbiased spectral path tracer: each path carries all bands; it converges to the rendering equation [eq. 5]."""
