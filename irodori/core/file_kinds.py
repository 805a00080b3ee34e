"""Kinds of files, told by their first bytes: what people give in place of a RAW file."""

_KINDS = (
    (0, b"\xff\xd8\xff", "a JPEG picture, in which the camera already chose white balance, tone curve and sharpening"),
    (0, b"\x89PNG\r\n\x1a\n", "a PNG picture, not what the sensor counted"),
    (4, b"ftypheic", "an HEIC picture, in which the camera already chose white balance and tone curve"),
    (4, b"ftypheix", "an HEIC picture, in which the camera already chose white balance and tone curve"),
    (4, b"ftypavif", "an AVIF picture, not what the sensor counted"),
    (8, b"WEBP", "a WebP picture, not what the sensor counted"),
    (0, b"GIF8", "a GIF picture, not what the sensor counted"),
    (0, b"%PDF", "a PDF document"),
    (0, b"PK\x03\x04", "a ZIP archive, to be unpacked first"),
    (0, b"version https://git-lfs", "a pointer of Git LFS to a file that was not fetched"),
)


def kind_instead_of_raw(path) -> str:
    """Return what a file is that is surely no RAW file, empty where its first bytes do not tell.

    Parameters
    ----------
    path : path
        A file; one that cannot be read does not tell.
    """
    try:
        with open(path, "rb") as file:
            first = file.read(32)
    except OSError:
        return ""
    return next((kind for start, magic, kind in _KINDS if first[start:].startswith(magic)), "")
