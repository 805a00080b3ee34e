"""Division of a texture into tiles of whole rows."""


def tile_rows(height: int, width: int, tile_texels: int) -> list[tuple[int, int]]:
    """Return the first and last-plus-one texture row of each tile.

    Parameters
    ----------
    height, width : int
        Size of the texture, texels.
    tile_texels : int
        Upper bound on the texels of a tile; a tile has at least one row.
    """
    rows = max(1, min(height, tile_texels // width))
    return [(start, min(start + rows, height)) for start in range(0, height, rows)]
