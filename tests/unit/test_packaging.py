"""Files in the repository's root for installation, citation and deployment."""

import re
import subprocess
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml

import irodori

ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def data_files() -> list[Path]:
    """Return what Git keeps beside the modules of the package, relative to the root."""
    listed = subprocess.run(["git", "ls-files", "irodori"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no Git repository: nothing tells data from what runs left")
    return [Path(line) for line in listed.stdout.splitlines() if not line.endswith(".py")]


def test_every_data_file_of_the_package_is_installed_with_it():
    files = data_files()
    assert {"config.schema.yaml", "published_tables.h5"} <= {file.name for file in files}
    patterns = PYPROJECT["tool"]["setuptools"]["package-data"]["*"]
    for file in files:
        package = file.parent
        while not (ROOT / package / "__init__.py").is_file():
            package = package.parent
        inside = file.relative_to(package)
        matching = [p for p in patterns if len(Path(p).parts) == len(inside.parts) and fnmatch(str(inside), p)]
        assert matching, f"{file}: no pattern of package-data in pyproject.toml"


def test_every_folder_with_modules_is_a_package():
    for file in (ROOT / "irodori").rglob("*.py"):
        assert (file.parent / "__init__.py").is_file(), f"{file.parent} would not be installed"


def test_the_licence_is_the_same_everywhere():
    text = (ROOT / "LICENSE").read_text()
    assert text.startswith("BSD 3-Clause License") and "The Irodori developers" in text
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["license"] == PYPROJECT["project"]["license"] == "BSD-3-Clause"


def test_citation_and_changelog_name_the_packages_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == irodori.__version__
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    assert headings[0] in ("Unreleased", irodori.__version__)


def test_the_workflow_catalog_finds_what_it_looks_for():
    usage = yaml.safe_load((ROOT / ".snakemake-workflow-catalog.yml").read_text())["usage"]
    assert usage["software-stack-deployment"]["conda"] is True and usage["report"] is True
    for path in ("workflow/Snakefile", "config/README.md", "config/config.yaml", "LICENSE", "README.md"):
        assert (ROOT / path).is_file(), path
    rules = "".join(file.read_text() for file in (ROOT / "workflow/rules").glob("*.smk"))
    environments = set(re.findall(r'"(.*/envs/.*\.yaml)"', rules))
    assert environments and all((ROOT / "workflow/rules" / path).is_file() for path in environments)


def test_hooks_before_a_commit_fetch_nothing():
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())
    assert {repo["repo"] for repo in config["repos"]} == {"local"}
    hooks = [hook for repo in config["repos"] for hook in repo["hooks"]]
    assert {"ruff-check", "ruff-format", "snakefmt"} <= {hook["id"] for hook in hooks}
    assert all(hook["language"] == "system" for hook in hooks)
    for hook in hooks:
        for word in hook["entry"].split():
            if word.endswith(".py"):
                assert (ROOT / word).is_file(), f"{hook['id']}: no file {word}"
