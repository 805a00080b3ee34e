"""Name of `irodori.jit.functions.exp` before there was one layer."""

from irodori.jit.functions import exp as exp_negative

__all__ = ["exp_negative"]
