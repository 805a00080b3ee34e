"""Irodori: from RAW photographs of a real object to its picture under any light."""

import importlib
import os
from typing import Any

__version__ = "0.1.0"

#: Names that the package offers, with the module of each. It is imported at first use, and the code hashes of rules do
#: not include it.
_OFFERED = {"open_material": "irodori.material.labelled_material"}

# Threads of a loop that wait for one another give the core to other jobs instead of spinning on it.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# While numba tries which definition of a function fits, it makes errors by the ten thousand that nobody sees. To colour
# them takes a fiftieth of the time of compilation.
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")


def __getattr__(name: str) -> Any:
    if name not in _OFFERED:
        raise AttributeError(f"module 'irodori' has no attribute {name!r}")
    return getattr(importlib.import_module(_OFFERED[name]), name)
