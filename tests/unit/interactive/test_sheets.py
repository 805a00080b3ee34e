"""Thin sheets in both integrators: both sides are seen, and light passes through."""

import dataclasses

import numpy as np
import pytest
from made import made
from path_scenes import DARK, ball, deviations, traced
from scenes import constant_light, material, plate, sky
from studio import BASIS, placed, prepared, view_of

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.cross_checks.thin_sheets import check_thin_sheet, check_thin_sheets
from irodori.config.loaded import Loaded
from irodori.config.models import Object, Render, Scene
from irodori.core.errors import InputError
from irodori.core.store import Provenance
from irodori.geometry.embree import Tracer
from irodori.geometry.mesh import Mesh
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.material.material_file import Material
from irodori.rendering import light_transfer
from irodori.rendering.energy_gain import body_fault, load_materials
from irodori.rendering.eyes import tell_black_backs
from irodori.rendering.integrators import render_image
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, render_frame
from irodori.rendering.planning.plan_file import write_plan
from irodori.rendering.planning.scene_plan import read_plan
from irodori.rendering.planning.stage import plan_of
from irodori.rendering.reference import baking
from irodori.rendering.scene_arrays import make_objects
from irodori.spectra.grid import SAMPLES
from irodori.spectra.published import light as spectrum_of

WAVE = np.linspace(-1.0, 1.0, SAMPLES)
FRONT, BACK = 0.35 + 0.2 * WAVE, 0.25 - 0.15 * WAVE
THROUGH = 0.2 + 0.25 * np.exp(-((2.0 * WAVE) ** 2))
TURN = rotation_xyz((25.0, -10.0, 30.0))
TOWARDS = TURN[:, 2]  # normal of a plate that is turned so
#: Views of both sides of the turned plate, off its normal.
SIDES = [tuple(sign * 200.0 * TOWARDS + np.array([20.0, -30.0, 10.0])) for sign in (1.0, -1.0)]


def leaf(through=THROUGH, **options) -> Material:
    return dataclasses.replace(Material.uniform(FRONT, transmittance=through, **options), back=Material.uniform(BACK))


def soft_sky():
    def coefficients(unit):
        x, y, z = np.moveaxis(unit, -1, 0)
        return np.stack([1.2 + z + 0.3 * x, 0.5 + 0.4 * y * z, 0.4 - 0.3 * x * z], axis=-1)

    return sky(coefficients, 64, 32, BASIS)


def towards(direction) -> dict:
    x, y, z = direction / np.linalg.norm(direction)
    angles = {"azimuth_deg": float(np.degrees(np.arctan2(y, x))), "elevation_deg": float(np.degrees(np.arcsin(z)))}
    return {"kind": "collimated", "spectrum": "D65", "irradiance": 1.0, **angles}


@pytest.mark.stability(stage="render", case="sheet that loses no light")
def test_a_sheet_that_loses_nothing_disappears_in_even_light():
    """A furnace: reflectance and transmittance sum to 1 in every band, on both sides, beside another object."""
    sheet = Material.uniform(1.0 - THROUGH, transmittance=THROUGH)
    for height in (80.0, -80.0):
        shapes, places = [plate(30.0), ball(8.0)], [(0.0, 0.0, 0.0), (3.0, 0.0, -9.0)]
        picture = traced(shapes, [sheet, material(1.0)], constant_light(0.7), 256, places=places,
                         position=(0.0, -200.0, height), size=(9, 9))  # fmt: skip
        assert np.abs(picture.radiance.mean(axis=(0, 1)) - 0.7).max() < 0.004
        assert np.mean(deviations(picture, 0.7) ** 2) < 2.0


@pytest.mark.stability(stage="render", case="leaf lit from behind")
@pytest.mark.parametrize("grazing", [1.0, 0.02])
def test_a_leaf_shows_the_light_of_a_lamp_behind_it(grazing):
    """T E cosθ / π on the side away from the lamp, R E cosθ / π with the back's R on the other; both integrators."""
    across = TURN[:, 0]
    lamp = -grazing * TOWARDS + np.sqrt(1.0 - grazing**2) * across
    lit = spectrum_of("D65") * grazing
    dark = sky(lambda unit: 0.0 * unit, 8, 4, BASIS)
    for position, reflectance in zip(SIDES, (THROUGH, BACK), strict=True):
        view = {"position": position, "size": (3, 3), "fov": 2.0}
        seen = traced([plate(30.0)], [leaf()], DARK, 8, rotations=[TURN], lights=[towards(lamp)], **view)
        np.testing.assert_allclose(seen.radiance, np.broadcast_to(reflectance * lit, (3, 3, 61)), rtol=2e-5)
        ready = prepared([plate(30.0)], [leaf()], dark, "spectral", rotations=[TURN],
                         lamps=np.pi * spectrum_of("D65")[None], white=np.ones(61))  # fmt: skip
        frame = render_frame(ready, view_of(**view), bands=True, lamps=(CollimatedLamp(lamp),))
        np.testing.assert_allclose(frame, seen.radiance, rtol=1e-4)
    # A ball before the lamp shades the leaf.
    shapes, places = [plate(30.0), ball(25.0)], [(0.0, 0.0, 0.0), 60.0 * lamp]
    turns = [TURN, np.eye(3)]
    view = {"position": SIDES[0], "size": (3, 3), "fov": 2.0}
    black = material(0.0)
    shaded = traced(shapes, [leaf(), black], DARK, 8, rotations=turns, places=places, lights=[towards(lamp)], **view)
    assert not shaded.radiance.any()
    ready = prepared(shapes, [leaf(), black], dark, "spectral", rotations=turns, places=places,
                     lamps=np.pi * spectrum_of("D65")[None], white=np.ones(61))  # fmt: skip
    assert not render_frame(ready, view_of(**view), bands=True, lamps=(CollimatedLamp(lamp),)).any()


def test_a_leaf_lets_as_much_light_through_in_either_direction():
    """Helmholtz: radiance over irradiance times its cosine, with lamp and eye exchanged; a coat on the front."""
    sheet = leaf(beta=1.0, mu=0.3)
    found = []
    for eye, lamp in ((SIDES[0], SIDES[1]), (SIDES[1], SIDES[0])):
        way = np.array(lamp) / np.linalg.norm(lamp)
        seen = traced([plate(30.0)], [sheet], DARK, 8, rotations=[TURN], lights=[towards(way)], position=eye,
                      size=(1, 1), fov=0.5)  # fmt: skip
        found.append(seen.radiance[0, 0] / abs(way @ TOWARDS))
    np.testing.assert_allclose(*found, rtol=1e-4)


def test_the_light_of_a_lamp_panel_passes_through_as_its_solid_angle_says():
    """Panels found by sampling lights and by sampling the sheet: E = L ∫ cosθ dω by quadrature, from below."""
    panel = {"kind": "rectangle", "spectrum": "D65", "radiance": 1.0, "position_mm": [20.0, 0.0, -40.0],
             "width_mm": 60.0, "height_mm": 30.0, "rotation_deg": [0.0, 0.0, 0.0]}  # fmt: skip
    x, y = np.meshgrid(20.0 + 60.0 * (np.arange(400) + 0.5) / 400 - 30.0, 30.0 * (np.arange(400) + 0.5) / 400 - 15.0)
    irradiance = (40.0**2 / (x**2 + y**2 + 40.0**2) ** 2).sum() * (60.0 * 30.0) / 400**2
    view = {"position": (0.0, 0.0, 300.0), "up": (0.0, 1.0, 0.0), "size": (1, 1), "fov": 0.01}
    seen = traced([plate(30.0)], [leaf()], DARK, 16384, lights=[panel], **view)
    expected = THROUGH * spectrum_of("D65") * irradiance / np.pi
    np.testing.assert_allclose(seen.radiance[0, 0], expected, rtol=0.01)
    assert np.abs(deviations(seen, expected)).max() < 5.0 and seen.standard_error.max() < 0.003 * expected.max()


def painted(columns) -> Material:
    """A material whose left and right halves differ, (2, 2) texels."""
    whole = Material.uniform(1.0)
    return dataclasses.replace(whole, coefficients=np.array([[[c] for c in columns]] * 2, dtype=np.float32))


def open_mesh(bend=4.0) -> Shape:
    """A bent sheet of two squares with one texture."""
    corners = np.array([[-15.0, -15, 0], [0, -15, bend], [15, -15, 0], [-15, 15, 0], [0, 15, bend], [15, 15, 0]])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], dtype=np.int32)
    across = np.cross(corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]])
    normals = np.repeat((across / np.linalg.norm(across, axis=1, keepdims=True))[:, None], 3, axis=1)
    uv = (corners[:, :2] / 30.0 + 0.5)[faces]
    return TriangleMesh(Mesh(corners, faces, np.ascontiguousarray(uv), np.ascontiguousarray(normals)))


@pytest.mark.parametrize(
    ("representation", "shape"), [("spectral", plate(30.0)), ("coefficients", open_mesh(0.0))], ids=["plate", "mesh"]
)
def test_the_look_ups_show_a_sheet_alone_as_the_paths_do(representation, shape):
    """Under a sky, from both sides: its back, and what comes through; a plate's was turned over about y."""
    light, view = soft_sky(), {"size": (16, 16), "fov": 5.0}
    through = painted((0.1, 0.4))
    sheet = dataclasses.replace(painted((0.2, 0.5)), through=through, back=painted((0.55, 0.05)).resized((6, 4)))
    white = light.upward_white()
    ready = prepared([shape], [sheet], light, representation, rotations=[TURN], white=white)
    means = []
    for position in SIDES:
        seen = traced([shape], [sheet], light, 1024, rotations=[TURN], position=position, **view)
        shown = render_frame(ready, view_of(position, **view), bands=representation == "spectral")
        expected = seen.radiance
        if representation != "spectral":
            expected = expected @ xyz_from_radiance(white).T
        error = np.sqrt(np.mean((shown / expected - 1.0) ** 2))
        assert error < 0.01
        means.append(seen.radiance.mean(axis=-1))
    # Turned over, the back's dark right half lies behind the front's left half; a mesh has one atlas.
    local = np.array([[-8.0, 0.0, 0.0], [8.0, 0.0, 0.0]]) @ TURN.T
    halves = traced([shape], [sheet], constant_light(), 64, rotations=[TURN], position=SIDES[1], size=(1, 1),
                    fov=0.5, target=tuple(local[0])), traced([shape], [sheet], constant_light(), 64,
                    rotations=[TURN], position=SIDES[1], size=(1, 1), fov=0.5, target=tuple(local[1]))  # fmt: skip
    left, right = (half.radiance.mean() for half in halves)
    behind = (0.55, 0.05) if shape.triangles is not None else (0.05, 0.55)
    assert left == pytest.approx(behind[0] + 0.1, rel=0.02) and right == pytest.approx(behind[1] + 0.4, rel=0.02)


@pytest.mark.stability(stage="render", case="sheet on a table")
@pytest.mark.default_cases(1)
@pytest.mark.parametrize("shape", [plate(30.0), open_mesh()], ids=["plate", "mesh"])
def test_light_maps_carry_light_through_a_sheet(shape, monkeypatch):
    """A leaf over a table and a ball: its shadow, what falls through it, and both sides, as the paths show them."""
    monkeypatch.setattr(light_transfer, "MOST_ERROR", np.inf)
    monkeypatch.setattr(baking, "_PATHS", 32)
    light = soft_sky()
    shapes, materials = [shape, ball(6.0), plate(150.0)], [leaf(), material(0.6), material(0.5)]
    places = [(0.0, 0.0, 0.0), (5.0, 0.0, -9.0), (0.0, 0.0, -16.0)]
    there = placed(shapes, places)
    maps = baking.bake_maps(Tracer(there), make_objects(there, materials)[0], light)
    assert len(maps.maps) == 4  # one of the leaf's back
    ready = prepared(shapes, materials, light, "spectral", places=places, maps=maps)
    # The front, the back from below with the ball, and what falls on the table beside and through the leaf.
    for position, target in (((0, -60, 90), (-6, 0, 0)), ((-6, -20, -14), (-6, 2, 0)), ((0, -90, 10), (0, -8, -16))):
        view = {"size": (8, 8), "fov": 5.0, "target": target, "position": tuple(map(float, position))}
        seen = traced(shapes, materials, light, 1024, places=places, **view)
        shown = render_frame(ready, view_of(**view), bands=True)
        assert np.abs(shown / seen.radiance - 1.0).mean() < 0.025
        assert shown.mean() == pytest.approx(seen.radiance.mean(), rel=0.015)


BODY = {"shape": {"kind": "plate", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [0.0, 0.0, 0.0]}


@pytest.mark.stability(stage="render", case="sheet that reflects and lets through more light than it gets")
def test_a_sheet_that_makes_light_is_refused(tmp_path):
    """Reflectance and transmittance of either side above 1 together, of a body and of a material's file."""
    white, dark = {"spectrum": "TCS20"}, {"spectrum": "TCS43"}
    bodies = [BODY | {"material": dark, "transmittance": 0.2}, BODY | {"material": white, "transmittance": 0.3},
              BODY | {"material": dark, "back": white, "transmittance": 0.3}]  # fmt: skip
    scene = made(Scene, {"bodies": bodies, "objects": []})
    assert body_fault(0, scene.bodies[0]) is None
    for index, key in ((1, "material"), (2, "back")):
        field, found, _ = body_fault(index, scene.bodies[index])
        assert field == f"bodies[{index}].{key}" and "sends back" in found
    paths = [tmp_path / f"{name}.h5" for name in ("front", "back")]
    for path, one in zip(paths, (Material.uniform(0.3, transmittance=0.6), Material.uniform(0.5)), strict=True):
        one.save(path, Provenance("test"))
    placed_object = {"object": "leaf", "position_mm": [0.0, 0.0, 0.0]}
    flat, bent = [plate(30.0)], [open_mesh()]
    assert load_materials(made(Scene, {"objects": [placed_object]}), flat, paths[:1])[0].through.basis.max() == 0.6
    turned = made(Scene, {"objects": [placed_object | {"back": "rear"}]})
    with pytest.raises(InputError, match="rear as the back of leaf"):
        load_materials(turned, flat, paths)
    # A plate is turned over, so that the left half of its back lies behind its right half; a mesh has one atlas.
    for columns, good, bad in (((0.3, 0.8), flat, bent), ((0.8, 0.3), bent, flat)):
        sheet = dataclasses.replace(Material.uniform(0.1), through=painted((0.1, 0.6)), transmittance="assumed")
        for path, one in zip(paths, (sheet, painted(columns)), strict=True):
            one.save(path, Provenance("test"))
        load_materials(turned, good, paths)
        with pytest.raises(InputError, match=r"rear as the back of leaf that sends back up to 1\.4 times"):
            load_materials(turned, bad, paths)


def test_a_sheet_has_an_open_shape():
    sphere = {"kind": "sphere", "radius_mm": 10.0}
    with pytest.raises(InputError, match="found a sheet of the shape sphere; accepted: one of the shapes plate"):
        check_thin_sheet(made(Object, {"shape": sphere, "sheet": {"transmittance": 0.2}}), "leaf.yaml")
    body = {"shape": sphere, "material": {"spectrum": "TCS1"}, "transmittance": 0.0}
    scene = made(Scene, {"objects": [], "bodies": [BODY | body]})
    with pytest.raises(InputError, match=r"bodies\[0\]\.transmittance: found a sheet of the shape sphere"):
        check_thin_sheets(made(Loaded, {}), scene, "scene.yaml")


@pytest.mark.parametrize("coat", ["coupled", "auto"])
def test_the_back_of_a_sheet_that_lets_light_through_has_no_coupled_coat(coat):
    """Light that passes would have to be counted by its angle under the coat, too."""
    plate = {"kind": "plate", "width_mm": 20.0, "height_mm": 20.0}
    for transmittance, refused in ((0.2, True), (0.0, False)):
        objects = {"leaf": {"shape": plate, "sheet": {"transmittance": transmittance}},
                   "rear": {"shape": plate, "coat": coat}}  # fmt: skip
        loaded = made(Loaded, {"objects": {name: made(Object, given) for name, given in objects.items()}})
        scene = made(Scene, {"objects": [{"object": "leaf", "back": "rear"}]})
        if not refused:
            check_thin_sheets(loaded, scene, "scene.yaml")
            continue
        with pytest.raises(InputError, match=rf"objects\[0\]\.back: found rear, whose coat is {coat}, on a sheet that"):
            check_thin_sheets(loaded, scene, "scene.yaml")


def scene_of(**changes) -> Scene:
    """A leaf that leans over a table, seen from its front and from behind."""
    table = {"shape": {"kind": "plate", "width_mm": 120.0, "height_mm": 120.0}, "position_mm": [0.0, 0.0, -20.0]}
    bodies = [BODY | {"rotation_deg": [60.0, 0.0, 0.0], "material": {"spectrum": "TCS31"}, "transmittance": 0.3,
                      "back": {"spectrum": "TCS81"}},
              table | {"material": {"spectrum": "TCS4"}}]  # fmt: skip
    views = {name: {"position_mm": [0.0, y, 60.0], "target_mm": [0.0, 0.0, -5.0], "field_of_view_deg": 24.0}
             for name, y in (("front", -150.0), ("behind", 150.0))}  # fmt: skip
    display = {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}}
    whole = {"image": {"width": 40, "height": 30}, "objects": [], "bodies": bodies, "views": views, "max_bounces": 2,
             "integrator": {"kind": "interactive", "light_maps": True}, "display": display}  # fmt: skip
    return made(Scene, whole | changes)


@pytest.mark.usefixtures("coarse_light_maps")
def test_a_plan_keeps_both_sides_of_a_sheet_and_what_passes_through(tmp_path):
    """Seen from behind too, the planned picture is as near to the full model as the plan says."""
    light, options = soft_sky(), Render(pixel_side=1, min_throughput=1e-3)
    scene = scene_of(tolerance_ciede2000=3.0, plan={"representation": "spectral"})
    document = plan_of("leaf", scene, [], [], light, options)
    write_plan(tmp_path / "plan.yaml", document)
    plan = read_plan(tmp_path / "plan.yaml")
    names = ["bodies[0]", "bodies[1]", "bodies[0], back", "bodies[0], transmittance"]
    assert list(plan.decisions["texture_halvings"]) == names
    for view in scene.views:
        _, figures = render_image(scene, view, [], [], light, options, plan=plan)
        measured = figures["plan"]["delta_e_to_full_model"]
        assert measured["p99"] <= plan.predicted_delta_e + 0.02


def test_a_plate_that_is_black_from_behind_is_told(caplog):
    scene = scene_of()
    for is_sheet, said in (([True, True], False), ([False, True], True)):
        caplog.clear()
        tell_black_backs(scene, "front", [], is_sheet)
        tell_black_backs(scene, "behind", [], is_sheet)
        assert ("the view behind sees bodies[0] from behind" in caplog.text) == said
        assert "bodies[1]" not in caplog.text and "the view front" not in caplog.text
