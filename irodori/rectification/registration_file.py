"""Files of registrations: what an object's photographs tell of it, its camera and its light, with all errors.

`irodori.rectification.object_registration` writes ``registration.h5`` of one object alone, and
`irodori.rectification.shared_camera` writes ``placement.h5``, with what other objects tell that were photographed
together with it. Later stages read ``/correction`` and ``/angle_error`` of either.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.material.angle_errors import ANGLES, write_registered
from irodori.rectification.placement_correction import COUNT, LIGHT, QUANTITIES
from irodori.rectification.told_values import is_told, told_in_words

_OWN = "own_camera_deg"  # the camera angle of one photograph, beside the quantities


class AngleChanges(NamedTuple):
    """Changes of the angles θ_i, θ_r, θ_H and φ of observations with errors of a registration, in J photographs.

    Parameters
    ----------
    products : (J, 4, 13, 13) float64
        Mean products of an angle's derivatives by the twelve common numbers and by the photograph's own camera angle;
        0 without observations.
    observations : (J,) int
        Number of observations.
    """

    products: np.ndarray
    observations: np.ndarray

    def by_photograph(self, moment: np.ndarray, light_deg: float) -> np.ndarray:
        """Return standard deviations of the angles, (J, 4) degrees; NaN in photographs without observations.

        Parameters
        ----------
        moment : (12 + J, 12 + J) float
            Mean squares and products of the errors of the common numbers and of each photograph's own camera angle.
        light_deg : float
            Standard deviation of each photograph's own light angle, degrees.
        """
        found = np.full(self.products.shape[:2], np.nan)
        for number in np.flatnonzero(self.observations):
            where = [*range(COUNT), COUNT + number]
            own = moment[np.ix_(where, where)]
            own[LIGHT, LIGHT] += light_deg**2
            found[number] = np.sqrt(np.einsum("apq,pq->a", self.products[number], own))
        return found

    def rms(self, by_photograph: np.ndarray) -> np.ndarray:
        """Return root mean squares over all observations, (4,) degrees; NaN without observations."""
        seen = self.observations > 0
        if not seen.any():
            return np.full(len(ANGLES), np.nan)
        return np.sqrt(np.average(by_photograph[seen] ** 2, axis=0, weights=self.observations[seen]))


class Estimate(NamedTuple):
    """Estimate of the numbers of a registration from the photographs of one object: a Gaussian, and the values in use.

    Parameters
    ----------
    probable : (12 + J,) float64
        Most probable values of the common numbers, in the order of `QUANTITIES`, and of the own camera angles of J
        photographs.
    covariance : (12 + J, 12 + J) float64
        Their covariance.
    prior : (12,) float64
        Standard deviations of what was typed.
    values : (12,) float64
        Corrections in use: 0 where the photographs determine nothing or change nothing significantly.
    """

    probable: np.ndarray
    covariance: np.ndarray
    prior: np.ndarray
    values: np.ndarray

    @property
    def told(self) -> np.ndarray:
        """Mask of the common values that the photographs determine, (12,) bool: error below half of the prior's.

        A light angle that they contradict is determined by them too.
        """
        told = is_told(self.sigma, self.prior)
        told[LIGHT] |= self.values[LIGHT] != 0.0
        return told

    @property
    def sigma(self) -> np.ndarray:
        """Standard errors of the most probable common values, (12,)."""
        return np.sqrt(np.diag(self.covariance))[:COUNT]

    @property
    def moment(self) -> np.ndarray:
        """Mean squares and products of the errors of the values in use, (12 + J, 12 + J).

        A number that was set back to its typed value is off by the difference from its most probable value too. The
        own camera angles are not used.
        """
        off = self.probable.copy()
        off[:COUNT] -= self.values
        return self.covariance + np.outer(off, off)

    def in_words(self) -> list[str]:
        """Return which quantities are corrected, confirmed and not determined."""
        return told_in_words(self.values, self.sigma, self.told)


class Told(NamedTuple):
    """Content of a registration's file that is combined with others.

    Parameters
    ----------
    estimate : Estimate
    light_deg : (float, float) or None
        Error of all light angles by shading and highlights and its standard error, if they show it.
    angles : AngleChanges
    captures : list of str
    remarks : list of str
        What is said of the photographs beside the quantities.
    """

    estimate: Estimate
    light_deg: tuple[float, float] | None
    angles: AngleChanges
    captures: list[str]
    remarks: list[str]


def _units() -> list[str]:
    """Return the unit codes of the quantities."""
    return ["{px}" if one.unit == "px" else one.unit for one in QUANTITIES]


def write_estimate(out: store.Writer, estimate: Estimate, captures: list[str]) -> None:
    """Write an estimate, with the names of its photographs."""
    out.coordinate("capture", captures, units="1", quantity="name of the capture")
    units = np.array(_units(), "S")
    for axis in ("quantity", "other_quantity"):
        out.coordinate(axis, [one.name for one in QUANTITIES], units="1", quantity="names of the corrections")
        out.write(f"{axis}_unit", units, units="1", dims=axis, quantity="its unit")
    for name, values, quantity in (
        ("correction", estimate.values, "to be added to what was typed"),
        ("sigma", estimate.sigma, "standard errors of the most probable values"),
        ("prior_sigma", estimate.prior, "standard deviations of what was typed"),
    ):
        out.write(name, values, units="{quantity_unit}", dims="quantity", quantity=quantity)
    common = estimate.covariance[:COUNT, :COUNT]
    about = {"units": "{quantity_unit}.{other_quantity_unit}", "dims": "quantity,other_quantity"}
    out.write("covariance", common, **about, quantity="covariance of the most probable values")
    out.attribute("quantities", [f"{one.name}, {one.unit}" for one in QUANTITIES])
    out.attribute("told", [bool(told) for told in estimate.told])
    out.attribute("captures", captures)


def write_told(out: store.Writer, told: Told) -> None:
    """Write what is combined with other objects, beside the estimate, which is written first."""
    names = [*(one.name for one in QUANTITIES), *(f"{_OWN} of {capture}" for capture in told.captures)]
    units = np.array([*_units(), *["deg"] * len(told.captures)], "S")
    for axis in ("unknown", "other_unknown"):
        out.coordinate(axis, names, units="1", quantity="quantities, and the own camera angle of each capture")
        out.write(f"{axis}_unit", units, units="1", dims=axis, quantity="its unit")
    estimate = told.estimate
    out.write("probable", estimate.probable, units="{unknown_unit}", dims="unknown", quantity="most probable values")
    about = {"units": "{unknown_unit}.{other_unknown_unit}", "dims": "unknown,other_unknown"}
    out.write("probable_covariance", estimate.covariance, **about, quantity="their covariance")
    if told.light_deg is not None:
        for name, value, quantity in zip(
            ("light_shown", "light_shown_sigma"),
            told.light_deg,
            ("error of all light angles by shading and highlights", "its standard error"),
            strict=True,
        ):
            out.write(name, value, units="deg", dims="", quantity=quantity)
    terms = [*(one.name for one in QUANTITIES), _OWN]
    for axis in ("term", "other_term"):
        out.coordinate(axis, terms, units="1", quantity="quantities, and the own camera angle of the capture")
        out.write(f"{axis}_unit", units[: COUNT + 1], units="1", dims=axis, quantity="its unit")
    out.coordinate("angle", list(ANGLES), units="1", quantity="symbol of an angle")
    out.write(
        "angle_change",
        told.angles.products,
        units="deg2/{term_unit}/{other_term_unit}",
        dims="capture,angle,term,other_term",
        quantity="mean products of the angle's derivatives over the observations of a capture",
    )
    out.write(
        "observations", told.angles.observations, units="1", dims="capture", quantity="observations of it that count"
    )
    out.attribute("remarks", told.remarks)


def write_angle_errors(out: store.Writer, rms: np.ndarray, by_photograph: np.ndarray) -> None:
    """Write the errors of the angles, (4,) and (J, 4) degrees, unless there are no observations from which to tell."""
    if not np.isfinite(rms).all():
        return
    out.coordinate("angle", list(ANGLES), units="1", quantity="symbol of an angle")
    write_registered(out, rms)
    out.write(
        "angle_error_of_capture",
        by_photograph,
        units="deg",
        dims="capture,angle",
        quantity="standard deviation of it in a capture",
    )


def read_told(path: str | Path) -> Told:
    """Read what one object's registration contributes to a combination.

    Raises
    ------
    InputError
        If the file is damaged, or was written by an earlier version.
    """
    axes = {
        "probable": "unknown",
        "probable_covariance": "unknown,other_unknown",
        "angle_change": "capture,angle,term,other_term",
        "observations": "capture",
    } | dict.fromkeys(("correction", "prior_sigma"), "quantity")
    with store.open_file(path) as file:
        captures = file.attribute("captures", list)
        size = COUNT + len(captures)
        lengths = {"unknown": size, "other_unknown": size, "capture": len(captures), "angle": len(ANGLES)}
        file.require_axes(axes, **lengths, quantity=COUNT, term=COUNT + 1, other_term=COUNT + 1)
        estimate = Estimate(
            *(file.read_within(name) for name in ("probable", "probable_covariance", "prior_sigma", "correction"))
        )
        shown = [float(file.read_within(name)) for name in ("light_shown", "light_shown_sigma") if name in file]
        return Told(
            estimate,
            (shown[0], shown[1]) if shown else None,
            AngleChanges(file.read_within("angle_change"), file.read("observations")),
            captures,
            file.attribute("remarks", list),
        )
