"""Web server of a session's dialogue, for browsers on this computer or in its network.

A request must have the token that the terminal shows and the page's own host name, and an action must come from the
page itself. A request that is refused has no effect and is answered with one sentence.
"""

import hmac
import importlib.resources
import ipaddress
import json
import os
import re
import secrets
import signal
import socket
import socketserver
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING

from irodori.capture.dialogue import LONGEST_REASON, Action, Dialogue, Refused, SessionView, Shown, State
from irodori.core.errors import InputError, PlainError

if TYPE_CHECKING:
    from irodori.ingest.preview import Preview

#: Longest accepted body of an action, bytes, and the most that is read of a longer one so that the answer arrives.
_LONGEST_BODY, _READ_AT_MOST = 4 * LONGEST_REASON + 200, 1 << 16
#: Interval of signs of life to a page without news, and longest silence of a request, s.
_BEAT_S, _PATIENCE_S = 4.0, 20.0
_MOST_CONNECTIONS = 32
#: Longest wait until the pages have received the last news, s.
_FAREWELL_S = 1.0
#: Number of photographs with pictures that are kept for late requests.
_PICTURES_KEPT = 4
_PICTURE = re.compile("/(?P<kind>picture|overlay)/(?P<number>[1-9][0-9]{0,8})")
_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class Address:
    """Address at which the page is served.

    Parameters
    ----------
    address : str
        IP address of this computer.
    port : int
        TCP port; 0 for a free one.
    """

    address: str = "127.0.0.1"
    port: int = 8462

    def __post_init__(self) -> None:
        accepted = "one address of this computer in numbers, such as 192.168.1.5 or fd12::5"
        try:
            parsed = ipaddress.ip_address(self.address)
        except ValueError:
            raise InputError("--address", "", repr(self.address), accepted) from None
        if parsed.is_unspecified or parsed.is_multicast:
            # The address in a request's Host header is compared with this one, so it cannot stand for several.
            raise InputError("--address", "", f"{self.address}, which stands for many", accepted)
        if parsed.version == 6 and (parsed.scope_id or parsed.ipv4_mapped):
            # Browsers refuse zones, and write mapped addresses in different ways.
            raise InputError("--address", "", f"{self.address}, which browsers do not open", accepted)
        if not 0 <= self.port <= 65535:
            raise InputError("--port", "", str(self.port), "0 to 65535")


class _Refusal(Exception):
    """Exception for a request without effect, with the HTTP status and the sentence of its answer."""

    def __init__(self, status: HTTPStatus, words: str) -> None:
        super().__init__(words)
        self.status, self.words = status, words


class PageServer(ThreadingHTTPServer):
    """HTTP server of one dialogue's page.

    Parameters
    ----------
    where : Address
    dialogue : Dialogue
    name : str
        Name of the subject that is photographed.

    Raises
    ------
    InputError
        If the address is not this computer's, or the port is in use.
    """

    daemon_threads = True
    #: Some versions of Python would let two sessions share a port.
    allow_reuse_port = False

    def __init__(self, where: Address, dialogue: Dialogue, name: str) -> None:
        self.dialogue, self.name, self.token = dialogue, name, secrets.token_urlsafe(16)
        self._slots, self._streams = threading.BoundedSemaphore(_MOST_CONNECTIONS), threading.Condition()
        self._open_streams = 0
        self._told: dict[int, Preview] = {}
        parsed = ipaddress.ip_address(where.address)
        self.address_family = socket.AF_INET6 if parsed.version == 6 else socket.AF_INET
        try:
            super().__init__((where.address, where.port), _Handler)
        except OSError as error:
            found = f"{where.address}, port {where.port}: {error.strerror or error}"
            accepted = "an address of this computer, and a port that is free"
            raise InputError("--address, --port", "", found, accepted) from None
        port = self.server_address[1]
        # In the form that browsers use, whatever form was typed.
        self.hosts = [f"[{parsed}]:{port}" if parsed.version == 6 else f"{parsed}:{port}"]
        if parsed.is_loopback:
            self.hosts.append(f"localhost:{port}")
        self.url = f"http://{self.hosts[0]}/?token={self.token}"
        # Browsers send a cookie to every port of a host.
        self.cookie = f"irodori-{port}"

    def server_bind(self) -> None:
        """Bind the socket without asking a name server for this computer's name."""
        socketserver.TCPServer.server_bind(self)

    def process_request(self, request, client_address) -> None:
        """Answer a request in a thread; close the connection if there are too many at a time."""
        if self._slots.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request, client_address) -> None:
        """Answer one request."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._slots.release()

    def handle_error(self, request, client_address) -> None:
        """Ignore connections that browsers closed; report every other error, which is a fault of this program."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)

    def tell(self, shown: Shown | None) -> None:
        """Keep the pictures of a photograph that is about to be announced to a page.

        A page requests them afterwards, when the next photograph may already be shown. The last few are kept.
        """
        with self._streams:
            if shown is not None:
                self._told[shown.number] = shown.preview
            for number in sorted(self._told)[:-_PICTURES_KEPT]:
                del self._told[number]

    def told(self, number: int) -> "Preview | None":
        """Return the pictures of a photograph that was announced to pages, None for others and old ones."""
        with self._streams:
            return self._told.get(number)

    @contextmanager
    def stream(self) -> Iterator[None]:
        """Count a stream of news as open while the block runs."""
        with self._streams:
            self._open_streams += 1
        try:
            yield
        finally:
            with self._streams:
                self._open_streams -= 1
                self._streams.notify_all()

    def await_farewells(self) -> None:
        """Wait, for a moment at most, until the pages have received the end of the session."""
        with self._streams:
            self._streams.wait_for(lambda: self._open_streams == 0, _FAREWELL_S)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    server_version, sys_version = "irodori", ""
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        """Answer a GET request with the page, its parts, a picture or the stream of news."""
        try:
            self._check_host()
            path, _, query = self.path.partition("?")
            given = query.removeprefix("token=") if path == "/" else ""
            self._check_token(given)
            if path in _FILES:
                name, kind = _FILES[path]
                content = importlib.resources.files("irodori.capture").joinpath("page", name).read_bytes()
                self._answer(HTTPStatus.OK, kind, content, set_cookie=bool(given))
            elif path == "/news":
                self._news()
            elif (picture := self._picture(path)) is not None:
                self._answer(HTTPStatus.OK, *picture)
            elif path == "/act":
                raise _Refusal(HTTPStatus.METHOD_NOT_ALLOWED, "An action is sent by POST; nothing was done.")
            else:
                raise _Refusal(HTTPStatus.NOT_FOUND, "There is no such page here.")
        except _Refusal as refusal:
            self._refuse(refusal)

    def do_POST(self) -> None:
        """Pass the action of a POST request to the dialogue."""
        try:
            body = self._body()
            self._check_host()
            self._check_token("")
            if self.headers.get_all("Origin") != [f"http://{self.headers['Host']}"]:
                raise _Refusal(HTTPStatus.FORBIDDEN, "The request comes from another page; nothing was done.")
            if self.path != "/act":
                raise _Refusal(HTTPStatus.NOT_FOUND, "There is no such action here; nothing was done.")
            action, turn, reason = _parsed(self.headers.get_content_type(), body)
            try:
                self.server.dialogue.act(action, turn, reason)
            except Refused as refused:
                raise _Refusal(HTTPStatus.CONFLICT, str(refused)) from None
            self._answer(HTTPStatus.OK, "text/plain; charset=utf-8", b"Done.")
        except _Refusal as refusal:
            self._refuse(refusal)

    def send_error(self, code, message=None, explain=None) -> None:
        """Answer an invalid request, or one with an unknown method, with one sentence."""
        self._refuse(_Refusal(HTTPStatus(code), f"{HTTPStatus(code).phrase}; nothing was done."))

    def log_message(self, format, *arguments) -> None:
        """Write no log, because addresses contain the token."""

    def _check_host(self) -> None:
        """Refuse requests with another host name, with which another page could reach this one (DNS rebinding)."""
        if self.headers.get_all("Host") not in [[host] for host in self.server.hosts]:
            accepted = " or ".join(self.server.hosts)
            raise _Refusal(
                HTTPStatus.MISDIRECTED_REQUEST, f"The address names another host than {accepted}; nothing was done."
            )

    def _check_token(self, given: str) -> None:
        pairs = [part.strip().partition("=") for part in self.headers.get("Cookie", "").split(";")]
        tokens = [given] if given else [value for name, _, value in pairs if name == self.server.cookie]
        if not any(hmac.compare_digest(token.encode(), self.server.token.encode()) for token in tokens):
            words = "This is not the session's token: open the address that the terminal shows."
            raise _Refusal(HTTPStatus.FORBIDDEN, words)

    def _body(self) -> bytes:
        try:
            length = int(self.headers.get("Content-Length", ""))
        except ValueError:
            length = -1
        if length < 0 or "Transfer-Encoding" in self.headers:
            raise _Refusal(HTTPStatus.LENGTH_REQUIRED, "The request does not say how long it is; nothing was done.")
        if length > _LONGEST_BODY:
            self.rfile.read(min(length, _READ_AT_MOST))
            words = f"The request is longer than {_LONGEST_BODY} bytes; nothing was done."
            raise _Refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, words)
        return self.rfile.read(length)

    def _picture(self, path: str) -> tuple[str, bytes] | None:
        """Return type and content of an announced picture or of its overlay; None for every other path."""
        asked = _PICTURE.fullmatch(path)
        if asked is None or (preview := self.server.told(int(asked["number"]))) is None:
            return None
        return ("image/jpeg", preview.jpeg) if asked["kind"] == "picture" else ("image/png", preview.overlay)

    def _news(self) -> None:
        """Send every change of the view as a server-sent event, until the session ends or the browser disconnects."""
        self.send_response(HTTPStatus.OK)
        self._send_headers({"Content-Type": "text/event-stream"})
        with self.server.stream():
            self.wfile.write(b"retry: 1000\n\n")
            version = -1
            while True:
                view = self.server.dialogue.changed_view(version, _BEAT_S)
                if view.version == version:
                    self.wfile.write(b"event: beat\ndata:\n\n")
                else:
                    version = view.version
                    self.server.tell(view.shown)
                    self.wfile.write(b"data: " + json.dumps(_plain(view, self.server.name)).encode() + b"\n\n")
                if view.state is State.ENDED:
                    return

    def _answer(self, status: HTTPStatus, kind: str, content: bytes, set_cookie: bool = False) -> None:
        self.send_response(status)
        headers = {"Content-Type": kind, "Content-Length": str(len(content))}
        if set_cookie:
            headers["Set-Cookie"] = f"{self.server.cookie}={self.server.token}; Path=/; HttpOnly; SameSite=Strict"
        self._send_headers(headers)
        self.wfile.write(content)

    def _refuse(self, refusal: _Refusal) -> None:
        self._answer(refusal.status, "text/plain; charset=utf-8", f"{refusal.words}\n".encode())

    def _send_headers(self, headers: dict[str, str]) -> None:
        for name, value in (_HEADERS | headers).items():
            self.send_header(name, value)
        self.end_headers()


def _parsed(kind: str, body: bytes) -> tuple[Action, int | None, str]:
    """Return action, turn and reason from the body of a request."""
    if kind != "application/json":
        raise _Refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "An action is sent as application/json; nothing was done.")
    try:
        content = json.loads(body)
        action, turn, reason = Action(content["action"]), content.get("turn"), content.get("reason", "")
        if not isinstance(turn, int | None) or isinstance(turn, bool) or not isinstance(reason, str):
            raise ValueError
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        words = f"An action is one of {', '.join(Action)}, with a turn and perhaps a reason; nothing was done."
        raise _Refusal(HTTPStatus.BAD_REQUEST, words) from None
    return action, turn, reason


def _plain(view: SessionView, name: str) -> dict:
    """Return a view as plain values for JSON."""
    shown = view.shown
    return {
        "name": name,
        "state": view.state,
        "words": view.words,
        "turn": view.turn,
        "offers": {offer.action: offer.button for offer in view.offers},
        "wanted": view.wanted,
        "done": view.done,
        "total": view.total,
        "left_s": view.left_s,
        "note": view.note,
        "shown": shown
        and {
            "number": shown.number,
            "file": shown.file,
            "finding": shown.finding,
            "histogram": shown.preview.histogram.round(5).tolist(),
            "extent": shown.preview.extent,
            "outline": shown.outline and shown.outline.path,
            "outlined": shown.outline and str(shown.outline),
        },
    }


@contextmanager
def served(dialogue: Dialogue, where: Address, name: str) -> Iterator[PageServer]:
    """Serve a dialogue's page while the block runs, and show at the end how the session ended.

    If the block runs in the main thread, a stop from the page raises KeyboardInterrupt there, even in a background job
    that ignores Ctrl-C. In another thread, it ends the session before the next photograph.

    Raises
    ------
    InputError
        See `PageServer`.
    """
    server = PageServer(where, dialogue, name)
    serving = threading.Thread(target=server.serve_forever, name="page", daemon=True)
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGUSR1, signal.default_int_handler) if in_main else None
    if in_main:
        dialogue.halt = lambda: os.kill(os.getpid(), signal.SIGUSR1)
    dialogue.watched = True
    serving.start()
    try:
        yield server
        dialogue.end("The session is complete.")
    except PlainError as error:
        dialogue.end(str(error))
        raise
    except KeyboardInterrupt:
        dialogue.end("Stopped; the rig stands still, and what was taken stays.")
        raise
    except BaseException:
        dialogue.end("The session ended by a fault: look at the terminal.")
        raise
    finally:
        dialogue.halt = lambda: None
        server.await_farewells()
        server.shutdown()
        server.server_close()
        serving.join()
        if in_main:
            signal.signal(signal.SIGUSR1, before)
