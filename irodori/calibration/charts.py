"""Patches of several charts of one camera, joined into one training set."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irodori.calibration.chart_reading import ChartPhotograph
from irodori.calibration.conditioning import PatchError
from irodori.calibration.patch_order import check_order
from irodori.calibration.patches import ChartReading
from irodori.calibration.training import ResponseNoise
from irodori.config.capture_table import chart_capture
from irodori.config.models import Camera, Chart
from irodori.config.parts import CalibratedCamera
from irodori.core.errors import InputError, counted
from irodori.core.progress import LOGGER
from irodori.spectra.published import chart_spectra

_LEVEL_BASES = 6
_LEVEL_TOLERANCE = 0.02
_MAX_UNEVEN_SHARE = 0.5  # of a chart's patches


@dataclass(frozen=True)
class Charts:
    """Photographs of a camera's charts, in the order of its definition, with readings and spectra of their patches.

    Parameters
    ----------
    fields : tuple of str
        Key of each chart in the definition of the camera.
    captures : tuple of str
        ``chart``, then ``chart-NAME`` of each further chart.
    photographs : tuple of ChartPhotograph
    readings : tuple of ChartReading
    patches : tuple of str
        Names of all patches; those of further charts are preceded by the chart's name and a slash.
    spectra : (m, 61) float64
    number : (m,) int
        Number of the chart that each patch belongs to.
    """

    fields: tuple[str, ...]
    captures: tuple[str, ...]
    photographs: tuple[ChartPhotograph, ...]
    readings: tuple[ChartReading, ...]
    patches: tuple[str, ...]
    spectra: np.ndarray
    number: np.ndarray

    @classmethod
    def load(cls, linear, camera: Camera | CalibratedCamera) -> "Charts":
        """Read all charts.

        Parameters
        ----------
        linear : path or sequence of paths
            Linear responses of each chart, in the order of the definition; a single path for a single chart.
        camera : Camera or CalibratedCamera

        Raises
        ------
        InputError
            If a chart cannot be read, its patches are in another order or most of them are uneven, or charts were
            photographed with different filters.
        ValueError
            If there is not one file for each chart.
        """
        files = [linear] if isinstance(linear, str | Path) else list(linear)
        definitions = {"": camera.chart, **camera.further_charts}
        if len(files) != len(definitions):
            found = f"{counted(len(files), 'file')} of charts"
            raise ValueError(f"{found}; accepted: {len(definitions)}, one for each chart")
        photographs: list[ChartPhotograph] = []
        readings: list[ChartReading] = []
        patches, spectra = [], []
        for file, (name, chart) in zip(files, definitions.items(), strict=True):
            names, reflectances = chart_spectra(chart.spectra)
            with _naming(name):
                photograph = ChartPhotograph.load(file, chart, len(names))
                reading = read_chart(photograph, reflectances, chart)
            if photograph.filters != (photographs or [photograph])[0].filters:
                found = ", ".join(photograph.filters)
                raise InputError(file, "filters", found, ", ".join(photographs[0].filters) + ", as of the first chart")
            photographs.append(photograph)
            readings.append(reading)
            patches += [f"{name}/{patch}" if name else patch for patch in names]
            spectra.append(reflectances)
        number = np.repeat(np.arange(len(files)), [len(part) for part in spectra])
        fields, captures = (tuple(of(name) for name in definitions) for of in (field_of, chart_capture))
        return cls(
            fields, captures, tuple(photographs), tuple(readings), tuple(patches), np.concatenate(spectra), number
        )

    @property
    def filters(self) -> tuple[str, ...]:
        """Filter states of the bands, three bands each."""
        return self.photographs[0].filters

    def responses(self) -> np.ndarray:
        """Return responses of all patches as if lit at normal incidence, (m, bands)."""
        return np.concatenate([p.responses(r) for p, r in zip(self.photographs, self.readings, strict=True)])

    def check_levels(self) -> None:
        """Refuse a further chart that was lit differently from the others; log the relative level of each.

        A linear model on the principal vectors of all spectra, fitted to the other charts, predicts the responses of a
        chart; its level is the median ratio of measured to predicted.

        Raises
        ------
        InputError
            If a level differs from 1 by more than 2 % and by more than four standard errors.
        """
        response = self.responses()
        weights = self.spectra @ np.linalg.svd(self.spectra, full_matrices=False)[2][:_LEVEL_BASES].T
        for which, photograph in enumerate(self.photographs[1:], start=1):
            own = self.number == which
            if (~own).sum() <= _LEVEL_BASES:
                continue
            model = np.linalg.lstsq(weights[~own], response[~own], rcond=None)[0]
            predicted = weights[own] @ model
            bright = (predicted > 0.02 * predicted.max(axis=0)) & (response[own] > 0.0)
            level, error = _level(np.log(response[own][bright] / predicted[bright]), own.sum())
            LOGGER.info("%s: %.3f +- %.3f times as bright as the other charts say", photograph.path, level, error)
            if abs(level - 1.0) > max(_LEVEL_TOLERANCE, 4.0 * error):
                found = f"a chart {level:.3f} times as bright as the others predict"
                accepted = f"{1 - _LEVEL_TOLERANCE:g} to {1 + _LEVEL_TOLERANCE:g}: the pose and the light of the first"
                raise InputError(photograph.path, self.fields[which], found, accepted)

    def refusal(self, error: ValueError) -> InputError:
        """Return the error to raise for responses that determine no calibration.

        It names the chart with the faulty patch, and the patch by its number in that chart. If the fault is not in a
        single patch, it names every chart, and the file of the first one.
        """
        accepted = "charts that determine every band"
        if not isinstance(error, PatchError):
            return InputError(self.photographs[0].path, ", ".join(self.fields), str(error), accepted)
        which = int(self.number[error.patch])
        own = error.patch - int(np.argmax(self.number == which))
        return InputError(self.photographs[which].path, self.fields[which], f"patch {own}{error.fault}", accepted)

    def noise(self, photographs: int) -> ResponseNoise:
        """Return the noise of patch means, and of a mean over some photographs, averaged over all patches.

        The latter are the responses that will be recovered; a pixel of one photograph has the noise that
        `ChartPhotograph.noise` returns.
        """
        found = [p.noise(r) for p, r in zip(self.photographs, self.readings, strict=True)]
        share = np.bincount(self.number) / self.number.size
        pixel = share @ [noise.pixel for noise in found]
        return ResponseNoise(share @ [noise.patch for noise in found], pixel / photographs)


def _level(ratios: np.ndarray, patches: int) -> tuple[float, float]:
    """Return the median of ratios given as logarithms, and its standard error from their spread over the patches."""
    middle = float(np.median(ratios))
    spread = 1.4826 * float(np.median(np.abs(ratios - middle)))
    return float(np.exp(middle)), 1.2533 * spread / np.sqrt(patches)


def read_chart(photograph: ChartPhotograph, spectra: np.ndarray, chart: Chart) -> ChartReading:
    """Return the statistics of a chart's patches.

    Raises
    ------
    InputError
        If they are in another order than the spectra, (patches, 61), or most of them are uneven.
    """
    reading = photograph.read()
    _check_order(photograph, spectra, chart)
    _check_evenness(photograph, reading)
    return reading


def _check_order(photograph: ChartPhotograph, spectra: np.ndarray, chart: Chart) -> None:
    try:
        check_order(photograph.located.centres_px, photograph.means_at, spectra, chart.rows, chart.columns)
    except ValueError as error:
        accepted = "chart.centres_px from the first patch on, rows and columns in the order of the spectra"
        raise InputError(photograph.path, "chart", str(error), accepted) from None


def _check_evenness(photograph: ChartPhotograph, reading: ChartReading) -> None:
    """Refuse a chart with dirt, an edge or a shadow in most patches: its squares then do not lie inside the patches."""
    uneven, count = int(reading.uneven.sum()), len(reading.uneven)
    if uneven > _MAX_UNEVEN_SHARE * count:
        accepted = "squares within the patches (chart.centres_px, chart.patch_px) of a clean chart in even light"
        found = f"{uneven} of {count} patches with dirt, an edge or a shadow"
        raise InputError(photograph.path, "chart", found, accepted)


def field_of(name: str) -> str:
    """Return the key of a chart in a camera's definition; the name of the first chart is empty."""
    return f"further_charts.{name}" if name else "chart"


@contextmanager
def _naming(name: str) -> Iterator[None]:
    """Replace the key ``chart`` in errors about a further chart by the key that the definition has for it."""
    try:
        yield
    except InputError as error:
        if not name:
            raise
        field = re.sub(r"\bchart(?=$|\.[a-z])", field_of(name), error.field)
        found, accepted = (
            re.sub(r"\bchart(?=\.[a-z]+_px\b|\.find\b)", field_of(name), t) for t in (error.found, error.accepted)
        )
        raise InputError(error.file, field, found, accepted) from None
