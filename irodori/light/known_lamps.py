"""Lamps that the user of a place knows: names of published lamps, or measured spectra.

The prior is then built from these lamps instead of all published ones. Light of other lamps would be recovered as a
mixture of the given ones; therefore it is first tested whether published lamps explain the panorama far better.
"""

from collections.abc import Sequence

import numpy as np

from irodori.core.errors import InputError
from irodori.light.light_prior import LightPrior, light_prior, of_luminance_one
from irodori.light.light_recovery import Directions, ResponseModel, evidence
from irodori.spectra.published import MEASURED_LAMP_ERROR, NAMED_LAMP_ERROR, is_measured, light

#: Accepted log evidence ratio of published over given lamps; being many, published lamps can also fit some noise.
_ODDS = np.log(1e4)


def told_by(lamps: Sequence[str]) -> str:
    """Describe in words how lamps were given: by names, by measured spectra, or both."""
    kinds = (
        ("named lamps", [lamp for lamp in lamps if not is_measured(lamp)]),
        ("measured spectra", [lamp for lamp in lamps if is_measured(lamp)]),
    )
    return " and ".join(f"{words} ({', '.join(some)})" for words, some in kinds if some)


def known_prior(lamps: Sequence[str]) -> LightPrior:
    """Return the prior for a place lit only by the given lamps, each a published name or the path of a spectrum.

    Raises
    ------
    InputError
        For an unknown name, or a file without the spectrum of a light.
    """
    return given_prior(np.stack([light(lamp) for lamp in lamps]), np.array([is_measured(lamp) for lamp in lamps]))


def given_prior(spectra: np.ndarray, measured: np.ndarray) -> LightPrior:
    """Return the prior from spectra of lamps, (lamps, 61).

    ``measured``, (lamps,) bool, states whether each is a measured spectrum or that of a published type of lamp.
    """
    return light_prior(of_luminance_one(spectra), np.where(measured, MEASURED_LAMP_ERROR, NAMED_LAMP_ERROR))


def require_lamps_seen(
    lamps: Sequence[str], directions: Directions, model: ResponseModel, known: LightPrior, published: LightPrior, file
) -> None:
    """Raise an error if published lamps explain a panorama ten thousand times better than the given lamps.

    A black panorama is always accepted.

    Raises
    ------
    InputError
        The message names the file of the panorama and the lamps.
    """
    if not directions.lit:
        return
    odds = evidence(published, model, directions) - evidence(known, model, directions)
    if odds > _ODDS:
        found = f"{', '.join(lamps)} for a panorama that other lamps explain 10^{odds / np.log(10.0):.0f} times better"
        raise InputError(file, "lamps", found, "every lamp of the place, daylight included, or no lamps")
