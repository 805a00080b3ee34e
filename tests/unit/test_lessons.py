"""Lessons of scenes: faults told in one sentence, pictures carried along, no job run anew for words."""

import base64

import numpy as np
import pytest
import yaml
from definitions import ROOT, load
from pages import room, sources

from irodori.config.definition import as_plain
from irodori.config.pages import MOST_LAMPS, page_fault, page_rooms
from irodori.config.placed_names import object_names
from irodori.config.scene_files import SceneFiles
from irodori.config.validation import load_schema
from irodori.core.errors import InputError
from irodori.spectra.published import light as published_light
from irodori.viewer import colours
from irodori.viewer.lesson import lesson_for_page
from irodori.viewer.page_data import page_data

STEP = {"title": {"en": "One"}, "text": {"en": "Words."}}
PNG = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR42mNgAAAAAgAB4iG8MwAAAABJRU5ErkJggg==")
LAMP = {"position_mm": [0, 0, 100]}


def with_step(root, scene="still-life", **step):
    """Give a scene a lesson of one step and load it."""
    file = root / f"config/scenes/{scene}.yaml"
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    content["lesson"] = {"title": {"en": "Lesson"}, "steps": [{**STEP, **step}]}
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    return load(root, scenes=[scene])


FAULTS = [
    ({"view": "fornt"}, "lesson.steps[0].view", "did you mean 'front'"),
    ({"view": "front", "camera": {"target_mm": [0, 0, 0], "azimuth_deg": 0, "elevation_deg": 0, "distance_mm": 9}},
     "lesson.steps[0].camera", "one of the two"),
    ({"objects": [{"name": "leaf-spere"}]}, "lesson.steps[0].objects[0].name", "did you mean 'leaf-sphere'"),
    ({"light": {"environment": "cellar"}}, "lesson.steps[0].light.environment", "classroom"),
    ({"light": {"illuminant": {"name": "D66"}}}, "lesson.steps[0].light.illuminant.name", "D65"),
    ({"light": {"lamps": [{**LAMP, "illuminant": {"name": "sun"}}]}},
     "lesson.steps[0].light.lamps[0].illuminant.name", "D65"),
    ({"light": {"lamps": [LAMP] * 9}}, "lesson.steps[0].light.lamps", "0 to 8"),
    ({"light": {"illuminant": {"power": [0.0] * 61}}}, "lesson.steps[0].light.illuminant.power", "above 0"),
    ({"observer": "CIE 1931"}, "lesson.steps[0].observer", "CIE 1931 2°"),
    ({"compare": {"mode": "wipe", "light": {"illuminant": {"name": "B6"}}}},
     "lesson.steps[0].compare.light.illuminant.name", "FL2"),
    ({"compare": {"mode": "blend"}}, "lesson.steps[0].compare.mode", "metamerism"),
    ({"picture": "gone.png"}, "lesson.steps[0].picture", "no such file"),
    ({"text": {}}, "lesson.steps[0].text", "by the language"),
    ({"tittle": {"en": "x"}}, "lesson.steps[0].tittle", "title"),
]  # fmt: skip


@pytest.mark.parametrize(("step", "field", "words"), FAULTS, ids=[field for _, field, _ in FAULTS])
def test_a_faulty_step_is_refused_in_one_sentence(root, step, field, words):
    with pytest.raises(InputError) as refused:
        with_step(root, **step)
    assert str(refused.value).startswith(str(refused.value.file)) and "still-life.yaml" in str(refused.value)
    assert refused.value.field == field and words in str(refused.value) and "\n" not in str(refused.value)


def test_a_step_has_no_more_lamps_with_the_scenes_own_lights_than_the_page_can_draw(root):
    file = root / "config/scenes/still-life.yaml"
    far = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": 0, "elevation_deg": 45, "irradiance": 1.0}
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    file.write_text(yaml.safe_dump(content | {"lights": [far] * 3}), encoding="utf-8")
    assert with_step(root, light={"lamps": [LAMP] * 5})
    with pytest.raises(InputError, match="9 lamps with the scene's own lights; accepted: at most 8 together"):
        with_step(root, compare={"mode": "wipe", "light": {"lamps": [LAMP] * 6}})
    shader = (ROOT / "irodori/viewer/page/renderer.js").read_text(encoding="utf-8")
    assert f"MOST_LAMPS = (Irodori.LAMPS = {MOST_LAMPS})" in shader
    file.write_text(yaml.safe_dump({**content, "lights": [far] * 9}), encoding="utf-8")
    field, found, _ = page_fault(load(root, scenes=["still-life"]).scenes["still-life"])
    assert (field, found) == ("lights", "9 lights")


def test_observers_of_lessons_are_those_of_the_page(root):
    for name in colours.OBSERVERS:
        assert with_step(root, observer=name)
    (accepted,) = [one["enum"] for one in _blocks(load_schema("scene")) if "CIE 1931 2°" in one.get("enum", ())]
    assert accepted == list(colours.OBSERVERS)


def _blocks(schema):
    """Yield all blocks of a schema."""
    for value in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        yield from _blocks(value)
    if isinstance(schema, dict):
        yield schema


def test_the_page_names_bodies_as_the_checks_do_and_carries_the_illuminants_of_its_lesson(tmp_path):
    body = {
        "shape": {"kind": "sphere", "radius_mm": 9.0},
        "position_mm": [60.0, 0.0, 9.1],
        "material": {"spectrum": "TCS3"},
    }
    light = {"illuminant": {"name": "FL3.1"}, "lamps": [{**LAMP, "illuminant": {"name": "HP1"}}]}
    lesson = {"title": {"en": "One"}, "steps": [{**STEP, "compare": {"mode": "wipe", "light": light}}]}
    given = sources(tmp_path, room(), bodies=[body], lesson=lesson)
    header = page_data(given).header
    assert [one["name"] for one in header["objects"]] == object_names(given.scene) == ["ball", "plate", "bodies[0]"]
    found = {one["name"]: np.array(one["power"]) for one in header["illuminants"]}
    assert list(found) == [*colours.ILLUMINANTS, "FL3.1", "HP1"]
    np.testing.assert_allclose(found["FL3.1"], published_light("FL3.1") / published_light("FL3.1").max())


def test_pictures_of_steps_are_carried_in_the_page(root):
    (root / "tube.png").write_bytes(PNG)
    lesson = with_step(root, picture="tube.png").scenes["still-life"].lesson
    (step,) = lesson_for_page(lesson, root)["steps"]
    head, content = step["picture"].split(",")
    assert head == "data:image/png;base64" and base64.b64decode(content) == PNG
    assert step["picture_file"] == "tube.png"
    assert lesson_for_page(None) is None


@pytest.mark.parametrize(("content", "words"), [(b"GIF89a", "neither"), (PNG + bytes(1_000_000), "at most")])
def test_other_pictures_are_refused(root, content, words):
    (root / "tube.png").write_bytes(content)
    with pytest.raises(InputError, match=words):
        with_step(root, picture="tube.png")


def test_a_room_that_a_lesson_names_is_made_for_the_page(root):
    """Its definition is loaded with the scene, and its light is an input of the page after the scene's own."""
    cellar = root / "config/environments/cellar.yaml"
    cellar.write_text((root / "config/environments/classroom.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    compare = {"mode": "wipe", "light": {"environment": "cellar"}}
    for step in ({"light": {"environment": "cellar"}}, {"compare": compare}):
        loaded = with_step(root, **step)
        assert "cellar" in loaded.environments
        assert page_rooms(loaded.scenes["still-life"]) == ["classroom", "cellar"]
    assert page_rooms(load(ROOT, scenes=["still-life"]).scenes["still-life"]) == ["classroom"]


def test_every_language_of_the_page_has_the_whole_lesson_of_the_default_scene():
    lesson = load(ROOT, scenes=["still-life"]).scenes["still-life"].lesson
    texts = [lesson.title, *(text for step in lesson.steps for text in (step.title, step.text))]
    texts += [note.text for step in lesson.steps for note in step.notes]
    assert [set(text) for text in texts] == [{"en", "ja"}] * len(texts)


def test_words_of_a_lesson_run_no_frames_anew(root):
    class Wildcards:
        scene = "turntable"

    def frames():
        loaded = load(root, scenes=["turntable"])
        needed = {name: getattr(SceneFiles, name) for name in ("_scene", "pictured")}
        return SceneFiles.with_frames(type("Files", (), {"loaded": loaded, **needed})(), Wildcards)

    before = frames()
    lesson = with_step(root, "turntable").scenes["turntable"].lesson
    assert lesson.steps[0].title == STEP["title"] and frames() == before and "lesson" not in before
    assert as_plain(lesson)["steps"][0]["text"] == STEP["text"]
