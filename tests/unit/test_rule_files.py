"""Answers to the Snakefile: files and parameters of jobs, from wildcards."""

import dataclasses
import itertools
import json
from types import SimpleNamespace

import pytest
from definitions import CAMERA_FILE, PLATE_FILE, ROOT, edit, fault, load

from irodori.config import models, parts
from irodori.config.photograph_sets import PhotographSets, named_tables
from irodori.config.scene_files import SceneFiles
from irodori.core.errors import InputError


def job(**wildcards):
    return SimpleNamespace(**wildcards)


@pytest.fixture(scope="module")
def definitions():
    return load(ROOT)


@pytest.fixture(scope="module")
def sets(definitions):
    return PhotographSets(definitions)


@pytest.fixture(scope="module")
def scenes(sets):
    return SceneFiles(sets)


def test_a_set_is_found_by_its_wildcard(sets):
    assert sets.table(job(object="tile-plate", tile="000")) == "results/tile-plate/captures/captures.csv"
    assert sets.made(job(camera="d5100-comb")) == ["results/cameras/d5100-comb/captures/session.json"]
    assert sets.folder(job(environment="classroom")) == "results/environments/classroom/captures"
    assert sets.camera_of(job(camera="d5100-comb")) == sets.camera_of(job(object="tile-plate")) == "d5100-comb"
    assert sets.rig_of(job(environment="classroom")) == "virtual"
    assert sets.roles(job(camera="d5100-comb")) == ["chart", "white", "dark"]
    assert sets.camera_file("{camera}.h5")(job(object="tile-plate")) == "d5100-comb.h5"
    scene = job(scene="still-life", photograph="front")
    assert sets.folder(scene) == "results/still-life/photographs/front/captures"
    assert sets.made(scene) == [f"{sets.folder(scene)}/session.json"] and sets.roles(scene) == ["scene"]
    assert sets.camera_of(scene) == "d5100-comb" and not sets.own_photographs(scene)


def test_photographs_do_not_depend_on_what_is_known_of_spectra(definitions):
    """Editing it does not take them again."""
    rig, room = definitions.rigs["virtual"], definitions.environments["classroom"]
    lamp = dataclasses.replace(rig.light, error_percent=1.0)
    rigs = definitions.rigs | {"virtual": dataclasses.replace(rig, light=lamp)}
    known = dataclasses.replace(room, lamps=("FL11",), lamps_error_percent=1.0)
    told = dataclasses.replace(definitions, rigs=rigs, environments=definitions.environments | {"classroom": known})
    before, after, here = PhotographSets(definitions), PhotographSets(told), job(environment="classroom")
    taken = after.photographed_place(here)
    assert after.rig(here) == before.rig(here) and taken == before.photographed_place(here)
    assert models.EnvironmentDefinition.of(taken).plain() == dataclasses.replace(room, lamps=()).plain()
    assert after.light_error_percent(job(camera="d5100-comb")) == 1.0


def test_photographs_and_truth_do_not_depend_on_tables_for_calibration_and_recovery(definitions):
    """Tables that only these read are no files of a session."""
    camera, place = definitions.cameras["d5100-comb"], definitions.environments["classroom"]
    table = camera.comb_filter.transmittance
    assert table in PhotographSets(definitions).tables_of_calibration(job(camera="d5100-comb"))
    room = dataclasses.replace(place, lamps=("config/lamps/room.csv",))
    sets = PhotographSets(dataclasses.replace(definitions, environments={"classroom": room}))
    asked = [job(object="tile-plate"), job(camera="d5100-comb"), job(environment="classroom"),
             job(scene="still-life", photograph="front")]  # fmt: skip
    for one in asked:
        files = sets.files_of_session(one)
        assert "config/lamps/halogen-measured.csv" in files and len(files) == len(set(files))
        assert table not in files and "config/lamps/room.csv" not in files


def test_only_a_camera_s_own_photographs_depend_on_its_charts(definitions):
    camera = definitions.cameras["d5100-comb"]
    chart = dataclasses.replace(camera.chart, spectra="config/cameras/mine.csv")
    edited = dataclasses.replace(camera, chart=chart, further_charts={"sg": camera.chart})
    after = PhotographSets(dataclasses.replace(definitions, cameras={"d5100-comb": edited}))
    before, own = PhotographSets(definitions), job(camera="d5100-comb")
    assert before.camera(own) != after.camera(own) and chart.spectra in after.files_of_session(own)
    for one in (job(object="tile-plate"), job(environment="classroom"), job(scene="still-life", photograph="front")):
        assert before.camera(one) == after.camera(one) and before.files_of_session(one) == after.files_of_session(one)


def test_descriptions_are_words_alone(definitions):
    plain = definitions.without_descriptions().plain()
    kinds = ("scenes", "objects", "environments", "cameras", "rigs")
    for kind in kinds:
        for name, one in getattr(definitions, kind).items():
            whole = one.plain()
            assert whole.pop("description", None) and plain[kind][name] == whole


def test_parameters_are_plain_and_as_the_files_say(sets, scenes, definitions):
    plate = job(object="tile-plate", tile="001")
    asked = {
        "camera": sets.camera(plate),
        "rig": sets.rig(plate),
        "optics": sets.optics(plate),
        "photographed": sets.photographed(plate),
        "shapes": scenes.shapes(job(scene="still-life")),
        "part": scenes.part("objects", "display")(job(scene="still-life")),
    }
    assert json.loads(json.dumps(asked)) == asked
    camera = definitions.cameras["d5100-comb"].plain()
    unread = {"calibration", "comb_filter", "chart", "white", "exposure_s"}
    assert unread <= camera.keys() - asked["camera"].keys()
    assert all(value == camera[key] for key, value in asked["camera"].items())
    assert asked["rig"] == definitions.rigs["virtual"].plain()
    scene = definitions.scenes["still-life"].plain()
    assert asked["part"] == {"objects": scene["objects"], "display": scene["display"]}
    photographed = {"shape", "refractive_index", "mirror_weight", "poses", "exposure_s", "virtual", "placements"}
    plate_file = definitions.objects["tile-plate"].plain()
    assert set(asked["photographed"]) == photographed
    assert all(asked["photographed"][key] == plate_file[key] for key in photographed)


def test_scripts_make_the_parts_of_what_the_snakefile_gives(sets, scenes):
    plate, still_life = job(object="tile-plate"), job(scene="still-life", photograph="front")
    photographed = parts.PhotographedObject.of(sets.photographed(plate))
    whole = sets.loaded.objects["tile-plate"]
    assert all(value == getattr(whole, key) for key, value in vars(photographed).items())
    assert parts.RigGeometry.of(sets.rig_geometry(plate)) == parts.RigGeometry.of_rig(sets.loaded.rigs["virtual"])
    assert models.Optics.of(sets.optics(plate)) == sets.loaded.cameras[whole.camera].optics
    scene = sets.loaded.scenes["still-life"]
    staging = parts.Staging.of(scenes.part("objects", "bodies", "lights", "display")(still_life))
    assert (staging.objects, staging.display) == (scene.objects, scene.display)
    assert [one.shape for one in map(parts.Subject.of, scenes.subjects(still_life))] == parts.typed_shapes(
        scenes.shapes(still_life)
    )
    assert models.ScenePhotograph.of(scenes.photograph(still_life)) == scene.photographs["front"]
    own, taken = job(camera="d5100-comb"), parts.PhotographingCamera.of(sets.camera(still_life))
    assert models.Camera.of(sets.camera(own)).optics == taken.optics == sets.loaded.cameras[whole.camera].optics


def test_tiles_cover_the_texture(sets, definitions):
    texels = definitions.objects["tile-plate"].texels
    rows = sets.tiles_of("tile-plate")
    assert rows[0][0] == 0 and rows[-1][1] == texels.height
    assert all(first[1] == second[0] for first, second in itertools.pairwise(rows))
    own = [f"results/tile-plate/brdf/tile-{n:03d}.h5" for n in range(len(rows))]
    assert sets.own_tiles(job(object="tile-plate")) == own
    assert sets.fitted_tiles(job(object="tile-plate")) == ["results/tile-plate/surface.h5"]


def test_every_capture_is_ingested_once(sets, definitions):
    parts = list(sets.ingest_parts())
    for name, captures in sets.captures["objects"].items():
        assert [one for part in parts if part.object_name == name for one in part.captures] == captures
    assert max(len(part.captures) for part in parts) <= definitions.config.ingest.captures_per_job
    assert "captures_per_job" not in sets.ingest_options(job())
    assert len({part.rule_name for part in parts}) == len(parts)


def test_where_an_object_stood_is_told_by_all_that_were_photographed_together(root):
    edit(root, "config.yaml", "photographed_together", [["leaf-sphere", "tile-plate"]])
    sets = PhotographSets(load(root))
    assert [[unit.label for unit in units] for units in sets.together()] == [["leaf-sphere", "tile-plate"]]
    assert sets.registration(job(object="tile-plate")) == ["results/tile-plate/placement.h5"]
    assert sets.registration(job(object="indigo-sphere")) == ["results/indigo-sphere/registration.h5"]
    # An object that was laid down again is registered in each placement, and these tell of the camera together.
    edit(root, "objects/indigo-sphere.yaml", "placements", [{"rotation_deg": [180.0, 0.0, 0.0]}])
    poses = [{"light_deg": [45.0], "camera_deg": [10.0, 20.0], "placement": [1, 2]}]
    edit(root, "objects/indigo-sphere.yaml", "poses", poses)
    sets, further = PhotographSets(load(root)), job(object="indigo-sphere", placement="2")
    assert [unit.label for unit in sets.together()[1]] == ["indigo-sphere", "indigo-sphere in placement 2"]
    both = [f"results/indigo-sphere/placement{end}.h5" for end in ("", "-2")]
    assert sets.registration(job(object="indigo-sphere")) == both
    first = [f"results/indigo-sphere/linear/l0450-c0{angle}-t000-r0000.h5" for angle in (100, 200)]
    assert sets.linear_of_placement(job(object="indigo-sphere")) == sets.first_linear(further) == first
    assert sets.linear_of_placement(further) == [file.replace(".h5", "-p2.h5") for file in first]
    assert sets.first_registration(further) == ["results/indigo-sphere/registration.h5"]
    assert sets.first_registration(job(object="indigo-sphere")) == []
    edit(root, "config.yaml", "place.register", False)
    unregistered = PhotographSets(load(root))
    assert unregistered.together() == unregistered.registration(job(object="tile-plate")) == []


def test_the_pose_of_the_white_counts_where_the_lamp_is_near(root):
    plate = job(object="tile-plate")
    assert PhotographSets(load(root)).white_pose(plate) is None
    edit(root, "rigs/virtual.yaml", "light.distance_mm", 800.0)
    near = PhotographSets(load(root))
    assert near.white_pose(plate) == near.loaded.cameras["d5100-comb"].poses.white.plain()
    assert near.rig_geometry(plate)["lamp_distance_mm"] == 800.0


def test_tables_that_definitions_name_are_found():
    body = models.BodyMaterial(spectrum="wall.csv", refractive_index=models.IndexTable(file="gold.CSV"))
    assert named_tables([body], {"a": "lamp.spd"}, "D65", None, 3.0) == ["wall.csv", "gold.CSV", "lamp.spd"]


def test_tables_of_a_camera_and_an_object_are_inputs_of_their_jobs(root):
    (root / "white.csv").write_text("wavelength_nm,a\n" + "".join(f"{nm},0.9\n" for nm in range(400, 701, 5)))
    edit(root, CAMERA_FILE, "white.reflectance_factor", "white.csv")
    (root / "n.csv").write_text("wavelength_nm,n,k\n" + "".join(f"{nm},0.2,3.0\n" for nm in range(400, 701, 5)))
    edit(root, PLATE_FILE, "refractive_index", {"file": "n.csv"})
    asked = PhotographSets(load(root))
    assert asked.tables_of_white(job(camera="d5100-comb")) == ["white.csv"]
    assert asked.tables_of_index(job(object="tile-plate")) == ["n.csv"]
    assert asked.calibration_of_index(job(object="tile-plate")) == ["results/cameras/d5100-comb/calibration.h5"]
    # The rig's lamp lights all that the virtual camera photographs, and their truth.
    lamp = "config/lamps/halogen-measured.csv"
    assert lamp in asked.tables_of_calibration(job(camera="d5100-comb"))
    for subject in ({"object": "tile-plate"}, {"environment": "classroom"}):
        assert lamp in asked.files_of_session(job(**subject)), subject


def test_frames_of_a_scene_without_frames_are_refused(scenes):
    with pytest.raises(InputError, match="the scene still-life defines no frames"):
        scenes.with_frames(job(scene="still-life"))


def test_a_large_picture_gets_a_second_thread(root, scenes):
    assert scenes.threads_of_view(job(scene="still-life", view="front")) == 1
    edit(root, "scenes/still-life.yaml", "image", {"width": 1920, "height": 1080})
    large = SceneFiles(PhotographSets(load(root)))
    assert large.threads_of_view(job(scene="still-life", view="front")) == 2


def test_the_only_picture_of_a_large_object_gets_a_second_thread(root):
    edit(root, "config.yaml", "rectify.tile_texels", 10_000)
    alone = SceneFiles(PhotographSets(load(root)))
    assert alone.threads_of_view(job(scene="still-life", view="front")) == 2
    side = {"position_mm": [330.0, 0.0, 190.0], "target_mm": [0.0, 0.0, 22.0], "field_of_view_deg": 34.0}
    edit(root, "scenes/still-life.yaml", "views.side", side)
    several = SceneFiles(PhotographSets(load(root)))
    assert several.threads_of_view(job(scene="still-life", view="side")) == 1


def test_pictures_are_those_that_scenes_ask_for(root):
    edit(root, "scenes/still-life.yaml", "further_outputs", ["tiff"])
    edit(root, "scenes/still-life.yaml", "frames", {"kind": "turntable", "count": 4})
    scenes = SceneFiles(PhotographSets(load(root)))
    wanted = scenes.pictures()
    assert {"results/still-life/front.tif", "results/still-life/front.frames.png"} <= set(wanted)
    image = scenes.loaded.scenes["still-life"].image
    assert scenes.memory_of_frames_mb(job(scene="still-life")) == 8 * image.width * image.height * 4 // 1_000_000


def test_a_sheet_needs_its_back_and_the_photographs_that_tell_its_transmittance(root):
    (root / "config/objects/rear.yaml").write_text((root / "config/objects/tile-plate.yaml").read_text())
    edit(root, "scenes/still-life.yaml", "objects.0.back", "rear")
    edit(root, "objects/rear.yaml", "sheet", {"transmittance": "TCS81"})
    edit(root, "objects/tile-plate.yaml", "sheet", {})
    sets, scene = PhotographSets(load(root)), job(scene="still-life")
    scenes = SceneFiles(sets)
    names = ["tile-plate", "vermilion-sphere", "indigo-sphere", "leaf-sphere", "rear"]
    assert scenes.materials("{object}")(scene) == names and scenes.pages() == ["results/still-life/viewer.html"]
    # The error budget takes the back as an object of its own.
    assert scenes.truth_is_rendered("still-life")
    assert len(scenes.subjects(scene)) == len(scenes.calibrations(scene)) == 5
    assert set(sets.fitted_tiles(job(object="rear"))) < set(scenes.tiles(scene))
    plate, rear = job(object="tile-plate"), job(object="rear")
    assert sets.observations_of_sheet(plate) == sets.observed_tiles(plate) != []
    assert sets.observations_of_sheet(rear) == []
    edit(root, "scenes/still-life.yaml", "objects.0.back", "leaf-sphere")
    said = "found leaf-sphere, a sphere, on the back of a plate; accepted: an object of the shape plate"
    assert said in str(fault(root))
    edit(root, "scenes/still-life.yaml", "objects.0.back", "rear")
    edit(root, "objects/rear.yaml", "shape.width_mm", 60.0)
    assert "accepted: one of the size of its front" in str(fault(root))
    edit(root, "objects/rear.yaml", "shape.width_mm", 90.0)
    edit(root, "objects/rear.yaml", "sheet.transmittance", "TCS999")
    assert fault(root).field == "sheet.transmittance"
