"""Cases and examples that a default run leaves to the heavy one."""

from types import SimpleNamespace

import default_cases
import pytest
from hypothesis import given, settings, strategies


class Item:
    """A collected test, as far as the plugin asks it."""

    def __init__(self, nodeid, obj=None, marker=None) -> None:
        self.nodeid, self.obj, self._marker, self.added = nodeid, obj, marker, []

    def get_closest_marker(self, name):
        return self._marker

    def add_marker(self, marker) -> None:
        self.added.append(marker.name)


def select(items, selected="not heavy") -> None:
    config = SimpleNamespace(option=SimpleNamespace(markexpr=selected))
    default_cases.pytest_collection_modifyitems(config, items)


def test_cases_that_run_by_default_are_spread_over_all_and_the_others_are_heavy():
    marker = pytest.mark.default_cases(3).mark
    some = [Item(f"test_a.py::test[{number}]", marker=marker) for number in range(9)]
    others = [Item(f"test_b.py::test[{number}]") for number in range(9)]
    few = [Item(f"test_c.py::test[{number}]", marker=marker) for number in range(2)]
    select([*some, *others, *few])
    assert [not item.added for item in some] == [number in (0, 4, 8) for number in range(9)]
    assert {name for item in some for name in item.added} == {"heavy"}
    assert not any(item.added for item in (*others, *few))


@pytest.mark.parametrize(("selected", "count"), [("not heavy", 20), ("heavy or not heavy", 100), ("stability", 100)])
def test_a_property_draws_a_fifth_of_its_examples_where_heavy_tests_are_left_out(selected, count):
    drawn = []

    @settings(max_examples=100, database=None)
    @given(strategies.integers())
    def holds(number):
        drawn.append(number)

    @settings(max_examples=6)
    @given(strategies.integers())
    def holds_in_few(number):
        pass

    # Both cases of a test are one function.
    select([Item("test_a.py::test[0]", holds), Item("test_a.py::test[1]", holds), Item("b", holds_in_few)], selected)
    holds()
    assert len(drawn) == count
    assert holds_in_few._hypothesis_internal_use_settings.max_examples == 6
