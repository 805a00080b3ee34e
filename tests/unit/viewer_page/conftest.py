"""A browser without a network, and the page open in it."""

from dataclasses import dataclass, field

import pytest
from definitions import ROOT, load
from double_pages import header_of, write_double

from irodori.viewer.browser import browser_command, client


@dataclass
class Visit:
    """An open page, with all that went wrong in it."""

    page: object
    complaints: list[str] = field(default_factory=list)

    def state(self) -> dict:
        return self.page.evaluate("Irodori.page()")

    def settled(self) -> dict:
        """Wait until the page has come to rest, and return its state."""
        self.page.evaluate(
            "async () => { while (!Irodori.pace().atRest) await new Promise((r) => setTimeout(r, 50)); }"
        )
        return self.state()

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


@pytest.fixture(scope="session")
def browser():
    command = browser_command()
    if command is None:
        pytest.skip("NO BROWSER: pages are not tested; install Debian's package chromium")
    chromium = client().chromium.launch(executable_path=command, args=["--no-sandbox", "--headless=new"])
    yield chromium
    chromium.close()


@pytest.fixture(scope="session")
def scene():
    return load(ROOT, scenes=["still-life"]).scenes["still-life"]


@pytest.fixture(scope="session")
def page_file(scene, tmp_path_factory):
    poster = ROOT / "docs/still-life.png"
    return write_double(tmp_path_factory.mktemp("viewer") / "viewer.html", header_of(scene), poster)


@pytest.fixture
def visit(browser, page_file):
    """Return a function that opens the page; at the end nothing may have been complained about."""
    contexts, visits = [], []

    def open_page(hash_="", script="", ready=True, **given) -> Visit:
        options = {"viewport": {"width": 1280, "height": 800}, "locale": "en", "reduced_motion": "reduce", **given}
        context = browser.new_context(offline=True, **options)
        contexts.append(context)
        if script:
            context.add_init_script(script)
        context.set_default_timeout(10_000)
        opened = Visit(context.new_page())
        visits.append(opened)
        opened.page.on("console", lambda message: opened.complaints.append(message.text))
        opened.page.on("pageerror", lambda error: opened.complaints.append(str(error)))
        opened.page.on("request", lambda asked: _note_request(asked, opened, page_file))
        opened.page.goto(page_file.as_uri() + hash_)
        if ready:
            opened.page.wait_for_selector("body[data-ready]")
        return opened

    yield open_page
    for context in contexts:
        context.close()
    assert [one.complaints for one in visits] == [[] for _ in visits]


def _note_request(request, opened: Visit, page_file) -> None:
    own = (page_file.as_uri(), "data:", "blob:")
    if not request.url.startswith(own):
        opened.complaints.append(f"asked for {request.url}")
