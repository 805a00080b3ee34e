"""Decoding of RAW files by LibRaw, and of linear pictures, to digital numbers on the sensor and to superpixels.

The orientation tag is ignored: in a camera that looks down, the level sensor sets it at random, and a picture that is
rotated between two shots of one pose would match neither the other shot nor the camera's optics.
"""

import contextlib
import math
import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import rawpy

from irodori.core.errors import InputError
from irodori.core.file_kinds import kind_instead_of_raw
from irodori.ingest.dng_levels import black_level_repeats

#: Demosaicing algorithms of LibRaw by their names in the configuration; ``superpixel`` is our own, without
#: interpolation.
ALGORITHMS = {
    "linear": rawpy.DemosaicAlgorithm.LINEAR,
    "vng": rawpy.DemosaicAlgorithm.VNG,
    "ppg": rawpy.DemosaicAlgorithm.PPG,
    "ahd": rawpy.DemosaicAlgorithm.AHD,
    "dcb": rawpy.DemosaicAlgorithm.DCB,
    "dht": rawpy.DemosaicAlgorithm.DHT,
}
#: Locks for algorithms of LibRaw that use a global variable: two threads running one of them would corrupt each other's
#: picture, or crash.
_ONE_AT_A_TIME = {"vng": threading.Lock()}
BAND_LETTERS = "RGB"
#: Where a CRW file, a "camera image file format", says that it is one.
_CIFF = slice(6, 14)
_WHOLE = "a whole RAW file that LibRaw reads"
_PATTERN_SIDE = 6  # of the X-Trans pattern, the largest that LibRaw knows
#: A plateau at the top of the numbers: the fewest samples of one colour with the largest number; their least ratio to
#: those with any of so many next smaller numbers; and the fewest steps above black. With that many, noise spreads an
#: honest maximum over several numbers: at a signal-to-noise ratio of 300, its standard deviation is 1.7 steps.
_PLATEAU, _ABOVE_NEXT, _NEXT, _FINE = 16, 8, 8, 512


@dataclass(frozen=True)
class Mosaic:
    """A decoded RAW file.

    Parameters
    ----------
    values : (height, width) uint16
        Digital numbers of the visible area as stored in the file, in the sensor's orientation; both sides are even.
    pattern : str
        Colours of the first 2 x 2 pixels row by row, such as ``RGGB``.
    black, white : (2, 2) float32
        Digital numbers without light, and at saturation, at the four places of the pattern. Saturation is where the
        numbers end in a plateau, if they do so below the white level of the file.
    full_scale : float
        White level of the file minus its largest black level, digital numbers.
    exposure_s, iso, f_number : float
        Exposure time in s, sensitivity (ISO 12232) and relative aperture stated in the file; 0 if it does not state
        them.
    orientation : int
        Orientation of the file in LibRaw's code (0 none, 3 half a turn, 5 a quarter counter-clockwise, 6 clockwise).
    focal_mm : float
        Focal length of the lens stated in the file, mm; 0 if it does not state it.
    linear : bool
        Whether the data come from a linear picture with three bands instead of a mosaic: each block of 2 x 2 pixels is
        one pixel of the picture, with green twice, see `irodori.ingest.linear_pictures`.
    early_clipping : str
        Warning about saturation below the white level of the file; empty if there is none.
    time : str
        Time of the camera's clock as LibRaw reads it, ISO 8601, whole seconds; empty if the file states none. In a file
        with TIFF tags it may be that of a later change of the file.
    """

    values: np.ndarray
    pattern: str
    black: np.ndarray
    white: np.ndarray
    full_scale: float
    exposure_s: float
    iso: float
    f_number: float
    orientation: int
    focal_mm: float = 0.0
    linear: bool = False
    early_clipping: str = ""
    time: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, mosaic pixels."""
        return self.values.shape[1], self.values.shape[0]

    def places(self) -> list[tuple[int, int, int]]:
        """Return (row, column, band) of the four places of the pattern; band 0 is red, 1 green, 2 blue."""
        return [(at // 2, at % 2, BAND_LETTERS.index(letter)) for at, letter in enumerate(self.pattern)]

    @property
    def superpixels(self) -> np.ndarray:
        """Superpixels (red, mean of the greens, blue), (height / 2, width / 2, 3) float32, DN above black."""
        height, width = self.values.shape
        out = np.zeros((height // 2, width // 2, 3), dtype=np.float32)
        for row, column, band in self.places():
            share = np.float32(0.5 if band == 1 else 1.0)
            out[..., band] += share * (self.values[row::2, column::2] - self.black[row, column])
        return out

    @property
    def largest(self) -> np.ndarray:
        """Largest value in each superpixel, as a fraction of the range from black to white, (height / 2, width / 2)."""
        level = [
            (self.values[r::2, c::2] - self.black[r, c]) / (self.white[r, c] - self.black[r, c])
            for r, c, _ in self.places()
        ]
        return np.maximum(np.maximum(level[0], level[1]), np.maximum(level[2], level[3]))


def decode(path, linear: bool = False) -> Mosaic:
    """Decode a RAW file with LibRaw, or a linear TIFF or PNG picture.

    Parameters
    ----------
    path : path
        A file in any format that LibRaw reads, with any order of the red-green-blue mosaic.
    linear : bool
        Whether it is declared to be a TIFF or PNG picture with numbers proportional to the light.

    Raises
    ------
    InputError
        If the file is missing, truncated, unknown to LibRaw, or not a 2 x 2 red-green-blue mosaic; with ``linear``, if
        it is not a TIFF or PNG picture, or shows a tone curve, see `irodori.ingest.linear_pictures`.
    """
    if linear:
        # OpenImageIO takes long to import, and RAW files never need it.
        from irodori.ingest.linear_pictures import read_picture

        return Mosaic(**read_picture(path), linear=True)
    return _read(path, lambda raw, mosaic: mosaic)


def demosaic(
    path, algorithm: str, offset: np.ndarray | None = None, pedestal: int = 0, masked_px: np.ndarray | None = None
) -> np.ndarray:
    """Demosaic a RAW file to full resolution with LibRaw; the result stays proportional to the light.

    There is no subtraction of or clipping at the black level, and no white balance, colour conversion, tone curve,
    automatic brightness or rotation.

    Parameters
    ----------
    path : path
    algorithm : str
        A key of ALGORITHMS.
    offset : (height, width) int, optional
        Digital numbers that are first subtracted from the mosaic: black level and dark frame.
    pedestal : int
        Digital number that is then added, so that noise below `offset` is kept.
    masked_px : (n, 2) int, optional
        Row and column of unreliable pixels. They are replaced by the median of their neighbours of the same colour, so
        that their values do not spread; the caller has to mask the pixels that they affect.

    Returns
    -------
    (height, width, 3) uint16
        Digital numbers; both sides are even.

    Raises
    ------
    ValueError
        For an unknown algorithm.
    InputError
        As `decode`.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(f"unknown demosaicing {algorithm!r}; accepted: {', '.join(ALGORITHMS)}")

    def interpolate(raw, mosaic: Mosaic) -> np.ndarray:
        height, width = mosaic.values.shape
        if offset is not None:
            shifted = mosaic.values.astype(np.int32) - offset + pedestal
            raw.raw_image_visible[:height, :width] = np.clip(shifted, 0, 65535)
        if masked_px is not None and len(masked_px):
            _replace_masked(raw.raw_image_visible[:height, :width], masked_px)
        with _ONE_AT_A_TIME.get(algorithm, contextlib.nullcontext()):
            picture = raw.postprocess(
                demosaic_algorithm=ALGORITHMS[algorithm],
                user_black=0,
                user_cblack=[0, 0, 0, 0],
                user_sat=65535,
                no_auto_scale=True,
                no_auto_bright=True,
                adjust_maximum_thr=0.0,
                user_wb=[1.0, 1.0, 1.0, 1.0],
                output_color=rawpy.ColorSpace.raw,
                output_bps=16,
                gamma=(1, 1),
                user_flip=0,
            )
        return picture[:height, :width]

    return _read(path, interpolate)


def _replace_masked(values: np.ndarray, masked_px: np.ndarray) -> None:
    """Set pixels to the median of the eight nearest pixels at even distances, mirrored at the edges of the picture."""
    height, width = values.shape
    steps = [(dy, dx) for dy in (-2, 0, 2) for dx in (-2, 0, 2) if (dy, dx) != (0, 0)]
    rows, columns = masked_px[:, 0], masked_px[:, 1]
    near = []
    for dy, dx in steps:
        r, c = rows + dy, columns + dx
        r, c = np.where((r < 0) | (r >= height), rows - dy, r), np.where((c < 0) | (c >= width), columns - dx, c)
        near.append(values[r, c])
    values[rows, columns] = np.median(near, axis=0)


def _read(path, use):
    """Open a RAW file with LibRaw, and return the result of ``use(file, mosaic)``."""
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file", "a RAW file that LibRaw reads")
    try:
        with rawpy.imread(str(path)) as raw:
            if raw.raw_type != rawpy.RawType.Flat:
                raise InputError(path, "mosaic", "several values at each pixel", "a 2 x 2 mosaic of one colour a pixel")
            return use(raw, _mosaic(path, raw))
    except InputError:
        raise
    except (rawpy.LibRawError, AttributeError, TypeError, ValueError) as error:
        said = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        unknown = f"a file LibRaw cannot decode ({said or type(error).__name__})"
        reason = kind_instead_of_raw(path) or unknown
        raise InputError(path, "", reason, _WHOLE) from None


def _mosaic(path: Path, raw) -> Mosaic:
    height, width = (side // 2 * 2 for side in raw.raw_image_visible.shape)
    pattern, colours = _pattern(path, raw)
    _check_black_repeat(path)
    white_level = float(raw.white_level)
    black = np.asarray(raw.black_level_per_channel, dtype=np.float32)[colours]
    stated = raw.camera_white_level_per_channel
    white = np.full(4, white_level, dtype=np.float32) if stated is None else np.asarray(stated, dtype=np.float32)
    # Some makers leave the white level of a channel empty, or state one that the data never reach.
    white = np.where((white > black.max()) & (white <= white_level), white, np.float32(white_level))[colours]
    if height < 2 or width < 2 or not (white > black).all():
        found = f"{width} x {height} pixels, black {black.max():g}, white {white_level:g}"
        raise InputError(path, "levels", found, _WHOLE)
    values = np.array(raw.raw_image_visible[:height, :width], order="C")
    saturated = _saturation(values, black, white)
    other = raw.other
    return Mosaic(
        values=values,
        pattern=pattern,
        black=black,
        white=saturated,
        # That of the file also here: photographs of a set have it in common, whether or not they saturate.
        full_scale=white_level - float(black.max()),
        exposure_s=_stated(other.shutter_speed),
        iso=_stated(other.iso_speed),
        f_number=_stated(other.aperture),
        orientation=int(raw.sizes.flip),
        focal_mm=_stated(other.focal_length),
        early_clipping=_early_clipping(values, white, saturated),
        time=_clock(path, other.timestamp),
    )


def _saturation(values: np.ndarray, black: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Return the numbers at saturation, (2, 2) float32: those of a plateau, or the stated ones where there is none."""
    places = [values[row::2, column::2] for row, column in np.ndindex(2, 2)]
    tops = np.array([int(samples.max()) for samples in places]).reshape(2, 2)
    plateaus = [
        top
        for samples, top, dark, stated in zip(places, tops.ravel(), black.ravel(), white.ravel(), strict=True)
        if dark + _FINE <= top < stated and _ends_in_plateau(samples, top, float(dark))
    ]
    # A small highlight may saturate only few pixels of one of the colours.
    return np.where(np.isin(tops, plateaus) & (tops < white), tops, white).astype(np.float32)


def _ends_in_plateau(samples: np.ndarray, top: int, dark: float) -> bool:
    """Return whether the largest number occurs as often as no honest maximum does.

    A picture of a single number, which no sensor makes, tells nothing.
    """
    # Most photographs end here: their largest number occurs once or twice.
    if np.count_nonzero(samples == top) < _PLATEAU:
        return False
    counts = np.bincount(samples.ravel())
    occurring = np.flatnonzero(counts)
    if len(occurring) < 2:
        return False
    step, highest = np.diff(occurring).min(), counts[occurring[-1 - _NEXT : -1]].max()
    return bool(top - dark >= _FINE * step and counts[top] >= _ABOVE_NEXT * highest)


def _early_clipping(values: np.ndarray, stated: np.ndarray, found: np.ndarray) -> str:
    """Return a warning about saturation below the stated white level; empty if there is none."""
    early = found < stated
    if not early.any():
        return ""
    count = sum(np.count_nonzero(values[r::2, c::2] == found[r, c]) for r, c in np.argwhere(early))
    return (
        f"white level: {count} pixels have exactly {found[early].min():g}, the largest number of their colour, and "
        f"hardly any come near it, but the file states {stated[early].max():g}: they are taken as saturated"
    )


def _pattern(path: Path, raw) -> tuple[str, np.ndarray]:
    """Return the letters of the mosaic pattern, such as ``RGGB``, and LibRaw's colour indices at its places, (2, 2)."""
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    side = range(_PATTERN_SIDE)
    seen = np.array([[raw.raw_color(top + row, left + column) for column in side] for row in side])
    names = raw.color_desc.decode()
    letters = "".join(names[c] if c < len(names) else "?" for c in seen[:2, :2].ravel())
    repeats = np.array_equal(seen, np.tile(seen[:2, :2], (_PATTERN_SIDE // 2, _PATTERN_SIDE // 2)))
    if not repeats or sorted(letters) != ["B", "G", "G", "R"]:
        found = letters if repeats else "a pattern that does not repeat every 2 pixels"
        raise InputError(path, "mosaic", found, "a 2 x 2 pattern of one red, two greens and one blue")
    return letters, seen[:2, :2]


def _check_black_repeat(path: Path) -> None:
    """Raise `InputError` for a DNG with black levels that repeat over more than 2 x 2 pixels, unsupported by LibRaw."""
    if path.suffix.lower() != ".dng":
        return
    for rows, columns in black_level_repeats(path):
        if max(rows, columns) > 2:
            found = f"a black level that repeats every {rows} x {columns} pixels"
            raise InputError(path, "BlackLevelRepeatDim", found, "a repeat of at most 2 x 2 pixels")


def _clock(path: Path, read: datetime) -> str:
    """Return the time of the camera's clock from what LibRaw read, ISO 8601; empty if the file states none."""
    if read.timestamp() <= 0.0:  # LibRaw's number for none: the beginning of 1970 in Greenwich
        return ""
    with open(path, "rb") as file:
        counts_seconds = file.read(_CIFF.stop)[_CIFF.start :] == b"HEAPCCDR"
    # CRW files count the seconds of the camera's own clock, which rawpy takes for those of Greenwich and shifts to the
    # zone of this computer. What other formats spell out, LibRaw takes for a time in this zone, and nothing is shifted.
    return (read.astimezone(UTC).replace(tzinfo=None) if counts_seconds else read).isoformat()


def _stated(value: float) -> float:
    """Return a value stated in a file; 0 if it is not a positive finite number."""
    return float(value) if math.isfinite(value) and value > 0 else 0.0
