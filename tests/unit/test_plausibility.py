"""Each limit of plausibility from both sides: what is a little within it passes, what is a little beyond it is said."""

import io
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy.ndimage import gaussian_filter

from irodori.colour.tone_curves import SRGB
from irodori.config.capture_table import Pose, Shot, Taken
from irodori.core.errors import InputError
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.plausibility import Look, Series, look_at, worth_recalling
from irodori.ingest.preview import preview_of
from irodori.ingest.set_plausibility import FocalRange, SetLook, _of_other_poses, _unlikeness

SIDE = 8  # superpixels of a block of the small pictures
FILTER = np.array([0.5, 0.6, 0.4])  # transmittance by band


def paints(seed: int = 0) -> np.ndarray:
    """Return a plate of tiles of many colours before a black ground, (40, 60, 3), the brightest at 0.5."""
    rng = np.random.default_rng(seed)
    picture = np.full((40, 60, 3), 0.004)
    picture[8:32, 12:48] = rng.uniform(0.1, 0.5, (6, 9, 3)).repeat(4, axis=0).repeat(4, axis=1)
    picture[10:12, 14:40] = 0.5
    return picture


PAINTS = paints()


def look(picture=PAINTS, **known) -> Look:
    """Return a look at a small picture (rows, columns, 3) of which nothing clips, unless something else is known."""
    told = {"size": (60 * 2 * SIDE, 40 * 2 * SIDE), "pixels": str(hash(np.asarray(picture).tobytes())), "camera": "",
            "lens": "", "time": "", "clipped": 0.0, "dark": 0.1, "sharpness": 0.9,
            "picture": np.asarray(picture, np.float32), "whole": np.ones(picture.shape[:2], bool)}  # fmt: skip
    return Look(**told | known)


def shot(role="object", state="out", seconds=0.02, *, camera=10.0, light=45.0, tilt=0.0, file="") -> Shot:
    name = file or f"{role}-{light:g}-{camera:g}-{state}-{seconds:g}.dng"
    return Shot(name, role, Pose(light, camera, tilt), state, seconds)


def doubts(known, asked, planned=()) -> list:
    """Return what is doubted about the last of some photographs, each with its look."""
    series = Series([*(one for one, _ in known), asked[0], *planned])
    for one, seen in known:
        series.add(one, seen)
    return series.doubts(*asked)


def of_level(role, level, **known):
    return lambda x: ([], (shot(role, **known), look(np.full((40, 60, 3), level * x), dark=0.5)))


WHITE, OUT, IN = shot("white"), shot(camera=0.0), shot(camera=0.0, state="in")
FLAT = np.full((40, 60, 3), 0.5)
PAIR = [(OUT, look()), (IN, look(PAINTS * FILTER))]
DRIFT = shot("drift", camera=0.0, file="drift.dng")


def background(level: float) -> np.ndarray:
    """Return the plate before a ground of a level beside its brightest, about an eighth of it."""
    return np.where(PAINTS < 0.01, 0.5 * level, PAINTS)


#: Name -> (photographs before and the one asked for by a figure, kind of doubt, figure that passes, one that does not,
#: words of the doubt).
LIMITS = {
    "blown, of what is lit": (
        lambda x: ([], (shot(), look(clipped=x, dark=0.5))), "blown", 0.12, 0.13, "26% of what is lit",
    ),
    "a capped lens": (of_level("dark", 1.0), "light", 0.029, 0.031, "light at 3.1% of the range"),
    "black, of a bracket's longest": (
        lambda x: ([], (shot(), look(FLAT * 2.0 * x, dark=0.998)), [shot(seconds=0.08)]), "black", 0.0013, 0.0012,
        "cap on the lens",
    ),
    "black where a few pixels are lit": (
        lambda x: ([], (shot(), look(FLAT * 0.004, dark=x))), "black", 0.9965, 0.9975, "cap on the lens",
    ),
    "beside the white reference": (
        lambda x: ([(WHITE, look(FLAT))], (shot(seconds=0.04), look(PAINTS * 2.0 * x))), "dim", 0.0105, 0.0095,
        "0.9% as bright as the white",
    ),
    "beside the darkest of its kind": (
        lambda x: (
            [(OUT, look()), (shot(camera=20.0, seconds=0.04), look(PAINTS))], (shot(), look(PAINTS * 0.5 * x)),
        ), "dim", 0.105, 0.095, "9.5% as bright as the darkest",
    ),
    "a dark chart": (
        lambda x: ([(WHITE, look(FLAT))], (shot("chart"), look(PAINTS * x))), "chart", 0.41, 0.39, "0.39 of the white",
    ),
    "a bright chart": (
        lambda x: ([(WHITE, look(FLAT))], (shot("chart", seconds=0.01), look(PAINTS * x / 2.0))), "chart", 1.29, 1.31,
        "1.31 of the white",
    ),
    "a view again, brighter": (
        lambda x: ([*PAIR], (DRIFT, look(PAINTS * x))), "light changed", 1.075, 1.09, "+9% against object-45-0-out",
    ),
    "a view again, darker": (
        lambda x: ([*PAIR], (DRIFT, look(PAINTS / [1.0, x, 1.0]))), "light changed", 1.075, 1.085,
        "the 2 photographs before it",
    ),
    "a pair's filter, more": (
        lambda x: ([*PAIR, (shot(), look(paints(2)))], (shot(state="in"), look(paints(2) * FILTER * x))),
        "light changed", 1.24, 1.26, "passes 1.26 times",
    ),
    "a pair's filter, less, the filter first": (
        lambda x: (
            [*PAIR, (shot(state="in", seconds=0.04), look(paints(2) * FILTER))], (shot(), look(paints(2) * x / 2.0)),
        ), "light changed", 1.24, 1.26, "passes 0.79 times",
    ),
    "no filter": (
        lambda x: ([(OUT, look())], (IN, look(PAINTS * np.array([1.0, 0.9, x])))), "filter", 0.79, 0.81,
        "as with the filter out: is it in",
    ),
    "a filter that adds light": (
        lambda x: ([(OUT, look())], (IN, look(PAINTS * [0.5, x, 0.5]))), "filter", 1.24, 1.26, "1.3 times as bright",
    ),
    "the colour of the other state": (
        lambda x: ([*PAIR], (shot(), look(0.8 * PAINTS * FILTER**x))), "filter", 0.55, 0.7, "with the filter in",
    ),
    "the colour of the other state, with the filter": (
        lambda x: ([*PAIR], (shot(state="in"), look(0.8 * PAINTS * FILTER**x))), "filter", 0.45, 0.3,
        "with the filter out: is it in",
    ),
    "a light room": (
        lambda x: ([(shot(camera=20.0), look(0.9 * PAINTS))], (shot(), look(background(x)))), "light changed",
        0.029, 0.031, "background is at 3.1% of the brightest, at 0.8% before",
    ),
    "a light room from the start": (
        lambda x: (
            [(shot(camera=20.0), look(0.9 * background(0.04))), (shot(camera=30.0), look(0.9 * PAINTS))],
            (shot(), look(background(x))),
        ), "light changed", 0.079, 0.081, "background is at 8.1%",
    ),
    "out of focus": (
        lambda x: (
            [(shot(camera=c), look(paints(int(c)), sharpness=s)) for c, s in ((20.0, 0.7), (30.0, 0.5), (40.0, 0.3))],
            (shot(), look(sharpness=x)),
        ), "defocus", 0.28, 0.27, "54% as steep",
    ),
    "out of focus beside the sharpest": (
        lambda x: ([(shot(camera=20.0), look(paints(2), sharpness=1.0))], (shot(), look(sharpness=x))),
        "defocus", 0.45, 0.43, "43% as steep",
    ),
    "out of focus, where the other photograph of the pose is softer than those of other poses": (
        lambda x: ([(shot(camera=20.0), look(paints(2), sharpness=0.8)), (OUT, look(sharpness=0.4))],
                   (IN, look(0.5 * PAINTS, sharpness=x))), "defocus", 0.23, 0.21, "52% as steep",
    ),
    "moved, the same view": (
        lambda x: ([*PAIR], (DRIFT, look(moved(PAINTS, 0.0, x / SIDE)))), "moved", 3.4, 4.2, "4 superpixels beside",
    ),
    "moved, the first pair": (
        lambda x: ([(OUT, look())], (IN, look(moved(PAINTS, x / SIDE, 0.0) * FILTER))), "moved", 8.0, 12.0,
        "superpixels beside object-45-0-out",
    ),
    "moved, beyond what the plate does": (
        lambda x: (
            [(OUT, look()), (IN, look(moved(PAINTS, -1.0, 0.0) * FILTER)), (shot(), look(paints(2)))],
            (shot(state="in"), look(moved(paints(2), -1.0 - x / SIDE, 0.0) * FILTER)),
        ), "moved", 3.2, 4.4, "superpixels beside object-45-10-out",
    ),
    "moved, the first pair of small pictures": (
        lambda x: (
            [(OUT, look(size=(240, 160)))], (IN, look(moved(PAINTS, x / 2.0, 0.0) * FILTER, size=(240, 160))),
        ), "moved", 3.0, 4.0, "4 superpixels beside",
    ),
    "dim, with the camera nearly at grazing angles": (
        lambda x: ([PAIR[0]], (shot(camera=70.0, tilt=x), look(PAINTS * 0.02))), "dim", 11.0, 9.0, "2.0% as bright",
    ),
    "dim, with the light nearly at grazing angles": (
        lambda x: ([PAIR[0]], (shot(light=85.0, tilt=x), look(PAINTS * 0.02))), "dim", 4.0, 6.0, "2.0% as bright",
    ),
    "the colour of the other state in a few blocks": (
        lambda x: ([(OUT, look(FLAT)), (IN, look(FLAT * FILTER))], (shot(), look(few(x)))), "filter", 15, 16,
        "colours of photographs with the filter in",
    ),
    "another size": (
        lambda x: ([(WHITE, look())], (shot(), look(PAINTS * 0.9, size=(960, 640 + x)))), "size", 0, 2, "960 x 642",
    ),
    "another lens": (
        lambda x: ([(WHITE, look(lens="f50"))], (shot(), look(PAINTS * 0.9, lens=x))), "lens", "", "f35", "'f35'",
    ),
    "another body": (
        lambda x: ([(WHITE, look(camera="a"))], (shot(), look(PAINTS * 0.9, camera=x))), "body", "a", "b", "with 'b'",
    ),
    "delivered twice": (
        lambda x: ([(WHITE, look())], (shot(), look(PAINTS * x))), "identical", 0.9, 1.0, "very picture of white-",
    ),
}  # fmt: skip


def few(blocks: int) -> np.ndarray:
    """Return a small black picture of which some blocks have the colour of a white plate behind the filter."""
    picture = np.zeros((20, 30, 3))
    picture.reshape(-1, 3)[100 : 100 + blocks] = FILTER
    return picture


def moved(picture, right, down) -> np.ndarray:
    """Return a picture moved by parts of its blocks, linear between them; it goes on at the other side."""
    y, x = np.indices(picture.shape[:2])
    out = np.zeros_like(picture)
    for dy in (0, 1):
        for dx in (0, 1):
            row, column = math.floor(down) + dy, math.floor(right) + dx
            share = (1.0 - abs(down - row)) * (1.0 - abs(right - column))
            out += share * picture[(y - row) % len(picture), (x - column) % picture.shape[1]]
    return out


@pytest.mark.parametrize("name", LIMITS)
def test_a_figure_within_its_limit_passes_and_one_beyond_is_said(name):
    case, kind, sound, unsound, words = LIMITS[name]
    assert doubts(*case(sound)) == []
    (found,) = doubts(*case(unsound))
    assert found.kind == kind and words in found.words
    # Only a frame that repeats a view says which photographs its finding concerns.
    assert "in doubt" not in found.words or case(unsound)[1][0].role == "drift"


def test_the_second_of_two_drift_frames_in_a_row_puts_nothing_in_doubt():
    first = replace(DRIFT, file="first.dng")
    (found,) = doubts([*PAIR, (first, look(PAINTS * 1.01))], (DRIFT, look(PAINTS * 1.2)))
    assert found.kind == "light changed" and "in doubt" not in found.words


@pytest.mark.parametrize(
    ("known", "asked"),
    [
        ([], (shot(seconds=0.08), look(clipped=0.9))),  # a shorter one of the bracket is planned
        ([], (shot(seconds=20.0), look(PAINTS * 0.2))),  # no white reference to be held against
        ([], (shot("chart", seconds=20.0), look(PAINTS * 0.2))),
        ([(WHITE, look())], (shot("environment"), look(PAINTS * 0.9, size=(2000, 1000)))),
        ([PAIR[0]], (shot(camera=20.0), look(background(0.5), clipped=0.01))),  # highlights that clip
        ([(OUT, look(sharpness=math.nan))], (shot(), look(paints(3), sharpness=0.1))),
        ([*PAIR], (DRIFT, look(moved(PAINTS, 2.0, 0.0), sharpness=math.nan))),
        ([*PAIR], (DRIFT, look(PAINTS * 2.0, whole=np.zeros((40, 60), bool)))),
        ([*PAIR], (DRIFT, look(moved(paints(), 0.0, 0.0)[:20] * 2.0))),
    ],
)
def test_what_cannot_be_told_is_not_doubted(known, asked):
    planned = [shot(), shot(seconds=0.02)] if asked[0].exposure_s == 0.08 else []
    assert [one.kind for one in doubts(known, asked, planned)] == []


@pytest.mark.parametrize(
    ("shift", "within_px"),
    # A shift by parts of a block spreads a contour over two, which draws the peak towards the whole ones.
    [((3.0, -2.0), 0.4), ((-4.0, 5.0), 0.4), ((0.5, 0.0), 0.4), ((-1.5, -0.5), 0.4), ((0.25, 0.0), 1.2),
     ((0.0, -0.25), 1.2), ((29.0, 19.0), 0.4), ((0.0, 0.0), 0.01)],
)  # fmt: skip
def test_a_drift_frame_tells_light_and_shift_of_the_first_photograph_of_its_view(shift, within_px):
    series, ground = Series([OUT, IN, DRIFT]), np.indices((40, 60))[0, ..., None]
    # Of the ground a part is unlit by its green, and a part is lit by little.
    before = np.where(ground < 2, [0.3, 0.009, 0.3], np.where(ground < 4, [0.011, 0.012, 0.011], PAINTS))
    for one, seen in ((OUT, look(before)), PAIR[1], (shot(), look(paints(3)))):
        series.add(one, seen)
    frame, after = replace(DRIFT, exposure_s=0.04), moved(before, *shift) * [0.95, 0.91234, 0.8]
    found = series.drift(frame, look(after * 2.0))
    assert found.shift_px == pytest.approx(SIDE * math.hypot(*shift), abs=within_px)
    assert (found.file, found.repeats) == (frame.file, OUT.file)
    common = (before[..., 1] > 0.01) & (after[..., 1] > 0.0)
    assert found.light == pytest.approx(after[common, 1].sum() / before[common, 1].sum(), rel=1e-5)
    assert found.plain() == {"file": frame.file, "repeats": OUT.file, "light": round(found.light, 4),
                             "shift_px": round(found.shift_px, 2)}  # fmt: skip
    assert str(found).endswith(f"{found.light - 1.0:+.1%} against {OUT.file}, contours {found.shift_px:.1f} "
                               "superpixels aside")  # fmt: skip
    assert series.drift(shot(camera=0.0), look()) is None
    assert series.drift(shot("drift", camera=33.0), look()) is None
    blurred = series.drift(frame, look(sharpness=math.nan))
    assert blurred.plain()["shift_px"] is None and "aside" not in str(blurred)
    # Light is compared where at least sixteen blocks are lit and whole in both.
    whole = np.arange(2400).reshape(40, 60) - 12 * 60 - 12
    for blocks in (15, 16):
        some = series.drift(frame, look(whole=(whole >= 0) & (whole < blocks)))
        assert (some is None) == (blocks == 15)
    assert series.drift(frame, look(0.0 * PAINTS)) is None


BLACK = np.array([[2000, 2010], [2020, 2030]], np.float32)
WHITE_DN = np.array([[16000, 16100], [16200, 16000]], np.float32)


def mosaic(shares, pattern="RGGB", focal_mm=0.0) -> Mosaic:
    """Return a mosaic of superpixels (rows, columns, 3), parts of the range from each place's own black to white."""
    shares, values = np.asarray(shares), np.zeros([2 * side for side in np.shape(shares)[:2]])
    for at, letter in enumerate(pattern):
        row, column = divmod(at, 2)
        black, white = BLACK[row, column], WHITE_DN[row, column]
        values[row::2, column::2] = black + shares[..., "RGB".index(letter)] * (white - black)
    return Mosaic(np.rint(values).astype(np.uint16), pattern, BLACK, WHITE_DN, 14070.0, 0.02, 0.0, 0.0, 0, focal_mm)


@pytest.fixture
def silent(tmp_path):
    """A file without tags."""
    (tmp_path / "a.raw").write_bytes(b"no TIFF")
    return tmp_path / "a.raw"


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG"])
def test_a_look_shows_means_of_blocks_what_clips_and_what_is_dark(silent, pattern):
    rng = np.random.default_rng(3)
    shares = rng.uniform(0.05, 0.9, (141, 135, 3))
    shares[20:40, 30:50, 2] = 0.9955  # of a block some clip
    shares[100:120, 100:120] = rng.uniform(0.0, 0.019, (20, 20, 3))
    shares[110, 110, 0], shares[111, 112, 1] = 0.021, 0.994
    seen = look_at(silent, mosaic(shares, pattern, 50.0), thumbnail=True)
    side = 2  # 135 superpixels in 64 to 127 columns
    blocks = shares[:140, :134].reshape(70, side, 67, side, 3)
    range_dn = WHITE_DN - BLACK
    gain = [np.mean([range_dn.flat[i] for i in range(4) if pattern[i] == letter]) / 14070.0 for letter in "RGB"]
    np.testing.assert_allclose(seen.picture, blocks.mean(axis=(1, 3)) * gain, atol=1e-4)
    clipped = (shares > 0.995).any(axis=2)
    assert seen.clipped == pytest.approx(clipped.mean()) and seen.dark == pytest.approx(398 / clipped.size)
    assert np.array_equal(seen.whole, ~clipped[:140, :134].reshape(70, side, 67, side).any(axis=(1, 3)))
    assert seen.size == (270, 282) and seen.focal_mm == 50.0 and seen.is_thumbnail and 0.5 < seen.sharpness < 1.0
    assert seen.level == pytest.approx(np.percentile(seen.picture.max(axis=2), 99.0))
    green = seen.picture[..., 1]
    assert seen.background == pytest.approx(np.percentile(green, 10.0) / np.percentile(green, 99.0))
    # Colour is the ratios of bands where all are lit: half as much red shifts its five figures, and those alone.
    shift = look_at(silent, mosaic(shares * [0.5, 1.0, 1.0], pattern), thumbnail=True).colour - seen.colour
    assert shift[1::2] == pytest.approx(0.0, abs=0.03) and shift[::2] == pytest.approx(-math.log(2) / 5**0.5, abs=0.03)
    assert (seen.camera, seen.lens, seen.time) == ("", "", "")
    other = mosaic(0.5 * shares, pattern)
    assert seen.pixels != look_at(silent, other, thumbnail=True).pixels == look_at(silent, other).pixels


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("wide_px", [1, 2, 3, 4])
def test_sharpness_is_the_part_of_a_contour_that_lies_within_one_superpixel(silent, turned, wide_px):
    ramp = np.clip((np.arange(60) - 30) / wide_px, 0.0, 1.0) * 0.6 + 0.2
    shares = np.broadcast_to(ramp[:, None, None], (60, 70, 3))
    seen = look_at(silent, mosaic(shares.swapaxes(0, 1) if turned else shares))
    assert seen.sharpness == pytest.approx(1.0 / wide_px, abs=0.01)


def test_the_soft_flanks_of_a_bright_highlight_do_not_make_a_sharp_outline_soft(silent):
    y, x = np.mgrid[-60:60, -80:80]
    outline, highlight = 0.1 * (np.hypot(x, y) < 40.0), 0.8 * np.exp(-(x**2 + y**2) / (2.0 * 5.0**2))
    sharp, blurred = (
        look_at(silent, mosaic((contour + highlight)[..., None].repeat(3, axis=2))).sharpness
        for contour in (outline, gaussian_filter(outline, 2.0))
    )
    assert sharp > 0.9 and blurred < 0.4


@pytest.mark.parametrize(("step", "known"), [(0.1, False), (0.2, True)])
def test_without_a_step_of_a_quarter_of_the_brightest_no_sharpness_is_known(silent, step, known):
    shares = np.full((60, 70, 3), 0.6)
    shares[:30] -= step
    assert math.isfinite(look_at(silent, mosaic(shares)).sharpness) == known
    assert math.isnan(look_at(silent, mosaic(np.full((4, 4, 3), 0.5))).sharpness)


def edges(places, level=0.3) -> list[np.ndarray]:
    """Return pictures (60, 90, 3) of a lit edge of a ball, 1.6 blocks wide, at some places (blocks from the middle)."""
    rows, columns = np.mgrid[-30:30, -45:45].astype(float)
    beside = [np.hypot(rows, columns - at) - 20.0 for at in places]
    lit = [np.exp(-((by / 0.7) ** 2) / 2.0) * (columns > at + 12.0) for by, at in zip(beside, places, strict=True)]
    return [level * one[..., None].repeat(3, axis=2) for one in lit]


@pytest.mark.parametrize("exchanged", [False, True])
def test_a_lit_edge_narrower_than_the_shift_by_the_filter_still_tells_its_pose(exchanged):
    """Poses lie half a block apart and the filter shifts by 0.6: each filtered view covers most of the next pose's."""
    places = 0.5 * np.arange(6)
    out, through = edges(places), [one * FILTER for one in edges(places + 0.6)]
    if exchanged:
        through[1], through[4] = through[4], through[1]
    pairs = [
        {"out": (Path(f"{n}-out"), look(a)), "in": (Path(f"{n}-in"), look(b))}
        for n, (a, b) in enumerate(zip(out, through, strict=True))
    ]
    assert _unlikeness(pairs[0]["in"][1], pairs[1]["out"][1]) < 0.1 * _unlikeness(pairs[0]["in"][1], pairs[0]["out"][1])
    assert [one.path.name for one in _of_other_poses(pairs)] == (["1-in", "4-in"] if exchanged else [])


def test_the_light_of_a_narrow_lit_edge_is_compared_with_all_of_it():
    """The filter shifts the edge by more than its half width: a third of what is lit without it is dark with it."""
    pictures = edges([0.0, 0.0, 0.0, 0.9], 0.03)
    shots = [shot(camera=c, state=s) for c in (10.0, 20.0) for s in ("out", "in")]
    views = [look(a * by, sharpness=math.nan) for a, by in zip(pictures, (1.0, FILTER, 1.0, FILTER), strict=True)]
    *known, last = zip(shots, views, strict=True)
    assert not doubts(known, last)
    darker = look(pictures[3] * FILTER * 0.75, sharpness=math.nan)
    assert [one.kind for one in doubts(known, (shots[3], darker))] == ["light changed"]


def test_the_lamp_changes_all_bands_and_another_paint_one():
    known = [*PAIR, (shot(camera=20.0), look(paints(2)))]
    for change, kinds in (([1.0, 1.3, 1.0], []), ([0.7, 1.3, 1.4], []), ([1.3, 1.3, 1.3], ["light changed"])):
        seen = look(paints(2) * FILTER * change)
        assert [one.kind for one in doubts(known, (shot(camera=20.0, state="in"), seen))] == kinds


@pytest.mark.parametrize(("by", "kinds"), [(0.0, []), (12.0, ["moved"])])
def test_where_less_than_a_hundredth_is_lit_noise_is_no_contour(by, kinds):
    before, after = (np.random.default_rng(seed).normal(0.0, 3e-4, (60, 90, 3)) for seed in (1, 2))
    before[20:24, 40:44], after[20:24, 40 + int(by) : 44 + int(by)] = 0.3, 0.2
    assert [one.kind for one in doubts([(OUT, look(before))], (IN, look(after)))] == kinds


def test_thumbnails_tell_whether_a_picture_is_sharp_and_not_whether_something_moved():
    shots = [(OUT, look(is_thumbnail=True)), (IN, look(moved(PAINTS, 3.0, 0.0) * FILTER, is_thumbnail=True))]
    assert not doubts(shots[:1], shots[1])
    assert [one.kind for one in doubts([(OUT, look())], (IN, look(moved(PAINTS, 3.0, 0.0) * FILTER)))] == ["moved"]
    soft = look(paints(3), sharpness=0.3, is_thumbnail=True)
    assert [one.kind for one in doubts(shots[:1], (shot(camera=20.0), soft))] == ["defocus"]


def test_what_is_recalled_is_the_first_of_each_kind_and_what_is_open():
    kept = [shot(camera=c, state=state) for c in range(6) for state in ("out", "in")]
    frame = shot("drift", camera=4.0)
    assert worth_recalling(kept, []) == kept[:6]
    assert worth_recalling(kept, [shot(camera=5.0)]) == [*kept[:6], *kept[10:]]
    assert worth_recalling([*kept, frame], []) == [*kept[:6], *kept[8:10], frame]


def test_what_is_taken_again_is_forgotten():
    series = Series([OUT, IN])
    for one, seen in PAIR:
        series.add(one, seen)
    assert [one.kind for one in series.doubts(IN, PAIR[1][1])] == ["identical"]
    assert series.doubts(DRIFT, look(PAINTS * 0.5))
    series.forget(IN)
    series.add(IN, look(PAINTS * FILTER * 1.7))
    # The pair's first transmittance is forgotten with it.
    series.add(shot(), look(paints(2)))
    assert not series.doubts(shot(state="in"), look(paints(2) * FILTER * 1.7))


@pytest.mark.parametrize(
    ("found_mm", "sound"), [(0.0, True), (50.0, True), (57.4, True), (57.6, False), (38.7, True), (38.5, False)]
)
def test_a_lens_states_what_the_definition_says_within_focus_and_rounding(found_mm, sound):
    """50 mm from the sensor at 550 mm from the subject: in focus a lens of 45 mm; and 15 % on both sides."""
    doubt = FocalRange.of(50.0, 550.0).doubt(found_mm)
    assert (doubt is None) == sound
    # Nearer than its own length there is no subject.
    assert FocalRange.of(50.0, 60.0).least_mm == pytest.approx(50.0 * 0.85 / 2.0)


def seen_set(shares, tmp_path, planned, focal_mm=48.0) -> SetLook:
    """Look at a set of pictures (rows, columns, 3), each of a shot."""
    seen = SetLook(planned, FocalRange.of(50.0, 1000.0))
    for one in seen.shots:
        path = tmp_path / one.file
        path.write_bytes(b"no TIFF")
        seen.see(one, path, mosaic(shares[planned.index(one)].repeat(2, axis=0).repeat(2, axis=1), focal_mm=focal_mm))
    return seen


def test_pictures_are_as_unlike_as_they_do_not_correlate_over_what_is_whole_in_both():
    rng = np.random.default_rng(2)
    a, b = rng.uniform(0.0, 1.0, (2, 40, 60))
    one, other = (look(np.stack([0.0 * green, green, 0.0 * green], axis=2)) for green in (a, 0.5 * a + 0.2 * b))
    assert _unlikeness(one, other) == pytest.approx(1.0 - np.corrcoef(a.ravel(), (0.5 * a + 0.2 * b).ravel())[0, 1])
    assert _unlikeness(one, look(3.0 * one.picture + 0.1)) == pytest.approx(0.0, abs=1e-6)
    assert _unlikeness(one, look(np.full((40, 60, 3), 0.5))) == 1.0
    for blocks in (63, 64):
        whole = (np.arange(2400) < blocks).reshape(40, 60)
        some = replace(other, whole=whole)
        expected = 1.0 - np.corrcoef(one.picture[..., 1][whole], other.picture[..., 1][whole])[0, 1]
        assert _unlikeness(one, some) == pytest.approx(1.0 if blocks == 63 else expected)


COUNT = 18  # poses, one more than how far a slip of names is looked for


@pytest.mark.parametrize(
    "mistake",
    ["none", "shifted", "accepted", "16 apart", "17 apart", "a blown one", "a dim one", "in weak light",
     "a chart of other paints", "another size"],
)  # fmt: skip
def test_photographs_with_the_filter_that_show_other_poses_are_named(tmp_path, mistake):
    planned = [shot(camera=float(c), state=s, file=f"{c}-{s}.dng") for s in ("out", "in") for c in range(COUNT)]
    scenes = [paints(seed)[::2, ::2] for seed in range(COUNT)]
    through, wrong, others = [scene * FILTER for scene in scenes], [], []
    if mistake == "shifted":
        through[4:8], wrong = [through[i] for i in (5, 6, 7, 4)], [4, 5, 6, 7]
        through[12], others = through[12] * 1.5, [("12-in.dng", "light changed")]
    elif mistake == "accepted":
        through[4], through[5] = through[5], through[4]
        planned[COUNT + 4] = replace(planned[COUNT + 4], taken=Taken(accepted="so it is"))
        others = [("5-in.dng", "light changed"), ("5-in.dng", "moved")]
    elif mistake == "in weak light":
        through[4], through[5] = through[5], through[4]
        scenes, through, wrong = [0.2 * scene for scene in scenes], [0.2 * scene for scene in through], [4, 5]
    elif mistake == "a chart of other paints":
        # What is no object's pose is no measure of poses.
        planned += [shot("chart", state=state, file=f"chart-{state}.dng") for state in ("out", "in")]
        through += [0.97 * scenes[3], 0.97 * scenes[17] * FILTER]
    elif mistake == "another size":
        through[4], through[5] = through[5], through[4][:, :24]
    elif mistake.endswith("apart"):
        other = int(mistake.split()[0])
        through[0], through[other] = through[other], through[0]
        wrong = [0, 16] if other == 16 else []
    elif mistake in ("a blown one", "a dim one"):
        # Another exposure, which clips or is dark, shows the next pose: the one that shows most counts.
        times = 0.04 if mistake == "a blown one" else 0.01
        for c in (6, 7):
            planned.append(shot(camera=float(c), seconds=times, file=f"{c}-other.dng"))
            through.append(np.minimum(scenes[13 - c] * times / 0.02, 1.0))
            if times == 0.04:
                through[-1][6:8, 8:18] = 1.0
    seen = seen_set([*scenes, *through], tmp_path, planned)
    found = seen.doubted()
    assert [one.path.name for one in found if one.doubt.kind == "order"] == [f"{i}-in.dng" for i in wrong]
    told = {(one.path.name, one.doubt.kind) for one in found if one.doubt.kind != "order"}
    assert mistake not in ("none", "shifted") or told == set(others)
    if mistake == "shifted":
        words = r"order: found it shows what 5-out.dng shows, and not what 4-out.dng does.*3 more .*\(5-in.dng, 6-in"
        with pytest.raises(InputError, match=words):
            seen.refuse("captures.csv")
    elif mistake != "another size":  # which is refused on its own
        assert wrong or seen.refuse("captures.csv") == found


def test_a_set_is_held_against_the_lens_and_the_white_reference_of_its_camera(tmp_path):
    planned, flat = [shot("white"), shot("white", camera=0.0), shot("white", camera=1.0)], FLAT[::2, ::2]
    whites = seen_set([flat, flat * 2.0, flat * 0.99], tmp_path, planned)
    assert [one.doubt.kind for one in whites.doubted()] == ["blown"]
    assert [one.file for one, _ in whites.whites] == [planned[0].file, planned[2].file]
    (tmp_path / "a.dng").write_bytes(b"no TIFF")
    for level, kinds in ((0.5, []), (0.02, ["dim"])):
        seen, long = SetLook([], whites=whites.whites), shot(seconds=0.5)
        seen.see(long, tmp_path / "a.dng", mosaic(paints()[::2, ::2].repeat(2, axis=0).repeat(2, axis=1) * level))
        assert [one.doubt.kind for one in seen.doubted()] == kinds
    wrong = seen_set([flat], tmp_path, [shot("white")], focal_mm=35.0)
    with pytest.raises(InputError, match=r"focal length: found taken at 35 mm, .*focal_length_mm is 50"):
        wrong.refuse("captures.csv")
    assert not wrong.whites


def test_body_lens_and_clock_are_those_of_the_files_tags(tmp_path):
    path, picture = tmp_path / "a.tif", mosaic(np.full((4, 4, 3), 0.5))
    texts = {271: "Maker", 272: "Body", 36867: "2026:11:23 08:50:00", 42033: "0017", 42036: "f50"}
    for given, camera, lens, time in (
        (texts, "Maker Body 0017", "f50", "2026-11-23T08:50:00"),
        (texts | {37521: "07"}, "Maker Body 0017", "f50", "2026-11-23T08:50:00.07"),
        (texts | {37521: "  "}, "Maker Body 0017", "f50", "2026-11-23T08:50:00"),
        ({271: "Body", 272: "Body", 36867: "2026:11:23"}, "Body", "", ""),
        ({271: "Body", 36867: "0000:00:00 00:00:00", 37521: "00"}, "Body", "", ""),
        ({271: "Body", 36867: "    :  :     :  :  "}, "Body", "", ""),
    ):
        tags = [(number, "s", 0, text, True) for number, text in given.items()]
        tifffile.imwrite(path, picture.values, extratags=tags, metadata=None)
        seen = look_at(path, picture, thumbnail=True)
        assert (seen.camera, seen.lens, seen.time) == (camera, lens, time)


@pytest.mark.parametrize(("size", "side"), [((7, 11), 1), ((160, 901), 2)])
def test_a_preview_shows_each_block_what_is_blown_or_dark_and_how_levels_are_spread(size, side):
    # Slow waves, which a compressed picture keeps.
    y, x = np.indices(size)
    shares = np.stack([0.5 + 0.4 * np.sin(x / 60.0 + y / 40.0 + band) for band in range(3)], axis=-1)
    shares[:4, :4], shares[4:6, 4:8] = 0.01, 0.0
    shares[4, 4, 1], shares[4, 6, 0], shares[-1, 2, 2] = 0.021, 0.019, 0.996
    shares[6, :2] = 1.02  # above what the file calls white
    picture = mosaic(shares, "GRBG")
    seen, (rows, columns) = preview_of(picture), (size[0] // side, size[1] // side)
    blocks = shares[: rows * side, : columns * side].reshape(rows, side, columns, side, 3)
    jpeg = np.asarray(Image.open(io.BytesIO(seen.jpeg)).convert("RGB"), float)
    expected = 255.0 * SRGB.code(blocks.mean(axis=(1, 3)))
    assert jpeg.shape == (rows, columns, 3) and np.median(np.abs(jpeg - expected)) < 4.0
    overlay = np.asarray(Image.open(io.BytesIO(seen.overlay)).convert("RGBA"))
    most = blocks.max(axis=(1, 3, 4))
    for where, colour in ((most > 0.995, (255, 40, 40, 200)), (most < 0.02, (40, 90, 255, 130))):
        assert where.any() and (overlay[where] == colour).all()
    assert not overlay[(most >= 0.02) & (most <= 0.995), 3].any()
    thinned = blocks.reshape(rows * side, columns * side, 3)[:: max(1, rows * side // 150)]
    for band in range(3):
        counts = np.histogram(np.minimum(thinned[..., band], 1.0), 64, (0.0, 1.0))[0]
        np.testing.assert_allclose(seen.histogram[band], counts / counts.sum(), atol=0.01)
    lines = seen.sketch().splitlines()
    assert [line[:3] for line in lines] == ["R |", "G |", "B |"] and {len(line) for line in lines} == {36}
    pairs = seen.histogram.reshape(3, 32, 2).sum(axis=2)
    for line, band in zip(lines, pairs, strict=True):
        heights = np.array([" ▁▂▃▄▅▆▇█".index(letter) for letter in line[3:-1]])
        assert ((heights == 0) == (band == 0.0)).all()
        np.testing.assert_allclose(heights, 8.0 * np.sqrt(band / pairs.max()), atol=1.0)
