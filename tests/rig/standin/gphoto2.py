"""Found as ``gphoto2`` by a process whose path begins with this folder: a simulated EOS 40D with whole RAW files.

With ``STANDIN_LOG`` in the environment it notes there when a process opens the camera and lets go of it; with
``STANDIN_DELAY_S`` each photograph takes so long.
"""

import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from driven import Studio
from simulated_gphoto2 import make_module

from irodori.capture.camera.gphoto_camera import GphotoCamera

_delay_s = float(os.environ.get("STANDIN_DELAY_S", "0"))
_studio = Studio(pause=lambda: time.sleep(_delay_s))
GphotoCamera.capture = _studio.following(GphotoCamera.capture)  # type: ignore[method-assign]
_module = make_module(_studio.bench)


def _note(what: str) -> None:
    if log := os.environ.get("STANDIN_LOG"):
        with open(log, "a") as out:
            out.write(f"{what} {os.getpid()}\n")


class Camera(_module.Camera):
    """The simulated camera, which notes who has it."""

    def init(self):
        super().init()
        _note("open")

    def exit(self):
        if self.is_open:
            _note("close")
        super().exit()


globals().update(
    {name: value for name, value in vars(_module).items() if not name.startswith("__")} | {"Camera": Camera}
)
