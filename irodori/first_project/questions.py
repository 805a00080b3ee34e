"""Questions to the user about facts that photographs do not contain: distances, lamp, object and poses."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from irodori.config.capture_table import Pose
from irodori.core.errors import InputError

#: Text in a definition or a table that marks a value which the user has to write.
GAP = "?"
#: Shapes that the user may name, with the keys of their sizes, and shapes that are read from a file.
_SIZES = {"plate": ("width_mm", "height_mm"), "sphere": ("radius_mm",)}
_FILES = ("mesh",)
_POINT = ", with a decimal point, and a space between two numbers"
_LONGEST_NAME = 100


@dataclass(frozen=True)
class Question:
    """A question to the user.

    Parameters
    ----------
    key : str
        Name of the question in a file of answers.
    words : str
        Text of the question, with an example.
    read : callable
        Function from the text of an answer to its value. It raises ValueError with a description of accepted answers.
    assumed : str
        Answer that is assumed if the user gives none; empty if none can be assumed.
    """

    key: str
    words: str
    read: Callable[[str], Any]
    assumed: str = ""


def _words(text: str) -> list[str]:
    """Split an answer at spaces and commas.

    Raises
    ------
    ValueError
        If one comma alone stands between digits: 90,5 may be two numbers or one with a decimal comma.
    """
    if any(re.fullmatch(r"[^,]*\d,\d[^,]*", word) for word in text.split()):
        raise ValueError("numbers" + _POINT)
    return text.replace(",", " ").split()


def name_in_files(text: str) -> str:
    """Convert the name of a folder or file to small letters, digits and hyphens.

    Raises
    ------
    ValueError
        If that would drop letters, nothing is left, or the name is too long for files.
    """
    found = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
    if not found or not text.isascii() or len(found) > _LONGEST_NAME:
        raise ValueError(f"a name of the letters a to z, digits and hyphens, at most {_LONGEST_NAME} of them")
    return found


def numbers(count: int) -> Callable[[str], list[float]]:
    """Return a function that reads ``count`` numbers from text; a single number is repeated ``count`` times."""

    def read(text: str) -> list[float]:
        try:
            found = [float(word) for word in _words(text)]
        except ValueError:
            found = []
        if len(found) not in (1, count) or not all(map(math.isfinite, found)):
            which = f"one number, or {count} in the order of the photographs" if count > 1 else "one number"
            raise ValueError(which + (_POINT if "," in text else ""))
        return found * count if len(found) == 1 else found

    return read


def positive(text: str) -> float:
    """Read a number above 0."""
    value = numbers(1)(text)[0]
    if value <= 0.0:
        raise ValueError("a number above 0")
    return value


def word(text: str) -> str:
    """Read a name or a path."""
    if not text.strip():
        raise ValueError("a name")
    return text.strip()


def pose_of_references(text: str) -> Pose:
    """Read light and camera angle of the chart and the white reference."""
    light, camera = _two(text)
    return Pose(light, camera)


def _two(text: str) -> list[float]:
    parts = _words(text)
    if len(parts) != 2:
        raise ValueError("two angles, of the light and of the camera, such as 45 0")
    return [numbers(1)(part)[0] for part in parts]


def shape(text: str) -> dict[str, Any]:
    """Read the shape of an object; return the block ``shape`` of its definition."""
    kind, _, rest = text.strip().partition(" ")
    if kind in _FILES and rest.strip():
        # glTF defines metres, and y upward; other formats state neither.
        is_gltf = Path(rest.strip()).suffix.lower() in (".glb", ".gltf")
        laid = {"unit": "m", "up": "y"} if is_gltf else {"unit": "mm", "up": "z"}
        return {"kind": kind, "file": rest.strip(), **laid}
    sizes, keys = _words(rest), _SIZES.get(kind, ())
    if len(sizes) == 1:
        sizes *= len(keys)  # one number is every size of the shape: a square's
    try:
        if keys and len(sizes) == len(keys):
            return {"kind": kind, **{key: positive(size) for key, size in zip(keys, sizes, strict=True)}}
    except ValueError:
        pass
    raise ValueError("plate WIDTH HEIGHT, plate SIDE, sphere RADIUS (mm), or mesh FILE")


def answer(question: Question, given: Mapping[str, Any], source, ask: Callable[[str], str] | None) -> Any | None:
    """Return the answer to a question from the written answers or from the user; None if there is none.

    Parameters
    ----------
    question : Question
    given : mapping
        Answers written beforehand, by key.
    source : path
        File of the written answers, for error messages.
    ask : callable or None
        Function that shows a text and returns the line that was typed, empty for no answer.

    Raises
    ------
    InputError
        If a written answer is not accepted. After a typed answer that is not accepted, the question is repeated.
    """
    if question.key in given:
        try:
            return question.read(_text(given[question.key]))
        except ValueError as error:
            raise InputError(source, question.key, repr(given[question.key]), str(error)) from None
    while ask is not None:
        without = f" (empty: {question.assumed})" if question.assumed else ""
        typed = ask(f"{question.words}{without}\n  {question.key}: ")
        if not typed.strip():
            return None
        try:
            return question.read(typed)
        except ValueError as error:
            ask_again = f"  not understood; accepted: {error}"
            question = replace(question, words=ask_again)
    return None


def _text(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)
