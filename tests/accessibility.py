"""Barriers on pages for people who see, hear or move otherwise, as axe-core finds them in a browser."""

from collections.abc import Iterable
from pathlib import Path

import patience

from irodori.viewer.browser import browser

#: Places of what is right are not asked for: finding them takes a third of the time.
OPTIONS = {"resultTypes": ["violations"]}


def violations(paths: Iterable[Path], *, contrast: bool = True) -> dict[str, list[str]]:
    """Return the rules that pages break, each with the first element that does, by page; no page that breaks none.

    Without ``contrast``, colours of text are not looked at, which takes half of the time.
    """
    options = OPTIONS | {"rules": {"color-contrast": {"enabled": contrast}}}
    from axe_playwright_python.sync_playwright import Axe

    context = browser(("--no-sandbox",)).new_context(offline=True, viewport={"width": 1280, "height": 900})
    context.set_default_timeout(patience.LONG_MS)
    page, axe, found = context.new_page(), Axe(), {}
    try:
        for path in paths:
            page.goto(Path(path).resolve().as_uri())
            broken = axe.run(page, options=options).response["violations"]
            found[str(path)] = [f"{one['id']}: {one['nodes'][0]['html'][:120]}" for one in broken]
    finally:
        context.close()
    return {name: broken for name, broken in found.items() if broken}
