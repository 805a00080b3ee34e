"""Definitions one by one: the schemas' own rules, and faults worded with their place."""

import copy
import re

import pytest
import yaml
from definitions import ROOT, leaf_paths, put
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from irodori.config.definitions import KINDS, read_yaml
from irodori.config.validation import SCHEMA_FOLDER, SCHEMAS, load_schema, validate
from irodori.core.errors import InputError
from irodori.fitting.solvers import SOLVERS


def example(kind: str, name: str) -> dict:
    """Return a definition of the repository's own."""
    return read_yaml(ROOT / "config" / kind / f"{name}.yaml")


def refused(definition, schema: str) -> InputError:
    with pytest.raises(InputError) as caught:
        validate(definition, schema, "some.yaml")
    assert caught.value.file == "some.yaml"
    return caught.value


# ---- the schemas themselves


def blocks(schema, path: str):
    """Yield (path, schema) of every key and every item, variants included, but not the conditions."""
    yield path, schema
    for word in ("properties", "patternProperties"):
        for key, inner in schema.get(word, {}).items():
            yield from blocks(inner, f"{path}.{key}")
    for index, inner in enumerate(schema.get("oneOf", ())):
        yield from blocks(inner, f"{path}<{index}>")
    if "items" in schema:
        yield from blocks(schema["items"], f"{path}[]")


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_level_is_closed_and_every_key_described(name):
    schema = load_schema(name)
    Draft202012Validator.check_schema(schema)
    for path, block in blocks(schema, name):
        if block.get("type") == "object":
            assert block.get("additionalProperties") is False, path
            assert set(block.get("required", ())) <= set(block.get("properties", ())), path
        if not path.endswith(">"):
            assert block.get("description"), path
        if block.get("type") in ("number", "integer"):
            assert {"minimum", "exclusiveMinimum"} & set(block), path
            assert {"maximum", "exclusiveMaximum"} & set(block), path
        if "default" in block:
            assert Draft202012Validator(block).is_valid(block["default"]), path


UNITS = {"_mm": "in mm", "_m": "in m", "_um": "in micrometres", "_nm": "in nm", "_rad": "in rad",
         "_s": "in seconds", "_deg_per_s": "in degrees a second",
         "_px": "pixels", "_e": "in electrons", "_e_per_s": "in electrons a second"}  # fmt: skip


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_key_with_a_unit_in_its_name_gives_it_in_its_description(name):
    for path, block in blocks(load_schema(name), name):
        suffix = max((suffix for suffix in UNITS if path.endswith(suffix)), key=len, default=None)
        if suffix:
            assert UNITS[suffix] in block["description"], path


def test_there_is_a_schema_for_each_kind_and_no_other_file():
    files = {file.name for file in SCHEMA_FOLDER.iterdir()}
    assert files == {f"{name}.schema.yaml" for name in (*SCHEMAS, "common")}
    assert set(SCHEMAS) == {"config", *(kind.removesuffix("s") for kind in KINDS)}


def test_the_readme_names_every_key():
    readme = (ROOT / "config" / "README.md").read_text(encoding="utf-8")
    for name in SCHEMAS:
        for path, _ in blocks(load_schema(name), name):
            key = path.replace("[]", "").rpartition(".")[2].partition("<")[0]
            if "." in path and not key.startswith("^"):
                assert re.search(rf"[`.]{key}\b[^|\n]*`", readme), path


def test_an_unknown_schema_lists_the_valid_ones():
    with pytest.raises(ValueError, match=r"no schema 'lens'; schemas: config, object"):
        validate({}, "lens", "x")


def test_the_solvers_of_the_schema_are_those_of_the_fit():
    solvers = [name for name in SOLVERS if name != "nlopt-reference"]  # which benchmarks and tests compare with
    assert load_schema("config")["properties"]["fit"]["properties"]["solver"]["enum"] == solvers
    error = refused({"make": {}, "fit": {"solver": "varpor"}}, "config")
    assert error.field == "fit.solver" and "did you mean 'varpro'?" in error.accepted


# ---- one definition at a time

PLATE = ("objects", "tile-plate")
SCENE = ("scenes", "still-life")
CAMERA = ("cameras", "d5100-comb")
RIG = ("rigs", "virtual")
ROOM = ("environments", "classroom")


@pytest.mark.parametrize(
    ("which", "path", "value", "field", "found", "accepted"),
    [
        # Unknown keys, with the nearest valid one.
        (PLATE, "shape", {"kind": "sphere", "radius": 3.0}, "shape.radius", "unknown key",
         "did you mean 'radius_mm'? (accepted here: kind, radius_mm)"),
        (PLATE, "shape.radius_mm", 3.0, "shape.radius_mm", "unknown key", "one of kind, width_mm, height_mm"),
        (PLATE, "camrea", "x", "camrea", "unknown key", "did you mean 'camera'?"),
        (PLATE, "refractive_index", {"n": 1.5, "kappa": 0.0}, "refractive_index.kappa", "unknown key",
         "n, k"),
        (PLATE, "virtual.pattern", {"kind": "uniform", "rows": 2}, "virtual.pattern.rows", "unknown key",
         "kind"),
        (SCENE, "objects.1.scal", 1.0, "objects[1].scal", "unknown key", "did you mean 'scale'?"),
        (SCENE, "views.Front", {}, "views.Front", "unknown key", "small letters"),
        (RIG, "virtual.imperfections.light_drift.rms", 0.1, "virtual.imperfections.light_drift.rms",
         "unknown key",
         "relative_rms"),
        # Missing keys, with what they should hold.
        (PLATE, "camera", ..., "camera", "no such key", "text of small letters"),
        (PLATE, "shape.width_mm", ..., "shape.width_mm", "no such key",
         "a number above 0 up to 10000 (Size along x"),
        (PLATE, "shape.kind", ..., "shape.kind", "no such key", "one of plate, sphere"),
        (PLATE, "exposure_s.out", ..., "exposure_s.out", "no such key", "a list of 1 to 16"),
        (PLATE, "virtual.materials.3.beta", ..., "virtual.materials[3].beta", "no such key", "gloss"),
        (RIG, "virtual", ..., "virtual", "no such key", "block of keys"),
        (RIG, "kind", ..., "kind", "no such key", "virtual, driven, files"),
        # Variants.
        (PLATE, "shape.kind", "spher", "shape.kind", "'spher'", "did you mean 'sphere'?"),
        (PLATE, "shape", "plate", "shape", "'plate'", "of kind plate"),
        (RIG, "kind", "files", "virtual", "the kind 'files' does not have", "leave it out"),
        (RIG, "kind", "vitrual", "kind", "'vitrual'", "did you mean 'virtual'?"),
        (SCENE, "display.exposure", "automatic", "display.exposure", "'automatic'",
         "auto, or a number above 0"),
        (SCENE, "display.exposure", {"a": 1}, "display.exposure", '{"a": 1}', "auto, or a number above 0"),
        (SCENE, "display.exposure", 0, "display.exposure", "0", "auto, or a number above 0"),
        # Ranges and types.
        (SCENE, "objects.1.scale", -1, "objects[1].scale", "-1", "a number above 0"),
        (SCENE, "objects.1.rotation_deg", [0, 0], "objects[1].rotation_deg", "[0, 0]", "exactly 3 items"),
        (SCENE, "integrator", {"kind": "referenc", "samples": 8}, "integrator.kind", "'referenc'",
         "interactive, reference"),
        (SCENE, "integrator", {"kind": "sampled"}, "integrator.kind", "'sampled'", "one of interactive, reference"),
        (SCENE, "integrator", {"kind": "reference", "samples": 20}, "integrator.samples", "20", "multiple of 8"),
        (SCENE, "integrator", {"kind": "interactive", "samples": 8}, "integrator.samples", "unknown key",
         "kind, light_maps"),
        (SCENE, "lights", [{"kind": "sphere", "spectrum": "A", "position_mm": [0, 0, 9], "radius": 1, "radiance": 1}],
         "lights[0].radius", "unknown key", "did you mean 'radius_mm'?"),
        (SCENE, "max_bounces", 21, "max_bounces", "21", "a whole number from 0 to 20"),
        (SCENE, "max_bounces", 1.5, "max_bounces", "1.5", "a whole number"),
        (SCENE, "max_bounces", True, "max_bounces", "true", "a whole number"),
        (SCENE, "views", {}, "views", "{}", "block of keys"),
        (SCENE, "objects.0.object", "Tile Plate", "objects[0].object", "'Tile Plate'", "small letters"),
        (PLATE, "refractive_index.n", 0.01, "refractive_index.n", "0.01", "from 0.05 to 10"),
        (PLATE, "virtual.materials", [], "virtual.materials", "[]", "a list of 1 to"),
        (PLATE, "exposure_s.out", [0.02, 0.02], "exposure_s.out", "0.02 twice", "each item once"),
        (PLATE, "texels.width", None, "texels.width", "nothing", "a whole number from 1"),
        (CAMERA, "optics.width_px", 801, "optics.width_px", "801", "divisible by 2"),
        (CAMERA, "calibration.estimator", "pin", "calibration.estimator", "'pin'", "did you mean 'pinv'?"),
        (ROOM, "virtual.surfaces.walls.spectrum", "", "virtual.surfaces.walls.spectrum", "''", "not empty"),
        (ROOM, "virtual.surfaces.walls.irradiance", float("nan"), "virtual.surfaces.walls.irradiance", "nan",
         "a finite number"),
        (RIG, "virtual.imperfections.stray_light.enabled", "yes", "virtual.imperfections.stray_light.enabled",
         "'yes'", "true or false"),
    ],
)  # fmt: skip
def test_a_fault_names_its_key(which, path, value, field, found, accepted):
    error = refused(put(example(*which), path, value), which[0].removesuffix("s"))
    assert error.field == field
    assert found in error.found
    assert accepted in error.accepted


def test_a_slip_of_the_pen_is_reported_rather_than_the_key_it_leaves_missing():
    plate = put(put(example(*PLATE), "camera", ...), "camrea", "d5100-comb")
    assert refused(plate, "object").field == "camrea"


@pytest.mark.parametrize(("text", "write"), [("1e4", "1.000000e+04"), ("'2.5'", "2.5")])
def test_numbers_that_yaml_reads_as_text_are_explained(text, write):
    beta = yaml.safe_load(text)
    assert isinstance(beta, str)
    error = refused(put(example(*PLATE), "virtual.materials.0.beta", beta), "object")
    assert error.field == "virtual.materials[0].beta"
    assert f"YAML reads this as text, write {write}" in error.accepted
    assert isinstance(yaml.safe_load(write), float)


def test_a_key_that_is_not_text():
    error = refused(yaml.safe_load("{make: {scenes: []}, on: 1}"), "config")
    assert "True" in error.found and "quotes" in error.accepted


def test_something_else_than_a_block_of_keys():
    for odd in (None, [], "x", 3):
        assert "block of keys" in refused(odd, "object").accepted


def test_defaults_are_filled_in_and_the_argument_is_left_alone():
    plate = put(put(example(*PLATE), "refractive_index", ...), "mirror_weight", ...)
    before = copy.deepcopy(plate)
    complete = validate(plate, "object", "x")
    assert plate == before
    assert complete["refractive_index"] == {"n": 1.5, "k": 0.0}
    assert complete["mirror_weight"] == 0.0
    assert complete["poses"][0]["tilt_deg"] == [0.0]
    assert "captures" not in complete
    complete["poses"][0]["tilt_deg"].append(1.0)
    assert validate(plate, "object", "x")["poses"][0]["tilt_deg"] == [0.0]
    scene = validate(put(example(*SCENE), "display", ...), "scene", "x")
    assert scene["display"] == {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}}
    assert scene["views"]["front"]["up"] == [0.0, 0.0, 1.0]
    assert scene["objects"][0]["rotation_deg"] == [0.0, 0.0, 0.0]
    assert scene["objects"][1]["scale"] == 1.0


def test_the_defaults_of_the_configuration_are_the_repository_s_own():
    own = read_yaml(ROOT / "config" / "config.yaml")
    # What is made, and which of these objects were photographed together, has no default.
    names = {"make": {"scenes": own["make"]["scenes"]}, "photographed_together": own["photographed_together"]}
    short = validate(names, "config", "x")
    assert short == validate(own, "config", "x")
    rig = example(*RIG)
    # The faults of the repository's own rig that no rig has unless it says so.
    faults = {name: {"enabled": True} for name in ("lamp_spectrum", "laid_off", "focal_length")}
    short = put(rig, "virtual", {"seed": rig["virtual"]["seed"], "imperfections": faults})
    assert validate(short, "rig", "x") == validate(rig, "rig", "x")


def test_numbers_take_the_type_of_the_schema():
    def types(scale, width):
        scene = put(put(example(*SCENE), "objects.0.scale", scale), "image.width", width)
        scene = validate(scene, "scene", "x")
        return type(scene["objects"][0]["scale"]), type(scene["image"]["width"])

    assert types(2, 640) == types(2.0, 640.0) == (float, int)


def test_refractive_index_from_a_file():
    plate = put(example(*PLATE), "refractive_index", {"file": "gold.csv"})
    assert validate(plate, "object", "x")["refractive_index"] == {"file": "gold.csv"}
    mixed = put(example(*PLATE), "refractive_index", {"file": "gold.csv", "n": 1.5, "k": 0.0})
    assert refused(mixed, "object").field == "refractive_index.file"


_PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["kind", "n", "file", "out", "x"]) | st.integers(), inner, max_size=3)
    ),
    max_leaves=6,
)


@pytest.mark.stability(stage="fuzzing", case="configuration")
@settings(deadline=None, max_examples=150)
@given(data=st.data(), which=st.sampled_from([PLATE, SCENE, CAMERA, RIG, ROOM]), value=_PLAIN)
def test_any_value_in_any_place_is_valid_or_an_input_error(data, which, value):
    definition = example(*which)
    path = data.draw(st.sampled_from(list(leaf_paths(definition))))
    block = definition
    for part in path[:-1]:
        block = block[part]
    block[path[-1]] = value
    try:
        validate(definition, which[0].removesuffix("s"), "x")
    except InputError as error:
        assert error.found and error.accepted


def test_an_alias_of_itself_is_refused():
    loop = {"make": {}}
    loop["make"]["scenes"] = [loop]
    assert "nested too deep" in refused(loop, "config").found
