"""The marker ``default_cases(N)``: of a test with many cases, N run by default, and the others are heavy.

The N are spread evenly over the cases in the order in which pytest collects them, from the first to the last.
"""

from collections import defaultdict

import pytest

MARK = "default_cases"


def spread(count: int, total: int) -> set[int]:
    """Return the places of so many cases of ``total``, as far apart as they can be; the first is always one."""
    return {round(i * (total - 1) / max(count - 1, 1)) for i in range(min(count, total))}


def pytest_configure(config):
    config.addinivalue_line("markers", f"{MARK}(N): of the test's cases, N run by default, and the others are heavy")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the other cases as heavy, before pytest selects by marker."""
    cases = defaultdict(list)
    for item in items:
        if item.get_closest_marker(MARK):
            cases[item.nodeid.partition("[")[0]].append(item)
    for found in cases.values():
        kept = spread(found[0].get_closest_marker(MARK).args[0], len(found))
        for number, item in enumerate(found):
            if number not in kept:
                item.add_marker(pytest.mark.heavy)
