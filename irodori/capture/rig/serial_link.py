"""Serial connection through pyserial, locked against other processes."""

import errno
import termios

import serial

from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import DeadlineError, Link, LinkError

#: A line longer than this means another baud rate or another device.
_MAX_LINE_BYTES = 4096
#: pyserial returns as soon as a byte arrives; a deadline is checked at least this often.
_WAIT_S = 0.02


class SerialLink(Link):
    """Connection through a serial port: 8 data bits, no parity, 1 stop bit.

    The port is locked (``flock`` of the device, which also works on pseudo-terminals and ends with the process): a
    second program that asks for the lock, or a second link of this process, is refused. The caller's own thread reads
    and writes: replies are small compared with the kernel's buffer of 4096 bytes, so that no thread for reading is
    needed.

    Parameters
    ----------
    port : str
        Path of the device.
    baud : int
        Bits per second.
    write_timeout_s : float
        Longest time until the port accepts bytes, s.
    line_end : bytes
        End of a line from the device; a carriage return before it is dropped.

    Raises
    ------
    LinkError
        If the port cannot be opened, or is in use.
    """

    def __init__(self, port: str, baud: int = 115200, *, write_timeout_s: float = 1.0, line_end: bytes = b"\n") -> None:
        self.port, self._line_end, self._buffer = str(port), line_end, b""
        try:
            self._serial = serial.Serial(
                self.port, baud, timeout=_WAIT_S, write_timeout=write_timeout_s, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkError(f"{self.port}: {_reason(error)}") from None

    def write(self, data: bytes) -> None:
        """Send bytes; see `Link.write`."""
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            seconds = self._serial.write_timeout
            raise DeadlineError(f"{self.port}: the line does not take bytes (waited {seconds:g} s)") from None
        except (serial.SerialException, OSError) as error:
            raise self._lost(error) from None

    def read_line(self, timeout_s: float) -> str:
        """Return the next line, with bytes that are not ASCII as hexadecimal codes; see `Link.read_line`."""
        deadline = Deadline(timeout_s)
        while self._line_end not in self._buffer:
            if len(self._buffer) > _MAX_LINE_BYTES:
                self._buffer = b""
                raise LinkError(f"{self.port}: {_MAX_LINE_BYTES} bytes without a line end; is the baud rate right?")
            got = self._read()
            if not got and deadline.passed:
                raise DeadlineError(f"{self.port}: no answer within {timeout_s:.2g} s")
            self._buffer += got
        line, _, self._buffer = self._buffer.partition(self._line_end)
        return line.removesuffix(b"\r").decode("ascii", "backslashreplace")

    def discard_input(self) -> None:
        """Discard received bytes that were not read; see `Link.discard_input`."""
        self._buffer = b""
        try:
            self._serial.reset_input_buffer()
        except (serial.SerialException, OSError, termios.error) as error:  # termios.error is none of the others
            raise self._lost(error) from None

    def close(self) -> None:
        """Close the port and release its lock; safe to call repeatedly, and after the connection was lost."""
        try:
            self._serial.close()
        except (serial.SerialException, OSError, termios.error):
            # A device that was unplugged cannot be closed properly; its descriptor is gone too.
            self._serial.is_open = False

    def _read(self) -> bytes:
        if not self._serial.is_open:
            raise LinkError(f"{self.port}: the line is closed")
        try:
            return self._serial.read(max(1, self._serial.in_waiting))
        except (serial.SerialException, OSError, TypeError) as error:  # TypeError: closed under the reader
            raise self._lost(error) from None

    def _lost(self, error: Exception) -> LinkError:
        return LinkError(f"{self.port}: the line is lost ({_reason(error)})")


def _reason(error: Exception) -> str:
    """Return the cause of an error as a short phrase, taken from the operating system's error inside pyserial's."""
    number = getattr(error, "errno", None)
    if number is None and error.__context__ is not None:
        number = next(iter(error.__context__.args), None)  # the errno of the system's error behind pyserial's
    text = str(error)
    if "exclusively lock" in text or number in (errno.EWOULDBLOCK, errno.EBUSY):
        return "in use by another program, or opened twice"
    words: dict[int | None, str] = {
        errno.ENOENT: "no such port",
        errno.EACCES: "no permission to open it; is the user in the port's group (ls -l shows it)?",
        errno.EIO: "hung up",
        errno.ENXIO: "no device behind it",
        errno.ENODEV: "no device behind it",
        errno.ENOTTY: "not a serial port",
    }
    return words.get(number, text or type(error).__name__)
