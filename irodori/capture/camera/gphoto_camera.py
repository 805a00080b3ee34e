"""Camera driver over USB through python-gphoto2; RAW files go straight to the computer.

This module sets exposure, aperture, sensitivity, white balance and file format through libgphoto2, releases the shutter
and waits for the file. `gphoto_line` repeats requests that fail because of a busy camera or a bad connection.
Source: the documentation of libgphoto2 2.5 and of its PTP driver.
"""

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath

from irodori.capture.camera.gphoto_line import FIRST_WAIT_S, GphotoLine
from irodori.capture.camera.gphoto_settings import WIDGETS, find_choice, means, offer
from irodori.capture.rig.devices import NOT_REPORTED, CameraDevice, CommandError, DeadlineError, DeviceError
from irodori.config.capture_table import Shot
from irodori.config.models import CameraDriver
from irodori.core.atomic_files import written_whole
from irodori.core.progress import LOGGER

#: Suffixes of RAW files by maker (first word of libgphoto2's model); the first is expected before a photograph.
RAW_SUFFIXES = {
    "Canon": (".cr2", ".cr3", ".crw"),
    "Nikon": (".nef", ".nrw"),
    "Sony": (".arw",),
    "Fuji": (".raf",),
    "Olympus": (".orf",),
    "Panasonic": (".rw2",),
    "Pentax": (".pef", ".dng"),
}
_ANY_RAW = (".dng", *(suffix for suffixes in RAW_SUFFIXES.values() for suffix in suffixes))
#: Names of libgphoto2's widgets for each fact that a camera reports; the first that it has is used.
_REPORTS = {
    "serial_number": ("eosserialnumber", "serialnumber"),
    "battery": ("batterylevel",),
    "lens": ("lensname",),
}
_FOCUS = ("focusmode",)
_RAM = "Internal RAM"
_EVENT_S = 0.5
#: Silence after which a camera has delivered all files of a photograph, and longest wait for such a silence, s.
_QUIET_S, _SETTLE_S = 0.2, 2.0
_LOW_BATTERY_PERCENT = 25.0


class GphotoCamera(CameraDevice):
    """Camera that libgphoto2 supports. The constructor opens it; only one thread may use it.

    Parameters
    ----------
    driver : CameraDriver
    sleep, now : callable
        Functions that wait and return the time, s; replaced for a simulated camera, so that tests need not wait.

    Raises
    ------
    DeviceError
        If python-gphoto2 is missing, the model is unknown, or the camera is absent or in use by another program.

    Notes
    -----
    `suffix` is a guess from the maker until the first photograph, then that of the camera's own file name.
    """

    #: Names of libgphoto2's widgets for each setting. A setting without widgets is not changed.
    widgets: Mapping[str, tuple[str, ...]] = WIDGETS
    #: Suffixes of RAW files.
    raw_suffixes: tuple[str, ...] = _ANY_RAW

    def __init__(
        self,
        driver: CameraDriver,
        sleep: Callable[[float], None] = time.sleep,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.model = driver.model
        self._line = GphotoLine(self.model, driver.port, driver.deadline_s, driver.retries, sleep=sleep, now=now)
        self._gp, self._driver = self._line.gp, driver
        self.suffix = next((s[0] for maker, s in RAW_SUFFIXES.items() if self.model.startswith(maker)), ".raw")
        #: Whether a photograph of an earlier attempt may still arrive.
        self._unsettled = False
        try:
            self._line.insist(self._begin)
        except BaseException:
            self.close()
            raise

    # ---- the contract

    def capture(self, shot: Shot, path: Path) -> None:
        """Take one photograph and store the complete RAW file at `path`; a second file (JPEG) is deleted."""
        name, data = self._line.insist(lambda end: self._photograph(shot, end), shot.exposure_s)
        suffix = PurePosixPath(name).suffix.lower()
        if suffix != self.suffix:
            LOGGER.warning("%s: its RAW files end in %s, not %s", self.model, suffix, self.suffix)
            self.suffix = suffix
        with written_whole(path) as temporary:
            temporary.write_bytes(data)

    def prepare(self, shots: Sequence[Shot]) -> None:
        """Raise an error for settings that the camera does not offer, for autofocus, and for a full card."""
        self._line.insist(lambda end: self._check(shots, end))

    def status(self) -> dict[str, str]:
        """Return ``model``, ``serial_number``, ``battery``, ``lens``, ``storage`` and ``settings``, as text."""
        return self._line.insist(self._report)

    def close(self) -> None:
        """Close the connection to the camera; a second call has no effect."""
        self._line.close()

    def _begin(self, end: float) -> None:
        self._keep_awake(end)
        level = self._read(_REPORTS["battery"], end)
        with suppress(ValueError):
            if level.lower() == "low" or float(level.rstrip("% ")) <= _LOW_BATTERY_PERCENT:
                LOGGER.warning("%s: battery %s; charge it before a long session", self.model, level)

    # ---- settings

    def _put(self, setting: str, wanted: float | str, end: float) -> None:
        """Change one setting and check that the camera accepted it."""
        name = self._widget_name(setting)
        widget = self._line.ask(end, "get_single_config", name)
        stands = str(widget.get_value())
        if means(setting, stands, wanted):
            return
        if widget.get_readonly():
            ring = ", or f_number: manual for a lens with a ring" if setting == "f_number" else ""
            raise CommandError(
                f"{self.model}: {name} {wanted} cannot be set, it stands at {stands} and is read-only now; "
                f"turn the mode dial to M{ring}"
            )
        choices = [str(choice) for choice in widget.get_choices()]
        choice = find_choice(setting, wanted, choices)
        if choice is None:
            raise CommandError(f"{self.model}: {name} {wanted} is not on offer; {offer(setting, wanted, choices)}")
        widget.set_value(choice)
        self._line.ask(end, "set_single_config", name, widget)
        wait, limit = FIRST_WAIT_S, min(end, self._line.now() + _SETTLE_S)
        # A camera may report the old value until its own event has arrived.
        while (stands := str(self._line.ask(end, "get_single_config", name).get_value())) != choice:
            if self._line.now() + wait > limit:
                raise CommandError(f"{self.model}: told {name} {choice}, it stands at {stands}")
            self._line.sleep(wait)
            wait *= 2.0

    def _widget_name(self, setting: str) -> str:
        name = next((name for name in self.widgets[setting] if name in self._line.names), None)
        if name is None:
            accepted = " or ".join(self.widgets[setting])
            raise CommandError(f"{self.model}: no setting {accepted} among those that gphoto2 lists")
        return name

    def _set_all(self, shot: Shot, end: float) -> None:
        wanted: dict[str, float | str] = {
            "capture_target": _RAM,
            "image_format": self._driver.image_format,
            "white_balance": self._driver.white_balance,
            "iso": shot.iso or self._driver.iso,
            "f_number": shot.f_number or self._driver.f_number,
            "exposure_s": shot.exposure_s,
        }
        if self._driver.f_number == "manual":
            del wanted["f_number"]
        if not self._line.names.intersection(self.widgets["capture_target"]):
            del wanted["capture_target"]  # the file's place does not matter: it is downloaded and then deleted
        for setting, value in wanted.items():
            if setting in self.widgets:
                self._put(setting, value, end)

    def _check(self, shots: Sequence[Shot], end: float) -> None:
        if not shots:
            return
        faults = [*self._in_the_way(end)]
        wanted: dict[str, set] = {
            "iso": {shot.iso or self._driver.iso for shot in shots},
            "f_number": {shot.f_number or self._driver.f_number for shot in shots} - {"manual"},
            "exposure_s": {shot.exposure_s for shot in shots},
        }
        for setting in self.widgets.keys() & wanted:
            name = self._widget_name(setting)
            widget = self._line.ask(end, "get_single_config", name)
            if not widget.get_readonly():
                choices = [str(choice) for choice in widget.get_choices()]
                absent = [value for value in sorted(wanted[setting]) if find_choice(setting, value, choices) is None]
                faults += [f"{name} {value} is not on offer; {offer(setting, value, choices)}" for value in absent]
        if faults:
            raise CommandError(f"{self.model}: {'; '.join(faults)}")
        # Read-only settings and values that the camera refuses show only when they are set.
        self._set_all(shots[0], end)

    def _in_the_way(self, end: float) -> Iterator[str]:
        """Yield the known obstacles to an exposure, as phrases: autofocus, a full card."""
        focus = self._read(_FOCUS, end)
        if focus != NOT_REPORTED and not re.search(r"manual|\bmf\b", focus, re.IGNORECASE):
            yield f"it focuses on its own (focusmode {focus}): switch the lens to manual focus"
        # If the file can be sent to the camera's memory, a full or missing card does not matter.
        if not self._line.names.intersection(self.widgets.get("capture_target", ())):
            gp = self._gp
            for store in self._stores(end) or ():
                pictures = store.freeimages if store.fields & gp.GP_STORAGEINFO_FREESPACEIMAGES else None
                kilobytes = store.freekbytes if store.fields & gp.GP_STORAGEINFO_FREESPACEKBYTES else None
                if pictures == 0 or kilobytes == 0:
                    yield f"no room on its card {store.basedir}: empty it"

    def _release(self, end: float) -> None:
        """Release the shutter; if the camera refuses without a reason, look for the cause."""
        try:
            self._line.ask(end, "trigger_capture")
        except self._gp.GPhoto2Error as error:
            if error.code != self._gp.GP_ERROR or self._line.is_loss(error):
                raise
            causes = "; ".join(self._in_the_way(end)) or "it may not find focus, or its card may be full"
            raise CommandError(
                f"{self.model}: the shutter was not released: {causes} (gphoto2 says {error})"
            ) from error

    def _keep_awake(self, end: float) -> None:
        """Ask the camera not to switch itself off between photographs."""
        if "autopoweroff" not in self._line.names:
            return
        widget = self._line.ask(end, "get_single_config", "autopoweroff")
        if widget.get_readonly() or str(widget.get_value()) == "0":
            return
        widget.set_value("0")
        try:
            self._line.ask(end, "set_single_config", "autopoweroff", widget)
        except self._gp.GPhoto2Error as error:
            if self._line.is_loss(error):
                raise
            LOGGER.warning("%s: keeps its automatic power off; gphoto2 says %s", self.model, error)

    # ---- one photograph

    def _photograph(self, shot: Shot, end: float) -> tuple[str, bytes]:
        """Take one photograph, and return the name and the content of its RAW file."""
        if self._unsettled:
            # An earlier photograph may still arrive; taken for this one, it would be a wrong measurement.
            self._settle(end, _QUIET_S + shot.exposure_s)
        self._set_all(shot, end)
        self._settle(end, _QUIET_S / 2.0)
        self._unsettled = True
        self._release(end)
        others: list[str] = []
        while (left := end - self._line.now()) > 0.0:
            folder, name = self._next_file(end, min(left, _EVENT_S))
            if name and not self._is_raw(name):
                others.append(name)
                self._delete(folder, name, end)
            elif name:
                data = self._fetch(folder, name, end)
                self._finish(folder, name, end)
                return name, data
        found = f"only {', '.join(others)}, is image_format a RAW format?" if others else "no file"
        waited = self._driver.deadline_s + shot.exposure_s
        self._line.let_go()
        raise DeadlineError(f"{self.model}: {found} in {waited:g} s after the shutter was released")

    def _next_file(self, end: float, wait_s: float) -> tuple[str, str]:
        """Return folder and name of a new file on the camera, empty if none appears within ``wait_s`` seconds."""
        kind, data = self._line.ask(end, "wait_for_event", max(1, round(1000.0 * wait_s)))
        return (data.folder, data.name) if kind == self._gp.GP_EVENT_FILE_ADDED else ("", "")

    def _is_raw(self, name: str) -> bool:
        return PurePosixPath(name).suffix.lower() in self.raw_suffixes

    def _fetch(self, folder: str, name: str, end: float) -> bytes:
        file = self._line.ask(end, "file_get", folder, name, self._gp.GP_FILE_TYPE_NORMAL)
        data = bytes(memoryview(file.get_data_and_size()))
        if not data:
            raise CommandError(f"{self.model}: delivered {name} without content")
        return data

    def _delete(self, folder: str, name: str, end: float) -> None:
        """Delete a file on the camera; the camera itself may already have removed one in its memory."""
        try:
            self._line.ask(end, "file_delete", folder, name)
        except self._gp.GPhoto2Error as error:
            if self._line.is_loss(error):
                raise
            if error.code not in (self._gp.GP_ERROR_FILE_NOT_FOUND, self._gp.GP_ERROR_DIRECTORY_NOT_FOUND):
                LOGGER.warning("%s: keeps %s/%s; gphoto2 says %s", self.model, folder, name, error)

    def _finish(self, folder: str, name: str, end: float) -> None:
        """Delete the file of a downloaded photograph on the camera; a fault here must not cost the photograph."""
        try:
            self._delete(folder, name, end)
            self._settle(end, _QUIET_S)
            self._unsettled = False
        except (DeviceError, self._gp.GPhoto2Error) as error:
            LOGGER.warning("%s: has delivered %s; clearing up: %s", self.model, name, error)
            self._line.let_go()

    def _settle(self, end: float, quiet_s: float) -> None:
        """Delete new files on the camera until it reports nothing for a time, s."""
        limit = min(end, self._line.now() + _SETTLE_S + quiet_s)
        while self._line.now() < limit:
            kind, data = self._line.ask(end, "wait_for_event", max(1, round(1000.0 * quiet_s)))
            if kind == self._gp.GP_EVENT_FILE_ADDED:
                LOGGER.info("%s: %s is thrown away", self.model, data.name)
                self._delete(data.folder, data.name, end)
            elif kind == self._gp.GP_EVENT_TIMEOUT:
                return

    # ---- the camera's state

    def _report(self, end: float) -> dict[str, str]:
        said = {"model": self.model}
        said |= {key: self._read(names, end) for key, names in _REPORTS.items()}
        said["storage"] = self._storage(end)
        shown = {setting: self._read(names, end) for setting, names in self.widgets.items()}
        said["settings"] = ", ".join(f"{setting} {value}" for setting, value in shown.items())
        return said

    def _read(self, names: tuple[str, ...], end: float) -> str:
        name = next((name for name in names if name in self._line.names), None)
        if name is None:
            return NOT_REPORTED
        return str(self._line.ask(end, "get_single_config", name).get_value()).strip() or NOT_REPORTED

    def _stores(self, end: float) -> list | None:
        """Return gphoto2's records of the camera's cards, None if the camera reports none."""
        try:
            return list(self._line.ask(end, "get_storageinfo"))
        except self._gp.GPhoto2Error as error:
            if self._line.is_loss(error):
                raise
            return None

    def _storage(self, end: float) -> str:
        gp, parts = self._gp, []
        stores = self._stores(end)
        if stores is None:
            return NOT_REPORTED
        for store in stores:
            words = []
            if store.fields & gp.GP_STORAGEINFO_FREESPACEKBYTES:
                words.append(f"{store.freekbytes / 1024:.0f} MB free")
            if store.fields & gp.GP_STORAGEINFO_FREESPACEIMAGES:
                words.append(f"room for {store.freeimages} pictures")
            parts.append(f"{store.basedir}: {', '.join(words) or NOT_REPORTED}")
        return "; ".join(parts) or "no card"
