"""Tags of photographs that are no plain TIFF: JPEG, and RAW files of Canon, Fujifilm, Olympus and Panasonic."""

import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raw_studio import ROOT
from test_dng_levels import directory, entry, head

from irodori.ingest.embedded_tiffs import embedded_tiffs
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.plausibility import camera_time, look_at
from irodori.ingest.tiff_tags import read_tags

RAW = ROOT.parent / "shared" / "data" / "raw"
MAKER, MODEL, TIME, SERIAL = 271, 272, 36867, 42033
OF_PICTURE, OF_EXPOSURE = {MAKER: "Maker", MODEL: "Body"}, {TIME: "2026:11:23 08:50:00", SERIAL: "0017"}
CANON = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")


def tiff(texts: dict, order: str = "<") -> bytes:
    """Return a TIFF with one directory of texts."""
    values = [text.encode() + b"\0" for text in texts.values()]
    places = np.cumsum([8 + 2 + 12 * len(texts) + 4] + [len(value) for value in values])
    entries = [
        entry(order, tag, 2, len(value), struct.pack(order + "I", place) if len(value) > 4 else value)
        for tag, value, place in zip(texts, values, places[:-1], strict=True)
    ]
    return head(order) + directory(order, *entries) + b"".join(values)


def box(kind: bytes, content: bytes, form: str = "short") -> bytes:
    """Return a box of an ISO base media file, its size in four or eight bytes, or that of the rest of the file."""
    if form == "long":
        return struct.pack(">I4sQ", 1, kind, len(content) + 16) + content
    return struct.pack(">I4s", 0 if form == "rest" else len(content) + 8, kind) + content


def cr3(*forms: str, order: str = "<") -> bytes:
    of_movie, of_canon = forms or ("short", "short")
    parts = box(b"CNCV", b"CanonCR3_001") + box(b"CMT1", tiff(OF_PICTURE, order)) + box(b"CMT2", tiff(OF_EXPOSURE))
    canon = box(b"uuid", CANON + parts + box(b"CMT3", tiff({TIME: "of the maker's notes"})), of_canon)
    other = box(b"uuid", bytes(16) + box(b"CMT2", tiff({TIME: "of another box"})))
    movie = box(b"moov", other + canon, of_movie)
    return box(b"ftyp", b"crx \0\0\0\1crx isom") + movie + (b"" if of_movie == "rest" else box(b"mdat", bytes(99)))


def jpeg(order: str = "<", before: bytes = b"") -> bytes:
    exif = b"Exif\0\0" + tiff(OF_PICTURE | OF_EXPOSURE, order)
    other = b"http://ns.adobe.com/xap/1.0/\0"
    segments = b"".join(struct.pack(">HH", 0xFFE1, len(part) + 2) + part for part in (other, exif))
    return b"\xff\xd8" + before + segments + b"\xff\xda\0\2" + bytes(50) + b"\xff\xd9"


def raf(order: str = "<", before: bytes = b"") -> bytes:
    picture = jpeg(order, before)
    return b"FUJIFILMCCD-RAW 0201FF389501".ljust(84, b"\0") + struct.pack(">II", 100, len(picture)) + bytes(8) + picture


def like_tiff(magic: bytes) -> bytes:
    return magic + tiff(OF_PICTURE | OF_EXPOSURE, ">" if magic[:1] == b"M" else "<")[4:]


WHOLE = {
    "CR3": cr3(), "CR3, long boxes": cr3("long", "long"), "CR3 up to its end": cr3("rest", "short", order=">"),
    "RAF": raf(), "RAF, big-endian": raf(">"), "RAF, JFIF first": raf(before=b"\xff\xe0\0\4ab"),
    "ORF": like_tiff(b"IIRO"), "ORF, old": like_tiff(b"IIRS"), "ORF, big-endian": like_tiff(b"MMOR"),
    "RW2": like_tiff(b"IIU\0"), "JPEG": jpeg(),
    "JPEG with fill bytes": jpeg(before=b"\xff\xff\xff\xe0\0\4ab\xff\xff"),
}  # fmt: skip


@pytest.mark.parametrize("content", WHOLE.values(), ids=WHOLE)
def test_body_and_clock_are_read_from_formats_that_are_no_plain_tiff(tmp_path, content):
    (tmp_path / "a.raw").write_bytes(content)
    seen = look_at(tmp_path / "a.raw", mosaic(), thumbnail=True)
    assert (seen.camera, seen.time) == ("Maker Body 0017", "2026-11-23T08:50:00")


def mosaic() -> Mosaic:
    return Mosaic(
        values=np.full((8, 8), 500, np.uint16),
        pattern="RGGB",
        black=np.zeros((2, 2), np.float32),
        white=np.full((2, 2), 1000.0, np.float32),
        full_scale=1000.0,
        exposure_s=0.1,
        iso=100.0,
        f_number=8.0,
        orientation=0,
        time="2020-01-01T00:00:00",
    )


def test_what_is_no_photograph_has_no_clock(tmp_path):
    for name, content in (
        ("a.txt", b"not at all"),
        ("empty.nef", b""),
        ("cut.nef", b"II*\0"),
        ("a.png", b"\x89PNG\r\n"),
    ):
        (tmp_path / name).write_bytes(content)
        assert camera_time(tmp_path / name) == ""


@pytest.mark.skipif(not RAW.is_dir(), reason="no measured photographs beside the repository")
def test_the_clock_of_a_real_camera_is_read(monkeypatch):
    """CRW has no TIFF tags. It is the camera's time, wherever the computer stands."""
    try:
        for zone in ("UTC", "Europe/Berlin", "America/New_York"):
            monkeypatch.setenv("TZ", zone)
            time.tzset()
            assert camera_time(RAW / "powershot_s40_chart.crw") == "2021-04-08T14:51:12"
    finally:
        monkeypatch.undo()
        time.tzset()


def test_the_clock_of_a_file_without_tags_is_the_one_that_libraw_reads(tmp_path):
    (tmp_path / "a.crw").write_bytes(b"II\x1a\0\0\0HEAPCCDR" + bytes(100))
    assert look_at(tmp_path / "a.crw", mosaic(), thumbnail=True).time == "2020-01-01T00:00:00"
    # LibRaw may take the day when a TIFF was last changed for the day when it was photographed.
    (tmp_path / "a.tif").write_bytes(tiff(OF_PICTURE))
    assert look_at(tmp_path / "a.tif", mosaic(), thumbnail=True).time == ""


@pytest.mark.parametrize("content", [WHOLE["CR3"], WHOLE["CR3, long boxes"], WHOLE["RAF"]], ids=["CR3", "long", "RAF"])
def test_a_file_that_ends_anywhere_has_only_tags_that_it_holds(content, tmp_path):
    known = {**OF_PICTURE, **OF_EXPOSURE}
    counts = []
    for end in range(1, len(content), 3):
        (tmp_path / "a.raw").write_bytes(content[:end])
        found = read_tags(tmp_path / "a.raw", tuple(known))
        # A text that is cut off is shorter.
        assert all(known[tag.number].startswith(str(tag.values[0])) for tag in found)
        counts.append(len(found))
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] == len(known)


@given(st.sampled_from(sorted(WHOLE)), st.data())
def test_damaged_files_are_read_without_an_error_and_in_bounds(name, data):
    content = bytearray(WHOLE[name])
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.sampled_from([0, 1, 8, 127, 255]))
    found = list(embedded_tiffs(bytes(content)))
    assert len(found) <= 64**3 and all(len(part) <= len(content) for part, _ in found)


def test_boxes_and_segments_that_never_end_are_left_after_64():
    empty = box(b"free", b"")
    inner = cr3().partition(box(b"ftyp", b"crx \0\0\0\1crx isom"))[2]
    begun = box(b"ftyp", b"crx \0\0\0\1crx isom")
    assert len(list(embedded_tiffs(begun + 62 * empty + inner))) == 2
    assert not list(embedded_tiffs(begun + 63 * empty + inner))
    segment = b"\xff\xe0\0\2"
    assert len(list(embedded_tiffs(raf(before=62 * segment)))) == 1
    assert not list(embedded_tiffs(raf(before=63 * segment)))
