"""Order of photographs by the camera's clock and by the numbers in their names."""

import random
from pathlib import Path

import pytest

from irodori.core.errors import InputError
from irodori.first_project.photograph_order import in_counting_order, in_order

CLOCK, NAMES = "the camera's clock", "their names, because not every file states its time"


def taken(names, start: int = 0, step: int = 20, silent=(), back_at: int | None = None) -> dict[Path, str]:
    """Return times of photographs, in seconds; from the photograph ``back_at`` on, an hour earlier."""
    times = {}
    for at, name in enumerate(names):
        second = start + 7200 + step * at - (3600 if back_at is not None and at >= back_at else 0)
        hour, minute = divmod(second // 60, 60)
        times[Path("raw", name)] = "" if name in silent else f"2026-10-25T{hour:02d}:{minute:02d}:{second % 60:02d}"
    return times


def numbered(first: int, count: int, before: str = "IMG_") -> list[str]:
    """Return names as a camera counts: 0001 after 9999."""
    return [f"{before}{(first - 1 + at) % 9999 + 1:04d}.DNG" for at in range(count)]


def mixed(times: dict[Path, str]) -> dict[Path, str]:
    return dict(random.Random(5).sample(sorted(times.items()), len(times)))


@pytest.mark.parametrize("step", [20, 0], ids=["by the clock", "all in one second"])
@pytest.mark.parametrize("first", [1, 8, 9978, 9999])
def test_clock_and_names_agree_also_where_the_count_begins_again(first, step):
    names = numbered(first, 30)
    paths, order = in_order(mixed(taken(names, step=step)))
    assert [path.name for path in paths] == names and order == CLOCK


@pytest.mark.parametrize("first", [1, 9978])
def test_without_a_clock_the_names_tell_the_order_also_where_the_count_begins_again(first):
    names = numbered(first, 30)
    paths, order = in_order(mixed(taken(names, silent=names)))
    assert [path.name for path in paths] == names and order == NAMES


def test_fractions_of_a_second_are_times():
    parts = zip("cab", ("", ".05", ".5"), strict=True)
    times = {Path("raw", f"{name}.DNG"): f"2026-10-25T02:50:00{part}" for name, part in parts}
    assert [path.stem for path in in_order(mixed(times))[0]] == ["c", "a", "b"]


@pytest.mark.parametrize(("first", "at"), [(1, 22), (9990, 3), (9990, 20)])
def test_a_clock_that_was_set_back_is_refused_with_the_two_files(first, at):
    names = numbered(first, 30)
    times = taken(names, back_at=at)
    with pytest.raises(InputError) as raised:
        in_order(mixed(times))
    said = str(raised.value)
    before, after = (Path("raw", names[n]) for n in (at - 1, at))
    assert said == (
        f"{after}: time: found {times[after]}, before {times[before]} of {before.name}, which by name is the earlier "
        "one; accepted: --order names if the clock was set between them, --order clock if files were renamed."
    )
    assert [path.name for path in in_order(mixed(times), "names")[0]] == names
    found, order = in_order(mixed(times), "clock")
    assert [times[path] for path in found] == sorted(times.values()) and order == f"{CLOCK}, as --order says"


def test_a_clock_set_back_where_the_count_begins_again_is_no_order():
    """Else the smaller numbers, with the earlier times, would come first."""
    with pytest.raises(InputError, match=r"IMG_0001\.DNG: time: .* of IMG_9999\.DNG"):
        in_order(mixed(taken(numbered(9978, 30), back_at=22)))


def test_a_photograph_without_a_time_stands_where_its_name_says():
    names = numbered(9990, 20)
    paths, order = in_order(mixed(taken(names, silent=names[4:5])))
    assert [path.name for path in paths] == names and order == NAMES
    with pytest.raises(InputError, match=r"IMG_9994\.DNG: time: found none; accepted: --order clock where every"):
        in_order(mixed(taken(names, silent=names[4:5])), "clock")


def test_a_photograph_without_a_time_among_names_that_contradict_the_clock_is_refused():
    """Names of another kind tell no place: the chart was photographed before the object."""
    times = taken(["white.DNG", "chart.DNG", "plate1.DNG"], silent=["plate1.DNG"])
    with pytest.raises(InputError, match=r"white\.DNG: time: found .* of chart\.DNG, .* set between them\.$"):
        in_order(times)
    assert [path.stem for path in in_order(times, "names")[0]] == ["chart", "plate1", "white"]


def test_names_of_different_kinds_contradict_no_clock():
    stems = ("white", "chart", "pose 1-out", "pose 1-in", "pose 2-out", "pose 10-in", "_MG_0007", "IMG_0006")
    names = [f"{stem}.DNG" for stem in stems]
    assert [path.name for path in in_order(mixed(taken(names)))[0]] == names


def test_whether_the_count_began_again_is_told_by_the_clock_or_not_at_all():
    restarted = [*numbered(9990, 5), *numbered(3, 5)]  # the shots between were deleted
    assert [path.name for path in in_order(mixed(taken(restarted)))[0]] == restarted
    apart = [*numbered(1000, 5), *numbered(8000, 5)]
    assert [path.name for path in in_order(mixed(taken(apart)))[0]] == apart
    for names in (restarted, apart):
        silent = mixed(taken(names, silent=names))
        with pytest.raises(InputError, match=r"up to IMG_\d+\.DNG, after which .* begun again with IMG_\d+\.DNG"):
            in_order(silent)
        with pytest.raises(InputError, match="accepted: names that count up"):
            in_counting_order(names)
        assert [path.name for path in in_order(silent, "names")[0]] == sorted(names)


@pytest.mark.parametrize(
    "names",
    [
        ["a2.png", "a10.png"],
        ["a.2.png", "a.10.png"],
        ["2 in.png", "2 out.png", "10 in.png"],
        ["lamp-500.png", "lamp-8000.png"],  # no camera's numbers: too few digits
        ["IMG_20260504_101500.DNG", "IMG_20260505_090000.DNG"],
        ["P1019999.RW2", "P1020001.RW2"],
        ["ball/100/IMG_9999.CR2", "ball/101/IMG_0000.CR2"],
        ["DSC09998.ARW", "DSC09999.ARW", "DSC00001.ARW", "DSC00002.ARW"],
        ["x\u00b2.png", "x\u00b3.png"],
    ],
)
def test_names_are_sorted_by_their_numbers(names):
    assert in_counting_order(reversed(names)) == names
