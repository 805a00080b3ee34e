"""Scenes, objects and environments looked up by name, with the results that their export reads."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.config.definitions import load_definitions, load_one
from irodori.config.models import Scene
from irodori.config.placed_names import materials_of
from irodori.core.atomic_files import file_sha256
from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.material.material_file import Material
from irodori.rendering.energy_gain import load_materials
from irodori.rendering.integrators import with_bodies
from irodori.rendering.scene_arrays import make_placements

_CONFIG = Path("config/config.yaml")
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


def kind_of(name: str) -> tuple[str, str]:
    """Return folder and name of a definition that is given as ``NAME`` or ``FOLDER/NAME``.

    Raises
    ------
    InputError
        If there is no such definition; the message lists the scenes and objects that exist.
    """
    folder, _, own = name.rpartition("/")
    definitions = Path(read_yaml(_CONFIG).get("definitions", "config"))
    wanted = [folder] if folder else list(_FOLDERS)
    for one in wanted:
        if one in _FOLDERS and (definitions / one / f"{own}.yaml").is_file():
            return one, own
    there = sorted(file.stem for one in ("scenes", "objects") for file in (definitions / one).glob("*.yaml"))
    raise InputError(definitions, "", f"no scene or object {name!r}", f"one of: {', '.join(there)}; or a result's file")


def result(path: Path) -> Path:
    """Return the path of a result after checking that the file exists.

    Raises
    ------
    InputError
        If it does not exist yet.
    """
    if not path.is_file():
        raise InputError(
            path, "", "no file", f"what 'snakemake --cores 2 {path}' makes, with its scene under make.scenes"
        )
    return path


def _item(name: str, placement: Placement, material: Material, file: Path | None) -> Item:
    covered = placement.shape.is_covered(*material.alpha.shape[::-1])
    if not (material.observed & covered).any():
        raise InputError(file, "", "no texel on the surface with data", "a material that photographs determine")
    whole, _ = material.filled(covered)
    sha256 = "" if file is None else file_sha256(file)
    return Item(name, placement, whole, material.observed & covered, "" if file is None else str(file), sha256)


def find(name: str) -> Source:
    """Load a scene, an object or an environment by name, with its results, from the project in the working directory.

    Raises
    ------
    InputError
        If the name is unknown, its definition is faulty, a result does not exist yet, no texel of an object has data,
        or a material of a scene reflects more light than it receives.
    """
    folder, own = kind_of(name)
    if folder == "environments":
        return Source(own, _FOLDERS[folder], [], None, result(Path(f"results/environments/{own}.h5")))
    if folder == "objects":
        shape = Shape.from_definition(load_one("objects", own).objects[own].shape)
        file = result(Path(f"results/{own}/material.h5"))
        return Source(own, _FOLDERS[folder], [_item(own, Placement(shape), Material.load(file), file)])
    loaded = load_definitions(read_yaml(_CONFIG) | {"make": {"scenes": [own]}}, Path())
    scene = loaded.scenes[own]
    files = [result(Path(f"results/{name}/material.h5")) for name in materials_of(scene)]
    shapes = [Shape.from_definition(loaded.objects[item.object].shape) for item in scene.objects]
    shapes, materials = with_bodies(scene, shapes, load_materials(scene, shapes, files))
    names = [item.object for item in scene.objects] + [f"body-{i + 1}" for i in range(len(scene.bodies))]
    known: list[Path | None] = [*files[: len(scene.objects)], *([None] * len(scene.bodies))]
    parts = zip(names, make_placements(scene, shapes), materials, known, strict=True)
    items = [_item(*part) for part in parts]
    return Source(own, _FOLDERS[folder], items, scene, result(Path(f"results/environments/{scene.environment}.h5")))
