"""Try an installed package: ``python installed.py REPOSITORY``, in a folder that is not the repository.

Every module is imported, every data file of the repository's package is there, the repository's configuration agrees
with the installed schemas, and the code's hashes, by which stages are made again, are those of the repository.
"""

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import irodori
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.validation import SCHEMAS, load_schema
from irodori.core.provenance import code_hash


def main(repository: Path) -> None:
    """Raise at the first fault."""
    folder = Path(irodori.__file__).resolve().parent
    if repository in folder.parents or str(repository) in sys.path:
        raise SystemExit(f"{folder} is the repository's own package")
    modules = [info.name for info in pkgutil.walk_packages(irodori.__path__, "irodori.")]
    for name in modules:
        # The last is a plugin that Mitsuba loads, wherever it is installed.
        if not name.endswith(("__main__", "irodori_mitsuba")):
            importlib.import_module(name)
    listed = subprocess.run(["git", "ls-files", "irodori"], cwd=repository, capture_output=True, text=True, check=True)
    missing = [file for file in listed.stdout.split() if not (folder.parent / file).is_file()]
    if missing:
        raise SystemExit(f"not installed: {', '.join(missing)}")
    for schema in SCHEMAS:
        load_schema(schema)
    definitions = load_definitions(read_yaml(repository / "config/config.yaml"), repository)
    for module in ("irodori.fitting.stage", "irodori.rendering.stage"):
        if code_hash(module) != code_hash(module, root=repository):
            raise SystemExit(f"{module}: the installed package hashes to something else than the repository's")
    print(f"{len(modules)} modules in {folder}; objects {', '.join(definitions.objects)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
