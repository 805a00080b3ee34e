"""Sessions in processes of their own, to be killed: ``python killable.py`` imports everything once and forks.

Each line on standard input is a JSON list: folder, whether a simulated rig moves, seconds by which every step of the
disk is stretched. The answer is the process to kill, then how it ended.
"""

import importlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import patience
from made import made
from sessions import MADE, ROOT, definitions, target

from irodori.capture.stage import capture_object
from irodori.config.models import Object
from irodori.config.parts import PhotographedObject


class Killable:
    """The forking process, from the side of the tests; ``motion`` may change from session to session."""

    def __init__(self, slow_s: float) -> None:
        self.motion, self.slow_s = False, slow_s
        path = os.pathsep.join([str(ROOT), str(ROOT / "tests"), str(ROOT / "tests/rig")])
        self._process = subprocess.Popen(
            [sys.executable, "-W", "error", __file__], env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def __enter__(self) -> "Killable":
        return self

    def __exit__(self, *_) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait(patience.LONG_S)

    def run(self, folder: Path, kill_after_s: float | None = None, photographs: int = 0) -> float:
        """Hold a session, and return how long it ran, s.

        Where a time is given, SIGKILL it so long after so many photographs stand: a host that others share may be many
        times slower than it was when the session was timed.
        """
        self._process.stdin.write(json.dumps([str(folder), self.motion, self.slow_s]) + "\n")
        self._process.stdin.flush()
        pid = int(self._process.stdout.readline())
        begun, ended = time.monotonic(), threading.Event()

        def kill() -> None:
            while len(list(folder.glob("*.dng"))) < photographs and not ended.wait(0.005):
                pass
            if not ended.wait(kill_after_s):
                os.kill(pid, 9)

        killer = threading.Thread(target=kill)
        if kill_after_s is not None:
            killer.start()
        status = int(self._process.stdout.readline())
        took = time.monotonic() - begun
        ended.set()
        assert status in ((0,) if kill_after_s is None else (0, -9)), status
        # The process is not waited for until the thread can no longer hit another one of its number.
        if kill_after_s is not None:
            killer.join()
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return took


def stretched(action, seconds: float):
    """Return an action of the disk with a pause on either side of it, so that kills fall there too."""

    def act(*arguments):
        time.sleep(seconds)
        result = action(*arguments)
        time.sleep(seconds)
        return result

    return act


def hold(folder: Path, motion: bool) -> None:
    """Hold a session."""
    definition, aim = target(folder, motion)
    capture_object(made(Object | PhotographedObject, definition), aim, folder / "session.json", MADE)


def import_all() -> None:
    """Import what a session imports as it goes, named by a session in a child: kills are to fall into its work."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        with tempfile.TemporaryDirectory() as folder:
            hold(Path(folder), motion=False)
        with os.fdopen(writing, "w") as out:
            out.write("\n".join(sys.modules))
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as found:
        names = found.read().split("\n")
    assert os.waitpid(pid, 0)[1] == 0
    for name in names:
        if name.partition(".")[0] in ("scipy", "numba", "embreex"):
            importlib.import_module(name)


def main() -> None:
    """Fork for each line."""
    definitions()  # read once
    import_all()
    for line in sys.stdin:
        folder, motion, slow_s = json.loads(line)
        pid = os.fork()
        if pid == 0:
            for name in ("fsync", "replace"):
                setattr(os, name, stretched(getattr(os, name), slow_s))
            try:
                hold(Path(folder), motion)
            except BaseException as error:
                print(repr(error), file=sys.stderr, flush=True)
                os._exit(1)
            os._exit(0)
        print(pid, flush=True)
        ended = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        print(ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status, flush=True)
        sys.stdin.readline()
        os.waitpid(pid, 0)


if __name__ == "__main__":
    main()
