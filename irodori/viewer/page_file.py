"""Assembly of the page as one HTML file, from its scripts in a fixed order, styles, texts and payload."""

import base64
import html
import io
import json
from importlib import resources
from pathlib import Path

from irodori.core.atomic_files import written_whole

#: Scripts of the page in their order: the renderer, the parts of the page, and the interaction.
SCRIPTS = (
    *("payload.js", "spectra.js", "maps.js", "light_maps.js", "renderer.js", "selftest.js"),
    *("text.js", "state.js", "screens.js", "png.js", "plot.js", "lesson.js", "view.js", "controls.js", "legend.js"),
    *("app.js", "drawing.js", "changes.js", "describe.js", "marks.js", "probe.js", "input.js"),
    *("panel.js", "panel_lesson.js", "panel_light.js", "panel_compare.js", "panel_objects.js", "panel_seeing.js"),
    *("dialogs.js", "files.js", "start.js"),
)
_POSTER_PX = (640, 640)  # largest width and height of the picture for a page that cannot draw
#: Nothing is fetched from anywhere: all that a page shows is in it.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'"
)


def _text(name: str) -> str:
    return (resources.files("irodori.viewer") / "page" / name).read_text(encoding="utf-8")


def _names(suffix: str) -> list[str]:
    return sorted(f.name for f in (resources.files("irodori.viewer") / "page").iterdir() if f.name.endswith(suffix))


def _languages() -> str:
    """Return the texts of the page by language and key, as JSON that is safe inside HTML."""
    folder = resources.files("irodori.viewer") / "page" / "languages"
    files = sorted(folder.iterdir(), key=lambda file: file.name)
    tables = {Path(file.name).stem: json.loads(file.read_text(encoding="utf-8")) for file in files}
    return json.dumps(tables, ensure_ascii=False).replace("</", "<\\/")


def _script(text: str) -> str:
    """Return a script as an HTML element, with closing tags inside the script escaped."""
    return "<script>\n" + text.replace("</script", "<\\/script") + "\n</script>"


def _poster_uri(path) -> str:
    """Return a picture as a PNG in a data URI, reduced if it is large, with its colour profile."""
    from PIL import Image  # slow to import

    content = io.BytesIO()
    with Image.open(path) as picture:
        profile = picture.info.get("icc_profile")
        picture.thumbnail(_POSTER_PX)
        picture.save(content, "PNG", icc_profile=profile)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode("ascii")


def page_html(title: str, payload: str, poster: Path | None = None) -> str:
    """Return the HTML of the page.

    Parameters
    ----------
    title : str
    payload : str
        Base64 text made by `irodori.viewer.payload`.
    poster : path, optional
        PNG to show, at most 640 pixels a side, if the page cannot draw.
    """
    sources = {name: _text(name) for name in _names(".glsl")}
    scripts = [f"var Irodori = Irodori || {{}};\nIrodori.sources = {json.dumps(sources)};"]
    scripts += [_text(name) for name in SCRIPTS]
    parts = {
        "{{title}}": html.escape(title),
        "{{policy}}": POLICY,
        "{{style}}": "<style>\n" + "\n".join(_text(name) for name in _names(".css")) + "\n</style>",
        "{{poster}}": _poster_uri(poster) if poster else "data:,",
        "{{languages}}": f'<script type="application/json" id="languages">{_languages()}</script>',
        "{{payload}}": f'<script type="application/octet-stream" id="payload">{payload}</script>',
        "{{scripts}}": "\n".join(_script(text) for text in scripts),
    }
    page = _text("page.html")
    for mark, text in parts.items():
        page = page.replace(mark, text)
    return page


def write_page(path, title: str, payload: str, poster=None) -> None:
    """Write the page, replacing the file only when complete; for the arguments see `page_html`."""
    with written_whole(path) as temporary:
        temporary.write_text(page_html(title, payload, poster), encoding="utf-8")
