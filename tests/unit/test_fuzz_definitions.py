"""Definitions damaged in every way a file can be: loaded, or refused with file, fault and what is accepted."""

import copy
import time

import pytest
import yaml
from damage import cut, flip, places, shares
from definitions import ROOT, leaf_paths
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from irodori.config.definitions import load_definitions, read_yaml, validate
from irodori.core.errors import InputError

FILES = (
    "config.yaml", "objects/tile-plate.yaml", "objects/leaf-sphere.yaml", "scenes/still-life.yaml",
    "cameras/d5100-comb.yaml", "rigs/virtual.yaml", "environments/classroom.yaml",
)  # fmt: skip
REUSED = [HealthCheck.function_scoped_fixture]
ODD = [
    None, True, 0, -1, 2**70, 1e308, -1e308, 1e-308, float("nan"), float("inf"), "", "x", "../..", "a" * 300, "é", "\0",
    "1e3", [], {}, [[]], [1], ["x"], {"kind": "x"}, {"x": 1}, 1000000007, "D65",
]  # fmt: skip


def check(root, file: str) -> None:
    """Load everything; a refusal must say what and where in a sentence of bearable length."""
    began = time.process_time()
    try:
        loaded = load_definitions(read_yaml(root / "config/config.yaml"), root)
        for kind in ("objects", "cameras", "environments"):
            for name in getattr(loaded, kind):
                loaded.captures_of(kind, name, root)
    except InputError as error:
        assert error.file and error.found and error.accepted and len(str(error)) < 1500, file
        assert "\n" not in str(error)
    assert time.process_time() - began < 60.0, "as good as hanging"


def with_content(root, file: str, content: bytes) -> None:
    path = root / "config" / file
    before = path.read_bytes()
    path.write_bytes(content)
    try:
        check(root, file)
    finally:
        path.write_bytes(before)


@pytest.mark.stability(stage="fuzzing", case="configuration")
@given(data=st.data(), file=st.sampled_from(FILES), odd=st.sampled_from(ODD) | st.floats() | st.text(max_size=6))
@settings(deadline=None, max_examples=examples(12), suppress_health_check=REUSED)
def test_any_value_in_any_place_of_any_file_loads_or_is_refused(root, data, file, odd):
    content = copy.deepcopy(read_yaml(root / "config" / file))
    *parents, last = data.draw(st.sampled_from(list(leaf_paths(content))))
    block = content
    for key in parents:
        block = block[key]
    if data.draw(st.booleans()):
        block[last] = odd
    else:
        del block[last]
    with_content(root, file, yaml.dump(content, Dumper=yaml.CSafeDumper, allow_unicode=True).encode())


@pytest.mark.stability(stage="fuzzing", case="configuration")
@given(file=st.sampled_from(FILES), damage=places)
@settings(deadline=None, max_examples=examples(12), suppress_health_check=REUSED)
def test_a_file_with_flipped_bits_loads_or_is_refused(root, file, damage):
    with_content(root, file, flip((root / "config" / file).read_bytes(), damage))


@pytest.mark.stability(stage="fuzzing", case="configuration")
@given(file=st.sampled_from(FILES), share=shares)
@settings(deadline=None, max_examples=examples(8), suppress_health_check=REUSED)
def test_a_file_cut_short_loads_or_is_refused(root, file, share):
    with_content(root, file, cut((root / "config" / file).read_bytes(), share))


@pytest.mark.stability(stage="fuzzing", case="configuration that unfolds without end")
@pytest.mark.parametrize("block", ["[{}]", "{{a: {}, b: {}, c: {}}}"], ids=["lists", "blocks"])
def test_aliases_of_aliases_are_refused_at_once(tmp_path, block):
    lines = ["a0: &a0 [x, x]"]
    for i in range(1, 40):
        inner = [f"*a{i - 1}"] * 3
        lines.append(f"a{i}: &a{i} " + (block.format(", ".join(inner)) if "[" in block else block.format(*inner)))
    path = tmp_path / "laughs.yaml"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"laughs\.yaml: line \d+, column \d+: found .*unfold without end"):
        validate(read_yaml(path), "object", path)


def test_the_repository_s_own_files_are_what_is_damaged():
    assert all((ROOT / "config" / file).is_file() for file in FILES)
