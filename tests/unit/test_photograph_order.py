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


@pytest.mark.parametrize(
    ("first", "step"), [(1, 20), (8, 20), (9978, 20), (9999, 20), (9971, 20), (1, 0), (9978, 0), (9998, 0)]
)
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
        "one; accepted: --order names if the clock was set between them, --order clock if files were renamed or have "
        "names that do not count photographs."
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
    said = (
        r"white\.DNG: time: found .* of chart\.DNG, .* set between them, or names .* because plate1\.DNG states no time"
    )
    with pytest.raises(InputError, match=said):
        in_order(times)
    assert [path.stem for path in in_order(times, "names")[0]] == ["chart", "plate1", "white"]


def test_names_of_different_kinds_contradict_no_clock():
    stems = ("white", "chart", "pose 1-out", "pose 1-in", "pose 2-out", "pose 10-in", "_MG_0007", "IMG_0006")
    names = [f"{stem}.DNG" for stem in stems]
    assert [path.name for path in in_order(mixed(taken(names)))[0]] == names


@pytest.mark.parametrize(
    "stems",
    [
        ["plate cam30", "plate cam10", "plate cam45", "plate cam0"],  # angles
        ["plate_500", "plate_100", "plate_250"],
        ["plate 6500K", "plate 2700K"],
        ["20260504_101502", "20260504_101500"],  # a phone that renamed them
    ],
)
def test_numbers_that_are_no_camera_s_count_contradict_no_clock(stems):
    names = [f"{stem}.dng" for stem in stems]
    paths, order = in_order(mixed(taken(names)))
    assert [path.name for path in paths] == names and order == CLOCK


@pytest.mark.parametrize(
    "stems",
    [
        ["P5049998", "P5049999", "P5040001", "P5040002", "P5050003"],  # month and day before the count
        ["DSC09998", "DSC09999", "DSC00001", "DSC00002"],
        ["B00019998", "B00019999", "B00020001", "B00020002"],
    ],
)
def test_the_last_four_digits_are_the_count(stems):
    names = [f"{stem}.ORF" for stem in stems]
    assert [path.name for path in in_order(mixed(taken(names)))[0]] == names
    assert [path.name for path in in_order(mixed(taken(names, silent=names)))[0]] == names
    with pytest.raises(InputError, match="--order names if the clock was set"):
        in_order(mixed(taken(names, back_at=1)))
    two = names[1:3]
    assert [path.name for path in in_order(mixed(taken(two)))[0]] == two


def test_a_count_after_month_and_day_that_may_have_begun_again_is_not_told_by_the_names():
    names = ["P5049999.ORF", "P5040001.ORF"]
    with pytest.raises(InputError, match=r"up to P5049999\.ORF, after which .* begun again with P5040001\.ORF"):
        in_order(mixed(taken(names, silent=names)))


@pytest.mark.parametrize("numbers", [(1, 2, 9999), (9999, 1, 2), (1, 9998, 9999), (1, 2, 5000, 9998, 9999)])
def test_where_a_count_ends_at_9999_the_clock_tells_whether_it_began_again(numbers):
    names = [f"IMG_{number:04d}.DNG" for number in numbers]
    assert [path.name for path in in_order(mixed(taken(names)))[0]] == names
    for unclear in (taken(names, silent=names), taken(names, step=0)):
        with pytest.raises(
            InputError, match=r"begun again with IMG_0001.*: --order names if it has not, or names that tell"
        ):
            in_order(mixed(unclear))


def test_a_clock_that_contradicts_a_count_with_and_without_a_restart_is_refused_with_both_doubts():
    """Else ``--order names`` would be advised, by which the small numbers come first."""
    names = [*numbered(9990, 9), *numbered(1, 20)]
    times = taken(names, back_at=15)
    begun = r"up to IMG_9998\.DNG, after which .* begun again with IMG_0001\.DNG; accepted: "
    with pytest.raises(InputError, match=begun + "--order clock if files were renamed .*, --order names if it has not"):
        in_order(mixed(times))
    with pytest.raises(InputError, match=begun + "--order names if it has not"):
        in_order(mixed(times | {Path("raw", names[3]): ""}))


def test_names_that_tell_as_the_message_says_are_accepted():
    names = ["a-IMG_9998.DNG", "a-IMG_9999.DNG", "b-IMG_0003.DNG", "b-IMG_0004.DNG"]
    assert [path.name for path in in_order(mixed(taken(names, silent=names)))[0]] == names


@pytest.mark.parametrize("fractions", [("7", "120", "340"), ("05", "12", "34"), ("", "5", "25")])  # 7 ms as 7
@pytest.mark.parametrize("name", ["IMG_000{}.DNG", "shot{}.DNG"])
def test_fractions_of_a_second_contradict_no_names(name, fractions):
    names = [name.format(number) for number in (1, 2, 3)]
    times = {
        Path("raw", one): f"2026-10-25T02:50:00.{fraction}".rstrip(".")
        for one, fraction in zip(names, fractions, strict=True)
    }
    paths, told = in_order(mixed(times))
    assert [path.name for path in paths] == names and told == CLOCK
    later = Path("raw", name.format(0))
    times[later] = "2026-10-25T02:50:01"
    if name.startswith("IMG"):
        with pytest.raises(InputError, match=r"IMG_0001\.DNG: time: "):
            in_order(mixed(times))
    else:
        assert in_order(mixed(times))[0][-1] == later


def test_whether_the_count_began_again_is_told_by_the_clock_or_not_at_all():
    restarted = [*numbered(9990, 5), *numbered(3, 5)]  # the shots between were deleted
    assert [path.name for path in in_order(mixed(taken(restarted)))[0]] == restarted
    apart = [*numbered(1000, 5), *numbered(8000, 5)]
    assert [path.name for path in in_order(mixed(taken(apart)))[0]] == apart
    for names in (restarted, apart):
        silent = mixed(taken(names, silent=names))
        with pytest.raises(InputError, match=r"up to IMG_\d+\.DNG, after which .* begun again with IMG_\d+\.DNG"):
            in_order(silent)
        with pytest.raises(InputError, match=r"accepted: .* names that tell, such as a-IMG_\d+\.DNG before b-IMG_"):
            in_order(silent)
        assert [path.name for path in in_order(silent, "names")[0]] == sorted(names) == in_counting_order(names)


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
