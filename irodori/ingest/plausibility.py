"""Plausibility of photographs: whether the content of a RAW file can be what was requested.

A capture session checks every shot at once, while a mistake can still be corrected; `irodori.ingest.set_plausibility`
checks a table of photographs that exist already. A photograph is compared with earlier ones that passed: those of the
same kind (role and filter), that of the same capture with the other filter, and the white reference. The limits are
wide enough for the poses, brackets and highlights of a normal session; whatever exceeds them is reported, so that the
user can decide.
"""

import hashlib
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property

import numpy as np

from irodori.config.capture_table import DRIFT, Shot, flat_incidence_rad
from irodori.core.errors import InputError, counted
from irodori.core.file_kinds import kind_instead_of_raw
from irodori.ingest.exposure_settings import relative_exposure_s
from irodori.ingest.mosaic import Mosaic, decode
from irodori.ingest.tiff_tags import read_tags

#: Smallest width of the reduced pictures for comparison, blocks of superpixels.
_SMALL_PX = 256
#: Smallest width of the reduced pictures that are compared with all others of a set.
_THUMBNAIL_PX = 64
_MAKE, _MODEL, _TIME, _FRACTION, _SERIAL, _LENS = 271, 272, 36867, 37521, 42033, 42036
#: Shares of the range from black to white: pixels above the first are lit, pixels at or above the second are clipped.
LIT, CLIPPED = 0.02, 0.995
#: Sharpness is measured at one in this number of positions, the steepest ones; the outline of a small object suffices.
_STEEPEST = 500
#: Percentile of the lit pixels at which a picture is cut off before its sharpness is measured.
_BRIGHT = 70.0
#: Quantiles of the colours of a picture that are compared.
_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
_FEWEST_STEPS, _STEP_PX = 16, 4
#: Every eighth row is hashed: the noise in an eighth of a picture does not occur twice.
_HASHED = 8
#: Largest shift of a picture by the plate of a filter, as a share of the picture's width.
PLATE_SHIFT = 0.01
#: Share of unlit superpixels above which a photograph counts as black; the others are hot pixels.
_BLACK = 0.997
#: Kinds of doubts that no correct photograph is known to raise: such photographs are refused.
CERTAIN = (
    *("identical", "size", "mosaic", "body", "lens", "focal length"),
    *("black", "blown", "light", "filter", "order", "white"),
)
_OTHER = {"in": "out", "out": "in"}
#: Number of photographs of each kind that are read again when a session is continued.
_RECALLED = 3
#: Largest share of clipped superpixels with which the ratio of background to highlights is still reliable.
_FEW = 1e-3


@dataclass(frozen=True)
class Limits:
    """Limits for the differences between a photograph and others of its session; shares and ratios.

    Parameters
    ----------
    clipped : float
        Largest clipped share of the lit superpixels in the shortest exposure of a bracket.
    black, capped : float
        Level (99th percentile, as a share of the range): smallest of a lit picture, and largest of a dark frame.
    dimmest, to_white : float
        Smallest level per exposure relative to the darkest photograph of the same kind, and to the white reference.
    ambient : float
        Ratio of the darkest tenth to the brightest hundredth above which ambient light is suspected, if it also exceeds
        twice the largest earlier ratio of the same kind.
    sharpness, sharpest : float
        Smallest sharpness relative to that of the other photograph of the capture or, for the first of the two, to the
        median of the same kind; what it is compared with counts as at most `sharpest`.
    repeat : float
        Largest relative change of the light in a repeated view.
    pair, unfiltered : float
        Largest factor between the transmittance of the filter in this pair of photographs and in earlier ones;
        transmittance above which, if exceeded in all bands, there is no filter.
    colour, colour_step : float
        A photograph is assigned to the other filter state if its distance in colour to that state is less than `colour`
        times the distance to its own state, and the latter exceeds `colour_step` (logarithms of ratios of bands).
    moved, moved_first : float
        Largest shift between the two photographs of a capture in excess of that in earlier pairs, and in the first
        pair; shares of the picture's width.
    moved_px : float
        Smallest shift that counts, superpixels; twice this for the first pair.
    chart : (float, float)
        Smallest and largest ratio of the brightest patch of a chart to the white reference.
    grazing_deg : float
        Angle of light or camera beyond which a flat sample may appear black.
    """

    clipped: float = 0.25
    black: float = 0.005
    capped: float = 0.03
    dimmest: float = 0.1
    to_white: float = 0.01
    ambient: float = 0.03
    sharpness: float = 0.55
    sharpest: float = 0.8
    repeat: float = 0.08
    pair: float = 1.25
    unfiltered: float = 0.8
    colour: float = 0.6
    colour_step: float = 0.08
    moved: float = 0.008
    moved_first: float = 0.02
    moved_px: float = 1.75
    chart: tuple[float, float] = (0.4, 1.3)
    grazing_deg: float = 80.0


@dataclass(frozen=True)
class Look:
    """Measurements of one photograph.

    Parameters
    ----------
    size : (width, height)
        Mosaic pixels.
    pixels : str
        Hash of every eighth row of pixels, without tags, which may differ between copies of a picture.
    camera, lens, time : str
        Maker, model and serial number of the body; lens; time of the camera's clock, ISO 8601. Empty if the file does
        not state them.
    clipped, dark : float
        Shares of superpixels with a saturated pixel, and of unlit ones.
    sharpness : float
        Share of the highest steps over four superpixels that occurs within one superpixel; NaN without such steps.
    picture : (rows, columns, 3) float32
        Red, green and blue of blocks of superpixels, as shares of the range from black to white.
    whole : (rows, columns) bool
        Blocks without clipped superpixels.
    focal_mm : float
        Focal length stated in the file, mm; 0 if it does not state it.
    is_thumbnail : bool
        Whether the picture is too small to tell a shift.
    pattern : str
        Colours of the first 2 x 2 pixels of the mosaic; empty for a picture that is not a mosaic.
    """

    size: tuple[int, int]
    pixels: str
    camera: str
    lens: str
    time: str
    clipped: float
    dark: float
    sharpness: float
    picture: np.ndarray = field(repr=False)
    whole: np.ndarray = field(repr=False)
    focal_mm: float = 0.0
    is_thumbnail: bool = False
    pattern: str = ""

    def __str__(self) -> str:
        return f"brightest hundredth at {self.level:.0%} of the range, {self.clipped:.1%} blown, {self.dark:.0%} dark"

    @cached_property
    def level(self) -> float:
        """99th percentile over the blocks of the brightest band, as a share of the range from black to white."""
        return float(np.percentile(self.picture.max(axis=2), 99.0))

    @cached_property
    def background(self) -> float:
        """Ratio of the 10th to the 99th percentile of green."""
        low, high = np.percentile(self.picture[..., 1], [10.0, 99.0])
        return float(low / max(high, 1e-6))

    @cached_property
    def colour(self) -> np.ndarray:
        """Quantiles of the logarithms of red/green and blue/green over lit, unclipped blocks, (10,); NaN without any.

        A filter shifts all quantiles. If another pose lights other parts of a multicoloured object, some quantiles jump
        from one colour to another while others stay. The scale makes distances root mean squares over the quantiles.
        """
        bands = self.picture[self.whole & (self.picture.min(axis=2) > LIT / 4.0)]
        if len(bands) < _FEWEST_STEPS:
            return np.full(2 * len(_QUANTILES), np.nan)
        ratios = np.log(bands[:, [0, 2]] / bands[:, 1:2])
        return np.quantile(ratios, _QUANTILES, axis=0).ravel() / math.sqrt(len(_QUANTILES))


@dataclass(frozen=True)
class Doubt:
    """A reason to doubt that a photograph is what was requested.

    Parameters
    ----------
    kind : str
        Short name, such as ``blown``.
    words : str
        Clause for the user: what was found, and what to check.
    beside : tuple of str
        Files of earlier photographs of the same capture that may be at fault instead, because the comparison with them
        does not tell which one is.
    """

    kind: str
    words: str
    beside: tuple[str, ...] = ()

    def naming_all(self) -> "Doubt":
        """Return the doubt with the names of the photographs ``beside`` in its words."""
        return replace(self, words=f"{self.words} Or is {' or '.join(self.beside)} at fault?") if self.beside else self

    @property
    def is_certain(self) -> bool:
        """Whether no correct photograph is known to raise this doubt."""
        return self.kind in CERTAIN


def delivered_again(file: str) -> Doubt:
    """Return the doubt about a photograph that is identical to another file."""
    return Doubt("identical", f"the very picture of {file}: was it delivered twice?")


@dataclass(frozen=True)
class Drift:
    """Differences between a drift frame and the photograph that it repeats.

    Parameters
    ----------
    file, repeats : str
        Names of the two files.
    light : float
        Ratio of the green light in the drift frame to that in the photograph.
    shift_px : float
        Distance between the contours in the two pictures, superpixels; NaN if there are no contours.
    """

    file: str
    repeats: str
    light: float
    shift_px: float

    def __str__(self) -> str:
        moved = "" if math.isnan(self.shift_px) else f", contours {self.shift_px:.1f} superpixels aside"
        return f"{self.file}: light {self.light - 1.0:+.1%} against {self.repeats}{moved}"

    def plain(self) -> dict[str, str | float | None]:
        """Return the fields for a record in JSON, with None for NaN."""
        shift = None if math.isnan(self.shift_px) else round(self.shift_px, 2)
        return {"file": self.file, "repeats": self.repeats, "light": round(self.light, 4), "shift_px": shift}


def look_at(path, mosaic: Mosaic, *, thumbnail: bool = False) -> Look:
    """Measure a decoded photograph.

    Parameters
    ----------
    path : path
        File of the photograph; its tags are read.
    mosaic : Mosaic
    thumbnail : bool
        Whether to make a smaller picture (64 to 127 columns), which takes little memory; position is not checked then.
    """
    side = _side(mosaic, _THUMBNAIL_PX if thumbnail else _SMALL_PX)
    bands, clipped, dark = _reduced(mosaic, side)
    texts = _texts(path)
    named = dict.fromkeys(texts[key] for key in (_MAKE, _MODEL, _SERIAL) if texts.get(key))
    return Look(
        size=mosaic.size,
        pixels=hashlib.blake2b(mosaic.values[::_HASHED].tobytes(), digest_size=16).hexdigest(),
        camera=" ".join(named),
        lens=texts.get(_LENS, ""),
        time=_stated_time(texts) if texts else mosaic.time,
        clipped=float(clipped.mean()),
        dark=float(dark.mean()),
        sharpness=_sharpness(mosaic),
        picture=bands,
        whole=_blocks(clipped, side) == 0.0,
        focal_mm=mosaic.focal_mm,
        is_thumbnail=thumbnail,
        pattern="" if mosaic.linear else mosaic.pattern,
    )


def camera_time(path) -> str:
    """Return the time of the camera's clock, ISO 8601; empty if a file states none, or is no RAW file or picture.

    Formats without TIFF tags, such as CRW, are read by LibRaw.
    """
    texts = _texts(path)
    if texts or kind_instead_of_raw(path):
        return _stated_time(texts)
    try:
        return decode(path).time
    except InputError:
        return ""


def _texts(path) -> dict[int, str]:
    tags = read_tags(path, (_MAKE, _MODEL, _TIME, _FRACTION, _SERIAL, _LENS))
    return {tag.number: str(tag.values[0]) for tag in tags}


def _stated_time(texts: dict[int, str]) -> str:
    return _iso_time(texts.get(_TIME, ""), texts.get(_FRACTION, ""))


def _iso_time(stated: str, fraction: str) -> str:
    """Return a time of Exif with the digits of its fraction of a second in ISO 8601; empty for one of no calendar.

    A camera whose clock was never set, or has lost its battery, may state zeros or blanks.
    """
    day, _, clock = stated.partition(" ")
    time = f"{day.replace(':', '-')}T{clock}" + (f".{fraction}" if fraction.isdecimal() else "")
    try:
        datetime.fromisoformat(time)
    except ValueError:
        return ""
    return time if clock else ""


def _side(mosaic: Mosaic, columns: int = _SMALL_PX) -> int:
    return max(1, mosaic.size[0] // 2 // columns)


def _reduced(mosaic: Mosaic, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the reduced picture, and masks of the superpixels that are clipped and that are unlit."""
    height, width = mosaic.values.shape
    clipped, dark = np.zeros((height // 2, width // 2), dtype=bool), np.ones((height // 2, width // 2), dtype=bool)
    bands: list[list[np.ndarray]] = [[], [], []]
    for row, column, band in mosaic.places():
        values = np.ascontiguousarray(mosaic.values[row::2, column::2])
        black, full = float(mosaic.black[row, column]), float(mosaic.white[row, column] - mosaic.black[row, column])
        clipped |= values >= black + CLIPPED * full
        dark &= values < black + LIT * full
        bands[band].append((_blocks(values, side) - np.float32(black)) / np.float32(mosaic.full_scale))
    return np.stack([sum(parts) / np.float32(len(parts)) for parts in bands], axis=-1), clipped, dark


def _blocks(picture: np.ndarray, side: int) -> np.ndarray:
    """Return means over blocks of ``side`` x ``side`` pixels, (rows, columns) float32."""
    rows, columns = picture.shape[0] // side, picture.shape[1] // side
    cut = picture[: rows * side, : columns * side]
    lines = np.add.reduce(cut.reshape(rows, side, -1), axis=1, dtype=np.uint32)
    return (lines.reshape(rows, columns, side).sum(axis=2) / (side * side)).astype(np.float32)


def _sharpness(mosaic: Mosaic) -> float:
    """Return the share of the highest steps that occurs within one superpixel; NaN if there are no steps.

    Highlights are cut off: their flanks are the highest steps on many glossy objects, and soft in a sharp picture too.
    """
    row, column, _ = next(place for place in mosaic.places() if place[2] == 1)
    green = (mosaic.values[row::2, column::2].astype(np.float32) - mosaic.black[row, column]) / mosaic.full_scale
    some = green[:: _side(mosaic), :: _side(mosaic)]
    if (lit := some[some > LIT]).size == 0:
        return math.nan
    green = np.minimum(green, np.percentile(lit, _BRIGHT).astype(np.float32))
    wide, narrow = [], []
    # In a large picture some of the lines suffice.
    for picture in (green[:: _side(mosaic)], np.ascontiguousarray(green[:, :: _side(mosaic)].T)):
        if picture.shape[1] <= _STEP_PX:
            continue
        wide.append(np.abs(picture[:, _STEP_PX:] - picture[:, :-_STEP_PX]).ravel())
        near = np.abs(np.diff(picture, axis=1))
        parts = [near[:, at : near.shape[1] - _STEP_PX + 1 + at] for at in range(_STEP_PX)]
        narrow.append(np.maximum.reduce(parts).ravel())
    if not wide:
        return math.nan
    high, steep = np.concatenate(wide), np.concatenate(narrow)
    count = min(high.size, max(_FEWEST_STEPS, high.size // _STEEPEST))
    places = np.argpartition(high, -count)[-count:]
    # An evenly lit picture has only steps due to noise.
    if np.median(high[places]) < max(LIT, 0.25 * float(np.percentile(green[::4, ::4], 99.0))):
        return math.nan
    return float(np.median(steep[places] / high[places]))


def _shift_between(first: Look, second: Look) -> np.ndarray | None:
    """Return the shift of the second picture against the first, (columns, rows), as shares of the picture's width.

    None if one of them has no contours or is a thumbnail.
    """
    if first.picture.shape != second.picture.shape or first.is_thumbnail or second.is_thumbnail:
        return None
    if not (math.isfinite(first.sharpness) and math.isfinite(second.sharpness)):
        return None
    spectra = [np.fft.rfft2(_outline(look)) for look in (first, second)]
    likeness = np.fft.irfft2(spectra[1] * spectra[0].conj(), first.picture.shape[:2])
    peak = np.unravel_index(int(np.argmax(likeness)), likeness.shape)
    found = []
    for axis in (1, 0):
        size = likeness.shape[axis]
        near = []
        for step in (-1, 0, 1):
            place = list(peak)
            place[axis] = (place[axis] + step) % size
            near.append(float(likeness[tuple(place)]))
        bend = near[0] - 2.0 * near[1] + near[2]
        at = int(peak[axis]) + (0.5 * (near[0] - near[2]) / bend if bend < 0.0 else 0.0)
        found.append((at - size if at > size / 2 else at) / likeness.shape[1])
    return np.array(found)


def _outline(look: Look) -> np.ndarray:
    """Return the gradient magnitude of the green picture, 0 below noise and limited to that of a clear contour.

    If less than a hundredth of the picture is lit, the brightest hundredth is noise: contours are those of lit parts.
    """
    green = look.picture[..., 1]
    scale = np.percentile(green, 99.0)
    rows, columns = np.gradient(np.minimum(green / max(float(scale), LIT), 1.0))
    steps = np.hypot(rows, columns)
    return np.where(steps > 0.05, np.minimum(steps, 0.25), 0.0).astype(np.float32)


class Series:
    """Accepted photographs of a session, with which the next one is compared.

    Parameters
    ----------
    planned : iterable of Shot
        All shots of the session; they determine the shortest and longest exposure of each bracket.
    limits : Limits
    """

    def __init__(self, planned: Iterable[Shot], limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self._brackets: dict[tuple[str, str], list[float]] = defaultdict(list)
        for shot in planned:
            self._brackets[shot.capture, shot.filter].append(shot.exposure_s)
        self._seen: list[tuple[Shot, Look]] = []
        #: By subject: capture, transmittance of the filter, and shift from the unfiltered to the filtered picture.
        self._pairs: dict[str, list[tuple[str, np.ndarray | None, np.ndarray | None]]] = defaultdict(list)

    def add(self, shot: Shot, look: Look) -> None:
        """Add an accepted photograph to those with which later ones are compared."""
        if (partner := self._partner(shot)) is not None:
            self._pairs[shot.subject].append((shot.capture, *_compared(*partner, shot, look)))
        self._seen.append((shot, look))

    def forget(self, shot: Shot) -> None:
        """Remove a photograph that is to be retaken; the new one need not agree with it."""
        self._seen = [(s, seen) for s, seen in self._seen if s.file != shot.file]
        self._pairs[shot.subject] = [pair for pair in self._pairs[shot.subject] if pair[0] != shot.capture]

    def _partner(self, shot: Shot) -> tuple[Shot, Look] | None:
        """Return the first photograph of the same capture with the other filter."""
        return next(((s, k) for s, k in self._seen if s.capture == shot.capture and s.filter != shot.filter), None)

    def doubts(self, shot: Shot, look: Look) -> list[Doubt]:
        """Return the doubts about a photograph, the most obvious first; empty if there are none."""
        found = list(self._of_the_file(shot, look))
        if not found:
            found = list(self._of_the_level(shot, look))
        # A black or overexposed picture would fail all other checks too.
        if not found and shot.role != "dark":
            found = [*self._of_the_light(shot, look), *self._of_the_view(shot, look)]
        return [doubt.naming_all() for doubt in found]

    def drift(self, shot: Shot, look: Look) -> Drift | None:
        """Compare a drift frame with the photograph that it repeats.

        None for other photographs, and if the two have no lit area in common.
        """
        found = self._repeated(shot) if shot.role == DRIFT else None
        if found is None or (change := _transmittance(*found, shot, look)) is None:
            return None
        shift = _shift_between(found[1], look)
        aside = math.nan if shift is None else float(np.hypot(*shift)) * look.size[0] / 2.0
        return Drift(shot.file, found[0].file, float(change[1]), aside)

    def _repeated(self, shot: Shot) -> tuple[Shot, Look] | None:
        """Return the first photograph of the same view, that is of the same capture and filter."""
        return next(((s, k) for s, k in self._seen if (s.capture, s.filter) == (shot.capture, shot.filter)), None)

    def _in_doubt(self, shot: Shot) -> str:
        """Return a clause naming the photographs that a changed drift frame puts in doubt; empty for other roles."""
        if shot.role != DRIFT:
            return ""
        frames = [at for at, (s, _) in enumerate(self._seen) if s.role == DRIFT]
        since = [s.file for s, _ in self._seen[frames[-1] + 1 if frames else 0 :]]
        return f"; in doubt are the {counted(len(since), 'photograph')} before it, from {since[0]} on" if since else ""

    def _kind(self, shot: Shot) -> list[tuple[Shot, Look]]:
        return [(s, seen) for s, seen in self._seen if (s.subject, s.filter) == (shot.subject, shot.filter)]

    def _of_the_file(self, shot: Shot, look: Look) -> Iterator[Doubt]:
        """Yield doubts from the file: a picture delivered before, or another size, mosaic, body or lens."""
        for earlier, seen in self._seen:
            if seen.pixels == look.pixels:
                yield delivered_again(earlier.file)
                return
        # A panorama is stitched or unwrapped, so its size differs from that of the charts in the same set.
        alike = [(s, k) for s, k in self._seen if (s.role == "environment") == (shot.role == "environment")]
        if not alike:
            return
        shot, first = alike[0]
        if look.size != first.size:
            (width, height), (as_wide, as_high) = look.size, first.size
            yield Doubt(
                "size", f"{width} x {height} pixels, {shot.file} has {as_wide} x {as_high}: look at its settings"
            )
        if look.pattern and first.pattern and look.pattern != first.pattern:
            found = f"a mosaic of {look.pattern}, {shot.file} has one of {first.pattern}"
            yield Doubt("mosaic", f"{found}: was it converted or cropped in another way?")
        for kind, mine, other in (("body", look.camera, first.camera), ("lens", look.lens, first.lens)):
            if mine and other and mine != other:
                yield Doubt(kind, f"taken with {mine!r}, {shot.file} with {other!r}: is this the right one?")

    def _of_the_level(self, shot: Shot, look: Look) -> Iterator[Doubt]:
        """Yield doubts about the brightness of a photograph for its role."""
        limits, rate = self.limits, look.level / relative_exposure_s(shot)
        if shot.role == "dark":
            if look.level > limits.capped:
                yield Doubt("light", f"a dark frame with light at {look.level:.1%} of the range: is the cap on?")
            return
        times = self._brackets.get((shot.capture, shot.filter)) or [shot.exposure_s]
        lit = 1.0 - look.dark
        if shot.exposure_s <= min(times) and look.clipped > limits.clipped * lit:
            share = look.clipped / max(lit, 1e-6)
            yield Doubt("blown", f"{share:.0%} of what is lit is saturated: look at exposure, aperture and lamp")
        grazing = max(math.degrees(flat_incidence_rad(shot.pose)), shot.pose.camera_deg + shot.pose.tilt_deg)
        if grazing > limits.grazing_deg and shot.subject == "object":
            return
        darkest = min((seen.level / relative_exposure_s(s) for s, seen in self._kind(shot)), default=0.0)
        white = self._white_rate(shot)
        if look.level < limits.black * shot.exposure_s / max(times) and look.dark > _BLACK:
            yield Doubt("black", "as good as black: is the cap on the lens, or the lamp off?")
        elif rate < limits.to_white * white:
            yield Doubt("dim", f"{rate / white:.1%} as bright as the white reference: is the lamp on?")
        elif rate < limits.dimmest * darkest:
            yield Doubt("dim", f"{rate / darkest:.1%} as bright as the darkest of its kind: is the lamp on?")
        low, high = limits.chart
        if shot.role == "chart" and white and not low < rate / white < high:
            found = f"its brightest patch is {rate / white:.2f} of the white reference"
            yield Doubt("chart", f"{found}, between {low:g} and {high:g} is expected: have lamp or aperture changed?")

    def _white_rate(self, shot: Shot) -> float:
        """Return the level of the white reference per second of relative exposure; 0 if there is none."""
        whites = [(s, w) for s, w in self._seen if s.role == "white" and s.filter == shot.filter]
        rates = [w.level / relative_exposure_s(s) for s, w in whites]
        return float(np.median(rates)) if rates else 0.0

    def _of_the_light(self, shot: Shot, look: Look) -> Iterator[Doubt]:
        """Yield doubts about changes of lamp, filter or ambient light."""
        limits = self.limits
        if (repeated := self._repeated(shot)) is not None:
            change = _transmittance(*repeated, shot, look)
            if change is not None and abs(math.log(change[1])) > math.log1p(limits.repeat):
                found = f"{change[1] - 1.0:+.0%} against {repeated[0].file}, the same view"
                asked = "has the lamp changed, was a door opened, is the filter right?"
                beside = self._of_the_capture(shot, shot.filter)
                yield Doubt("light changed", f"{found}: {asked}{self._in_doubt(shot)}", beside)
                return
        partner = self._partner(shot)
        if partner is not None and (passed := _compared(*partner, shot, look)[0]) is not None:
            found_pair = list(self._of_the_pair(shot, look, passed))
            yield from found_pair
            if found_pair:
                return
        # The other photograph of the pose tells more about the filter than the colours, which highlights change too.
        elif (shot.capture, _OTHER[shot.filter]) not in self._brackets and self._has_other_colour(shot, look):
            found = f"it has the colours of photographs with the filter {_OTHER[shot.filter]}"
            yield Doubt("filter", f"{found}: is it {shot.filter}?")
            return
        darkest = [seen.background for _, seen in self._kind(shot) if seen.clipped < _FEW]
        if darkest and look.clipped < _FEW and look.background > max(limits.ambient, 2.0 * max(darkest)):
            found = f"its background is at {look.background:.1%} of the brightest, at {max(darkest):.1%} before"
            yield Doubt("light changed", f"{found}: was a door opened, or another lamp switched on?")

    def _of_the_pair(self, shot: Shot, look: Look, passed: np.ndarray) -> Iterator[Doubt]:
        """Yield doubts about the transmittance of the filter, compared with earlier captures of the same subject.

        The photograph with the other filter may be at fault instead, unless the colours tell.
        """
        brightest, other = float(passed.max()), _OTHER[shot.filter]
        beside = self._of_the_capture(shot, other)
        if brightest > 1.0 / self.limits.unfiltered:
            found = f"it is {brightest:.1f} times as bright with the filter in as with the filter out"
            yield Doubt("filter", f"{found}, and no filter adds light: are 'in' and 'out' exchanged?", beside)
        elif passed.min() > self.limits.unfiltered:
            found = f"it is as bright as with the filter {other}: is it {shot.filter}?"
            yield Doubt("filter", found, () if self._has_other_colour(shot, look) else beside)
        elif earlier := [known for _, known, _ in self._pairs[shot.subject] if known is not None]:
            factors = np.log(passed / np.median(earlier, axis=0))
            # The lamp changes all bands alike, and another paint in view a single one.
            if min(np.abs(factors)) > math.log(self.limits.pair) and abs(np.sign(factors).sum()) == 3.0:
                found = f"the filter passes {math.exp(factors[1]):.2f} times what it passed before"
                asked = "have lamp or aperture changed between the two photographs?"
                yield Doubt("light changed", f"{found}: {asked}", beside)

    def _has_other_colour(self, shot: Shot, look: Look) -> bool:
        near = {"in": math.inf, "out": math.inf}
        for s, seen in self._seen:
            # If one of a pair has the wrong filter, both have the same colours, whichever of them it is.
            if s.subject == shot.subject and (s.capture != shot.capture or s.filter == shot.filter):
                distance = math.dist(seen.colour, look.colour)
                near[s.filter] = min(near[s.filter], distance if math.isfinite(distance) else math.inf)
        same, other = near[shot.filter], near["out" if shot.filter == "in" else "in"]
        return math.isfinite(same) and same > self.limits.colour_step and other < self.limits.colour * same

    def _of_the_capture(self, shot: Shot, state: str) -> tuple[str, ...]:
        """Return the files of the earlier photographs of the same capture with a state of the filter.

        A drift frame has none: it repeats a photograph that was taken long before.
        """
        if shot.role == DRIFT:
            return ()
        alike = (s for s, _ in self._seen if (s.capture, s.filter, s.role) == (shot.capture, state, shot.role))
        return tuple(s.file for s in alike)

    def _of_the_view(self, shot: Shot, look: Look) -> Iterator[Doubt]:
        """Yield doubts about sharpness, and about a shift against the same view or the other photograph of the pair."""
        limits = self.limits
        # In the same pose the same contours are seen, in others perhaps only the soft border of shadow on a ball.
        partner = self._partner(shot)
        alike = self._kind(shot) if partner is None or math.isnan(partner[1].sharpness) else [partner]
        known = [seen.sharpness for _, seen in alike if math.isfinite(seen.sharpness)]
        if known and look.sharpness < limits.sharpness * min(float(np.median(known)), limits.sharpest):
            found = f"contours {look.sharpness / float(np.median(known)):.0%} as steep as before"
            yield Doubt("defocus", f"{found}: look at the focus, and whether something shook")
            return
        beside = self._repeated(shot) or partner
        if beside is not None and (beyond := self._moved(*beside, shot, look)) is not None:
            found = f"{beyond:.0f} superpixels beside {beside[0].file}"
            asked = f"has object or camera moved, or a motor lost steps?{self._in_doubt(shot)}"
            yield Doubt("moved", f"{found}: {asked}", self._of_the_capture(shot, beside[0].filter))

    def _moved(self, earlier: Shot, seen: Look, shot: Shot, look: Look) -> float | None:
        """Return the shift in excess of that due to the filter plate, superpixels; None if it is small or unknown."""
        width, limits = look.size[0] / 2.0, self.limits
        usual, limit = np.zeros(2), max(limits.moved * width, limits.moved_px)
        if earlier.filter == shot.filter:
            shift = _shift_between(seen, look)
        else:
            shift = _compared(earlier, seen, shot, look)[1]
            known = [by for _, _, by in self._pairs[shot.subject] if by is not None]
            if known:
                usual = np.median(known, axis=0)
            else:
                limit = max(limits.moved_first * width, 2.0 * limits.moved_px)
        if shift is None:
            return None
        beyond = float(np.hypot(*(shift - usual))) * width
        return beyond if beyond > limit else None


def worth_recalling(kept: Iterable[Shot], missing: Iterable[Shot]) -> list[Shot]:
    """Return the earlier photographs of a session that are needed for comparison with the missing ones.

    They are the first of each kind, drift frames with the views that they repeat, and incomplete captures.
    """
    kept, chosen = list(kept), []
    open_captures = {shot.capture for shot in (*missing, *(s for s in kept if s.role == DRIFT))}
    kinds: dict[tuple[str, str], int] = defaultdict(int)
    for shot in kept:
        kinds[shot.role, shot.filter] += 1
        if kinds[shot.role, shot.filter] <= _RECALLED or shot.capture in open_captures:
            chosen.append(shot)
    return chosen


def _compared(first: Shot, seen: Look, second: Shot, other: Look) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return transmittance of the filter by band, and shift from unfiltered to filtered, for the pair of a capture."""
    if first.filter == "in":
        first, seen, second, other = second, other, first, seen
    return _transmittance(first, seen, second, other), _shift_between(seen, other)


def _transmittance(first: Shot, seen: Look, second: Shot, other: Look) -> np.ndarray | None:
    """Return the ratio of the second photograph's light to the first's at equal exposure, (3,).

    If only one is taken through the filter, as much is added around lit blocks as its plate may shift the picture: of a
    narrow lit edge, few blocks are lit in both. None if too few blocks are lit and unclipped.
    """
    if seen.picture.shape != other.picture.shape:
        return None
    whole, lit = seen.whole & other.whole, seen.picture[..., 1] > LIT / 2.0
    common = lit & whole
    if first.filter != second.filter:
        aside = math.ceil(PLATE_SHIFT * lit.shape[1])
        whole = ~_grown(~whole, aside)
        common = _grown(lit & whole, aside) & whole
    sums = [look.picture[common].sum(axis=0) for look in (seen, other)]
    if (lit & whole).sum() < _FEWEST_STEPS or not (np.array(sums) > 0.0).all():
        return None
    return sums[1] / sums[0] / _exposure_ratio(second, first)


def _grown(mask: np.ndarray, by: int) -> np.ndarray:
    """Return a mask, (height, width) bool, with all within so many pixels of it in both directions."""
    for axis in (0, 1):
        beyond = np.pad(mask, [(by, by) if axis == one else (0, 0) for one in (0, 1)])
        mask = np.asarray(np.lib.stride_tricks.sliding_window_view(beyond, 2 * by + 1, axis).any(axis=-1))
    return mask


def _exposure_ratio(one: Shot, other: Shot) -> float:
    """Return the ratio of the exposures of two photographs, with ISO and f-number if known for both."""
    ratio = one.exposure_s / other.exposure_s
    if one.iso and other.iso:
        ratio *= one.iso / other.iso
    if one.f_number and other.f_number:
        ratio *= (other.f_number / one.f_number) ** 2
    return ratio
