"""Recognition of file types by their first bytes, to name what a user supplied in place of a RAW file."""

from pathlib import Path

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

_PICTURES = {".png": (b"\x89PNG\r\n\x1a\n",), ".tif": (b"II*\0", b"MM\0*"), ".tiff": (b"II*\0", b"MM\0*")}
IF_LINEAR = "if you know that its numbers go with the light, without a tone curve"


def is_picture(path) -> bool:
    """Whether a file is a TIFF or PNG picture, by its suffix and its first bytes; many RAW files begin like a TIFF.

    Parameters
    ----------
    path : path
        A file; False if it cannot be read.
    """
    return _first_bytes(path).startswith(_PICTURES.get(Path(path).suffix.lower(), (b"no such file",)))


def _first_bytes(path) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read(32)
    except OSError:
        return b""


def kind_instead_of_raw(path) -> str:
    """Return a phrase that names the type of a file that is certainly not RAW; empty if the first bytes do not decide.

    Parameters
    ----------
    path : path
        A file; the phrase is empty if it cannot be read.
    """
    first = _first_bytes(path)
    return next((kind for start, magic, kind in _KINDS if first[start:].startswith(magic)), "")
