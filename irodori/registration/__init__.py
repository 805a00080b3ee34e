"""Registration of two pictures of one object, taken without and with a comb-filter plate before the lens."""

from irodori.registration.similarity import Registration, bayer_offsets_px, meets_marked, register, resample

__all__ = ["Registration", "bayer_offsets_px", "meets_marked", "register", "resample"]
