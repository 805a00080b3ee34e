"""Findings of a check: errors, which stop the workflow, and warnings."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Finding:
    """Error or warning of a check.

    Parameters
    ----------
    is_error : bool
        Whether the workflow would refuse it, now or hours later; otherwise it is a warning.
    text : str
        Sentence that names the file, the field and the fault.
    photograph : path, optional
        The RAW file that it concerns; None if it concerns a definition, a table or several files.
    """

    is_error: bool
    text: str
    photograph: Path | None = None

    def __str__(self) -> str:
        return f"{'error' if self.is_error else 'warning'}: {self.text}"
