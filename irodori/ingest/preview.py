"""Preview of a photograph at the rig: a small picture, an overlay of overexposed and dark areas, and a histogram."""

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image

from irodori.colour.tone_curves import SRGB
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.plausibility import CLIPPED, LIT

#: Largest width of the small picture, and approximate number of lines of superpixels in the histogram.
_WIDTH_PX, _COUNTED_LINES = 900, 150
_BINS = 64
_LEVELS = 4096
_SRGB_OF_LEVEL = (255.0 * SRGB.code(np.linspace(0.0, 1.0, _LEVELS)) + 0.5).astype(np.uint8)
#: Colours of overexposed (red) and dark (blue) areas, opaque enough to be seen on a phone in a lit room.
_OVERLAY = [0, 0, 0, 0, 255, 40, 40, 200, 40, 90, 255, 130]
_BARS = " ▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class Preview:
    """Small version of a photograph.

    Parameters
    ----------
    jpeg : bytes
        Blocks of superpixels in sRGB, in the sensor's orientation; white is the white level.
    overlay : bytes
        PNG of the same size: red for blocks with a saturated pixel, blue for unlit blocks.
    histogram : (3, 64) float
        For red, green, blue: share of the pixels in equal parts of the range from black to white. Values outside count
        in the first or last part.
    extent : (2,) tuple of int
        Columns and rows of superpixels shown, from the first; incomplete blocks at the edge are left out.
    """

    jpeg: bytes
    overlay: bytes
    histogram: np.ndarray
    extent: tuple[int, int]

    def sketch(self) -> str:
        """Return the histogram as text with a line for each colour; heights are square roots, to show small shares."""
        heights = np.sqrt(self.histogram.reshape(3, _BINS // 2, 2).sum(axis=2))
        steps = np.ceil(heights / max(float(heights.max()), 1e-9) * (len(_BARS) - 1)).astype(int)
        return "\n".join(f"{name} |{''.join(_BARS[s] for s in row)}|" for name, row in zip("RGB", steps, strict=True))


def preview_of(mosaic: Mosaic, width_px: int = _WIDTH_PX) -> Preview:
    """Make the preview of a decoded photograph, at most ``width_px`` wide."""
    side = max(1, -(-(mosaic.size[0] // 2) // width_px))
    rows, columns = mosaic.size[1] // 2 // side, mosaic.size[0] // 2 // side
    picture, places = np.zeros((rows, columns, 3), dtype=np.float32), np.zeros(3, dtype=np.float32)
    blown, lit = np.zeros((rows, columns), dtype=bool), np.zeros((rows, columns), dtype=bool)
    histogram = np.zeros((3, _BINS))
    thinned = max(1, rows * side // _COUNTED_LINES)
    for row, column, band in mosaic.places():
        black, white = float(mosaic.black[row, column]), float(mosaic.white[row, column])
        values = mosaic.values[row::2, column::2][: rows * side, : columns * side]
        total, brightest = np.zeros((rows, columns), dtype=np.uint32), np.zeros((rows, columns), dtype=np.uint16)
        # Loop over the places within a block: reductions over short axes would take five times as long.
        for at in np.ndindex(side, side):
            part = values[at[0] :: side, at[1] :: side]
            total += part
            np.maximum(brightest, part, out=brightest)
        picture[..., band] += (total / np.float32(side * side) - black) / np.float32(white - black)
        blown |= brightest >= black + CLIPPED * (white - black)
        lit |= brightest >= black + LIT * (white - black)
        counted = (values[::thinned].astype(np.float32) - black) * (_BINS / (white - black))
        histogram[band] += np.bincount(np.clip(counted, 0, _BINS - 1).astype(np.intp).ravel(), minlength=_BINS)
        places[band] += 1.0
    overlay = Image.fromarray(np.where(blown, np.uint8(1), np.where(lit, np.uint8(0), np.uint8(2))), "P")
    overlay.putpalette(_OVERLAY, "RGBA")
    codes = np.clip(picture / places * (_LEVELS - 1) + 0.5, 0, _LEVELS - 1).astype(np.intp)
    return Preview(
        jpeg=_encoded(Image.fromarray(_SRGB_OF_LEVEL[codes]), "JPEG", quality=85),
        overlay=_encoded(overlay, "PNG", compress_level=1),
        histogram=histogram / histogram.sum(axis=1, keepdims=True),
        extent=(columns * side, rows * side),
    )


def _encoded(picture: Image.Image, kind: str, **how) -> bytes:
    out = io.BytesIO()
    picture.save(out, kind, **how)
    return out.getvalue()
