"""Conversion between numbers and the text choices that libgphoto2 offers for camera settings.

Cameras of different makers name one setting differently and write one value differently: an exposure time is ``1/50``,
``0.0200s`` or ``10/25``, an aperture ``8`` or ``f/8``.
"""

import difflib
import math
import re
from collections.abc import Iterable

#: Names of libgphoto2's widgets for each setting; the first that a camera has is used. A Nikon's ``shutterspeed`` is
#: rounded to 0.1 ms, its ``shutterspeed2`` is not.
WIDGETS = {
    "iso": ("iso",),
    "f_number": ("aperture", "f-number"),
    "exposure_s": ("shutterspeed2", "shutterspeed"),
    "white_balance": ("whitebalance",),
    "image_format": ("imageformat", "imagequality"),
    "capture_target": ("capturetarget",),
}
#: Settings with numeric choices.
NUMERIC = ("iso", "f_number", "exposure_s")
#: Relative difference up to which a choice is the wanted number: 0.0167 is 1/60, and 0.033 is not 1/30.
TOLERANCE = 0.005

_NUMBER = re.compile(
    r"(?:f\s*/\s*|f(?=\d)|iso\s*)?(\d+(?:\.\d+)?)(?:\s*/\s*(\d+(?:\.\d+)?))?\s*(?:s|sec)?", re.IGNORECASE
)


def parse_number(text: str) -> float | None:
    """Return the number that the text of a choice represents, such as ``1/50``, ``0.0200s``, ``f/8`` or ``ISO 100``.

    Returns
    -------
    float or None
        Seconds for an exposure time; None for words such as ``Auto`` or ``Bulb``.
    """
    match = _NUMBER.fullmatch(text.strip())
    if not match:
        return None
    below = float(match[2]) if match[2] else 1.0
    return float(match[1]) / below if below else None


def find_choice(setting: str, wanted: float | str, choices: Iterable[str]) -> str | None:
    """Return the choice that equals the wanted value, None if there is none.

    Parameters
    ----------
    setting : str
        One of WIDGETS; those in NUMERIC compare numbers within TOLERANCE, the others compare text ignoring case.
    wanted : float or str
    choices : iterable of str
    """
    if setting in NUMERIC:
        near = _nearest_number(float(wanted), choices)
        return near if near is not None and means(setting, near, wanted) else None
    return next((choice for choice in choices if means(setting, choice, wanted)), None)


def means(setting: str, choice: str, wanted: float | str) -> bool:
    """Return whether a choice of a setting equals the wanted value."""
    if setting not in NUMERIC:
        return choice.strip().casefold() == str(wanted).strip().casefold()
    number = parse_number(choice)
    return number is not None and math.isclose(number, float(wanted), rel_tol=TOLERANCE)


def offer(setting: str, wanted: float | str, choices: Iterable[str]) -> str:
    """Return a phrase with the choices of a camera that lacks a value: ``nearest 1/50; on offer: 1/40, 1/50``."""
    choices = list(choices)
    if setting in NUMERIC:
        near = _nearest_number(float(wanted), choices)
    else:
        folded = {choice.casefold(): choice for choice in choices}
        close = difflib.get_close_matches(str(wanted).casefold(), folded, n=1, cutoff=0.3)
        near = folded[close[0]] if close else None
    listed = f"on offer: {', '.join(choices) or 'nothing'}"
    return f"nearest {near}; {listed}" if near is not None else listed


def _nearest_number(wanted: float, choices: Iterable[str]) -> str | None:
    """Return the choice with the smallest ratio to a positive number."""
    numbers = [(choice, number) for choice in choices if (number := parse_number(choice))]
    return min(numbers, key=lambda pair: abs(math.log(pair[1] / wanted)), default=(None, 0.0))[0]
