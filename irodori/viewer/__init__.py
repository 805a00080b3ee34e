"""The classroom page: an interactive rendering of a scene in one HTML file that works offline."""
