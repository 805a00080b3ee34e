"""Measurements of speed against error, run by hand."""
