"""Lamps that the user of a place knows: names of published lamps, or measured spectra.

The prior is then built from these lamps instead of all published ones. Light of other lamps would be recovered as a
mixture of the given ones; therefore it is first tested whether published lamps explain the panorama far better.
"""

from collections.abc import Sequence

import numpy as np

from irodori.core.errors import InputError
from irodori.light.light_prior import LightPrior, light_prior, of_luminance_one
from irodori.light.light_recovery import Directions, ResponseModel, evidence
from irodori.spectra.published import is_measured, lamp_error, light

#: Accepted log evidence ratio of published over given lamps; being many, published lamps can also fit some noise.
_ODDS = np.log(1e4)


def told_by(lamps: Sequence[str]) -> str:
    """Describe in words how lamps were given: by names, by measured spectra, or both."""
    kinds = (
        ("named lamps", [lamp for lamp in lamps if not is_measured(lamp)]),
        ("measured spectra", [lamp for lamp in lamps if is_measured(lamp)]),
    )
    return " and ".join(f"{words} ({', '.join(some)})" for words, some in kinds if some)


def known_prior(lamps: Sequence[str], error_percent: float | None = None) -> LightPrior:
    """Return the prior for a place lit only by the given lamps, each a published name or the path of a spectrum.

    ``error_percent`` is how far a lamp may differ from its spectrum, by default as
    `irodori.spectra.published.lamp_error` says.

    Raises
    ------
    InputError
        For an unknown name, or a file without the spectrum of a light.
    """
    errors = np.array([lamp_error(lamp, error_percent) for lamp in lamps])
    return given_prior(np.stack([light(lamp) for lamp in lamps]), errors)


def given_prior(spectra: np.ndarray, error: float | np.ndarray) -> LightPrior:
    """Return the prior from spectra of lamps, (lamps, 61), that may differ from these by relative errors, (lamps,)."""
    return light_prior(of_luminance_one(spectra), error)


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
