"""A plan of a scene: what it leaves out, what it predicts, how it is checked."""

import dataclasses
import functools
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from scenes import BALL, GOLD_K, GOLD_N, ONES, THIRDS, material, plate, sky
from studio import BASIS, even_light

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import ObjectShape, Render, Scene, Size, View
from irodori.config.placed_names import object_names
from irodori.core.errors import InputError
from irodori.core.store import Provenance
from irodori.core.yaml_files import read_yaml
from irodori.export.pictures import read_xyz, write_spectral_exr, write_xyz_exr
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material
from irodori.rendering.integrators import make_renderer, render_image
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, light_of, render_frame
from irodori.rendering.interactive.pixel_rays import render_pixels, render_rays
from irodori.rendering.planning.modelled_scene import Model, SceneParts, full_model, leading_basis, prepare
from irodori.rendering.planning.plan_file import model_of, write_plan
from irodori.rendering.planning.planned_check import ToleranceError, chosen_pixels
from irodori.rendering.planning.planned_picture import parts_of
from irodori.rendering.planning.probes import Changes, Probes
from irodori.rendering.planning.scene_plan import ScenePlan, read_plan
from irodori.rendering.planning.stage import plan_of
from irodori.rendering.planning.tolerance import bound_of_share
from irodori.rendering.scene_arrays import make_light, make_view
from irodori.rendering.stage import render_view

pytestmark = pytest.mark.usefixtures("coarse_light_maps")

OPTIONS = Render(pixel_side=1, min_throughput=1e-3)
GREENISH = 0.1 + 0.6 * np.exp(-(((np.arange(61) - 28) / 9.0) ** 2))
PARALLEL = {"kind": "orthographic", "position_mm": [0.0, -200.0, 90.0], "target_mm": [0.0, 0.0, 12.0],
            "up": [0.0, 0.0, 1.0], "height_mm": 80.0}  # fmt: skip
LAMP = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": -60.0, "elevation_deg": 50.0, "irradiance": 1.0}
TABLE, JAR = plate(90.0), BALL
PLACES = [(0.0, 0.0, 0.0), (0.0, 0.0, 20.1)]


def scene_of(tolerance=1.0, lights=(), overrides=None, **integrator) -> dict:
    places = [{"position_mm": list(p), "rotation_deg": [0.0, 0.0, 0.0], "scale": 1.0} for p in PLACES]
    return {
        "image": {"width": 40, "height": 30},
        "objects": [{"object": name, **place} for name, place in zip(("table", "jar"), places, strict=True)],
        "views": {"v": {"position_mm": [0.0, -200.0, 90.0], "target_mm": [0.0, 0.0, 12.0], "up": [0.0, 0.0, 1.0],
                        "field_of_view_deg": 22.0}},
        "integrator": {"kind": "interactive", "light_maps": True} | integrator,
        "max_bounces": 4,
        "lights": list(lights),
        "display": {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}},
        "tolerance_ciede2000": tolerance,
        "plan": overrides or {},
    }  # fmt: skip


def room() -> Environment:
    """Light of three spectra that vary over the sphere, soft enough for a small picture."""

    def coefficients(unit):
        x, y, z = np.moveaxis(unit, -1, 0)
        return np.stack([1.2 + z + 0.3 * x, 0.5 + 0.4 * y * z, 0.4 - 0.3 * x * z], axis=-1)

    return sky(coefficients, 64, 32, BASIS)


def black() -> Environment:
    light = even_light()
    return Environment(0 * light.coefficients, light.basis, 0 * light.irradiance)


def planned(materials, light, **scene):
    """The plan's document, and the scene."""
    definition = scene_of(**scene)
    document = plan_of("table-top", made(Scene, definition), [TABLE, JAR], materials, light, made(Render, OPTIONS))
    return document, definition


def modelled(materials, light, document, definition):
    """The scene as the renderer has it for a plan."""
    parts = parts_of(make_renderer(made(Scene, definition), [TABLE, JAR], materials, light, made(Render, OPTIONS)))
    return parts, model_of(ScenePlan.of(document), full_model(parts, 4), object_names(made(Scene, definition)))


def values(document) -> dict:
    return {name: decision["value"] for name, decision in document["decisions"].items()}


def picture(materials, light, document, definition):
    return render_image(
        made(Scene, definition), "v", [TABLE, JAR], materials, light, made(Render, OPTIONS), plan=ScenePlan.of(document)
    )


@pytest.mark.heavy
def test_a_matte_scene_pays_for_no_mirror_and_no_gloss():
    matte = [material(0.7), material(GREENISH)]
    shiny = [material(0.7, beta=1.0, mu=0.1, mirror=0.5), material(GREENISH, beta=2.0, mirror=1.0)]
    document, definition = planned(matte, room())
    parts, model = modelled(matte, room(), document, definition)
    found = values(document)
    assert found["gloss"] == found["mirror"] == [] and found["max_bounces"] == 0 and found["gloss_levels"] == [0, 0]
    view = make_view(made(View, definition["views"]["v"]), made(Size, definition["image"]))
    prepared, figures = prepare(parts, model, np.ones((3, 61))), {}
    render_frame(prepared, view, figures=figures)
    assert figures["rays"] == view.width * view.height
    # Without levels lobes cannot be looked up.
    assert prepared.world.gloss_levels == 0 < prepared.world.environment_levels
    _, figures = picture(matte, room(), document, definition)
    assert figures["plan"]["delta_e_to_full_model"]["p99"] <= document["predicted_delta_e"] + 0.02
    dearer, _ = planned(shiny, room(), tolerance=0.01)
    assert document["cost"]["numbers_per_pixel"] < 0.5 * document["cost_of_full_model"]["numbers_per_pixel"]
    assert document["cost"]["rays_per_pixel"] < dearer["cost"]["rays_per_pixel"]


def test_a_scene_of_mirrors_alone_pays_for_no_irradiance_map():
    gold = {"n": np.array(GOLD_N)[THIRDS], "k": np.array(GOLD_K)[THIRDS]}
    mirrors = [material(0.0, mirror=1.0, **gold), material(0.0, mirror=0.9)]
    document, definition = planned(mirrors, room())
    parts, model = modelled(mirrors, room(), document, definition)
    assert values(document)["irradiance"] is False and values(document)["mirror"] == ["table", "jar"]
    world = prepare(parts, model, np.ones((3, 61))).world
    assert world.irradiance_side == world.scatters == world.gloss_levels == 0
    _, figures = picture(mirrors, room(), document, definition)
    assert figures["plan"]["delta_e_to_full_model"]["p99"] <= document["predicted_delta_e"] + 0.02 <= 1.02


def test_a_scene_under_one_lamp_looks_no_environment_up_and_keeps_its_highlights():
    shiny = [material(0.5), material(GREENISH, beta=3.0, mu=0.15, mirror=0.4)]
    document, definition = planned(shiny, black(), lights=[LAMP])
    parts, model = modelled(shiny, black(), document, definition)
    found = values(document)
    assert found["environment"] is False and found["irradiance"] is False and found["gloss_levels"] == [0, 0]
    assert "jar" in found["gloss"]
    world = prepare(parts, model, np.ones((3, 61))).world
    assert world.environment_levels == world.gloss_levels == world.irradiance_side == 0 < world.scatters
    image, figures = picture(shiny, black(), document, definition)
    assert figures["plan"]["delta_e_to_full_model"]["p99"] <= document["predicted_delta_e"] + 0.02 <= 1.02
    dull = [shiny[0], material(GREENISH, mirror=0.4)]
    plain, _ = planned(dull, black(), lights=[LAMP])
    assert (image[..., 1] - picture(dull, black(), plain, definition)[0][..., 1]).max() > 5.0


@settings(max_examples=6, deadline=None, derandomize=True)
@given(st.data())
@pytest.mark.heavy
def test_no_scene_errs_by_more_than_its_plan_predicts(data):
    number = st.floats(0.0, 1.0)
    materials = [
        material(
            data.draw(number) * GREENISH + 0.2 * data.draw(number),
            beta=data.draw(st.sampled_from([0.0, 0.02, 1.0, 4.0])),
            mu=data.draw(st.floats(0.03, 0.6)),
            mirror=data.draw(st.sampled_from([0.0, 0.01, 0.3, 1.0])),
            n=data.draw(st.sampled_from([1.3, 1.5, 2.2])),
        )
        for _ in range(2)
    ]
    lights = [LAMP] if data.draw(st.booleans()) else []
    tolerance = data.draw(st.sampled_from([0.2, 1.0, 3.0]))
    document, definition = planned(materials, room(), tolerance=tolerance, lights=lights)
    assert document["predicted_delta_e"] <= tolerance
    _, figures = picture(materials, room(), document, definition)
    # What single precision leaves is no part of the prediction.
    assert figures["plan"]["delta_e_to_full_model"]["p99"] <= document["predicted_delta_e"] + 0.01


# Together they reflect less than they receive: light between them ends, in the path-traced picture too.
MIRRORS = [material(0.04, mirror=0.95, n=0.3, k=3.0), material(0.1 * GREENISH, mirror=0.9, n=0.3, k=3.0)]


def test_an_override_that_costs_too_much_is_predicted_and_refused():
    document, definition = planned(MIRRORS, room(), overrides={"max_bounces": 0})
    assert document["decisions"]["max_bounces"]["by"] == "scene" and document["predicted_delta_e"] > 1.0
    with pytest.raises(ToleranceError, match=r"scene 'table-top', view 'v'.* ΔE2000 .*tolerated: 1;") as caught:
        picture(MIRRORS, room(), document, definition)
    assert str(caught.value).count("\n") == 0


def test_nothing_is_left_of_a_picture_that_is_refused(tmp_path):
    origin = Provenance("test", "0", "0")
    files = [tmp_path / f"{name}.h5" for name in ("table", "jar", "room")]
    for path, what in zip(files, [*MIRRORS, room()], strict=True):
        what.save(path, origin)
    shapes = [{"kind": "plate", "width_mm": 90.0, "height_mm": 90.0}, {"kind": "sphere", "radius_mm": 20.0}]
    outputs = {"exr": tmp_path / "v.exr", "png": tmp_path / "v.png", "figures_file": tmp_path / "v.json"}
    # One ray a pixel is far from the mean over a pixel that path tracing gives where a mirror's outline crosses it.
    for overrides, tolerance, whole in (({"mirror": []}, 1.0, False), ({}, 0.3, False), ({}, 60.0, True)):
        document, definition = planned(MIRRORS, room(), overrides=overrides, tolerance=tolerance)
        write_plan(tmp_path / "plan.yaml", document)
        before = set(tmp_path.iterdir())
        job = partial(
            render_view,
            made(Scene, definition),
            "v",
            made(Sequence[ObjectShape], shapes),
            files[:2],
            files[2],
            **outputs,
            options=OPTIONS,
            plan_file=tmp_path / "plan.yaml",
        )
        if whole:
            job()
            far = json.loads(outputs["figures_file"].read_text())["delta_e_to_reference"]
            assert 0.3 < far["p99"] < 60.0
            assert all(path.exists() for path in outputs.values())
            continue
        with pytest.raises(ToleranceError):
            job()
        assert set(tmp_path.iterdir()) == before


def test_a_plan_is_the_same_to_the_byte_and_says_all_that_the_renderer_needs(tmp_path):
    shiny = [material(0.5, beta=0.5, mu=0.2), material(GREENISH, beta=3.0, mu=0.15, mirror=0.4)]
    texts = []
    for name in ("a.yaml", "b.yaml"):
        document, definition = planned(shiny, room(), tolerance=0.5)
        write_plan(tmp_path / name, document)
        texts.append((tmp_path / name).read_bytes())
    assert texts[0] == texts[1]
    assert read_yaml(tmp_path / "a.yaml") == document == yaml.safe_load(texts[0])
    parts, model = modelled(shiny, room(), document, definition)
    assert dataclasses.replace(model, quadrature=None) != full_model(parts, 4)
    needed = {"value", "full", "predicted_delta_e", "numbers_per_ray", "by", "why"}
    assert all(set(decision) == needed for decision in document["decisions"].values())
    own = [decision["predicted_delta_e"] for decision in document["decisions"].values()]
    assert document["predicted_delta_e"] >= max(own) and document["predicted_delta_e"] <= 0.5


def test_a_plan_that_cannot_take_its_name_leaves_nothing_behind(tmp_path):
    (tmp_path / "plan.yaml").mkdir()
    with pytest.raises(OSError):
        write_plan(tmp_path / "plan.yaml", {"scene": "table-top"})
    assert [path.name for path in tmp_path.iterdir()] == ["plan.yaml"]


@pytest.mark.heavy
def test_a_smaller_tolerance_costs_more():
    shiny = [material(0.5, beta=0.5, mu=0.2), material(GREENISH, beta=3.0, mu=0.15, mirror=0.4)]
    costs = [planned(shiny, room(), tolerance=t)[0]["cost"]["numbers_per_pixel"] for t in (20.0, 0.5, 1e-4)]
    assert costs == sorted(costs) and costs[0] < costs[-1]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("parallel", [False, True])
def test_single_pixels_are_those_of_the_picture(parallel):
    shiny = [material(0.5, mirror=0.3), material(GREENISH, beta=3.0, mu=0.15, mirror=0.4)]
    definition = scene_of()
    parts = parts_of(make_renderer(made(Scene, definition), [TABLE, JAR], shiny, room(), made(Render, OPTIONS)))
    definition |= {"views": {"v": PARALLEL}} if parallel else {}
    prepared = prepare(parts, full_model(parts, 4), np.ones((3, 61)))
    view = make_view(made(View, definition["views"]["v"]), made(Size, definition["image"]))
    pixels = chosen_pixels(view, 300)
    assert len(np.unique(pixels, axis=0)) == 300
    fine = view._replace(focal_px=2 * view.focal_px, width=80, height=60)
    whole = render_frame(prepared, fine).reshape(30, 2, 40, 2, 3).mean(axis=(1, 3))
    single = render_pixels(prepared, view, pixels, 2)
    difference = np.abs(single - whole[pixels[:, 1], pixels[:, 0]]) / whole.max()
    # A ray that grazes an edge may fall on the other side of it.
    assert np.sort(difference.max(axis=1))[-4] < 1e-4


def test_the_gloss_of_an_object_that_nobody_would_miss_is_left_out():
    faint = [material(0.5, beta=1e-4, mu=0.3), material(GREENISH, beta=3.0, mu=0.3)]
    document, _ = planned(faint, room())
    assert values(document)["gloss"] == ["jar"] and document["decisions"]["gloss"]["predicted_delta_e"] > 0


@pytest.mark.default_cases(2)
@pytest.mark.parametrize(
    ("overrides", "field"),
    [
        ({"gloss": ["pot"]}, "plan.gloss"),
        ({"mirror": ["table"]}, "plan.mirror"),
        ({"light_bases": 9}, "plan.light_bases"),
        ({"environment_halvings": 19}, "plan.environment_halvings"),
    ],
)
def test_an_override_that_the_scene_cannot_meet_is_refused_with_what_it_can(overrides, field):
    shiny = [material(0.5), material(GREENISH, beta=3.0, mirror=0.4)]
    with pytest.raises(InputError) as caught:
        planned(shiny, room(), overrides=overrides)
    assert caught.value.field == field and caught.value.accepted


def test_the_plan_says_what_the_scenes_file_decided_even_where_that_is_nothing():
    nothing = {
        "mirror": [],
        "max_bounces": 0,
        "least_throughput": 0.0,
        "environment_halvings": 0,
        "texture_halvings": 0,
    }
    document, _ = planned([material(0.5), material(GREENISH, mirror=0.4)], room(), overrides={**nothing, "nodes": 14})
    decided = {name for name, decision in document["decisions"].items() if decision["by"] == "scene"}
    assert decided == {*nothing, "nodes", "representation"}  # the number of nodes leaves one representation
    found = values(document)
    assert found["mirror"] == [] and found["nodes"] == 14
    assert not any(found[name] for name in ("max_bounces", "least_throughput", "environment_halvings"))


def test_coefficients_are_not_offered_where_a_mirror_has_a_colour():
    gold = [material(0.4), material(0.0, mirror=1.0, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS])]
    with pytest.raises(InputError, match="quadrature, spectral"):
        planned(gold, room(), overrides={"representation": "coefficients"})


def test_textures_are_as_fine_as_the_picture_shows_them():
    def waves(texels):
        place = 2.0 * np.pi * 3.0 * (np.arange(texels) + 0.5) / texels
        pattern = 0.25 * (2.0 + np.sin(place)[:, None] + np.cos(place))
        plain = Material.uniform(0.4 * ONES)
        whole = {key: np.ones((texels, texels)) for key in ("alpha", "green_response")}
        coefficients = (0.4 + pattern)[..., None].astype(np.float32)
        zero = np.zeros((texels, texels))
        return dataclasses.replace(plain, **whole, beta=zero, mu=zero + 0.1, coefficients=coefficients)

    found = []
    for texels in (32, 256):
        document, _ = planned([waves(texels), material(0.3)], room(), tolerance=2.0)
        found.append(values(document)["texture_halvings"]["table"])
    # Eight times the texels for the same picture: they are halved away.
    assert found[1] >= found[0] + 2


def checked_texture(rng, beta: float, mirror: float) -> Material:
    """Texels of no pattern, whose halvings all differ."""
    plain = Material.uniform(0.4 * ONES)
    texels = 24, 40
    maps = {key: np.ones(texels) for key in ("alpha", "green_response")}
    coefficients = rng.uniform(0.3, 1.6, (*texels, 1)).astype(np.float32)
    zero, own = np.zeros(texels), rng.uniform(0.5, 1.5, texels)
    return dataclasses.replace(
        plain, **maps, beta=zero + beta * own, mu=zero + 0.1 * own, coefficients=coefficients, mirror=mirror
    )


def projected(parts, full, bases):
    """What changes, and the model, where the light is kept on a few vectors."""
    to, basis = leading_basis(light_of(parts.environment), bases)
    return Changes(light_basis=to @ basis), replace(full, light_bases=bases)


CHANGED = {
    "nothing": lambda parts, full: (Changes(), full),
    "bounces": lambda parts, full: (Changes(max_bounces=1), replace(full, max_bounces=1)),
    "throughput": lambda parts, full: (Changes(least_throughput=0.1), replace(full, least_throughput=0.1)),
    "gloss": lambda parts, full: (Changes(without_gloss=frozenset([1])), replace(full, gloss=(True, False))),
    "mirror": lambda parts, full: (Changes(without_mirror=frozenset([0])), replace(full, mirror=(False, True))),
    "light": lambda parts, full: projected(parts, full, 1),
    "sky": lambda parts, full: (Changes(sky_level=2), replace(full, environment_halvings=2)),
    "textures": lambda parts, full: (Changes(texture_level={0: 1, 1: 3}), replace(full, texture_halvings=(1, 3))),
    "several": lambda parts, full: (
        Changes(1, 1e-3, frozenset([0]), frozenset([1]), sky_level=1, texture_level={0: 2}),
        replace(full, max_bounces=1, least_throughput=1e-3, gloss=(False, True), mirror=(True, False),
                environment_halvings=1, texture_halvings=(2, 0)),
    ),
}  # fmt: skip


class Probed(NamedTuple):
    """A scene as the planner probes it, and as it is prepared for a picture."""

    parts: SceneParts
    full: Model
    matrix: np.ndarray
    probes: Probes
    whole: np.ndarray  # what the probes' rays show of the scene as it is
    shown: Callable  # the same of a model of it


@functools.cache
def probed(lamps: int) -> Probed:
    """Return the scene under a sky and lamps; one for all changes, each of which is taken back."""
    rng = np.random.default_rng(4)
    materials = [checked_texture(rng, 1.0, 0.4), dataclasses.replace(checked_texture(rng, 2.0, 0.8), coat="coupled")]
    definition = scene_of(lights=[LAMP] * lamps)
    parts = parts_of(make_renderer(made(Scene, definition), [TABLE, JAR], materials, room(), made(Render, OPTIONS)))
    full, matrix = full_model(parts, 4), xyz_from_radiance(parts.white)
    view = make_view(made(View, definition["views"]["v"]), made(Size, definition["image"]))
    ladder = make_light(parts.environment)
    probes = Probes(parts, full, ladder, [view], 500, 7)
    lights = tuple(CollimatedLamp(towards) for towards in parts.lamp_towards)

    def shown(model):
        return render_rays(prepare(parts, model, matrix, ladder), view, probes.rays, lights)

    return Probed(parts, full, matrix, probes, shown(full), shown)


@pytest.mark.default_cases(5)
@pytest.mark.parametrize("lamps", [0, 1])
@pytest.mark.parametrize("change", CHANGED)
def test_a_change_of_the_probes_scene_is_what_a_scene_prepared_without_it_shows(change, lamps):
    scene = probed(lamps)
    probes, (changes, model) = scene.probes, CHANGED[change](scene.parts, scene.full)
    for _ in range(2):  # what was changed is taken back
        shown = probes.radiance(changes) @ scene.matrix.T
        whole = probes.radiance() @ scene.matrix.T
    for found, expected in ((shown, scene.shown(model)), (whole, scene.whole)):
        assert np.abs(found - expected).max() < 1e-5 * expected.max()
    assert (np.abs(shown - whole).max() > 1e-4 * whole.max()) == (change != "nothing")
    met = probes.met(changes)
    assert met["rays"] == pytest.approx(met["hits"] + met["misses"]) and 0 < met["glossy"] <= met["hits"]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("side", [1, 2])
def test_an_environment_of_straight_edges_is_halved_no_further_than_its_check_allows(side):
    """Panels of two pixels of the picture and more, beside a mirror and in it; ``side`` rays along a pixel."""
    rng, height = np.random.default_rng(5), 256
    panels = np.ones((height, 2 * height, 3))
    for _ in range(60):
        y, x, rows, columns = *rng.integers(0, [height, 2 * height]), *rng.integers(5, height // 6, 2)
        panels[y : y + rows, x : x + columns] = rng.uniform(0.1, 4.0, 3)
    light, mirrors = sky(lambda unit: panels, 2 * height, height, BASIS), [MIRRORS[0], material(GREENISH)]
    definition, options = scene_of(), replace(OPTIONS, pixel_side=side)
    definition["views"]["v"]["field_of_view_deg"] = 45.0
    document = plan_of("table-top", made(Scene, definition), [TABLE, JAR], mirrors, light, made(Render, options))
    _, figures = render_image(
        made(Scene, definition), "v", [TABLE, JAR], mirrors, light, made(Render, options), plan=ScenePlan.of(document)
    )
    assert figures["plan"]["delta_e_to_full_model"]["p99"] <= document["predicted_delta_e"] + 0.02


def test_a_view_of_parallel_rays_is_predicted_and_checked_as_it_is_rendered():
    shiny = [material(0.5, mirror=0.3), material(GREENISH, beta=3.0, mu=0.15, mirror=0.4)]
    definition = scene_of() | {"views": {"v": PARALLEL}}
    document = plan_of("table-top", made(Scene, definition), [TABLE, JAR], shiny, room(), made(Render, OPTIONS))
    # The table and the jar fill most of the picture, and throw rays at each other.
    assert document["cost_of_full_model"]["rays_per_pixel"] > 1.5
    _, figures = picture(shiny, room(), document, definition)
    assert figures["plan"]["delta_e_to_full_model"]["p99"] <= document["predicted_delta_e"] + 0.02 <= 1.02


@pytest.mark.heavy
def test_rays_that_all_leave_the_scene_are_planned_for():
    """A mirror that has nothing to show but the sky, and a view of the sky alone."""
    mirrors = [material(0.2, beta=1.0, mu=0.2, mirror=1.0)]
    definition = scene_of() | {"objects": scene_of()["objects"][1:]}
    away = definition["views"]["v"] | {"target_mm": [0.0, -400.0, 250.0]}
    for views in ({"v": definition["views"]["v"]}, {"v": away}):
        definition |= {"views": views}
        document = plan_of("table-top", made(Scene, definition), [JAR], mirrors, room(), made(Render, OPTIONS))
        _, figures = render_image(
            made(Scene, definition), "v", [JAR], mirrors, room(), made(Render, OPTIONS), plan=ScenePlan.of(document)
        )
        assert figures["plan"]["delta_e_to_full_model"]["p99"] <= document["predicted_delta_e"] + 0.02 <= 1.02


def test_a_scene_without_light_has_no_colours_to_tolerate():
    with pytest.raises(InputError, match="no light"):
        planned([material(0.5), material(0.5)], black())


def test_a_picture_without_spectra_is_read_as_the_xyz_that_it_is(tmp_path):
    rng = np.random.default_rng(3)
    matrix, xyz = rng.random((3, 61)), rng.random((4, 5, 3)).astype(np.float32)
    write_xyz_exr(tmp_path / "planned.exr", xyz, {"irodori:whiteXYZ": "1 1 1"})
    assert np.array_equal(read_xyz(tmp_path / "planned.exr", matrix), xyz)
    radiance = rng.random((4, 5, 61)).astype(np.float32)
    write_spectral_exr(tmp_path / "full.exr", radiance, xyz, {}, storage="single")
    assert np.allclose(read_xyz(tmp_path / "full.exr", matrix), radiance @ matrix.T, rtol=1e-6)


def test_objects_that_stand_twice_and_bodies_have_names_of_their_own():
    scene = {"objects": [{"object": "jar"}, {"object": "lid"}, {"object": "jar"}], "bodies": [{}, {}]}
    assert object_names(made(Scene, scene)) == ["jar", "lid", "jar#2", "bodies[0]", "bodies[1]"]


def test_the_bound_of_a_share_holds_for_the_whole():
    rng = np.random.default_rng(0)
    true = -np.log(0.01)
    bounds = np.array([bound_of_share(rng.exponential(size=2000)) for _ in range(500)])
    assert (bounds >= true).mean() > 0.99 and np.median(bounds) < 1.4 * true
    assert bound_of_share(np.arange(10.0)) == 9.0


def test_a_file_that_is_no_plan_is_refused_by_its_name(tmp_path):
    (tmp_path / "plan.yaml").write_text("{scene: table-top, integrator: interactive, tolerance_ciede2000: 1.0}")
    with pytest.raises(InputError, match=r"plan\.yaml: found no whole plan; accepted: .* plan_scene"):
        read_plan(tmp_path / "plan.yaml")
