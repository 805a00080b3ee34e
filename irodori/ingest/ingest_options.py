"""Options of ingestion."""

from dataclasses import dataclass, replace
from typing import Final

from irodori.config.definition import check_choices
from irodori.config.models import Ingest

SUPERPIXEL: Final = "superpixel"


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class IngestOptions(Ingest):
    """The ``ingest`` block of the configuration, with what follows from it."""

    def __post_init__(self) -> None:
        check_choices(self)

    @property
    def sample_px(self) -> int:
        """Side of a sample in mosaic pixels."""
        return 2 if self.demosaic == SUPERPIXEL else 1

    def superpixels(self) -> "IngestOptions":
        """Return the options with superpixels instead of demosaicing."""
        return replace(self, demosaic=SUPERPIXEL)
