"""White reference under a near lamp, for photographs that this lamp does not light.

Division by the white reference removes the vignetting of the lens, and with it the fall-off of the lamp's light over
the white reference. Rectification takes account of the latter for objects on the rig (`irodori.geometry.lamp`). Places,
room charts and scenes are under other light: their responses must be divided by the vignetting alone.
"""

import numpy as np

from irodori.config.capture_table import Pose
from irodori.config.parts import NearLamp
from irodori.geometry.lamp import Lamp
from irodori.geometry.pinhole import Pinhole
from irodori.ingest.flat_field import evaluate_flat, fit_flat

_PLACES = 65  # along each side of the picture, at which the fall-off is computed


def evenly_lit(white: np.ndarray, size_px: tuple[int, int], near: NearLamp) -> np.ndarray:
    """Return the white reference as if its lamp were far.

    Parameters
    ----------
    white : (bands, 15) float64
        Coefficients of the flat field, see `irodori.ingest.flat_field`.
    size_px : (width, height)
        Size of the mosaic.
    near : NearLamp

    Returns
    -------
    (bands, 15) float64, with the same value where the camera looks at the middle of the white reference

    Raises
    ------
    InputError
        If a pixel does not see the lit side of the white reference.
    """
    x, y = (np.linspace(1.0, size - 1.0, _PLACES) for size in size_px)  # centres of the first and last superpixels
    lamp, pose = Lamp.at(near.rig.lamp_distance_mm), Pose(**vars(near.white_pose))
    places = np.stack(np.meshgrid(x, y), axis=-1)
    power = lamp.on_white(places, Pinhole.from_optics(near.optics), near.rig.camera_distance_mm, pose)
    even = evaluate_flat(white, _PLACES, _PLACES) / power[..., None]
    return fit_flat(even, np.ones(power.shape, dtype=np.bool_))
