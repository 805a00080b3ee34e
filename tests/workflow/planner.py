"""Snakemake in forks of one process that has imported it: ``python planner.py``, started by `Planner`.

A dry run of its own process takes two thirds of its time to import and to read what never changes: Snakemake, schemas
and the repository's sources. So does a small job, which is forked as well (`script_forks`). Each line on standard
input is a JSON list: working directory, file for standard output, file for standard error, arguments. The answer is
the fork's process, then its exit status.
"""

import gc
import json
import os
import select
import subprocess
import sys
from pathlib import Path

import patience
import script_forks

ROOT = Path(__file__).resolve().parents[2]


class _Fork:
    """A run, to `patience.wait` as good as a process that was started here."""

    def __init__(self, server: subprocess.Popen, command: list) -> None:
        self.args, self._server = command, server
        server.stdin.write(json.dumps(command) + "\n")
        server.stdin.flush()
        self.pid = int(server.stdout.readline())

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit status."""
        if not select.select([self._server.stdout], [], [], timeout)[0]:
            raise subprocess.TimeoutExpired(self.args, timeout)
        return int(self._server.stdout.readline())


class Planner:
    """The forking process, from the side of the tests."""

    def __init__(self) -> None:
        path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
        self._server = subprocess.Popen(
            [sys.executable, __file__], env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def run(self, folder: Path, arguments: list[str], out: Path, err: Path) -> int:
        """Run Snakemake in a working directory; return its exit status."""
        fork = _Fork(self._server, [str(folder), str(out), str(err), arguments])
        return patience.wait(fork, out, err)

    def close(self) -> None:
        """End the process."""
        self._server.stdin.close()
        self._server.stdout.close()
        self._server.wait(patience.LONG_S)


def main() -> None:
    """Fork for each line."""
    import snakemake.cli

    from irodori.config.validation import SCHEMAS, load_schema
    from irodori.core.frame_memory import with_room_for_calls
    from irodori.core.provenance import code_hash, modules_of

    script_forks.import_what_scripts_use()
    for schema in SCHEMAS:
        load_schema(schema)
    code_hash(*modules_of("irodori"))  # each rule asks for that of its part: the sources are parsed once
    os.environ.pop("PYTHONPATH")
    # A fork never collects what was imported here, and copies no page of it to look whether it could.
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    for line in sys.stdin:
        folder, out, err, arguments = json.loads(line)
        pid = os.fork()
        if not pid:
            os.chdir(folder)
            sys.path[0] = folder  # as for python -m
            for path, number in ((os.devnull, 0), (out, 1), (err, 2)):
                os.dup2(os.open(path, os.O_RDWR | os.O_CREAT), number)
            if "--dry-run" not in arguments:
                script_forks.run_scripts_in_forks()
            with_room_for_calls(snakemake.cli.main)(arguments)
            os._exit(1)  # it has not ended the process itself, as it always does
        print(pid, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)


if __name__ == "__main__":
    main()
