"""Pages in a browser: what they draw is what `render_frame` renders, over lights, observers, poses and hard cases.

The browser is Debian's chromium with its renderer in software; without one all of this is skipped, and says so.
"""

import base64
import json
import zlib
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from pages import painted, room, sources, write_mesh
from scenes import fresnel
from written_pages import SIZE, Written, agree, differences, inside

import irodori.viewer
from irodori.core.custody import accept
from irodori.core.errors import InputError
from irodori.export.pictures import write_spectral_exr
from irodori.geometry.rig_frame import look_at, rotation_xyz
from irodori.rendering.scene_arrays import make_view
from irodori.spectra.grid import ERROR_NM, WAVELENGTH_NM
from irodori.viewer import viewer_command
from irodori.viewer.browser import FLAGS, browser_command, opened
from irodori.viewer.measured import frame_bands, prepared
from irodori.viewer.page_data import page_data
from irodori.viewer.page_file import page_html
from irodori.viewer.payload import read_payload
from irodori.viewer.stage import checks, export_viewer, finish_viewer
from irodori.viewer.viewer_command import payload_of

pytestmark = pytest.mark.skipif(
    browser_command() is None, reason="NO BROWSER: pages are not tested; install Debian's package chromium"
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    return Written(folder, sources(folder / "files", room()))


@pytest.fixture(scope="module")
def page(written):
    with opened(written.path) as found:
        yield found
        assert found.messages == []


@pytest.mark.heavy
@pytest.mark.parametrize("turn", [0.0, 110.0])
def test_every_light_and_observer_of_the_list_is_the_renderers(written, page, turn):
    bands = frame_bands(written.scene, written.view, written.data.parts, turn)
    state = page.default_state()
    state["light"]["turn_deg"] = turn
    assert_every_light_and_observer(written, page, state, bands)


def assert_every_light_and_observer(written, page, state, bands):
    """Compare a page's state with the renderer's radiance of it, under every illuminant and for every observer."""
    for observer, entry in enumerate(written.data.header["observers"]):
        for name in (None, *(light["name"] for light in written.data.header["illuminants"])):
            state["observer"] = entry["name"]
            state["light"]["illuminant"] = name and {"name": name}
            found = differences(*written.wanted(bands, observer, name), *page.read_xyz(state, 64, 48))
            assert agree(found), (entry["name"], name, found.mean(), np.percentile(found, 99))


def test_objects_and_camera_are_moved_as_the_scene_says(written, page):
    state = page.default_state()
    state["objects"][0] |= {"position_mm": [20.0, -15.0, 24.0], "turn_deg": [10.0, 80.0, 30.0]}
    state["camera"] |= {"target_mm": [4.0, -3.0, 8.0], "azimuth_deg": 20.0, "elevation_deg": 35.0, "distance_mm": 200.0,
                        "fov_deg": 30.0}  # fmt: skip
    parts = written.data.parts
    ball = parts.placements[0].__class__(
        parts.placements[0].shape, rotation_xyz((10.0, 80.0, 30.0)), np.array([20.0, -15.0, 24.0])
    )
    moved = parts.__class__(**{**parts.__dict__, "placements": [ball, *parts.placements[1:]]})
    az, el = np.radians([20.0, 35.0])
    target = np.array([4.0, -3.0, 8.0])
    eye = target + 200.0 * np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    view = written.view._replace(
        position_mm=eye,
        world_from_camera=np.ascontiguousarray(look_at(eye, target, (0.0, 0.0, 1.0))),
        focal_px=24.0 / np.tan(np.radians(15.0)),
    )
    scene = prepared(moved)
    state["light"]["turn_deg"] = 110.0
    bands = frame_bands(scene, view, moved, 110.0)
    assert_every_light_and_observer(written, page, state, bands)


def test_lines_of_the_pages_code_are_those_of_a_person():
    page = Path(irodori.viewer.__file__).parent / "page"
    for file in (*page.glob("*.js"), *page.glob("*.glsl"), *page.glob("*.css")):
        longest = max(map(len, file.read_text(encoding="utf-8").splitlines()))
        assert longest <= 120, f"{file.name}: {longest} characters"


def heavy(name: str):
    """Return a case that is left out unless asked for: pages take seconds each."""
    return pytest.param(name, marks=pytest.mark.heavy)


MUTATIONS = {
    "another basis": ("spectra.js", "light.basis.map((row) =>", "[...light.basis].reverse().map((row) =>"),
    "a flipped axis": ("transport.glsl", "uv = d.zx;", "uv = d.xz;"),
    "a wrong lobe row": ("transport.glsl", "* PARTS + part) * 17 + row", "* PARTS + part) * 17 + max(row - 2, 0)"),
}


@pytest.mark.parametrize(
    "name", ["a wrong lobe row", *(heavy(name) for name in MUTATIONS if name != "a wrong lobe row")]
)
def test_a_wrong_page_does_not_agree(written, tmp_path, name):
    _, right, wrong = MUTATIONS[name]
    assert written.text.count(json.dumps(right)[1:-1]) == 1
    path = tmp_path / "page.html"
    path.write_text(written.text.replace(json.dumps(right)[1:-1], json.dumps(wrong)[1:-1]), encoding="utf-8")
    bands = frame_bands(written.scene, written.view, written.data.parts)
    with opened(path) as page:
        found = differences(*written.wanted(bands), *page.read_xyz(page.default_state(), 64, 48))
    assert not agree(found)


def test_an_exchanged_illuminant_does_not_agree(written, page):
    bands = frame_bands(written.scene, written.view, written.data.parts)
    state = page.default_state()
    state["light"]["illuminant"] = {"name": "D50"}
    found = differences(*written.wanted(bands, 0, "D65"), *page.read_xyz(state, 64, 48))
    assert not agree(found)


def lamps(count: int) -> list[dict]:
    return [
        {"kind": "collimated", "azimuth_deg": 60.0 * i + 15.0, "elevation_deg": 25.0 + 9.0 * i,
         "irradiance": 0.5 + 0.2 * i, "spectrum": ("D65", "A", "FL11")[i % 3]}
        for i in range(count)
    ]  # fmt: skip


def hard_case(name: str, folder):
    if name == "a mesh of 100,000 triangles":
        file = write_mesh(folder / "ball.obj", 224, 224)
        return sources(folder, room(), ball={"kind": "mesh", "file": str(file), "unit": "mm"},
                       objects=[{"object": "ball", "position_mm": [-12.0, 4.0, 20.1], "rotation_deg": [0.0, 0.0, 0.0],
                                 "scale": 1.0},
                                {"object": "plate", "position_mm": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 12.0],
                                 "scale": 1.0}])  # fmt: skip
    if name == "six lamps":
        return sources(folder, room(), lights=lamps(6))
    if name == "no gloss":
        return sources(folder, room(), first=painted(beta=0.0, mirror=0.0))
    if name == "no sun":
        return sources(folder, room(sun=0.0))
    return sources(folder, room(level=0.0), lights=lamps(1))


HARD_CASES = ("a mesh of 100,000 triangles", "six lamps", "no gloss", "no sun", "one lamp alone")


@pytest.mark.heavy
@pytest.mark.parametrize("name", HARD_CASES)
def test_hard_cases_are_drawn_as_they_are_rendered(tmp_path, name):
    written = Written(tmp_path, hard_case(name, tmp_path))
    bands = frame_bands(written.scene, written.view, written.data.parts)
    with opened(written.path) as page:
        found = differences(*written.wanted(bands), *page.read_xyz(page.default_state(), 64, 48))
        assert page.messages == []
    assert agree(found), (name, found.mean(), np.percentile(found, 99))
    planes = read_payload(written.payload)[1]
    assert ("light/0/sky" in planes) == (name != "one lamp alone")
    assert ("object/0/power/0" in planes) == (name != "no gloss")


def test_the_page_reads_what_python_reads_and_damage_in_one_sentence(written, page):
    planes = read_payload(written.payload)[1]
    read = """async (text) => Object.entries((await Irodori.readPayload(text)).planes)
        .map(([n, p]) => [n, p.length, p.reduce((a, b) => a + b, 0)])"""
    for name, length, total in page.page.evaluate(read, written.payload):
        assert length == planes[name].size
        assert total == pytest.approx(float(planes[name].sum(dtype=np.float64)), rel=1e-4, abs=1e-2)
    rng = np.random.default_rng(1)
    raw = base64.b64decode(written.payload)
    broken = ["no payload!", "", base64.b64encode(zlib.compress(b"12345678", wbits=31)).decode()]
    for _ in range(20):
        damaged = bytearray(raw)
        damaged[rng.integers(len(raw))] ^= int(rng.integers(1, 256))
        broken += [base64.b64encode(bytes(damaged)).decode(), base64.b64encode(raw[: rng.integers(len(raw))]).decode()]
    said = page.page.evaluate(
        "async (all) => Promise.all(all.map((t) => Irodori.readPayload(t).then(() => '', (e) => e.message)))", broken
    )
    assert all(text.count("accepted:") == 1 for text in said), said


@pytest.mark.heavy
def test_a_lost_context_is_restored(written, tmp_path):
    with opened(written.path) as page:
        state = page.default_state()
        before, _ = page.read_xyz(state, 64, 48)
        page.page.evaluate(
            """() => new Promise((done) => {
              const renderer = Irodori.renderer, lose = renderer.gl.getExtension("WEBGL_lose_context");
              renderer.onrestored = done;
              renderer.onlost = () => setTimeout(() => lose.restoreContext(), 50);
              lose.loseContext();
            })"""
        )
        after, _ = page.read_xyz(state, 64, 48)
    np.testing.assert_array_equal(before, after)


def test_a_probe_tells_what_the_material_says(written, page):
    state = page.default_state()
    _, objects = page.read_xyz(state, 64, 48)
    size = page.page.evaluate("[Irodori.renderer.canvas.width, Irodori.renderer.canvas.height]")
    row, column = np.argwhere(objects == 0)[len(np.argwhere(objects == 0)) // 2]
    place = [(column + 0.5) * size[0] / 64, (row + 0.5) * size[1] / 48]
    found = page.page.evaluate("([s, x, y]) => Irodori.renderer.probe(s, x, y)", [state, *place])
    assert found["object"] == "ball" and found["status"] == "measured"
    material = painted()
    own = material.spectra()[tuple(found["texel"])] * material.spectrum_scale[tuple(found["texel"])]
    np.testing.assert_allclose(found["reflectance"], own, atol=2e-3)
    assert found["mu_rad"] == pytest.approx(material.mu[tuple(found["texel"])], rel=0.01)
    assert found["beta"] == pytest.approx(material.beta[tuple(found["texel"])], rel=0.03)
    assert np.linalg.norm(np.subtract(found["position_mm"], [-12.0, 4.0, 20.1])) == pytest.approx(20.0, abs=0.01)
    assert page.page.evaluate("([s]) => Irodori.renderer.probe(s, 1, 1)", [state]) is None


def add_errors(path, seed: int, nm=ERROR_NM) -> np.ndarray:
    """Add standard errors to a material's file, over the range of measured ones, one texel unknown; return them."""
    errors = 0.34 * np.exp(np.random.default_rng(seed).uniform(-5.5, 0.0, (12, 16, len(ERROR_NM)))).astype(np.float32)
    errors[3, 5] = np.nan
    with h5py.File(path, "a") as file:
        file["spectral_error"], file["error_wavelength"] = errors, nm
        file["reflectance_error"] = np.sqrt((errors**2).mean(axis=-1))
    accept(path)
    return errors


def test_a_probes_error_band_is_the_files_at_every_wavelength(tmp_path):
    given = sources(tmp_path / "files", room())
    errors = [add_errors(path, seed) for seed, path in enumerate(given.materials)]
    data = page_data(given)
    payload = data.payload({})
    planes = read_payload(payload)[1]
    for number, wanted in enumerate(errors):
        found = np.moveaxis(planes[f"object/{number}/spectral_error"], 0, -1)
        known = np.isfinite(wanted)
        np.testing.assert_allclose(found[known], wanted[known], rtol=0.08)  # as docs/viewer.md states
        assert not found[~known].any()
    path = tmp_path / "page.html"
    path.write_text(page_html("A page", payload), encoding="utf-8")
    with opened(path) as page:
        places = [{"surface": 1, "texel": texel, "position_mm": [0, 0, 0]} for texel in ([7, 11], [3, 5])]
        known, unknown = page.page.evaluate("(places) => places.map((p) => Irodori.renderer.known(p))", places)
    at = np.isin(WAVELENGTH_NM, ERROR_NM)
    assert known["object"] == "plate" and known["texel"] == [7, 11]
    np.testing.assert_allclose(np.array(known["sigma"])[at], errors[1][7, 11], rtol=0.08)
    np.testing.assert_allclose(known["sigma"], np.interp(WAVELENGTH_NM, ERROR_NM, np.array(known["sigma"])[at]))
    assert unknown["sigma"] is None


def test_errors_at_other_wavelengths_are_refused(tmp_path):
    given = sources(tmp_path, room())
    add_errors(given.materials[0], 1, ERROR_NM + 1.0)
    with pytest.raises(InputError, match="error_wavelength"):
        page_data(given)


def test_a_room_without_some_wavelengths_says_what_an_exchanged_light_lacks(tmp_path):
    full = room()
    weak = np.where(WAVELENGTH_NM < 425.0, 2e-5, 1.0)[:, None]  # less than 1e-4 of the peak, but not 0
    written = Written(tmp_path, sources(tmp_path / "files", replace(full, basis=full.basis * weak)))
    # The page's checks exchange no light that neither renderer can give.
    lights = {json.dumps(check.light["illuminant"]) for check in checks(written.data, written.scenes, written.view)}
    assert lights == {"null"}
    with opened(written.path) as page:
        lights = [None, {"name": "A"}, {"power": [0.0] * 5 + [1.0] * 56}]
        missing = page.page.evaluate(
            """(lights) => { const {light} = Irodori.renderer.defaultState();
              return lights.map((illuminant) => Irodori.renderer.missing({...light, illuminant})); }""",
            lights,
        )
    assert missing == [[], [400, 405, 410, 415, 420], []]


@pytest.fixture(scope="module")
def exported(written, tmp_path_factory):
    """The file of a page that was checked as it was written, and the errors that were returned."""
    output = tmp_path_factory.mktemp("exported") / "viewer.html"
    return output, export_viewer(written.sources, output=output)


@pytest.mark.heavy
def test_a_page_states_its_errors_and_its_own_check_agrees(exported, tmp_path, capsys):
    output, errors = exported
    header, _ = read_payload(payload_of(output))
    assert header["stated_errors"] == errors
    for name in ("data_loss", "cpu"):
        assert 0.0 < errors[name]["mean"] <= 0.1 and errors[name]["p99"] <= 0.3
    with opened(output) as page:
        rows = page.page.evaluate("Irodori.selftest(Irodori.renderer)")
        assert page.messages == []
    assert len(rows) == len(header["selftest"]) > 4
    assert max(row["mean"] for row in rows) <= 0.1
    # The command prints the header, with the planes' ranges, long lists told by their length; or says what it misses.
    assert viewer_command.main(["test", "--inspect", "--output", str(output)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["stated_errors"] == errors and printed["hashes"] == header["hashes"]
    assert printed["wavelength_nm"] == "61 entries" and printed["units"]["length"] == "mm"
    assert all(low <= high for low, high in (plane["range"] for plane in printed["planes"]))
    assert viewer_command.main(["test", "--inspect", "--output", str(tmp_path / "none.html")]) == 2
    assert capsys.readouterr().err.count("accepted:") == 1


@pytest.mark.heavy
def test_a_page_encoded_before_its_picture_states_the_same_and_the_distance_to_the_picture(exported, tmp_path, written):
    """What is encoded is what a page without a picture has."""
    given, payload, picture = written.sources, tmp_path / "viewer.payload", tmp_path / "front.exr"
    encoded = exported[1]
    payload.write_text(payload_of(exported[0]), encoding="ascii")
    assert encoded["reference"] is None
    bands = frame_bands(written.scene, make_view(given.scene.views["front"], given.scene.image), written.data.parts)
    write_spectral_exr(picture, bands, bands[..., :3], {})
    errors = finish_viewer(
        payload, given.scene, given.environments[0], output=tmp_path / "viewer.html", picture=picture
    )
    header, planes = read_payload(payload_of(tmp_path / "viewer.html"))
    assert header["stated_errors"] == errors == encoded | {"reference": errors["reference"]}
    assert 0.0 < errors["reference"]["mean"] <= 0.1
    assert set(planes) == {entry["name"] for entry in read_payload(payload.read_text())[0]["planes"]}


@pytest.mark.heavy
def test_without_webgl2_the_page_says_so(written):
    with opened(written.path, flags=(*FLAGS, "--disable-3d-apis"), wait=False) as page:
        page.wait_for("!document.getElementById('poster').hidden")
        assert "WebGL 2" in page.page.evaluate("document.getElementById('poster-text').textContent")


@pytest.mark.heavy
def test_highlights_of_ggx_are_those_of_its_formula(tmp_path):
    """One lamp on a black ball: the luminance is β F D G / cosθ_r of the half vector, written out here."""
    black = painted(beta=1.5, mirror=0.0)
    mu = 0.3
    ggx = black.__class__(
        **{**black.__dict__, "coefficients": 0 * black.coefficients, "mu": mu + 0 * black.mu, "lobes": ("ggx",),
           "beta": 1.5 + 0 * black.beta}
    )  # fmt: skip
    lamp = {"kind": "collimated", "azimuth_deg": -40.0, "elevation_deg": 50.0, "irradiance": 1.0, "spectrum": "D65"}
    given = sources(tmp_path, room(level=0.0), first=ggx, lights=[lamp])
    data = page_data(given)
    path = tmp_path / "page.html"
    path.write_text(page_html("A page", data.payload({})), encoding="utf-8")
    with opened(path) as page:
        xyz, objects = page.read_xyz(page.default_state(), 64, 48)
    view = make_view(given.scene.views["front"], SIZE)
    x, y = np.meshgrid((np.arange(64) - 31.5) / view.focal_px, (np.arange(48) - 23.5) / view.focal_px)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1) @ view.world_from_camera.T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    away = np.array([-12.0, 4.0, 20.1]) - view.position_mm
    along = ray @ away
    t = along - np.sqrt(np.maximum(400.0 - (away @ away - along**2), 0.0))
    normal = (t[..., None] * ray - away) / 20.0
    to_light = data.parts.directions[0]
    half = to_light - ray
    cos_h = np.sqrt(0.5 * (1.0 - ray @ to_light))
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cos_i, cos_r, cos_phi = normal @ to_light, -(normal * ray).sum(axis=-1), (normal * half).sum(axis=-1)
    seen = (objects == 0) & inside(objects) & (cos_i > 0.05) & (cos_r > 0.05)
    m2 = mu**2
    d = (m2 / (m2 * cos_phi**2 + 1.0 - cos_phi**2)) ** 2
    smith = [np.sqrt(c**2 + m2 * (1.0 - c**2)) for c in (cos_i, cos_r)]
    value = 1.5 * fresnel(cos_h, 1.5, 0.0) * 2.0 * cos_i * d / (cos_r * smith[0] + cos_i * smith[1])
    wanted = 100.0 * value / to_light[2]  # white is the diffuser that faces up
    assert seen.sum() > 40
    np.testing.assert_allclose(xyz[seen][:, 1], wanted[seen], rtol=0.02, atol=0.002 * wanted[seen].max())
