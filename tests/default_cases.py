"""Cases of a test and examples of a property that a default run leaves to the heavy one.

Of a test with the marker ``default_cases(N)``, N cases run by default, and the others are heavy. The N are spread
evenly over the cases in the order in which pytest collects them, the first among them. Where heavy tests are left out,
the tests of properties draw a fifth of their examples; others are drawn in each run.
"""

from collections import defaultdict

import pytest
from hypothesis import settings

MARK = "default_cases"
#: A property of no more examples keeps them.
_FEW = 8


def spread(count: int, total: int) -> set[int]:
    """Return the places of so many cases of ``total``, as far apart as they can be; the first is always one."""
    count = min(count, total)
    return {round(i * (total - 1) / max(count - 1, 1)) for i in range(count)}


def pytest_configure(config):
    config.addinivalue_line("markers", f"{MARK}(N): of the test's cases, N run by default, and the others are heavy")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
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
    if config.option.markexpr == "not heavy":
        for test in {item.obj for item in items if hasattr(item.obj, "_hypothesis_internal_use_settings")}:
            asked = test._hypothesis_internal_use_settings
            fewer = max(min(asked.max_examples, _FEW), asked.max_examples // 5)
            test._hypothesis_internal_use_settings = settings(asked, max_examples=fewer)
