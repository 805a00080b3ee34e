"""Rig driver for controllers with Grbl 1.1, grblHAL or FluidNC."""

import contextlib
import math
import re
import time
import zlib
from collections.abc import Iterator, Mapping

from irodori.capture.rig.controlled_rig import MARGIN, POLL_S, ControlledRig
from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import (
    AlarmError,
    CommandError,
    DeadlineError,
    DeviceError,
    GarbledError,
    HeldError,
    Link,
    LinkError,
    RigStatus,
    SettingError,
)
from irodori.capture.rig.drives import Drive, along, straight_s
from irodori.capture.rig.grbl.codes import HARD_LIMIT, alarm_text
from irodori.capture.rig.grbl.conversation import HOW_TO_CLEAR, RESTARTED, Conversation
from irodori.capture.rig.grbl.protocol import (
    FLUIDNC,
    FULL_STATUS,
    GRBL,
    GRBLHAL,
    HOLD,
    JOG_CANCEL,
    LETTERS,
    RESUME,
    Feedback,
    Report,
    Setting,
    TextSetting,
    jog_line,
    motion_line,
)
from irodori.capture.rig.grbl.settings_check import (
    STEPS,
    TRAVEL,
    Disagreement,
    check_settings,
    disagreements,
    home_position,
    homing_s,
    number,
    switch_position,
)
from irodori.capture.rig.homings import Homings, Verdict
from irodori.core.progress import LOGGER

#: Interval between questions to a controller that may still be starting, s.
_KNOCK_S = 0.3
#: Positions are sent and reported with three decimals.
_ROUNDING = 1.5e-3
#: Length of the search for a switch beyond the position where it should close, degrees.
_SEARCH_DEG = 5.0
#: If no hard limit stops an axis, its way to the switch has so many steps, and the last is divided into their square.
_STEPS_TO_SWITCH = 4
#: Settings of grblHAL: whether jogs are limited to the travel, and a mask of the rotary axes.
_JOG_LIMITED, _ROTARY = 40, 376
#: Keys of each axis in FluidNC's own file that are switched off during the search for a limit switch.
_FLUIDNC_LIMITS = ("motor0/hard_limits", "soft_limits")
#: Number of tries to reach a switch if the alarm is that of another one.
_TRIES = 3
_SILENT = "it said nothing until it was reset, as after ALARM:1 or ALARM:2 (a limit switch, a target out of travel)"
_NUMBER = re.compile(r"-?\d{1,9}(?:\.\d{1,6})?", re.ASCII)
#: Tool word of Grbl's modal state, into which the mark of homing is written, and its largest number.
_TOOL, _LARGEST_TOOL = re.compile(r"(?:^| )T(\d{1,3})(?: |$)"), 255


class GrblRig(ControlledRig):
    """Rig with a controller that runs Grbl, grblHAL or FluidNC.

    The constructor wakes and resets the controller (motion in progress is first brought to rest), and compares its
    settings with the drives. An unlocked controller need not have been homed, because anybody can unlock it. Homing
    therefore writes a mark into the controller: a tool number, which moves nothing, and which Grbl forgets at every
    start and reset, that is, at everything that can cost it its position. After its own resets at rest this driver
    writes the mark again. grblHAL itself keeps a record of homing; FluidNC is homed each time it is opened.

    Parameters
    ----------
    link : Link
        Closed by `close`; if this constructor raises an error, the caller must close it.
    drives : dict
        {angle of a pose: drive}.
    timeout_s : float
        Longest time for a reply, s. A board that restarts when its port is opened needs about 2 s.
    homing : bool
        Whether the axes have limit switches. If not, positions count from that at power-on.
    checked : bool
        Whether to refuse a controller with settings that contradict the drives; an unchecked one does not move.
    homings : Homings, optional
        Record of the rig's homings; by default an empty one, which ends with the process.

    Raises
    ------
    SettingError, DeadlineError, LinkError
    """

    def __init__(
        self,
        link: Link,
        drives: Mapping[str, Drive],
        *,
        timeout_s: float = 3.0,
        homing: bool = True,
        checked: bool = True,
        homings: Homings | None = None,
    ) -> None:
        super().__init__(drives, timeout_s, homing)
        self.homings = homings or self.homings
        self._talk, self._is_homing = Conversation(link, timeout_s), False
        self._options, self._mark_found, self._homes = "", 0, dict[str, float]()
        self._file_limits: dict[str, bool] = {}
        report = self._wake()
        self._settings = self._read_settings()
        if not checked:
            return
        check_settings(self._settings, self._options, self.drives, homing, self._homes)
        self._homed = not homing or (report.state != "Alarm" and self._was_homed())
        if self._homed:
            self._write_mark()

    _without_switches = "put it where it was switched on and start anew, or unlock it"

    # ---- what every rig does

    def move(self, targets_deg: Mapping[str, float]) -> None:
        """Move axes in a straight line and wait until they are at rest there; see `RigDevice.move`."""
        self.check(targets_deg)
        if not targets_deg:
            return
        with self._stopping_on_failure():
            places = self._ready()
            after = {**places, **{name: self.drives[name].to_units(angle) for name, angle in targets_deg.items()}}
            line, seconds = self._motion(places, after)
            arrival = Deadline(seconds * (1 + MARGIN) + self._timeout_s)
            arrival = self._send(line, places, arrival)
            self._await_arrival([places, after], arrival)

    def jog(self, name: str, by_deg: float) -> None:
        """Move one axis by an angle, degrees, with a jog command, which a stop cancels completely."""
        self.check({name: self.axes[name].min_deg if name in self.axes else by_deg})
        with self._stopping_on_failure(JOG_CANCEL):
            places, drive = self._ready(), self.drives[name]
            target_deg = drive.to_deg(places[name]) + by_deg
            self.check({name: target_deg})
            after = {**places, name: drive.to_units(target_deg)}
            seconds = self._travel([after[n] - places[n] for n in places])
            arrival = Deadline(seconds * (1 + MARGIN) + self._timeout_s)
            arrival = self._send(jog_line({drive.channel: after[name]}, drive.speed * 60.0), places, arrival)
            self._await_arrival([places, after], arrival)

    def status(self) -> RigStatus:
        """Return the state that the controller reports; see `RigDevice.status`."""
        self._get_in_step()
        try:
            report = self._talk.ask_report()
        except AlarmError:
            # It stands, and after a limit switch or a soft limit it reports its position only once it is reset.
            self._talk.soft_reset()
            report = self._talk.ask_report()
        if report.state == "Alarm" or self._talk.restarted:
            self._homed = False
        places = {name: drive.to_deg(self._place(report, drive)) for name, drive in self.drives.items()}
        words = [self._talk.message]
        if self._talk.restarted:
            words = [RESTARTED]
        elif report.state == "Alarm" and self._talk.alarm is not None:
            words = [alarm_text(self._talk.alarm)]
        if report.pins:
            words.append(f"active inputs: {report.pins}")
        return RigStatus(report.state.lower(), places, self._homed, "; ".join(filter(None, words)))

    def close(self) -> None:
        """Close the connection."""
        self._talk.link.close()

    def travel_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """Return the time of a straight move, s."""
        moves = {name: (to_deg[name] - from_deg[name]) * self.drives[name].units_per_deg for name in to_deg}
        return self._travel([moves.get(name, 0.0) for name in self.drives])

    # ---- what only this one does

    def settings(self) -> dict[int, float]:
        """Return the controller's ``$`` settings by number, as it reports them now.

        Raises
        ------
        CommandError
            If it is not at rest.
        HeldError
            If it is in feed hold: Grbl then reads no line.
        DeadlineError, LinkError
        """
        self._get_in_step()
        try:
            if self._talk.ask_report().state == "Hold":
                raise HeldError("the rig is held, and answers no question: clear the cause, then let it go on")
            return self._read_settings()
        except (LinkError, DeadlineError):
            self._in_step = False
            raise

    def disagreements(self) -> list[Disagreement]:
        """Return the settings of the controller that contradict the rig's file."""
        return disagreements(self._settings, self._options, self.drives, self._homing, self._homes)

    def write_settings(self, wanted: Mapping[int, float]) -> None:
        """Change settings of the controller, which stores them permanently, and read them back.

        Parameters
        ----------
        wanted : dict
            {number of the ``$`` setting: value}.

        Raises
        ------
        SettingError
            If the firmware has its settings in a file of its own, or a setting differs from the written value.
        GarbledError
            If another setting changed because a byte was lost in transmission; its value is restored.
        CommandError, HeldError, DeadlineError, LinkError
        """
        if self._firmware == FLUIDNC and wanted.keys() - {10, 13}:
            raise SettingError("FluidNC shows its $ settings but does not take them: change its config.yaml")
        self._homed, before = False, self._settings
        for key, value in wanted.items():
            self._talk.command(f"${key}={value:.10g}")
        self._settings = self.settings()
        # Without homing Grbl has no soft limits either.
        own = {*wanted, 20} if 22 in wanted else set(wanted)
        hit = {key: value for key, value in before.items() if key not in own and self._settings.get(key) != value}
        for key, value in hit.items():
            self._talk.command(f"${key}={value:.10g}")
        if hit:
            self._settings = self.settings()
            changed = ", ".join(f"${key}" for key in hit)
            raise GarbledError(f"a byte was lost on the way and changed {changed}, which was put back; try again")
        for key, value in wanted.items():
            if abs(self._settings.get(key, math.inf) - value) > 5e-4:
                raise SettingError(f"${key} was set to {value:g} and stands at {self._settings.get(key, 'nothing')}")

    # ---- lost steps

    @property
    def cannot_recount(self) -> str:
        """Reason, as a phrase, why `recount` is not possible; empty if it is."""
        return "" if self._homing else "this rig has no limit switches (motion.homing is false)"

    def recount(self) -> dict[str, float]:
        """Measure lost motor steps by comparing the controller's position with the limit switches, then home.

        See `RigDevice.recount`. Homing itself does not report its correction. Each axis therefore moves slowly, at the
        feed rate with which homing locates the switch, from the position after homing until the switch closes. Soft
        limits, which end before the switch, are switched off meanwhile; if they stay off because the connection is
        lost, the board is refused when it is next opened. With Grbl's hard limits, the alarm stops the axis and the
        position is kept. Without them the axis moves in small steps, and so it does with grblHAL and FluidNC, which
        have their hard limits switched off meanwhile too: after that alarm they may refuse to continue, or release the
        motors. If a switch does not close within `_SEARCH_DEG` beyond its position, this is the result for its axis.
        """
        if self.cannot_recount:
            raise CommandError(self.cannot_recount)
        if self._firmware == FLUIDNC and not self._homed:
            raise CommandError("FluidNC is homed each time it is opened: its sessions look for lost steps at their end")
        limits, found = self._limits(), dict[str, float]()
        with self._stopping_on_failure():
            self._ready()
        try:
            with self._stopping_on_failure():
                self._put_limits(dict.fromkeys(limits, 0))
                for name, drive in self.drives.items():
                    home = home_position(self._settings, self._options, drive, self._homes)
                    switch = switch_position(self._settings, drive, home)
                    lost = (switch - self._closing(drive, home, switch)) / drive.units_per_deg
                    found[name] = round(lost, 4) + 0.0
            self.homings.conclude(Verdict(found))
        except BaseException:
            if Verdict(found).off(self.axes) and not self.homings.verdicts(self.homings.current):
                with contextlib.suppress(DeviceError):
                    self.homings.conclude(Verdict(found))  # the search ended early, but has found enough
            try:
                self._put_limits(limits)
            except DeviceError:
                left_off = "start the board anew" if self._firmware == FLUIDNC else _assignments(limits)
                LOGGER.warning("the board was left without its limits: before it moves again, %s", left_off)
            raise
        self._put_limits(limits)
        self.home()
        return found

    def _limits(self) -> dict[int | str, float]:
        """Return {setting: value} of the limits that keep an axis from its switch, in the order of their restoration.

        Soft limits are restored last: if they are on, the others are too, and a board without them is refused.
        """
        if self._firmware == FLUIDNC:
            return {path: 1 for name in _FLUIDNC_LIMITS for path, on in self._file_limits.items()
                    if on and path.endswith(name)}  # fmt: skip
        others = (21, _JOG_LIMITED) if self._firmware == GRBLHAL else ()
        return {key: self._settings[key] for key in (*others, 20) if self._settings.get(key)}

    def _put_limits(self, values: Mapping[int | str, float]) -> None:
        """Set limits, repeatedly if a byte or an answer was lost."""
        for left in reversed(range(_TRIES)):
            try:
                self._set_limits(values)
                return
            except (GarbledError, CommandError, SettingError, DeadlineError) as error:
                if not left or not self._in_step:
                    raise
                if isinstance(error, DeadlineError):
                    self._halt()  # a late answer must not be taken for the next one

    def _set_limits(self, values: Mapping[int | str, float]) -> None:
        """Set limits, see `_limits`; in FluidNC's file the change lasts until a restart."""
        if settings := {key: value for key, value in values.items() if isinstance(key, int)}:
            homed = self._homed
            try:
                self.write_settings(settings)
            finally:
                self._homed = homed  # no limit changes the count
        wanted = {key: "true" if value else "false" for key, value in values.items() if isinstance(key, str)}
        for path, value in wanted.items():
            self._talk.command(f"${path}={value}")
        for path, value in wanted.items():
            if (found := self._in_file(path)) != value:
                raise GarbledError(f"{path} was set to {value} and stands at {found}: a byte was lost on the way")
        if wanted:
            self._settings = self._read_settings()

    def _closing(self, drive: Drive, home: float, switch: float) -> float:
        """Return the controller's position at which the limit switch of a drive closes, controller units."""
        ahead = math.copysign(1.0, switch - home)
        last, slow = switch + ahead * _SEARCH_DEG * abs(drive.units_per_deg), self._settings[24] / 60.0
        closed = self._until_closed(drive, home, drive.speed)
        if self._settings[21] and self._firmware == GRBL:
            if closed is None:
                closed = self._until_closed(drive, last, slow)
            return last if closed is None else closed
        step, at = (switch - home) / _STEPS_TO_SWITCH, home
        while closed is not None:
            at -= step
            closed = self._until_closed(drive, at, drive.speed)
        while closed is None:
            if (at - last) * ahead >= 0.0:
                return last
            at += step
            closed = self._until_closed(drive, at, slow)
        # Again in small steps, from outside: a switch opens at another position than it closes.
        self._until_closed(drive, at - 2.0 * step, slow)
        places = (at + step * (part / _STEPS_TO_SWITCH**2 - 1.0) for part in range(1, _STEPS_TO_SWITCH**2))
        return next((place for place in places if self._until_closed(drive, place, slow) is not None), at)

    def _until_closed(self, drive: Drive, target: float, speed: float) -> float | None:
        """Move a drive to a position, units; return the position at which its switch closed, None if it did not."""
        name = drive.axis.name
        for _ in range(_TRIES):
            _, places = self._look()
            way = [(places if other != name else {name: target})[other] - places[other] for other in places]
            arrival = Deadline(abs(target - places[name]) / speed + self._travel(way) + 2.0 * self._timeout_s)
            try:
                arrival = self._send(jog_line({drive.channel: target}, speed * 60.0), places, arrival)
                self._await_arrival([places, {**places, name: target}], arrival)
            except AlarmError:
                if self._talk.alarm != HARD_LIMIT:
                    raise
                self._talk.soft_reset()
                report = self._talk.ask_report()
                self._talk.command("$X")
                self._talk.alarm = None
                if drive.channel not in report.pins:
                    # A slow stop costs no steps, and another switch, which its axis stands on, may chatter.
                    if speed > self._settings[24] / 60.0:
                        raise
                    continue
            else:
                report = self._talk.ask_report()
            return self._place(report, drive) if drive.channel in report.pins else None
        raise AlarmError(f"{name}: {_TRIES} times ALARM:1 although its limit switch is open; look at the switches")

    # ---- steps of the above

    def _wake(self) -> Report:
        """Bring a controller from any state to rest, reset it, and return its status report."""
        knocking, report = Deadline(self._timeout_s), None
        while report is None and not (knocking.passed or self._talk.locked):
            with contextlib.suppress(DeadlineError, GarbledError, CommandError, AlarmError):
                report = self._talk.ask_report(min(_KNOCK_S, self._timeout_s))
        # In feed hold it reads no line: then the reset deletes the mark.
        if self._homing and report is not None and report.state in ("Idle", "Run"):
            self._mark_found = self._read_mark()
        if report is not None and report.moving:
            self._halt()
        else:
            try:
                self._talk.soft_reset()
            except DeadlineError:
                raise DeadlineError(
                    f"no Grbl controller answers within {self._timeout_s:g} s: is it on, are port and baud right?"
                ) from None
        after = self._talk.ask_report()
        self._in_step = True
        if report is None and after.state == "Alarm" and self._talk.alarm is None:
            # This also follows a power cut, but then it would have answered in time or sent its banner.
            self._talk.message = _SILENT
        return after

    def _halt(self) -> None:
        """Bring the axes to rest and reset the controller, which discards all lines and moves."""
        talk, still = self._talk, Deadline(self._brake_s * (1 + MARGIN) + self._timeout_s)
        try:
            # During homing and after some alarms the controller reacts to nothing but a reset.
            while not (self._is_homing or talk.locked):
                talk.link.write(HOLD)
                try:
                    report = talk.ask_report(min(self._timeout_s, still.remaining_s))
                    if not report.moving:
                        break
                except AlarmError:
                    break
                except (GarbledError, CommandError):
                    pass
                if still.passed:
                    break
                time.sleep(POLL_S / 3)
        except DeadlineError:
            pass
        self._is_homing = False
        talk.soft_reset()
        self._in_step = True
        if self._homed:
            try:
                self._write_mark()
            except CommandError:  # locked: the reset came while something still moved
                self._homed = False

    def _send(self, line: str, places: Mapping[str, float], arrival: Deadline) -> Deadline:
        """Send a line that moves the axes from their positions, units; return the deadline of its end.

        Without an answer, either the line or its ``ok`` was lost, and the positions of the axes show which. A line that
        was not executed is sent again: its target is absolute.
        """
        try:
            self._talk.command(line)
            return arrival
        except (DeadlineError, GarbledError):
            state, now = self._look()
            if state == "idle" and not self._off_target(now, places):
                self._halt()  # forgets what has arrived of the line
                self._talk.command(line)
        return Deadline(arrival.seconds)

    # ---- whether the axes have been homed

    @property
    def _mark(self) -> int:
        """Tool number that marks the last homing with the present settings, on which positions depend.

        Without the homing, one of another project or computer would be taken for that of its own record.
        """
        keys = [23, 27, *(number(first, drive) for drive in self.drives.values() for first in (STEPS, TRAVEL))]
        marked = repr([self._settings.get(key) for key in keys]) + self.homings.stored
        return 1 + zlib.crc32(marked.encode()) % _LARGEST_TOOL

    def _was_homed(self) -> bool:
        """Return whether a report or the mark shows that the controller was homed and has kept its position since."""
        if self._firmware == GRBLHAL:
            return self._talk.ask_report(question=FULL_STATUS).homed is True
        return self._firmware == GRBL and self._mark_found == self._mark

    def _write_mark(self) -> None:
        if self._homing and self._firmware == GRBL:
            self._talk.command(f"T{self._mark}")

    def _read_mark(self) -> int:
        """Return the tool number in the controller's state, 0 if it does not report one."""
        # The first line also ends, and makes the controller refuse, a line that another program left unfinished.
        for _ in range(2):
            with contextlib.suppress(DeviceError):
                for said in self._talk.command("$G", min(_KNOCK_S, self._timeout_s)):
                    if isinstance(said, Feedback) and said.kind == "GC" and (found := _TOOL.search(said.text)):
                        return int(found[1])
        return 0

    @contextlib.contextmanager
    def _stopping_on_failure(self, first: bytes = b"") -> Iterator[None]:
        """Stop the rig if the block ends with an exception, also with Ctrl-C."""
        try:
            yield
        except BaseException as error:
            if isinstance(error, AlarmError) or self._talk.restarted:
                self._homed = False
            with contextlib.suppress(DeviceError):
                self._talk.link.write(first or HOLD)
            self.stop()
            if isinstance(error, AlarmError) and error.of_switch and self._homing:
                try:
                    self.homings.conclude(Verdict({}, str(error)))
                except DeviceError as untold:
                    LOGGER.warning("%s", untold)
            raise

    def _get_in_step(self) -> None:
        if not self._in_step:
            self._wake()

    def _find_switches(self) -> None:
        self._halt()
        self._talk.alarm, self._is_homing = None, True
        self._talk.home(homing_s(self._settings, self.drives) + self._timeout_s)
        self._is_homing = False
        report = self._talk.ask_report()
        self._refuse_unless_idle(report)
        for drive in self.drives.values():
            at, wanted = self._place(report, drive), home_position(self._settings, self._options, drive, self._homes)
            if abs(at - wanted) > self._tolerance(drive):
                raise LinkError(
                    f"{drive.axis.name}: homing ended at {drive.channel} {at:g} instead of {wanted:g}: "
                    "the command was garbled on its way, or $23 or $27 is not what the controller does"
                )
        self._write_mark()
        self._talk.message = ""  # what it said while it was locked

    def _send_resume(self) -> None:
        self._talk.link.write(RESUME)

    def _astray(self, what: str) -> DeviceError:
        return LinkError(f"{what}; a command was garbled on its way, or a jog was ended by feed hold")

    def _look(self) -> tuple[str, dict[str, float]]:
        report = self._talk.ask_report()
        self._refuse_alarm(report)
        if report.state in ("Door", "Sleep", "Check"):
            self._refuse_unless_idle(report)
        places = {name: self._place(report, drive) for name, drive in self.drives.items()}
        # A hold with axes that still slow down counts as motion: until they stand, Grbl does not accept its end.
        return "run" if report.moving else report.state.lower(), places

    def _refuse_unless_idle(self, report: Report) -> None:
        self._refuse_alarm(report)
        if report.state != "Idle":
            why = {"Door": "close the safety door", "Sleep": "switch it off and on", "Check": "end its check mode ($C)"}
            what = why.get(report.state, "another program or its buttons move it")
            raise CommandError(f"the controller is not idle but says {report.state}: {what}")

    def _refuse_alarm(self, report: Report | None = None) -> None:
        if self._talk.restarted:
            self._homed = False
            raise AlarmError(RESTARTED)
        if self._talk.alarm is not None and (report is None or report.state == "Alarm"):
            self._homed = False
            why = f"the controller stopped on its own: {alarm_text(self._talk.alarm)}; {HOW_TO_CLEAR}"
            raise AlarmError(why, self._talk.alarm == HARD_LIMIT)
        if report is not None and report.state == "Alarm":
            self._homed = False
            raise AlarmError("the controller is locked, as it is after switching on or an alarm: home it first")

    def _motion(self, places: Mapping[str, float], after: Mapping[str, float]) -> tuple[str, float]:
        """Return the command for a straight move between positions in controller units, and its time, s."""
        way = {name: after[name] - places[name] for name in places}
        named = {self.drives[n].channel: after[n] for n in way if abs(way[n]) > self._tolerance(self.drives[n]) / 4}
        moved = [n for n in way if self.drives[n].channel in named]
        if not moved:
            return "", 0.0
        drives = [self.drives[n] for n in moved]
        speed, _ = along([way[n] for n in moved], [d.speed for d in drives], [d.acceleration for d in drives])
        straight = [way[n] for n in moved if not self._is_rotary(self.drives[n])]
        if straight:
            # In a move of linear and rotary axes, grblHAL applies the feed to the linear ones.
            speed *= math.hypot(*straight) / math.hypot(*(way[n] for n in moved))
        return motion_line(named, speed * 60.0), self._travel([way[n] for n in self.drives])

    def _is_rotary(self, drive: Drive) -> bool:
        """Return whether the controller treats an axis as rotary."""
        mask = int(self._settings.get(_ROTARY, 0)) if self._firmware == GRBLHAL else 0
        return bool(mask >> LETTERS.index(drive.channel) & 1)

    def _travel(self, way: list[float]) -> float:
        drives = list(self.drives.values())
        return straight_s(way, [d.speed for d in drives], [d.acceleration for d in drives])

    def _place(self, report: Report, drive: Drive) -> float:
        """Return the position of a drive in a report, controller units."""
        places, index = report.machine, LETTERS.index(drive.channel)
        if places is None or len(places) <= index:
            raise GarbledError(f"the controller reports no machine position of its axis {drive.channel}")
        return places[index]

    def _tolerance(self, drive: Drive) -> float:
        """Return the largest accepted distance of a drive from its target at rest: a motor step and the rounding."""
        return 1.0 / self._settings[number(STEPS, drive)] + _ROUNDING

    def _read_settings(self) -> dict[int, float]:
        """Return the ``$`` settings, read twice, because nothing else would show that a digit was lost."""
        self._options, self._firmware = "", self._talk.firmware
        for message in self._talk.command("$I"):
            if isinstance(message, Feedback) and (message.kind, message.text) == ("FIRMWARE", GRBLHAL):
                self._firmware = GRBLHAL
            if isinstance(message, Feedback) and message.kind == "VER" and FLUIDNC in message.text:
                self._firmware = FLUIDNC
            if isinstance(message, Feedback) and message.kind == "OPT":
                self._options = message.text.partition(",")[0]
        first, second = (
            {m.number: m.value for m in self._talk.command("$$") if isinstance(m, Setting)} for _ in range(2)
        )
        if first != second:
            raise GarbledError("the controller's settings read differently twice in a row: the line is garbled")
        if self._firmware != FLUIDNC:
            return second
        # Old versions do not list these two, and report as Grbl does with these values.
        return {10: 1, 13: 0} | second | (self._configured() if self._homing else {})

    def _configured(self) -> dict[int, float]:
        """Return FluidNC's configuration of homing as settings of Grbl, and record the positions after homing."""
        places = {"mpos_mm": "homing", "feed_mm_per_min": "homing", "seek_mm_per_min": "homing", "settle_ms": "homing"}
        found: dict[str, list[float]] = {name: [] for name in (*places, "pulloff_mm")}
        self._file_limits = {}
        for drive in self.drives.values():
            axis = f"/axes/{drive.channel.lower()}"
            for name, values in found.items():
                path = f"{axis}/{places.get(name, 'motor0')}/{name}"
                if not _NUMBER.fullmatch(said := self._in_file(path)):
                    raise SettingError(f"{drive.axis.name}: the controller's file lacks {path[1:]}")
                values.append(float(said))
            for name in _FLUIDNC_LIMITS:
                self._file_limits[f"{axis}/{name}"] = self._in_file(f"{axis}/{name}") == "true"
            self._homes[drive.channel] = found["mpos_mm"][-1]
        # The slowest axis decides how long homing may take. FluidNC's own $20 is for the first axis alone, $21 for any.
        feeds, seeks = found["feed_mm_per_min"], found["seek_mm_per_min"]
        homing = {24: min(feeds), 25: min(seeks), 26: max(found["settle_ms"]), 27: max(found["pulloff_mm"])}
        hard, soft = ([on for path, on in self._file_limits.items() if path.endswith(name)] for name in _FLUIDNC_LIMITS)
        return {**homing, 20: float(all(soft)), 21: float(any(hard))}

    def _in_file(self, path: str) -> str:
        """Return the value at a path of FluidNC's own configuration, empty if it reports none."""
        with contextlib.suppress(CommandError):
            said = [m.text for m in self._talk.command(f"${path}") if isinstance(m, TextSetting) and m.name == path]
            if len(said) == 1:
                return said[0]
        return ""


def _assignments(values: Mapping[int | str, float]) -> str:
    """Return settings in the form in which they are typed."""
    return ", ".join(f"${key}={value:g}" for key, value in values.items())
