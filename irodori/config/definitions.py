"""Loading of all definitions of a run: reading, validation, conversion to dataclasses, and checks between them.

Quick to import for the Snakefile: only the standard library, PyYAML and jsonschema are imported.
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from irodori.config.capture_table import table_faults
from irodori.config.cross_checks.captures_on_rig import table_and_folder
from irodori.config.cross_checks.consistency import check_agreement
from irodori.config.definition import Definition
from irodori.config.loaded import Loaded
from irodori.config.models import Camera, Config, EnvironmentDefinition, Object, Rig, Scene
from irodori.config.validation import dotted, schema_faults, suggest, validate
from irodori.core.errors import InputError, is_file
from irodori.core.yaml_files import read_yaml

__all__ = [
    "KINDS",
    "definition_faults",
    "load_definitions",
    "load_one",
    "read_yaml",
    "validate",
]

#: Class of each kind of definition. A kind is the name of the folder and of the field of `Loaded`, a plural; its
#: singular is the name of the schema.
KINDS: dict[str, type[Definition]] = {
    "scenes": Scene,
    "objects": Object,
    "environments": EnvironmentDefinition,
    "cameras": Camera,
    "rigs": Rig,
}

_CONFIG_FILE = "config/config.yaml"
_NAME = re.compile(r"[a-z0-9-]+")


def load_definitions(config: dict, root: Path, file=_CONFIG_FILE) -> Loaded:
    """Validate a configuration and load every definition that it needs.

    Parameters
    ----------
    config : dict
        Content of ``config.yaml``, as Snakemake merged it.
    root : path
        Working directory of the workflow; relative paths in all files start here.
    file : path, or sequence of paths
        Source of `config`: one file, or all that were merged, in order. A fault is reported for the last file that has
        the key in question. Each existing file is read, to refuse duplicate keys.

    Raises
    ------
    InputError
        For the first fault in any of the files, or between them.
    """
    files = [file] if isinstance(file, str | Path) else list(file) or [_CONFIG_FILE]
    contents = [read_yaml(Path(root) / path) if is_file(Path(root) / path) else {} for path in files]
    try:
        return _load_definitions(config, Path(root), files[0])
    except InputError as error:
        raise _of_its_file(error, files, contents) from None


def definition_faults(config: dict, root: Path, file=_CONFIG_FILE) -> list[InputError]:
    """Return the faults of a configuration's definitions and tables, checked one file at a time.

    Contradictions between files are left to `load_definitions`, which raises an error for the first: they mean little
    while single files have faults. Parameters as in `load_definitions`.
    """
    files = [file] if isinstance(file, str | Path) else list(file) or [_CONFIG_FILE]
    contents = [read_yaml(Path(root) / path) if is_file(Path(root) / path) else {} for path in files]
    return [_of_its_file(fault, files, contents) for fault in _definition_faults(config, Path(root), files[0])]


def _definition_faults(config: dict, root: Path, first) -> list[InputError]:
    """Return the faults; those of the configuration name its first file."""
    faults = schema_faults(config, "config", first)
    if faults:
        return faults
    given = Config.of(validate(config, "config", first))
    finder = _FaultFinder(root, Path(given.definitions), first)
    for index, name in enumerate(given.make.scenes):
        finder.scene(name, first, ("make", "scenes", index))
    for index, name in enumerate(given.make.cameras):
        finder.camera(name, first, ("make", "cameras", index))
    finder.together(given.photographed_together)
    return finder.faults


def load_one(
    kind: str,
    name: str,
    root: Path = Path(),
    file=_CONFIG_FILE,
    *,
    config: dict | None = None,
    photographs: bool = True,
) -> Loaded:
    """Load one definition and those that it requires.

    Parameters
    ----------
    kind : {"scenes", "objects", "cameras", "environments", "rigs"}
    name : str
    root : path
        Folder at which relative paths start.
    file : path
        The configuration, which has the folder of the definitions.
    config : dict, optional
        Content of the configuration if it is merged of several files, of which `file` is the first.
    photographs : bool
        Whether tables of photographs that a person takes must already exist.

    Raises
    ------
    ValueError
        For an unknown kind.
    InputError
        For the first fault.
    """
    wanted: dict[str, list[str]] = {"scenes": [], "cameras": []}
    given = {**(read_yaml(Path(root) / file) if config is None else config), "make": wanted}
    return _load_definitions(given, Path(root), file, (kind, name), photographs)


def _load_definitions(
    given: dict, root: Path, file, also: tuple[str, str] | None = None, photographs: bool = True
) -> Loaded:
    config = Config.of(validate(given, "config", file))
    loader = _Loader(root, Path(config.definitions), file)
    for index, name in enumerate(config.make.scenes):
        loader.scene(name, file, ("make", "scenes", index))
    for index, name in enumerate(config.make.cameras):
        loader.camera(name, file, ("make", "cameras", index))
    if also is not None:
        loader.load(*also)
    else:
        loader.together(config.photographed_together)
    loaded = Loaded(config=config, **loader.found)
    check_agreement(loaded, root, file, loader.file, photographs=photographs)
    return loaded


def _of_its_file(error: InputError, files: list, contents: list[dict]) -> InputError:
    """Return a fault that names the first of the merged files as one of the file that has the key in question."""
    if error.file != str(files[0]):
        return error
    return InputError(_source(error.field, files, contents), error.field, error.found, error.accepted)


def _source(field: str, files: list, contents: list[dict]):
    """Return the last of the files that have the longest part of a dotted path of keys; the first if none has any."""
    best, most = files[0], 1
    for file, block in zip(files, contents, strict=True):
        depth = 0
        for key in re.findall(r"[^.\[\]]+", field):
            if not isinstance(block, dict) or key not in block:
                break
            block, depth = block[key], depth + 1
        if depth >= most:
            best, most = file, depth
    return best


class _Loader:
    """Loader that follows the references from the configuration down to the rigs."""

    def __init__(self, root: Path, folder: Path, config_file) -> None:
        self.root, self.folder, self.config_file = root, folder, config_file
        self.found: dict[str, Any] = {kind: {} for kind in KINDS}

    def file(self, kind: str, name: str) -> Path:
        return self.folder / kind / f"{name}.yaml"

    def load(self, kind: str, name: str) -> None:
        """Load one definition of a kind and those that it requires.

        Raises
        ------
        ValueError
            For an unknown kind.
        """
        loaders = {
            "scenes": self.scene,
            "objects": self._object,
            "cameras": self.camera,
            "environments": self._environment,
            "rigs": self._rig,
        }
        if kind not in loaders:
            raise ValueError(f"no definitions of {kind!r}; {suggest(kind, loaders, 'kinds')}")
        loaders[kind](name, self.config_file, (kind,))

    def scene(self, name: str, by, path: tuple) -> None:
        for scene, file in self._load("scenes", name, by, path):
            self._environment(scene.environment, file, ("environment",))
            for index, step in enumerate(scene.lesson.steps if scene.lesson else ()):
                for keys, light in (
                    (("light",), step.light),
                    (("compare", "light"), step.compare and step.compare.light),
                ):
                    if light and light.environment is not None:
                        self._environment(light.environment, file, ("lesson", "steps", index, *keys, "environment"))
            for index, placed in enumerate(scene.objects):
                self._object(placed.object, file, ("objects", index, "object"))
                if placed.back is not None:
                    self._object(placed.back, file, ("objects", index, "back"))
            for label, photograph in scene.photographs.items():
                self.camera(photograph.camera, file, ("photographs", label, "camera"))

    def camera(self, name: str, by, path: tuple) -> None:
        for camera, file in self._load("cameras", name, by, path):
            list(self._load("rigs", camera.rig, file, ("rig",)))

    def together(self, sets: Sequence[Sequence[str]]) -> None:
        """Load the other objects of each set of which an object is loaded."""
        for number, names in enumerate(sets):
            if any(name in self.found["objects"] for name in names):
                for index, name in enumerate(names):
                    self._object(name, self.config_file, ("photographed_together", number, index))

    def _rig(self, name: str, by, path: tuple) -> None:
        list(self._load("rigs", name, by, path))

    def _object(self, name: str, by, path: tuple) -> None:
        for definition, file in self._load("objects", name, by, path):
            self.camera(definition.camera, file, ("camera",))

    def _environment(self, name: str, by, path: tuple) -> None:
        for definition, file in self._load("environments", name, by, path):
            if definition.camera is not None:
                self.camera(definition.camera, file, ("camera",))

    def _load(self, kind: str, name: str, by, path: tuple) -> Iterator[tuple[Any, Path]]:
        """Load the definition with a name and yield it with its file; yield nothing if it is already loaded."""
        if name in self.found[kind]:
            return
        # Schemas check names in files; a name may also come from the command line.
        if not _NAME.fullmatch(name):
            raise InputError(by, dotted(path), repr(name), "a name of small letters, digits and hyphens")
        file = self.file(kind, name)
        if not is_file(self.root / file):
            existing = sorted(other.stem for other in (self.root / self.folder / kind).glob("*.yaml"))
            found = f"{name!r}, for which there is no {file}"
            raise InputError(by, dotted(path), found, suggest(name, existing, f"{kind} that exist"))
        given = validate(read_yaml(self.root / file), kind.removesuffix("s"), file)
        self.found[kind][name] = KINDS[kind].of(given)
        yield self.found[kind][name], file


class _FaultFinder(_Loader):
    """Loader that collects all faults, and also follows the references in a file that has faults."""

    def __init__(self, root: Path, folder: Path, config_file) -> None:
        super().__init__(root, folder, config_file)
        self.faults: list[InputError] = []
        self._seen: set[tuple[str, str]] = set()

    def _load(self, kind: str, name: str, by, path: tuple) -> Iterator[tuple[Any, Path]]:
        if (kind, name) in self._seen:
            return
        self._seen.add((kind, name))
        try:
            found = list(super()._load(kind, name, by, path))
        except InputError as error:
            self._note(kind, name, error)
            return
        for definition, _ in found:
            captures = getattr(definition, "captures", None)
            if captures is not None and is_file(self.root / captures.table):
                table, folder = table_and_folder(captures, self.root)
                self.faults += table_faults(table, None if captures.published else folder)
        yield from found

    def _note(self, kind: str, name: str, error: InputError) -> None:
        """Record a file's faults, and load the definitions that it refers to."""
        file = self.root / self.file(kind, name)
        try:
            given = read_yaml(file) if _NAME.fullmatch(name) and is_file(file) else None
        except InputError:
            given = None
        if not isinstance(given, dict):
            self.faults.append(error)
            return
        self.faults += schema_faults(given, kind.removesuffix("s"), self.file(kind, name)) or [error]
        placed = given.get("objects")
        names = [(f"{key}s", given.get(key)) for key in ("environment", "camera", "rig")]
        for one in placed if isinstance(placed, list) else ():
            names.append(("objects", one.get("object") if isinstance(one, dict) else None))
        for other, label in names:
            if isinstance(label, str) and _NAME.fullmatch(label):
                self.load(other, label)
