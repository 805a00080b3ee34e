"""Principal components of one spectral image [section 7 of the paper].

Two passes over tiles of it: second moments, then coefficients. An image recovered from a few bands has their number
as its rank, so its decomposition is a problem of that size: the 61 bands are never built.
"""

from irodori.principal.compression import Compressed, Compression, CompressOptions, analyse, choose, compress
from irodori.principal.decomposition import WEIGHTINGS, principal_basis
from irodori.principal.moments import Moments, second_moments
from irodori.principal.positive import Negative, count_negative, without_negative
from irodori.principal.reflections import drift
from irodori.principal.tiles import Tiles, require_grid, spectral_tiles

__all__ = [
    "WEIGHTINGS",
    "CompressOptions",
    "Compressed",
    "Compression",
    "Moments",
    "Negative",
    "Tiles",
    "analyse",
    "choose",
    "compress",
    "count_negative",
    "drift",
    "principal_basis",
    "require_grid",
    "second_moments",
    "spectral_tiles",
    "without_negative",
]
