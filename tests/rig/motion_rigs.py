"""Rigs of the tests of motion: definitions for each protocol, simulated, fast, and with short answers."""

import copy
import time

from irodori.capture.rig.connect import start_simulator
from irodori.capture.rig.devices import DeviceError
from irodori.config.validation import validate
from irodori.simulation.controllers.peer_client import Simulator

#: How long a rig may be silent: on a clock that only waiting moves, and where its simulator is another process, which
#: other programs may keep from the processor for seconds.
TIMEOUT_S, PATIENT_S = 0.5, 20.0

_LIMITS = {
    "light_deg": {"min": 35.0, "max": 125.0, "step": 0.5},
    "camera_deg": {"min": 0.0, "max": 140.0, "step": 0.1},
    "tilt_deg": {"min": 0.0, "max": 45.0, "step": 0.5},
    "turn_deg": {"min": 0.0, "max": 359.5, "step": 0.5},
}
# Fast axes, so that deadlines are short in real time.
# The camera's switch is at -1 degree and the table's at 360.5; Grbl counts downward from the switch.
_AXES = {
    "camera_deg": {"channel": "X", "units_per_deg": -1.0, "zero_deg": -1.0,
                   "speed_deg_per_s": 400.0, "acceleration_deg_per_s2": 8000.0},
    "turn_deg": {"channel": "Y", "units_per_deg": 0.5, "zero_deg": 361.5,
                 "speed_deg_per_s": 800.0, "acceleration_deg_per_s2": 16000.0},
}  # fmt: skip
_ASCII = {
    "line_end": "cr",
    "home": "HM {axis}",
    "move": "MA {axis} {target:.3f}",
    "stop": "ST",
    "resume": "GO",
    "position": "PO {axis}",
    "status": "SS",
    "replies": {
        "accepted": "OK",
        "position": r"PO (?P<axis>\w+)=(?P<position>-?\d+\.\d{3})",
        "status": r"SS=(?P<state>\w+)",
        "refused": r"NG (?P<message>.*)",
    },
    "idle": ["READY"],
    "busy": ["BUSY"],
    "hold": ["HELD"],
    "alarm": ["FAULT"],
    "simulated_replies": {
        "accepted": "OK",
        "position": "PO {axis}={position:.3f}",
        "status": "SS={state}",
        "refused": "NG {message}",
    },
}


def definition(protocol: str, *, time_scale: float = 10.0, seed: int = 1, timeout_s: float = PATIENT_S) -> dict:
    """Return the validated definition of a rig with a simulated controller."""
    motion = {
        "protocol": protocol,
        "port": "simulator",
        "timeout_s": timeout_s,
        "axes": copy.deepcopy(_AXES),
        "simulator": {"time_scale": time_scale, "seed": seed},
    }
    if protocol == "ascii":
        motion["ascii"] = copy.deepcopy(_ASCII)
        for name in ("camera_deg", "turn_deg"):
            motion["axes"][name]["channel"] = name[:4].upper()
    rig = {
        "kind": "virtual",
        "limits": _LIMITS,
        "motion": motion,
        "camera_distance_mm": 900.0,
        "light": {"spectrum": "A"},
        "virtual": {"seed": 1},
    }
    return validate(rig, "rig", "rig.yaml")


def at_port(rig: dict, port: str) -> dict:
    """Return a definition for a controller that runs already."""
    changed = copy.deepcopy(rig)
    changed["motion"]["port"] = port
    return changed


def wait_until_still(simulator: Simulator) -> dict:
    """Return the simulator's snapshot once nothing moves, and fail where that never comes."""
    for _ in range(4000):  # polls and no seconds: on a busy host the simulator is slow as well
        if not (seen := simulator.snapshot())["moving"]:
            return seen
        time.sleep(0.005)
    raise AssertionError("the axes never came to rest")


def failure(action) -> DeviceError | None:
    """Return the device's error that an action raises, None where it raises none."""
    try:
        action()
    except DeviceError as error:
        return error
    return None


__all__ = ["PATIENT_S", "TIMEOUT_S", "at_port", "definition", "failure", "start_simulator", "wait_until_still"]
