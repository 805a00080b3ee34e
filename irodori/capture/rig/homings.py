"""Record of a rig's homings, and of what was found out about lost steps after each."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from irodori.capture.rig.devices import ANGLE_TOLERANCE_DEG, Axis, DeviceError
from irodori.core.atomic_files import append_line


@dataclass(frozen=True)
class Verdict:
    """Finding about the steps that a rig lost after a homing.

    Parameters
    ----------
    lost_deg : dict
        {axis: true angle minus the counted one, degrees}, of a comparison with the limit switches; empty without one.
    alarm : str
        Message of the controller when an axis met its switch in a move; empty without one.
    """

    lost_deg: Mapping[str, float]
    alarm: str = ""

    def off(self, axes: Mapping[str, Axis]) -> str:
        """Return a phrase on the axes that were off their count by more than a step, or the alarm; empty if sound."""
        step_deg = {name: axis.step_deg for name, axis in axes.items()}
        least_deg = {name: step_deg.get(name, 0.0) + ANGLE_TOLERANCE_DEG for name in self.lost_deg}
        return self.alarm or told({name: lost for name, lost in self.lost_deg.items() if abs(lost) > least_deg[name]})


def told(lost_deg: Mapping[str, float]) -> str:
    """Return a phrase such as ``camera_deg stood -0.5 degrees off its count``."""
    return ", ".join(f"{name} stood {lost:+.3g} degrees off its count" for name, lost in lost_deg.items())


class Homings:
    """Record of the homings of one rig, by whatever command, so that each session knows which one its count is of.

    Each line of the file is JSON: ``{"homing": ID}`` when a homing begins, and ``{"homing": ID, "lost_deg": {…}}`` or
    ``{"homing": ID, "alarm": "…"}`` when it is known what became of the count after it.

    Parameters
    ----------
    path : path, optional
        By default nothing is stored, as for a simulated controller, which ends with its process.

    Raises
    ------
    DeviceError
        From all methods, if the file cannot be read or written.
    """

    def __init__(self, path=None) -> None:
        self._path = None if path is None else Path(path)
        self._lines: list[dict] = []
        if self._path is not None and self._path.exists():
            try:
                text = self._path.read_text(encoding="utf-8", errors="replace")
            except OSError as error:
                raise DeviceError(f"{self._path}: cannot be read: {error.strerror}") from None
            self._lines = [found for line in text.splitlines() if (found := _read(line)) is not None]

    @property
    def current(self) -> str:
        """ID of the last homing; empty if there was none."""
        return self._lines[-1]["homing"] if self._lines else ""

    @property
    def stored(self) -> str:
        """ID of the last homing if the record outlasts the process, for a mark in the controller; else empty."""
        return self.current if self._path is not None else ""

    def begin(self) -> None:
        """Record that the rig is about to be homed: its present count ends here."""
        self._append({"homing": datetime.now(UTC).isoformat()})

    def conclude(self, verdict: Verdict) -> None:
        """Record what was found out about the steps lost since the last homing, before anything else happens."""
        found = {"alarm": verdict.alarm} if verdict.alarm else {"lost_deg": dict(verdict.lost_deg)}
        self._append({"homing": self.current, **found})

    def verdicts(self, homing: str) -> list[Verdict]:
        """Return all that was found out after a homing; empty if nothing was."""
        found = [line for line in self._lines if line["homing"] == homing and len(line) > 1]
        return [Verdict(line.get("lost_deg", {}), line.get("alarm", "")) for line in found]

    def _append(self, line: dict) -> None:
        self._lines.append(line)
        if self._path is not None:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                append_line(self._path, json.dumps(line))
            except OSError as error:
                raise DeviceError(f"{self._path}: cannot be stored: {error.strerror}") from None


def _read(line: str) -> dict | None:
    """Return a line of the file; None for half a line, as a power cut leaves it, and for any other line."""
    try:
        found = json.loads(line)
        homing, lost_deg, alarm = found.pop("homing"), found.pop("lost_deg", None), found.pop("alarm", None)
    except (ValueError, AttributeError, KeyError, TypeError):
        return None
    if not isinstance(homing, str) or found:
        return None
    if alarm is not None and isinstance(alarm, str) and lost_deg is None:
        return {"homing": homing, "alarm": alarm}
    if alarm is None and isinstance(lost_deg, dict) and lost_deg:
        numbers = all(isinstance(lost, int | float) and math.isfinite(lost) for lost in lost_deg.values())
        return {"homing": homing, "lost_deg": lost_deg} if numbers else None
    return {"homing": homing} if alarm is None and lost_deg is None else None
