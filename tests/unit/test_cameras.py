"""Cameras: a thin lens by its formula, parallel rays by their sizes, and what an integrator refuses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from made import made
from path_scenes import DARK, ball
from scenes import BALL, OPTIONS, constant_light, material, pixel_rays, plate

from irodori.config.models import Render, Scene, SceneLight, Size, View
from irodori.geometry.shapes.placement import Placement
from irodori.light.placed_lights import unit_luminance
from irodori.rendering.integrators import render_image
from irodori.rendering.reference.converging_picture import make_scene, render
from irodori.rendering.scene_arrays import make_objects, make_view
from irodori.rendering.view_cameras import aim

FOCUS, LENS, FIELD, SIDE = 200.0, 30.0, 13.0, 64
FOCAL = SIDE / 2 / np.tan(np.radians(FIELD / 2))
ALONG_Y = {"position_mm": [0.0, -FOCUS, 0.0], "target_mm": [0.0, 0.0, 0.0], "up": [0.0, 0.0, 1.0]}
EYE = ALONG_Y | {"field_of_view_deg": FIELD}
THROUGH_LENS = EYE | {"lens": {"diameter_mm": LENS, "focus_mm": FOCUS}}
SEEN_AT_ONCE = ALONG_Y | {"kind": "orthographic", "height_mm": 120.0}


def scene_of(view, places, integrator, size=(SIDE, SIDE), turn=(0.0, 0.0, 0.0), **more):
    """A definition with bare objects ``o0``, ``o1``, ..."""
    objects = [
        {"object": f"o{i}", "position_mm": list(p), "rotation_deg": list(turn), "scale": 1.0}
        for i, p in enumerate(places)
    ]
    image = {"width": size[0], "height": size[1]}
    return {"image": image, "objects": objects, "views": {"v": view}, "integrator": integrator, **more}


INTEGRATORS = [
    {"kind": "interactive", "light_maps": False},
    {"kind": "reference", "samples": 64, "seed": 0},
]


def seen(view, shapes, materials, places, integrator, light=None, **more):
    light = constant_light() if light is None else light
    options = replace(OPTIONS, pixel_side=4)
    return render_image(
        made(Scene, scene_of(view, places, integrator, **more)), "v", shapes, materials, light, made(Render, options)
    )[0]


def lamp_through(view, depth, samples=512, size=(SIDE, SIDE), radius=0.4):
    """The picture of a small lamp on the line of sight, (height, width), one band, and the lamp's radius in px."""
    shapes, paints = [ball(0.01)], [material(0.0)]
    placements = [Placement(shapes[0], np.eye(3), np.array([0.0, -1e4, 0.0]))]
    lamp = {
        "kind": "sphere",
        "spectrum": "E",
        "position_mm": [0.0, depth - FOCUS, 0.0],
        "radius_mm": radius,
        "radiance": 1.0,
    }
    prepared = make_scene(placements, make_objects(placements, paints)[0], DARK, made(Sequence[SceneLight], [lamp]))
    return render(
        prepared, make_view(made(View, view), made(Size, {"width": size[0], "height": size[1]})), samples
    ).radiance[..., 30]


def width_px(picture):
    """Diameter of the even disc of the same second moment."""
    weight = picture / picture.sum(dtype=float)
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    cx, cy = (weight * x).sum(), (weight * y).sum()
    return 4 * np.sqrt(0.5 * (weight * ((x - cx) ** 2 + (y - cy) ** 2)).sum())


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("depth", [120.0, 160.0, 280.0, 500.0])
def test_a_point_off_focus_is_a_circle_of_the_thin_lens_formula(depth):
    picture = lamp_through(THROUGH_LENS, depth)
    blur = LENS * abs(depth - FOCUS) / depth / FOCUS * FOCAL
    own = 2 * 0.4 / depth * FOCAL
    # Variances add: of the circle, of the lamp's disc and of a pixel.
    assert width_px(picture) == pytest.approx(np.sqrt(blur**2 + own**2 + 16 / 12), rel=0.03)
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    assert (picture[np.hypot(x, y) > (blur + own) / 2 + 1.5] == 0).all()
    # Even over the circle: a quarter of the light within half its radius, which a pixel's width blurs.
    assert picture[np.hypot(x, y) < blur / 4].sum() / picture.sum() == pytest.approx(0.25, abs=0.05)


def test_a_lens_spreads_light_and_neither_adds_nor_loses_any():
    """A ball beyond the focus, through lenses and without: radiance times pixels is that of its disc in the picture."""
    disc = np.pi * (16 / np.tan(np.radians(FIELD / 2)) * 8.0 / np.sqrt(300.0**2 - 8.0**2)) ** 2
    for lens in ({}, {"lens": {"diameter_mm": 6.0, "focus_mm": FOCUS}}, THROUGH_LENS):
        picture = lamp_through(EYE | lens, 300.0, samples=1024, size=(32, 32), radius=8.0)
        assert picture.sum(dtype=float) == pytest.approx(disc * unit_luminance("E")[30], rel=0.01)
    assert (picture[0] == 0).all() and (picture[:, 0] == 0).all()


def test_an_edge_in_focus_stays_sharp_and_one_off_focus_does_not():
    """A black plate that faces the eye and ends in the middle of a column, before even light."""
    black, upright = [material(0.0)], (90.0, 0.0, 0.0)
    edge = {
        "shapes": [plate(400.0)],
        "materials": black,
        "turn": upright,
        "integrator": INTEGRATORS[1],
        "size": (SIDE, 8),
    }
    there = 400.0 / 2 - 0.5 * FOCUS / FOCAL / SIDE * 8
    view = THROUGH_LENS | {"field_of_view_deg": 2 * np.degrees(np.arctan(4 / FOCAL))}
    sharp = seen(view, places=[(-there, 0.0, 0.0)], **edge)[..., 30]
    blurred = seen(view, places=[(-there, 60.0, 0.0)], **edge)[..., 30]
    assert ((sharp > 1e-3) & (sharp < 1 - 1e-3)).any(axis=0).sum() <= 1
    assert (sharp[:, : SIDE // 2 - 1] == 0).all() and np.allclose(sharp[:, SIDE // 2 + 1 :], 1.0)
    mixed = ((blurred > 1e-3) & (blurred < 1 - 1e-3)).any(axis=0).sum()
    circle = LENS * 60.0 / 260.0 / FOCUS * FOCAL
    assert circle - 2 <= mixed <= circle + 2


def test_places_on_the_lens_are_even():
    view = make_view(made(View, THROUGH_LENS), made(Size, {"width": 8, "height": 8}))
    origin, direction = np.empty((2, 3))
    u, v = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(64) + 0.5) / 64)
    places = []
    for a, b in zip(u.ravel(), v.ravel(), strict=True):
        aim(view, (4.0, 4.0), (a, b), origin, direction)
        places.append(origin.copy())
        at = origin + direction * (FOCUS / direction[1])
        assert np.allclose(at, 0.0, atol=1e-9)  # through the middle of the plane in focus
    offset = np.array(places) - [0.0, -FOCUS, 0.0]
    radius = np.hypot(offset[:, 0], offset[:, 2])
    assert (offset[:, 1] == 0).all() and radius.max() <= LENS / 2
    for share in (0.2, 0.5, 0.8):
        assert (radius <= LENS / 2 * np.sqrt(share)).mean() == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: i["kind"])
def test_parallel_rays_show_a_ball_of_one_size_at_every_distance(integrator):
    """Black balls of radius 20 mm before even light, 120 mm of height: their area in pixels, near and far."""
    areas = []
    for distance in (0.0, 100.0, 900.0):
        picture = seen(SEEN_AT_ONCE, [BALL], [material(0.0)], [(-17.0, distance, 9.0)], integrator)[..., 30]
        areas.append((1.0 - picture).sum())
        weight = 1.0 - picture
        y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
        assert (weight * x).sum() / weight.sum() == pytest.approx(-17.0 * SIDE / 120, abs=0.1)
        assert (weight * y).sum() / weight.sum() == pytest.approx(-9.0 * SIDE / 120, abs=0.1)
    assert np.allclose(areas, np.pi * 20.0**2 * (SIDE / 120) ** 2, rtol=0.01)


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: i["kind"])
def test_parallel_rays_see_one_direction_of_the_sky_and_one_cosine_of_a_plate(integrator):
    from scenes import fresnel, sky

    light = sky(lambda d: 2 + d[..., 1:2] + 0.5 * d[..., 2:], 256, 128)
    down = np.array([0.0, 100.0, -60.0]) / np.hypot(100.0, 60.0)
    view = {"kind": "orthographic", "position_mm": [0.0, -100.0, 60.0], "target_mm": [0.0, 0.0, 0.0],
            "up": [0.0, 0.0, 1.0], "height_mm": 40.0}  # fmt: skip
    mirror = material(mirror=1.0, n=0.2, k=3.0)
    picture = seen(view, [plate(2000.0)], [mirror], [(0, 0, 0)], integrator, light=light, size=(16, 16))
    expected = (2 + down[1] - 0.5 * down[2]) * fresnel(-down[2], 0.2, 3.0)
    assert np.allclose(picture[..., 30], expected, rtol=3e-3)
    # What lies behind the plane where the rays start is not seen.
    beside = seen(view, [BALL], [mirror], [(0.0, -160.0, 90.0)], integrator, light=light, size=(16, 16))
    assert np.allclose(beside[..., 30], 2 + down[1] + 0.5 * down[2], rtol=3e-3)


def test_without_a_lens_rays_leave_the_eye_as_they_did():
    view = make_view(made(View, EYE), made(Size, {"width": SIDE, "height": SIDE}))
    truth = pixel_rays(EYE["position_mm"], size=(SIDE, SIDE))
    origin, direction = np.empty((2, 3))
    for x, y in ((0, 0), (13, 40), (63, 63)):
        aim(view, (x + 0.5, y + 0.5), (0.3, 0.9), origin, direction)
        assert np.allclose(direction, truth[y, x]) and np.array_equal(origin, EYE["position_mm"])


def test_what_samples_nothing_refuses_a_lens():
    with pytest.raises(ValueError, match="'interactive', which samples nothing; accepted: a view without a lens"):
        seen(THROUGH_LENS, [BALL], [material(0.5)], [(0, 0, 0)], INTEGRATORS[0])


def test_an_unknown_view_lists_the_kinds():
    with pytest.raises(ValueError, match=r"fisheye.*kinds perspective, orthographic"):
        make_view(made(View, EYE | {"kind": "fisheye"}), made(Size, {"width": 4, "height": 4}))
