"""Codes of units of measure: the part of UCUM, the Unified Code for Units of Measure, that files of this project use.

Things that are counted, such as pixels, have no unit in UCUM. They are written in braces, as UCUM allows for any text:
``{superpixel}``, ``1/{DN}``.
"""

import re

#: Name of the vocabulary of unit codes, stored in every file.
VOCABULARY = "UCUM 2.1, https://ucum.org"
_PREFIXED = ("m", "s", "g", "rad", "sr", "Hz", "V", "K", "Cel", "lx", "lm", "cd", "W", "J")
_ALONE = ("deg", "min", "h", "d", "%")
_PREFIX = ("p", "n", "u", "m", "c", "k", "M", "G", "")
_NAMED = "|".join(sorted([f"{p}{u}" for p in _PREFIX for u in _PREFIXED] + list(_ALONE), key=len, reverse=True))
_NOTE = r"\{[!-z|~]+\}"
_ONE = rf"(?:(?:{_NAMED})(?:-?[1-9])?(?:{_NOTE})?|[1-9]\d*(?:{_NOTE})?|{_NOTE})"
_CODE = re.compile(rf"/?{_ONE}(?:[./]{_ONE})*")


def require_unit(code: str) -> None:
    """Raise an error for text that is not a unit code.

    Parameters
    ----------
    code : str
        Unit code such as ``nm``, ``1/s``, ``W/m2/sr``, ``{px}``; ``1`` for a pure number.

    Raises
    ------
    ValueError
        If it is not a unit code; the message names the vocabulary.
    """
    if not _CODE.fullmatch(code):
        raise ValueError(f"the unit {code!r}; accepted: a code of {VOCABULARY}, such as 1, nm, deg, 1/s, {{px}}")
