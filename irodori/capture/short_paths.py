"""Short tours through poses, and through blocks of poses between which a person has to set something.

Of up to six points all orders are tried, and a single axis is swept from end to end. For more points, the best of
several boustrophedon orders is taken, or of a nearest-neighbour order improved by 2-opt. Costs are tuples that compare
from the left: settings changed by hand, travel in s, then *unrest*, a small cost of changes that are slow by hand.
"""

import functools
import itertools
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence

from irodori.capture.rig.devices import Axis

#: A place is the angle of each axis, degrees; the empty place stands for any, for a shot without a pose.
Place = tuple
#: A block is its phase, its settings by hand, and its places.
Block = tuple[tuple, dict, list[Place]]
#: Settings changed, travel in s, unrest.
_Cost = tuple[float, float, float]

#: Above this number of points, sweeps begin at two corners only; above the second, orders are swept and not searched.
_CORNER_POINTS, _SEARCH_POINTS = 120, 400
_EXACT_POINTS, _FRONTIER = 6, 12


def shortest_blocks(
    blocks: Sequence[Block], axes: Sequence[Axis], start: Place, hand: Mapping[str, float | str]
) -> list[tuple[tuple[tuple, dict], list[Place]]]:
    """Return the blocks in the order of least cost, each with the way through its places.

    Parameters
    ----------
    blocks : sequence of (phase, settings, places)
        Phases run in order. The blocks of one phase have settings with the same names and different values.
    axes : sequence of Axis
        Axes of the angles in a place, in the same order.
    start : tuple
        Angle of each axis at the start, degrees; None if it is unknown.
    hand : mapping
        Settings by hand at the start; those that are missing are unknown.
    """
    travel = _Travel(axes)
    ways = functools.cache(lambda places: _ways(list(places), axes, travel))  # most blocks have the same places
    frontier: list[tuple[_Cost, dict, Place, list]] = [((0, 0.0, 0.0), dict(hand), start, [])]
    for _, group in itertools.groupby(sorted(blocks, key=lambda block: block[0]), key=lambda block: block[0]):
        phase = [(block, ways(tuple(block[2]))) for block in group]
        ends: dict[Hashable, tuple[_Cost, dict, Place, list]] = {}
        for cost, stands, place, done in frontier:
            for more, order in _phase(phase, stands, place, travel):
                block, way = order[-1]
                after = ({**stands, **block[1]}, way[-1] or place)
                key = (tuple(sorted(after[0].items())), after[1])
                candidate = (_sum(cost, more), *after, [*done, *order])
                if key not in ends or _rounded(candidate[0]) < _rounded(ends[key][0]):
                    ends[key] = candidate
        frontier = sorted(ends.values(), key=lambda end: _rounded(end[0]))[:_FRONTIER]
    return [((block[0], block[1]), way) for block, way in frontier[0][3]]


class _Travel:
    """Function that returns the travel time between two places, s, with a cache.

    Axes move simultaneously; an unknown angle costs nothing.
    """

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes
        self._known: dict[tuple[Place, Place], float] = {}

    def __call__(self, here: Place, there: Place) -> float:
        key = (here, there)
        if key not in self._known:
            legs = zip(self._axes, here, there, strict=False)  # an empty place has no angles and costs nothing
            self._known[key] = max((axis.travel_s(a, b) for axis, a, b in legs if a is not None), default=0.0)
        return self._known[key]

    def along(self, way: Sequence[Place]) -> float:
        return sum(self(a, b) for a, b in itertools.pairwise(way))


# ---- the way through one block


def _ways(places: list[Place], axes: Sequence[Axis], travel: _Travel) -> list[tuple[list[Place], float]]:
    """Return good ways through places with their travel times, s, for different first and last places."""
    varying = [i for i in range(len(axes)) if len({place[i] for place in places if place}) > 1]
    if len(places) <= 1 or len(varying) == 1:
        ways = [sorted(places)]
    elif len(places) <= _EXACT_POINTS:
        ways = list(_exact_ways(places, travel))
    else:
        ways = [snake for order in itertools.permutations(varying) for snake in _snakes(places, order)]
        if len(places) <= _SEARCH_POINTS:
            ways.append(_bettered(places, travel, lambda a: 0.0))
        ways = sorted(ways, key=travel.along)[:_EXACT_POINTS]
    ways += [way[::-1] for way in ways if len(way) > 1]
    return [(way, travel.along(way)) for way in ways]


def _exact_ways(places: list[Place], travel: _Travel) -> Iterator[list[Place]]:
    """Yield the shortest way for each pair of a first and a last place (each pair in one direction)."""
    best: dict[tuple, tuple[float, tuple]] = {}
    for way in itertools.permutations(places):
        if way[0] < way[-1]:
            key, length = (way[0], way[-1]), travel.along(way)
            if key not in best or length < best[key][0] - 1e-9:
                best[key] = (length, way)
    return (list(way) for _, way in best.values())


def _snakes(points: Collection[tuple], order: Sequence[int]) -> Iterator[list[tuple]]:
    """Yield boustrophedon orders of points, ``order[0]`` the slowest coordinate, from the corners."""
    corners: Iterable[tuple[bool, ...]] = itertools.product((False, True), repeat=len(order))
    if len(points) > _CORNER_POINTS:
        corners = ((flip,) * len(order) for flip in (False, True))
    for flips in corners:
        yield _snake(list(points), list(zip(order, flips, strict=True)))[0]


def _snake(points: list[tuple], order: list[tuple[int, bool]]) -> tuple[list[tuple], list[tuple[int, bool]]]:
    """Return the points in boustrophedon order, and the directions in which the coordinates would continue."""
    if not order:
        return points, order
    (axis, flip), inner = order[0], order[1:]
    done = []
    for value in sorted({point[axis] for point in points}, reverse=flip):
        part, inner = _snake([point for point in points if point[axis] == value], inner)
        done += part
    return done, [(axis, not flip), *inner]


def _bettered(points: Sequence, distance: Callable, entry: Callable) -> list:
    """Return an open way through points: by nearest neighbours, then improved until no 2-opt step helps.

    Parameters
    ----------
    points : sequence
    distance, entry : callable
        Symmetric distance between two points, and distance from the start to a first point.
    """
    left = list(points)
    way = [left.pop(min(range(len(left)), key=lambda i: entry(left[i])))]
    while left:
        way.append(left.pop(min(range(len(left)), key=lambda i: distance(way[-1], left[i]))))
    while _reversed_better(way, distance, entry):
        pass
    return way


def _reversed_better(way: list, distance: Callable, entry: Callable) -> bool:
    """Reverse parts of a way wherever that shortens it (2-opt), in place; return whether one did."""
    found = False
    for i, j in itertools.combinations(range(len(way)), 2):
        before = distance(way[i - 1], way[i]) if i else entry(way[i])
        after = distance(way[i - 1], way[j]) if i else entry(way[j])
        if j + 1 < len(way):
            before, after = before + distance(way[j], way[j + 1]), after + distance(way[i], way[j + 1])
        if after < before - 1e-9:
            way[i : j + 1] = way[i : j + 1][::-1]
            found = True
    return found


# ---- the order of the blocks of one phase


def _phase(phase: list[tuple], hand: dict, place: Place, travel: _Travel) -> Iterator[tuple]:
    """Yield (cost, list of (block, way)) for good orders of a phase, with different last places."""
    if len(phase) == 1 and 1 < len(phase[0][0][2]) <= _SEARCH_POINTS:
        # A single block is entered only from the present position of the motors.
        block, ways = phase[0]
        way = _bettered(block[2], travel, lambda a: travel(place, a))
        phase = [(block, [*ways, (way, travel.along(way))])]
    costs = [(_hand_cost_along([block for block, _ in order], hand), order) for order in _orders(phase, hand)]
    fewest = min(cost[0] for cost, _ in costs)
    seen: set[tuple[int, ...]] = set()
    for cost, order in sorted((pair for pair in costs if pair[0][0] == fewest), key=lambda pair: pair[0]):
        key = tuple(id(block) for block, _ in order)
        if key not in seen and len(seen) < 4 * _FRONTIER:
            seen.add(key)
            yield from ((_sum(cost, more), chosen) for more, chosen in _choose_ways(order, place, travel))


def _orders(phase: list[tuple], hand: dict) -> Iterator[list[tuple]]:
    """Yield all orders of few blocks; of many, those that are likely to need few changes by hand."""
    if len(phase) <= _EXACT_POINTS:
        yield from map(list, itertools.permutations(phase))
        return
    names = sorted(phase[0][0][1])
    points = {tuple(block[1][name] for name in names): (block, ways) for block, ways in phase}
    varying = [i for i in range(len(names)) if len({point[i] for point in points}) > 1]
    for order in itertools.permutations(varying):
        for snake in _snakes(points, order):
            yield [points[point] for point in snake]
    if len(points) <= _SEARCH_POINTS:

        def weight(cost: tuple) -> float:
            return cost[0] + 1e-3 * cost[2]

        def between(a: tuple, b: tuple) -> float:
            return weight(_hand_cost(a[0][1], b[0][1]))

        yield _bettered(phase, between, lambda a: weight(_hand_cost(hand, a[0][1])))


def _choose_ways(order: list[tuple], place: Place, travel: _Travel) -> Iterator[tuple]:
    """Yield, for each way through the last block, the ways with the least travel through all blocks in their order."""
    reached: list[tuple[float, Place, tuple]] = [(0.0, place, ())]
    for block, ways in order:
        following = []
        for way, length in ways:
            options = [(cost + travel(end, way[0]) + length, done) for cost, end, done in reached]
            cost, done = min(options, key=lambda option: round(option[0], 6))
            following.append((cost, way[-1] or place, (done, block, way)))
        reached = following
    for cost, _, done in reached:
        chosen = []
        while done:
            done, block, way = done
            chosen.append((block, way))
        yield (0, cost, 0.0), chosen[::-1]


def _hand_cost(stands: Mapping, wanted: Mapping) -> tuple[int, float, float]:
    """Return (settings changed, 0 s of travel, unrest); large changes of angles cost most, the filter nothing."""
    changed = [name for name, value in wanted.items() if stands.get(name) != value]
    unrest = 0.0
    for name in changed:
        if name != "filter":
            old, new = stands.get(name), wanted[name]
            far = abs(new - old) / 360.0 if isinstance(new, float) and isinstance(old, float) else 0.0
            unrest += 1.0 + 1e-3 * far
    return len(changed), 0.0, unrest


def _hand_cost_along(order: list[Block], hand: Mapping) -> tuple[int, float, float]:
    costs = [_hand_cost(a, b) for a, b in itertools.pairwise([hand, *(block[1] for block in order)])]
    return sum(c[0] for c in costs), 0.0, sum(c[2] for c in costs)


def _sum(a: _Cost, b: _Cost) -> _Cost:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _rounded(cost: _Cost) -> _Cost:
    """Return a rounded cost, so that rounding errors do not decide a comparison."""
    return cost[0], round(cost[1], 6), round(cost[2], 9)
