"""The file of the lobes and the coat that were chosen for an object, with the prediction errors of all candidates."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from irodori.config.cross_checks.object_lobes import AUTO
from irodori.core import store
from irodori.reflection.coat import SUM
from irodori.reflection.registry import DEFAULT_LOBES

#: Error of left-out readings, in stated errors, from which on no form of gloss explains the photographs. Errors of the
#: default objects' readings are 0.7 to 1.7 with eight photographs or more, 7 to 26 where the lamp failed or drifted.
CONTRADICTED = 2.0
_FIGURES = {
    "deviation": "median error of a left-out reading over its stated standard deviation",
    "behind": "mean log(1 + z^2) of left-out readings over that of the best candidate",
    "behind_error": "standard error of behind, over photographs",
}


@dataclass(frozen=True)
class LeftOut:
    """Cross-validation of one candidate: errors in predicting photographs that the fit left out.

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
    coat : str
        Coat of the candidate, see `irodori.reflection.coat`.
    """

    lobes: tuple[str, ...]
    deviation: float
    behind: float
    behind_error: float
    coat: str = SUM

    @property
    def text(self) -> str:
        """Names of the lobes joined as a sum, and a coat that is coupled: ``gaussian + ggx, coupled coat``."""
        return model_text(self.lobes, self.coat)


class Comparison(NamedTuple):
    """Candidates for the reflection model of an object."""

    candidates: tuple[LeftOut, ...] = ()  # the simplest first
    painted: float | None = None  # share of the compared texels with the colour of a paint; None without paints
    favours_tails: bool = False  # whether too few had: by single texels, lobes with long tails are favoured
    tells_misfit: bool = True  # whether there are photographs enough: of three, two do not tell the gloss of the third

    def misfit(self, lobes: Iterable[str], coat: str) -> float:
        """Return by how many stated errors a candidate predicts left-out readings wrongly; 1 up to `CONTRADICTED`."""
        of = [one.deviation for one in self.candidates if (one.lobes, one.coat) == (tuple(lobes), coat)]
        return of[0] if self.tells_misfit and of and of[0] > CONTRADICTED else 1.0


#: That of a material whose lobes no photographs were asked about.
NOTHING_COMPARED = Comparison()


class Candidate(NamedTuple):
    """Form of the reflection model that an object may have: the lobe of each gloss component, and the coat."""

    lobes: tuple[str, ...]
    coat: str = SUM


def model_text(lobes: tuple[str, ...] | list[str], coat: str) -> str:
    """Return the names of an object's lobes joined as a sum, and its coat if that is coupled."""
    return " + ".join(lobes) + (f", {coat} coat" if coat != SUM else "")


def write_choice(
    output,
    chosen: Candidate,
    compared: Comparison,
    texels: int,
    provenance: store.Provenance,
) -> None:
    """Write the choice (attributes ``lobes`` and ``coat``) and the prediction errors of every candidate in order.

    Parameters
    ----------
    output : path
    chosen : Candidate
    compared : Comparison
    texels : int
        Number of texels that the prediction errors come from.
    provenance : Provenance
    """
    found = compared.candidates
    with store.create(output, provenance) as out:
        out.coordinate("candidate", [one.text for one in found], units="1", quantity="lobes, as a sum, and coat")
        for name, quantity in _FIGURES.items():
            values = np.array([getattr(one, name) for one in found])
            out.write(name, values, units="1", dims="candidate", quantity=quantity)
        tried = {"candidates": [list(one.lobes) for one in found], "coats": [one.coat for one in found]}
        attributes = {"lobes": list(chosen.lobes), "coat": chosen.coat, **tried, "texels": texels}
        attributes |= {"favours_tails": compared.favours_tails, "tells_misfit": compared.tells_misfit}
        if compared.painted is not None:
            attributes["painted"] = compared.painted
        for name, value in attributes.items():
            out.attribute(name, value)


def chosen_model(choice) -> dict:
    """Return lobes and coat in a choice's file as options of a fit."""
    with store.open_file(choice) as file:
        return {"lobes": tuple(file.attribute("lobes", list)), "coat": file.attribute("coat", str)}


def model_before_choice(lobes: list[str], coat: str) -> dict:
    """Return lobes and coat that an object's definition names; those of equation (5) in place of ``auto``."""
    return {"lobes": DEFAULT_LOBES if AUTO in lobes else tuple(lobes), "coat": SUM if coat == AUTO else coat}


def read_choice(choice) -> Comparison:
    """Return the comparison in a choice's file."""
    with store.open_file(choice) as file:
        tried, coats = file.attribute("candidates", list), file.attribute("coats", list)
        figures = np.transpose([file.read(name) for name in _FIGURES])
        painted = file.attribute("painted", float) if file.has_attribute("painted") else None
        favours_tails, tells_misfit = (file.attribute(name, bool) for name in ("favours_tails", "tells_misfit"))
    found = [
        LeftOut(tuple(lobes), float(row[0]), float(row[1]), float(row[2]), coat)
        for lobes, coat, row in zip(tried, coats, figures, strict=True)
    ]
    return Comparison(tuple(found), painted, favours_tails, tells_misfit)
