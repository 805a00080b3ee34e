"""Decision which numbers of a registration are corrected: those that photographs determine and significantly change.

A correction smaller than its own error would do harm, so that all others stay exactly as typed.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.core.progress import LOGGER
from irodori.rectification.placement_correction import LIGHT, QUANTITIES

_TOLD = 0.5  # share of the prior's standard deviation; a value with a larger error is not determined by the photographs
_SIGNIFICANT = 2.0  # standard errors that a significant correction exceeds
#: Standard deviations, of what was typed and of the estimate together, beyond which the typed angle of the light is
#: contradicted. A surface of two lobes, fitted with one, was seen to displace it by three.
CONTRADICTED = 4.0
#: Accuracy that registration aims at, in the order of `QUANTITIES`: 0.1 mm and 0.05 degrees, and what moves the rim of
#: an object of a hand's size by as much. Standard errors do not include the bias of an outline in dim light.
ACCURACY = np.array([0.1] * 3 + [0.05] * 3 + [2.0, 0.2] + [0.5] * 2 + [0.05] * 2)


def is_told(sigma: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return a mask of the values whose standard error is below half of the prior's standard deviation."""
    return sigma < _TOLD * prior


def told_in_words(values: np.ndarray, sigma: np.ndarray, told: np.ndarray) -> list[str]:
    """Return which of the `QUANTITIES` are corrected, by ``values``, which confirmed and which left undetermined.

    Parameters
    ----------
    values, sigma : (12,) float
        Corrections in use, and standard errors.
    told : (12,) bool
        Whether the photographs determine a value.
    """
    said, confirmed, silent = [], [], []
    for quantity, value, error, known in zip(QUANTITIES, values, sigma, told, strict=True):
        # If a value is determined only because others are fixed, its joint standard error would mislead.
        stated = f"± {error:.2f} " if known else ""
        if value:
            said.append(f"{quantity.text} {value:+.2f} {stated}{quantity.unit}")
        elif known:
            confirmed.append(quantity.text)
        else:
            silent.append(quantity.text)
    parts = [f"corrections of what was typed: {'; '.join(said) or 'none'}"]
    if confirmed:
        parts.append(f"confirmed as typed: {', '.join(confirmed)}")
    if silent:
        parts.append(f"not determined by the photographs, kept as typed: {', '.join(silent)}")
    return parts


class SettledLight(NamedTuple):
    """Error of all light angles, deg: the correction in use, the most probable value, and its variance, deg²."""

    used_deg: float
    probable_deg: float
    variance: float


def settle_light(offset_deg: float, error_deg: float, prior_deg: float) -> SettledLight:
    """Decide what shading and highlights correct of the light's angles.

    The angles are corrected where the photographs contradict them or, as other numbers are, where the photographs
    determine them and they are significantly off. Else they stay as typed.

    Parameters
    ----------
    offset_deg, error_deg : float
        Error of the angles by the photographs, and its standard error.
    prior_deg : float
        Standard deviation of the typed angles.
    """
    significant = error_deg < _TOLD * prior_deg and abs(offset_deg) > max(_SIGNIFICANT * error_deg, ACCURACY[LIGHT])
    contradicted = abs(offset_deg) > CONTRADICTED * math.hypot(prior_deg, error_deg)
    if contradicted:
        # A round object alone shows only the sum of the two scales.
        words = (
            "the photographs contradict the typed light angles, which are corrected by %+.2f ± %.2f deg, or else the"
        )
        words += " zero of the camera's scale is off by as much"
        LOGGER.warning(words, offset_deg, error_deg)
    if significant or contradicted:
        return SettledLight(offset_deg, offset_deg, error_deg**2)
    share = prior_deg**2 / (prior_deg**2 + error_deg**2)
    return SettledLight(0.0, share * offset_deg, share * error_deg**2)


def only_what_is_told(
    unknowns: np.ndarray, matrix: np.ndarray, sigma: np.ndarray, accuracy: np.ndarray = ACCURACY
) -> tuple[np.ndarray, np.ndarray]:
    """Reset unknowns that the photographs do not determine; return all unknowns and standard deviations of the prior.

    One after the other, the least determined of the first k unknowns is fixed at 0, its value in the definitions, and
    the others are solved again: if only the sum of two unknowns is determined, fixing one determines the other. Then
    unknowns whose correction is not significant, or is below the accuracy of the method, are fixed in the same way. The
    returned standard deviation of a fixed unknown is 0.

    Parameters
    ----------
    unknowns : (n,) float
        Most probable values, those first of which this is decided; the others are free.
    matrix : (n, n) float
        Normal matrix at these values, with the prior.
    sigma : (n,) float
        Standard deviations of the prior.
    accuracy : (k,) float
        Corrections of the first k unknowns up to these are none; by default the accuracy of the method.
    """
    values, room = unknowns.copy(), sigma.copy()
    while True:
        free = np.flatnonzero(room[: len(accuracy)] > 0)
        if not free.size:
            return values, room
        error = np.sqrt(diagonal_of_inverse(matrix, room))[free]
        told = _TOLD * sigma[free] / error
        sure = np.abs(values[free]) / np.maximum(_SIGNIFICANT * error, accuracy[free])
        least = told if told.min() <= 1.0 else sure
        if least.min() > 1.0:
            return values, room
        out = free[np.argmin(least)]
        room[out] = 0.0
        values += solve(matrix, matrix[:, out] * values[out], room)
        values[out] = 0.0


def solve(matrix: np.ndarray, right: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the step of the unknowns with a positive standard deviation ``sigma``; 0 for the others."""
    free = sigma > 0
    step = np.zeros(len(right))
    scaled = np.outer(sigma[free], sigma[free]) * matrix[np.ix_(free, free)]
    step[free] = sigma[free] * np.linalg.solve(scaled, sigma[free] * right[free])
    return step


def inverse(matrix: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the inverse of a matrix, 0 for the unknowns without a standard deviation ``sigma``."""
    free = sigma > 0
    both = np.outer(sigma, sigma)
    out = np.zeros_like(matrix)
    out[np.ix_(free, free)] = np.linalg.inv((both * matrix)[np.ix_(free, free)])
    return both * out


def diagonal_of_inverse(matrix: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the diagonal of `inverse`."""
    return np.diag(inverse(matrix, sigma))
