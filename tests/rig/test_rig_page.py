"""The page at the rig: a session driven from a browser, and requests that must move nothing.

The session runs in a thread; the browser, and those who mean harm, speak to it over the line.
"""

import csv
import http.client
import io
import json
import signal
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import patience
import pytest
from PIL import Image
from sessions import QuickCamera, assert_whole, contents, shots

from irodori.capture.dialogue import Action, Dialogue, Refused, RetakeLast, State
from irodori.capture.journal import Journal
from irodori.capture.operator import OperatorAbort, PromptOperator
from irodori.capture.page_server import Address, served
from irodori.capture.session import Session, take_stock
from irodori.core.errors import InputError
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.preview import preview_of
from irodori.viewer.browser import browser, browser_command

PHONE = {"width": 390, "height": 844}


class Watched(QuickCamera):
    """Waits before each photograph until it may be taken; delivers its last file again where told to."""

    def __init__(self) -> None:
        super().__init__()
        self.may, self.free, self.again = threading.Semaphore(0), False, False

    def capture(self, shot, path):
        if not self.free:
            assert self.may.acquire(timeout=patience.LONG_S)
        super().capture(replace(shot, file=f"{len(self.taken)}"), path)  # no two are alike
        if self.again:
            self.again = False
            path.write_bytes(self.last)
        self.last = path.read_bytes()


class Sitting:
    """A session with its page, in a thread."""

    def __init__(self, folder, planned, rig=None, address: str = "127.0.0.1") -> None:
        self.folder, self.planned, self.eye, self.ended = folder, planned, Watched(), None
        self.rig, self.address = rig, address
        self.dialogue, self.server = Dialogue(), None
        self._up = threading.Event()
        self._thread = threading.Thread(target=self._hold, daemon=True)

    def _hold(self) -> None:
        journal = Journal(self.folder / "captures.csv")
        tally = take_stock(journal, self.planned)
        try:
            with served(self.dialogue, Address(self.address, 0), "vase") as self.server:
                self._up.set()
                operator = PromptOperator(self.dialogue)
                how = {"dialogue": self.dialogue, "left_s": lambda left: 60.0 * len(left)}
                self.ended = Session(self.eye, operator, journal, self.rig, tally, **how).run(self.planned, "vase")
        except Exception as error:
            self.ended = error

    def __enter__(self):
        self._thread.start()
        assert self._up.wait(patience.LONG_S)
        return self

    def __exit__(self, *_) -> None:
        self.eye.free = True
        self.eye.may.release()
        if self.ended is None:
            self.dialogue.end("The test ends.")
        self._thread.join(0.0 if self.ended is None else patience.LONG_S)

    def state(self) -> State:
        return self.dialogue.view.state

    def comes_to(self, state: State) -> None:
        patience.until(lambda: self.state() is state)

    def send(self, method="POST", path="/act", body=None, **headers) -> tuple[int, str]:
        """Send a request that is right but for what is given; return status and answer."""
        host, cookie = self.server.hosts[0], f"{self.server.cookie}={self.server.token}"
        usual = {"Host": host, "Origin": f"http://{host}", "Cookie": cookie, "Content-Type": "application/json"}
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        asked = http.client.HTTPConnection(*self.server.server_address[:2], timeout=patience.LONG_S)
        text = json.dumps({"action": "done", "turn": self.dialogue.view.turn} if body is None else body)
        all_of = {name: value for name, value in (usual | given).items() if value is not None}
        try:
            asked.request(method, path, text if method == "POST" else None, all_of)
            answer = asked.getresponse()
            return answer.status, answer.read().decode("utf-8", errors="replace")
        finally:
            asked.close()


@pytest.fixture
def sitting(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with Sitting(tmp_path, shots(4)) as found:
        yield found


# ---- requests that move nothing

REFUSED = {
    "wrong token": (403, {"Cookie": "irodori-0=guessed"}),
    "no token": (403, {"Cookie": None}),
    "another host's name, as of DNS rebinding": (421, {"Host": "evil.example"}),
    "another page": (403, {"Origin": "http://evil.example"}),
    "no page": (403, {"Origin": None}),
    "a form": (415, {"Content_Type": "text/plain"}),
    "GET": (405, {"method": "GET"}),
    "another method": (501, {"method": "PUT"}),
    "another path": (404, {"path": "/act/../stop"}),
    "oversize": (413, {"body": {"action": "done", "reason": "x" * 5000}}),
    "no action": (400, {"body": {"action": "home", "turn": 1}}),
    "no object": (400, {"body": [["action", "done"]]}),
    "nested": (400, {"body": {"action": {"action": "done"}}}),
    "a turn that is gone": (409, {"body": {"action": "done", "turn": 0}}),
    "no turn": (409, {"body": {"action": "done"}}),
    "not possible now": (409, {"body": {"action": "pause"}}),
    "keep what is not in doubt": (409, {"body": {"action": "keep", "turn": 2, "reason": "good"}}),
    "endless": (411, {"Transfer_Encoding": "chunked"}),
}


def test_a_request_that_is_refused_moves_nothing_and_answers_one_sentence(sitting):
    """Every one while the person is asked for a step, where a single action that slips through would take a picture."""
    sitting.comes_to(State.STEP)
    before = sitting.dialogue.view
    for name, (status, wrong) in REFUSED.items():
        found, said = sitting.send(**wrong)
        assert found == status, (name, found, said)
        assert 10 < len(said) < 200 and said.count("\n") == 1 and "<" not in said, (name, said)
        assert sitting.dialogue.view == before, name
    for path in ("/../captures.csv", "/page/../page_server.py", "/%2e%2e/captures.csv", "/picture/1", "/picture/../x"):
        assert sitting.send("GET", path)[0] == 404, path
    for cookie, path in ((None, "/"), (None, "/news"), (None, "/?token=guessed"), ("irodori-0=x", "/page.js")):
        assert sitting.send("GET", path, Cookie=cookie)[0] == 403, path
    assert sitting.send("GET", "/", Host="evil.example")[0] == 421
    assert sitting.eye.taken == [] and sitting.dialogue.view == before
    # The same request with nothing wrong about it moves on, once.
    right = {"action": "done", "turn": before.turn}
    assert sitting.send(body=right) == (200, "Done.")
    assert sitting.send(body=right)[0] == 409
    sitting.eye.may.release()
    sitting.comes_to(State.STEP)
    assert len(sitting.eye.taken) == 1
    assert sitting.send(body={"action": "stop"})[0] == 200
    patience.until(lambda: sitting.ended is not None)
    assert isinstance(sitting.ended, OperatorAbort) and len(sitting.eye.taken) == 1


def test_a_stop_from_the_page_ends_the_photograph_under_way_as_ctrl_c_does(tmp_path):
    dialogue = Dialogue()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt), served(dialogue, Address(port=0), "vase"):
        dialogue.working("Keep clear.", 0, 1, 1.0)
        threading.Timer(0.1, dialogue.act, [Action.STOP]).start()
        time.sleep(patience.LONG_S)
    assert time.monotonic() - begun < patience.LONG_S
    assert dialogue.view.state is State.ENDED and "stands still" in dialogue.view.words
    assert signal.getsignal(signal.SIGUSR1) is signal.SIG_DFL


def test_what_is_wanted_while_the_session_works_means_the_photograph_that_was_seen(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    dialogue = Dialogue(watched=True)
    dialogue.stored("a.dng")
    dialogue.working("Keep clear.", 1, 3, 2.0)
    dialogue.act(Action.RETAKE_LAST, dialogue.view.turn)
    with pytest.raises(Refused, match="retake last first"):
        dialogue.act(Action.PAUSE)

    # Meanwhile the next one comes, is doubted, taken again and stored.
    def answer() -> None:
        patience.until(lambda: dialogue.view.state is State.DOUBT)
        dialogue.act(Action.RETAKE, dialogue.view.turn)

    answers = threading.Thread(target=answer)
    answers.start()
    assert dialogue.ask(State.DOUBT, "b.dng: blown") == ""
    answers.join()
    dialogue.stored("b.dng")
    with pytest.raises(RetakeLast) as wish:
        dialogue.between_shots()
    assert wish.value.file == "a.dng"
    dialogue.between_shots()


@pytest.mark.parametrize(
    "host",
    ["0.0.0.0", "::", "rig.example", "224.0.0.1", "203.0.113.1", "ff02::1", "2001:db8::1", "fe80::1%lo",
     "::ffff:127.0.0.1", "[::1]"],
)  # fmt: skip
def test_an_address_that_is_not_one_of_this_computer_is_refused(host):
    with pytest.raises(InputError, match=r"--address.*accepted: .*address of this computer"), \
            served(Dialogue(), Address(host, 0), "vase"):  # fmt: skip
        pass


def test_a_single_blown_pixel_of_a_large_picture_is_marked_and_counted():
    values = np.full((400, 4000), 600, dtype=np.uint16)  # three superpixels become one
    values[:, 2000:] = 600 + 8000
    values[6, 3001] = 16383
    black, white = np.full((2, 2), 600.0, np.float32), np.full((2, 2), 16383.0, np.float32)
    preview = preview_of(Mosaic(values, "RGGB", black, white, 15783.0, 0.02, 100.0, 8.0, 0))
    marks = np.asarray(Image.open(io.BytesIO(preview.overlay)).convert("RGBA"))
    picture = np.asarray(Image.open(io.BytesIO(preview.jpeg)))
    assert marks.shape == (66, 666, 4) and picture.shape == (66, 666, 3)
    assert np.argwhere((marks[..., 0] > 200) & (marks[..., 3] > 0)).tolist() == [[1, 500]]
    dark = (marks[..., 2] > 200) & (marks[..., 3] > 0)
    assert dark[:, :333].all() and not dark[:, 334:].any()
    # Half the range is 188 of sRGB.
    assert abs(float(picture[:, 340:490].mean()) - 188.6) < 3.0 and picture[:, :320].max() < 5
    assert preview.histogram.sum(axis=1) == pytest.approx(1.0) and preview.histogram[1, -1] > 0.0
    assert preview.histogram[:, 0] == pytest.approx(0.5, abs=0.01) and preview.histogram[0, -1] == 0.0


# ---- in a browser


@pytest.fixture
def visit():
    """Return a function that opens an address on a phone; at the end nothing may have been complained about."""
    if browser_command() is None:
        pytest.skip("NO BROWSER: pages are not tested; install Debian's package chromium")
    contexts, complaints = [], []

    def open_page(url, size=PHONE):
        contexts.append(browser(("--no-sandbox",)).new_context(viewport=size))
        page = contexts[-1].new_page()
        page.set_default_timeout(patience.LONG_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda message: complaints.append(message.text))
        page.goto(url)
        return page

    yield open_page
    for context in contexts:
        context.close()
    # A line that is lost, another token and an action that is not possible are told by the browser as well.
    assert [text for text in complaints if "net::ERR" not in text and "409" not in text and "403" not in text] == []


def says(page, words: str) -> None:
    page.get_by_role("heading", level=1).filter(has_text=words).wait_for()


def pictured(page, width_px: int, name: str = "picture") -> None:
    """Wait until a picture of the page is there, of this width.

    Asked again from here: the page's own rules forbid the text that Playwright would evaluate in it at every frame.
    """
    asked = f"document.getElementById('{name}').naturalWidth"
    patience.until(lambda: page.evaluate(asked) == width_px, lambda: f"{name}: {page.evaluate(asked)} pixels wide")


def press(page, button: str) -> None:
    page.get_by_role("button", name=button, exact=True).click()


def possible(page) -> list[str]:
    return [b.inner_text() for b in page.locator("nav button:visible").all() if b.is_enabled()]


def test_nothing_can_be_pressed_before_the_page_knows_what_the_session_does(sitting, visit):
    page = visit(sitting.server.url)
    says(page, "Take the lens cap off")
    assert "Done" in possible(page)
    page.route("**/news", lambda route: route.abort())
    page.reload()
    says(page, "Waiting for the session.")
    assert possible(page) == []
    page.unroute("**/news")
    page.reload()
    says(page, "Take the lens cap off")
    assert "Done" in possible(page)


def test_a_picture_is_still_there_for_a_page_that_asks_when_the_next_is_shown(sitting):
    """A page asks for what it has heard of: where a camera goes on without a person, the next comes in between."""
    sitting.eye.free = True
    for _ in range(2):
        sitting.comes_to(State.STEP)
        sitting.dialogue.act(Action.DONE, sitting.dialogue.view.turn)  # and no longer asks, at once
    sitting.comes_to(State.STEP)
    shown = sitting.dialogue.view.shown
    for number in range(1, 8):
        sitting.server.tell(replace(shown, number=number))
    sitting.server.tell(None)
    for number, status in ((7, 200), (4, 200), (3, 404), (8, 404), (0, 404), ("07", 404), ("9" * 5000, 404)):
        assert {sitting.send("GET", f"/{kind}/{number}")[0] for kind in ("picture", "overlay")} == {status}, number


@pytest.mark.heavy
def test_a_session_is_driven_from_a_phone(sitting, visit):
    page = visit(sitting.server.url)
    says(page, "Take the lens cap off and put the object in place")
    assert sitting.server.token not in page.url and possible(page) == ["Done", "Test exposure", "Stop"]
    assert "0 of 4, about 4 min left" in page.locator("header").inner_text()
    # Nothing is cut off on a phone, and what is pressed is as large as a finger.
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    for box in [button.bounding_box() for button in page.locator("nav button:visible").all()]:
        assert box["height"] >= 44 and box["width"] >= 44 and box["y"] + box["height"] <= PHONE["height"]

    # A test exposure is shown and leaves nothing.
    before = contents(sitting.folder)
    sitting.eye.may.release()
    press(page, "Test exposure")
    page.get_by_text("Test exposure, not kept").wait_for()
    says(page, "Take the lens cap off")
    assert contents(sitting.folder) == before
    inked = (
        "[...document.getElementById('histogram').getContext('2d').getImageData(0, 0, 640, 160).data].some((v) => v)"
    )
    assert page.evaluate(inked)

    # A photograph with its picture; a second browser sees the same, and of two answers one counts.
    press(page, "Done")
    says(page, "photograph 1 of 4 is being taken")
    assert possible(page) == ["Pause", "Stop"]
    press(page, "Pause")
    page.get_by_text("As soon as this photograph is stored: pause.").wait_for()
    sitting.eye.may.release()
    says(page, "Paused: nothing moves until you go on")
    assert len(sitting.eye.taken) == 2
    pictured(page, 16)
    pictured(page, 16, "overlay")
    assert page.locator("#file").inner_text() == sitting.planned[0].file
    assert "Sound: brightest hundredth at" in page.locator("#finding").inner_text()
    other = visit(sitting.server.url)
    says(other, "Paused")
    assert possible(other) == possible(page) == ["Go on", "Retake last", "Test exposure", "Stop"]
    assert other.locator("#file").inner_text() == sitting.planned[0].file

    # Retake last: both are kept, the table names the newer.
    first = (sitting.folder / sitting.planned[0].file).read_bytes()
    press(other, "Retake last")
    says(page, "a photograph is taken again")
    sitting.eye.may.release()
    says(page, "Put the comb filter in")
    page.reload()
    says(page, "Put the comb filter in")
    retired = list(csv.DictReader((sitting.folder / "captures-retired.csv").read_text().splitlines()))
    assert [row["file"].split("-retaken-")[0] for row in retired] == [sitting.planned[0].file.removesuffix(".dng")]
    assert (sitting.folder / retired[0]["file"]).read_bytes() == first
    assert Journal(sitting.folder / "captures.csv").missing(sitting.planned) == sitting.planned[1:]

    # What is in doubt is said with its question; a reason keeps it, which nothing else does.
    sitting.eye.again = True
    press(page, "Done")
    sitting.eye.may.release()
    says(page, "was it delivered twice?")
    assert possible(page) == ["Keep it", "Retake this", "Test exposure", "Stop"]
    press(page, "Keep it")
    page.get_by_text("say why it is right").wait_for()
    sitting.eye.may.release()
    press(page, "Retake this")

    # The line is lost and found again.
    says(page, "Take the comb filter out")
    page.context.set_offline(True)
    press(page, "Done")
    page.get_by_text("The session was not reached: nothing was done.").wait_for()
    assert sitting.state() is State.STEP
    page.context.set_offline(False)
    refuse, cut = (lambda route: route.fulfill(status=403)), (lambda route: route.abort())
    for answer, words in ((refuse, "restarted: open the address"), (cut, "what is shown may be old")):
        page.route("**/news", answer)
        page.reload()
        page.locator("#lost").filter(has_text=words).wait_for()
        page.unroute("**/news")
    says(page, "Take the comb filter out")
    page.locator("#lost").wait_for(state="hidden")
    sitting.eye.free = True
    press(page, "Done")
    says(page, "Put the comb filter in")
    press(page, "Done")

    # At the end the last one can be taken again; then all browsers hear that it is over.
    says(page, "All 4 photographs are there")
    press(page, "Retake last")
    patience.until(lambda: len(sitting.eye.taken) == 8)
    says(page, "All 4 photographs are there")
    press(other, "Finish")
    for each in (page, other):
        says(each, "The session is complete.")
        assert possible(each) == [] and not each.locator("#lost").is_visible()
    patience.until(lambda: sitting.ended is not None)
    assert (sitting.ended.taken, sitting.ended.retaken, sitting.ended.doubted) == (6, 2, 1)
    (sitting.folder / "captures-retired.csv").unlink()
    assert_whole(sitting.folder, sitting.planned)


def test_a_session_that_was_stopped_is_gone_on_with(tmp_path, monkeypatch, visit):
    monkeypatch.setattr(sys, "stdin", None)
    planned = shots(2)
    with Sitting(tmp_path, planned) as first:
        first.eye.free = True
        page = visit(first.server.url)
        says(page, "Take the lens cap off")
        press(page, "Done")
        says(page, "Put the comb filter in")
        first.send(body={"action": "stop"})
        says(page, "stopped by the person at the bench")
        patience.until(lambda: first.ended is not None)
    with Sitting(tmp_path, planned) as second:
        second.eye.free = True
        page.goto(second.server.url)
        says(page, "Take the lens cap off and put the object in place, set the light to")
        assert "1 of 2" in page.locator("header").inner_text()
        press(page, "Done")
        says(page, "All 2 photographs are there")
        press(page, "Finish")
        patience.until(lambda: second.ended is not None)
    assert second.ended.taken == 1
    assert_whole(tmp_path, planned)
