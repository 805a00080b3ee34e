"""Shapes behind one interface: nobody compares their kinds, and one from outside the package works everywhere."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import pixel_rays, sky, smooth_light
from tube import Tube

from irodori.geometry import shape_registry
from irodori.geometry.shape_blocks import is_flat, variants
from irodori.geometry.shapes.shape import Kernels
from irodori.light.irradiance import irradiance_at

ROOT = Path(__file__).resolve().parents[2]
SHAPES = {shape.name: shape for shape in shape_registry.shapes()}
CLASSES = {shape.__name__ for shape in SHAPES.values()}
CONSTANTS = {"PLATE", "SPHERE", "MESH", "DISC", "PLANE"}


# --- nobody compares kinds -------------------------------------------------------------------------------------------


def comparisons_of_shapes(source: str) -> list[str]:
    """Return the pieces of Python that ask what kind a shape is."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Compare, ast.MatchValue)):
            inner = [*ast.walk(node)]
            names = {n.id for n in inner if isinstance(n, ast.Name)} | {
                n.attr for n in inner if isinstance(n, ast.Attribute)
            }
            words = {n.value for n in inner if isinstance(n, ast.Constant) and isinstance(n.value, str)}
            if names & (CONSTANTS | CLASSES | {"number_of"}) or words & {*SHAPES}:
                found.append(ast.unparse(node))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("isinstance", "issubclass"):
            asked = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)} & CLASSES
            found += [ast.unparse(node)] * bool(asked)
    return found


@pytest.mark.parametrize(
    "source",
    [
        'if definition["shape"]["kind"] == "plate": pass', "round_ = kind == float(SPHERE)", "x = shape.kind != MESH",
        "flat = shape.kind in (shapes.DISC, PLANE)", "y = isinstance(p.shape, (Plate, Disc))", "z = type(s) is Sphere",
        'match block["kind"]:\n    case "mesh": pass',
    ],
)  # fmt: skip
def test_comparisons_of_kinds_are_found(source):
    assert comparisons_of_shapes(source)


def test_no_module_outside_the_shapes_compares_their_kinds():
    own = ROOT / "irodori/geometry/shapes"
    files = [f for folder in ("irodori", "workflow", "calibrate") for f in sorted((ROOT / folder).rglob("*.py"))]
    assert len(files) > 200
    for file in files:
        if own not in file.parents:
            assert comparisons_of_shapes(file.read_text(encoding="utf-8")) == [], file
    for file in sorted((ROOT / "workflow").rglob("*.smk")):
        text = file.read_text(encoding="utf-8")
        assert not re.search(rf"""(==|!=|\bin)\s*[("'\[]*({"|".join(SHAPES)})["']""", text), file


# --- the registry ----------------------------------------------------------------------------------------------------


def test_configuration_has_the_variants_of_the_shapes_themselves():
    for of in ("object", "scene"):
        expected = [shape.schema[of] for shape in SHAPES.values() if of in shape.schema]
        found = {v["properties"]["kind"]["const"]: v for v in variants(of)}
        assert found == {v["properties"]["kind"]["const"]: v for v in expected}
    assert {name: is_flat(name) for name in SHAPES} == {name: shape.is_flat for name, shape in SHAPES.items()}
    with pytest.raises(ValueError, match=r"'torus'; accepted: .*plate"):
        is_flat("torus")


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_declares_everything_that_is_asked_of_it(name):
    shape = SHAPES[name]
    assert not shape.__abstractmethods__
    assert all(hasattr(shape, word) for word in shape.DECLARED)
    assert set(shape.schema) <= {"object", "scene"} and shape.schema
    assert all(v["properties"]["kind"]["const"] == name for v in shape.schema.values())
    # Lanes have both functions, or rays are brought to the shape one by one.
    assert (shape.kernels.point is None) == (shape.kernels.texture is None)
    assert shape.border in ("joined", "black", "unknown") and (shape.border == "joined") == shape.wraps


def test_a_shape_that_comes_after_the_loops_is_refused(monkeypatch):
    monkeypatch.setattr(shape_registry, "_settled", ["irodori.geometry.surfaces"])
    with pytest.raises(ValueError, match=r"'tube' comes too late: .*irodori\.geometry\.surfaces"):
        shape_registry.register(Tube)


def test_a_shape_is_registered_once_and_whole(monkeypatch):
    monkeypatch.setattr(shape_registry, "_settled", [])
    with pytest.raises(ValueError, match="'plate' is registered already"):
        shape_registry.register(SHAPES["plate"])

    class Silent(Tube):
        name = "silent"

    monkeypatch.delattr(Tube, "wraps")
    with pytest.raises(ValueError, match="'silent' leaves undeclared: wraps"):
        shape_registry.register(Silent)
    assert Silent not in shape_registry.shapes()


def test_the_kernels_that_loops_choose_among_are_those_of_the_interface():
    asked = set()
    for file in sorted((ROOT / "irodori").rglob("*.py")):
        asked |= set(re.findall(r'\b(?:lane_)?chain\("(\w+)"', file.read_text(encoding="utf-8")))
    assert asked == set(Kernels._fields)


# --- a shape from outside --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory) -> dict[str, dict]:
    """What `tube_everywhere` finds in a process in which the tube is registered; both integrators are compiled anew."""
    output, here = tmp_path_factory.mktemp("tube") / "found.npz", Path(__file__).parent
    parts = ["traced", "rectified", "reference", "interactive"]
    command = [sys.executable, "-W", "error", here / "tube_everywhere.py", output, *parts]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(here.parent), str(here)])}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    with np.load(output) as found:
        return {part: {key.split()[1]: found[key] for key in found if key.startswith(f"{part} ")} for part in parts}


@pytest.mark.heavy
def test_a_shape_from_outside_is_traced_exactly(everywhere):
    found = everywhere["traced"]
    assert [*found["variants"]] == ["plate", "sphere", "mesh", "tube"]
    hit = found["hit"] == 0
    assert 0.2 < hit.mean() < 0.9
    # On the cylinder's own equation, not on the triangles that Embree was given.
    assert np.hypot(*found["exact"][hit, :2].T) == pytest.approx(20.0, abs=1e-9)
    front = found["seen"] == 0
    local, uv = found["local"][front], found["uv"][front]
    assert front.mean() > 0.15 and np.hypot(*local[:, :2].T) == pytest.approx(20.0, abs=1e-4)
    assert found["normal"][front] == pytest.approx(np.column_stack([local[:, :2] / 20.0, 0 * uv[:, 0]]), abs=1e-5)
    assert uv[:, 1] == pytest.approx(0.5 - local[:, 2] / 60.0, abs=1e-6)
    assert np.exp(2j * np.pi * uv[:, 0]) == pytest.approx((local[:, 0] + 1j * local[:, 1]) / 20.0, abs=1e-5)


@pytest.mark.heavy
def test_a_shape_from_outside_is_rectified(everywhere):
    found = everywhere["rectified"]
    x, y = found["pixel"].T
    expected = np.stack([x / 512, y / 512, (3 * x - 2 * y) / 512], axis=1)
    seen = found["weight"][:, 0] > 0
    assert 0.15 < seen.mean() < 0.5
    off = found["response"][seen, 0].astype(np.float64) - expected[seen]
    rounding = 0.5 * np.spacing(np.abs(expected[seen]).astype(np.float16)).astype(np.float64)
    assert (np.abs(off) - rounding).max() <= 5e-3 / 512 and np.abs(off.mean(axis=0)).max() <= 0.03 / 512


@pytest.mark.heavy
@pytest.mark.parametrize(("integrator", "tolerance"), [("reference", 0.03), ("interactive", 0.004)])
def test_a_shape_from_outside_is_rendered(everywhere, integrator, tolerance):
    found = everywhere[integrator]
    ray = pixel_rays((0.0, -300.0, 0.0), (0.0, 0.0, 0.0), (32, 32), 8.0)
    a, b = np.sum(ray[..., :2] ** 2, axis=-1), -300.0 * ray[..., 1]
    with np.errstate(invalid="ignore"):
        distance = (-b - np.sqrt(b * b - a * (300.0**2 - 20.0**2))) / a
    normal = (np.array([0.0, -300.0, 0.0]) + distance[..., None] * ray) * [0.05, 0.05, 0.0]
    inner = np.abs(normal[..., 0]) < 0.9  # away from the outline, where a pixel sees the sky as well
    assert inner.sum() > 500
    light = sky(lambda towards: smooth_light(towards)[..., None])
    expected = 0.5 / np.pi * irradiance_at(light.irradiance, normal[inner])[:, 0]
    error = found["tube"][inner] / expected - 1.0
    assert abs(error.mean()) < 0.2 * tolerance and np.abs(error).max() < 4.0 * tolerance
    # Light maps blur the dark inside of the tube out through its wall, by less than two texels of the floor.
    leaks = np.abs(found["furnace"] - 1.0) > 0.02
    assert leaks.mean() < (0.01 if integrator == "interactive" else 1e-9)
    assert found["furnace"].mean() == pytest.approx(1.0, abs=0.002)
    if integrator == "reference":  # the texels in which paths end lie all over it, and nowhere else
        point, normal = np.moveaxis(found["texels"], 1, 0)
        assert len(point) > 500 and np.hypot(*point[:, :2].T) == pytest.approx(20.0, abs=0.01)
        assert normal == pytest.approx(point * [0.05, 0.05, 0.0], abs=1e-3)
        assert np.abs(point.mean(axis=0)).max() < 0.01 and 28.0 < np.abs(point[:, 2]).max() < 30.0
    # A black tube on a grey floor has a contact shadow, by paths and by light maps.
    shadow, alone = found["shadow"], found["alone"]
    floor = shadow > 1e-3
    assert 0.5 < floor.mean() < 0.95
    assert (shadow[floor] < 0.9 * alone[floor]).sum() > 10
