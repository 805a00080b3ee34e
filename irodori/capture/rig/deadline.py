"""Deadlines: the time left of a bounded wait."""

import time


class Deadline:
    """Moment in the future on a monotonic clock.

    Parameters
    ----------
    seconds : float
        Time from now, s.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._end = time.monotonic() + seconds

    @property
    def remaining_s(self) -> float:
        """Time left, s; 0 if the moment has passed."""
        return max(0.0, self._end - time.monotonic())

    @property
    def passed(self) -> bool:
        """Whether no time is left."""
        return self.remaining_s == 0.0
