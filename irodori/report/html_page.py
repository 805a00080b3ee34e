"""Self-contained HTML pages from the templates in this folder; values are escaped unless a template says otherwise."""

import base64
import math
from collections.abc import Iterable
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from irodori.core.atomic_files import written_whole


def number(value: str | float) -> str:
    """Return a number as text with four significant digits, or a dash for NaN."""
    value = float(value)
    return "–" if math.isnan(value) else f"{value:.4g}"


def data_uri(path) -> str:
    """Return a PNG file as a data URI."""
    return "data:image/png;base64," + base64.b64encode(Path(path).read_bytes()).decode()


def _grouped(rows: Iterable, *names: str) -> dict:
    """Group rows by one field, {value: rows}, or by several, {tuple of values: rows}, in order of first appearance."""
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


def fragment(template: str, **context) -> str:
    """Return the text of a template filled with data.

    Parameters
    ----------
    template : str
        Name of a file in ``templates``. Filters in addition to those of Jinja: ``number``, four digits or a dash;
        ``show``, a Python format specification; ``grouped``, rows grouped by fields.
    **context
        Data of the template.

    Raises
    ------
    jinja2.UndefinedError
        If the template uses a name that is not in the context.
    """
    return _TEMPLATES.get_template(template).render(**context)


def write_page(path, template: str, **context) -> None:
    """Write a self-contained page, replacing the file only when complete; for the arguments see `fragment`."""
    with written_whole(path) as temporary:
        temporary.write_text(fragment(template, **context), encoding="utf-8")
