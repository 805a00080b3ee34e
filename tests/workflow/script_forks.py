"""Scripts of jobs in forks of a process that has imported what they use: a start of a tenth of a second, not of two.

For a Snakemake that runs in a fork itself, see `planner`. Jobs see what they would see in a process of their own but
for the time of importing: the working directory, the script's folder first on the path, the environment variables that
Snakemake sets for its threads, exit status and what is printed. The main job of the continuous integration and the
tests of sessions start them as users do.
"""

import atexit
import importlib
import json
import os
import re
import socket
import subprocess
import sys
import traceback
import types
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def import_what_scripts_use() -> None:
    """Import the package's modules that the workflow's scripts name."""
    for script in (ROOT / "workflow/scripts").glob("*.py"):
        for module in re.findall(r"^from (irodori[\w.]*) import", script.read_text(encoding="utf-8"), re.MULTILINE):
            importlib.import_module(module)


def run_scripts_in_forks() -> None:
    """Let Snakemake, which is yet to start in this process, run Python scripts in forks of this process as it is now.

    A process of one thread forks them, whatever threads Snakemake has by then.
    """
    from snakemake.benchmark import benchmarked
    from snakemake.script import PythonScript

    asking, asked = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    if not os.fork():
        asking.close()
        _serve(asked)
        os._exit(0)
    asked.close()

    def execute_script(self, fname: str, edit: bool = False) -> None:
        reader, writer = os.pipe()
        socket.send_fds(asking, [json.dumps([fname, self.threads]).encode()], [writer])
        os.close(writer)
        with open(reader) as answer, benchmarked(int(answer.readline()), self.bench_record):
            status = int(answer.readline())
        if status:
            raise subprocess.CalledProcessError(status, fname)

    PythonScript.execute_script = execute_script


def _serve(asked: socket.socket) -> None:
    """Answer each request, in a fork, by the number of a script's process and, once that has ended, by its status."""
    waiting = 0
    while True:
        message, given, *_ = socket.recv_fds(asked, 65536, 1)
        if not message:  # Snakemake has ended
            break
        waiting += 1
        if not os.fork():
            with open(given[0], "w", buffering=1) as answer:
                script, threads = json.loads(message)
                job = os.fork()
                if not job:
                    os._exit(_run(script, threads))
                print(job, file=answer)
                print(os.waitstatus_to_exitcode(os.waitpid(job, 0)[1]), file=answer)
            os._exit(0)
        os.close(given[0])
        while waiting and os.waitpid(-1, os.WNOHANG)[0]:
            waiting -= 1
    while waiting:
        os.waitpid(-1, 0)
        waiting -= 1


def _run(script: str, threads: int) -> int:
    """Run a script in this process; return its exit status."""
    os.environ |= dict.fromkeys(_THREADS, str(threads))
    sys.argv, sys.path[0] = [script], str(Path(script).parent)
    sys.modules["__main__"] = main = types.ModuleType("__main__")
    main.__file__ = script
    status = 0
    try:
        exec(compile(Path(script).read_bytes(), script, "exec"), vars(main))
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        status = 1
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return status


__all__ = ["import_what_scripts_use", "run_scripts_in_forks"]
