"""Actions of people in the classroom page: by keys alone, with a finger, with a pointer, at random."""

import random

import pytest
from double_pages import close

TOOLS = ("view", "object", "room", "lamp", "probe", "ruler")
TABS = ("lesson", "light", "compare", "objects", "seeing")


def keys(visit, *pressed):
    for key in pressed:
        visit.page.keyboard.press(key)


def open_tab(visit, name):
    visit.tab_to("[role=tab][aria-selected=true]")
    keys(visit, "Home", *["ArrowRight"] * TABS.index(name))
    assert visit.focused() == f"tab-{name}"


def at_picture(visit, tool):
    visit.tab_to("#picture")
    keys(visit, str(TOOLS.index(tool) + 1))


def choose(visit, label):
    """Type the first letters of an option of the list that has the focus.

    A list forgets letters after a second: on a busy machine some may come too late for it, and are typed again. A list
    whose choice changes the controls is gone by then.
    """
    chosen = "(label) => document.activeElement.selectedOptions?.[0].label.startsWith(label) ?? true"
    for _ in range(10):
        visit.page.keyboard.type(label)
        if visit.page.evaluate(chosen, label):
            return
        visit.page.wait_for_timeout(1500)
    raise AssertionError(f"no option {label}")


# ---- by keys alone: how, and what of the state is another afterwards


def orbit(visit):
    at_picture(visit, "view")
    keys(visit, "ArrowLeft", "ArrowUp")
    return lambda page: (page["state"]["camera"]["azimuth_deg"], page["state"]["camera"]["elevation_deg"]) == (-95, 31)


def zoom(visit):
    at_picture(visit, "view")
    keys(visit, "+", "+", "-")
    return lambda page: page["state"]["camera"]["distance_mm"] == pytest.approx(370 / 1.1)


def pan(visit):
    at_picture(visit, "view")
    keys(visit, "Shift+ArrowRight")
    return lambda page: page["state"]["camera"]["target_mm"][0] > 2


def turn_room(visit):
    at_picture(visit, "room")
    keys(visit, "ArrowRight", "ArrowRight")
    return lambda page: page["state"]["light"]["turn_deg"] == 10


def move_object(visit):
    at_picture(visit, "object")
    keys(visit, "n", "ArrowRight", "PageUp", ".")
    return lambda page: (
        page["state"]["objects"][1]["position_mm"] == pytest.approx([-50, 8, 32.1])
        and (page["state"]["objects"][1]["turn_deg"][2] == 5)
    )


def probe(visit):
    at_picture(visit, "probe")
    keys(visit, *["Shift+ArrowLeft"] * 2, "Enter")
    assert "Vermilion sphere" in visit.page.locator("#card").inner_text()
    assert "Paint’s" in visit.page.locator("#live").inner_text()
    return lambda page: len(page["probes"]) == 1


def measure_length(visit):
    at_picture(visit, "ruler")
    keys(visit, *["Shift+ArrowLeft"] * 2, "Enter", *["Shift+ArrowRight"] * 4, "Enter")
    assert " mm apart" in visit.page.locator("#message").inner_text()
    return lambda page: len(page["ruler"]) == 2


def go_through_lesson(visit):
    open_tab(visit, "lesson")
    visit.tab_to(".stepper .chief")
    keys(visit, "Enter", "Enter", "Enter")
    return lambda page: page["step"] == 2 and page["compare"]["mode"] == "wipe"


def choose_illuminant(visit):
    open_tab(visit, "light")
    visit.tab_to("#page-light select")
    choose(visit, "D50")
    return lambda page: page["state"]["light"]["illuminant"] == {"name": "D50"}


def choose_temperature(visit):
    open_tab(visit, "light")
    visit.tab_to("#page-light select")
    choose(visit, "Colour temp")
    visit.tab_to("#page-light input[type=range]")
    keys(visit, "PageUp")
    return lambda page: page["state"]["light"]["illuminant"]["cct_K"] < 3000


def draw_light(visit):
    open_tab(visit, "light")
    visit.tab_to("#page-light select")
    choose(visit, "Drawn")
    visit.tab_to("#page-light input[type=range][min='400']")
    keys(visit, "End")
    keys(visit, "Tab", "Home")
    return lambda page: page["state"]["light"]["illuminant"]["power"][60] == 0


def expose(visit):
    open_tab(visit, "light")
    visit.tab_to("#page-light input[min='-4']")
    keys(visit, "ArrowRight")
    return lambda page: page["state"]["exposure_ev"] == pytest.approx(0.1)


def add_lamp(visit):
    open_tab(visit, "light")
    visit.tab_to("#add-lamp")
    keys(visit, "Enter")
    at_picture(visit, "lamp")
    keys(visit, "ArrowRight", "PageUp")
    return lambda page: page["state"]["light"]["lamps"][0]["position_mm"] == pytest.approx([-58, 20, 112])


def change_lamp(visit):
    open_tab(visit, "light")
    visit.tab_to("#add-lamp")
    keys(visit, "Enter")
    visit.tab_to("#page-light input[max='300']")
    keys(visit, "ArrowRight")
    visit.tab_to("#page-light fieldset select")
    choose(visit, "D50")
    return lambda page: (
        [(lamp["size_mm"], lamp["illuminant"]) for lamp in page["state"]["light"]["lamps"]] == [(61, {"name": "D50"})]
    )


def compare(visit):
    open_tab(visit, "compare")
    visit.tab_to("#page-compare input[type=radio]")
    keys(visit, "ArrowDown")
    visit.tab_to("#wipe")
    keys(visit, "ArrowRight", "ArrowRight")
    return lambda page: page["compare"]["mode"] == "wipe" and page["compare"]["at"] == pytest.approx(0.54)


def metamerism(visit):
    open_tab(visit, "compare")
    visit.tab_to("#page-compare input[type=radio]")
    keys(visit, "ArrowDown", "ArrowDown", "ArrowDown")
    assert visit.page.locator("#legend").is_visible()
    return lambda page: (
        page["compare"]["mode"] == "metamerism" and page["compare"]["other"]["illuminant"] == {"name": "A"}
    )


def hide_object(visit):
    open_tab(visit, "objects")
    visit.tab_to("#page-objects input[type=checkbox]")
    keys(visit, "Space")
    return lambda page: page["state"]["objects"][0]["visible"] is False


def swap_objects(visit):
    open_tab(visit, "objects")
    visit.tab_to("#page-objects button:last-of-type:not(:nth-child(5))")
    while visit.page.evaluate("document.activeElement.textContent") != "Swap places":
        keys(visit, "Tab")
    keys(visit, "Enter")
    return lambda page: page["state"]["objects"][0]["position_mm"] == [-52, 8, 30.1]


def observe(visit):
    open_tab(visit, "seeing")
    visit.tab_to("#page-seeing select")
    keys(visit, "ArrowDown", "Tab", "ArrowDown")
    visit.tab_to("#page-seeing input[type=radio]")
    keys(visit, "ArrowDown")
    return lambda page: (page["state"]["observer"], page["state"]["deficiency"], page["state"]["overlay"]) == (
        "CIE 1964 10°", "protan", "status",
    )  # fmt: skip


def own_screen(visit):
    open_tab(visit, "seeing")
    visit.tab_to("#page-seeing section:nth-of-type(2) select")
    choose(visit, "Measured")
    visit.tab_to("input[type=number]")
    visit.page.keyboard.type("0.7")
    keys(visit, "Tab")
    return lambda page: page["state"]["display"]["primaries"]["red_xy"] == [0.7, 0.33]


ACTIONS = [
    orbit, zoom, pan, turn_room, move_object, probe, measure_length, go_through_lesson, choose_illuminant,
    choose_temperature, draw_light, expose, add_lamp, change_lamp, compare, metamerism, hide_object, swap_objects,
    observe, own_screen,
]  # fmt: skip


@pytest.fixture(scope="module")
def reset_pages() -> list:
    """Pages that were opened from an address and then reset, which are as good as new ones."""
    return []


#: Actions by several tools and on several tabs, by which every kind of control is tried.
_ALWAYS = (orbit, move_object, choose_illuminant)


@pytest.mark.parametrize(
    "action",
    [pytest.param(one, marks=[] if one in _ALWAYS else pytest.mark.heavy, id=one.__name__) for one in ACTIONS],
)
def test_everything_can_be_done_by_keys_and_is_in_the_address(open_page, reset_pages, action, opening_state):
    """Each begins on the page on which the one before has ended."""
    one = reset_pages.pop() if reset_pages else open_page()
    one.page.bring_to_front()
    holds = action(one)
    page = one.settled()
    assert holds(page), page
    again = open_page(one.page.evaluate("location.hash"))
    assert close(again.settled(), page)
    again.tab_to("#reset")
    keys(again, "Enter")
    assert again.settled() == opening_state
    one.leave()
    assert one.complaints == again.complaints == []
    reset_pages.append(again)


def test_dialogs_open_and_close_by_keys(visit):
    one = visit()
    for opener, words in (("#help-open", "Page Up"), ("#truth-open", "0123abcd")):
        one.tab_to(opener)
        keys(one, "Enter")
        assert words in one.page.locator("#dialog").inner_text()
        keys(one, "Escape")
        assert not one.page.locator("#dialog").is_visible()
        assert one.focused() == opener[1:]


def test_the_screen_is_checked(visit):
    one = visit()
    open_tab(one, "seeing")
    one.page.get_by_role("button", name="Check the screen").click()
    one.page.locator("#dialog input[type=range]").first.focus()
    keys(one, "Home")
    assert "Dark tones are lost" in one.page.locator("#dialog").inner_text()


# ---- with a pointer


def drag(visit, by, start=(0, 0), **given):
    x, y = visit.centre()
    x, y = x + start[0], y + start[1]
    visit.page.mouse.move(x, y)
    visit.page.mouse.down(**given)
    for part in range(1, 6):
        visit.page.mouse.move(x + by[0] * part / 5, y + by[1] * part / 5)
    visit.page.mouse.up(**given)


@pytest.mark.heavy
def test_pointer_moves_view_room_object_and_line(visit):
    one = visit()
    drag(one, (100, 50))
    camera = one.state()["state"]["camera"]
    assert camera["azimuth_deg"] < -110 and camera["elevation_deg"] > 35
    x, y = one.centre()
    one.page.mouse.move(x, y)
    one.page.mouse.wheel(0, -300)
    one.wait_for("Irodori.page().state.camera.distance_mm < 300")
    drag(one, (80, 0), button="right")
    assert one.state()["state"]["camera"]["target_mm"] != [0, 0, 22]
    one.page.locator("#reset").click()
    one.tool("room")
    drag(one, (100, 0))
    assert one.state()["state"]["light"]["turn_deg"] == pytest.approx(40, abs=4)
    one.tool("object")
    x, y, *_ = one.page.evaluate(
        "() => { const s = document.getElementById('stage'), o = Irodori.page().state; "
        "return Irodori.project(o.camera, o.objects[3].position_mm, s.clientWidth, s.clientHeight); }"
    )
    box = one.page.locator("#picture").bounding_box()
    centre = one.centre()
    drag(one, (60, 0), start=(box["x"] + x - centre[0], box["y"] + y - centre[1]))
    moved = one.state()["state"]["objects"][3]["position_mm"]
    assert moved[0] > 60 and moved[2] == pytest.approx(30.1)
    one.page.locator("#tab-compare").click()
    one.page.locator("#page-compare label", has_text="Second light").click()
    handle = one.page.locator("#wipe span").bounding_box()
    x, y = handle["x"] + 22, handle["y"] + 22
    one.page.mouse.move(x, y)
    one.page.mouse.down()
    one.page.mouse.move(x + 90, y)
    one.page.mouse.up()
    assert one.state()["compare"]["at"] == pytest.approx(0.6, abs=0.01)


@pytest.mark.heavy
def test_a_light_is_drawn_with_the_pointer(visit):
    one = visit()
    one.page.locator("#tab-light").click()
    one.page.locator("#page-light select").first.select_option(label="Drawn by hand")
    box = one.page.locator("svg.drawable").bounding_box()
    one.page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 0.9 * box["height"])
    one.page.mouse.down()
    for part in range(20, 90, 2):
        one.page.mouse.move(
            box["x"] + part / 100 * box["width"], box["y"] + box["height"] * (0.8 - 0.7 * (part - 20) / 70)
        )
    one.page.mouse.up()
    power = one.state()["state"]["light"]["illuminant"]["power"]
    assert power[15] < 0.2 < power[35] < power[50] and len(power) == 61


# ---- with fingers


def touches(session, kind, *points):
    fingers = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
    session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})


def test_fingers_turn_pinch_and_probe(visit):
    one = visit(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    session = one.page.context.new_cdp_session(one.page)
    x, y = one.centre()
    touches(session, "touchStart", (x, y))
    for step in range(8):
        touches(session, "touchMove", (x + 10 * step, y))
    touches(session, "touchEnd")
    assert one.state()["state"]["camera"]["azimuth_deg"] < -105
    touches(session, "touchStart", (x - 30, y), (x + 30, y))
    for step in range(8):
        touches(session, "touchMove", (x - 30 - 5 * step, y), (x + 30 + 5 * step, y))
    touches(session, "touchEnd")
    camera = one.state()["state"]["camera"]
    assert camera["distance_mm"] < 250
    # A finger's click comes after the touch that makes it.
    one.page.locator("#reset").tap()
    one.wait_for("Irodori.page().state.camera.distance_mm > 300")
    one.page.locator("#tools label").nth(4).tap()
    one.wait_for("document.querySelector('#tools input[value=probe]').checked")
    at = one.page.evaluate(
        "() => { const s = document.getElementById('stage'), o = Irodori.page().state; "
        "return Irodori.project(o.camera, o.objects[3].position_mm, s.clientWidth, s.clientHeight); }"
    )
    box = one.page.locator("#picture").bounding_box()
    one.page.touchscreen.tap(box["x"] + at[0], box["y"] + at[1])
    one.wait_for("document.getElementById('card').innerText.includes('Leaf green sphere')")


# ---- at random

_AROUND = (
    "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Shift+ArrowLeft", "Shift+ArrowUp", "PageUp", "PageDown",
    "+", "-", ",", ".", "n", "Enter", "Home",
)  # fmt: skip


#: The picture of the page has so few pixels that a renderer in software draws as fast as people act.
_SMALL = {"device_scale_factor": 0.03}
#: How many numbers are none: in the state, in what is read back of the picture and of the light it is compared with.
NOT_FINITE = """() => {
  const page = Irodori.page(), {state, compare} = page, lights = [state.light];
  const numbers = (v) =>
    typeof v === "number" ? [v] : v && typeof v === "object" ? Object.values(v).flatMap(numbers) : [];
  if (compare && compare.other) lights.push({...state.light, ...compare.other});
  return [numbers(page), ...lights.map((light) => Irodori.renderer.readXYZ({...state, light}, 24, 16))]
    .map((values) => values.filter((x) => !Number.isFinite(x)).length);
}"""


@pytest.mark.heavy
def test_random_actions_leave_no_error_and_no_number_lost(visit, drawn_page_file):
    """Sequences of 8 actions each, on the product's own renderer: what is drawn after each is read back."""
    one, draw = visit(file=drawn_page_file, **_SMALL), random.Random(1)
    for _ in range(25):
        for _ in range(8):
            chance = draw.random()
            if chance < 0.45:
                one.page.locator("#picture").focus()
                keys(one, str(draw.randint(1, 6)), draw.choice(_AROUND), draw.choice(_AROUND))
            elif chance < 0.55:
                drag(one, (draw.uniform(-200, 200), draw.uniform(-200, 200)))
            else:
                one.page.evaluate(ANY_CONTROL, draw.random())
        one.page.evaluate("document.getElementById('dialog').close()")
        assert set(one.page.evaluate(NOT_FINITE)) == {0}
        if draw.random() < 0.2:
            one.page.locator("#reset").click()
    page = one.settled()
    again = visit(one.page.evaluate("location.hash"), file=drawn_page_file, drawn=True, **_SMALL)
    # A step that was added is in the edited page alone.
    if page["step"] is not None and page["step"] >= again.page.evaluate("Irodori.lesson()?.steps.length ?? 0"):
        page["step"] = None
    assert close(again.settled(), page)


#: Use any control that is shown as its user would: the number in 0..1 picks it and its value.
ANY_CONTROL = """(chance) => {
  const places = ['#panel button', '#panel select', '#panel input', '#tools input', '#notes button', '#card button'];
  const all = [...document.querySelectorAll(places.join())]
    .filter((one) => one.checkVisibility() && !one.disabled && !/export|file/.test(one.textContent.toLowerCase()));
  const one = all[Math.floor(chance * all.length)], part = (chance * 7919) % 1;
  document.getElementById('dialog').close();
  if (!one) return;
  if (one.tagName === 'SELECT') {
    const options = [...one.options].filter((each) => each.value !== ':file');
    one.value = options[Math.floor(part * options.length)].value;
    one.dispatchEvent(new Event('change', {bubbles: true}));
  } else if (one.type === 'range' || one.type === 'number') {
    one.value = Number(one.min) + part * (Number(one.max) - Number(one.min));
    one.dispatchEvent(new Event('input', {bubbles: true}));
    one.dispatchEvent(new Event('change', {bubbles: true}));
  } else if (one.type === 'text') {
    one.value = 'words ' + part;
    one.dispatchEvent(new Event('change', {bubbles: true}));
  } else one.click();
}"""
