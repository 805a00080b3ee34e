"""Reading of ``lens.yaml``, which `irodori.lens.stage` writes."""

from collections.abc import Sequence
from dataclasses import dataclass
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
    """Return the measured optics of a camera if there is a file of its lens, and otherwise the typed ones.

    Parameters
    ----------
    typed : Optics
    files : sequence of path
        ``lens.yaml`` of the camera, or nothing.
    """
    return next((LensFile.load(path).optics for path in files), typed)
