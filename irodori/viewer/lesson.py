"""The lesson of a scene as the classroom page reads it: plain values, its pictures inside."""

import base64
from pathlib import Path
from typing import Any

from irodori.config.cross_checks.lessons import picture_kind
from irodori.config.models import Lesson

__all__ = ["lesson_for_page"]


def lesson_for_page(lesson: Lesson | None, root: Path = Path()) -> dict[str, Any] | None:
    """Return a lesson, ready for JSON, with each picture's bytes in place of its path.

    Parameters
    ----------
    lesson : Lesson or None
        Checked with the scene that it belongs to; None where the scene has none.
    root : path
        Where the paths of pictures start.

    Returns
    -------
    dict or None
        Keys and values as in the scene's file, defaults written out; ``picture`` is a ``data:`` address, and
        ``picture_file`` beside it the path.
    """
    if lesson is None:
        return None
    page = lesson.plain()
    for step in page["steps"]:
        if "picture" in step:
            step["picture_file"] = step["picture"]
            path = Path(root) / step["picture"]
            content = base64.b64encode(path.read_bytes()).decode("ascii")
            step["picture"] = f"data:{picture_kind(path)};base64,{content}"
    return page
