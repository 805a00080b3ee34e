"""Responses to the light that passes through a thin sheet, from photographs whose light stands behind it.

A sheet sends what passes through it out evenly diffuse. An observation is therefore T cosθ, with the transmittance T
of the band and the angle θ of the light to the normal on the far side.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.material.observed_angles import read_angles
from irodori.material.photograph_levels import levels_of

_AXES = {
    "response": "texel,capture,band",
    "passed": "texel,capture",
    "noise_model": "capture,band,coefficient",
}


class PassedLight:
    """Observations of a sheet with the light behind it, tile by tile.

    Parameters
    ----------
    observations : sequence of path
        Tiles of observations of an object that is a sheet.
    levels : sequence of path
        File of the lamp's level in every photograph, by which responses are divided; none if it is constant.

    Raises
    ------
    InputError
        If no photograph shows light behind the sheet.
    """

    def __init__(self, observations: Sequence, levels: Sequence) -> None:
        self._files: list[tuple[int, int, int, Path]] = []
        self._levels, seen = levels, False
        for path in observations:
            with store.open_file(path) as file:
                self._files.append((*file.attribute("rows", list), file.attribute("width", int), path))
                seen |= "passed" in file and bool(file.read("passed").any())
        if not seen:
            accepted = "a photograph of the sheet with the light behind it, or sheet.transmittance in its definition"
            raise InputError(observations[0], "passed", "no texel that shows light from behind", accepted)

    def of(self, rows: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return transmittances of the bands in rows of a tile, and their variances by noise, (texels, bands) each.

        Both are NaN where no photograph shows light from behind; variances also where the camera's noise is not known.
        """
        first, _, width, path = next(one for one in self._files if one[0] <= rows.start and rows.stop <= one[1])
        here = slice((rows.start - first) * width, (rows.stop - first) * width)
        with store.open_file(path) as file:
            file.require_axes(_AXES, coefficient=2)
            response, passed = (file.read(name, here).astype(np.float64) for name in ("response", "passed"))
            cosine, noise = np.cos(np.pi - read_angles(file, here)[..., 0].astype(np.float64)), file.read("noise_model")
            gain = file.read("light_gain", here) if "light_gain" in file else np.ones(passed.shape)
            captures = file.read("capture").astype(str).tolist()
        for name in self._levels:
            level = levels_of(name, captures, response.shape[2], path)
            response, gain = response / level, gain[..., None] / level
        gain = gain.reshape(*passed.shape, -1)
        variance = gain**2 * noise[:, :, 0] + gain * noise[:, :, 1] * np.maximum(response, 0.0)
        weight = (passed * cosine)[..., None]
        whole = (weight * cosine[..., None]).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.where(whole > 0.0, (weight * response).sum(axis=1) / whole, np.nan)
            error = np.where(passed[..., None] > 0.0, weight**2 * variance, 0.0).sum(axis=1) / whole**2
        return found, np.where(whole > 0.0, error, np.nan)
