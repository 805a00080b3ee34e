"""Definitions as dataclasses: made from the schemas, equal to what a file says, handed on whole."""

import dataclasses
import json
import pickle
import subprocess
import sys

import pytest
from definitions import ROOT, load

from irodori.config import models
from irodori.config.definition import as_plain, field_name
from irodori.config.definitions import KINDS, read_yaml
from irodori.config.validation import _complete, load_schema, validate
from irodori.config.write_models import MODELS, README, key_table, models_text, readme_text
from irodori.core.errors import InputError

OWN = [["still-life"], ["lid"], ["turntable"]]


def test_dataclasses_and_tables_are_those_of_the_schemas():
    assert models_text() == MODELS.read_text(encoding="utf-8")
    readme = README.read_text(encoding="utf-8")
    assert readme_text(readme) == readme


@pytest.mark.parametrize("scenes", OWN)
def test_a_definition_says_what_its_file_says(scenes):
    loaded = load(ROOT, scenes=scenes)
    for kind, made in KINDS.items():
        assert getattr(loaded, kind)
        for name, typed in getattr(loaded, kind).items():
            file = ROOT / "config" / kind / f"{name}.yaml"
            assert isinstance(typed, made) and typed.plain() == validate(read_yaml(file), kind.removesuffix("s"), file)
            assert pickle.loads(pickle.dumps(typed)) == typed
            json.dumps(as_plain({"all": [typed]}))
    config = read_yaml(ROOT / "config/config.yaml")
    config["make"]["scenes"] = scenes
    assert loaded.config.plain() == validate(config, "config", "config.yaml")


def blocks(schema):
    """Yield every block of a schema that has the name of a class."""
    if schema.get("title", "").isidentifier() and "properties" in schema:
        yield schema
    inner = [*schema.get("properties", {}).values(), *schema.get("patternProperties", {}).values()]
    for one in (*inner, *schema.get("oneOf", ()), schema.get("items", {})):
        if one:
            yield from blocks(one)


@pytest.mark.parametrize(("kind", "made"), [("config", models.Config), *KINDS.items()])
def test_keys_and_defaults_of_the_dataclasses_are_those_of_the_schemas(kind, made):
    for block in blocks({**load_schema(kind.removesuffix("s")), "title": made.__name__}):
        fields = getattr(models, block["title"]).__dataclass_fields__
        assert [field.rstrip("_") for field in fields] == list(block["properties"])
        for key, rules in block["properties"].items():
            default = fields[field_name(key)].default
            if fields[field_name(key)].default_factory is not dataclasses.MISSING:
                default = fields[field_name(key)].default_factory()
            if default is dataclasses.MISSING:
                assert key in block.get("required", ()) or block["title"] == "ConstantIndex", (block["title"], key)
            elif "default" in rules:
                assert as_plain(default) == _complete(rules, rules["default"]), (block["title"], key)
            else:
                assert default == rules.get("properties", rules).get("const"), (block["title"], key)


def test_nobody_changes_a_definition():
    size = models.Size.of({"width": 4, "height": 3})
    with pytest.raises(dataclasses.FrozenInstanceError):
        size.width = 5
    assert hash(size) == hash(models.Size(width=4, height=3))


def test_a_block_becomes_the_dataclass_of_its_kind():
    body = {"position_mm": [0.0, 0.0, 1.0], "material": {"spectrum": "TCS3"}}
    disc = models.Body.of({**body, "shape": {"kind": "disc", "radius_mm": 2.0}})
    assert disc.shape == models.DiscShape(radius_mm=2.0)
    assert disc.position_mm == (0.0, 0.0, 1.0)
    assert disc.material.refractive_index == models.ConstantIndex(n=1.5, k=0.0)
    gold = {"spectrum": "TCS3", "refractive_index": {"file": "gold.csv"}}
    assert models.BodyMaterial.of(gold).refractive_index == models.IndexTable(file="gold.csv")
    assert models.Exposures.of({"out": [0.1], "in": [0.2]}).in_ == (0.2,)
    assert models.Exposures.of({"out": [0.1]}).plain() == {"out": [0.1]}


@pytest.mark.parametrize(
    ("cls", "given", "message"),
    [
        ("Size", {"width": 4, "hight": 3}, "Size has no key 'hight'; its keys: width, height"),
        ("Size", {"width": 4}, "Size needs the key 'height'"),
        ("Body", {"shape": {"kind": "cube"}, "position_mm": [0, 0, 0], "material": {"spectrum": "A"}},
         "fits none of the kinds disc, plane, plate, sphere"),
    ],
)  # fmt: skip
def test_what_is_no_definition_is_refused(cls, given, message):
    with pytest.raises(ValueError, match=message):
        getattr(models, cls).of(given)


def test_an_absent_key_is_left_out():
    assert "distance_mm" not in models.RigLight(spectrum="D65").plain()


def test_the_table_shows_needed_keys_defaults_and_kinds():
    table = key_table("scene")
    assert "| **`environment`** |  | text of small letters, digits and hyphens |" in table
    assert "| `max_bounces` | `5` | a whole number from 0 to 20 |" in table
    assert "| `bodies[].shape.kind` |  | `disc` |" in table
    assert "| **`views.NAME.target_mm`** |" in table


def test_a_readme_without_a_table_is_refused():
    with pytest.raises(InputError, match="no marks of the table of rig"):
        readme_text(README.read_text(encoding="utf-8").replace("<!-- end of keys of rig -->", ""))


def test_the_dataclasses_are_light():
    code = "import sys, irodori.config.models; print({'numpy', 'numba', 'jsonschema'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
