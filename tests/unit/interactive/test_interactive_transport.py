"""The interactive integrator's geometry and light: mirrors, gloss, lamps, shadows, textures; scales; what repeats."""

import dataclasses

import numba
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from made import made
from quadrangles import box
from scenes import BALL, OPTIONS, fresnel, material, plate, smooth_light, sphere_hits
from studio import even_light, levels, picture, prepared, sky_of, spectrum_of, view_of

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import Render, Scene
from irodori.geometry.mesh import Mesh
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.rendering.integrators import render_image
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, render_frame

CROWD = [plate(120.0), BALL, BALL]
CROWD_PLACES = [(0, 0, 0), (-22, 0, 20), (22, 5, 20)]
CROWD_VIEW = {"position": (20, -250, 130), "target": (0, 0, 10), "fov": 24, "size": (50, 40)}


def crowd():
    return [material(0.5, beta=1.0, mirror=0.5), material(0.3, beta=3.0, mu=0.2, mirror=0.6),
            material(mirror=1.0, n=0.2, k=3.0)]  # fmt: skip


@pytest.mark.stability(stage="render", case="grazing hits")
@pytest.mark.stability(stage="render", case="Fresnel with large k", k=40.0)
@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4), (2.4, 0.0), (1.2, 40.0)])
def test_a_mirror_shows_fresnel_reflectance_up_to_the_outline(n, k):
    light = even_light()
    found = picture([BALL], [material(mirror=1.0, n=n, k=k)], light)
    ray, normal = sphere_hits()
    cosine = -np.sum(ray * normal, axis=-1)
    truth = xyz_from_radiance(light.upward_white()) @ spectrum_of()
    inside = np.isfinite(cosine) & (cosine > 0.02)
    assert inside.sum() > 1000
    assert np.allclose(found[inside, 1] / truth[1], fresnel(cosine[inside], n, k), atol=1e-3, rtol=2e-3)
    assert found[~np.isfinite(cosine)] / truth == pytest.approx(1.0, abs=1e-3)


def test_a_mirror_shows_the_light_of_the_reflected_direction_and_of_the_turned_one():
    light = sky_of(lambda d: 3 + d[..., 0] - 0.5 * d[..., 1] + 0.7 * d[..., 2])
    turn = rotation_xyz([20.0, -35.0, 140.0])
    # Fine pixels: a ball widens a pixel's cone, and the light is the mean over it.
    size = (161, 161)
    ray, normal = sphere_hits(size=size)
    cosine = -np.sum(ray * normal, axis=-1)
    inside = cosine > 0.3
    reflected = ray + 2 * cosine[..., None] * normal
    for rotation in (np.eye(3), turn):
        found = picture([BALL], [material(mirror=1.0, n=0.01, k=30.0)], light, view={"size": size},
                        frame={"world_from_light": rotation})  # fmt: skip
        local = reflected[inside] @ rotation
        truth = (3 + local @ [1.0, -0.5, 0.7]) * fresnel(cosine[inside], 0.01, 30.0)
        assert np.allclose(levels(found, light)[inside], truth, rtol=5e-3)
        beside = 3 + (ray[0, 0] @ rotation) @ [1.0, -0.5, 0.7]
        assert levels(found, light)[0, 0] == pytest.approx(beside, rel=2e-3)


@pytest.mark.stability(stage="render", case="parallel mirrors")
def test_parallel_mirrors_end_at_the_limit_and_keep_the_energy():
    shapes, places = [plate(100.0), plate(100.0)], [(0, 0, 0), (0, 0, 20.0)]
    over = [np.eye(3), rotation_xyz([180.0, 0.0, 0.0])]
    light = even_light()
    truth = xyz_from_radiance(light.upward_white()) @ spectrum_of()
    view = {"position": (0, -48, 10), "target": (0, 0, 2), "fov": 40, "size": (32, 24)}
    means, mirrors = [], [material(mirror=1.0, n=0.001, k=50.0)] * 2
    for bounces in (0, 1, 3, 10, 40):
        figures = {}
        found = picture(shapes, mirrors, light, view=view, places=places, rotations=over, max_bounces=bounces,
                        frame={"figures": figures})  # fmt: skip
        assert figures["rays"] <= (bounces + 1) * 32 * 24
        assert found.max() <= 1.001 * truth.max() and found.min() >= 0
        means.append(found[..., 1].mean() / truth[1])
    assert means == sorted(means) and means[0] < 0.6 and means[-1] > 0.99


# --- lamps -------------------------------------------------------------------------------------------------------

DARK = even_light((0.0, 0.0, 0.0))
BEAM = np.linspace(1.0, 2.0, 61)[None]


@pytest.mark.parametrize("representation", ["spectral", "coefficients"])
def test_a_lamp_lights_by_equation_5(representation):
    direction = np.array([0.4, -0.7, 0.6])
    direction /= np.linalg.norm(direction)
    paint = material(np.linspace(0.2, 0.7, 61), beta=2.0, mu=0.25)
    found = picture([BALL], [paint], DARK, representation, white=np.ones(61), lamps=BEAM,
                    frame={"lamps": (CollimatedLamp(5.0 * direction, 3.0),)})  # fmt: skip
    ray, normal = sphere_hits()
    matrix = np.eye(61) if representation == "spectral" else xyz_from_radiance(np.ones(61))
    lit = 0
    for y, x in [(20, 20), (14, 20), (20, 27), (28, 12), (25, 33), (33, 24), (16, 26)]:
        if normal[y, x] @ direction <= 0:
            continue
        lit += 1
        angles = angles_from_directions(normal[y, x], direction, -ray[y, x])
        truth = [reflect(1.0, s, 2.0, 0.25, angles) for s in np.linspace(0.2, 0.7, 61)]
        assert np.allclose(found[y, x], matrix @ (np.array(truth) * 3.0 * BEAM[0] / np.pi), rtol=2e-3)
    assert lit >= 4
    away = (normal @ direction < -0.05) & np.isfinite(ray[..., 0])
    assert away.any() and (found[away] == 0).all()


def test_a_ball_throws_the_shadow_of_a_disc():
    """From straight above: the plate is dark within the ball's radius and lit as if alone beyond."""
    view = {"position": (0.0, -0.001, 600.0), "target": (0, 0, 0), "size": (81, 81), "fov": 9.6}
    scene = {"places": [(0, 0, 0), (0, 0, 300.0)], "white": np.ones(61), "lamps": BEAM}
    slanted = np.array([1.0, 0.0, 1.0])
    ready = prepared([plate(4000.0), BALL], [material(0.5), material(0.0)], DARK, **scene)
    shadow = render_frame(ready, view_of(**view | {"target": (-300.0, 0.0, 0.0), "position": (-300.0, -0.001, 600.0)}),
                          lamps=(CollimatedLamp(slanted),))[..., 1]  # fmt: skip
    # The ball stands 300 mm up and the light comes from +x at 45 degrees: the shadow's centre is at x = -300.
    at = (np.arange(81) - 40.0) * (2 * 600 * np.tan(np.radians(4.8)) / 81)
    x, y = np.meshgrid(at, -at)
    radius = np.hypot(x / np.sqrt(2.0), y)
    truth = 0.5 * np.cos(np.pi / 4) * xyz_from_radiance(np.ones(61))[1] @ BEAM[0] / np.pi
    assert (shadow[radius < 19] == 0).all() and (radius < 19).sum() > 300
    assert np.allclose(shadow[radius > 21], truth, rtol=1e-3)


@pytest.mark.stability(stage="render", case="black light")
def test_a_black_lamp_and_lamps_of_no_strength_change_nothing():
    light = even_light()
    plain = picture(CROWD, crowd(), light, view=CROWD_VIEW, places=CROWD_PLACES)
    for spectra, strength in ((np.zeros((1, 61)), 1.0), (BEAM, 0.0)):
        found = picture(CROWD, crowd(), light, view=CROWD_VIEW, places=CROWD_PLACES, lamps=spectra,
                        frame={"lamps": (CollimatedLamp(np.array([0.0, 0.0, 1.0]), strength),)})  # fmt: skip
        assert np.allclose(found, plain, rtol=1e-5, atol=1e-5)
    with pytest.raises(ValueError, match="accepted: three finite numbers"):
        picture(CROWD, crowd(), light, view=CROWD_VIEW, places=CROWD_PLACES, lamps=BEAM,
                frame={"lamps": (CollimatedLamp(np.zeros(3)),)})  # fmt: skip
    with pytest.raises(ValueError, match="accepted: the 1 that the scene was prepared for"):
        picture(CROWD, crowd(), light, view=CROWD_VIEW, places=CROWD_PLACES, lamps=BEAM)


def test_a_scene_of_lamps_alone_has_a_picture():
    sun = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": -90.0, "elevation_deg": 20.0, "irradiance": 1.0}
    seen = {"position_mm": [0, -200, 0], "target_mm": [0, 0, 0], "up": [0, 0, 1], "field_of_view_deg": 13.0}
    where = {"object": "ball", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}
    scene = {"integrator": {"kind": "interactive", "light_maps": False}, "image": {"width": 8, "height": 6},
             "objects": [where], "views": {"front": seen}, "lights": [sun]}  # fmt: skip
    radiance, _ = render_image(made(Scene, scene), "front", [BALL], [material(0.5)], DARK, made(Render, OPTIONS))
    assert np.isfinite(radiance).all() and (radiance[2:4, 3:5] > 0).all()


@pytest.mark.stability(stage="render", case="one-texel sun")
@pytest.mark.stability(stage="render", case="black light")
def test_a_sun_of_one_texel_stays_finite_and_black_light_black():
    light = sky_of(lambda d: np.where((np.arange(256) == 100) & (np.arange(128) == 30)[:, None], 1e6, 0.0))
    found = picture(CROWD, crowd(), light, view=CROWD_VIEW, places=CROWD_PLACES, white=np.ones(61))
    # Blurred light is a Fourier series, which rounds to either side of zero: 1e-9 of the sun's radiance.
    assert np.isfinite(found).all() and found.max() > 0 and found.min() >= -1e-3
    dark = picture(CROWD, crowd(), DARK, view=CROWD_VIEW, places=CROWD_PLACES, white=np.ones(61))
    assert (dark == 0).all()


# --- shapes and scales -------------------------------------------------------------------------------------------


def test_the_picture_shows_a_textures_places():
    values = np.array([[0.1, 0.4], [0.6, 0.9]]).repeat(16, axis=0).repeat(16, axis=1)
    uniform = material(1.0)
    textured = dataclasses.replace(
        uniform, alpha=values, green_response=np.ones_like(values), beta=np.zeros_like(values),
        mu=np.full_like(values, 0.1), coefficients=np.ones((32, 32, 1), np.float32),
    )  # fmt: skip
    light = even_light()
    view = {"position": (0, -0.001, 500), "fov": 11, "size": (40, 40)}
    found = picture([plate(100.0)], [textured], light, view=view)
    truth = xyz_from_radiance(light.upward_white()) @ spectrum_of()
    for rows, columns, value in (
        (slice(5, 18), slice(5, 18), 0.1), (slice(5, 18), slice(22, 35), 0.4),
        (slice(22, 35), slice(5, 18), 0.6), (slice(22, 35), slice(22, 35), 0.9),
    ):  # fmt: skip
        assert np.allclose(found[rows, columns], value * truth, rtol=2e-3)


def square_mesh(side: float) -> Shape:
    """A plate as two triangles with the plate's texture coordinates."""
    corners = side / 2 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    uv = np.stack([corners[:, 0] / side + 0.5, 0.5 - corners[:, 1] / side], axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    return TriangleMesh(Mesh(corners, faces, uv[faces], np.broadcast_to([0.0, 0.0, 1.0], (2, 3, 3)).copy()))


def test_a_mesh_looks_like_the_plate_that_it_is():
    light = even_light()
    pictures = [picture([shape, BALL, BALL], crowd(), light, view=CROWD_VIEW, places=CROWD_PLACES)
                for shape in (plate(120.0), square_mesh(120.0))]  # fmt: skip
    different = (np.abs(pictures[0] - pictures[1]) > 1e-3 * pictures[0].max()).any(axis=-1)
    assert different.mean() <= 2e-3  # pixels on an edge


@pytest.mark.default_cases(1)
@pytest.mark.stability(stage="render", case="scene of 1 mm", scale=1 / 120.0)
@pytest.mark.stability(stage="render", case="scene of 1 km", scale=1e6 / 120.0)
@pytest.mark.parametrize("scale", [1 / 120.0, 1e6 / 120.0])
def test_a_scene_of_a_millimetre_and_one_of_a_kilometre_look_alike(scale):
    light = sky_of(lambda d: 2 + d[..., 0] + d[..., 2])
    lamp = {"lamps": BEAM}
    pictures = [
        picture(CROWD, crowd(), light, view=CROWD_VIEW | {"scale": s}, places=CROWD_PLACES, scale=s,
                frame={"lamps": (CollimatedLamp(np.array([0.3, -0.4, 0.8])),)}, **lamp)
        for s in (1.0, scale)
    ]  # fmt: skip
    different = (np.abs(pictures[0] - pictures[1]) > 2e-3 * pictures[0].max()).any(axis=-1)
    assert different.mean() <= 4e-3


@pytest.mark.stability(stage="render", case="self-intersection")
@pytest.mark.stability(stage="render", case="touching spheres")
def test_spheres_that_touch_and_plates_of_a_kilometre_throw_no_specks():
    """A lamp straight above a plate of 1 km lights it evenly; touching mirrors show light everywhere."""
    ready = prepared([plate(1e6)], [material(0.5)], DARK, white=np.ones(61), lamps=BEAM)
    found = render_frame(
        ready, view_of((0.0, -2e4, 1e4), size=(60, 40)), lamps=(CollimatedLamp(np.array([0.0, 0.0, 1.0])),)
    )
    assert np.ptp(found[..., 1]) <= 1e-4 * found.max() and found.min() > 0
    light = even_light()
    truth = xyz_from_radiance(light.upward_white()) @ spectrum_of()
    found = picture([BALL, BALL], [material(mirror=1.0, n=0.001, k=50.0)] * 2, light, places=[(-20, 0, 0), (20, 0, 0)],
                    view={"fov": 26, "size": (60, 40)}, max_bounces=40)  # fmt: skip
    assert np.abs(found / truth - 1).max() <= 2e-3


def test_the_back_of_a_plate_is_black():
    found = picture([plate(100.0)], [material(0.8, mirror=0.5)], even_light(), view={"position": (0, -1, -200.0)})
    assert (found[20, 20] == 0).all()


# --- what repeats ------------------------------------------------------------------------------------------------


@pytest.fixture
def threads():
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


def test_threads_do_not_change_a_bit(threads):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    ready = prepared(CROWD, crowd(), sky_of(smooth_light, 64), places=CROWD_PLACES, smooth_outlines=True)
    pictures = []
    for count in (1, 2):
        threads(count)
        pictures += [render_frame(ready, view_of(**CROWD_VIEW)) for _ in range(2)]
    assert all(np.array_equal(pictures[0], other) for other in pictures[1:])


def test_kept_visibility_changes_no_bit_and_is_of_its_view():
    ready = prepared(CROWD, crowd(), sky_of(smooth_light, 64), places=CROWD_PLACES, smooth_outlines=True)
    turned = {"world_from_light": rotation_xyz([0.0, 0.0, 50.0])}
    one, other = view_of(**CROWD_VIEW), view_of(**CROWD_VIEW | {"position": (-40, -250, 110)})
    for view, frame in ((one, {}), (one, turned), (other, turned), (one, turned)):
        fresh = render_frame(ready, view, **frame)
        assert np.array_equal(render_frame(ready, view, keep_visibility=True, **frame), fresh)
    # What is kept is what is used: without it the same frame is of nothing.
    ready._kept.view(np.int32)[:] = -1
    assert not np.array_equal(render_frame(ready, one, keep_visibility=True, **turned), fresh)


@pytest.mark.stability(stage="render", case="random scenes")
@given(
    balls=st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60), st.floats(-10, 50), st.floats(0, 1),
                             st.floats(0.1, 3.0), st.floats(0.0, 30.0), st.floats(0.005, 1.2)), min_size=1, max_size=4),
    eye=st.tuples(st.floats(-200, 200), st.floats(-300, -100), st.floats(-50, 200)),
)  # fmt: skip
@settings(deadline=None, max_examples=25)
def test_any_spheres_give_finite_light_between_black_and_the_sky(balls, eye):
    light = even_light()
    truth = xyz_from_radiance(light.upward_white()) @ spectrum_of()
    # A lobe reflects less than β 4 μ² F: with the diffuse half no surface sends back more than it gets.
    materials = [material(0.5 * (1 - m), beta=0.5 * (1 - m) / (4 * mu**2), mu=mu, mirror=m, n=n, k=k)
                 for *_, m, n, k, mu in balls]  # fmt: skip
    places = [ball[:3] for ball in balls]
    found = picture([BALL] * len(balls), materials, light, places=places,
                    view={"position": eye, "size": (17, 19), "fov": 40})  # fmt: skip
    assert np.isfinite(found).all() and (found >= 0).all() and (found <= 1.002 * truth).all()


@pytest.mark.parametrize("eye", [(0.0, 0.0, 0.0), (31.0, -12.0, 0.0), (40.0, 0.0, 0.0), (200.0, 0.0, 0.0)])
def test_an_eye_that_lies_in_a_plate_sees_what_embree_lets_it_see(eye):
    """In its middle, in its surface, on its edge, and beside it in its plane."""
    ready = prepared([plate(80.0), BALL], [material(0.5), material(0.7)], even_light(), places=[(0, 0, 0), (0, 0, 60)])
    everything = dataclasses.replace(ready, world=ready.world._replace(bounded=0))
    for target in ((0.0, 10.0, 60.0), (5.0, 1.0, -60.0)):
        view = view_of(eye, target, (24, 24), 40.0)
        # Places on the plate differ by rounding errors.
        np.testing.assert_allclose(render_frame(ready, view), render_frame(everything, view), rtol=1e-6)


@given(
    turns=st.lists(st.tuples(*[st.floats(-180, 180)] * 3), min_size=3, max_size=3),
    eye=st.tuples(st.floats(-60, 60), st.floats(-250, -30), st.floats(-60, 120)),
    far=st.sampled_from([0.0, 3e3, 1e5]),
    in_plane=st.booleans(),
)
@settings(deadline=None, max_examples=20)
def test_bounds_keep_no_ray_from_what_it_meets(turns, eye, far, in_plane):
    """Every ray that Embree would let meet a mesh is handed to it: far from the origin, and from a triangle's plane."""
    shapes = [square_mesh(80.0), box(14.0, True), square_mesh(30.0)]
    places = [(far, 0, 0), (far - 22, 0, 20), (far + 10, -20, 15)]
    rotations = [rotation_xyz(t) for t in turns]
    if in_plane:
        eye = rotations[0] @ [*eye[:2], 0.0]
        assume(np.linalg.norm(np.subtract((0, 0, 5), eye)[:2]) > 1.0)
    ready = prepared(shapes, crowd(), even_light(), places=places, rotations=rotations)
    everything = dataclasses.replace(ready, world=ready.world._replace(bounded=0))
    view = view_of((far + eye[0], eye[1], eye[2]), (far, 0, 5), (24, 24), 40.0)
    assert np.array_equal(render_frame(ready, view), render_frame(everything, view))
