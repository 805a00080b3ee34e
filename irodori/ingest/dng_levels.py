"""Repeat pattern of a DNG's black levels, a tag that LibRaw does not report."""

from irodori.ingest.tiff_tags import SHORT, read_tags

_BLACK_LEVEL_REPEAT = 50713


def black_level_repeats(path) -> list[tuple[int, int]]:
    """Return (rows, columns) of the repeat of the black level in each directory of a TIFF that states one.

    Parameters
    ----------
    path : path
        Any file; one that is no TIFF states none, and what a damaged one says beyond its end is left out.
    """
    found = [tag.values for tag in read_tags(path, (_BLACK_LEVEL_REPEAT,)) if tag.kind == SHORT]
    return [(int(values[0]), int(values[1])) for values in found if len(values) == 2]
