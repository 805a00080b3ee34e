"""Normals of meshes that have none, and that the size of a mesh decides nothing."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from shortcuts import ball
from test_meshes import SEEDS, body, cube, in_order

from irodori.geometry.mesh import make_mesh
from irodori.geometry.shapes.triangle_mesh import TriangleMesh


@given(seed=SEEDS)
@settings(deadline=None, max_examples=15)
def test_normals_weighted_by_angle_do_not_depend_on_how_faces_are_cut(seed):
    corners, uv = cube(seed)
    smooth = make_mesh(corners, uv, crease_deg=180.0)
    assert np.abs(smooth.normals - corners / np.sqrt(3)).max() < 1e-12
    creased = make_mesh(corners, uv, crease_deg=40.0)
    assert np.abs(creased.normals - creased.facets[:, None]).max() < 1e-12


@given(scale=st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]), seed=SEEDS)
@settings(deadline=None, max_examples=15)
def test_size_changes_nothing_but_size(scale, seed):
    corners, uv, _ = body(seed)
    small, plain = make_mesh(scale * corners, uv), make_mesh(corners, uv)
    order = [in_order(m.vertices_mm[m.faces] / k, m.normals) for m, k in ((small, scale), (plain, 1.0))]
    assert np.abs(order[0][0] - order[1][0]).max() < 1e-9 and np.abs(order[0][1] - order[1][1]).max() < 1e-9
    assert np.array_equal(TriangleMesh(small).is_covered(32, 32), TriangleMesh(plain).is_covered(32, 32))


@given(crease=st.floats(1.0, 60.0), rings=st.integers(4, 60))
@settings(deadline=None, max_examples=20)
def test_facets_that_meet_at_less_than_the_crease_are_smooth_and_others_keep_their_edge(crease, rings):
    mesh = make_mesh(*ball(10.0, rings, 2 * rings), crease_deg=crease)
    exact = mesh.vertices_mm[mesh.faces] / 10.0
    step = 180.0 / rings
    if crease > 3.0 * step:  # all about a vertex, the corners of two facets included
        assert np.sum(mesh.normals * exact, axis=2)[np.abs(exact[..., 2]) < 0.9].min() > np.cos(np.radians(0.3 * step))
    if crease < 0.2 * step:
        # The two halves of a quadrangle are one plane; nothing else is within the crease away from the poles.
        flat = np.sum(mesh.normals * mesh.facets[:, None], axis=2)[np.abs(exact[..., 2]).max(axis=1) < 0.7]
        assert flat.size == 0 or flat.min() > np.cos(np.radians(crease))
