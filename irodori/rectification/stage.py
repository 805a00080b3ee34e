"""Rectification stage: response and geometry of every texel in every capture [design, §4].

Responses are relative to a perfect diffuser at normal incidence. Under a near lamp, they are relative to the irradiance
at the texel; `irodori.geometry.lamp` explains which part of the lamp's fall-off the white reference has removed already
and which part is removed here.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.capture_table import Pose
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track
from irodori.geometry.atlas import Texels
from irodori.geometry.distortion import distort
from irodori.geometry.embree import Tracer, is_blocked, new_ray, trace
from irodori.geometry.interpolation import KEYS_NOISE_SHARE, keys_weights
from irodori.geometry.lamp import FAR, Lamp
from irodori.geometry.pinhole import NEAREST_MM, Pinhole, bayer_offsets_px, samples_from_superpixels
from irodori.geometry.rig_frame import rig_from_camera, to_camera, to_light
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.jit.half_precision import half_from_single
from irodori.material.angle_errors import ANGLES, write_registered
from irodori.material.observed_angles import Surroundings, write_surroundings
from irodori.material.tile_strips import strips, texels_of
from irodori.rectification.placement_correction import AS_TYPED, Correction
from irodori.reflection.angle_kernels import angle_between, angles_between, unit
from irodori.reflection.equation5 import angles_from_directions
from irodori.spectra.coordinates import require_bands, write_bands

if TYPE_CHECKING:
    from irodori.config.models import FurtherPlacement, Object, Optics, RigPose
    from irodori.config.parts import RigGeometry, TexturedObject

_ANGLES_OF_POSE = tuple(field.name for field in fields(Pose) if field.name != "placement")
_CHUNK = 8192  # texels that a thread takes at a time
_LARGEST = float(np.finfo(np.float16).max)


@dataclass(frozen=True)
class RigSetup:
    """Geometry of rig and camera that determines where a texel appears in a picture and how it is lit.

    Parameters
    ----------
    pinhole : Pinhole
    camera_distance_mm : float
        From the origin to the centre of projection.
    table_radius_mm : float
        Half the side of the table's top; 0 for none.
    lamp : Lamp
    white_pose : Pose, optional
        Pose in which the white reference was photographed; needed if the lamp is near.
    correction : Correction
        Correction of the object's place and the angles; pinhole and distance are corrected already.
    further : tuple of RigSetup
        The same for each further placement of the object, if photographs of all placements are read together.
    """

    pinhole: Pinhole
    camera_distance_mm: float
    table_radius_mm: float
    lamp: Lamp = FAR
    white_pose: Pose | None = None
    correction: Correction = AS_TYPED
    further: tuple["RigSetup", ...] = ()

    @classmethod
    def from_definitions(cls, optics: "Optics", rig: "RigGeometry", white_pose: "RigPose | None" = None) -> "RigSetup":
        """Return the setup of a camera and its rig.

        Parameters
        ----------
        optics : Optics
        rig : RigGeometry
        white_pose : RigPose, optional
            Pose of the white reference; needed if the lamp is near.

        Raises
        ------
        InputError
            If the lamp is near and the pose of the white reference is not given.
        """
        lamp = Lamp.at(rig.lamp_distance_mm)
        if lamp.is_near and white_pose is None:
            found = "no pose of the white reference, though the rig's light is near"
            raise InputError("camera", "poses.white", found, "photographs of the role white")
        return cls(
            Pinhole.from_optics(optics),
            rig.camera_distance_mm,
            rig.table_radius_mm,
            lamp,
            None if white_pose is None else Pose(**vars(white_pose)),
        )

    def corrected(self, correction: Correction) -> "RigSetup":
        """Return a copy of the setup with a correction from the photographs applied."""
        distance = correction.camera_distance_mm(self.camera_distance_mm)
        pinhole = correction.pinhole(self.pinhole)
        return replace(self, pinhole=pinhole, camera_distance_mm=distance, correction=correction)

    def laid(self, shape: Shape, placements: "Sequence[FurtherPlacement]", number: int = 1) -> "RigSetup":
        """Return a copy of the setup for one placement of the object, whose place is as typed."""
        return self if number == 1 else self.corrected(Correction.laid(shape, placements[number - 2].rotation_deg))

    def registered(
        self, shape: Shape, placements: "Sequence[FurtherPlacement]", registrations: Sequence = ()
    ) -> "RigSetup":
        """Return a copy of the setup for all placements of the object.

        Parameters
        ----------
        shape : Shape
        placements : sequence of FurtherPlacement
            Those after the first.
        registrations : sequence of path
            Files of the registration of every placement; none if all lie as typed.
        """
        setups = [self.laid(shape, placements, number) for number in range(1, len(placements) + 2)]
        if registrations:
            found = zip(setups, registrations, strict=True)
            setups = [one.corrected(one.correction.by(Correction.load(path).values)) for one, path in found]
        return replace(setups[0], further=tuple(setups[1:]))

    def of(self, pose: Pose) -> "RigSetup":
        """Return the setup for the placement that a photograph shows."""
        return self.further[pose.placement - 2] if self.further and pose.placement > 1 else self

    def light_gain(self, xy, power) -> np.ndarray:
        """Return factors (n,) that make responses relative to each texel's irradiance instead of the white reference's.

        Parameters
        ----------
        xy : (n, 2) float
            Positions of the texels in the picture, superpixels.
        power : (n,) float
            Irradiance of the texels normal to the beam, 1 at the origin.
        """
        if not self.lamp.is_near:
            return np.ones(len(xy))
        assert self.white_pose is not None  # required for a near lamp
        white = self.lamp.on_white(2.0 * (xy + 0.5), self.pinhole, self.camera_distance_mm, self.white_pose)
        return white / power


class _Window(NamedTuple):
    """A rectangular part of a picture: responses, masks and its position."""

    response: np.ndarray  # (height, width, bands)
    valid: np.ndarray  # (height, width)
    clipped: np.ndarray  # (height, width)
    corner: np.ndarray  # (2,) row and column at which it begins
    places: np.ndarray  # (colours, 2) centres of the bands in a sample, x then y, samples from its centre; in turn


@njit(cache=True, forceinline=True)
def _all_valid(valid, left, top):
    """Return whether all 4 x 4 samples from a corner on are in the window and valid."""
    height, width = valid.shape
    if left < 0 or top < 0 or left + 4 > width or top + 4 > height:
        return False
    for y in range(top, top + 4):
        for x in range(left, left + 4):
            if not valid[y, x]:
                return False
    return True


@njit(cache=True, nogil=True)
def _sample(window, xy, out, marks, first, last):
    """Interpolate responses at points ``xy`` and mark which points are good and which clip.

    From 4 x 4 samples by Keys' cubic, or bilinearly from 2 x 2 if one of the others is not valid. A point is good if
    those of the 2 x 2 that have weight are in the window and valid in all bands; it clips if one of them clips.
    Coordinates are those of the whole picture, so that a texel gets the same bits in whichever tile it is.
    """
    (response, valid, clipped, corner, places), (good, clips) = window, marks
    height, width, bands = response.shape
    colours = places.shape[0]
    for t in range(first, last):
        good[t], clips[t] = False, 0
        known = True
        for colour in range(colours):
            x, y = xy[t, 0] - places[colour, 0], xy[t, 1] - places[colour, 1]
            if not (x >= 0.0 and y >= 0.0):
                known = False
                break
            left, top_row = math.floor(x), math.floor(y)
            fx, fy = x - left, y - top_row
            x0, y0 = left - corner[1], top_row - corner[0]
            # A neighbour without weight is not read, because it may lie outside the window or the picture.
            x1, y1 = x0 + (1 if fx > 0.0 else 0), y0 + (1 if fy > 0.0 else 0)
            if x0 < 0 or y0 < 0 or x1 > width - 1 or y1 > height - 1:
                known = False
                break
            clips[t] |= clipped[y0, x0] | clipped[y0, x1] | clipped[y1, x0] | clipped[y1, x1]
            if not (valid[y0, x0] and valid[y0, x1] and valid[y1, x0] and valid[y1, x1]):
                known = False
                continue
            if _all_valid(valid, x0 - 1, y0 - 1):
                wx, wy = keys_weights(fx), keys_weights(fy)
                for b in range(colour, bands, colours):
                    total = np.float32(0.0)
                    for j in range(4):
                        row = np.float32(0.0)
                        for i in range(4):
                            row += wx[i] * response[y0 - 1 + j, x0 - 1 + i, b]
                        total += wy[j] * row
                    out[t, b] = total
                continue
            for b in range(colour, bands, colours):
                top = (1.0 - fx) * response[y0, x0, b] + fx * response[y0, x1, b]
                bottom = (1.0 - fx) * response[y1, x0, b] + fx * response[y1, x1, b]
                out[t, b] = (1.0 - fy) * top + fy * bottom
        good[t] = known
        if not known:
            for b in range(bands):
                out[t, b] = 0.0


class _Seen(NamedTuple):
    """Surface of n texels in the frame of the object, and where it lies in the frame of the rig."""

    position: np.ndarray  # (n, 3) mm
    normal: np.ndarray  # (n, 3) unit vectors
    facet: np.ndarray  # (n, 3) unit vectors, normals of the facets
    rotation: np.ndarray  # (3, 3) rig_from_object
    translation_mm: np.ndarray  # (3,)
    scale: float


class _Around(NamedTuple):
    """Lamp and camera in the frame of the rig."""

    lamp: np.ndarray  # (3,) place of a near one, mm, or direction of a far one
    near: float  # 1 or 0
    lamp_mm: float  # distance from the origin
    camera: np.ndarray  # (3,) centre of projection, mm
    world_from_camera: np.ndarray  # (3, 3)
    distortion: np.ndarray  # (8,)
    fold: float
    focal_px: float
    centre_px: tuple
    offset_mm: float  # between a texel and the beginning of a ray
    is_sheet: bool


class _Looked(NamedTuple):
    """Arrays that `_look` fills for n texels."""

    geometry: np.ndarray  # (n, 2) θ_i and θ_r, or (n, 4) with θ_H and φ, rad
    xy: np.ndarray  # (n, 2) superpixels
    visible: np.ndarray  # (n,) bool
    lit: np.ndarray  # (n,) bool
    power: np.ndarray  # (n,) irradiance normal to the beam, 1 at the origin
    lit_behind: np.ndarray  # (n,) bool


@njit(cache=True, forceinline=True)
def _turned(matrix, x, y, z):
    """Return the product of a matrix and a vector."""
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _project(around, point):
    """Return where a point of the rig is in the picture, superpixels; see `Pinhole.project`."""
    x, y, z = point[0] - around.camera[0], point[1] - around.camera[1], point[2] - around.camera[2]
    across, down, depth = _turned(around.world_from_camera.T, x, y, z)
    if not depth > NEAREST_MM:
        return math.nan, math.nan
    u, v = distort(around.distortion, around.fold, across / depth, down / depth)
    (x0, y0), focal = around.centre_px, around.focal_px
    return (u * focal + x0) * 0.5 - 0.5, (v * focal + y0) * 0.5 - 0.5


@njit(cache=True, nogil=True, error_model="numpy")
def _look(surface, around, tracing, looked, first, last):
    """Fill angles, visibility and places in the picture of texels; a ray is traced only where a facet faces its end."""
    rotation, (tx, ty, tz), scale = surface.rotation, surface.translation_mm, surface.scale
    (occluded, scene), geometry, ray, offset = tracing, looked.geometry, new_ray(), around.offset_mm
    for t in range(first, last):
        x, y, z = _turned(rotation, surface.position[t, 0], surface.position[t, 1], surface.position[t, 2])
        x, y, z = scale * x + tx, scale * y + ty, scale * z + tz
        normal = _turned(rotation, surface.normal[t, 0], surface.normal[t, 1], surface.normal[t, 2])
        fx, fy, fz = _turned(rotation, surface.facet[t, 0], surface.facet[t, 1], surface.facet[t, 2])
        lamp, camera, near = around.lamp, around.camera, around.near
        lx, ly, lz, light_mm = unit(lamp[0] - near * x, lamp[1] - near * y, lamp[2] - near * z)
        vx, vy, vz, camera_mm = unit(camera[0] - x, camera[1] - y, camera[2] - z)
        if geometry.shape[1] == 4:
            angles = angles_between(normal, (lx, ly, lz), (vx, vy, vz))
            geometry[t, 2], geometry[t, 3] = angles[2], angles[3]
            incidence, reflection = angles[0], angles[1]
        else:
            incidence, reflection = angle_between(normal, (lx, ly, lz)), angle_between(normal, (vx, vy, vz))
        geometry[t, 0], geometry[t, 1] = incidence, reflection
        looked.xy[t, 0], looked.xy[t, 1] = _project(around, (x, y, z))
        looked.power[t] = (around.lamp_mm / light_mm) ** 2 if near > 0.0 else 1.0
        far = light_mm if near > 0.0 else math.inf
        start = x + offset * fx, y + offset * fy, z + offset * fz
        visible = reflection < 0.5 * math.pi and fx * vx + fy * vy + fz * vz > 0.0
        if visible:
            trace(occluded, scene, ray, start, (vx, vy, vz), camera_mm)
            visible = not is_blocked(ray)
        to_lamp = fx * lx + fy * ly + fz * lz
        lit = incidence < 0.5 * math.pi and to_lamp > 0.0
        if lit:
            trace(occluded, scene, ray, start, (lx, ly, lz), far)
            lit = not is_blocked(ray)
        behind = around.is_sheet and incidence > 0.5 * math.pi and to_lamp < 0.0
        if behind:
            trace(occluded, scene, ray, (x - offset * fx, y - offset * fy, z - offset * fz), (lx, ly, lz), far)
            behind = not is_blocked(ray)
        looked.visible[t], looked.lit[t], looked.lit_behind[t] = visible, lit, behind


class Sight(NamedTuple):
    """Position, angles and visibility of texels in a capture.

    ``xy`` (n, 2) position in the picture, superpixels; ``geometry`` (n, 4) θ_i, θ_r, θ_H, φ in rad; ``visible``,
    ``lit`` (n,) bool, from the angles with the normal and from shadow rays; ``power`` (n,) irradiance normal to the
    beam, 1 at the origin; ``lit_behind`` (n,) whether the light reaches the other side of a sheet there.
    """

    xy: np.ndarray
    geometry: np.ndarray
    visible: np.ndarray
    lit: np.ndarray
    power: np.ndarray
    lit_behind: np.ndarray


def observe(position, normal, tracer: Tracer, pose: Pose, setup: RigSetup, facet=None) -> Sight:
    """Return the positions of texels in a capture, their angles, and whether they are seen and lit.

    Parameters
    ----------
    position, normal : (n, 3) float
        Positions in mm and unit normals of the texels, in the rig's frame.
    tracer : Tracer
        Object and table in the rig's frame; the object is shape 0.
    pose : Pose
    setup : RigSetup
    facet : (n, 3) float, optional
        Unit normals of the facets if they differ from the shading normals. A texel is seen or lit only from the front
        side of both.
    """
    texels = _Surface(position, normal, normal if facet is None else facet)
    return _sight(texels, Placement(tracer.placements[0].shape), tracer, pose, setup, angles=4, is_sheet=False)


class _Surface(NamedTuple):
    """Positions (n, 3), mm, unit normals and unit normals of the facets of n texels."""

    position: np.ndarray
    normal: np.ndarray
    facet: np.ndarray

    @classmethod
    def of(cls, texels: Texels) -> "_Surface":
        """Return the texels on the surface."""
        return cls(*(values[texels.covered] for values in (texels.position, texels.normal, texels.facet)))


def _sight(
    surface: _Surface, placed: Placement, tracer: Tracer, pose: Pose, setup: RigSetup, *, angles: int, is_sheet: bool
) -> Sight:
    """Return the `Sight` of texels in the frame of a placed shape, with its first two angles or all four."""
    count, near, pinhole = len(surface.position), setup.lamp.is_near, setup.pinhole
    position, normal, facet, rotation, translation_mm = (
        np.ascontiguousarray(one, dtype=np.float64) for one in (*surface, placed.rotation, placed.translation_mm)
    )
    around = _Around(
        to_light(pose) * (setup.lamp.distance_mm if near else 1.0),
        float(near),
        float(setup.lamp.distance_mm),
        setup.camera_distance_mm * to_camera(pose),
        np.ascontiguousarray(rig_from_camera(pose, pinhole.quarter_turns), dtype=np.float64),
        np.array(pinhole.distortion, dtype=np.float64),
        float(pinhole.fold),
        float(pinhole.focal_px),
        (float(pinhole.centre_px[0]), float(pinhole.centre_px[1])),
        float(tracer.placements[0].shape.ray_offset_mm),
        is_sheet,
    )
    visible, lit, behind = np.empty((3, count), dtype=np.bool_)
    looked = _Looked(np.empty((count, angles)), np.empty((count, 2)), visible, lit, np.empty(count), behind)
    seen = _Seen(position, normal, facet, rotation, translation_mm, float(placed.scale))
    run_chunks(_look, count, _CHUNK, seen, around, (tracer.occluded_address, tracer.scene), looked)
    return Sight(looked.xy, looked.geometry, visible, lit, looked.power, behind)


@njit(cache=True, nogil=True)
def _bounds(xy, chosen):
    """Return the least and largest finite coordinates of chosen points, (2, 2); without points, inf and 0."""
    out = np.array([[np.inf, np.inf], [0.0, 0.0]])
    for t in range(xy.shape[0]):
        if chosen[t] and math.isfinite(xy[t, 0]) and math.isfinite(xy[t, 1]):
            for axis in range(2):
                out[0, axis], out[1, axis] = min(out[0, axis], xy[t, axis]), max(out[1, axis], xy[t, axis])
    return out


def _window(xy: np.ndarray, chosen: np.ndarray, margin: float, height: int, width: int) -> tuple[slice, slice]:
    """Return slices of rows and columns with the 4 x 4 samples around all chosen finite points; empty without points.

    The bands of a sample lie up to ``margin`` samples beside its centre.
    """
    least, largest = _bounds(xy, chosen)
    first, last = np.floor(least - margin) - 1.0, np.floor(largest + margin) + 3.0
    (x0, y0), (x1, y1) = np.clip([first, last], 0, [width, height]).astype(int)
    return slice(y0, max(y0, y1)), slice(x0, max(x0, x1))


def sample_picture(file: store.Reader, xy, within=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return interpolated responses of a capture, (n, bands) float32, which of them are good, and which clip, (n,).

    Red and blue of a superpixel are measured beside its centre, and each band is interpolated between its own places.
    Otherwise every border of two paints would have coloured fringes.

    Parameters
    ----------
    file : store.Reader
        Linear responses of the capture.
    xy : (n, 2) float
        Samples of the picture, x then y.
    within : (n,) bool, optional
        Those of them that matter, all by default: only the window of the picture that holds them is read.
    """
    file.require_axes({"response": "row,column,band", "valid": "row,column", "clipped": "row,column"})
    height, width, bands = file.dataset("response").shape
    pattern = file.attribute("mosaic")
    places = bayer_offsets_px(pattern) if pattern else np.zeros((1, 2))
    xy = np.ascontiguousarray(xy, dtype=np.float64)
    chosen = np.ones(len(xy), dtype=bool) if within is None else within
    window = _window(xy, chosen, np.abs(places).max(), height, width)
    sampled = np.zeros((len(xy), bands), dtype=np.float32)
    good, clips = np.empty(len(xy), dtype=np.bool_), np.empty(len(xy), dtype=np.uint8)
    corner = np.array([window[0].start, window[1].start])
    response, valid, clipped = (file.read(name, window) for name in ("response", "valid", "clipped"))
    seen = _Window(response, valid, clipped, corner, places)
    run_chunks(_sample, len(xy), _CHUNK, seen, xy, sampled, (good, clips))
    return sampled, good, clips


class Observations(NamedTuple):
    """Observations of n texels in J captures, (n, J, ...), or in one, (n, ...), as `rectify_object` describes them."""

    response: np.ndarray
    geometry: np.ndarray
    weight: np.ndarray
    shadowed: np.ndarray
    clipped: np.ndarray
    gain: np.ndarray
    passed: np.ndarray


def observe_captures(
    linear: Iterable,
    shape: Shape,
    texels: Texels,
    setup: RigSetup,
    max_angle_deg: float,
    *,
    is_sheet: bool = False,
    stored: bool = False,
) -> Observations:
    """Return the observations of texels in files of linear responses; arguments as in `rectify_object`.

    ``stored`` is for what is written to a file: responses are float16, and what is not written is empty, such as the
    geometry, which takes as much memory as four bands.

    Raises
    ------
    InputError
        If a response is too large for float16.
    """
    limit, paths = np.radians(max_angle_deg), list(linear)
    covered = slice(None) if texels.covered.all() else np.flatnonzero(texels.covered)
    surface, several = _Surface.of(texels), None
    for number, path in enumerate(paths):
        found = _observe_file(path, shape, surface, setup, angles=2 if stored else 4, is_sheet=is_sheet)
        incidence, reflection = found.geometry[:, 0], found.geometry[:, 1]
        frontal = (incidence <= limit) & (reflection <= limit)
        behind = (np.pi - incidence <= limit) & (reflection <= limit)
        found = found._replace(weight=found.weight & frontal, passed=found.passed & behind)
        if stored:
            kept = {"geometry": False, "gain": setup.lamp.is_near, "passed": is_sheet}
            nothing = np.empty((len(frontal), 0))
            found = found._replace(**{name: nothing for name, is_kept in kept.items() if not is_kept})
        if several is None:
            several = _nothing_seen(texels.covered.size, len(paths), found, np.float16 if stored else np.float32)
        if stored:
            if (found.response > _LARGEST).any():
                largest, accepted = (
                    f"{found.response.max():.6g} times a perfect diffuser",
                    f"at most {_LARGEST:g} times",
                )
                raise InputError(path, "response", largest, accepted)
            found = found._replace(response=half_from_single(found.response))
        # The bands of an observation are copied as one item: one by one they take ten times as long.
        item = np.dtype((np.void, found.response.shape[1] * found.response.itemsize))
        several.response.view(item)[covered, number] = found.response.view(item)
        for whole, values in zip(several[1:], found[1:], strict=True):
            whole[covered, number] = values
    assert several is not None  # there is a capture
    return several


def _nothing_seen(texels: int, captures: int, like: Observations, precision: type) -> Observations:
    """Return observations of texels in captures that are all 0, with the axes of those of one capture."""
    marks = dict.fromkeys(("weight", "clipped", "passed"), np.uint8)
    kinds = {"response": precision, "shadowed": np.bool_, **marks}
    return Observations(
        *(
            np.zeros((texels, captures, *values.shape[1:]), kinds.get(name, np.float32))
            for name, values in zip(like._fields, like, strict=True)
        )
    )


def angles_in_captures(linear: Iterable, shape: Shape, texels: Texels, setup: RigSetup) -> np.ndarray:
    """Return θ_i, θ_r, θ_H and φ of texels in captures, (n, J, 4) rad, whether they are seen or not."""
    captures = []
    for path in linear:
        with store.open_file(path) as file:
            typed = Pose.of_file(file)
        there = setup.of(typed)
        pose = there.correction.pose(typed)
        lain = there.correction.placements(shape, pose, there.table_radius_mm)[0]
        position = lain.points(texels.position[texels.covered])
        normal = texels.normal[texels.covered] @ lain.rotation.T
        light, _, _ = there.lamp.seen_from(position, pose)
        view = there.camera_distance_mm * to_camera(pose) - position
        view /= np.linalg.norm(view, axis=1)[:, None]
        captures.append(_spread(angles_from_directions(normal, light, view), texels.covered))
    return np.stack(captures, axis=1)


def _observe_file(
    path, shape: Shape, surface: _Surface, setup: RigSetup, *, angles: int, is_sheet: bool
) -> Observations:
    """Return the observations of texels in the capture of one file of linear responses; ``angles`` as in `_sight`."""
    with store.open_file(path) as file:
        typed = Pose.of_file(file)
        setup = setup.of(typed)
        pose = setup.correction.pose(typed)
        placements = setup.correction.placements(shape, pose, setup.table_radius_mm)
        sight = _sight(surface, placements[0], Tracer(placements), pose, setup, angles=angles, is_sheet=is_sheet)
        visible = sight.visible
        xy = samples_from_superpixels(sight.xy, file.attribute("sample_px"))
        sampled, good, clips = sample_picture(file, xy, visible)
    # A hidden texel's samples show another surface, and whether they were read depends on the window of the tile.
    sampled[~visible], clips[~visible] = 0.0, 0
    gain = np.ones(len(xy))
    if setup.lamp.is_near:
        gain[good] = setup.light_gain(sight.xy[good], sight.power[good])
        sampled *= gain[:, None].astype(np.float32)
    shadowed = visible & ~sight.lit & (sight.geometry[:, 0] < np.pi / 2)
    passed = visible & sight.lit_behind & good
    return Observations(sampled, sight.geometry, visible & sight.lit & good, shadowed, clips, gain, passed)


def _spread(values: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return an array of all texels with the given values at the covered ones and zeros elsewhere."""
    out = np.zeros((covered.size, *values.shape[1:]), dtype=values.dtype)
    out[covered.ravel()] = values
    return out


def _surroundings(linear: list, shape: Shape, texels: Texels, setup: RigSetup) -> Surroundings:
    """Return what determines the angles of texels in captures, in the frame of the object."""
    light, camera = np.empty((2, len(linear), 3))
    for number, path in enumerate(linear):
        with store.open_file(path) as file:
            typed = Pose.of_file(file)
        there = setup.of(typed)
        pose = there.correction.pose(typed)
        lain = there.correction.placements(shape, pose, there.table_radius_mm)[0]
        near = there.lamp.is_near
        source = to_light(pose) * (there.lamp.distance_mm if near else 1.0)
        light[number] = (source - lain.translation_mm if near else source) @ lain.rotation
        camera[number] = (there.camera_distance_mm * to_camera(pose) - lain.translation_mm) @ lain.rotation
    seen = texels.covered[..., None]
    position, normal = (np.where(seen, values, 0.0).reshape(-1, 3) for values in (texels.position, texels.normal))
    return Surroundings(position, normal, light, camera, setup.lamp.is_near)


def noise_models(linear: list) -> np.ndarray:
    """Return c0 and c1 of the variance c0 + c1 ρ of an interpolated response, (J, bands, 2); NaN where not known."""
    models = []
    for path in linear:
        with store.open_file(path) as file:
            models.append(KEYS_NOISE_SHARE * file.read("noise_model"))
    return np.stack(models)


def _poses_and_filters(linear: list) -> tuple[list[Pose], list[str]]:
    """Return the pose of every capture and the filter states that all captures have in common.

    Raises
    ------
    InputError
        If the filter states of captures differ, because then their bands differ too.
    """
    first: list[str] | None = None
    poses = []
    for path in linear:
        with store.open_file(path) as file:
            filters = file.attribute("filters")
            poses.append(Pose.of_file(file))
        if first is not None and first != filters:
            raise InputError(path, "filters", ", ".join(filters), f"{', '.join(first)}, as in the other captures")
        first = filters
    assert first is not None  # there is a capture
    return poses, first


def _maps(observed: Observations, texels: Texels, near: bool, is_sheet: bool) -> dict:
    """Return the datasets that `rectify_object` writes for each texel: name -> (values, units, quantity)."""
    shadowed, covered = observed.shadowed.view(np.uint8), texels.covered.ravel().astype(np.uint8)
    maps = {
        "response": (observed.response, "1", "response, 1 = perfect diffuser at normal incidence"),
        "weight": (observed.weight, "1", "weight in the fit"),
        "shadowed": (shadowed, store.Mask, "whether another surface keeps the light away"),
        "clipped": (observed.clipped, store.Mask, "whether the picture clips in every exposure"),
        "texel": (covered, store.Mask, "whether a surface lies under the texel's centre"),
    }
    if is_sheet:
        what = "whether the texel is seen and measured with the light behind it"
        maps["passed"] = (observed.passed, store.Mask, what)
    if near:
        quantity = "irradiance of the white reference in the pixel over that of the texel"
        maps["light_gain"] = (observed.gain.astype(np.float32), "1", quantity)
    return maps


def rectify_object(
    linear: list,
    definition: "Object | TexturedObject",
    setup: RigSetup,
    rows: tuple[int, int],
    max_angle_deg: float,
    *,
    output,
    provenance: store.Provenance,
    angle_error_deg=None,
) -> None:
    """Write the observations of one tile of an object's texture.

    Parameters
    ----------
    linear : list of path
        Files of linear responses of the J captures; only the window that the tile covers is read.
    definition : Object or TexturedObject
    setup : RigSetup
        For all placements of the object, see `RigSetup.registered`.
    rows : (int, int)
        First and last-plus-one texture row of the tile.
    max_angle_deg : float, degrees
        Observations with θ_i or θ_r beyond it are kept without weight.
    angle_error_deg : (4,) float, optional
        Standard deviations of θ_i, θ_r, θ_H and φ by registration, degrees; they are passed on.

    Raises
    ------
    InputError
        If captures differ in their filter states, their bands do not fit the filter states, the shape is a mesh that is
        refused, a response is beyond the range of float16, or a near lamp stands within the reach of the object.

    Notes
    -----
    Datasets: ``/response`` (texel, J, bands) float16, rounded by at most 0.05 %; what determines the angles, which
    `irodori.material.observed_angles.read_angles` computes, in the frame of the object: ``/position`` (texel, 3) mm,
    ``/normal`` (texel, 3), ``/light`` (J, 3) and ``/camera`` (J, 3) mm;
    ``/weight`` (texel, J) uint8, 1 where the texel is seen, lit and validly measured, else 0; ``/shadowed`` (texel,
    J) uint8, 1 where the texel faces the light but another surface blocks it; ``/clipped`` (texel, J) uint8, 1 where
    the texel is seen and a sample under it clips in every exposure, which distinguishes a highlight from a hot pixel or
    the edge of the picture; ``/texel`` (texel,) uint8, 0 outside the UV charts of a mesh: such an entry is zero in all
    datasets and is not fitted; ``/noise_model`` (J, bands, 2), variance of a response = c0 + c1 * response, NaN where
    the camera's noise was not measured.

    For a thin sheet, ``/passed`` (texel, J) uint8 is 1 where the texel is seen and validly measured, and the light
    reaches its other side.

    Under a near light, ``/light_gain`` (texel, J) float32 is the factor by which a response was multiplied: irradiance
    of the white reference over irradiance of the texel. The variance of a response is then
    gain² c0 + gain c1 * response. If the object was registered, ``/angle_error`` (4,) are the standard deviations of
    the four angles, degrees.
    """
    shape = Shape.from_definition(definition.shape)
    width = definition.texels.width
    if setup.lamp.distance_mm <= shape.reach_mm:
        found = f"{setup.lamp.distance_mm:g} mm, within the reach of the object, {shape.reach_mm:.4g} mm"
        raise InputError("rig", "light.distance_mm", found, "a lamp outside the object, or no such key for a far one")
    poses, filters = _poses_and_filters(linear)
    is_sheet, near = definition.sheet is not None, setup.lamp.is_near
    with store.create(output, provenance) as out:
        out.coordinate("capture", [Path(path).stem for path in linear], units="1", quantity="name of the capture")
        for name in _ANGLES_OF_POSE:
            values = np.array([getattr(pose, name) for pose in poses])
            out.write(name, values, units="deg", dims="capture", quantity="angle of the rig, as typed")
        number = np.array([pose.placement for pose in poses])
        out.write("placement", number, units="1", dims="capture", quantity="number of the object's placement")
        out.coordinate("angle", list(ANGLES), units="1", quantity="symbol of an angle")
        if angle_error_deg is not None:
            write_registered(out, angle_error_deg)
        write_bands(out, filters)
        out.coordinate("term", ["c0", "c1"], units="1", quantity="coefficient of the variance")
        datasets: dict = {}
        around, unseen, covered = [], 0, 0
        for strip in strips(rows, width, len(linear)):
            texels = shape.atlas(width, definition.texels.height, strip)
            tracked = track(linear, f"rectify rows {strip[0]}-{strip[1]}")
            observed = observe_captures(tracked, shape, texels, setup, max_angle_deg, is_sheet=is_sheet, stored=True)
            require_bands(filters, observed.response.shape[2], linear[0])
            covered += int(texels.covered.sum())
            unseen += int((~(observed.weight > 0).any(axis=1) & texels.covered.ravel()).sum())
            for name, (values, units, quantity) in _maps(observed, texels, near, is_sheet).items():
                if name not in datasets:
                    size = ((rows[1] - rows[0]) * width, *values.shape[1:])
                    dims = ",".join(["texel_number", "capture", "band"][: values.ndim])
                    packing = "fast" if name == "response" else "small"
                    datasets[name] = out.reserve(
                        name, size, values.dtype, units=units, dims=dims, quantity=quantity, compression=packing
                    )
                datasets[name][texels_of(strip, rows, width)] = values
            around.append(_surroundings(linear, shape, texels, setup))
        position, normal = (np.concatenate([getattr(one, name) for one in around]) for name in ("position", "normal"))
        write_surroundings(out, around[0]._replace(position=position, normal=normal))
        if unseen:
            LOGGER.info("%d of %d texels have no observation", unseen, covered)
        noise = noise_models(linear)
        out.write("noise_model", noise, units="1", dims="capture,band,term", quantity="variance c0 + c1 rho")
        out.attribute("rows", list(rows))
        out.attribute("width", width)
        out.attribute("filters", filters)
