"""Decoding of the photographs of one filter state, and merging of their exposures into responses."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np

from irodori.config.capture_table import Shot, shot_path
from irodori.core.errors import InputError
from irodori.ingest.exposure_settings import iso_ratio, relative_exposure_s, settle
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.merge import ABSENT, FADED, ExposureBracket, PatternPlanes, merge
from irodori.ingest.mosaic import Mosaic, decode, demosaic

_PEDESTAL = 512  # digital number that represents black in a demosaiced picture
#: Distance, in mosaic pixels, to which an algorithm spreads the value of a pixel (measured with single outliers on
#: noise). DCB and DHT choose directions from a larger area; hot pixels are replaced before, so as not to influence it.
REACH_PX = {"linear": 1, "vng": 2, "ppg": 4, "ahd": 5, "dcb": 5, "dht": 5}
_MERGED_SHARE = 0.5  # smallest share of a band's samples with which an exposure counts in the noise model


@dataclass(frozen=True)
class Frame:
    """One decoded photograph: its shot with ISO and aperture completed, its mosaic, and its demosaiced bands or None.

    ``black`` and ``clip`` are the digital numbers of black and of the clip level in the demosaiced bands.
    """

    shot: Shot
    mosaic: Mosaic
    bands: np.ndarray | None
    black: tuple[float, ...] = ()
    clip: tuple[float, ...] = ()


@dataclass(frozen=True)
class Developed:
    """Responses of one filter state.

    Parameters
    ----------
    response : (height, width, 3) float32
        Responses; 0 where clipped.
    clipped : (height, width) bool
        Pixels with a band at or above the clip level in every exposure.
    hot : (height, width) bool
        Pixels that a hot mosaic pixel affects.
    noise : (3, 2) float64
        c0 and c1 of the variance c0 + c1 x response at the centre of the picture; NaN if unknown.
    exposures : (exposures, 3, 3) float64
        c0 and c1 of each exposure alone, the shortest first, and the response from which it no longer counts.
    pattern : str
        Colours of the first 2 x 2 pixels of the mosaic; empty for a picture that is not a mosaic.
    """

    response: np.ndarray
    clipped: np.ndarray
    hot: np.ndarray
    noise: np.ndarray
    exposures: np.ndarray
    pattern: str

    @property
    def valid(self) -> np.ndarray:
        """Pixels with three measured bands, (height, width) bool."""
        return ~(self.clipped | self.hot)


def load_frames(reference, shots: list[Shot], table, folder, options: IngestOptions) -> list[Frame]:
    """Decode photographs in parallel.

    Raises
    ------
    InputError
        If a file cannot be decoded, contradicts the table, or has another size or another mosaic than the camera's
        reference.
    """

    def load(shot: Shot) -> Frame:
        path = shot_path(shot, table, folder)
        mosaic = decode(path, shot.linear)
        shot = settle(shot, mosaic, table)
        _check_sensor(reference, shot, mosaic, path)
        if options.sample_px == 2:
            return Frame(shot, mosaic, None)
        if mosaic.linear:
            found = f"{options.demosaic} for a picture that is no mosaic"
            raise InputError(path, "ingest.demosaic", found, "superpixel, which takes each pixel of a picture as it is")
        return _demosaiced(reference, shot, mosaic, path, options)

    with ThreadPoolExecutor(max(1, min(len(shots), numba.get_num_threads()))) as pool:
        return list(pool.map(load, shots))


def _is_sensor(reference, shot: Shot, mosaic: Mosaic) -> bool:
    """Return whether pixels of a picture correspond to pixels of the sensor; those of a stitched panorama do not."""
    return shot.role != "environment" or mosaic.size == tuple(reference.size_px)


def _check_sensor(reference, shot: Shot, mosaic: Mosaic, path) -> None:
    wanted = tuple(reference.size_px)
    if _is_sensor(reference, shot, mosaic) and wanted != (0, 0) and mosaic.size != wanted:
        found = f"{mosaic.size[0]} x {mosaic.size[1]} pixels"
        raise InputError(path, "size", found, f"{wanted[0]} x {wanted[1]}, as the camera's dark frames and white")
    if _is_sensor(reference, shot, mosaic):
        require_pattern(reference.pattern, mosaic, path)


def require_pattern(pattern: str, mosaic: Mosaic, path) -> None:
    """Raise `InputError` for a mosaic of another pattern than the camera's; an empty one accepts any."""
    if pattern and not mosaic.linear and mosaic.pattern != pattern:
        raise InputError(path, "mosaic", mosaic.pattern, f"{pattern}, as the camera's reference photographs")


def _dark_seconds(reference, shot: Shot) -> float:
    """Return the exposure time for the dark signal: multiplied by the amplification relative to the dark frames, s."""
    return shot.exposure_s * iso_ratio(shot, reference.dark.iso if reference.dark else 0.0)


def _demosaiced(reference, shot: Shot, mosaic: Mosaic, path, options: IngestOptions) -> Frame:
    """Demosaic a photograph to full resolution; pixels that clipping affects are set to the clip level."""
    height, width = mosaic.values.shape
    offset = np.tile(mosaic.black.astype(np.float32), (height // 2, width // 2))
    if reference.dark is not None:
        if _is_sensor(reference, shot, mosaic):
            offset += reference.dark.signal_dn(_dark_seconds(reference, shot))
        else:
            offset += reference.dark.signal_dn(_dark_seconds(reference, shot)).mean()
    whole = np.rint(offset).astype(np.int32)
    hot_px = None
    if reference.dark is not None and _is_sensor(reference, shot, mosaic):
        hot_px = reference.dark.hot_px
    bands = demosaic(path, options.demosaic, whole, _PEDESTAL, hot_px)
    clip = mosaic.black + options.saturation * (mosaic.white - mosaic.black)
    rest, level = np.zeros(3), np.full(3, np.inf)
    for row, column, band in mosaic.places():
        share = 0.5 if band == 1 else 1.0
        mean = float(np.mean(offset[row::2, column::2], dtype=np.float64))
        # LibRaw works with integers: the mean rounding error of the offset is subtracted later for each colour.
        rest[band] += share * (mean - float(np.mean(whole[row::2, column::2], dtype=np.float64)))
        level[band] = min(level[band], np.ceil(_PEDESTAL + clip[row, column] - mean))
    clipped = mosaic.values >= np.tile(clip, (height // 2, width // 2))
    bands[_reached(clipped, options)] = level.astype(np.uint16)
    return Frame(shot, mosaic, bands, tuple(_PEDESTAL + rest), tuple(level))


def _reached(mask: np.ndarray, options: IngestOptions) -> np.ndarray:
    """Return the pixels that marked mosaic pixels affect by interpolation."""
    from scipy import ndimage  # slow to import, and superpixels never need it

    reach = REACH_PX[options.demosaic]
    return ndimage.binary_dilation(mask, np.ones((2 * reach + 1,) * 2, bool)) if mask.any() else mask


def merge_frames(reference, frames: list[Frame], options: IngestOptions, white, out=None) -> Developed:
    """Merge the frames of one filter state.

    Parameters
    ----------
    reference : irodori.ingest.camera_reference.Reference
    frames : list of Frame
    options : IngestOptions
    white : (3, 15) float64 or None
        Coefficients of the flat field; for a panorama only its value at the centre is used.
    out : (height, width, 3) float32, optional
        Array to fill with the responses.
    """
    frames = sorted(frames, key=lambda f: relative_exposure_s(f.shot))
    first = frames[0].mosaic
    for frame in frames[1:]:
        if frame.mosaic.values.shape != first.values.shape or frame.mosaic.pattern != first.pattern:
            found = f"{frame.mosaic.size} pixels, {frame.mosaic.pattern}"
            raise InputError(frame.shot.file, "size", found, f"{first.size}, {first.pattern}, as {frames[0].shot.file}")
    on_sensor = _is_sensor(reference, frames[0].shot, first)
    if white is not None and not on_sensor:
        white = white[:, 0]  # at the centre both coordinates are 0
    height, width = (2 * side // options.sample_px // 2 for side in first.values.shape)
    shape = (height, width)
    out = empty_response(height, width, 1) if out is None else out
    clipped = np.zeros(shape, dtype=np.bool_)
    bracket = _bracket(reference, frames)
    planes = _planes(reference, frames, options, on_sensor)
    shares = merge(planes, bracket, white, options.sample_px, out, clipped)
    hot = _hot(reference, first.values.shape, options) if on_sensor else np.zeros(shape, dtype=np.bool_)
    greens = 1.0 if first.linear else 2.0
    noise = _noise_model(bracket, white, shares, options, greens)
    exposures = _noise_of_exposures(bracket, white, planes, options, greens)
    return Developed(out, clipped, hot, noise, exposures, "" if first.linear else first.pattern)


def empty_response(height: int, width: int, states: int) -> np.ndarray:
    """Allocate the responses of some filter states, (height, width, 3 states) float32.

    The bands of one state are never contiguous in memory, because the loops are compiled only for strided pictures.
    """
    bands = 3 * states
    return np.empty((height, width, max(bands, 4)), dtype=np.float32)[..., :bands]


def develop(reference, shots: list[Shot], table, folder, options: IngestOptions, white) -> Developed:
    """Decode and merge the photographs of one filter state; see `load_frames` and `merge_frames`."""
    return merge_frames(reference, load_frames(reference, shots, table, folder, options), options, white)


def _bracket(reference, frames: list[Frame]) -> ExposureBracket:
    noise = [reference.noise.at(iso_ratio(f.shot, reference.noise.iso)) for f in frames]
    return ExposureBracket(
        exposure_dn=np.array([relative_exposure_s(f.shot) * f.mosaic.full_scale for f in frames]),
        dark_s=np.array([_dark_seconds(reference, f.shot) for f in frames]),
        electrons_per_dn=np.array([n[0] for n in noise]),
        read_dn2=np.array([n[1] for n in noise]),
    )


def _planes(reference, frames: list[Frame], options: IngestOptions, on_sensor: bool) -> PatternPlanes:
    if options.sample_px == 1:
        pictures = [f.bands for f in frames if f.bands is not None]  # all frames have bands: they were demosaiced
        stack = pictures[0][None] if len(pictures) == 1 else np.stack(pictures)
        # Green is listed twice, as in a mosaic, so that the loops are compiled only for four places.
        bands = np.array([0, 1, 1, 2])
        black, clip = (
            np.ascontiguousarray(np.array([getattr(f, n) for f in frames]).T[bands]) for n in ("black", "clip")
        )
        absent = (ABSENT,) * 4
        return PatternPlanes(tuple(stack[..., band] for band in bands), bands, black, clip, absent, absent, (0.0, 0.0))
    places = frames[0].mosaic.places()
    stack = frames[0].mosaic.values[None] if len(frames) == 1 else np.stack([f.mosaic.values for f in frames])
    samples = tuple(stack[:, row::2, column::2] for row, column, _ in places)
    bands = np.array([band for *_, band in places])
    black = np.array([[float(f.mosaic.black[row, column]) for f in frames] for row, column, _ in places])
    white = np.array([[float(f.mosaic.white[row, column]) for f in frames] for row, column, _ in places])
    clip = black + options.saturation * (white - black)
    dark = reference.dark
    nothing = (ABSENT,) * len(places)
    if dark is None or not on_sensor:
        level = 0.0 if dark is None else np.array([_mean_dark(dark, _dark_seconds(reference, f.shot)) for f in frames])
        return PatternPlanes(samples, bands, black + level, clip, nothing, nothing, (0.0, 0.0))
    offset, rate = (
        nothing if values is None else tuple(values[row::2, column::2] for row, column, _ in places)
        for values in (dark.offset, dark.rate)
    )
    return PatternPlanes(samples, bands, black, clip, offset, rate, (dark.offset_step_dn, dark.rate_step_dn_per_s))


def _mean_dark(dark, seconds: float) -> float:
    level = dark.rate_step_dn_per_s * seconds * float(dark.rate.mean(dtype=np.float64))
    return level if dark.offset is None else level + dark.offset_step_dn * float(dark.offset.mean(dtype=np.float64))


def _hot(reference, shape, options: IngestOptions) -> np.ndarray:
    """Return the samples that hot mosaic pixels affect, (height, width) bool."""
    side = options.sample_px
    hot_px = np.zeros((0, 2), int) if reference.dark is None else reference.dark.hot_px
    mask = np.zeros((shape[0] // side, shape[1] // side), dtype=np.bool_)
    mask[hot_px[:, 0] // side, hot_px[:, 1] // side] = True
    return mask if side == 2 else _reached(mask, options)


def _noise_model(
    bracket: ExposureBracket, white, shares: np.ndarray, options: IngestOptions, greens: float
) -> np.ndarray:
    """Return c0 and c1 of the noise model of each band at the centre of the picture, (3, 2).

    Exposures count if they contribute at least half of a band's samples; the shortest always counts. A sample of green
    is the mean of ``greens`` independent mosaic pixels.
    """
    unknown = (
        white is None or not np.isfinite(bracket.electrons_per_dn).all() or not np.isfinite(bracket.read_dn2).all()
    )
    # Demosaicing averages neighbouring pixels, so the noise differs from that of a single sample.
    if unknown or options.sample_px == 1:
        return np.full((3, 2), np.nan)
    merged = shares >= _MERGED_SHARE
    merged[:, 0] = True
    level = white if white.ndim == 1 else white[:, 0]
    dn_per_response = merged * level[:, None] * bracket.exposure_dn
    read = np.sum(dn_per_response**2 / bracket.read_dn2, axis=1)
    shot = np.sum(dn_per_response * bracket.electrons_per_dn, axis=1)
    samples = np.array([1.0, greens, 1.0])
    return np.stack([1.0 / read / samples, 1.0 / shot / samples], axis=-1)


def _noise_of_exposures(
    bracket: ExposureBracket, white, planes: PatternPlanes, options: IngestOptions, greens: float
) -> np.ndarray:
    """Return c0 and c1 of each exposure alone, and the response from which it no longer counts, (exposures, 3, 3).

    That of the shortest is where it clips. All are NaN if the noise is unknown.
    """
    alone = (ExposureBracket(*(field[[k]] for field in bracket)) for k in range(bracket.exposure_dn.size))
    models = np.stack([_noise_model(one, white, np.ones((3, 1)), options, greens) for one in alone])
    if not np.isfinite(models).all():
        return np.full((len(models), 3, 3), np.nan)
    level = white if white.ndim == 1 else white[:, 0]
    room = np.stack([(planes.clip - planes.black)[planes.bands == band].min(axis=0) for band in range(3)], axis=-1)
    limit = room / (level * bracket.exposure_dn[:, None])
    limit[1:] *= FADED
    return np.concatenate([models, limit[..., None]], axis=-1)
