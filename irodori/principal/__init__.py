"""Principal components of one spectral image [section 7 of the paper].

Two passes over tiles of it: second moments, then coefficients. An image recovered from a few bands has their number
as its rank, so its decomposition is a problem of that size: the 61 bands are never built.
"""

from irodori.principal.compression import Compression, CompressOptions, analyse, choose
from irodori.principal.decomposition import WEIGHTINGS
from irodori.principal.moments import Moments, second_moments
from irodori.principal.positive import Negative, count_negative
from irodori.principal.reflections import drift
from irodori.principal.tiles import Tiles

__all__ = [
    "WEIGHTINGS",
    "CompressOptions",
    "Compression",
    "Moments",
    "Negative",
    "Tiles",
    "analyse",
    "choose",
    "count_negative",
    "drift",
    "second_moments",
]
