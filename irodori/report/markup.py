"""HTML fragments: tables, figures, numbers."""

import base64
import html
import math
from pathlib import Path

from irodori.core.atomic_files import written_whole

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1180px; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1, h2 { font-weight: 600 } table { border-collapse: collapse; margin: .5rem 0 1.5rem }
th, td { padding: .2rem .7rem; border-bottom: 1px solid #ddd; text-align: right }
th:first-child, td:first-child, td.text, th.text { text-align: left }
figure { display: inline-block; margin: 0 1rem 1rem 0 } figcaption { font-size: .85rem; color: #555 }
img { max-width: 100% }
"""


def table(header: list[str], rows: list[list[str]]) -> str:
    """Return an HTML table; cells are escaped."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def figure(uri: str, caption: str, width: int | None = None) -> str:
    """Return an HTML figure of a data URI."""
    size = f' width="{width}"' if width else ""
    text = html.escape(caption)
    return f'<figure><img src="{uri}" alt="{text}"{size}><figcaption>{text}</figcaption></figure>'


def details(summary: str, inner: str) -> str:
    """Return what opens on a click."""
    return f"<details><summary>{html.escape(summary)}</summary>{inner}</details>"


def number(text: str | float) -> str:
    """Return four digits of a number, a dash for NaN."""
    value = float(text)
    return "–" if math.isnan(value) else f"{value:.4g}"


def data_uri(path) -> str:
    """Return a PNG file as a data URI."""
    return "data:image/png;base64," + base64.b64encode(Path(path).read_bytes()).decode()


def write_page(path, title: str, body: str) -> None:
    """Write a page that needs nothing beside it, whole or not at all."""
    with written_whole(path) as temporary:
        temporary.write_text(
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
            f"<style>{_STYLE}</style><body>{body}</body></html>\n",
            encoding="utf-8",
        )
