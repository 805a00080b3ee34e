"""Rendering of spectral images from materials, light and a scene [eq. 5, 6, 8, 9]."""
