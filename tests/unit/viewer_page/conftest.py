"""A browser without a network, and the page open in it."""

import json
from collections import defaultdict
from dataclasses import dataclass, field

import patience
import pytest
from definitions import ROOT, load
from double_pages import header_of, write_double
from pages import room, sources

from irodori.viewer.browser import FLAGS, browser, browser_command, is_told_by_page
from irodori.viewer.page_data import page_data
from irodori.viewer.page_file import write_page

#: A window of the usual size in the units of styles, by which all is laid out, and of a sixteenth of its pixels.
_USUAL = {"viewport": {"width": 1280, "height": 800}, "locale": "en", "reduced_motion": "reduce",
          "device_scale_factor": 0.25}  # fmt: skip


@dataclass
class Visit:
    """An open page, with all that went wrong in it."""

    page: object
    complaints: list[str] = field(default_factory=list)
    listeners: dict = field(default_factory=dict)
    idle: list = field(default_factory=list)

    def leave(self) -> None:
        """Leave the page empty for a later test."""
        self.page.goto("about:blank")
        for event, listener in self.listeners.items():
            self.page.remove_listener(event, listener)
        self.idle.append(self.page)

    def state(self) -> dict:
        return self.page.evaluate("Irodori.page()")

    def wait_for(self, condition: str) -> None:
        """Wait until an expression is true in the page: it has minutes, of which it needs none."""
        held = self.page.evaluate(
            f"async (end) => {{ while (!({condition}) && performance.now() < end)"
            " await new Promise((go) => setTimeout(go, 10)); return !!(" + condition + "); }",
            self.page.evaluate("performance.now()") + patience.LONG_MS,
        )
        assert held, condition

    def settled(self) -> dict:
        """Wait until the page has come to rest, and return its state."""
        self.wait_for("Irodori.pace().atRest")
        return self.state()

    def says(self, words: str) -> None:
        """Wait until the page's message holds some words."""
        self.wait_for(f"document.getElementById('message').textContent.includes({json.dumps(words)})")

    def focused(self) -> str:
        return self.page.evaluate("document.activeElement.id || document.activeElement.outerHTML.slice(0, 80)")

    def tab_to(self, selector: str) -> None:
        """Press the tabulator key until the element has the focus."""
        for _ in range(150):
            if self.page.evaluate("(s) => document.activeElement.matches(s)", selector):
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"the tabulator key never reaches {selector}")

    def tool(self, name: str) -> None:
        self.page.locator(f"#tools input[value={name}]").check()

    def centre(self) -> tuple[float, float]:
        box = self.page.locator("#picture").bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.fixture(scope="module")
def browser_of():
    """Return a function that gives a browser, with graphics drawn in software only where a page needs them.

    With them every page of text is laid out by that renderer too, at several times the cost.
    """
    if browser_command() is None:
        pytest.skip("NO BROWSER: pages are not tested; install Debian's package chromium")
    return lambda drawn: browser((*(FLAGS if drawn else ("--no-sandbox",)), "--headless=new"))


@pytest.fixture(scope="module")
def scene():
    return load(ROOT, scenes=["still-life"]).scenes["still-life"]


@pytest.fixture(scope="module")
def page_file(scene, tmp_path_factory):
    poster = ROOT / "docs/still-life.png"
    return write_double(tmp_path_factory.mktemp("viewer") / "viewer.html", header_of(scene), poster)


@pytest.fixture(scope="module")
def drawn_page_file(tmp_path_factory):
    """A page of the product's own renderer: two rooms, a lamp, and a lesson that goes through both."""
    folder = tmp_path_factory.mktemp("drawn")
    lesson = {"title": {"en": "Two rooms"}, "steps": [
        {"title": {"en": "Here"}, "text": {"en": "Move it."}, "light": {"illuminant": {"name": "A"}},
         "compare": {"mode": "wipe", "light": {"illuminant": {"name": "FL11"}}}},
        {"title": {"en": "Below"}, "text": {"en": "Darker."}, "light": {"environment": "cellar"},
         "compare": {"mode": "metamerism", "light": {"illuminant": {"name": "D65"}}}},
    ]}  # fmt: skip
    data = page_data(sources(folder, room(), lesson=lesson, further=(room(sun=5.0, level=0.2),)))
    file = folder / "viewer.html"
    write_page(file, "Two rooms", data.payload({}))
    return file


@pytest.fixture(scope="module")
def context_of(browser_of):
    """Return a function that gives the browser's context of some options, in which pages keep nothing."""
    contexts = {}

    def found(script, drawn=False, **options):
        key = json.dumps([script, drawn, options], sort_keys=True)
        if key not in contexts:
            contexts[key] = browser_of(drawn).new_context(offline=True, **options)
            contexts[key].set_default_timeout(patience.LONG_MS)
            if script:
                contexts[key].add_init_script(script)
        return contexts[key]

    yield found
    for context in contexts.values():
        context.close()


@pytest.fixture(scope="module")
def idle_pages() -> dict[object, list]:
    """Pages that a test has left, by context: a new page would cost a process of the browser's."""
    return defaultdict(list)


@pytest.fixture(scope="module")
def open_page(context_of, page_file, idle_pages):
    """Return a function that opens the page; it is closed with `Visit.leave`."""

    def found(hash_="", script="", ready=True, file=page_file, drawn=False, **given) -> Visit:
        context = context_of(script, drawn=drawn or file != page_file, **{**_USUAL, **given})
        opened = Visit(idle_pages[context].pop() if idle_pages[context] else context.new_page())
        opened.idle = idle_pages[context]
        opened.listeners = {
            "console": lambda message: _note_message(message.text, opened),
            "pageerror": lambda error: opened.complaints.append(str(error)),
            "request": lambda asked: _note_request(asked, opened, file),
        }
        for event, listener in opened.listeners.items():
            opened.page.on(event, listener)
        opened.page.bring_to_front()
        opened.page.goto(file.as_uri() + hash_)
        if ready:
            opened.page.wait_for_selector("body[data-ready]")
        return opened

    return found


@pytest.fixture
def visit(open_page):
    """Return a function that opens the page; at the end nothing may have been complained about."""
    visits = []

    def opened(*place, **given) -> Visit:
        visits.append(open_page(*place, **given))
        return visits[-1]

    yield opened
    for one in visits:
        one.leave()
    assert [one.complaints for one in visits] == [[] for _ in visits]


@pytest.fixture(scope="module")
def untouched(open_page):
    """The page as it opens, for tests that ask it something and change nothing: a page costs more than what they do."""
    one = open_page()
    yield one
    one.leave()
    assert one.complaints == []


@pytest.fixture(scope="module")
def opening_state(untouched) -> dict:
    """State in which the page opens."""
    return untouched.state()


def _note_message(text: str, opened: Visit) -> None:
    if is_told_by_page(text):
        opened.complaints.append(text)


def _note_request(request, opened: Visit, page_file) -> None:
    own = (page_file.as_uri(), "data:", "blob:")
    if not request.url.startswith(own):
        opened.complaints.append(f"asked for {request.url}")
