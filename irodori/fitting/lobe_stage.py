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
from irodori.fitting.texel_sample import Readings, drawn, sample_texels
from irodori.material.lobe_choices import Comparison, model_text, write_choice
from irodori.reflection.coat import COATS, SUM
from irodori.reflection.registry import DEFAULT_LOBES

#: Texels from which paints are found, at most, and the observations that each should have, fewer than to tell lobes.
_MOST_SEEN, _ENOUGH_FOR_PAINT = 8192, 4
_MISFIT = (
    "no form of gloss predicts left-out readings better than within %.1f of their stated errors: lamp, aperture or a "
    "pose differ between photographs from what was typed, the surface has another shape (a bent plate, a ball out of "
    "round, other normals), or highlights clip; everything is stated with larger errors, and nothing is called ok"
)
_LEAST_PAINTED = 0.5  # share of the sample below which a choice of one lobe is said to rest on single texels


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
    few = drawn(np.count_nonzero(every.weight > 0.0, axis=1), MOST_TEXELS, ENOUGH_OBSERVATIONS)
    tried, coats = candidates(options, None if AUTO in lobes else tuple(lobes), coats_of(coat)), coats_of(coat)
    paint, share = np.full(len(every.response), -1), None
    if options.gloss_by_paint:
        lobe = next((one.lobes for one in tried if len(one.lobes) == 1), DEFAULT_LOBES)
        labels = [
            _paint_of(seen, every, replace(options, lobes=lobe, coat=name, solver="varpro"), fresnel) for name in coats
        ]
        # Under a wrong coat, the colours of a paint scatter; its texels are the same under each.
        paint = max(labels, key=lambda one: np.count_nonzero(one[few] >= 0))
        share = float((paint[few] >= 0).mean()) if len(few) else 0.0
    by_paint = share is not None and share >= _LEAST_PAINTED
    few = few[paint[few] >= 0] if by_paint else few
    paints = {name: painted(every, paint, few) for name in coats} if by_paint else {}
    sample = every[few]
    chosen, found = choose(sample, options, tried, paints)
    favours_tails = share is not None and not by_paint and len(chosen.lobes) == 1 and AUTO in lobes
    compared = Comparison(tuple(found), share, favours_tails, sample.response.shape[1] >= ENOUGH_OBSERVATIONS)
    write_choice(output, chosen, compared, len(few), provenance)
    for one in found:
        stated = (one.text, one.deviation, one.behind, one.behind_error)
        LOGGER.info("%s: left-out readings off by %.2f stated errors; behind the best by %.3f +- %.3f", *stated)
    said = *sample.response.shape, len(paints.get(chosen.coat, ())), 100.0 * (share or 0.0), model_text(*chosen)
    LOGGER.info("model from %d texels of %d photographs and %d paints, which %.0f %% had: %s", *said)
    if (times := compared.misfit(*chosen)) > 1.0:
        LOGGER.warning(_MISFIT, times)
    if favours_tails:
        LOGGER.warning("few texels have the colour of a paint; by single texels, lobes with long tails are favoured")


def coats_of(coat: str) -> tuple[str, ...]:
    """Return the coats that an object's definition leaves open, or the one that it names."""
    return COATS if coat == AUTO else (coat,)


def _paint_of(seen: Observed, green: Readings, options: FitOptions, fresnel: BandGloss) -> np.ndarray:
    """Return the paint of each texel of a sample, (texels,) int; -1 where its colour is not that of a paint.

    The colours are those that texels have by their own fit with the lobe and the coat of the options.
    """
    own = fit(green.response, green.geometry, green.weight, green.n, green.k, options, noise=green.noise)
    given = seen.response, seen.geometry, seen.weight, own, fresnel, seen.noise
    response, variance = diffuse_response(*given, model_error=options.model_error, coupled=options.is_coupled)
    told = np.isin(own.status, BELIEVED) & np.isfinite(response).all(axis=1)
    colours = find_colours(response[told], noise_floor(variance[told], response[told]))
    return by_colour(response, variance, colours)
