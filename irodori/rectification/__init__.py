"""Rectification: observations of an object's texels from its pictures."""
