"""Report on the fit of an object: photographs that contradict the gloss of its paints."""

import pytest

from irodori.fitting.joint_gloss import HIGHLIGHTS, NOTHING, PHOTOGRAPH, Contradiction
from irodori.report.html_page import fragment


@pytest.mark.parametrize(
    ("left_out", "words"),
    [
        (HIGHLIGHTS, "clip without a flag"),
        (PHOTOGRAPH, "not without pose-2,"),
        (NOTHING, "most of all pose-2. Perhaps"),
    ],
)
def test_photographs_that_contradict_the_gloss_are_named_with_what_was_done_about_it(left_out, words):
    found = Contradiction(3.14159, left_out, 2).told(["pose-0", "pose-1", "pose-2"])
    text = " ".join(fragment("contradiction.html.j2", contradiction=found).split())
    assert "by 3.1 times the expected errors" in text and words in text and "pose-1" not in text


def test_nothing_is_said_where_no_photograph_contradicts():
    assert not fragment("contradiction.html.j2", contradiction={}).strip()
