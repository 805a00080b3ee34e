"""Capture sessions: take, verify, check, hash and record every missing photograph of a plan.

A photograph is stored under a temporary name, decoded, renamed and then recorded in the table. Whatever interrupts the
session, the next one finds complete files and complete lines, and takes what is missing.
"""

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from irodori.capture.dialogue import Dialogue, RetakeLast, State
from irodori.capture.journal import Journal, storing
from irodori.capture.operator import HandSettings, Operator
from irodori.capture.rig.devices import (
    NOT_REPORTED,
    Axis,
    CameraDevice,
    DeviceError,
    RigDevice,
)
from irodori.capture.rig.homings import Homings, Verdict, told
from irodori.capture.setup_steps import hand_settings, motor_targets
from irodori.config.capture_table import Shot, Taken
from irodori.core.atomic_files import file_sha256
from irodori.core.errors import InputError, PlainError
from irodori.core.progress import LOGGER, track
from irodori.geometry.projected_outline import Outline
from irodori.ingest.mosaic import Mosaic, decode
from irodori.ingest.plausibility import Doubt, Drift, Look, Series, delivered_again, look_at, worth_recalling
from irodori.ingest.preview import preview_of

_TRIES = 3
#: Number of times that a doubtful photograph is taken if no person can be asked.
_UNATTENDED_TRIES = 2
#: Number of photographs, taken at places that motors moved to, after which a sitting looks for lost steps. The search
#: takes about as long as homing; more photographs between two searches would mean more to take again.
_PHOTOGRAPHS_PER_SEARCH = 50
#: Cameras round what they write into their files.
_TOLERANCE = 0.05
_TEMPORARY = ".part-"
#: Temporary files that a killed session leaves: its own, and that of the camera or of the DNG writer.
_LEFT_OVER = (f"{_TEMPORARY}*", f".{_TEMPORARY}*")


@dataclass
class Tally:
    """Counts of a session's photographs.

    ``kept`` photographs were in the table before, ``adopted`` ones were in the folder without a line, ``retired`` ones
    are no longer required, ``retaken`` ones were taken again at a person's request, or because a later photograph of
    the same pose contradicted them. ``doubted`` counts photographs that did not look as expected, ``accepted`` those
    that a person kept.
    """

    taken: int = 0
    kept: int = 0
    adopted: int = 0
    retired: int = 0
    retries: int = 0
    retaken: int = 0
    doubted: int = 0
    accepted: int = 0
    operator_steps: int = 0
    seconds: float = 0.0


class _BothInDoubt(Exception):
    """Request to take earlier photographs again, and then the one that contradicted them."""

    def __init__(self, files: Sequence[str]) -> None:
        super().__init__(*files)
        self.files = files


class PositionError(DeviceError):
    """Error for a rig that has lost steps, so that photographs may show other poses than their names state."""


@dataclass(frozen=True)
class PositionCheck:
    """Comparison of the controller's positions with the limit switches, after photographs were taken.

    Parameters
    ----------
    photographs : int
        Number of photographs, also of earlier sittings, since the rig was homed.
    lost_deg : dict
        {axis: true angle minus the angle that the controller counted, degrees}.
    """

    photographs: int
    lost_deg: Mapping[str, float]

    def __str__(self) -> str:
        return "limit switches found: " + told(self.lost_deg)

    def plain(self) -> dict:
        """Return the comparison as plain values for the session's record."""
        return {"photographs": self.photographs, "lost_deg": dict(self.lost_deg)}


def confirm(journal: Journal, homings: Homings, axes: Mapping[str, Axis]) -> dict[str, str]:
    """Remove the marks of photographs after which no step was lost, and return those that are in doubt.

    Returns
    -------
    dict
        {file: what was found out about the steps after the homing before it}.

    Raises
    ------
    DeviceError
    """
    verdicts = {file: homings.verdicts(homing) for file, homing in journal.unchecked.items()}
    found = {file: next(filter(None, (v.off(axes) for v in all_of)), "") for file, all_of in verdicts.items() if all_of}
    if sound := [file for file, off in found.items() if not off]:
        journal.checked(sound)
    return {file: off for file, off in found.items() if off}


class Session:
    """One sitting of a capture session.

    Parameters
    ----------
    camera : CameraDevice
    operator : Operator
        Person, or substitute, who makes the settings without a motor.
    journal : Journal
    rig : RigDevice, optional
        None if the rig is not used, as for an environment.
    tally : Tally, optional
        Counts from `take_stock`, to be continued.
    settle_s : float
        Time from the arrival of the motors to the shutter, s, including steps by hand in between.
    dialogue : Dialogue, optional
        Dialogue that shows the progress, and is checked for requests of the person between two photographs.
    left_s : callable, optional
        Function that returns the time that photographs take, s.
    outline_of : callable, optional
        Function that returns the `Outline` of the object in the pose of a photograph, None if there is none to draw.
    """

    def __init__(
        self,
        camera: CameraDevice,
        operator: Operator,
        journal: Journal,
        rig: RigDevice | None,
        tally: Tally | None = None,
        *,
        settle_s: float = 0.0,
        dialogue: Dialogue | None = None,
        left_s: Callable[[Sequence[Shot]], float] = lambda shots: 0.0,
        outline_of: Callable[[Shot], Outline | None] = lambda shot: None,
    ) -> None:
        self.camera, self.journal, self.rig = camera, journal, rig
        self.tally = tally or Tally()
        self._hand, self._left_s, self._outline_of = HandSettings(operator), left_s, outline_of
        self._dialogue = dialogue or Dialogue()
        self._settle_s, self._settled_at = settle_s, -math.inf
        self._stands: dict[str, float] = {}
        self._series, self._body, self._without_outline = Series(()), "", ""
        #: How often a photograph was doubted since it was last found sound.
        self._doubted: Counter[str] = Counter()
        #: Photographs that this sitting has taken.
        self._own: set[str] = set()
        #: Results of this sitting's drift frames.
        self.drift: list[Drift] = []
        #: Comparisons with the rig's limit switches in this sitting.
        self.position: list[PositionCheck] = []
        if rig is not None:
            # A person has started a feed hold, and must end it.
            rig.on_hold = operator.confirm

    def run(self, planned: Sequence[Shot], label: str) -> Tally:
        """Take the missing photographs of a plan, in its order, after homing a rig with an unknown position.

        After every fifty photographs, and at the end, the positions of the rig's controller are compared with its
        limit switches.

        Raises
        ------
        DeviceError
            For a fault of rig, camera or disk; photographs taken before are in the table. `PositionError` if the rig
            has lost steps.
        InputError
            If a photograph is broken or has wrong settings three times in a row, or is doubtful twice and nobody can be
            asked.
        """
        begun = time.monotonic()
        missing = self.journal.missing(planned)
        self.camera.prepare(missing)
        self._body = _body(self.camera.status())
        if self.rig is not None:
            # A plan beyond the rig's limits is refused before anything moves.
            for shot in planned:
                self.rig.check(motor_targets(shot, self.rig.axes))
            if self._know_place(self.rig, label):
                missing = self.journal.missing(planned)
                self.camera.prepare(missing)
        tries = 0
        while missing:
            tries += 1
            self._series = self._recalled(planned, missing)
            for number, shot in enumerate(track(missing, f"capture {label}"), 1):
                self._take_in_turn(shot, planned)
                if number % _PHOTOGRAPHS_PER_SEARCH == 0 and number < len(missing):
                    self._look_for_lost_steps(tries)
            if self._dialogue.watched:
                # Otherwise the command would end before the person has seen the last photograph. Photographs that are
                # taken again here are still checked for lost steps.
                self._take_in_turn(None, planned)
            self._look_for_lost_steps(tries)
            missing = self.journal.missing(planned)
        self.journal.finish(planned)
        self.tally.seconds = time.monotonic() - begun
        return self.tally

    def _know_place(self, rig: RigDevice, label: str) -> bool:
        """Home a rig with an unknown position; check any other for steps lost since it was homed.

        Photographs of interrupted sittings, after which the rig was not compared with its limit switches, are in doubt
        if it is found to have lost steps after them, by whatever command.

        Returns
        -------
        bool
            Whether photographs were set aside.

        Raises
        ------
        DeviceError
        """
        if rig.cannot_recount:
            LOGGER.info("lost steps are not looked for: %s", rig.cannot_recount)
        were_set_aside = not rig.cannot_recount and self._judge(rig, 1)
        # A homing that this record does not know, or of which all was found out, is none that photographs can refer to.
        is_recorded = bool(rig.cannot_recount or ((now := rig.homings.current) and not rig.homings.verdicts(now)))
        if not is_recorded or not rig.status().homed:
            LOGGER.info("%s: homing the rig", label)
            rig.home()
            return were_set_aside
        if rig.cannot_recount:
            return False
        if self._look_for_lost_steps(1):
            return True
        if not self.position and any(motor_targets(shot, rig.axes) for shot in self.journal.shots.values()):
            self.position.append(check := PositionCheck(0, rig.recount()))
            if off := Verdict(check.lost_deg).off(rig.axes):
                LOGGER.warning(
                    "%s: the rig was moved by hand, or has lost steps between two sittings; it is homed", off
                )
        return were_set_aside

    def _look_for_lost_steps(self, times: int) -> bool:
        """Compare the rig with its limit switches if photographs were taken since it was homed; see `_in_doubt`.

        Returns
        -------
        bool
            Whether photographs were set aside.

        Raises
        ------
        PositionError
            If no person can be asked and the photographs were already taken again.
        DeviceError
            For a fault of the rig, or if the person stops.
        """
        rig = self.rig
        if rig is None or rig.cannot_recount:
            return False
        placed = [file for file, homing in self.journal.unchecked.items() if homing == rig.homings.current]
        if not placed:
            return False
        self.position.append(check := PositionCheck(len(placed), rig.recount()))
        self._stands = {}
        LOGGER.info("%s", check)
        return self._judge(rig, times)

    def _judge(self, rig: RigDevice, times: int) -> bool:
        """Judge photographs by what was found out about lost steps; return whether any were set aside."""
        doubtful = confirm(self.journal, rig.homings, rig.axes)
        return bool(doubtful) and self._in_doubt(list(doubtful), ", ".join(dict.fromkeys(doubtful.values())), times)

    def _in_doubt(self, files: Sequence[str], why: str, times: int) -> bool:
        """Set photographs aside that may show other poses than their names state, unless a person keeps them.

        Returns
        -------
        bool
            Whether they were set aside.

        Raises
        ------
        PositionError
            If no person can be asked and the photographs were already taken again.
        """
        found = f"{why}: steps were lost, and {len(files)} photographs since the rig was homed are in doubt: "
        found += ", ".join(files)
        reason = ""
        if self._hand.operator.attended:
            # Whatever prevents the answer, the next sitting asks again: the rig's record of homings has what was found.
            reason = " ".join(self._hand.operator.judge(f"{self.journal.table}: {found}").split())
        self.tally.doubted += len(files)
        if reason:
            self.journal.accept(files, reason)
            self.journal.checked(files)
            self.tally.accepted += len(files)
            return False
        for file in files:
            self._series.forget(self.journal.shots[file])
        self.drift = [frame for frame in self.drift if frame.file not in files]
        earlier = len(files) - len(self._own.intersection(files))
        kept = min(self.tally.kept, earlier)
        self.tally.taken -= len(files) - earlier
        self.tally.kept, self.tally.adopted = self.tally.kept - kept, self.tally.adopted - (earlier - kept)
        self.journal.drop(files, "doubtful")
        self.journal.checked(files)
        if not self._hand.operator.attended and times >= _UNATTENDED_TRIES:
            raise PositionError(f"{found}; they are set aside: look at speed, current and friction, and start again")
        LOGGER.warning("%s; they are set aside, and taken once more", found)
        return True

    def _take_in_turn(self, shot: Shot | None, planned: Sequence[Shot]) -> None:
        """Take a photograph, or end the session if it is None; first retake photographs if the person asks for it.

        An earlier photograph remains in the table until the new one is verified.
        """
        wanted = [shot]
        while wanted:
            try:
                self._take_or_end(wanted[0], planned)
            except RetakeLast as wish:
                last = self.journal.shots.get(wish.file)
                if last is None:
                    continue  # it was set aside meanwhile, and is taken again as a missing one
                self._series.forget(last)
                self.drift = [frame for frame in self.drift if frame.file != last.file]
                if wanted[0] is None or wanted[0].file != last.file:
                    wanted.insert(0, last)
                continue
            except _BothInDoubt as doubt:
                wanted[:0] = self._withdrawn(doubt.files)
                continue
            if done := wanted.pop(0):
                self._dialogue.stored(done.file)

    def _withdrawn(self, files: Sequence[str]) -> list[Shot]:
        """Set photographs aside that a later one has put in doubt, and return their shots."""
        shots = [self.journal.shots[file] for file in files]
        for shot in shots:
            self._series.forget(shot)
        self.journal.drop(files, "doubtful")
        self.tally.taken -= len(shots)
        self.tally.retaken += len(shots)
        return shots

    def _take_or_end(self, shot: Shot | None, planned: Sequence[Shot]) -> None:
        missing, total = self.journal.missing(planned), len(planned)
        there = total - len(missing)
        if shot is None:
            self._dialogue.working("Keep clear: the session goes on.", there, total, 0.0)
            self._dialogue.between_shots()
            self._dialogue.ask(State.COMPLETE, f"All {total} photographs are there")
            return
        again = shot.file in self.journal.shots
        what = "a photograph is taken again" if again else f"photograph {there + 1} of {total} is being taken"
        left_s = self._left_s([shot, *missing] if again else missing)
        self._dialogue.working(f"Keep clear: {what}.", there, total, left_s)
        self._dialogue.on_test = lambda: self._test_exposure(shot)
        self._dialogue.between_shots()
        self._take(shot)

    def _test_exposure(self, shot: Shot) -> None:
        """Take and show a test photograph with the settings of a shot; it does not become part of the session."""
        path = self.journal.folder / f"{_TEMPORARY}test{Path(shot.file).suffix}"
        try:
            with storing(path):
                self.camera.capture(shot, path)
            mosaic, outline = decode(path), self._outline(shot)
            finding = f"Test exposure: {look_at(path, mosaic)}" + (f"; {outline}" if outline else "")
            self._show("", finding, mosaic, outline)
        except PlainError as error:
            self._dialogue.note(f"The test exposure failed: {error}")
        finally:
            path.unlink(missing_ok=True)

    def _show(self, file: str, finding: str, mosaic: Mosaic, outline: Outline | None) -> None:
        """Show a photograph with its outline, which is omitted if the picture's size contradicts the definition."""
        size, without = (mosaic.size[0] // 2, mosaic.size[1] // 2), self._without_outline
        if outline is not None and outline.size != size:
            told = "the picture has {} x {} superpixels, and by the camera's optics {} x {}"
            without, outline = told.format(*size, *outline.size), None
        finding = f"{finding}; no outline is drawn: {without}" if without else finding
        self._dialogue.show(file, finding, preview_of(mosaic), outline)

    def _outline(self, shot: Shot) -> Outline | None:
        """Return the outline of the object in the pose of a shot; None without one or before its mesh exists."""
        try:
            return self._outline_of(shot)
        except InputError as error:
            self._outline_of, self._without_outline = (lambda shot: None), str(error)
            return None

    def _recalled(self, planned: Sequence[Shot], missing: Sequence[Shot]) -> Series:
        """Return the series with which new photographs are compared, filled from those of earlier sittings."""
        series = Series(planned)
        kept = [shot for shot in self.journal.shots.values() if not shot.taken.accepted]
        for shot in worth_recalling(kept, missing):
            path = self.journal.folder / shot.file
            self._add(series, shot, look_at(path, decode(path)))
        return series

    def _add(self, series: Series, shot: Shot, look: Look) -> None:
        if (frame := series.drift(shot, look)) is not None:
            self.drift = [*(known for known in self.drift if known.file != frame.file), frame]
            LOGGER.info("%s", frame)
        series.add(shot, look)

    def _take(self, shot: Shot) -> None:
        motorised = self.rig.axes if self.rig is not None else {}
        # Motors move first, so that nobody has a hand at the lens while the arm swings.
        targets = motor_targets(shot, motorised)
        if self.rig is not None and targets:
            self.rig.move(targets)
            if targets != self._stands:
                self._stands, self._settled_at = targets, time.monotonic() + self._settle_s
        if self._hand.set(hand_settings(shot, motorised)):
            self.tally.operator_steps += 1
        time.sleep(max(0.0, self._settled_at - time.monotonic()))
        path = self.journal.folder / shot.file
        temporary = path.with_name(_TEMPORARY + path.name)
        try:
            taken, digest = self._photograph(shot, path, temporary)
            if self.rig is not None and targets and not self.rig.cannot_recount:
                self.journal.leave_unchecked(shot.file, digest, self.rig.homings.current)
            with storing(path):
                _sync(temporary)
                if shot.file in self.journal.shots:
                    self.journal.make_way(shot.file)
                    self.tally.retaken += 1
                os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        self.journal.append(replace(shot, taken=taken), digest)
        self._own.add(shot.file)
        self.tally.taken += 1

    def _photograph(self, shot: Shot, path: Path, temporary: Path) -> tuple[Taken, str]:
        """Take and verify a photograph under a temporary name; return the details of its capture and its hash.

        Errors name the final file.
        """
        failed = 0
        read = {} if self.rig is None else self.rig.position()
        # Computed before the exposure, so that the photograph is shown as soon as it is downloaded.
        outline = self._outline(shot) if self._dialogue.watched else None
        while True:
            now = datetime.now(UTC).astimezone().isoformat(timespec="milliseconds")
            try:
                with storing(path):
                    self.camera.capture(shot, temporary)
                look = look_at(temporary, mosaic := verify(temporary, shot))
            except InputError as error:
                failed += 1
                fault = InputError(path, error.field, error.found, error.accepted)
                if failed == _TRIES:
                    raise fault from None
                LOGGER.warning("%s Once more.", fault)
                self.tally.retries += 1
                continue
            # A computed photograph has neither a time of day nor a body.
            real = {} if self.camera.is_virtual else {"at": now, "camera": self._body or look.camera}
            taken = Taken(camera_time=look.time, read_deg=read, **real)
            digest = file_sha256(temporary)
            same = next((file for file, known in self.journal.sha256.items() if known == digest), None)
            doubts = self._series.doubts(shot, look) if same is None else [delivered_again(same)]
            if self._dialogue.watched:
                finding = "; ".join(doubt.words for doubt in doubts) or f"Sound: {look}"
                self._show(shot.file, finding, mosaic, outline)
            if not doubts:
                self._add(self._series, shot, look)
                del self._doubted[shot.file]
                return taken, digest
            self._doubted[shot.file] += 1
            self.tally.doubted += 1
            beside = sorted({file for doubt in doubts for file in doubt.beside})
            if reason := self._judged(path, doubts, beside, self._doubted[shot.file]):
                self.journal.accept(beside, reason)
                for file in beside:
                    self._series.forget(self.journal.shots[file])
                self.tally.accepted += 1 + len(beside)
                return replace(taken, accepted=reason), digest
            if beside:
                raise _BothInDoubt(beside)

    def _judged(self, path: Path, doubts: Sequence[Doubt], beside: Sequence[str], times: int) -> str:
        """Return the reason to keep a doubtful photograph, empty if it is to be taken again.

        ``beside`` are the files of earlier photographs that share its fate, and ``times`` how often it was doubted.

        Raises
        ------
        InputError
            If no person can be asked and the photograph was already taken again.
        DeviceError
            If the person stops.
        """
        found = "; ".join(f"{doubt.kind}: {doubt.words}" for doubt in doubts)
        if beside:
            found += f" {' and '.join([*beside, path.name])} are taken again or kept together."
        if self._hand.operator.attended:
            reason = self._hand.operator.judge(f"{path.name}: {found}")  # a phone is narrow
            return " ".join(reason.split())
        if times >= _UNATTENDED_TRIES:
            words = "; ".join(doubt.words for doubt in doubts)
            raise InputError(path, doubts[0].kind, words, "a photograph as it was asked for; nobody is there to judge")
        LOGGER.warning("%s: %s; once more", path, found)
        return ""


def take_stock(journal: Journal, planned: Sequence[Shot]) -> Tally:
    """Compare the journal and the folder with a plan: adopt complete photographs, retire those of another plan.

    Temporary files of a killed session are removed. A file with a photograph's name but no line, which a crash has
    cost, is recorded after verification; a broken one is set aside and taken again.

    Raises
    ------
    StorageError
    """
    tally = Tally(retired=len(journal.retire(planned)))
    missing = journal.missing(planned)
    tally.kept = len(planned) - len(missing)
    with storing(journal.folder):
        for pattern in _LEFT_OVER:
            for left_over in journal.folder.glob(pattern):
                left_over.unlink()
    for shot in missing:
        path = journal.stray(shot)
        if path is None:
            continue
        try:
            verify(path, shot)
        except InputError as error:
            aside = journal.set_aside(shot.file, "broken", file_sha256(path))
            LOGGER.warning("%s It is kept as %s and taken again.", error, aside)
            continue
        with storing(path):
            _sync(path)
            digest = file_sha256(path)
        journal.append(shot, digest)
        tally.adopted += 1
    return tally


def verify(path: Path, shot: Shot) -> Mosaic:
    """Decode a photograph, and compare the exposure time, sensitivity and aperture in the file with those of the shot.

    Raises
    ------
    InputError
        If the file cannot be decoded, or one of these differs by more than 5 %.
    """
    mosaic = decode(path)
    for name, what, unit in (("exposure_s", "exposure time", " s"), ("iso", "ISO", ""), ("f_number", "f-number", "")):
        found, told = getattr(mosaic, name), getattr(shot, name)
        if found and told and abs(found / told - 1) > _TOLERANCE:
            raise InputError(path, what, f"{found:g}{unit}", f"{told:g}{unit}, as the camera was told")
    return mosaic


def _body(status: Mapping[str, str]) -> str:
    """Return model and serial number of the camera, as far as its status has them."""
    told = (status.get(key, "") for key in ("model", "serial_number"))
    return " ".join(text for text in told if text and text != NOT_REPORTED)


def _sync(path: Path) -> None:
    with open(path, "rb") as file:
        os.fsync(file.fileno())
