"""Alignment of the two shots of a pose, without and with the filter, on one grid."""

from dataclasses import dataclass, replace

import numpy as np

from irodori.config.capture_table import Shot
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.geometry.pinhole import bayer_offsets_px
from irodori.ingest.develop import Developed, develop
from irodori.ingest.exposure_settings import filter_states
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.registration.similarity import Registration, meets_marked, register, resample

#: Predicted standard error of a registration, superpixels, above which the picture has too little content.
MAX_SIGMA_PX = 0.1


@dataclass(frozen=True)
class Alignment:
    """Alignment of the filtered picture with the unfiltered one.

    Parameters
    ----------
    transform : (4,) tuple of float
        dx and dy in superpixels, rotation in rad, scale, about the picture's centre.
    residual_px : float
        RMS shift that remains in local blocks, superpixels; NaN if not measured.
    sigma_px : float
        Predicted standard error, superpixels.
    source : str
        Source of the transform: ``capture``; ``chart`` if the capture has too little content; ``none`` if the chart has
        too little, too.
    """

    transform: tuple[float, float, float, float]
    residual_px: float
    sigma_px: float
    source: str

    def write(self, out: store.Writer) -> None:
        """Write the dataset ``/registration``, (4,), and its attributes."""
        units = ["{superpixel}", "{superpixel}", "rad", "1"]
        out.coordinate("parameter", ["dx", "dy", "rotation", "scale"], units="1", quantity="what is aligned")
        out.write("parameter_unit", np.array(units, "S"), units="1", dims="parameter", quantity="its unit")
        out.write("registration", np.array(self.transform), units="{parameter_unit}", dims="parameter",
                  quantity="dx, dy, rotation, scale from the unfiltered to the filtered picture")  # fmt: skip
        out.attribute("registration_residual_px", self.residual_px)
        out.attribute("registration_sigma_px", self.sigma_px)
        out.attribute("registration_source", self.source)

    @classmethod
    def read(cls, file: store.Reader) -> "Alignment":
        """Read an alignment that `write` wrote."""
        names = ("registration_residual_px", "registration_sigma_px", "registration_source")
        return cls(tuple(file.read("registration").tolist()), *(file.attribute(name) for name in names))


UNMOVED = Alignment((0.0, 0.0, 0.0, 1.0), float("nan"), float("inf"), "none")


def _align(fixed: Developed, moving: Developed, start: Alignment | None, sample_px: int) -> Alignment:
    """Register two filter states with `irodori.ingest.registration`."""
    pictures = [_superpixels(state.response, state.valid, sample_px) for state in (fixed, moving)]
    (image_a, valid_a), (image_b, valid_b) = pictures
    # The bands of a superpixel have different positions; those of demosaiced or non-mosaic pictures coincide.
    offsets = bayer_offsets_px(fixed.pattern) if sample_px == 2 and fixed.pattern else None
    guess = None if start is None else _registration(start)
    found = register(image_a, image_b, valid_a, valid_b, guess, band_offsets_px=offsets)
    transform = (float(found.dx_px), float(found.dy_px), float(found.rotation_rad), float(found.scale))
    return Alignment(transform, float(found.residual_px), float(found.sigma_px), "capture")


def _registration(alignment: Alignment, scale: float = 1.0) -> Registration:
    """Convert an alignment to a transform in samples with a side of 1 / ``scale`` superpixels."""
    dx, dy, rotation, magnification = alignment.transform
    return Registration(scale * dx, scale * dy, rotation, magnification, alignment.residual_px, alignment.sigma_px)


def _superpixels(image: np.ndarray, valid: np.ndarray, sample_px: int) -> tuple[np.ndarray, np.ndarray]:
    """Average a picture and its mask to superpixels."""
    if sample_px == 2:
        return image, valid
    blocks = [image[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    masks = [valid[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    return np.stack(blocks).mean(axis=0, dtype=np.float32), np.logical_and.reduce(masks)


def align_states(
    fixed: Developed, moving: Developed, nominal: Alignment | None, options: IngestOptions, file, capture: str
) -> Alignment:
    """Determine the transform from the unfiltered to the filtered picture of a capture.

    Parameters
    ----------
    fixed, moving : Developed
        Pictures without and with the filter.
    nominal : Alignment or None
        Transform from the chart: the start, and the result if the capture has too little content.
    file : path
        Table of the capture, for the error message.
    capture : str

    Raises
    ------
    InputError
        If the remaining shift in local blocks exceeds the limit, because something moved between the shots.
    """
    found = _align(fixed, moving, nominal, options.sample_px)
    # Checked before the content: a movement between the shots makes the fit uncertain too, and would be mistaken for a
    # lack of content. The residual does not include noise.
    if found.residual_px > options.max_registration_px:
        text = f"shots of the capture {capture} that differ by {found.residual_px:.2f} superpixels after registration"
        accepted = f"at most {options.max_registration_px:g} superpixels (ingest.max_registration_px); nothing may move"
        raise InputError(file, "capture", text, accepted)
    if not found.sigma_px <= MAX_SIGMA_PX:
        if nominal is None:
            LOGGER.warning("%s: too little content to register its filter states; they stay as they are", capture)
            return replace(UNMOVED, sigma_px=found.sigma_px)
        LOGGER.info("%s: too little content to register (%.2g px); the chart's transform", capture, found.sigma_px)
        return replace(nominal, sigma_px=found.sigma_px, source="chart")
    return found


def move(state: Developed, alignment: Alignment, sample_px: int, out: np.ndarray) -> Developed:
    """Resample a filtered picture to the grid of the unfiltered one; the responses are written to ``out``."""
    registration = _registration(alignment, 2.0 / sample_px)
    response, valid = resample(state.response, state.valid, registration, out)
    clipped = meets_marked(state.clipped, valid, registration) if state.clipped.any() else state.clipped
    return replace(state, response=response, clipped=clipped, hot=~(valid | clipped))


def nominal_alignment(reference, white: dict, shots: list[Shot], table, folder, options: IngestOptions):
    """Return the nominal transform of the filter from the two shots of the chart.

    None if there is only one filter state, registration is switched off, or the chart has too little content.
    """
    states = filter_states(shots)
    if not options.register or len(states) < 2:
        return None
    on_superpixels = options.superpixels()
    fixed, moving = (
        develop(reference, [s for s in shots if s.filter == state], table, folder, on_superpixels, white.get(state))
        for state in states
    )
    alignment = align_states(fixed, moving, None, on_superpixels, table, "chart")
    LOGGER.info(
        "filter's transform from the chart: shift %.3f, %.3f superpixels, rotation %.5f rad, scale %.6f, residual %.3f",
        *alignment.transform, alignment.residual_px,
    )  # fmt: skip
    return alignment if alignment.source == "capture" else None
