"""Every fault of a line and of a controller, in every command: an error of the right family, in time, the rig still.

On a clock that only waiting moves; the faults of a session over a real line are in `test_session`.
"""

import collections
import random

import patience
import pytest
from made import made
from motion_rigs import TIMEOUT_S, definition, failure, wait_until_still
from virtual_time import FaultyBench

from irodori.capture.rig.connect import open_rig, true_position_deg
from irodori.capture.rig.devices import AlarmError, CommandError, DeadlineError, HeldError, LimitError, LinkError
from irodori.capture.rig.drives import drives_of
from irodori.capture.rig.grbl.settings_check import homing_s
from irodori.config.models import Rig

PEERS = ("grbl", "ascii")
#: Fault: families of the error that it may end in; a command may also succeed.
FAULTS = {
    # A digit less can make another position, on which no command must rely: off its way, or not where it was left.
    "drop-output 1": (LinkError, DeadlineError, AlarmError),
    "drop-output 7": (LinkError, DeadlineError, AlarmError, CommandError),
    "drop-output 60": (LinkError, DeadlineError, AlarmError, CommandError),
    "drop-input 1": (LinkError, DeadlineError, AlarmError, CommandError),
    "drop-input 5": (LinkError, DeadlineError, AlarmError, CommandError),
    # One that is lost is asked for again; all of a question's reports are silence.
    "drop-report 1": (),
    "drop-report 9": (DeadlineError,),
    "garble": (LinkError, DeadlineError),
    "stall 0.1": (),
    "stall 0.4": (LinkError, DeadlineError),
    "stall": (DeadlineError,),
    "hangup 0.1": (LinkError,),
    "reset": (AlarmError, DeadlineError),
    "alarm 1": (AlarmError,),
    "alarm 2": (AlarmError,),
    "alarm 3": (AlarmError,),
    # A jog that Grbl holds is cancelled, and stands elsewhere; a refusal is that of a move that finds it held.
    "hold": (HeldError, LinkError, CommandError),
}
COMMANDS = {
    "home": lambda rig: rig.home(),
    "move": lambda rig: rig.move({"camera_deg": 90.0, "turn_deg": 200.0}),
    "jog": lambda rig: rig.jog("camera_deg", 60.0),
    "status": lambda rig: rig.status(),
    "stop": lambda rig: rig.stop(),
    "settings": lambda rig: rig.settings(),
}
#: Silences that a command and the stop after it may wait for, one after the other.
SILENCES = 6
ROUNDING = 0.02


def budget_s(rig, name: str) -> float:
    """Return the time that a command may take until it has failed and the rig was stopped, s."""
    motion = rig.travel_s({"camera_deg": 0.0, "turn_deg": 0.0}, {"camera_deg": 140.0, "turn_deg": 359.5})
    if name == "home":
        motion = 6.0 * motion if not hasattr(rig, "settings") else homing_s(rig._settings, rig.drives)
    return 1.25 * motion + SILENCES * TIMEOUT_S


def check_inside(rig: dict, seen: dict, homing: bool) -> None:
    """Fail where an axis was beyond its limits; homing alone may go up to the switch, at 0, behind them."""
    for drive in drives_of(made(Rig, rig)).values():
        name, (low, high) = drive.channel, drive.reach
        # The described controller stands at the switch after homing, Grbl has pulled off to the end of the reach.
        end = 0.0 if homing or rig["motion"]["protocol"] == "ascii" else high
        assert low - ROUNDING <= seen["low"][name] and seen["high"][name] <= end + ROUNDING, seen


@pytest.fixture(params=["grbl", "ascii"])
def peer(request, monkeypatch) -> tuple[dict, FaultyBench]:
    rig = definition(request.param, timeout_s=TIMEOUT_S)
    return rig, FaultyBench(made(Rig, rig), monkeypatch)


@pytest.mark.stability(
    stage="capture",
    case="line drops bytes",
    fault=("drop-output 1", "drop-output 7", "drop-output 60", "drop-input 1", "drop-input 5"),
    command="move",
)
@pytest.mark.stability(stage="capture", case="line garbles a reply", fault="garble", command="move")
@pytest.mark.stability(
    stage="capture", case="controller stalls", fault=("stall 0.1", "stall 0.4", "stall"), command="move"
)
@pytest.mark.stability(stage="capture", case="controller disconnects", fault="hangup 0.1", command="move")
@pytest.mark.stability(stage="capture", case="controller resets in mid-move", fault="reset", command="move")
@pytest.mark.stability(
    stage="capture", case="alarm in mid-move", fault=("alarm 1", "alarm 2", "alarm 3"), command="move"
)
@pytest.mark.parametrize("command", [pytest.param(c, marks=[] if c == "move" else pytest.mark.heavy) for c in COMMANDS])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_a_command_ends_in_time_and_leaves_the_rig_still(peer, fault, command, record_property):
    rig, simulator = peer
    if command == "settings" and rig["motion"]["protocol"] != "grbl":
        pytest.skip("only Grbl has settings to read")
    with open_rig(made(Rig, rig)) as opened:
        opened.home()
        opened.move({"camera_deg": 20.0, "turn_deg": 60.0})
        simulator.forget()
        moving = command in ("home", "move", "jog")
        simulator.fault(f"move 0.5 {fault}" if moving else f"now {fault}")
        budget, began = budget_s(opened, command), simulator.now
        error = failure(lambda: COMMANDS[command](opened))
        elapsed = simulator.now - began
        assert elapsed <= budget, error
        assert error is None or isinstance(error, FAULTS[fault]), repr(error)
        record_property("outcome", f"{fault} | {command} | {type(error).__name__ if error else 'ok'}")
        record_property("of_budget", round(elapsed / budget, 3))
        # A lost line carries no stop; everything else has stopped the rig by the time that the error is there.
        seen = wait_until_still(simulator) if fault.startswith("hangup") else simulator.snapshot()
        assert not seen["moving"]
        assert seen["state"].lower() not in ("run", "jog", "home")
        check_inside(rig, seen, homing=command == "home")
        simulator.sleep(0.2)
        assert simulator.true_position() == seen["position"]
        simulator.clear()
        check_truth(opened)
    again(rig, simulator)


def check_truth(opened) -> None:
    """Fail where a rig says that it knows where it stands, and stands elsewhere."""
    seen = []
    error = failure(lambda: seen.append(opened.status()))
    assert seen or isinstance(error, (LinkError, DeadlineError, CommandError))
    if seen and seen[0].homed:
        assert true_position_deg(opened) == pytest.approx(seen[0].position_deg, abs=0.02)


def again(rig: dict, simulator) -> None:
    """Open the rig anew, home it and move it."""

    def works() -> bool:
        error = failure(lambda: use(rig))
        assert error is None or isinstance(error, LinkError), error
        return error is None

    patience.until(works, polls=100)
    here = {
        name: drive.to_deg(simulator.true_position()[drive.channel])
        for name, drive in drives_of(made(Rig, rig)).items()
    }
    assert here["camera_deg"] == pytest.approx(45.0, abs=0.005)


def use(rig: dict) -> None:
    with open_rig(made(Rig, rig)) as opened:
        opened.home()
        opened.move({"camera_deg": 45.0})


# ---- random commands with random faults at random times

RUNS, BATCHES = 204, 12


@pytest.mark.heavy
@pytest.mark.parametrize("batch", range(BATCHES))
def test_random_commands_with_random_faults(batch, monkeypatch, record_property):
    rng = random.Random(20100401 + batch)
    rig = definition(PEERS[batch % len(PEERS)], seed=batch, timeout_s=TIMEOUT_S)
    outcomes: collections.Counter = collections.Counter()
    worst = 0.0
    simulator = FaultyBench(made(Rig, rig), monkeypatch, batch)
    for _ in range(RUNS // BATCHES):
        worst = max(worst, random_run(rng, rig, simulator, outcomes))
    again(rig, simulator)
    record_property("runs", RUNS // BATCHES)
    record_property("worst_of_budget", round(worst, 3))
    for outcome, count in sorted(outcomes.items()):
        record_property(f"outcome: {outcome}", count)


def random_run(rng: random.Random, rig: dict, simulator, outcomes: collections.Counter) -> float:
    """Open and home the rig that the run before has left, and go on; return the worst part of a budget taken."""
    fault = rng.choice(list(FAULTS))
    when = rng.choice(["now", f"line {rng.randint(1, 6)}", f"move {rng.random():.3f}"])
    worst, homed = 0.0, False
    patience.until(lambda: simulator.faulty.plugged)  # a line that hung up comes back a moment later
    with open_rig(made(Rig, rig)) as opened:
        opened.home()
        homed = True
        simulator.forget()
        simulator.fault(f"{when} {fault}")
        for _ in range(3):
            name = rng.choice(list(COMMANDS)[:5])
            act = COMMANDS[name]
            if name == "move":
                targets = {"camera_deg": round(rng.uniform(-10, 150), 1), "turn_deg": rng.randint(0, 719) / 2}
                act = lambda rig, targets=targets: rig.move(targets)  # noqa: E731
            if name == "jog":
                by_deg = round(rng.uniform(-60, 60), 1)
                act = lambda rig, by_deg=by_deg: rig.jog("camera_deg", by_deg)  # noqa: E731
            if name == "home":
                homed = False
            budget, began = budget_s(opened, name), simulator.now
            error = failure(lambda act=act: act(opened))
            worst = max(worst, (simulator.now - began) / budget)
            assert error is None or isinstance(error, (*FAULTS[fault], LimitError, AlarmError)), (when, fault, error)
            outcomes[f"{fault} | {name} | {type(error).__name__ if error else 'ok'}"] += 1
            seen = wait_until_still(simulator) if fault.startswith("hangup") else simulator.snapshot()
            assert not seen["moving"] and seen["state"].lower() not in ("run", "jog", "home"), (when, fault, name)
            check_inside(rig, seen, homing=not homed)
            if error and not isinstance(error, LimitError):
                break
        assert worst <= 1.0
        simulator.clear()
        check_truth(opened)
    return worst
