"""Decode damaged copies of a RAW file, in a process of its own: LibRaw is C++, and a crash must not end the tests.

``python raw_fuzzer.py FILE FOLDER HEADER_BYTES COUNT SEED`` prints one JSON object with the number of outcomes of each
kind; ``FOLDER`` keeps the file at hand, so that a crash or a hang leaves the one that caused it.
"""

import collections
import json
import random
import sys
import time
from pathlib import Path

from irodori.core.errors import InputError
from irodori.ingest.mosaic import decode


def damaged(content: bytes, header: int, chance: random.Random) -> bytes:
    """Return a file with flipped bits in its header: its first bytes, or its last where the number is negative."""
    out = bytearray(content)
    for _ in range(chance.choice([1, 1, 2, 8])):
        at = chance.randrange(min(abs(header), len(out)))
        out[at if header > 0 else -1 - at] ^= chance.choice([1 << chance.randrange(8), chance.randrange(1, 256)])
    return bytes(out)


def main(source: str, folder: str, header: int, count: int, seed: int) -> dict:
    """Return {outcome: count}, and the longest CPU time of one file under ``slowest_s``."""
    content, chance = Path(source).read_bytes(), random.Random(seed)
    path, found, slowest = Path(folder) / f"damaged{Path(source).suffix}", collections.Counter(), 0.0
    for number in range(count):
        is_cut = number % 5 == 4
        path.write_bytes(content[: chance.randrange(len(content))] if is_cut else damaged(content, header, chance))
        began = time.process_time()
        try:
            decode(path)
            outcome = "cut and decoded" if is_cut else "decoded"
        except InputError as error:
            outcome = "refused" if str(path) in str(error) and "\n" not in str(error) else f"badly worded: {error}"
        except Exception as error:
            outcome = f"{type(error).__name__}: {error}"
        found[outcome] += 1
        slowest = max(slowest, time.process_time() - began)
    return {**found, "slowest_s": slowest}


if __name__ == "__main__":
    print(json.dumps(main(*sys.argv[1:3], *map(int, sys.argv[3:]))))
