"""Triangle meshes with UV: what files say, what is refused, which texel lies where, and shading normals."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lathe import lathe, write_lid, write_obj
from made import made
from scipy.spatial import Delaunay
from shortcuts import ball

from irodori.config.models import BodyShape, ObjectShape
from irodori.core.errors import InputError
from irodori.geometry.atlas import NO_FACE, mesh_texels, rasterise
from irodori.geometry.mesh import make_mesh
from irodori.geometry.mesh_files import MM_IN, read_mesh
from irodori.geometry.mesh_sources import mesh_files
from irodori.geometry.shapes.placement import on_table
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh

trimesh = pytest.importorskip("trimesh")
SEEDS = st.integers(0, 2**32 - 1)
FORMATS = ("obj", "ply", "glb", "gltf")


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def facets_of(corners):
    return unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def body(seed=0, segments=12):
    """A closed body of revolution with a chart, and normals that are none of its facets'."""
    rng = np.random.default_rng(seed)
    radius = np.concatenate([[0.0], rng.uniform(5.0, 20.0, 5), [0.0]])
    height = np.cumsum(np.concatenate([[0.0], rng.uniform(2.0, 8.0, 6)]))
    corners, uv = lathe(np.stack([radius, height], axis=1), segments, margin=0.02)
    solid = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 1e-9
    corners, uv = corners[solid], uv[solid]
    normals = unit(facets_of(corners)[:, None] + 0.3 * rng.normal(size=corners.shape))
    return corners, uv, normals


def cube(seed):
    """A cube of 2 mm whose six faces are cut along diagonals drawn at random."""
    rng = np.random.default_rng(seed)
    corners, charts = [], []
    for face in range(6):
        axis, side = face // 2, 1.0 if face % 2 else -1.0
        a, b = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        ring = [side * np.eye(3)[axis] + x * a + y * b for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        chart = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * 0.15 + [face / 6, 0.0]
        cuts = [(0, 1, 2), (0, 2, 3)] if rng.random() < 0.5 else [(0, 1, 3), (1, 2, 3)]
        for cut in cuts:
            order = cut if side > 0 else cut[::-1]
            corners.append([ring[i] for i in order])
            charts.append([chart[i] for i in order])
    return np.array(corners), np.array(charts)


def written(path, corners, uv, normals=None):
    """Write triangles by the library's exporters, or the project's own for OBJ."""
    if path.suffix == ".obj":
        write_obj(path, corners, uv, normals, digits=9)
        return path
    visual = None if uv is None else trimesh.visual.TextureVisuals(uv=uv.reshape(-1, 2) * [1, -1] + [0, 1])
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    own = None if normals is None else normals.reshape(-1, 3)
    part = trimesh.Trimesh(corners.reshape(-1, 3), faces, vertex_normals=own, visual=visual, process=False)
    if path.suffix == ".gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(part)).items():
            (path.parent / (path.name if name.endswith(".gltf") else name)).write_bytes(data)
    elif path.suffix == ".ply":
        part.export(path, vertex_normal=normals is not None)
    else:
        part.export(path)
    return path


def in_order(corners, *others):
    """Triangles sorted by their centres, for formats that may reorder them, each begun at its lowest corner."""
    first = np.argmin(corners @ [1.0, 0.01234, 0.000567], axis=1)
    turn = (first[:, None] + np.arange(3)) % 3
    turned = [np.take_along_axis(values, turn[..., None], axis=1) for values in (corners, *others)]
    order = np.lexsort(np.round(turned[0].mean(axis=1), 3).T)
    return [values[order] for values in turned]


# Files


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("with_normals", [True, False])
def test_a_file_gives_back_its_triangles_texture_coordinates_and_normals(tmp_path, suffix, with_normals):
    corners, uv, normals = body()
    mesh = read_mesh(
        written(tmp_path / f"a.{suffix}", corners, uv, normals if with_normals else None), "mm", "z", [0] * 3
    )
    found = in_order(mesh.vertices_mm[mesh.faces], mesh.uv, mesh.normals)
    expected = in_order(corners, uv, normals)
    assert np.abs(found[0] - expected[0]).max() < 1e-5
    assert np.abs(found[1] - expected[1]).max() < 1e-6
    if with_normals:
        assert np.abs(found[2] - expected[2]).max() < 1e-5
    else:
        # Those computed are means of facets about the corner: far from the disturbed ones.
        assert np.abs(found[2] - expected[2]).max() > 0.1
        assert (np.sum(found[2] * facets_of(found[0])[:, None], axis=2) > 0.7).all()


@given(seed=SEEDS, unit_name=st.sampled_from(sorted(MM_IN)), up=st.sampled_from(["y", "z"]), pivoted=st.booleans())
@settings(deadline=None, max_examples=12)
def test_unit_up_and_pivot_place_the_mesh(tmp_path_factory, seed, unit_name, up, pivoted):
    corners, uv, _ = body(seed)
    path = written(tmp_path_factory.mktemp("mesh") / "a.obj", corners, uv)
    pivot = np.random.default_rng(seed).uniform(-5, 5, 3) if pivoted else None
    mesh = read_mesh(path, unit_name, up, pivot)
    turned = corners if up == "z" else np.stack([corners[..., 0], -corners[..., 2], corners[..., 1]], axis=-1)
    expected = MM_IN[unit_name] * turned
    flat = expected.reshape(-1, 3)
    expected = expected - (0.5 * (flat.min(axis=0) + flat.max(axis=0)) if pivot is None else pivot)
    found, expected = in_order(mesh.vertices_mm[mesh.faces])[0], in_order(expected)[0]
    assert np.abs(found - expected).max() < 1e-6 * MM_IN[unit_name] * 50
    # It stands on the table with its lowest point.
    _, top = on_table(TriangleMesh(mesh), np.eye(3), 50.0)
    assert top.corners()[:, 2] == pytest.approx(np.full(4, expected[..., 2].min()), abs=1e-4 * MM_IN[unit_name])


def test_parts_of_a_scene_stand_where_its_nodes_put_them(tmp_path):
    corners, uv, _ = body()
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    scene = trimesh.Scene()
    for index, scale in enumerate((1.0, -1.0)):  # the second is mirrored, and so is its winding
        chart = uv.reshape(-1, 2) * [0.5, 1.0] + [0.5 * index, 0.0]
        visual = trimesh.visual.TextureVisuals(uv=chart * [1, -1] + [0, 1])
        place = np.diag([scale, 1.0, 1.0, 1.0])
        place[0, 3] = 100.0 * index
        part = trimesh.Trimesh(corners.reshape(-1, 3), faces, visual=visual, process=False)
        scene.add_geometry(part, node_name=f"n{index}", geom_name=f"g{index}", transform=place)
    scene.export(tmp_path / "two.glb")
    mesh = read_mesh(tmp_path / "two.glb", "mm", pivot_mm=[0, 0, 0])
    assert len(mesh.faces) == 2 * len(corners)
    assert mesh.vertices_mm[:, 0].max() == pytest.approx(100.0 - corners[..., 0].min(), abs=1e-4)
    outward = np.sum(mesh.facets * (mesh.vertices_mm[mesh.faces].mean(axis=1) - [0, 0, 15]), axis=1)
    assert (outward[: len(corners)] * [1]).sum() > 0  # both halves face outward
    volume = np.einsum("fi,fi->f", mesh.vertices_mm[mesh.faces[:, 0]], np.cross(*(
        mesh.vertices_mm[mesh.faces[:, c]] for c in (1, 2)))).sum() / 6  # fmt: skip
    one = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(2 * one, rel=1e-4)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_mesh_without_texture_coordinates_is_refused_with_what_to_do(tmp_path, suffix):
    corners, _, _ = body()
    with pytest.raises(InputError, match=r"no texture coordinates.*unwrap"):
        read_mesh(written(tmp_path / f"a.{suffix}", corners, None), "mm")


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_damaged_file_is_refused(tmp_path, suffix):
    path = written(tmp_path / f"a.{suffix}", *body()[:2])
    path.write_bytes(path.read_bytes()[: 40 if suffix == "obj" else 100])
    with pytest.raises(InputError):
        read_mesh(path, "mm")


@pytest.mark.parametrize("face", ["f 0/1 1/2 2/3", "f 1/1\t2/0 3/3", "\tf 1/1/1 2/2/2 3/3/0", "f 1 2 00"])
def test_an_obj_that_counts_from_zero_is_refused_with_the_face(tmp_path, face):
    path = tmp_path / "zero.obj"
    corners = "v 0 0 0\nv 10 0 0\nv 10 10 0\nvt 0.1 0.1\nvt 0.9 0.1\nvt 0.9 0.9\n"
    path.write_text(f"{corners}f 1/1 2/2 3/3\r\n{face}\n")
    with pytest.raises(
        InputError, match=rf"faces: found the face '{face.strip()}'.*, with an index of 0".replace("\t", ".*")
    ):
        read_mesh(path, "mm")


def test_unknown_kinds_units_and_axes_list_the_known_ones(tmp_path):
    (tmp_path / "a.stl").write_text("solid")
    with pytest.raises(InputError, match=r"\.stl.*\.obj, \.ply, \.glb, \.gltf"):
        read_mesh(tmp_path / "a.stl", "mm")
    path = written(tmp_path / "a.obj", *body()[:2])
    with pytest.raises(ValueError, match=r"furlong.*mm, cm, m, inch"):
        read_mesh(path, "furlong")
    with pytest.raises(ValueError, match=r"'x'.*z, y"):
        read_mesh(path, "mm", "x")
    with pytest.raises(InputError, match="no such file"):
        mesh_files(tmp_path / "none.obj")


def test_a_gltf_and_its_buffers_are_one_input(tmp_path):
    path = written(tmp_path / "a.gltf", *body()[:2])
    files = mesh_files(path)
    assert files[0] == str(path) and len(files) > 1 and all((tmp_path / f).is_file() for f in files)
    (tmp_path / files[1]).unlink()
    with pytest.raises(InputError, match="does not exist"):
        mesh_files(path)


# What makes a surface wrong


def square(u0=0.0, v0=0.0, u1=1.0, v1=1.0, z=0.0):
    """Two triangles of 10 mm, their face up, with a rectangle of the texture."""
    place = np.array([[0, 0, z], [10, 0, z], [10, 10, z], [0, 10, z]], dtype=float)
    chart = np.array([[u0, v1], [u1, v1], [u1, v0], [u0, v0]])
    faces = [[0, 1, 2], [0, 2, 3]]
    return place[faces], chart[faces]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_coordinates_that_are_not_finite_are_refused_with_their_number(bad):
    corners, uv, normals = body()
    for name, values in (("vertices", corners), ("UV", uv), ("normals", normals)):
        broken = values.copy()
        broken[[3, 7], 1, 0] = bad
        arguments = {
            "vertices": (broken, uv, normals),
            "UV": (corners, broken, normals),
            "normals": (corners, uv, broken),
        }
        with pytest.raises(InputError, match=f"{name}: found 2 of {len(corners)} triangles"):
            make_mesh(*arguments[name])


def test_a_repeated_texture_is_refused():
    corners, uv = square(u1=2.0)
    with pytest.raises(InputError, match=r"2 of 2 triangles outside 0\.\.1"):
        make_mesh(corners, uv)


@given(seed=SEEDS)
@settings(deadline=None, max_examples=20)
def test_overlapping_charts_are_refused_with_the_number_of_texels(seed):
    rng = np.random.default_rng(seed)
    width, height = rng.integers(4, 40, 2)
    left, top = rng.integers(0, width - 1), rng.integers(0, height - 1)
    right, bottom = rng.integers(left + 1, width + 1), rng.integers(top + 1, height + 1)
    upper = square(z=5.0)
    lower = square(left / width, top / height, right / width, bottom / height)
    mesh = make_mesh(*(np.concatenate(pair) for pair in zip(upper, lower, strict=True)))
    expected = (right - left) * (bottom - top)
    with pytest.raises(InputError, match=f"overlap in {expected} of {width} x {height} texels"):
        rasterise(mesh, int(width), int(height))


def test_charts_smaller_than_a_texel_are_refused():
    corners, uv = square(0.5, 0.5, 0.5001, 0.5001)
    with pytest.raises(InputError, match="no triangle over any centre"):
        rasterise(make_mesh(corners, uv), 16, 16)


def test_triangles_without_area_are_left_out_and_nothing_else_changes():
    corners, uv, normals = body()
    flat = np.concatenate([corners, corners[:5, [0, 1, 1]], np.repeat(corners[:3, :1], 3, axis=1)])
    mesh, plain = make_mesh(flat, np.concatenate([uv, uv[:5], uv[:3]])), make_mesh(corners, uv)
    assert np.array_equal(mesh.faces, plain.faces) and np.array_equal(mesh.normals, plain.normals)
    with pytest.raises(InputError, match="none with an area"):
        make_mesh(flat[-3:], uv[:3])
    assert np.isfinite(make_mesh(flat, np.concatenate([uv, uv[:5], uv[:3]]), np.concatenate(
        [normals, normals[:8]])).normals).all()  # fmt: skip


def test_a_triangle_wound_against_its_neighbours_is_refused():
    corners, uv, _ = body()
    turned = corners.copy()
    turned[40] = turned[40, ::-1]
    with pytest.raises(InputError, match="3 edges whose two triangles look to opposite sides"):
        make_mesh(turned, uv)


def test_a_closed_surface_inside_out_is_refused_and_so_are_normals_that_look_inward():
    corners, uv, normals = body()
    with pytest.raises(InputError, match="looks inward"):
        make_mesh(corners[:, ::-1], uv[:, ::-1])
    with pytest.raises(InputError, match="100% of the area with normals against its winding"):
        make_mesh(corners, uv, -normals)


def test_an_inconsistent_winding_is_found_through_a_gap_of_rounding():
    corners, uv = square()
    corners[1] = corners[1, ::-1] + 1e-6
    with pytest.raises(InputError, match="1 edge whose two triangles look to opposite sides"):
        make_mesh(corners, uv)
    corners[1] += 1e-3  # two sheets, each of which may look where it likes
    make_mesh(corners, uv)


@pytest.mark.parametrize("lean_deg", [10.0, 55.0, 80.0])
def test_normals_that_lean_on_a_flat_surface_are_refused_with_their_angle(lean_deg):
    corners, uv = square()
    lean = np.radians(lean_deg)
    outward = unit((corners - [5.0, 5.0, 0.0]) * [1.0, 1.0, 0.0]) * np.sin(lean) + [0.0, 0.0, np.cos(lean)]
    with pytest.raises(InputError, match=rf"100% of the area .* by up to {lean_deg:.0f} degrees.*crease_deg"):
        make_mesh(corners, uv, outward)
    make_mesh(corners, uv, np.broadcast_to([0.0, 0.0, 1.0], corners.shape))


def test_one_of_two_triangles_with_normals_against_it_is_refused():
    corners, uv = square()
    normals = np.zeros_like(corners)
    normals[:, :, 2] = [[1.0], [-1.0]]
    with pytest.raises(InputError, match="50% of the area with normals against its winding"):
        make_mesh(corners, uv, normals)


def test_smooth_normals_are_taken_and_those_that_round_off_flat_sides_are_told_of(caplog):
    corners, uv = ball(10.0, 24, 48)
    solid = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 1e-9
    make_mesh(corners[solid], uv[solid], corners[solid])
    assert "lean" not in caplog.text
    corners, uv = cube(0)
    make_mesh(corners, uv, corners)
    assert re.search(r"on 100 % of the area they lean .* more than 15 degrees, up to 55; .*crease_deg", caplog.text)


def test_a_chart_without_area_is_told_of_with_the_share_of_the_surface(caplog):
    corners, uv = square()
    make_mesh(corners, uv)
    assert not caplog.text
    uv[1, 1:] = uv[1, 0]
    make_mesh(corners, uv)
    assert "UV: 50.0 % of the area has texture coordinates on one point or line" in caplog.text


# Polygons of an OBJ

ARROW = [(-40.0, -40.0), (0.0, 0.0), (40.0, -40.0), (0.0, 40.0)]
PENTAGON = [(30.0 * float(np.cos(a)), 30.0 * float(np.sin(a))) for a in 2.0 * np.pi * np.arange(5) / 5]
STAR = [
    (r * float(np.cos(a)), r * float(np.sin(a)))
    for a, r in zip(np.pi * np.arange(10) / 5, [40.0, 12.0] * 5, strict=True)
]


def obj_of(path, polygon, end="\n"):
    """Write a polygon, (x, y) mm, as one face in the plane z = y / 2, whose chart is the polygon."""
    lines = [f"v {x!r} {y!r} {y / 2!r}" for x, y in polygon] + [
        f"vt {(x + 50) / 100} {(y + 50) / 100}" for x, y in polygon
    ]
    lines.append("f " + " ".join(f"{i}/{i}" for i in range(1, len(polygon) + 1)))
    path.write_bytes(end.join([*lines, ""]).encode())
    return path


@pytest.mark.parametrize("polygon", [ARROW, PENTAGON, STAR, [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (20.0, 20.0)]])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_polygons_of_an_obj_become_triangles_that_cover_them_once(tmp_path, polygon, end):
    for turned in range(len(polygon)):
        points = polygon[turned:] + polygon[:turned]
        mesh = read_mesh(obj_of(tmp_path / "a.obj", points, end), "mm", pivot_mm=(0.0, 0.0, 0.0))
        x, y = np.array(points).T
        area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
        flat = mesh.vertices_mm[mesh.faces][..., :2]
        found = 0.5 * np.linalg.det(flat[:, 1:] - flat[:, :1])
        assert (found > 0.0).all() and found.sum() == pytest.approx(area, rel=1e-9)
        assert (rasterise(mesh, 100, 100) >= 0).sum() == pytest.approx(area, abs=60.0)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("v 0,5 0,5 0\n", "the line 'v 0,5 0,5 0', with decimal commas; accepted: numbers with decimal points"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3 9\n", "'f 1 2 3 9', with a vertex that is none of the 4"),
        ("v 0 0 0\nv 9 9 0\nv 9 0 0\nv 0 9 0\nf 1 2 3 4\n", "'f 1 2 3 4', which cannot be cut .*triangulate"),
    ],
)
def test_an_obj_that_cannot_be_read_as_triangles_is_refused_with_its_line(tmp_path, lines, said):
    (tmp_path / "a.obj").write_text(lines)
    with pytest.raises(InputError, match=said):
        read_mesh(tmp_path / "a.obj", "mm")


def test_three_sheets_that_share_an_edge_are_a_surface_like_any_other():
    edge = np.array([[0.0, 0, 0], [0, 10, 0]])
    sheets, charts = [], []
    for index, angle in enumerate((0.3, 2.4, 4.5)):
        tip = np.array([[10 * np.cos(angle), 5, 10 * np.sin(angle)]])
        sheets.append(np.concatenate([edge, tip]))
        charts.append(np.array([[0.0, 0], [0, 1], [1, 0.5]]) * [0.3, 0.9] + [index / 3, 0.05])
    mesh = make_mesh(np.array(sheets), np.array(charts))
    shape = TriangleMesh(mesh)
    found = shape.atlas(90, 60)
    assert all(found.covered[:, 30 * i : 30 * i + 30].sum() > 300 for i in range(3))
    assert np.isfinite(found.normal[found.covered]).all()


# Texels


def partition(rng, points, snap=None):
    """A flat mesh over the whole texture, x = 100 u and y = 80 v, z a plane, triangulated at random."""
    inner = rng.uniform(0, 1, (points, 2))
    if snap is not None:  # vertices exactly on texel centres: edges run through centres
        inner = (np.floor(inner * snap) + 0.5) / snap
    uv = np.unique(np.concatenate([[[0, 0], [1, 0], [0, 1], [1, 1]], inner]), axis=0)
    faces = Delaunay(uv).simplices
    chart = uv[faces]
    turn = np.linalg.det(chart[:, 1:] - chart[:, :1])
    chart[turn < 0] = chart[turn < 0][:, ::-1]
    chart = chart[np.abs(turn) > 1e-12]
    place = np.concatenate([chart * [100.0, 80.0], (chart @ [20.0, -10.0])[..., None]], axis=-1)
    return make_mesh(place, chart)


@given(seed=SEEDS, width=st.integers(2, 60), height=st.integers(2, 60), snapped=st.booleans())
@settings(deadline=None, max_examples=40)
def test_every_texel_centre_of_a_partition_has_one_triangle_and_its_own_place(seed, width, height, snapped):
    rng = np.random.default_rng(seed)
    mesh = partition(rng, int(rng.integers(3, 60)), np.array([width, height]) if snapped else None)
    face_of = rasterise(mesh, width, height)
    assert (face_of != NO_FACE).all()
    found = mesh_texels(mesh, face_of)
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    expected = np.stack([100 * u, 80 * v, 20 * u - 10 * v], axis=-1)
    # A sliver of the partition loses the digits of its own flatness.
    assert np.abs(found.position - expected).max() < 1e-7
    normal = unit(np.cross([100, 0, 20.0], [0, 80, -10.0]))
    assert np.abs(found.facet - normal).max() < 1e-6 and np.abs(found.normal - normal).max() < 1e-6


def test_a_chart_holds_the_centres_inside_it_and_no_others():
    # Edges of charts on texel borders: 6 x 3 texels of 16 x 8, the rest none.
    mesh = make_mesh(*square(4 / 16, 2 / 8, 10 / 16, 5 / 8))
    found = TriangleMesh(mesh).atlas(16, 8)
    expected = np.zeros((8, 16), bool)
    expected[2:5, 4:10] = True
    assert np.array_equal(found.covered, expected)
    assert np.isnan(found.position[~expected]).all() and np.isfinite(found.position[expected]).all()
    assert found.position[2, 4] == pytest.approx([10 * 0.5 / 6, 10 - 10 * 0.5 / 3, 0.0])


def test_a_mirrored_chart_is_as_good():
    corners, uv = square()
    mesh = make_mesh(corners, uv * [-1, 1] + [1, 0])
    found = TriangleMesh(mesh).atlas(8, 8)
    assert found.covered.all() and (found.facet == [0, 0, 1]).all()
    assert found.position[0, 0] == pytest.approx([10 - 10 / 16, 10 - 10 / 16, 0])


def test_rows_of_the_atlas_are_those_of_the_whole():
    corners, uv, _ = body()
    shape = TriangleMesh(make_mesh(corners, uv))
    whole = shape.atlas(40, 30)
    for name in ("position", "normal", "facet", "covered"):
        parts = [getattr(shape.atlas(40, 30, rows), name) for rows in ((0, 1), (1, 17), (17, 30))]
        assert np.array_equal(np.concatenate(parts), getattr(whole, name), equal_nan=name != "covered"), name
    assert np.array_equal(shape.is_covered(40, 30), whole.covered)


@pytest.mark.parametrize("rings", [32, 128])
def test_a_sphere_of_triangles_has_the_texels_of_the_sphere(rings):
    shape = TriangleMesh(make_mesh(*ball(25.0, rings, 2 * rings)))
    position, normal = shape.texels(64, 32)
    exact, direction = Shape.from_definition(
        made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": 25.0})
    ).texels(64, 32)
    known = np.isfinite(position[..., 0])
    # At the poles the quadrangles are triangles that leave half of the texture free.
    assert known[1 + 64 // rings // 2 : -(1 + 64 // rings // 2)].all()
    # Linear interpolation along a diagonal: an eighth of its second derivative, P_θθ + 2 P_θφ + P_φφ over the step
    # squared, whose length is at most 1 + 2 |cosθ| + sinθ <= 1 + √5 radii.
    bound = (1 + np.sqrt(5)) * (np.pi / rings) ** 2 / 8
    assert np.linalg.norm(position - exact, axis=-1)[known].max() < 25.0 * bound
    # The normals at the vertices are means themselves.
    assert np.linalg.norm(normal - direction, axis=-1)[known].max() < 1.5 * bound


@pytest.mark.parametrize("by", ["triangle", "vertex"])
def test_a_ply_has_texture_coordinates_by_triangle_or_by_vertex(tmp_path, by):
    """With those by triangle, one vertex has several; its normal is one."""
    corners, uv, _ = body()
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    if by == "vertex":
        vertices, index = corners.reshape(-1, 3), np.arange(3 * len(corners))
    normals = np.zeros_like(vertices)
    np.add.at(normals, index.ravel(), np.repeat(facets_of(corners), 3, axis=0))
    normals = unit(normals)
    stored = uv.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0]
    of_vertex = ["s", "t"] if by == "vertex" else []
    header = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    header += [f"property double {name}" for name in ["x", "y", "z", "nx", "ny", "nz", *of_vertex]]
    header += [f"element face {len(corners)}", "property list uchar int vertex_indices"]
    header += ["property list uchar double texcoord"] * (by == "triangle") + ["end_header"]
    columns = [vertices, normals, stored] if by == "vertex" else [vertices, normals]
    rows = [" ".join(map(repr, row.tolist())) for row in np.hstack(columns)]
    for triangle, pairs in zip(index.reshape(-1, 3), stored.reshape(-1, 6), strict=True):
        line = ["3", *map(str, triangle.tolist())]
        rows.append(" ".join([*line, "6", *map(repr, pairs.tolist())] if by == "triangle" else line))
    (tmp_path / "body.ply").write_text("\n".join([*header, *rows, ""]))
    found = read_mesh(tmp_path / "body.ply", "mm", pivot_mm=(0.0, 0.0, 0.0))
    expected = make_mesh(corners, uv, normals[index].reshape(-1, 3, 3))
    for one, other in ((found.vertices_mm[found.faces], expected.vertices_mm[expected.faces]),
                       (found.uv, expected.uv), (found.normals, expected.normals)):  # fmt: skip
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_vertices_with_round_coordinates_are_kept_apart():
    """A grid of whole millimetres, whose coordinates have few bits that are not 0, keeps its vertices apart."""
    x, y = np.meshgrid(np.arange(-64.0, 64.0), np.arange(-64.0, 64.0))
    low, high = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), np.stack([x + 1, y + 1, 0 * x], axis=-1).reshape(-1, 3)
    side = np.stack([x + 1, y, 0 * x], axis=-1).reshape(-1, 3)
    mesh = make_mesh(
        np.stack([low, side, high], axis=1), np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], (len(low), 1, 1))
    )
    assert len(mesh.vertices_mm) == 129**2 - 1 and len(np.unique(mesh.vertices_mm, axis=0)) == len(mesh.vertices_mm)


@pytest.mark.heavy
def test_a_million_triangles_are_a_mesh_like_any_other():
    rings, segments = 500, 1000
    shape = TriangleMesh(make_mesh(*ball(30.0, rings, segments)))
    assert len(shape.mesh.faces) == 2 * segments * (rings - 1)
    found = shape.atlas(512, 256, (100, 140))
    assert found.covered.all()
    assert np.abs(np.linalg.norm(found.position, axis=-1) - 30.0).max() < 30.0 * (np.pi / rings) ** 2 / 4
    assert np.abs(found.normal - found.position / 30.0).max() < 1e-4


def test_the_example_lid_is_what_its_script_writes(tmp_path):
    from pathlib import Path

    write_lid(tmp_path / "lid.obj")
    kept = Path(__file__).resolve().parents[2] / "config/meshes/lid.obj"
    assert kept.read_text() == (tmp_path / "lid.obj").read_text()
    mesh = read_mesh(kept, "mm")
    assert mesh.bottom_mm == pytest.approx(-14.4) and len(mesh.faces) > 1000


def test_samples_are_spread_by_area():
    mesh = make_mesh(*ball(10.0, 24, 48))
    position, normal = mesh.samples(2000)
    assert np.abs(position.mean(axis=0)).max() < 0.15
    assert np.mean(position[:, 2] > 5.0) == pytest.approx(0.25, abs=0.02)  # a cap's area goes with its height
    assert np.sum(normal * unit(position), axis=1).min() > 0.99
