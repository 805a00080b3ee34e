"""Pixels at outlines of the integrator `interactive`: what they cover, which they are, and what stays as it is."""

import numpy as np
import pytest
from made import made
from quadrangles import box
from scenes import BALL, OPTIONS, material, plate, smooth_light
from studio import even_light, prepared, sky_of, view_of

from irodori.config.models import Scene, Size, View
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.plane import Plane
from irodori.rendering.integrators import render_image
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, render_frame
from irodori.rendering.interactive.pixel_rays import rays_through, render_rays
from irodori.rendering.interactive.smooth_outlines import spread_points
from irodori.rendering.scene_arrays import make_view
from irodori.rendering.single_pixels import middle_rays

CROWD = [plate(120.0), BALL, BALL]
PLACES = [(0, 0, 0), (-22, 0, 20), (22, 5, 20)]
MATERIALS = [material(0.5, beta=1.0, mirror=0.5), material(0.3, beta=3.0, mu=0.2, mirror=0.6),
             material(mirror=1.0, n=0.2, k=3.0)]  # fmt: skip
#: Neither side is a multiple of a tile's 16 pixels.
CROWD_VIEW = {"position": (20, -250, 130), "target": (0, 0, 10), "fov": 24, "size": (50, 40)}
SIZE = 47


def from_above(height_mm: float):
    """Parallel rays on a square picture, its middle off that of a ball at the origin."""
    seen = {"position_mm": [0.3, -0.2, 200.0], "target_mm": [0.3, -0.2, 0.0], "up": [0.0, 1.0, 0.0],
            "kind": "orthographic", "height_mm": height_mm}  # fmt: skip
    return make_view(made(View, seen), made(Size, {"width": SIZE, "height": SIZE}))


def covered_by_ball(view, radius_mm: float) -> np.ndarray:
    """Share of each pixel within the outline of a ball at the origin: chords, whose middle rule is near exact."""
    steps = 400
    across = (np.arange(SIZE * steps) + 0.5) / steps
    column = (across - SIZE / 2) / view.focal_px + view.position_mm[0]
    half = np.sqrt(np.maximum(radius_mm**2 - column**2, 0.0))
    # Rows count downwards.
    low, high = (SIZE / 2 + view.focal_px * (view.position_mm[1] + sign * half) for sign in (-1, 1))
    row = np.arange(SIZE)[:, None]
    length = np.clip(np.minimum(high, row + 1) - np.maximum(low, row), 0.0, 1.0) * (half > 0)
    return length.reshape(SIZE, SIZE, steps).mean(axis=2)


@pytest.mark.parametrize(("smooth", "rms", "most"), [(False, 0.35, 0.51), (True, 0.045, 0.14)])
def test_a_pixel_at_the_outline_of_a_ball_shows_the_share_that_the_ball_covers(smooth, rms, most):
    light, dark, view = even_light(), 0.25, from_above(60.0)
    covered = covered_by_ball(view, 20.0)
    found = render_frame(prepared([BALL], [material(dark)], light, smooth_outlines=smooth), view)
    # Every point of the ball has the same radiance, a quarter of that of the light behind it.
    share = (1.0 - found[..., 1] / found[0, 0, 1]) / (1.0 - dark)
    partly = (covered > 0.0) & (covered < 1.0)
    assert partly.sum() > 100
    off = (share - covered)[partly]
    assert 0.3 * rms < np.sqrt(np.mean(off**2)) < rms and np.abs(off).max() < most
    np.testing.assert_allclose(share[~partly], covered[~partly], atol=1e-3)


def shares_of(shape: np.ndarray) -> np.ndarray:
    """For how much each ray of a pixel counts, (16,), from what they meet: no shape counts for more than it covers."""
    share = np.zeros(16)
    for number in set(shape.tolist()):
        members = np.nonzero(shape == number)[0]
        shaded = [ray for ray in (2, 4, 11, 13) if ray in members] or [members[0]]
        share[shaded] = len(members) / 16 / len(shaded)
    return share


@pytest.mark.parametrize("representation", ["coefficients", "spectral"])
def test_outlines_show_each_shape_by_its_share_and_all_else_stays_as_it_was(representation):
    light, view, bands = sky_of(smooth_light, 64), view_of(**CROWD_VIEW), representation == "spectral"
    plain, fine = (
        prepared(CROWD, MATERIALS, light, representation, places=PLACES, smooth_outlines=smooth)
        for smooth in (False, True)
    )
    before, after = (render_frame(ready, view, bands=bands) for ready in (plain, fine))
    # What the rays meet, by a tracer of its own.
    tracer = Tracer(plain.owned[0].placements)
    pixels = np.stack(np.meshgrid(np.arange(view.width), np.arange(view.height)), axis=-1).reshape(-1, 2)
    places = pixels[:, None] + spread_points().astype(np.float64)
    shape = tracer.intersect(*middle_rays(view, places.reshape(-1, 2)))[1].reshape(-1, 16)
    mixed = (shape != shape[:, :1]).any(axis=1)
    changed = (before != after).any(axis=2).ravel()
    # The tracer calculates in single precision too, so that a ray that touches an outline may go either way.
    assert mixed.sum() > 100 and changed[mixed].mean() > 0.9 and (changed & ~mixed).sum() <= 1
    rays = rays_through(view.finer(4), 4 * places[changed].reshape(-1, 2))
    traced = render_rays(plain, view, rays, bands=bands).reshape(changed.sum(), 16, -1)
    wanted = np.einsum("nrc,nr->nc", traced, np.array([shares_of(one) for one in shape[changed]]))
    off = np.abs(after.reshape(len(pixels), -1)[changed] / wanted - 1.0).max(axis=1)
    assert np.percentile(off, 98) < 2e-3
    # The mean over all rays is near, unlike the ray through the middle.
    whole = traced.mean(axis=1)
    one, several = (np.abs(shown.reshape(len(pixels), -1)[changed] - whole).mean() for shown in (before, after))
    assert several < 0.2 * one


def test_sky_beside_and_after_outlines_is_that_of_rays_of_its_own():
    """A ball in the corner of the picture: whole tiles of sky follow tiles whose pixels were rendered again."""
    light, view = sky_of(smooth_light, 64), view_of((20, -250, 130), target=(30, 0, -30), fov=24, size=(80, 64))
    plain, fine = (
        prepared([BALL], [material(0.3, beta=3.0, mu=0.2, mirror=0.6)], light, smooth_outlines=smooth)
        for smooth in (False, True)
    )
    found = render_frame(fine, view)
    pixels = np.stack(np.meshgrid(np.arange(view.width), np.arange(view.height)), axis=-1).reshape(-1, 2) + 0.5
    alone = render_rays(plain, view, rays_through(view, pixels)).reshape(found.shape)
    met = Tracer(plain.owned[0].placements).intersect(*middle_rays(view, pixels))[1].reshape(found.shape[:2]) >= 0
    sky = ~met
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        sky &= ~np.roll(met, step, axis=axis)
    tiles = met.reshape(4, 16, 5, 16).any(axis=(1, 3)).ravel()
    assert met.sum() > 100 and (~tiles[tiles.argmax() :]).sum() > 5
    np.testing.assert_allclose(found[sky], alone[sky], rtol=1e-5)


def test_the_edge_between_two_faces_of_a_shape_is_an_outline_but_no_flat_or_round_place():
    lamp = (CollimatedLamp(np.array([1.0, -0.3, 0.4])),), np.ones((1, 61))
    cube, ground = box(20.0, outward=True), Plane()

    def refined(shape, **view):
        """The pixels that more rays change, and how many there are of these, but for those beside the nine tiles."""
        shown, rays = [], []
        for smooth in (False, True):
            ready, figures = prepared([shape], [material(0.5)], even_light(), lamps=lamp[1], smooth_outlines=smooth), {}
            shown.append(render_frame(ready, view_of(**view), lamps=lamp[0], figures=figures))
            rays.append(figures["rays"])
        return (shown[0] != shown[1]).any(axis=2), rays[1] - rays[0] - 9 * 64

    # The edge between two faces is the middle column; above and below, the cube ends outside of the picture.
    edges, rays = refined(cube, position=(150.0, -150.0, 0.0), fov=10.0)
    assert edges[:, 20].all() and rays <= 3 * 41 * 16
    # Plain ground up to near the horizon, seen from just above it: at the horizon, some rays see the sky.
    _, rays = refined(ground, position=(0.0, -200.0, 3.0), target=(0.0, 0.0, 3.0), fov=30.0)
    assert 41 * 16 <= rays <= 3 * 41 * 32
    assert refined(BALL, position=(0.0, -200.0, 0.0), fov=7.0)[1] == 0


def test_a_scene_has_smooth_outlines_unless_it_says_no():
    seen = {"position_mm": [0, -200, 0], "target_mm": [0, 0, 0], "up": [0, 0, 1], "field_of_view_deg": 13.0}
    scene = {"objects": [{"object": "ball", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}],
             "image": {"width": 24, "height": 24}, "views": {"front": seen}}  # fmt: skip
    light, shown = even_light(), []
    for said in ({}, {"smooth_outlines": True}, {"smooth_outlines": False}):
        integrator = {"kind": "interactive", "light_maps": False} | said
        one = made(Scene, scene | {"integrator": integrator})
        shown.append(render_image(one, "front", [BALL], [material(0.25)], light, OPTIONS)[0][..., 30])
    assert np.array_equal(shown[0], shown[1])
    # Without, each pixel is all of the ball, or all of the light behind it.
    between = [int(((one > 1.01 * one.min()) & (one < 0.99 * one.max())).sum()) for one in shown]
    assert between[2] == 0 and between[1] > 40


def test_points_of_a_pixel_are_spread():
    points = spread_points().astype(np.float64)
    assert len(np.unique(np.floor(4 * points), axis=0)) == 16
    for axis in range(2):
        assert np.array_equal(np.sort(np.floor(16 * points[:, axis])), np.arange(16))
    assert points.mean(axis=0) == pytest.approx(0.5, abs=1e-6)
