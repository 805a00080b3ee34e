"""A scene's plan in the form in which pictures are rendered by it, read from ``plan.yaml``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml


@dataclass(frozen=True)
class ScenePlan:
    """Decisions of a plan for a scene.

    Parameters
    ----------
    scene : str
        Name of the scene.
    integrator : str
        Kind of the integrator that the plan is for, ``interactive`` or ``reference``.
    tolerance_ciede2000 : float
        Colour error that a picture may have, CIEDE2000.
    predicted_delta_e : float
        Colour error that the plan expects, CIEDE2000.
    decisions : mapping
        Value of each decision by its name, such as ``light_bases`` or ``samples``.
    quadrature : mapping, optional
        ``samples`` and ``xyz_weights`` of the wavelengths of the representation ``quadrature``.
    """

    scene: str
    integrator: str
    tolerance_ciede2000: float
    predicted_delta_e: float
    decisions: Mapping[str, Any]
    quadrature: Mapping[str, list] | None = None

    @classmethod
    def of(cls, document: Mapping[str, Any], file="plan.yaml") -> "ScenePlan":
        """Return the plan in the content of a file, see `irodori.rendering.planning.plan_file.document_of`.

        Raises
        ------
        InputError
            If one of a plan's keys is missing.
        """
        try:
            return cls(
                scene=document["scene"],
                integrator=document["integrator"],
                tolerance_ciede2000=float(document["tolerance_ciede2000"]),
                predicted_delta_e=float(document["predicted_delta_e"]),
                decisions={name: decision["value"] for name, decision in document["decisions"].items()},
                quadrature=document.get("quadrature"),
            )
        except (KeyError, TypeError, ValueError, AttributeError):
            raise InputError(file, "", "no whole plan", "the file as the rule plan_scene writes it") from None

    @property
    def figures(self) -> dict[str, object]:
        """Numbers of the plan that are repeated in the figures of a picture."""
        return {"tolerance_ciede2000": self.tolerance_ciede2000, "predicted_delta_e": self.predicted_delta_e}


def read_plan(path) -> ScenePlan:
    """Read a plan from a YAML file.

    Raises
    ------
    InputError
        If the file is no YAML file or no plan.
    """
    return ScenePlan.of(read_yaml(path), path)
