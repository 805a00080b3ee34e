"""Irodori: from RAW photographs of a real object to its picture under any light."""

__version__ = "0.1.0"
