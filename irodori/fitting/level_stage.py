"""Stage that estimates the lamp's level in every photograph of an object from its observations."""

from pathlib import Path

import numpy as np

from irodori.core import store
from irodori.fitting.diffuse_response import GREEN
from irodori.fitting.level_estimate import MOST_TEXELS, estimate_levels
from irodori.fitting.mirror_image import without_images
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import for_object, fresnel_of
from irodori.fitting.texel_sample import Readings, sample_texels
from irodori.material.photograph_levels import BANDS_OF_STATE, NOTHING, TEXELS, PhotographLevels

_OBSERVATIONS = 5  # of a texel that is taken, where there are such texels


def measure_levels(observations: list, output, options: FitOptions, n, k, *, provenance, calibration=None) -> None:
    """Estimate the lamp's level in every photograph jointly with the materials, and write it.

    Parameters
    ----------
    observations : list of path
        All tiles of the object.
    output, options, n, k, calibration
        As in `irodori.fitting.stage.fit_brdf`.

    Notes
    -----
    The file is that of `irodori.material.photograph_levels`. The levels of each filter state are estimated from its
    green band. If one state's levels are not determined, all are 1.
    """
    with store.open_file(observations[0]) as file:
        captures = file.read("capture").astype(str).tolist()
        filters, bands = file.attribute("filters", list), file.dataset("response").shape[2]
    fresnel, options = fresnel_of(n, k, calibration, bands), for_object(options, observations)
    sample = without_images(sample_texels(observations, MOST_TEXELS, _OBSERVATIONS), options)
    found = []
    for band in range(GREEN, bands, BANDS_OF_STATE):
        found.append(estimate_levels(Readings.of_band(sample, band, fresnel.n, fresnel.k, options.is_coupled), options))
    told = [one for one in found if one is not None]
    if len(told) < len(filters):
        nothing = np.ones((len(captures), len(filters)))
        levels = PhotographLevels(nothing, options.model_error * nothing, options.level_error, NOTHING)
    else:
        level, error = (np.column_stack([getattr(one, name) for one in told]) for name in ("level", "error"))
        levels = PhotographLevels(level, error, options.level_error, TEXELS)
    levels.say()
    levels.write(Path(output), captures, filters, provenance)
