"""Coordinate frames, cameras, shapes and ray tracing. Lengths are in mm."""
