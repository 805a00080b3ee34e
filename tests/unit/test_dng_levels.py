"""The repeat of a DNG's black levels, found in whatever directory of a TIFF states it."""

import struct

import pytest

from irodori.ingest.dng_levels import black_level_repeats
from irodori.ingest.tiff_tags import Tag, read_tags

SHORT, LONG, IFD = 3, 4, 13
REPEAT, CHILDREN = 50713, 330


def entry(order: str, tag: int, kind: int, count: int, value: bytes) -> bytes:
    return struct.pack(order + "HHI", tag, kind, count) + value.ljust(4, b"\0")


def repeat(order: str, rows: int, columns: int, kind: int = SHORT, count: int = 2) -> bytes:
    return entry(order, REPEAT, kind, count, struct.pack(order + "HH", rows, columns))


def directory(order: str, *entries: bytes, following: int | None = 0) -> bytes:
    """Return a directory; without ``following`` the file ends with the last entry."""
    end = b"" if following is None else struct.pack(order + "I", following)
    return struct.pack(order + "H", len(entries)) + b"".join(entries) + end


def found(tmp_path, content: bytes) -> list:
    (tmp_path / "a.dng").write_bytes(content)
    return sorted(black_level_repeats(tmp_path / "a.dng"))


@pytest.fixture(params=["<", ">"])
def order(request):
    return request.param


def head(order: str, first: int = 8) -> bytes:
    return (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", first)


def test_a_repeat_stands_among_other_entries(tmp_path, order):
    other = entry(order, 256, LONG, 1, struct.pack(order + "I", 7))
    content = head(order) + directory(order, other, repeat(order, 2, 3), other)
    assert found(tmp_path, content) == [(2, 3)]
    assert found(tmp_path, head(order, 11) + b"xyz" + directory(order, repeat(order, 6, 1))) == [(6, 1)]
    assert found(tmp_path, head(order) + directory(order, other)) == []


@pytest.mark.parametrize(("kind", "count"), [(LONG, 2), (SHORT, 1), (SHORT, 3)])
def test_a_repeat_of_another_kind_is_none(tmp_path, order, kind, count):
    assert found(tmp_path, head(order) + directory(order, repeat(order, 2, 2, kind, count))) == []


def test_directories_that_follow_each_other_are_all_read(tmp_path, order):
    first = directory(order, repeat(order, 1, 2), following=40)
    content = (head(order) + first).ljust(40, b"\0") + directory(order, repeat(order, 3, 4))
    assert found(tmp_path, content) == [(1, 2), (3, 4)]


@pytest.mark.parametrize("kind", [LONG, IFD])
def test_directories_within_a_directory_are_read(tmp_path, order, kind):
    child = directory(order, repeat(order, 3, 3))
    inline = entry(order, CHILDREN, kind, 1, struct.pack(order + "I", 40))
    content = (head(order) + directory(order, inline)).ljust(40, b"\0") + child
    assert found(tmp_path, content) == [(3, 3)]
    # Two of them are listed elsewhere.
    listed = entry(order, CHILDREN, kind, 2, struct.pack(order + "I", 40))
    places = struct.pack(order + "II", 100, 200)
    beyond = directory(order, listed, following=2**32 - 1)
    content = ((head(order) + beyond).ljust(40, b"\0") + places).ljust(100, b"\0") + child
    assert found(tmp_path, content.ljust(200, b"\0") + directory(order, repeat(order, 4, 4))) == [(3, 3), (4, 4)]
    # A place that is written in two bytes is none.
    short = entry(order, CHILDREN, SHORT, 1, struct.pack(order + "H", 40))
    assert found(tmp_path, (head(order) + directory(order, short)).ljust(40, b"\0") + child) == []


@pytest.mark.parametrize("count", [0, 65])
def test_more_directories_than_a_dng_has_are_left_alone(tmp_path, order, count):
    places = struct.pack(order + "I", 600) * count
    listed = entry(order, CHILDREN, LONG, count, struct.pack(order + "I", 40))
    content = ((head(order) + directory(order, listed)).ljust(40, b"\0") + places).ljust(600, b"\0")
    assert found(tmp_path, content + directory(order, repeat(order, 3, 3))) == []


def test_a_file_that_ends_with_its_last_entry_is_read_to_its_end(tmp_path, order):
    content = head(order) + directory(order, repeat(order, 5, 2), following=None)
    assert found(tmp_path, content) == [(5, 2)]
    assert found(tmp_path, content[:-1]) == []
    # What is counted and is not there is left out.
    more = head(order) + struct.pack(order + "H", 9) + content[10:]
    assert found(tmp_path, more) == [(5, 2)]


def test_64_directories_in_a_row_are_read_and_no_more(tmp_path, order):
    size = len(directory(order, repeat(order, 2, 2)))
    content = head(order)
    for number in range(80):
        content += directory(order, repeat(order, 2, number + 1), following=8 + size * (number + 1))
    assert found(tmp_path, content) == [(2, n + 1) for n in range(64)]


ASCII, RATIONAL, EXIF = 2, 5, 34665


def tag_of(tmp_path, order: str, kind: int, count: int, value: bytes, elsewhere: bytes = b"") -> list[Tag]:
    """Return what is read of one tag of an Exif directory; what is elsewhere stands 100 bytes into the file."""
    inner = directory(order, entry(order, 42, kind, count, value), entry(order, 43, SHORT, 1, b"\0\7"))
    outer = directory(order, entry(order, EXIF, LONG, 1, struct.pack(order + "I", 40)))
    content = ((head(order) + outer).ljust(40, b"\0") + inner).ljust(100, b"\0") + elsewhere
    (tmp_path / "a.tif").write_bytes(content)
    return read_tags(tmp_path / "a.tif", (42,))


def test_numbers_and_texts_stand_in_their_entry_where_they_fit_and_elsewhere_if_not(tmp_path, order):
    place = struct.pack(order + "I", 100)
    for kind, letter, values, fits in (
        (SHORT, "H", (7, 65_535), True), (SHORT, "H", (7, 8, 9), False), (LONG, "I", (2**32 - 1,), True),
        (LONG, "I", (1, 2), False), (RATIONAL, "I", (10, 3), False), (RATIONAL, "I", (1, 2, 3, 4), False),
    ):  # fmt: skip
        stored = struct.pack(f"{order}{len(values)}{letter}", *values)
        count = len(values) // 2 if kind == RATIONAL else len(values)
        given = (stored, b"") if fits else (place, stored)
        assert tag_of(tmp_path, order, kind, count, *given) == [Tag(42, kind, values)]
    for text, value in (
        (b"f35\0", "f35"),
        (b"f50\0old", "f50"),
        (b"  Maker  \0", "Maker"),
        (b"na\xefve\0", "na\ufffdve"),
    ):
        given = (text, b"") if len(text) <= 4 else (place, text)
        assert tag_of(tmp_path, order, ASCII, len(text), *given) == [Tag(42, ASCII, (value,))]


def test_what_is_too_long_unknown_or_beyond_the_file_is_no_tag(tmp_path, order):
    place = struct.pack(order + "I", 100)
    for length, is_read in ((256, True), (257, False)):
        assert len(tag_of(tmp_path, order, ASCII, length, place, b"x" * 300)) == is_read
        assert len(tag_of(tmp_path, order, LONG, length // 4 + (not is_read), place, b"x" * 300)) == is_read
        assert len(tag_of(tmp_path, order, RATIONAL, length // 8 + (not is_read), place, b"x" * 300)) == is_read
    assert tag_of(tmp_path, order, ASCII, 0, place, b"x" * 300) == []
    assert tag_of(tmp_path, order, 12, 1, place, b"x" * 300) == []
    assert tag_of(tmp_path, order, LONG, 3, place, b"x" * 12) and not tag_of(tmp_path, order, LONG, 3, place, b"x" * 11)
    for content in (b"", b"II*", b"PK\3\4 no TIFF"):
        (tmp_path / "b.tif").write_bytes(content)
        assert read_tags(tmp_path / "b.tif", (42,)) == []


def test_a_directory_that_leads_back_to_itself_is_read_once(tmp_path, order):
    back = directory(order, repeat(order, 2, 3), following=8)
    assert found(tmp_path, head(order) + back) == [(2, 3)]
