"""A camera's RAW file decoded by LibRaw into superpixels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rawpy

from irodori.errors import InputError


@dataclass(frozen=True)
class Mosaic:
    """A decoded RAW file.

    Parameters
    ----------
    superpixels : (height, width, 3) float32
        Digital numbers above black.
    largest : (height, width) float32
        Largest digital number of the superpixel as a fraction of the range from black to white.
    full_scale : float
        White minus black, digital numbers.
    exposure_s : float
        The file's own exposure time, s; 0 where it has none.
    """

    superpixels: np.ndarray
    largest: np.ndarray
    full_scale: float
    exposure_s: float


def decode(path) -> Mosaic:
    """Decode a RAW file with LibRaw into 2 x 2 superpixels.

    Raises
    ------
    InputError
        If the file is missing, truncated, unknown to LibRaw, or not a 2 x 2 red-green-blue mosaic.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file", "a RAW file that LibRaw reads")
    try:
        with rawpy.imread(str(path)) as raw:
            visible = raw.raw_image_visible.astype(np.float32)
            colours = raw.raw_colors_visible[:2, :2].copy()
            names = raw.color_desc.decode()
            black = np.asarray(raw.black_level_per_channel, dtype=np.float32)
            white, exposure_s = float(raw.white_level), float(raw.other.shutter_speed)
            repeats = np.array_equal(raw.raw_colors_visible[2:4, 2:4], colours)
    except (rawpy.LibRawError, AttributeError, TypeError, ValueError) as error:
        reason = f"a file LibRaw cannot decode ({str(error) or type(error).__name__})"
        raise InputError(path, "", reason, "a whole RAW file that LibRaw reads") from None
    letters = [names[c] for c in colours.ravel()]
    if not repeats or sorted(letters) != ["B", "G", "G", "R"]:
        raise InputError(path, "mosaic", "".join(letters), "a 2 x 2 pattern of one red, two greens and one blue")
    height, width = visible.shape[0] // 2 * 2, visible.shape[1] // 2 * 2
    planes = [visible[r:height:2, c:width:2] - black[colours[r, c]] for r in (0, 1) for c in (0, 1)]
    red, blue = planes[letters.index("R")], planes[letters.index("B")]
    greens = [plane for plane, letter in zip(planes, letters, strict=True) if letter == "G"]
    full_scale = white - float(black.max())
    largest = np.maximum(np.maximum(planes[0], planes[1]), np.maximum(planes[2], planes[3])) / full_scale
    superpixels = np.stack([red, 0.5 * (greens[0] + greens[1]), blue], axis=-1)
    return Mosaic(superpixels, largest, full_scale, exposure_s)
