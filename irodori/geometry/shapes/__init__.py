"""Shapes with texture coordinates, one file for each, and their placement in a world.

A texture has `height` rows and `width` columns; texel (row, column) has u = (column + 0.5) / width and v = (row + 0.5)
/ height. The file of a shape contains everything that is specific to it and implements the interface
`irodori.geometry.shapes.shape`. `irodori.geometry.shape_registry` lists the shapes.
"""
