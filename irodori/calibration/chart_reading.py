"""Training data of a calibration from the linear pictures of its charts."""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.chart import Located, locate_patches, read_located
from irodori.calibration.illumination import Illumination, illumination
from irodori.calibration.patches import ChartReading, read_means
from irodori.calibration.training import ResponseNoise
from irodori.config.capture_table import Pose, flat_incidence_rad
from irodori.config.models import Chart
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.pinhole import samples_from_superpixels


@dataclass(frozen=True)
class ChartPhotograph:
    """A chart's photograph with its patches located.

    Parameters
    ----------
    path : path
    response : (height, width, bands) float32
    valid : (height, width) uint8
    sample_px : int
        Mosaic pixels along the side of a sample.
    cosine : float
        Cosine of the angle of incidence of the light on the chart.
    filters : tuple of str
    noise_model : (bands, 2) float64 or None
        c0 and c1 of a sample's variance c0 + c1 ρ; None where it was not measured.
    located : Located
    light : Illumination or None
        Uneven light, estimated from the chart itself; None if a white reference has already corrected it.
    """

    path: object
    response: np.ndarray
    valid: np.ndarray
    sample_px: int
    cosine: float
    filters: tuple[str, ...]
    noise_model: np.ndarray | None
    located: Located
    light: Illumination | None

    @classmethod
    def load(cls, path, chart: Chart, count: int, *, on_rig: bool = True) -> "ChartPhotograph":
        """Read a chart's linear responses and find its patches.

        Parameters
        ----------
        path : path
        chart : Chart
            Definition of the chart.
        count : int
            Number of spectra of the chart.
        on_rig : bool
            Whether the rig's lamp lights the chart: a white reference corrects the unevenness of this light only.

        Raises
        ------
        InputError
            If the layout does not have one patch for each spectrum, or the patches cannot be read.
        """
        if count != chart.rows * chart.columns:
            found = f"{count} spectra for {chart.rows} x {chart.columns} patches"
            raise InputError(chart.spectra, "chart", found, "one spectrum a patch, row by row")
        with store.open_file(path) as file:
            response, valid = file.read("response"), file.read("valid")
            # Ingestion writes a rate, 1/s, where no white reference has evened the light.
            even = on_rig and file.dataset("response").attrs["units"] == "1"
            pose = Pose.of_file(file)
            sample_px = file.attribute("sample_px")
            model = file.read("noise_model") if "noise_model" in file else None
            filters = tuple(file.attribute("filters"))
        if model is not None and not np.isfinite(model).all():
            model = None
        located = locate_patches(response, valid, chart, path, sample_px)
        light = None if even else illumination(response, valid, located, path, sample_px)
        cosine = float(np.cos(flat_incidence_rad(pose)))
        return cls(path, response, valid, sample_px, cosine, filters, model, located, light)

    def read(self) -> ChartReading:
        """Return the statistics of every patch, corrected for uneven light if that could be estimated."""
        reading = read_located(self.response, self.valid, self.located, self.path, self.sample_px)
        return reading if self._field is None else reading.divided(self._field)

    def means_at(self, centres_px: np.ndarray) -> np.ndarray | None:
        """Return the mean responses of squares at given centres, (n, bands), in uneven light; None if unreadable.

        Parameters
        ----------
        centres_px : (n, 2) float
            x then y, superpixels.
        """
        centres = samples_from_superpixels(centres_px, self.sample_px)
        try:
            return read_means(
                self.response, self.valid, centres, self.located.side_px * 2.0 / self.sample_px, self.path
            )
        except InputError:
            return None

    def responses(self, reading: ChartReading) -> np.ndarray:
        """Return responses as if lit at normal incidence, (patches, bands)."""
        return reading.mean / self.cosine

    def noise(self, reading: ChartReading) -> ResponseNoise:
        """Return the noise of patch means and of a pixel at the chart's mean level, as if lit at normal incidence.

        The noise of a pixel is that of the camera's noise model if there is one. Otherwise, and for the means, it is
        estimated from the scatter within the patches, which includes their texture. An estimator uses a single noise,
        that of a typical pixel.
        """
        pixel, patch = np.median(reading.pixel_variance, axis=0), np.median(reading.mean_variance, axis=0)
        if self.noise_model is not None:
            pixel = np.maximum(self.noise_model[:, 0] + self.noise_model[:, 1] * reading.mean.mean(axis=0), 0.0)
        return ResponseNoise(patch / self.cosine**2, pixel / self.cosine**2)

    @property
    def _field(self) -> np.ndarray | None:
        return self.light.field if self.light is not None and self.light.correctable else None
