"""Findings of a check: what stops the workflow, and what a person had better look at."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Finding:
    """One finding.

    Parameters
    ----------
    is_error : bool
        Whether the workflow would refuse it, now or hours later; otherwise it is a warning.
    text : str
        File, field and what is wrong with it, a sentence.
    photograph : path, optional
        The RAW file that it concerns; None where it concerns a definition, a table or several files.
    """

    is_error: bool
    text: str
    photograph: Path | None = None

    def __str__(self) -> str:
        return f"{'error' if self.is_error else 'warning'}: {self.text}"
