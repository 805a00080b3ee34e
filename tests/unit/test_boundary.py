"""Hostile files: names that leave their folder, bombs, declared sizes, and numbers that nothing real has."""

import hashlib
import json
import os
import struct
import sys
import time
from dataclasses import replace

import h5py
import numpy as np
import OpenImageIO as oiio
import patience
import pytest
from definitions import ROOT, edit, fault
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import constant_light, material

from irodori.capture.journal import Journal, claimed
from irodori.colour.display import standard_display
from irodori.colour.icc import D50_XYZ, Profile, read_profile, write_profile
from irodori.colour.tone_curves import ParametricCurve, SampledCurve
from irodori.config.capture_table import Pose, Shot, read_captures, shot_path, write_captures
from irodori.config.definitions import load_one
from irodori.core import store
from irodori.core.confined_paths import confined
from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml
from irodori.geometry.mesh_files import read_mesh
from irodori.geometry.mesh_sources import mesh_files
from irodori.light.environment_file import Environment
from irodori.light.light_files import rgb_picture
from irodori.material.coefficients import write_coefficients
from irodori.material.material_file import COEFFICIENTS, Material, write_constants
from irodori.spectra.tables import index_table

MADE = store.Provenance("test")
LEAVING = ["../../home/mine.dng", "a/../../../home/mine.dng", "ABSOLUTE", "link/mine.dng"]


# ---- names that leave their folder


@pytest.fixture
def session(tmp_path):
    """Return a session's folder, beside which a person's photograph stands that is none of its business."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home/mine.dng").write_bytes(b"mine")
    folder = tmp_path / "photographs/jar"
    folder.mkdir(parents=True)
    (folder / "link").symlink_to(tmp_path / "home")
    return folder


def table_of(session, name: str, sha256: str = "0" * 64):
    """Write a table of one photograph under a name that leaves the folder, and return the name and the table."""
    name = str(session.parents[1] / "home/mine.dng") if name == "ABSOLUTE" else name
    shot = Shot(name, "object", Pose(45.0, 0.0), "out", 0.02)
    write_captures(session / "captures.csv", [shot], {name: sha256})
    return shot, session / "captures.csv"


@pytest.mark.parametrize("name", LEAVING)
@pytest.mark.parametrize("sha256", ["0" * 64, hashlib.sha256(b"mine").hexdigest(), ""])
def test_a_line_of_a_table_never_moves_a_file_outside_its_folder(session, name, sha256):
    shot, table = table_of(session, name, sha256)
    with pytest.raises(InputError, match=r"captures\.csv: .*file: found .*leaves its folder|a link that leads out"):
        Journal(table).retire([Shot(shot.file, "object", Pose(45.0, 0.0), "out", 0.5)])
    assert (session.parents[1] / "home/mine.dng").read_bytes() == b"mine"
    assert sorted(file.name for file in session.iterdir()) == ["captures.csv", "link"]


@pytest.mark.parametrize("name", LEAVING)
def test_a_photograph_outside_the_folder_is_not_read(session, name):
    shot, table = table_of(session, name)
    with pytest.raises(InputError, match=r"leaves its folder|a link that leads out"):
        read_captures(table, session)
    with pytest.raises(InputError, match=r"leaves its folder|a link that leads out"):
        shot_path(shot, table, session)


def test_links_within_a_folder_and_to_a_folder_are_followed(session):
    (session / "raw").mkdir()
    (session / "raw/a.dng").write_bytes(b"raw")
    (session / "b.dng").symlink_to(session / "raw/a.dng")
    (session.parent / "also").symlink_to(session)
    assert confined(session, "raw/a.dng", "t.csv", "file").read_bytes() == b"raw"
    assert confined(session.parent / "also", "b.dng", "t.csv", "file").read_bytes() == b"raw"


@given(parts=st.lists(st.sampled_from(["a", "..", ".", "", "b.dng", "/", "...", "..a"]), min_size=1, max_size=6))
@settings(max_examples=200)
def test_what_is_let_through_ends_inside(tmp_path_factory, parts):
    folder = tmp_path_factory.getbasetemp() / "inside"
    try:
        found = confined(folder, "/".join(parts), "t.csv", "file")
    except InputError:
        assert ".." in parts or "/".join(parts).startswith("/")
    else:
        assert os.path.normpath(found) == str(folder) or os.path.normpath(found).startswith(f"{folder}/")


def test_a_mark_that_is_a_link_is_not_written(session):
    (session / ".session").symlink_to(session.parents[1] / "home/profile")
    with (
        pytest.raises(InputError, match=r"\.session.*a link that leads out"),
        claimed(session / "t.csv", session, "jar"),
    ):
        pass
    assert not (session.parents[1] / "home/profile").exists()


def test_a_virtual_session_removes_nothing_behind_a_link(tmp_path):
    from irodori.capture.stage import _start_over_if_changed

    (tmp_path / "real").mkdir()
    (tmp_path / "real/a.dng").write_bytes(b"a day's work")
    (tmp_path / "jar").mkdir()
    (tmp_path / "jar/captures").symlink_to(tmp_path / "real")
    with pytest.raises(InputError, match="a link that leads out"):
        _start_over_if_changed(tmp_path / "jar/captures/captures.csv", tmp_path / "session.json", MADE)
    assert (tmp_path / "real/a.dng").read_bytes() == b"a day's work"


@pytest.mark.parametrize("uri", ["../secret.bin", "%2e%2e/secret.bin", "/etc/hostname", "link/secret.bin"])
def test_a_gltf_reads_no_buffer_outside_its_folder(tmp_path, uri):
    (tmp_path / "secret.bin").write_bytes(bytes(100))
    folder = tmp_path / "mesh"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    (folder / "a.gltf").write_text(json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": uri}]}))
    with pytest.raises(InputError, match=r"a\.gltf: buffers: found .*leaves its folder|a link that leads out"):
        mesh_files(folder / "a.gltf")


@pytest.mark.parametrize("name", ["tile-plate\n", "../objects/tile-plate", "Tile"])
def test_a_name_is_small_letters_digits_and_hyphens_and_nothing_after(root, name):
    with pytest.raises(InputError, match="small letters, digits and hyphens"):
        load_one("objects", name, root)


def test_a_name_in_a_file_does_not_end_in_a_newline(root):
    edit(root, "scenes/still-life.yaml", "objects.0.object", "tile-plate\n")
    assert "small letters, digits and hyphens" in str(fault(root))
    edit(root, "scenes/still-life.yaml", "objects.0.object", "tile-plate")
    edit(root, "scenes/still-life.yaml", "views", {"front\n": {}})
    assert "small letters, digits and hyphens" in str(fault(root))


# ---- bombs


def merge_keys(levels: int) -> str:
    lines = ["a0: &a0 {x: 1}"]
    lines += [f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}" for i in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (merge_keys(8), "unfold without end"),
        (merge_keys(30), "unfold without end"),
        ("a: &a [*a]", "an alias inside itself"),
        ("a: &a {<<: *a}", "an alias inside itself"),
        ("a: " + "[" * 3000 + "]" * 3000, "nested more than 64 deep"),
        ("a: [" + "1," * 30_000 + "]", "more than 25000 values"),
        ("a: &a x\nb: [" + "*a," * 2000 + "]", "more than 1000 aliases"),
        ("a: " + ":".join(["1"] + ["59"] * 50_000), "a number or a date of 150001 letters"),
        ("a: x\n" * 100_000, "more than 262144 bytes"),
        ("__use_yte__: true\na: ?print(1)", "a template"),
    ],
)
def test_what_would_unfold_without_end_is_refused_before_it_does(tmp_path, text, found):
    (tmp_path / "bomb.yaml").write_text(text)
    began = time.process_time()
    with pytest.raises(InputError, match=rf"bomb\.yaml: .*{found}"):
        read_yaml(tmp_path / "bomb.yaml")
    assert time.process_time() - began < 5.0


def test_aliases_and_merge_keys_that_a_person_writes_are_read(tmp_path):
    (tmp_path / "a.yaml").write_text("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}\nc: [*a, *a]\n")
    found = read_yaml(tmp_path / "a.yaml")
    assert found["b"] == {"x": 1, "y": 3} and found["c"] == [{"x": 1, "y": 2}] * 2


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("text", [merge_keys(8), '__use_yte__: true\ny: ?open("run", "w").write("x")\n'])
def test_snakemake_does_not_unfold_or_run_a_configuration(tmp_path, text):
    (tmp_path / "config").mkdir()
    (tmp_path / "config/config.yaml").write_text(text)
    command = [sys.executable, "-m", "snakemake", "-n", "--cores", "1", "-s", ROOT / "workflow/Snakefile"]
    run = patience.run(list(map(str, command)), cwd=tmp_path)
    said = run.stdout + run.stderr
    assert run.returncode != 0 and "config/config.yaml: " in said and "accepted: " in said
    assert not (tmp_path / "run").exists()


# ---- declared sizes


def glb(folder, content: dict, data: bytes = bytes(96)):
    """Write a binary glTF of one buffer."""
    text = json.dumps({"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(data)}], **content}).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    (folder / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    return folder / "a.glb"


def triangle(index: int) -> tuple[dict, bytes]:
    """Return a glTF of one triangle whose last corner is a vertex of this number."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4").tobytes()
    uv = np.array([[0, 0], [1, 0], [0, 1]], dtype="<f4").tobytes()
    faces = np.array([0, 1, index], dtype="<u4").tobytes()
    data = corners + uv + faces
    views = [{"buffer": 0, "byteOffset": o, "byteLength": n} for o, n in ((0, 36), (36, 24), (60, 12))]
    kinds = [("VEC3", 5126), ("VEC2", 5126), ("SCALAR", 5125)]
    accessors = [{"bufferView": i, "componentType": c, "count": 3, "type": t} for i, (t, c) in enumerate(kinds)]
    part = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
    rest = {"meshes": [{"primitives": [part]}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "materials": [{}]}
    return {"bufferViews": views, "accessors": accessors, "scene": 0, **rest}, data


def test_a_triangle_on_a_vertex_that_is_not_there_is_refused(tmp_path):
    assert len(read_mesh(glb(tmp_path, *triangle(2)), "mm").faces) == 1
    with pytest.raises(InputError, match=r"a\.glb"):
        read_mesh(glb(tmp_path, *triangle(32768)), "mm")


def test_meshes_that_declare_more_than_they_hold_are_refused(tmp_path):
    huge = {"accessors": [{"componentType": 5126, "count": 10**12, "type": "VEC3"}]}
    with pytest.raises(InputError, match=r"a\.glb: found a header that declares .* of geometry in a file of"):
        read_mesh(glb(tmp_path, huge), "mm")
    for kind in ("ascii", "binary_little_endian"):
        head = (
            f"ply\nformat {kind} 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\n"
        )
        (tmp_path / "a.ply").write_text(head + "end_header\n0 0 0\n")
        with pytest.raises(InputError, match=r"a\.ply: found a header that declares"):
            read_mesh(tmp_path / "a.ply", "mm")


def test_a_part_placed_ten_thousand_times_is_refused(tmp_path):
    content, data = triangle(2)
    content["nodes"] = [{"mesh": 0}] * 200
    content["scenes"] = [{"nodes": list(range(200))}]
    content["meshes"][0]["primitives"] *= 50
    with pytest.raises(InputError, match=r"a\.glb: nodes: found parts placed so often"):
        read_mesh(glb(tmp_path, content, data), "mm")


def material_file(path, change, replaced: str = "alpha"):
    """Write a material of which one dataset is what ``change`` puts there, by its own program from the start."""
    whole = material(0.5)
    maps = {name: getattr(whole, name) for name in ("alpha", "beta", "mu", "green_response")}
    with store.create(path, MADE) as out:
        for name in maps.keys() - {replaced}:
            out.write(name, maps[name], units="1", dims="row,column", quantity=name)
        write_coefficients(out, COEFFICIENTS, whole.coefficients, quantity="coefficients")
        constants = {"lobes": whole.lobes, "typical_gloss": whole.typical_gloss, "coat": whole.coat}
        write_constants(out, whole.basis, whole.n, whole.k, whole.mirror, None, **constants)
        change(out)
    return path


def test_a_dataset_that_declares_more_than_its_file_holds_is_refused(tmp_path):
    def huge(out):
        out.reserve("alpha", (10**6, 10**6), np.float64, units="1", dims="many,more", quantity="alpha")

    with pytest.raises(InputError, match=r"material\.h5: alpha: found .*declares 8000000000000 bytes"):
        Material.load(material_file(tmp_path / "material.h5", huge))


@pytest.mark.parametrize("kind", ["link", "raw"])
def test_a_dataset_in_another_file_is_refused(tmp_path, kind):
    other = tmp_path / "other.h5"
    material(0.5).save(other, MADE)

    def elsewhere(out):
        file = out._file  # what writes files of the project has no way to do this
        if kind == "link":
            file["alpha"] = h5py.ExternalLink(str(other), "/alpha")
        else:
            file.create_dataset("alpha", (4, 8), "f8", external=[(str(other), 0, h5py.h5f.UNLIMITED)])

    with pytest.raises(InputError, match=r"material\.h5: alpha: found a dataset that stands in another file"):
        Material.load(material_file(tmp_path / "material.h5", elsewhere))


def panorama(path, width: int = 16, height: int = 8):
    spec = oiio.ImageSpec(width, height, 3, "half")
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(np.ones((height, width, 3), np.float32)) and out.close()
    return path


def test_an_exr_whose_names_are_not_utf8_or_whose_size_is_not_its_own_is_refused(tmp_path):
    path = panorama(tmp_path / "a.exr")
    content = path.read_bytes()
    assert len(list(rgb_picture(path).read())) == 1
    path.write_bytes(content.replace(b"B\0\1\0\0\0", b"\xff\0\1\0\0\0", 1))
    with pytest.raises(InputError, match=r"a\.exr: found a header whose text is not UTF-8"):
        rgb_picture(path)
    window = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    for right, bottom in ((2**30, 2**29), (65535, 32767)):
        path.write_bytes(content[: window + 8] + struct.pack("<ii", right, bottom) + content[window + 16 :])
        with pytest.raises(InputError, match=r"a\.exr: "):
            rgb_picture(path)


# ---- numbers that nothing real has


def profile(matrix=None, curve=None) -> bytes:
    known = standard_display("Display P3")
    made = Profile("a", known.xyz_from_rgb, (curve or ParametricCurve(2.2),) * 3)
    return write_profile(made if matrix is None else made._replace(xyz_from_rgb=matrix))


def with_number(data: bytes, tag: bytes, at: int, value: float) -> bytes:
    """Return a profile with another fixed-point number in a tag."""
    entry = data.index(tag, 132)
    offset = int.from_bytes(data[entry + 4 : entry + 8], "big") + at
    return data[:offset] + struct.pack(">i", round(value * 65536)) + data[offset + 4 :]


@pytest.mark.parametrize("gamma", [0.0, -1.0, 300.0])
def test_a_profile_of_a_gamma_that_no_curve_has_is_refused(gamma):
    with pytest.raises(InputError, match=r"a\.icc: found a tone curve of the exponent"):
        read_profile(with_number(profile(), b"rTRC", 12, gamma), "a.icc")


@pytest.mark.parametrize(("at", "value"), [(16, -1.0), (16, 0.5), (24, 5.0), (32, 0.5)])
def test_a_profile_whose_curve_falls_or_does_not_end_at_white_is_refused(at, value):
    """The factor a, the slope c below a joint d, and the offset e of the parameters."""
    data = profile()
    if at == 24:
        data = with_number(data, b"gTRC", 28, 0.5)
    with pytest.raises(InputError, match=r"a\.icc: .*tone curve"):
        read_profile(with_number(data, b"gTRC", at, value), "a.icc")


def test_a_profile_whose_samples_fall_is_refused():
    data = profile(curve=SampledCurve(np.linspace(0.0, 1.0, 50)))
    start = data.index(b"curv") + 12
    with pytest.raises(InputError, match="a tone curve that falls"):
        read_profile(data[:start] + data[start : start + 8192][::-1] + data[start + 8192 :], "a.icc")


@pytest.mark.parametrize("red", [0.2, 0.9])
def test_a_profile_whose_colorants_do_not_make_white_is_refused(red):
    data = profile()
    assert read_profile(data, "a.icc").xyz_from_rgb.sum(axis=1)[1] == pytest.approx(1.0)
    with pytest.raises(InputError, match=r"a\.icc: found colorants whose sum is .* not the white"):
        read_profile(with_number(data, b"rXYZ", 8, red * D50_XYZ[0]), "a.icc")


def first_is(values: np.ndarray, value: float) -> np.ndarray:
    """Return numbers of which the first is another."""
    changed = values.copy()
    changed.flat[0] = value
    return changed


@pytest.mark.parametrize(
    ("field", "name"), [("basis", "reflectance/basis"), ("n", "refractive_index/n"), ("k", "refractive_index/k")]
)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_material_with_a_number_that_is_none_is_refused(tmp_path, field, name, value):
    path, whole = tmp_path / "material.h5", material(0.5)
    replace(whole, **{field: first_is(getattr(whole, field), value)}).save(path, MADE)
    with pytest.raises(InputError, match=rf"material\.h5: {name}: found the value"):
        Material.load(path)


@pytest.mark.parametrize("n", [1e20, 0.0, 10.5])
def test_a_refractive_index_that_no_material_has_is_refused(tmp_path, n):
    path = tmp_path / "material.h5"
    material(0.5, n=n).save(path, MADE)
    with pytest.raises(InputError, match=r"refractive_index/n: found the value .*numbers from 0\.001 to 10"):
        Material.load(path)
    table = tmp_path / "index.csv"
    table.write_text("wavelength_nm,n,k\n" + "".join(f"{w},{n},0\n" for w in range(400, 701, 20)))
    with pytest.raises(InputError, match=r"index\.csv: 400 nm: found n = .*accepted: n from 0\.001 to 10"):
        index_table(table)


def test_a_surface_that_reflects_more_than_falls_on_it_is_refused(tmp_path):
    """By more than its error, that is: one that is poorly known may."""
    path, bright = tmp_path / "material.h5", material(1.3)
    material(1.19).save(path, MADE)
    assert Material.load(path).observed.all()
    bright.save(path, MADE)
    with pytest.raises(InputError, match=r"reflectance/coefficients: found a reflectance factor of 1\.3.*up to 1\.2"):
        Material.load(path)
    error = np.full(bright.alpha.shape, 0.2, np.float32)
    replace(bright, extra={"reflectance_error": (error, "1", "standard deviation")}).save(path, MADE)
    assert Material.load(path).observed.all()


@pytest.mark.parametrize("name", ["coefficients", "basis", "irradiance"])
def test_an_environment_with_a_number_that_is_none_is_refused(tmp_path, name):
    path, whole = tmp_path / "sky.h5", constant_light()
    replace(whole, **{name: first_is(getattr(whole, name), np.nan)}).save(path, MADE)
    with pytest.raises(InputError, match=rf"sky\.h5: {name}: found"):
        Environment.load(path)
