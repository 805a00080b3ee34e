"""Normalisation data of a camera: dark signal, hot pixels, white reference, noise, linearity."""

from collections import defaultdict
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from irodori.config.capture_table import Shot, check_unchanged, flat_incidence_rad, read_captures, shot_path
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track
from irodori.ingest.dark_frames import Dark, measure_dark
from irodori.ingest.develop import develop, require_pattern
from irodori.ingest.exposure_settings import filter_states, known_settings, settle, settle_set
from irodori.ingest.flat_field import find_spot, fit_flat
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.linearity import measure_linearity
from irodori.ingest.mosaic import decode
from irodori.ingest.photon_transfer import PhotonTransfer, measure_noise
from irodori.ingest.shot_alignment import Alignment, nominal_alignment
from irodori.spectra.white_reference import white_reflectance


@dataclass(frozen=True)
class Reference:
    """Normalisation data of a camera, from a file of `ingest_reference`.

    Parameters
    ----------
    dark : Dark or None
    white : dict
        Filter state -> (3, 15) coefficients of the response rate of a perfect diffuser lit at normal incidence, in full
        scales per second of relative exposure; empty without white reference.
    noise : PhotonTransfer
    size_px : (width, height)
        Size of the mosaic; (0, 0) if there is neither a dark frame nor a white reference.
    known : list of str
        Those of ``iso`` and ``f_number`` that are part of the relative exposure.
    alignment : Alignment or None
        Nominal transform due to the filter, from the chart.
    pattern : str
        Colours of the first 2 x 2 pixels of the mosaics; empty if no photograph is a mosaic.
    """

    dark: Dark | None
    white: dict[str, np.ndarray]
    noise: PhotonTransfer
    size_px: tuple[int, int]
    known: list[str]
    alignment: Alignment | None
    pattern: str = ""

    @classmethod
    def load(cls, path) -> "Reference":
        """Read a file that `ingest_reference` wrote."""
        with store.open_file(path) as file:
            dark = _load_dark(file)
            states = file.attribute("filters")
            white = file.read("white") if "white" in file else ()
            fields = ("gain_e_per_dn", "gain_error", "read_noise_dn", "read_noise_error")
            noise = PhotonTransfer(
                **{name: file.attribute(name) for name in fields},
                gain_by_colour=tuple(file.read("gain")[:, 0]),
                gain_error_by_colour=tuple(file.read("gain")[:, 1]),
                iso=file.attribute("gain_iso"),
            )
            alignment = Alignment.read(file) if "registration" in file else None
            size, known, pattern = tuple(file.attribute("size_px")), file.attribute("known"), file.attribute("mosaic")
            return cls(dark, dict(zip(states, white, strict=True)), noise, size, known, alignment, pattern)


def _load_dark(file: store.Reader) -> Dark | None:
    if "dark_rate" not in file:
        return None
    return Dark(
        offset=file.read("dark_offset") if "dark_offset" in file else None,
        rate=file.read("dark_rate"),
        offset_step_dn=file.attribute("dark_offset_step_dn"),
        rate_step_dn_per_s=file.attribute("dark_rate_step_dn_per_s"),
        iso=file.attribute("dark_iso"),
        exposures_s=tuple(file.attribute("dark_exposures_s")),
        hot_px=file.read("hot_px"),
    )


def ingest_reference(
    table, folder, output, provenance: store.Provenance, white_factor: float | str, options: IngestOptions
) -> None:
    """Compute the normalisation data of a camera from its dark frames, white references and chart, and write them.

    Parameters
    ----------
    table, folder : path
        Capture table of the camera, and the folder of its files.
    white_factor : float or str
        Reflectance factor of the white reference; or the name or file of its measured spectrum, which is averaged,
        because the sensitivities of the bands are unknown at this stage. The attribute ``white_factor_uncertainty``
        states the variation of the spectrum.
    options : IngestOptions

    Raises
    ------
    InputError
        If a file has changed since its hash was recorded in the table, the mosaics differ in their pattern, a white
        reference is saturated or uneven, the camera is less linear than the options allow, or the two shots of the
        chart cannot be registered.

    Notes
    -----
    Datasets, absent if the table has no such shots: ``/dark_offset`` and ``/dark_rate`` (H, W) int16 over the mosaic,
    in steps stated by the attributes, DN and DN/s above the black level; ``/hot_px`` (n, 2) row and column of hot
    mosaic pixels; ``/white`` (filters, 3, 15) coefficients of x^i y^j over the picture (`irodori.ingest.flat_field`),
    in full scales per second of relative exposure; ``/gain`` (3, 2) electrons per DN of red, green and blue, and their
    standard errors; ``/linearity`` (n) deviation at each relative exposure; ``/registration`` (4). Attributes of the
    noise are NaN if it cannot be measured.
    """
    shots, size, pattern = _settled_shots(table, folder)
    whites = [s for s in shots if s.role == "white"]
    dark = measure_dark(shots, table, folder)
    hot_px = np.zeros((0, 2), np.int32) if dark is None else dark.hot_px
    noise = measure_noise(shots, table, folder, hot_px)
    linearity = measure_linearity(shots, table, folder, dark, options.max_nonlinearity)
    factor, factor_uncertainty = white_reflectance(white_factor)
    partial = Reference(dark, {}, noise, size, known_settings(shots), None, pattern)
    white = {
        state: _white(partial, [s for s in whites if s.filter == state], table, folder, float(factor), options)
        for state in filter_states(whites)
    }
    alignment = nominal_alignment(partial, white, [s for s in shots if s.capture == "chart"], table, folder, options)
    with store.create(output, provenance) as out:
        _write_dark(out, dark)
        if white:
            coefficients = np.stack(list(white.values()))
            quantity = "coefficients of the response rate of a perfect diffuser at normal incidence"
            out.coordinate("filter", list(white), units="1", quantity="state of the filter")
            out.write("white", coefficients, units="1/s", dims="filter,colour,term", quantity=quantity)
        _write_noise(out, noise)
        if linearity is not None:
            out.coordinate("exposure", linearity.exposure_s, units="s", quantity="relative exposure")
            out.write("linearity", linearity.deviation, units="1", dims="exposure", quantity="deviation")
            out.attribute("max_nonlinearity", linearity.largest)
            out.attribute("linearity_repeatability", linearity.repeatability)
        if alignment is not None:
            alignment.write(out)
        out.attribute("filters", filter_states(whites))
        out.attribute("white_factor", float(factor))
        out.attribute("white_factor_uncertainty", factor_uncertainty)
        out.attribute("size_px", list(size))
        out.attribute("known", partial.known)
        out.attribute("mosaic", pattern)


def _settled_shots(table, folder) -> tuple[list[Shot], tuple[int, int], str]:
    """Return the shots of a camera with settings completed from their files; size, px, and pattern of its mosaics.

    Raises
    ------
    InputError
        If the pattern of a file differs from that of the first.
    """
    settled, size, pattern = [], (0, 0), ""
    shots = [shot for shot in read_captures(table, folder) if shot.role in ("dark", "white", "chart")]
    check_unchanged(table, folder, shots)
    for shot in track(shots, "reference"):
        path = shot_path(shot, table, folder)
        mosaic = decode(path, shot.linear)
        require_pattern(pattern, mosaic, path)
        pattern = pattern or ("" if mosaic.linear else mosaic.pattern)
        settled.append(settle(shot, mosaic, table))
        if size == (0, 0) and shot.role in ("dark", "white"):
            size = mosaic.size
    return settle_set(settled, table), size, pattern


def _write_dark(out: store.Writer, dark: Dark | None) -> None:
    if dark is None:
        return
    if dark.offset is not None:
        out.write("dark_offset", dark.offset, units="{step}", dims="row,column", quantity="dark signal at no exposure",
                  compression="fast")  # fmt: skip
    out.write("dark_rate", dark.rate, units="{step}", dims="row,column", quantity="dark signal a second",
              compression="fast")  # fmt: skip
    out.write("hot_px", dark.hot_px, units="{px}", dims="pixel,axis", quantity="row and column of hot mosaic pixels")
    out.attribute("dark_offset_step_dn", dark.offset_step_dn)
    out.attribute("dark_rate_step_dn_per_s", dark.rate_step_dn_per_s)
    out.attribute("dark_iso", dark.iso)
    out.attribute("dark_exposures_s", list(dark.exposures_s))
    out.attribute("hot_pixels", len(dark.hot_px))


def _write_noise(out: store.Writer, noise: PhotonTransfer) -> None:
    gains = np.stack([noise.gain_by_colour, noise.gain_error_by_colour], axis=1)
    out.coordinate("colour", ["red", "green", "blue"], units="1", quantity="colour of the sensor")
    out.coordinate("value", ["gain", "standard error"], units="1", quantity="what is stated")
    out.write("gain", gains, units="{electron}/{DN}", dims="colour,value", quantity="electrons per DN, standard error")
    for name in ("gain_e_per_dn", "gain_error", "read_noise_dn", "read_noise_error", "read_noise_e"):
        out.attribute(name, getattr(noise, name))
    out.attribute("gain_iso", noise.iso)


def _repeats(group: list[Shot]) -> list[list[Shot]]:
    """Group shots into brackets of distinct exposures: the first shots of each exposure, then the second, and so on."""
    equal: dict[tuple, list[Shot]] = defaultdict(list)
    for shot in group:
        equal[shot.exposure_s, shot.iso, shot.f_number, shot.light_level].append(shot)
    return [[shot for shot in bracket if shot] for bracket in zip_longest(*equal.values())]


def _white(reference: Reference, group: list[Shot], table, folder, reflectance: float, options: IngestOptions):
    """Return the coefficients of the response rate of a perfect diffuser, (3, 15), for one filter state."""
    cosine = np.cos(flat_incidence_rad(group[0].pose))
    path = shot_path(group[0], table, folder)
    coefficients = []
    for bracket in _repeats(group):
        # The flat field is measured on superpixels, also if captures are demosaiced.
        state = develop(reference, bracket, table, folder, options.superpixels(), white=None)
        valid = ~(state.clipped | state.hot)
        if valid.mean() < 0.5:
            found = f"a white reference saturated over {state.clipped.mean():.0%} of the picture"
            raise InputError(path, "exposure_s", found, "a shorter exposure of the white reference")
        try:
            coefficients.append(fit_flat(state.response, valid))
        except ValueError as error:
            accepted = "a white reference that fills the picture and is evenly lit"
            raise InputError(path, "white", str(error), accepted) from None
        if len(coefficients) == 1 and (spot := find_spot(state.response, valid, coefficients[0])):
            LOGGER.warning(
                "%s: about %.0f, %.0f (superpixels) %.0f %% %s than a smooth surface, as by dust or a stain, which the "
                "white reference does not correct: clean card, lens and sensor",
                path,
                spot.column,
                spot.row,
                100 * abs(spot.difference),
                "darker" if spot.difference < 0 else "brighter",
            )
    LOGGER.info("white reference, filter %s: %d rounds of frames", group[0].filter, len(coefficients))
    return np.mean(coefficients, axis=0) / (cosine * reflectance)
