"""Give an installed package what it says that it needs, and nothing else: ``python declared_only.py NAME ENVIRONMENT``.

The package stands in a virtual environment that has nothing beside it. Links there lead to its dependencies, and to
theirs, in the environment that runs this, so that nothing is fetched or unpacked a second time: what the package
imports without saying so is not found.
"""

import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


def needed(package: Distribution, extras: frozenset[str] = frozenset()) -> Iterator[tuple[str, frozenset[str]]]:
    """Yield name and extras of what a package needs on this machine, for itself and for some of its extras."""
    for requirement in map(Requirement, package.requires or ()):
        if not requirement.marker or any(requirement.marker.evaluate({"extra": one}) for one in ("", *extras)):
            yield canonicalize_name(requirement.name), frozenset(requirement.extras)


def main(name: str, environment: Path) -> None:
    """Link the dependencies; raise PackageNotFoundError where one is not installed here."""
    (site,) = environment.glob("lib/python*/site-packages")
    (package,) = distributions(name=name, path=[str(site)])
    waiting, seen = [*needed(package)], set()
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        seen.add(one)
        dependency = distribution(one[0])
        waiting += needed(dependency, one[1])
        for part in {file.parts[0] for file in dependency.files or ()} - {"..", "__pycache__"}:
            link = site / part
            if not link.is_symlink():
                link.symlink_to(dependency.locate_file(part))
    print(f"{len({name for name, _ in seen})} packages are linked")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]).resolve())
