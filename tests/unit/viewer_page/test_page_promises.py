"""Promises of the classroom page: readable by everyone, states that travel, files, one sentence where it refuses."""

import base64
import io
import itertools
import json
import math
import re
from contextlib import nullcontext
from importlib import resources

import pytest
import yaml
from definitions import ROOT
from double_pages import PAGE, close, header_of, write_double
from PIL import Image

from irodori.config.cross_checks.lessons import check_lesson
from irodori.config.models import Scene
from irodori.config.pages import MOST_LAMPS
from irodori.config.validation import validate
from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml
from irodori.spectra.published import light
from irodori.viewer.lesson import lesson_for_page

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
TABLET = {"viewport": {"width": 820, "height": 1180}}
PROJECTOR = {"viewport": {"width": 1920, "height": 1080}}
TABS = ("lesson", "light", "compare", "objects", "seeing")


def words(language):
    return json.loads((PAGE / f"languages/{language}.json").read_text(encoding="utf-8"))


# ---- everyone


def violations(visit) -> list[str]:
    found = visit.page.evaluate("async () => (await axe.run(document, {resultTypes: ['violations']})).violations")
    return [f"{one['id']}: {node['html'][:120]}" for one in found for node in one["nodes"]]


@pytest.mark.parametrize(("size", "language"), [
    pytest.param(PHONE, "ja", id="phone-ja"), pytest.param(PROJECTOR, "en", id="projector-en", marks=pytest.mark.heavy),
])  # fmt: skip
def test_axe_finds_no_violation(visit, size, language):
    pytest.importorskip("axe_playwright_python", reason="axe is not installed: no page was checked for everyone's use")
    one = visit(locale=language, **size)
    one.page.evaluate(resources.files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8"))
    found = violations(one)
    one.page.locator(".steps li:nth-child(2) button").click()
    found += violations(one)
    one.page.locator(".steps li:nth-child(4) button").click()
    one.page.evaluate("document.querySelector('#page-lesson .group button').click()")
    found += violations(one)
    one.page.evaluate("document.querySelector('#add-lamp').click()")
    one.page.evaluate("document.querySelector('#page-seeing input[value=status]').click()")
    for tab in TABS[1:]:
        one.page.locator(f"#tab-{tab}").click()
        found += violations(one)
    one.tool("probe")
    box = one.page.locator("#picture").bounding_box()
    x, y = place_of(one, 3)
    one.page.mouse.click(box["x"] + x, box["y"] + y)
    assert one.page.locator("#card").is_visible()
    found += violations(one)
    for opener in ("#help-open", "#truth-open"):
        one.page.evaluate(f"document.querySelector('{opener}').click()")
        found += violations(one)
        one.page.keyboard.press("Escape")
    assert found == []


def place_of(visit, number):
    return visit.page.evaluate(
        "(i) => { const s = document.getElementById('stage'), o = Irodori.page().state; "
        "return Irodori.project(o.camera, o.objects[i].position_mm, s.clientWidth, s.clientHeight).slice(0, 2); }",
        number,
    )


def test_the_focus_goes_from_the_head_over_the_picture_to_the_panel(visit):
    one, order = visit(), []
    for _ in range(14):
        one.page.keyboard.press("Tab")
        order.append(one.page.evaluate("document.activeElement.closest('[id]').id"))
    expected = ["reset", "snapshot", "open", "help-open", "language", "picture", "tools", "tab-lesson", "page-lesson"]
    assert list(dict.fromkeys(order))[: len(expected)] == expected


@pytest.mark.parametrize("size", [
    pytest.param(PHONE, id="phone"), pytest.param(PROJECTOR, id="projector", marks=pytest.mark.heavy),
    pytest.param(TABLET, id="tablet", marks=pytest.mark.heavy),
])  # fmt: skip
def test_nothing_is_wider_than_the_screen_and_targets_are_large(visit, size):
    one = visit(**size)
    for tab in TABS:
        one.page.locator(f"#tab-{tab}").click()
        assert one.page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
        small = one.page.evaluate(
            "[...document.querySelectorAll('button, select, #tools label, .tick, input[type=range]')]"
            ".filter((e) => e.checkVisibility()).map((e) => [e.textContent, e.getBoundingClientRect()])"
            ".filter(([, box]) => box.height < 30 || box.width < 40).map(([words]) => words)"
        )
        assert small == []
    picture = one.page.locator("#picture").bounding_box()
    assert picture["width"] * picture["height"] > 0.4 * size["viewport"]["width"] * size["viewport"]["height"]


@pytest.mark.parametrize("language", ["en", "ja"])
def test_nothing_over_the_picture_covers_another(visit, language):
    """The scale bar is as long as it can be, and the window is of several sizes."""
    sizes = [dict(zip(("width", "height"), size, strict=True)) for size in ((900, 560), (821, 600), (1280, 720),
                                                                            (1441, 800))]  # fmt: skip
    one = visit(viewport=sizes[0], locale=language)
    one.page.locator("#tab-seeing").click()
    one.page.evaluate("document.querySelector('#page-seeing input[value=status]').click()")
    one.page.locator("#page-seeing").get_by_label(words(language)["show_rate"]).check()
    one.wait_for("document.getElementById('rate').textContent")

    def apart(a, b) -> bool:
        sides = (("x", "width"), ("y", "height"))
        return any(a[at] + a[size] <= b[at] or b[at] + b[size] <= a[at] for at, size in sides)

    for window in sizes:
        one.page.set_viewport_size(window)
        one.settled()
        stage = one.page.locator("#stage").bounding_box()
        longest_px = min(150, stage["width"] / 4)
        one.page.evaluate("(px) => { document.getElementById('scale-line').style.width = px + 'px'; }", longest_px)
        boxes = {name: one.page.locator(name).bounding_box() for name in ("#tools", "#scale-bar", "#legend", "#rate")}
        for name, box in boxes.items():
            for at, size in (("x", "width"), ("y", "height")):
                assert stage[at] <= box[at] and box[at] + box[size] <= stage[at] + stage[size], (name, window)
        assert [pair for pair in itertools.combinations(boxes, 2) if not apart(*map(boxes.get, pair))] == [], window
    one.page.set_viewport_size(sizes[0])


def test_changes_are_told_to_those_who_do_not_see_them(visit):
    one = visit()
    one.page.locator(".steps li:nth-child(3) button").click()
    one.settled()
    told = one.page.locator("#live").inner_text()
    assert "D65" in told and "Second light" in told and "50 %" in told


@pytest.mark.heavy
def test_motion_is_reduced_on_request(visit):
    glide = visit(reduced_motion="no-preference")
    still = visit()
    for one in (glide, still):
        one.page.evaluate("window.drawn = Irodori.pace().frames")
        one.page.locator(".steps li:nth-child(2) button").click()
        one.settled()
    frames = [one.page.evaluate("Irodori.pace().frames - window.drawn") for one in (glide, still)]
    # A machine that is busy draws few frames of a glide; without one there is the last alone, and what settles it.
    assert frames[0] > frames[1] and frames[1] <= 2
    assert glide.state() == still.state()


def test_every_word_is_there_in_every_language():
    tables = {language: words(language) for language in ("en", "ja")}
    assert tables["en"].keys() == tables["ja"].keys()
    for key, text in tables["en"].items():
        assert set(re.findall(r"{\w+}", text)) == set(re.findall(r"{\w+}", tables["ja"][key])), key
    used = re.compile(r"""(?:I\.text\(|data-text=|data-label=|Refusal\()['"]([a-z_0-9]*[a-z0-9])['"]""")
    named = {key for file in PAGE.glob("*.*") for key in used.findall(file.read_text(encoding="utf-8"))}
    assert len(named) > 50 and named <= tables["en"].keys()


def test_the_page_speaks_japanese_to_a_japanese_browser_and_can_be_told_otherwise(visit):
    one = visit(locale="ja-JP")
    assert one.page.evaluate("document.documentElement.lang") == "ja"
    assert "色は光と面と目でできている" in one.page.locator("#panel").inner_text()
    one.page.locator("#language").select_option("en")
    assert "Colour is light" in one.page.locator("#panel").inner_text()
    assert not re.search("[ぁ-んァ-ン]", one.page.evaluate("document.body.innerText").replace("日本語", ""))


# ---- states that travel


@pytest.mark.heavy
def test_a_step_shows_the_same_however_one_comes_to_it(visit):
    direct, round_about = visit(), visit()
    count = len(direct.page.locator(".steps li").all())
    assert count == 7
    for step in range(1, count + 1):
        direct.page.locator(f".steps li:nth-child({step}) button").click()
        for turn, other in enumerate((count, 1, step)):
            round_about.page.locator("#tab-lesson").click()
            round_about.page.locator(f".steps li:nth-child({other}) button").click()
            if turn == 1:
                round_about.page.locator("#picture").focus()
                for key in ("ArrowLeft", "+", "3", "ArrowRight", "2", "PageUp", "1"):
                    round_about.page.keyboard.press(key)
        assert direct.state() == round_about.state()
    state = direct.settled()
    assert state["step"] == count - 1
    assert visit(direct.page.evaluate("location.hash")).settled() == state


def address(content) -> str:
    text = content if isinstance(content, str) else json.dumps(content)
    return "#v1." + base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


LIGHT = {"environment": "classroom", "turn_deg": 0, "illuminant": None, "lamps": []}
PROFILE = {"label": "x", "xyz_from_rgb": [[1, 0, 0]] * 3, "codes": []}
CORNERS = ("red_xy", "green_xy", "blue_xy", "white_xy")
PRIMARIES = dict(zip(CORNERS, ([0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]), strict=True)) | {"gamma": 2.2}
EQUAL = {**{corner: [0.3, 0.3] for corner in CORNERS}, "gamma": 2}
PLACE = {"surface": 0, "texel": [3, 4], "position_mm": [0, 0, 0]}
FAULTS = {
    "camera.distance_mm": {"state": {"camera": {"distance_mm": -1}}},
    "camera.azimuth_deg": {"state": {"camera": {"azimuth_deg": "x"}}},
    "camera.roll_deg": {"state": {"camera": {"roll_deg": None}}},
    "camera.height_mm": {"state": {"camera": {"height_mm": -1}}},
    "display.profile.codes": {"state": {"display": {"profile": PROFILE}}},
    "camera.target_mm": {"state": {"camera": {"target_mm": [1, 2]}}},
    "state.camera.roll": {"state": {"camera": {"roll": 1}}},
    "light.illuminant.name": {"state": {"light": {"illuminant": {"name": "D66"}}}},
    "light.illuminant.power": {"state": {"light": {"illuminant": {"power": [0] * 61, "label": "dark"}}}},
    "light.lamps": {"state": {"light": {"lamps": [{}] * 9}}},
    "light.lamps[0].position_mm": {"state": {"light": {"lamps": [{"on": True}]}}},
    "light.environment": {"state": {"light": {"environment": "cellar"}}},
    "objects": {"state": {"objects": []}},
    "observer": {"state": {"observer": "nobody"}},
    "overlay": {"state": {"overlay": "rain"}},
    "display.primaries.red_xy": {"state": {"display": {"primaries": {"red_xy": [1]}}}},
    "compare.mode": {"compare": {"mode": "sniff", "at": 0, "other": None}},
    "compare.at": {"compare": {"mode": "rgb", "at": 2, "other": LIGHT}},
    "probes": {"probes": [PLACE] * 3},
    "probes[0]": {"probes": [[0, 0, 0]]},
    "probes[0].surface": {"probes": [PLACE | {"surface": 4}]},
    "probes[0].texel[1]": {"probes": [PLACE | {"texel": [0, 16]}]},
    "probes[0].texel[0]": {"probes": [PLACE | {"texel": [0.5, 0]}]},
    "__proto__": '{"__proto__": {"x": 1}}',
    "state is null": {"state": None},
    "state.camera is null": {"state": {"camera": None}},
    "state.light is [1]": {"state": {"light": [1]}},
    "light.illuminant.power is [1]": {"state": {"light": {"illuminant": {"name": "A", "power": [1]}}}},
    "light.illuminant.cct_K": {"state": {"light": {"illuminant": {"name": "A", "cct_K": 3000}}}},
    "light.environment is null": {"state": {"light": {"environment": None}}},
    "step is 100": {"step": 100},
    "step is -1": {"step": -1},
    "step is 0.5": {"step": 0.5},
    "display.name": {"state": {"display": {"name": "Adobe RGB (1998)"}}},
    'display.name is "sRGB"': {"state": {"display": {"name": "sRGB", "primaries": PRIMARIES}}},
    "display.primaries.white_xy": {"state": {"display": {"primaries": EQUAL}}},
    "white_xy is [0.8,0.8]": {"state": {"display": {"primaries": PRIMARIES | {"white_xy": [0.8, 0.8]}}}},
}  # fmt: skip


def test_a_faulty_address_is_refused_in_one_sentence_and_the_scene_is_shown(visit, opening_state):
    start, one = opening_state, visit()
    for field, content in FAULTS.items():
        one.page.evaluate("(hash) => { location.hash = hash; }", address(content))
        one.says(field)
        assert one.state() == start
    for hash_ in ("#v1.!!!", "#v0.e30", "#nothing", "#v1." + "A" * 5000, address("null"), address("[]"), address("1")):
        one.page.evaluate("document.getElementById('message').textContent = ''")
        one.page.evaluate("(hash) => { location.hash = hash; }", hash_)
        one.says("address")
        assert one.state() == start


def test_what_the_page_offers_is_taken_from_an_address(untouched):
    lights = ({"name": "A"}, {"cct_K": 3000}, {"power": [1] * 61, "label": "even"})
    displays = ({"name": "sRGB"}, {"name": "Display P3"}, {"primaries": PRIMARIES})
    for fields in ({"step": 6}, {"probes": [PLACE, PLACE | {"surface": 3, "texel": [15, 15]}]},
                   *({"state": {"display": display}} for display in displays),
                   *({"state": {"light": {"illuminant": illuminant}}} for illuminant in lights)):  # fmt: skip
        assert untouched.page.evaluate(
            "(hash) => { const app = Irodori.app, page = Irodori.hashToPage(hash, app.base, app.header, app.lesson);"
            " return Irodori.pageToHash(page, app.base); }",
            address(fields)[1:],
        ).startswith("v1.")


def test_an_address_of_a_step_that_another_page_has_shows_its_picture_without_a_step(visit):
    one = visit(address({"step": 50, "state": {"exposure_ev": 1.5}}))
    assert (one.settled()["step"], one.settled()["state"]["exposure_ev"]) == (None, 1.5)


def hidden_plate(visit) -> str:
    """Probe the plate, walk to where a ball hides it, and return the page's address."""
    visit.tool("probe")
    box = visit.page.locator("#picture").bounding_box()
    x, y = place_of(visit, 0)
    visit.page.mouse.click(box["x"] + x, box["y"] + y)
    visit.page.evaluate(
        "() => { const app = Irodori.app;"
        " Object.assign(app.page.state.camera, {azimuth_deg: -36.5, elevation_deg: 27}); app.changed(); }"
    )
    probed = visit.settled()["probes"]
    seen = visit.page.evaluate(
        "(at) => Irodori.renderer.probe(Irodori.page().state, ...Irodori.app.pixels(...at)).object", place_of(visit, 0)
    )
    assert seen == "leaf-sphere" and len(probed) == 1
    return visit.page.evaluate("location.hash")


def test_a_hidden_point_keeps_its_object_when_its_address_is_opened(visit):
    one = visit()
    hash_ = hidden_plate(one)
    before, words_before = one.state(), one.page.locator("#card").inner_text()
    assert "Tiled plate" in words_before
    again = visit(hash_)
    assert again.settled() == before
    assert again.page.locator("#card").inner_text() == words_before


def test_a_saved_picture_shows_its_probe_while_the_camera_is_still_on_its_way(visit):
    one = visit()
    hash_ = hidden_plate(one)
    moving = visit(reduced_motion="no-preference")
    plain = io.BytesIO()
    Image.new("RGB", (4, 4)).save(plain, "png")
    drop(moving, "saved.png", bytes(moving.page.evaluate(
        "([png, text]) => [...Irodori.pngWithText(Uint8Array.from(png), text)]", [list(plain.getvalue()), hash_[1:]]
    )))  # fmt: skip
    moving.says("state is shown again")
    assert "Tiled plate" in moving.page.locator("#card").inner_text()
    assert moving.settled() == one.state()
    assert "Tiled plate" in moving.page.locator("#card").inner_text()


def test_the_error_band_is_told_with_its_ends(visit):
    """The double's errors rise from 0.01 at 400 nm to 0.04 at 700 nm."""
    one = visit(address({"probes": [PLACE]}))
    told = one.page.locator("#card").inner_text()
    assert "±0.020 at 400 nm" in told and "±0.080 at 700 nm" in told
    one.page.evaluate(
        "() => { const {renderer} = Irodori, known = renderer.known;"
        " renderer.known = (place) => ({...known.call(renderer, place), sigma: null}); Irodori.app.showCard(); }"
    )
    assert "error is not known" in one.page.locator("#card").inner_text()
    assert one.page.locator("#card path.band").count() == 0


def test_a_light_that_the_room_cannot_give_is_told(visit):
    one = visit(script="window.missingLight = [400, 405, 410, 700]")
    one.page.locator("#tab-light").click()
    note = one.page.locator("#page-light p.hint[role=status]")
    assert "no power at 400–410 nm, 700 nm" in note.inner_text()
    one.page.evaluate("window.missingLight = []; Irodori.app.changed()")
    assert note.is_hidden()


def saved(visit, press) -> bytes:
    with visit.page.expect_download() as download:
        press()
    return download.value.path().read_bytes()


@pytest.mark.heavy
def test_a_saved_picture_shows_its_state_again(visit, tmp_path):
    one = visit(device_scale_factor=1)
    one.page.locator(".steps li:nth-child(3) button").click()
    one.page.locator("#tab-light").click()
    before = one.settled()
    content = saved(one, lambda: one.page.locator("#snapshot").click())
    with Image.open(io.BytesIO(content)) as picture:
        assert picture.size[0] > 500 and picture.text["irodori"].startswith("v1.")
    file = tmp_path / "still-life.png"
    file.write_bytes(content)
    again = visit()
    again.page.locator("#file").set_input_files(file)
    again.says("state is shown again")
    assert again.settled() == before
    other = visit()
    drop(other, "still-life.png", content)
    other.says("state is shown again")
    assert other.settled() == before


def drop(visit, name, content):
    visit.page.evaluate(
        "([name, text]) => { const held = new DataTransfer();"
        " held.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], name));"
        " document.dispatchEvent(new DragEvent('drop', {dataTransfer: held, bubbles: true, cancelable: true})); }",
        [name, base64.b64encode(content).decode()],
    )


@pytest.mark.heavy
def test_other_pictures_and_files_are_refused(visit, opening_state):
    one, start = visit(), opening_state
    plain = io.BytesIO()
    Image.new("RGB", (4, 4)).save(plain, "png")
    cases = [
        ("plain.png", plain.getvalue(), "no picture that this page saved"),
        ("cut.png", plain.getvalue()[:20], "no picture that this page saved"),
        ("text.png", b"not a picture", "no picture that this page saved"),
        ("a.doc", b"x", "neither a saved picture"),
        ("short.csv", b"450,1\n600,1\n", "450–600 nm"),
        ("none.csv", b"", "needed"),
        ("gap.csv", b"400,1\n700,1\n", "for more than 20 nm after 400 nm"),
        ("dark.csv", b"".join(b"%d,0\n" % nm for nm in range(400, 710, 10)), "none at all"),
        ("minus.csv", b"".join(b"%d,%d\n" % (nm, -1 if nm == 500 else 1) for nm in range(400, 710, 10)), "negative"),
        ("words.csv", b"wavelength,power\n400,1\n500,much\n700,1\n", "500,much"),
    ]
    for name, content, sentence in cases:
        drop(one, name, content)
        one.says(sentence)
        assert one.state() == start


def test_a_table_of_photons_is_refused(visit):
    one = visit()
    for words in ("Wavelength [nm],Photon flux [umol]", "# photon flux"):
        one.page.evaluate("document.getElementById('message').textContent = ''")
        drop(one, "torch.csv", (words + "\n" + "".join(f"{nm},1\n" for nm in range(380, 785, 10))).encode())
        one.says(f"torch.csv says “{words}”")
        assert one.state()["state"]["light"]["illuminant"] is None


@pytest.mark.heavy
def test_a_table_of_a_light_becomes_the_light(visit):
    one = visit()
    rows = "\ufeffwavelength nm;power\r\n" + "".join(f"{nm};{nm / 100}\r\n" for nm in range(380, 785, 10))
    drop(one, "torch.csv", rows.encode())
    one.says("torch.csv")
    light = one.state()["state"]["light"]["illuminant"]
    assert light["label"] == "torch.csv"
    assert light["power"] == pytest.approx([(400 + 5 * i) / 700 for i in range(61)], abs=1e-4)
    # A line of 1 nm in a fine table keeps its energy on the grid of 5 nm, wherever it stands.
    for line in (546, 548, 550):
        rows = "".join(f"{nm},{100 if nm == line else 1}\n" for nm in range(390, 711))
        one.page.evaluate("document.getElementById('message').textContent = ''")
        drop(one, "tube.csv", rows.encode())
        one.says("tube.csv")
        power = one.state()["state"]["light"]["illuminant"]["power"]
        assert (sum(power) - 61 * min(power)) / min(power) == pytest.approx(99 / 5, rel=0.02)


GRID = range(380, 741, 5)
UNEVEN = [395 + 0.7 * i + 0.2 * (i % 3) for i in range(450)]
TABLES = {
    "commas": "nm,W\n" + "".join(f"{nm},{0.3 + nm / 1000:.3f}\n" for nm in GRID),
    "semicolons and decimal commas": "nm;W\n" + "".join(f"{nm};{10 + nm / 7:.3f}\n".replace(".", ",") for nm in GRID),
    "small numbers": "".join(f"{nm};{nm / 1e4:.4f}\n".replace(".", ",") for nm in GRID),
    "tabs": "".join(f"{nm:.1f}\t{10 + nm / 7:.3f}\n".replace(".", ",") for nm in GRID),
    "spaces": "".join(f"{nm} {10 + nm / 7:.3f}\n".replace(".", ",") for nm in GRID),
    "commas and spaces": "".join(f"{nm}, {10 + nm / 7:.3f}\n" for nm in GRID),
    "1 nm": "".join(f"{nm},{1 + 100 * (nm == 546)}\n" for nm in range(390, 711)),
    "from 400 to 700 nm": "".join(f"{nm / 2},{1 + nm % 7}\n" for nm in range(800, 1401)),
    **{f"{step} nm": "".join(f"{nm},{2 + math.sin(nm / 23) + math.cos(nm / 9):.4f}\n" for nm in range(380, 781, step))
       for step in (10, 20)},
    "20 nm, to the ends": "".join(f"{nm},{1 + (nm - 400) ** 2 % 77}\n" for nm in range(400, 701, 20)),
    "rounded thirds": "".join(f"{380 + 20 * i / 3:.3f},{1 + math.sin(i / 2):.4f}\n" for i in range(61)),
    "a line, where Sprague's would be negative": "".join(f"{nm},{100 * (nm == 540)}\n" for nm in range(400, 701, 20)),
    "uneven, coarse": "".join(f"{nm},{nm % 90}\n" for nm in (390, 400, 410, *range(430, 711, 20))),
    "uneven": "".join(f"{nm:.2f},{2 + math.sin(nm):.4f}\n" for nm in UNEVEN),
    **{f"0.3 nm, line at {line}": "".join(
        f"{380 + 0.3 * i:.1f},{0.001 + math.exp(-(((380 + 0.3 * i - line) / 0.25) ** 2)):.5f}\n" for i in range(1134))
       for line in (532.0, 532.5)},
}  # fmt: skip


def test_tables_of_light_are_read_as_the_program_reads_them(untouched, tmp_path):
    for name, text in TABLES.items():
        file = tmp_path / "light.spd"
        file.write_text(text, encoding="utf-8")
        wanted = light(str(file))
        found = untouched.page.evaluate("(text) => Irodori.powerOfTable(text, 'light.txt').power", text)
        # The page keeps five digits.
        assert found == pytest.approx(list(wanted / wanted.max()), rel=5.1e-5, abs=1e-12), name


@pytest.mark.parametrize(("under", "refused"), [(0.009, False), (0.0101, True)])
@pytest.mark.parametrize("step", [1, 10])
def test_power_under_0_is_noise_for_the_page_as_for_the_program(untouched, tmp_path, under, refused, step):
    """The page draws it as 0."""
    text = "".join(
        f"{nm},{-50 * under if nm < 450 else nm - 450 if nm < 500 else 50}\n" for nm in range(380, 741, step)
    )
    (tmp_path / "light.spd").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="a hundredth of the peak under 0") if refused else nullcontext():
        wanted = light(str(tmp_path / "light.spd"))
    said = untouched.page.evaluate(
        "(text) => { try { return Irodori.powerOfTable(text, 'x.csv').power; }"
        " catch (error) { return Irodori.sentence(error); } }",
        text,
    )
    if refused:
        assert "x.csv has negative power" in said
    else:
        assert wanted.min() < 0.0 and said == pytest.approx(
            list((wanted / wanted.max()).clip(0.0)), rel=5.1e-5, abs=1e-9
        )


def test_tables_of_light_that_can_be_read_in_two_ways_are_refused(untouched):
    head = "".join(f"{nm};{nm}\n" for nm in range(380, 741, 10))
    for rows, sentence in (
        ("750;1.5\n760;1,5\n", "750;1.5"),
        ("750,10,5\n", "750,10,5"),
        ("750;1;2\n", "750;1;2"),
        ("750;\n", "750;"),
        ("400;1\n", "two rows for 400 nm"),
    ):
        said = untouched.page.evaluate(
            "(text) => { try { return Irodori.powerOfTable(text, 'x.csv').power.join(); }"
            " catch (error) { return Irodori.sentence(error); } }",
            head + rows,
        )
        assert sentence in said


@pytest.mark.parametrize(("wavelengths", "refused"), [
    ([*range(380, 531, 10), *range(560, 741, 10)], True),
    ([400, 421, *range(440, 701, 20)], True),
    ([*range(400, 701, 20)], False),
    ([300, 390, *range(400, 701, 20), 900], False),  # what is beyond 400 to 700 nm may have gaps
])  # fmt: skip
def test_tables_of_light_with_gaps_are_refused_as_the_program_refuses_them(untouched, tmp_path, wavelengths, refused):
    text = "".join(f"{nm},1\n" for nm in wavelengths)
    (tmp_path / "light.spd").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="no sample for") if refused else nullcontext():
        light(str(tmp_path / "light.spd"))
    said = untouched.page.evaluate(
        "(text) => { try { return Irodori.powerOfTable(text, 'x.csv').power.join(); }"
        " catch (error) { return Irodori.sentence(error); } }",
        text,
    )
    assert ("has no row for more than 20 nm after" in said) is refused


# ---- the teacher


@pytest.mark.heavy
def test_an_edited_lesson_is_exported_as_a_scene_takes_it(visit, scene, opening_state):
    one = visit()
    page = one.page
    page.locator(".steps li:nth-child(3) button").click()
    page.get_by_role("button", name="Edit the lesson").click()
    page.locator("#step-title").fill('A "second" title: yes')
    page.locator("#step-text").fill("First.\n\nSecond # not a comment")
    page.locator("#picture").focus()
    for key in ("ArrowLeft", "2", "PageUp"):
        page.keyboard.press(key)
    page.get_by_role("button", name="Take over the picture").click()
    shown = one.state()
    page.get_by_role("button", name="Add a step from this picture").click()
    text = saved(one, lambda: page.get_by_role("button", name="Export").click()).decode()
    written = yaml.safe_load(text)
    whole = {**yaml.safe_load((ROOT / "config/scenes/still-life.yaml").read_text(encoding="utf-8")), **written}
    lesson = Scene.of(validate(whole, "scene", "still-life.yaml")).lesson
    assert len(lesson.steps) == len(scene.lesson.steps) + 1
    assert lesson.steps[2].title["en"] == 'A "second" title: yes'
    assert lesson.steps[2].title["ja"] == scene.lesson.steps[2].title["ja"]
    assert lesson.steps[2].text["en"] == "First.\n\nSecond # not a comment"
    again = page.evaluate(
        "([lesson, base]) => Irodori.pageOfStep(lesson.steps[2], 2, base, {illuminants: [{name: 'D65'}, {name: 'A'}],"
        " environments: ['classroom'], observers: [{name: base.state.observer}], views: [],"
        " displays: [{name: 'sRGB'}]})",
        [lesson_for_page(lesson), opening_state],
    )
    assert close(again["state"]["camera"], shown["state"]["camera"])
    assert again["state"]["objects"] == shown["state"]["objects"]
    assert again["compare"] == shown["compare"]


def test_the_text_of_a_lesson_is_read_back_as_it_was(untouched, tmp_path):
    """YAML 1.1 takes 1e-7 for a text, and does not print some characters."""
    numbers = [1e-7, -2e-15, 1.5e-9, 1e21, 0.25, 3, 0]
    words = {"en": 'a\u2028\x85\x7f\xa0é😀 "x" # \t\\', "ja": "a: b\n\n  c\r\n'd'", "no": "x"}
    lesson = {
        "title": words,
        "steps": [{"title": words, "text": words, "numbers": numbers, "at": 1e-7, "visible": True}],
    }
    text = untouched.page.evaluate("(lesson) => Irodori.lessonYaml(lesson)", lesson)
    (tmp_path / "lesson.yaml").write_bytes(text.encode())
    assert read_yaml(tmp_path / "lesson.yaml") == {"lesson": lesson}
    half = untouched.page.evaluate("() => Irodori.lessonYaml({title: {en: 'a\\ud83d'}, steps: []})")
    assert yaml.safe_load(half)["lesson"]["title"]["en"] == "a\ufffd"


def test_lamps_are_added_until_the_page_can_draw_no_more_and_a_light_needs_a_name(visit, opening_state):
    one = visit()
    one.page.locator("#tab-light").click()
    for _ in range(MOST_LAMPS):
        one.page.locator("#add-lamp").click()
    assert one.page.locator("#add-lamp").is_disabled()
    page = one.state()
    words = {"title": {"en": "One"}, "text": {"en": "Words."}}
    export = (
        "([page, words, base]) => Irodori.lessonYaml("
        "{title: words.title, steps: [Irodori.stepOfPage(page, words, base)]})"
    )
    given = yaml.safe_load(one.page.evaluate(export, [page, words, opening_state]))
    whole = yaml.safe_load((ROOT / "config/scenes/still-life.yaml").read_text(encoding="utf-8"))
    scene = Scene.of(validate({**whole, **given}, "scene", "still-life.yaml"))
    check_lesson(scene, ROOT, "still-life.yaml")
    assert [lamp.size_mm for lamp in scene.lesson.steps[0].light.lamps] == [60.0] * MOST_LAMPS
    page["state"]["light"]["illuminant"] = {"power": [1] * 61, "label": ""}
    header = {"environments": ["classroom"], "illuminants": []}
    refused = one.page.evaluate(
        "([page, header]) => { try { Irodori.checkedPage(page, page, header) } catch (e) { return e.values.field } }",
        [page, header],
    )
    assert refused == "light.illuminant.label"


@pytest.mark.heavy
def test_a_picture_given_to_a_step_is_shown_and_exported_with_the_lesson(visit, tmp_path):
    one = visit()
    page = one.page
    page.locator(".steps li:nth-child(2) button").click()
    page.get_by_role("button", name="Edit the lesson").click()
    stream = io.BytesIO()
    Image.new("RGB", (4, 4), (200, 30, 30)).save(stream, "png")
    (tmp_path / "red tube.png").write_bytes(stream.getvalue())
    (tmp_path / "tube.gif").write_bytes(b"GIF89a")
    (tmp_path / "large.png").write_bytes(stream.getvalue() + bytes(1_000_000))
    for name in ("tube.gif", "large.png"):
        with page.expect_file_chooser() as chooser:
            page.get_by_role("button", name="Give it a picture").click()
        chooser.value.set_files(tmp_path / name)
        one.says(name)
        assert not page.locator("#page-lesson .prose img").count()
    # The same name in two steps: one of them gets a number.
    for step in (2, 3):
        page.locator(f".steps li:nth-child({step}) button").click()
        with page.expect_file_chooser() as chooser:
            page.get_by_role("button", name="Give it a picture").click()
        chooser.value.set_files(tmp_path / "red tube.png")
        one.wait_for("document.querySelector('#page-lesson .prose img')?.naturalWidth === 4")
    downloads = []
    page.on("download", lambda found: downloads.append(found))
    page.get_by_role("button", name="Export").click()
    one.says("red-tube-2.png")
    for _ in range(6000):
        if len(downloads) < 3:
            page.wait_for_timeout(10)
    files = {found.suggested_filename: found.path().read_bytes() for found in downloads}
    steps = yaml.safe_load(files.pop("still-life-lesson.yaml"))["lesson"]["steps"]
    assert [step.get("picture") for step in steps[1:3]] == ["red-tube.png", "red-tube-2.png"]
    assert files == dict.fromkeys(("red-tube.png", "red-tube-2.png"), stream.getvalue())
    page.get_by_role("button", name="Remove the picture").click()
    assert not page.locator("#page-lesson .prose img").count()


# ---- what cannot be drawn, and how fast it can


def test_without_webgl2_there_is_the_rendered_picture_and_a_sentence(visit):
    one = visit(script="window.noWebGL2 = true", ready=False)
    one.page.wait_for_selector("body.still")
    assert "no WebGL 2" in one.page.locator("#poster-text").inner_text()
    assert one.page.locator("#poster-picture").bounding_box()["width"] > 300
    assert not one.page.locator("main").is_visible()


NO_FLOATS = """const own = WebGL2RenderingContext.prototype.getExtension;
WebGL2RenderingContext.prototype.getExtension = function (name) {
  return /float/.test(name) ? null : own.call(this, name);
};
"""


@pytest.mark.parametrize(("script", "sentence"), [
    (NO_FLOATS, "EXT_color_buffer_float"), ("delete window.DecompressionStream", "cannot unpack"),
    ("HTMLCanvasElement.prototype.getContext = () => null", "no WebGL 2"),
])  # fmt: skip
def test_what_the_browser_lacks_is_named(visit, drawn_page_file, script, sentence):
    one = visit(script=script, ready=False, file=drawn_page_file)
    one.page.wait_for_selector("body.still")
    assert sentence in one.page.locator("#poster-text").inner_text()
    one.page.set_viewport_size({"width": 900, "height": 700})
    one.page.evaluate("() => new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")


def test_a_damaged_payload_is_told_in_a_sentence(visit):
    one = visit(script="window.damagedPayload = true", ready=False)
    one.page.wait_for_selector("body.still")
    assert one.page.locator("#poster-text").inner_text() == "The data of this page are damaged."


@pytest.mark.heavy
def test_a_slow_machine_gets_fewer_pixels_while_it_moves_and_all_at_rest(visit):
    one = visit(script="window.slowness = 120")
    one.page.evaluate(
        "async () => { for (let i = 0; i < 60; i++) { document.getElementById('picture').dispatchEvent("
        "new KeyboardEvent('keydown', {key: 'ArrowLeft'})); await new Promise(requestAnimationFrame); } }"
    )
    moving = one.page.evaluate("Irodori.pace()")
    assert 0.25 <= moving["scale"] < 0.75
    # All of them, unless that would take two seconds, as on a machine that others keep busy.
    one.wait_for("(p => Irodori.calls.at(-1) === Math.min(1, p.scale * Math.sqrt(2000 / p.ms)))(Irodori.pace())")
    drawn = one.page.evaluate("Irodori.pace().frames")
    one.page.wait_for_timeout(500)
    assert one.page.evaluate("Irodori.pace().frames") == drawn


@pytest.mark.heavy
def test_rate_and_scale_are_shown_on_request(visit):
    one = visit(device_scale_factor=1)
    assert not one.page.locator("#rate").is_visible()
    one.page.locator("#tab-seeing").click()
    one.page.get_by_label("Show frames per second").check()
    one.wait_for("document.getElementById('rate').textContent")
    assert re.search(r"scale [01]\.\d\d · 900 × \d+$", one.page.locator("#rate").inner_text())


def test_the_scale_bar_tells_millimetres(untouched):
    one = untouched
    mm = float(one.page.locator("#scale-text").inner_text().split()[0])
    pixels = one.page.locator("#scale-line").bounding_box()["width"]
    ends = one.page.evaluate(
        "(mm) => { const s = document.getElementById('stage'), c = Irodori.page().state.camera;"
        " return [-mm / 2, mm / 2].map((x) => Irodori.project(c, [x, 0, 22], s.clientWidth, s.clientHeight)[0]); }",
        mm,
    )
    assert ends[1] - ends[0] == pytest.approx(pixels, abs=1)


def test_the_footer_tells_how_true_the_picture_is(visit):
    one = visit("#selftest")
    line = one.page.locator("#truth-line").inner_text()
    assert "0.040" in line and "0.210" in line and "2026-11-22" in line and "0123abcd" in line
    # The address that asks for the page's own check shows its table.
    one.wait_for("document.querySelector('#dialog td')")
    assert one.page.locator("#dialog td").all_inner_texts() == ["double", "0.01", "0.1"]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("language", ["en", "ja"])
def test_the_footer_of_an_unchecked_page_tells_what_was_not_checked_and_what_that_needs(
    visit, scene, tmp_path, language
):
    header = header_of(scene)
    header["stated_errors"]["cpu"] = None
    one = visit(file=write_double(tmp_path / "viewer.html", header), locale=language)
    line = one.page.locator("#truth-line").inner_text()
    assert line.startswith(words(language)["truth_unchecked"]) and "CPU" in line
    assert "Chromium" in line and "playwright" in line
