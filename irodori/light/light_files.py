"""Environments from files of other programs: high-dynamic-range RGB pictures and spectral EXR."""

from collections.abc import Callable, Iterator

import numpy as np

from irodori.colour.display import srgb
from irodori.colour.icc import D50_XYZ, bradford, read_profile
from irodori.core.errors import InputError, counted
from irodori.core.progress import LOGGER
from irodori.export.pictures import Header, layers_of, picture_bands, picture_header
from irodori.light.clipped_lamps import LargestNumbers
from irodori.light.omnidirectional import BAND_ROWS, OmnidirectionalPicture, from_panorama
from irodori.light.panorama_doubts import DisplaySteps, LightFromBelow
from irodori.light.whole_sphere import whole_sphere
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import light
from irodori.spectra.published_tables import published_table
from irodori.spectra.resampling import resample_picture

_RGB_ASSUMPTION = (
    "linear sRGB primaries; the spectrum of a pixel is R r(λ) + G g(λ) + B b(λ) of Mallett and Yuksel (2019) times "
    "D65, the smooth spectrum that has its colour: what the lights of the place really emit is not in the file"
)


#: Chromaticities x, y of red, green, blue and white of linear sRGB (ITU-R BT.709).
_SRGB = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
_CHROMATICITY_ROUNDING = 2e-3
#: Rounding of a profile's primaries, XYZ, and of its curve, sampled at so many codes.
_PROFILE_ROUNDING, _LOOKED_AT = 2e-3, 1024
#: Names of its colour space, as files state it, and names that say nothing of the colours.
_LINEAR, _UNSPECIFIC = "lin_rec709_scene", ("data", "unknown")
#: Accepted deviation of the width from twice the height, relative to the width; rescaling can cut pixels off.
_ODD_SHARE = 0.01
#: How statements of the accepted projection, or of none, begin in small letters.
_EQUIRECTANGULAR = ("latlong", "equirectangular", "plain texture")
#: Largest number of half precision.
_HALF_LARGEST = 65504.0
#: Negative light as a share of the positive, above which there is a warning; lossy compression leaves 1 to 2 %.
_MOST_NEGATIVE = 0.05


def mallett_basis() -> np.ndarray:
    """Return the spectra of the linear sRGB primaries (Mallett and Yuksel 2019), (61, 3), times D65 (100 at 560 nm).

    Their sum is D65. The sum weighted with linear sRGB values, where D65 is (1, 1, 1), has the colour of these values.
    """
    return published_table("srgb_primaries").at(WAVELENGTH_NM).T * light("D65")[:, None]


def _panorama_header(path) -> Header:
    """Read the header of a panorama; raise an error if the file states a part of a picture or another projection."""
    header = picture_header(path)
    if header.size != header.shown:
        (height, width), (whole_height, whole_width) = header.size, header.shown
        found = f"{width} x {height} pixels of a picture of {whole_width} x {whole_height}"
        raise InputError(path, "dataWindow", found, "every direction: a whole panorama")
    stated = header.projection
    if stated is not None and not stated.lower().startswith(_EQUIRECTANGULAR):
        raise InputError(path, "projection", stated, "an equirectangular panorama (LatLong), or no statement")
    return header


def _panorama(
    header: Header,
    channels: list[int],
    basis: np.ndarray,
    origin: dict,
    path,
    *,
    convert: Callable[[np.ndarray], np.ndarray],
    scale: float,
    centre_azimuth_deg: float,
) -> OmnidirectionalPicture:
    """Make the picture of a file; raise an error if its size is not that of a full equirectangular panorama.

    What makes its light doubtful is written to the log, and as ``warnings`` to ``origin``, when all bands have been
    read. The function ``convert`` returns the weights on the basis for bands of the file's numbers.
    """
    height, width = header.size
    if abs(width - 2 * height) > _ODD_SHARE * width:
        accepted = "an equirectangular panorama of all directions, twice as wide as high"
        raise InputError(path, "", f"{width} x {height} pixels", accepted)
    not_negative = _NotNegative(origin)

    def samples(tops: LargestNumbers, steps: DisplaySteps, below: LightFromBelow) -> Iterator[np.ndarray]:
        lit = False
        for first, band in picture_bands(path, BAND_ROWS):
            numbers = _sound(band[..., channels], first, path)
            tops.add(numbers)
            steps.add(numbers)
            values = not_negative(convert(numbers), first)
            below.add(values, first)
            lit = lit or bool((values > 0.0).any())
            yield values
        if not lit:
            raise InputError(path, "", "no pixel with a positive value", "a panorama with light")

    def read() -> Iterator[np.ndarray]:
        tops = LargestNumbers([header.channels[index] for index in channels], height * width)
        steps, below = DisplaySteps(), LightFromBelow(height)
        for values in whole_sphere(samples(tops, steps, below), header.size, path):
            yield from_panorama(values * np.float32(scale), centre_azimuth_deg)
        doubts = [*tops.clipping(), *steps.warnings(), *below.warnings(), *not_negative.warnings()]
        known, origin["warnings"] = "warnings" in origin, doubts
        for text in [] if known else origin["warnings"]:
            LOGGER.warning("%s: %s", path, text)

    return OmnidirectionalPicture(header.size, basis, read, path, origin)


def _sound(band: np.ndarray, first: int, path) -> np.ndarray:
    """Return a band of a picture; raise an error if a pixel is not finite, or at the end of half precision."""
    rows = f"in rows {first} to {first + len(band) - 1}"
    bad = int((~np.isfinite(band)).any(axis=-1).sum())
    if bad:
        raise InputError(
            path, "", f"{counted(bad, 'pixel')} without a finite value {rows}", "finite radiance everywhere"
        )
    bad = int((band == _HALF_LARGEST).any(axis=-1).sum())
    if bad:
        found = f"{bad} pixels of exactly {_HALF_LARGEST:g} {rows}, at which half precision cuts off brighter ones"
        raise InputError(path, "", found, "radiance below that, as after a division by ten, which the scale takes back")
    return band


class _NotNegative:
    """Clip negative values in bands of a picture to 0 and count them; repeated reading does not change the counts."""

    def __init__(self, origin: dict) -> None:
        self._origin = origin
        self._counts: dict[int, tuple[int, float, float]] = {}
        origin |= {"negative_pixels": 0, "negative_sum_over_positive": 0.0}

    def __call__(self, band: np.ndarray, first: int) -> np.ndarray:
        """Return the clipped band, (rows, width, n); ``first`` is the index of its first row."""
        out = np.maximum(band, 0.0)
        removed = out - band
        self._counts[first] = (
            int(removed.any(axis=-1).sum()), removed.sum(dtype=np.float64), out.sum(dtype=np.float64)
        )  # fmt: skip
        pixels, below, above = (sum(column) for column in zip(*self._counts.values(), strict=True))
        self._origin |= {"negative_pixels": pixels, "negative_sum_over_positive": float(below / max(above, 1e-30))}
        return out

    def warnings(self) -> list[str]:
        """Return a warning if too much light was negative."""
        share = self._origin["negative_sum_over_positive"]
        if share <= _MOST_NEGATIVE:
            return []
        return [f"negative values of {100 * share:.0f} % of the positive ones were set to 0, which adds light"]


def _check_profile(data: bytes | None, path) -> None:
    """Refuse a picture whose ICC profile, if it has one, is not that of linear light of the primaries of sRGB."""
    if data is None:
        return
    profile = read_profile(data, path)
    codes = np.linspace(0.0, 1.0, _LOOKED_AT)
    bent = max(float(np.abs(curve.linear(codes) - codes).max()) for curve in profile.curves)
    # Profiles state the white as it is or adapted to D50.
    xyz = bradford(D50_XYZ, profile.xyz_from_rgb.sum(axis=1)) @ profile.xyz_from_rgb
    own = bradford(D50_XYZ, srgb().white_xyz) @ srgb().xyz_from_rgb
    if bent > _PROFILE_ROUNDING or np.abs(xyz - own).max() > _PROFILE_ROUNDING:
        found = f"{profile.description!r}, with {'a tone curve' if bent > _PROFILE_ROUNDING else 'other primaries'}"
        raise InputError(path, "ICC profile", found, "linear light of the primaries of sRGB, or no profile")


def rgb_picture(path, scale: float = 1.0, centre_azimuth_deg: float = 0.0) -> OmnidirectionalPicture:
    """Open the light of an RGB panorama; its spectra are assumed, after Mallett and Yuksel (2019).

    Parameters
    ----------
    path : path
        EXR, Radiance HDR or TIFF with half or float samples; linear sRGB primaries; seen from inside, zenith at the
        top. It is mirrored as the file states (a Radiance HDR from below, ``Orientation`` 2 to 4), and values of a
        Radiance HDR are divided by its ``EXPOSURE`` and ``COLORCORR``.
    scale : float
        Radiance of RGB (1, 1, 1), relative: 1 has the luminance of D65 as tabulated, 100 at 560 nm.
    centre_azimuth_deg : float, degrees
        Azimuth of the centre of the picture.

    Raises
    ------
    InputError
        If the file cannot be read, lacks R, G or B, states other primaries, another colour space or another projection,
        has an ICC profile other than that of linear sRGB, contains only a part of the picture, is not twice as wide as
        high, has columns stored as rows, or has integer samples. While the bands are read: if the file is truncated, a
        pixel is not finite or at the end of half precision, none is positive, or the picture does not
        show all directions (`irodori.light.whole_sphere`).

    Notes
    -----
    Negative values, which result from lossy compression and wide gamuts, are set to 0 and counted in ``origin``; above
    5 % of the positive ones there is a warning, and so there is if the largest number looks like clipped lamps, the
    numbers have the steps of a picture for a display, or much more light comes from below than from above.
    """
    header = _panorama_header(path)
    names, depth = header.channels, header.depth
    if depth not in ("half", "float", "double"):
        accepted = "linear light: half or float samples, as EXR and Radiance HDR have"
        raise InputError(path, "", f"{depth} samples, which are made for a display", accepted)
    missing = [name for name in "RGB" if name not in names]
    if missing:
        found = f"no channel {missing[0]} among {', '.join(names[:6])}"
        raise InputError(path, "channels", found, "the channels R, G and B")
    stated = header.chromaticities
    if stated is not None and np.abs(np.array(stated) - _SRGB).max() > _CHROMATICITY_ROUNDING:
        found = ", ".join(f"{value:g}" for value in stated)
        raise InputError(path, "chromaticities", found, f"those of linear sRGB: {', '.join(map(str, _SRGB))}")
    _check_profile(header.profile, path)
    if header.colour_space not in (None, _LINEAR, *_UNSPECIFIC):
        accepted = f"{_LINEAR}, linear light of the primaries of sRGB, or no statement"
        raise InputError(path, "colour space", str(header.colour_space), accepted)
    origin = {"kind": "rgb", "assumption": _RGB_ASSUMPTION}
    return _panorama(
        header, [names.index(name) for name in "RGB"], mallett_basis(), origin, path,
        convert=lambda rgb: rgb, scale=scale, centre_azimuth_deg=centre_azimuth_deg,
    )  # fmt: skip


def spectral_picture(path, scale: float = 1.0, centre_azimuth_deg: float = 0.0) -> OmnidirectionalPicture:
    """Open the light of a spectral EXR in the published layout, resampled to the 61 wavelengths.

    Parameters
    ----------
    path : path
        File with emissive layers ``S0.<wavelength>``, at any wavelengths that cover 400 to 700 nm; seen from inside,
        zenith at the top.
    scale : float
        Factor on the radiance in the file.
    centre_azimuth_deg : float, degrees

    Raises
    ------
    InputError
        If the file cannot be read, has no emissive layers (as a picture of reflectances), states another projection,
        contains only a part of the picture, is not twice as wide as high, has columns stored as rows, or does not cover
        the wavelengths. While the bands are read: as `rgb_picture`, which also has its warnings.
    """
    header = _panorama_header(path)
    wavelength_nm, channels = layers_of(header.channels, path)
    resample_picture(wavelength_nm, np.zeros((1, len(wavelength_nm)), np.float32), path)  # refuses before reading
    bounds = [float(wavelength_nm[0]), float(wavelength_nm[-1]), len(wavelength_nm)]
    origin = {"kind": "spectral", "wavelengths_nm": bounds}
    return _panorama(
        header, channels, np.eye(WAVELENGTH_NM.size), origin, path,
        convert=lambda spectra: resample_picture(wavelength_nm, spectra, path),
        scale=scale, centre_azimuth_deg=centre_azimuth_deg,
    )  # fmt: skip
