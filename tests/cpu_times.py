"""CPU time of tests, whoever else uses the processor: by file and by test, printed with ``--durations=N``.

The N that computed most are listed, or all with 0.

Time counts that a test's process computes and that of the processes that it has started, those that go on included:
of fixtures, of the test and of cleaning up. What is computed between tests, by a thread or by a child that was started
for others, falls to the next. Looking at a browser's threads takes milliseconds: it is done once a test, and only where
the times are asked for.
"""

import contextlib
import os
from collections import Counter

import pytest

_NAME = "cpu_s"
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


def _tree_s(process: int | str = "self") -> float:
    """Return the CPU time of a process, of its descendants and of those that have been waited for, s."""
    try:
        with open(f"/proc/{process}/stat", encoding="utf-8", errors="replace") as file:
            fields = file.read().rpartition(")")[2].split()
    except OSError:  # it has ended meanwhile
        return 0.0
    children = set()
    # What ends while it is looked at, a thread or the process, takes nothing with it: it has been counted.
    with contextlib.suppress(OSError):
        for thread in os.listdir(f"/proc/{process}/task"):  # a child belongs to the thread that has started it
            with contextlib.suppress(OSError), open(f"/proc/{process}/task/{thread}/children", "rb") as file:
                children.update(file.read().decode().split())
    return _TICK_S * sum(map(int, fields[11:15])) + sum(map(_tree_s, children))


class CpuTimes:
    """What tests have computed: noted where they run, summed and printed where their reports arrive."""

    def __init__(self) -> None:
        self.begin()
        self._of: dict[str, Counter[str]] = {"file": Counter(), "test": Counter()}

    def begin(self) -> None:
        """Count from now on."""
        self._last_s = _tree_s()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self):
        report = yield
        if report.when != "teardown":
            return report
        now_s = _tree_s()
        # Less than before where a process has ended that nobody waited for.
        report.user_properties.append((_NAME, max(now_s - self._last_s, 0.0)))
        self._last_s = now_s
        return report

    def pytest_runtest_logreport(self, report) -> None:
        seconds = sum(value for name, value in report.user_properties if name == _NAME)
        self._of["file"][report.nodeid.partition("::")[0]] += seconds
        self._of["test"][report.nodeid] += seconds

    def pytest_terminal_summary(self, terminalreporter) -> None:
        most = terminalreporter.config.getoption("durations")
        for kind, found in self._of.items():
            terminalreporter.section(f"most CPU time of a {kind}, s; of all {found.total():.0f}")
            for name, seconds in found.most_common(most or None):
                terminalreporter.write_line(f"{seconds:8.1f} {name}")


def pytest_configure(config):
    if config.getoption("durations") is not None:
        config.pluginmanager.register(CpuTimes(), "cpu times of tests")
