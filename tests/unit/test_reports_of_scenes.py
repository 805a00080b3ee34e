"""Reports of a configuration: one for each scene and camera, which covers its own scene and nothing of another."""

import json
from types import SimpleNamespace

import pytest
from definitions import PLATE_FILE, ROOT, edit, load

from irodori.config.photograph_sets import PhotographSets
from irodori.config.reports import Reports
from irodori.config.scene_files import SceneFiles
from irodori.report.page import _rules


def reports(loaded) -> Reports:
    return Reports(SceneFiles(PhotographSets(loaded)))


def of_scene(name) -> SimpleNamespace:
    return SimpleNamespace(scene=name)


CAMERA = SimpleNamespace(camera="d5100-comb")


@pytest.fixture(scope="module")
def three():
    return reports(load(ROOT, scenes=["still-life", "lid", "turntable"], cameras=["d5100-comb"]))


def test_every_scene_and_every_camera_asked_for_has_a_folder_of_its_own(three):
    folders = ["results/still-life", "results/lid", "results/turntable", "results/cameras/d5100-comb"]
    assert three.folders() == folders
    targets = three.targets()
    assert len(set(targets)) == len(targets)
    assert {f"{folder}/{name}" for folder in folders for name in ("report.html", "errors.csv")} <= set(targets)
    # A camera that only a scene needs is calibrated, and the report of the scene tells of it.
    alone = reports(load(ROOT, scenes=["lid"], cameras=[]))
    assert alone.folders() == ["results/lid"] and "results/cameras/d5100-comb/calibration.h5" in alone.targets()


@pytest.mark.parametrize("scene", ["still-life", "lid", "turntable"])
def test_a_report_is_the_same_whichever_scenes_are_made_beside_it(three, scene):
    alone, asked = reports(load(ROOT, scenes=[scene], cameras=[])), of_scene(scene)
    for name in ("errors", "title", "light", "light_name", "scene", "shapes", "sessions", "pages", "jobs"):
        answer = getattr(three, name)(asked)
        assert answer == getattr(alone, name)(asked), name
        assert json.loads(json.dumps(answer)) == answer
    for name, pattern in (("objects", "{object}"), ("environments", "{environment}"), ("cameras", "{camera}"),
                          ("views", "{scene}/{view}"), ("photographs", "{scene}/{photograph}")):  # fmt: skip
        assert getattr(three, name)(pattern)(asked) == getattr(alone, name)(pattern)(asked), name


def test_a_report_covers_the_objects_views_and_light_of_its_scene(three):
    lid = of_scene("lid")
    assert three.objects("results/{object}/material.h5")(lid) == [
        "results/tile-plate/material.h5", "results/celadon-lid/material.h5"]  # fmt: skip
    assert three.environments("{environment}", virtual_only=True)(lid) == ["classroom"]
    assert three.cameras("{camera}")(lid) == ["d5100-comb"]
    assert three.views("{scene}/{view}")(of_scene("turntable")) == ["turntable/front", "turntable/level"]
    assert "results/vermilion-sphere/captures/session.json" not in three.sessions(lid)


def test_an_object_that_stands_twice_in_a_scene_is_reported_once(root):
    placed = {"object": "tile-plate", "position_mm": [0.0, 0.0, 0.0]}
    edit(root, "scenes/lid.yaml", "objects", [placed, placed | {"position_mm": [200.0, 0.0, 0.0]}])
    assert reports(load(root, scenes=["lid"])).objects("{object}")(of_scene("lid")) == ["tile-plate"]


def test_the_report_of_a_camera_covers_the_camera_alone(three):
    assert three.cameras("{camera}")(CAMERA) == ["d5100-comb"]
    assert three.errors(CAMERA) == "results/cameras/d5100-comb/errors.csv"
    assert three.sessions(CAMERA) == ["results/cameras/d5100-comb/captures/session.json"]
    for found in (three.objects, three.environments, three.views, three.photographs):
        assert found("{scene}")(CAMERA) == []
    assert three.pages(CAMERA) == three.light(CAMERA) == []


def test_views_of_objects_of_unknown_truth_are_not_compared_with_it(root):
    assert reports(load(root)).views("{view}", virtual_only=True)(of_scene("still-life")) == ["front"]
    edit(root, "scenes/still-life.yaml", "photographs", {})
    edit(root, PLATE_FILE, "virtual.materials.0.lobe", "ggx")
    unknown = reports(load(root))
    assert unknown.views("{view}", virtual_only=True)(of_scene("still-life")) == []
    assert unknown.views("{view}")(of_scene("still-life")) == ["front"]


def test_the_times_in_a_report_are_those_of_its_own_jobs(three, tmp_path):
    jobs = {
        "fit_brdf/tile-plate_003": 1.0,
        "ingest_raw/cameras-d5100-comb_chart": 2.0,
        "prepare_environment/classroom": 4.0,
        "render_view/lid_front": 8.0,
        "render_view/still-life_front": 16.0,
        "fit_brdf/vermilion-sphere_000": 32.0,
    }
    for name, seconds in jobs.items():
        path = tmp_path / f"{name}.tsv"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"s\tmax_rss\n{seconds}\t100.0\n")
    found = {rule: (count, seconds) for rule, count, seconds, _ in _rules(tmp_path, three.jobs(of_scene("lid")))}
    assert found == {"fit_brdf": (1, 1.0), "ingest_raw": (1, 2.0), "prepare_environment": (1, 4.0),
                     "render_view": (1, 8.0)}  # fmt: skip
    assert [rule for rule, *_ in _rules(tmp_path, three.jobs(CAMERA))] == ["ingest_raw"]
