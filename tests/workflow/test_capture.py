"""Sessions inside Snakemake: on a driven rig without hardware, killed and begun again, one at a time."""

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import patience
import pytest
from project import ROOT, edit, planned, small_project, snakemake

sys.path.insert(0, str(ROOT / "tests/rig"))

from driven import CAMERA, OBJECT, project
from sessions import assert_whole, contents

from irodori.config.capture_table import read_captures

RECORDS = [f"results/{OBJECT}/captures/session.json", f"results/cameras/{CAMERA}/captures/session.json"]


@pytest.fixture
def studio(tmp_path):
    """Return a working directory whose one scene shows an object of the driven rig."""
    folder = project(tmp_path / "studio")
    scene = {"objects": [{"object": OBJECT, "position_mm": [0.0, 0.0, 0.0]}], "photographs": {}}
    edit(folder / "config/scenes/still-life.yaml", scene)
    edit(folder / f"config/objects/{OBJECT}.yaml", {"poses": [{"light_deg": [45.0], "camera_deg": [0.0, 20.0, 40.0]}]})
    return folder


class Run:
    """Snakemake with the simulated camera on its path, and a person who does what the messages say."""

    def __init__(self, folder: Path, *arguments: str, answers: bool = True) -> None:
        standin = ROOT / "tests/rig/standin"
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", "2"]
        self.said: list[str] = []
        self._answers, self._touched = answers, set()
        self.process = subprocess.Popen(
            [*command, *arguments], cwd=folder, text=True, start_new_session=True, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONPATH": str(standin), "STANDIN_LOG": str(folder / "camera.log")},
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.said.append(line)
            found = re.search(r"When done: touch (\S+)", line)
            if found and self._answers and found[1] not in self._touched:
                self._touched.add(found[1])
                Path(found[1]).touch()

    def end(self) -> str:
        """Wait until it ends; return all that it said."""
        patience.wait(self.process)
        self._reader.join()
        self.process.stdout.close()
        return "".join(self.said)

    def kill(self) -> None:
        """SIGKILL Snakemake and its jobs, as a power cut would."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.end()


@pytest.mark.heavy
def test_sessions_of_a_driven_rig_come_one_after_the_other_and_go_on_after_a_kill(studio):
    run = Run(studio, *RECORDS)
    table, folder = studio / "photos/jar.csv", studio / "photos/jar"
    patience.until(
        lambda: (table.exists() and table.read_text().count("\n") > 2) or run.process.poll() is not None,
        lambda: "".join(run.said),
        polls=20000,
    )
    run.kill()
    before = contents(folder)
    kept = read_captures(table)
    assert 0 < len(kept) < 6 and not (studio / RECORDS[0]).exists()
    assert snakemake(studio, "--unlock").returncode == 0
    log = studio / "camera.log"
    killed = log.read_text().splitlines()[-1]
    assert killed.startswith("open")
    run = Run(studio, *RECORDS)
    said = run.end()
    assert run.process.returncode == 0, said[-4000:]
    assert all((studio / record).exists() for record in RECORDS)
    shots = read_captures(table, folder)
    assert len(shots) == 6
    for name in before:
        if name.endswith(".cr2") and not name.startswith("."):
            assert (folder / name).read_bytes() == before[name], "what stood before the kill was not taken again"
    assert not [name for name in contents(folder) if "part" in name]
    camera = studio / f"photographs/{CAMERA}"
    assert_whole(camera, read_captures(camera / "captures.csv"))
    # The resource rig of the Snakefile. Each session has the camera for itself from its first to its last photograph.
    users = [line for line in log.read_text().splitlines() if line != killed]
    assert len(users) >= 4
    for opened, closed in zip(users[::2], users[1::2], strict=True):
        assert opened.startswith("open") and closed == opened.replace("open", "close")
    assert not planned(snakemake(studio, "--dry-run", *RECORDS))


@pytest.mark.heavy
def test_a_prompt_inside_snakemake_says_what_to_do_in_one_sentence(studio):
    edit(studio / "config/rigs/gonio-grbl.yaml", {"operator": "prompt"})
    run = Run(studio, RECORDS[0])
    said = run.end()
    assert run.process.returncode != 0
    assert "start it on a terminal, or give the rig operator: file" in said
    assert "Traceback" not in said and not list((studio / "photos/jar").glob("*.cr2"))


@pytest.mark.heavy
def test_the_target_capture_asks_for_every_session_and_nothing_else(tmp_path):
    folder = small_project(tmp_path / "virtual")
    jobs = planned(snakemake(folder, "--dry-run", "capture"))
    assert sorted(rule for rule, _ in jobs) == [
        "capture", "capture_camera", "capture_environment", "capture_object", "capture_object",
    ]  # fmt: skip
