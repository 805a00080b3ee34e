"""The check digit of an ORCID finds a mistyped one."""

from itertools import pairwise

import pytest

from irodori.config.orcid import orcid_address, orcid_fault

#: Those that ORCID's own documentation shows.
PUBLISHED = ["0000-0002-1825-0097", "0000-0001-5109-3700", "0000-0002-1694-233X"]


@pytest.mark.parametrize("orcid", PUBLISHED)
def test_published_numbers_are_taken_as_numbers_and_as_addresses(orcid):
    for text in (orcid, f"https://orcid.org/{orcid}"):
        assert orcid_fault(text) == "" and orcid_address(text) == f"https://orcid.org/{orcid}"


@pytest.mark.parametrize("orcid", PUBLISHED)
def test_every_mistyped_digit_and_every_exchange_of_neighbours_is_found(orcid):
    places = [place for place, letter in enumerate(orcid[:-1]) if letter != "-"]
    for place in places:
        for digit in set("0123456789") - {orcid[place]}:
            assert "a last digit" in orcid_fault(orcid[:place] + digit + orcid[place + 1 :])
    for first, second in pairwise(places):
        if orcid[first] != orcid[second]:
            letters = list(orcid)
            letters[first], letters[second] = letters[second], letters[first]
            assert orcid_fault("".join(letters))


@pytest.mark.parametrize(
    "text", ["", "0000", "0000-0002-1825-009", "0000-0002-1825-0097 ", "orcid.org/0000-0002-1825-0097"]
)
def test_what_has_another_form_is_refused(text):
    assert orcid_fault(text) == "not four groups of four digits"
    with pytest.raises(ValueError, match="accepted"):
        orcid_address(text)
