"""The command ``irodori``: its subcommands, and that its help loads nothing heavy."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import irodori
from irodori import command_line
from irodori.command_line import SUBCOMMANDS, main

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_every_subcommand_explains_itself_under_its_own_name(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: irodori {name} ")


def test_help_lists_every_subcommand_and_loads_no_library():
    code = "import sys; from irodori.command_line import main\ntry: main(['--help'])\nfinally: print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    *said, modules = run.stdout.splitlines()
    assert all(any(line.split()[:1] == [name] for line in said) for name in SUBCOMMANDS)
    assert not {"numpy", "numba", "yaml", "h5py", "matplotlib"} & set(modules.split())


@pytest.mark.parametrize("arguments", [["exprt", "a", "b"], [], ["--nonsense"]])
def test_what_is_no_subcommand_is_refused_with_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "SUBCOMMAND" in said and ("export" in said or "exprt" not in arguments)


def test_python_m_irodori_is_the_same_command():
    run = subprocess.run([sys.executable, "-m", "irodori", "--version"], capture_output=True, text=True, cwd=ROOT)
    assert run.stdout == f"irodori {irodori.__version__}\n"


def test_a_subcommand_does_its_work_and_returns_its_status(tmp_path, capsys):
    result = tmp_path / "results/jar/result.csv"
    result.parent.mkdir(parents=True)
    result.write_text("1\n")
    assert main(["verify", "--accept", str(result)]) == 0
    assert main(["verify", str(tmp_path / "results")]) == 0
    result.write_text("2\n")
    assert main(["verify", str(tmp_path / "results")]) == 1
    assert str(result) in capsys.readouterr().out


def test_a_subcommand_of_the_bench_gets_its_own_name_too(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    assert main(["plan", "leaf-sphere"]) == 0
    assert "camera" in capsys.readouterr().out
    assert main(["plan", "no-such-object"]) == 1
    assert "no-such-object" in capsys.readouterr().err


SPEAKING = """
import importlib, sys
from irodori.command_line import SUBCOMMANDS, main
module = importlib.import_module(SUBCOMMANDS[sys.argv[1]].module)
work = {"init": "_write", "crate": "write_crate", "export": "export_named", "verify": "Chain"}[sys.argv[1]]
setattr(module, work, lambda *_: print("a line", flush=True))
raise SystemExit(main())
"""


@pytest.mark.parametrize("words", [["init", "raw"], ["crate"], ["export", "jar", "--to", "gltf"], ["verify"]])
def test_a_command_whose_output_nobody_reads_ends_quietly(words, tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    command, environment = [sys.executable, "-c", SPEAKING, *words], os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=environment)
    os.close(writer)
    assert (run.returncode, run.stderr) == (141, "")


def test_the_command_of_the_rig_ends_quietly_too():
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "irodori.rig", "plan", "tile-plate"]
    run = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    os.close(writer)
    assert (run.returncode, run.stderr) == (141, "")


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["irodori", "--version"], 0),
        (["irodori", "plan", "tile-plate"], 0),
        (["irodori", "plan", "no-such-object"], 1),
        (["irodori.rig", "plan", "no-such-object"], 1),
    ],
)
def test_a_process_without_an_output_has_the_status_of_its_command(words, status):
    """As of a daemon, or of a shell's ``>&-``."""
    command = ["sh", "-c", 'exec "$@" >&-', "sh", sys.executable, "-m", *words]
    run = subprocess.run(command, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert run.returncode == status and "Traceback" not in run.stderr


def test_a_broken_pipe_of_another_program_is_an_error(monkeypatch):
    def broken(arguments):
        raise BrokenPipeError("the controller has gone")

    monkeypatch.setattr(command_line, "_run", broken)
    reader, writer = os.pipe()
    with os.fdopen(reader), os.fdopen(writer, "w") as out, pytest.raises(BrokenPipeError, match="controller"):
        monkeypatch.setattr(sys, "stdout", out)
        main([])
