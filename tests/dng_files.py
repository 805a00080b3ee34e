"""DNG files with any pattern, black level, orientation and settings, for tests of decoding."""

import struct
from fractions import Fraction

import tifffile

_MATRIX = tuple(
    part for v in (0.80, -0.27, -0.07, -0.45, 1.25, 0.21, -0.08, 0.19, 0.62) for part in (round(v * 1e4), 10_000)
)
_CODES = {"R": 0, "G": 1, "B": 2}


def _rational(value):
    fraction = Fraction(value).limit_denominator(10_000)
    return fraction.numerator, fraction.denominator


def write_any_dng(path, mosaic, *, pattern="RGGB", black=600, white=16383, exposure_s=0.02, iso=0, f_number=0.0,
                  focal_mm=0.0, orientation=1):  # fmt: skip
    """Write a mosaic with tags that `irodori.simulation.virtual_rig.dng_writer` does not need.

    ``black`` is a number or a (rows, columns) array that repeats; ISO stands in an EXIF block, as cameras write it.
    """
    tags = [
        (271, "s", 0, "Irodori", True), (272, "s", 0, "test", True), (274, "H", 1, orientation, True),
        (33421, "H", 2, (2, 2), True), (33422, "B", 4, tuple(_CODES[letter] for letter in pattern), True),
        (33434, "2I", 1, _rational(exposure_s), True), (50706, "B", 4, (1, 4, 0, 0), True),
        (50707, "B", 4, (1, 1, 0, 0), True), (50708, "s", 0, "Irodori test", True),
        (50717, "I", 1, white, True), (50721, "2i", 9, _MATRIX, True), (50728, "2I", 3, (1, 1) * 3, True),
        (50778, "H", 1, 17, True),
    ]  # fmt: skip
    if f_number:
        tags.append((33437, "2I", 1, _rational(f_number), True))
    if focal_mm:
        tags.append((37386, "2I", 1, _rational(focal_mm), True))
    if isinstance(black, int):
        tags.append((50714, "H", 1, black, True))
    else:
        tags += [(50713, "H", 2, black.shape, True), (50714, "H", black.size, tuple(map(int, black.ravel())), True)]
    if iso:
        tags.append((34666, "I", 1, 0, True))  # becomes the EXIF block's, which tifffile does not write
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=sorted(tags), metadata=None, subfiletype=0)
    if iso:
        content = path.read_bytes()
        content += b"\0" * (len(content) % 2)
        block = struct.pack("<HHHII", 1, 34855, 3, 1, iso) + struct.pack("<I", 0)
        placeholder = struct.pack("<HHII", 34666, 4, 1, 0)
        assert content.count(placeholder) == 1
        path.write_bytes(content.replace(placeholder, struct.pack("<HHII", 34665, 4, 1, len(content))) + block)
    return path
