"""Frames, cameras, shapes and the ray tracer: where things are and what sees what. Lengths are in mm."""
