"""Unbiased spectral path tracer, in which each path carries all 61 bands [eq. 5]."""
