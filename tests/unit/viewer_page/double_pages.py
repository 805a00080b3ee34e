"""The classroom page around a stand-in of the renderer, for tests of what people do with it."""

import base64
import json
from pathlib import Path

import jinja2

import irodori.viewer
from irodori.config.models import Scene
from irodori.spectra.published import light
from irodori.viewer.lesson import lesson_for_page

PAGE = Path(irodori.viewer.__file__).parent / "page"
SCRIPTS = ("text.js", "state.js", "png.js", "plot.js", "lesson.js", "view.js", "controls.js", "app.js")
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
OBJECTS = [
    {"name": "tile-plate", "position_mm": [0.0, 0.0, 0.0], "radius_mm": 12, "colour": [240, 240, 240]},
    {"name": "vermilion-sphere", "position_mm": [-52.0, 8.0, 30.1], "radius_mm": 30, "colour": [214, 80, 50]},
    {"name": "indigo-sphere", "position_mm": [10.0, 42.0, 30.1], "radius_mm": 30, "colour": [50, 90, 190]},
    {"name": "leaf-sphere", "position_mm": [46.0, -34.0, 30.1], "radius_mm": 30, "colour": [80, 140, 60]},
]


def header_of(scene: Scene) -> dict:
    names = ("D65", "D50", "A", "E", "FL2", "FL11", "LED-B3")
    pair = {"mean": 0.04, "p99": 0.21}
    return {
        "schema_version": 1,
        "scene": "still-life",
        "title": "Still life",
        "description": scene.description,
        "objects": OBJECTS,
        "environments": ["classroom"],
        "illuminants": [{"name": name, "label": name, "power": list(light(name))} for name in names],
        "observers": [{"name": name, "label": name} for name in ("CIE 1931 2°", "CIE 1964 10°")],
        "views": [{"name": "front", "camera": {"target_mm": [0, 0, 22], "azimuth_deg": -90, "elevation_deg": 27,
                                               "distance_mm": 370, "fov_deg": 34}}],
        "stated_errors": {"data_loss": pair, "cpu": pair, "browser": "Chromium"},
        "hashes": {"scene": "0123abcd"},
        "made": "2026-11-22",
        "lesson": lesson_for_page(scene.lesson),
    }  # fmt: skip


def write_page(path: Path, header: dict, poster: bytes = b"") -> Path:
    """Write the page with the double in the renderer's place."""
    double = Path(__file__).with_name("renderer_double.js").read_text(encoding="utf-8")
    languages = {
        file.stem: json.loads(file.read_text(encoding="utf-8")) for file in sorted(PAGE.glob("languages/*.json"))
    }
    environment = jinja2.Environment(autoescape=True, loader=jinja2.FileSystemLoader(PAGE))
    text = environment.get_template("page.html").render(
        title=header["title"],
        policy=POLICY,
        style=(PAGE / "style.css").read_text(encoding="utf-8"),
        scripts=[double, *((PAGE / name).read_text(encoding="utf-8") for name in SCRIPTS)],
        languages=json.dumps(languages, ensure_ascii=False).replace("</", "<\\/"),
        payload=base64.b64encode(json.dumps(header).encode()).decode("ascii"),
        poster="data:image/png;base64," + base64.b64encode(poster).decode("ascii") if poster else "",
    )
    path.write_text(text, encoding="utf-8")
    return path
