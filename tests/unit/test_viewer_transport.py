"""Pages in a browser, case by case: views of every kind, light maps, lamps nearby, lobes, coloured metals.

What the integrator `interactive` has is compared with `render_frame`; what the page alone has, with its formula.
"""

import base64
import json
import math
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from made import made
from pages import SPHERE, gold, painted, room, sources, write_bent, write_mesh, write_torus
from scenes import constant_light, material
from shortcuts import irradiance_map
from written_pages import SIZE, Written, agree, compared, differences, inside, prepared

from irodori.colour.colorimetry import delta_e_xyz
from irodori.colour.display import make_display, srgb, standard_display
from irodori.colour.icc import Profile, write_profile
from irodori.colour.tone_curves import ParametricCurve
from irodori.config.models import CollimatedLight, PrimariesDisplay, ProfileDisplay
from irodori.geometry.rig_frame import rotation_xyz
from irodori.light.environment_file import Environment, directions
from irodori.material.material_file import Material
from irodori.rendering import light_transfer
from irodori.rendering.scene_arrays import make_view
from irodori.rendering.scene_lights import make_lights
from irodori.spectra.published import light, spectrum
from irodori.viewer import scene_data
from irodori.viewer.browser import browser_command, opened
from irodori.viewer.measured import frame_bands
from irodori.viewer.page_data import page_data
from irodori.viewer.page_file import page_html
from irodori.viewer.stage import white_of

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


LAMP = {"kind": "collimated", "azimuth_deg": -40.0, "elevation_deg": 50.0, "irradiance": 0.8, "spectrum": "FL11"}
#: A leaf whose back faces the front view; the lamp stands behind it.
LEAF = {
    "shape": {"kind": "disc", "radius_mm": 14.0},
    "position_mm": [26.0, -22.0, 16.0],
    "rotation_deg": [70.0, 0.0, 210.0],
    "material": {"spectrum": "TCS31", "beta": 1.0, "mu_rad": 0.2},
    "back": {"spectrum": "TCS56"},
    "transmittance": "TCS38",
}
BEHIND = LAMP | {"azimuth_deg": 120.0, "irradiance": 0.2}


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    written = Written(folder, sources(folder / "files", room(), views=VIEWS, bodies=[LEAF]))
    with opened(written.path) as page:
        yield written, page
        assert page.messages == []


@pytest.mark.default_cases(4)
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


# ---- screens


GAMMAS = (2.2, 2.0, 1.8)


@pytest.fixture(scope="module")
def profile(tmp_path_factory):
    """A profile of primaries like P3 under a white that is not D65, each channel with its own curve."""
    file = tmp_path_factory.mktemp("profile") / "screen.icc"
    colours = [xy_to_xyz(x, y) for x, y in ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), (0.32, 0.34))]
    level = np.linalg.solve(np.column_stack(colours[:3]), colours[3])
    matrix = np.column_stack(colours[:3]) * level
    file.write_bytes(write_profile(Profile("screen", matrix, tuple(ParametricCurve(gamma) for gamma in GAMMAS))))
    return file


def xy_to_xyz(x, y):
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


def drop(page, name, content):
    page.page.evaluate(
        "([name, text]) => { const held = new DataTransfer();"
        " held.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], name));"
        " document.dispatchEvent(new DragEvent('drop', {dataTransfer: held, bubbles: true, cancelable: true})); }",
        [name, base64.b64encode(content).decode()],
    )


CODES = """(state) => {
  const {canvas, gl} = Irodori.renderer, [width, height] = [96, 72], codes = new Uint8Array(4 * width * height);
  [canvas.width, canvas.height] = [width, height];
  Irodori.renderer.draw(state);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, codes);
  return [width, height, Array.from(codes)];
}"""


def codes_of(page, state):
    width, height, codes = page.page.evaluate(CODES, state)
    return np.array(codes, dtype=int).reshape(height, width, 4)[::-1, :, :3]


def wrong_codes(page, state, display) -> np.ndarray:
    """Steps of 8 bits between what the page shows and what pictures for the display hold."""
    codes = codes_of(page, state)
    xyz, objects = page.read_xyz(state, codes.shape[1], codes.shape[0])
    white = np.array(page.page.evaluate("Irodori.renderer.lit.whiteXYZ"))
    wanted, _ = display.encode(display.linear_rgb(xyz, white))
    return np.abs(codes - wanted.astype(int))[inside(objects)]


def test_a_dropped_profile_shows_colours_as_pictures_for_that_screen_do(seen, profile):
    _, page = seen
    state = page.default_state()
    given = make_display(made(ProfileDisplay, {"kind": "profile", "file": str(profile)}))
    drop(page, "screen.icc", profile.read_bytes())
    page.wait_for("Irodori.page().state.display.profile")
    state["display"] = page.page.evaluate("Irodori.page().state.display")
    found = wrong_codes(page, state, given)
    assert found.max() <= 2 and found.mean() < 0.3
    assert wrong_codes(page, page.default_state(), given).mean() > 3.0
    assert wrong_codes(page, page.default_state(), srgb()).max() <= 2
    # It stands in the page's address, so that the lesson's steps and a reload keep it.
    page.wait_for("Irodori.pace().atRest")
    read = """() => Irodori.hashToPage(location.hash.slice(1), Irodori.newPage(Irodori.renderer.defaultState()),
        Irodori.renderer.data.header).state.display.profile.label"""
    assert page.page.evaluate(read) == "screen.icc"


def test_measured_primaries_show_colours_as_pictures_for_that_screen_do(seen):
    _, page = seen
    state = page.default_state()
    primaries = {"red_xy": [0.63, 0.34], "green_xy": [0.3, 0.6], "blue_xy": [0.15, 0.07], "white_xy": [0.30, 0.32]}
    state["display"] = {"primaries": {**primaries, "gamma": 2.4}}
    device = {"kind": "primaries", **primaries, "tone": {"kind": "gamma", "gamma": 2.4}}
    found = wrong_codes(page, state, make_display(made(PrimariesDisplay, device)))
    assert found.max() <= 2 and found.mean() < 0.3


def test_display_p3_shows_colours_as_pictures_for_it_do(seen):
    _, page = seen
    state = page.default_state()
    state["display"] = {"name": "Display P3"}
    found = wrong_codes(page, state, standard_display("Display P3"))
    assert found.max() <= 2 and found.mean() < 0.3
    assert wrong_codes(page, state, srgb()).mean() > 1.0
    # The browser is told whose codes they are, and again when they are the usual ones.
    spaces = []
    for name in ("Display P3", "sRGB"):
        codes_of(page, {**state, "display": {"name": name}})
        spaces.append(page.page.evaluate("Irodori.renderer.gl.drawingBufferColorSpace"))
    assert spaces == ["display-p3", "srgb"]


#: Machado, Oliveira and Fernandes (2009), table 1, severity 1.0: what dichromats see, on linear sRGB.
DICHROMATS = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


@pytest.mark.parametrize("kind", DICHROMATS)
def test_each_kind_of_colour_deficiency_is_shown_as_published(seen, kind):
    _, page = seen
    state = {**page.default_state(), "deficiency": kind}
    codes = codes_of(page, state)
    xyz, objects = page.read_xyz(state, codes.shape[1], codes.shape[0])
    white = np.array(page.page.evaluate("Irodori.renderer.lit.whiteXYZ"))
    wanted, _ = srgb().encode(srgb().linear_rgb(xyz, white) @ np.array(DICHROMATS[kind]).T)
    found = np.abs(codes - wanted.astype(int))[inside(objects)]
    # One step more than elsewhere: these matrices enlarge the rounding of the picture's half precision.
    assert found.max() <= 3 and found.mean() < 0.3
    assert wrong_codes(page, state, srgb()).mean() > 1.0


def test_other_profiles_are_refused_in_a_sentence(seen, profile):
    _, page = seen
    right = profile.read_bytes()
    before = page.page.evaluate("JSON.stringify(Irodori.page().state)")
    for content, said in (
        (right[:200], "no whole profile"),
        (right[:12] + b"prtr" + right[16:], "another device"),
        (right.replace(b"rTRC", b"A2B0", 1), "colour tables"),
        (right.replace(b"gXYZ", b"gXYy", 1), "no matrix"),
        (right.replace(b"para", b"mft9"), "tone curve"),
    ):
        drop(page, "other.icc", content)
        page.wait_for(f"document.getElementById('message').textContent.includes('{said}')")
        assert page.page.locator("#message").inner_text().count("accepted:") == 1
        assert page.page.evaluate("JSON.stringify(Irodori.page().state)") == before


def test_a_leaf_shows_its_back_and_what_passes_through(seen):
    """The page without either differs from the renderer; data of a point are those of the side that is seen."""
    written, page = seen
    state = page.default_state()
    assert agree(compared(written, page, state, written.view))
    places = np.argwhere(page.read_xyz(state, 64, 48)[1] == 3)
    row, column = places[len(places) // 2]
    probe = """([state, x, y]) => { const {width, height} = Irodori.renderer.canvas;
               const {object, reflectance} = Irodori.renderer.probe(state, x * width, y * height);
               return [object, Array.from(reflectance)]; }"""
    name, reflectance = page.page.evaluate(probe, [state, (column + 0.5) / 64, (row + 0.5) / 48])
    assert name == "bodies[0]"
    np.testing.assert_allclose(reflectance, spectrum("TCS56"), atol=2e-3)
    for place in ("objects[2].behind", "sides[0].through"):
        given = f"(row) => {{ Irodori.renderer.data.header.{place} = row; }}"
        row = page.page.evaluate(f"Irodori.renderer.data.header.{place}")
        page.page.evaluate(given, None)
        assert not agree(compared(written, page, state, written.view))
        page.page.evaluate(given, row)
    # A lamp behind it.
    lights = make_lights([made(CollimatedLight, BEHIND)], 0)[0]
    towards, spectra = lights.rotation[:, :, 2], lights.spectrum[:, :61].astype(float)
    parts = replace(written.data.parts, lamps=spectra, directions=towards)
    state["light"]["lamps"] = [{"position_mm": list(1e3 * towards[0]), "size_mm": 0.0, "far": True, "strength": 0.2,
                                "illuminant": {"power": list(light("FL11"))}, "on": True}]  # fmt: skip
    matrix = np.array(written.data.header["observers"][0]["xyz"]).T
    matrix = matrix * (100.0 / (matrix[1] @ white_of(parts)))
    wanted = frame_bands(prepared(parts), written.view, parts) @ matrix.T
    assert agree(differences(wanted, matrix @ white_of(parts), *page.read_xyz(state, 64, 48)))


# ---- light maps


@contextmanager
def coarse_maps():
    """Give light maps a quarter of the page's texels, and of the renderer's as many as it begins with.

    They still differ by a third of what `near` allows in the mean, and at most by four fifths at the 99th percentile.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_data, "MOST_TEXELS", 1 << 8)
        patch.setattr(light_transfer, "MOST_ERROR", math.inf)
        yield


@pytest.fixture
def few_texels():
    with coarse_maps():
        yield


def with_torus(folder, **keys):
    """A torus that stands on a plate beside a ball: each hides light from the others, and the torus from itself."""
    file = write_torus(folder / "torus.obj", 24, 12)
    ball = {
        "shape": SPHERE,
        "position_mm": [30.0, -22.0, 20.1],
        "material": {
            "spectrum": "TCS71",
            "beta": 0.0,
            "mu_rad": 0.2,
            "mirror": 0.0,
            "refractive_index": {"n": 1.5, "k": 0.0},
        },
    }
    return sources(folder, room(), ball={"kind": "mesh", "file": str(file), "unit": "mm"}, light_maps=True,
                   objects=[{"object": "torus", "position_mm": [-16.0, 4.0, 26.0], "rotation_deg": [65.0, 0.0, 20.0],
                             "scale": 1.0},
                            {"object": "plate", "position_mm": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 12.0],
                             "scale": 1.0}], bodies=[ball], **keys)  # fmt: skip


@pytest.fixture(scope="module")
def torus(tmp_path_factory):
    """The torus with dull surfaces under a lamp: what is seen is the light on them, and what they send each other."""
    folder = tmp_path_factory.mktemp("torus")
    dull = [painted(beta=0.0, mirror=0.0) for _ in range(2)]
    with coarse_maps():
        return Written(folder, with_torus(folder, first=dull[0], second=dull[1], lights=[LAMP]))


def near(found, p99=4.0) -> bool:
    """Whether a page's light maps, which have fewer texels, show what the renderer's do."""
    return bool(found.mean() <= 0.6 and np.percentile(found, 99) <= p99)


STANDS = {"position_mm": [-4.0, -8.0, 28.0], "turn_deg": [80.0, 10.0, 50.0]}


def under(written, turn_deg: float, stands=None) -> tuple[np.ndarray, np.ndarray]:
    """Return XYZ of the renderer with its own light maps, and of the white: turned, or the first object elsewhere."""
    parts = written.data.parts
    if stands:
        own = replace(parts.placements[0], rotation=rotation_xyz(stands["turn_deg"]),
                      translation_mm=np.array(stands["position_mm"]))  # fmt: skip
        parts = replace(parts, placements=[own, *parts.placements[1:]])
    return written.wanted(frame_bands(prepared(parts), written.view, parts, turn_deg))


@pytest.mark.usefixtures("few_texels")
@pytest.mark.heavy
def test_the_light_on_objects_is_the_renderers_also_where_a_mesh_is_moved_and_the_room_turned(torus):
    """The page says meanwhile that it looks for the light, and shows none of the place before."""
    with opened(torus.path) as page:
        page.wait_for("Irodori.page")
        first, found = page.default_state(), {}
        for turn, stands in ((0.0, None), (110.0, None), (0.0, STANDS)):
            state = json.loads(json.dumps(first))
            state["light"]["turn_deg"] = turn
            state["objects"][0] |= stands or {}
            wanted, white = under(torus, turn, stands)
            if stands:
                draw = "(s) => Array.from(Irodori.renderer.readXYZ(s, 64, 48))"
                at_once = np.reshape(page.page.evaluate(draw, state), (48, 64, 4))
                given = "(s) => { location.hash = Irodori.pageToHash({...Irodori.page(), state: s}, Irodori.page()); }"
                page.page.evaluate(given, state)
                page.wait_for("!document.getElementById('updating').hidden")
                assert "updated" in page.page.locator("#live").inner_text()
                page.wait_for("document.getElementById('updating').hidden")
                assert "updated" not in page.page.locator("#live").inner_text()
            xyz, objects = page.read_xyz(state, 64, 48)
            found[turn, bool(stands)] = differences(wanted, white, xyz, objects)
            if stands:
                bare = at_once[..., :3]
        page.page.evaluate("() => { Irodori.renderer.bakedFor = () => null; }")
        unshaded, objects = page.read_xyz(state, 64, 48)
        assert page.messages == []
    assert all(near(one) for one in found.values()), {k: (f.mean(), np.percentile(f, 99)) for k, f in found.items()}
    # Until light is found for the new place, the mesh has that of the sky alone.
    np.testing.assert_array_equal(bare, unshaded[..., :3])
    assert differences(wanted, white, unshaded, objects).mean() > 4.0 * found[0.0, True].mean()


@pytest.mark.usefixtures("few_texels")
def test_white_objects_vanish_in_an_even_room(tmp_path):
    """A white furnace: what neighbours hide they send back or let through, on a page as anywhere."""
    white, sheet = material(1.0), Material.uniform(0.6, transmittance=0.4)
    places = [{"object": name, "position_mm": [0.0, 0.0, z], "rotation_deg": [0.0] * 3, "scale": 1.0}
              for name, z in (("ball", 25.0), ("plate", 0.0))]  # fmt: skip
    given = sources(tmp_path, constant_light(), first=white, second=sheet, light_maps=True, objects=places)
    path = tmp_path / "page.html"
    path.write_text(page_html("A page", page_data(given).payload({})), encoding="utf-8")
    with opened(path) as page:
        xyz, objects = page.read_xyz(page.default_state(), 64, 48)
        assert page.messages == []
    assert (objects >= 0).sum() > 500
    np.testing.assert_allclose(xyz[..., 1], 100.0, atol=3.0)
    assert xyz[objects >= 0][:, 1].mean() == pytest.approx(100.0, abs=0.5)


def test_an_object_that_is_hidden_throws_no_shadow(torus):
    with opened(torus.path) as page:
        state = page.default_state()
        for number in (0, 2):
            state["objects"][number]["visible"] = False
        found, objects = page.read_xyz(state, 64, 48)
        page.page.evaluate("() => { Irodori.renderer.bakedFor = () => null; }")
        plain, _ = page.read_xyz(state, 64, 48)
        assert page.messages == []
    assert (objects == 1).sum() > 300 and set(np.unique(objects)) == {-1, 1}
    np.testing.assert_allclose(found, plain, atol=2e-3 * plain.max())


# ---- lobes and metals


def of_ggx(material):
    """Return a material whose gloss is GGX, beside a component of no weight: scenes of two share one loop."""
    gloss = {"beta": 0.0 * material.beta, "further_gloss": ((material.beta, material.mu),)}
    return replace(material, **gloss, lobes=("gaussian", "ggx"), typical_gloss=2 * material.typical_gloss)


@pytest.mark.heavy
def test_ggx_shines_in_a_room_as_in_the_renderer(tmp_path):
    """Rows of blurred light of a lobe with long tails, beside those of the other lobe; and a lamp's highlight."""
    written = Written(tmp_path, sources(tmp_path / "files", room(), first=of_ggx(painted(beta=6.0)), lights=[LAMP]))
    assert [lobe["name"] for lobe in written.data.header["lobes"]] == ["gaussian", "ggx"]
    assert [entry["lobes"] for entry in written.data.header["objects"]] == [[1], [0]]
    with opened(written.path) as page:
        found = compared(written, page, page.default_state(), written.view)
        # Where each takes the other's rows, it is seen.
        page.page.evaluate(
            "() => { for (const o of Irodori.renderer.data.header.objects) o.lobes = [1 - o.lobes[0]]; }"
        )
        exchanged = compared(written, page, page.default_state(), written.view)
        assert page.messages == []
    assert agree(found), (found.mean(), np.percentile(found, 99))
    assert not agree(exchanged)


@pytest.mark.heavy
def test_the_weights_of_a_metals_wavelengths_follow_the_illuminant(tmp_path):
    written = Written(tmp_path, sources(tmp_path / "files", room(), first=gold()))
    assert written.data.header["quadrature"] is not None
    with opened(written.path) as page:
        for observer in (0, 1):
            for name in (None, "A", "D65", "FL2", "FL11", "LED-B3"):
                found = compared(written, page, page.default_state(), written.view, observer, name)
                assert agree(found), (observer, name, found.mean(), np.percentile(found, 99))
        page.page.evaluate(
            """() => { const own = Irodori.renderer.spectra, solved = own.channels.bind(own);
              own.channels = (c) => solved({...c, white: own.lights[c.number].white}); Irodori.renderer.lit = null; }"""
        )
        stale = compared(written, page, page.default_state(), written.view, 0, "FL11")
        assert page.messages == []
    assert not agree(stale)


# ---- lamps that stand nearby, which scenes do not have: their formulas, in double precision


def matte():
    found = painted(beta=0.0, mirror=0.0)
    return found.__class__(**{**found.__dict__, "coefficients": 0 * found.coefficients + np.float32([1.0, 0.0])})


@pytest.fixture(scope="module")
def dark(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dark")
    files = sources(folder / "files", room(level=0.0), first=matte(), second=matte(), lights=[LAMP])
    written = Written(folder, files)
    with opened(written.path) as page:
        yield written, page
        assert page.messages == []


def seen_points(view, objects) -> tuple[np.ndarray, np.ndarray]:
    """Return points and normals under the pixels: object 0 is the ball, 1 the plate in z = 0."""
    x, y = np.meshgrid((np.arange(64) - 31.5) / view.focal_px, (np.arange(48) - 23.5) / view.focal_px)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1) @ view.world_from_camera.T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    away = np.array([-12.0, 4.0, 20.1]) - view.position_mm
    along = ray @ away
    t = np.where(objects == 0, along - np.sqrt(np.maximum(400.0 - (away @ away - along**2), 0.0)),
                 -view.position_mm[2] / ray[..., 2])  # fmt: skip
    point = view.position_mm + t[..., None] * ray
    normal = np.where((objects == 0)[..., None], (point - [-12.0, 4.0, 20.1]) / 20.0, [0.0, 0.0, 1.0])
    return point, normal


def lit_share(point, normal, centre, radius, count=2048) -> tuple[np.ndarray, np.ndarray]:
    """Return the irradiance of a ball of light over that of a point, and the share of the ball that is seen.

    By directions spread evenly over the cone of the ball, past the ball of the scene and above the horizon.
    """
    to = centre - point
    far = np.linalg.norm(to, axis=-1, keepdims=True)
    axis = to / far
    least = np.sqrt(1.0 - (radius / far[..., 0]) ** 2)
    across = np.cross(axis, [0.3, 0.9, 0.1])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    other = np.cross(axis, across)
    total, free = np.zeros(point.shape[:-1]), np.zeros(point.shape[:-1])
    for i in range(count):
        cosine = 1.0 - (i + 0.5) / count * (1.0 - least)
        sine, turn = np.sqrt(1.0 - cosine**2), i * np.pi * (3.0 - np.sqrt(5.0))
        d = cosine[..., None] * axis
        d = d + sine[..., None] * (np.cos(turn) * across + np.sin(turn) * other)
        gap = np.array([-12.0, 4.0, 20.1]) - point
        along = (gap * d).sum(axis=-1)
        beside = (gap**2).sum(axis=-1) - along**2
        above = (normal * d).sum(axis=-1)
        open_ = (above > 0.0) & ~((along > 0.0) & (beside < 400.0) & ((gap**2).sum(axis=-1) > 400.001))
        total += open_ * above
        free += open_
    # The irradiance of the whole ball is that of its middle: the cone's solid angle times its radiance.
    return total / count * 2.0 / (1.0 + least), free / count


@pytest.mark.heavy
@pytest.mark.parametrize("size", [0.0, 60.0])
def test_a_lamp_nearby_lights_by_its_formula(dark, size):
    written, page = dark
    at = np.array([70.0, -60.0, 120.0])
    state = page.default_state()
    state["light"]["lamps"] = [{"position_mm": list(at), "size_mm": size, "strength": 0.7, "illuminant": {"name": "A"},
                                "on": True, "far": False}]  # fmt: skip
    xyz, objects = page.read_xyz(state, 64, 48)
    point, normal = seen_points(written.view, objects)
    seen = inside(objects) & (objects >= 0)
    share, free = np.zeros(seen.shape), np.zeros(seen.shape)
    share[seen], free[seen] = lit_share(point[seen], normal[seen], at, 0.5 * size or 1e-3, 4096 if size else 1)
    material = matte()
    reflectance = material.spectra()[0, 0] * material.spectrum_scale[0, 0]
    weights = np.array(written.data.header["observers"][0]["xyz"]).T
    power = np.array(next(e["power"] for e in written.data.header["illuminants"] if e["name"] == "A"))
    diffuse = 100.0 * (weights @ (power * reflectance)) / (weights[1] @ power)
    # White is a diffuser in the scene's middle that faces up.
    far = np.linalg.norm(at - point, axis=-1)
    white_share = at[2] / np.linalg.norm(at) ** 3
    wanted = diffuse * (share / far**2 / white_share)[..., None]
    white = 100.0 * (weights @ power) / (weights[1] @ power)
    lit, shut = seen & (free > 0.0), seen & (free == 0.0)
    # What is lit in part is the shadow's soft edge.
    assert lit.sum() > 400 and shut.sum() > 5 and (seen & (free > 0.0) & (free < 1.0)).sum() > (20 if size else -1)
    for some in (lit, lit & (free == 1.0)):
        found = delta_e_xyz(wanted[some], xyz[some], white)
        assert agree(found), (found.mean(), np.percentile(found, 99))
    assert np.abs(xyz[shut]).max() < 1e-6 * wanted[lit].max()


@pytest.mark.heavy
def test_a_balls_soft_shadow_is_that_of_many_lamps_of_the_renderer(tmp_path):
    """A ball so far away that the whole scene sees it in the same cone, which the renderer fills with lamps."""
    written = Written(tmp_path, sources(tmp_path / "files", room(level=0.0), lights=[LAMP]))
    towards, radius_rad, count = np.array([0.5, -0.45, 0.74]), 0.15, 1024
    towards /= np.linalg.norm(towards)
    across = np.cross(towards, [0.3, 0.9, 0.1])
    across /= np.linalg.norm(across)
    number = np.arange(count)
    cosine, turn = 1.0 - (number + 0.5) / count * (1.0 - np.cos(radius_rad)), number * np.pi * (3.0 - np.sqrt(5.0))
    sideways = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(towards, across)
    directions_ = cosine[:, None] * towards + np.sqrt(1.0 - cosine**2)[:, None] * sideways
    parts = replace(written.data.parts, lamps=np.tile(light("D65"), (count, 1)), directions=directions_)
    bands, white = frame_bands(prepared(parts), written.view, parts), white_of(parts)
    weights = np.array(written.data.header["observers"][0]["xyz"]).T
    matrix = weights * (100.0 / (weights[1] @ white))
    far = 1e5
    with opened(written.path) as page:
        state = page.default_state()
        state["light"]["lamps"] = [{"position_mm": list(far * towards), "size_mm": 2.0 * far * np.sin(radius_rad),
                                    "strength": 1e4, "illuminant": None, "on": True, "far": False}]  # fmt: skip
        xyz, objects = page.read_xyz(state, 64, 48)
        state["light"]["lamps"][0]["size_mm"] = 0.0
        hard, _ = page.read_xyz(state, 64, 48)
        assert page.messages == []
    seen = inside(objects) & (objects >= 0)
    found, other = (delta_e_xyz(bands[seen] @ matrix.T, one[seen], matrix @ white) for one in (xyz, hard))
    assert agree(found), (found.mean(), np.percentile(found, 99))
    assert not agree(other)


# ---- two rooms in one page


CELLAR = {"title": {"en": "Rooms"}, "steps": [{"title": {"en": "Below"}, "text": {"en": "Darker."},
                                              "light": {"environment": "cellar"}}]}  # fmt: skip


def cellar():
    """A room of other colours, of fewer vectors, and lit from elsewhere."""
    found = room(sun=5.0, level=0.2)
    return Environment(found.coefficients[:, ::-1, :3], found.basis[:, :3], found.irradiance[:, ::-1, :3])


@pytest.mark.heavy
def test_each_room_of_a_page_lights_as_in_the_renderer(tmp_path):
    files = sources(tmp_path / "files", room(), first=gold(), lesson=CELLAR, further=(cellar(),))
    written = Written(tmp_path, files)
    assert written.data.header["environments"] == ["room", "cellar"]
    with opened(written.path) as page:
        state = page.default_state()
        # There, back and there again: nothing of the room before is left.
        for name in ("room", "cellar", "room", "cellar"):
            state["light"] = {**state["light"], "environment": name}
            for illuminant in (None, "FL11"):
                found = compared(written, page, state, written.view, 0, illuminant)
                assert agree(found), (name, illuminant, found.mean(), np.percentile(found, 99))
        page.page.locator("#picture").focus()
        rooms = []
        for _ in range(2):
            page.page.keyboard.press("r")
            rooms.append(page.page.evaluate("Irodori.page().state.light.environment"))
        assert rooms == ["cellar", "room"]
        assert page.messages == []


@pytest.mark.usefixtures("few_texels")
@pytest.mark.heavy
def test_a_bent_leaf_over_a_golden_plate_is_the_renderers(tmp_path):
    """A mesh of two sides whose light maps carry light through, in a scene of a coloured mirror."""
    dull, golden = painted(beta=0.0, mirror=0.0), replace(gold(), beta=0.0 * gold().beta)
    leaf = replace(dull, through=replace(dull, coefficients=0.4 * dull.coefficients), transmittance="assumed")
    bent = {"kind": "mesh", "file": str(write_bent(tmp_path / "bent.obj")), "unit": "mm"}
    place = {"object": "leaf", "position_mm": [0.0, 0.0, 24.0], "rotation_deg": [150.0, 0.0, 20.0], "scale": 1.0}
    floor = {"object": "plate", "position_mm": [0.0, 0.0, 0.0], "rotation_deg": [0.0] * 3, "scale": 1.0}
    given = sources(tmp_path / "files", room(), ball=bent, first=leaf, second=golden, light_maps=True,
                    objects=[place, floor], lights=[BEHIND | {"spectrum": "D65"}])  # fmt: skip
    written = Written(tmp_path, given)
    with opened(written.path) as page:
        found = compared(written, page, page.default_state(), written.view)
        assert page.messages == []
    assert near(found), (found.mean(), np.percentile(found, 99))


@pytest.mark.usefixtures("few_texels")
@pytest.mark.heavy
def test_a_mesh_of_ggx_and_its_light_are_the_renderers_in_both_rooms_of_a_page(tmp_path):
    """What the heavy tests try one by one, all on one page: lobe, lamp, light maps, a second room."""
    files = with_torus(tmp_path, first=of_ggx(painted(beta=6.0)), lights=[LAMP], lesson=CELLAR, further=(cellar(),))
    written = Written(tmp_path, files)
    with opened(written.path) as page:
        state = page.default_state()
        for name in ("room", "cellar", "room"):
            state["light"] = {**state["light"], "environment": name}
            found = compared(written, page, state, written.view)
            # The renderer's gloss on a mesh sees no neighbours, the page's does.
            assert near(found, p99=7.0), (name, found.mean(), np.percentile(found, 99))
        assert page.messages == []


@pytest.mark.heavy
def test_a_page_of_two_rooms_and_a_mesh_is_at_most_ten_megabytes(tmp_path):
    """Rooms as fine as a page keeps them, with edges, a lamp and a photograph's grain; a mesh of 100,000 triangles."""
    height = 512
    unit = directions(2 * height, height)[0]
    grain = np.random.default_rng(1).normal(1.0, 0.01, unit.shape[:2])
    rooms = []
    for shift in (0.0, 1.0):
        coarse = room()
        waves = np.sin(9.0 * unit[..., 0] + shift) * np.sin(11.0 * unit[..., 1]) * np.sin(8.0 * unit[..., 2])
        wall = 1.0 + 0.6 * np.sign(waves)
        level = wall * (1.2 + unit[..., 2]) * grain
        level += 60.0 * np.exp(400.0 * (unit @ np.array([0.48, -0.6, 0.64]) - 1.0))
        parts = [0.2 * unit[..., 0], 0.15 * wall, 0.1 * np.sin(7 * unit[..., 0]), 0.05 * unit[..., 2], 0.03 * wall]
        coefficients = np.stack([level, *(level * part for part in parts)], axis=-1).astype(np.float32)
        rooms.append(Environment(coefficients, coarse.basis, irradiance_map(coefficients[::8, ::8], 64, 32)))
    file = write_mesh(tmp_path / "ball.obj", 224, 224)
    given = sources(tmp_path / "files", rooms[0], further=(rooms[1],), lesson=CELLAR,
                    ball={"kind": "mesh", "file": str(file), "unit": "mm"}, light_maps=True)  # fmt: skip
    data = page_data(given)
    assert sum(plane.shape[-1] for plane in data.planes.entries if plane.name.endswith("mesh/faces")) > 99_000
    assert [plane.shape[2] for plane in data.planes.entries if plane.name.endswith("/sky")] == [256, 256]
    size = len(page_html("A page", data.payload({})))
    assert 1e6 < size <= 10e6, size


# ---- coats


@pytest.mark.usefixtures("few_texels")
@pytest.mark.default_cases(1)
@pytest.mark.parametrize("light_maps", [True, False], ids=["light maps", "sky"])
def test_light_under_coats_is_the_renderers(tmp_path, light_maps):
    """Two coats of different indices under a lamp and a turned room, at a low angle; without coats the page errs."""
    materials, low = (painted(beta=1.0, mirror=0.0),) * 2, {"front": view_of(position=(30.0, -190.0, 40.0))}
    first, second = (replace(m, coat="coupled", n=np.full(61, n)) for m, n in zip(materials, (1.4, 1.9), strict=True))
    given = sources(tmp_path / "f", room(), first=first, second=second, lights=[LAMP], light_maps=light_maps, views=low)
    written, bounds = Written(tmp_path, given), near if light_maps else agree
    with opened(written.path) as page:
        state = page.default_state()
        state["light"]["turn_deg"] = 110.0
        wanted = under(written, 110.0)
        found = differences(*wanted, *page.read_xyz(state, 64, 48))
        page.page.evaluate("""() => { for (const o of Irodori.renderer.data.header.objects) o.coat = 0;
          Irodori.renderer.baked.clear(); if (Irodori.renderer.maps) Irodori.renderer.maps.transfers = {}; }""")
        bare = differences(*wanted, *page.read_xyz(state, 64, 48))
        assert page.messages == []
    assert bounds(found), (found.mean(), np.percentile(found, 99))
    assert bare.mean() > 4.0 * found.mean(), (found.mean(), bare.mean())
