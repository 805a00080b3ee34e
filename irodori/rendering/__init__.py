"""Rendering: from materials, light and a scene to a spectral image [eq. 5, 6, 8, 9]."""
