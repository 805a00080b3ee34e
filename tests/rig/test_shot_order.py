"""The order of the photographs: fewest steps by hand, then least travel, and what the session will take."""

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made

from irodori.capture.rig.devices import Axis
from irodori.capture.setup_steps import hand_settings, motor_targets
from irodori.capture.shot_order import PHASES, estimate_s, order_shots
from irodori.config.capture_table import SUBJECTS, Pose, Shot, expand_poses
from irodori.config.models import PoseGroup

CAMERA = Axis("camera_deg", 0.0, 140.0, 0.1, 10.0, 20.0)
TURN = Axis("turn_deg", 0.0, 359.5, 0.5, 20.0, 40.0)
LIGHT = Axis("light_deg", 35.0, 125.0, 0.5, 5.0, 10.0)
TILT = Axis("tilt_deg", 0.0, 45.0, 0.5, 5.0, 5.0)
ONE = {"camera_deg": CAMERA}
TWO = {"camera_deg": CAMERA, "turn_deg": TURN}
ALL = {"light_deg": LIGHT, **TWO, "tilt_deg": TILT}
NONE = {}
START = {"camera_deg": 0.0, "light_deg": 35.0, "tilt_deg": 0.0, "turn_deg": 0.0}
#: A step by hand that takes longer than all travel of a small plan.
HAND_S = 1000.0


def plan(lights, cameras, tilts=(0.0,), turns=(0.0,), *, states=("out", "in"), exposures=(0.02,), role="object"):
    groups = [{"light_deg": lights, "camera_deg": cameras, "tilt_deg": tilts, "turn_deg": turns}]
    return [
        Shot(f"{role}-{pose.name}-{state}-{exposure:g}", role, pose, state, exposure)
        for pose in expand_poses(made(Sequence[PoseGroup], groups))
        for state in states
        for exposure in exposures
    ]


def bracket(shot: Shot) -> tuple:
    return shot.role, shot.pose, shot.filter


def combinations(shots, axes) -> int:
    return len({tuple(sorted(hand_settings(shot, axes).items())) for shot in shots})


def least(shots, axes, start, by_hand):
    """Return (steps, settings, travel) of the best of all orders of brackets."""
    phases = [
        {bracket(shot): [s for s in shots if bracket(s) == bracket(shot)] for shot in shots if shot.role == role}
        for role in PHASES
    ]
    best = None
    for orders in itertools.product(*(itertools.permutations(phase.values()) for phase in phases)):
        found = estimate_s([shot for order in orders for group in order for shot in group], axes, start, HAND_S)
        cost = (found.steps if by_hand else 0, found.settings if by_hand else 0, found.travel_s)
        best = cost if best is None else min(best, cost)
    return best


def of_values(values):
    return st.sampled_from(values)


poses = st.builds(
    Pose,
    of_values([35.0, 45.0, 65.0, 90.0]),
    of_values([0.0, 5.0, 20.0, 21.0, 60.0, 140.0]),
    of_values([0.0, 15.0]),
    of_values([0.0, 90.0, 180.0]),
)
shots = st.builds(
    lambda role, pose, state, exposure: Shot("", role, pose, state, exposure),
    of_values(["dark", "white", "chart", "object", "object", "object", "environment"]),
    poses,
    of_values(["out", "in"]),
    of_values([0.02, 0.1, 0.5]),
)
starts = st.one_of(
    st.just({}),
    st.just(START),
    st.builds(lambda p: {"camera_deg": p.camera_deg, "turn_deg": p.turn_deg, "filter": "in"}, poses),
)
rigs = st.sampled_from([NONE, ONE, TWO, ALL])
costs = st.sampled_from([0.0, HAND_S])


# ---- whatever the shots


def test_every_role_has_its_place_and_what_calibrates_comes_first():
    assert sorted(PHASES) == sorted(SUBJECTS) and PHASES[:4] == ("dark", "white", "chart", "object")


@settings(deadline=None)
@given(st.lists(shots, max_size=25), rigs, starts, costs)
def test_every_order_keeps_its_promises(given_shots, axes, start, cost):
    ordered = order_shots(given_shots, axes, start, cost)
    # A permutation, and always the same one.
    assert sorted(map(repr, ordered)) == sorted(map(repr, given_shots))
    assert order_shots(given_shots, axes, start, cost) == ordered
    # What calibrates comes first.
    roles = [PHASES.index(shot.role) for shot in ordered]
    assert roles == sorted(roles)
    # Each bracket once, the shortest exposure first.
    groups = [(key, list(group)) for key, group in itertools.groupby(ordered, bracket)]
    assert len({key for key, _ in groups}) == len(groups)
    assert all(a.exposure_s <= b.exposure_s for _, group in groups for a, b in itertools.pairwise(group))
    # No combination of settings by hand is set twice.
    if cost:
        assert estimate_s(ordered, axes, start, cost).steps <= combinations(given_shots, axes)


@settings(deadline=None)
@given(st.lists(shots, max_size=25), rigs, starts, costs)
def test_no_order_is_worse_than_the_given_one(given_shots, axes, start, cost):
    as_given = sorted(given_shots, key=lambda shot: PHASES.index(shot.role))
    before = estimate_s(as_given, axes, start, cost)
    after = estimate_s(order_shots(given_shots, axes, start, cost), axes, start, cost)
    if cost:
        assert (after.steps, after.settings) <= (before.steps, before.settings)
    if not cost or (after.steps, after.settings) == (before.steps, before.settings):
        assert after.travel_s <= before.travel_s + 1e-5


@settings(deadline=None, max_examples=40)
@given(st.lists(shots, min_size=1, max_size=6), st.sampled_from([ONE, TWO, ALL]), starts, costs)
def test_a_small_plan_is_within_a_tenth_of_the_best_of_all_orders(given_shots, axes, start, cost):
    found = estimate_s(order_shots(given_shots, axes, start, cost), axes, start, HAND_S)
    steps, changes, travel_s = least(given_shots, axes, start, bool(cost))
    if cost:
        assert (found.steps, found.settings) == (steps, changes)
    assert found.travel_s <= 1.1 * travel_s + 1e-6


# ---- plans as they are


@pytest.mark.parametrize("axes", [ONE, TWO])
def test_a_full_plan_changes_one_setting_at_a_time(axes):
    lights, tilts = [35.0, 45.0, 65.0, 85.0], [0.0, 15.0, 30.0]
    full = plan(lights, [0.0, 20.0, 40.0], tilts, [0.0, 90.0])
    found = estimate_s(order_shots(full, axes, {}, HAND_S), axes, {}, HAND_S)
    blocks = combinations(full, axes)
    # The first step states subject, angles and filter; each later one changes a single setting.
    first = len(hand_settings(full[0], axes)) - 2  # but the lamp's azimuth, in the plane, and the first placement
    assert (found.steps, found.settings) == (blocks, first + blocks - 1)


def test_the_camera_sweeps_to_and_fro_without_going_back():
    full = plan([35.0, 45.0, 65.0], [0.0, 10.0, 20.0, 50.0])
    ordered = order_shots(full, ONE, START, HAND_S)
    sweeps = [[s.pose.camera_deg for s in group] for _, group in
              itertools.groupby(ordered, lambda s: (s.pose.light_deg, s.filter))]  # fmt: skip
    up = [0.0, 10.0, 20.0, 50.0]
    assert sweeps == [up, up[::-1]] * 3
    one_sweep = sum(CAMERA.travel_s(a, b) for a, b in itertools.pairwise(up))
    assert estimate_s(ordered, ONE, START, HAND_S).travel_s == pytest.approx(6 * one_sweep)


def test_at_one_camera_angle_the_filter_states_of_a_capture_follow_each_other():
    # Changing the light first would take as many steps.
    ordered = order_shots(plan([35.0, 45.0, 65.0], [20.0]), ONE, {}, HAND_S)
    assert [s.pose.light_deg for s in ordered] == [35.0, 35.0, 45.0, 45.0, 65.0, 65.0]
    assert [s.filter for s in ordered[::2]] != [s.filter for s in ordered[1::2]]


@pytest.mark.parametrize("axes", [ONE, TWO, ALL])
def test_where_hands_cost_nothing_the_shots_of_a_capture_stay_together(axes):
    full = plan([35.0, 45.0, 65.0], [0.0, 10.0, 50.0], [0.0, 15.0], exposures=(0.1, 0.02))
    full = full[::2] + full[1::2]
    ordered = order_shots(full, axes, START, 0.0)
    captures = [key for key, _ in itertools.groupby(ordered, lambda s: s.pose)]
    assert len(captures) == len(set(captures))


def test_where_hands_cost_nothing_the_camera_sweeps_once():
    found = estimate_s(order_shots(plan([35.0, 45.0, 65.0], [50.0, 0.0, 20.0]), ONE, START, 0.0), ONE, START, 0.0)
    assert found.travel_s == pytest.approx(CAMERA.travel_s(0.0, 20.0) + CAMERA.travel_s(20.0, 50.0))


def test_a_plan_with_gaps_is_close_to_its_bound():
    # A plan in which the tilt depends on the light: each block once, and few changes beyond one a step.
    full = [s for light in range(35, 95, 5) for tilt in range(0, light - 30, 5) for s in
            plan([float(light)], [0.0, 30.0], [float(tilt)])]  # fmt: skip
    found = estimate_s(order_shots(full, ONE, {}, HAND_S), ONE, {}, HAND_S)
    blocks = combinations(full, ONE)
    assert found.steps == blocks
    assert found.settings <= 5 + (blocks - 1) + 0.02 * blocks


def test_a_thousand_poses_of_all_motors_take_no_longer_than_nested_sweeps():
    full = plan([35.0, 55.0, 75.0, 95.0], [float(c) for c in range(0, 140, 14)], [0.0, 15.0, 30.0],
                [0.0, 40.0, 80.0, 120.0, 160.0, 200.0, 240.0, 280.0], states=("out",))  # fmt: skip
    ordered = order_shots(full[::-1], ALL, START, 0.0)
    found, nested = (estimate_s(order, ALL, START, 0.0) for order in (ordered, full))
    # To and fro saves the way back: more than a tenth.
    assert found.travel_s < 0.9 * nested.travel_s
    # Every pose is at least one step of the quickest axis away from another.
    quickest = min(
        CAMERA.travel_s(0.0, 14.0), TURN.travel_s(0.0, 40.0), LIGHT.travel_s(35.0, 55.0), TILT.travel_s(0.0, 15.0)
    )
    assert found.travel_s <= 1.1 * quickest * (len(full) - 1)


# ---- dark, white and chart


def test_dark_frames_come_first_and_move_nothing():
    dark = [Shot(f"d{i}", "dark", Pose(0.0, 0.0), "out", 0.5) for i in range(3)]
    white = plan([45.0], [20.0], role="white", exposures=(0.05, 0.02))
    chart = plan([45.0], [20.0], role="chart")
    thing = plan([45.0, 65.0], [20.0, 40.0])
    ordered = order_shots([*thing, *chart, *white, *dark], ONE, START, HAND_S)
    assert [s.role for s in ordered] == ["dark"] * 3 + ["white"] * 4 + ["chart"] * 2 + ["object"] * 8
    assert ordered[:3] == dark
    assert estimate_s(dark, ONE, START, HAND_S).travel_s == 0.0
    assert motor_targets(dark[0], ONE) == {}
    # The cap, then two filter states of white, chart and two lights of the object: nine steps for nine combinations.
    assert estimate_s(ordered, ONE, START, HAND_S).steps == combinations(ordered, ONE) == 9


def test_what_already_stands_is_not_set_again():
    full = plan([45.0, 65.0], [20.0])
    stands = {"subject": "object", "light_deg": 65.0, "tilt_deg": 0.0, "turn_deg": 0.0, "filter": "in"}
    ordered = order_shots(full, ONE, stands, HAND_S)
    assert (ordered[0].pose.light_deg, ordered[0].filter) == (65.0, "in")
    found = estimate_s(ordered, ONE, stands, HAND_S)
    assert (found.steps, found.settings) == (3, 3)


def test_a_cost_below_zero_is_refused():
    for cost in (-1.0, float("nan")):
        with pytest.raises(ValueError, match="manual_cost_s"):
            order_shots([], ONE, {}, cost)


# ---- the estimate


def test_the_estimate_adds_up():
    full = plan([45.0, 65.0], [0.0, 30.0], states=("out",), exposures=(0.5, 2.0))
    found = estimate_s(full, ONE, {"camera_deg": 0.0}, 60.0, overhead_s=3.0, settle_s=62.0)
    assert (found.shots, found.steps, found.settings) == (8, 2, 6)
    assert found.hand_s == 120.0 and found.overhead_s == 24.0 and found.exposure_s == 10.0
    there = CAMERA.travel_s(0.0, 30.0)
    assert found.travel_s == pytest.approx(3 * there)
    # Three moves: to 30 degrees, back to 0 while the light is set (60 of the 62 seconds), to 30 degrees.
    assert found.settle_s == pytest.approx(62.0 + 2.0 + 62.0)
    assert found.total_s == pytest.approx(120.0 + 24.0 + 10.0 + 126.0 + 3 * there)
    parts = "2 hand steps 2 min, travel 10 s, settling 2 min, exposure 10 s, overhead 24 s"
    assert str(found) == f"8 shots, about 5 min: {parts}"


def test_a_rig_settles_after_each_move_and_not_between_the_exposures_of_one_place():
    full = plan([45.0], [0.0, 30.0], states=("out",), exposures=(0.5, 2.0))
    assert estimate_s(full, ONE, {"camera_deg": 0.0}, 0.0, settle_s=0.5).settle_s == 0.5
    assert estimate_s(full, ONE, {}, 0.0, settle_s=0.5).settle_s == 1.0, "nobody knows where it stands: it may move"


def test_axes_that_move_together_take_the_time_of_the_slowest():
    both = [
        Shot("", "object", Pose(45.0, 0.0), "out", 1.0),
        Shot("", "object", Pose(45.0, 10.0, 0.0, 200.0), "out", 1.0),
    ]
    assert estimate_s(both, TWO, START, 0.0).travel_s == pytest.approx(TURN.travel_s(0.0, 200.0))


def test_a_long_session_is_told_in_hours():
    full = plan([45.0], [0.0], states=("out",), exposures=tuple(3600.0 - i for i in range(3)))
    assert str(estimate_s(full, ONE, {}, 0.0)).startswith("3 shots, about 3 h 00 min: 1 hand step 0 s, ")


def test_no_shots_take_no_time():
    assert order_shots([], ONE, {}, HAND_S) == [] and estimate_s([], ONE, {}, HAND_S).total_s == 0.0
