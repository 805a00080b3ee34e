"""Irodori: from RAW photographs of a real object to its picture under any light."""

import os

__version__ = "0.1.0"

# Threads of a loop that wait for one another give the core to other jobs instead of spinning on it.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
