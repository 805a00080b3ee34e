"""Photographs of whole scenes by the virtual camera, from rendered radiance."""

import numpy as np

from irodori.config.models import Optics
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.ideal_camera import IdealView
from irodori.geometry.pinhole import Pinhole
from irodori.material.coefficients import read_coefficients

_BLOCK_ROWS = 32


def scene_radiance(path, optics: Optics) -> np.ndarray:
    """Read a rendered spectral radiance, (rows, columns, 61) float32, the mean of its two independent halves.

    Raises
    ------
    InputError
        If the picture does not cover the camera's sensor.
    """
    with store.open_file(path) as file:
        radiance = read_coefficients(file, "radiance").mean(axis=0)
    least = IdealView.covering(Pinhole.from_optics(optics), 1)
    if radiance.shape[0] < least.height or radiance.shape[1] < least.width:
        found = f"{radiance.shape[1]} x {radiance.shape[0]} pixels"
        raise InputError(path, "radiance", found, f"at least {least.width} x {least.height}, what the camera sees")
    return radiance


def scene_mosaic(radiance: np.ndarray, light: np.ndarray, optics: Optics, ideal_from_seen, band_weights) -> np.ndarray:
    """Return the responses of the sensor's mosaic pixels to a rendered scene.

    Parameters
    ----------
    radiance : (rows, columns, 61) float
        Radiance of the scene, centred on the camera's axis, without distortion, one pixel for each superpixel.
    light : (61,) float
        Spectrum E(λ) of the rig's light.
    optics : Optics
        Optics of the camera.
    ideal_from_seen : (2, 3) float
        Map of the filter plate, see `irodori.simulation.virtual_rig.imperfections.Faults.ideal_from_seen`.
    band_weights : (3, 61) float
        Weights of the filter state.

    Returns
    -------
    (height, width) float64, responses, RGGB
    """
    from scipy import ndimage  # slow to import

    # Band weights are for reflectances under the rig's light; a radiance is that light times a reflectance.
    bands = (radiance @ (band_weights / light).T.astype(np.float32)).astype(np.float64)
    pinhole = Pinhole.from_optics(optics)
    ideal = IdealView(pinhole, 1, pinhole.focal_px / 2.0, radiance.shape[1], radiance.shape[0])
    picture = np.empty((pinhole.height_px, pinhole.width_px))
    for first in range(0, pinhole.height_px, _BLOCK_ROWS):
        y, x = np.indices((min(_BLOCK_ROWS, pinhole.height_px - first), pinhole.width_px))
        y += first
        seen = np.stack([x + 0.5, y + 0.5, np.ones(x.shape)], axis=-1) @ np.asarray(ideal_from_seen).T
        at = np.moveaxis(ideal.pixels_of(seen)[..., ::-1], -1, 0)
        rows = picture[first : first + len(y)]
        for row in (0, 1):
            for column in (0, 1):
                own = (slice(row, None, 2), slice(column, None, 2))
                rows[own] = ndimage.map_coordinates(
                    bands[..., row + column], at[(slice(None), *own)], order=1, mode="nearest", prefilter=False
                )
    return picture
