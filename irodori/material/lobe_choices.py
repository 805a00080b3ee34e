"""The file of a choice of lobes: which an object has, and how the photographs preferred them."""

from dataclasses import dataclass

import numpy as np

from irodori.core import store

_FIGURES = {
    "deviation": "median error of a left-out reading over its stated standard deviation",
    "behind": "mean log(1 + z^2) of left-out readings over that of the best candidate",
    "behind_error": "standard error of behind, over photographs",
}


@dataclass(frozen=True)
class LeftOut:
    """Prediction error of left-out photographs with some lobes.

    Parameters
    ----------
    lobes : tuple of str
    deviation : float
        Median size of a prediction's error in stated standard deviations of a reading, 1 = as a normal error of that
        size; NaN without any.
    behind : float
        How much worse than with the best candidate: by the mean over photographs of a reading's log(1 + z²), z its
        error in stated standard deviations times the least ``deviation`` of all candidates, where that exceeds 1.
    behind_error : float
        Standard error of that, from its scatter over photographs.
    """

    lobes: tuple[str, ...]
    deviation: float
    behind: float
    behind_error: float


def lobes_text(lobes: tuple[str, ...] | list[str]) -> str:
    """Return the names of an object's lobes as a sum."""
    return " + ".join(lobes)


def write_choice(
    output, chosen: tuple[str, ...], found: list[LeftOut], texels: int, provenance: store.Provenance
) -> None:
    """Write what was chosen, attribute ``lobes``, and the figures of every candidate, the simplest first.

    Parameters
    ----------
    output : path
    chosen : tuple of str
    found : list of LeftOut
        Of all candidates.
    texels : int
        By which they were judged.
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
    """Return an object's lobes: those named or, where there is a file of a choice, those chosen.

    Parameters
    ----------
    named : list of str
        By the object's definition.
    choices : list of path
        The file, or nothing where the definition names lobes.
    """
    if not choices:
        return tuple(named)
    with store.open_file(choices[0]) as file:
        return tuple(file.attribute("lobes", list))


def read_choice(choices: list) -> list[LeftOut]:
    """Return the figures of all candidates in the file of a choice, the simplest first; none without a file."""
    found = []
    for path in choices:
        with store.open_file(path) as file:
            tried, figures = file.attribute("candidates", list), [file.read(name) for name in _FIGURES]
        found += [
            LeftOut(tuple(lobes), *map(float, row)) for lobes, row in zip(tried, np.transpose(figures), strict=True)
        ]
    return found
