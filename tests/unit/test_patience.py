"""Programs that the tests start are waited for as long as they get on, and no longer."""

import subprocess
import sys

import patience
import psutil
import pytest

QUIET_S = 1.0
COMPUTES = "import time\nwhile time.process_time() < {}: pass\n"
STARTS = "import subprocess, sys\nsubprocess.run([sys.executable, '-c', {!r}])\nprint('started')\n"


@pytest.fixture(autouse=True)
def any_computing_counts(monkeypatch):
    """So that a host with many programs for each core is none that fails the tests."""
    monkeypatch.setattr(patience, "LEAST_CPU_S", 0.02)


@pytest.mark.heavy
def test_what_computes_is_waited_for_though_it_is_silent():
    run = patience.run([sys.executable, "-c", COMPUTES.format(1.5 * QUIET_S) + "print('done')"], quiet_s=QUIET_S)
    assert (run.returncode, run.stdout, run.stderr) == (0, "done\n", "")


@pytest.mark.heavy
def test_what_a_child_computes_counts():
    code = STARTS.format(COMPUTES.format(1.5 * QUIET_S))
    assert patience.run([sys.executable, "-c", code], quiet_s=QUIET_S).stdout == "started\n"


def test_what_waits_for_a_hung_child_is_killed_with_it_and_what_it_said_is_told(tmp_path):
    child = f"import os, time\nopen({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid()))\ntime.sleep(600)"
    code = "print('about to hang', flush=True)\n" + STARTS.format(child)
    with pytest.raises(patience.HungError, match=r"(?s)no progress.*about to hang"):
        patience.run([sys.executable, "-c", code], quiet_s=QUIET_S)
    pid = int((tmp_path / "pid").read_text())
    patience.until(lambda: not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)


def test_what_computes_without_end_is_killed(monkeypatch):
    monkeypatch.setattr(patience, "MOST_CPU_S", 1.0)
    with pytest.raises(patience.HungError, match="no end"):
        patience.run([sys.executable, "-c", "while True: pass"], quiet_s=QUIET_S)


def test_output_is_progress_and_a_status_is_handed_on():
    code = (
        f"import sys, time\nfor _ in range(10):\n    print(1, flush=True)\n    time.sleep({QUIET_S / 5})\nsys.exit(3)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "1\n"
        process.kill()
        assert patience.wait(process) == -9
    assert patience.run([sys.executable, "-c", code], quiet_s=QUIET_S).returncode == 3


def test_a_condition_that_never_holds_fails_in_the_callers_words():
    with pytest.raises(AssertionError, match="it never came"):
        patience.until(lambda: False, lambda: "it never came", polls=3)
