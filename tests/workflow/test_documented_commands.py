"""Commands of the documents: each is one that its program's own parser accepts, and targets are those of the workflow.

All are parsed. Those that read a finished project are run on one as well; what Snakemake is to make is planned, by a
dry run of the small project. The help of every command is run where the site is built, the first project's commands in
`test_first_project`, those of a rig on simulated boards in ``tests/rig/test_command.py``, ``irodori crate`` in the
tests of crates, and the README's two in ``.ci/run``.
"""

import argparse
import contextlib
import importlib.util
import inspect
import io
import re
import shlex
import shutil
import sys

import pytest
from project import ROOT, planned, small_project, snakemake

from irodori.capture.command import main as bench_main
from irodori.command_line import main as irodori_main

DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), ROOT / "config" / "README.md", *(ROOT / "docs").rglob("*.md")], key=lambda path: str(path)
)
#: What the documents let one type, by the first word; of other programs nothing is looked at.
_OWN = ("irodori", "python", "python3", "snakemake", "pip", "pytest")
_OTHERS = ("sudo", "npx", "pre-commit", "mkdocs", ".", "cd", "git", "python3.11", "ls", "mkdir")
_STANDS_FOR = {"<lobe>": "gaussian", "RIG": "gonio-grbl", "..": "."}
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(rf"(?<!`)`((?:{'|'.join(_OWN)}) [^`]+)`(?!`)")


def commands(text: str) -> list[str]:
    """Return the commands of a document: lines of its blocks that open with a program, and code between the words."""
    found = []
    for language, block in _FENCE.findall(text):
        lines = [line.split("  #")[0].strip() for line in block.replace("\\\n", " ").splitlines()]
        if language in ("bash", "console", "sh"):
            for part in (part.strip() for line in lines if line for part in line.split("&&")):
                assert part.split()[0] in (*_OWN, *_OTHERS), f"an unknown program: {part}"
                found.append(part)
        elif not language:
            found += [line for line in lines if line.split()[:1] and line.split()[0] in _OWN]
    # A sentence that breaks within a command is one command.
    found += [" ".join(span.split()) for span in _SPAN.findall(_FENCE.sub("", text))]
    return [command for command in dict.fromkeys(found) if command.split()[0] in _OWN]


DOCUMENTED = sorted({command for path in DOCUMENTS for command in commands(path.read_text(encoding="utf-8"))})


class Accepted(Exception):
    """A parser has accepted its words."""


@pytest.fixture
def only_parsed(monkeypatch):
    """Let every program end as soon as its own parser has accepted its words."""

    def ending(original):
        def parse(self, args=None, namespace=None):
            original(self, args, namespace)
            raise Accepted

        return parse

    for name in ("parse_args", "parse_intermixed_args"):
        monkeypatch.setattr(argparse.ArgumentParser, name, ending(getattr(argparse.ArgumentParser, name)))
    monkeypatch.chdir(ROOT)


def is_accepted(run) -> bool:
    try:
        run()
    except Accepted:
        return True
    except SystemExit as ended:
        return ended.code in (0, None)
    return False


def accepts_module(name: str, words: list[str], monkeypatch) -> bool:
    """Whether a module that is run by its name accepts these words; one that parses none is only looked for."""
    try:
        module = importlib.import_module(name)
        if hasattr(module, "__path__"):
            return is_accepted(lambda: bench_main(words))
    except ModuleNotFoundError:
        return False
    if "parse_args" not in inspect.getsource(module):
        return not words
    monkeypatch.setattr(sys, "argv", [name, *words])
    return is_accepted(module.main)


def accepts_irodori(words: list[str]) -> bool:
    return is_accepted(lambda: irodori_main(words)) or has_option(irodori_main, words)


def has_option(main, words: list[str]) -> bool:
    """Whether words that end with an option and not its value, as sentences name them, are of a command that has it."""
    if not words or not words[-1].startswith("--"):
        return False
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        return is_accepted(lambda: main([*words[:1], "--help"])) and words[-1] in said.getvalue()


def accepts_pip(words: list[str]) -> bool:
    from pip._internal.commands import create_command

    command, *rest = words
    options, named = create_command(command).parse_args(rest)
    return all((ROOT / file).is_file() for file in options.requirements) and bool(named or options.requirements)


def accepts_snakemake(words: list[str]) -> bool:
    from snakemake.cli import get_argument_parser, parse_args

    if words[-1].startswith("--") and len(words) == 1:  # an option that a sentence names
        return words[0] in get_argument_parser().format_help()
    try:
        parse_args(words)
    except SystemExit as ended:
        return ended.code == 0
    return True


def accepts(command: str, config, monkeypatch) -> bool:
    """Whether a documented command is one that its program knows."""
    program, *words = (_STANDS_FOR.get(word, word) for word in shlex.split(command, comments=True))
    if program == "irodori":
        # The name of a command stands for the command.
        return accepts_irodori(words) or (len(words) == 1 and accepts_irodori([*words, "--help"]))
    if program == "pip":
        return accepts_pip(words)
    if program == "pytest":
        return not config._parser.parse_known_and_unknown_args(words)[1]
    if program == "snakemake":
        return accepts_snakemake(words)
    if words[0] != "-m":
        return (ROOT / words[0]).is_file()
    if words[1].split(".")[0] not in ("irodori", "benchmarks"):
        return importlib.util.find_spec(words[1]) is not None
    if words[1] == "irodori":
        return accepts_irodori(words[2:] or ["--help"])
    return accepts_module(words[1], words[2:], monkeypatch) or (
        not words[2:] and accepts_module(words[1], ["--help"], monkeypatch)
    )


@pytest.mark.parametrize("command", DOCUMENTED)
def test_a_documented_command_is_one_that_its_program_knows(command, only_parsed, pytestconfig, monkeypatch):
    assert accepts(command, pytestconfig, monkeypatch), command


@pytest.mark.parametrize(
    "command",
    ["irodori exprot a b", "irodori plan OBJECT --most 12", "python -m benchmarks.fit --size huge", "pytest --stabilty",
     "snakemake --core 2 --cofigfile=x", "python -m benchmarks.fitt", "pip install -r requirements-none.txt"],
)  # fmt: skip
def test_a_command_or_an_option_that_does_not_exist_is_noticed(command, only_parsed, pytestconfig, monkeypatch):
    try:
        assert not accepts(command, pytestconfig, monkeypatch)
    except SystemExit as ended:
        assert ended.code


def test_the_documents_have_commands_and_each_kind_is_found():
    assert {command.split()[0] for command in DOCUMENTED} >= {"irodori", "python", "snakemake", "pip", "pytest"}
    block = "```bash\nsnakemake --cores 2  # all\ncd x && irodori init y\n```\n"
    text = f"Type `irodori check` or\n{block}`irodori/core` is a folder."
    assert commands(text) == ["snakemake --cores 2", "irodori init y", "irodori check"]


def targets() -> list[str]:
    """Return what the documents let Snakemake make, apart from everything."""
    from snakemake.cli import parse_args

    asked = [shlex.split(command, comments=True)[1:] for command in DOCUMENTED if command.startswith("snakemake ")]
    return sorted(
        {target for words in asked if len(words) > 1 or words[0][0] != "-" for target in parse_args(words)[1].targets}
    )


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return small_project(tmp_path_factory.mktemp("documented") / "project")


def test_every_target_that_the_documents_name_is_planned(project):
    named = targets()
    assert {"benchmark", "calibrate", "stability"} <= set(named)
    # One dry run plans them all: what does not exist is refused by its name.
    assert planned(snakemake(project, "--dry-run", *named))
    refused = snakemake(project, "--dry-run", "calibrat")
    assert refused.returncode and "calibrat" in refused.stdout + refused.stderr


#: Commands that read a finished project, and what it has in place of a document's own names.
_ON_RESULTS = ("check", "export", "preview", "verify", "viewer")
_IN_PROJECT = {
    "FILE": "results/tile-plate/material.h5",
    "MATERIAL": "results/tile-plate/material.h5",
    "PICTURE": "of-a-file.exr",
    "NAME": "tile-plate",
    "SCENE": "still-life",
    "results/jar/": "results/tile-plate/",
    "results/my-plate/": "results/tile-plate/",
    "config/mine.yaml": "config/config.yaml",
    "config/my-plate.yaml": "config/config.yaml",
}


def runnable() -> list[list[str]]:
    """Return the words of the documented commands that read a finished project, with names that the small one has."""
    found = []
    for command in DOCUMENTED:
        words = shlex.split(command.removeprefix("python -m "), comments=True)
        if words[0] != "irodori" or words[1:2] == [] or words[1] not in _ON_RESULTS:
            continue
        if words[-1] in ("export", "--accept"):
            continue  # named in a sentence, without what they take
        for theirs, ours in _IN_PROJECT.items():
            words = [word.replace(theirs, ours) for word in words]
        found.append(words[1:])
    # What has been accepted differs from what it was when later results were made of it.
    return sorted(found, key=lambda words: "--accept" in words)


@pytest.mark.heavy
def test_every_documented_command_on_results_does_its_work(again, monkeypatch, capsys):
    monkeypatch.chdir(again)
    commands_run = runnable()
    assert {words[0] for words in commands_run} == set(_ON_RESULTS) and len(commands_run) >= 15
    for words in commands_run:
        before = {path: path.stat().st_mtime_ns for path in again.rglob("*") if path.is_file()}
        assert irodori_main(words) == 0, (words, capsys.readouterr())
        written = [path for path in again.rglob("*") if path.is_file() and before.get(path) != path.stat().st_mtime_ns]
        # What only looks says what it found; the others leave what they were asked for.
        if words[0] in ("check", "verify") or "--inspect" in words:
            assert capsys.readouterr().out.strip(), words
        else:
            assert [path for path in written if path.stat().st_size], words


def test_the_readmes_two_commands_are_those_that_a_new_machine_runs():
    script = (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    for file in ("README.md", "README.ja.md"):
        found = commands((ROOT / file).read_text(encoding="utf-8"))
        for command in ("pip install --require-hashes -r requirements.lock", "snakemake --cores 2"):
            assert command in found and command in script, (file, command)


def test_what_is_run_by_its_path_can_be_run():
    for path in DOCUMENTS:
        for script in re.findall(r"`(tests/\w+/run)\b", path.read_text(encoding="utf-8")):
            assert shutil.which(script, path=str(ROOT)) or (ROOT / script).stat().st_mode & 0o100, f"{path}: {script}"
