"""Pages in a headless browser, to measure the errors that a page states and for tests.

The client is Playwright, which is imported only where pages are checked; the browser is the one of the system.
"""

import atexit
import base64
import importlib
import importlib.util
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import numpy as np

from irodori.core.errors import PlainError

#: No dependency of the package: without it, pages are written unchecked and state that.
_CLIENT = "playwright"
#: Commands by which systems know Chromium.
COMMANDS = ("chromium", "chromium-browser", "google-chrome")
#: WebGL2 in a software renderer gives the same numbers on every machine. That renderer does not compose the rest of the
#: page, which would take most of its time.
FLAGS = (
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox",
    "--disable-gpu-compositing",
)  # fmt: skip
_PATIENCE_MS = 180_000
#: A small window of few pixels, because the page draws it in software and its content is not read.
_WINDOW = {"viewport": {"width": 360, "height": 320}, "device_scale_factor": 0.25}
_USUAL = {"viewport": {"width": 1280, "height": 720}}
#: JavaScript expression for the text that a page shows instead of a picture.
_SAID = "!document.getElementById('poster').hidden && document.getElementById('poster-text').textContent"
_READ = """async ([state, width, height]) => {
  await Irodori.renderer.findLight(state);
  const values = Irodori.renderer.readXYZ(state, width, height), bytes = new Uint8Array(values.buffer);
  let text = "";
  for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
  return btoa(text);
}"""


def browser_command() -> str | None:
    """Return the path of the browser's executable, or None without a browser or without Playwright."""
    if importlib.util.find_spec(_CLIENT) is None:
        return None
    return next((found for found in map(shutil.which, COMMANDS) if found), None)


def is_told_by_page(message: str) -> bool:
    """Return whether a console message comes from the page, and is not the driver's warning about slow reading."""
    return "GPU stall due to ReadPixels" not in message


class OpenPage:
    """A page that is open in the browser and can draw; see `opened`."""

    def __init__(self, page, messages: list[str]) -> None:
        self.page, self.messages = page, messages

    def default_state(self) -> dict:
        """Return the initial state of the page: view, light, observer and other settings."""
        return json.loads(self.page.evaluate("JSON.stringify(Irodori.renderer.defaultState())"))

    def read_xyz(self, state: dict, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw a state; return XYZ, (height, width, 3), and object indices, (height, width), -1 for the background."""
        raw = base64.b64decode(self.page.evaluate(_READ, [state, width, height]))
        values = np.frombuffer(raw, dtype="<f4").reshape(height, width, 4)
        return values[..., :3].astype(np.float64), values[..., 3].astype(int)

    def wait_for(self, condition: str) -> None:
        """Wait until a JavaScript expression is true; it polls within the page, whose policy forbids evaluating text.

        Raises
        ------
        PlainError
            If the expression is not true within three minutes.
        """
        loop = f"""async (end) => {{
          while (!({condition}) && performance.now() < end) await new Promise((go) => setTimeout(go, 20));
          return !!({condition});
        }}"""
        if not self.page.evaluate(loop, _PATIENCE_MS):
            raise PlainError(f"The page was not ready within {_PATIENCE_MS / 1000:g} s; waited for {condition}.")


@lru_cache(maxsize=1)
def client():
    """Return the Playwright client, started once per process, because it allows only one per thread."""
    started = importlib.import_module(f"{_CLIENT}.sync_api").sync_playwright().start()
    atexit.register(started.stop)
    return started


#: Browsers of this process that are open, and the pages in them that were left, by flags: a new page would cost a
#: process of the browser, which takes as long as all else in it.
_started: list = []
_left: dict[tuple[str, ...], list] = {}


@lru_cache(maxsize=4)
def browser(flags: tuple[str, ...] = FLAGS):
    """Return the browser with the given flags, started once per process.

    Raises
    ------
    PlainError
        If there is no browser.
    """
    command = browser_command()
    if command is None:
        raise PlainError("No browser to check a page in; accepted: Debian's package chromium and Python's playwright.")
    started = client().chromium.launch(executable_path=command, args=list(flags), headless=True)
    _started.append(started)
    atexit.register(close_browsers)
    return started


def close_browsers() -> None:
    """Close the browsers of this process; the next page starts one again."""
    browser.cache_clear()
    _left.clear()
    while _started:
        _started.pop().close()


@contextmanager
def opened(path, flags: tuple[str, ...] = FLAGS, wait: bool = True, cold: bool = False) -> Iterator[OpenPage]:
    """Open a page from disk and wait until it can draw.

    Parameters
    ----------
    path : path
    flags : tuple of str
        Command-line flags of the browser.
    wait : bool
        Whether to wait for the renderer; a page that cannot draw has none.
    cold : bool
        Whether to start a new browser, with empty caches and a window of the usual size.

    Raises
    ------
    PlainError
        If there is no browser, or the page cannot draw; the message is then the reason that the page states.
    """
    if cold:
        browser.cache_clear()
        page = browser(flags).new_context(**_USUAL).new_page()
    else:
        idle = _left.setdefault(flags, [])
        page = idle.pop() if idle else browser(flags).new_context(**_WINDOW).new_page()
    messages: list[str] = []
    listeners = {
        "console": lambda message: messages.append(message.text) if is_told_by_page(message.text) else None,
        "pageerror": lambda error: messages.append(str(error)),
        "request": lambda request: (
            messages.append(f"request {request.url}")
            if not request.url.startswith(("file:", "data:", "blob:"))
            else None
        ),
    }
    try:
        page.set_default_timeout(_PATIENCE_MS)
        for event, listener in listeners.items():
            page.on(event, listener)
        page.goto(Path(path).resolve().as_uri())
        found = OpenPage(page, messages)
        if wait:
            drawn = "window.Irodori && Irodori.renderer && Irodori.renderer.drawn !== undefined"
            found.wait_for(f"({drawn}) || ({_SAID})")
            if not page.evaluate(f"!!({drawn})"):
                raise PlainError(page.evaluate(_SAID))
        yield found
    except BaseException:
        page.context.close()
        raise
    if cold:
        page.context.close()
        return
    for event, listener in listeners.items():
        page.remove_listener(event, listener)
    page.goto("about:blank")
    _left[flags].append(page)
