"""Irodori: from RAW photographs of a real object to its picture under any light."""

import hashlib
import os
import tempfile
from pathlib import Path

__version__ = "0.1.0"


def _keep_kernels_with_their_source() -> None:
    """Give compiled loops a cache folder of their own for every state of the package's source.

    numba renews a compiled loop when its own file changes, but not when a function that it calls in another file
    does: a corrected equation would go on being computed wrongly. It reads the folder when it is first imported.
    """
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.read_bytes())
    base = package / "__pycache__"
    if not os.access(package, os.W_OK):
        base = Path(tempfile.gettempdir()) / f"irodori-{os.getuid()}"
    os.environ["NUMBA_CACHE_DIR"] = str(base / f"kernels-{digest.hexdigest()[:16]}")


_keep_kernels_with_their_source()
# Threads of a loop that wait for one another give the core to other jobs instead of spinning on it.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
