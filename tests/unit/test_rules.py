"""Every rule's hash covers the modules that its script uses."""

import ast
import re
from pathlib import Path

from irodori.provenance import local_sources

ROOT = Path(__file__).resolve().parents[2]
#: Log, threads and provenance: what every script uses and no result depends on.
COMMON = "irodori.rules"


def imports(script: Path) -> set[str]:
    """Return the modules of the package that a script imports."""
    names = set()
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("irodori", "benchmarks")):
            names.add(node.module)
    return names - {COMMON}


def hashed() -> dict[str, set[str]]:
    """Return script -> modules of its rule's code_hash."""
    found = {}
    for file in (ROOT / "workflow/rules").glob("*.smk"):
        for rule in re.split(r"\n(?=(?:use )?rule )", file.read_text()):
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


def test_every_script_is_thin():
    for file in (ROOT / "workflow/scripts").glob("*.py"):
        assert len(file.read_text().splitlines()) <= 30, file.name


def test_stages_import_the_ground_and_never_each_other():
    stages = ("raw", "calibration", "rectification", "fitting", "compression", "environment", "rendering")
    for stage in stages:
        others = {f"irodori.{other}" for other in stages if other != stage}
        sources = local_sources(f"irodori.{stage}")
        assert not {name for name in sources if name in others}, stage
        assert not {name for name in sources if name.startswith(("irodori.rig", "irodori.report"))}, stage
