"""A picture compressed in memory, as the stages compress it on the way to a file."""

from typing import NamedTuple

import numpy as np

from irodori.material.principal_components.basis_count import Compression, analyse


class Compressed(NamedTuple):
    """Coefficients (n, k) as they come back from storage, and how they were made."""

    coefficients: np.ndarray
    compression: Compression

    @property
    def basis(self):
        return self.compression.basis

    @property
    def errors(self):
        return self.compression.errors

    @property
    def negative_fraction(self):
        return self.compression.negative


def compress(pixels, basis, observers, options, *, bases=None) -> Compressed:
    """Analyse a picture, then encode and decode it."""
    made = analyse(pixels, basis, observers, options, bases=bases)
    return Compressed(np.concatenate([made.decode(tile) for tile in made.tiles(pixels)]), made)
