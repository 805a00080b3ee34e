"""The file that records which gloss lobes were chosen for an object, with the prediction errors of all candidates."""

from dataclasses import dataclass

import numpy as np

from irodori.config.cross_checks.object_lobes import AUTO
from irodori.core import store
from irodori.reflection.registry import DEFAULT_LOBES

_FIGURES = {
    "deviation": "median error of a left-out reading over its stated standard deviation",
    "behind": "mean log(1 + z^2) of left-out readings over that of the best candidate",
    "behind_error": "standard error of behind, over photographs",
}


@dataclass(frozen=True)
class LeftOut:
    """Cross-validation of one candidate set of lobes: errors in predicting photographs that the fit left out.

    Parameters
    ----------
    lobes : tuple of str
        Lobe of each gloss component of the candidate.
    deviation : float
        Median error of a predicted reading in units of the reading's stated standard deviation, scaled so that normal
        errors of that deviation give 1; NaN without readings.
    behind : float
        Excess of the mean of log(1 + z²) over photographs above that of the best candidate. z is the error of a reading
        over its stated standard deviation, which is first multiplied by the least ``deviation`` of all candidates if
        that exceeds 1.
    behind_error : float
        Standard error of ``behind``, from its scatter over photographs.
    """

    lobes: tuple[str, ...]
    deviation: float
    behind: float
    behind_error: float


def lobes_text(lobes: tuple[str, ...] | list[str]) -> str:
    """Return the names of an object's lobes joined as a sum, for example ``gaussian + ggx``."""
    return " + ".join(lobes)


def write_choice(
    output, chosen: tuple[str, ...], found: list[LeftOut], texels: int, provenance: store.Provenance
) -> None:
    """Write the chosen lobes (attribute ``lobes``) and the prediction errors of every candidate, the simplest first.

    Parameters
    ----------
    output : path
    chosen : tuple of str
    found : list of LeftOut
        Prediction errors of all candidates.
    texels : int
        Number of texels that the prediction errors come from.
    provenance : Provenance
    """
    with store.create(output, provenance) as out:
        out.coordinate("candidate", [lobes_text(one.lobes) for one in found], units="1", quantity="lobes, as a sum")
        for name, quantity in _FIGURES.items():
            values = np.array([getattr(one, name) for one in found])
            out.write(name, values, units="1", dims="candidate", quantity=quantity)
        attributes = {"lobes": list(chosen), "candidates": [list(one.lobes) for one in found], "texels": texels}
        for name, value in attributes.items():
            out.attribute(name, value)


def chosen_lobes(named: list[str], choices: list) -> tuple[str, ...]:
    """Return an object's lobes: the chosen ones if there is a file of a choice, else those that its definition names.

    Parameters
    ----------
    named : list of str
        Lobes in the object's definition.
    choices : list of path
        The file of the choice; empty if the definition names the lobes.
    """
    if not choices:
        return tuple(named)
    with store.open_file(choices[0]) as file:
        return tuple(file.attribute("lobes", list))


def lobes_before_choice(named: list[str]) -> tuple[str, ...]:
    """Return the lobes that an object's definition names; equation (5) as long as they are still to be chosen."""
    return DEFAULT_LOBES if AUTO in named else tuple(named)


def read_choice(choices: list) -> list[LeftOut]:
    """Return the prediction errors of all candidates in a choice's file, the simplest first; none without a file."""
    found = []
    for path in choices:
        with store.open_file(path) as file:
            tried, figures = file.attribute("candidates", list), [file.read(name) for name in _FIGURES]
        found += [
            LeftOut(tuple(lobes), *map(float, row)) for lobes, row in zip(tried, np.transpose(figures), strict=True)
        ]
    return found
