"""Stage that chooses the lobes of an object: reads its observations, writes the choice and the comparison behind it."""

import numpy as np

from irodori.core import store
from irodori.core.progress import LOGGER
from irodori.fitting.lobe_choice import ENOUGH_OBSERVATIONS, MOST_TEXELS, Sample, candidates, choose
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import GREEN, Observed, fresnel_of, read_observations
from irodori.material.lobe_choices import lobes_text, write_choice

_MOST_TILES = 16  # largest number of tiles to read, spread evenly over the object


def _sample(tiles: list, n: float, k: float) -> Sample:
    """Draw a sample of texels, evenly from some tiles, from those with enough observations.

    If no texel has enough, the texels with the most observations are used.
    """
    tiles = tiles[:: -(-len(tiles) // _MOST_TILES)]
    counts = [_observations(path) for path in tiles]
    least = max(min(ENOUGH_OBSERVATIONS, max(count.max(initial=0) for count in counts)), 1)
    total = sum(int((count >= least).sum()) for count in counts)
    step = max(1, -(-total // MOST_TEXELS))
    parts: list[Observed] = []
    for path, count in zip(tiles, counts, strict=True):
        parts.append(read_observations(path)[np.flatnonzero(count >= least)[::step]])
    return Sample(
        response=np.concatenate([part.response[..., GREEN] for part in parts]),
        weight=np.concatenate([part.weight for part in parts]),
        geometry=np.concatenate([part.geometry for part in parts]),
        noise=parts[0].noise[:, GREEN],
        n=n,
        k=k,
    )


def _observations(path) -> np.ndarray:
    """Return the number of observations with weight for each texel of a tile."""
    with store.open_file(path) as file:
        return (file.read("weight") > 0.0).sum(axis=1)


def choose_lobes(observations: list, output, options: FitOptions, n, k, *, provenance, calibration=None) -> None:
    """Choose the lobes that predict left-out photographs of an object best, and write the comparison.

    Parameters
    ----------
    observations : list of path
        All tiles of the object.
    output, options, n, k, calibration
        As in `irodori.fitting.stage.fit_brdf`; the lobes of the options are ignored.

    Notes
    -----
    `irodori.material.lobe_choices` describes the file.
    """
    with store.open_file(observations[0]) as file:
        bands = file.dataset("response").shape[2]
    fresnel = fresnel_of(n, k, calibration, bands)
    sample = _sample(observations, fresnel.n, fresnel.k)
    chosen, found = choose(sample, options, candidates(options))
    write_choice(output, chosen, found, len(sample.response), provenance)
    for one in found:
        stated = (lobes_text(one.lobes), one.deviation, one.behind, one.behind_error)
        LOGGER.info("%s: left-out readings off by %.2f stated errors; behind the best by %.3f +- %.3f", *stated)
    LOGGER.info("lobes from %d texels of %d photographs: %s", *sample.response.shape, lobes_text(chosen))
