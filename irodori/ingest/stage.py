"""Ingestion stage: reads the RAW files of one capture; writes linear responses."""

from dataclasses import replace

import numpy as np

from irodori.config.capture_table import Shot, check_unchanged, read_captures
from irodori.config.parts import NearLamp
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.ingest.camera_reference import Reference
from irodori.ingest.develop import Developed, Frame, empty_response, load_frames, merge_frames
from irodori.ingest.exposure_settings import filter_states, known_settings, settle_set
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.near_lamp import evenly_lit
from irodori.ingest.shot_alignment import Alignment, align_states, move
from irodori.spectra.coordinates import write_bands

_BANDS = 3
_ENVIRONMENT = "environment"


def ingest_raw(
    table,
    folder,
    capture: str,
    reference,
    output,
    provenance: store.Provenance,
    *,
    options: IngestOptions,
    near_lamp: NearLamp | None = None,
) -> None:
    """Compute linear responses from the RAW files of one capture, and write them.

    Parameters
    ----------
    table, folder : path
        Capture table and the folder of its files.
    capture : str
        Name of the capture in the table: all its filter states and brackets are merged.
    reference : path
        File of `ingest_reference`, made with the same camera.
    options : IngestOptions
    near_lamp : NearLamp, optional
        Near lamp that lit the white reference, for a capture that it does not light.

    Raises
    ------
    InputError
        If a file contradicts the table, its hash in the table, or the reference, or the filter states cannot be
        registered.

    Notes
    -----
    Datasets: ``/response`` (H, W, bands) float32, 1 = a perfect diffuser lit at normal incidence (without a white
    reference: full scales per second of relative exposure), 0 where not valid; ``/valid`` (H, W) uint8, 1 where every
    band was measured; ``/clipped`` (H, W) uint8, 1 where a band is at or above the clip level in every exposure of its
    bracket (a pixel that is neither valid nor clipped is hot or outside the picture); ``/noise_model`` (bands, 2),
    coefficients of the variance c0 + c1 * response at the picture's centre for the exposures merged, NaN if the
    camera's noise was not measured; ``/exposure_noise`` (exposures, bands, 2), these coefficients of each exposure
    alone, the shortest first, and ``/exposure_limit`` (exposures, bands), the response from which it no longer counts,
    0 for one that a filter state lacks; ``/registration`` (4), see `irodori.ingest.shot_alignment`, with two filter
    states.
    The attribute ``sample_px`` is the side of a sample in mosaic pixels.
    """
    shots = [s for s in read_captures(table, folder) if s.capture == capture]
    if not shots:
        raise InputError(table, "capture", repr(capture), "a capture the table holds")
    check_unchanged(table, folder, shots)
    camera = Reference.load(reference)
    states = filter_states(shots)
    _check_filters(camera, states, capture, table)
    frames = load_frames(camera, shots, table, folder, options)
    settled = settle_set([f.shot for f in frames], table)
    _check_settings(camera, settled, table)
    frames = [replace(f, shot=shot) for f, shot in zip(frames, settled, strict=True)]
    height, width = (side // options.sample_px for side in frames[0].mosaic.values.shape)
    response = empty_response(height, width, len(states))
    align = options.register and len(states) > 1 and capture != _ENVIRONMENT
    developed = []
    for number, state in enumerate(states):
        group = [f for f in frames if f.shot.filter == state]
        if group[0].mosaic.values.shape != frames[0].mosaic.values.shape:
            found = f"{group[0].mosaic.size} pixels"
            raise InputError(group[0].shot.file, "size", found, f"{frames[0].mosaic.size}, as the other filter state")
        # A picture that will be resampled needs its own memory; the result goes into ``response``.
        out = None if align and number else response[..., _BANDS * number : _BANDS * (number + 1)]
        white = camera.white.get(state)
        if white is not None and near_lamp is not None:
            white = evenly_lit(white, camera.size_px, near_lamp)
        developed.append(merge_frames(camera, group, options, white, out))
    alignment = None
    if align:
        alignment = align_states(developed[0], developed[1], camera.alignment, options, table, capture)
        developed[1] = move(developed[1], alignment, options.sample_px, response[..., _BANDS:])
    unit = "1" if camera.white else "1/s"
    _write(output, provenance, response, developed, unit=unit, alignment=alignment, options=options, frames=frames)


def _check_filters(camera: Reference, states: list[str], capture: str, table) -> None:
    for state in states:
        if camera.white and state not in camera.white:
            found = f"{capture} shot with the filter {state!r}"
            raise InputError(table, "filter", found, f"filters of the white reference: {', '.join(camera.white)}")


def _check_settings(camera: Reference, shots: list[Shot], table) -> None:
    """Raise `InputError` if ISO or aperture is known for the capture or for the white reference, but not for both."""
    known = known_settings(shots)
    if camera.white and set(known) != set(camera.known):
        column = sorted(set(known) ^ set(camera.known))[0]
        found = f"{column} {'known' if column in known else 'unknown'} for {shots[0].file}"
        accepted = f"{column} {'unknown' if column in known else 'known'}, as for the camera's white reference"
        raise InputError(table, column, found, accepted)


def _of_all_states(exposures: list[np.ndarray]) -> np.ndarray:
    """Join the noise of the exposures of all filter states; one that a state lacks never counts."""
    out = np.empty((max(map(len, exposures)), len(exposures), *exposures[0].shape[1:]))
    out[:] = 1.0, 0.0, 0.0
    for number, state in enumerate(exposures):
        out[: len(state), number] = state
    return out.reshape(len(out), -1, out.shape[-1])


def _write(
    output,
    provenance: store.Provenance,
    response: np.ndarray,
    developed: list[Developed],
    *,
    unit: str,
    alignment: Alignment | None,
    options: IngestOptions,
    frames: list[Frame],
) -> None:
    shots = [frame.shot for frame in frames]
    valid = np.logical_and.reduce([state.valid for state in developed])
    clipped = np.logical_or.reduce([state.clipped for state in developed])
    LOGGER.info(
        "%s: %.3f %% clipped, %.3f %% masked otherwise", shots[0].capture, 100 * clipped.mean(),
        100 * (1.0 - (valid | clipped).mean()),
    )  # fmt: skip
    with store.create(output, provenance) as out:
        dims = "row,column"
        out.write("response", response, units=unit, dims=f"{dims},band", quantity="response", compression="none")
        for name, mask, quantity in (
            ("valid", valid, "whether every band is measured"),
            ("clipped", clipped, "whether a band clips in every exposure"),
        ):
            out.write(name, mask.view(np.uint8), units=store.Mask, dims=dims, quantity=quantity)
        write_bands(out, filter_states(shots))
        noise = np.concatenate([state.noise for state in developed])
        out.coordinate("term", ["c0", "c1"], units="1", quantity="coefficient of the variance")
        out.write("noise_model", noise, units="1", dims="band,term", quantity="variance c0 + c1 rho")
        exposures = _of_all_states([state.exposures for state in developed])
        quantity, dims = "variance c0 + c1 rho of one exposure", "exposure,band,term"
        out.write("exposure_noise", exposures[..., :2], units="1", dims=dims, quantity=quantity)
        quantity = "response from which an exposure no longer counts"
        out.write("exposure_limit", exposures[..., 2], units="1", dims="exposure,band", quantity=quantity)
        if alignment is not None:
            alignment.write(out)
        pose = shots[0].pose
        out.attribute("pose_deg", list(pose.angles_deg))
        out.attribute("placement", pose.placement)
        out.attribute("filters", filter_states(shots))
        out.attribute("sample_px", options.sample_px)
        out.attribute("demosaic", options.demosaic)
        # Where the bands of a superpixel lie; those of demosaiced pictures coincide.
        out.attribute("mosaic", developed[0].pattern if options.sample_px == 2 else "")
        out.attribute("orientation", frames[0].mosaic.orientation)
