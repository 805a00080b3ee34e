"""Errors of the angles under which light and camera see a surface: by registration, or as the configuration states."""

import math
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from irodori.core import store

#: Value of ``fit.pose_error_deg`` that leaves the errors to registration; error of an angle of the rig without one.
AUTO: Literal["auto"] = "auto"
UNREGISTERED_DEG = 0.05
#: Origins of the errors: registration of the object, the configuration, or `UNREGISTERED_DEG`.
REGISTERED, STATED, ASSUMED = "registered", "stated", "assumed"
DATASET = "angle_error"
ANGLES = ("theta_i", "theta_r", "theta_h", "phi")


@dataclass(frozen=True)
class AngleErrors:
    """Standard deviations of θ_i, the angle of incidence, and of φ, between normal and half vector.

    Parameters
    ----------
    theta_i_deg, phi_deg : float
        Degrees.
    source : str
        Origin of the errors: `REGISTERED`, `STATED` or `ASSUMED`.
    """

    theta_i_deg: float
    phi_deg: float
    source: str

    @classmethod
    def of_rig(cls, sigma_deg: float, source: str) -> "AngleErrors":
        """Return the errors if the angles of light and camera have independent errors of ``sigma_deg``."""
        return cls(sigma_deg, sigma_deg / math.sqrt(2.0), source)

    @property
    def variances(self) -> tuple[float, float]:
        """Variances of θ_i and φ, rad²."""
        return math.radians(self.theta_i_deg) ** 2, math.radians(self.phi_deg) ** 2

    @property
    def rig_deg(self) -> float:
        """Error of light and camera, independent of each other, that gives φ its error, degrees."""
        return self.phi_deg * math.sqrt(2.0)

    def __str__(self) -> str:
        origin = {REGISTERED: "by registration", STATED: "as stated", ASSUMED: "as assumed without registration"}
        angles = f"{self.theta_i_deg:.3f} deg of incidence, {self.phi_deg:.3f} deg to the half vector"
        return f"{angles}, {origin[self.source]}"

    def plain(self) -> dict[str, float | str]:
        """Return the errors as an attribute of a file."""
        return asdict(self)


def write_registered(out: store.Writer, rms_deg) -> None:
    """Write the standard deviations of `ANGLES`, (4,) degrees, to a file with the coordinate ``angle``."""
    quantity = "standard deviation of the angle, by registration"
    out.write(DATASET, np.array(rms_deg), units="deg", dims="angle", quantity=quantity)


def read_registered(*paths) -> np.ndarray | None:
    """Return the standard deviations of `ANGLES` by registration, (4,) degrees; None if no file has any.

    Parameters
    ----------
    *paths : path
        File of a registration, or tile of observations; of several, such as an object's placements, the root mean
        square is returned.
    """
    found = []
    for path in paths:
        with store.open_file(path) as file:
            if DATASET in file:
                file.require_axes({DATASET: "angle"}, angle=len(ANGLES))
                found.append(file.read(DATASET))
    return np.sqrt(np.mean(np.square(found), axis=0)) if found else None


def registered_errors(path) -> AngleErrors | None:
    """Return the errors by registration in a tile of observations; None if its object was not registered."""
    found = read_registered(path)
    return None if found is None else AngleErrors(float(found[0]), float(found[3]), REGISTERED)


def errors_in_use(stated: Literal["auto"] | float, registered: AngleErrors | None) -> AngleErrors:
    """Return the errors that a fit uses: those stated, else by registration, else those of an unregistered object.

    Parameters
    ----------
    stated : "auto" or float
        ``fit.pose_error_deg``.
    registered : AngleErrors, optional
        By registration.
    """
    if stated != AUTO:
        return AngleErrors.of_rig(float(stated), STATED)
    return registered or AngleErrors.of_rig(UNREGISTERED_DEG, ASSUMED)
