"""TIFFs that hold the tags of photographs: the whole file, or parts of JPEG, Canon's CR3 and Fujifilm's RAF."""

import struct
from collections.abc import Iterator
from itertools import islice

#: First bytes of a TIFF, and of the formats of Olympus and Panasonic, which differ from one in nothing else that counts
#: here; with the order of bytes in numbers.
_BYTE_ORDERS = {b"II*\0": "<", b"MM\0*": ">", b"IIRO": "<", b"IIRS": "<", b"MMOR": ">", b"IIU\0": "<"}
_CANON, _FUJIFILM = b"ftypcrx ", b"FUJIFILMCCD-RAW "
#: Identifier of the box with Canon's metadata, and those boxes within it whose tags are read: of picture and exposure.
_CANON_BOX = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
_CANON_TAGS = (b"CMT1", b"CMT2")
#: Where a Fujifilm file states the place of its JPEG, bytes from its beginning.
_FUJIFILM_JPEG = 84
_JPEG, _FILL, _APP1, _SCAN, _EXIF = b"\xff\xd8", b"\xff\xff", 0xFFE1, 0xFFDA, b"Exif\0\0"
#: Most boxes or segments in a row that are looked at; a RAW file has a dozen, and a damaged one may claim more.
_MOST_PARTS = 64
#: Most bytes of a part that are read; tags of a photograph take some kilobytes.
_MOST_BYTES = 1 << 20


def embedded_tiffs(content) -> Iterator[tuple[bytes, str]]:
    """Yield each TIFF in a photograph's file, from its first byte on, and its byte order in the notation of `struct`.

    Parameters
    ----------
    content : bytes or mmap
        The file, which may be damaged. Most formats are a TIFF as a whole; nothing of them is copied. CR3 files are ISO
        base media files (ISO/IEC 14496-12) with TIFFs in boxes of Canon's; JPEG has one in its Exif segment, and RAF
        contains a JPEG. Other files yield nothing.
    """
    if order := _BYTE_ORDERS.get(content[:4]):
        yield content, order
        return
    for begin, end in _canon_parts(content) if content[4:12] == _CANON else _jpeg_parts(content):
        part = content[begin : min(end, begin + _MOST_BYTES)]
        if order := _BYTE_ORDERS.get(part[:4]):
            yield part, order


def _canon_parts(content) -> Iterator[tuple[int, int]]:
    for kind, begin, end in _boxes(content, 0, len(content)):
        if kind == b"moov":
            for inner, first, last in _boxes(content, begin, end):
                if inner == b"uuid" and content[first : first + len(_CANON_BOX)] == _CANON_BOX:
                    for name, at, after in _boxes(content, first + len(_CANON_BOX), last):
                        if name in _CANON_TAGS:
                            yield at, after


def _boxes(content, begin: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield kind, first byte and end of the contents of the boxes that stand in a row."""
    return islice(_all_boxes(content, begin, end), _MOST_PARTS)


def _all_boxes(content, begin: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    while begin + 8 <= end:
        size, kind = struct.unpack_from(">I4s", content, begin)
        first = begin + 8
        if size == 1 and first + 8 <= end:  # stated in eight bytes
            size, first = *struct.unpack_from(">Q", content, first), first + 8
        elif size == 0:  # the last one
            size = end - begin
        if size < first - begin:
            return
        yield kind, first, min(begin + size, end)
        begin += size


def _jpeg_parts(content) -> Iterator[tuple[int, int]]:
    """Yield first byte and end of the Exif in a JPEG, or in that of a Fujifilm file."""
    at = 0
    if content[: len(_FUJIFILM)] == _FUJIFILM and len(content) >= _FUJIFILM_JPEG + 4:
        (at,) = struct.unpack_from(">I", content, _FUJIFILM_JPEG)
    if content[at : at + 2] != _JPEG:
        return
    at += 2
    for _ in range(_MOST_PARTS):
        while content[at : at + 2] == _FILL:  # which may precede any marker
            at += 1
        if at + 4 > len(content):
            return
        marker, size = struct.unpack_from(">HH", content, at)
        if marker == _SCAN or marker >> 8 != _FILL[0] or size < 2:
            return
        if marker == _APP1 and content[at + 4 : at + 4 + len(_EXIF)] == _EXIF:
            yield at + 4 + len(_EXIF), at + 2 + size
        at += 2 + size
