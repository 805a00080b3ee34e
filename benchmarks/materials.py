"""Fit errors of reflection models on measured materials: equation (5), Lambert, Cook-Torrance with GGX.

Bidirectional measurements in ``../shared/data/brdf`` are fitted at every wavelength separately, all observations with
equal weight as in equation (7): α alone (Lambert); α, β and roughness with the Gaussian facets and the V-groove
attenuation of equation (5); α, β and roughness with the GGX distribution and Smith's height-correlated masking (Walter
2007, Heitz 2014). F is the exact Fresnel reflectance for n = 1.5 in both. The error is the root-mean-square residual in
ρ = π f cosθ_i over the root mean square of ρ. `irodori.fitting` fits equation (5); a dense scan over roughness with
bounded minimisation fits GGX. With ``--peer``, SciPy's least squares searches from many starts for a lower minimum.

``--lobes`` shows the lobes and the coat that are chosen (`irodori.fitting.lobe_choice`) from one half of the
directions, and how well all candidates fit that half and predict the other, for light and view up to 70°, where the
outliers of the laboratory begin.

``--halves`` simulates surfaces with 16 to 64 photographs, half of them within 25° of the mirror direction, with the
noise of a camera. Two disjoint halves of the photographs are fitted, and if both have the status OK, they are compared;
each surface alone, and many of one wavelength as texels of one paint.

Values above 20 sr⁻¹ are considered outliers, left out and counted; the figures with them are printed too.

``python -m benchmarks.materials [--peer] [--lobes] [--halves] [--data FOLDER] [--output materials.csv]``, at the top
of the repository.
"""

import argparse
import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from irodori.fitting import gloss_sums
from irodori.fitting.joint_gloss import gloss_of_paints
from irodori.fitting.lobe_choice import candidates, choose, predicted
from irodori.fitting.paint_gloss import PaintGloss, share
from irodori.fitting.paints import MOST_TEXELS
from irodori.fitting.solvers import FitOptions, FitResult, fit, problem_of
from irodori.fitting.texel_sample import Readings
from irodori.material.material_file import Status
from irodori.reflection.coat import COATS
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate

DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"
CORNELL = ("cornell_acryl_blue", "cornell_garnet_red", "cornell_krylon_blue")
PTFE = "nist_ptfe"
MATERIALS = (*CORNELL, PTFE)
MODELS = ("lambert", "equation 5", "ggx")
N, K = 1.5, 0.0
OUTLIER_PER_SR = 20.0
_BOUNDS = {"alpha": (0.0, 2.0), "beta": (0.0, 1e6), "mu_rad": (0.005, 1.2)}
_GGX_ALPHA = (0.003, 1.0)
_SCAN = 400
_STEEPEST_DEG = 70.0
_SEEN_TO_DEG, _NEAR_DEG, _CAMERA = 75.0, 25.0, (1e-6, 1e-5)
_SURFACES, _SEED = 1500, 2
_VISIBLE_UM = (0.4, 0.7)
_HALVES = slice(0, None, 2), slice(1, None, 2)
_PAINTS_NM, _DRAWS = (450.0, 550.0, 650.0), 4
CALLED_OK = (Status.OK, Status.PAINT)
_COMPARED = ("status", "alpha", "beta", "mu", "alpha_error", "beta_error", "mu_error")


class Measured(NamedTuple):
    """BRDF measurements of a material: θ_i, θ_r, θ_H, φ, rad, (J, 4); wavelengths, nm; f, sr⁻¹, (wavelengths, J).

    Angles and f are float32, as the workflow stores observations.
    """

    name: str
    geometry: np.ndarray
    wavelength_nm: np.ndarray
    brdf: np.ndarray

    @property
    def response(self) -> np.ndarray:
        """ρ = π f cosθ_i, (wavelengths, J)."""
        return np.pi * self.brdf * np.cos(self.geometry[:, 0])

    @property
    def trusted(self) -> np.ndarray:
        """Mask of the values that are no outliers, (wavelengths, J) bool."""
        return self.brdf <= OUTLIER_PER_SR


def _direction(theta, phi) -> np.ndarray:
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def _angles(incidence: np.ndarray, view: np.ndarray) -> np.ndarray:
    return angles_from_directions(np.array([0.0, 0.0, 1.0]), _direction(*incidence), _direction(*view))


def read(name: str, folder: Path = DATA) -> list[Measured]:
    """Return the measurements of a material: one entry, or one for each wavelength if their angles differ."""
    if name != PTFE:
        path = folder / "brdf" / f"{name}.csv"
        table = np.genfromtxt(path, delimiter=",", skip_header=1)
        with path.open(encoding="utf-8") as stream:
            wavelength_nm = np.array([float(word) for word in stream.readline().split(",")[4:]])
        angles = table[:, :4].T
        return [_measured(name, angles, wavelength_nm, table[:, 4:].T)]
    table = np.genfromtxt(folder / "brdf" / "nist_ptfe_mueller.csv", delimiter=",", skip_header=1)
    out = []
    for wavelength_um in np.unique(table[:, 0]):
        if _VISIBLE_UM[0] <= wavelength_um <= _VISIBLE_UM[1]:
            rows = table[table[:, 0] == wavelength_um]
            angles = np.radians(rows[:, 1:5]).T
            out.append(_measured(name, angles, np.array([1000.0 * wavelength_um]), rows[None, :, 5]))
    return out


def _measured(name: str, angles: np.ndarray, wavelength_nm: np.ndarray, brdf: np.ndarray) -> Measured:
    geometry = _angles(angles[:2], angles[2:])
    return Measured(name, geometry.astype(np.float32), wavelength_nm, np.ascontiguousarray(brdf, dtype=np.float32))


def _lobe_of(name: str, geometry: np.ndarray) -> Callable[[float], np.ndarray]:
    """Return F D G / cosθ_r of a lobe as a function of its roughness."""
    reflectance = fresnel_array(np.cos(geometry[:, 2]), N, K)
    return lambda roughness: reflectance * evaluate(name, roughness, geometry)


def gauss(geometry: np.ndarray) -> Callable[[float], np.ndarray]:
    """Return F D G / cosθ_r of equation (5) as a function of μ in rad."""
    return _lobe_of("gaussian", geometry)


def ggx(geometry: np.ndarray) -> Callable[[float], np.ndarray]:
    """Return π F D G₂ / (4 cosθ_r), D of GGX and G₂ Smith's, as a function of its roughness α_g."""
    lobe = _lobe_of("ggx", geometry)
    return lambda roughness: lobe(roughness) / (4.0 * roughness * roughness)


def best_pair(cosine: np.ndarray, lobe: np.ndarray, response: np.ndarray) -> tuple[float, float, float]:
    """Return the α, β >= 0 with the least sum of squares, and that sum."""
    found = [(max(cosine @ response / (cosine @ cosine), 0.0), 0.0)]
    square = lobe @ lobe
    if square > 0.0:
        found.append((0.0, max(lobe @ response / square, 0.0)))
        pair = np.linalg.lstsq(np.stack([cosine, lobe], axis=1), response, rcond=None)[0]
        if (pair >= 0.0).all():
            found.append(tuple(pair))
    sums = [float(np.sum((a * cosine + b * lobe - response) ** 2)) for a, b in found]
    best = int(np.argmin(sums))
    return *map(float, found[best]), sums[best]


def least_squares_of(cosine: np.ndarray, lobes: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return the sums of squares of `best_pair` for many lobes, (n,) of (n, J)."""
    cc, cr, rr = cosine @ cosine, cosine @ response, response @ response
    cg, gr, gg = lobes @ cosine, lobes @ response, np.sum(lobes**2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = cc * gg - cg * cg
        a, b = (gg * cr - cg * gr) / determinant, (cc * gr - cg * cr) / determinant
        both = np.where((a >= 0.0) & (b >= 0.0), rr - a * cr - b * gr, np.inf)
        alone = np.where(gg > 0.0, rr - np.maximum(gr, 0.0) ** 2 / gg, np.inf)
    return np.fmin(np.fmin(both, alone), rr - max(cr, 0.0) ** 2 / cc)


def scan(cosine, lobe: Callable, response, grid: np.ndarray, lobes: np.ndarray) -> tuple[float, float, float, float]:
    """Fit α, β and roughness by a scan over roughness and bounded minimisation; return them and the sum of squares.

    Parameters
    ----------
    cosine, response : (J,) float
    lobe : callable
        The lobe as a function of its roughness, (J,).
    grid : (n,) float
        Logarithms of the roughnesses of the scan.
    lobes : (n, J) float
        The lobe there.
    """
    sums = least_squares_of(cosine, lobes, response)
    best = int(np.argmin(sums))
    bracket = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found = minimize_scalar(
        lambda t: best_pair(cosine, lobe(math.exp(t)), response)[2],
        bounds=bracket, method="bounded", options={"xatol": 1e-9},
    )  # fmt: skip
    at_node = best_pair(cosine, lobes[best], response)[2]
    roughness = math.exp(found.x if found.fun <= at_node else grid[best])
    alpha, beta, squares = best_pair(cosine, lobe(roughness), response)
    return alpha, beta, roughness, squares


class Fitted(NamedTuple):
    """A fit at every wavelength: parameters, (wavelengths, 3), and predictions of ρ, (wavelengths, J)."""

    parameters: np.ndarray
    predicted: np.ndarray


def fit_all(measured: Measured, keep_outliers: bool = False) -> dict[str, Fitted]:
    """Fit every model to a material and return the fits by the model's name."""
    kept = np.ones(measured.brdf.shape, dtype=bool) if keep_outliers else measured.trusted
    response, geometry = measured.response, measured.geometry
    cosine = np.cos(geometry[:, 0])
    out = {}
    alpha = (kept * response) @ cosine / (kept @ cosine**2)
    out["lambert"] = Fitted(np.stack([alpha, 0 * alpha, 0 * alpha + 1.0], axis=1), alpha[:, None] * cosine)
    options = FitOptions(bounds=_BOUNDS)
    result = fit(response, geometry, kept.astype(float), N, K, options)
    parameters = np.column_stack([result.alpha, result.gloss])
    a, b, m = (parameters[:, i, None] for i in range(3))
    out["equation 5"] = Fitted(parameters, reflect(a, 1.0, b, m, geometry[None], n=N, k=K))
    lobe, grid, rows = ggx(geometry), np.linspace(*np.log(_GGX_ALPHA), _SCAN), []
    lobes = np.stack([lobe(math.exp(t)) for t in grid])  # the same at all wavelengths
    for here, rho in zip(kept, response, strict=True):
        rows.append(scan(cosine[here], _only(lobe, here), rho[here], grid, lobes[:, here])[:3])
    predicted = np.stack([a * cosine + b * lobe(r) for a, b, r in rows])
    out["ggx"] = Fitted(np.array(rows), predicted)
    return out


def _only(lobe: Callable, kept: np.ndarray) -> Callable:
    return lambda roughness: lobe(roughness)[kept]


def relative(measured: Measured, fitted: Fitted, chosen: np.ndarray) -> float:
    """Return the root-mean-square residual over the root-mean-square response, of selected values."""
    off = (fitted.predicted - measured.response)[chosen]
    return float(np.sqrt(np.mean(off**2) / np.mean(measured.response[chosen] ** 2)))


def peer(measured: Measured, model: str, wavelength: int, starts: int = 40, seed: int = 0) -> float:
    """Return the least sum of squares that SciPy's least squares finds from many starts."""
    kept = measured.trusted[wavelength]
    rho, cosine = measured.response[wavelength, kept], np.cos(measured.geometry[kept, 0])
    lobe = {"equation 5": gauss, "ggx": ggx}[model](measured.geometry[kept])
    limits = {"equation 5": _BOUNDS["mu_rad"], "ggx": _GGX_ALPHA}[model]
    low, high = np.array([0.0, 0.0, math.log(limits[0])]), np.array([2.0, 1e6, math.log(limits[1])])
    rng, best = np.random.default_rng(seed), np.inf
    for _ in range(starts):
        t = rng.uniform(low[2], high[2])
        top = lobe(math.exp(t)).max()
        start = [rng.uniform(0.0, 1.0), min(rng.uniform(0.1, 2.0) * rho.max() / max(top, 1e-12), 9e5), t]
        found = least_squares(
            lambda x: x[0] * cosine + x[1] * lobe(math.exp(x[2])) - rho,
            start, bounds=(low, high), x_scale=[0.1, max(start[1], 1e-6), 0.1], xtol=1e-12, ftol=1e-12, gtol=1e-14,
        )  # fmt: skip
        best = min(best, 2.0 * found.cost)
    return best


def rows_of(name: str, folder: Path = DATA) -> list[dict]:
    """Return the table's rows of a material: errors of every model in all, by angle of incidence, and by wavelength."""
    out = []
    for measured in read(name, folder):
        whole, trusted = fit_all(measured, keep_outliers=True), measured.trusted
        incidence = np.round(np.degrees(measured.geometry[:, 0])).astype(int)
        parts = {f"θ_i {angle}°": trusted & (incidence == angle) for angle in np.unique(incidence)}
        if len(measured.wavelength_nm) > 1:
            bands = np.digitize(measured.wavelength_nm, [500.0, 600.0])
            for band, label in enumerate(("400..490 nm", "500..590 nm", "600..700 nm")):
                parts[label] = trusted & (bands == band)[:, None]
        label = name if len(measured.wavelength_nm) > 1 else f"{name} {measured.wavelength_nm[0]:.0f} nm"
        for model, fitted in fit_all(measured).items():
            base = {"material": label, "model": model, "outliers": int((~trusted).sum()), "values": trusted.size}
            out.append(base | {"part": "all", "relative_rms": relative(measured, fitted, trusted)})
            everything = relative(measured, whole[model], np.ones_like(trusted))
            out.append(base | {"part": "all, outliers fitted too", "relative_rms": everything})
            out += [base | {"part": p, "relative_rms": relative(measured, fitted, c)} for p, c in parts.items()]
    return out


def peer_rows(name: str, folder: Path = DATA) -> list[tuple[str, str, float, float]]:
    """Return material, model, wavelength in nm, and our fit's sum of squares over that of SciPy's least squares."""
    out = []
    for measured in read(name, folder):
        fitted = fit_all(measured)
        for w in range(0, len(measured.wavelength_nm), 10):
            kept = measured.trusted[w]
            for model in MODELS[1:]:
                off = fitted[model].predicted[w, kept] - measured.response[w, kept]
                ratio = float(np.sum(off**2)) / peer(measured, model, w)
                out.append((name, model, float(measured.wavelength_nm[w]), ratio))
    return out


def choices(name: str, folder: Path = DATA, seed: int = 0) -> list[dict]:
    """Return the residuals of every candidate for a material's lobes, on the fitted half of directions and the rest."""
    out = []
    for measured in read(name, folder):
        geometry, response = measured.geometry, measured.response
        kept = measured.trusted.all(axis=0) & (geometry[:, :2] < np.radians(_STEEPEST_DEG)).all(axis=1)
        order = np.random.default_rng(seed).permutation(np.flatnonzero(kept))
        halves = [
            Readings(
                response[:, half], np.ones((len(response), len(half))),
                np.broadcast_to(geometry[half], (len(response), len(half), 4)), np.full((len(half), 2), np.nan), N, K,
            )
            for half in (order[::2], order[1::2])
        ]  # fmt: skip
        options = FitOptions(bounds=_BOUNDS)
        chosen, found = choose(halves[0], options, candidates(options, coats=COATS))
        for one in found:
            own = replace(options, lobes=one.lobes, coat=one.coat)
            result = fit(halves[0].response, geometry[order[::2]], halves[0].weight, N, K, own)
            fitted, held = (_off(half, result, halves[0], own) for half in halves)
            label = name if len(measured.wavelength_nm) > 1 else f"{name} {measured.wavelength_nm[0]:.0f} nm"
            out.append({"material": label, "lobes": "+".join(one.lobes), "coat": one.coat,
                        "chosen": (one.lobes, one.coat) == chosen,
                        "behind": one.behind, "behind_error": one.behind_error, "fitted_rms": fitted[0],
                        "fitted_median": fitted[1], "held_out_rms": held[0], "held_out_median": held[1]})  # fmt: skip
    return out


def _off(sample: Readings, result: FitResult, fitted: Readings, options: FitOptions) -> tuple[float, float]:
    """Return the rms residual over the rms response, and the median of residual over response."""
    sample, fitted = (replace(one, coupled=options.is_coupled) for one in (sample, fitted))
    off = predicted(sample, result.gloss, fitted, options) - sample.response
    relative_rms = float(np.sqrt(np.mean(off**2) / np.mean(sample.response**2)))
    return relative_rms, float(np.median(np.abs(off) / np.maximum(sample.response, np.finfo(float).tiny)))


def _surfaces(name: str, photographs: int, surfaces: int, rng, folder: Path, wavelength_nm: float | None = None):
    """Return simulated responses and angles of surfaces of a material, (surfaces, photographs) and the same by 4.

    Each surface has one of the measured wavelengths, or all the one nearest to ``wavelength_nm``.
    """
    measured, *_ = read(name, folder)
    kept = measured.trusted.all(axis=0) & (measured.geometry[:, :2] < np.radians(_SEEN_TO_DEG)).all(axis=1)
    every, near = np.flatnonzero(kept), np.flatnonzero(kept & (measured.geometry[:, 3] < np.radians(_NEAR_DEG)))
    chosen = np.empty((surfaces, photographs), dtype=int)
    for row in chosen:
        row[: photographs // 2] = rng.choice(near, photographs // 2, replace=False)
        rest = np.setdiff1d(every, row[: photographs // 2])
        row[photographs // 2 :] = rng.choice(rest, photographs - photographs // 2, replace=False)
        rng.shuffle(row)
    band = rng.integers(len(measured.wavelength_nm), size=(surfaces, 1))
    if wavelength_nm is not None:
        band = np.argmin(np.abs(measured.wavelength_nm - wavelength_nm))
    clean = measured.response[band, chosen]
    response = clean + np.sqrt(_CAMERA[0] + _CAMERA[1] * np.abs(clean)) * rng.normal(size=clean.shape)
    return response.astype(np.float32), measured.geometry[chosen]


def _agreement(one: dict, other: dict) -> dict[str, float]:
    """Return the share of surfaces that are OK in both halves, and how many of these agree within 2σ, by parameter.

    Both have status, parameters and their standard errors by name. A parameter's ``told`` is the share of all surfaces
    that are OK and for which both halves state it.
    """
    both = np.isin(one["status"], CALLED_OK) & np.isin(other["status"], CALLED_OK)
    out = {"ok": float(both.mean())}
    for name in ("alpha", "beta", "mu"):
        apart = one[name][both] - other[name][both]
        error = np.hypot(one[f"{name}_error"][both], other[f"{name}_error"][both])
        told = np.isfinite(error)
        out[name] = float(np.mean(np.abs(apart[told]) < 2.0 * error[told])) if told.any() else math.nan
        out[f"{name}_told"] = float(told.sum() / len(both))
    return out


def together(draws: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return what `_agreement` gives for the surfaces of several draws together."""
    out = {"ok": float(np.mean([draw["ok"] for draw in draws]))}
    for name in ("alpha", "beta", "mu"):
        told = np.array([draw[f"{name}_told"] for draw in draws])
        agree = np.nan_to_num([draw[name] for draw in draws]) @ told
        out[name] = float(agree / told.sum()) if told.any() else math.nan
    return out


def halves(name: str, lobe: str, photographs: int, surfaces: int, seed: int, folder: Path = DATA) -> dict[str, float]:
    """Return the share of surfaces with status OK in both halves of the photographs, and how many of these agree.

    For each parameter, halves agree if they differ by less than two standard errors of the difference.
    """
    response, geometry = _surfaces(name, photographs, surfaces, np.random.default_rng(seed), folder)
    noise, options = np.tile(_CAMERA, (photographs // 2, 1)), FitOptions(lobes=(lobe,))
    return _agreement(
        *(
            vars(
                fit(response[:, half], geometry[:, half], np.ones(response[:, half].shape), N, K, options, noise=noise)
            )
            for half in _HALVES
        )
    )


def gloss_of_halves(
    name: str, lobe: str, photographs: int, wavelength_nm: float, seed: int, folder: Path = DATA
) -> list[tuple[FitResult, gloss_sums.SearchedTexels, PaintGloss | None]]:
    """Return, for two halves of the photographs of one paint, fits of its texels alone, packed texels, and their gloss.

    The halves share the light level, so its error is left out.
    """
    rng = np.random.default_rng(seed)
    response, geometry = _surfaces(name, photographs, MOST_TEXELS, rng, folder, wavelength_nm)
    noise, options = np.tile(_CAMERA, (photographs // 2, 1)), FitOptions(lobes=(lobe,), level_error=0.0)
    out: list = []
    for half in _HALVES:
        seen = response[:, half], geometry[:, half], np.ones(response[:, half].shape)
        surface = gloss_sums.pack(*problem_of(*seen, N, K, options, noise=noise), sides=True)
        (gloss,), _ = gloss_of_paints([surface], options.nodes())
        out.append((fit(*seen, N, K, options, noise=noise), surface, gloss))
    return out


def halves_of_paint(
    name: str, lobe: str, photographs: int, wavelength_nm: float, seed: int, folder: Path = DATA
) -> dict[str, float]:
    """Return the same as `halves` for the texels of one paint, which are fitted with the paint's gloss.

    Texels that contradict it keep their own fit.
    """
    fits = []
    for alone, surface, gloss in gloss_of_halves(name, lobe, photographs, wavelength_nm, seed, folder):
        own = vars(alone)
        if gloss is not None:
            shared = share(surface, gloss)
            own = {key: np.where(shared.agrees, getattr(shared, key, Status.PAINT), own[key]) for key in _COMPARED}
        fits.append(own)
    return _agreement(*fits)


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peer", action="store_true", help="compare the minima with scipy's least squares")
    parser.add_argument("--lobes", action="store_true", help="show the lobes that are chosen, and what each leaves")
    parser.add_argument("--halves", action="store_true", help="compare fits of two halves of the photographs")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--output", type=Path, help="CSV to write")
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        if not arguments.output:
            parser.error(f"no measured materials at {arguments.data}")
        print(f"skipped: no measured materials at {arguments.data}")
        arguments.output.write_text("material,model,outliers,values,part,relative_rms\n", encoding="utf-8")
        return
    rows = [row for name in MATERIALS for row in rows_of(name, arguments.data)]
    print(f"{'material':>22} {'part':>26} {'outliers':>9} " + " ".join(f"{m:>11}" for m in MODELS))
    for row in rows:
        if row["model"] == MODELS[0]:
            same = {r["model"]: r for r in rows if (r["material"], r["part"]) == (row["material"], row["part"])}
            values = " ".join(f"{same[m]['relative_rms']:>11.3f}" for m in MODELS)
            print(f"{row['material']:>22} {row['part']:>26} {row['outliers']:>4}/{row['values']:<6} {values}")
    if arguments.peer:
        for name in MATERIALS:
            for row in peer_rows(name, arguments.data):
                print("{} {} {:.0f} nm: sum of squares over the peer's {:.6f}".format(*row))
    if arguments.halves:
        for name, lobe, count in product(CORNELL, ("gaussian", "ggx"), (16, 32, 64)):
            found = halves(name, lobe, count, _SURFACES, _SEED, arguments.data)
            text = "{:>22} {:>9} {:>3} photographs: both OK {ok:.3f}; agree α {alpha:.2f}, β {beta:.2f}, μ {mu:.2f}"
            print(text.format(name, lobe, count, **found))
            draws = [
                halves_of_paint(name, lobe, count, wavelength, _SEED + draw, arguments.data)
                for wavelength, draw in product(_PAINTS_NM, range(_DRAWS))
            ]
            told = sum(not math.isnan(draw["mu"]) for draw in draws)
            by_paint = text.replace("photographs:", f"photographs, by paint, {told} of {len(draws)} draws told:")
            print(by_paint.format(name, lobe, count, **together(draws)))
    if arguments.lobes:
        for row in (row for name in MATERIALS for row in choices(name, arguments.data)):
            print(
                "{material:>22} {lobes:>17} {coat:>7} {0:>6} behind {behind:.3f} ± {behind_error:.3f}; rms, median: "
                "fitted {fitted_rms:.3f} {fitted_median:.3f}, held out {held_out_rms:.3f} {held_out_median:.3f}".format(
                    "chosen" if row["chosen"] else "", **row
                )
            )
    if arguments.output:
        with arguments.output.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
