"""Stage that chooses lobes and coat of an object from its observations, and writes the comparison behind the choice."""

from irodori.config.cross_checks.object_lobes import AUTO
from irodori.core import store
from irodori.core.progress import LOGGER
from irodori.fitting.diffuse_response import GREEN
from irodori.fitting.lobe_choice import ENOUGH_OBSERVATIONS, MOST_TEXELS, candidates, choose
from irodori.fitting.mirror_image import without_images
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import for_object, fresnel_of
from irodori.fitting.texel_sample import Readings, sample_texels
from irodori.material.lobe_choices import model_text, write_choice
from irodori.reflection.coat import COATS, SUM


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
    seen = without_images(sample_texels(observations, MOST_TEXELS, ENOUGH_OBSERVATIONS), options)
    sample = Readings.of_band(seen, GREEN, fresnel.n, fresnel.k)
    tried = candidates(options, None if AUTO in lobes else tuple(lobes), COATS if coat == AUTO else (coat,))
    chosen, found = choose(sample, options, tried)
    write_choice(output, chosen, found, len(sample.response), provenance)
    for one in found:
        stated = (one.text, one.deviation, one.behind, one.behind_error)
        LOGGER.info("%s: left-out readings off by %.2f stated errors; behind the best by %.3f +- %.3f", *stated)
    LOGGER.info("model from %d texels of %d photographs: %s", *sample.response.shape, model_text(*chosen))
