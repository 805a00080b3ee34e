"""Options of ingestion."""

from dataclasses import dataclass, replace

from irodori.ingest.mosaic import ALGORITHMS

SUPERPIXEL = "superpixel"


@dataclass(frozen=True)
class IngestOptions:
    """The ``ingest`` block of the configuration.

    Parameters
    ----------
    saturation : float
        Fraction of the range from black to white at and above which a sample counts as clipped.
    demosaic : str
        ``superpixel``, or an algorithm of LibRaw for full resolution.
    register : bool
        Whether the shots of two filter states are registered.
    max_registration_px : float
        Largest residual of the registration, superpixels.
    max_nonlinearity : float
        Largest deviation from linearity, ratio.
    """

    saturation: float = 0.98
    demosaic: str = SUPERPIXEL
    register: bool = True
    max_registration_px: float = 0.3
    max_nonlinearity: float = 0.02

    def __post_init__(self) -> None:
        if self.demosaic != SUPERPIXEL and self.demosaic not in ALGORITHMS:
            accepted = ", ".join((SUPERPIXEL, *ALGORITHMS))
            raise ValueError(f"unknown demosaicing {self.demosaic!r}; accepted: {accepted}")

    @property
    def sample_px(self) -> int:
        """Side of a sample in mosaic pixels."""
        return 2 if self.demosaic == SUPERPIXEL else 1

    def superpixels(self) -> "IngestOptions":
        """Return the options with superpixels instead of demosaicing."""
        return replace(self, demosaic=SUPERPIXEL)
