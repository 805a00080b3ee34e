"""Refusal of photographs that contradict what was typed, with the mistake that explains them best.

Registration corrects small errors. A larger one leaves photographs that disagree, a correction that nobody would
believe, or an outline that stands clearly at another place than the one that was found.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.rectification.coarse_look import (
    CLEARER,
    LEAST,
    Look,
    expected_contrast,
    look_elsewhere,
    look_for_other_poses,
)
from irodori.rectification.placement_correction import CAMERA, PRIOR_KEYS, QUANTITIES
from irodori.rectification.told_values import CONTRADICTED

if TYPE_CHECKING:
    from irodori.config.models import Placing
    from irodori.rectification.registration_problem import Problem, Registered

#: Standard deviation of the error of all camera angles, degrees, with which it is asked whether it explains a fault.
FREE_CAMERA_DEG = 5.0
#: Residual, superpixels, from which other rolls of the camera are tried: sound photographs leave a few hundredths. And
#: what another roll has to leave of it.
_UNEASY_PX, _BETTER = 0.2, 0.5
_OUTLINED = 0.5  # share of photographs with an outline from which a clearer one may be that of paper around the object
#: Numbers of a correction that a wrong size of the object changes: distance of the camera and focal length.
_OF_SIZE = (6, 7)


class Otherwise(NamedTuple):
    """Registrations of the same photographs with other definitions.

    Parameters
    ----------
    with_free_camera : function
        Registers with the standard deviation `FREE_CAMERA_DEG` of the error that all camera angles share.
    with_roll : function
        Registers with another ``optics.roll_deg``.
    """

    with_free_camera: "Callable[[], tuple[Registered, Problem]]"
    with_roll: "Callable[[int], tuple[Registered, Problem]]"


def refuse_contradictions(
    found: "Registered",
    problem: "Problem",
    linear: Sequence,
    placing: "Placing",
    otherwise: Otherwise,
) -> None:
    """Raise an error if photographs contradict what was typed; the message names what explains them best.

    Parameters
    ----------
    found : Registered
    problem : Problem
        At the end of the registration. Its unknowns are changed.
    linear : sequence of path
    placing : Placing
    otherwise : Otherwise

    Raises
    ------
    InputError
        If the object in a photograph is further than ``max_residual_px`` from its expected place, or if a correction of
        the object or the lens exceeds four standard deviations of the definitions; if a flat object is shown in the
        pose of another photograph; if another roll of the camera explains the photographs far better; and if the
        object's outline is far larger, smaller or elsewhere.
    """
    fault = fault_of(found, linear, placing)
    expected, poses = expected_contrast(problem, linear), [look_for_other_poses(problem)]
    # If something is wrong, what was found may be anywhere: what is said of place and size refers to what was typed.
    problem.unknowns = np.zeros(len(problem.unknowns))
    clearest = look_elsewhere(problem, linear)
    if fault is not None:
        poses.append(look_for_other_poses(problem))
    exchanged = max(poses, key=lambda one: one.contrast)
    if fault is not None:
        freed, at_freed = otherwise.with_free_camera()
        offset, at_scale = freed.correction.values[CAMERA], expected_contrast(at_freed, linear)
        is_sound = abs(offset) > CONTRADICTED * placing.camera_deg and fault_of(freed, linear, placing) is None
        # Other poses of the set may be nearly those that an error of the scale makes of its own.
        if is_sound and CLEARER * at_scale > max(clearest.contrast, exchanged.contrast):
            raise _of_scale(fault, offset, linear)
    left, is_wrong = _residual_px(found), fault is not None or clearest.is_elsewhere or bool(exchanged.pairs)
    if is_wrong or left > _UNEASY_PX:
        # Of a small flat object, a camera upside down shows nothing that is far from its place.
        rolls_deg = [
            (90 * (problem.setup.pinhole.quarter_turns + more)) % 360 for more in ((2, 1, 3) if is_wrong else (2,))
        ]
        roll_deg, residual, contrast = _best_roll(rolls_deg, otherwise, linear, placing)
        if residual < _BETTER * left and contrast >= max(clearest.contrast, exchanged.contrast):
            raise _of_roll(roll_deg, linear)
    expected = max(expected, clearest.expected)
    is_elsewhere = clearest.is_elsewhere and clearest.contrast > max(LEAST, CLEARER * expected)
    if exchanged.pairs and not (is_elsewhere and clearest.contrast > exchanged.contrast):
        raise _of_exchanged(exchanged.pairs, linear)
    # The corners of a sheet tell size and place better, and its border is more conspicuous than the object.
    if is_elsewhere and problem.sheet is None:
        _refuse_elsewhere(clearest, linear, is_found=fault is None and is_outlined(found))
    if fault is not None:
        raise fault


def is_outlined(found: "Registered") -> bool:
    """Return whether most photographs show an outline where it is expected."""
    return bool(np.mean(found.outline_points > 0) >= _OUTLINED)


def fault_of(found: "Registered", linear: Sequence, placing: "Placing") -> InputError | None:
    """Return the error about the photograph or the correction that is furthest off; None if all are as they may be."""
    return _too_far(found, linear, placing.max_residual_px) or _too_unlikely(found, linear)


def _of_scale(fault: InputError, offset_deg: float, linear: Sequence) -> InputError:
    said = f"{fault.found}; all photographs agree if every camera angle is {offset_deg:+.1f} deg from what was typed"
    accepted = "angles as they were: is the zero of the camera's scale right, or that of the table's tilt?"
    return InputError(linear[0], "camera_deg", said, accepted)


def _best_roll(
    rolls_deg: Sequence[int], otherwise: Otherwise, linear: Sequence, placing: "Placing"
) -> tuple[int, float, float]:
    """Return the camera's roll, deg, with the least residual, that residual, and the outline's contrast.

    The residual is infinite if photographs contradict what was typed at each of them.
    """
    best = (0, np.inf, 0.0)
    for roll_deg in rolls_deg:
        try:
            found, problem = otherwise.with_roll(roll_deg)
        except InputError:
            continue
        residual = _residual_px(found)
        if residual < best[1] and fault_of(found, linear, placing) is None and is_outlined(found):
            best = (roll_deg, residual, expected_contrast(problem, linear))
        if best[1] < _UNEASY_PX:
            break
    return best


def _residual_px(found: "Registered") -> float:
    """Return the root mean square of the residuals, superpixels; infinite if no photograph shows the object."""
    known = found.residual_px[np.isfinite(found.residual_px)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.inf


def _of_roll(roll_deg: int, linear: Sequence) -> InputError:
    said = f"photographs that agree if the camera is mounted turned by {roll_deg} deg, and not as it is stated"
    return InputError(linear[0], "optics.roll_deg", said, f"a camera mounted as stated, or {roll_deg}")


def _of_exchanged(pairs: Sequence[tuple[int, int]], linear: Sequence) -> InputError:
    (photograph, pose_of), *others = pairs
    more = f"; {len(others)} more show that of another, too" if others else ""
    said = f"the object in the pose of {Path(linear[pose_of]).stem}, and not in its own{more}"
    return InputError(linear[photograph], "pose_deg", said, "each photograph in its own line of the table")


def _refuse_elsewhere(clearest: Look, linear: Sequence, *, is_found: bool) -> None:
    """Raise an error for an outline elsewhere; log one of another size if an outline is found where it was expected."""
    if clearest.shift_mm:
        said = f"the object about {clearest.shift_mm:.0f} mm beside its stated place"
        accepted = "an object where it is said to lie, or a larger value"
        raise InputError(linear[0], "place.translation_mm", said, accepted)
    said = f"an object that looks {clearest.multiple:.2g} times as large as size, distance and focal length say"
    if is_found:
        LOGGER.warning("%s: perhaps %s; or something around the object is more conspicuous", linear[0], said)
        return
    lengths = "a size in mm, camera_distance_mm and optics.focal_length_mm as they were"
    accepted = f"{lengths}; or place.register: false, if something around the object is what looks so"
    raise InputError(linear[0], "shape", said, accepted)


def _too_far(found: "Registered", linear: Sequence, most_px: float) -> InputError | None:
    """Return an error that names the photograph with the largest residual if that exceeds ``most_px`` superpixels."""
    if np.isnan(found.least_residual_px).all():
        return None
    worst = int(np.nanargmax(found.least_residual_px))
    residual = found.least_residual_px[worst]
    if residual <= most_px:
        return None
    angle, off = found.suspects[worst]
    apart = f"{residual:.2g} superpixels ({residual * found.mm_per_px:.2g} mm)"
    is_sheet = found.sheet is not None and found.sheet.residual_px[worst] >= residual
    thing = "the printed sheet" if is_sheet else "the object"
    where = f"{thing} {apart} from its expected place; most likely {angle} is off by {off:+.1f}"
    accepted = f"at most {most_px:g} superpixels (place.max_residual_px), and a pose as it was"
    return InputError(linear[worst], "pose_deg", where, accepted)


def _too_unlikely(found: "Registered", linear: Sequence) -> InputError | None:
    """Return an error if object or lens are far from what the definitions say: a search can end there wrongly."""
    values, prior = found.estimate.values, found.estimate.prior
    ratio = np.abs(values)[:CAMERA] / np.maximum(prior[:CAMERA], np.finfo(float).tiny)
    worst = int(np.argmax(ratio))
    if ratio[worst] <= CONTRADICTED:
        return None
    quantity, key = QUANTITIES[worst], f"place.{PRIOR_KEYS[worst]}"
    value = f"{quantity.text} {values[worst]:+.3g} {quantity.unit}"
    measured = "measure again, the object's size, too" if worst in _OF_SIZE else "measure again"
    accepted = f"at most {CONTRADICTED:g} times {key} ({prior[worst]:g}); {measured}, or give a larger one"
    return InputError(linear[0], key, f"{value} from the definitions", accepted)
