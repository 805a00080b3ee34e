"""The page at the bench: on a small phone, for everyone, over IPv6, with a rig that moves or is held, and attacked."""

import http.client
import ipaddress
import json
import os
import pty
import socket
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources

import patience
import psutil
import pytest
from made import made
from sessions import assert_whole, definitions, shots
from test_rig_page import Sitting, pictured, possible, press, says, sitting, visit  # noqa: F401 - fixtures

from irodori.capture.dialogue import OFFERS, Action, Dialogue, RetakeLast, State
from irodori.capture.operator import OperatorAbort
from irodori.capture.page_server import Address, served
from irodori.capture.rig.connect import open_rig
from irodori.config.capture_table import Pose, Shot
from irodori.config.models import Rig

SMALL = {"width": 360, "height": 740}
FINGER_PX = 44


# ---- everyone, on any phone


def check_page(page) -> None:
    """Fail where something scrolls sideways, a control is smaller than a finger or out of reach, or axe complains."""
    assert page.evaluate("document.documentElement.scrollWidth") <= SMALL["width"]
    for button in page.locator("nav button:visible").all():
        box = button.bounding_box()
        assert box["height"] >= FINGER_PX and box["width"] >= FINGER_PX, button.inner_text()
        assert box["x"] >= 0 and box["x"] + box["width"] <= SMALL["width"]
        assert box["y"] >= 0 and box["y"] + box["height"] <= SMALL["height"], button.inner_text()
    for control in page.locator("label:visible").all():
        assert control.bounding_box()["height"] >= FINGER_PX
    if not page.evaluate("'axe' in window"):
        page.evaluate(resources.files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8"))
    found = page.evaluate("async () => (await axe.run(document, {resultTypes: ['violations']})).violations")
    assert [f"{one['id']}: {node['html'][:120]}" for one in found for node in one["nodes"]] == []


@pytest.mark.heavy
def test_on_a_small_phone_nothing_is_cut_off_and_axe_finds_nothing_in_any_state(sitting, visit):  # noqa: F811
    pytest.importorskip("axe_playwright_python", reason="axe is not installed: no page was checked for everyone's use")
    page = visit(sitting.server.url, SMALL)
    says(page, "Take the lens cap off")
    check_page(page)
    press(page, "Done")
    says(page, "photograph 1 of 4 is being taken")
    check_page(page)
    press(page, "Pause")
    # A pause that comes when the photograph is stored already finds the session at its next question.
    page.get_by_text("As soon as this photograph is stored: pause.").wait_for()
    sitting.eye.may.release()
    says(page, "Paused")
    pictured(page, 16)
    check_page(page)
    press(page, "Go on")
    says(page, "Put the comb filter in")
    sitting.eye.again = True
    press(page, "Done")
    sitting.eye.may.release()
    says(page, "was it delivered twice?")
    page.get_by_label("Why it is right").fill("a" * 200)
    check_page(page)
    sitting.eye.free = True
    sitting.eye.may.release()
    press(page, "Retake this")
    for words in ("Take the comb filter out", "Put the comb filter in"):
        says(page, words)
        press(page, "Done")
    says(page, "All 4 photographs are there")
    check_page(page)
    page.context.set_offline(True)
    page.locator("#lost").evaluate("(one) => { one.hidden = false; }")
    check_page(page)
    page.context.set_offline(False)
    page.reload()
    press(page, "Finish")
    says(page, "The session is complete.")
    check_page(page)


# ---- addresses


def addresses_v6() -> list[str]:
    """Return an IPv6 address of this computer that other computers may reach, none where there is none."""
    found = (one.address for of in psutil.net_if_addrs().values() for one in of if one.family == socket.AF_INET6)
    return [text for text in found if "%" not in text and not ipaddress.ip_address(text).is_loopback][:1]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("address", ["::1", "0:0:0:0:0:0:0:1", "another"])
def test_a_session_is_held_over_ipv6(tmp_path, monkeypatch, visit, address):  # noqa: F811
    monkeypatch.setattr(sys, "stdin", None)
    if address == "another":
        address = next(iter(addresses_v6()), "") or pytest.skip("no IPv6 address but that of the loopback")
    planned = shots(1)
    try:
        socket.create_server((address, 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this computer has no IPv6")
    with Sitting(tmp_path, planned, address=address) as one:
        one.eye.free = True
        assert one.server.url.startswith(f"http://[{ipaddress.ip_address(address)}]:")
        if not ipaddress.ip_address(address).is_loopback:
            assert len(one.server.hosts) == 1, "no other name reaches it"
        assert one.send(Cookie=None)[0] == 403 and one.send(Host="localhost:1")[0] == 421
        assert one.send("GET", "/?token=guessed", Cookie=None)[0] == 403 and one.eye.taken == []
        page = visit(one.server.url)
        says(page, "Take the lens cap off")
        assert one.server.token not in page.url
        press(page, "Done")
        says(page, "All 1 photographs are there")
        press(page, "Finish")
        says(page, "The session is complete.")
        patience.until(lambda: one.ended is not None)
    assert_whole(tmp_path, planned)


# ---- a rig that moves, or is held


@pytest.fixture
def rig():
    with open_rig(made(Rig, definitions(motion=True)[2])) as opened:
        opened.home()
        opened.move({"camera_deg": 10.0, "turn_deg": 0.0})
        yield opened


@pytest.fixture
def driven(tmp_path, monkeypatch, rig):
    """A session that waits for its first step, of two photographs 120 degrees apart."""
    monkeypatch.setattr(sys, "stdin", None)
    planned = [Shot(f"{angle}.dng", "object", Pose(45.0, angle), "out", 0.02) for angle in (10.0, 130.0)]
    with Sitting(tmp_path, planned, rig) as found:
        found.eye.free = True
        found.comes_to(State.STEP)
        yield found


def moving(rig) -> bool:
    return rig.simulator.snapshot()["moving"]


def refused(sitting, *actions: str) -> None:  # noqa: F811
    """Fail unless each of the actions is refused and changes nothing."""
    before = sitting.dialogue.view
    for action in actions:
        status, said = sitting.send(body={"action": action, "turn": before.turn, "reason": "so"})
        assert status == 409 and "is not possible now" in said, action
    assert sitting.dialogue.view == before


def test_a_feed_hold_is_ended_on_the_page_and_by_nothing_else(driven, rig, visit):  # noqa: F811
    page = visit(driven.server.url)
    rig.simulator.fault("move 0.5 hold")
    press(page, "Done")
    says(page, "Clear the cause of the feed hold: the rig is held at camera_deg")
    assert possible(page) == ["Done", "Stop"] and driven.state() is State.HELD
    held = rig.simulator.true_position()
    refused(driven, "pause", "retake", "retake-last", "test", "keep")
    assert driven.send(body={"action": "done", "turn": driven.dialogue.view.turn - 1})[0] == 409
    assert rig.simulator.true_position() == held and not moving(rig) and len(driven.eye.taken) == 1
    press(page, "Done")
    says(page, "All 2 photographs are there")
    assert len(driven.eye.taken) == 2 and rig.position()["camera_deg"] == pytest.approx(130.0, abs=0.01)
    press(page, "Finish")
    patience.until(lambda: driven.ended is not None)
    assert_whole(driven.folder, driven.planned)


def test_a_session_is_stopped_in_a_feed_hold(driven, rig, visit):  # noqa: F811
    page = visit(driven.server.url)
    rig.simulator.fault("move 0.5 hold")
    press(page, "Done")
    says(page, "Clear the cause of the feed hold")
    held = rig.simulator.true_position()
    press(page, "Stop")
    says(page, "stopped by the person at the bench")
    patience.until(lambda: driven.ended is not None)
    assert isinstance(driven.ended, OperatorAbort) and len(driven.eye.taken) == 1
    assert rig.simulator.true_position() == held and rig.status().state == "idle" and rig.status().homed


def test_what_is_pressed_during_a_move_waits_for_its_photograph(driven, rig, visit):  # noqa: F811
    page = visit(driven.server.url)
    rig.simulator.pace(1.0)  # six seconds of a move, which a browser on a busy machine may take to say that it began
    driven.eye.free = False
    driven.eye.may.release()
    press(page, "Done")
    says(page, "photograph 2 of 2 is being taken")
    patience.until(lambda: moving(rig))
    refused(driven, "done", "test", "retake", "keep")
    press(page, "Pause")
    page.get_by_text("As soon as this photograph is stored: pause.").wait_for()
    # A second wish is refused, until the first is done.
    assert driven.send(body={"action": "retake-last", "turn": driven.dialogue.view.turn})[0] == 409
    rig.simulator.pace(200.0)
    patience.until(lambda: not moving(rig))
    assert rig.position()["camera_deg"] == pytest.approx(130.0, abs=0.01)
    driven.eye.may.release()
    says(page, "Paused: nothing moves until you go on")
    assert len(driven.eye.taken) == 2
    press(page, "Go on")
    says(page, "All 2 photographs are there")


def test_stop_on_the_page_brings_a_moving_axis_to_rest(rig):
    """In the main thread, where the command holds its session."""
    dialogue, stops = Dialogue(), []

    def stop(server) -> None:
        patience.until(lambda: 20.0 < 141.0 + rig.simulator.true_position()["X"] < 120.0)
        stops.append(sent(server, {"action": "stop"}))

    with pytest.raises(KeyboardInterrupt), served(dialogue, Address(port=0), "vase") as server:
        dialogue.working("Keep clear.", 0, 1, 1.0)
        rig.simulator.pace(1.0)
        threading.Thread(target=stop, args=(server,), daemon=True).start()
        rig.move({"camera_deg": 140.0})
    assert stops == [200] and not moving(rig)
    status = rig.status()
    assert 20.0 < status.position_deg["camera_deg"] < 135.0 and status.homed and status.state == "idle"


def sent(server, body: dict, **headers) -> int:
    """Send an action with the session's token; return the status of the answer."""
    host = server.hosts[0]
    usual = {"Host": host, "Origin": f"http://{host}", "Cookie": f"{server.cookie}={server.token}"}
    asked = http.client.HTTPConnection(*server.server_address[:2], timeout=patience.LONG_S)
    asked.request("POST", "/act", json.dumps(body), usual | {"Content-Type": "application/json"} | headers)
    try:
        return asked.getresponse().status
    finally:
        asked.close()


# ---- several clients, and hostile ones


def test_of_many_that_answer_one_question_at_once_one_is_heard(sitting):  # noqa: F811
    sitting.comes_to(State.STEP)
    body, found = {"action": "done", "turn": sitting.dialogue.view.turn}, []
    gate = threading.Barrier(12)

    def answer() -> None:
        gate.wait(patience.LONG_S)
        found.append(sent(sitting.server, body))

    clients = [threading.Thread(target=answer) for _ in range(12)]
    for client in clients:
        client.start()
    for client in clients:
        client.join(patience.LONG_S)
    assert sorted(found) == [200] + 11 * [409]
    sitting.eye.may.release()
    sitting.comes_to(State.STEP)
    assert len(sitting.eye.taken) == 1


_FOREIGN = """<!DOCTYPE html><title>waiting</title>
<form id="form" method="post" enctype="text/plain" action="TARGET/act" target="frame">
<input name='{"action": "done", "turn": TURN, "x": "' value='"}'></form>
<iframe name="frame"></iframe><iframe id="inside" src="TARGET/"></iframe><img id="image" src="TARGET/picture/1">
<script>
const all = [];
for (const [mode, kind] of [["cors", "application/json"], ["no-cors", "text/plain"], ["cors", "text/plain"]])
  all.push(fetch("TARGET/act", {method: "POST", mode, credentials: "include", headers: {"Content-Type": kind},
    body: JSON.stringify({action: "done", turn: TURN})}).then((answer) => answer.text(), () => "refused"));
for (const path of ["/", "/news", "/page.js"])
  all.push(fetch("TARGET" + path, {credentials: "include"}).then((answer) => answer.text(), () => "refused"));
document.getElementById("form").submit();
Promise.all(all).then((said) => { window.said = said; document.title = "done"; });
</script>"""


class _Foreign(BaseHTTPRequestHandler):
    text = ""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.server.text.encode())

    def log_message(self, format, *arguments) -> None:
        pass


def test_another_page_in_the_same_browser_moves_nothing_and_reads_nothing(sitting, visit):  # noqa: F811
    """On another port of the same computer: a browser sends the session's cookie along with its requests."""
    page = visit(sitting.server.url)
    says(page, "Take the lens cap off")
    before = sitting.dialogue.view
    foreign = ThreadingHTTPServer(("127.0.0.1", 0), _Foreign)
    target = f"http://{sitting.server.hosts[0]}"
    foreign.text = _FOREIGN.replace("TARGET", target).replace("TURN", str(before.turn))
    threading.Thread(target=foreign.serve_forever, daemon=True).start()
    try:
        other = page.context.new_page()
        other.goto(f"http://127.0.0.1:{foreign.server_address[1]}/")
        other.wait_for_function("document.title === 'done'")
        # What is not to be read is empty; the request of the form is answered in its frame, by a refusal.
        assert set(other.evaluate("said")) <= {"refused", ""}
        assert other.evaluate("document.getElementById('image').naturalWidth") == 0
        framed = [frame for frame in other.frames if frame != other.main_frame]
        assert not any("Take the lens cap off" in frame.content() for frame in framed)
        assert sitting.dialogue.view == before and sitting.eye.taken == []
    finally:
        foreign.shutdown()
        foreign.server_close()


@pytest.mark.heavy
def test_what_never_ends_or_says_it_is_huge_is_not_waited_for(sitting):  # noqa: F811
    sitting.comes_to(State.STEP)
    before, host = sitting.dialogue.view, sitting.server.hosts[0]
    start = f"POST /act HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nContent-Type: application/json\r\n"
    start += f"Cookie: {sitting.server.cookie}={sitting.server.token}\r\n"
    body = json.dumps({"action": "done", "turn": before.turn})
    requests = {
        "no end of its head": start,
        "half of what it announced": f"{start}Content-Length: {len(body)}\r\n\r\n{body[:-1]}",
        "a terabyte": f"{start}Content-Length: {10**12}\r\n\r\n",
        "less than nothing": f"{start}Content-Length: -1\r\n\r\n{body}",
        "two lengths": f"{start}Content-Length: 2\r\nContent-Length: {len(body)}\r\n\r\n{{}}{body}",
        "two hosts": f"{start}Host: evil.example\r\nContent-Length: {len(body)}\r\n\r\n{body}",
        "two origins": f"{start}Origin: http://evil.example\r\nContent-Length: {len(body)}\r\n\r\n{body}",
        "a head without end": start + "X: " + "x" * 70_000,
        "no HTTP": body,
    }
    for what, text in requests.items():
        with socket.create_connection(sitting.server.server_address[:2], timeout=patience.LONG_S) as line:
            line.sendall(text.encode())
            line.shutdown(socket.SHUT_WR)
            answer = line.makefile("rb").read(2000)
        assert b"200" not in answer.partition(b"\r\n")[0], what
        assert sitting.dialogue.view == before, what
    # More lines than are taken, all silent: the page that is there still hears, and the terminal still stops.
    crowd = [socket.create_connection(sitting.server.server_address[:2], timeout=patience.LONG_S) for _ in range(40)]
    assert sitting.dialogue.view == before and sitting.eye.taken == []
    for line in crowd:
        line.close()
    patience.until(lambda: _answers(sitting))
    sitting.eye.may.release()
    sitting.comes_to(State.STEP)
    assert len(sitting.eye.taken) == 1


def _answers(sitting) -> bool:  # noqa: F811
    try:
        return sitting.send()[0] == 200
    except OSError:
        return False


# ---- the terminal


class Done(Exception):
    """What a test exposure, or a pause, ends in here."""


@pytest.mark.parametrize("by", ["terminal", "page"])
@pytest.mark.parametrize(
    ("state", "offer"),
    [(state, offer) for state in OFFERS for offer in OFFERS[state]],
    ids=lambda one: getattr(one, "action", one),
)
def test_whatever_the_page_offers_is_done_by_keys_too(monkeypatch, state, offer, by):
    def done(*_) -> None:
        raise Done(offer.action)

    master, slave = pty.openpty()
    with os.fdopen(slave) as source:
        monkeypatch.setattr(sys, "stdin", source if by == "terminal" else None)
        dialogue = Dialogue(watched=True)
        dialogue.stored("a.dng")
        dialogue.on_test = done
        dialogue.working("Keep clear.", 1, 2, 1.0)

        def press_it() -> None:
            patience.until(lambda: dialogue.view.state is state)
            if by == "page":
                dialogue.act(offer.action, dialogue.view.turn, "it is right")
            else:
                os.write(master, b"it is right\n" if offer.action is Action.KEEP else f"{offer.key}\n".encode())

        person = threading.Thread(target=press_it, daemon=True)
        person.start()
        ended = {Action.STOP: OperatorAbort, Action.RETAKE_LAST: RetakeLast, Action.TEST: Done, Action.PAUSE: Done}
        if state is State.WORKING:
            person.join(patience.LONG_S)
            # A line that is written to a terminal comes out at its other end at once, as here.
            monkeypatch.setattr(dialogue, "ask", done)
            with pytest.raises(ended[offer.action]):
                dialogue.between_shots()
        elif offer.action in ended:
            with pytest.raises(ended[offer.action]):
                dialogue.ask(state, "Do something")
        else:
            assert dialogue.ask(state, "Do something") == ("it is right" if offer.action is Action.KEEP else "")
    os.close(master)
