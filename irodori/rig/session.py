"""A sitting at the rig: every missing photograph of a plan is taken, verified, hashed and noted, one by one.

A photograph is stored under a temporary name, decoded, given its own name and then noted in the table. Whatever
breaks the session off, the next one finds whole files and whole lines, and takes what is missing.
"""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from irodori.captures import Shot
from irodori.errors import InputError
from irodori.mosaic import decode
from irodori.progress import LOGGER, track
from irodori.provenance import file_sha256
from irodori.rig.devices import Camera, Rig
from irodori.rig.journal import Journal
from irodori.rig.operator import HandSettings, Operator
from irodori.rig.placing import hand_settings, motor_targets

_TRIES = 3
#: Cameras round the exposure times that they write into their files.
_EXPOSURE_TOLERANCE = 0.05
_TEMPORARY = ".part-"


@dataclass
class Tally:
    """What a session did.

    ``kept`` photographs stood in the table before, ``adopted`` ones stood in the folder without a line, ``retired``
    ones are no longer asked for.
    """

    taken: int = 0
    kept: int = 0
    adopted: int = 0
    retired: int = 0
    retries: int = 0
    operator_steps: int = 0
    seconds: float = 0.0


class Session:
    """One sitting.

    Parameters
    ----------
    camera : Camera
    operator : Operator
        Sets by hand what no motor drives.
    journal : Journal
    rig : Rig, optional
        None where nothing stands on the rig, as for an environment.
    clock : callable
        Seconds, monotonic.
    """

    def __init__(
        self,
        camera: Camera,
        operator: Operator,
        journal: Journal,
        rig: Rig | None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.camera, self.journal, self.rig = camera, journal, rig
        self.tally = Tally()
        self._hand, self._clock = HandSettings(operator), clock

    def run(self, planned: Sequence[Shot], label: str) -> Tally:
        """Take what is missing of a plan, in its order.

        Raises
        ------
        DeviceError
            If rig or camera is at fault; what was taken before stands in the table.
        InputError
            If a photograph is broken or shot otherwise than asked for, `_TRIES` times in a row.
        """
        begun = self._clock()
        if self.rig is not None:
            self._check_reach(planned)
        self.tally.retired = len(self.journal.retire(planned))
        self.tally.kept = len(planned) - len(self.journal.missing(planned))
        self._clear_temporary()
        for shot in self.journal.missing(planned):
            self._adopt(shot)
        for shot in track(self.journal.missing(planned), f"capture {label}"):
            self._take(shot)
        self.journal.finish(planned)
        self.tally.seconds = self._clock() - begun
        LOGGER.info("%s: %s", label, ", ".join(f"{key} {value:g}" for key, value in vars(self.tally).items()))
        return self.tally

    def _check_reach(self, planned: Sequence[Shot]) -> None:
        """Refuse a plan that leaves the rig's limits before its first photograph is taken."""
        for shot in planned:
            self.rig.check(motor_targets(shot, self.rig.axes))

    def _clear_temporary(self) -> None:
        for path in self.journal.folder.glob(f"{_TEMPORARY}*"):
            path.unlink()

    def _adopt(self, shot: Shot) -> None:
        """Note a photograph that has its name but no line: only a verified one has, the line was lost in a crash."""
        path = self.journal.folder / shot.file
        if not path.is_file():
            return
        verify(path, shot)
        self.journal.append(shot, file_sha256(path))
        self.tally.adopted += 1

    def _take(self, shot: Shot) -> None:
        motorised = self.rig.axes if self.rig is not None else {}
        # Motors first: nobody has a hand at the lens while the arm swings.
        if targets := motor_targets(shot, motorised):
            self.rig.move(targets)
        if self._hand.set(hand_settings(shot, motorised)):
            self.tally.operator_steps += 1
        path = self.journal.folder / shot.file
        temporary = path.with_name(_TEMPORARY + path.name)
        for attempt in range(_TRIES):
            try:
                self.camera.capture(shot, temporary)
                verify(temporary, shot)
                break
            except InputError as error:
                temporary.unlink(missing_ok=True)
                if attempt == _TRIES - 1:
                    raise
                LOGGER.warning("%s; once more", error)
                self.tally.retries += 1
        _sync(temporary)
        os.replace(temporary, path)
        self.journal.append(shot, file_sha256(path))
        self.tally.taken += 1


def verify(path: Path, shot: Shot) -> None:
    """Decode a photograph and compare its own exposure time with what was asked for.

    Raises
    ------
    InputError
    """
    exposure_s = decode(path).exposure_s
    if exposure_s > 0 and abs(exposure_s / shot.exposure_s - 1) > _EXPOSURE_TOLERANCE:
        raise InputError(path, "exposure time", f"{exposure_s:g} s", f"{shot.exposure_s:g} s, as the camera was told")


def _sync(path: Path) -> None:
    with open(path, "rb") as file:
        os.fsync(file.fileno())
