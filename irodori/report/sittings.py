"""Summary of rig and lamp while photographs were taken, for the report."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Sitting:
    """The worst that the sittings of one subject have shown.

    Parameters
    ----------
    name : str
        Of the object or camera.
    photographs : int
        How many were held against the rig's limit switches.
    lost_deg : dict
        Axis: how far it stood off its count, degrees, with its sign.
    light, shift_px : float or None
        Of the drift frames: light beside the photograph that one repeats, a ratio, and how far contours lie aside,
        superpixels; None without such frames.
    """

    name: str
    photographs: int
    lost_deg: dict[str, float]
    light: float | None
    shift_px: float | None


def sittings(records: Sequence) -> list[Sitting]:
    """Return what ``sittings.html.j2`` shows of the records of sessions; those without a rig have no line.

    Parameters
    ----------
    records : sequence of path
        ``RESULTS/NAME/captures/session.json``.
    """
    found = []
    for path in map(Path, records):
        record = json.loads(path.read_text(encoding="utf-8"))
        checks, drift = record.get("position", []), record["drift"]  # records of old versions hold no position
        if not checks and not drift:
            continue
        axes = dict.fromkeys(name for check in checks for name in check["lost_deg"])
        lost = {name: max((check["lost_deg"].get(name, 0.0) for check in checks), key=abs) for name in axes}
        light = max((frame["light"] for frame in drift), key=lambda ratio: abs(ratio - 1.0), default=None)
        shift = max((frame["shift_px"] for frame in drift if frame["shift_px"] is not None), default=None)
        count = sum(check["photographs"] for check in checks)
        found.append(Sitting(path.parents[1].name, count, lost, light, shift))
    return found
