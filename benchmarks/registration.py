"""Benchmark of registering the two filter states of a 10.1-megapixel camera: speed against error.

``python -m benchmarks.registration [output.csv]`` writes a table with the columns of ``speed_error.csv``; the reference
is Gauss-Newton over all superpixels of the finest level.
"""

import csv
import os
import resource
import statistics
import sys
import time

import numpy as np

from benchmarks.plate_pictures import AT_REST, errors_px, leaves_scene, photograph, random_truth, render
from benchmarks.table import COLUMNS
from irodori.geometry.pinhole import bayer_offsets_px
from irodori.ingest.registration import similarity
from irodori.ingest.registration.similarity import register, resample

WIDTH, HEIGHT, RUNS = 1944, 1296, 5
# name -> finest level's pixels, places compared there, elsewhere and in the search, whether the bands' places are given
VARIANTS = {
    "all-pixels": (10**9, (10**9, 10**9, 4_000), False),
    "finest": (10**9, (60_000, 12_000, 4_000), False),
    "reduced-400k": (800_000, (400_000, 12_000, 4_000), False),
    "reduced-20k": (800_000, (20_000, 12_000, 4_000), False),
    "reduced": (800_000, (60_000, 12_000, 4_000), False),
    "reduced-bands": (800_000, (60_000, 12_000, 4_000), True),
}


def _pair(seed: int):
    rng = np.random.default_rng(seed)
    scene, truth = leaves_scene(WIDTH, HEIGHT, rng, size_px=(6, 120), cover=2.5), random_truth(rng)
    fixed, fixed_valid = photograph(render(scene, WIDTH, HEIGHT, 0, AT_REST), 0, rng)
    moving, moving_valid = photograph(render(scene, WIDTH, HEIGHT, 1, truth), 1, rng)
    return (fixed, moving, fixed_valid, moving_valid), truth


def measure(output) -> None:
    """Time all variants on two scenes, resampling included, and write times and largest errors to a table."""
    pairs, rows, reference = [_pair(seed) for seed in range(2)], [], None
    for name, (finest, places, bands) in VARIANTS.items():
        similarity._FINEST_PIXELS, similarity._PLACES = finest, places
        offsets, seconds, worst = bayer_offsets_px("RGGB") if bands else None, [], 0.0
        for run in range(RUNS + 1):
            for pictures, truth in pairs:
                start = time.perf_counter()
                found = register(*pictures, band_offsets_px=offsets)
                resample(pictures[1], pictures[3], found)
                if run:  # the first one compiles
                    seconds.append(time.perf_counter() - start)
                worst = max(worst, float(errors_px(found, truth, WIDTH, HEIGHT).max()))
        median = statistics.median(seconds)
        reference = reference or median
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        values = ("ingest", f"register-{name}", WIDTH * HEIGHT, "superpixel", f"{median:.3f}",
                  f"{WIDTH * HEIGHT / median:.3g}", "largest error at corners and centre, superpixels", f"{worst:.4f}",
                  f"{peak:.0f}", "register-all-pixels", f"{median / reference:.3f}")  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
        print(*values, "load", f"{os.getloadavg()[0]:.1f}", flush=True)
    with open(output, "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    measure(sys.argv[1] if len(sys.argv) > 1 else "registration_speed_error.csv")
