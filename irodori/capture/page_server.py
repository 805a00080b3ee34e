"""A page at the rig: what a session's dialogue shows and asks, for browsers on this computer or in its network.

Nothing is answered without the token that the terminal shows, nor under another host name than the page's own, and
nothing is done on behalf of another page. A request that is refused has no effect and is answered by one sentence.
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

#: Longest body of an action, bytes; what is longer is read so far only that the answer arrives.
_LONGEST_BODY, _READ_AT_MOST = 4 * LONGEST_REASON + 200, 1 << 16
#: Time after which a page that is told nothing hears that the line is up, and that a silent request may take, s.
_BEAT_S, _PATIENCE_S = 4.0, 20.0
_MOST_CONNECTIONS = 32
#: Time that the pages have for the last news, s.
_FAREWELL_S = 1.0
#: Photographs whose pictures are kept for pages that ask late.
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
        One of this computer, in numbers.
    port : int
        0 for one that is free.
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
            # Requests name the address that they mean; one that stands for all could not be compared with it.
            raise InputError("--address", "", f"{self.address}, which stands for many", accepted)
        if parsed.version == 6 and (parsed.scope_id or parsed.ipv4_mapped):
            # No browser takes a zone, and a mapped address is written in one way by some and in another by others.
            raise InputError("--address", "", f"{self.address}, which browsers do not open", accepted)
        if not 0 <= self.port <= 65535:
            raise InputError("--port", "", str(self.port), "0 to 65535")


class _Refusal(Exception):
    """A request that has no effect: its status and the sentence that answers it."""

    def __init__(self, status: HTTPStatus, words: str) -> None:
        super().__init__(words)
        self.status, self.words = status, words


class PageServer(ThreadingHTTPServer):
    """Serves the page of one dialogue.

    Parameters
    ----------
    where : Address
    dialogue : Dialogue
    name : str
        Of what is photographed.

    Raises
    ------
    InputError
        If the address is not this computer's, or the port is in use.
    """

    daemon_threads = True
    #: Two sessions never share a port, which some versions of Python would let them.
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
        # As browsers write it, whatever way it was typed.
        self.hosts = [f"[{parsed}]:{port}" if parsed.version == 6 else f"{parsed}:{port}"]
        if parsed.is_loopback:
            self.hosts.append(f"localhost:{port}")
        self.url = f"http://{self.hosts[0]}/?token={self.token}"
        # Cookies do not tell ports apart.
        self.cookie = f"irodori-{port}"

    def server_bind(self) -> None:
        """Bind without asking a name server for this computer's name."""
        socketserver.TCPServer.server_bind(self)

    def process_request(self, request, client_address) -> None:
        """Answer in a thread; beyond so many at a time the line is closed."""
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
        """Let go of browsers that went away; all else is a mistake of ours and is said."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)

    def tell(self, shown: Shown | None) -> None:
        """Keep the pictures of a photograph of which a page is about to hear.

        A page asks for them once it has heard, and by then the next photograph may be shown. The last few are kept.
        """
        with self._streams:
            if shown is not None:
                self._told[shown.number] = shown.preview
            for number in sorted(self._told)[:-_PICTURES_KEPT]:
                del self._told[number]

    def told(self, number: int) -> "Preview | None":
        """Return the pictures of a photograph that pages have heard of, None for others and those long gone."""
        with self._streams:
            return self._told.get(number)

    @contextmanager
    def stream(self) -> Iterator[None]:
        """Count an open stream of news."""
        with self._streams:
            self._open_streams += 1
        try:
            yield
        finally:
            with self._streams:
                self._open_streams -= 1
                self._streams.notify_all()

    def await_farewells(self) -> None:
        """Wait until the pages have heard how the session ended, for a moment at most."""
        with self._streams:
            self._streams.wait_for(lambda: self._open_streams == 0, _FAREWELL_S)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    server_version, sys_version = "irodori", ""
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        """Answer with the page, its parts, a picture or the news."""
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
        """Hand an action to the dialogue."""
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
        """Answer what is no request of HTTP, or an unknown method, by one sentence."""
        self._refuse(_Refusal(HTTPStatus(code), f"{HTTPStatus(code).phrase}; nothing was done."))

    def log_message(self, format, *arguments) -> None:
        """Write no log: addresses hold the token."""

    def _check_host(self) -> None:
        """Refuse requests under another name, by which another page could reach this one (DNS rebinding)."""
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
        """Return kind and content of a picture that pages were told of, or its overlay; None for every other path."""
        asked = _PICTURE.fullmatch(path)
        if asked is None or (preview := self.server.told(int(asked["number"]))) is None:
            return None
        return ("image/jpeg", preview.jpeg) if asked["kind"] == "picture" else ("image/png", preview.overlay)

    def _news(self) -> None:
        """Send every change as an event, until the session ends or the browser goes."""
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
    """Return action, turn and reason of an action's body."""
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
    """Return a view for JSON."""
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
    """Serve a dialogue's page for as long as the block runs, and say at its end how it ended.

    A stop from the page ends the main thread's work as Ctrl-C does, also where the program ignores that key (a job in
    the background); elsewhere it ends the session before the next photograph.

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
