"""Rectification: from pictures of an object to observations of its texels."""
