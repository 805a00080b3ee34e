"""Names of `irodori.jit.functions` and `irodori.jit.table_sums` before they were one layer."""

from irodori.jit.functions import exp as decaying
from irodori.jit.functions import log as logarithm
from irodori.jit.table_sums import OUTPUTS, TILE, any_above_zero, blend_tile

__all__ = ["OUTPUTS", "TILE", "any_above_zero", "blend_tile", "decaying", "logarithm"]
