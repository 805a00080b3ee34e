"""Straight moves of axes with trapezoidal speed profiles, in simulated time."""

import math
from collections import deque
from dataclasses import dataclass

_STEP_S = 1e-3


@dataclass
class Block:
    """A straight move that is queued or running.

    Parameters
    ----------
    target : list of float
        End position, units.
    speed, acceleration : float
        Speed and acceleration along the path, units/s and units/s^2.
    """

    target: list[float]
    speed: float
    acceleration: float


class Stage:
    """Axes that move together, with their queue of moves.

    Parameters
    ----------
    position : sequence of float
        Initial position of the axes, units.
    """

    def __init__(self, position) -> None:
        self.position = list(position)
        self.speed = 0.0
        self.holding = False
        self.blocks: deque[Block] = deque()
        self.low, self.high = list(position), list(position)
        self._start = list(position)
        self._length = self._done = 0.0
        self._path = self._travelled = 0.0

    @property
    def moving(self) -> bool:
        """Whether the axes move or are about to."""
        return bool(self.blocks) and not (self.holding and self.speed == 0.0)

    @property
    def end(self) -> list[float]:
        """Position of the axes after all moves, units."""
        return list(self.blocks[-1].target if self.blocks else self.position)

    @property
    def progress(self) -> float:
        """Share of the path of all moves since the axes were last idle that is done, 0..1; 0 without moves."""
        return self._travelled / self._path if self._path else 0.0

    def push(self, block: Block) -> None:
        """Add a move to the queue; start it if the queue was empty."""
        if not self.blocks:
            self._path = self._travelled = 0.0
        self._path += math.dist(self.end, block.target)
        self.blocks.append(block)
        if len(self.blocks) == 1:
            self._begin()

    def clear(self) -> None:
        """Stop at once and discard all moves."""
        self.blocks.clear()
        self.speed, self.holding = 0.0, False
        self._path = self._travelled = 0.0

    def advance(self, seconds: float) -> None:
        """Advance the motion by a number of seconds."""
        if seconds <= 0.0 or not self.moving:
            return
        while seconds > 0.0 and self.moving:
            self._step(min(seconds, _STEP_S))
            seconds -= _STEP_S
        if self.blocks and self._length:
            part, target = self._done / self._length, self.blocks[0].target
            self.position = [a + (b - a) * part for a, b in zip(self._start, target, strict=True)]
        self._note_extremes()

    def shift(self, axis: int, position: float) -> None:
        """Set the position of an axis, as a mechanical stop does, and leave the moves unchanged."""
        self.position[axis] = position

    def slip(self, axis: int, by: float) -> None:
        """Shift the position of an axis and all its remaining moves by a number of units, as lost steps do."""
        for places in (self.position, self._start, *(block.target for block in self.blocks)):
            places[axis] += by

    def _begin(self) -> None:
        self._start, self._done = list(self.position), 0.0
        self._length = math.dist(self.position, self.blocks[0].target)

    def _step(self, seconds: float) -> None:
        block = self.blocks[0]
        left = self._length - self._done
        brake = math.sqrt(2.0 * block.acceleration * left)
        limit = 0.0 if self.holding else min(block.speed, brake)
        change = block.acceleration * seconds
        self.speed = min(limit, self.speed + change) if self.speed < limit else max(limit, self.speed - change)
        self.speed = min(self.speed, brake)
        way = min(self.speed * seconds, left)
        self._done += way
        self._travelled += way
        if left - way <= 1e-9 and not (self.holding and self.speed == 0.0 and left > 1e-9):
            self.position = list(block.target)
            self._note_extremes()
            self.blocks.popleft()
            self.speed = 0.0
            if self.blocks:
                self._begin()

    def _note_extremes(self) -> None:
        """Update the extreme positions with the present one; on a straight path they lie at its ends."""
        self.low = [min(pair) for pair in zip(self.low, self.position, strict=True)]
        self.high = [max(pair) for pair in zip(self.high, self.position, strict=True)]
