"""Connection to a USB camera through python-gphoto2, with retries while busy and after a lost connection.

python-gphoto2 is imported when a camera is opened, since only the computer at the rig needs it
(``requirements-rig.txt``).
Source: the documentation of libgphoto2 2.5.
"""

import difflib
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from irodori.capture.rig.devices import CommandError, DeadlineError, DeviceError, LinkError
from irodori.core.progress import LOGGER

FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 5.0


class _AbsentError(LinkError):
    """Error for a camera that is not connected, or not switched on."""


class GphotoLine:
    """Connection to one camera; it is opened by the first call of `insist`.

    Parameters
    ----------
    model : str
        Model name in libgphoto2.
    port : str or None
        Such as ``usb:001,004``; None for the only camera of the model.
    deadline_s : float
        Longest time for an action with all its repetitions, s.
    retries : int
        Largest number of repetitions of a request.
    sleep, now : callable
        Functions that wait and return the time, s; replaced for a simulated camera, so that tests need not wait.

    Raises
    ------
    DeviceError
        If python-gphoto2 is missing.
    """

    def __init__(
        self,
        model: str,
        port: str | None,
        deadline_s: float,
        retries: int,
        sleep: Callable[[float], None] = time.sleep,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.gp = gp = _library()
        self.model, self.port, self.deadline_s, self.retries = model, port, deadline_s, retries
        self.sleep, self.now = sleep, now
        #: Names of the settings that the camera has.
        self.names: frozenset[str] = frozenset()
        self._camera: Any = None  # gphoto2's, which has no types
        self._closed = self._was_open = False
        #: A setting that could be read, to test later whether the connection works.
        self._readable = ""
        self._lost_codes = {
            gp.GP_ERROR_IO,
            gp.GP_ERROR_IO_INIT,
            gp.GP_ERROR_IO_READ,
            gp.GP_ERROR_IO_WRITE,
            gp.GP_ERROR_IO_UPDATE,
            gp.GP_ERROR_IO_USB_FIND,
            gp.GP_ERROR_IO_USB_CLEAR_HALT,
            gp.GP_ERROR_TIMEOUT,
            gp.GP_ERROR_MODEL_NOT_FOUND,
        }
        # Codes of libgphoto2's PTP driver for a dead port, and also for a full card, no focus, a wrong value.
        self._doubtful_codes = {gp.GP_ERROR, gp.GP_ERROR_BAD_PARAMETERS}

    def insist(self, action: Callable, allowance_s: float = 0.0):
        """Return ``action(end)``; if the connection is lost, open it again and repeat the action, within limits.

        Parameters
        ----------
        action : callable
            Function of the time at which it must have ended.
        allowance_s : float
            Time that the action may take beyond `deadline_s`, such as an exposure, s.

        Raises
        ------
        DeviceError
            The message contains that of gphoto2.
        """
        if self._closed:
            raise DeviceError(f"{self.model}: closed; open it again before using it")
        end = self.now() + self.deadline_s + allowance_s
        wait, tries = FIRST_WAIT_S, 0
        while True:
            tries += 1
            try:
                self._open(end)
                return action(end)
            except _AbsentError as error:
                if not self._was_open:
                    raise
                said = str(error)
            except self.gp.GPhoto2Error as error:
                self._raise_unless_lost(error)
                said = f"{self.model}: gphoto2 says {error}"
            self.let_go()
            if tries > self.retries or self.now() + wait >= end:
                raise LinkError(f"{said} (tried {tries} times)")
            LOGGER.warning("%s; trying again in %.1f s", said, wait)
            self.sleep(wait)
            wait = min(2.0 * wait, LONGEST_WAIT_S)

    def ask(self, end: float, method: str, *arguments):
        """Call a method of gphoto2's camera object and return its result; repeat it while the camera is busy.

        Raises
        ------
        DeadlineError
            If the camera is still busy at the last repetition or at the time `end`.
        GPhoto2Error
            For every other fault, which `insist` turns into a `DeviceError`.
        """
        wait, tries = FIRST_WAIT_S, 0
        while True:
            tries += 1
            try:
                answer = getattr(self._camera, method)(*arguments)
                if method == "get_single_config":
                    self._readable = arguments[0]
                return answer
            except self.gp.GPhoto2Error as error:
                if error.code != self.gp.GP_ERROR_CAMERA_BUSY:
                    raise
                if tries > self.retries or self.now() + wait >= end:
                    said = f"{self.model}: still busy with {method} (tried {tries} times); gphoto2 says {error}"
                    raise DeadlineError(said) from error
            self.sleep(wait)
            wait = min(2.0 * wait, LONGEST_WAIT_S)

    def is_loss(self, error) -> bool:
        """Return whether an error of gphoto2 means a lost connection; in doubtful cases a setting is read as a test."""
        if error.code not in self._doubtful_codes:
            return error.code in self._lost_codes
        name = self._readable or min(self.names, default="")
        if self._camera is None or not name:
            return False
        try:
            self._camera.get_single_config(name)
        except self.gp.GPhoto2Error as silence:
            return silence.code != self.gp.GP_ERROR_CAMERA_BUSY
        return False

    def let_go(self) -> None:
        """Close the connection until the next `insist`."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with suppress(self.gp.GPhoto2Error):  # the connection may already be lost
                camera.exit()

    def close(self) -> None:
        """Close the connection permanently; a second call has no effect."""
        self._closed = True
        self.let_go()

    def _open(self, end: float) -> None:
        if self._camera is not None:
            return
        gp = self.gp
        models = gp.CameraAbilitiesList()
        models.load()
        abilities = models.get_abilities(self._index_in(models))
        port = self.port or self._find_port()
        self._camera = gp.Camera()
        try:
            self._camera.set_abilities(abilities)
            self._init_at(port, end)
            self.names = frozenset(_leaves(self.ask(end, "get_config")))
        except BaseException:
            self.let_go()
            raise
        self._was_open = True

    def _init_at(self, port: str, end: float) -> None:
        gp, ports = self.gp, self.gp.PortInfoList()
        # Codes of libgphoto2 for a port without a camera, or with another device.
        absent = (gp.GP_ERROR_UNKNOWN_PORT, gp.GP_ERROR_BAD_PARAMETERS, gp.GP_ERROR_MODEL_NOT_FOUND)
        try:
            ports.load()
            self._camera.set_port_info(ports.get_info(ports.lookup_path(port)))
            self.ask(end, "init")
        except gp.GPhoto2Error as error:
            if error.code not in (*absent, gp.GP_ERROR_IO_USB_FIND):
                raise
            raise _AbsentError(f"{self.model}: no such camera at {port}; gphoto2 says {error}") from error

    def _index_in(self, models) -> int:
        try:
            return models.lookup_model(self.model)
        except self.gp.GPhoto2Error:
            known = [models.get_abilities(index).model for index in range(models.count())]
            near = ", ".join(difflib.get_close_matches(self.model, known, n=3)) or "none"
            raise DeviceError(f"libgphoto2 knows no camera {self.model!r}; nearest names: {near}") from None

    def _find_port(self) -> str:
        """Return the port of the only camera of the model on the bus."""
        found = self.gp.Camera.autodetect()
        seen = [(found.get_name(index), found.get_value(index)) for index in range(found.count())]
        ports = [port for model, port in seen if model == self.model]
        if not ports:
            listed = ", ".join(f"{model} at {port}" for model, port in seen) or "no camera"
            raise _AbsentError(f"{self.model}: not found, is it switched on and plugged in? gphoto2 sees {listed}")
        if len(ports) > 1:
            raise DeviceError(f"{self.model}: more than one, at {', '.join(ports)}; name one as driver.port")
        return ports[0]

    def _raise_unless_lost(self, error) -> None:
        """Raise a `DeviceError` for an error of gphoto2, unless it means a lost connection."""
        if error.code in (self.gp.GP_ERROR_IO_USB_CLAIM, self.gp.GP_ERROR_IO_LOCK):
            raise LinkError(
                f"{self.model}: another program holds the camera, on a desktop most often the file manager's gvfs; "
                f"run `gio mount -s gphoto2` or close that program (gphoto2 says {error})"
            ) from error
        if not self.is_loss(error):
            raise CommandError(f"{self.model}: gphoto2 says {error}") from error


def _library():
    """Import and return python-gphoto2; raise `DeviceError` if it is missing."""
    try:
        import gphoto2
    except ImportError as error:
        raise DeviceError(
            f"the camera's driver needs python-gphoto2 ({error}): pip install -r requirements-rig.txt"
        ) from error
    return gphoto2


def _leaves(widget) -> list[str]:
    """Return the names of the settings, which are the leaves in a camera's tree of widgets."""
    children = [widget.get_child(index) for index in range(widget.count_children())]
    return [name for child in children for name in _leaves(child)] if children else [widget.get_name()]
