"""Unbiased spectral path tracer; each path carries all bands [eq. 5]."""
