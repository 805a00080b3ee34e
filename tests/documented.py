"""Commands that the documents let one type: where they stand, and which kind each is of.

Every kind has a test that runs its commands; `test_documented_commands` fails where a command has none.
"""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), ROOT / "config" / "README.md", *(ROOT / "docs").rglob("*.md")], key=lambda path: str(path)
)
#: What the documents let one type, by the first word; of other programs nothing is looked at.
OWN = ("irodori", "python", "python3", "snakemake", "pip", "pytest")
OTHERS = ("sudo", "npx", "pre-commit", "mkdocs", ".", "cd", "git", "python3.11", "ls", "mkdir", "cp")
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(rf"(?<!`)`((?:{'|'.join(OWN)}) [^`]+)`(?!`)")

#: The file whose test runs the commands of a kind, and which therefore asks for ``of_kind("...")``.
RUN_BY = {
    "benchmark": "tests/workflow/test_documented_benchmarks.py",
    "bench": "tests/rig/test_command.py",
    "first project": "tests/rig/test_init.py",
    "dome": "tests/unit/test_dome.py",
    "lights": "tests/unit/test_mirror_highlights.py",
    "help": "tests/workflow/test_documented_commands.py",
    "lens": "tests/unit/test_lens.py",
    "markers": "tests/unit/test_marker_sheet.py",
    "mutation": "tests/unit/test_mutation.py",
    "pip": "tests/workflow/test_documented_commands.py",
    "pytest": "tests/unit/test_documented_tools.py",
    "results": "tests/workflow/test_documented_commands.py",
    "snakemake": "tests/workflow/test_documented_commands.py",
    "tool": "tests/unit/test_documented_tools.py",
}
_ON_RESULTS = ("check", "crate", "export", "preview", "verify", "viewer")
_AT_THE_BENCH = ("capture", "home", "jog", "move", "plan", "recount", "setup", "shoot", "status")
#: Words that name a command in a sentence, without what it takes: its help is what can be run.
_NAMED = ("dome", "export", "init", "lens", "lights", "markers", "plan", "verify --accept", "--help", "")


def commands(text: str) -> list[str]:
    """Return the commands of a document: lines of its blocks that open with a program, and code between the words."""
    found = []
    for language, block in _FENCE.findall(text):
        lines = [line.split("  #")[0].strip() for line in block.replace("\\\n", " ").splitlines()]
        if language in ("bash", "console", "sh"):
            for part in (part.strip() for line in lines if line for part in line.split("&&")):
                assert part.split()[0] in (*OWN, *OTHERS), f"an unknown program: {part}"
                found.append(part)
        elif not language:
            found += [line for line in lines if line.split()[:1] and line.split()[0] in OWN]
    # A sentence that breaks within a command is one command.
    found += [" ".join(span.split()) for span in _SPAN.findall(_FENCE.sub("", text))]
    return [command for command in dict.fromkeys(found) if command.split()[0] in OWN]


def _of(paths: list[Path]) -> list[str]:
    return sorted({command for path in paths for command in commands(path.read_text(encoding="utf-8"))})


#: All, and those that are to be run: the list of changes also names what earlier versions had.
DOCUMENTED = _of(DOCUMENTS)
TO_RUN = _of([path for path in DOCUMENTS if path.name != "CHANGELOG.md"])


def words_of(command: str) -> list[str]:
    """Return the words of a command; a module of the package that is a program counts as the program."""
    words = shlex.split(command, comments=True)
    return words[2:] if words[:2] == ["python", "-m"] else words


def kind(command: str) -> str | None:
    """Return which kind a command is of, a key of `RUN_BY`; None where no test runs it."""
    program, *rest = words_of(command)
    if program in ("irodori", "irodori.rig"):
        if " ".join(rest) in _NAMED:
            return "help"
        kinds = {"init": "first project"} | {name: name for name in ("dome", "lens", "lights", "markers")}
        kinds |= dict.fromkeys(_ON_RESULTS, "results")
        return (kinds | dict.fromkeys(_AT_THE_BENCH, "bench")).get(rest[0])
    if program in ("pip", "pytest", "snakemake"):
        return program
    if program.startswith("irodori.simulation."):
        return "bench"
    if rest[:1] == ["tests/mutation/run.py"]:
        return "mutation"
    return "benchmark" if program.startswith("benchmarks.") else "tool"


def of_kind(name: str) -> list[str]:
    """Return the commands of a kind, a key of `RUN_BY`."""
    return [command for command in TO_RUN if kind(command) == name]
