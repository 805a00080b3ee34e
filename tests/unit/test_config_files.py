"""Files of the configuration: reading YAML, and one file over another."""

from pathlib import Path

import pytest
import yaml
from definitions import ROOT, edit
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from irodori.config.definitions import load_definitions, read_yaml
from irodori.core.errors import InputError

DATA = ROOT.parent / "shared" / "data"
POSE = "l0450-c0000-t000-r0000"
BODY = {"shape": {"kind": "sphere", "radius_mm": 5}, "position_mm": [0, 0, 5], "material": {"spectrum": "TCS3"}}


# ---- reading YAML


@pytest.mark.parametrize(
    ("text", "place", "found"),
    [
        (b"a: 1\nb: [1, 2\n", "line 3", "expected"),
        (b"a: 1\nb: 2\na: 3\n", "line 3, column 1", "the key 'a' twice"),
        (b"a:\n  b: 1\n  b: 2\n", "line 3, column 3", "the key 'b' twice"),
        (b"a: 1\nwhen: 2010-13-45\n", "line 2", "month"),
        (b"a: 045\n", "line 1, column 4", "045, which YAML reads as 37"),
        (b"a: [-0120, 3]\n", "line 1, column 5", "-0120, which YAML reads as -80"),
        (b"a: 10:40\n", "line 1", "10:40, which YAML reads as 640"),
        (b"a: 190:20:30.15\n", "line 1", "which YAML reads as 685230"),
        (b"a: \xff\xfe\n", "", ""),
        (b"", "", "an empty file"),
        (b"- 1\n", "", "a list"),
        (b"? [1, 2]\n: 3\n", "line 1", "unhashable"),
        (b"a: !!python/name:os.system\n", "line 1", "constructor"),
        (b"[" * 100_000, "line 1, column 65", "nested more than 64 deep"),
    ],
)
def test_a_broken_yaml_names_its_line(tmp_path, text, place, found):
    path = tmp_path / "x.yaml"
    path.write_bytes(text)
    with pytest.raises(InputError) as caught:
        read_yaml(path)
    assert caught.value.file == str(path)
    assert caught.value.field.startswith(place)
    assert found in caught.value.found


def test_a_yaml_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_yaml(tmp_path / "x.yaml")
    with pytest.raises(InputError):
        read_yaml(tmp_path)


@pytest.mark.stability(stage="fuzzing", case="configuration")
@settings(deadline=None, max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=60))
def test_any_bytes_give_a_block_or_an_input_error(tmp_path, content):
    path = tmp_path / "x.yaml"
    path.write_bytes(content)
    try:
        assert isinstance(read_yaml(path), dict)
    except InputError as error:
        assert error.found


# ---- several files of the configuration


@pytest.fixture
def layers(root):
    """Return a function that loads a working directory's configuration with a second file over it."""

    def load_both(text: str) -> InputError:
        (root / "config/mine.yaml").write_text(text)
        config, own = read_yaml(root / "config/config.yaml"), yaml.safe_load(text)
        for key, block in own.items():
            config[key] = {**config.get(key, {}), **block} if isinstance(block, dict) else block
        with pytest.raises(InputError) as caught:
            load_definitions(config, root, ("config/config.yaml", Path("config/mine.yaml"), "config/none.yaml"))
        return caught.value

    return load_both


@pytest.mark.parametrize(
    ("text", "file", "field"),
    [
        ("make: {scenes: [stil-life]}", "config/mine.yaml", "make.scenes[0]"),
        ("fit: {solver: x}", "config/mine.yaml", "fit.solver"),
        ("fti: {solver: nlopt}", "config/mine.yaml", "fti"),
        ("report: {lights: [D65, D56]}", "config/mine.yaml", "report.lights[1]"),
        ("fit: {bounds: {beta: [2.0, 1.0], alpha: [0.0, 1.0], mu_rad: [0.01, 1.0]}}", "config/mine.yaml",
         "fit.bounds.beta"),
        ("make: []", "config/mine.yaml", "make"),
    ],
)  # fmt: skip
def test_a_fault_is_reported_for_the_file_that_gives_its_key(layers, text, file, field):
    error = layers(text)
    assert (error.file, error.field) == (file, field)


def test_a_fault_of_the_first_file_is_not_laid_on_the_second(layers, root):
    edit(root, "config.yaml", "make.scenes", ["stil-life"])
    assert layers("make: {cameras: []}").file == "config/config.yaml"
    edit(root, "config.yaml", "make.scenes", ["still-life"])
    edit(root, "config.yaml", "report.lights", ["D56"])
    assert layers("make: {cameras: []}").file == "config/config.yaml"


def test_a_key_given_twice_in_any_file_of_the_configuration(layers, root):
    error = layers("make: {scenes: [still-life]}\nmake: {cameras: []}")
    assert error.file.endswith("config/mine.yaml") and "the key 'make' twice" in error.found
    path = root / "config/config.yaml"
    path.write_text(path.read_text() + "\nmake: {}\n")
    with pytest.raises(InputError, match="the key 'make' twice"):
        load_definitions({"make": {}}, root)
