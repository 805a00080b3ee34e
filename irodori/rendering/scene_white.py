"""White point of a scene, for display and for colour errors."""

import numpy as np

from irodori.config.models import Scene
from irodori.config.parts import Staging
from irodori.core.errors import InputError
from irodori.light.environment_file import Environment


def scene_white(scene: Scene | Staging, environment: Environment) -> tuple[np.ndarray, float]:
    """Return the radiance that pictures of a scene show as white, and their exposure.

    White is the radiance of a perfect diffuser that faces up at the scene's origin, divided by the exposure.

    Parameters
    ----------
    scene : Scene or Staging
        Its ``lights`` and the environment light the diffuser; its ``display.exposure`` is the factor on the diffuser's
        radiance before display. With ``auto`` it is 1, and the diffuser is shown as white.
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
    """Return `scene_white` for making a picture, and raise an error if there is no light.

    Raises
    ------
    InputError
        If no light falls on the diffuser that defines white.
    """
    white, exposure = scene_white(scene, environment)
    if not white.any():
        found = "no light on a surface that faces up at the scene's origin, nor from lights of the scene"
        raise InputError(environment_file, "", found, "a white that colours are seen against")
    return white, exposure
