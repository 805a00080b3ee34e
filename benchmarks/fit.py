"""The fit of every solver at 48 observations: pixels a second against error, beside NLopt called from Python.

``nlopt-reference`` starts where our scan ends, as every solver here. It is measured with L-BFGS, which is told the
gradient and is the fastest, and with BOBYQA, which is not. Two geometries: ``own`` (every texel its own angles, as on
a curved object or under a near light) and ``shared`` (a flat object under far light). The error is the share of texels
whose sum of squares exceeds the best of a dense scan over μ in float64 by more than 0.1 %; the largest errors of
noise-free parameters are printed beside it.

``python -m benchmarks.fit [--size small] [--runs 7] [--output speed_error.csv]``,
at the top of the repository. Peak memory is that of a
process that fits the texels once; times exclude compilation.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.table import COLUMNS, arguments_of, median_s, own_peak_mb, report
from irodori.brdf import gloss_factors, reflect
from irodori.fitting import FitOptions, Status, fit
from irodori.fitting.solvers import ACCEPTED_ALGORITHMS
from irodori.threads import use_threads

ROOT = Path(__file__).resolve().parents[1]
N, K = 1.5, 0.0
OBSERVATIONS = 48
TEXELS = {"varpro": 200_000, "nlopt": 20_000, "nlopt-reference": 600}
WITHOUT_GRADIENT = ("LN_BOBYQA",)  # a loop in Python that is given no derivatives
CHECKED = 2000  # texels whose minimum is compared with a dense scan
MEGAPIXELS, TILE = 10.1, 40_000


def angles(observations: int = OBSERVATIONS) -> np.ndarray:
    """Return θ_i, θ_r, θ_H, φ of poses in one plane, (J, 4) rad: three lights, the camera around each highlight."""
    light = np.radians(np.array([25.0, 45.0, 65.0]))[np.arange(observations) % 3]
    camera = light + np.radians(np.linspace(-22.0, 12.0, observations))
    return np.stack([light, np.abs(camera), np.abs(light + camera) / 2, np.abs(light - camera) / 2], axis=1)


def scene(texels: int, observations: int = OBSERVATIONS, noise: float = 0.01, seed: int = 1):
    """Return α, β, μ and the responses of random materials, (texels, J) float32."""
    rng = np.random.default_rng(seed)
    alpha, mu = rng.uniform(0.02, 0.95, texels), np.exp(rng.uniform(np.log(0.04), np.log(0.4), texels))
    beta = 10 ** rng.uniform(-0.3, 1.2, texels)
    response = np.empty((texels, observations), dtype=np.float32)
    for rows in np.array_split(np.arange(texels), max(texels // 20_000, 1)):
        parameters = (p[rows, None] for p in (alpha, beta, mu))
        a, b, m = parameters
        clean = reflect(a, 1.0, b, m, angles(observations)[None], N, K)
        response[rows] = clean * (1 + noise * rng.normal(size=clean.shape))
    return alpha, beta, mu, response


def inputs(response: np.ndarray, kind: str):
    """Return the arguments of `fit` that a geometry calls for."""
    geometry = angles(response.shape[1]).astype(np.float32)
    if kind == "own":
        geometry = np.tile(geometry, (len(response), 1, 1))
    return response, geometry, np.ones(response.shape, dtype=np.float32), N, K


def brute_force(response: np.ndarray, mus: np.ndarray) -> np.ndarray:
    """Return the least sum of squares over α, β >= 0 on a dense grid of μ, (texels,)."""
    geometry = angles(response.shape[1]).astype(np.float32).astype(np.float64)
    c, plain = np.cos(geometry[:, 0]), gloss_factors(geometry, N, K)
    rho = response.astype(np.float64)
    best = np.sum((rho - np.maximum(rho @ c / (c @ c), 0)[:, None] * c) ** 2, axis=1)
    for mu in mus:
        g = plain * np.exp(-np.square(geometry[:, 3] / mu))
        if not g @ g > 0:
            continue
        pair = np.linalg.lstsq(np.stack([c, g], axis=1), rho.T, rcond=None)[0]
        for a, b in (pair, (0 * pair[0], np.maximum(rho @ g / (g @ g), 0))):
            squares = np.sum((a[:, None] * c + b[:, None] * g - rho) ** 2, axis=1)
            best = np.where((a >= 0) & (b >= 0), np.minimum(best, squares), best)
    return best


def errors(options: FitOptions, kind: str, best: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the share of texels that miss the minimum, and the largest |Δα|, |Δβ|/β, |Δμ|/μ without noise."""
    count = len(best)
    *_, response = scene(count)
    result = fit(*inputs(response, kind), options)
    geometry = angles().astype(np.float32).astype(np.float64)
    beta, mu = result.gloss[:, 0, None], result.gloss[:, 1, None]
    fitted = reflect(result.alpha[:, None], 1.0, beta, mu, geometry[None], N, K)
    whole = result.model == 3  # a simpler model has a larger sum of squares on purpose
    squares = np.sum((fitted - response) ** 2, axis=1)
    missed = float((squares > 1.001 * best)[whole].mean())
    alpha, beta, mu, _ = scene(count)
    clean = reflect(alpha[:, None], 1.0, beta[:, None], mu[:, None], angles()[None], N, K)
    arguments = (clean, angles() if kind == "shared" else np.tile(angles(), (count, 1, 1)), np.ones(clean.shape), N, K)
    exact = fit(*arguments, options)
    known = exact.status == Status.OK
    off = (exact.alpha - alpha, exact.beta / beta - 1, exact.mu / mu - 1)
    return missed, np.array([np.abs(v[known]).max() for v in off])


def variants(quick: bool) -> dict[str, FitOptions]:
    """Return the options of every variant, the reference first."""
    algorithms = ("LD_LBFGS",) if quick else ACCEPTED_ALGORITHMS
    return (
        {"nlopt-reference": FitOptions(solver="nlopt-reference")}
        | {f"nlopt-reference-{name}": FitOptions(solver="nlopt-reference", algorithm=name) for name in WITHOUT_GRADIENT}
        | {f"nlopt-{name}": FitOptions(solver="nlopt", algorithm=name) for name in algorithms}
        | {"varpro": FitOptions(solver="varpro"), "varpro-scan-4": FitOptions(solver="varpro", scan_per_octave=4)}
    )


def child(variant: str, kind: str, threads: int) -> float:
    """Return the peak memory of a process that fits once, MB."""
    command = [sys.executable, "-m", "benchmarks.fit", "--child", variant, "--kind", kind, "--threads", str(threads)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


def measure(runs: int, threads: int, quick: bool) -> list[dict]:
    """Return one row a variant and geometry; a quick one tries one algorithm of NLopt on a tenth of the texels."""
    checked = CHECKED // 4 if quick else CHECKED
    best = {count: brute_force(scene(count)[3], np.geomspace(0.005, 1.2, 4000)) for count in (checked, 200)}
    rows = []
    for kind in ("own", "shared"):
        slowest = None
        for variant, options in variants(quick).items():
            texels = TEXELS[options.solver] // (10 if quick and options.solver == "nlopt" else 1)
            arguments = inputs(scene(texels)[3], kind)
            seconds = median_s(lambda a=arguments, o=options: fit(*a, o), runs)
            missed, off = errors(options, kind, best[200 if options.solver == "nlopt-reference" else checked])
            slowest = slowest or seconds / texels
            name = variant if kind == "own" else f"{variant}-shared"
            values = ("fit", name, str(texels), "pixels", f"{seconds:.4f}", f"{texels / seconds:.0f}",
                      "share of pixels 0.1 % above the dense scan", f"{missed:.5f}",
                      f"{child(variant, kind, threads):.0f}", f"nlopt-reference{name.removeprefix(variant)}",
                      f"{seconds / texels / slowest:.6f}")  # fmt: skip
            rows.append(dict(zip(COLUMNS, values, strict=True)))
            print(f"{name:>28} {texels / seconds:>11.0f} pixels/s, {slowest * texels / seconds:>7.1f} x, missed "
                  f"{missed:.5f}, noise-free errors {off[0]:.1e} {off[1]:.1e} {off[2]:.1e}, "
                  f"{values[8]} MB, load {os.getloadavg()[0]:.1f}", flush=True)  # fmt: skip
    return rows


def growth(runs: int) -> None:
    """Print times over pixels and over observations: a linear solver has constant time a pixel and observation."""
    for kind in ("own", "shared"):
        for texels, observations in ((25_000, 48), (50_000, 48), (100_000, 48), (50_000, 24), (50_000, 96)):
            arguments = inputs(scene(texels, observations)[3], kind)
            seconds = median_s(lambda a=arguments: fit(*a, FitOptions()), runs)
            print(f"{kind:>7} {texels:>7} pixels, {observations} observations: {seconds:.3f} s, "
                  f"{1e9 * seconds / texels / observations:.1f} ns each")  # fmt: skip


def capture() -> None:
    """Print time and memory of a 10.1-megapixel capture of 48 poses, fitted tile by tile with a geometry a pixel."""
    tiles = [inputs(scene(TILE, seed=s)[3], "own") for s in range(4)]
    noise = np.tile([1e-6, 1e-5], (OBSERVATIONS, 1))
    fit(*tiles[0], FitOptions(), noise)
    start, done = time.perf_counter(), 0
    while done < MEGAPIXELS * 1e6:
        fit(*tiles[done // TILE % len(tiles)], FitOptions(), noise)
        done += TILE
    seconds = time.perf_counter() - start
    print(f"{done / 1e6:.1f} megapixels of {OBSERVATIONS} poses in tiles of {TILE}: {seconds:.1f} s, "
          f"{own_peak_mb():.0f} MB, load {os.getloadavg()[0]:.1f}")  # fmt: skip


def main() -> None:
    """Measure and print; write a CSV if asked."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--kind", default="own", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    if arguments.child == "capture":
        capture()
        return
    if arguments.child:
        options = variants(False)[arguments.child]
        fit(*inputs(scene(TEXELS[options.solver])[3], arguments.kind), options)
        print(own_peak_mb())
        return
    rows = measure(arguments.runs, arguments.threads, arguments.size == "small")
    if arguments.size == "full":
        growth(arguments.runs)
        subprocess.run([sys.executable, "-m", "benchmarks.fit", "--child", "capture"], cwd=ROOT, check=True)
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
