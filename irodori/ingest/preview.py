"""A photograph as it is shown at the rig: a small picture, where it is blown or dark, and its histogram."""

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image

from irodori.colour.tone_curves import SRGB
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.plausibility import CLIPPED, LIT

#: Of the small picture, at most; and of the places of the pattern that the histogram counts.
_WIDTH_PX, _COUNTED = 900, 400_000
_BINS = 64
#: Blown, dark: red and blue, opaque enough to be seen on a phone in a lit room.
_OVERLAY = np.array([[0, 0, 0, 0], [255, 40, 40, 200], [40, 90, 255, 130]], dtype=np.uint8)
_BARS = " ▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class Preview:
    """A photograph made small.

    Parameters
    ----------
    jpeg : bytes
        Part of the range from black to white of each block, as sRGB, in the sensor's frame.
    overlay : bytes
        PNG of the same size: red where a pixel of the block is saturated, blue where nothing of it is lit.
    histogram : (3, 64) float
        Red, green, blue: share of the pixels in equal parts of the range from black to white; what is outside is in the
        first and the last one.
    """

    jpeg: bytes
    overlay: bytes
    histogram: np.ndarray

    def sketch(self) -> str:
        """Return the histogram for a terminal, a line for each colour; roots of shares, so that few pixels show."""
        heights = np.sqrt(self.histogram.reshape(3, _BINS // 2, 2).sum(axis=2))
        steps = np.ceil(heights / max(float(heights.max()), 1e-9) * (len(_BARS) - 1)).astype(int)
        return "\n".join(f"{name} |{''.join(_BARS[s] for s in row)}|" for name, row in zip("RGB", steps, strict=True))


def preview_of(mosaic: Mosaic) -> Preview:
    """Return a decoded photograph made small."""
    side = max(1, -(-(mosaic.size[0] // 2) // _WIDTH_PX))
    rows, columns = mosaic.size[1] // 2 // side, mosaic.size[0] // 2 // side
    picture, share = np.zeros((rows, columns, 3), dtype=np.float32), np.zeros(3)
    blown, lit = np.zeros((rows, columns), dtype=bool), np.zeros((rows, columns), dtype=bool)
    histogram = np.zeros((3, _BINS))
    thinned = max(1, rows * columns * side * side // _COUNTED)
    for row, column, band in mosaic.places():
        black, white = float(mosaic.black[row, column]), float(mosaic.white[row, column])
        values = np.ascontiguousarray(mosaic.values[row::2, column::2][: rows * side, : columns * side])
        blocks = values.reshape(rows, side, columns, side)
        picture[..., band] += (blocks.mean(axis=(1, 3), dtype=np.float32) - black) / (white - black)
        brightest = blocks.max(axis=3).max(axis=1)
        blown |= brightest >= black + CLIPPED * (white - black)
        lit |= brightest >= black + LIT * (white - black)
        counted = (values[::thinned].astype(np.float32) - black) * (_BINS / (white - black))
        histogram[band] += np.bincount(np.clip(counted, 0, _BINS - 1).astype(np.intp).ravel(), minlength=_BINS)
        share[band] += 1.0
    linear = picture / share.astype(np.float32)
    overlay = _OVERLAY[np.where(blown, 1, np.where(lit, 0, 2))]
    return Preview(
        jpeg=_encoded((255.0 * SRGB.code(np.clip(linear, 0.0, 1.0)) + 0.5).astype(np.uint8), "JPEG", quality=85),
        overlay=_encoded(overlay, "PNG", compress_level=1),
        histogram=histogram / histogram.sum(axis=1, keepdims=True),
    )


def _encoded(values: np.ndarray, kind: str, **how) -> bytes:
    out = io.BytesIO()
    Image.fromarray(values).save(out, kind, **how)
    return out.getvalue()
