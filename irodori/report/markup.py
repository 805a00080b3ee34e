"""Pieces of HTML: tables, figures, numbers."""

import base64
import html
import math
from pathlib import Path


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
