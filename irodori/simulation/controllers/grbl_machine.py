"""Model of a Grbl 1.1 controller: replies and axis motion, without the serial line.

The model follows the firmware's documentation and its order of events: single-byte commands act at once; lines wait in
a serial buffer of 128 bytes and are read while the planner has room; a hold stops the reading; nothing is answered
during homing. Moves end at rest; the firmware blends the corners of a path, which no pose of the rig needs. The
differences of grblHAL and FluidNC are taken from their sources: machine_limits.c, planner.c and system.c of
grblHAL/core; RuntimeSetting.cpp, Cartesian.cpp and ProcessSettings.cpp of bdring/FluidNC.
"""

import math
import random

from irodori.capture.rig.drives import along
from irodori.capture.rig.grbl.protocol import FIRMWARES, FLUIDNC, GRBL, GRBLHAL, LINE_BYTES, RX_BUFFER_BYTES
from irodori.simulation.controllers.grbl_gcode import GcodeError, Modes, Move, parse_block
from irodori.simulation.controllers.peer_server import Machine
from irodori.simulation.controllers.trapezoidal_motion import Block, Stage

PLANNER_BLOCKS = 15
DEFAULTS = {
    0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.01, 12: 0.002, 13: 0,
    20: 1, 21: 0, 22: 1, 23: 0, 24: 300.0, 25: 3000.0, 26: 250, 27: 1.0, 30: 1000.0, 31: 0.0, 32: 0,
    **dict.fromkeys((100, 101, 102), 100.0), **dict.fromkeys((110, 111, 112), 1200.0),
    **dict.fromkeys((120, 121, 122), 100.0), **dict.fromkeys((130, 131, 132), 200.0),
}  # fmt: skip
_WHOLE = (0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 32, 40, 376)
#: Settings of grblHAL: whether jogs end at the travel, also without soft limits; which axes are rotary, a bit each.
_JOG_LIMITED, _ROTARY = 40, 376
#: Messages of each firmware at its start, and replies to ``$I``, taken from their sources.
_BANNERS = {
    GRBL: "Grbl 1.1h ['$' for help]",
    GRBLHAL: "GrblHAL 1.1f ['$' or '$HELP' for help]",
    FLUIDNC: "Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]",
}
_BUILDS = {
    GRBL: ["[VER:1.1h.20190830:]", f"[OPT:V,{PLANNER_BLOCKS},{RX_BUFFER_BYTES}]"],
    GRBLHAL: [
        "[VER:1.1f.20230419:]",
        "[OPT:VNMSL,35,1024,3,0]",
        "[AXS:3:XYZ]",
        "[NEWOPT:ENUMS,RT+,HOME,SED]",
        "[FIRMWARE:grblHAL]",
        "[NVS STORAGE:*FLASH]",
        "[DRIVER:RP2040]",
        "[DRIVER VERSION:230418]",
        "[DRIVER OPTIONS:SDK_1.5.0]",
        "[AUX IO:0,1,0,0]",
    ],
    FLUIDNC: ["[VER:3.7 FluidNC v3.7.8:]", "[OPT:PHS]", "[MSG: Machine: Default (Test Drive)]"],
}
#: Limits in FluidNC's configuration, by their setting's number in Grbl; changes last until the next start.
_LIMITS = {20: "soft_limits", 21: "motor0/hard_limits"}
_CONFIGURED = {24: "homing/feed_mm_per_min", 25: "homing/seek_mm_per_min", 26: "homing/settle_ms",
               27: "motor0/pulloff_mm"}  # fmt: skip
_LOCKED = "[MSG:'$H'|'$X' to unlock]"
_TRAVEL_SLACK = 1e-6
#: Distance from a switch to the end of the mechanics, units.
_STOP_BEHIND = 2.0
#: Largest error of the position count after a stop without deceleration at full speed, units.
_LOST_AT_SPEED = 0.3


class GrblMachine(Machine):
    """Simulated Grbl controller and its mechanics.

    Like the firmware, it sends nothing after an alarm of a hard or soft limit until it is reset, and it never answers a
    status query if a reset comes before the answer.

    Parameters
    ----------
    settings : dict
        ``$`` settings that differ from `DEFAULTS`; the travels among them are also those of the mechanics.
    letters : str
        Letters of the axes.
    seed : int
        Seed of the initial positions and of all other random numbers.
    homing_rms : float
        Repeatability of the switches, standard deviation, units.
    firmware : str
        One of `FIRMWARES`; grblHAL and FluidNC answer in every alarm, and grblHAL reports whether it is homed.

    Attributes
    ----------
    hysteresis : float
        Distance between the points where a limit switch closes and where it opens again, units.
    """

    state = "Idle"

    def __init__(
        self, settings=None, letters: str = "XYZ", seed: int = 0, homing_rms: float = 0.0, firmware: str = GRBL
    ) -> None:
        super().__init__()
        if firmware not in FIRMWARES:
            raise ValueError(f"no firmware {firmware!r}; accepted: {', '.join(FIRMWARES)}")
        self.firmware, self._is_homed, self._full = firmware, False, False
        own = {_JOG_LIMITED: 0, _ROTARY: 0} if firmware == GRBLHAL else {}
        self.settings = {**DEFAULTS, **own, **(settings or {})}
        self._told: dict[tuple[int, int], bool] = {}
        self.letters, self.channels, self._homing_rms = letters, tuple(letters), homing_rms
        self._rng = random.Random(seed)
        self._length = [self._of(130, axis) for axis in range(len(letters))]
        starts = [-self._rng.uniform(0.1, 0.9) * length for length in self._length]
        # Without switches the mechanics have no ends, and the operator has set the axes to zero before switching on.
        self._has_ends = bool(self.settings[22])
        self.stage = Stage(starts if self._has_ends else [0.0 for _ in starts])
        self.hysteresis, self._pressed = 0.0, set[int]()
        self._pressed = self._switches()
        self.stages = (self.stage,)
        self.power_up()

    # ---- power, reset, alarms

    def power_up(self) -> None:
        """Start as after switching on: with a position count of zero, wherever the axes stand."""
        self.stage.clear()
        self._is_homed = False
        self._told.clear()
        self._origin = list(self.stage.position)
        self.state = "Alarm" if self.settings[22] else "Idle"
        self._restart()

    def raise_alarm(self, code: int) -> None:
        """Stop at once and report an alarm: 1 and 2 then wait silently for a reset; 3 and those of homing restart."""
        # The position count stays valid after a soft limit, because the axes have come to rest before.
        self._is_homed &= code == 2
        self._stop_dead()
        self.state, self._locked = "Alarm", code in (1, 2)
        self._say(f"ALARM:{code}")
        if self._locked:
            self._say("[MSG:Reset to continue]")
        elif code not in (4, 5):
            self._restart()

    def slip(self, by: float, axis: int = 0) -> None:
        """Lose steps of an axis; see `Machine.slip`."""
        self.stage.slip(axis, by)
        self._origin[axis] += by

    def _soft_reset(self) -> None:
        if self.state == "Home" or self.stage.moving:
            self.raise_alarm(6 if self.state == "Home" else 3)
            return
        if self.state != "Alarm":
            self.state = "Alarm" if self.state == "Sleep" else "Idle"
        self.stage.clear()
        self._restart()

    def _restart(self) -> None:
        self._rx, self._line, self._too_long = bytearray(), "", False
        self._modes, self._locked, self._suspended = Modes(), False, False
        self._blocked: Move | tuple[Move, bool] | None = None
        self._dwell_s, self._alarm_when_still, self._reports, self._report_due = 0.0, 0, 0, False
        self.stage.clear()
        self._homing: list[tuple[list[float], float]] = []
        self._say("")
        self._say(_BANNERS[self.firmware])
        if self.state == "Alarm":
            self._say(_LOCKED)

    def _stop_dead(self) -> None:
        """Stop without deceleration: the motors lose steps, so that the count no longer matches the axes.

        No steps are lost at the slow rate of homing, which ends in such a stop too.
        """
        if self.stage.moving and self.stage.speed > self.settings[24] / 60.0 * (1 + 1e-6):
            for axis in range(len(self.letters)):
                share = self.stage.speed / (self._of(110, axis) / 60.0)
                self._origin[axis] += self._rng.uniform(-_LOST_AT_SPEED, _LOST_AT_SPEED) * min(1.0, share)
        self.stage.clear()
        self._homing = []

    # ---- the line

    def receive(self, byte: int) -> None:
        """Receive a byte: single-byte commands act at once; others enter the serial buffer, or are lost if full."""
        acts = {0x18: self._soft_reset, 0x3F: self._ask, 0x21: self.press_hold, 0x7E: self._resume, 0x85: self._cancel}
        if self.firmware == GRBLHAL:
            acts[0x87] = self._ask_all
        if byte in acts:
            acts[byte]()
        elif byte < 0x80 and len(self._rx) < RX_BUFFER_BYTES:
            self._rx.append(byte)
        self._read()

    def _read(self) -> None:
        """Execute lines from the serial buffer until a full planner, a hold, a lock or homing stops the reading."""
        while self._rx and not (self._blocked or self._suspended or self._locked or self.state == "Home"):
            letter = chr(self._rx.pop(0))
            if letter not in "\r\n":
                self._too_long |= len(self._line) >= LINE_BYTES - 1
                self._line += "" if letter <= " " or self._too_long else letter.upper()
                continue
            line, too_long = self._line.partition(";")[0], self._too_long
            self._line, self._too_long = "", False
            self.lines += bool(line) or letter == "\n"
            try:
                if too_long:
                    raise GcodeError(11)
                self._execute(line)
            except GcodeError as error:
                self._say(f"error:{error.code}")

    def _execute(self, line: str) -> None:
        if line.startswith("$"):
            self._system(line)
        elif line and self.state in ("Alarm", "Jog"):
            raise GcodeError(9)
        else:
            self._take(parse_block(line, self._modes, self.letters) if line else Move())

    def _say(self, text: str) -> None:
        self.output += text.encode() + b"\r\n"

    # ---- single bytes

    def _ask(self) -> None:
        """Note a status query; a reset before the report is written discards it."""
        self._report_due = True

    def _ask_all(self) -> None:
        self._report_due = self._full = True

    def _answer(self) -> None:
        """Write the requested status report, except in Grbl during homing or a lock."""
        if self._report_due and not (self.firmware == GRBL and (self._locked or self.state == "Home")):
            self._report_due = False
            if self.dropped_reports:
                self.dropped_reports -= 1
            else:
                self._say(self._report())

    def press_hold(self) -> None:
        """Begin a feed hold, as the command ``!`` and the board's input do."""
        if self.state == "Jog":
            self._cancel()
        elif self.state in ("Run", "Idle"):
            self.state, self.stage.holding, self._suspended = "Hold", True, True

    def _resume(self) -> None:
        if self.state == "Hold" and self.stage.speed == 0.0:
            self.stage.holding = self._suspended = False
            self.state = "Run" if self.stage.blocks else "Idle"
            self._read()

    def _cancel(self) -> None:
        if self.state == "Jog":
            self.stage.holding = True
            # Grbl discards the waiting jogs and its serial buffer.
            self._rx.clear()
            self._line, self._blocked = "", None

    def _report(self) -> str:
        mask = int(self.settings[10])
        state = self.state
        if state == "Hold":
            state += ":1" if self.stage.speed else ":0"
        fields = [state, ("MPos:" if mask & 1 else "WPos:") + _join(self.count())]
        if mask & 2:
            room = PLANNER_BLOCKS - len(self.stage.blocks)
            fields.append(f"Bf:{room},{RX_BUFFER_BYTES - len(self._rx)}")
        fields.append(f"FS:{self.stage.speed * 60:.0f},0")
        if pressed := "".join(self.letters[axis] for axis in sorted(self._switches())):
            fields.append(f"Pn:{pressed}")
        if self._reports % 10 == 0:
            fields.append("WCO:" + _join([0.0] * len(self.letters)))
        elif self._reports % 10 == 1:
            fields.append("Ov:100,100,100")
        self._reports += 1
        if self._full:
            self._full = False
            fields.append(f"H:{int(self._is_homed)}")
            fields.append("FW:grblHAL")
        return f"<{'|'.join(fields)}>"

    def count(self) -> list[float]:
        """Return the position that the controller has counted, on whole steps, units."""
        counted = []
        for axis, (true, origin) in enumerate(zip(self.stage.position, self._origin, strict=True)):
            steps = self._of(100, axis)
            counted.append(round((true - origin) * steps) / steps)
        return counted

    # ---- lines that begin with $

    def _system(self, line: str) -> None:
        if line.startswith("$J="):
            if self.state not in ("Idle", "Jog"):
                raise GcodeError(8)
            self._take(parse_block(line[3:], self._modes, self.letters, jog=True), jog=True)
            return
        still = self.state in ("Idle", "Alarm")
        if line not in ("$", "$G", "$X", "$C", "$$") and not still:
            raise GcodeError(8)
        if line == "$$" and self.state in ("Run", "Hold"):
            raise GcodeError(8)
        if line == "$H":
            self._begin_homing()
            return
        answers = {"$": ["[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"],
                   "$$": self._listed(),
                   "$G": [self._modes.report()],
                   "$I": _BUILDS[self.firmware],
                   "$N": ["$N0=", "$N1="],
                   "$#": [f"[G{n}:{_join([0.0] * len(self.letters))}]" for n in (*range(54, 60), 28, 30, 92)]
                         + ["[TLO:0.000]", f"[PRB:{_join([0.0] * len(self.letters))}:0]"]}  # fmt: skip
        if line == "$X":
            self._unlock()
        elif line == "$C":
            self._check_mode()
        elif line == "$SLP":
            self.state = "Sleep"
        elif line in answers:
            for answer in answers[line]:
                self._say(answer)
        elif self.firmware == FLUIDNC and line.startswith("$/"):
            self._in_file(line)
        else:
            self._store(line)
        self._say("ok")

    def _unlock(self) -> None:
        if self.state != "Alarm":
            return
        if self.firmware == GRBLHAL:
            # Strict hard limits, and homing that is required.
            if int(self.settings[21]) & 3 == 3 and self._switches():
                raise GcodeError(45)
            if int(self.settings[22]) & 4 and not self._is_homed:
                raise GcodeError(46)
        self._say("[MSG:Caution: Unlocked]")
        self.state = "Idle"

    def _check_mode(self) -> None:
        if self.state == "Check":
            self._say("[MSG:Disabled]")
            self._soft_reset()
        elif self.state != "Idle":
            raise GcodeError(8)
        else:
            self._say("[MSG:Enabled]")
            self.state = "Check"

    def _store(self, line: str) -> None:
        number, equals, value = line[1:].partition("=")
        try:
            key, new = float(number), float(value) if equals else 0.0
        except ValueError:
            raise GcodeError(2 if number[:1].isdigit() else 3) from None
        if not equals or key not in self.settings:
            raise GcodeError(3)
        if not 0.0 <= new < math.inf:
            raise GcodeError(4)
        if self.firmware == FLUIDNC and key not in (10, 13):
            raise GcodeError(162)
        if key == 20 and new and not self.settings[22]:
            raise GcodeError(10)
        if key == 0 and new < 3:
            raise GcodeError(6)
        self.settings[int(key)] = new
        # If homing is switched on now, the controller is locked only after the next start.
        if key == 22 and not new:
            self.settings[20] = 0

    def _listed(self) -> list[str]:
        """Return the reply to ``$$``, one line for each setting."""
        hidden = _CONFIGURED if self.firmware == FLUIDNC else ()
        lines = [f"${number}={self._printed(number)}" for number in sorted(self.settings) if number not in hidden]
        return [*lines, "$70=7", "$300=grblHAL", "$302=192.168.5.1"] if self.firmware == GRBLHAL else lines

    def _in_file(self, line: str) -> None:
        """Answer a query of FluidNC's configuration such as ``$/axes/x/homing/mpos_mm``, or change a limit in it."""
        path, equals, value = line.lower().partition("=")
        _, _, letter, *rest = path.split("/")
        axis, name = self.letters.find(letter.upper() or "-"), "/".join(rest)
        number = next((key for key, known in {**_CONFIGURED, **_LIMITS}.items() if known == name), None)
        if axis < 0 or (number is None and name != "homing/mpos_mm"):
            raise GcodeError(3)
        if equals and number in _LIMITS:
            self._told[number, axis] = value in ("true", "yes", "1")
        elif equals:
            raise GcodeError(3)
        elif number is None:
            self._say(f"{path}={self._after_homing(axis):.3f}")
        else:
            limit = str(self._limit(number, axis)).lower()
            self._say(f"{path}={limit if number in _LIMITS else f'{self.settings[number]:.3f}'}")

    def _limit(self, number: int, axis: int) -> bool:
        """Return whether a limit of an axis is enabled: setting 20 for the soft limit, 21 for the hard one."""
        return self._told.get((number, axis), bool(self.settings[number]))

    def _printed(self, number: int) -> str:
        value = self.settings[number]
        if number == 20:
            value = self._limit(20, 0)
        elif number == 21:
            value = value if not self._told else any(self._limit(21, axis) for axis in range(len(self.letters)))
        return str(int(value)) if number in _WHOLE else f"{value:.3f}"

    def _of(self, first: int, axis: int) -> float:
        return float(self.settings.get(first + axis, self.settings[first]))

    # ---- motion

    def _take(self, move: Move, jog: bool = False) -> None:
        """Add a move to the planner and answer it, or keep it waiting until there is room."""
        if move.dwell_s is not None:
            self._blocked, self._dwell_s = move, move.dwell_s
            return
        target = self._target(move)
        if jog and (self.firmware == FLUIDNC or (self.settings.get(_JOG_LIMITED) and self._is_homed)):
            target = self._within_travel(target)
        outside = not all(
            -self._of(130, axis) - _TRAVEL_SLACK <= place <= _TRAVEL_SLACK
            for axis, place in enumerate(target)
            if self._limit(20, axis)
        )
        if outside and jog:
            raise GcodeError(15)
        if outside:
            self._soft_limit()
            return
        if self.state != "Check" and move.targets:
            if len(self.stage.blocks) >= PLANNER_BLOCKS:
                self._blocked = (move, jog)
                return
            self._plan(target, move)
            if self.state in ("Idle", "Run", "Jog") and self.stage.blocks:
                self.state = "Jog" if jog else "Run"
        self._say("ok")

    def _target(self, move: Move) -> list[float]:
        """Return the end of a move in the controller's count, rounded to whole steps."""
        target = [true - origin for true, origin in zip(self.stage.end, self._origin, strict=True)]
        for letter, value in move.targets.items():
            axis = self.letters.index(letter)
            steps = self._of(100, axis)
            target[axis] = round((value + (target[axis] if move.relative else 0.0)) * steps) / steps
        return target

    def _within_travel(self, target: list[float]) -> list[float]:
        """Return the end of a jog clipped to the travel, as grblHAL does in one setting and FluidNC at soft limits."""
        for axis, place in enumerate(target):
            if self._limit(20, axis) or self.firmware == GRBLHAL:
                target[axis] = min(max(place, -self._of(130, axis)), 0.0)
        return target

    def _plan(self, target: list[float], move: Move) -> None:
        end = [count + origin for count, origin in zip(target, self._origin, strict=True)]
        way = [b - a for a, b in zip(self.stage.end, end, strict=True)]
        if max(map(abs, way)) < 1e-9:
            return
        axes = range(len(self.letters))
        speed, acceleration = along(way, [self._of(110, a) / 60.0 for a in axes], [self._of(120, a) for a in axes])
        if move.feed is not None:
            along_way, rotary = math.hypot(*way), int(self.settings.get(_ROTARY, 0))
            straight = math.hypot(*(step for axis, step in enumerate(way) if not rotary >> axis & 1))
            turns = any(rotary >> axis & 1 and abs(step) > 0.0 for axis, step in enumerate(way))
            feed = move.feed * along_way if move.inverse_time else move.feed
            if turns and straight and not move.inverse_time:
                feed *= along_way / straight
            speed = min(speed, feed / 60.0)
        self.stage.push(Block(end, speed, acceleration))

    def _soft_limit(self) -> None:
        if self.stage.moving:
            self.stage.holding, self._alarm_when_still, self._blocked = True, 2, Move()
        else:
            self.raise_alarm(2)

    def _begin_homing(self) -> None:
        if not self.settings[22]:
            raise GcodeError(5)
        self.state = "Home"
        self.stage.clear()
        signs = [-1 if int(self.settings[23]) >> axis & 1 else 1 for axis in range(len(self.letters))]
        error = [self._rng.gauss(0.0, self._homing_rms) if self._homing_rms else 0.0 for _ in signs]
        switch = [
            (0.0 if sign > 0 else -length) + e for sign, length, e in zip(signs, self._length, error, strict=True)
        ]
        off = [place - sign * self.settings[27] for place, sign in zip(switch, signs, strict=True)]
        seek, locate = self.settings[25] / 60.0, self.settings[24] / 60.0
        self._homing = [(switch, seek), (off, seek), (switch, locate), (off, seek)]
        self._next_homing()

    def _next_homing(self) -> None:
        target, speed = self._homing.pop(0)
        self.stage.push(Block(list(target), speed, min(self._of(120, a) for a in range(len(self.letters)))))

    def advance(self, seconds: float) -> None:
        """Advance simulated time by a number of seconds."""
        self._answer()
        self.stage.advance(seconds)
        self._meet_stops()
        if isinstance(self._blocked, tuple) and len(self.stage.blocks) < PLANNER_BLOCKS and not self._suspended:
            waiting, self._blocked = self._blocked, None
            self._take(*waiting)
            self._read()
        if self.stage.moving:
            return
        if self._alarm_when_still:
            code, self._alarm_when_still = self._alarm_when_still, 0
            self.raise_alarm(code)
        elif self.state == "Home":
            self._go_on_homing()
        elif self.state == "Jog" or (self.state == "Run" and not self.stage.blocks):
            self.stage.clear()
            self.state = "Idle"
        self._dwell(seconds)
        self._read()

    def _go_on_homing(self) -> None:
        if self._homing:
            self._next_homing()
            return
        for axis in range(len(self.letters)):
            self._origin[axis] = self.stage.position[axis] - self._after_homing(axis)
        self.state, self._is_homed = "Idle", True
        self._answer()
        self._say("ok")

    def _switches(self) -> set[int]:
        """Return the axes that press a limit switch: at position 0, or beyond the travel at the other end."""
        if not self._has_ends:
            return set()
        ends = enumerate(zip(self.stage.position, self._length, strict=True))
        back = dict.fromkeys(self._pressed, self.hysteresis)
        return {
            axis
            for axis, (place, length) in ends
            if not back.get(axis, 0.0) - length - 1e-6 <= place < -back.get(axis, 0.0) - 1e-6
        }

    def _after_homing(self, axis: int) -> float:
        """Return the count of an axis after homing, when it has pulled off its switch, units."""
        negative = int(self.settings[23]) >> axis & 1
        return -self._length[axis] + self.settings[27] if negative else -self.settings[27]

    def _dwell(self, seconds: float) -> None:
        """Advance a dwell, which begins after all earlier moves, and answer it at its end."""
        if isinstance(self._blocked, Move) and not (self.stage.blocks or self._suspended or self._locked):
            self._dwell_s -= seconds
            if self._dwell_s <= 0.0:
                self._blocked = None
                self._say("ok")

    def _meet_stops(self) -> None:
        """Raise an alarm at a limit switch; stall the motor, so that it loses steps, at the end of the mechanics."""
        before, self._pressed = self._pressed, self._switches()
        if self.state == "Home" or not self._has_ends:
            return
        # Grbl reacts to any change of its inputs, also to an opening switch; the others only to a closing one.
        changed = self._pressed - before or (before - self._pressed if self.firmware == GRBL else set())
        changed = {axis for axis in changed if self._limit(21, axis)}
        if changed and self.state != "Alarm":
            for axis in changed & self._pressed:
                # The motor stops at the very step.
                self.stage.shift(axis, max(-self._length[axis] - 2e-6, min(0.0, self.stage.position[axis])))
            self.raise_alarm(1)
        for axis, length in enumerate(self._length):
            place = self.stage.position[axis]
            end = min(max(place, -length - _STOP_BEHIND), _STOP_BEHIND)
            if end != place:
                self.stage.shift(axis, end)
                self._origin[axis] += end - place


def _join(values) -> str:
    return ",".join(f"{value:.3f}" for value in values)
