"""Tolerances and plan overrides of a scene that are refused or accepted."""

import pytest
from made import made

from irodori.config.cross_checks.plan_overrides import check_plan
from irodori.config.models import Scene
from irodori.core.errors import InputError


def scene(kind, tolerance=1.0, **plan):
    return made(Scene, {"integrator": {"kind": kind}, "plan": plan, "tolerance_ciede2000": tolerance})


@pytest.mark.parametrize(
    ("definition", "field"),
    [
        (scene("interactive", None, nodes=6), "plan"),
        (scene("interactive", samples=64), "plan.samples"),
        (scene("reference", max_bounces=2), "plan.max_bounces"),
        (scene("interactive", nodes=6, representation="coefficients"), "plan.nodes"),
    ],
)
def test_what_nothing_would_read_is_refused(definition, field):
    with pytest.raises(InputError) as caught:
        check_plan(definition, "scene.yaml")
    assert caught.value.field == field and caught.value.accepted


@pytest.mark.parametrize(
    "definition",
    [
        scene("interactive", None),
        scene("reference"),
        scene("interactive", nodes=6),
        scene("interactive", gloss=[], representation="coefficients"),
        scene("reference", samples=64),
    ],
)
def test_what_a_plan_reads_is_accepted(definition):
    check_plan(definition, "scene.yaml")
