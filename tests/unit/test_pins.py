"""The packages are pinned once, and everything else agrees with that."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def pins(path: Path) -> dict[str, str]:
    """Return name -> version of a requirements file, every line of which must be a pin or an include."""
    found = {}
    for line in path.read_text().splitlines():
        line = line.split("#")[0].strip()
        if line and not line.startswith("-r "):
            name, _, number = line.partition("==")
            assert number, f"{path.name}: {line!r} is not pinned"
            found[name] = number
    return found


def test_the_conda_environment_has_the_same_versions():
    for path in (ROOT / "envs").glob("*.yaml"):
        dependencies = yaml.safe_load(path.read_text())["dependencies"]
        listed = next(d["pip"] for d in dependencies if isinstance(d, dict))
        assert dict(line.split("==") for line in listed) == pins(ROOT / "requirements.txt")


def bounds(*lines: str) -> dict[str, Requirement]:
    """Return name -> requirement of pyproject.toml, each of which must be a lower bound and nothing else."""
    found = {}
    for line in lines:
        requirement = Requirement(line)
        assert [bound.operator for bound in requirement.specifier] == [">="], line
        assert not requirement.extras and requirement.marker is None, line
        found[requirement.name] = requirement
    return found


def test_what_an_installation_asks_for_is_what_is_pinned():
    extras = PROJECT["optional-dependencies"]
    main = bounds(*PROJECT["dependencies"], *extras["workflow"])
    assert set(main) == set(pins(ROOT / "requirements.txt"))
    assert set(bounds(*extras["camera"])) == set(pins(ROOT / "requirements-rig.txt"))
    pinned = pins(ROOT / "requirements.txt") | pins(ROOT / "requirements-rig.txt")
    for name, requirement in (main | bounds(*extras["camera"])).items():
        assert requirement.specifier.contains(Version(pinned[name])), f"{requirement} refuses the pin {pinned[name]}"


def test_the_workflow_needs_no_snakemake_newer_than_it_says():
    least = re.search(r'min_version\("([\d.]+)"\)', (ROOT / "workflow/Snakefile").read_text())[1]
    assert Version(least) <= Version(pins(ROOT / "requirements.txt")["snakemake"])


def test_every_python_that_is_promised_is_accepted_and_no_other():
    accepted = SpecifierSet(PROJECT["requires-python"])
    named = {c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)}
    assert named == {f"3.{minor}" for minor in range(30) if f"3.{minor}.1" in accepted}


def test_the_installed_versions_are_those_pinned():
    for name, number in (pins(ROOT / "requirements.txt") | pins(ROOT / "requirements-dev.txt")).items():
        assert version(name) == number, name


def test_no_file_names_a_package_index():
    for path in [*ROOT.glob("requirements*.txt"), *(ROOT / "envs").glob("*.yaml"), ROOT / "pyproject.toml"]:
        assert not re.search(r"index-url|find-links|https?://", path.read_text()), path.name


def test_every_third_party_import_of_the_package_is_pinned():
    import ast
    import sys

    modules = {"OpenImageIO": "OpenImageIO", "PIL": "pillow", "yaml": "PyYAML", "colour": "colour-science",
               "serial": "pyserial", "cv2": "opencv-python",
               "colour_checker_detection": "colour-checker-detection"}  # fmt: skip
    files = ("requirements.txt", "requirements-rig.txt")
    pinned = {name.lower() for file in files for name in pins(ROOT / file)} | {"llvmlite"}  # numba brings llvmlite
    asked = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["camera"]]
    asked = {name.lower() for name in bounds(*asked)} | {"llvmlite"}
    for path in (ROOT / "irodori").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            for name in names:
                top = name.split(".")[0]
                if top != "irodori" and top not in sys.stdlib_module_names:
                    assert modules.get(top, top).lower() in pinned & asked, f"{path.name} imports {top}"
