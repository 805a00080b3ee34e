"""Shapes with a texture parametrisation, one file each, and where they stand.

A texture has `height` rows and `width` columns; texel (row, column) has u = (column + 0.5) / width and
v = (row + 0.5) / height. What a shape is, in all that the package asks of it, stands in its own file behind the
interface of `irodori.geometry.shapes.shape`; `irodori.geometry.shape_registry` lists them.
"""
