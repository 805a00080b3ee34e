"""Coupled coats in the interactive integrator and in light maps, against sums over the sky and against path tracing."""

from dataclasses import replace

import numpy as np
import pytest
from made import made
from scenes import BALL, constant_light, material, plate, sky, smooth_light, sphere_hits
from studio import prepared
from test_coat import glass

from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.models import Render, Scene
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rotation_z
from irodori.geometry.shapes.placement import Placement
from irodori.light.environment_file import directions
from irodori.reflection.coat import COUPLED, SUM
from irodori.rendering.frame_state import STILL
from irodori.rendering.integrators import make_renderer
from irodori.rendering.reference import baking
from irodori.rendering.reference.baking import bake_maps
from irodori.rendering.reference.converging_picture import make_scene
from irodori.rendering.reference.incident_light import incident_light
from irodori.rendering.scene_arrays import make_objects
from irodori.rendering.scene_lights import make_lights

OPTIONS = made(Render, Render(pixel_side=2, min_throughput=1e-3))
MAPS, BARE = ({"kind": "interactive", "light_maps": maps} for maps in (True, False))
LAMP = {"kind": "collimated", "spectrum": "E", "azimuth_deg": -60.0, "elevation_deg": 30.0, "irradiance": 2.0}
#: Light from the side, so that much of it falls at grazing angles.
LIGHT = sky(lambda unit: (smooth_light(unit) + 4.0 * np.exp(8.0 * (unit[..., 0] - 1.0)))[..., None], 64, 32)
TURN_DEG = 70.0


def coated(reflectance, **gloss):
    return replace(material(reflectance, **gloss), coat=COUPLED)


def scene_of(stands, integrator, lights, view, size=(41, 41)) -> Scene:
    placed = [{"object": name, "position_mm": list(place)} for name, place in stands.items()]
    return made(Scene, {"image": {"width": size[0], "height": size[1]}, "objects": placed, "views": {"v": view},
                        "integrator": integrator, "lights": list(lights)})  # fmt: skip


def view_of(position, target, fov) -> dict:
    return {"position_mm": position, "target_mm": target, "field_of_view_deg": fov}


def test_light_passes_the_coat_of_a_ball_at_its_angle_and_out_at_the_angle_of_the_view():
    """Every pixel is the sum over all pixels of the turned sky, and the lamp, each by its angle."""
    view, bare = view_of([0.0, -200.0, 0.0], [0.0, 0.0, 0.0], 13.0), BARE | {"smooth_outlines": False}
    scene = scene_of({"ball": (0.0, 0.0, 0.0)}, bare, [LAMP], view)
    options, moment = replace(OPTIONS, pixel_side=1), STILL._replace(environment_deg=TURN_DEG)
    found = make_renderer(scene, [BALL], [coated(0.5)], LIGHT, options).picture("v", moment)[0][..., 30]
    ray, normal = sphere_hits()
    seen = np.isfinite(normal[..., 0])
    facing, unit = -(ray * normal).sum(axis=-1)[seen], directions(64, 32)[0].reshape(-1, 3)
    seen[seen] = facing > 0.05
    out, normal = facing[facing > 0.05], normal[seen]
    light = LIGHT.coefficients.reshape(-1) * directions(64, 32)[1].reshape(-1)
    cosine = np.maximum(normal @ (unit @ rotation_z(np.radians(TURN_DEG)).T).T, 0.0)
    wanted = (cosine * glass(cosine)) @ light
    lamps = make_lights(scene.lights, 0)[0]
    for spectrum, turn in zip(lamps.spectrum, lamps.rotation, strict=True):
        cosine = np.maximum(normal @ turn[:, 2], 0.0)
        wanted = wanted + spectrum[30] * cosine * glass(cosine)
    np.testing.assert_allclose(found[seen], 0.5 / np.pi * wanted * glass(out), rtol=2e-3)


@pytest.fixture
def few_paths(monkeypatch):
    """Measure the stated error with a sixteenth of the paths; it is tried in even light, where they have no noise."""
    monkeypatch.setattr(baking, "_PATHS", 32)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("coats", [(COUPLED, SUM), (SUM, COUPLED)], ids=["table", "ball"])
def test_maps_of_coated_surfaces_hold_the_light_that_passes_their_coats(few_paths, coats):
    """A ball over a table, one of them coated: the maps err little against traced paths, and differ without a coat."""
    there = [Placement(plate(120.0), np.eye(3), np.zeros(3)), Placement(BALL, np.eye(3), np.array([0.0, 0.0, 21.0]))]
    coated_, plain = (
        bake_maps(
            Tracer(there), make_objects(there, [replace(material(0.8), coat=c) for c in some])[0], constant_light()
        )
        for some in (coats, (SUM, SUM))
    )
    assert max(bake.error for bake in coated_.bakes) < 0.015
    share = [one.mean() / other.mean() for one, other in zip(coated_.maps, plain.maps, strict=True)]
    own = coats.index(COUPLED)
    # What the coated surface gets is reduced by its coat, and what the other gets from it less.
    assert share[own] < 0.96 and share[own] < share[1 - own] < 1.0


def test_paths_from_a_surface_count_light_by_its_own_coat():
    """In even light, whichever surface comes first, a free one with a coat gets what passes, and another all."""
    there = [Placement(plate(9.0), np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.0, 900.0)]
    node, weight = np.polynomial.legendre.leggauss(100)
    cosine, up = 0.5 * (node + 1.0), np.array([[0.0, 0.0, 1.0]])
    for own, materials in enumerate(([coated(0.5), material(0.5)], [material(0.5), coated(0.5)])):
        scene = make_scene(there, make_objects(there, materials)[0], constant_light())
        point = [np.array([[x, 0.0, 0.0]]) for x in (0.0, 900.0)]
        found = [incident_light(scene, one, point[one], up, up, samples=1024).mean() for one in (own, 1 - own)]
        assert found == pytest.approx([np.sum(weight * cosine * glass(cosine)), 1.0], rel=2e-3)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("lights", [(), (LAMP,)], ids=["sky", "sky and a lamp"])
def test_with_light_maps_a_coated_ball_on_a_coated_table_is_shown_as_paths_show_it_in_turned_light(lights):
    """As near as without coats; a picture without them is not near."""
    paint, stands = [0.7, np.linspace(0.9, 0.3, 61)], {"table": (0.0, 0.0, 0.0), "ball": (0.0, 0.0, 20.1)}
    materials = [coated(one, beta=1.0, mu=0.2, mirror=1.0) for one in paint]

    def seen(integrator, materials):
        view = view_of([0.0, -200.0, 40.0], [0.0, 0.0, 12.0], 22.0)
        scene = scene_of(stands, integrator, lights, view, (32, 24))
        moment = STILL._replace(environment_deg=TURN_DEG)
        return make_renderer(scene, [plate(120.0), BALL], materials, LIGHT, OPTIONS).picture("v", moment)[0]

    white = LIGHT.upward_white() + len(lights)
    matrix = xyz_from_radiance(white)
    without = [replace(one, coat=SUM) for one in materials]
    reference = {"kind": "reference", "samples": 256, "denoise": False}
    paths, shown, plain = (
        lab_from_xyz(picture @ matrix.T, matrix @ white)
        for picture in (seen(reference, materials), seen(MAPS, materials), seen(MAPS, without))
    )
    far = delta_e(shown, paths).mean()
    assert far < 0.5 and far < 0.2 * delta_e(plain, paths).mean()


def test_light_without_the_irradiance_under_a_coat_is_refused():
    with pytest.raises(ValueError, match="irradiance under 0 coats; accepted: under 1"):
        prepared([BALL], [coated(0.5)], constant_light())
