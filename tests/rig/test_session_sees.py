"""A session that looks at its photographs: what is wrong is said on its shot, what is right is kept."""

import json
import math

import numpy as np
import pytest
from accidents import Accident, Mishap
from made import made
from sessions import MADE, ROOT, assert_whole, definitions

from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator, OperatorAbort
from irodori.capture.session import Session, take_stock
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.capture.stage import Target, capture_object
from irodori.config.capture_table import FILTERS, Pose, Shot, read_captures
from irodori.config.models import Camera, Object, Rig
from irodori.core.errors import InputError
from irodori.ingest.first_look import check_captures
from irodori.ingest.plausibility import Look, Series
from irodori.simulation.virtual_rig.bench import Bench

POSES = [{"light_deg": [45.0], "camera_deg": [0.0, 15.0, 30.0]}]


class Person(AutoOperator):
    """Sets the bench, and answers as told when a photograph is doubted."""

    attended = True

    def __init__(self, bench: Bench, answers) -> None:
        super().__init__(bench.set)
        self.answers, self.told = list(answers), []

    def judge(self, doubt):
        self.told.append(doubt)
        answer = self.answers.pop(0)
        if answer == "stop":
            raise OperatorAbort("stopped by the person at the bench")
        return answer


@pytest.fixture
def bench():
    return Bench()


def plate(bench: Bench, poses=POSES, seen=None):
    """Return the photographs of a plate in their order, and a camera that looks at it."""
    definition, camera, rig = definitions(poses=poses)
    subject, camera, rig = made(Object, definition), made(Camera, camera), made(Rig, rig)
    planned = object_shots(subject, camera, ".dng")
    eye = Accident(camera, rig, bench, "plate", planned, subject)
    eye.seen = seen
    eye.happen("", Mishap())
    return planned, eye


def hold(folder, planned, eye, operator):
    journal = Journal(folder / "captures.csv")
    return Session(eye, operator, journal, None, take_stock(journal, planned)).run(planned, "plate")


def other(shot) -> str:
    return FILTERS[1 - FILTERS.index(shot.filter)]


SEEN: dict = {}
MISHAPS = {
    "cap on": (lambda shot: Mishap(subject="dark"), "black"),
    "lamp off, a lit room": (lambda shot: Mishap(lamp=0.0, ambient=0.01), "dim"),
    "wrong filter": (lambda shot: Mishap(filter=other(shot)), "filter"),
    "blown": (lambda shot: Mishap(aperture=30.0), "blown"),
    "black": (lambda shot: Mishap(aperture=1e-4), "black"),
    "identical": (lambda shot: Mishap(delivers_last=True), "identical"),
    "another body": (lambda shot: Mishap(body="spare camera"), "body"),
    "another size": (lambda shot: Mishap(cut_px=8), "size"),
    "out of focus": (lambda shot: Mishap(blur_px=2.0), "defocus"),
    "moved": (lambda shot: Mishap(moved_px=(3.0, 2.0)), "moved"),
    "door opened": (lambda shot: Mishap(ambient=0.08), "light changed"),
    "lamp at 60 %": (lambda shot: Mishap(lamp=0.6), "light changed"),
}
#: These are seen beside the other photograph of the pose: on the second of the two, whichever is at fault.
SEEN_BESIDE_THE_OTHER = {"wrong filter", "moved", "lamp at 60 %"}


@pytest.mark.parametrize(("name", "at"), [(name, at) for name in MISHAPS for at in (4, 5)])
def test_a_mistake_is_said_and_the_shot_taken_again(tmp_path, bench, name, at):
    planned, eye = plate(bench, seen=SEEN)
    mishap, kind = MISHAPS[name]
    eye.happen(planned[at].file, mishap(planned[at]))
    person = Person(bench, [""])
    tally = hold(tmp_path, planned, eye, person)
    said_on = planned[5 if name in SEEN_BESIDE_THE_OTHER else at].file
    assert len(person.told) == 1 and f"{said_on}: {kind}" in person.told[0]
    # One photograph is taken again, or both of the pose, if the person is told so.
    again = [planned[4].file, planned[5].file] if "taken again or kept together" in person.told[0] else [said_on]
    assert planned[at].file in again and all(file in person.told[0] for file in again)
    assert sorted(eye.tried) == sorted([*(shot.file for shot in planned), *again])
    assert (tally.doubted, tally.accepted, tally.taken) == (1, 0, len(planned))
    assert_whole(tmp_path, planned)


def test_the_guide_s_table_is_what_is_tried():
    text = (ROOT / "docs/rig.md").read_text(encoding="utf-8")
    table = text.partition("| mistake |")[2].partition("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    assert {name: kind.strip("`") for name, kind, _ in rows} == {name: kind for name, (_, kind) in MISHAPS.items()}
    assert {name for name, _, on in rows if on == "second"} == SEEN_BESIDE_THE_OTHER


def test_a_filter_left_out_is_said_with_the_first_pair(tmp_path, bench):
    planned, eye = plate(bench, seen=SEEN)
    eye.happen(planned[1].file, Mishap(filter="out"))
    person = Person(bench, [""])
    hold(tmp_path, planned, eye, person)
    assert len(person.told) == 1 and "filter: it is as bright as with the filter out: is it in?" in person.told[0]


def test_what_a_person_keeps_has_their_reason_in_the_table_and_is_no_measure_for_the_next(tmp_path, bench):
    planned, eye = plate(bench, seen=SEEN)
    eye.happen(planned[2].file, Mishap(blur_px=2.0))
    tally = hold(tmp_path, planned, eye, Person(bench, ["soft on purpose,\n a veil"]))
    assert tally.accepted == 1
    reasons = {shot.file: shot.taken.accepted for shot in read_captures(tmp_path / "captures.csv")}
    assert {file: why for file, why in reasons.items() if why} == {planned[2].file: "soft on purpose, a veil"}
    again, eye = plate(bench, seen=SEEN)
    assert hold(tmp_path, again, eye, AutoOperator(bench.set)).kept == len(planned)


def test_a_person_may_stop_and_the_next_session_compares_with_what_was_kept(tmp_path, bench):
    planned, eye = plate(bench, seen=SEEN)
    eye.happen(planned[4].file, Mishap(subject="dark"), 9)
    with pytest.raises(OperatorAbort):
        hold(tmp_path, planned, eye, Person(bench, ["stop"]))
    assert_whole(tmp_path, planned[:4])
    _, eye = plate(bench, seen=SEEN)
    eye.happen(planned[4].file, Mishap(body="spare camera"))
    person = Person(bench, [""])
    hold(tmp_path, planned, eye, person)
    assert "body: taken with 'Irodori spare camera'" in person.told[0] and planned[0].file in person.told[0]


def test_what_a_person_keeps_of_two_that_contradict_each_other_is_kept_with_the_reason_in_both(tmp_path, bench):
    planned, eye = plate(bench, seen=SEEN)
    eye.happen(planned[4].file, Mishap(filter=other(planned[4])))
    tally = hold(tmp_path, planned, eye, Person(bench, ["a test of the filter"]))
    reasons = {shot.file: shot.taken.accepted for shot in read_captures(tmp_path / "captures.csv")}
    assert {file for file, why in reasons.items() if why == "a test of the filter"} == {
        planned[4].file, planned[5].file,
    }  # fmt: skip
    assert (tally.doubted, tally.accepted, len(eye.tried)) == (1, 2, len(planned))


def test_an_object_that_was_moved_for_good_between_two_photographs_does_not_lead_in_circles(tmp_path, bench):
    planned, eye = plate(bench, seen=SEEN)

    class Moved(Accident):
        def capture(self, shot, path):
            if planned[4].file in self.tried:
                self.happen(shot.file, Mishap(moved_px=(3.0, 2.0)))
            super().capture(shot, path)

    moved = Moved(eye.camera, eye.rig, bench, "plate", planned, eye.subject)
    moved.happen("", Mishap())
    person = Person(bench, [""])
    hold(tmp_path, planned, moved, person)
    assert len(person.told) == 1 and moved.tried[-3:] == [planned[5].file, planned[4].file, planned[5].file]
    assert_whole(tmp_path, planned)


@pytest.mark.parametrize("times", [1, 9])
def test_where_nobody_is_asked_both_are_taken_again_once(tmp_path, bench, times):
    """A filter that was wrong once is right the second time; one that is stuck ends the session."""
    planned, eye = plate(bench, seen=SEEN)
    eye.happen(planned[4].file, Mishap(filter=other(planned[4])), times)
    if times > 1:
        with pytest.raises(InputError, match=r"filter: found it is as bright as with the filter"):
            hold(tmp_path, planned, eye, AutoOperator(bench.set))
        assert len(eye.tried) == len(planned) + 2
        return
    assert hold(tmp_path, planned, eye, AutoOperator(bench.set)).doubted == 1
    assert_whole(tmp_path, planned)


def test_where_nobody_is_asked_it_is_taken_again_once_and_then_the_session_stops(tmp_path, bench):
    planned, eye = plate(bench, seen=SEEN)
    eye.happen(planned[3].file, Mishap(subject="dark"), 9)
    with pytest.raises(InputError, match=r"black: found .*is the cap on the lens, or the lamp off") as caught:
        hold(tmp_path, planned, eye, AutoOperator(bench.set))
    assert caught.value.file == str(tmp_path / planned[3].file)
    assert eye.tried.count(planned[3].file) == 2
    assert_whole(tmp_path, planned[:3])


def test_a_file_of_an_earlier_sitting_is_known_too(tmp_path, bench):
    planned, eye = plate(bench, [{"light_deg": [45.0], "camera_deg": [5.0 * i for i in range(8)]}])
    hold(tmp_path, planned[:14], eye, AutoOperator(bench.set))
    old = (tmp_path / planned[9].file).read_bytes()

    class Repeating(Accident):
        def capture(self, shot, path):
            super().capture(shot, path)
            if shot.file == planned[15].file and self.tried.count(shot.file) == 1:
                path.write_bytes(old)

    again = Repeating(eye.camera, eye.rig, bench, "plate", planned, eye.subject)
    again.happen("", Mishap())
    person = Person(bench, [""])
    hold(tmp_path, planned, again, person)
    assert len(person.told) == 1 and f"identical: the very picture of {planned[9].file}" in person.told[0]


@pytest.mark.parametrize(
    ("role", "mishap", "kind"),
    [
        ("dark", Mishap(subject="white"), "light"),
        ("white", Mishap(lamp=1.2), "light changed"),
        ("chart", Mishap(aperture=0.3), "chart"),
    ],
)
def test_the_photographs_of_a_camera_are_looked_at_too(tmp_path, bench, role, mishap, kind):
    _, camera, rig = definitions()
    camera, rig = made(Camera, camera), made(Rig, rig)
    planned = camera_shots(camera, ".dng")
    eye = Accident(camera, rig, bench, "camera", planned)
    file = [shot.file for shot in planned if shot.role == role][-2 if role == "chart" else -1]
    eye.happen(file, mishap)
    person = Person(bench, [""])
    hold(tmp_path, planned, eye, person)
    assert len(person.told) == 1 and f"{file}: {kind}" in person.told[0]


def look(picture: np.ndarray, size=(800, 600)) -> Look:
    """Return a look at a small picture (rows, columns, 3) in which nothing is clipped."""
    whole = np.ones(picture.shape[:2], bool)
    return Look(size, str(picture.tobytes()), "", "", "", 0.0, 0.0, math.nan, picture.astype(np.float32), whole)


def test_a_pose_that_leaves_one_paint_in_the_dark_is_no_other_filter():
    """The dark paint covers most of the plate; without it the median colour is where the filter would shift it.

    Colours decide only where no photograph with the filter is planned: beside it, its transmittance does.
    """
    band = np.array([0.9, 1.0, 0.55])
    dark, bright = np.array([0.02, 0.025, 0.025]), np.array([0.32, 0.4, 0.4]) * band
    paints = np.where(np.arange(40)[None, :, None] < 22, dark, bright) * np.ones((40, 1, 1))
    shots = [Shot(f"{pose:.0f}-{state}.dng", "object", Pose(45.0, pose), state, 0.02)
             for pose in (0.0, 10.0) for state in ("out", "in")]  # fmt: skip
    series = Series(shots[:3])
    for shot, filtered in zip(shots[:2], (1.0, 0.6 * band), strict=True):
        series.add(shot, look(paints * filtered))
    assert not series.doubts(shots[2], look(0.2 * paints))
    assert [doubt.kind for doubt in series.doubts(shots[2], look(0.8 * paints * band))] == ["filter"]


def test_charts_of_a_place_have_not_the_size_of_its_panorama():
    picture = np.full((40, 40, 3), 0.4)
    panorama = Shot("a.dng", "environment", Pose(0.0, 0.0), "out", 0.02)
    charts = [Shot(f"{i}.dng", "room-chart", Pose(0.0, 0.0), "out", 0.02, chart=f"c{i}") for i in range(2)]
    series = Series([panorama, *charts])
    series.add(panorama, look(picture, (2000, 1000)))
    assert not series.doubts(charts[0], look(0.9 * picture))
    series.add(charts[0], look(0.9 * picture))
    assert [d.kind for d in series.doubts(charts[1], look(0.8 * picture, (640, 480)))] == ["size"]


# ---- drift frames


def drifting(bench, every=6):
    """Return a plan with drift frames for a rig whose camera arm is driven, and its camera."""
    definition, camera, rig = definitions(
        poses=[{"light_deg": [45.0], "camera_deg": [0.0, 10.0, 20.0, 30.0]}], motion=True
    )
    subject, camera, rig = made(Object, definition), made(Camera, camera), made(Rig, rig | {"drift_every": every})
    planned = Target("plate", camera, rig).ordered(object_shots(subject, camera, ".dng"))
    eye = Accident(camera, rig, bench, "plate", planned, subject)
    eye.happen("", Mishap())
    return planned, eye


@pytest.mark.parametrize("operator", ["auto", "prompt"])
def test_drift_frames_cost_no_step_by_hand_and_are_no_photographs_of_the_object(operator):
    definition, camera, rig = definitions(
        poses=[{"light_deg": [45.0, 60.0], "camera_deg": [0.0, 10.0, 20.0, 30.0]}], motion=True
    )
    subject, camera = made(Object, definition), made(Camera, camera)
    given = object_shots(subject, camera, ".dng")
    without, planned = (
        Target("plate", camera, made(Rig, rig | {"operator": operator, "drift_every": every})) for every in (0, 5)
    )
    frames = [shot for shot in planned.ordered(given) if shot.role == "drift"]
    assert len(frames) == 4 and planned.ordered(given)[-1].role == "drift"
    assert [shot for shot in planned.ordered(given) if shot.role != "drift"] == without.ordered(given)
    assert planned.estimate(planned.ordered(given)).steps == without.estimate(without.ordered(given)).steps
    assert {(shot.pose, shot.filter, shot.exposure_s) for shot in frames} <= {
        (shot.pose, shot.filter, shot.exposure_s) for shot in given
    }


def test_what_drift_frames_show_is_in_the_record_and_the_next_stages_leave_them_out(tmp_path, bench):
    definition, camera, rig = definitions(poses=POSES, motion=True)
    aim = Target(
        "plate", made(Camera, camera), made(Rig, rig | {"drift_every": 3}), "virtual", tmp_path / "captures.csv"
    )
    capture_object(made(Object, definition), aim, tmp_path / "session.json", MADE)
    record = json.loads((tmp_path / "session.json").read_text())
    assert record["photographs"] == 8 and len(record["drift"]) == 2
    assert all(abs(frame["light"] - 1.0) < 0.05 and frame["shift_px"] < 1.5 for frame in record["drift"])
    read = [shot.taken.read_deg for shot in read_captures(tmp_path / "captures.csv") if shot.role == "object"]
    assert [angles["camera_deg"] for angles in read] == pytest.approx([0.0, 0.0, 15.0, 15.0, 30.0, 30.0], abs=0.01)
    check_captures(tmp_path / "captures.csv", tmp_path, tmp_path / "checked.csv", ["object"])
    assert {shot.role for shot in read_captures(tmp_path / "checked.csv")} == {"object"}


@pytest.mark.parametrize(
    ("mishap", "kind"),
    [
        (Mishap(lamp=0.85), "light changed"),
        (Mishap(ambient=0.08), "light changed"),
        (Mishap(moved_px=(0.0, 4.0)), "moved"),
    ],
)
def test_a_drift_frame_names_the_photographs_in_doubt(tmp_path, bench, mishap, kind):
    planned, eye = drifting(bench)
    frames = [shot for shot in planned if shot.role == "drift"]
    eye.happen(frames[1].file, mishap)
    person = Person(bench, [""])
    hold(tmp_path, planned, eye, person)
    assert len(person.told) == 1 and frames[1].file in person.told[0] and f"{kind}: " in person.told[0]
    assert f"in doubt are the 2 photographs before it, from {planned[7].file} on" in person.told[0]
