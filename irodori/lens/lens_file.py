"""Reading of ``lens.yaml``, which `irodori.lens.stage` writes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from irodori.config.models import Optics
from irodori.core.yaml_files import read_own_yaml


@dataclass(frozen=True)
class LensFile:
    """Content of ``lens.yaml``.

    Parameters
    ----------
    optics : Optics
        As measured.
    focal_length_error_mm : float
        Standard error of the focal length, mm.
    remarks : list of str
        Lines of text about the measurement; the first compares the focal length with the typed one.
    """

    optics: Optics
    focal_length_error_mm: float
    remarks: list[str]

    @classmethod
    def load(cls, path) -> "LensFile":
        """Read a file that the workflow has written."""
        content = read_own_yaml(Path(path))
        return cls(Optics.of(content["optics"]), content["focal_length_error_mm"], content["remarks"])


def optics_in_use(typed: Optics, files: Sequence) -> Optics:
    """Return the measured optics of a camera, mounted as typed; the typed ones if there is no file of its lens.

    Parameters
    ----------
    typed : Optics
    files : sequence of path
        ``lens.yaml`` of the camera, or nothing.
    """
    # A sheet may be held in any way: it tells nothing of the roll.
    return next((replace(LensFile.load(path).optics, roll_deg=typed.roll_deg) for path in files), typed)
