"""Benchmark of stated errors: how often true values of the default objects lie within them, over many virtual rigs.

``python -m benchmarks.coverage [--rigs 14] [--objects NAME ...] [--output coverage.csv]``, at the top of the
repository. Each rig has its own seed, so its own lamp drift, errors of the angles, hot pixels and noise. Snakemake
makes the materials of all objects, some 75 s for each rig. Counted are texels away from seams.

The lamp's drift between the white reference and an object is one number for the object and a rig, and most of the error
of α and β, so that a few rigs say little about how often it lies within the stated errors. The simulated drift is
known, though: it is taken out of the measured values, and the shares are integrated over all drifts that this lamp may
have, a normal distribution. Errors of angles and paints remain as they were drawn.
"""

import argparse
import csv
import math
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from scipy.stats import norm

from benchmarks.ten_megapixels import ROOT, run_chain
from irodori.config.capture_table import Shot, read_captures
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import Imperfections, VirtualRig
from irodori.core import store
from irodori.evaluation.truth_errors import comparable_gloss, interior
from irodori.material.material_file import Material
from irodori.simulation.virtual_rig.imperfections import Faults

OBJECTS = ("tile-plate", "vermilion-sphere", "indigo-sphere", "leaf-sphere")
CAMERA = "d5100-comb"
_RIG = Path("config/rigs/virtual.yaml")
_SHARES = ("within_1_sigma", "within_2_sigma")
_COLUMNS = ("object", "quantity", "rigs", "values", *_SHARES)
_ERRORS = ("error_of_1_sigma", "error_of_2_sigma")


class Drift(NamedTuple):
    """Lamp during the photographs of an object over that during the white reference: the ratio, and its deviation."""

    ratio: float
    sigma: float


def drift(faults: Imperfections, seed: int, camera: Sequence[Shot], name: str, shots: Sequence[Shot]) -> Drift:
    """Return the lamp's drift on a virtual rig during the photographs without the filter, which tell α and β.

    Parameters
    ----------
    faults : Imperfections
    seed : int
        Of the rig.
    camera, shots : sequence of Shot
        Tables of photographs of its camera and of an object.
    name : str
        Of the object.
    """
    means, variance = [], 0.0
    memory, rms = math.exp(-1.0 / faults.light_drift.correlation_shots), faults.light_drift.relative_rms
    rms *= faults.light_drift.enabled
    for session, every, role in ((CAMERA, camera, "white"), (name, shots, "object")):
        found = Faults(faults, seed, session, every)
        at = np.array([n for n, shot in enumerate(every) if shot.role == role and shot.filter == "out"])
        means.append(np.mean([found.light(every[n]) for n in at]))
        # Of the mean of a first-order autoregressive process.
        variance += rms**2 * np.mean(memory ** np.abs(at[:, None] - at))
    return Drift(float(means[1] / means[0]), math.sqrt(variance))


def shares(off: np.ndarray, spread: np.ndarray, stated: np.ndarray) -> tuple[float, float]:
    """Return how often errors lie within one and two stated errors if a normal error of ``spread`` is added to each."""
    found = []
    for count in (1.0, 2.0):
        with np.errstate(divide="ignore"):
            high, low = (side * count * stated - off for side in (1.0, -1.0))
            inside = norm.cdf(high / spread) - norm.cdf(low / spread)
        found.append(float(np.where(spread > 0.0, inside, np.abs(off) <= count * stated).mean()))
    return found[0], found[1]


def errors_of(
    found: Material, truth: Material, stated: dict[str, np.ndarray], bands: np.ndarray, lamp: Drift
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return errors without the lamp's drift, the standard deviation that drifts add, and the stated errors.

    Parameters
    ----------
    found, truth : Material
    stated : dict
        ``alpha``, ``beta`` and ``mu``, (height, width) each, and ``reflectance``, (height, width, n).
    bands : (n,) int
        Indices of the wavelengths at which errors of reflectance are stated.
    lamp : Drift
    """
    inner, (beta, mu) = interior(truth), comparable_gloss(found, truth)[0]
    coloured = found.observed & inner & (truth.alpha > 0.0)
    estimate, exact = (m.coefficients[coloured] @ m.basis.T[:, bands] for m in (found, truth))
    none = Drift(1.0, 0.0)
    pairs = {
        "alpha": (found.alpha[coloured], truth.alpha[coloured], stated["alpha"][coloured], lamp),
        "beta": (found.beta[inner], beta[inner], stated["beta"][inner], lamp),
        "mu": (found.mu[inner], mu[inner], stated["mu"][inner], none),
        "reflectance": (estimate, exact, stated["reflectance"][coloured], lamp),
    }
    out = {}
    for quantity, (value, true, error, one) in pairs.items():
        known = np.isfinite(value) & np.isfinite(true) & np.isfinite(error)
        if known.any():
            out[quantity] = (value / one.ratio - true)[known], one.sigma * np.abs(true[known]), error[known]
    return out


def measured(folder: Path, name: str, lamp: Drift) -> dict[str, tuple[int, float, float]]:
    """Return the number of values of each quantity, and their shares within one and two stated errors, of an object."""
    files = {kind: folder / f"results/{name}/{kind}.h5" for kind in ("material", "truth")}
    found, truth = (Material.load(path) for path in files.values())
    with store.open_file(files["material"]) as file:
        stated = {key: file.read(f"{key}_error") for key in ("alpha", "beta", "mu")}
        stated["reflectance"] = file.read("spectral_error")
        bands = np.searchsorted(file.read("wavelength"), file.read("error_wavelength"))
    errors = errors_of(found, truth, stated, bands, lamp)
    return {quantity: (len(one[0].ravel()), *shares(*one)) for quantity, one in errors.items()}


def with_seed(folder: Path, seed: int) -> None:
    """Give the virtual rig of a project a seed."""
    rig = yaml.safe_load((folder / _RIG).read_text(encoding="utf-8"))
    rig["virtual"]["seed"] = seed
    (folder / _RIG).write_text(yaml.safe_dump(rig, sort_keys=False), encoding="utf-8")


def rows_of(folder: Path, seed: int, objects: Sequence[str]) -> list[dict]:
    """Return the table's rows of one rig, whose materials and true materials are in a project."""
    rigs = load_definitions(read_yaml(folder / "config/config.yaml"), folder).plain()["rigs"]
    faults = VirtualRig.of(rigs["virtual"]["virtual"]).imperfections
    camera = read_captures(folder / f"results/cameras/{CAMERA}/captures.csv")
    rows = []
    for name in objects:
        lamp = drift(faults, seed, camera, name, read_captures(folder / f"results/{name}/captures.csv"))
        for quantity, (count, one, two) in measured(folder, name, lamp).items():
            rows.append(dict(zip(_COLUMNS, (name, quantity, 1, count, one, two), strict=True)))
    return rows


def together(rows: Sequence[dict]) -> list[dict]:
    """Return the mean over rigs and its standard error for each object and quantity, in order of first occurrence."""
    out = []
    for name, quantity in dict.fromkeys((row["object"], row["quantity"]) for row in rows):
        same = [row for row in rows if (row["object"], row["quantity"]) == (name, quantity)]
        each = np.array([[row[key] for key in _SHARES] for row in same])
        apart = each.std(axis=0, ddof=1) / math.sqrt(len(same)) if len(same) > 1 else np.full(2, math.nan)
        figures = len(same), sum(row["values"] for row in same), *each.mean(axis=0).tolist(), *apart.tolist()
        out.append(dict(zip((*_COLUMNS, *_ERRORS), (name, quantity, *figures), strict=True)))
    return out


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=14, help="number of virtual rigs")
    parser.add_argument("--objects", nargs="+", default=OBJECTS, choices=OBJECTS)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--output", type=Path, help="CSV to write")
    given = parser.parse_args()
    rows = []
    for seed in range(1, given.rigs + 1):
        with tempfile.TemporaryDirectory(prefix="irodori-") as temporary:
            folder = Path(temporary)
            shutil.copytree(ROOT / "config", folder / "config")
            with_seed(folder, seed)
            files = [f"results/{name}/{kind}.h5" for name in given.objects for kind in ("material", "truth")]
            seconds = run_chain(folder, given.cores, *files)
            print(f"rig {seed} of {given.rigs}: {seconds:.0f} s", flush=True)
            rows += rows_of(folder, seed, given.objects)
    found = together(rows)
    for row in found:
        text = "{object:>17} {quantity:>12}: {values:>9} values on {rigs} rigs, "
        text += (
            "within 1σ {within_1_sigma:.1%} ± {error_of_1_sigma:.1%}, 2σ {within_2_sigma:.1%} ± {error_of_2_sigma:.1%}"
        )
        print(text.format(**row))
    if given.output:
        with given.output.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, (*_COLUMNS, *_ERRORS), lineterminator="\n")
            writer.writeheader()
            writer.writerows(found)


if __name__ == "__main__":
    main()
