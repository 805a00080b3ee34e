"""White point of a scene, for display and for colour errors."""

import numpy as np

from irodori.config.models import Scene
from irodori.config.parts import Staging
from irodori.core.errors import InputError
from irodori.light.environment_file import Environment


def scene_white(scene: Scene | Staging, environment: Environment) -> tuple[np.ndarray, float]:
    """Return the radiance that pictures of a scene show as white, and their exposure.

    Parameters
    ----------
    scene : Scene or Staging
        Its ``lights`` are those that a perfect diffuser that faces up sees from the scene's origin beside the
        environment; its ``display.exposure`` is the factor on that diffuser's radiance before it is shown. ``auto``
        is 1: it is white.
    environment : Environment

    Returns
    -------
    white : (61,) float64
    exposure : float
    """
    given = scene.display.exposure
    exposure = 1.0 if given == "auto" else float(given)
    white = environment.upward_white()
    if scene.lights:
        from irodori.rendering.scene_lights import make_lights, upward_radiance  # compiles loops

        white = white + upward_radiance(make_lights(scene.lights, 0)[0])
    return white / exposure, exposure


def shown_white(scene: Scene, environment: Environment, environment_file) -> tuple[np.ndarray, float]:
    """Return `scene_white`, against which a picture is made.

    Raises
    ------
    InputError
        If nothing lights that diffuser: there is no white, and no picture.
    """
    white, exposure = scene_white(scene, environment)
    if not white.any():
        found = "no light on a surface that faces up at the scene's origin, nor from lights of the scene"
        raise InputError(environment_file, "", found, "a white that colours are seen against")
    return white, exposure
