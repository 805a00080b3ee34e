"""Every rule's hash covers the modules that its script uses."""

import ast
import re
from pathlib import Path

import irodori
from irodori.core.provenance import local_sources

ROOT = Path(__file__).resolve().parents[2]
#: Log, threads and provenance, on which no result depends; and the dataclasses of a rule's parameters, which Snakemake
#: compares itself.
COMMON = {"irodori.core.run_rule", "irodori.config.models", "irodori.config.parts"}


def imports(script: Path) -> set[str]:
    """Return the modules of the package that a script imports."""
    names = set()
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("irodori", "benchmarks")):
            names.add(node.module)
    return names - COMMON


def hashed() -> dict[str, set[str]]:
    """Return script -> modules of its rule's code_hash."""
    found = {}
    for file in (ROOT / "workflow/rules").glob("*.smk"):
        for rule in re.split(r"\n(?=(?:use )?rule |for )", file.read_text()):
            script = re.search(r'scripts/(\w+\.py)"', rule)
            if script:
                found[script[1]] = set(re.findall(r'"((?:irodori|benchmarks)[\w.]*)"', rule))
    return found


def test_every_script_belongs_to_a_rule_whose_hash_covers_it():
    rules = hashed()
    scripts = {file.name for file in (ROOT / "workflow/scripts").glob("*.py")}
    assert scripts == set(rules)
    for name, modules in rules.items():
        assert modules, f"{name}: no code_hash"
        covered = {source for module in modules for source in local_sources(module)}
        assert imports(ROOT / "workflow/scripts" / name) <= covered, name


def test_every_rule_that_reads_the_users_files_runs_again_when_their_content_changes():
    found = 0
    for file in (ROOT / "workflow/rules").glob("*.smk"):
        for rule in re.split(r"\n(?=(?:use )?rule |for )", file.read_text()):
            read = re.findall(r"user_files=ancient\(([\w.]+)\)", rule)
            assert read == re.findall(r"user_files=ledger\.content\(([\w.]+)\)", rule), f"{file.name}: {rule[:60]}"
            found += len(read)
    assert found >= 20


def test_every_script_is_thin():
    for file in (ROOT / "workflow/scripts").glob("*.py"):
        assert len(file.read_text().splitlines()) <= 30, file.name


def test_stages_import_the_ground_and_never_each_other():
    stages = ("ingest", "calibration", "rectification", "fitting", "material", "light", "rendering")
    modules = {stage: f"irodori.{stage}.stage" for stage in stages}
    for stage, module in modules.items():
        sources = local_sources(module)
        assert not {name for name in sources if name in modules.values() and name != module}, stage
        assert not {name for name in sources if name.startswith(("irodori.capture", "irodori.evaluation"))}, stage
        assert not {name for name in sources if name.startswith(("irodori.simulation", "irodori.report"))}, stage


def test_no_two_modules_share_a_name_and_rooms_hold_nothing_but_modules():
    files = sorted((ROOT / "irodori").rglob("*.py"))
    names = [file.stem for file in files if file.stem not in ("__init__", "__main__", "stage")]
    assert sorted({name for name in names if names.count(name) > 1}) == []
    for file in files:
        if file.name == "__init__.py" and file.parent != ROOT / "irodori":
            assert len(ast.parse(file.read_text()).body) == 1, f"{file}: more than a docstring"
    assert {file.name for file in (ROOT / "irodori").glob("*.py")} <= {"__init__.py", "__main__.py", "command_line.py"}


QUESTIONS = ("What", "How", "Which", "Where", "When", "Who", "Why")


def opens_with(text: str | None, words: tuple[str, ...]) -> bool:
    return re.match(rf"({'|'.join(words)})\b", text or "") is not None


def test_no_docstring_of_a_module_opens_with_a_question_word():
    files = [file for room in ("irodori", "benchmarks", "tests") for file in sorted((ROOT / room).rglob("*.py"))]
    for file in files:
        text = ast.get_docstring(ast.parse(file.read_text()))
        assert text or file.is_relative_to(ROOT / "tests"), f"{file}: no docstring"
        assert not opens_with(text, (*QUESTIONS, "Whether")), file


def test_no_docstring_of_the_package_opens_with_a_question_word():
    """A property that is true or false may open with Whether; dataclasses of the schemas have the schemas' words."""
    for file in sorted((ROOT / "irodori").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and file.name != "models.py":
                assert not opens_with(ast.get_docstring(node), QUESTIONS), f"{file}: {node.name}"


def test_documents_name_only_modules_and_files_that_are_there():
    own = (ROOT / name for name in ("README.md", "README.ja.md", "CONTRIBUTING.md", "config/README.md"))
    documents = [*own, *(ROOT / "docs").rglob("*.md")]
    rooms = ("irodori", "benchmarks", "tests", "workflow")
    modules = {file.name for room in rooms for file in (ROOT / room).rglob("*.py")}
    for document in documents:
        # Where links lead is looked at in test_documentation.
        text = re.sub(r"\]\([^)]*\)", "]", document.read_text())
        for path in re.findall(r"`((?:irodori|workflow|tests|benchmarks|docs|config|profiles)/[\w./-]+)`", text):
            if "__pycache__" not in path:  # made by a run, and elsewhere if NUMBA_CACHE_DIR says so
                assert (ROOT / path).exists(), f"{document.name} names {path}"
        for module in re.findall(r"(?<![/\w])((?:irodori|benchmarks)(?:\.[a-z_0-9]+)+)\b", text):
            base = ROOT.joinpath(*module.split("."))
            parent = base.parent.with_suffix(".py")  # a function of a module
            offered = module.count(".") == 1 and hasattr(irodori, base.name)
            assert base.is_dir() or base.with_suffix(".py").is_file() or parent.is_file() or offered, (
                f"{document.name} names {module}"
            )
        for name in re.findall(r"`(?:[\w/]*/)?(\w+\.py)`", text):
            assert name in modules, f"{document.name} names {name}"
