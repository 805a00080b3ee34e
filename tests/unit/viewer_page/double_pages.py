"""The classroom page around a stand-in of the renderer, for tests of what people do with it."""

import base64
import json
from pathlib import Path

import pytest

import irodori.viewer
from irodori.config.models import Scene
from irodori.spectra.published import light
from irodori.viewer.lesson import lesson_for_page
from irodori.viewer.page_file import page_html

PAGE = Path(irodori.viewer.__file__).parent / "page"
DOUBLE = Path(__file__).with_name("renderer_double.js")
OBJECTS = [
    {"name": "tile-plate", "position_mm": [0.0, 0.0, 0.0], "radius_mm": 12, "colour": [240, 240, 240]},
    {"name": "vermilion-sphere", "position_mm": [-52.0, 8.0, 30.1], "radius_mm": 30, "colour": [214, 80, 50]},
    {"name": "indigo-sphere", "position_mm": [10.0, 42.0, 30.1], "radius_mm": 30, "colour": [50, 90, 190]},
    {"name": "leaf-sphere", "position_mm": [46.0, -34.0, 30.1], "radius_mm": 30, "colour": [80, 140, 60]},
]


def header_of(scene: Scene) -> dict:
    names = ("D65", "D50", "A", "E", "FL2", "FL11", "LED-B3", "LED-B5")
    pair = {"mean": 0.04, "p99": 0.21}
    return {
        "schema_version": 2,
        "scene": "still-life",
        "title": "Still life",
        "description": scene.description,
        "objects": [{"texels": [16, 16], **one} for one in OBJECTS],
        "sides": [],
        "displays": [{"name": name} for name in ("sRGB", "Display P3")],
        "environments": ["classroom"],
        "lamps": [],
        "most_uncertainty": 0.08,
        "illuminants": [{"name": name, "label": name, "power": list(light(name))} for name in names],
        "observers": [{"name": name, "label": name} for name in ("CIE 1931 2°", "CIE 1964 10°")],
        "views": [{"name": "front", "camera": {"target_mm": [0, 0, 22], "azimuth_deg": -90, "elevation_deg": 27,
                                               "distance_mm": 370, "fov_deg": 34, "roll_deg": 0, "height_mm": 0}}],
        "stated_errors": {"data_loss": pair, "cpu": pair, "reference": None},
        "hashes": {"scene": "0123abcd"},
        "made": "2026-11-22",
        "lesson": lesson_for_page(scene.lesson),
    }  # fmt: skip


def write_double(path: Path, header: dict, poster: Path | None = None) -> Path:
    """Write the page of a scene with the double in the renderer's place."""
    double, app = (file.read_text(encoding="utf-8") for file in (DOUBLE, PAGE / "app.js"))
    payload = base64.b64encode(json.dumps(header).encode()).decode("ascii")
    whole = page_html(header["title"], payload, poster)
    assert app in whole
    path.write_text(whole.replace(app, double + app), encoding="utf-8")
    return path


def close(a, b) -> bool:
    """Whether two plain values agree, numbers as far as an address keeps them."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(close(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(close(*pair) for pair in zip(a, b, strict=True))
    # A whole number of the page comes as an int.
    is_number = isinstance(a, int | float) and not isinstance(a, bool)
    return a == pytest.approx(b, rel=1e-5, abs=1e-9) if is_number else a == b
