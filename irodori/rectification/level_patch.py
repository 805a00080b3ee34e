"""Level of the lamp in every photograph, from a matt patch that stands in the frame.

The mean response of the patch, divided by cosθ_i and corrected for a near lamp, is the lamp's level times the
reflectance factor of the patch. This factor departs from Lambert's law by a ratio that varies slowly with the
directions of lamp and camera. Levels of photographs with the same directions therefore compare as accurately as the
mean responses; those of others only as accurately as Lambert's law holds. The levels are the conditional expectation,
given the responses, of normal variables with these covariances. The surface of the patch is assumed to be isotropic.
"""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.capture_table import Pose
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import track
from irodori.geometry.embree import Tracer
from irodori.geometry.pinhole import samples_from_superpixels
from irodori.geometry.rig_frame import rig_from_object
from irodori.geometry.shapes.shape import Shape
from irodori.material.photograph_levels import BANDS_OF_STATE, KNOWN_PATCH, PATCH, PhotographLevels
from irodori.rectification.stage import RigSetup, Sight, observe, sample_picture

if TYPE_CHECKING:
    from irodori.config.models import LevelPatch, ObjectShape

_GREEN = 1
_POINTS = 24  # along a side of the square
_LARGEST_ANGLE_DEG = 75.0
_ALIKE_RAD = 0.2  # by which directions differ where the departures from Lambert's law are little alike
_LEAST_SHARE = 0.9  # of the square's points that must be valid: hot pixels are not
_UNEVEN = 0.1  # largest relative spread over the square
_HUE = 0.1  # largest relative change of the ratio of two bands between photographs
_WRONG = 1.5  # ratio of the response to that of the median photograph, beyond which something hides the patch
_LEAST_VARIANCE = 1e-12
_MISTYPED = 1.25  # ratio of the patch's reflectance factor to the stated one, beyond which it is another patch
_UNKNOWN = 1e3  # standard deviation of a logarithm that is not known


class PatchReading(NamedTuple):
    """The patch in one photograph.

    ``response`` (bands,) mean response over cosθ_i; ``error`` (bands,) its relative standard error; ``angles`` (3,)
    θ_i, θ_r and the angle between the directions to lamp and camera, rad.
    """

    response: np.ndarray
    error: np.ndarray
    angles: np.ndarray


def _grid(patch: "LevelPatch") -> np.ndarray:
    """Return points of the patch, (points, 3) mm in its own frame."""
    offset = ((np.arange(_POINTS) + 0.5) / _POINTS - 0.5) * patch.side_mm
    x, y = np.meshgrid(offset, offset)
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3) + np.asarray(patch.centre_mm)


def read_patch(path, shape: Shape, setup: RigSetup, patch: "LevelPatch") -> PatchReading:
    """Measure the patch in one capture.

    Parameters
    ----------
    path : path
        Linear responses of the capture.
    shape : Shape
        The object, which must not hide the patch or keep the lamp from it.
    setup : RigSetup
    patch : LevelPatch

    Raises
    ------
    InputError
        If the patch is not wholly in the frame, is lit or seen at more than 75 degrees, lies behind the object or in
        its shadow, clips, or is not even.
    """
    with store.open_file(path) as file:
        typed = Pose.of_file(file)
        setup = setup.of(typed)
        pose = setup.correction.pose(typed)
        rotation = rig_from_object(pose) if patch.moves_with_table else np.eye(3)
        position = _grid(patch) @ rotation.T
        normal = np.broadcast_to(rotation[:, 2], position.shape)
        tracer = Tracer(setup.correction.placements(shape, pose, 0.0))
        sight = observe(position, normal, tracer, pose, setup)
        file.require_axes({"response": "row,column,band", "valid": "row,column", "clipped": "row,column"})
        xy = samples_from_superpixels(sight.xy, file.attribute("sample_px"))
        height, width, _ = file.dataset("response").shape
        inside = (xy >= 0.0).all(axis=1) & (xy <= np.array([width - 1.0, height - 1.0])).all(axis=1)
        _check_sight(path, sight, inside)
        response, good, clipped = sample_picture(file, xy)
    if clipped.any():
        raise _refused(path, "clips in every exposure", "a shorter exposure, or a darker patch")
    if good.mean() < _LEAST_SHARE:
        raise _refused(path, f"is measured on {good.mean():.0%} of the square", "nine tenths of it or more")
    gain = setup.light_gain(sight.xy, sight.power)
    values = response[good] * gain[good, None] / np.cos(sight.geometry[good, :1])
    middle = np.median(values, axis=0)
    if not (middle > 0.0).all():
        raise _refused(path, "is black", "a white or grey patch at that place")
    spread = np.percentile(values, [16.0, 84.0], axis=0)
    uneven = float(((spread[1] - spread[0]) / (2.0 * middle))[_GREEN::BANDS_OF_STATE].max())
    if uneven > _UNEVEN:
        raise _refused(path, f"varies by {uneven:.0%} over the square", "an even patch at that place")
    mean = values.mean(axis=0)
    samples = len(np.unique(np.rint(xy[good]), axis=0))  # points within one sample tell the same
    error = values.std(axis=0) / mean / np.sqrt(samples)
    return PatchReading(mean, error, sight.geometry[:, :3].mean(axis=0) * [1.0, 1.0, 2.0])


def _check_sight(path, sight: Sight, inside: np.ndarray) -> None:
    """Raise an error if a photograph cannot show the patch."""
    largest = np.degrees(sight.geometry[:, :2].max(axis=0))
    for angle, doing in zip(largest, ("lit", "seen"), strict=True):
        if angle > _LARGEST_ANGLE_DEG:
            found = f"is {doing} at {angle:.0f} degrees from its normal"
            raise _refused(path, found, f"up to {_LARGEST_ANGLE_DEG:g} degrees in every photograph")
    if not inside.all():
        raise _refused(path, "lies outside the frame", "a patch that is in the frame in every photograph")
    if not sight.visible.all():
        raise _refused(path, "is hidden by the object", "a patch that is seen in every photograph")
    if not sight.lit.all():
        raise _refused(path, "lies in the object's shadow", "a patch that is lit in every photograph")


def _refused(path, found: str, accepted: str) -> InputError:
    return InputError(path, "level_patch", f"a patch that {found}", accepted)


def measure_patch(
    linear: list,
    definition: "ObjectShape",
    setup: RigSetup,
    patch: "LevelPatch",
    model_error: float,
    level_error: float,
    *,
    output,
    provenance: store.Provenance,
) -> None:
    """Measure the lamp's level in every photograph from a patch, and write it.

    Parameters
    ----------
    linear : list of path
        Linear responses of all captures of the object.
    definition : ObjectShape
    setup : RigSetup
    patch : LevelPatch
    model_error, level_error : float
        Those of the fit: standard deviation of the lamp's level among photographs, and of its change since the white
        reference, before they are measured. If the patch shows larger ones, those count.

    Raises
    ------
    InputError
        As in `read_patch`; if the patch in one photograph has another hue than in the others, or is far darker or
        brighter; or if its reflectance factor is far from the stated one.

    Notes
    -----
    The file is that of `irodori.material.photograph_levels`.
    """
    shape, readings, filters, captures = Shape.from_definition(definition), [], [], []
    for path in track(linear, "patch"):
        readings.append(read_patch(path, shape, setup, patch))
        with store.open_file(path) as file:
            filters = file.attribute("filters", list)
        captures.append(Path(path).stem)
    _check_readings(linear, np.stack([one.response for one in readings]), patch)
    levels = levels_by_patch(readings, patch, model_error, level_error)
    levels.say()
    levels.write(output, captures, filters, provenance)


def _check_readings(linear: list, response: np.ndarray, patch: "LevelPatch") -> None:
    """Raise an error if photographs show something other than the patch, or a patch of another reflectance."""
    factor, stated = float(np.median(response[:, _GREEN])), patch.reflectance_factor
    if stated is not None and not 1.0 / _MISTYPED < factor / stated < _MISTYPED:
        found = f"has a reflectance factor of {factor:.2f} by the white reference"
        raise _refused(linear[0], found, f"the stated {stated:g}, within a quarter")
    relative = response / np.median(response, axis=0)
    for path, one in zip(linear, relative, strict=True):
        hue = one[:BANDS_OF_STATE].max() / one[:BANDS_OF_STATE].min() - 1.0
        if not 1.0 / _WRONG < one[_GREEN] < _WRONG:
            found = f"reflects {one[_GREEN]:.2f} times what it does in the median photograph"
            raise _refused(path, found, "the same patch in every photograph, with nothing before it")
        if hue > _HUE:
            raise _refused(path, f"changes its hue by {hue:.0%}", "the same patch in every photograph")


def levels_by_patch(
    readings: list[PatchReading], patch: "LevelPatch", model_error: float, level_error: float
) -> PhotographLevels:
    """Estimate the lamp's levels from readings of a patch; parameters as in `measure_patch`."""
    response = np.stack([one.response for one in readings])[:, _GREEN::BANDS_OF_STATE]
    error = np.stack([one.error for one in readings])[:, _GREEN::BANDS_OF_STATE]
    angles, count = np.stack([one.angles for one in readings]), len(readings)
    apart = np.linalg.norm(angles[:, None] - angles[None], axis=2) / _ALIKE_RAD
    departure = patch.departure**2 * np.exp(-0.5 * apart**2)
    known = patch.reflectance_factor is not None
    if patch.reflectance_factor is not None:
        scale, of_reflectance = np.full(response.shape[1], patch.reflectance_factor), patch.reflectance_error
    else:
        scale, of_reflectance = np.exp(np.log(response).mean(axis=0)), _UNKNOWN
    centred = np.eye(count) - 1.0 / count
    level, own = np.empty_like(response), np.empty_like(response)
    common = level_error
    for state in range(response.shape[1]):
        measured = np.log(response[:, state] / scale[state])
        # A lamp that varies by more than is stated, or has changed by more since the white reference, is believed to.
        drift = max(model_error**2, float(measured.var() - patch.departure**2))
        change = max(level_error**2, float(measured.mean() ** 2 - of_reflectance**2))
        prior = drift * np.eye(count) + change
        noise = departure + of_reflectance**2 + np.diag(error[:, state] ** 2 + _LEAST_VARIANCE)
        weight = np.linalg.solve(prior + noise, prior).T
        level[:, state] = np.exp(weight @ measured)
        left = prior - weight @ prior
        own[:, state] = np.sqrt(np.maximum(np.diag(centred @ left @ centred.T), 0.0))
        if known and state == 0:
            common = float(np.sqrt(left.mean()))
    if not known:
        level /= level.mean(axis=0)
    return PhotographLevels(level, own, common, KNOWN_PATCH if known else PATCH)
