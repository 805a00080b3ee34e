"""Ranking of second-shot filters on the command line: ``irodori filters --camera FILE --filters FILE``.

Print the filters that are best for the second shot of a camera, ordered by predicted mean CIEDE2000, and write the
scores of all filters to a CSV file. The module `irodori.calibration.ranking` explains the prediction.
"""

import argparse
import csv
import sys
from dataclasses import astuple, fields
from pathlib import Path

import numpy as np

from irodori.calibration.ranking import NO_FILTER, FilterScore, rank_filters
from irodori.calibration.simulated_responses import EXPOSURES
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.spectra.published import camera_sensitivities, chart_spectra, light, spectrum
from irodori.spectra.resampling import resample
from irodori.spectra.spectral_files import SUFFIXES, check_transmittance, spectral_table

__all__ = ["FilterScore", "main", "rank_filters", "read_filters"]


def read_filters(path) -> dict[str, np.ndarray]:
    """Return transmittances from a file of spectra, or from all files of spectra in a folder.

    Returns
    -------
    dict of (61,) float64
        {name: transmittance}. The name is that in the file, or that of the file if it has one spectrum and lies in a
        folder. Noise of a measurement below 0, down to -0.01, is set to 0.

    Raises
    ------
    InputError
        For a folder without such files, a file that cannot be read, a name that comes twice, values outside
        -0.01..1.02.
    """
    path = Path(path)
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
    if not files:
        raise InputError(path, "", "no file of spectra", f"files whose names end in one of {', '.join(SUFFIXES)}")
    filters: dict[str, np.ndarray] = {}
    for file in files:
        table = spectral_table(file)
        check_transmittance(table, file)
        spectra = resample(np.array(table.wavelength_nm), np.array(table.values), file, method="auto")
        names = [file.stem] if path.is_dir() and len(table.names) == 1 else table.names
        for name, transmittance in zip(names, spectra, strict=True):
            if name in filters:
                raise InputError(file, name, "a second filter of this name", "each name once")
            filters[name] = np.maximum(transmittance, 0.0)
    return filters


def _reflectances(name: str) -> np.ndarray:
    """Return a set of reflectances by the name of a chart, a file, or ``TCS`` for the 99 samples of CIE 224:2017."""
    return np.stack([spectrum(f"TCS{i}") for i in range(99)]) if name == "TCS" else chart_spectra(name)[1]


def write_scores(scores: list[FilterScore], path) -> None:
    """Write the ranking to a CSV, best first.

    Raises
    ------
    InputError
        If the folder does not exist.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(path, "", "no such folder", "a file in a folder that is there")
    with written_whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["rank", *(field.name for field in fields(FilterScore))])
        for rank, score in enumerate(scores, start=1):
            writer.writerow([rank, score.name, *(f"{value:.5g}" for value in astuple(score)[1:])])


def _print_scores(scores: list[FilterScore], count: int, max_exposure: float) -> None:
    print(f"{'':>4} {'filter':<40} {'CIEDE2000':>10} {'p95':>7} {'RMSE':>8} {'exposure':>9} {'darkest band':>13}")
    for rank, score in enumerate(scores, start=1):
        if (rank <= count and score.exposure_ratio <= max_exposure) or score.name == NO_FILTER:
            print(
                f"{rank:>4} {score.name:<40} {score.delta_e_mean:>10.3f} {score.delta_e_p95:>7.2f} "
                f"{score.rmse_mean:>8.4f} {score.exposure_ratio:>8.1f}x {score.darkest_band:>13.3f}"
            )
    hidden = sum(score.exposure_ratio > max_exposure for score in scores[:count])
    if hidden:
        print(
            f"{hidden} of the first {count} not shown: exposed over {max_exposure:g} times longer than without a filter"
        )


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=prog, description=__doc__.split("\n\n")[1])
    parser.add_argument("--camera", required=True, help="sensitivities: a file, or a camera of colour-science by name")
    parser.add_argument("--filters", required=True, help="transmittances: a file, or a folder of files")
    parser.add_argument("--light", default="A", help="light on the object: a name or a file (%(default)s)")
    parser.add_argument("--noise", type=float, required=True, help="noise of a pixel, fraction of full scale")
    parser.add_argument("--training", default="BabelColor Average", help="chart, by name or file (%(default)s)")
    parser.add_argument(
        "--test", default="TCS", help="reflectances: TCS (CIE 224:2017), a chart or a file (%(default)s)"
    )
    parser.add_argument("--exposure", choices=EXPOSURES, default="per_shot", help="how shots are exposed (%(default)s)")
    parser.add_argument("--viewing-light", default="D65", help="light of the colour comparison (%(default)s)")
    parser.add_argument("--count", type=int, default=20, help="filters to print (%(default)s)")
    parser.add_argument(
        "--max-exposure", type=float, default=32.0, help="longest second exposure to print, in times (%(default)s)"
    )
    parser.add_argument("--output", default="filters.csv", help="CSV of all filters (%(default)s)")
    return parser


def main(arguments: list[str] | None = None, prog: str = "python -m irodori.calibration.filters") -> int:
    """Rank filters by command-line arguments and return the exit status."""
    options = _parser(prog).parse_args(arguments)
    try:
        scores = rank_filters(
            camera_sensitivities(options.camera),
            read_filters(options.filters),
            light(options.light),
            _reflectances(options.training),
            _reflectances(options.test),
            options.noise,
            exposure=options.exposure,
            viewing_light=options.viewing_light,
        )
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    _print_scores(scores, options.count, options.max_exposure)
    write_scores(scores, options.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
