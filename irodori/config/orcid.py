"""Check digits of ORCID, the number of a researcher (ISO/IEC 7064, MOD 11-2)."""

import re

_FORM = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")


def orcid_fault(text: str) -> str:
    """Return what is wrong with an ORCID, empty where its last digit is that of the others.

    Parameters
    ----------
    text : str
        Four groups of four digits, the last of which may be X, with or without ``https://orcid.org/`` before them.
    """
    form = _FORM.fullmatch(text)
    if form is None:
        return "not four groups of four digits"
    digits = form[1].replace("-", "")
    total = 0
    for digit in digits[:-1]:
        total = (total + int(digit)) * 2
    wanted = "0123456789X"[(12 - total % 11) % 11]
    return "" if digits[-1] == wanted else f"a last digit of {digits[-1]} where that of the others is {wanted}"


def orcid_address(text: str) -> str:
    """Return the address of an ORCID, which names its person."""
    form = _FORM.fullmatch(text)
    if form is None:
        raise ValueError(f"the ORCID {text!r}; accepted: four groups of four digits")
    return f"https://orcid.org/{form[1]}"
