"""Picture files through OpenImageIO: spectral EXR, XYZ EXR, and PNG and TIFF with an ICC profile."""

import atexit
import gc
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.export.loss import LOSS, stored_loss
from irodori.export.radiance_header import radiance_header
from irodori.jit.half_precision import half_from_single
from irodori.material.coefficients import require_storage
from irodori.spectra.grid import WAVELENGTH_NM

# OpenImageIO tells at the end of a process, on the terminal, of each of its objects that the garbage collector has not
# taken apart; it would not look at those that have been set aside for it, as `irodori.core.run_rule` does.
atexit.register(gc.unfreeze)


def layer_names(kind: str) -> list[str]:
    """Return the names of the 61 layers of a spectral EXR, such as ``S0.400,000000nm``.

    The kind is ``S0`` for emission or ``T`` for reflectance.
    """
    return [f"{kind}." + f"{wavelength:.6f}nm".replace(".", ",") for wavelength in WAVELENGTH_NM]


def specification(size: tuple[int, int], names: list[str], attributes: dict, kind: str = "float") -> oiio.ImageSpec:
    """Make the image specification for OpenImageIO from (height, width), channel names, attributes and data type."""
    height, width = size
    spec = oiio.ImageSpec(width, height, len(names), kind)
    spec.channelnames = tuple(names)
    for name, value in attributes.items():
        spec.attribute(name, value)
    return spec


def write_picture_file(path, spec: oiio.ImageSpec, bands: Iterable[np.ndarray]) -> None:
    """Write a picture; the file appears only when it is complete.

    Parameters
    ----------
    path : path
        Its suffix determines the format.
    spec : ImageSpec
    bands : iterable of (rows, width, channels)
        Consecutive groups of rows from the top, with the data type of ``spec``.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise OSError(f"{path}: {oiio.geterror()}")
    with written_whole(path) as temporary:
        done, first = output.open(str(temporary), spec), 0
        for rows in bands:
            done = done and output.write_scanlines(first, first + len(rows), 0, np.ascontiguousarray(rows))
            first += len(rows)
        if not (done and output.close()):
            raise OSError(f"{path}: {output.geterror()}")


def write_spectral_exr(
    path,
    radiance: np.ndarray,
    rgb: np.ndarray,
    attributes: dict[str, str],
    *,
    storage: str = "half",
    white: np.ndarray | None = None,
) -> None:
    """Write a spectral radiance image (Fichet et al. 2021, *An OpenEXR Layout for Spectral Images*).

    Half precision rounds to one part in 2048 between 6e-5 and 65504. If the largest radiance is above 65504 or below 1,
    the spectra are multiplied by a power of two, which brings the largest to between 16384 and 32768 and is stored as
    the attribute ``irodori:scale``; `picture_bands` divides by it again. If more than half of the positive numbers
    would still be below 6e-5, the picture is written in single precision. Red, green and blue are never scaled.

    Parameters
    ----------
    radiance : (height, width, 61) float32, relative radiance
    rgb : (height, width, 3) float
        Linear sRGB for viewers that cannot show spectra.
    attributes : dict of str
        Further text attributes.
    storage : str
        ``half`` or ``single``.
    white : (61,) float, optional
        Radiance of the scene's white. If given, the attribute ``irodori:loss`` states the colour differences between
        the stored numbers and ``radiance``.

    Raises
    ------
    ValueError
        For an unknown storage.
    """
    require_storage(storage)
    names = ["R", "G", "B", *layer_names("S0")]
    own = {"compression": "zip", "spectralLayoutVersion": "1.0", "emissiveUnits": "relative spectral radiance"}
    pixels = np.concatenate([rgb, radiance], axis=-1).astype(np.float32, copy=False)
    scale = _half_scale(radiance) if storage == "half" else None
    if scale is not None:
        if scale != 1.0:
            own[_SCALE] = f"{scale:.17g}"
            pixels[..., 3:] *= np.float32(scale)
        # What is not finite stays so.
        np.clip(pixels[..., :3], -_HALF_LARGEST, _HALF_LARGEST, out=pixels[..., :3], where=np.isfinite(pixels[..., :3]))
        pixels = half_from_single(pixels)
    if white is not None:
        matrix, divisor = xyz_from_radiance(white), np.float32(scale or 1.0)

        def stored(part: slice) -> np.ndarray:
            return pixels[part, :, 3:].astype(np.float32) / divisor

        own[LOSS] = stored_loss(matrix, matrix @ white, radiance.__getitem__, stored, len(radiance)).text
    kind = "float" if scale is None else "half"
    write_picture_file(path, specification(radiance.shape[:2], names, own | attributes, kind), [pixels])


#: Text attribute of a picture: the power of two by which its spectra were multiplied.
_SCALE = "irodori:scale"
_HALF_LARGEST, _HALF_SMALLEST_NORMAL = 65504.0, 2.0**-14
_HALF_TOP = 15  # after scaling, the largest number of a picture is below 2 to this power
_MOST_DOUBLINGS = 126  # largest exponent of the scale, so that single precision can represent it


def _half_scale(radiance: np.ndarray) -> float | None:
    """Return the power of two that brings spectra into the range of half precision; None if there is none."""
    size = np.abs(radiance)
    largest = float(size.max(initial=0.0, where=np.isfinite(size)))
    if largest == 0.0 or 1.0 <= largest <= _HALF_LARGEST:
        return 1.0
    scale = math.ldexp(1.0, min(_HALF_TOP - math.frexp(largest)[1], _MOST_DOUBLINGS))
    typical = float(np.median(size[(size > 0.0) & np.isfinite(size)]))
    return scale if typical * scale >= _HALF_SMALLEST_NORMAL else None


_LAYER = re.compile(r"(S0|T)\.(\d*,?\d+(?:[eE][+-]?\d+)?)(Y|Z|E|P|T|G|M|k|h|da|d|c|m|u|n|p)?(m|Hz)")
_PREFIX = {"Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1, "": 0, "d": -1,
           "c": -2, "m": -3, "u": -6, "n": -9, "p": -12}  # fmt: skip
_LIGHT_NM_PER_S = 299_792_458e9
#: Largest plausible ratio of decoded to stored size: PIZ packs 32 black rows of 8192 pixels into some 50 bytes.
_MOST_UNFOLDED = 1 << 16
#: Longest quotation of a message from OpenImageIO, in characters; it repeats its message for every channel.
_LONGEST_REASON = 200
#: Number of chromaticity coordinates: x, y of red, green, blue and white.
_PRIMARIES = 8
#: OpenImageIO's name of the format Radiance HDR.
_RADIANCE = "hdr"
#: Orientations of TIFF and Exif: whether rows are stored from below, and columns from the right.
_MIRRORED = {1: (False, False), 2: (False, True), 3: (True, True), 4: (True, False)}
#: Largest width or height, in pixels.
_LONGEST_SIDE = 1 << 17
_EMISSION = "S0"  # kind of a layer of radiance in the published spectral layout
#: Rows whose spectra are converted together.
_ROWS = 32
#: Largest amount of data, decoded, that is read at once: a group of rows, or whole rows of tiles.
_MOST_TOGETHER_BYTES = 1 << 31


def _wavelength_nm(name: str) -> float | None:
    """Return the wavelength in nm from the name of a layer of emission; None for other kinds."""
    match = _LAYER.fullmatch(name)
    if match is None or match[1] != _EMISSION:
        return None
    value = float(match[2].replace(",", ".")) * 10.0 ** _PREFIX[match[3] or ""]
    if not 0.0 < value < math.inf:
        return None
    return round(value * 1e9 if match[4] == "m" else _LIGHT_NM_PER_S / value, 6)


def _open(path, accepted: str) -> oiio.ImageInput:
    """Open a picture file; raise `InputError` if its header is unreadable or declares implausibly much data."""
    try:
        source = oiio.ImageInput.open(str(path))
        reason = "" if source is not None else " ".join(oiio.geterror().split())[:_LONGEST_REASON]
        names = [] if source is None else list(source.spec().channelnames)
        "".join(names).encode()  # OpenImageIO turns some invalid bytes into surrogates, which cannot be encoded
    except UnicodeError:
        raise InputError(path, "", "a header whose text is not UTF-8", accepted) from None
    if source is None:
        raise InputError(path, "", f"a file OpenImageIO cannot open ({reason})", accepted)
    spec = source.spec()
    pixels, row = spec.width * spec.height, spec.width * spec.nchannels * np.dtype(np.float32).itemsize
    held = Path(path).stat().st_size
    if not names or not (0 < spec.width <= _LONGEST_SIDE and 0 < spec.height <= _LONGEST_SIDE):
        source.close()
        found = f"a header of {spec.width} x {spec.height} pixels and {spec.nchannels} channels"
        raise InputError(path, "", found, f"a picture of 1 to {_LONGEST_SIDE} pixels a side")
    together = max(spec.tile_height, 1)
    if pixels * spec.pixel_bytes() > _MOST_UNFOLDED * held or row * together > _MOST_TOGETHER_BYTES:
        source.close()
        found = f"a header of {spec.width} x {spec.height} pixels and {spec.nchannels} channels in {held} bytes"
        raise InputError(path, "", found, "a whole picture, as long as its header says, in tiles of at most 2 GB a row")
    return source


class Header(NamedTuple):
    """Metadata of a picture file."""

    size: tuple[int, int]  # (height, width)
    channels: list[str]
    depth: str  # type of the samples
    shown: tuple[int, int]  # (height, width) of the display window; the file may contain only a part of it
    chromaticities: tuple[float, ...] | None  # x, y of red, green, blue and white, where the file states them
    colour_space: str | None  # name of the colour space, where the file states it; see `_colour_space`
    projection: str | None  # which directions the pixels show, where the file states it; see `_projection`
    profile: bytes | None  # ICC profile, where the file has one


def picture_header(path) -> Header:
    """Read the metadata of a picture file.

    Raises
    ------
    InputError
        If OpenImageIO cannot open the file, its text is not UTF-8, it declares more data than it can contain, its
        chromaticities or its exposure are malformed, or its columns are stored as rows.
    """
    source = _open(path, "an HDR or EXR picture")
    spec, is_radiance = source.spec(), source.format_name() == _RADIANCE
    source.close()
    _mirrored(spec, path)  # refuses before reading
    shown = (spec.full_height, spec.full_width)
    chromaticities = radiance_header(path).primaries if is_radiance else spec.getattribute("chromaticities")
    if chromaticities is not None and (not isinstance(chromaticities, tuple) or len(chromaticities) != _PRIMARIES):
        found = "something else than eight numbers"
        raise InputError(path, "chromaticities", found, "x and y of red, green, blue and white")
    size, names = (spec.height, spec.width), list(spec.channelnames)
    profile = spec.getattribute("ICCProfile")
    profile = None if profile is None else np.asarray(profile, dtype=np.uint8).tobytes()
    return Header(size, names, str(spec.format), shown, chromaticities, _colour_space(spec), _projection(spec), profile)


def _projection(spec: oiio.ImageSpec) -> str | None:
    """Return the projection that a file states, such as ``LatLong Environment``; None if it states none.

    OpenImageIO reports the attribute ``envmap`` of an EXR and the tag ``PixarTextureFormat`` of a TIFF as
    ``textureformat``; programs that stitch photographs write ``GPano:ProjectionType``.
    """
    stated = spec.getattribute("textureformat") or spec.getattribute("GPano:ProjectionType")
    return None if stated is None else str(stated)


def _colour_space(spec: oiio.ImageSpec) -> str | None:
    """Return the name of the colour space that a file states, one of the Color Interop Forum's; None if it states none.

    OpenImageIO reports the attribute ``colorInteropID`` of an EXR as ``oiio:ColorSpace``, and derives a name from the
    line ``GAMMA`` of a Radiance HDR.
    """
    stated = spec.getattribute("colorInteropID") or spec.getattribute("oiio:ColorSpace")
    return None if stated is None else str(stated)


def _mirrored(spec: oiio.ImageSpec, path) -> tuple[bool, bool]:
    """Return whether the rows of a picture are stored from below, and its columns from the right.

    Raises
    ------
    InputError
        If columns are stored as rows.
    """
    stated = spec.getattribute("Orientation")
    if stated is None:
        return False, False
    if stated not in _MIRRORED:
        accepted = f"rows that are stored as rows: {', '.join(map(str, _MIRRORED))}"
        raise InputError(path, "Orientation", str(stated), accepted)
    return _MIRRORED[stated]


def stored_samples(path, accepted: str) -> tuple[np.ndarray, dict[str, object]]:
    """Read the numbers of a picture as they are stored, (height, width, channels), and its attributes by name.

    Parameters
    ----------
    path : path
    accepted : str
        Description of acceptable files, for the error message.

    Raises
    ------
    InputError
        If OpenImageIO cannot open the file, or the file is truncated.
    """
    source = _open(path, accepted)
    spec = source.spec()
    samples = source.read_image(spec.format)
    source.close()
    if samples is None:
        raise InputError(path, "", "a picture that ends early", accepted)
    return samples, {attribute.name: attribute.value for attribute in spec.extra_attribs}


def picture_bands(path, rows: int) -> Iterator[tuple[int, np.ndarray]]:
    """Read a picture file in groups of rows from the top; yield each with the index of its first row.

    The picture is mirrored as the file states (``Orientation``), its spectra are divided by ``irodori:scale``, and the
    values of a Radiance HDR by its exposure.

    Parameters
    ----------
    path : path
    rows : int
        Largest number of rows in a group. A tiled file is read in whole rows of tiles, which are then divided.

    Yields
    ------
    first : int
    pixels : (rows, width, channels) float32

    Raises
    ------
    InputError
        If the file cannot be opened or is truncated, its ``irodori:scale`` is not a power of two, or for an orientation
        or exposure that `picture_header` refuses.
    """
    source = _open(path, "an HDR or EXR picture")
    try:
        spec = source.spec()
        together = spec.tile_height or rows
        divisor, (from_below, from_right) = _divisor(source, path), _mirrored(spec, path)
        starts = range(0, spec.height, together)
        for first in reversed(starts) if from_below else starts:
            band = _stored_rows(source, first, min(first + together, spec.height), path)
            if divisor is not None:
                with np.errstate(over="ignore"):
                    band = band / divisor
            if from_below:
                first, band = spec.height - first - len(band), band[::-1]
            if from_right:
                band = band[:, ::-1]
            for start in range(0, len(band), rows):
                yield first + start, band[start : start + rows]
    finally:
        source.close()


def _stored_rows(source: oiio.ImageInput, first: int, end: int, path) -> np.ndarray:
    """Read the rows from ``first`` to before ``end`` as they are stored, (rows, width, channels) float32."""
    spec = source.spec()
    top, bottom = spec.y + first, spec.y + end
    if spec.tile_height:
        right = spec.x + spec.width
        band = source.read_tiles(0, 0, spec.x, right, top, bottom, 0, 1, 0, spec.nchannels, "float")
    else:
        band = source.read_scanlines(0, 0, top, bottom, 0, 0, spec.nchannels, "float")
    if band is None:
        found = f"a picture that ends within rows {first} to {end - 1}"
        raise InputError(path, "", found, f"a whole picture of {spec.height} rows")
    return band.reshape(end - first, spec.width, spec.nchannels)


def _divisor(source: oiio.ImageInput, path) -> np.ndarray | None:
    """Return the number by which each channel was multiplied, (channels,) float32; None if all are 1."""
    spec = source.spec()
    if source.format_name() == _RADIANCE:
        divisor = np.array(radiance_header(path).exposure, np.float32)
    else:
        spectral = list(map(bool, map(_LAYER.fullmatch, spec.channelnames)))
        divisor = np.where(spectral, np.float32(_stored_scale(spec, path)), np.float32(1.0))
    return None if (divisor == 1.0).all() else divisor


def _stored_scale(spec: oiio.ImageSpec, path) -> float:
    """Return the power of two by which the spectra of a picture were multiplied; 1 if the file states none."""
    stated = spec.getattribute(_SCALE)
    if stated is None:
        return 1.0
    try:
        scale = float(stated)
    except (TypeError, ValueError):
        scale = math.nan
    if not (0.0 < scale < math.inf and math.frexp(scale)[0] == 0.5):
        raise InputError(path, _SCALE, repr(stated), "a power of two")
    return scale


def layers_of(names: list[str], path) -> tuple[np.ndarray, list[int]]:
    """Find the spectral layers of emission among channel names.

    Returns
    -------
    wavelength_nm : (n,) float64, increasing
    indices : list of int
        Indices of these channels in ``names``.

    Raises
    ------
    InputError
        If there is no such layer, or two for the same wavelength.
    """
    found = [(wavelength, index) for index, name in enumerate(names) if (wavelength := _wavelength_nm(name))]
    if not found:
        others = sorted({name.partition(".")[0] for name in names})
        accepted = f"layers {_EMISSION}.<wavelength>nm of the published spectral layout"
        missing = f"no layer for 400 nm or another wavelength of the kind {_EMISSION} among {', '.join(others)}"
        raise InputError(path, "channels", missing, accepted)
    found.sort()
    wavelength_nm = np.array([wavelength for wavelength, _ in found])
    twice = np.flatnonzero(np.diff(wavelength_nm) < 1e-6)
    if twice.size:
        raise InputError(path, "channels", f"{wavelength_nm[twice[0]]:g} nm twice", "each wavelength once")
    return wavelength_nm, [index for _, index in found]


def _grid_channels(header: Header, path) -> list[int]:
    """Return the channel indices of the S0 layers at the 61 wavelengths."""
    wavelength_nm, channels = layers_of(header.channels, path)
    available = dict(zip((round(float(w), 3) for w in wavelength_nm), channels, strict=True))
    missing = [w for w in WAVELENGTH_NM if round(float(w), 3) not in available]
    if missing:
        raise InputError(path, "channels", f"no layer for {missing[0]:g} nm", "layers S0.400nm to S0.700nm, step 5")
    return [available[round(float(w), 3)] for w in WAVELENGTH_NM]


def write_xyz_exr(path, xyz: np.ndarray, attributes: dict[str, str]) -> None:
    """Write tristimulus values as an EXR with the channels X, Y and Z.

    Parameters
    ----------
    xyz : (height, width, 3) float32
        CIE 1931 2° observer; Y = 100 is the scene's white.
    attributes : dict of str
        Text attributes.
    """
    spec = specification(xyz.shape[:2], ["X", "Y", "Z"], {"compression": "zip", **attributes})
    write_picture_file(path, spec, [xyz.astype(np.float32, copy=False)])


def read_xyz(path, matrix: np.ndarray) -> np.ndarray:
    """Read the tristimulus values of a rendered picture, (height, width, 3) float.

    Parameters
    ----------
    path : path
        A spectral EXR, or an EXR with the channels X, Y, Z, which are returned unchanged.
    matrix : (3, 61) float
        Matrix from radiance to XYZ.

    Raises
    ------
    InputError
        If the file is missing or truncated, or has neither kind of channels.
    """
    header = picture_header(path)
    if {"X", "Y", "Z"} <= set(header.channels):
        channels = [header.channels.index(name) for name in "XYZ"]
        return np.concatenate([band[..., channels] for _, band in picture_bands(path, _ROWS)])
    channels = _grid_channels(header, path)
    return np.concatenate([band[..., channels] @ matrix.T for _, band in picture_bands(path, _ROWS)])


def write_display_picture(path, pixels: np.ndarray, profile: bytes, attributes: dict[str, str]) -> None:
    """Write a picture for a display, as PNG or TIFF depending on the suffix of the file.

    Parameters
    ----------
    pixels : (height, width, 3) uint8 or uint16, code values
    profile : bytes
        ICC profile of the display.
    attributes : dict of str
        Text attributes; a TIFF has no field for them and lists them in its description.
    """
    if Path(path).suffix != ".png":
        listed = "; ".join(f"{name} {value}" for name, value in attributes.items())
        attributes = {"ImageDescription": listed, "compression": "zip"}
    spec = specification(pixels.shape[:2], ["R", "G", "B"], attributes, str(pixels.dtype))
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, dtype=np.uint8))
    # No chunks that declare sRGB: the ICC profile alone defines the colours.
    spec.attribute("oiio:ColorSpace", "unknown")
    write_picture_file(path, spec, [pixels])
