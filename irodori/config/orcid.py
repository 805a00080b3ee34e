"""Check digits of ORCID identifiers of researchers (ISO/IEC 7064, MOD 11-2)."""

import re

_FORM = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")


def orcid_fault(text: str) -> str:
    """Return a phrase that describes the fault of an ORCID; empty if its form and its check digit are right.

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
    """Return the web address of an ORCID. Raises ValueError if its form is wrong."""
    form = _FORM.fullmatch(text)
    if form is None:
        raise ValueError(f"the ORCID {text!r}; accepted: four groups of four digits")
    return f"https://orcid.org/{form[1]}"
