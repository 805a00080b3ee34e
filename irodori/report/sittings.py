"""Summary of the checks of rig and lamp during photography, for the report."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Sitting:
    """Largest deviations of rig and lamp in all photographing sessions of one object or camera.

    Parameters
    ----------
    name : str
        Name of the object or camera.
    photographs : int
        Number of photographs covered by checks of the rig's position against its limit switches.
    never_checked : int
        Number of photographs after which the rig lost its count of steps before such a check.
    lost_deg : dict
        Axis -> largest difference between true and counted position, degrees, with its sign.
    light, shift_px : float or None
        From the drift frames, repeats of an earlier photograph: ratio of light to that photograph that is furthest from
        1, and largest shift of contours, superpixels; None without such frames.
    """

    name: str
    photographs: int
    never_checked: int
    lost_deg: dict[str, float]
    light: float | None
    shift_px: float | None


def sittings(records: Sequence) -> list[Sitting]:
    """Return the data of ``sittings.html.j2``; session records without position checks and drift frames are left out.

    Parameters
    ----------
    records : sequence of path
        ``RESULTS/NAME/captures/session.json``.
    """
    found = []
    for path in map(Path, records):
        record = json.loads(path.read_text(encoding="utf-8"))
        checks, drift = record.get("position", []), record["drift"]  # records of old versions hold no position
        never = len(record.get("never_checked", []))
        if not checks and not drift and not never:
            continue
        axes = dict.fromkeys(name for check in checks for name in check["lost_deg"])
        lost = {name: max((check["lost_deg"].get(name, 0.0) for check in checks), key=abs) for name in axes}
        light = max((frame["light"] for frame in drift), key=lambda ratio: abs(ratio - 1.0), default=None)
        shift = max((frame["shift_px"] for frame in drift if frame["shift_px"] is not None), default=None)
        count = sum(check["photographs"] for check in checks)
        found.append(Sitting(path.parents[1].name, count, never, lost, light, shift))
    return found
