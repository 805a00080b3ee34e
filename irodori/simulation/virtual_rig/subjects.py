"""Ideal responses of the virtual camera's pixels to its subjects, before vignetting, stray light and noise.

Every function returns (height, width) float64 for one filter state, 1 = a perfect diffuser lit at normal incidence in
the brightest band.
"""

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from irodori.config.capture_table import Pose, flat_incidence_rad
from irodori.config.models import (
    Camera,
    Chart,
    FurtherPlacement,
    LaidOff,
    LevelPatch,
    Markers,
    Rig,
    VirtualRoom,
)
from irodori.config.parts import AnyCamera
from irodori.geometry.embree import Tracer
from irodori.geometry.lamp import Lamp
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import (
    rig_from_camera,
    rig_from_object,
    rotation_xyz,
    to_camera,
    to_light,
)
from irodori.geometry.shapes.placement import Placement, laid, with_table
from irodori.light.omnidirectional import to_panorama
from irodori.simulation.virtual_rig.aperture import gather_rows, place_in_cell
from irodori.simulation.virtual_rig.classroom import source_spectra
from irodori.simulation.virtual_rig.imaging import RigView, expose_object
from irodori.simulation.virtual_rig.samples import Sample
from irodori.spectra.published import chart_spectra
from irodori.spectra.white_reference import white_reflectance

_PATCH_FILL = 0.42  # half of a patch's side, as a fraction of the pitch between patches
_BORDER_REFLECTANCE = 0.03
_GREY = 0.5  # reflectance factor of a patch that states none
_INK, _PAPER = 0.05, 0.8  # reflectance factors of a printed sheet
#: Where the printed sheet lies on the table, along x and y, mm, and its turn, degrees: no one lays it exactly.
_SHEET_AT_MM, _SHEET_TURN_DEG = (3.0, -2.0), 5.0
_SQUARE_SAMPLES = 60  # samples of the drawn sheet along a square
_BLOCK_ROWS = 64


def in_mosaic(bands: np.ndarray) -> np.ndarray:
    """Return the RGGB mosaic (height, width) of a picture of three bands, (height, width, 3)."""
    y, x = np.indices((bands.shape[0], bands.shape[1]), sparse=True)
    return np.take_along_axis(bands, (y % 2 + x % 2)[..., None], axis=2)[..., 0]


def object_mosaic(
    sample: Sample,
    camera: AnyCamera,
    rig: Rig,
    pose: Pose,
    ideal_from_seen,
    band_weights,
    *,
    patch: LevelPatch | None = None,
    markers: Markers | None = None,
    placements: Sequence[FurtherPlacement] = (),
) -> np.ndarray:
    """Return the mosaic of an object on the table, of the patch that tells the lamp's level, and of a printed sheet.

    Parameters
    ----------
    sample : Sample
    camera : Camera or PhotographingCamera
    rig : Rig
    pose : Pose
        True pose of the rig.
    ideal_from_seen : (2, 3) float
        Map of the filter plate, see `irodori.simulation.virtual_rig.imperfections.Faults.ideal_from_seen`.
    band_weights : (3, 61) float
        Weights of the filter state.
    patch : LevelPatch, optional
        Matt card of one reflectance factor, `_GREY` if it states none. The card is a fifth wider than the square that
        is measured.
    markers : Markers, optional
        The printed sheet, which lies under the object, somewhat off the middle of the table.
    placements : sequence of FurtherPlacement
        Placements of the object after the first; the pose says which one is photographed.
    """
    assert camera.optics is not None and rig.virtual is not None  # checked: the rig is virtual, its camera has optics
    rotation = rig_from_object(pose)
    faults = rig.virtual.imperfections
    longer = faults.focal_length.percent / 100.0 if faults.focal_length.enabled else 0.0
    pinhole = Pinhole.from_optics(camera.optics)
    view = RigView(
        pinhole=replace(pinhole, focal_px=pinhole.focal_px * (1.0 + longer)),
        position_mm=rig.camera_distance_mm * to_camera(pose),
        world_from_camera=rig_from_camera(pose, pinhole.quarter_turns),
        to_light=to_light(pose),
        lamp=Lamp.at(rig.light.distance_mm),
        lamp_radius_rad=math.radians(rig.virtual.light_angular_radius_deg),
        ideal_from_seen=ideal_from_seen,
    )
    rotation_deg = placements[pose.placement - 2].rotation_deg if pose.placement > 1 else (0.0, 0.0, 0.0)
    lies = laid(sample.shape, rotation_deg)
    if faults.laid_off.enabled:
        lies = _laid_off(lies, faults.laid_off, rig.virtual.seed, pose.placement)
    tracer = Tracer(with_table(lies, rotation, rig.table_radius_mm))
    picture = expose_object(sample, tracer, view, band_weights)
    if markers is not None:
        height_mm = sample.shape.table_height_mm if markers.z_mm is None else markers.z_mm
        _add_card(picture, _sheet(markers, height_mm, rotation), pose, tracer, view, band_weights)
    if patch is not None:
        _add_card(picture, _level_card(patch, rotation), pose, tracer, view, band_weights)
    return picture


def _laid_off(lain: Placement, off: LaidOff, seed: int, number: int) -> Placement:
    """Return an object that does not lie exactly where it is said to, in the frame of the table.

    A further placement has errors of its own.

    Parameters
    ----------
    lain : Placement
        As it is said to lie, in the frame of the table.
    off : LaidOff
    seed : int
        Seed of the rig.
    number : int
        Number of the placement.
    """
    translation_mm, rotation_deg = np.array(off.translation_mm), np.array(off.rotation_deg)
    if number > 1:
        rng = np.random.default_rng([seed, zlib.crc32(f"placement {number}".encode())])
        translation_mm, rotation_deg = translation_mm * rng.normal(size=3), off.turned_rms_deg * rng.normal(size=3)
    return Placement(lain.shape, rotation_xyz(rotation_deg) @ lain.rotation, lain.translation_mm + translation_mm)


class _Card(NamedTuple):
    """A flat matt thing: its middle (3,) mm and axes (3, 3) in the rig's frame, half its sides (2,) mm, reflectance.

    ``reflectance`` takes places on it, (n, 2) mm from its middle, and returns reflectance factors, (n,).
    """

    centre: np.ndarray
    axes: np.ndarray
    half: np.ndarray
    reflectance: Callable[[np.ndarray], np.ndarray]


def _level_card(patch: LevelPatch, table: np.ndarray) -> _Card:
    """Return the patch that tells the lamp's level; ``table`` is the rotation of the table."""
    axes, factor = table if patch.moves_with_table else np.eye(3), patch.reflectance_factor or _GREY
    half = np.full(2, 0.6 * patch.side_mm)
    return _Card(axes @ np.array(patch.centre_mm), axes, half, lambda place: np.full(len(place), factor))


def _sheet(markers: Markers, height_mm: float, table: np.ndarray) -> _Card:
    """Return the printed sheet at a height above the origin; ``table`` is the rotation of the table."""
    from irodori.lens.printed_sheets import OBJECT_SHEET

    width_mm, length_mm, square_mm = OBJECT_SHEET.papers_mm[markers.paper]
    scale = (markers.square_mm or square_mm) / square_mm
    drawn = OBJECT_SHEET.picture(_SQUARE_SAMPLES)

    def reflectance(place: np.ndarray) -> np.ndarray:
        per_mm = _SQUARE_SAMPLES / (scale * square_mm)
        column = np.floor(place[:, 0] * per_mm + drawn.shape[1] / 2).astype(int)
        row = np.floor(drawn.shape[0] / 2 - place[:, 1] * per_mm).astype(int)
        printed = (column >= 0) & (column < drawn.shape[1]) & (row >= 0) & (row < drawn.shape[0])
        black = np.zeros(len(place), dtype=bool)
        black[printed] = drawn[row[printed], column[printed]] == 0
        return np.where(black, _INK, _PAPER)

    axes = table @ rotation_xyz((0.0, 0.0, _SHEET_TURN_DEG))
    half = 0.5 * scale * np.array([width_mm, length_mm])
    return _Card(table @ np.array([*_SHEET_AT_MM, height_mm]), axes, half, reflectance)


def _add_card(picture: np.ndarray, card: _Card, pose: Pose, tracer: Tracer, view: RigView, band_weights) -> None:
    """Put a flat matt thing into the picture of an object, which may hide or shade it; the table does neither."""
    normal, eye = card.axes[:, 2], np.asarray(view.position_mm)
    alone, start = Tracer(list(tracer.placements[:1])), 1e-4 * card.half.min() * normal
    bands = np.asarray(band_weights).sum(axis=1)
    height, width = picture.shape
    added, covered = np.empty_like(picture), np.empty_like(picture)
    for first in range(0, height, _BLOCK_ROWS):
        rows = min(_BLOCK_ROWS, height - first)
        row, column = np.indices((2 * rows + 2, 2 * width + 2), sparse=True)
        x, y = place_in_cell(2 * first + row - 1, column - 1)
        seen = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1) @ np.asarray(view.ideal_from_seen).T
        way = view.pinhole.directions(seen, view.world_from_camera)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = ((card.centre - eye) @ normal) / (way @ normal)
            across = ((eye + along[..., None] * way - card.centre) @ card.axes)[..., :2]
        is_card = (np.abs(across) < card.half).all(axis=-1) & (along > 0.0) & (way @ normal < 0.0)
        place = eye + along[is_card][:, None] * way[is_card] + start
        is_card[is_card] = is_seen = ~alone.occluded(place, -way[is_card], far=along[is_card])
        place = place[is_seen]
        light, power, far = view.lamp.seen_from(place, pose)
        lit = (
            card.reflectance(across[is_card])
            * power
            * np.maximum(light @ normal, 0.0)
            * ~alone.occluded(place, light, far=far)
        )
        for out, values in ((added, lit[:, None] * bands), (covered, np.ones((len(place), 3)))):
            points = np.zeros((*is_card.shape, 3))
            points[is_card] = values
            gather_rows(points, first, out)
    picture *= 1.0 - covered
    picture += added


def white_mosaic(camera: Camera, rig: Rig, pose: Pose, ideal_from_seen, band_weights) -> np.ndarray:
    """Return the mosaic of the white reference, which fills the picture; parameters as in `object_mosaic`."""
    optics = camera.optics
    assert camera.white is not None and optics is not None  # checked: a camera that photographs a white has both
    reflectance, _ = white_reflectance(camera.white.reflectance_factor, band_weights)
    level = reflectance * math.cos(flat_incidence_rad(pose)) * band_weights.sum(axis=1)
    picture = in_mosaic(np.broadcast_to(level, (optics.height_px, optics.width_px, 3)))
    return picture * _fall_off(camera, rig, pose, ideal_from_seen)


def _fall_off(camera: AnyCamera, rig: Rig, pose: Pose, ideal_from_seen) -> np.ndarray | float:
    """Return the irradiance of a flat subject in each mosaic pixel, relative to its centre; 1 under a far light."""
    lamp = Lamp.at(rig.light.distance_mm)
    if not lamp.is_near:
        return 1.0
    assert camera.optics is not None  # checked: a camera on a rig has optics
    pinhole = Pinhole.from_optics(camera.optics)
    y, x = np.indices((pinhole.height_px, pinhole.width_px)) + 0.5
    point = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.asarray(ideal_from_seen).T
    return lamp.on_white(point, pinhole, rig.camera_distance_mm, pose)


def chart_mosaic(chart: Chart, camera: AnyCamera, rig: Rig, pose: Pose, ideal_from_seen, band_weights) -> np.ndarray:
    """Return the mosaic of a colour chart on the table; other parameters as in `object_mosaic`."""
    bands = _patch_bands(chart, math.cos(flat_incidence_rad(pose)), band_weights)
    return _chart_picture(bands, chart, camera, rig, pose, ideal_from_seen) * _fall_off(
        camera, rig, pose, ideal_from_seen
    )


def room_chart_mosaic(
    chart: Chart, light: np.ndarray, camera: AnyCamera, rig: Rig, ideal_from_seen, band_weights
) -> np.ndarray:
    """Return the mosaic of a colour chart in a virtual room, as large as the camera's own chart on the rig.

    ``light`` is the light of the room on the chart, (61,), relative to the rig's light at normal incidence; other
    parameters are as in `object_mosaic`.
    """
    assert camera.poses is not None  # checked: the rig is virtual
    pose = Pose(**vars(camera.poses.chart))
    return _chart_picture(_patch_bands(chart, light, band_weights), chart, camera, rig, pose, ideal_from_seen)


def _patch_bands(chart: Chart, light: np.ndarray | float, band_weights) -> np.ndarray:
    """Return the band responses of a chart's patches, then of its border, (patches + 1, 3).

    ``light`` is the spectral irradiance relative to that of the rig's light at normal incidence.
    """
    _names, patches = chart_spectra(chart.spectra)
    spectra = np.concatenate([patches, np.full((1, patches.shape[1]), _BORDER_REFLECTANCE)])
    return (spectra * light) @ band_weights.T


def _chart_picture(
    bands: np.ndarray, chart: Chart, camera: AnyCamera, rig: Rig, pose: Pose, ideal_from_seen
) -> np.ndarray:
    """Return the mosaic of a uniformly lit chart from the band responses of its patches and its border."""
    assert camera.optics is not None  # checked: a camera on a rig has optics
    pinhole = Pinhole.from_optics(camera.optics)
    image = np.empty((pinhole.height_px, pinhole.width_px))
    for first in range(0, pinhole.height_px, _BLOCK_ROWS):
        rows = min(_BLOCK_ROWS, pinhole.height_px - first)
        row, column = np.indices((2 * rows + 2, 2 * pinhole.width_px + 2), sparse=True)
        x, y = place_in_cell(2 * first + row - 1, column - 1)
        point = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1) @ np.asarray(ideal_from_seen).T
        gather_rows(bands[_patch_at(point, chart, camera, rig, pose, pinhole)], first, image)
    return image


def _patch_at(mosaic_xy, chart: Chart, camera: AnyCamera, rig: Rig, pose: Pose, pinhole: Pinhole) -> np.ndarray:
    """Return the index of the patch at each point of the picture; between patches, the number of patches."""
    rows, columns = chart.rows, chart.columns
    rotation = rig_from_object(pose)
    view = pinhole.directions(mosaic_xy, rig_from_camera(pose, pinhole.quarter_turns)) @ rotation
    eye = rig.camera_distance_mm * to_camera(pose) @ rotation
    point = eye - view * (eye[2] / view[..., 2:])
    assert camera.virtual is not None  # checked: on a virtual rig the camera is virtual
    pitch = camera.virtual.chart_width_mm / columns
    across, along = point[..., 0] / pitch + columns / 2, rows / 2 - point[..., 1] / pitch
    column, row = np.floor(across).astype(int), np.floor(along).astype(int)
    patch = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    patch &= (np.abs(across - column - 0.5) < _PATCH_FILL) & (np.abs(along - row - 0.5) < _PATCH_FILL)
    return np.where(patch, row * columns + column, rows * columns)


def room_mosaic(room: VirtualRoom, coefficients: np.ndarray, light: np.ndarray, band_weights) -> np.ndarray:
    """Return the mosaic of an omnidirectional picture of a virtual room, a panorama whose centre looks towards +x.

    Parameters
    ----------
    room : VirtualRoom
    coefficients : (height, width, sources) float
        What `room_coefficients` gives of the room: the same for every photograph of it.
    light : (61,) float
        Spectrum E(λ) of the rig's light.
    band_weights : (3, 61) float
        Weights of the filter state.
    """
    _names, spectra = source_spectra(room, light)
    # Band weights are for reflectances under the rig's light; a radiance is that light times a reflectance.
    bands = coefficients @ (spectra / light @ band_weights.T)
    # A panorama is resampled from many photographs: the four mosaic pixels of a superpixel see the same directions.
    return in_mosaic(to_panorama(bands).repeat(2, axis=0).repeat(2, axis=1))
