"""HTML pages from the templates beside this module: self-contained, and escaped unless a template says otherwise."""

import base64
import math
from collections.abc import Iterable
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from irodori.core.atomic_files import written_whole
from irodori.reflection.registry import lobe


def number(value: str | float) -> str:
    """Return four digits of a number, a dash for NaN."""
    value = float(value)
    return "–" if math.isnan(value) else f"{value:.4g}"


def data_uri(path) -> str:
    """Return a PNG file as a data URI."""
    return "data:image/png;base64," + base64.b64encode(Path(path).read_bytes()).decode()


def _grouped(rows: Iterable, *names: str) -> dict:
    """Return {value: rows} by a field, or {values: rows} by several, in order of first appearance."""
    found: dict = {}
    for row in rows:
        values = tuple(row[name] if isinstance(row, dict) else getattr(row, name) for name in names)
        found.setdefault(values if len(values) > 1 else values[0], []).append(row)
    return found


_TEMPLATES = Environment(
    loader=PackageLoader("irodori.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters |= {"number": number, "show": format, "grouped": _grouped}
_TEMPLATES.globals["lobe_named"] = lobe


def fragment(template: str, **context) -> str:
    """Return a template filled in; a name that it uses and nobody gave is an error.

    Parameters
    ----------
    template : str
        Name of a file in ``templates``. Its filters beside Jinja's own: ``number``, four digits or a dash;
        ``show``, a Python format specification; ``grouped``, rows by their fields.
    **context
        What the template shows.

    Raises
    ------
    jinja2.UndefinedError
        If a name is missing.
    """
    return _TEMPLATES.get_template(template).render(**context)


def write_page(path, template: str, **context) -> None:
    """Write a page that needs nothing beside it, whole or not at all; for the arguments see `fragment`."""
    with written_whole(path) as temporary:
        temporary.write_text(fragment(template, **context), encoding="utf-8")
