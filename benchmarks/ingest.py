"""Benchmark of ingesting a pose of two shots, compared with decoding by LibRaw and writing the same arrays to HDF5.

Full: 10.1 megapixels, twice: from DNG files compressed by lossless JPEG, as in the RAW files of cameras (CR2, NEF,
ARW), and from uncompressed DNG files, which LibRaw only copies (variants that end in ``-unpacked``). Small: 2.5
megapixels, compressed. The filter plate shifts the filtered shot, also that of the chart. Without registration, the
filtered bands therefore belong to other points, which the error shows.

``python -m benchmarks.ingest [--size small] [--runs 7] [--output speed_error.csv]``, at the top of the repository. It
makes its own DNG files in a temporary folder. Peak memory is that of a process that ingests once; its baseline is the
same process after its imports. Times exclude compilation, which is reported separately.
"""

import argparse
import math
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rawpy
import tifffile
import yaml

from benchmarks.plate_pictures import AT_REST, leaves_scene, render
from benchmarks.table import COLUMNS, arguments_of, medians_s, own_peak_mb, report, row_without_figures, why_it_fails
from irodori.config.capture_table import Pose, Shot, write_captures
from irodori.core import store
from irodori.core.threads import use_threads
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.registration.similarity import Registration
from irodori.ingest.stage import ingest_raw
from irodori.simulation.virtual_rig.dng_writer import write_dng
from irodori.simulation.virtual_rig.sensor import Sensor

ROOT = Path(__file__).resolve().parents[1]
SIZES_PX = {"small": (1944, 1296), "full": (3888, 2592)}  # of the mosaic, width and height
EXPOSURE_S = {"out": 0.02, "in": 0.05}
BALANCE = {"out": (0.7, 1.0, 0.5), "in": (0.30, 0.45, 0.2)}
PLATE = Registration(1.6, -0.9, math.radians(0.03), 1.0015, 0.0, 0.0)
POSE = Pose(45.0, 20.0)
PROVENANCE = store.Provenance("benchmark")
#: What packs the photographs; it is tried in a process of its own, and without it they are measured unpacked.
PACKING = "import numpy, imagecodecs; imagecodecs.ljpeg_encode(numpy.zeros((8, 8), numpy.uint16), bitspersample=14)"


class Views(NamedTuple):
    """Responses of the object at each mosaic pixel, one picture (height, width) for each filter state."""

    shot: dict[str, np.ndarray]  # shifted by the filter plate
    still: dict[str, np.ndarray]  # not shifted


def views(size_px: tuple[int, int]) -> Views:
    """Return the responses of both shots, with and without the shift by the filter plate."""
    width, height = size_px[0] // 2, size_px[1] // 2
    scene = leaves_scene(width, height, np.random.default_rng(1), size_px=(6, 120), cover=2.5)
    still = {state: render(scene, width, height, i, AT_REST) for i, state in enumerate(EXPOSURE_S)}
    return Views({"out": still["out"], "in": render(scene, width, height, 1, PLATE)}, still)


def true_response(seen: Views) -> np.ndarray:
    """Return the six bands on superpixels, (height / 2, width / 2, 6), without noise and shift."""
    mosaics = [seen.still[state] for state in EXPOSURE_S]
    bands = [(m[::2, ::2], 0.5 * (m[::2, 1::2] + m[1::2, ::2]), m[1::2, 1::2]) for m in mosaics]
    return np.stack([band for state in bands for band in state], axis=-1)


def pack(path: Path) -> None:
    """Compress the pixels of a DNG file by lossless JPEG, in place."""
    import imagecodecs

    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        mosaic = page.asarray()
        kept = [t for t in page.tags if t.code in (271, 272) or t.code > 33000]
        tags = [(t.code, t.dtype, t.count, t.value, True) for t in kept]
        photometric = page.photometric
    packed = imagecodecs.ljpeg_encode(mosaic, bitspersample=14)
    tifffile.imwrite(path, iter([packed]), shape=mosaic.shape, dtype=mosaic.dtype, photometric=photometric,
                     compression="jpeg", rowsperstrip=mosaic.shape[0], extratags=tags, metadata=None,
                     subfiletype=0)  # fmt: skip


def photograph(folder: Path, seen: Views, packed: bool) -> None:
    """Write dark frames, white references, a chart and the two shots of one pose as DNG files, with their tables."""
    camera = yaml.safe_load((ROOT / "config/cameras/d5100-comb.yaml").read_text())
    sensor = Sensor(**camera["virtual"]["sensor"])
    rng = np.random.default_rng(0)
    height, width = seen.shot["out"].shape
    y, x = np.indices((height, width), sparse=True)
    fall = 1.0 - 0.2 * ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2)
    shots = {"camera": [], "object": []}

    def shoot(kind: str, role: str, light, state: str, exposure_s: float) -> None:
        file = f"{role}-{state}-{exposure_s}-{len(shots[kind])}.dng"
        balance = np.array(BALANCE[state])[y % 2 + x % 2]
        mosaic = sensor.expose(light * balance * fall, exposure_s, rng)
        write_dng(folder / file, mosaic, black_level=sensor.black_level, white_level=sensor.white_level,
                  exposure_s=exposure_s, model="benchmark")  # fmt: skip
        if packed:
            pack(folder / file)
        shots[kind].append(Shot(file, role, POSE, state, exposure_s))

    for exposure_s in (0.02, 0.5):
        for _ in range(2):
            shoot("camera", "dark", np.zeros((1, 1)), "out", exposure_s)
    cosine = np.cos(np.radians(POSE.light_deg))
    for state, exposure_s in EXPOSURE_S.items():
        for _ in range(2):
            shoot("camera", "white", np.full((1, 1), cosine), state, exposure_s)
        shoot("camera", "chart", seen.shot[state], state, exposure_s)
        shoot("object", "object", seen.shot[state], state, exposure_s)
    for kind, group in shots.items():
        write_captures(folder / f"{kind}.csv", group)


def libraw(folder: Path, arrays: dict, threads: int) -> None:
    """Decode the two shots with LibRaw only and write the given arrays as ingestion does, for reference."""

    def decode(path: Path) -> np.ndarray:
        with rawpy.imread(str(path)) as raw:
            return raw.raw_image_visible.copy()

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(decode, sorted(folder.glob("object-*.dng"))))
    with store.create(folder / "same.h5", PROVENANCE) as out:
        for name, values in arrays.items():
            dims = ",".join(f"{name}_{axis}" for axis in range(values.ndim))
            out.write(name, values, units="1", dims=dims, quantity=name, compression="fast")


def ingest(folder: Path, options: IngestOptions) -> None:
    """Ingest the pose."""
    ingest_raw(
        folder / "object.csv",
        folder,
        POSE.name,
        folder / "reference.h5",
        folder / "linear.h5",
        PROVENANCE,
        options=options,
    )


def response_error(folder: Path, truth: np.ndarray) -> float:
    """Return the rms error of the responses over all superpixels and bands, relative to the rms of the true ones."""
    with store.open_file(folder / "linear.h5") as file:
        response, valid = file.read("response"), file.read("valid").astype(bool)
    return float(np.sqrt(np.mean((response - truth)[valid] ** 2) / np.mean(truth[valid] ** 2)))


def peak_mb(folder: Path, variant: str, threads: int) -> float:
    """Return the peak resident memory of a separate process that runs a variant once, MB."""
    command = [sys.executable, "-m", "benchmarks.ingest", "--child", variant, "--folder", str(folder),
               "--threads", str(threads)]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


VARIANTS = {
    "superpixel": IngestOptions(register=False),
    "superpixel-registered": IngestOptions(register=True),
}


def child(folder: Path, variant: str, threads: int) -> None:
    """Run a variant once and print the peak resident memory, MB."""
    if variant == "libraw":
        libraw(folder, read_arrays(folder), threads)
    elif variant != "imports":
        ingest(folder, VARIANTS[variant])
    print(own_peak_mb())


def read_arrays(folder: Path) -> dict:
    """Return the arrays of the file of linear responses."""
    with store.open_file(folder / "linear.h5") as file:
        return {name: file.read(name) for name in ("response", "valid", "clipped")}


def measure(folder: Path, seen: Views, packed: bool, runs: int, threads: int) -> list[dict]:
    """Return one row of the table for each variant, the reference first."""
    photograph(folder, seen, packed)
    ingest_reference(
        folder / "camera.csv", folder, folder / "reference.h5", PROVENANCE, 1.0, IngestOptions(register=True)
    )
    start = time.perf_counter()
    ingest(folder, VARIANTS["superpixel"])
    print(f"first run, compilation included: {time.perf_counter() - start:.2f} s", file=sys.stderr)
    arrays, truth = read_arrays(folder), true_response(seen)
    work = {"libraw": lambda: libraw(folder, arrays, threads)}
    work |= {name: lambda options=options: ingest(folder, options) for name, options in VARIANTS.items()}
    seconds, suffix, rows = medians_s(work, runs), "" if packed else "-unpacked", []
    for variant, median in seconds.items():
        error = float("nan")
        if variant in VARIANTS:
            ingest(folder, VARIANTS[variant])
            error = response_error(folder, truth)
        megapixels = 2 * seen.shot["out"].size / 1e6
        peak = peak_mb(folder, variant, threads)
        rows.append(row(variant, suffix, megapixels, median, seconds["libraw"], error=error, peak=peak))
    print(f"a process after its imports: {peak_mb(folder, 'imports', threads):.0f} MB", file=sys.stderr)
    return rows


def row(
    variant: str, suffix: str, megapixels: float, seconds: float, reference: float, *, error: float, peak: float
) -> dict:
    """Return one row of the table of speed against error."""
    speed, metric = megapixels / seconds, "rms of the response over its own"
    values = ("ingest", variant + suffix, f"{megapixels:.2f}", "megapixels", f"{seconds:.4f}", f"{speed:.1f}", metric,
              f"{error:.5f}", f"{peak:.0f}", "libraw" + suffix, f"{seconds / reference:.3f}")  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--child", choices=["libraw", "imports", *VARIANTS], help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    if arguments.child:
        child(arguments.folder, arguments.child, arguments.threads)
        return
    seen, rows = views(SIZES_PX[arguments.size]), []
    if reason := why_it_fails("-c", PACKING):
        rows += [row_without_figures("ingest", name, reason) for name in ("libraw", *VARIANTS)]
    for packed in (False,) if reason else (True, False)[: 1 if arguments.size == "small" else 2]:
        with tempfile.TemporaryDirectory() as folder:
            rows += measure(Path(folder), seen, packed, arguments.runs, arguments.threads)
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
