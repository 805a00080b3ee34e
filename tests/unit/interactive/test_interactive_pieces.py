"""The parts of the interactive integrator by themselves: vectors, cube maps, rows of lobes, what shapes hide."""

import dataclasses
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lobe_albedos import lobe_albedo
from scenes import BALL, fresnel, material

from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.sphere import arc_tangent
from irodori.jit import functions, vector_memory
from irodori.light.environment_file import directions
from irodori.light.equirectangular import look_up
from irodori.light.gloss_maps import GlossMaps
from irodori.light.irradiance import irradiance_at
from irodori.reflection.albedo import gloss_albedo
from irodori.reflection.fresnel import fresnel_array
from irodori.rendering.interactive.cube_maps import (
    Corners,
    at_corners,
    cell_of,
    environment_pyramid,
    face_directions,
    face_of,
    fill_borders,
    from_equirectangular,
    give_back,
    keep_corners,
    look_up_cube,
)
from irodori.rendering.interactive.prepared_scene import needed_gloss
from irodori.rendering.interactive.round_lobes import (
    ANGLES,
    ROUGHNESSES,
    TAPS,
    gloss_power,
    grid_cells,
    lobe_table,
    roughness_at,
    roughness_place,
    samples_about_mirror,
)
from irodori.rendering.scene_arrays import make_objects


@numba.njit
def _exercise(a, b, numbers, out):
    x, y = vector_memory.load(a, 0, 16), vector_memory.load(b, 0, 16)
    mask = (x > y) & ~(y < 0.25)
    vector_memory.store(out, 0, functions.select(mask, x * 2.0 - y, functions.root(functions.magnitude(y)) / (1.0 + x)))
    vector_memory.store(out, 16, vector_memory.gather(a, vector_memory.load(numbers, 0, 16)))
    vector_memory.store(out, 32, arc_tangent(y, x))
    vector_memory.store(out, 48, functions.with_sign(functions.lower_of(functions.upper_of(x, 0.1), 0.6), -y))
    vector_memory.compress(out, 64, mask, x)
    return vector_memory.mask_bits(mask), vector_memory.total(x), vector_memory.largest(x)


def test_vectors_compute_what_numpy_computes():
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1, 1, (2, 16)).astype(np.float32)
    numbers = rng.permutation(16).astype(np.int32)
    out = np.zeros(96, np.float32)
    bits, total, largest = _exercise(a, b, numbers, out)
    mask = (a > b) & ~(b < 0.25)
    assert 0 < mask.sum() < 16
    assert bits == sum(1 << i for i in np.flatnonzero(mask))
    assert np.allclose(out[:16], np.where(mask, a * 2 - b, np.sqrt(np.abs(b)) / (1 + a)), rtol=1e-6)
    assert np.array_equal(out[16:32], a[numbers])
    assert np.abs(out[32:48] - np.arctan2(b, a)).max() <= 1e-5
    assert np.array_equal(out[48:64], np.copysign(np.clip(a, np.float32(0.1), np.float32(0.6)), -b))
    assert np.array_equal(out[64 : 64 + mask.sum()], a[mask]) and (out[64 + mask.sum() :] == 0).all()
    assert total == pytest.approx(a.sum(), abs=1e-6) and largest == a.max()


def test_halves_are_read_as_the_numbers_that_they_are():
    values = np.array([1.0, -0.5, 6e-8, 65504.0], dtype=np.float16)
    out = np.zeros(4, np.float32)

    @numba.njit
    def read(halves, out):
        vector_memory.store(out, 0, vector_memory.load(halves, 0, 4))

    read(values.view(np.uint16), out)
    assert np.array_equal(out, values.astype(np.float32))


# --- cube maps -----------------------------------------------------------------------------------------------------


def smooth(unit):
    return np.stack([2 + unit[..., 0], 1 + unit[..., 1] * unit[..., 2], 1 - unit[..., 2] ** 2], axis=-1)


def directions_near_edges(count=4000):
    """Unit vectors, half of them within a hundredth of an edge or of a corner."""
    rng = np.random.default_rng(1)
    unit = rng.normal(size=(count, 3))
    near = 1 + 0.01 * rng.normal(size=count // 2)
    unit[: count // 4, 0] = unit[: count // 4, 1] * near[: count // 4]
    corners = np.copysign(np.stack([near[count // 4 :]] * 3, axis=1) ** [1, 2, 3], unit[count // 4 : count // 2])
    unit[count // 4 : count // 2] = corners
    return unit / np.linalg.norm(unit, axis=1, keepdims=True)


def test_a_map_errs_with_the_square_of_a_texel_over_edges_and_corners_too():
    unit = directions_near_edges()
    errors = []
    for side in (16, 32, 64):
        stored = np.zeros((6, side + 2, side + 2, 3), np.float32)
        stored[:, 1:-1, 1:-1] = smooth(np.stack([face_directions(face, side) for face in range(6)]))
        fill_borders(stored)
        errors.append(np.abs(look_up_cube(stored, unit) - smooth(unit)).max())
    assert errors[0] < 0.02 and errors[2] < errors[0] / 8


@numba.njit
def _compiled_look_up(texels, side, unit, corners, out):
    for i in range(0, unit.shape[1], 16):
        face, u, v = face_of(
            vector_memory.load(unit[0], i, 16), vector_memory.load(unit[1], i, 16), vector_memory.load(unit[2], i, 16)
        )
        cell, x, y = cell_of(face, u, v, vector_memory.spread(np.float32(side), 16))
        one, stride = vector_memory.spread(np.float32(1.0), 16), vector_memory.spread(side + 2, 16)
        keep_corners(corners, cell, stride, (x, y), one)
        for ray in range(16):
            found = at_corners(texels, corners, ray, vector_memory.load(texels, 0, 4))
            vector_memory.store(out, (i + ray) * 4, found)


def test_compiled_look_up_is_that_of_numpy():
    stored = np.random.default_rng(2).random((6, 10, 10, 4)).astype(np.float32)
    unit = directions_near_edges(320).astype(np.float32)
    out = np.zeros(320 * 4, np.float32)
    corners = Corners(np.zeros(64, np.float32), 0, np.zeros(32, np.int32), 0)
    _compiled_look_up(stored.ravel(), 8, np.ascontiguousarray(unit.T), corners, out)
    assert np.abs(out.reshape(-1, 4) - look_up_cube(stored, unit.astype(np.float64))).max() <= 1e-4


def solid_angles(side):
    """Of a face's texels, sr."""
    place = 2.0 * np.arange(side + 1) / side - 1.0
    u, v = np.meshgrid(place, place)
    corner = np.arctan(u * v / np.sqrt(1 + u * u + v * v))
    return corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]


@pytest.mark.parametrize("row", [3, 20, 40, 60])
def test_the_power_of_a_one_texel_sun_is_kept(row):
    picture = np.zeros((64, 128, 1), np.float32)
    picture[row, 77] = 1e6
    pyramid = environment_pyramid(picture, np.eye(1), 4)
    power = float(picture[..., 0].ravel() @ directions(128, 64)[1].ravel())
    for first, side in zip(pyramid.first[:2], pyramid.side[:2], strict=True):
        count = 6 * (side + 2) ** 2 * 4
        stored = pyramid.texels[first : first + count].reshape(6, side + 2, side + 2, 4)
        values = stored[:, 1:-1, 1:-1, 0].astype(np.float64)
        # Bilinear between the source's pixels, and sampled: its power is that of a blurred sun.
        assert (values * solid_angles(side)).sum() == pytest.approx(power, rel=0.1)


def test_lights_of_one_pixel_are_hardly_blurred_between_the_pixels_of_a_picture():
    """Where a flat mirror magnifies the picture; texels as wide as its pixels would err by half of the contrast."""
    rng = np.random.default_rng(3)
    picture = (rng.random((128, 256, 1)) < 0.03).astype(np.float32)
    unit = rng.normal(size=(4000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = unit[np.abs(unit[:, 2]) < 0.7]  # pixels are narrow about the poles
    pyramid = environment_pyramid(picture, np.eye(1), 4)
    side, wanted = int(pyramid.side[0]), np.empty((len(unit), 1))
    stored = pyramid.texels[: pyramid.first[1]].reshape(6, side + 2, side + 2, 4)
    look_up(picture, unit, wanted)
    assert (look_up_cube(stored, unit)[:, :1] - wanted).std() < 0.3 * wanted.std()


def test_an_irradiance_map_loses_little_by_going_round():
    picture = smooth(directions(128, 64)[0]).astype(np.float32)
    stored = np.stack(list(from_equirectangular(picture, 64)))
    unit = directions_near_edges()
    assert np.abs(look_up_cube(stored, unit) - irradiance_at(picture, unit)).max() <= 1e-3


def resident_file_kb():
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status["RssFile"].split()[0])


def test_a_mapped_picture_gives_its_memory_back_and_stays_what_it_is(tmp_path):
    values = np.arange(8_000_000, dtype=np.float32)
    np.save(tmp_path / "picture.npy", values)
    mapped = np.load(tmp_path / "picture.npy", mmap_mode="r")
    view = mapped.reshape(2000, 1000, 4)[:1000]
    total = float(mapped.sum(dtype=np.float64))
    before = resident_file_kb()
    give_back(view)
    assert before - resident_file_kb() > 25_000
    assert float(mapped.sum(dtype=np.float64)) == total
    give_back(values)  # no file: nothing to give
    assert values[-1] == len(values) - 1


# --- lobes -------------------------------------------------------------------------------------------------------


def test_rows_of_lobes_are_near_the_true_ones_where_these_are_short():
    distance = lobe_table().distance
    theta = np.degrees(np.arccos(np.linspace(0, 1, ANGLES) ** 2))
    mu = roughness_at(np.arange(ROUGHNESSES))
    short = np.ix_(mu < 0.22, theta < 60)
    assert distance[short].max() <= 0.12
    assert distance[np.ix_((mu > 0.1) & (mu < 0.35), theta < 77)].max() <= 0.31
    assert distance[np.ix_(mu > 0.35, theta < 60)].max() <= 0.41


@pytest.mark.parametrize(("low", "high", "count"), [(-0.4, 1.3, 40), (0.0, 0.2, 5), (-2.0, -0.1, 9)])
def test_cells_fill_their_range_and_are_narrowest_about_zero(low, high, count):
    centre, width = grid_cells(0.05, low, high, count)
    assert len(centre) == len(width) == count and width.sum() == pytest.approx(high - low)
    edges = low + np.concatenate([[0.0], np.cumsum(width)])
    np.testing.assert_allclose(centre, 0.5 * (edges[1:] + edges[:-1]))
    # They grow with the distance from zero as its hyperbolic sine does, from the scale on.
    np.testing.assert_allclose(np.diff(np.arcsinh(edges / 0.05)), np.ptp(np.arcsinh(edges / 0.05)) / count)


@pytest.mark.parametrize(("name", "least"), [("gaussian", 0.97), ("ggx", 0.935)])
def test_gloss_in_even_light_is_the_lobes_albedo_also_between_entries_of_the_table(name, least):
    """A tenth was lost where neighbouring entries have their weight in different lobes of the row."""
    entries, lacquer = lobe_table(name).entries.astype(np.float64), fresnel_array(np.linspace(0.0, 1.0, 2001), 1.5, 0.0)

    def reflected(cosine):
        return np.interp(cosine, np.linspace(0.0, 1.0, 2001), lacquer)

    for mu in (0.06, 0.13, 0.21, 0.3, 0.4, 0.45, 0.5, 0.55, 0.7, 0.8, 1.0, 1.2):
        for theta_deg in (5.0, 20.0, 40.0, 50.0, 58.0, 63.4, 68.0, 72.0, 78.0, 81.5):
            place, angle = float(roughness_place(mu, name)), np.sqrt(np.cos(np.radians(theta_deg))) * (ANGLES - 1)
            i, j = min(int(place), ROUGHNESSES - 2), int(angle)
            of_mu, of_angle = np.array([1 - place + i, place - i]), np.array([1 - angle + j, angle - j])
            entry = np.einsum("a,b,pabe->pe", of_mu, of_angle, entries[:, i : i + 2, j : j + 2])
            weight, incidence = entry[:, 1 : 1 + 3 * TAPS : 3], entry[:, 3 : 1 + 3 * TAPS : 3]
            found = (
                np.pi * float(gloss_power(np.ones(1), np.array([mu]), name)[0]) * (weight * reflected(incidence)).sum()
            )
            seen = samples_about_mirror(name, mu, float(np.radians(theta_deg)), (192, 128))
            exact = (seen.value * seen.solid_angle) @ reflected(seen.cos_h)
            assert least <= found / exact <= 1.03, (mu, theta_deg)


@pytest.mark.parametrize("index", [(1.5, 0.0), (2.2, 0.0), (0.2, 3.4)], ids=["lacquer", "zircon", "metal"])
@pytest.mark.parametrize(("place", "tolerance"), [(6, 7e-3), (10, 1e-2), (12, 1.5e-2), (14, 2e-2), (16, 2e-2)])
def test_a_row_reflects_even_light_as_its_lobe_does(place, tolerance, index):
    """At every view angle: what Fresnel makes of a lobe is not what it makes of the lobe's middle."""
    table, mu = lobe_table().entries[0, place], float(roughness_at(place))
    for cosine, entry in zip(np.linspace(0, 1, ANGLES)[4:] ** 2, table[4:], strict=True):
        true = gloss_albedo("gaussian", mu, cosine, *index).item() / mu**2
        weights, incidence = entry[1 : 1 + 3 * TAPS : 3], entry[3 : 1 + 3 * TAPS : 3].astype(np.float64)
        assert float(weights @ fresnel(incidence, *index)) == pytest.approx(true, rel=tolerance)


@given(place=st.floats(0, ROUGHNESSES - 1.001), root=st.floats(0.25, 0.999))
@settings(deadline=None, max_examples=40)
def test_between_its_entries_the_table_keeps_the_power(place, root):
    table = lobe_table().entries[0]
    i, j = int(place), int(root * (ANGLES - 1))
    fi, fj = place - i, root * (ANGLES - 1) - j
    entry = (table[i, j] * (1 - fj) + table[i, j + 1] * fj) * (1 - fi)
    entry = entry + (table[i + 1, j] * (1 - fj) + table[i + 1, j + 1] * fj) * fi
    mu = float(roughness_at(place))
    power = lobe_albedo("gaussian", mu, root**2).item() / mu**2
    assert entry[1 : 1 + 3 * TAPS : 3].sum() == pytest.approx(power, rel=0.03)
    assert roughness_place(mu) == pytest.approx(place, abs=1e-6)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(("mu", "dropped"), [(0.005, False), (0.05, True), (0.3, True)])
def test_blurred_light_that_no_lobe_asks_for_is_left_out(mu, dropped):
    maps = GlossMaps.of(np.random.default_rng(0).random((128, 256, 1)).astype(np.float32))
    fine = dataclasses.replace(maps, first=0, levels=(maps.levels[0],) * maps.first + maps.levels)
    for one in (material(0.5, beta=1.0, mu=mu), material(0.5)):
        objects, _ = make_objects([Placement(BALL)], [one])
        kept = needed_gloss(fine, objects)
        assert kept.first + len(kept.levels) == fine.first + len(fine.levels)
        if one.beta.max() > 0:
            assert (kept.first > 0) == dropped
            assert kept.first <= lobe_table().entries[0, int(roughness_place(mu)) :, :, 0].min() or kept.first == 0
        else:
            assert len(kept.levels) == 1
