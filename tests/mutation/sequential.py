"""Wald's sequential test: a sample of mutants ends as soon as it tells good tests from bad ones.

With at most sixty mutants its verdict is as sure as that of all sixty, whatever share is noticed, and takes a third of
them: 17 on average where tests notice 95 of 100, 25 at 90.
"""

import math

#: Shares that good and bad tests notice.
_GOOD, _BAD = 0.9, 0.7
#: How often good tests may be taken for bad ones, and bad ones for good.
_FALSE_ALARM, _OVERSIGHT = 0.001, 0.05


def is_told(noticed: int, tried: int) -> bool:
    """Return whether so many of the mutants tried tell which of both the tests are."""
    lost = tried - noticed
    ratio = noticed * math.log(_BAD / _GOOD) + lost * math.log((1.0 - _BAD) / (1.0 - _GOOD))
    return not math.log(_OVERSIGHT) < ratio < -math.log(_FALSE_ALARM)
