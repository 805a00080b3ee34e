"""Conversion of a scene's lesson into plain values with embedded pictures, as the classroom page reads it."""

import base64
from pathlib import Path
from typing import Any

from irodori.config.cross_checks.lessons import picture_kind
from irodori.config.models import Lesson

__all__ = ["lesson_for_page"]


def lesson_for_page(lesson: Lesson | None, root: Path = Path()) -> dict[str, Any] | None:
    """Return a lesson as values for JSON, with each picture embedded in place of its path.

    Parameters
    ----------
    lesson : Lesson or None
        A lesson that was checked with its scene; None if the scene has none.
    root : path
        Folder to which the paths of pictures are relative.

    Returns
    -------
    dict or None
        Keys and values as in the scene's file, with defaults; ``picture`` is a ``data:`` URI, and ``picture_file`` the
        path.
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
