"""Compression of a spectral environment, streamed from disk: speed against error, compared with scikit-learn.

``python -m benchmarks.compress [--size small] [--runs 7] [--output speed_error.csv]``. The picture is made of the 99
measured materials of CIE 224 under daylight, a tungsten lamp and an LED, 61 bands in single precision, with a sun a
million times brighter than the shadows and 0.2 % noise. Small: 600 x 300 px, a few variants in one process, times are
medians of alternating runs; fixed work on the sample's colours takes most of each, and the peak memory includes what
earlier variants left. Full: 6000 x 3000 px (4.4 GB in a temporary folder), all variants, each once in a process of its
own, after compilation.

The reference ``read-blas`` reads the file tile by tile and multiplies each tile with itself by BLAS, in single
precision, one after the other. Every variant ends with encoded 61-band spectra: the ``pca`` ones in a file, those of
scikit-learn in memory, because it has no storage. Errors are CIEDE2000 over a sample of 65536 pixels, storage included,
with the picture taken as reflectances under D65 and A; light seen directly would need only three bases, one for each
tristimulus value. ``decode`` reads coefficients back.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.table import COLUMNS, arguments_of, medians_s, own_peak_mb, report, row_without_figures, why_it_fails
from irodori.colour.colorimetry import colour_matching_weights, delta_e_of_light, summary, xyz_from_reflectance
from irodori.core import store
from irodori.core.threads import use_threads
from irodori.material.coefficients import read_coefficients
from irodori.material.principal_components.basis_count import Compression, CompressOptions, analyse
from irodori.material.principal_components.pixel_tiles import TILE_BYTES
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.published import spectrum

ROOT = Path(__file__).resolve().parents[1]
PROVENANCE = store.Provenance("benchmark")
SIZES = {"small": (300, 600), "full": (3000, 6000)}
LIGHTS = ("D65", "A", "LED-B3")
PATCHES = 60  # along the longer side
NOISE, SUN = 0.002, 1e4

#: Variant -> file of the picture, options, number of bases (None: by the colour error).
PCA = {
    "pca-4": ("spectra", CompressOptions(), 4),
    "pca-8": ("spectra", CompressOptions(), 8),
    "pca-12": ("spectra", CompressOptions(), 12),
    "pca-budget": ("spectra", CompressOptions(), None),
    "pca-4-visual": ("spectra", CompressOptions(weighting="visual"), 4),
    "pca-8-visual": ("spectra", CompressOptions(weighting="visual"), 8),
    "pca-budget-visual": ("spectra", CompressOptions(weighting="visual"), None),
    "pca-4-single": ("spectra", CompressOptions(storage="single"), 4),
    "pca-4-lzf": ("spectra", CompressOptions(codec="lzf"), 4),
    "pca-4-from-6": ("bands", CompressOptions(), 4),
    "pca-budget-from-6": ("bands", CompressOptions(), None),
}
OTHER_BASES = 4
#: Variants of another project -> program that tests it first, in a separate process.
PEERS = {
    "sklearn-incremental": "import numpy, sklearn.decomposition as d; d.IncrementalPCA(2).partial_fit(numpy.eye(8))",
    "truncated-svd": "import numpy, sklearn.decomposition as d; d.TruncatedSVD(2).fit_transform(numpy.eye(8))",
}
DECODED = ("pca-4", "pca-4-single", "pca-4-lzf")
#: What is measured after the reference where no variants are named.
VARIANTS = {
    "small": ("pca-4", "pca-budget", "pca-budget-visual", "pca-4-from-6", "sklearn-incremental", "decode-pca-4"),
    "full": (*PCA, "sklearn-incremental", "truncated-svd", *(f"decode-{name}" for name in DECODED)),
}


def palette() -> np.ndarray:
    """Return the spectra in the picture, (297, 61): every material under every light, scaled to Y = 1 for white."""
    materials = np.stack([spectrum(f"TCS{i}") for i in range(99)])
    lights = np.stack([spectrum(name) for name in LIGHTS])
    lights *= colour_matching_weights()[1].sum() / (lights @ colour_matching_weights()[1])[:, None]
    return (materials[None] * lights[:, None]).reshape(-1, 61)


def make_picture(folder: Path, size: str) -> None:
    """Write the picture as spectra and as coefficients on six vectors."""
    height, width = SIZES[size]
    rng = np.random.default_rng(1)
    spectra = palette()
    basis = np.linalg.svd(spectra, full_matrices=False)[2][:6].T
    patch = width // PATCHES
    shape = (-(-height // patch), PATCHES + 1)
    chosen = rng.integers(99, size=(2, *shape))
    chosen += 99 * (np.arange(shape[1]) * len(LIGHTS) // shape[1])
    noise = (1 + NOISE * rng.standard_normal((1 << 15, 61))).astype(np.float32)
    with store.create(folder / "spectra.h5", PROVENANCE) as whole, store.create(folder / "bands.h5", PROVENANCE) as six:
        names = {"units": "1", "dims": "row,column,band", "quantity": "radiance", "compression": "none"}
        out = whole.reserve("radiance", (height, width, 61), np.float32, **names)
        bands = six.reserve("radiance", (height, width, 6), np.float32, **names)
        write_wavelength(six)
        six.write("basis", basis, units="1", dims="wavelength,component", quantity="basis")
        column = np.arange(width)
        for row in range(height):
            mix = np.abs((column % patch) / patch - 0.5)[:, None]
            brightness = 0.01 + 0.99 * np.abs(np.sin(column / width * 7 + row / height * 5))[:, None]
            first, second = (spectra[one[row // patch, column // patch]] for one in chosen)
            line = (brightness * (first + mix * (second - first))).astype(np.float32)
            line *= noise[(column + 7919 * row) % len(noise)]
            if height // 3 <= row < height // 3 + height // 150:
                line[: width // 300] = SUN * spectra[0]
            out[row], bands[row] = line, line @ basis.astype(np.float32)
    os.sync()  # pending writes to the disk would be timed with the next variant


def observers() -> dict:
    """Return matrix to XYZ and white for each light under which colours are compared."""
    return {name: (matrix := xyz_from_reflectance(name), matrix.sum(axis=1)) for name in LIGHTS[:2]}


class Picture:
    """A contiguous dataset (height, width, bands) of float32, read as memory maps of some rows each."""

    def __init__(self, dataset) -> None:
        self._file, self._first_byte, self._shape = dataset.file.filename, dataset.id.get_offset(), dataset.shape

    def __iter__(self) -> Iterator[np.ndarray]:
        height, *row = self._shape
        row_bytes = 4 * int(np.prod(row))
        rows = max(1, TILE_BYTES // row_bytes)
        for first in range(0, height, rows):
            shape = (min(rows, height - first), *row)
            yield np.memmap(self._file, np.float32, "r", self._first_byte + first * row_bytes, shape)


def pca(folder: Path, variant: str) -> Compression:
    """Compress the picture's file into another file and return the compression."""
    name, options, bases = PCA[variant]
    with store.open_file(folder / f"{name}.h5") as file:
        source, size = Picture(file.dataset("radiance")), file.dataset("radiance").shape[:2]
        basis = file.read("basis") if "basis" in file else None
        made = analyse(source, basis, observers(), options, bases=bases)
        with store.create(folder / f"{variant}.h5", PROVENANCE) as out:
            names = {"quantity": "coefficients of the radiance", "codec": options.codec}
            made.write(out, "coefficients", source, size, **names)
            write_wavelength(out)
            out.write("basis", made.basis, units="1", dims="wavelength,component", quantity="basis")
    return made


def tiles_of(source) -> Iterator[np.ndarray]:
    """Yield a picture's pixels (n, 61) tile by tile; all tiles use the same buffer."""
    rows = max(1, (16 << 20) // (source.shape[1] * 244))
    tile = np.empty((rows, *source.shape[1:]), dtype=np.float32)
    for first in range(0, source.shape[0], rows):
        last = min(first + rows, source.shape[0])
        source.read_direct(tile, np.s_[first:last], np.s_[: last - first])
        yield tile[: last - first].reshape(-1, 61)


def read_blas(folder: Path) -> None:
    """Read the picture tile by tile and multiply each tile with itself by BLAS, for reference."""
    with store.open_file(folder / "spectra.h5") as file:
        total = np.zeros((61, 61))
        for tile in tiles_of(file.dataset("radiance")):
            total += tile.T @ tile


def scikit(folder: Path, variant: str):
    """Fit scikit-learn's decomposition and return it with the picture's coefficients."""
    from sklearn.decomposition import IncrementalPCA, TruncatedSVD

    with store.open_file(folder / "spectra.h5") as file:
        source = file.dataset("radiance")
        if variant == "truncated-svd":
            model = TruncatedSVD(OTHER_BASES, random_state=0)
            return model, model.fit_transform(source[()].reshape(-1, 61))
        model = IncrementalPCA(OTHER_BASES)
        # Tiles are processed in turn, because the model cannot be updated by two threads. BLAS also has one thread: a
        # second one is a quarter faster on an idle machine, but five times slower if it must wait for a core.
        with threadpool_limits(1, user_api="blas"):
            for tile in tiles_of(source):
                model.partial_fit(tile)
            return model, np.concatenate([model.transform(tile).astype(np.float32) for tile in tiles_of(source)])


def decode(folder: Path, variant: str, rows: slice = slice(None)) -> int:
    """Read coefficients from a file and return their number."""
    with store.open_file(folder / f"{variant}.h5") as file:
        return read_coefficients(file, "coefficients", rows).size


def run(folder: Path, variant: str):
    """Run a variant once and return its result."""
    if variant.startswith("decode-"):
        return decode(folder, variant.removeprefix("decode-"))
    if variant in PCA:
        return pca(folder, variant)
    if variant == "read-blas":
        read_blas(folder)
        return None
    return scikit(folder, variant)


def error(folder: Path, done) -> dict:
    """Return the worst light's mean and p99 of CIEDE2000, the rms error, and the bases of a variant."""
    if isinstance(done, Compression):
        worst = max(done.errors.values(), key=lambda e: e["mean"])
        return {"mean": worst["mean"], "p99": worst["p99"], "rmse": done.rmse, "bases": done.bases,
                "negative": done.negative}  # fmt: skip
    model, coefficients = done
    chosen = np.sort(np.random.default_rng(0).choice(len(coefficients), 1 << 16, replace=False))
    with store.open_file(folder / "spectra.h5") as file:
        truth = file.dataset("radiance")[()].reshape(-1, 61)[chosen]
    decoded = model.inverse_transform(coefficients[chosen])
    found = [summary(delta_e_of_light(truth @ m.T, decoded @ m.T, white)) for m, white in observers().values()]
    worst = max(found, key=lambda e: e["mean"])
    rmse = float(np.sqrt(np.mean((truth - decoded) ** 2)))
    return {"mean": worst["mean"], "p99": worst["p99"], "rmse": rmse, "bases": OTHER_BASES,
            "negative": float((decoded < 0).mean())}  # fmt: skip


def measured(folder: Path, variant: str) -> dict:
    """Run a variant once after compilation; return ``seconds``, ``peak_mb``, errors and size of the file in MB."""
    if variant in PCA:
        basis = np.eye(61)[:, :6] if PCA[variant][0] == "bands" else None
        analyse(np.ones((100, 61 if basis is None else 6), np.float32), basis, observers(), PCA[variant][1])
    if variant.startswith("decode-"):  # imports the converter
        decode(folder, variant.removeprefix("decode-"), slice(1))
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak to the present memory
    start, done = time.perf_counter(), None
    if variant != "imports":
        done = run(folder, variant)
    found = {"seconds": time.perf_counter() - start, "peak_mb": own_peak_mb()}
    if variant.startswith("decode-"):
        found["coefficients"] = done
    elif done is not None:
        found |= error(folder, done)
    if variant in PCA:
        found["mb"] = (folder / f"{variant}.h5").stat().st_size / 1e6
    return found


def once(folder: Path, variant: str, threads: int) -> dict:
    """Run `measured` in a process of its own and return its result."""
    command = [sys.executable, "-m", "benchmarks.compress", "--child", variant, "--folder", str(folder),
               "--threads", str(threads)]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def measure(folder: Path, size: str, wanted: list[str] | None, runs: int, threads: int) -> list[dict]:
    """Return one row of the table for each variant, the reference first."""
    start = time.perf_counter()
    make_picture(folder, size)
    print(f"the picture: {time.perf_counter() - start:.0f} s to make", file=sys.stderr)
    variants = ["read-blas", *(wanted or VARIANTS[size])]
    reasons = {name: why_it_fails("-c", PEERS[name]) for name in variants if name in PEERS}
    variants = [name for name in variants if not reasons.get(name)]
    if size == "full":
        single = {name: once(folder, name, threads) for name in variants}
        seconds = {name: found["seconds"] for name, found in single.items()}
    else:
        single = {}

        def work(name: str) -> None:
            if name in single:
                run(folder, name)
            else:  # the run that warms up
                single[name] = measured(folder, name)

        seconds = medians_s({name: lambda name=name: work(name) for name in variants}, runs)
    rows = [row(name, size, seconds, single[name]) for name in variants]
    return rows + [row_without_figures("compress", name, reason) for name, reason in reasons.items() if reason]


def row(variant: str, size: str, seconds: dict, found: dict) -> dict:
    """Return one row of the table of speed against error; print the figures that have no column."""
    height, width = SIZES[size]
    work, unit, median = width * height / 1e6, "megapixels", seconds[variant]
    name = variant if size == "small" else f"{variant}-full"
    if "coefficients" in found:
        work, unit = found["coefficients"] / 1e6, "megacoefficients"
    elif "mean" in found:
        packed = f", {found['mb']:.1f} MB" if "mb" in found else ""
        print(f"{name}: {found['bases']} bases, p99 {found['p99']:.3f}, rms {found['rmse']:.2e}, "
              f"negative {found['negative']:.3%}{packed}", file=sys.stderr)  # fmt: skip
    values = ("compress", name, f"{work:.2f}", unit, f"{median:.4f}", f"{work / median:.1f}",
              "mean CIEDE2000, worse light, 65536 pixels", f"{found.get('mean', float('nan')):.5f}",
              f"{found['peak_mb']:.0f}", "read-blas", f"{median / seconds['read-blas']:.3f}")  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--variants", nargs="+", help="all where absent; decode-<variant> needs the variant before it")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    if arguments.child:
        print(json.dumps(measured(arguments.folder, arguments.child)))
        return
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(Path(folder), arguments.size, arguments.variants, arguments.runs, arguments.threads)
        if arguments.size == "full":
            imports = once(Path(folder), "imports", arguments.threads)
            print(f"a process after its imports: {imports['peak_mb']:.0f} MB", file=sys.stderr)
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
