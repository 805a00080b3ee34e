"""Names of the layer's modules before each idea had one."""

from irodori.jit.c_functions import c_function
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import cfunc, njit, uncounted
from irodori.jit.table_sums import vector_times_table
from irodori.jit.vector_memory import aligned
from irodori.jit.vectors import LANES

__all__ = ["LANES", "aligned", "c_function", "cfunc", "njit", "run_chunks", "uncounted", "vector_times_table"]
