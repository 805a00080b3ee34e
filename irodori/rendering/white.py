"""The white of a scene: what its pictures show as white and their colour errors are judged against."""

import numpy as np

from irodori.light import Environment


def scene_white(scene: dict, environment: Environment) -> tuple[np.ndarray, float]:
    """Return the radiance that pictures of a scene show as white, and their exposure.

    Parameters
    ----------
    scene : dict
        ``lights``, which a perfect diffuser that faces up sees from the scene's origin beside the environment; and
        ``display.exposure``, the factor on that diffuser's radiance before it is shown. ``auto`` is 1: it is white.
    environment : Environment

    Returns
    -------
    white : (61,) float64
    exposure : float
    """
    given = scene["display"]["exposure"]
    exposure = 1.0 if given == "auto" else float(given)
    white = environment.upward_white()
    if scene.get("lights"):
        from irodori.rendering.lights import make_lights, upward_radiance  # compiles loops

        white = white + upward_radiance(make_lights(scene["lights"], 0)[0])
    return white / exposure, exposure
