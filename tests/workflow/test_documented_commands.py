"""Commands of the documents: each is one that its program's own parser accepts, and each is run by some test.

`documented` says which kind a command is of, and the file whose test runs that kind. Here are those that read a
finished project, those of Snakemake, those that install, and the help of what sentences only name. Snakemake's targets
are planned by dry runs; other tests of this folder and ``.ci/run`` make them.
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

import h5py
import pytest
from documented import DOCUMENTED, DOCUMENTS, RUN_BY, TO_RUN, commands, kind, of_kind, words_of
from project import ROOT, planned, small_project, snakemake

from irodori.capture.command import main as bench_main
from irodori.command_line import main as irodori_main

_STANDS_FOR = {"<lobe>": "gaussian", "RIG": "gonio-grbl", "..": "."}


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


def test_every_documented_command_is_of_a_kind_that_some_test_runs():
    assert [command for command in TO_RUN if kind(command) not in RUN_BY] == []
    for name, file in RUN_BY.items():
        assert of_kind(name), name
        assert f'of_kind("{name}")' in (ROOT / file).read_text(encoding="utf-8"), name
    assert kind("irodori exprot still-life") is None


@pytest.mark.parametrize("command", of_kind("help"))
def test_what_a_sentence_only_names_explains_itself(command, capsys):
    program, *words = (word for word in words_of(command) if word != "--help")
    with pytest.raises(SystemExit) as ended:
        (irodori_main if program == "irodori" else bench_main)([*words[:1], "--help"])
    said = capsys.readouterr().out
    assert not ended.value.code and said.startswith("usage: ") and all(word in said for word in words)


#: What a finished project has in place of a document's own names.
_IN_PROJECT = {
    "FILE": "results/tile-plate/material.h5",
    "MATERIAL": "results/tile-plate/material.h5",
    "PICTURE": "of-a-file.exr",
    "NAME": "tile-plate",
    "SCENE": "still-life",
    "results/jar/": "results/tile-plate/",
    "results/my-plate/": "results/tile-plate/",
    "my-plate": "tile-plate",
    "config/mine.yaml": "config/config.yaml",
    "config/tile-plate.yaml": "config/config.yaml",  # as my-plate was renamed above
}


def runnable() -> list[list[str]]:
    """Return the words of the documented commands that read a finished project, with names that the small one has."""
    found = []
    for command in of_kind("results"):
        words = words_of(command)[1:]
        for theirs, ours in _IN_PROJECT.items():
            words = [word.replace(theirs, ours) for word in words]
        if words not in found:
            found.append(words)
    # What has been accepted differs from what it was when later results were made of it.
    return sorted(found, key=lambda words: "--accept" in words)


@pytest.mark.heavy
def test_every_documented_command_on_results_does_its_work(again, monkeypatch, capsys):
    shutil.copytree(ROOT / "workflow", again / "workflow", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(again)
    for words in runnable():
        before = {path: path.stat().st_mtime_ns for path in again.rglob("*") if path.is_file()}
        capsys.readouterr()
        if "--accept" in words:
            with h5py.File(words[-1], "r+") as file:
                file.attrs["note"] = "by hand"
            assert irodori_main(["verify"]) == 1
        assert irodori_main(words) == 0, (words, capsys.readouterr())
        written = [path for path in again.rglob("*") if path.is_file() and before.get(path) != path.stat().st_mtime_ns]
        # What only looks says what it found; the others leave what they were asked for.
        if "--accept" not in words and (words[0] in ("check", "verify") or "--inspect" in words):
            assert capsys.readouterr().out.strip(), words
        else:
            assert [path for path in written if path.stat().st_size], words


def is_of_targets(words: list[str]) -> bool:
    """Whether words ask for nothing but cores and targets, which one dry run plans together."""
    return not [word for word in words[1:] if word.startswith("-") and word != "--cores"]


@pytest.mark.heavy
def test_every_documented_command_of_snakemake_does_what_it_says_or_plans_it(again):
    """Configurations of one's own are the project's under another name; `test_first_project` has such."""
    shutil.copytree(ROOT / "profiles", again / "profiles")
    for name in ("my-plate", "eye"):
        shutil.copy(again / "config/config.yaml", again / f"config/{name}.yaml")
    photographs = ROOT.parent / "shared"
    if photographs.is_dir():
        (again.parent / "shared").symlink_to(photographs)
    for command in of_kind("snakemake"):
        words = [str(again) if word == "FOLDER" else word for word in words_of(command)]
        if is_of_targets(words) or ("config/real.yaml" in command and not photographs.is_dir()):
            continue
        given = [word for word in words[1:] if word not in ("--cores", "2")]
        if given == ["--configfile"]:  # an option that a sentence names
            given.append("config/config.yaml")
        if "--lint" in given:
            run = snakemake(ROOT, *given, cores=None)
            assert run.returncode == 0 and "in a good condition" in run.stdout + run.stderr, run.stderr[-4000:]
        elif "--unlock" in given or "--report" in given:
            run = snakemake(again, *given)
            assert run.returncode == 0, run.stderr[-4000:]
            assert "--unlock" in given or (again / "report.zip").stat().st_size > 1000
        else:
            jobs = {rule for rule, _ in planned(snakemake(again, "--dry-run", *given))}
            expected = {"calibrate": {"calibrate_camera"}, "capture_object": {"capture_object", "fit_brdf"}}
            assert jobs >= expected.get(given[-1] if "eye" not in command else "", set()), command


def test_what_the_documents_install_is_installed_on_a_new_machine():
    script = (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    tried = [shlex.split(line) for line in script if line.startswith("pip install --quiet --dry-run ")]
    for command in of_kind("pip"):
        asked = words_of(command)[1:]
        assert command in script or any(set(asked) <= set(words) for words in tried), command
    for file in ("README.md", "README.ja.md"):
        found = commands((ROOT / file).read_text(encoding="utf-8"))
        for command in ("pip install --require-hashes -r requirements.lock", "snakemake --cores 2"):
            assert command in found and command in script, (file, command)


def test_what_is_run_by_its_path_can_be_run():
    for path in DOCUMENTS:
        for script in re.findall(r"`(tests/\w+/run)\b", path.read_text(encoding="utf-8")):
            assert shutil.which(script, path=str(ROOT)) or (ROOT / script).stat().st_mode & 0o100, f"{path}: {script}"
