"""The repeat of a DNG's black levels, found in whatever directory of a TIFF states it."""

import struct

import pytest

from irodori.ingest.dng_levels import black_level_repeats

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
