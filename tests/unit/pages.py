"""Small scenes for the tests of pages, written to files as the workflow does."""

from pathlib import Path

import numpy as np
from made import made
from scenes import GOLD_K, GOLD_N, THIRDS
from shortcuts import ball, irradiance_map

from irodori.config.models import ObjectShape, Scene
from irodori.core.store import Provenance
from irodori.light.environment_file import Environment, directions
from irodori.material.material_file import Material
from irodori.viewer.stage import SceneSources

_ROOM = (96, 48)


def room(sun: float = 40.0, level: float = 1.0) -> Environment:
    """A room of six coefficients: a floor, walls of two colours, a lamp."""
    width, height = _ROOM
    unit = directions(width, height)[0]
    x = np.linspace(-1.0, 1.0, 61)
    basis = np.linalg.qr(np.stack([2.0 + 0.0 * x, x, x**2, x**3, np.cos(9 * x), np.sin(7 * x)], axis=1))[0]
    basis *= np.sign(basis.sum(axis=0))[0]
    up = np.clip(unit[..., 2] + 0.3, 0.1, None)
    lamp = sun * np.exp(60.0 * (unit @ np.array([0.48, -0.6, 0.64]) - 1.0))
    first = level * (up + lamp)
    others = [0.2 * unit[..., 0], 0.15 * unit[..., 1], 0.1 * np.sin(3 * unit[..., 0]), 0.05 * unit[..., 2], 0.03 * up]
    coefficients = np.stack([first, *(first * part for part in others)], axis=-1).astype(np.float32)
    return Environment(coefficients, basis, irradiance_map(coefficients, 64, 32))


def painted(beta: float = 25.0, mirror: float = 1.0, n=1.5, k=0.0) -> Material:
    """A material of two paints in stripes whose gloss changes along the texture."""
    rows, columns = 12, 16
    x = np.linspace(0.0, 1.0, 61)
    basis = np.stack([0.1 + 0.6 * x, 0.5 - 0.4 * x + 0.2 * np.sin(8 * x)], axis=1)
    stripe = (np.arange(columns) // 4 % 2).astype(float)[None].repeat(rows, axis=0)
    one, along = np.ones((rows, columns)), np.linspace(0.0, 1.0, rows)[:, None].repeat(columns, axis=1)
    return Material(
        alpha=0.5 * one,
        beta=beta * (0.5 + along),
        mu=0.08 + 0.2 * along,
        green_response=0.5 * one,
        coefficients=np.stack([stripe, 1.0 - stripe], axis=-1).astype(np.float32),
        basis=basis,
        n=np.broadcast_to(np.asarray(n, float), 61).copy(),
        k=np.broadcast_to(np.asarray(k, float), 61).copy(),
        mirror=mirror,
        typical_gloss=(beta or 1.0, 0.15),
    )


def gold() -> Material:
    """A glossy mirror of gold."""
    return painted(beta=4.0, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS])


def write_mesh(path: Path, rings: int, segments: int) -> Path:
    """Write a ball of triangles as OBJ."""
    corners, uv = ball(20.0, rings, segments)
    numbers = np.repeat(np.arange(1, 3 * len(corners) + 1), 2)
    # A format for all lines at once: line by line, a hundred thousand triangles take a second.
    parts = (("v %.6f %.6f %.6f\n", corners, 3), ("vt %.6f %.6f\n", uv, 2), ("f %d/%d %d/%d %d/%d\n", numbers, 6))
    lines = [line * (values.size // count) % tuple(values.ravel().tolist()) for line, values, count in parts]
    path.write_text("".join(lines), encoding="utf-8")
    return path


def write_torus(path: Path, around: int = 48, across: int = 24, radius: float = 18.0, tube: float = 7.0) -> Path:
    """Write a torus of triangles about the z axis as OBJ."""
    u, v = np.meshgrid(np.arange(around + 1) / around, np.arange(across + 1) / across, indexing="ij")
    far = radius + tube * np.cos(2 * np.pi * v)
    x, y, z = far * np.cos(2 * np.pi * u), far * np.sin(2 * np.pi * u), tube * np.sin(2 * np.pi * v)
    lines = [f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in zip(x.ravel(), y.ravel(), z.ravel(), strict=True)]
    lines += [f"vt {a:.6f} {b:.6f}" for a, b in zip(u.ravel(), v.ravel(), strict=True)]
    number = np.arange(u.size).reshape(u.shape) + 1
    quads = zip(number[:-1, :-1].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel(), number[:-1, 1:].ravel(),
                strict=True)  # fmt: skip
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}\nf {a}/{a} {c}/{c} {d}/{d}" for a, b, c, d in quads]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def write_bent(path: Path, count: int = 8, side: float = 60.0) -> Path:
    """Write a square sheet of triangles that is bent about the y axis as OBJ."""
    v, u = np.meshgrid(np.arange(count + 1) / count, np.arange(count + 1) / count, indexing="ij")
    x, y = side * (u - 0.5), side * (v - 0.5)
    lines = [f"v {a:.6f} {b:.6f} {a * a / side:.6f}" for a, b in zip(x.ravel(), y.ravel(), strict=True)]
    lines += [f"vt {a:.6f} {b:.6f}" for a, b in zip(u.ravel(), v.ravel(), strict=True)]
    n = np.arange(u.size).reshape(u.shape) + 1
    corners = (n[:-1, :-1].ravel(), n[:-1, 1:].ravel(), n[1:, 1:].ravel(), n[1:, :-1].ravel())
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}\nf {a}/{a} {c}/{c} {d}/{d}" for a, b, c, d in zip(*corners, strict=True)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


SPHERE = {"kind": "sphere", "radius_mm": 20.0}
PLATE = {"kind": "plate", "width_mm": 110.0, "height_mm": 90.0}


def sources(
    folder: Path,
    environment: Environment,
    *,
    ball=SPHERE,
    first: Material | None = None,
    second: Material | None = None,
    further: tuple[Environment, ...] = (),
    light_maps=False,
    **keys,
) -> SceneSources:
    """A ball on a plate, written into a folder; further rooms are those that a lesson among the keys names.

    Without light maps, the page draws exactly what the renderer does.
    """
    folder.mkdir(parents=True, exist_ok=True)
    materials = [first or painted(), second or painted(beta=8.0, mirror=0.3)]
    files = []
    for number, material in enumerate(materials):
        files.append(folder / f"material-{number}.h5")
        material.save(files[-1], Provenance("test"))
    lights = [folder / f"light-{number}.h5" for number in range(1 + len(further))]
    for file, light in zip(lights, (environment, *further), strict=True):
        light.save(file, Provenance("test"))
    scene = {
        "description": "A ball & a plate",
        "environment": "room",
        "image": {"width": 64, "height": 48},
        "max_bounces": 3,
        "allow_energy_gain": True,  # gold mirrors under bright paint: what is tried is how they are drawn
        "integrator": {"kind": "interactive", "light_maps": light_maps},
        "display": {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}},
        "views": {"front": {"kind": "perspective", "position_mm": [30.0, -190.0, 120.0], "target_mm": [0.0, 0.0, 10.0],
                            "up": [0.0, 0.0, 1.0], "field_of_view_deg": 36.0}},
        "objects": [
            {"object": "ball", "position_mm": [-12.0, 4.0, 20.1], "rotation_deg": [50.0, 10.0, -20.0], "scale": 1.0},
            {"object": "plate", "position_mm": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 12.0], "scale": 1.0},
        ],
        "bodies": [],
        "lights": [],
        "photographs": {},
        "further_outputs": [],
        **keys,
    }  # fmt: skip
    shapes = tuple(made(ObjectShape, shape) for shape in (ball, PLATE))
    return SceneSources("test", made(Scene, scene), shapes, tuple(files), tuple(lights), 1e-3)
