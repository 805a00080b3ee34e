"""Stage that chooses lobes and coat of an object from its observations, and writes the comparison behind the choice."""

from dataclasses import replace

import numpy as np

from irodori.config.cross_checks.object_lobes import AUTO
from irodori.core import store
from irodori.core.progress import LOGGER
from irodori.fitting.band_fresnel import BandGloss
from irodori.fitting.diffuse_response import GREEN, Observed, diffuse_response
from irodori.fitting.lobe_choice import ENOUGH_OBSERVATIONS, MOST_TEXELS, candidates, choose, painted
from irodori.fitting.mirror_image import without_images
from irodori.fitting.paint_colours import find_colours, noise_floor
from irodori.fitting.paints import BELIEVED, by_colour
from irodori.fitting.solvers import FitOptions, fit
from irodori.fitting.stage import for_object, fresnel_of
from irodori.fitting.texel_sample import Readings, evenly, sample_texels
from irodori.material.lobe_choices import model_before_choice, model_text, write_choice
from irodori.reflection.coat import COATS, SUM

#: Texels from which paints are found, at most, and the observations that each should have, fewer than to tell lobes.
_MOST_SEEN, _ENOUGH_FOR_PAINT = 8192, 4


def choose_lobes(
    observations: list, output, options: FitOptions, n, k, *, provenance, calibration=None, lobes=(AUTO,), coat=SUM
) -> None:
    """Choose the lobes and the coat that predict left-out photographs of an object best, and write the comparison.

    Parameters
    ----------
    observations : list of path
        All tiles of the object.
    output, options, n, k, calibration
        As in `irodori.fitting.stage.fit_brdf`; the lobes and the coat of the options are ignored.
    lobes : sequence of str
    coat : str
        As in the object's definition; what is ``auto`` is chosen.

    Notes
    -----
    `irodori.material.lobe_choices` describes the file.
    """
    with store.open_file(observations[0]) as file:
        bands = file.dataset("response").shape[2]
    fresnel, options = fresnel_of(n, k, calibration, bands), for_object(options, observations)
    seen = without_images(sample_texels(observations, _MOST_SEEN, _ENOUGH_FOR_PAINT), options)
    every = Readings.of_band(seen, GREEN, fresnel.n, fresnel.k)
    few = evenly(np.count_nonzero(every.weight > 0.0, axis=1), MOST_TEXELS, ENOUGH_OBSERVATIONS)
    sample, paints = every[few], []
    if options.gloss_by_paint:
        paints = painted(every, _paint_of(seen, every, options, fresnel), few)
    tried = candidates(options, None if AUTO in lobes else tuple(lobes), COATS if coat == AUTO else (coat,))
    chosen, found = choose(sample, options, tried, paints)
    write_choice(output, chosen, found, len(sample.response), provenance)
    for one in found:
        stated = (one.text, one.deviation, one.behind, one.behind_error)
        LOGGER.info("%s: left-out readings off by %.2f stated errors; behind the best by %.3f +- %.3f", *stated)
    said = len(sample.response), len(paints), sample.response.shape[1], model_text(*chosen)
    LOGGER.info("model from %d texels and %d paints in %d photographs: %s", *said)


def _paint_of(seen: Observed, green: Readings, options: FitOptions, fresnel: BandGloss) -> np.ndarray:
    """Return the paint of each texel of a sample, (texels,) int; -1 where its colour is not that of a paint."""
    plain = replace(options, **model_before_choice([AUTO], AUTO))
    own = fit(green.response, green.geometry, green.weight, green.n, green.k, plain, noise=green.noise)
    given = seen.response, seen.geometry, seen.weight, own, fresnel, seen.noise
    response, variance = diffuse_response(*given, model_error=options.model_error)
    told = np.isin(own.status, BELIEVED) & np.isfinite(response).all(axis=1)
    colours = find_colours(response[told], noise_floor(variance[told], response[told]))
    return by_colour(response, variance, colours)
