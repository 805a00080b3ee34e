"""Settings of all tests, and light maps of few texels; in CI, properties draw the same examples every time."""

import ctypes
import gc
import math
import os
import signal

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

from irodori.core.frame_memory import with_room_for_calls

# One thread for linear algebra, before NumPy is loaded: the matrices of tests are small, and while other tests compute
# on all cores, threads that wait for each other burn up to fifteen times what they compute.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What a test frees is kept for the next one. Given back to the system and asked for again, page by page, it took an
# eighth of the CPU time of those tests with which this was measured. Only the GNU C library has this setting.
if keep := getattr(ctypes.CDLL(None), "mallopt", None):
    for option, most in ((-3, 1 << 30), (-1, (1 << 31) - 1), (-2, 1 << 26)):  # bytes to map, to trim and to pad
        keep(option, most)

# Tests are called from so deep that their own calls would often be at the end of a piece of memory for frames.
with_room_for_calls(runtestprotocol)

pytest_plugins = ["stability_table", "cpu_times", "default_cases", "left_behind", "rewritten_once"]

settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("here", deadline=None)  # the first example of a test compiles its loops
settings.load_profile("ci" if os.environ.get("CI") else "here")

# Under nohup a hang-up is ignored, and in a script's background an interrupt, rightly, and by all that is started from
# here: the tests that hang up and interrupt need both.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


#: Files that take minutes: the workflow's, and those that start programs and wait for them.
_LONG = (
    "/workflow/", "test_mutation.py", "/viewer_page/", "/test_viewer_", "test_session_killed.py",
    "test_sound_captures.py", "test_shapes.py",
)  # fmt: skip
#: The file whose first test runs the small project, for which the others that read its results would wait.
_FIRST = "/workflow/test_chain.py"


# What collection makes, half a million objects, lives until the end: the garbage collector need never look at it.
gc.disable()


def pytest_collection_finish():
    """Collect garbage from now on, but none of what there is, and less often: compiling loops makes much that stays."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


def pytest_collection_modifyitems(items):
    """Begin with the files that take minutes, for which the others would wait at the end.

    Of these, those that read the results of the small project come after the others, but for the one that runs it. Then
    files of all folders alternate: those of the rig wait for simulated controllers, while others compute.
    """
    readers = {item.path for item in items if "finished" in item.fixturenames}
    files = {}  # of each folder, in order
    for item in items:
        files.setdefault(item.path.parent, {}).setdefault(item.path, len(files[item.path.parent]))

    def turn(item) -> tuple[int, float]:
        path = item.path.as_posix()
        if any(part in path for part in _LONG):
            return 0 if path.endswith(_FIRST) else 2 if item.path in readers else 1, 0.0
        folder = files[item.path.parent]
        return 3, folder[item.path] / len(folder)

    items.sort(key=turn)


@pytest.fixture
def coarse_light_maps(monkeypatch):
    """Give light maps as few texels as tests of other things need; a hundredth of the rays is traced.

    The error that they state is measured with a sixteenth of the paths, too.
    """
    from irodori.rendering import light_transfer
    from irodori.rendering.interactive import surroundings
    from irodori.rendering.reference import baking

    monkeypatch.setattr(light_transfer, "_FEWEST_TEXELS", 64)
    monkeypatch.setattr(light_transfer, "MOST_ERROR", math.inf)
    monkeypatch.setattr(surroundings, "TEXELS", 16)
    monkeypatch.setattr(baking, "_PATHS", 32)
