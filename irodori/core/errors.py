"""Exceptions for bad input, with messages for the author of the input."""

from pathlib import Path


class PlainError(Exception):
    """A fault that its message tells whole, in one sentence for the person at the machine: a traceback adds nothing."""


class InputError(PlainError, ValueError):
    """Input that the user can mend: says where it stands, what was found and what is accepted.

    Parameters
    ----------
    file : str or path
        The file that holds the fault.
    field : str
        Key, column or dataset inside the file; empty where the file as a whole is at fault.
    found : str
        What was found there.
    accepted : str
        What would have been right.

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


def is_file(path) -> bool:
    """Whether a name that a definition gives is that of a file; one that no file can have is not."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False
