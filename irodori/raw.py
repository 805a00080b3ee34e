"""RAW ingestion: from a camera's files to linear responses.

A superpixel is 2 x 2 mosaic pixels: red, the mean of the two greens, blue; nothing is interpolated. Bands are red,
green, blue without the filter, then with it where it was used; their number comes from the shots, not from the code.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from irodori import store
from irodori.captures import FILTERS, Shot, read_captures, shot_path, write_captures
from irodori.errors import InputError
from irodori.mosaic import Mosaic, decode
from irodori.provenance import file_sha256

BAND_NAMES = ("red", "green", "blue")
_EXPOSURE_TOLERANCE = 0.05
_FLAT_DEGREE = 4
_FLAT_RESIDUAL = 0.05  # of the mean; pixel noise of a white reference is far below


def check_captures(table, folder, output, roles, size_px=None) -> None:
    """Decode every RAW file of a set once, before any long work, and write its table with their hashes.

    Parameters
    ----------
    table, folder : path
    output : path
        Table of the set's own shots.
    roles : sequence of str
        The roles that the set uses; a table may serve several sets.
    size_px : (width, height), optional
        Size of the mosaic that the definition states; otherwise that of the first file counts.

    Raises
    ------
    InputError
        If a file is missing, truncated, of another size than stated, or its own exposure time differs from the
        table's by more than 5 %.
    """
    shots = [shot for shot in read_captures(table, folder) if shot.role in roles]
    hashes = {}
    wanted = None if size_px is None else (size_px[1] // 2, size_px[0] // 2)
    for shot in shots:
        path = shot_path(shot, table, folder)
        mosaic = decode(path)
        size = mosaic.superpixels.shape[:2]
        wanted = wanted or size
        if size != wanted:
            found = f"a mosaic of {2 * size[1]} x {2 * size[0]} pixels"
            raise InputError(path, "size", found, f"{2 * wanted[1]} x {2 * wanted[0]} pixels, as its set states")
        if mosaic.exposure_s > 0 and abs(mosaic.exposure_s / shot.exposure_s - 1) > _EXPOSURE_TOLERANCE:
            found = f"exposure_s {shot.exposure_s:g} for {shot.file}"
            raise InputError(table, "exposure_s", found, f"{mosaic.exposure_s:g} as the file itself says")
        hashes[shot.file] = file_sha256(path)
    write_captures(output, shots, hashes)


def _exposure_mean(paths: Sequence[Path], exposures_s: Sequence[float], dark, saturation: float):
    """Return dark-subtracted superpixels per second, merged over brackets and repeats, and where they are valid.

    Samples are weighted by exposure time, which is inverse variance where shot noise rules; a clipped sample is
    never used.
    """
    total, weight = 0.0, 0.0
    for path, exposure_s in zip(paths, exposures_s, strict=True):
        mosaic = decode(path)
        if dark is not None and dark.ndim == 3 and dark.shape != mosaic.superpixels.shape:
            found = f"{mosaic.superpixels.shape[:2]} superpixels"
            raise InputError(path, "size", found, f"{dark.shape[:2]}, as the dark frames")
        good = (mosaic.largest < saturation)[..., None]
        signal = (mosaic.superpixels - (0.0 if dark is None else dark)) / mosaic.full_scale
        total = total + np.where(good, signal, 0.0)
        weight = weight + good * exposure_s
    valid = weight[..., 0] > 0
    return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0), valid


def smooth_flat(image: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the polynomial surface (degree 4 in x and y) nearest to a flat-field picture.

    Parameters
    ----------
    image : (height, width, bands) float
    valid : (height, width) bool

    Returns
    -------
    (height, width, bands) float32, positive

    Raises
    ------
    ValueError
        If the picture is not that of an even surface that fills it.
    """
    height, width = image.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    powers = [(i, j) for i in range(_FLAT_DEGREE + 1) for j in range(_FLAT_DEGREE + 1 - i)]
    terms = np.stack([x**i * y**j for i, j in powers], axis=-1)
    # The normal equations of 15 terms on [-1, 1] are well conditioned and need one pass over the picture.
    design = terms[valid]
    coefficients = np.linalg.solve(design.T @ design, design.T @ image[valid])
    flat = terms @ coefficients
    residual = np.sqrt(np.mean((image[valid] - flat[valid]) ** 2, axis=0)) / image[valid].mean(axis=0)
    if not (flat > 0).all() or not (residual < _FLAT_RESIDUAL).all():
        raise ValueError(f"a picture that varies by {np.max(residual):.0%} about a smooth surface")
    return flat.astype(np.float32)


def _equal_pair(shots: list[Shot]) -> tuple[Shot, Shot] | None:
    """Return the first two shots of one exposure time."""
    for i, first in enumerate(shots):
        for second in shots[i + 1 :]:
            if first.exposure_s == second.exposure_s:
                return first, second
    return None


def _photon_transfer(first: Mosaic, second: Mosaic) -> float:
    """Return the conversion gain, electrons per digital number, from two equal frames; NaN if they are identical."""
    a, b = first.superpixels[..., 0], second.superpixels[..., 0]
    good = (first.largest < 0.9) & (second.largest < 0.9)
    mean_a, mean_b = a[good].mean(), b[good].mean()
    difference = a[good] / mean_a - b[good] / mean_b
    mean = 0.5 * (mean_a + mean_b)
    variance = 0.5 * difference.var()
    return float(1.0 / (variance * mean)) if variance > 0 else float("nan")


def ingest_reference(
    table, folder, saturation: float, output, provenance: store.Provenance, white_reflectance: float
) -> None:
    """Average a camera's dark frames and white references into the file that normalises its captures.

    Parameters
    ----------
    table, folder : path
        Capture table of the camera and the folder of its files.
    saturation : float
        Fraction of full scale from which a pixel counts as saturated.
    white_reflectance : float
        Reflectance factor of the white reference, 0..1.

    Notes
    -----
    Datasets: ``/dark`` (H, W, 3) in digital numbers above the black level, ``/white`` (H, W, bands) response rate of
    a perfect diffuser lit at normal incidence, in full scales per second; either is absent where the table has no
    such shots. Attributes ``gain_e_per_dn`` and ``read_noise_dn`` by photon transfer, NaN where not measurable.
    """
    shots = read_captures(table, folder)
    darks = [shot_path(s, table, folder) for s in shots if s.role == "dark"]
    whites = [s for s in shots if s.role == "white"]
    dark, read_noise, gain = None, np.nan, np.nan
    with store.create(output, provenance) as out:
        if darks:
            frames = np.stack([decode(path).superpixels for path in darks])
            dark = frames.mean(axis=0)
            read_noise = float(np.sqrt(frames[..., 0].var(axis=0, ddof=1).mean())) if len(darks) > 1 else np.nan
            out.write("dark", dark, units="DN", dims="row,column,band", quantity="dark frame above black level")
        if whites:
            bands = []
            for state in _filter_states(whites):
                group = [s for s in whites if s.filter == state]
                paths = [shot_path(s, table, folder) for s in group]
                rate, valid = _exposure_mean(paths, [s.exposure_s for s in group], dark, saturation)
                if valid.mean() < 0.5:
                    found = f"a white reference saturated over {1 - valid.mean():.0%} of the picture"
                    raise InputError(paths[0], "exposure_s", found, "a shorter exposure of the white reference")
                cosine = np.cos(np.radians(group[0].pose.light_deg - group[0].pose.tilt_deg))
                try:
                    bands.append(smooth_flat(rate, valid) / np.float32(cosine * white_reflectance))
                except ValueError as error:
                    accepted = "a white reference that fills the picture and is evenly lit"
                    raise InputError(paths[0], "white", str(error), accepted) from None
                pair = _equal_pair(group)
                if pair and not np.isfinite(gain):
                    gain = _photon_transfer(*(decode(shot_path(s, table, folder)) for s in pair))
            out.write(
                "white",
                np.concatenate(bands, axis=-1),
                units="1/s",
                dims="row,column,band",
                quantity="response rate of a perfect diffuser at normal incidence",
            )
        out.attribute("gain_e_per_dn", gain)
        out.attribute("read_noise_dn", read_noise)
        out.attribute("filters", _filter_states(whites))


def _filter_states(shots: list[Shot]) -> list[str]:
    """Return the filter states of shots in the order of the bands, whatever the order of the table's lines."""
    return [state for state in FILTERS if any(shot.filter == state for shot in shots)]


def ingest_raw(table, folder, capture: str, reference, saturation: float, output, provenance: store.Provenance) -> None:
    """Turn the RAW files of one capture into linear responses.

    Parameters
    ----------
    table, folder : path
        Capture table and the folder of its files.
    capture : str
        Name of the capture in the table: all its filter states and brackets are merged.
    reference : path
        File of `ingest_reference`, made with the same camera.
    saturation : float
        Fraction of full scale from which a sample is clipped.

    Notes
    -----
    Datasets: ``/response`` (H, W, bands) float32, 1 = a perfect diffuser lit at normal incidence (full scales per
    second where there is no white reference); ``/valid`` (H, W) uint8; ``/noise_model`` (bands, 2), variance of the
    response = c0 + c1 * response at the picture's centre, NaN where the camera's noise was not measured.
    """
    shots = [s for s in read_captures(table, folder) if s.capture == capture]
    if not shots:
        raise InputError(table, "capture", repr(capture), "a capture the table holds")
    with store.open_file(reference) as file:
        dark = file.read("dark") if "dark" in file else None
        white = file.read("white") if "white" in file else None
        gain, read_noise = file.attribute("gain_e_per_dn"), file.attribute("read_noise_dn")
        white_filters = file.attribute("filters")
    responses, valid, noise = [], True, []
    for state in _filter_states(shots):
        group = [s for s in shots if s.filter == state]
        paths = [shot_path(s, table, folder) for s in group]
        exposures = [s.exposure_s for s in group]
        usable_dark = dark if dark is not None and capture != "environment" else _mean_dark(dark)
        rate, good = _exposure_mean(paths, exposures, usable_dark, saturation)
        flat = _flat_for(white, white_filters, state, capture, table)
        if flat is not None and capture != "environment" and flat.shape != rate.shape:
            raise InputError(paths[0], "size", f"{rate.shape[:2]} superpixels", f"{flat.shape[:2]}, as the white")
        # An omnidirectional picture has its own geometry: the level of the white applies, its shape does not.
        flat = flat[flat.shape[0] // 2, flat.shape[1] // 2] if flat is not None and capture == "environment" else flat
        responses.append(rate if flat is None else rate / flat)
        noise.append(_noise_model(flat, gain, read_noise, max(exposures), decode(paths[0]).full_scale))
        valid = valid & good
    with store.create(output, provenance) as out:
        out.write(
            "response",
            np.concatenate(responses, axis=-1).astype(np.float32),
            units="1" if white is not None else "1/s",
            dims="row,column,band",
            quantity="response",
        )
        out.write("valid", valid.astype(np.uint8), units="1", dims="row,column", quantity="1 where not saturated")
        out.write("noise_model", np.concatenate(noise), units="1", dims="band,term", quantity="variance c0 + c1 rho")
        pose = shots[0].pose
        out.attribute("pose_deg", [pose.light_deg, pose.camera_deg, pose.tilt_deg, pose.turn_deg])
        out.attribute("filters", _filter_states(shots))


def _mean_dark(dark):
    return None if dark is None else dark.mean(axis=(0, 1))


def _flat_for(white, white_filters: list[str], state: str, capture: str, table):
    if white is None:
        return None
    if state not in white_filters:
        raise InputError(
            table,
            "filter",
            f"{capture} shot with the filter {state!r}",
            f"filters of the white reference: {', '.join(white_filters)}",
        )
    at = 3 * white_filters.index(state)
    return white[..., at : at + 3]


def _noise_model(flat, gain: float, read_noise: float, exposure_s: float, full_scale: float) -> np.ndarray:
    """Return c0 and c1 of each of three bands at the centre of the picture, (3, 2)."""
    if flat is None or not np.isfinite(gain) or not np.isfinite(read_noise):
        return np.full((3, 2), np.nan)
    level = flat if flat.ndim == 1 else flat[flat.shape[0] // 2, flat.shape[1] // 2]
    dn_per_response = level * exposure_s * full_scale
    # Green is the mean of two mosaic pixels.
    samples = np.array([1.0, 2.0, 1.0])
    return np.stack([(read_noise / dn_per_response) ** 2 / samples, 1.0 / (gain * dn_per_response) / samples], axis=-1)
