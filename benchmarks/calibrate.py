"""Benchmark of the estimators of reflectance: speed against error, and errors on measured spectra.

``python -m benchmarks.calibrate [--size small] [--runs 7] [--output speed_error.csv]`` applies each estimator to a
picture of 2 megapixels of six bands, half a megapixel in small; the reference is a bare BLAS product of the same size
in the same run. The variant ``posterior`` computes the standard errors for a 64th of that picture. Other outputs
instead: ``--table`` prints the errors of every estimator and of the best linear one, for all sets, cameras and noise
levels; ``--error-bars`` prints how often errors lie within the stated ones, on sets left out in turn; and
``--response-models`` prints how much tables of filters and sensitivities improve the response model. All read the
measured spectra in ``../shared/data``. Times exclude compilation, which is reported separately; peak memory is that of
this process while a variant runs, with the picture and all estimators in it.
"""

import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.response_models import errors as response_errors
from benchmarks.response_models import judged_trial, print_response_models
from benchmarks.table import COLUMNS, arguments_of, median_s, medians_s, peak_mb_of, report, write
from irodori.calibration.best_response import Given
from irodori.calibration.estimator_choice import choose, cross_validate, safest
from irodori.calibration.estimators import ESTIMATORS, fit, fit_mapping
from irodori.calibration.paper_estimator import spectral_basis
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.posterior import SIZE, Posterior
from irodori.calibration.training import ResponseNoise, Training
from irodori.colour.colorimetry import delta_e_reflectance, spectral_rmse
from irodori.core.threads import use_threads
from irodori.spectra.grid import ERROR_NM, TRAPEZOID_NM, WAVELENGTH_NM
from irodori.spectra.published import camera_sensitivities, read_spectra, spectrum
from irodori.spectra.published_names import TEST_COLOURS
from irodori.spectra.resampling import resample
from irodori.spectra.tables import wide_table

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
LIGHT, FILTER = "A", "MIDOPT_NF550"
PIXELS = {"small": 1 << 19, "full": 1 << 21}
BASES = 6
NOISES = (0.0, 0.001, 0.003, 0.01)
SEEDS = (0, 1, 2)
SETS = {
    "classic": "colorchecker_classic_24.csv",
    "sg": "colorchecker_digital_sg_140.csv",
    "munsell": "munsell_matt_1269.csv",
    "vrhel": "vrhel_170.csv",
    "esser": "esser_chart.csv",
}
#: The 99 test colours of CIE 224:2017, which come with the package.
CIE = "cie"
#: Estimators for which stated errors are tested, with their numbers of bases.
STATED = (("pinv", 6), ("local", 12), ("broad", 12))
#: Pairs of a training chart and a set that is not used for training, each set once. The SG has the Classic's paints.
NEVER_SEEN = (*((("classic", name)) for name in ("sg", "munsell", "vrhel", "esser", CIE)), ("esser", "classic"))
#: `local` with the variance of each pixel given, as for texels of an object.
TOLD = "local-told"
VARIANTS = (*ESTIMATORS, TOLD)
CAMERAS = ("canon_eos_40d", "nikon_d5100", "sony_ilce-7rm2")


@cache
def reflectances(name: str) -> np.ndarray:
    """Return the reflectances of a named set of measured spectra, (n, 61)."""
    if name == CIE:
        return np.array([spectrum(colour) for colour in TEST_COLOURS])
    return read_spectra(DATA / "reflectance" / SETS[name])[1]


@dataclass(frozen=True, eq=False)
class Trial:
    """A camera whose estimator is trained on one set of reflectances and tested on another.

    Parameters
    ----------
    system : (bands, 61) float
        Responses per unit reflectance; a perfect diffuser gives 1 in every band.
    train, test : (n, 61) float
        Reflectances of both sets.
    full_scale : (bands,) float
        Largest response of the test set, for which the exposure is set; noise is given as a fraction of it.
    """

    system: np.ndarray
    train: np.ndarray
    test: np.ndarray
    full_scale: np.ndarray

    @classmethod
    def of(cls, camera: str, train: str, test: str, bands: int = 6) -> "Trial":
        """Return the trial of a camera and two named sets; with ``bands`` = 3, only those without the filter."""
        names, wavelength_nm, values = wide_table(DATA / "filters/filters.csv")
        plate = resample(wavelength_nm, np.array(values[names.index(FILTER)]), FILTER)
        sensitivity = camera_sensitivities(str(DATA / f"cameras/{camera}.csv"))
        system = np.concatenate([sensitivity, sensitivity * plate])[:bands] * spectrum(LIGHT) * TRAPEZOID_NM
        system /= system.sum(axis=1, keepdims=True)
        first, second = reflectances(train), reflectances(test)
        return cls(system, first, second, (second @ system.T).max(axis=0))

    def responses(self, noise: float, seed: int) -> tuple[Training, np.ndarray, np.ndarray]:
        """Return training data, responses of the test set (n, bands), and the variance of a pixel (bands,)."""
        rng = np.random.default_rng(seed)
        sigma = noise * self.full_scale
        chart = self.train @ self.system.T + 0.1 * sigma * rng.standard_normal((len(self.train), len(sigma)))
        seen = self.test @ self.system.T + sigma * rng.standard_normal((len(self.test), len(sigma)))
        return Training(chart, self.train, spectrum(LIGHT), ResponseNoise(0.01 * sigma**2, sigma**2)), seen, sigma**2

    def bound(self, noise: float) -> np.ndarray:
        """Return the Wiener matrix, (bands, 61), for the test set itself with camera and noise known exactly.

        No linear estimator has a smaller mean square error on the test set.
        """
        moment = self.test.T @ self.test / len(self.test)
        spread = self.system @ moment @ self.system.T + np.diag((noise * self.full_scale) ** 2 + 1e-12)
        return np.linalg.solve(spread, self.system @ moment)


@cache  # what is computed from training data is kept with it, and all estimators share it
def _responses(trial: Trial, noise: float, seed: int) -> tuple[Training, np.ndarray, np.ndarray]:
    return trial.responses(noise, seed)


def errors(trial: Trial, noise: float, estimator: str, bases: int = 12, stated: bool = False) -> np.ndarray:
    """Return mean and p95 of CIEDE2000 under D65 and mean spectral RMSE of a trial, averaged over the seeds, (3,).

    Parameters
    ----------
    trial : Trial
    noise : float
        Standard deviation relative to full scale.
    estimator : str
        Name of an estimator, ``bound``, or ``auto``, for which cross-validation chooses estimator and number of bases.
    bases : int
        Number of basis vectors.
    stated : bool
        Whether the estimator gets the variance of the pixels.
    """
    found = []
    for seed in SEEDS if noise else SEEDS[:1]:
        training, seen, variance = _responses(trial, noise, seed)
        if estimator == "bound":
            recovered = seen @ trial.bound(noise)
        else:
            name, count = _choice(trial, noise, seed) if estimator == "auto" else (estimator, bases)
            # Without the camera's response model, which no estimator uses and which takes most of the time of `fit`.
            basis = spectral_basis(training.spectra, count)
            solved = Calibration(basis, fit_mapping(name, training).on_basis(basis), training.light)
            recovered = solved.spectra(seen, variance if stated else None)
        delta_e = delta_e_reflectance(trial.test, recovered, "D65")
        found.append((delta_e.mean(), np.percentile(delta_e, 95), spectral_rmse(trial.test, recovered).mean()))
    return np.mean(found, axis=0)


@dataclass(frozen=True)
class Coverage:
    """Shares of the errors of recovered spectra that lie within one and two stated standard deviations.

    Parameters
    ----------
    wavelengths, rmse, delta_e : (2,) float
        Shares for errors at single wavelengths, root-mean-square errors and CIEDE2000.
    rank : float
        Spearman's rank correlation between true and stated root-mean-square errors.
    """

    wavelengths: np.ndarray
    rmse: np.ndarray
    delta_e: np.ndarray
    rank: float


def ratios(trial: Trial, noise: float, variant: tuple[str, int], size: float = SIZE, most: int | None = None):
    """Return the ratios of true errors to stated standard deviations on a set that is not used for training.

    Parameters
    ----------
    trial : Trial
    noise : float
    variant : (str, int)
        Estimator and number of bases.
    size : float
        See `Posterior`.
    most : int, optional
        Approximate number of spectra of the set to use, at equal steps; all by default.

    Returns
    -------
    wavelengths : (n, 16) float
    rmse, delta_e : (n,) float
    rank : float
        Spearman's rank correlation between true and stated root-mean-square errors.
    """
    from scipy.stats import spearmanr  # slow to import

    _, seen, variance = _responses(trial, noise, SEEDS[0])
    some = np.s_[:: 1 if most is None else max(1, len(seen) // most)]
    seen, truth = seen[some], trial.test[some]
    solved = _fitted(trial, noise, variant)
    stated = Posterior(solved, size).of(seen, variance, stated=True)
    recovered = solved.spectra(seen, variance)
    rms, rmse = stated.rms, spectral_rmse(truth, recovered)
    at = np.isin(WAVELENGTH_NM, ERROR_NM)
    wavelengths = np.abs(truth - recovered)[:, at] / stated.standard_deviation
    colour = delta_e_reflectance(truth, recovered, "D65") / stated.delta_e
    return wavelengths, rmse / rms, colour, float(spearmanr(rmse, rms).statistic)


def coverage(camera: str, pair: tuple[str, str], noise: float, size: float = SIZE) -> Coverage:
    """Return how well stated errors hold on a set that is not used for training, as the mean over three estimators."""
    found = [ratios(_trial(camera, *pair), noise, variant, size) for variant in STATED]
    shares = np.mean([[[np.mean(r <= k) for k in (1, 2)] for r in one[:3]] for one in found], axis=0)
    return Coverage(*shares, float(np.mean([one[3] for one in found])))


@cache
def _trial(camera: str, train: str, test: str) -> Trial:
    return Trial.of(camera, train, test)


@cache
def _fitted(trial: Trial, noise: float, variant: tuple[str, int]) -> Calibration:
    return fit(variant[0], _responses(trial, noise, SEEDS[0])[0], variant[1])


@cache
def _middle(pair: tuple[str, str], size: float) -> float:
    """Return the mean logarithm of the 0.7 quantile of true over stated errors, of spectra and of colours of a set."""
    found = [ratios(_trial(CAMERAS[0], *pair), 0.001, variant, size, most=60) for variant in STATED]
    return float(np.mean([np.log(np.quantile(one[which], 0.7)) for one in found for which in (0, 2)]))


def size_without(left_out: str | None) -> float:
    """Return the size, see `Posterior`, with which 0.7 of the errors are within one σ, averaged over all sets but one.

    It is found with the first camera at 0.1 % noise. The share is 0.7 instead of 0.68 because errors have longer tails
    than a normal distribution: more of them are then within two σ.
    """
    sizes = (0.65, 0.8, 0.95)
    pairs = [pair for pair in NEVER_SEEN if pair[1] != left_out]
    middle = [np.mean([_middle(pair, size) for pair in pairs]) for size in sizes]
    return float(np.exp(np.polyfit(middle, np.log(sizes), 1)[1]))


def print_coverage() -> None:
    """Print how well stated errors hold on every set, with the size from the other sets and the first camera."""
    for pair in NEVER_SEEN:
        size = size_without(pair[1])
        for camera in CAMERAS:
            for noise in NOISES[:3]:
                own = coverage(camera, pair, noise, size)
                shares = "  ".join(f"{one:.2f} {two:.2f}" for one, two in (own.wavelengths, own.rmse, own.delta_e))
                print(f"{pair[1]:8} {size:.2f} {camera:14} {noise:5.1%}  {shares}  {own.rank:.2f}", flush=True)


@cache  # it takes longest, and does not depend on whether the estimator gets the variance of the pixels
def _choice(trial: Trial, noise: float, seed: int) -> tuple[str, int]:
    training, _, _ = _responses(trial, noise, seed)
    return choose(cross_validate(training)[0], "auto", "auto", safest(training))


def print_table() -> None:
    """Print mean / p95 of CIEDE2000 under D65 and mean spectral RMSE for all trials, estimators and noise levels."""
    trials = [(CAMERAS[0], train, test) for train in ("classic", "sg") for test in ("munsell", "vrhel")]
    trials += [(camera, "classic", test) for camera in CAMERAS[1:] for test in ("munsell", "vrhel")]
    trials += [(CAMERAS[1], "sg", test) for test in ("munsell", "vrhel")]
    variants = [("bound", 0, False), ("pinv", 6, False)]
    variants += [(name, 12, False) for name in ESTIMATORS if name != "pinv"]
    variants += [("local", 12, True), ("auto", 0, False), ("auto", 0, True)]
    print("noise  " + "".join(f"{noise:>22.1%}" for noise in NOISES))
    for names in trials:
        print(", ".join(names))
        three = Trial.of(*names, bands=3)
        _print_row("pinv, 3 bands", [errors(three, noise, "pinv", 3) for noise in NOISES])
        trial = Trial.of(*names)
        for name, bases, stated in variants:
            label = name + (" + variance" if stated else "")
            _print_row(label, [errors(trial, noise, name, bases, stated) for noise in NOISES])


def _print_row(label: str, values) -> None:
    print(f"  {label:18}" + "".join(f"{m:8.3f} /{p:6.2f} {r:.4f}" for m, p, r in values), flush=True)


def picture(pixels: int) -> np.ndarray:
    """Return responses of the Munsell spectra, repeated to fill a picture, with 0.3 % noise, (pixels, 6) float32."""
    _, seen, _ = Trial.of(CAMERAS[0], "classic", "munsell").responses(0.003, 0)
    return np.resize(seen.astype(np.float32), (pixels, seen.shape[1]))


def name_of(variant: str) -> str:
    """Return the name of a variant's estimator."""
    return "local" if variant == TOLD else variant


def variance_of(response: np.ndarray, variant: str) -> np.ndarray | None:
    """Return the variance of read and photon noise that a variant gets, (pixels, 6) float32; None for most variants."""
    return 1e-6 + 1e-4 * np.maximum(response, 0.0) if variant == TOLD else None


def calibration(name: str):
    """Return an estimator that is trained on the 24 patches of a chart with 0.3 % noise."""
    return fit(name, Trial.of(CAMERAS[0], "classic", "munsell").responses(0.003, 0)[0], BASES)


def bare_product(response: np.ndarray):
    """Return a function that only multiplies a picture with a matrix by BLAS, for reference."""
    matrix = np.asarray(calibration("pinv").weights_from_response, dtype=np.float32)
    out = np.empty((len(response), matrix.shape[1]), dtype=np.float32)
    return lambda: np.matmul(response, matrix, out=out)


def measure(size: str, runs: int) -> list[dict]:
    """Return one row of the table for each variant, the reference first."""
    pixels = PIXELS[size]
    response, trial = picture(pixels), Trial.of(CAMERAS[0], "classic", "munsell")
    work = {"blas": bare_product(response)}
    for variant in VARIANTS:
        solved, variance = calibration(name_of(variant)), variance_of(response, variant)
        start = time.perf_counter()
        solved.weights(response[: pixels // 64], None if variance is None else variance[: pixels // 64])
        print(f"{variant}, first run, compilation included: {time.perf_counter() - start:.2f} s", file=sys.stderr)
        work[variant] = lambda solved=solved, variance=variance: solved.weights(response, variance)
    seconds = medians_s(work, runs)
    rows = []
    for variant, median in seconds.items():
        error = float("nan")
        if variant != "blas":
            error = errors(trial, 0.003, name_of(variant), BASES, variant == TOLD)[0]
        rows.append(row(variant, pixels, median, seconds["blas"], error, peak_mb_of(work[variant])))
    rows.append(_posterior_row(response[: pixels // 64], runs))
    rows += _response_rows(runs)
    training = trial.responses(0.003, 0)[0]

    def judge() -> None:
        chart = Training(training.response, training.spectra, training.light, training.noise)
        cross_validate(chart, timed=True)

    seconds = median_s(judge, 5 if size == "full" else 1)
    print(f"cross-validation of everything: {seconds:.2f} s", file=sys.stderr)
    print(f"at rest, the picture and all estimators in memory: {peak_mb_of(lambda: None):.0f} MB", file=sys.stderr)
    return rows


def _posterior_row(response: np.ndarray, runs: int) -> dict:
    """Return the row for computing standard errors of a picture with `local`; its error is the share within 1 σ."""
    posterior, product = Posterior(calibration("local")), bare_product(response)
    variance = np.full(response.shape, 1e-6)

    def state() -> None:
        posterior.of(response, variance, stated=True)

    seconds = medians_s({"blas": product, "posterior": state}, runs)
    share = float(coverage(CAMERAS[0], NEVER_SEEN[1], 0.003).delta_e[0])
    metric = "share within the stated CIEDE2000, Munsell, 0.3 % noise"
    own = row("posterior", len(response), seconds["posterior"], seconds["blas"], share, peak_mb_of(state))
    return own | {"error_metric": metric}


def _response_rows(runs: int) -> list[dict]:
    """Return the rows for one camera's response model, from the chart alone and with a table of the filter."""
    own, table = judged_trial(CAMERAS[0], FILTER)
    ways = {"response-chart": Given(), "response-filter-table": Given(table)}
    seconds = medians_s({name: lambda given=given: own.found(given) for name, given in ways.items()}, runs)
    rows = []
    for name, given in ways.items():
        best, true = own.found(given)
        peak_mb = peak_mb_of(lambda given=given: own.found(given))
        values = ("calibrate", name, "1", "cameras", f"{seconds[name]:.4f}", f"{1.0 / seconds[name]:.3f}",
                  "relative rms error of the bands with the filter, 0.1 % noise",
                  f"{response_errors(best.mean, true)[3:].mean():.4f}", f"{peak_mb:.0f}",
                  "response-chart", f"{seconds[name] / seconds['response-chart']:.3f}")  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    return rows


def row(variant: str, pixels: int, seconds: float, reference: float, error: float, peak: float) -> dict:
    """Return one row of the table of speed against error."""
    work = pixels * 6 / 1e6
    metric = "mean CIEDE2000 under D65, Munsell, 0.3 % noise"
    values = ("calibrate", variant, f"{work:.2f}", "megapixel-bands", f"{seconds:.4f}", f"{work / seconds:.1f}", metric,
              f"{error:.5f}", f"{peak:.0f}", "blas", f"{seconds / reference:.3f}")  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--table", action="store_true", help="errors of every estimator, set, camera and noise")
    parser.add_argument(
        "--error-bars", action="store_true", help="how stated errors hold on every set, left out in turn"
    )
    parser.add_argument("--response-models", action="store_true", help="response models with and without a table")
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    if not DATA.is_dir():
        if not arguments.output:
            parser.error(f"no measured spectra at {DATA}")
        print(f"skipped: no measured spectra at {DATA}")
        write([], arguments.output)
        return
    if arguments.table:
        print_table()
        return
    if arguments.error_bars:
        print_coverage()
        return
    if arguments.response_models:
        print_response_models()
        return
    rows = measure(arguments.size, arguments.runs)
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
