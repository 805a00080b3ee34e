"""Hashes change with what they stand for, and with nothing else."""

import hashlib
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from irodori.core.atomic_files import file_sha256
from irodori.core.provenance import code_hash, config_hash, local_sources, modules_of

_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)

SOURCES = {
    "__init__.py": "",
    "alone.py": "import json\nimport packaging\n",
    "leaf.py": "VALUE = 1\n",
    "middle.py": "from pkg import leaf\n",
    "stage.py": "def late():\n    import pkg.middle\n",
    "loop.py": "import pkg.knot\n",
    "knot.py": "from pkg.loop import *\n",
    "sub/__init__.py": "from . import inner\n",
    "sub/inner.py": "from ..leaf import VALUE\n",
    "sub/deep/core.py": "from .. import inner as other\nfrom . import sibling\n",
    "sub/deep/sibling.py": "",
    "named.py": "from pkg.sub import inner\n",
    "hinted.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import pkg.middle\nimport pkg.alone\n",
}


@pytest.fixture
def root(tmp_path):
    for name, text in SOURCES.items():
        path = tmp_path / "pkg" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    code_hash.cache_clear()
    return tmp_path


@pytest.mark.parametrize(
    ("module", "wanted"),
    [
        ("pkg.alone", {"pkg", "pkg.alone"}),
        ("pkg.stage", {"pkg", "pkg.stage", "pkg.middle", "pkg.leaf"}),
        ("pkg.loop", {"pkg", "pkg.loop", "pkg.knot"}),
        ("pkg.sub", {"pkg", "pkg.sub", "pkg.sub.inner", "pkg.leaf"}),
        # What type checkers alone read is not run: kernels outlive a change of a definition's class.
        ("pkg.hinted", {"pkg", "pkg.hinted", "pkg.alone"}),
        ("pkg.named", {"pkg", "pkg.named", "pkg.sub", "pkg.sub.inner", "pkg.leaf"}),
        # pkg.sub.deep has no __init__, so that it adds no source of its own.
        ("pkg.sub.deep.core", {"pkg", "pkg.sub", "pkg.sub.inner", "pkg.leaf", "pkg.sub.deep.core",
                               "pkg.sub.deep.sibling"}),
    ],
)  # fmt: skip
def test_local_imports_are_followed(root, module, wanted):
    assert set(local_sources(module, root)) == wanted


def test_imports_of_another_local_package_are_followed(root):
    (root / "other").mkdir()
    (root / "other/bench.py").write_text("import os\nfrom pkg.stage import x\n")
    wanted = {"other.bench", "pkg", "pkg.stage", "pkg.middle", "pkg.leaf"}
    assert set(local_sources("other.bench", root)) == wanted
    assert {"irodori.fitting", "irodori.fitting.varpro"} <= set(local_sources("benchmarks.fit"))


def test_beside_installed_packages_only_the_package_asked_for_is_local(root):
    (root / "other").mkdir()
    (root / "other/bench.py").write_text("")
    (root / "pkg/user.py").write_text("import other.bench\nfrom pkg.leaf import VALUE\n")
    assert "other.bench" in local_sources("pkg.user", root)
    installed = root.with_name("installed")
    root.rename(installed)
    (installed / "other-1.0.dist-info").mkdir()
    assert set(local_sources("pkg.user", installed)) == {"pkg", "pkg.user", "pkg.leaf"}


def test_compiled_loops_do_not_depend_on_the_definitions():
    for module in ("irodori.rectification.stage", "irodori.rendering.reference.paths", "irodori.geometry.surfaces"):
        assert "irodori.config.models" not in local_sources(module)


def test_an_edit_changes_the_hash_of_those_who_import_it(root):
    before = {name: code_hash(f"pkg.{name}", root=root) for name in ("alone", "stage", "named")}
    (root / "pkg" / "leaf.py").write_text("VALUE = 2\n")
    code_hash.cache_clear()
    after = {name: code_hash(f"pkg.{name}", root=root) for name in before}
    assert before["alone"] == after["alone"]
    assert before["stage"] != after["stage"] and before["named"] != after["named"]


@pytest.mark.parametrize("name", ["templates/page.html.j2", "published.h5"])
def test_templates_and_tables_are_sources_of_their_package(root, name):
    template = root / "pkg/sub" / name
    template.parent.mkdir(exist_ok=True)
    hashes = []
    for text in ("one", "two"):
        template.write_text(text)
        code_hash.cache_clear()
        hashes.append((code_hash("pkg.sub.inner", root=root), code_hash("pkg.alone", root=root)))
    assert hashes[0][0] != hashes[1][0] and hashes[0][1] == hashes[1][1]


def test_code_hash_is_short_hexadecimal_and_imports_nothing(root):
    digest = code_hash("pkg.stage", root=root)
    assert len(digest) == 16 and int(digest, 16) >= 0
    assert "pkg" not in sys.modules


def test_an_unknown_module_lists_the_known_ones(root):
    with pytest.raises(ValueError, match=r"no module 'pkg\.lief'; modules: pkg, pkg\.alone, "):
        code_hash("pkg.lief", root=root)


def test_the_package_itself():
    sources = local_sources("irodori.config.definitions")
    assert {"irodori", "irodori.config.capture_table", "irodori.core.errors", "irodori.config.validation"} <= set(
        sources
    )


@given(value=_JSON)
def test_config_hash_is_a_function_of_the_content(value):
    assert config_hash(value) == config_hash(value)
    assert config_hash({"a": value}) != config_hash({"b": value})


def test_config_hash_ignores_what_makes_no_difference():
    assert config_hash({"a": 45, "b": (1, 2)}) == config_hash({"b": [1.0, 2.0], "a": 45.0})
    assert config_hash({"a": 1}) != config_hash({"a": True})
    assert config_hash({"a": 1.5}) != config_hash({"a": "1.5"})


@pytest.mark.parametrize(("value", "error"), [(float("nan"), ValueError), ({1: 2}, TypeError), (b"x", TypeError)])
def test_config_hash_refuses_what_json_cannot_hold(value, error):
    with pytest.raises(error):
        config_hash({"a": value})


def test_file_sha256(tmp_path):
    path = tmp_path / "raw"
    path.write_bytes(b"\0\1" * 1000)
    assert file_sha256(path) == hashlib.sha256(b"\0\1" * 1000).hexdigest()
    path.write_bytes(b"")
    assert file_sha256(path) == hashlib.sha256(b"").hexdigest()
    with pytest.raises(OSError):
        file_sha256(tmp_path / "absent")


def test_the_modules_of_a_package_are_all_its_files():
    names = modules_of("irodori")
    assert {"irodori", "irodori.core.store", "irodori.rendering", "irodori.rendering.stage"} <= set(names)
    assert len(names) == len(set(names)) and not any(name.endswith("__init__") for name in names)
    assert code_hash(*names)
