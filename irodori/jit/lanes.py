"""Names of `irodori.jit.functions` and `irodori.jit.vector_memory` before they were one layer."""

from irodori.jit.functions import exp as exponential
from irodori.jit.functions import log, lower_of, magnitude, negated, root, select, upper_of
from irodori.jit.table_sums import lanes_times_tables
from irodori.jit.vector_memory import lane, load, spread, store
from irodori.jit.vector_memory import mask_bits as bits
from irodori.jit.vectors import LANES as COUNT

__all__ = [
    "COUNT", "bits", "exponential", "lane", "lanes_times_tables", "load", "log", "lower_of", "magnitude", "negated",
    "root", "select", "spread", "store", "upper_of",
]  # fmt: skip
