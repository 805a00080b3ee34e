"""The packages are pinned once, and everything else agrees with that."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from packaging.markers import Marker, default_environment
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
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


class Locked(NamedTuple):
    """A package of a lock file: its version, where it is wanted, and the SHA-256 of each file that may be installed."""

    version: str
    marker: Marker | None
    hashes: list[str]


KINDS = ("", "-dev", "-rig")
ENTRY = re.compile(r"([a-z0-9-]+)==(\S+)(?: ; (.+?))? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)")


def locked(kind: str) -> dict[str, Locked]:
    """Return name -> entry of a lock file, which must hold entries with hashes and comments and nothing else."""
    text = re.sub(r"^ *#.*\n", "", (ROOT / f"requirements{kind}.lock").read_text(), flags=re.MULTILINE)
    assert not ENTRY.sub("", text), ENTRY.sub("", text)[:200]
    return {
        name: Locked(number, Marker(marker) if marker else None, re.findall(r"[0-9a-f]{64}", hashes))
        for name, number, marker, hashes in ENTRY.findall(text)
    }


def declared(kind: str) -> dict[str, str]:
    """Return canonical name -> pinned version of a requirements file and of those that it includes."""
    found = pins(ROOT / "requirements.txt") | pins(ROOT / f"requirements{kind}.txt")
    return {canonicalize_name(name): number for name, number in found.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_the_lock_has_every_pin_and_the_packages_that_all_files_share_alike(kind):
    lock, main = locked(kind), locked("")
    for name, number in declared(kind).items():
        assert lock[name].version == number and lock[name].marker is None, name
    # What a larger set needs on every machine, a smaller one may need on some alone.
    shared = {name: lock[name] if lock[name].marker else lock[name]._replace(marker=main[name].marker) for name in main}
    assert shared == main


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_the_lock_holds_what_the_pins_need_and_nothing_else(kind, python):
    """Follow what the installed packages say that they need, under each Python that is promised."""
    lock = locked(kind)
    here = default_environment() | {"python_version": python, "python_full_version": f"{python}.0"}
    wanted = {name for name, entry in lock.items() if entry.marker is None or entry.marker.evaluate(here)}
    reached, ahead = set(), [(name, frozenset()) for name in declared(kind)]
    while ahead:
        name, extras = found = ahead.pop()
        if found in reached:
            continue
        reached.add(found)
        assert name in wanted, f"requirements{kind}.lock lacks {name}"
        try:
            needs = [Requirement(line) for line in requires(name) or []]
        except PackageNotFoundError:
            if (marker := lock[name].marker) and not marker.evaluate(default_environment()):
                pytest.skip(f"{name}, which Python {python} needs, is not installed under this Python")
            assert name in declared("-rig"), f"{name} is not installed"  # which only the bench needs
            continue
        for need in needs:
            if need.marker is None or any(need.marker.evaluate(here | {"extra": e}) for e in ("", *extras)):
                needed = canonicalize_name(need.name)
                assert need.specifier.contains(lock[needed].version, prereleases=True), f"{name} needs {need}"
                ahead.append((needed, frozenset(need.extras)))
    assert {name for name, _ in reached} == wanted


def test_the_installed_versions_are_those_locked():
    for name, entry in locked("-dev").items():
        if entry.marker is None or entry.marker.evaluate():
            assert version(name) == entry.version, name


def test_what_the_manuals_tell_to_install_is_what_a_new_machine_installs():
    script = (ROOT / ".ci/run").read_text()
    for file, lock in (("README.md", "requirements.lock"), ("CONTRIBUTING.md", "requirements-dev.lock")):
        command = f"pip install --require-hashes -r {lock}"
        assert command in (ROOT / file).read_text().splitlines(), file
        assert command in script.splitlines(), command


def test_no_file_names_a_package_index():
    for path in [*ROOT.glob("requirements*.*"), *(ROOT / "envs").glob("*.yaml"), ROOT / "pyproject.toml"]:
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
    # What a person adds by choice is tried with the pins of development.
    optional = bounds(*PROJECT["optional-dependencies"]["xarray"])
    tried = pins(ROOT / "requirements-dev.txt")
    assert all(bound.specifier.contains(Version(tried[name])) for name, bound in optional.items())
    pinned |= {name.lower() for name in optional}
    asked += PROJECT["optional-dependencies"]["xarray"]
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
                if path.name == "irodori_mitsuba.py" and top in ("mitsuba", "drjit"):
                    continue  # nothing imports this file: exports hold a copy, which runs within Mitsuba
                if top != "irodori" and top not in sys.stdlib_module_names:
                    assert modules.get(top, top).lower() in pinned & asked, f"{path.name} imports {top}"
