"""Scenes, objects and environments looked up by name, with the results that their export reads."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.config.loaded import Loaded
from irodori.config.models import Scene
from irodori.config.photograph_sets import light_definition, light_files, material_definition, material_files
from irodori.config.placed_names import materials_of
from irodori.config.project import DEFAULT_FILE, definitions_folder, load_named
from irodori.core.atomic_files import file_sha256
from irodori.core.errors import InputError
from irodori.core.made_of import made_of, refuse_changed_definition
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.material.material_file import Material
from irodori.rendering.energy_gain import load_materials
from irodori.rendering.integrators import with_bodies
from irodori.rendering.scene_arrays import make_placements

#: Kinds of definitions by folder; a name without a folder is searched for in this order.
_FOLDERS = {"scenes": "scene", "objects": "object", "environments": "environment"}


class Item(NamedTuple):
    """One object or body in an export."""

    name: str
    placement: Placement
    material: Material  # texels without data are filled in
    observed: np.ndarray  # (height, width) bool, texels on the surface with data
    file: str  # path of the material; empty for a body of the scene
    sha256: str  # hash of this file; empty for a body


class Source(NamedTuple):
    """A scene, an object or an environment to be exported, with its results."""

    name: str
    kind: str  # one of the values of `_FOLDERS`
    items: list[Item]
    scene: Scene | None = None
    environment: Path | None = None


def kind_of(name: str, configs: Sequence[str] = ()) -> tuple[str, str]:
    """Return folder and name of a definition that is given as ``NAME`` or ``FOLDER/NAME``.

    ``configs`` are configurations on top of the default one.

    Raises
    ------
    InputError
        If there is no such definition; the message lists the scenes and objects that exist.
    """
    folder, _, own = name.rpartition("/")
    definitions = definitions_folder(configs)
    wanted = [folder] if folder else list(_FOLDERS)
    for one in wanted:
        if one in _FOLDERS and (definitions / one / f"{own}.yaml").is_file():
            return one, own
    there = sorted(file.stem for one in ("scenes", "objects") for file in (definitions / one).glob("*.yaml"))
    raise InputError(definitions, "", f"no scene or object {name!r}", f"one of: {', '.join(there)}; or a result's file")


def result(path: Path, configs: Sequence[str] = ()) -> Path:
    """Return the path of a result after checking that the file exists.

    Raises
    ------
    InputError
        If it does not exist yet; the message has the command that makes it with the given configurations.
    """
    if not path.is_file():
        accepted = f"what '{_making(path, configs)}' makes, with its scene under make.scenes"
        raise InputError(path, "", "no file", accepted)
    return path


def _making(path: Path, configs: Sequence[str]) -> str:
    """Return the command that makes a result."""
    given = [config for config in configs if Path(config) != Path(DEFAULT_FILE)]
    option = f" --configfile {shlex.join(given)} --" if given else ""
    return f"snakemake --cores 2{option} {path}"


def material_of(loaded: Loaded, name: str, configs: Sequence[str] = ()) -> Path:
    """Return the path of an object's material after checking that it exists and is of its definition of today.

    Raises
    ------
    InputError
        If it does not exist yet, or its object's definition has changed since it was made.
    """
    path, definition = result(Path(f"results/{name}/material.h5"), configs), loaded.objects[name]
    now = made_of(material_definition(definition), material_files(definition))
    file = Path(loaded.config.definitions) / "objects" / f"{name}.yaml"
    refuse_changed_definition(path, now, file, _making(path, configs))
    return path


def light_of(loaded: Loaded, name: str, configs: Sequence[str] = ()) -> Path:
    """Return the path of an environment's light after checking that it exists and is of its definition of today.

    Raises
    ------
    InputError
        If it does not exist yet, or its environment's definition has changed since it was made.
    """
    path, place = result(Path(f"results/environments/{name}.h5"), configs), loaded.environments[name]
    file = Path(loaded.config.definitions) / "environments" / f"{name}.yaml"
    refuse_changed_definition(path, made_of(light_definition(place), light_files(place)), file, _making(path, configs))
    return path


def _item(name: str, placement: Placement, material: Material, file: Path | None) -> Item:
    covered = placement.shape.is_covered(*material.alpha.shape[::-1])
    if not (material.observed & covered).any():
        raise InputError(file, "", "no texel on the surface with data", "a material that photographs determine")
    whole, _ = material.filled(covered)
    sha256 = "" if file is None else file_sha256(file)
    return Item(name, placement, whole, material.observed & covered, "" if file is None else str(file), sha256)


def find(name: str, configs: Sequence[str] = ()) -> Source:
    """Load a scene, an object or an environment by name, with its results, from the project in the working directory.

    ``configs`` are configurations on top of the default one.

    Raises
    ------
    InputError
        If the name is unknown, its definition is faulty or has changed since its material or light was made, a result
        does not exist yet, no texel of an object has data, or a material of a scene reflects more light than it
        receives.
    """
    folder, own = kind_of(name, configs)
    loaded = load_named(folder, own, configs)
    if folder == "environments":
        return Source(own, _FOLDERS[folder], [], None, light_of(loaded, own, configs))
    if folder == "objects":
        shape = Shape.from_definition(loaded.objects[own].shape)
        file = material_of(loaded, own, configs)
        return Source(own, _FOLDERS[folder], [_item(own, Placement(shape), Material.load(file), file)])
    scene = loaded.scenes[own]
    files = [material_of(loaded, name, configs) for name in materials_of(scene)]
    shapes = [Shape.from_definition(loaded.objects[item.object].shape) for item in scene.objects]
    shapes, materials = with_bodies(scene, shapes, load_materials(scene, shapes, files))
    names = [item.object for item in scene.objects] + [f"body-{i + 1}" for i in range(len(scene.bodies))]
    known: list[Path | None] = [*files[: len(scene.objects)], *([None] * len(scene.bodies))]
    parts = zip(names, make_placements(scene, shapes), materials, known, strict=True)
    items = [_item(*part) for part in parts]
    light = light_of(loaded, scene.environment, configs)
    return Source(own, _FOLDERS[folder], items, scene, light)
