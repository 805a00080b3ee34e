"""Small sources of exports, and the tools that open what was exported."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import patience
import pytest
from lathe import LID_MM, lathe
from made import made
from scenes import material

from irodori.config.models import BodyShape, ObjectShape, Scene
from irodori.export.export_sources import Item, Source
from irodori.geometry.mesh import make_mesh
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.rendering.scene_arrays import make_placements
from irodori.spectra.published import spectrum

TOOLS = Path(__file__).resolve().parents[1] / "exports"
FLAT = [{"kind": "plate", "width_mm": 40.0, "height_mm": 24.0}, {"kind": "disc", "radius_mm": 15.0}]
BLOCKS = {one["kind"]: one for one in [*FLAT, {"kind": "sphere", "radius_mm": 20.0}, {"kind": "plane"}]}


def shape(kind: str) -> Shape:
    if kind == "mesh":
        return TriangleMesh(make_mesh(*lathe(LID_MM, 24, 1 / 64)))
    return Shape.from_definition(made(ObjectShape | BodyShape, BLOCKS[kind]))


def painted(rows=8, columns=16, **properties):
    """A material of two paints in checks, with gradients of gloss."""
    one = material(**properties)
    y, x = np.mgrid[:rows, :columns]
    which = ((x // 4 + y // 4) % 2).astype(np.float32)
    basis = np.stack([spectrum("TCS10"), spectrum("TCS44")], axis=1)
    coefficients = np.stack([1.0 - which, which], axis=-1)
    ones = np.ones((rows, columns))
    gloss = [(beta[0, 0] * ones, mu[0, 0] * (0.9 + 0.2 * (x // 4) / 3)) for _, beta, mu in one.gloss]
    own = replace(one, alpha=0.5 * ones, green_response=0.5 * ones, coefficients=coefficients, basis=basis)
    return own.with_gloss(gloss)


def item(kind: str, own, place=(0.0, 0.0, 0.0), turn=None) -> Item:
    where = Placement(shape(kind), np.eye(3) if turn is None else turn, np.asarray(place, float))
    covered = where.shape.is_covered(*own.alpha.shape[::-1])
    return Item(kind, where, own.filled(covered)[0], own.observed & covered, "", "")


def alone(kind: str, own) -> Source:
    """The source of an export of one object."""
    return Source(kind, "object", [item(kind, own)])


def scene_of(things, views, environment: Path, lights=(), size=(24, 18)) -> Source:
    """The source of a scene: things are (kind, material, position, rotation in degrees)."""
    placed = [{"object": kind, "position_mm": list(place), "rotation_deg": list(turn), "scale": 1.0}
              for kind, _, place, turn in things]  # fmt: skip
    scene = made(Scene, {
        "image": {"width": size[0], "height": size[1]}, "objects": placed, "views": views, "lights": list(lights),
    })  # fmt: skip
    placements = make_placements(scene, [shape(kind) for kind, *_ in things])
    items = []
    for (kind, own, *_), where in zip(things, placements, strict=True):
        covered = where.shape.is_covered(*own.alpha.shape[::-1])
        items.append(Item(kind, where, own.filled(covered)[0], own.observed & covered, "", ""))
    return Source("stage", "scene", items, scene, environment)


def validated(path) -> dict:
    """Return what the Khronos validator says of a glTF file."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed: nothing validates glTF")
    if not (TOOLS / "node_modules/gltf-validator").is_dir():
        pytest.skip("gltf-validator is not installed: npm ci --prefix tests/exports")
    command = ["node", str(TOOLS / "validate.mjs"), str(path)]
    run = patience.run(command)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)
