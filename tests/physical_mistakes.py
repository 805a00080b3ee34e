"""Mistakes that people make at the table, with the camera or in a table of photographs, in one place.

Each is noticed before the fit. A row says where, what becomes of the photographs, words that the message contains, the
module that writes them, and the tests that make the mistake. `test_physical_mistakes` fails where a test is missing,
where neither test nor module has the words, and where the table in `docs/troubleshooting.md` says something else.
"""

from typing import NamedTuple

#: What becomes of the photographs.
REFUSED, WARNED, CORRECTED = "refused", "warning", "corrected"
#: Where a mistake is noticed. `irodori check` and the first job of a run look at the same things in the first three.
DEFINITIONS, TABLE, FIRST_LOOK = "definitions", "table", "first look at the photographs"
CHART, INGEST, REGISTRATION = "chart", "ingest", "registration"


class Mistake(NamedTuple):
    """A mistake: what went wrong, where it is noticed, what becomes of it, words of the message, where they are tested.

    ``module`` is the file of the package that writes the words, ``tests`` are names of tests as pytest takes them.
    """

    what: str
    noticed: str
    outcome: str
    said: str
    module: str
    tests: tuple[str, ...]


_SET = "tests/rig/test_set_plausibility.py::test_a_mistake_in_a_table_is_refused_on_its_photograph"
_SESSION = "tests/rig/test_session_sees.py"
_CHECK = "tests/rig/test_check.py"
_ON_RIG = "tests/unit/test_captures_on_rig.py"
_LOOK, _WHOLE_SET = "irodori/ingest/plausibility.py", "irodori/ingest/set_plausibility.py"
_SCENES, _UNITS = "irodori/check/scenes.py", "irodori/config/cross_checks/plausible_units.py"
