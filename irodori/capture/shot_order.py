"""Order of a session's photographs, and an estimate of the time they take.

The person's time counts most: each step by hand (`irodori.capture.operator.Step`) interrupts the session and waits for
somebody. Photographs with the same settings by hand are therefore taken together, each combination once, and successive
combinations differ in as few settings as possible. Apart from that, the order of these blocks and the way through each
are chosen for the least travel of the motors.

If steps by hand cost nothing (on the virtual rig), only travel counts, and the photographs of one capture stay
together, so that the light drifts least between its two filter states.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from irodori.capture.operator import Step
from irodori.capture.rig.devices import Axis
from irodori.capture.setup_steps import hand_settings, motor_targets
from irodori.capture.short_paths import shortest_blocks
from irodori.config.capture_table import Shot
from irodori.core.errors import counted

#: Order of the roles: photographs for the calibration come before those of the object.
PHASES = ("dark", "white", "chart", "object", "environment", "room-chart", "scene")


@dataclass(frozen=True)
class Estimate:
    """Time that a list of shots takes.

    Parameters
    ----------
    shots, steps, settings : int
        Photographs; steps by hand; settings changed in them.
    hand_s, travel_s, settle_s, exposure_s, overhead_s : float
        Time of the steps by hand, of the motors, of the rig's settling after them, of the exposures, and of everything
        else (reading out, storing), s.
    """

    shots: int
    steps: int
    settings: int
    hand_s: float
    travel_s: float
    settle_s: float
    exposure_s: float
    overhead_s: float

    @property
    def total_s(self) -> float:
        """Time of the session, s."""
        return self.hand_s + self.travel_s + self.settle_s + self.exposure_s + self.overhead_s

    def __str__(self) -> str:
        parts = (
            f"{counted(self.steps, 'hand step')} {_duration(self.hand_s)}",
            f"travel {_duration(self.travel_s)}",
            f"settling {_duration(self.settle_s)}",
            f"exposure {_duration(self.exposure_s)}",
            f"overhead {_duration(self.overhead_s)}",
        )
        return f"{counted(self.shots, 'shot')}, about {_duration(self.total_s)}: {', '.join(parts)}"


def order_shots(
    shots: Sequence[Shot],
    axes: Mapping[str, Axis],
    start: Mapping[str, float | str],
    manual_cost_s: float,
) -> list[Shot]:
    """Return the shots in the order of least work by hand, then of least travel.

    Dark frames come first, then the white reference, the chart, the objects one placement after the other, the
    environment, charts in it, scenes.
    The exposures of one bracket (same subject, pose and filter) follow each other, the shortest first, so that a long
    exposure leaves no traces in the next picture. The order is deterministic.

    Parameters
    ----------
    shots : sequence of Shot
    axes : mapping of str to Axis
        Angles that motors drive.
    start : mapping
        Present settings: angles in degrees, ``filter``, ``subject``; those that are missing are unknown.
    manual_cost_s : float
        Time of a step by hand, s. If it is above 0, steps are minimised before travel, whatever its value; if it is 0,
        they are ignored.

    Returns
    -------
    list of Shot
        A permutation of `shots`.

    Raises
    ------
    ValueError
        For a cost below 0.
    """
    if not manual_cost_s >= 0.0:
        raise ValueError(f"manual_cost_s {manual_cost_s:g}: 0 or more")
    brackets: dict[tuple, list[Shot]] = {}
    for shot in shots:
        # An object that is laid down again lies elsewhere: all of one placement is photographed together.
        phase = PHASES.index(shot.role), shot.pose.placement
        brackets.setdefault((phase, shot.pose, shot.filter, shot.chart), []).append(shot)
    for bracket in brackets.values():
        bracket.sort(key=lambda shot: shot.exposure_s)
    given = sorted(brackets, key=lambda key: key[0])  # in the given order, as far as the phases allow
    by_hand = manual_cost_s > 0.0
    candidates = [_blockwise(brackets, axes, start, by_hand), [shot for key in given for shot in brackets[key]]]

    def cost(order: list[Shot]) -> tuple:
        estimate = estimate_s(order, axes, start, manual_cost_s)
        hand = (estimate.steps, estimate.settings) if by_hand else ()
        return (*hand, round(estimate.travel_s, 6), _splits(order))

    return min(candidates, key=cost)


def estimate_s(
    shots: Sequence[Shot],
    axes: Mapping[str, Axis],
    start: Mapping[str, float | str],
    manual_cost_s: float,
    overhead_s: float = 0.0,
    settle_s: float = 0.0,
) -> Estimate:
    """Return the time that the shots take in their order.

    Parameters
    ----------
    shots, axes, start, manual_cost_s
        As for `order_shots`. A motor with an unknown angle is assumed to be at its first target.
    overhead_s : float
        Time for each photograph beyond its exposure, s.
    settle_s : float
        Time from each arrival of the motors to the shutter, s, in which a step by hand may be done.
    """
    hand = {name: value for name, value in start.items() if name not in axes}
    motors = {name: float(start[name]) for name in axes if name in start}
    steps = settings = 0
    travel = settling = 0.0
    for shot in shots:
        step = Step.between(hand, hand_settings(shot, axes))
        steps, settings = steps + bool(step), settings + len(step.changes)
        hand |= step.new
        targets = motor_targets(shot, axes)
        if any(motors.get(name) != angle for name, angle in targets.items()):
            settling += max(0.0, settle_s - (manual_cost_s if step else 0.0))
        travel += max((axes[n].travel_s(motors.get(n, a), a) for n, a in targets.items()), default=0.0)
        motors |= targets
    return Estimate(
        shots=len(shots),
        steps=steps,
        settings=settings,
        hand_s=steps * manual_cost_s,
        travel_s=travel,
        settle_s=settling,
        exposure_s=sum(shot.exposure_s for shot in shots),
        overhead_s=len(shots) * overhead_s,
    )


def _blockwise(brackets: dict[tuple, list[Shot]], axes, start, by_hand: bool) -> list[Shot]:
    """Return the shots in blocks with the same settings by hand, ordered for the least travel within each block."""
    names = tuple(axes)
    blocks: dict[tuple, dict[tuple, list[tuple]]] = {}
    for key, shots in brackets.items():
        settings = hand_settings(shots[0], axes) if by_hand else {}
        targets = motor_targets(shots[0], axes)
        place = tuple(targets[name] for name in names) if targets else ()
        block = (key[0], tuple(sorted(settings.items())))
        blocks.setdefault(block, {}).setdefault(place, []).append(key)
    ways = shortest_blocks(
        [(phase, dict(settings), sorted(places)) for (phase, settings), places in sorted(blocks.items())],
        [axes[name] for name in names],
        tuple(start.get(name) for name in names),
        {name: value for name, value in start.items() if name not in axes},
    )
    ordered = []
    for (phase, settings), way in ways:
        places = blocks[phase, tuple(sorted(settings.items()))]
        for place in way:
            # Captures of one place follow each other by their angles, the two filter states of each side by side.
            for key in sorted(places[place], key=lambda key: (_angles(key[1]), key[3], key[2] == "in")):
                ordered += brackets[key]
    return ordered


def _angles(pose) -> tuple[float, ...]:
    return (pose.light_deg, pose.light_azimuth_deg, pose.tilt_deg, pose.turn_deg, pose.camera_deg)


def _splits(shots: list[Shot]) -> int:
    """Return the number of changes from one capture to another, a measure of how well captures stay together."""
    captures = [(shot.subject, shot.pose) for shot in shots]
    return sum(a != b for a, b in itertools.pairwise(captures))


def _duration(seconds: float) -> str:
    """Return a time as text in a convenient unit."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"
