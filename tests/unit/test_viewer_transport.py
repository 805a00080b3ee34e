"""Pages in a browser, case by case: views of every kind, soft shadows of meshes, lamps nearby, lobes, coloured metals.

What the integrator `interactive` has is compared with `render_frame`; what the page alone has, with its formula.
"""

import json

import numpy as np
import pytest
from pages import PLATE, SPHERE, gold, painted, room, sources, write_torus
from written_pages import SIZE, Written, agree, compared, inside

from irodori.rendering.scene_arrays import make_view
from irodori.viewer.browser import browser_command, opened

pytestmark = pytest.mark.skipif(
    browser_command() is None, reason="NO BROWSER: pages are not tested; install Debian's package chromium"
)


# ---- views


def view_of(kind="perspective", position=(30.0, -190.0, 120.0), up=(0.0, 0.0, 1.0), **keys) -> dict:
    size = {"field_of_view_deg": 36.0} if kind == "perspective" else {"height_mm": 110.0}
    return {"kind": kind, "position_mm": list(position), "target_mm": [0.0, 0.0, 10.0], "up": list(up), **size, **keys}


VIEWS = {
    "front": view_of(),
    "leaning": view_of(up=(0.5, 0.2, 1.0)),
    "lying": view_of(up=(1.0, 0.1, 0.0)),
    "upside down": view_of(up=(0.0, 0.1, -1.0)),
    "straight down": view_of(position=(0.0, 0.0, 260.0), up=(0.3, 1.0, 0.0)),
    "from below": view_of(position=(-20.0, -150.0, -20.0)),
    "parallel": view_of("orthographic"),
    "parallel, leaning": view_of("orthographic", up=(-0.4, 0.0, 1.0), height_mm=70.0),
    "parallel, straight down": view_of("orthographic", position=(0.0, 0.0, 90.0), up=(0.0, 1.0, 0.0)),
}


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    written = Written(folder, sources(folder / "files", room(), views=VIEWS))
    with opened(written.path) as page:
        yield written, page
        assert page.messages == []


@pytest.mark.parametrize("name", VIEWS)
def test_a_view_of_any_kind_is_the_renderers(seen, name):
    written, page = seen
    state = page.default_state()
    state["camera"] = {view["name"]: view["camera"] for view in written.data.header["views"]}[name]
    found = compared(written, page, state, make_view(written.sources.scene.views[name], SIZE))
    assert agree(found), (name, found.mean(), np.percentile(found, 99))


@pytest.mark.parametrize("name", VIEWS)
def test_a_point_that_is_seen_is_marked_where_it_is_seen(seen, name):
    written, page = seen
    state = page.default_state()
    state["camera"] = {view["name"]: view["camera"] for view in written.data.header["views"]}[name]
    back = page.page.evaluate(
        """([state, places]) => { const {width, height} = Irodori.renderer.canvas; return places.map(([x, y]) => {
          const found = Irodori.renderer.probe(state, x * width, y * height);
          return found && Irodori.project(state.camera, found.position_mm, width, height)
            .slice(0, 2).map((at, i) => at - 0.5 - Math.floor([x * width, y * height][i]));
        }); }""",
        [state, [[0.5, 0.5], [0.4, 0.55], [0.62, 0.41]]],
    )
    assert [one for one in back if one is not None]
    assert np.abs([one for one in back if one is not None]).max() < 0.01


# ---- soft shadows of meshes


def with_torus(folder, **keys):
    """A torus that stands on a plate beside a ball: each hides light from the others, and the torus from itself."""
    file = write_torus(folder / "torus.obj")
    ball = {"shape": SPHERE, "position_mm": [30.0, -22.0, 20.1],
            "material": {"spectrum": "TCS71", "beta": 0.0, "mu_rad": 0.2, "mirror": 0.0, "refractive_index": {"n": 1.5, "k": 0.0}}}
    return sources(folder, room(), ball={"kind": "mesh", "file": str(file), "unit": "mm"},
                   objects=[{"object": "torus", "position_mm": [-16.0, 4.0, 26.0], "rotation_deg": [65.0, 0.0, 20.0],
                             "scale": 1.0},
                            {"object": "plate", "position_mm": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 12.0],
                             "scale": 1.0}], bodies=[ball], **keys)  # fmt: skip


@pytest.fixture(scope="module")
def torus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("torus")
    return Written(folder, with_torus(folder))


def test_meshes_hide_light_from_all_sides_as_in_the_renderer(torus, tmp_path):
    with opened(torus.path) as page:
        found = compared(torus, page, page.default_state(), torus.view)
        moved = page.default_state()
        moved["objects"][0]["position_mm"][0] += 1.0
        held = page.page.evaluate(
            "(all) => all.map((s) => Irodori.shadowed(Irodori.renderer.data.header, s))", [page.default_state(), moved]
        )
        assert page.messages == []
    assert agree(found), (found.mean(), np.percentile(found, 99))
    # The places of the nodes are those of the scene: shadows are left out where a mesh stands elsewhere.
    assert held == [0b111, 0]
    wrong = tmp_path / "page.html"
    assert torus.text.count("header.objects.reduce((bits, o, i) => ") == 1
    text = torus.text.replace("header.objects.reduce((bits, o, i) => ", "0 * header.objects.reduce((bits, o, i) => ")
    wrong.write_text(text, encoding="utf-8")
    with opened(wrong) as page:
        assert not agree(compared(torus, page, page.default_state(), torus.view))
