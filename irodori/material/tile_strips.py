"""Division of a tile into strips of whole rows, in which its observations are computed, fitted and read.

Memory depends on the strip and not on the tile, so that a tile can be large: every job of a tile reads all photographs
whole to check them, and takes a second to start.
"""

from itertools import pairwise

#: Observations of a strip: texels times photographs. With 24 photographs, 250 000 texels.
MOST_OBSERVATIONS = 6_000_000


def strips(rows: tuple[int, int], width: int, captures: int) -> list[tuple[int, int]]:
    """Return the first and last-plus-one texture row of each strip of a tile.

    Parameters
    ----------
    rows : (int, int)
        First and last-plus-one row of the tile.
    width : int
        Texels in a row.
    captures : int
        Photographs of the object.
    """
    most = max(1, MOST_OBSERVATIONS // (width * max(captures, 1)))
    count = max(1, -(-(rows[1] - rows[0]) // most))
    borders = [rows[0] + (rows[1] - rows[0]) * number // count for number in range(count + 1)]
    return list(pairwise(borders))


def texels_of(strip: tuple[int, int], rows: tuple[int, int], width: int) -> slice:
    """Return which texels of a tile with these rows lie in a strip."""
    return slice((strip[0] - rows[0]) * width, (strip[1] - rows[0]) * width)
