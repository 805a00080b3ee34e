"""Lamps of a place that its user knows: named as published ones, or given by measured spectra.

They make the prior's families in place of all published lamps. A place with other light than theirs would be recovered
as their mixture, so that the panorama is asked first: light that the published lamps explain far better than those
given is not theirs.
"""

from collections.abc import Sequence

import numpy as np

from irodori.core.errors import InputError
from irodori.light.light_prior import LightPrior, light_prior, of_luminance_one
from irodori.light.light_recovery import Directions, ResponseModel, log_densities
from irodori.spectra.published import light
from irodori.spectra.spectral_files import SUFFIXES

#: Standard deviation of what differs smoothly from a lamp, relative: of one lamp from the published one of its type,
#: and of the reading of a field spectroradiometer.
_OF_TYPE, _OF_MEASURED = 0.05, 0.02
_ODDS = np.log(1000.0)  # by which published lamps explain a direction better that is not lit by those given
_MAX_FOREIGN = 0.05  # of a panorama's light


def is_measured(lamp: str) -> bool:
    """Whether a lamp is given by the file of its spectrum, as against a published name."""
    return lamp.lower().endswith(SUFFIXES)


def told_by(lamps: Sequence[str]) -> str:
    """Return in words what tells of some lamps: their names, their measured spectra, or both."""
    kinds = (
        ("named lamps", [lamp for lamp in lamps if not is_measured(lamp)]),
        ("measured spectra", [lamp for lamp in lamps if is_measured(lamp)]),
    )
    return " and ".join(f"{words} ({', '.join(some)})" for words, some in kinds if some)


def known_prior(lamps: Sequence[str]) -> LightPrior:
    """Return the prior of a place that is lit by some lamps alone, each a published name or the path of a spectrum.

    Raises
    ------
    InputError
        For an unknown name, and for a file that holds no spectrum of a light.
    """
    return given_prior(np.stack([light(lamp) for lamp in lamps]), np.array([is_measured(lamp) for lamp in lamps]))


def given_prior(spectra: np.ndarray, measured: np.ndarray) -> LightPrior:
    """Return the prior that lamps make, (lamps, 61), of which some were measured and the others are of that type."""
    return light_prior(of_luminance_one(spectra), np.where(measured, _OF_MEASURED, _OF_TYPE))


def foreign_share(directions: Directions, model: ResponseModel, known: LightPrior, published: LightPrior) -> float:
    """Return the share of a panorama's light that published lamps explain a thousand times better than known ones."""
    better = log_densities(published, model, directions) - log_densities(known, model, directions)
    return float(directions.share[better > _ODDS].sum())


def require_lamps_seen(
    lamps: Sequence[str], directions: Directions, model: ResponseModel, known: LightPrior, published: LightPrior, file
) -> None:
    """Refuse lamps that do not make the light of a panorama.

    Raises
    ------
    InputError
        Which names the panorama's file, the lamps and how much of its light is not theirs.
    """
    foreign = foreign_share(directions, model, known, published)
    if foreign > _MAX_FOREIGN:
        found = f"{', '.join(lamps)} for a panorama of which {foreign:.0%} is other light"
        accepted = f"every lamp of the place, daylight included, at most {_MAX_FOREIGN:.0%} other light; or no lamps"
        raise InputError(file, "lamps", found, accepted)
