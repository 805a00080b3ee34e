"""Scenes in which rays tend to go astray: a slab of 1 µm, grazing mirrors, crossed meshes, a sun below the horizon."""

import numpy as np
import pytest
from made import made
from path_scenes import facetted_sphere, traced
from quadrangles import squares
from scenes import BALL, OPTIONS, constant_light, fresnel, material, pixel_rays, plate, sky
from scipy.ndimage import binary_erosion
from shortcuts import ball

from irodori.config.models import Scene
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.mesh import make_mesh
from irodori.geometry.rig_frame import rotation_x
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.rendering.energy_gain import load_materials
from irodori.rendering.integrators import render_image

INTEGRATORS = ["reference", "interactive"]
FROM_ABOVE, FROM_BELOW = (0.0, -60.0, 80.0), (0.0, -60.0, -80.0)


def seen(integrator, shapes, materials, light, *, position, places=None, size=(24, 18), fov=20.0, samples=64):
    """Radiance of a view towards the origin, (height, width, 61); without lights of its own and without light maps."""
    if integrator == "reference":
        return traced(shapes, materials, light, samples, position=position, places=places, size=size, fov=fov).radiance
    places = places or [(0.0, 0.0, 0.0)] * len(shapes)
    scene = {
        "image": {"width": size[0], "height": size[1]},
        "objects": [{"object": f"o{i}", "position_mm": list(place)} for i, place in enumerate(places)],
        "views": {"v": {"position_mm": list(position), "target_mm": [0.0, 0.0, 0.0], "field_of_view_deg": fov}},
        "integrator": {"kind": "interactive", "light_maps": False},
    }
    return render_image(made(Scene, scene), "v", shapes, materials, light, OPTIONS)[0]


def slab(side_mm: float, thickness_mm: float) -> Shape:
    """A closed slab of twelve triangles about the origin."""
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5 * side_mm
    low, high = (np.column_stack([corner, np.full(4, z)]) for z in (-0.5 * thickness_mm, 0.5 * thickness_mm))
    sides = [[low[i], low[(i + 1) % 4], high[(i + 1) % 4], high[i]] for i in range(4)]
    return squares(high, low[::-1], *sides)


# --- a slab of 1 µm ----------------------------------------------------------------------------------------------


@pytest.mark.stability(stage="render", case="a slab of 1 µm")
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_white_slab_of_a_micrometre_vanishes_in_a_furnace(integrator):
    """Seen from both sides. A ray that started behind the other side would meet that one's black inner face."""
    for position in (FROM_ABOVE, FROM_BELOW):
        picture = seen(integrator, [slab(40.0, 1e-3)], [material(1.0)], constant_light(), position=position)
        assert np.abs(picture - 1.0).max() <= 2e-3


@pytest.mark.stability(stage="render", case="a slab of 1 µm")
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_no_light_passes_through_a_slab_of_a_micrometre(integrator):
    """Light from the upper half alone: the upper side shows its reflectance, the lower side is black."""
    light = sky(lambda d: (d[..., 2:] > 0.0).astype(float))
    shape, paint = slab(40.0, 1e-3), material(0.6)
    view = {"size": (9, 9), "fov": 8.0}
    above, below = (
        seen(integrator, [shape], [paint], light, position=p, samples=256, **view) for p in (FROM_ABOVE, FROM_BELOW)
    )
    assert above.mean() == pytest.approx(0.6, rel=0.02)
    # The sky is interpolated over its texels at the horizon, 0.7 degrees high.
    assert below.max() <= 0.6 * 2e-4


# --- mirrors at grazing angles -----------------------------------------------------------------------------------


@pytest.mark.stability(stage="render", case="mirrors at grazing angles")
@pytest.mark.parametrize("height_deg", [0.5, 2.0, 5.0])
def test_a_corridor_of_mirrors_loses_fresnels_share_at_every_bounce(height_deg):
    """The eye looks along two mirrors 20 mm apart, so low that a ray meets them eight times."""
    n, k, slope = 0.2, 3.4, np.tan(np.radians(height_deg))
    run, bounces = 20.0 / slope, 8
    length = run * (bounces - 1) + 1.5 * run  # a ray starts half-way between the plates, half a run before it meets one
    first = -0.5 * length
    picture = traced([plate(length)] * 2, [material(mirror=1.0, n=n, k=k)] * 2, constant_light(), 4096, size=(1, 1),
                     fov=0.01 * height_deg, places=[(0, 0, 0), (0, 0, 20.0)], rotations=[np.eye(3), rotation_x(np.pi)],
                     position=(0, first, 10.0), target=(0, first + 0.5 * run, 0.0))  # fmt: skip
    expected = fresnel(np.sin(np.radians(height_deg)), n, k) ** bounces
    assert expected < 0.98
    assert abs(picture.radiance[0, 0, 30] - expected) <= 5 * picture.standard_error[0, 0, 30] + 1e-3 * expected
    assert picture.standard_error[0, 0, 30] <= 0.02 * expected


# --- meshes ------------------------------------------------------------------------------------------------------


@pytest.mark.stability(stage="render", case="meshes that interpenetrate")
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("apart", [0.0, 1e-4, 13.0])
def test_white_meshes_that_interpenetrate_vanish_in_a_furnace(integrator, apart):
    """Two balls of triangles share much of their volume, or all of it: their surfaces coincide."""
    shapes, places = [facetted_sphere(20.0, 3)] * 2, [(0, 0, 0), (apart, 0, 0)]
    view = {"position": (0.0, -200.0, 40.0), "fov": 16.0}
    picture = seen(integrator, shapes, [material(1.0)] * 2, constant_light(), places=places, **view)
    off = np.abs(picture[..., 0] - 1.0)
    assert off.mean() <= 1e-3 and (off > 0.02).mean() <= 0.01


@pytest.mark.stability(stage="render", case="meshes that interpenetrate")
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_of_meshes_that_interpenetrate_the_nearer_surface_is_seen(integrator):
    """A white and a black ball, whose common circle lies in a plane that the eye looks along."""
    shapes, places = [facetted_sphere(20.0, 3)] * 2, [(-6.0, 0, 0), (6.0, 0, 0)]
    picture = seen(integrator, shapes, [material(1.0), material(0.0)], constant_light(), places=places, fov=18.0,
                   position=(0.0, -200.0, 0.0), size=(40, 30))[..., 0]  # fmt: skip
    rays = pixel_rays(size=(40, 30), fov=18.0)
    hits = []
    for x, _, _ in places:
        origin = np.array([-x, -200.0, 0.0])
        along = rays @ origin
        root = along**2 - (origin @ origin - 400.0)
        hits.append(np.where(root > 0.0, -along - np.sqrt(np.maximum(root, 0.0)), np.inf))
    white, black = hits[0] < hits[1] - 0.5, hits[1] < hits[0] - 0.5  # the facets lie up to 0.2 mm inside
    inner = [binary_erosion(one, iterations=2) for one in (white, black)]
    assert min(one.sum() for one in inner) > 80
    assert picture[inner[1]].max() == 0.0
    # What the black ball takes away is most beside it.
    assert picture[inner[0]].min() > 0.4 and np.median(picture[inner[0]]) > 0.8


@pytest.mark.heavy
@pytest.mark.stability(stage="render", case="a million triangles")
def test_a_ball_of_a_million_triangles_looks_like_a_ball():
    light = sky(lambda d: 1.0 + 0.6 * d[..., 2:] + 0.3 * d[..., :1])
    mesh = TriangleMesh(make_mesh(*ball(20.0, 500, 1000)))
    assert len(mesh.mesh.faces) > 990_000
    glossy = material(0.5, beta=1.0, mu=0.2, mirror=0.3)
    for integrator in INTEGRATORS:
        one, other = (
            seen(integrator, [shape], [glossy], light, position=(0.0, -200.0, 40.0), fov=13.0, samples=256)
            for shape in (mesh, BALL)
        )
        assert np.median(np.abs(one / other - 1.0)) <= 0.02
        assert abs(one.mean() / other.mean() - 1.0) <= 2e-3


# --- light -------------------------------------------------------------------------------------------------------


@pytest.mark.stability(stage="render", case="a sun under the horizon")
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("below_deg", [1.5, 20.0])
def test_a_sun_under_the_horizon_lights_no_plate(integrator, below_deg):
    """A plate that faces up is black, also where it is a mirror or glossy, and however bright the sun.

    `interactive` reads blurred light where a surface is glossy, whose lobes the horizon does not cut exactly.
    """
    row = int(64 + below_deg / 180.0 * 128)

    def sun(direction):
        radiance = np.zeros((*direction.shape[:2], 1))
        radiance[row, 40] = 1e6
        return radiance

    light = sky(sun, 256, 128)
    paint = material(0.6, beta=1.0, mu=0.3, mirror=0.5)
    picture = seen(integrator, [plate(400.0)], [paint], light, position=(0, -160, 30), size=(12, 9), samples=64)
    lit = 1e6 * (np.pi / 128) ** 2  # irradiance of a surface that faces such a sun
    assert picture.max() <= (1e-6 if integrator == "reference" else 5e-3) * lit


@pytest.mark.stability(stage="render", case="reflectance 1.1 between two plates")
def test_plates_that_send_back_more_than_they_get_are_refused_by_name(tmp_path):
    """Between two plates of reflectance 1.1 light would grow without end."""
    path = tmp_path / "bright.h5"
    material(1.1).save(path, store.Provenance("test"))
    objects = [{"object": "bright-plate", "position_mm": [0.0, 0.0, z]} for z in (0.0, 20.0)]
    with pytest.raises(InputError) as caught:
        load_materials(made(Scene, {"objects": objects}), [plate(400.0)] * 2, [path, path])
    for words in ("bright.h5: albedo: found bright-plate", "on 100 % of its texels", "allow_energy_gain: true"):
        assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
