"""Lists of the photographs that a definition requires.

A file's name depends on what the photograph shows and not on when it was taken, so that an interrupted session can
determine what is missing.
"""

from collections.abc import Container, Sequence
from dataclasses import replace

from irodori.capture.setup_steps import hand_settings
from irodori.config.capture_table import DRIFT, Pose, Shot, expand_poses
from irodori.config.models import Camera, EnvironmentDefinition, Exposures, Object, ScenePhotograph
from irodori.config.parts import AnyCamera, PhotographedObject

#: Pose of photographs that have none: the lens cap is on, or the camera is not on the rig.
_NOWHERE = Pose(0.0, 0.0)
#: Default number of photographs of the white reference at each exposure time.
_WHITE_FRAMES = 2


def _settings(camera: AnyCamera) -> tuple[float, float]:
    """Return the camera's ISO sensitivity and f-number; 0 if unknown."""
    block = camera.driver or camera.virtual
    known = (getattr(block, key, None) for key in ("iso", "f_number"))
    # The camera does not know the aperture of a lens with an aperture ring.
    iso, f_number = (float(value) if isinstance(value, int | float) else 0.0 for value in known)
    return iso, f_number


def _times(exposure_s: Exposures | None) -> dict[str, tuple[float, ...]]:
    """Return the exposure times of each filter state, s.

    Raises
    ------
    ValueError
        If there are none.
    """
    if exposure_s is None:
        raise ValueError("a definition without exposure_s; accepted: one whose photographs the workflow takes")
    return exposure_s.given()


def _file(subject: str, state: str, exposure_s: float, suffix: str, frame: int | None = None) -> str:
    repeat = "" if frame is None else f"-{frame:02d}"
    return f"{subject}-{state}-{round(exposure_s * 1e6)}us{repeat}{suffix}"


def _bracket(
    role: str,
    pose: Pose,
    exposure_s: Exposures | None,
    settings: tuple[float, float],
    suffix: str,
    chart: str = "",
):
    for state, exposures in _times(exposure_s).items():
        for exposure in exposures:
            shot = Shot("", role, pose, state, exposure, *settings, chart)
            yield replace(shot, file=_file(shot.capture, state, exposure, suffix))


def object_shots(definition: Object | PhotographedObject, camera: AnyCamera, suffix: str) -> list[Shot]:
    """Return the photographs of an object: every pose, filter state and exposure time.

    Parameters
    ----------
    definition : Object or PhotographedObject
    camera : Camera or PhotographingCamera
    suffix : str
        Suffix of the files' names, with the dot.
    """
    settings = _settings(camera)
    return [
        shot
        for pose in expand_poses(definition.poses or ())
        for shot in _bracket("object", pose, definition.exposure_s, settings, suffix)
    ]


def shots_without_rig(
    definition: EnvironmentDefinition | ScenePhotograph, camera: AnyCamera, suffix: str
) -> list[Shot]:
    """Return the photographs of an environment and of the charts in it, or of a scene from one position.

    Parameters as in `object_shots`.
    """
    taken = definition.exposure_s, _settings(camera), suffix
    if isinstance(definition, ScenePhotograph):
        return list(_bracket("scene", _NOWHERE, *taken))
    charts = [shot for name in definition.room_charts for shot in _bracket("room-chart", _NOWHERE, *taken, name)]
    return [*_bracket("environment", _NOWHERE, *taken), *charts]


def camera_shots(camera: Camera, suffix: str) -> list[Shot]:
    """Return the photographs that calibrate a camera: dark frames, white references, the chart, further charts.

    Dark frames are taken at every exposure time of ``exposure_s``, the white reference ``white_frames`` times at each
    exposure time, and without the filter also at those of ``linearity_exposure_s``. By default there are no dark frames
    and two photographs of the white reference.
    """
    if camera.poses is None:
        raise ValueError("a camera without poses; accepted: one whose photographs the workflow takes")
    settings, exposure_s = _settings(camera), _times(camera.exposure_s)
    white_frames = _WHITE_FRAMES if camera.white_frames is None else camera.white_frames
    white = {state: list(exposures) for state, exposures in exposure_s.items()}
    white["out"] += [e for e in camera.linearity_exposure_s or () if e not in white["out"]]
    pose = {role: Pose(**vars(angles)) for role, angles in vars(camera.poses).items() if angles is not None}
    shots = []
    for exposure in sorted({e for group in exposure_s.values() for e in group}):
        for frame in range(camera.dark_frames or 0):
            file = _file("dark", "out", exposure, suffix, frame)
            shots.append(Shot(file, "dark", _NOWHERE, "out", exposure, *settings))
    for state, exposures in white.items():
        for exposure in exposures:
            for frame in range(white_frames):
                file = _file("white", state, exposure, suffix, frame)
                shots.append(Shot(file, "white", pose["white"], state, exposure, *settings))
    for chart in ("", *camera.further_charts):
        shots += _bracket("chart", pose["chart"], camera.exposure_s, settings, suffix, chart)
    return shots


def with_drift_frames(ordered: Sequence[Shot], every: int, motorised: Container[str]) -> list[Shot]:
    """Return a session's photographs with drift frames inserted, which need no change of settings by hand.

    A drift frame repeats an earlier photograph to measure the drift of the light: after `every` photographs of the
    object, and after the last, the first photograph with the present settings by hand is taken again, with its pose and
    exposure time.

    Parameters
    ----------
    ordered : sequence of Shot
        Photographs of an object, in the order in which they are taken.
    every : int
        Number of photographs between drift frames; 0 for no drift frames.
    motorised : container of str
        Angles that motors drive.
    """
    if every == 0:
        return list(ordered)
    first: dict[tuple, Shot] = {}
    planned, since, count = [], 0, 0
    for at, shot in enumerate(ordered):
        planned.append(shot)
        repeated = first.setdefault(tuple(sorted(hand_settings(shot, motorised).items())), shot)
        since += 1
        # No drift frame is inserted between the exposures of one bracket.
        goes_on = at + 1 < len(ordered) and _view(ordered[at + 1]) == _view(shot)
        if not goes_on and (since >= every or at + 1 == len(ordered)):
            file = f"{DRIFT}-{count:03d}-{repeated.file}"
            planned.append(replace(repeated, file=file, role=DRIFT))
            since, count = 0, count + 1
    return planned


def _view(shot: Shot) -> tuple[Pose, str]:
    return shot.pose, shot.filter
