"""Repeat pattern of the black levels of a DNG file, a tag that LibRaw does not report."""

from irodori.ingest.tiff_tags import SHORT, read_tags

_BLACK_LEVEL_REPEAT = 50713


def black_level_repeats(path) -> list[tuple[int, int]]:
    """Return the repeat (rows, columns) of the black level from each TIFF directory that states one.

    Parameters
    ----------
    path : path
        Any file. A file that is not a TIFF gives an empty list; tags beyond the end of a truncated file are ignored.
    """
    found = [tag.values for tag in read_tags(path, (_BLACK_LEVEL_REPEAT,)) if tag.kind == SHORT]
    return [(int(values[0]), int(values[1])) for values in found if len(values) == 2]
