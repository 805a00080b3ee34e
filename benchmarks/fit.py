"""Benchmark of the solvers of the fit at 48 observations: pixels per second against error, compared with NLopt.

All solvers start from the result of our scan, also ``nlopt-reference``, which calls NLopt from Python; both variants of
NLopt use its L-BFGS. There are two geometries: ``own``, in which every texel has its own angles, as on a curved object
or under a near light, and ``shared``, for a flat object under a far light. The error is the share of texels with a sum
of squares more than 0.1 % above the best of a dense scan over μ in float64. The largest errors of parameters without
noise are printed too.

``python -m benchmarks.fit [--size small] [--runs 7] [--output speed_error.csv]``, at the top of the repository. Peak
memory is that of the process while it fits the texels once; times exclude compilation. Small has fewer texels.
"""

import argparse
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.table import COLUMNS, arguments_of, median_s, own_peak_mb, peak_mb_of, report
from irodori.core.threads import use_threads
from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status
from irodori.reflection.equation5 import reflect
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate

ROOT = Path(__file__).resolve().parents[1]
N, K = 1.5, 0.0
KINDS = ("own", "shared")
OBSERVATIONS = 48
TEXELS = {
    "small": {"varpro": 50_000, "nlopt": 4000, "nlopt-reference": 200},
    "full": {"varpro": 200_000, "nlopt": 20_000, "nlopt-reference": 600},
}
CHECKED = {"small": 500, "full": 2000}  # texels whose minimum is compared with a dense scan
CHECKED_OF_REFERENCE = 200
MEGAPIXELS, TILE = 10.1, 40_000


def angles(observations: int = OBSERVATIONS) -> np.ndarray:
    """Return θ_i, θ_r, θ_H, φ of poses in one plane, (J, 4) rad: three lights, cameras around each highlight."""
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
        clean = reflect(a, 1.0, b, m, angles(observations)[None], n=N, k=K)
        response[rows] = clean * (1 + noise * rng.normal(size=clean.shape))
    return alpha, beta, mu, response


def inputs(response: np.ndarray, kind: str):
    """Return the arguments of `fit` for a kind of geometry, ``own`` or ``shared``."""
    geometry = angles(response.shape[1]).astype(np.float32)
    if kind == "own":
        geometry = np.tile(geometry, (len(response), 1, 1))
    return response, geometry, np.ones(response.shape, dtype=np.float32), N, K


def brute_force(response: np.ndarray, mus: np.ndarray) -> np.ndarray:
    """Return the least sum of squares over α, β >= 0 on a dense grid of μ, (texels,)."""
    geometry = angles(response.shape[1]).astype(np.float32).astype(np.float64)
    c, reflectance = np.cos(geometry[:, 0]), fresnel_array(np.cos(geometry[:, 2]), N, K)
    rho = response.astype(np.float64)
    # At a minimum over α, β the sum of squares is the total less the explained part, without computing residuals.
    whole, on_c, cc = np.sum(rho**2, axis=1), rho @ c, c @ c
    best = whole - np.maximum(on_c, 0) ** 2 / cc
    for mu in mus:
        g = reflectance * evaluate("gaussian", mu, geometry)
        gg, cg, on_g = g @ g, c @ g, rho @ g
        if not gg > 0:
            continue
        best = np.minimum(best, whole - np.maximum(on_g, 0) ** 2 / gg)
        determinant = cc * gg - cg * cg
        if determinant > 1e-9 * cc * gg:
            a, b = (gg * on_c - cg * on_g) / determinant, (cc * on_g - cg * on_c) / determinant
            best = np.where((a >= 0) & (b >= 0), np.minimum(best, whole - a * on_c - b * on_g), best)
    return best


def missed_share(options: FitOptions, kind: str, best: np.ndarray) -> float:
    """Return the share of texels, of those fitted with all parameters, that miss the minimum by more than 0.1 %."""
    count = len(best)
    *_, response = scene(count)
    result = fit(*inputs(response, kind), options)
    geometry = angles().astype(np.float32).astype(np.float64)
    beta, mu = result.gloss[:, 0, None], result.gloss[:, 1, None]
    fitted = reflect(result.alpha[:, None], 1.0, beta, mu, geometry[None], n=N, k=K)
    whole = result.model == 3  # a simpler model has a larger sum of squares on purpose
    squares = np.sum((fitted - response) ** 2, axis=1)
    return float((squares > 1.001 * best)[whole].mean())


def exact_errors(options: FitOptions, kind: str, count: int) -> np.ndarray:
    """Return the largest |Δα|, |Δβ|/β, |Δμ|/μ without noise, in double precision."""
    alpha, beta, mu, _ = scene(count)
    clean = reflect(alpha[:, None], 1.0, beta[:, None], mu[:, None], angles()[None], n=N, k=K)
    arguments = (clean, angles() if kind == "shared" else np.tile(angles(), (count, 1, 1)), np.ones(clean.shape), N, K)
    exact = fit(*arguments, options)
    known = exact.status == Status.OK
    off = (exact.alpha - alpha, exact.beta / beta - 1, exact.mu / mu - 1)
    return np.array([np.abs(v[known]).max() for v in off])


def variants() -> dict[str, FitOptions]:
    """Return the options of every variant, the reference first."""
    return {
        "nlopt-reference": FitOptions(solver="nlopt-reference"),
        "nlopt-LD_LBFGS": FitOptions(solver="nlopt"),
        "varpro": FitOptions(),
    }


def measure(runs: int, size: str) -> list[dict]:
    """Return one row of the table for each variant and geometry."""
    counts, mus = {CHECKED[size], CHECKED_OF_REFERENCE}, np.geomspace(0.005, 1.2, 4000)
    best = {count: brute_force(scene(count)[3], mus) for count in counts}
    rows = []
    for kind in KINDS:
        slowest = None
        for variant, options in variants().items():
            texels = TEXELS[size][options.solver]
            arguments = inputs(scene(texels)[3], kind)
            work = partial(fit, *arguments, options)
            seconds = median_s(work, runs)
            checked = CHECKED_OF_REFERENCE if options.solver == "nlopt-reference" else CHECKED[size]
            missed = missed_share(options, kind, best[checked])
            slowest = slowest or seconds / texels
            name = variant if kind == "own" else f"{variant}-shared"
            values = ("fit", name, str(texels), "pixels", f"{seconds:.4f}", f"{texels / seconds:.0f}",
                      "share of pixels 0.1 % above the dense scan", f"{missed:.5f}", f"{peak_mb_of(work):.0f}",
                      f"nlopt-reference{name.removeprefix(variant)}", f"{seconds / texels / slowest:.6f}")  # fmt: skip
            rows.append(dict(zip(COLUMNS, values, strict=True)))
            noiseless = ""
            if size == "full":  # double precision is compiled for it alone
                noiseless = "noise-free errors {:.1e} {:.1e} {:.1e}, ".format(*exact_errors(options, kind, checked))
            print(f"{name:>28} {texels / seconds:>11.0f} pixels/s, {slowest * texels / seconds:>7.1f} x, missed "
                  f"{missed:.5f}, {noiseless}{values[8]} MB, load {os.getloadavg()[0]:.1f}", flush=True)  # fmt: skip
    return rows


def growth(runs: int) -> None:
    """Print times for growing numbers of pixels and observations; a linear solver has a constant time for each."""
    for kind in ("own", "shared"):
        for texels, observations in ((25_000, 48), (50_000, 48), (100_000, 48), (50_000, 24), (50_000, 96)):
            arguments = inputs(scene(texels, observations)[3], kind)
            seconds = median_s(lambda a=arguments: fit(*a, FitOptions()), runs)
            print(f"{kind:>7} {texels:>7} pixels, {observations} observations: {seconds:.3f} s, "
                  f"{1e9 * seconds / texels / observations:.1f} ns each")  # fmt: skip


def capture() -> None:
    """Print time and memory of fitting 10.1 megapixels in 48 poses tile by tile, with angles for each pixel."""
    tiles = [inputs(scene(TILE, seed=s)[3], "own") for s in range(4)]
    noise = np.tile([1e-6, 1e-5], (OBSERVATIONS, 1))
    fit(*tiles[0], FitOptions(), noise=noise)
    start, done = time.perf_counter(), 0
    while done < MEGAPIXELS * 1e6:
        fit(*tiles[done // TILE % len(tiles)], FitOptions(), noise=noise)
        done += TILE
    seconds = time.perf_counter() - start
    print(f"{done / 1e6:.1f} megapixels of {OBSERVATIONS} poses in tiles of {TILE}: {seconds:.1f} s, "
          f"{own_peak_mb():.0f} MB, load {os.getloadavg()[0]:.1f}")  # fmt: skip


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--child", choices=["capture"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    if arguments.child:
        capture()
        return
    rows = measure(arguments.runs, arguments.size)
    if arguments.size == "full":
        growth(arguments.runs)
        subprocess.run([sys.executable, "-m", "benchmarks.fit", "--child", "capture"], cwd=ROOT, check=True)
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
