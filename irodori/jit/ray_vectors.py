"""Names of `irodori.jit.functions` and `irodori.jit.vector_memory` before they were one layer."""

from irodori.jit.c_functions import cycles
from irodori.jit.functions import (
    as_float,
    bits_as_float,
    bits_as_int,
    root,
    select,
    truncated,
    with_sign,
)
from irodori.jit.functions import lower_of as least
from irodori.jit.functions import magnitude as absolute
from irodori.jit.functions import upper_of as greatest
from irodori.jit.vector_memory import (
    channel_count,
    compress,
    gather,
    lane,
    largest,
    load,
    load_like,
    mask_bits,
    numbered,
    pair_mixed,
    store,
    total,
    zeros_like,
)
from irodori.jit.vector_memory import spread as repeated
from irodori.jit.vectors import width_of

__all__ = [
    "absolute", "as_float", "bits_as_float", "bits_as_int", "channel_count", "compress", "cycles", "gather", "greatest",
    "lane", "largest", "least", "load", "load_like", "mask_bits", "numbered", "pair_mixed", "repeated", "root",
    "select", "store", "total", "truncated", "width_of", "with_sign", "zeros_like",
]  # fmt: skip
