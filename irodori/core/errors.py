"""Exceptions for bad input, with messages for the author of the input."""

from pathlib import Path


class PlainError(Exception):
    """Error that its message explains completely to the user, in one sentence; it is shown without a traceback."""


class InputError(PlainError, ValueError):
    """Error in the user's input; the message names the file and the field, what was found and what is accepted.

    Parameters
    ----------
    file : str or path
        The file that holds the fault.
    field : str
        Key, column or dataset inside the file; empty if the file as a whole is at fault.
    found : str
        What was found there.
    accepted : str
        What is accepted there.

    Examples
    --------
    >>> print(InputError("config/objects/jar.yaml", "shape.radius_mm", "-3.0", "a number above 0"))
    config/objects/jar.yaml: shape.radius_mm: found -3.0; accepted: a number above 0.
    """

    def __init__(self, file, field: str, found: str, accepted: str) -> None:
        self.file, self.field, self.found, self.accepted = str(file), field, found, accepted
        place = f"{self.file}: {field}" if field else self.file
        super().__init__(f"{place}: found {found}; accepted: {accepted}.")

    def __reduce__(self):
        return type(self), (self.file, self.field, self.found, self.accepted)


def counted(number: float, noun: str, form: str = "") -> str:
    """Return a number and its noun for a message, in the singular if the number reads 1.

    Examples
    --------
    >>> counted(1, "pixel"), counted(2, "pixel"), counted(0.996, "pixel", ".2g")
    ('1 pixel', '2 pixels', '1 pixel')
    """
    text = f"{number:{form}}"
    return f"{text} {noun}{'' if text == '1' else 's'}"


def is_file(path) -> bool:
    """Whether a path from a definition is an existing file; also False for a name that no file can have."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False
